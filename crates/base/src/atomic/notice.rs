//! One word to the user where a file system cannot do what is asked of it in one step.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

static TELL: OnceLock<fn(&str)> = OnceLock::new();
static TOLD: AtomicBool = AtomicBool::new(false);

/// The function that hears, once a process, that a file system needs several steps where others need one; the first one named stays.
///
/// The library itself never prints; without this nobody hears of it.
pub fn tell_by(tell: fn(&str)) {
    let _ = TELL.set(tell);
}

/// Tells `note`, unless something has been told before.
pub(super) fn tell(note: &str) {
    if let Some(tell) = TELL.get()
        && !TOLD.swap(true, Ordering::Relaxed)
    {
        tell(note);
    }
}
