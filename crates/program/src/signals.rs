//! What a user asks for while a program runs: its end, at the next step of work that listens, or at once.

use std::sync::atomic::{AtomicBool, Ordering};

/// Whether work looks for a request.
static LISTENED: AtomicBool = AtomicBool::new(false);
/// Whether somebody has asked for an end.
static ASKED: AtomicBool = AtomicBool::new(false);

/// Attends to signals from now on; at a program's beginning.
///
/// Ctrl-C, SIGTERM and SIGHUP end the program with 128 and the signal's number, and what it was writing is cleared away. Once work listens ([`asked`]) the first one
/// is a request to that work, and the second ends the program. A file that grows beyond what the system allows (SIGXFSZ) is an error of its writer.
/// Where the system lets no handler be set (no more files may be open, say) they do what they do to any program.
#[doc(hidden)]
pub fn attend() {
    let _ = attended();
}

/// From now on a first Ctrl-C does not end the program: the result says whether it was pressed.
#[doc(hidden)]
pub fn asked() -> impl Fn() -> bool + Copy {
    LISTENED.store(true, Ordering::SeqCst);
    || ASKED.load(Ordering::SeqCst)
}

/// What a signal of this number does.
fn seen(number: i32) {
    if LISTENED.load(Ordering::SeqCst) && !ASKED.swap(true, Ordering::SeqCst) {
        return;
    }
    isoplanat_base::atomic::abandon();
    end(128 + number);
}

#[cfg(unix)]
fn attended() -> std::io::Result<()> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
    use signal_hook::iterator::Signals;

    // Its handler does nothing, but with one the system no longer ends the program: the write fails.
    signal_hook::flag::register(SIGXFSZ, std::sync::Arc::default())?;
    let mut signals = Signals::new([SIGHUP, SIGINT, SIGTERM])?;
    std::thread::Builder::new().name("signals".into()).spawn(move || signals.forever().for_each(seen))?;
    Ok(())
}

/// Without what a program does at its end: its other threads are still at work.
#[cfg(unix)]
fn end(code: i32) -> ! {
    signal_hook::low_level::exit(code)
}

#[cfg(not(unix))]
fn attended() -> std::io::Result<()> {
    // Ctrl-C and what Windows counts as one.
    ctrlc::set_handler(|| seen(2)).map_err(std::io::Error::other)
}

#[cfg(not(unix))]
fn end(code: i32) -> ! {
    std::process::exit(code)
}
