//! `isoplanat view`: the page of a lens or of a run, live: it follows the file.
//!
//! A small server on the loopback interface. It answers `GET` of the page and of a stream of events (one a version), to requests whose `Host`
//! is its own, so that no foreign page can read through it by a name of its own. A file that is no lens keeps the last good page, with the error on top.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use isoplanat::lens::Lens;
use isoplanat::report::lens::{LensReport, Options, html};
use isoplanat::{Error, Result};
use tiny_http::{Header, Method, Request, Response, Server};

use crate::analyses::View;

/// Arguments of `view`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), the name of a shipped lens, or the folder of a design
    #[arg(value_name = "LENS|RUN")]
    what: String,
    /// Port on the loopback interface; 0 takes a free one
    #[arg(long, default_value_t = 0)]
    port: u16,
    /// Write the page to a file and end: the same page, without a server
    #[arg(long, value_name = "OUT.html")]
    export: Option<PathBuf>,
    #[command(flatten)]
    view: View,
    /// Overwrite the file
    #[arg(long)]
    force: bool,
}

/// How often the file is looked at.
const LOOK: Duration = Duration::from_millis(25);
/// Rays of a spot for the page that comes at once; the whole page follows it.
const FIRST_RAYS: usize = 100;
/// Least time between two signs of life on a stream of events.
const ALIVE: Duration = Duration::from_secs(10);

/// What the server shows.
#[derive(Debug, Default)]
struct Shown {
    version: u64,
    page: String,
    /// Why the file as it is now is not shown.
    error: Option<String>,
}

/// The shown page, and the news that it is another.
#[derive(Debug, Default)]
struct Board {
    shown: Mutex<Shown>,
    news: Condvar,
}

impl Board {
    /// Changes what is shown; with `after` only while that version is. The new version, if it was changed.
    fn change(&self, after: Option<u64>, how: impl FnOnce(&mut Shown)) -> Option<u64> {
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        if after.is_some_and(|version| version != shown.version) {
            return None;
        }
        how(&mut shown);
        shown.version += 1;
        self.news.notify_all();
        Some(shown.version)
    }

    /// What is shown once it is another than `version`, or after [`ALIVE`].
    fn after(&self, version: u64) -> (u64, Option<String>) {
        let shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.news.wait_timeout_while(shown, ALIVE, |s| s.version == version);
        let (shown, _) = waited.unwrap_or_else(PoisonError::into_inner);
        (shown.version, shown.error.clone())
    }
}

/// What is looked at.
#[derive(Clone, Debug)]
enum Subject {
    /// A lens by its file or name.
    Lens(String),
    /// The page in a design's folder, written anew by the design itself.
    Page(PathBuf),
}

impl Subject {
    fn new(what: &str) -> Result<Self> {
        let folder = Path::new(what);
        if !folder.is_dir() {
            return Ok(Self::Lens(what.to_owned()));
        }
        let page = folder.join("report.html");
        if page.is_file() {
            return Ok(Self::Page(page));
        }
        Err(Error::bad(
            what,
            "report.html",
            "none",
            "the folder of a design, which has one from its first judgement on",
        ))
    }

    /// The file that is followed; none for a shipped lens.
    fn file(&self) -> Option<&Path> {
        match self {
            Self::Lens(name) => Some(Path::new(name)).filter(|p| p.is_file()),
            Self::Page(page) => Some(page),
        }
    }
}

/// What tells one state of a file from another.
fn state(path: Option<&Path>) -> Option<(SystemTime, u64)> {
    let meta = std::fs::metadata(path?).ok()?;
    Some((meta.modified().ok()?, meta.len()))
}

/// The page of `lens`; a first one has few rays and no kernels.
fn page(lens: &Lens, options: &Options, first: bool) -> Result<String> {
    let colour = !first && crate::report::in_colour(lens);
    let rays = if first { options.rays.min(FIRST_RAYS) } else { options.rays };
    let options = Options { rays, colour, whole: !first, ..options.clone() };
    html(&[LensReport::new(lens.clone(), &options)])
}

/// What is followed, and how it is shown.
#[derive(Clone, Debug)]
struct Watch {
    subject: Subject,
    view: View,
    options: Options,
    board: Arc<Board>,
}

impl Watch {
    /// Shows the subject anew whenever its file is another and stays so for a moment: editors write a file in more than one step.
    fn run(&self) {
        let mut seen = None;
        let mut first = true;
        loop {
            let now = state(self.subject.file());
            if first || now != seen {
                std::thread::sleep(LOOK);
                if state(self.subject.file()) == now {
                    (first, seen) = (false, now);
                    self.show();
                }
            } else {
                std::thread::sleep(LOOK);
            }
        }
    }

