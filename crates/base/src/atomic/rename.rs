//! Moves of one step, and the steps that stand for them on file systems without; what is written reaches the disk.

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::path::Path;

use rayon::iter::{IntoParallelRefIterator, ParallelIterator};

use super::{fault, notice};

/// Moves to a name that is free, in one step.
///
/// # Errors
/// [`ErrorKind::AlreadyExists`]; [`ErrorKind::Unsupported`] where the system or the file system has no such move.
pub(super) fn exclusive(from: &Path, to: &Path) -> io::Result<()> {
    fault::at("rename to a free name").and_then(|()| step(from, to, false)).map_err(unsupported)
}

/// Exchanges two names, in one step.
///
/// # Errors
/// [`ErrorKind::NotFound`]; [`ErrorKind::Unsupported`] as in [`exclusive`].
pub(super) fn exchange(one: &Path, other: &Path) -> io::Result<()> {
    fault::at("exchange").and_then(|()| step(one, other, true)).map_err(unsupported)
}

/// Moves, whatever stands there.
pub(super) fn over(from: &Path, to: &Path) -> io::Result<()> {
    fault::at("rename")?;
    fs::rename(from, to)
}

/// [`exclusive`] for a file; where there is no such move by a second name and the removal of the first.
///
/// # Errors
/// [`ErrorKind::AlreadyExists`]; what the disk says.
pub(super) fn exclusive_file(from: &Path, to: &Path) -> io::Result<()> {
    match exclusive(from, to) {
        Err(e) if e.kind() == ErrorKind::Unsupported => {}
        other => return other,
    }
    match fault::at("link").and_then(|()| fs::hard_link(from, to)) {
        Ok(()) => {
            notice::tell("this file system cannot rename without replacing: files get their names by link and unlink")
        }
        // A network that repeats a request refuses what it has done already.
        Err(e) if e.kind() == ErrorKind::AlreadyExists && same(from, to) => {}
        Err(e) if e.kind() == ErrorKind::AlreadyExists => return Err(e),
        Err(e) => {
            let e = unsupported(e);
            let without = [ErrorKind::Unsupported, ErrorKind::PermissionDenied, ErrorKind::TooManyLinks];
            return if without.contains(&e.kind()) { claimed(from, to) } else { Err(e) };
        }
    }
    // The new file is there; a second name that stays is swept as a leftover.
    let _ = fault::at("unlink").and_then(|()| fs::remove_file(from));
    Ok(())
}

/// [`exclusive_file`] where there are no second names (FAT): an empty file claims the name and is replaced.
fn claimed(from: &Path, to: &Path) -> io::Result<()> {
    notice::tell("this file system can neither rename without replacing nor link: a kill may leave an empty file");
    fault::at("claim")?;
    File::create_new(to)?;
    over(from, to).inspect_err(|_| {
        let _ = fs::remove_file(to);
    })
}

/// Whether two names are one file's.
#[cfg(unix)]
fn same(one: &Path, other: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let which = |path| fs::symlink_metadata(path).ok().map(|m| (m.dev(), m.ino()));
    which(one).is_some_and(|w| Some(w) == which(other))
}

#[cfg(not(unix))]
fn same(_: &Path, _: &Path) -> bool {
    false
}

#[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple"))]
fn step(from: &Path, to: &Path, exchange: bool) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    let how = if exchange { RenameFlags::EXCHANGE } else { RenameFlags::NOREPLACE };
    Ok(renameat_with(CWD, from, CWD, to, how)?)
}

#[cfg(not(any(target_os = "linux", target_os = "android", target_vendor = "apple")))]
fn step(_: &Path, _: &Path, _: bool) -> io::Result<()> {
    Err(ErrorKind::Unsupported.into())
}

/// The error with one kind for all that file systems answer to a call they do not have.
fn unsupported(error: io::Error) -> io::Error {
    #[cfg(unix)]
    {
        use rustix::io::Errno;
        let answers = [Errno::INVAL, Errno::NOSYS, Errno::OPNOTSUPP, Errno::NOTSUP].map(Errno::raw_os_error);
        if error.raw_os_error().is_some_and(|code| answers.contains(&code)) {
            return io::Error::new(ErrorKind::Unsupported, error);
        }
    }
    error
}

/// Brings a folder's names to the disk.
///
/// # Errors
/// What the disk says; nothing where folders cannot be synced or this one not be opened.
pub(super) fn sync_folder(folder: &Path) -> io::Result<()> {
    fault::at("sync folder")?;
    if !cfg!(unix) {
        return Ok(());
    }
    let Ok(opened) = File::open(folder) else { return Ok(()) };
    match opened.sync_all().map_err(unsupported) {
        Err(e) if e.kind() != ErrorKind::Unsupported => Err(e),
        _ => Ok(()),
    }
}

/// Brings files and then folders, the deepest first, to the disk; several at a time, so that a journal takes them together.
pub(super) fn sync_all(files: &[impl AsRef<Path> + Sync], folders: &[impl AsRef<Path>]) -> io::Result<()> {
    fault::at("sync files")?;
    files.par_iter().try_for_each(|file| File::open(file)?.sync_all())?;
    folders.iter().rev().try_for_each(|folder| sync_folder(folder.as_ref()))
}
