//! The precision of pictures: f32 or f64.

use rustfft::num_traits::{Float, NumAssign};

/// The numbers images are made of: `f32` and `f64`.
pub trait Real: Float + NumAssign + rustfft::FftNum + std::iter::Sum + Default {
    /// The nearest number to `v`.
    fn real(v: f64) -> Self;
    /// This number as `f64`.
    fn to_double(self) -> f64;
}

impl Real for f32 {
    #[inline(always)]
    fn real(v: f64) -> Self {
        v as Self
    }
    #[inline(always)]
    fn to_double(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    #[inline(always)]
    fn real(v: f64) -> Self {
        v
    }
    #[inline(always)]
    fn to_double(self) -> f64 {
        self
    }
}
