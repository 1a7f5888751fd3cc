//! Work that somebody asks to end early: a token, and the look at it that long loops take.
//!
//! A [`Token`] is attached to the threads that work (those of one pool); [`Token::run`] starts the work, and [`look`] ends it where somebody has
//! called [`Token::ask`]: it unwinds to `run`, which returns [`Error::Interrupted`]. Loops whose steps take a millisecond or more look once a step.
//! Threads without a token never end early, so that whoever needs none pays one look at a thread's own variable.
//!
//! ```
//! use isoplanat_base::stop::{Token, look};
//!
//! let token = Token::default();
//! token.attach();
//! assert_eq!(token.run(|| { look(); 7 })?, 7);
//! token.ask();
//! assert!(token.run(|| { look(); 7 }).is_err());
//! Token::detach();
//! look();
//! # Ok::<(), isoplanat_base::Error>(())
//! ```

use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::error::{Error, Result};

/// Whether work is to end.
#[derive(Clone, Debug, Default)]
pub struct Token(Arc<AtomicBool>);

thread_local! {
    static OWN: RefCell<Option<Token>> = const { RefCell::new(None) };
}

/// What unwinds: no panic, so that no hook is told.
struct Ended;

impl Token {
    /// Asks the work to end.
    pub fn ask(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Takes that back, before other work.
    pub fn reset(&self) {
        self.0.store(false, Ordering::Relaxed);
    }

    /// Whether it was asked to end.
    pub fn asked(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Makes it the token that [`look`] sees on this thread.
    pub fn attach(&self) {
        OWN.with_borrow_mut(|own| *own = Some(self.clone()));
    }

    /// Takes this thread's token away.
    pub fn detach() {
        OWN.with_borrow_mut(|own| *own = None);
    }

    /// What `work` makes, on threads that this token is attached to.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where it was asked to end.
    ///
    /// # Panics
    /// As `work`.
    pub fn run<R>(&self, work: impl FnOnce() -> R) -> Result<R> {
        catch_unwind(AssertUnwindSafe(work))
            .map_err(|payload| if payload.is::<Ended>() { Error::Interrupted } else { resume_unwind(payload) })
    }
}

/// Ends this thread's work where its token was asked to.
#[inline]
pub fn look() {
    let asked = OWN.with_borrow(|own| own.as_ref().is_some_and(Token::asked));
    if asked {
        resume_unwind(Box::new(Ended));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Work on several threads ends wherever it is, and other work of the same pool goes on afterwards.
    #[test]
    fn work_on_a_pool_ends_where_it_is_asked_to() {
        use rayon::prelude::*;

        let token = Token::default();
        let of_threads = token.clone();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(2).start_handler(move |_| of_threads.attach()).build();
        let pool = pool.expect("threads start");
        let done = std::sync::atomic::AtomicUsize::new(0);
        let work = || {
            (0..1000).into_par_iter().for_each(|k| {
                look();
                done.fetch_add(1, Ordering::Relaxed);
                if k == 3 {
                    token.ask();
                }
            });
        };
        let ended = pool.install(|| token.run(work)).expect_err("asked");
        assert!(matches!(ended, Error::Interrupted) && done.load(Ordering::Relaxed) < 1000, "{ended}");
        token.reset();
        assert_eq!(
            pool.install(|| token.run(|| (0..1000).into_par_iter().map(|k| (look(), k).1).sum::<u32>())).ok(),
            Some(499_500)
        );
    }

    #[test]
    fn other_panics_go_on() {
        let token = Token::default();
        let caught = catch_unwind(AssertUnwindSafe(|| token.run(|| resume_unwind(Box::new("a fault")))));
        assert_eq!(caught.expect_err("a fault").downcast_ref::<&str>(), Some(&"a fault"));
    }
}
