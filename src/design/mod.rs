//! Lens and network together.
//!
//! [`chain`] is the whole path of one patch, scene → developed picture, with its adjoint to the lens; [`joint`] puts
//! the network and `lens_steps` around it, `sensor_loss` a loss without one, [`noise`] how well its gradients are known, [`as_built`] lenses within tolerances that pictures are taken through; [`data`] draws patches at [`places`], [`scenery`] says from what; [`judge`] looks at pictures that are not trained on;
//! [`run`] is the loop, [`designing`] the loop with its folder, [`state`] where it stands, [`story`] its page, [`sweep`] many of them by number, [`stages`] several one after the other; [`task`] is the file that asks for one. The final network for a finished lens:
//! [`pairs`] renders what it learns from, `schedule` sets its pace, [`training`] is the loop with a folder,
//! `train_task` its part of the file, [`subject`] what stands before the sensor: a lens, or one that was measured.
//! [`evaluate`] judges what came out, [`compare`] puts other lenses in its place; [`memory`] and [`pace`] say beforehand what all of it takes.

#[doc(hidden)]
pub mod as_built;
mod bound;
#[doc(hidden)]
pub mod chain;
#[doc(hidden)]
pub mod compare;
pub(crate) mod constraint;
#[doc(hidden)]
pub mod data;
pub mod designing;
#[doc(hidden)]
pub mod distances;
pub mod evaluate;
#[doc(hidden)]
pub mod folder;
mod going;
pub mod joint;
#[doc(hidden)]
pub mod judge;
#[doc(hidden)]
pub mod lens_steps;
#[doc(hidden)]
pub mod log;
#[doc(hidden)]
pub mod memory;
#[doc(hidden)]
pub mod noise;
pub mod opened;
#[doc(hidden)]
pub mod pace;
#[doc(hidden)]
pub mod pairs;
#[doc(hidden)]
pub mod places;
pub mod run;
#[doc(hidden)]
pub mod scenery;
#[doc(hidden)]
pub mod schedule;
pub mod sensor_loss;
#[doc(hidden)]
pub mod stages;
#[doc(hidden)]
pub mod state;
#[doc(hidden)]
pub mod stated;
#[doc(hidden)]
pub mod story;
pub mod subject;
#[doc(hidden)]
pub mod sweep;
#[doc(hidden)]
pub mod sweep_task;
pub mod task;
pub mod train_task;
pub mod training;
#[doc(hidden)]
pub mod verdict;
