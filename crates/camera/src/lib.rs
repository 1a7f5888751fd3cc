//! The camera side: RAW in, picture out. No training code, no gradients.

pub mod child;
pub mod developed;
pub mod kit;
pub mod network_process;
pub mod onnxruntime;
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

/// What a program does that was started by itself to decode a file or to run a network: all of it is done, and the program ends with this code. `None` where
/// it was started by somebody else. The first thing in `main`.
pub fn serve_child() -> Option<ExitCode> {
    let mut arguments = std::env::args_os().skip(1);
    let first = arguments.next()?;
    let serve: Box<dyn FnOnce() -> std::io::Result<()>> = match (arguments.next(), arguments.next()) {
        (Some(path), None) if first == raw_process::COMMAND => {
            Box::new(move || raw_process::serve(std::path::Path::new(&path), &mut std::io::stdout().lock()))
        }
        (None, None) if first == network_process::COMMAND => {
            Box::new(|| network_process::serve(&mut std::io::stdin().lock(), &mut std::io::stdout()))
        }
        _ => return None,
    };
    // The parent tells of a panic.
    std::panic::set_hook(Box::new(|_| {}));
    Some(if serve().is_ok() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// What `mutex` holds, also after a panic of who held it: what panics here (a runtime, a writer) leaves nothing half done that is asked again.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
