//! The contract between training and camera: what a reconstruction network is made of ([`Blocks`]), what it sees beside the capture ([`Inputs`]), and the
//! [`ModelCard`] in which its file says so.
//!
//! It knows neither burn nor lenses: training, camera and image formation depend on it, and on each other no further than that.

mod blocks;
mod card;
mod inputs;

pub use blocks::Blocks;
pub use card::{DEMOSAIC, INPUT_CONVENTION, ModelCard, SCHEMA, Weights, receptive_radius_px};
pub use inputs::{Inputs, SPREAD};
