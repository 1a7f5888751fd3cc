//! `--glass`: catalogues beside the shipped one; `--strict`, `--configuration`: how lens files are read.

use std::path::PathBuf;
use std::sync::OnceLock;

use isoplanat::interchange::Reading;
use isoplanat::lens::catalogue::Glasses;
use isoplanat::{Error, Result};

static GLASSES: OnceLock<Glasses> = OnceLock::new();
static READING: OnceLock<Reading> = OnceLock::new();

/// Reads the catalogues and pages of this run of the program: those in the folder that `ISOPLANAT_GLASSES` names, then `files`; `instead` has
/// pairs `NAME=GLASS`.
///
/// # Errors
/// A file that cannot be read or is no catalogue.
pub(crate) fn set(files: &[PathBuf], instead: &[String]) -> Result<()> {
    let configured = std::env::var_os("ISOPLANAT_GLASSES").filter(|f| !f.is_empty()).map(PathBuf::from);
    if configured.is_none() && files.is_empty() && instead.is_empty() {
        return Ok(());
    }
    let mut all = Glasses::shipped().clone();
    for path in configured.iter().chain(files) {
        all.add(path)?;
    }
    for pair in instead {
        let bad = |found: String, allowed: &str| Error::bad("--glass-for", "value", found, allowed);
        let Some((name, glass)) = pair.split_once('=').filter(|(n, g)| !n.is_empty() && !g.is_empty()) else {
            return Err(bad(format!("`{pair}`"), "NAME=GLASS, such as SSK4=SSK4A or SSK4=1.6177,55.1"));
        };
        all.take_instead(name, glass).map_err(|e| e.at("value").of_file("--glass-for"))?;
    }
    // The first value stays: the program sets it once.
    let _ = GLASSES.set(all);
    Ok(())
}

/// Whether this run takes glasses in the place of others.
#[cfg(feature = "train")]
pub(crate) fn are_replaced() -> bool {
    all().are_replaced()
}

/// Refuses a `--glass-for` whose name no lens had that was read so far: it would change nothing.
///
/// # Errors
/// There is one.
pub(crate) fn all_taken() -> Result<()> {
    all().all_taken().map_err(|e| e.of_file("--glass-for"))
}

/// The glasses of this run.
pub(crate) fn all() -> &'static Glasses {
    GLASSES.get().unwrap_or_else(|| Glasses::shipped())
}

/// Sets how this run of the program reads lens files.
pub(crate) fn set_reading(reading: Reading) {
    let _ = READING.set(reading);
}

/// How this run reads lens files.
pub(crate) fn reading() -> Reading {
    READING.get().copied().unwrap_or_default()
}
