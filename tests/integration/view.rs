//! `view`: the page follows the file, keeps the last good one, and answers to its own address only.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use crate::support::{Workplace, root};

/// The running program and where it listens.
struct Server {
    child: Child,
    address: String,
}

impl Server {
    fn start(place: &Workplace, what: &str) -> Self {
        let mut child =
            place.command(&format!("view {what} --rays 200")).stdout(Stdio::piped()).spawn().expect("starts");
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("piped")).read_line(&mut line).expect("an address");
        let address = line.trim().trim_start_matches("http://").trim_end_matches('/').to_owned();
        assert!(address.starts_with("127.0.0.1:"), "{line}");
        Self { child, address }
    }

    /// A request for `path` under the name `host`, kept open.
    fn ask(&self, path: &str, host: &str) -> TcpStream {
        let mut stream = TcpStream::connect(&self.address).expect("connects");
        stream.set_read_timeout(Some(Duration::from_secs(60))).expect("a time limit");
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").expect("asks");
        stream
    }

    fn get(&self, path: &str, host: &str) -> String {
        let mut text = String::new();
        self.ask(path, host).read_to_string(&mut text).expect("answers");
        text
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
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
    let first = server.get("/", &server.address);
    assert!(first.starts_with("HTTP/1.1 200") && first.contains("Cooke triplet") && first.contains("EventSource"));
    for (path, host, code) in
        [("/", "evil.example", 403), ("/", "evil.example:80", 403), ("/etc/passwd", &*server.address, 404)]
    {
        assert!(server.get(path, host).starts_with(&format!("HTTP/1.1 {code}")), "{path} {host}");
    }
    let mut events = BufReader::new(server.ask("/events", &server.address));
    let start = next(&mut events)["version"].as_u64().expect("a version");

    let saved = Instant::now();
    place.write("lens.toml", text.replace("Cooke triplet", "Another triplet"));
    let seen = loop {
        let event = next(&mut events);
        assert!(event["error"].is_null(), "{event}");
        if server.get("/", &server.address).contains("Another triplet") {
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
    assert!(server.get("/", &server.address).contains("Another triplet"), "the last good page");

    place.write("lens.toml", &text);
    loop {
        let event = next(&mut events);
        if event["error"].is_null() && server.get("/", &server.address).contains("Cooke triplet") {
            break;
        }
    }
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
}
