//! What is promised of files and folders: whole or not at all, nothing replaced unasked, nothing left behind, nothing planted let in.

mod crowd;
mod files;
mod folders;
mod kills;

use std::cell::Cell;
use std::fs;
use std::io::{self, Write};
use std::path::Path;
use std::rc::Rc;

use rustix::io::Errno;

use super::{FolderKind, Replace, fault, publish_file, publish_folder, publish_path, write_bytes};
use crate::error::{Error, Result};

/// What a folder of the tests is known by.
const MARKER: &str = "mark";

/// The names in a folder, in order.
fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .expect("readable")
        .map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// Writes `text` to a file as the program does, with a fault in its middle.
fn put(path: &Path, replace: Replace, text: &str) -> Result<()> {
    publish_file(path, replace, |out| {
        let (begin, end) = text.as_bytes().split_at(text.len() / 2);
        let half = out.write_all(begin).and_then(|()| out.flush()).and_then(|()| fault::at("half"));
        half.and_then(|()| out.write_all(end)).map_err(|e| Error::writing(path, e))
    })
}

/// The same by a writer that opens its file itself.
fn put_path(path: &Path, replace: Replace, text: &str) -> Result<()> {
    publish_path(path, replace, |at| {
        fs::write(at, text).and_then(|()| fault::at("half")).map_err(|e| Error::writing(path, e))
    })
}

/// Writes a result of one of three forms: `file`, `path`, `folder`.
fn write(what: &str, path: &Path, replace: Replace, text: &str) -> Result<()> {
    match what {
        "file" => put(path, replace, text),
        "path" => put_path(path, replace, text),
        _ => put_folder(path, replace, text),
    }
}

/// The text of such a result, which is whole.
fn read(what: &str, path: &Path) -> String {
    match what {
        "file" | "path" => fs::read_to_string(path).expect("whole"),
        _ => text_of(path),
    }
}

/// Writes a folder of three files in two folders, all of which hold `text`.
fn put_folder(folder: &Path, replace: Replace, text: &str) -> Result<()> {
    publish_folder(folder, &FolderKind::listed(MARKER), replace, |inside| {
        fs::create_dir(inside.join("sub")).map_err(|e| Error::writing(inside, e))?;
        for name in [MARKER, "a", "sub/b"] {
            write_bytes(&inside.join(name), text.as_bytes())?;
        }
        Ok(())
    })
}

/// The text of a folder by [`put_folder`]; panics where it is not whole.
fn text_of(folder: &Path) -> String {
    let texts = [MARKER, "a", "sub/b"].map(|n| fs::read_to_string(folder.join(n)).expect("a whole folder"));
    assert!(texts.iter().all(|t| *t == texts[0]), "a mixture: {texts:?}");
    assert_eq!(names(folder), [super::MANIFEST, "a", MARKER, "sub"]);
    let [text, ..] = texts;
    text
}

/// The calling thread's faults, until it is dropped.
struct Faults;

impl Faults {
    /// The steps in `steps` answer `errno`, as a file system without them does.
    fn without(steps: &'static [&'static str], errno: Errno) -> Self {
        Self::set(move |step| steps.contains(&step).then(|| errno.into()))
    }

    /// The step number `at` fails with `errno`. How many steps there were.
    fn nth(at: usize, errno: Errno, without: &'static [&'static str]) -> (Self, Rc<Cell<usize>>) {
        let count = Rc::new(Cell::new(0));
        let counted = count.clone();
        let faults = Self::set(move |step| {
            if without.contains(&step) {
                return Some(Errno::NOSYS.into());
            }
            count.set(count.get() + 1);
            (count.get() == at).then(|| errno.into())
        });
        (faults, counted)
    }

    fn set(hook: impl Fn(&'static str) -> Option<io::Error> + 'static) -> Self {
        fault::set(Some(Rc::new(hook)));
        Self
    }
}

impl Drop for Faults {
    fn drop(&mut self) {
        fault::set(None);
    }
}

/// Steps that NFS does not have.
const NFS: &[&str] = &["rename to a free name", "exchange"];
/// Steps that FAT does not have on older systems.
const FAT: &[&str] = &["rename to a free name", "exchange", "link"];
