//! Files and folders beside their place while they are written: made exclusively, known as living by a lock, removed when their writing ends.

use std::ffi::OsStr;
use std::fs::{self, File, TryLockError};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};

use super::living;
pub(super) use super::living::removed;
use super::name::{self, Part};
use super::{fault, rename};

/// Names that are tried before it is given up; one is enough unless somebody plants them.
const TRIES: usize = 32;

/// A file that is being written; it is removed with this value. Once it got its name there is nothing left to remove.
pub(super) struct Temporary {
    /// Open for reading and writing, and locked.
    pub(super) file: File,
    path: PathBuf,
}

impl Temporary {
    /// A new empty file beside `target`.
    pub(super) fn beside(target: &Path) -> io::Result<Self> {
        let tag = name::tag(target.file_name().unwrap_or(OsStr::new("output")));
        for _ in 0..TRIES {
            let path = target.with_file_name(name::join(&tag, &name::random(), Part::Partial));
            if let Some(file) = living::begun(&path, None, || made(&path))? {
                return Ok(Self { file, path });
            }
        }
        Err(ErrorKind::AlreadyExists.into())
    }

    /// Where it is.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// From here on it is on its way to its place: nobody takes it away.
    pub(super) fn settle(&self) {
        living::ended(&self.path);
    }

    /// Takes its name away where that may be done to an open file: nobody else reads it, and no kill leaves it.
    pub(super) fn hidden(&self) -> io::Result<()> {
        if cfg!(unix) { fs::remove_file(&self.path) } else { Ok(()) }
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        self.settle();
        let _ = fs::remove_file(&self.path);
        // A process that another thread is just starting holds the lock, too, until it becomes another program.
        let _ = self.file.unlock();
    }
}

/// How a folder of several steps gets to its place; it stands in the lock, for whoever finds it after a kill.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mark {
    /// To a free name.
    New,
    /// In place of an older one, which is set aside.
    Replace,
}

impl Mark {
    fn text(self) -> &'static str {
        match self {
            Self::New => "new\n",
            Self::Replace => "replace\n",
        }
    }

    /// The mark in a lock; `None`: no step has been taken.
    pub(super) fn read(text: &str) -> Option<Self> {
        [Self::New, Self::Replace].into_iter().find(|m| m.text() == text)
    }
}

/// A folder that is being written, and its lock beside it. What is under its name at the end (nothing, or what it replaced) is removed.
pub(super) struct TemporaryFolder {
    lock: File,
    lock_path: PathBuf,
    path: PathBuf,
    old: PathBuf,
    left: bool,
}

impl TemporaryFolder {
    /// A new empty folder beside `target`.
    pub(super) fn beside(target: &Path) -> io::Result<Self> {
        let tag = name::tag(target.file_name().unwrap_or(OsStr::new("output")));
        for _ in 0..TRIES {
            let random = name::random();
            let at = |part| target.with_file_name(name::join(&tag, &random, part));
            let [lock_path, path, old] = [Part::Lock, Part::Partial, Part::Old].map(at);
            let make = || {
                let Some(lock) = made(&lock_path)? else { return Ok(None) };
                let folder = if old.symlink_metadata().is_ok() {
                    Err(ErrorKind::AlreadyExists.into())
                } else {
                    fault::at("make folder").and_then(|()| fs::create_dir(&path))
                };
                match folder {
                    Ok(()) => Ok(Some(lock)),
                    Err(e) => {
                        let _ = fs::remove_file(&lock_path);
                        if e.kind() == ErrorKind::AlreadyExists { Ok(None) } else { Err(e) }
                    }
                }
            };
            if let Some(lock) = living::begun(&path, Some(&lock_path), make)? {
                return Ok(Self { lock, lock_path, path, old, left: false });
            }
        }
        Err(ErrorKind::AlreadyExists.into())
    }

    /// Where it is.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// As for a file.
    pub(super) fn settle(&self) {
        living::ended(&self.path);
    }

    /// The mode of a new file here: that of the lock.
    pub(super) fn mode(&self) -> io::Result<fs::Permissions> {
        self.lock.metadata().map(|found| found.permissions())
    }

    /// Where a folder is that gives way to it in several steps.
    pub(super) fn old(&self) -> &Path {
        &self.old
    }

    /// Puts down, on the disk, that what is written is whole and on its way.
    pub(super) fn mark(&mut self, mark: Mark) -> io::Result<()> {
        fault::at("mark")?;
        self.lock.write_all(mark.text().as_bytes())?;
        self.lock.sync_all()?;
        self.lock_path.parent().map_or(Ok(()), rename::sync_folder)
    }

    /// Leaves everything as it stands to the next writer's sweep: the old folder could not be put back.
    pub(super) fn leave(&mut self) {
        self.left = true;
    }

    /// Leaves the folder where it is, for nobody to remove: it holds what is not ours and could not be put back.
    pub(super) fn disown(&mut self) {
        self.left = true;
        let _ = fs::remove_file(&self.lock_path);
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        self.settle();
        if !self.left && removed(&self.path) && removed(&self.old) {
            let _ = fs::remove_file(&self.lock_path);
        }
        // As for a file.
        let _ = self.lock.unlock();
    }
}

/// Makes a file and takes its lock; `None`: the name is taken, or a sweep took it for a dead writer's.
fn made(path: &Path) -> io::Result<Option<File>> {
    fault::at("make")?;
    let file = match File::options().read(true).write(true).create_new(true).open(path) {
        Err(e) if e.kind() == ErrorKind::AlreadyExists => return Ok(None),
        other => other?,
    };
    let locked = fault::at("lock").and_then(|()| match file.try_lock() {
        Ok(()) => linked(&file),
        Err(TryLockError::WouldBlock) => Ok(false),
        // A file system without locks: nobody can take this for a dead writer's.
        Err(TryLockError::Error(_)) => Ok(true),
    });
    match locked {
        Ok(ours) => Ok(ours.then_some(file)),
        Err(e) => {
            let _ = fs::remove_file(path);
            Err(e)
        }
    }
}

/// Whether the file still has a name.
#[cfg(unix)]
fn linked(file: &File) -> io::Result<bool> {
    Ok(std::os::unix::fs::MetadataExt::nlink(&file.metadata()?) > 0)
}

#[cfg(not(unix))]
fn linked(_: &File) -> io::Result<bool> {
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What stands under a name is not opened, whatever it is: the name is given up.
    #[test]
    fn names_that_are_taken_are_left_alone() {
        let place = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| place.path().join(name);
        fs::write(at("file"), "theirs").expect("writes");
        fs::create_dir(at("folder")).expect("made");
        for name in ["file", "folder"] {
            assert!(made(&at(name)).expect("no error").is_none(), "{name}");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink("nowhere", at("link")).expect("linked");
            assert!(made(&at("link")).expect("no error").is_none());
        }
        assert_eq!(fs::read_to_string(at("file")).expect("there"), "theirs");
        let new = made(&at("new")).expect("made").expect("ours");
        assert!(matches!(File::open(at("new")).expect("opens").try_lock(), Err(TryLockError::WouldBlock)));
        drop(new);
    }
}
