//! The camera side: RAW in, picture out. No training code, no gradients.

pub mod edges;
pub mod kit;
pub mod onnxruntime;
mod opcodes;
pub mod orientation;
pub mod raw;
pub mod raw_process;
pub mod reconstruct;
pub mod session;
#[cfg(test)]
mod test_model;
pub mod tiles;
pub mod valid;
