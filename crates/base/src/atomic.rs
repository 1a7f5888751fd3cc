//! Files and folders that appear whole or not at all; files that are read whole, up to a size.
//!
//! What is published is first written beside its place, under a name that its writer alone has (`name`, `temporary`), and then moved there
//! in one step (`rename`): nothing is replaced unless that was asked for. A kill at any moment leaves the old or the new; what dead writers
//! have left is cleared when the next write to the same place begins (`sweep`). Links are followed, devices and pipes are written into
//! (`place`).
//!
//! A folder that gives way holds nothing but a result's own entries (`entries`); outputs are tested before the work begins (`check`).
//!
//! What is not promised: file systems that can neither move without replacing nor exchange (NFS, some of FUSE) show no folder for a moment
//! while one is replaced, which [`tell_by`] hears of; the next writer or [`recover`] puts it there after a kill in that moment. Those without
//! locks keep the leftovers of dead writers. After a loss of power counts what the disk says that it has synced.

mod check;
mod entries;
#[doc(hidden)]
pub(crate) mod fault;
mod file;
mod folder;
mod living;
mod name;
mod notice;
mod place;
mod read;
mod rename;
mod sweep;
mod temporary;
#[cfg(all(test, unix))]
mod tests;
mod turn;

pub use check::{check_folder, check_kind, check_target};
pub use entries::{FolderKind, MANIFEST};
pub use file::{publish_file, publish_path, write_atomic, write_bytes, write_cached};
pub use folder::{publish_folder, write_folder};
pub use living::abandon;
pub use notice::tell_by;
pub use place::{distinct, outside, spares};
pub use read::{as_text, of_schema, read_at_most, read_bounded, read_text, regular, sha256_hex, sha256_of};
pub use sweep::recover;

use std::path::Path;

/// Whether what stands at an output's place gives way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Replace {
    /// Nothing is replaced: [`Error::Exists`](crate::Error::Exists).
    Never,
    /// A file is replaced; a folder where it is one of the same kind with nothing else in it.
    Always,
}

/// A file to be: its path, and whether it takes the place of another. A path alone does: what belongs to a folder of one's own is written anew.
#[derive(Debug, Clone, Copy)]
pub struct Target<'a> {
    /// Where it is to be.
    pub path: &'a Path,
    /// Whether it takes the place of another.
    pub replace: Replace,
}

impl<'a> Target<'a> {
    /// A file that a user names, and whether he lets it take another's place.
    pub fn new(path: &'a (impl AsRef<Path> + ?Sized), replace: impl Into<Replace>) -> Self {
        Self { path: path.as_ref(), replace: replace.into() }
    }
}

impl<'a, P: AsRef<Path> + ?Sized> From<&'a P> for Target<'a> {
    fn from(path: &'a P) -> Self {
        Self { path: path.as_ref(), replace: Replace::Always }
    }
}

impl From<bool> for Replace {
    /// `--force`, as programs ask for it.
    fn from(force: bool) -> Self {
        if force { Self::Always } else { Self::Never }
    }
}
