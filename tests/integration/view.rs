//! `view`: the page follows the file, keeps the last good one, and can be exported.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::support::{Workplace, root};

/// The running program, where it listens, and the token it wants.
pub(crate) struct Server {
    pub(crate) child: Child,
    pub(crate) address: String,
    pub(crate) token: String,
}

impl Server {
    pub(crate) fn start(place: &Workplace, what: &str) -> Self {
        Self::started(place.command(&format!("view {what} --rays 200")))
    }

    /// The same by a command of one's own.
    pub(crate) fn started(mut command: Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).spawn().expect("starts");
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("piped")).read_line(&mut line).expect("an address");
        let (address, token) = apart(line.trim());
        Self { child, address, token }
    }

    /// A path with the token.
    pub(crate) fn with_token(&self, path: &str) -> String {
        format!("{path}?token={}", self.token)
    }

    /// A connection on which these bytes were sent.
    pub(crate) fn send(&self, bytes: &[u8]) -> TcpStream {
        let mut stream = TcpStream::connect(&self.address).expect("connects");
        stream.set_read_timeout(Some(Duration::from_secs(60))).expect("a time limit");
        // A server that has seen enough may have closed it.
        let _ = stream.write_all(bytes);
        stream
    }

    /// A request for `target` under the name `host`, kept open.
    pub(crate) fn ask(&self, target: &str, host: &str) -> TcpStream {
        self.send(format!("GET {target} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").as_bytes())
    }

    pub(crate) fn get(&self, target: &str, host: &str) -> String {
        let mut text = String::new();
        self.ask(target, host).read_to_string(&mut text).expect("answers");
        text
    }

    /// The page as its user sees it.
    pub(crate) fn page(&self) -> String {
        self.get(&self.with_token("/"), &self.address)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Address and token of a page's whole address.
fn apart(url: &str) -> (String, String) {
    let parts = url.strip_prefix("http://").and_then(|rest| rest.split_once("/?token="));
    let (address, token) = parts.unwrap_or_else(|| panic!("an address with a token: {url}"));
    assert!(address.starts_with("127.0.0.1:"), "{url}");
    assert!(token.len() == 32 && token.chars().all(|c| c.is_ascii_hexdigit()), "128 bits: {url}");
    (address.to_owned(), token.to_owned())
}

/// The next event of a stream.
fn next(events: &mut impl BufRead) -> serde_json::Value {
    loop {
        let mut line = String::new();
        assert!(events.read_line(&mut line).expect("an event") > 0, "the stream ended");
        if let Some(data) = line.strip_prefix("data: ") {
            return serde_json::from_str(data).expect("JSON");
        }
    }
}

#[test]
fn the_page_follows_the_file_and_keeps_the_last_good_one() {
    let place = Workplace::new();
    let text = std::fs::read_to_string(root().join("models/lenses/cooke_triplet.toml")).expect("reads");
    place.write("lens.toml", &text);
    let server = Server::start(&place, "lens.toml");
    let first = server.page();
    assert!(first.starts_with("HTTP/1.1 200") && first.contains("Cooke triplet") && first.contains("EventSource"));
    let mut events = BufReader::new(server.ask(&server.with_token("/events"), &server.address));
    let start = next(&mut events)["version"].as_u64().expect("a version");

    let saved = Instant::now();
    place.write("lens.toml", text.replace("Cooke triplet", "Another triplet"));
    let seen = loop {
        let event = next(&mut events);
        assert!(event["error"].is_null(), "{event}");
        let page = server.page();
        if page.contains("Another triplet") {
            break event["version"].as_u64().expect("a version");
        }
    };
    eprintln!("a saved edit was served after {:?}", saved.elapsed());
    assert!(seen > start);

    place.write("lens.toml", text.replace("radius_mm = ", "radius_mm = \"x\" # "));
    let wrong = loop {
        let event = next(&mut events);
        if let Some(error) = event["error"].as_str() {
            break error.to_owned();
        }
    };
    assert!(wrong.contains("lens.toml"), "{wrong}");
    assert!(server.page().contains("Another triplet"), "the last good page");

    place.write("lens.toml", &text);
    loop {
        let event = next(&mut events);
        if event["error"].is_null() && server.page().contains("Cooke triplet") {
            // The event names the page that is served.
            let name =
                format!("<meta name=\"isoplanat-page\" content=\"{}\">", event["page"].as_str().expect("a name"));
            assert!(server.page().contains(&name) || next(&mut events)["version"].is_u64(), "{name}");
            break;
        }
    }
}

/// The folder of a design shows its page, and every run has a token of its own.
#[test]
fn a_run_shows_its_page_and_json_has_the_whole_address() {
    let place = Workplace::new();
    std::fs::create_dir(place.path("run")).expect("creates");
    place.run("view cooke_triplet --rays 100 --export run/report.html").done();
    let server = Server::started(place.command("view run"));
    assert!(server.page().contains("Cooke triplet"));
    let mut command = place.command("view run --json");
    let mut other = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("starts");
    let mut line = String::new();
    BufReader::new(other.stdout.take().expect("piped")).read_line(&mut line).expect("an address");
    let told: serde_json::Value = serde_json::from_str(&line).expect("JSON");
    let (_, token) = apart(told["url"].as_str().expect("an address"));
    assert_ne!(token, server.token);
    let _ = (other.kill(), other.wait());
    let mut told = String::new();
    other.stderr.take().expect("piped").read_to_string(&mut told).expect("UTF-8");
    assert_eq!(told, "", "the page is this program's own");

    // A page of another program: its script is not among those that the policy lets run.
    place.write("run/report.html", "<html><head></head><body>Old<script>alert(1)</script></body></html>");
    let mut old = place.command("view run").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("starts");
    let mut note = String::new();
    BufReader::new(old.stderr.take().expect("piped")).read_line(&mut note).expect("a note");
    let _ = (old.kill(), old.wait());
    assert!(note.starts_with("note: run: ") && note.contains("script"), "{note}");
}

#[test]
fn a_page_can_be_exported_and_what_is_neither_lens_nor_run_is_refused() {
    let place = Workplace::new();
    place.run("view cooke_triplet --rays 100 --export page.html").done();
    let page = std::fs::read_to_string(place.path("page.html")).expect("reads");
    assert!(page.contains("Cooke triplet") && !page.contains("EventSource"));
    place.run("view cooke_triplet --export page.html").refused(&["page.html", "--force"]);
    place.run("view none_such").refused(&["none_such"]);
    std::fs::create_dir(place.path("empty")).expect("creates");
    place.run("view empty").refused(&["empty", "report.html"]);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("an address").port();
    place.run(&format!("view cooke_triplet --rays 100 --port {port}")).refused(&["--port", &port.to_string()]);
}
