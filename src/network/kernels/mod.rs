//! SIMD kernels for the network's operations on the CPU: the same mathematics as `layers`, several times faster.
//!
//! Every operation works through its picture in *strips* of whole rows. A strip's inputs are copied, activated, into a
//! scratch buffer with a border of zeros ([`strip`]), small enough for the second-level cache; the register-blocked
//! loops of [`simd`] then run without any border case. Strips go to rayon's threads. How the picture is cut, and so the
//! order of every sum, depends on its shape alone: results do not depend on the number of threads.

mod convolution;
mod pooling;
mod recycle;
mod simd;
mod strip;
#[cfg(test)]
mod tests;
mod unpooling;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(super) use convolution::{convolve, convolve_vjp};
pub(super) use pooling::{pool, pool_vjp};
pub(super) use recycle::give;
pub(super) use unpooling::{unpool, unpool_vjp};

/// Which code runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Level {
    /// burn's own operations, on any processor.
    Plain,
    /// Eight lanes: AVX2 with FMA.
    Avx2,
    /// Sixteen lanes: AVX-512 (F, VL, DQ, BW).
    Avx512,
}

impl Level {
    /// The best this processor runs.
    pub(super) fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            if std::arch::is_x86_feature_detected!("avx512f")
                && std::arch::is_x86_feature_detected!("avx512vl")
                && std::arch::is_x86_feature_detected!("avx512dq")
                && std::arch::is_x86_feature_detected!("avx512bw")
            {
                return Self::Avx512;
            }
            if std::arch::is_x86_feature_detected!("avx2")
                && std::arch::is_x86_feature_detected!("fma")
            {
                return Self::Avx2;
            }
        }
        Self::Plain
    }
}

/// A batch of planes `[batch, channels, rows, columns]` in row-major order, and the PReLU to apply when it is read.
#[derive(Clone, Copy, Debug)]
pub(super) struct Source<'a> {
    /// Values before the activation.
    pub(super) values: &'a [f32],
    /// Number of channels.
    pub(super) channels: usize,
    /// One slope a channel; `None`: no activation.
    pub(super) slope: Option<&'a [f32]>,
}

/// Size of one plane and of the batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Extent {
    /// Pictures.
    pub(super) batch: usize,
    /// Height.
    pub(super) rows: usize,
    /// Width.
    pub(super) columns: usize,
}

impl Extent {
    /// Values in one plane.
    fn plane(self) -> usize {
        self.rows * self.columns
    }
}

/// Cotangent of a [`Source`].
#[derive(Clone, Debug, Default)]
pub(super) struct SourceBar {
    /// Of the values before the activation; empty where it was not asked for.
    pub(super) values: Vec<f32>,
    /// Of the slopes; empty where there are none.
    pub(super) slope: Vec<f32>,
}

/// Which cotangents an operation computes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    /// Those of the inputs.
    pub(super) inputs: bool,
    /// Those of weight and bias.
    pub(super) weights: bool,
}
