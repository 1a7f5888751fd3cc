//! Folders that appear whole or not at all.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::entries::{self, FolderKind};
use super::place::{self, Destination};
use super::temporary::{Mark, TemporaryFolder, removed};
use super::turn::Turn;
use super::{Replace, fault, name, notice, rename, sweep};
use crate::error::{Error, Result};

/// Turns in which others may come between before it is given up.
const TURNS: usize = 16;

/// A folder that `fill` writes: [`publish_folder`] of the kind [`FolderKind::listed`].
///
/// With `replace` an existing folder that holds the file `marker` gives way, where it has a list and nothing else in it; any other never
/// does.
///
/// # Errors
/// As [`publish_folder`].
pub fn write_folder<T>(folder: &Path, marker: &str, replace: bool, fill: impl FnOnce(&Path) -> Result<T>) -> Result<T> {
    publish_folder(folder, &FolderKind::listed(marker), replace.into(), fill)
}

/// A folder that `fill` writes beside `folder` and that gets its name when that went well; otherwise everything is as it was. What `fill`
/// returned.
///
/// With [`Replace::Never`] one of several simultaneous writers succeeds; a folder without entries gives way. With [`Replace::Always`] a folder of the same kind gives way, in
/// one exchange; one with other entries never does. The list of what was published is put into it ([`MANIFEST`](super::MANIFEST)). Missing
/// folders around it are made. A link to a folder stays and leads to the new one. All is synced.
///
/// # Errors
/// [`Error::Exists`] before `fill` or after it; entries that are not of this kind, up to three of them named; `fill`'s; what the disk says.
pub fn publish_folder<T>(
    folder: &Path,
    kind: &FolderKind,
    replace: Replace,
    fill: impl FnOnce(&Path) -> Result<T>,
) -> Result<T> {
    let failed = |e| Error::writing(folder, e);
    let target = target(folder)?;
    allowed(folder, &target, kind, replace)?;
    let around = Around::made(&target).map_err(failed)?;
    let mut temporary = TemporaryFolder::beside(&target).map_err(failed)?;
    fault::at("fill").map_err(failed)?;
    let value = fill(temporary.path()).map_err(|e| named(e, temporary.path(), folder))?;
    let (files, folders) = entries::record(temporary.path())?;
    if !name::in_temporary(&target) {
        rename::sync_all(&files, &folders).map_err(failed)?;
    }
    let move_ = Move { folder, kind, replace, target: &target };
    {
        let _turn = Turn::beside(&target);
        temporary.settle();
        move_.go(&mut temporary)?;
    }
    around.keep();
    if !name::in_temporary(&target)
        && let Some(parent) = target.parent()
    {
        rename::sync_folder(parent).map_err(failed)?;
    }
    Ok(value)
}

/// Whether a folder of this kind may be put at `target`, which `folder` leads to, now that leftovers are gone.
///
/// # Errors
/// [`Error::Exists`]; entries that are not of this kind.
pub(super) fn allowed(folder: &Path, target: &Path, kind: &FolderKind, replace: Replace) -> Result<()> {
    let _turn = Turn::beside(target);
    sweep::sweep(target);
    kind.allows(folder, target, replace)
}

/// The error with places in the temporary folder named as they are to be.
fn named(error: Error, temporary: &Path, folder: &Path) -> Error {
    error.with_files(|path| path.strip_prefix(temporary).map(|rest| folder.join(rest)).unwrap_or(path))
}

/// Where a folder named `folder` is to stand, without links.
///
/// # Errors
/// A file, a device or the root there; a path that cannot be looked at.
pub(super) fn target(folder: &Path) -> Result<PathBuf> {
    match place::of(folder)? {
        Destination::Free(target) | Destination::Folder(target) if target.file_name().is_some() => Ok(target),
        found => {
            let found = match found {
                Destination::File(..) => "a file stands there",
                Destination::Stream(_) => "a device or a pipe stands there",
                Destination::Free(_) | Destination::Folder(_) => "the root of all folders",
            };
            Err(Error::bad(folder.display().to_string(), "output", found, "the name of a folder"))
        }
    }
}

