//! What the program says.

use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};

use isoplanat_base::error::Error;
use isoplanat_base::terminal::printable;

/// Says an error and returns its exit code.
pub(crate) fn complain(error: &Error) -> u8 {
    crate::program::tell!("isoplanat-camera: {error}");
    error.exit_code()
}

/// Whether something could not be printed.
static LOST: AtomicBool = AtomicBool::new(false);

/// Prints to standard output; a reader that has gone away is no error, anything else is told at the end ([`lost`]).
pub(crate) fn say(text: &str) {
    let printed = writeln!(std::io::stdout().lock(), "{}", printable(text));
    if printed.is_err_and(|e| e.kind() != ErrorKind::BrokenPipe) {
        LOST.store(true, Ordering::Relaxed);
    }
}

/// Whether something that was to be printed is lost.
pub(crate) fn lost() -> bool {
    LOST.load(Ordering::Relaxed)
}