    /// Shows the subject as it is now: a lens at once by few rays, then whole, unless the file is another by then.
    fn show(&self) {
        let name = match &self.subject {
            Subject::Page(file) => {
                self.put(std::fs::read_to_string(file).map_err(|e| Error::reading(file, e)), None);
                return;
            }
            Subject::Lens(name) => name,
        };
        let lens = match self.view.lens(name) {
            Ok(lens) => lens,
            Err(e) => {
                self.put(Err(e), None);
                return;
            }
        };
        let Some(version) = self.put(page(&lens, &self.options, true), None) else { return };
        let whole = self.clone();
        // By itself: an edit does not wait for the whole page of what was there before.
        std::thread::spawn(move || whole.put(page(&lens, &whole.options, false), Some(version)));
    }

    /// Shows a page, or why there is none; `after` a version only while it is shown still. The new version, if it is a page's.
    fn put(&self, made: Result<String>, after: Option<u64>) -> Option<u64> {
        let error = match made {
            Ok(page) => return self.board.change(after, |s| (s.page, s.error) = (live(&page), None)),
            Err(e) => e.to_string().replace('\n', " "),
        };
        eprintln!("error: {error}");
        self.board.change(after, |s| s.error = Some(error));
        None
    }
}

/// The page with what keeps it up to date.
fn live(page: &str) -> String {
    page.replacen("</head>", &format!("<script>{LIVE}</script>\n</head>"), 1)
}

const LIVE: &str = include_str!("view.js");

/// Runs the command until it is interrupted; where the page is goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let options = args.view.options()?;
    let subject = Subject::new(&args.what)?;
    if let Some(path) = &args.export {
        crate::output::check_writable(path, args.force)?;
        let text = match &subject {
            Subject::Lens(name) => page(&args.view.lens(name)?, &options, false)?,
            Subject::Page(file) => std::fs::read_to_string(file).map_err(|e| Error::reading(file, e))?,
        };
        return crate::output::put(&text, Some(path), out);
    }
    let board = Arc::new(Board::default());
    // A first page, or the reason why there is none, before anything is served.
    if let Subject::Lens(name) = &subject {
        let first = page(&args.view.lens(name)?, &options, true)?;
        board.change(None, |s| s.page = live(&first));
    }
    let server = Server::http(("127.0.0.1", args.port))
        .map_err(|e| Error::bad("--port", "port", args.port.to_string(), format!("a free port ({e})")))?;
    let address = server.server_addr().to_string();
    writeln!(out, "http://{address}/")?;
    out.flush()?;
    let watch = Watch { subject, view: args.view.clone(), options, board: Arc::clone(&board) };
    std::thread::spawn(move || watch.run());
    for request in server.incoming_requests() {
        let (board, address) = (Arc::clone(&board), address.clone());
        std::thread::spawn(move || answer(request, &address, &board));
    }
    Ok(())
}

/// Answers one request; who went away is not written to.
fn answer(request: Request, address: &str, board: &Board) {
    let port = address.rsplit(':').next().unwrap_or("");
    let host = request.headers().iter().find(|h| h.field.equiv("Host")).map(|h| h.value.as_str().to_owned());
    let own = [address.to_owned(), format!("localhost:{port}")];
    if !host.is_some_and(|h| own.contains(&h)) {
        let _ = request
            .respond(Response::from_string("this server answers to its own address only\n").with_status_code(403));
        return;
    }
    if *request.method() != Method::Get {
        let _ = request.respond(Response::from_string("GET only\n").with_status_code(405));
        return;
    }
    match request.url().split('?').next().unwrap_or("") {
        "/" => {
            let page = board.shown.lock().unwrap_or_else(PoisonError::into_inner).page.clone();
            let kinds = [("Content-Type", "text/html; charset=utf-8"), ("Cache-Control", "no-store")];
            // In one piece: chunks are of no use to a page that is ready.
            let response = kinds
                .iter()
                .filter_map(|(k, v)| Header::from_bytes(k.as_bytes(), v.as_bytes()).ok())
                .fold(Response::from_string(page).with_chunked_threshold(usize::MAX), Response::with_header);
            let _ = request.respond(response);
        }
        "/events" => {
            let _ = events(request, board);
        }
        _ => {
            let _ = request.respond(Response::from_string("nothing here\n").with_status_code(404));
        }
    }
}

/// A stream of events: each has the version and, where the file cannot be shown, why.
fn events(request: Request, board: &Board) -> std::io::Result<()> {
    let mut to = request.into_writer();
    to.write_all(
        b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n",
    )?;
    let mut version = u64::MAX;
    loop {
        let (now, error) = board.after(version);
        if now == version {
            to.write_all(b": still here\n\n")?;
        } else {
            version = now;
            let event = serde_json::json!({ "version": version, "error": error });
            write!(to, "data: {event}\n\n")?;
        }
        to.flush()?;
    }
}
