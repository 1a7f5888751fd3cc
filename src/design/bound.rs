//! What a checkpoint belongs to: the lens and the filters of its network, by SHA-256, among the facts of the checkpoint itself.
//!
//! A kill between two renames may leave the network of one checkpoint beside the lens of the one before. Whatever reads a run compares them and refuses;
//! `isoplanat design --resume` puts a design right.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use super::subject::Subject;
use super::task::train::NETWORK;
use isoplanat_base::atomic::{self, sha256_hex};
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::guide::{self, Facts, Guide, Inputs};
use isoplanat_network::Reconstructor;

/// Facts of a checkpoint.
const LENS: &str = "run.lens_sha256";
const FILTERS: &str = "run.filters_sha256";

/// How long a reader waits, each time, for a run under way that has written a checkpoint and not yet the files beside it, ms.
const PAUSES: [u64; 4] = [20, 100, 300, 1000];

/// Lens and filters of a checkpoint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Bound {
    lens: String,
    filters: Option<String>,
}

impl Bound {
    /// A lens and a file of filters, by their hashes.
    pub(super) fn new(lens: String, filters: Option<String>) -> Self {
        Self { lens, filters }
    }

    /// That of `subject`, and the file of what its network is told beside the capture, where it is told something of the lens.
    ///
    /// # Errors
    /// Filters that cannot be written.
    pub(super) fn of(subject: String, guide: &Guide) -> Result<(Self, Option<Vec<u8>>)> {
        let bytes = guide.facts().map(Facts::to_npz).transpose()?;
        Ok((Self { lens: subject, filters: bytes.as_deref().map(sha256_hex) }, bytes))
    }

    /// What a checkpoint says; nothing in those of versions before.
    fn said(facts: &BTreeMap<String, String>) -> Option<Self> {
        Some(Self { lens: facts.get(LENS)?.clone(), filters: facts.get(FILTERS).cloned() })
    }

    /// Adds itself to the facts of a checkpoint.
    pub(super) fn put(&self, facts: &mut BTreeMap<String, String>) {
        facts.insert(LENS.to_owned(), self.lens.clone());
        if let Some(filters) = &self.filters {
            facts.insert(FILTERS.to_owned(), filters.clone());
        }
    }

    /// Refuses a folder that holds it beside a checkpoint that says, among its `facts`, another lens or other filters; filters that were not read are not
    /// compared, and checkpoints of versions before say nothing.
    ///
    /// # Errors
    /// What does not belong together.
    pub(super) fn check(&self, folder: &Path, facts: &BTreeMap<String, String>) -> Result<()> {
        let Some(said) = Self::said(facts) else { return Ok(()) };
        let other = |file: &str| {
            let allowed =
                "as its checkpoint was written: --resume puts a design's right; another lens is a run of its own";
            let found = format!("{file} is not the one of network.safetensors");
            Err(Error::bad(folder.display().to_string(), "run", found, allowed))
        };
        if said.lens != self.lens {
            return other("lens.toml, or what was measured,");
        }
        match (&said.filters, &self.filters) {
            (Some(said), Some(found)) if said != found => other(guide::FILE),
            _ => Ok(()),
        }
    }

    /// What stands in a run's folder: its lens, and the bytes of its filters.
    ///
    /// # Errors
    /// A folder without a lens, files that cannot be read.
    pub(super) fn there(folder: &Path) -> Result<Self> {
        let path = folder.join(guide::FILE);
        let filters = if path.exists() { Some(atomic::read_bounded(&path, guide::LARGEST)?) } else { None };
        Ok(Self { lens: Subject::of_run(folder)?.sha256(), filters: filters.as_deref().map(sha256_hex) })
    }
}

/// What the network of a run's folder, trained for a lens on `frame`, is told beside the capture, and the hash of the file that says it.
///
/// # Errors
/// A folder without what the network needs, or with that of another frame.
pub(super) fn guide_of(folder: &Path, inputs: Inputs, frame: &Frame) -> Result<(Guide, Option<String>)> {
    let path = folder.join(guide::FILE);
    let (facts, sum) = if inputs.knows_lens() {
        let bytes = atomic::read_bounded(&path, guide::LARGEST)?;
        (Facts::from_npz(&bytes, &path)?, Some(sha256_hex(&bytes)))
    } else {
        (Facts::default(), None)
    };
    Ok((Guide::from_parts(inputs, frame, facts).map_err(|e| e.in_file(&path))?, sum))
}

/// What `read` finds once checkpoint and files beside it agree: the inner result says whether they do. A run under way writes them one after the other.
pub(super) fn agreed<T>(mut read: impl FnMut() -> Result<Result<T>>) -> Result<T> {
    for pause in PAUSES {
        if let Ok(found) = read()? {
            return Ok(found);
        }
        std::thread::sleep(Duration::from_millis(pause));
    }
    read()?
}

/// Refuses a run whose lens or filters are not those of its checkpoint; one that has no checkpoint yet has nothing to agree with.
///
/// # Errors
/// Files that cannot be read or do not agree.
pub(super) fn require_agreement(folder: &Path) -> Result<()> {
    let checkpoint = folder.join(NETWORK);
    if !checkpoint.is_file() {
        return Ok(());
    }
    agreed(|| {
        let facts = Reconstructor::facts_of(&checkpoint)?;
        Ok(Bound::there(folder)?.check(folder, &facts))
    })
}
