//! `isoplanat view`: the page of a lens or of a run, live: it follows the file.
//!
//! A small server on the loopback interface. It answers `GET` of the page and of a stream of events (one a version), to requests whose `Host`
//! is its own, so that no foreign page can read through it by a name of its own. A file that is no lens keeps the last good page, with the error on top.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
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
    /// The address, or the written file, as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    view: View,
    /// Overwrite the file
    #[arg(long)]
    force: bool,
}

/// How often the file is looked at.
const LOOK: Duration = Duration::from_millis(8);
/// Rays of a spot for the page that comes at once; the whole page follows it.
const FIRST_RAYS: usize = 100;
/// Shifts of the image plane to each side on that page.
const FIRST_SHIFTS: u32 = 1;
/// Least time between two signs of life on a stream of events.
const ALIVE: Duration = Duration::from_secs(10);

/// Bytes of a design's page at most.
const LARGEST: u64 = 256 << 20;

/// Connections at once; more are refused.
const MOST: usize = 64;
/// Bytes of a request's body that are read; none is wanted.
const BODY: usize = 1 << 16;

/// What the server shows.
#[derive(Debug, Default)]
struct Shown {
    /// Counts all changes.
    version: u64,
    page: String,
    /// The version that brought the page.
    page_version: u64,
    /// Why the file as it is now is not shown.
    error: Option<String>,
}

/// An event: which page is shown, and what is wrong with the file as it is now.
#[derive(Clone, Debug)]
struct News {
    version: u64,
    page_version: u64,
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
        shown.version += 1;
        how(&mut shown);
        self.news.notify_all();
        Some(shown.version)
    }

    /// What is shown once it is another than `version`, or after [`ALIVE`].
    fn after(&self, version: u64) -> News {
        let shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.news.wait_timeout_while(shown, ALIVE, |s| s.version == version);
        let (shown, _) = waited.unwrap_or_else(PoisonError::into_inner);
        News { version: shown.version, page_version: shown.page_version, error: shown.error.clone() }
    }

    /// Whether `version` is still shown.
    fn shows(&self, version: u64) -> bool {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner).version == version
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

/// The page of `lens`; a first one has few rays and no kernels. A page that fails altogether does not end the program.
fn page(lens: &Lens, options: &Options, first: bool) -> Result<String> {
    let make = || {
        let colour = !first && crate::report::in_colour(lens);
        let rays = if first { options.rays.min(FIRST_RAYS) } else { options.rays };
        let shifts = if first { FIRST_SHIFTS } else { options.shifts };
        let options = Options { rays, colour, shifts, whole: !first, ..options.clone() };
        html(&[LensReport::new(lens.clone(), &options)])
    };
    let made = std::panic::catch_unwind(std::panic::AssertUnwindSafe(make));
    made.unwrap_or_else(|_| Err(Error::Internal(format!("the page of {} could not be made", lens.name))))
}

/// What is followed, and how it is shown.
#[derive(Clone, Debug)]
struct Watch {
    subject: Subject,
    view: View,
    options: Options,
    board: Arc<Board>,
    /// Lenses whose whole page is wanted, each with the version that shows it.
    wanted: Sender<(Lens, u64)>,
}

/// Makes whole pages, one at a time, only of what is shown still.
fn whole(board: &Board, options: &Options, wanted: &Receiver<(Lens, u64)>) {
    while let Ok(mut next) = wanted.recv() {
        while let Ok(newer) = wanted.try_recv() {
            next = newer;
        }
        let (lens, version) = next;
        if board.shows(version) {
            put(board, page(&lens, options, false), Some(version));
        }
    }
}

/// Shows a page, or why there is none; `after` a version only while it is shown still. The new version, if it is a page's.
fn put(board: &Board, made: Result<String>, after: Option<u64>) -> Option<u64> {
    let error = match made {
        Ok(page) => {
            return board.change(after, |s| (s.page, s.page_version, s.error) = (page, s.version, None));
        }
        Err(e) => e.to_string().replace('\n', " "),
    };
    let told = error.clone();
    if board.change(after, |s| s.error = Some(error)).is_some() {
        crate::tell!("error: {told}");
    }
    None
}

impl Watch {
    /// Shows the subject anew whenever its file is another and stays so for a moment: editors write a file in more than one step.
    fn run(&self) {
        let mut seen = None;
        let mut first = true;
        loop {
            let now = state(self.subject.file());
            if first || now != seen {
                std::thread::sleep(2 * LOOK);
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
                put(&self.board, isoplanat::atomic::read_text(file, LARGEST), None);
                return;
            }
            Subject::Lens(name) => name,
        };
        let lens = match self.view.lens(name) {
            Ok(lens) => lens,
            Err(e) => {
                put(&self.board, Err(e), None);
                return;
            }
        };
        let Some(version) = put(&self.board, page(&lens, &self.options, true), None) else { return };
        // By another thread: an edit does not wait for the whole page of what was there before.
        let _ = self.wanted.send((lens, version));
    }
}

/// The page with what keeps it up to date, and which page it is.
fn live(page: &str, name: &str) -> String {
    let head = format!("<meta name=\"isoplanat-page\" content=\"{name}\">\n<script>{LIVE}</script>\n</head>");
    page.replacen("</head>", &head, 1)
}

