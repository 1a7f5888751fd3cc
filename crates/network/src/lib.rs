//! The reconstruction network: model, training and export.
//!
//! Input and output are `[batch, 3, row, col]`, f32, linear camera RGB, black at 0, white at 1, white-balanced and
//! demosaicked. burn's types stay inside this crate, and no lens comes into it: the design loop and the tests speak `ndarray`.
//!
//! Reading order: [`isoplanat_card`] (the contract with the camera), `unet` (the model), `block` (what it is made of), `layers` (their operations), `learner`
//! (weights and Adam; `device_adam` off the CPU), `reconstructor` (forward, the design's step), `content`, `ms_ssim`, `perceptual` and `critic` (losses),
//! `trainer` (the final training's step), its `device_check` (whether a GPU computes the same; `in_blocks`, the way round where not),
//! `average`, `checkpoint`, `onnx` (export). The fast convolutions are in `kernels`.

mod adam;
mod average;
mod block;
mod checkpoint;
pub mod compute;
mod content;
pub mod critic;
mod deepen;
mod device_adam;
mod display;
mod extension;
mod in_blocks;
mod kernels;
mod layers;
mod learner;
mod ms_ssim;
pub mod onnx;
mod perceptual;
pub(crate) mod reconstructor;
mod tensors;
mod tiles;
pub(crate) mod trainer;
pub mod unet;

pub use compute::Compute;
pub use learner::Parameter;
pub use reconstructor::{NetworkStep, Reconstructor, Step};
pub use trainer::{ContentKind, Objective, TrainStep, Trainer};
pub use unet::{Base, UnetConfig};