/// A whole folder's way to its place.
struct Move<'a> {
    folder: &'a Path,
    kind: &'a FolderKind<'a>,
    replace: Replace,
    target: &'a Path,
}

impl Move<'_> {
    /// In one step; several where the file system has no such step.
    fn go(&self, temporary: &mut TemporaryFolder) -> Result<()> {
        for _ in 0..TURNS {
            match rename::exclusive(temporary.path(), self.target) {
                Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
                Err(e) if e.kind() == ErrorKind::Unsupported => return self.go_stepwise(temporary),
                other => return other.map_err(|e| self.failed(e)),
            }
            self.kind.allows(self.folder, self.target, self.replace)?;
            keep_mode(self.target, temporary.path());
            // An empty folder gives way to the move itself, which is refused where something is in it by then.
            if cfg!(unix) && entries::is_empty(self.target) {
                match rename::over(temporary.path(), self.target) {
                    Err(e) if is_taken(&e) => continue,
                    moved => return moved.map_err(|e| self.failed(e)),
                }
            }
            match rename::exchange(temporary.path(), self.target) {
                Ok(()) => {}
                // It has gone meanwhile.
                Err(e) if e.kind() == ErrorKind::NotFound => continue,
                Err(e) if e.kind() == ErrorKind::Unsupported => return self.go_stepwise(temporary),
                Err(e) => return Err(self.failed(e)),
            }
            // What gave way has a name now that nobody knows: whatever came into it until then is seen.
            let late = self.kind.allows(self.folder, temporary.path(), Replace::Always);
            if late.is_err() {
                rename::exchange(temporary.path(), self.target).map_err(|e| {
                    temporary.disown();
                    self.failed(e)
                })?;
            }
            return late;
        }
        Err(Error::Exists(self.folder.to_owned()))
    }

    /// By a claim of the name, or by setting the old folder aside; the mark in the lock tells the next writer what was under way.
    fn go_stepwise(&self, temporary: &mut TemporaryFolder) -> Result<()> {
        notice::tell("this file system cannot exchange folders in one step: a replaced folder is away for a moment");
        let failed = |e| self.failed(e);
        temporary.mark(if self.replace == Replace::Never { Mark::New } else { Mark::Replace }).map_err(failed)?;
        for _ in 0..TURNS {
            match claim(self.target) {
                Ok(made) => {
                    if !made {
                        keep_mode(self.target, temporary.path());
                    }
                    match rename::over(temporary.path(), self.target) {
                        Err(e) if is_taken(&e) => continue,
                        Err(e) if made => {
                            let _ = fs::remove_dir(self.target);
                            return Err(failed(e));
                        }
                        moved => return moved.map_err(failed),
                    }
                }
                Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
                Err(e) => return Err(failed(e)),
            }
            self.kind.allows(self.folder, self.target, self.replace)?;
            keep_mode(self.target, temporary.path());
            if !removed(temporary.old()) {
                return Err(failed(ErrorKind::DirectoryNotEmpty.into()));
            }
            match fault::at("set aside").and_then(|()| fs::rename(self.target, temporary.old())) {
                Err(e) if e.kind() == ErrorKind::NotFound => continue,
                other => other.map_err(failed)?,
            }
            match rename::over(temporary.path(), self.target) {
                Ok(()) => return Ok(()),
                Err(e) if is_taken(&e) => {}
                Err(e) => {
                    if fs::rename(temporary.old(), self.target).is_err() {
                        temporary.leave();
                    }
                    return Err(failed(e));
                }
            }
        }
        Err(Error::Exists(self.folder.to_owned()))
    }

    fn failed(&self, error: io::Error) -> Error {
        unmoved(self.folder, error)
    }
}

