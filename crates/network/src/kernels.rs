//! SIMD kernels for the network's operations on the CPU: the same mathematics as `layers`, several times faster.
//!
//! Every operation works through its picture in *strips* of whole rows. A strip's inputs are copied, activated, into a
//! scratch buffer with a border of zeros ([`strip`]), small enough for the second-level cache; the register-blocked
//! loops of [`inner`] then run without any border case. Strips go to rayon's threads. How the picture is cut, and so the
//! order of every sum, depends on its shape alone: results do not depend on the number of threads.
//!
//! Planes of few columns, which come with many channels, are cut by weights instead ([`small`]). What has no weights between
//! channels ([`pooling`], [`depthwise`], [`gate`]) goes plane by plane. Kernels of other sizes and strides than
//! the U-Net's go by [`columns`].

pub(super) mod columns;
mod convolution;
mod depthwise;
mod flat;
mod gate;
mod inner;
mod panel;
mod pooling;
mod product;
mod recycle;
mod small;
mod strip;
#[cfg(test)]
mod tests;
mod unpooling;

pub(super) use depthwise::{depthwise, depthwise_vjp};
pub(super) use gate::{gate, gate_vjp};
pub(super) use isoplanat_base::math::simd::Level;
pub(super) use pooling::{pool, pool_vjp};
pub(super) use recycle::give;

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

/// Output `[batch, bias.len(), rows, columns]` of the 3×3 or 1×1 convolution of all sources' channels in turn, with zero
/// padding.
///
/// `weight` is `[out, in, 3, 3]` or `[out, in, 1, 1]`.
pub(super) fn convolve(level: Level, sources: &[Source], extent: Extent, weight: &[f32], bias: &[f32]) -> Vec<f32> {
    let pointwise = pointwise(sources, bias.len(), weight);
    let convolve = match (pointwise, small::convolves(extent, pointwise)) {
        (false, true) => small::convolve::<3>,
        (false, false) => convolution::convolve::<3>,
        (true, true) => small::convolve::<1>,
        (true, false) => convolution::convolve::<1>,
    };
    convolve(level, sources, extent, weight, bias)
}

/// Whether the weights are one for each input and output.
fn pointwise(sources: &[Source], outputs: usize, weight: &[f32]) -> bool {
    weight.len() == outputs * sources.iter().map(|s| s.channels).sum::<usize>()
}

/// Cotangents of [`convolve`]: of each source, of the weight, of the bias (empty where not wanted).
pub(super) fn convolve_vjp(
    level: Level,
    sources: &[Source],
    extent: Extent,
    weight: &[f32],
    output_bar: &[f32],
    wanted: Wanted,
) -> (Vec<SourceBar>, Vec<f32>, Vec<f32>) {
    let outputs = output_bar.len() / (extent.batch * extent.plane());
    let pointwise = pointwise(sources, outputs, weight);
    let vjp = match (pointwise, small::convolves(extent, pointwise)) {
        (false, true) => small::convolve_vjp::<3>,
        (false, false) => convolution::convolve_vjp::<3>,
        (true, true) => small::convolve_vjp::<1>,
        (true, false) => convolution::convolve_vjp::<1>,
    };
    vjp(level, sources, extent, weight, output_bar, wanted)
}

/// Output `[batch, bias.len(), 2 rows, 2 columns]` of the transposed 2×2 convolution with stride 2; `weight` is
/// `[in, out, 2, 2]`, `extent` that of the source.
pub(super) fn unpool(level: Level, source: Source, extent: Extent, weight: &[f32], bias: &[f32]) -> Vec<f32> {
    let unpool = if small::unpools(extent) { small::unpool } else { unpooling::unpool };
    unpool(level, source, extent, weight, bias)
}

/// Cotangents of [`unpool`]: of the source, the weight, the bias (empty where not wanted).
pub(super) fn unpool_vjp(
    level: Level,
    source: Source,
    extent: Extent,
    weight: &[f32],
    output_bar: &[f32],
    wanted: Wanted,
) -> (SourceBar, Vec<f32>, Vec<f32>) {
    let vjp = if small::unpools(extent) { small::unpool_vjp } else { unpooling::unpool_vjp };
    vjp(level, source, extent, weight, output_bar, wanted)
}
