//! Lens and network together.
//!
//! [`chain`] is the whole path of one patch, scene → developed picture, with its adjoint to the lens; [`joint`] puts
//! the network and the optimiser around it; [`constraint`] keeps the lens buildable; [`data`] draws patches;
//! [`run`] is the loop with its folder; [`task`] is the file that asks for one; [`evaluate`] judges what came out.

pub mod chain;
pub mod constraint;
pub mod data;
pub mod evaluate;
pub mod joint;
pub mod run;
pub mod task;
