//! Those who replace folders beside one another take turns: what is looked through must not be exchanged meanwhile.

use std::fs::{File, TryLockError};
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// How long another's turn is waited for: the look through a folder and its move take milliseconds.
const LONGEST: Duration = Duration::from_secs(10);

/// A turn, until it is dropped: the lock of the folder around. Where there are no such locks (NFS), or somebody else keeps it, it is gone
/// on without: a folder may then be refused because it changes while it is looked through.
pub(super) struct Turn(Option<File>);

impl Turn {
    /// The turn of whoever replaces `target`.
    pub(super) fn beside(target: &Path) -> Self {
        let Some(around) = target.parent().and_then(|p| File::open(p).ok()) else { return Self(None) };
        let end = Instant::now() + LONGEST;
        loop {
            match around.try_lock() {
                Ok(()) => return Self(Some(around)),
                Err(TryLockError::WouldBlock) if Instant::now() < end => sleep(Duration::from_millis(1)),
                Err(_) => return Self(None),
            }
        }
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        if let Some(around) = &self.0 {
            let _ = around.unlock();
        }
    }
}
