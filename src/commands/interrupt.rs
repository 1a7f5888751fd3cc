//! Ctrl-C as a request: work comes to an end at its next step and keeps what it has.

use std::sync::atomic::{AtomicBool, Ordering};

static ASKED: AtomicBool = AtomicBool::new(false);
/// Whether the handler is set: a program has one, however often its work asks.
static SET: AtomicBool = AtomicBool::new(false);

/// From now on Ctrl-C does not end the program: the result says whether it was pressed. A second one ends the program.
///
/// # Errors
/// A system that lets no handler be set.
pub(crate) fn asked() -> anyhow::Result<impl Fn() -> bool + Copy> {
    if !SET.swap(true, Ordering::Relaxed) {
        ctrlc::set_handler(|| {
            if ASKED.swap(true, Ordering::Relaxed) {
                std::process::exit(130);
            }
        })?;
    }
    Ok(|| ASKED.load(Ordering::Relaxed))
}
