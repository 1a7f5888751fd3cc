//! The program `isoplanat-camera`: RAW captures in, pictures out, through a kit's network. [`main`] is all that its binary calls.

pub use isoplanat_program::tell;

mod arguments;
mod batch;
mod bench;
mod command;
mod output;
mod say;
mod show;
mod watch;

use std::process::ExitCode;

use crate::serve_child;
use arguments::Arguments;

/// Reads the command line and runs; the program's exit code.
pub fn main() -> ExitCode {
    if let Some(code) = serve_child() {
        return code;
    }
    isoplanat_program::signals::attend();
    let (arguments, _) = match isoplanat_program::command_line::asked::<Arguments>("isoplanat-camera: ") {
        Ok(both) => both,
        Err(code) => return ExitCode::from(code),
    };
    let code = isoplanat_program::guarded(|| command::run(&arguments)).unwrap_or_else(|text| {
        tell!("isoplanat-camera: internal error: {text}");
        1
    });
    if code == 0 && say::lost() {
        tell!("isoplanat-camera: standard output: what was to be printed could not be written");
        return ExitCode::FAILURE;
    }
    ExitCode::from(code)
}
