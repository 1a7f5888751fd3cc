//! Everything that is read from others, one target a reader: bytes in, a promise kept or a panic. What each promises stands in its file.
//!
//! The same functions run under libFuzzer (this package's programs, `.ci/slow fuzz`) and, over the corpus and seeded changes of it, as a test of every
//! change (`tests/integration/fuzz_corpus.rs`).

mod glasses;
mod kits;
mod lenses;
mod models;
mod pictures;
mod raw;
mod requests;
mod runs;
mod tables;

use std::path::PathBuf;

use isoplanat::{Error, Result};

/// A reader under test.
pub(crate) struct Target {
    /// What it is called: its program, its corpus, its dictionary.
    pub(crate) name: &'static str,
    /// Reads bytes; panics where a promise is broken.
    pub(crate) run: fn(&[u8]),
    /// Inputs to start from, made of what the program ships and writes.
    pub(crate) starts: fn() -> Vec<Vec<u8>>,
}

/// All of them.
pub(crate) const TARGETS: [Target; 20] = [
    Target { name: "zmx", run: lenses::zmx, starts: lenses::zmx_starts },
    Target { name: "seq", run: lenses::seq, starts: lenses::seq_starts },
    Target { name: "json", run: lenses::json, starts: lenses::json_starts },
    Target { name: "txt", run: lenses::txt, starts: lenses::txt_starts },
    Target { name: "prescription", run: lenses::prescription, starts: lenses::prescription_starts },
    Target { name: "agf", run: glasses::agf, starts: glasses::agf_starts },
    Target { name: "page", run: glasses::page, starts: glasses::page_starts },
    Target { name: "png", run: pictures::png, starts: pictures::png_starts },
    Target { name: "jpeg", run: pictures::jpeg, starts: pictures::jpeg_starts },
    Target { name: "tiff", run: pictures::tiff, starts: pictures::tiff_starts },
    Target { name: "npy", run: pictures::npy, starts: pictures::npy_starts },
    Target { name: "npz", run: tables::npz, starts: tables::npz_starts },
    Target { name: "tables", run: tables::tables, starts: tables::starts },
    Target { name: "dng", run: raw::dng, starts: raw::starts },
    Target { name: "onnx", run: models::onnx, starts: models::starts },
    Target { name: "kit", run: kits::kit, starts: kits::starts },
    Target { name: "task", run: runs::task, starts: runs::task_starts },
    Target { name: "run", run: runs::run, starts: runs::run_starts },
    Target { name: "weights", run: runs::weights, starts: runs::weights_starts },
    Target { name: "request", run: requests::request, starts: requests::starts },
];

/// A refusal is one line with the exit code of bad input; of bad input it says what was found and what is allowed.
fn refused(error: &Error) {
    let text = error.to_string();
    assert!(!text.contains('\n') && error.exit_code() == 2, "{text:?}, exit code {}", error.exit_code());
    let empty = error.bad_input().is_some_and(|bad| bad.found.is_empty() || bad.allowed.is_empty());
    assert!(!empty, "{text:?} lacks a value, or what is allowed");
}

/// What was read of `file`; a refusal is looked at, and names that file.
fn read<T>(file: &str, result: Result<T>) -> Option<T> {
    let named =
        |error: &Error| error.bad_input().is_none_or(|bad| bad.file.contains(file)) && error.to_string().contains(file);
    result.inspect_err(refused).inspect_err(|error| assert!(named(error), "not of {file}: {error}")).ok()
}

/// What was made of something that is no file.
fn made<T>(result: Result<T>) -> Option<T> {
    result.inspect_err(refused).ok()
}

/// What must be read, since this program wrote it.
#[track_caller]
fn again<T>(result: Result<T>, written: &str) -> T {
    result.unwrap_or_else(|e| panic!("what was written is refused: {e}\n{written}"))
}

/// A folder of one thread, gone with it.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        let thread = format!("{:?}", std::thread::current().id());
        let number: String = thread.chars().filter(char::is_ascii_digit).collect();
        let folder = std::env::temp_dir().join(format!("isoplanat-fuzz-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        Self(folder)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

thread_local! {
    static FOLDER: Folder = Folder::new();
}

/// A place in a folder of this thread's own.
fn place(name: &str) -> PathBuf {
    FOLDER.with(|folder| folder.0.join(name))
}

/// A file with these bytes there.
fn file(name: &str, bytes: &[u8]) -> PathBuf {
    let path = place(name);
    std::fs::write(&path, bytes).expect("writes");
    path
}
