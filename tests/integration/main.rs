//! Tests across modules, in the order of the data flow.

mod adjoints;
mod cli;
mod golden;
mod gradients;
mod layering;
#[cfg(all(feature = "train", feature = "deploy"))]
mod parity;
mod one_way;
mod picture;
mod renderers;
mod stiff;
mod support;
mod throughput;
#[cfg(feature = "train")]
mod training;
mod white;

mod white_oracle;
mod windows;
