//! Lens and network together.
//!
//! [`chain`] is the whole path of one patch, scene → developed picture, with its adjoint to the lens; [`joint`] puts
//! the network and [`lens_steps`] around it, [`sensor_loss`] a loss without one, [`noise`] how well its gradients are known, [`as_built`] lenses within tolerances that pictures are taken through; [`data`] draws patches at [`places`], [`scenery`] says from what; [`judge`] looks at pictures that are not trained on;
//! [`run`] is the loop, [`designing`] the loop with its folder, [`state`] where it stands, [`story`] its page, [`sweep`] many of them by number, [`stages`] several one after the other; [`task`] is the file that asks for one. The final network for a finished lens:
//! [`pairs`] renders what it learns from, [`schedule`] sets its pace, [`training`] is the loop with a folder,
//! [`train_task`] its part of the file, [`subject`] what stands before the sensor: a lens, or one that was measured.
//! [`evaluate`] judges what came out, [`compare`] puts other lenses in its place; [`memory`] and [`pace`] say beforehand what all of it takes.

pub mod as_built;
mod bound;
pub mod chain;
pub mod compare;
pub mod constraint;
pub mod data;
pub mod designing;
pub mod distances;
pub mod evaluate;
pub mod folder;
mod going;
pub mod joint;
pub mod judge;
pub mod lens_steps;
pub mod log;
pub mod memory;
pub mod noise;
pub mod opened;
pub mod pace;
pub mod pairs;
pub mod places;
pub mod run;
pub mod scenery;
pub mod schedule;
pub mod sensor_loss;
pub mod state;
pub mod story;
pub mod subject;
pub mod sweep;
pub mod task;
pub mod training;
pub mod verdict;
