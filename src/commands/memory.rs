//! `--memory-gib`: what every command may take.

use std::sync::OnceLock;

use isoplanat::Result;
use isoplanat::math::memory::Limit;
#[cfg(feature = "train")]
use isoplanat::math::memory::words;

static LIMIT: OnceLock<Limit> = OnceLock::new();

/// Sets the limit for this run of the program, which the system then holds too; by default what the system leaves ([`Limit::of_process`]).
pub(crate) fn set(gib: Option<f64>) -> Result<()> {
    let limit = gib.map_or_else(|| Ok(Limit::of_process()), Limit::gib)?;
    if gib.is_some() {
        limit.hold();
    }
    // The first value stays: the program sets it once.
    let _ = LIMIT.set(limit);
    Ok(())
}

/// The limit of this run.
pub(crate) fn limit() -> Limit {
    *LIMIT.get_or_init(Limit::of_process)
}

/// Says how many bytes are taken at most, once nothing can be refused any more.
#[cfg(feature = "train")]
pub(crate) fn tell(bytes: u64) {
    crate::aside!("memory: at most {}", words(bytes));
}
