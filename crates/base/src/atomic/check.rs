//! Outputs are tested before the work begins: what would be refused after it is refused at once.

use std::io::ErrorKind;
use std::path::Path;

use super::entries::FolderKind;
use super::file::allowed;
use super::folder;
use super::place::Destination;
use super::temporary::Temporary;
use super::{Replace, sweep};
use crate::error::{Error, Result};

/// Whether [`publish_file`](super::publish_file) may put a file at `path`, tried out with a file beside it.
///
/// # Errors
/// [`Error::Exists`]; a folder in the file's place, none around it or one where nothing can be written, a name that is too long; a device
/// or pipe that may not be written to.
pub fn check_target(path: &Path, replace: Replace) -> Result<()> {
    let failed = |e| Error::writing(path, e);
    match allowed(path, replace)? {
        Destination::Stream(stream) => {
            #[cfg(unix)]
            rustix::fs::access(&stream, rustix::fs::Access::WRITE_OK).map_err(|e| failed(e.into()))?;
            let _ = stream;
            Ok(())
        }
        Destination::Free(target) | Destination::File(target, _) | Destination::Folder(target) => {
            sweep::sweep(&target);
            Temporary::beside(&target).map(drop).map_err(failed)
        }
    }
}

/// Whether [`write_folder`](super::write_folder) may put a folder at `folder`: nothing stands there or an empty one, or `replace` and one with `marker` in
/// it; where its list of entries is there, nothing else is in it.
///
/// # Errors
/// As [`check_kind`].
pub fn check_folder(folder: &Path, marker: &str, replace: bool) -> Result<()> {
    check_kind(folder, &FolderKind::listed(marker), replace.into())
}

/// Whether [`publish_folder`](super::publish_folder) may put a folder of this kind at `folder`, tried out with a file beside it.
///
/// # Errors
/// [`Error::Exists`]; entries that are not of this kind, named; a folder that cannot be moved away (a mount point); a place where nothing can
/// be written, a name that is too long.
pub fn check_kind(folder: &Path, kind: &FolderKind, replace: Replace) -> Result<()> {
    let target = folder::target(folder)?;
    folder::allowed(folder, &target, kind, replace)?;
    // Folders around it are made with it: the next one that is there has to take them and their names.
    let failed = |e| Error::writing(folder, e);
    if target.symlink_metadata().is_ok() {
        return folder::check_movable(folder, &target);
    }
    let missing: Vec<&Path> = target.ancestors().take_while(|p| p.parent().is_some() && !p.is_dir()).collect();
    let around = missing.last().copied().unwrap_or(&target);
    for name in missing.iter().filter_map(|p| p.file_name()) {
        match around.with_file_name(name).symlink_metadata() {
            Err(e) if e.kind() == ErrorKind::InvalidFilename => return Err(failed(e)),
            _ => {}
        }
    }
    Temporary::beside(around).map(drop).map_err(failed)
}
