//! `isoplanat-camera`: RAW captures in, pictures out, through a kit's network.

mod batch;
mod bench;
mod command;
mod output;
mod show;
mod watch;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::process::ExitCode;
use std::sync::Mutex;

use clap::Parser;
use isoplanat::deploy::raw_process;

/// What a panic had to say; the hook keeps it off the screen so that one sentence can be made of it.
static PANIC: Mutex<String> = Mutex::new(String::new());

fn main() -> ExitCode {
    std::panic::set_hook(Box::new(|info| {
        if let Ok(mut text) = PANIC.lock() {
            *text = info.to_string().replace('\n', " ");
        }
    }));
    let mut arguments = std::env::args_os().skip(1);
    if let (Some(first), Some(path), None) = (arguments.next(), arguments.next(), arguments.next())
        && first == raw_process::COMMAND
    {
        return match raw_process::serve(Path::new(&path), &mut std::io::stdout().lock()) {
            Ok(()) => ExitCode::SUCCESS,
            Err(_) => ExitCode::FAILURE,
        };
    }
    let arguments = command::Arguments::parse();
    let code = catch_unwind(AssertUnwindSafe(|| command::run(&arguments))).unwrap_or_else(|_| {
        let text = PANIC.lock().map(|t| t.clone()).unwrap_or_default();
        eprintln!("isoplanat-camera: internal error: {text}");
        1
    });
    ExitCode::from(code)
}
