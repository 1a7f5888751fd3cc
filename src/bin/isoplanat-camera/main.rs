//! `isoplanat-camera`: RAW captures in, pictures out, through a kit's network.

mod batch;
mod bench;
mod command;
mod output;
mod show;
mod watch;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::sync::Mutex;

use clap::Parser;
use isoplanat::deploy::serve_child;

/// What a panic had to say; the hook keeps it off the screen so that one sentence can be made of it.
static PANIC: Mutex<String> = Mutex::new(String::new());

fn main() -> ExitCode {
    if let Some(code) = serve_child() {
        return code;
    }
    std::panic::set_hook(Box::new(|info| {
        if let Ok(mut text) = PANIC.lock() {
            *text = info.to_string().replace('\n', " ");
        }
    }));
    let arguments = command::Arguments::parse();
    let code = catch_unwind(AssertUnwindSafe(|| command::run(&arguments))).unwrap_or_else(|_| {
        let text = PANIC.lock().map(|t| t.clone()).unwrap_or_default();
        eprintln!("isoplanat-camera: internal error: {text}");
        1
    });
    ExitCode::from(code)
}