/// A name for this run of the server: pages of an earlier one at the same port are others.
fn nonce() -> String {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    format!("{:x}-{:x}", std::process::id(), since.as_nanos())
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
            Subject::Page(file) => isoplanat::atomic::read_text(file, LARGEST)?,
        };
        crate::output::put(&text, Some(path), args.force, out)?;
        if args.json {
            writeln!(out, "{}", serde_json::json!({ "schema": 1, "file": path }))?;
        }
        return Ok(());
    }
    let board = Arc::new(Board::default());
    // A first page, or the reason why there is none, before anything is served.
    let first = match &subject {
        Subject::Lens(name) => page(&args.view.lens(name)?, &options, true)?,
        Subject::Page(file) => isoplanat::atomic::read_text(file, LARGEST)?,
    };
    put(&board, Ok(first), None);
    let server = Server::http(("127.0.0.1", args.port))
        .map_err(|e| Error::bad("--port", "port", args.port.to_string(), format!("a free port ({e})")))?;
    let address = server.server_addr().to_string();
    let url = format!("http://{address}/");
    if args.json {
        writeln!(out, "{}", serde_json::json!({ "schema": 1, "url": url }))?;
    } else {
        writeln!(out, "{url}")?;
    }
    out.flush()?;
    let (wanted, asked) = channel();
    let (shown, how) = (Arc::clone(&board), options.clone());
    std::thread::spawn(move || whole(&shown, &how, &asked));
    let watch = Watch { subject, view: args.view.clone(), options, board: Arc::clone(&board), wanted };
    std::thread::spawn(move || watch.run());
    let desk = Arc::new(Desk { address, nonce: nonce(), board, open: AtomicUsize::new(0) });
    loop {
        let request = server.recv().map_err(|e| Error::reading(Path::new("the server's connections"), e))?;
        let desk = Arc::clone(&desk);
        std::thread::spawn(move || desk.answer(request));
    }
}

/// What answers requests.
#[derive(Debug)]
struct Desk {
    address: String,
    nonce: String,
    board: Arc<Board>,
    /// Requests that are being answered.
    open: AtomicUsize,
}

/// A short answer in words.
fn short(request: Request, code: u16, text: &str) {
    // Who went away is not written to.
    let _ = request.respond(Response::from_string(format!("{text}\n")).with_status_code(code));
}

impl Desk {
    /// Answers one request.
    fn answer(&self, request: Request) {
        if request.body_length().is_some_and(|length| length > BODY) {
            // Dropping it would read, and first allocate, the whole body; nothing here takes one.
            std::mem::forget(request);
            return;
        }
        if self.open.fetch_add(1, Ordering::Relaxed) < MOST {
            self.answer_one(request);
        } else {
            short(request, 503, "too many connections");
        }
        self.open.fetch_sub(1, Ordering::Relaxed);
    }

    /// Whether `host` is a name of this server's.
    fn is_own(&self, host: &str) -> bool {
        let port = self.address.rsplit(':').next().unwrap_or("");
        let bare = port == "80" && ["127.0.0.1", "localhost"].contains(&host);
        bare || host == self.address || host == format!("localhost:{port}")
    }

    fn answer_one(&self, request: Request) {
        let host = request.headers().iter().find(|h| h.field.equiv("Host")).map(|h| h.value.as_str().to_owned());
        if !host.is_some_and(|h| self.is_own(&h)) {
            short(request, 403, "this server answers to its own address only");
            return;
        }
        if *request.method() != Method::Get {
            short(request, 405, "GET only");
            return;
        }
        match request.url().split('?').next().unwrap_or("") {
            "/" => {
                let (page, version) = {
                    let shown = self.board.shown.lock().unwrap_or_else(PoisonError::into_inner);
                    (shown.page.clone(), shown.page_version)
                };
                let page = live(&page, &format!("{}.{version}", self.nonce));
                let kinds = [("Content-Type", "text/html; charset=utf-8"), ("Cache-Control", "no-store")];
                // In one piece: chunks are of no use to a page that is ready.
                let response = kinds
                    .iter()
                    .filter_map(|(k, v)| Header::from_bytes(k.as_bytes(), v.as_bytes()).ok())
                    .fold(Response::from_string(page).with_chunked_threshold(usize::MAX), Response::with_header);
                let _ = request.respond(response);
            }
            "/events" => {
                let _ = self.events(request);
            }
            _ => short(request, 404, "nothing here"),
        }
    }

    /// A stream of events: each names the page that is shown and, where the file cannot be shown, says why.
    fn events(&self, request: Request) -> std::io::Result<()> {
        let mut to = request.into_writer();
        to.write_all(
            b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n",
        )?;
        let mut version = u64::MAX;
        loop {
            let news = self.board.after(version);
            if news.version == version {
                to.write_all(b": still here\n\n")?;
            } else {
                version = news.version;
                let page = format!("{}.{}", self.nonce, news.page_version);
                let event = serde_json::json!({ "version": version, "page": page, "error": news.error });
                write!(to, "data: {event}\n\n")?;
            }
            to.flush()?;
        }
    }
}
