//! The program that becomes a child.

use std::path::{Path, PathBuf};

use isoplanat_base::error::{Error, Result};

/// A program whose `main` begins with [`crate::serve_child`]: `isoplanat`, `isoplanat-camera`, or one of the caller's own. It is started again to decode files and
/// to run networks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Helper {
    program: PathBuf,
}

impl Helper {
    /// The program at `path`, for callers that are no such program themselves (a library in Python, say).
    pub fn at(path: impl Into<PathBuf>) -> Self {
        Self { program: path.into() }
    }

    /// The running program; only for one whose `main` begins with [`crate::serve_child`].
    ///
    /// # Errors
    /// A system that does not tell where the program lies.
    pub fn current() -> Result<Self> {
        std::env::current_exe().map(Self::at).map_err(|e| Error::reading(Path::new("/proc/self/exe"), e))
    }

    /// Where it lies.
    pub fn program(&self) -> &Path {
        &self.program
    }
}
