//! Tolerances in a task: the name of a file, or the file's own keys, so that a run's folder needs no other file.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Location, Result};
use isoplanat_optics::analysis::fabrication::tolerances::Tolerances;

/// Largest file that is read.
const LARGEST: u64 = 1 << 20;
/// The key of a task that they stand under.
const PLACE: &str = "tolerances";

/// A file, or its keys.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "tolerances: the name of a file, or a table of its keys")]
pub enum Stated {
    /// A file, as for `isoplanat tolerance`.
    File(PathBuf),
    /// Its keys.
    Keys(toml::Table),
}

/// An error of keys that stand in a task, which names the file; lines are those of no file.
fn within(error: Error) -> Error {
    error.with_place(|place| Location { line: None, ..place }.within(PLACE))
}

impl Stated {
    /// The keys of the file at `path`.
    ///
    /// # Errors
    /// A file that cannot be read, or is none.
    pub fn read(path: &Path) -> Result<Self> {
        let text = atomic::read_text(path, LARGEST)?;
        let file = path.display().to_string();
        Tolerances::parse(&text, &file)?;
        isoplanat_base::exact::from_toml(&text)
            .map(Self::Keys)
            .map_err(|e| Error::toml(&file, &text, &e, "the keys of models/README.md"))
    }

    /// What they say.
    ///
    /// # Errors
    /// Keys that are none, values that are not allowed; a file that was not read.
    pub fn tolerances(&self) -> Result<Tolerances> {
        match self {
            Self::File(path) => Tolerances::load(path),
            Self::Keys(keys) => {
                let text = toml::to_string(keys).map_err(|e| Error::Internal(format!("tolerances: {e}")))?;
                Tolerances::parse(&text, "").map_err(within)
            }
        }
    }
}
