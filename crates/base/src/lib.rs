//! What every floor of Isoplanat stands on: the one error type, files that appear whole, units, numerics without an optical word.
//!
//! Part of Isoplanat; its front door is the crate `isoplanat`.

pub mod atomic;
pub mod error;
#[doc(hidden)]
pub mod exact;
#[doc(hidden)]
pub mod figures;
pub mod math;
#[doc(hidden)]
pub mod refusing;
#[doc(hidden)]
pub mod stop;
#[doc(hidden)]
pub mod terminal;
#[doc(hidden)]
pub mod testing;
#[doc(hidden)]
pub mod threads;
pub mod units;

pub use error::{Error, Result};
