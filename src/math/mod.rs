//! Numerics without an optical word.

pub mod fft;
pub mod least_squares;
pub mod wide;