/// Whether the folder `target`, which `folder` leads to, could be moved away: a mount point or a folder of a lower layer (of a container's
/// image) could not. A folder never moves onto one that is not empty; what else the system says to that is the reason.
///
/// # Errors
/// That reason; a place where nothing can be written.
pub(super) fn check_movable(folder: &Path, target: &Path) -> Result<()> {
    let failed = |e| Error::writing(folder, e);
    // A whole folder takes the other's place, which is its parent's to give.
    let parent = target.parent().unwrap_or(target);
    let beside = |e: io::Error| {
        let text = format!("{e}, by the folder {} that it is in", parent.display());
        failed(io::Error::new(e.kind(), text))
    };
    let probe = TemporaryFolder::beside(target).map_err(beside)?;
    fs::write(probe.path().join("probe"), "").map_err(failed)?;
    if !cfg!(unix) {
        return Ok(());
    }
    match fault::at("probe").and_then(|()| fs::rename(target, probe.path())) {
        Err(e) if is_taken(&e) || e.kind() == ErrorKind::NotFound => Ok(()),
        Err(e) => Err(unmoved(folder, e)),
        // Against all rules.
        Ok(()) => fs::rename(probe.path(), target).map_err(failed),
    }
}

/// Why a folder could not be moved, in words where the system has only a number's name.
fn unmoved(folder: &Path, error: io::Error) -> Error {
    let why = match error.kind() {
        ErrorKind::CrossesDevices => {
            "the folder there cannot be moved (it is of a layer below, as in a container's image)"
        }
        ErrorKind::ResourceBusy => "the folder there cannot be moved (it is a mount point: a folder inside it can)",
        _ => return Error::writing(folder, error),
    };
    let text = format!("{why}; remove it or name another output");
    Error::writing(folder, io::Error::new(error.kind(), text))
}

/// Takes a free name by an empty folder, which the whole one replaces; one that is there already does as well. Whether it was made. Elsewhere than
/// on Unix a folder replaces none: there the move itself is the claim.
fn claim(target: &Path) -> io::Result<bool> {
    fault::at("claim folder")?;
    if cfg!(unix) {
        return match fs::create_dir(target) {
            Err(e) if e.kind() == ErrorKind::AlreadyExists && entries::is_empty(target) => Ok(false),
            made => made.map(|()| true),
        };
    }
    if target.symlink_metadata().is_ok() { Err(ErrorKind::AlreadyExists.into()) } else { Ok(false) }
}

/// Whether another writer was faster.
fn is_taken(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::AlreadyExists | ErrorKind::DirectoryNotEmpty)
}

/// Gives the new folder the mode of the old one, where that lets its owner work in it.
fn keep_mode(from: &Path, to: &Path) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = fs::metadata(from).map_or(0, |m| m.permissions().mode() & 0o777);
        if mode & 0o700 == 0o700 {
            let _ = fs::set_permissions(to, fs::Permissions::from_mode(mode));
        }
    }
    #[cfg(not(unix))]
    let _ = (from, to);
}

/// Folders around a target that were made for it; unless kept they go with this value.
struct Around(Vec<PathBuf>);

impl Around {
    fn made(target: &Path) -> io::Result<Self> {
        let missing: Vec<&Path> = target.ancestors().skip(1).take_while(|p| !p.is_dir()).collect();
        let mut made = Self(Vec::new());
        for folder in missing.into_iter().rev() {
            match fault::at("make around").and_then(|()| fs::create_dir(folder)) {
                Ok(()) => made.0.push(folder.to_owned()),
                Err(e) if e.kind() == ErrorKind::AlreadyExists && folder.is_dir() => {}
                Err(e) => return Err(e),
            }
        }
        Ok(made)
    }

    fn keep(mut self) {
        self.0.clear();
    }
}

impl Drop for Around {
    fn drop(&mut self) {
        for folder in self.0.iter().rev() {
            let _ = fs::remove_dir(folder);
        }
    }
}
