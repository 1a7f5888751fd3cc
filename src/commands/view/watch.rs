//! What is followed, and its pages: at once by few rays, then whole.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant, SystemTime};

use isoplanat::lens::Lens;
use isoplanat::report::lens::{LensReport, Options, html};
use isoplanat::{Error, Result, threads};

use super::board::Board;
use crate::analyses::View;
use crate::named::Named;

/// How often the file is looked at.
const LOOK: Duration = Duration::from_millis(8);
/// After so long a file that could not be read is read again: that may have been for want of descriptors, not its own fault.
const AGAIN: Duration = Duration::from_secs(1);
/// Rays of a spot for the page that comes at once; the whole page follows it.
const FIRST_RAYS: usize = 100;
/// Shifts of the image plane to each side on that page.
const FIRST_SHIFTS: u32 = 1;

/// Bytes of a design's page at most.
const LARGEST: u64 = 256 << 20;

/// What is looked at.
#[derive(Clone, Debug)]
pub(super) enum Subject {
    /// A lens by its file or name.
    Lens(Named),
    /// The page in a design's folder, written anew by the design itself.
    Page(PathBuf),
}

impl Subject {
    pub(super) fn new(what: &Named) -> Result<Self> {
        let folder: &Path = what.as_ref();
        if !folder.is_dir() {
            return Ok(Self::Lens(what.clone()));
        }
        let page = folder.join("report.html");
        if page.is_file() {
            return Ok(Self::Page(page));
        }
        Err(Error::bad(
            &**what,
            "report.html",
            "none",
            "the folder of a design, which has one from its first judgement on",
        ))
    }

    /// The file that is followed; none for a shipped lens.
    fn file(&self) -> Option<&Path> {
        match self {
            Self::Lens(name) => Some(name.as_ref()).filter(|p: &&Path| p.is_file()),
            Self::Page(page) => Some(page),
        }
    }
}

/// What is followed, and how it is shown.
#[derive(Clone, Debug)]
pub(super) struct Watch {
    pub(super) subject: Subject,
    pub(super) view: View,
    pub(super) options: Options,
}

impl Watch {
    /// The page as it is now; a first one has few rays and no kernels.
    pub(super) fn page(&self, first: bool) -> Result<String> {
        match &self.subject {
            Subject::Lens(name) => page(&self.view.lens(name)?, &self.options, first),
            Subject::Page(file) => isoplanat::atomic::read_text(file, LARGEST),
        }
    }

    /// Shows the subject on `board` from now on, by two threads.
    ///
    /// # Errors
    /// A system that lets them not be started.
    pub(super) fn start(self, board: &Arc<Board>) -> Result<()> {
        let (wanted, asked) = channel();
        let (shown, options) = (Arc::clone(board), self.options.clone());
        threads::start(move || whole(&shown, &options, &asked))?;
        let board = Arc::clone(board);
        threads::start(move || self.run(&board, &wanted))
    }

    /// Shows the subject anew whenever its file is another and stays so for a moment: editors write a file in more than one step.
    fn run(&self, board: &Board, wanted: &Sender<(Lens, u64)>) {
        let mut seen = None;
        // The page that is shown first has few rays: it is made again, and the whole one after it.
        let mut due = Some(Instant::now());
        loop {
            let now = state(self.subject.file());
            if now == seen && due.is_none_or(|at| at > Instant::now()) {
                std::thread::sleep(LOOK);
                continue;
            }
            std::thread::sleep(2 * LOOK);
            if state(self.subject.file()) == now {
                seen = now;
                due = self.show(board, wanted).err().map(|Unread| Instant::now() + AGAIN);
            }
        }
    }

    /// Shows the subject as it is now: a lens at once by few rays, then whole, unless the file is another by then.
    fn show(&self, board: &Board, wanted: &Sender<(Lens, u64)>) -> Result<(), Unread> {
        let name = match &self.subject {
            Subject::Page(_) => {
                put(board, self.page(false), None)?;
                return Ok(());
            }
            Subject::Lens(name) => name,
        };
        let lens = match self.view.lens(name) {
            Ok(lens) => lens,
            Err(e) => {
                put(board, Err(e), None)?;
                return Ok(());
            }
        };
        if let Some(version) = put(board, page(&lens, &self.options, true), None)? {
            // By another thread: an edit does not wait for the whole page of what was there before.
            let _ = wanted.send((lens, version));
        }
        Ok(())
    }
}

/// A file could not be read, whatever it holds.
#[derive(Clone, Copy, Debug)]
struct Unread;

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
        let options = Options { rays, colour, shifts, whole: !first, energy: !first, ..options.clone() };
        html(&[LensReport::new(lens.clone(), &options)])
    };
    let made = std::panic::catch_unwind(std::panic::AssertUnwindSafe(make));
    made.unwrap_or_else(|_| Err(Error::Internal(format!("the page of {} could not be made", lens.name))))
}

/// Makes whole pages, one at a time, only of what is shown still.
fn whole(board: &Board, options: &Options, wanted: &Receiver<(Lens, u64)>) {
    while let Ok(mut next) = wanted.recv() {
        while let Ok(newer) = wanted.try_recv() {
            next = newer;
        }
        let (lens, version) = next;
        if board.shows(version) {
            // The lens has been read: nothing of a file is wanted any more.
            let _ = put(board, page(&lens, options, false), Some(version));
        }
    }
}

/// Shows a page, or why there is none; `after` a version only while it is shown still. The new version, if it is a page's.
fn put(board: &Board, made: Result<String>, after: Option<u64>) -> Result<Option<u64>, Unread> {
    let error = match made {
        Ok(page) => return Ok(board.put(Ok(&page), after)),
        Err(e) => e,
    };
    let told = error.to_string().replace('\n', " ");
    if board.put(Err(&told), after).is_some() {
        crate::tell!("error: {told}");
    }
    if matches!(error, Error::Io { .. }) { Err(Unread) } else { Ok(None) }
}
