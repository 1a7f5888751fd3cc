//! What this process is writing at the moment, so that a program that has to end at once leaves none of it.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::fault;

/// Temporaries that are not on their way to their places yet, each with its lock where that is another file.
static LIVING: Mutex<BTreeMap<PathBuf, Option<PathBuf>>> = Mutex::new(BTreeMap::new());

/// How often a folder is tried to be removed that others still write into.
const TRIES: usize = 16;

fn living() -> MutexGuard<'static, BTreeMap<PathBuf, Option<PathBuf>>> {
    LIVING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What `make` made at `path`, noted before an end can come between. Nothing where it made nothing.
///
/// # Errors
/// Those of `make`.
pub(super) fn begun<T>(
    path: &Path,
    lock: Option<&Path>,
    make: impl FnOnce() -> io::Result<Option<T>>,
) -> io::Result<Option<T>> {
    let mut living = living();
    let made = make()?;
    if made.is_some() {
        living.insert(path.to_owned(), lock.map(Path::to_owned));
    }
    Ok(made)
}

/// It is about to be moved to its place, or gone.
pub(super) fn ended(path: &Path) {
    living().remove(path);
}

/// Removes what this process is writing, for a program that ends now: from here on nothing that it writes gets to its place, and whoever tries waits for the end.
pub fn abandon() {
    let living = living();
    for (path, lock) in living.iter() {
        if (0..TRIES).any(|_| removed(path))
            && let Some(lock) = lock
        {
            let _ = fs::remove_file(lock);
        }
    }
    std::mem::forget(living);
}

/// Removes a file or a folder with all that is in it; links are not followed. Whether nothing is there any more.
pub(super) fn removed(path: &Path) -> bool {
    let gone = |e: io::Error| if e.kind() == ErrorKind::NotFound { Ok(()) } else { Err(e) };
    let done = fault::at("remove").and_then(|()| match path.symlink_metadata() {
        Ok(found) if found.is_dir() => fs::remove_dir_all(path),
        Ok(_) => fs::remove_file(path),
        Err(e) => Err(e),
    });
    done.or_else(gone).is_ok()
}
