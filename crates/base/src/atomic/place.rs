//! What stands at an output's place: links are followed, devices and pipes are told apart, two names of one place are seen.

use std::fs::{self, Metadata};
use std::io::{self, ErrorKind};
use std::path::{Component, Path, PathBuf};

use super::entries;
use crate::error::{Error, Result};

/// Links that are followed one after the other, as Linux does.
const LINKS: usize = 40;

/// A place, its path absolute and without links.
pub(super) enum Destination {
    /// Nothing stands there.
    Free(PathBuf),
    /// A file.
    File(PathBuf, Metadata),
    /// A folder.
    Folder(PathBuf),
    /// A device, a pipe, or a file that is open as one of a process's descriptors (`/dev/stdout`): written into, never replaced. Its path
    /// is the given one, or the descriptor's.
    Stream(PathBuf),
}

/// What stands at `path`.
///
/// # Errors
/// An empty path; links in a circle; a name that is too long; a place that cannot be looked at.
pub(super) fn of(path: &Path) -> Result<Destination> {
    if path.as_os_str().is_empty() {
        return Err(Error::bad("", "output", "an empty name", "a file's or a folder's name"));
    }
    let failed = |e| Error::writing(path, e);
    if let Some(descriptor) = descriptor(path) {
        return Ok(Destination::Stream(descriptor));
    }
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => Ok(Destination::Folder(fs::canonicalize(path).map_err(failed)?)),
        Ok(found) if found.is_file() => Ok(Destination::File(fs::canonicalize(path).map_err(failed)?, found)),
        Ok(_) => Ok(Destination::Stream(path.to_owned())),
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(Destination::Free(absolute(path, LINKS).map_err(failed)?)),
        Err(e) => Err(failed(e)),
    }
}

/// `path` absolute and without links, whatever of it is there.
///
/// # Errors
/// As [`of`].
pub(super) fn resolved(path: &Path) -> Result<PathBuf> {
    Ok(match of(path)? {
        Destination::Free(path)
        | Destination::File(path, _)
        | Destination::Folder(path)
        | Destination::Stream(path) => path,
    })
}

/// Whether all paths, of files and folders, are different places, none inside of another: `.`, `..` and links count as what they lead to, of what is not there yet the
/// folders around it.
///
/// Devices and pipes may be named twice: nothing is replaced there.
///
/// # Errors
/// A place named twice; one inside of another, which would be replaced with all that is in it; a path that cannot be looked at.
pub fn distinct(paths: &[&Path]) -> Result<()> {
    let mut seen: Vec<(&Path, PathBuf)> = Vec::new();
    for path in paths {
        if matches!(of(path)?, Destination::Stream(_)) {
            continue;
        }
        let mut place = resolved(path)?;
        if cfg!(any(windows, target_vendor = "apple")) {
            // Their file systems do not tell capitals apart.
            place = place.to_string_lossy().to_lowercase().into();
        }
        let refused =
            |path: &Path, found: String, allowed| Err(Error::bad(path.display().to_string(), "output", found, allowed));
        let inside = |path: &Path, outer: &Path| {
            refused(path, format!("lies in {}, another output", outer.display()), "a place outside of it")
        };
        for (other, taken) in &seen {
            if *taken == place {
                return refused(path, "named for two outputs".to_owned(), "a name of its own for each");
            }
            if place.starts_with(taken) {
                return inside(path, other);
            }
            if taken.starts_with(&place) {
                return inside(other, path);
            }
        }
        seen.push((path, place));
    }
    Ok(())
}

/// Whether a file or folder that takes the place of `output` leaves alone what is read from `inputs`: files, folders, and names of other things.
///
/// Devices and pipes are written into, and links count as what they lead to. A file that is put into a folder of the inputs is none of them, unless it takes the
/// place of one that was published with that folder.
///
/// # Errors
/// An output that is an input, or holds one, or is one of an input's own files.
pub fn spares(output: &Path, inputs: &[&Path]) -> Result<()> {
    // What cannot be looked at is told where it is written.
    let place = match of(output) {
        Ok(Destination::Free(place) | Destination::File(place, _) | Destination::Folder(place)) => place,
        Ok(Destination::Stream(_)) | Err(_) => return Ok(()),
    };
    for input in inputs {
        // A name that is no file's is of something else.
        let Ok(read) = fs::canonicalize(input) else { continue };
        let shown = input.display();
        let found = if place == read {
            "is read by the same command, and would be overwritten".to_owned()
        } else if read.starts_with(&place) {
            format!("holds {shown}, which is read by the same command")
        } else if entries::published(&read, &place)? {
            format!("is a file of {shown}, which is read by the same command")
        } else {
            continue;
        };
        return Err(Error::bad(output.display().to_string(), "output", found, "another name"));
    }
    Ok(())
}

/// Whether `output` lies outside of a `folder` that is read and keeps its own files only.
///
/// # Errors
/// An output in it; a path that cannot be looked at.
pub fn outside(output: &Path, folder: &Path) -> Result<()> {
    match fs::canonicalize(folder) {
        Ok(read) if resolved(output)?.starts_with(&read) => {
            let found = format!("lies in {}, which is read by the same command", folder.display());
            Err(Error::bad(output.display().to_string(), "output", found, "a place outside of it"))
        }
        _ => Ok(()),
    }
}

/// `path` absolute and without links, where nothing or a dangling link stands at its end.
fn absolute(path: &Path, links: usize) -> io::Result<PathBuf> {
    let mut at = if path.is_absolute() { PathBuf::new() } else { fs::canonicalize(std::env::current_dir()?)? };
    for component in path.components() {
        match component {
            Component::CurDir => {}
            Component::ParentDir => {
                at.pop();
            }
            Component::Prefix(_) | Component::RootDir => at.push(component),
            Component::Normal(name) => {
                at.push(name);
                if let Ok(leads_to) = fs::read_link(&at) {
                    let links = links.checked_sub(1).ok_or(ErrorKind::InvalidInput)?;
                    at.pop();
                    at = absolute(&at.join(leads_to), links)?;
                }
            }
        }
    }
    Ok(at)
}

/// The open descriptor that `path` leads to by links (`/dev/stdout`, `/dev/fd/3`).
pub(super) fn descriptor(path: &Path) -> Option<PathBuf> {
    if !cfg!(unix) {
        return None;
    }
    let mut at = path.to_owned();
    for _ in 0..LINKS {
        let leads_to = fs::read_link(&at).ok();
        let around = at.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let around = fs::canonicalize(around).ok()?;
        let of_process = around.starts_with("/proc") && around.ends_with("fd");
        if of_process || around == Path::new("/dev/fd") {
            return Some(around.join(at.file_name()?));
        }
        at = around.join(leads_to?);
    }
    None
}
