//! Threads of the two programs: where the system lets no more be started that is one line, and no panic.

use std::error::Error as _;
use std::io;
use std::thread::Builder;

use crate::error::{Error, Result};

/// Starts the threads that share work: so many, or with 0 as many as the machine has processors (`RAYON_NUM_THREADS` where it is set). At a program's beginning:
/// whoever first shares work starts them otherwise, and panics where that fails. Where they are there already, nothing.
///
/// # Errors
/// A system that lets none be started.
pub fn start_pool(threads: usize) -> Result<()> {
    match rayon::ThreadPoolBuilder::new().num_threads(threads).build_global() {
        // Only the system's refusal has a source: there is one pool already otherwise.
        Err(error) => error.source().map_or(Ok(()), |reason| Err(refused(reason))),
        Ok(()) => Ok(()),
    }
}

/// Does `work` on a thread of its own.
///
/// # Errors
/// A system that lets none be started.
pub fn start(work: impl FnOnce() + Send + 'static) -> Result<()> {
    Builder::new().spawn(work).map(drop).map_err(|reason: io::Error| refused(&reason))
}

/// A thread that could not be started, for `reason`.
pub fn refused(reason: &dyn std::fmt::Display) -> Error {
    let allowed = "a system that lets a user have more of them, and more memory (`ulimit -u`, `ulimit -v`)";
    Error::bad("this process", "threads", format!("one could not be started ({reason})"), allowed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_start_and_a_pool_that_is_there_stays() {
        assert!(start_pool(0).is_ok() && start_pool(1).is_ok());
        let (say, said) = std::sync::mpsc::channel();
        start(move || say.send(7).expect("heard")).expect("starts");
        assert_eq!(said.recv(), Ok(7));
        let error = refused(&io::Error::from_raw_os_error(11));
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().starts_with("this process: threads: one could not be started ("), "{error}");
    }
}
