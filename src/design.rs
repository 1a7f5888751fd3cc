//! Lens and network together: three loops, and what they share.
//!
//! | room | holds |
//! |---|---|
//! | [`task`] | the file that asks for a design, a sweep, a training |
//! | [`joint`] | lens and network at once: its step, its loop, its folder, its page |
//! | [`training`] | the final network of a finished lens: its pairs, its loop, its folder |
//! | [`evaluate`] | how good lens and network are |
//! | [`compare`] | other lenses in a lens's place |
//!
//! Shared: [`chain`] is the whole path of one patch, scene → developed picture, with its adjoint to the lens; [`data`] draws patches at [`places`]; [`subject`] is what stands before the sensor, a
//! lens or a measured one; `schedule` sets the pace, `going` is the one loop with checkpoints, `bound` says what a checkpoint belongs to, `folder` and `log` are a run's, [`opened`] is a run as
//! others read it; [`memory`] and [`pace`] say beforehand what all of it takes.

mod bending;
mod bound;
#[doc(hidden)]
pub mod chain;
#[doc(hidden)]
pub mod compare;
#[doc(hidden)]
pub mod data;
pub mod evaluate;
#[doc(hidden)]
pub mod folder;
mod going;
pub mod joint;
#[doc(hidden)]
pub mod log;
#[doc(hidden)]
pub mod memory;
pub mod opened;
#[doc(hidden)]
pub mod pace;
#[doc(hidden)]
pub mod places;
#[doc(hidden)]
pub mod schedule;
pub mod subject;
pub mod task;
pub mod training;
