//! The reconstruction network: the model card here without burn; model, training and export behind `train`.
//!
//! Input and output are `[batch, 3, row, col]`, f32, linear camera RGB, black at 0, white at 1, white-balanced and
//! demosaicked. burn's types stay inside this module: the design loop and the tests speak `ndarray`.
//!
//! Reading order: [`card`] (the contract with the camera), `unet` (the model), `block` (what it is made of), `layers` (their operations), `learner`
//! (weights and Adam; `device_adam` off the CPU), `reconstructor` (forward, the design's step), `content`, `perceptual` and `critic` (losses),
//! `trainer` (the final training's step), its `device_check` (whether a GPU computes the same; `in_blocks`, the way round where not),
//! `average`, `checkpoint`, `onnx` (export). The fast convolutions are in `kernels`.

pub mod blocks;
pub mod card;

#[cfg(feature = "train")]
mod adam;
#[cfg(feature = "train")]
mod average;
#[cfg(feature = "train")]
mod block;
#[cfg(feature = "train")]
mod checkpoint;
#[cfg(feature = "train")]
pub mod compute;
#[cfg(feature = "train")]
mod content;
#[cfg(feature = "train")]
pub mod critic;
#[cfg(feature = "train")]
mod deepen;
#[cfg(feature = "train")]
mod device_adam;
#[cfg(feature = "train")]
mod display;
#[cfg(feature = "train")]
mod extension;
#[cfg(feature = "train")]
mod in_blocks;
#[cfg(feature = "train")]
mod kernels;
#[cfg(feature = "train")]
mod layers;
#[cfg(feature = "train")]
mod learner;
#[cfg(feature = "train")]
pub mod onnx;
#[cfg(feature = "train")]
mod perceptual;
#[cfg(feature = "train")]
pub mod reconstructor;
#[cfg(feature = "train")]
mod tensors;
#[cfg(feature = "train")]
mod tiles;
#[cfg(feature = "train")]
pub mod trainer;
#[cfg(feature = "train")]
pub mod unet;

pub use blocks::Blocks;
#[cfg(feature = "train")]
pub use compute::Compute;
#[cfg(feature = "train")]
pub use learner::Parameter;
#[cfg(feature = "train")]
pub use reconstructor::{NetworkStep, Reconstructor, Step};
#[cfg(feature = "train")]
pub use trainer::{ContentKind, Objective, TrainStep, Trainer};
#[cfg(feature = "train")]
pub use unet::UnetConfig;
