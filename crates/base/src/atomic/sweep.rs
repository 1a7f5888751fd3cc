//! What dead writers to a place have left is cleared; a folder that was on its way in several steps is taken up again.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use super::name::{self, Part};
use super::temporary::{Mark, removed};
use super::turn::Turn;
use super::{fault, place};
use crate::error::Result;

/// Takes up or clears what killed writers to `path`, or into the folder there, have left. Every writing and every check does so by itself beside its place; a run that goes
/// on may never write again what a kill left half done.
///
/// Only names of this module's form, and of those only what nobody holds a lock on. A folder that was being replaced in several steps is
/// put in its place, the new one or the old one.
///
/// # Errors
/// A path that cannot be looked at.
pub fn recover(path: &Path) -> Result<()> {
    let target = place::resolved(path)?;
    for target in [vec![target.clone()], unfinished_in(&target)].concat() {
        let _turn = Turn::beside(&target);
        sweep(&target);
    }
    Ok(())
}

/// What was on its way somewhere within `folder`, links not followed.
fn unfinished_in(folder: &Path) -> Vec<PathBuf> {
    let (mut found, mut walk) = (BTreeSet::new(), vec![folder.to_owned()]);
    while let Some(folder) = walk.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let name = entry.file_name();
            if let Some(target) = name::target(&name) {
                found.insert(folder.join(target));
            } else if entry.file_type().is_ok_and(|t| t.is_dir()) {
                walk.push(entry.path());
            }
        }
    }
    found.into_iter().collect()
}

/// [`recover`] for a path without links. What cannot be opened or removed stays: the writing itself tells of a folder that it may not use.
pub(super) fn sweep(target: &Path) {
    let (Some(folder), Some(file_name)) = (target.parent(), target.file_name()) else { return };
    let Ok(entries) = fs::read_dir(folder) else { return };
    let tag = name::tag(file_name);
    for entry in entries.flatten() {
        let found = entry.file_name();
        let Some((random, part)) = found.to_str().and_then(|n| name::parse(n, &tag)) else { continue };
        let at = |part| folder.join(name::join(&tag, random, part));
        // A folder is cleared by its lock; one without a lock is not known to be anybody's.
        if part == Part::Old || !entry.file_type().is_ok_and(|t| t.is_file()) {
            continue;
        }
        let Some(mut lock) = taken(&entry.path()) else { continue };
        let mut text = String::new();
        if part == Part::Lock {
            let _ = (&mut lock).take(64).read_to_string(&mut text);
            let (new, old) = (at(Part::Partial), at(Part::Old));
            taken_up(Mark::read(&text), &new, &old, target);
            if !(removed(&new) && removed(&old)) {
                let _ = lock.unlock();
                continue;
            }
        }
        let _ = fault::at("remove leftover").and_then(|()| fs::remove_file(entry.path()));
        let _ = lock.unlock();
    }
}

/// Puts a whole folder where a dead writer was about to: nothing stands there, or the empty folder by which it claimed the name.
fn taken_up(mark: Option<Mark>, new: &Path, old: &Path, target: &Path) {
    match mark {
        // The claim of a new result, which nobody has seen; not removed where something is in it.
        Some(Mark::New) if new.exists() => {
            let _ = fs::remove_dir(target);
        }
        Some(Mark::Replace) => {
            let free = fs::read_dir(target).map_or(!target.exists(), |mut entries| entries.next().is_none());
            if free && fs::rename(new, target).is_err() {
                let _ = fs::rename(old, target);
            }
        }
        _ => {}
    }
}

/// The file with its lock; `None`: its writer lives, or it cannot be known.
fn taken(path: &Path) -> Option<File> {
    let open = |write: bool| {
        let mut options = File::options();
        options.read(true).write(write);
        #[cfg(unix)]
        {
            use rustix::fs::OFlags;
            use std::os::unix::fs::OpenOptionsExt;
            // A link or a pipe that somebody puts there meanwhile is neither followed nor waited for.
            let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
            options.custom_flags(i32::try_from(flags.bits()).unwrap_or_default());
        }
        options.open(path)
    };
    // Some networks lock only what is open for writing; a leftover may have the mode of a file that nobody writes.
    let file = open(true).or_else(|_| open(false)).ok()?;
    (file.metadata().ok()?.is_file() && file.try_lock().is_ok()).then_some(file)
}
