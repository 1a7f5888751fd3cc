//! The program `isoplanat-camera`: RAW captures in, pictures out, through a kit's network. [`main`] is all that its binary calls.

/// Says something on stderr; what would steer a terminal is escaped ([`isoplanat_base::terminal`]).
macro_rules! tell {
    // Where nobody can be told the work goes on.
    ($($words:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), "{}", isoplanat_base::terminal::printable(&format!($($words)*)));
    }};
}
pub(crate) use tell;

mod arguments;
mod batch;
mod bench;
mod command;
mod output;
mod say;
mod show;
mod watch;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::sync::Mutex;

use crate::serve_child;
use clap::Parser;

/// What a panic had to say; the hook keeps it off the screen so that one sentence can be made of it.
static PANIC: Mutex<String> = Mutex::new(String::new());

/// Reads the command line and runs; the program's exit code.
pub fn main() -> ExitCode {
    if let Some(code) = serve_child() {
        return code;
    }
    std::panic::set_hook(Box::new(|info| {
        if let Ok(mut text) = PANIC.lock() {
            *text = info.to_string().replace('\n', " ");
        }
    }));
    let arguments = arguments::Arguments::parse();
    let code = catch_unwind(AssertUnwindSafe(|| command::run(&arguments))).unwrap_or_else(|_| {
        let text = PANIC.lock().map(|t| t.clone()).unwrap_or_default();
        crate::program::tell!("isoplanat-camera: internal error: {text}");
        1
    });
    if code == 0 && say::lost() {
        tell!("isoplanat-camera: standard output: what was to be printed could not be written");
        return ExitCode::FAILURE;
    }
    ExitCode::from(code)
}
