//! A run's folder: its marker, its lock, what a kill leaves in it.

use std::fs::{self, File, TryLockError};
use std::path::Path;

use isoplanat_base::atomic::{self, FolderKind};
use isoplanat_base::error::{Error, Result};

/// The file that makes a folder a run.
pub const MARKER: &str = "task.toml";

/// The lens that what moves and is held counts from: as the task names it, its sensor moved where the task asks for that.
pub const START: &str = "lens-start.toml";

/// SHA-256 of the list of what it is trained on, in hexadecimal.
pub(super) const SCENES: &str = "scenes.sha256";

/// What a run's folder holds, or comes to hold.
const KIND: FolderKind<'static> = FolderKind::new(
    MARKER,
    &[
        "*.part",
        ".*.partial",
        "best.safetensors",
        "cache/**",
        "design.state",
        "filters.npz",
        "history.jsonl",
        "lens/**",
        "lens*.toml",
        "lenses/**",
        "lock",
        "log.csv",
        "network.safetensors",
        "report.html",
        "samples/**",
        SCENES,
        "stages/**",
        "tolerances*",
    ],
);

/// Whether a run may be put at `folder`: nothing stands there, or with `replace` another run in which nobody works.
///
/// # Errors
/// [`Error::Exists`]; a run in which another process works.
pub fn check(folder: &Path, replace: bool) -> Result<()> {
    atomic::check_kind(folder, &KIND, replace.into())?;
    if folder.exists() {
        lock(folder)?;
    }
    Ok(())
}

/// Makes a run's folder by `fill`, with `replace` in place of another run, and takes its lock.
///
/// # Errors
/// What `fill` and the disk say; a run to give way to in which another process works.
pub(super) fn made(folder: &Path, replace: bool, fill: impl FnOnce(&Path) -> Result<()>) -> Result<File> {
    // The run that gives way must not be worked on elsewhere; its lock goes with it.
    let _old = if folder.exists() { Some(lock(folder)?) } else { None };
    atomic::publish_folder(folder, &KIND, replace.into(), fill)?;
    lock(folder)
}

/// Takes a run's lock: one process a folder. What a writer that was killed as it put the run there has left beside it is cleared: a run that goes on
/// writes inside alone.
pub(super) fn lock(folder: &Path) -> Result<File> {
    let path = folder.join("lock");
    let file = File::create(&path).map_err(|e| Error::writing(&path, e))?;
    match file.try_lock() {
        Ok(()) => atomic::recover(folder).map(|()| file),
        Err(TryLockError::WouldBlock) => {
            let allowed = "one run a folder; wait for the other or end it";
            Err(Error::bad(folder.display().to_string(), "lock", "another process works here", allowed))
        }
        Err(TryLockError::Error(e)) => Err(Error::writing(&path, e)),
    }
}

/// What the run in `folder` is trained on, by [`SCENES`]; none of a version before.
///
/// # Errors
/// A file that cannot be read or holds no hash.
pub(super) fn scenes_of(folder: &Path) -> Result<Option<String>> {
    let path = folder.join(SCENES);
    if !path.exists() {
        return Ok(None);
    }
    let text = atomic::read_text(&path, 1 << 10)?;
    let hash = text.trim();
    if hash.len() != 64 || !hash.bytes().all(|b| b.is_ascii_hexdigit()) {
        let found = format!("{} characters", hash.len());
        return Err(Error::bad(
            path.display().to_string(),
            "hash",
            found,
            "64 hexadecimal digits, as the run wrote them",
        ));
    }
    Ok(Some(hash.to_owned()))
}

/// Refuses to go on with a run on other pictures than it began with.
///
/// # Errors
/// A file that cannot be read or holds no hash; other pictures.
pub fn same_scenes(folder: &Path, now: &str) -> Result<()> {
    match scenes_of(folder)? {
        Some(then) if then != now => {
            let allowed = "the pictures that it began with: a run is what it was trained on; a new run for others";
            Err(Error::bad(
                folder.display().to_string(),
                SCENES,
                "the names of the task's pictures have changed",
                allowed,
            ))
        }
        _ => Ok(()),
    }
}

/// Removes what a kill in the middle of a writing has left; the folder is locked.
pub(super) fn sweep(folder: &Path) -> Result<()> {
    let failed = |e| Error::reading(folder, e);
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.extension().is_some_and(|e| e == "part" || e == "partial") && path.is_file() {
            fs::remove_file(&path).map_err(|e| Error::writing(&path, e))?;
        }
    }
    Ok(())
}
