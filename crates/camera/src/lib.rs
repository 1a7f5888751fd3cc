//! The camera side: RAW in, picture out. No training code, no gradients.

mod any_path;
pub mod child;
pub(crate) mod developed;
pub mod kit;
pub mod network_process;
pub(crate) mod onnxruntime;
pub mod orientation;
#[doc(hidden)]
pub mod program;
pub mod raw;
pub mod raw_process;
pub mod reconstruct;
pub mod session;
#[cfg(test)]
mod test_model;
pub mod tiles;
pub mod valid;

pub use isoplanat_base::refusing::Refusing;

use std::process::ExitCode;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What a program does that was started by itself (or by the caller of this library, as a [`child::Helper`]) to decode a file or to run a network: all of it is
/// done, and the program ends with this code. `None` where it was started for something else. The first thing in `main`.
///
/// Limits come first, before anything of others is read; a child that cannot be held to them says why and does nothing.
pub fn serve_child() -> Option<ExitCode> {
    let mut arguments = std::env::args_os().skip(1);
    let command = arguments.next().filter(|c| c == raw_process::COMMAND || c == network_process::COMMAND)?;
    let bounds = child::Bounds::parse(&arguments.next()?, &arguments.next()?)?;
    let held = bounds.hold();
    child::follow_parent();
    // The parent tells of a panic.
    std::panic::set_hook(Box::new(|_| {}));
    let mut out = std::io::stdout();
    let served = match (held, command == raw_process::COMMAND) {
        (Ok(held), true) => {
            child::standard_input().and_then(|file| raw_process::serve(file, &mut out, || child::enter(held)))
        }
        (Ok(held), false) => network_process::serve(&mut std::io::stdin().lock(), &mut out, || child::enter(held)),
        (Err(why), true) => raw_process::unheld(&mut out, why),
        (Err(why), false) => network_process::unheld(&mut out, why),
    };
    Some(if served.is_ok() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// What `mutex` holds, also after a panic of who held it: what panics here (a runtime, a writer) leaves nothing half done that is asked again.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
