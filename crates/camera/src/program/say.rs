//! What the program says.

use std::io::Write;

use isoplanat_base::error::Error;

/// Says an error and returns its exit code.
pub(crate) fn complain(error: &Error) -> u8 {
    eprintln!("isoplanat-camera: {error}");
    error.exit_code()
}

/// Prints to standard output; a reader that has gone away is no error.
pub(crate) fn say(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}
