//! `--glass`: catalogues beside the shipped one.

use std::path::PathBuf;
use std::sync::OnceLock;

use isoplanat::Result;
use isoplanat::lens::catalogue::Glasses;

static GLASSES: OnceLock<Glasses> = OnceLock::new();

/// Reads the catalogues and pages of this run of the program: those in the folder that `ISOPLANAT_GLASSES` names, then `files`.
///
/// # Errors
/// A file that cannot be read or is no catalogue.
pub(crate) fn set(files: &[PathBuf]) -> Result<()> {
    let configured = std::env::var_os("ISOPLANAT_GLASSES").filter(|f| !f.is_empty()).map(PathBuf::from);
    if configured.is_none() && files.is_empty() {
        return Ok(());
    }
    let mut all = Glasses::shipped().clone();
    for path in configured.iter().chain(files) {
        all.add(path)?;
    }
    // The first value stays: the program sets it once.
    let _ = GLASSES.set(all);
    Ok(())
}

/// The glasses of this run.
pub(crate) fn all() -> &'static Glasses {
    GLASSES.get().unwrap_or_else(|| Glasses::shipped())
}
