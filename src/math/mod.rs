//! Numerics without an optical word.

pub mod fft;
pub mod least_squares;
pub mod memory;
pub mod real;
pub mod simd;
pub mod wide;
