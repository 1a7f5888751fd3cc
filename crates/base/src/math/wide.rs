//! Loops compiled for the widest vectors the processor has.
//!
//! The operations and their order are the same at every width (no fused multiply-add is formed), so the numbers are
//! the same bits on every processor.

use super::simd::{Kernel, Level, Simd};

pub use super::simd::prefetch;

/// Work to be compiled for several instruction sets; `run` and all it calls must be `#[inline(always)]` to profit.
pub trait Work {
    /// What the work gives.
    type Output;
    /// Does the work.
    fn run(self) -> Self::Output;
}

/// Runs `work` in its widest version.
#[inline]
pub fn wide<W: Work>(work: W) -> W::Output {
    Level::detect().run(Wide(work))
}

struct Wide<W>(W);

impl<W: Work> Kernel for Wide<W> {
    type Output = W::Output;
    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> W::Output {
        self.0.run()
    }
}
