//! Faults that tests bring in: before each system call of a publication the calling thread's hook is asked. Nothing else sets one.

use std::cell::RefCell;
use std::io;
use std::rc::Rc;

/// What a test does before the named step: nothing, an error in the step's place, or the end of the process.
pub(crate) type Hook = Rc<dyn Fn(&'static str) -> Option<io::Error>>;

thread_local! {
    static HOOK: RefCell<Option<Hook>> = const { RefCell::new(None) };
}

/// Sets the calling thread's hook, or takes it away.
#[cfg(all(test, unix))]
pub(crate) fn set(hook: Option<Hook>) {
    HOOK.set(hook);
}

/// The place of a fault before the step `step`.
pub(super) fn at(step: &'static str) -> io::Result<()> {
    let hook = HOOK.with_borrow(Option::clone);
    match hook.and_then(|hook| hook(step)) {
        Some(error) => Err(error),
        None => Ok(()),
    }
}
