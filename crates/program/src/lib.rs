//! What the two programs share: [`command_line`] reads what was asked for, [`signals`] what the user asks for while it runs, [`guarded`] makes one
//! sentence of a panic, [`tell!`] says it.
//!
//! Part of Isoplanat; its front door is the crate `isoplanat`.

pub mod command_line;
pub mod signals;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

#[doc(hidden)]
pub use isoplanat_base::terminal::in_line;

/// Says something on stderr; what would steer a terminal is escaped ([`isoplanat_base::terminal`]).
#[doc(hidden)]
#[macro_export]
macro_rules! tell {
    // Where nobody can be told the work goes on.
    ($($words:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stderr(), "{}", $crate::in_line(&format!($($words)*)));
    }};
}

/// [`tell!`]s what nobody must know: left out where [`set_quiet`] asked for it.
#[doc(hidden)]
#[macro_export]
macro_rules! aside {
    ($($words:tt)*) => {
        if !$crate::is_quiet() {
            $crate::tell!($($words)*);
        }
    };
}

/// Whether warnings and errors alone are told.
static QUIET: AtomicBool = AtomicBool::new(false);

/// Tells warnings and errors alone from now on, no notes and no progress.
#[doc(hidden)]
pub fn set_quiet(quiet: bool) {
    QUIET.store(quiet, Ordering::Relaxed);
}

/// Whether warnings and errors alone are told.
#[doc(hidden)]
pub fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// What a panic had to say: the hook keeps it off the screen, so that one line can be made of it, and none where somebody catches it.
static PANIC: Mutex<String> = Mutex::new(String::new());

/// What `run` returns; in place of a panic what it had to say, as one line.
///
/// # Errors
/// A panic.
#[doc(hidden)]
pub fn guarded<T>(run: impl FnOnce() -> T) -> Result<T, String> {
    std::panic::set_hook(Box::new(|panic| {
        if let Ok(mut text) = PANIC.lock() {
            *text = panic.to_string().replace('\n', " ");
        }
    }));
    catch_unwind(AssertUnwindSafe(run)).map_err(|_| PANIC.lock().map(|text| text.clone()).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_panic_is_one_line() {
        let said = super::guarded(|| panic!("two\nlines")).expect_err("a panic");
        assert!(said.contains("two lines") && !said.contains('\n'), "{said}");
        assert_eq!(super::guarded(|| 3), Ok(3));
    }
}
