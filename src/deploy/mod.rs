//! The camera side: RAW in, picture out. No training code, no gradients.

mod opcodes;
pub mod orientation;
pub mod raw;
pub mod raw_process;
pub mod tiles;
