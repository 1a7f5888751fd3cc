//! Numerics without an optical word.

pub mod fft;
