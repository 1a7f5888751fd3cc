//! Lens and network together.
//!
//! [`chain`] is the whole path of one patch, scene → developed picture, with its adjoint to the lens; [`joint`] puts
//! the network and the optimiser around it; [`constraint`] keeps the lens buildable; [`data`] draws patches;
//! [`run`] is the loop with its folder; [`task`] is the file that asks for one. The final network for a finished lens:
//! [`pairs`] renders what it learns from, [`schedule`] sets its pace, [`training`] is the loop that can be killed and resumed,
//! [`train_task`] its part of the file.
//! [`evaluate`] judges what came out; [`memory`] says beforehand what all of it takes.

pub mod chain;
pub mod constraint;
pub mod data;
pub mod evaluate;
pub mod joint;
pub mod log;
pub mod memory;
pub mod pairs;
pub mod run;
pub mod schedule;
pub mod task;
pub mod train_task;
pub mod training;
