//! Convolution of any square size and stride as a product of matrices: every tap of every channel is a line of its own
//! ([`super::flat`]), as long as the output. For kernels that the register blocks for 3×3 taps do not fit.

use rayon::prelude::*;

use super::flat::{Line, Lines};
use super::panel::Panel;
use super::product::{Block, group, outer, product};
use super::small::{Store, interleave};
use super::strip::filled;
use super::{Extent, Level, Source, Wanted, recycle};

/// A convolution's geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) struct Taps {
    /// Rows and columns of the kernel.
    pub(in super::super) side: usize,
    /// Pixels between outputs.
    pub(in super::super) stride: usize,
    /// Zeros around the picture.
    pub(in super::super) padding: usize,
}

impl Taps {
    /// Size of the output of pictures of `extent`.
    ///
    /// # Panics
    /// If the kernel is larger than picture and padding.
    pub(in super::super) fn output(self, extent: Extent) -> Extent {
        let out = |n: usize| (n + 2 * self.padding - self.side) / self.stride + 1;
        Extent { rows: out(extent.rows), columns: out(extent.columns), ..extent }
    }

    fn count(self) -> usize {
        self.side * self.side
    }

    /// For a tap `k` along one axis of `n` pixels: the outputs that see a pixel there, and the first one's pixel.
    fn seen(self, k: usize, n: usize, outputs: usize) -> (std::ops::Range<usize>, usize) {
        let first = self.padding.saturating_sub(k).div_ceil(self.stride);
        let end = ((n + self.padding).saturating_sub(k)).div_ceil(self.stride).min(outputs);
        (first.min(end)..end, (first * self.stride + k).saturating_sub(self.padding))
    }
}

/// Calls `pair` for every row of outputs that tap `k` (row and column) of a plane sees: first pixel in the plane, first and last output.
fn rows(taps: Taps, k: usize, extent: Extent, mut pair: impl FnMut(usize, std::ops::Range<usize>)) {
    let out = taps.output(extent);
    let (down, row) = taps.seen(k / taps.side, extent.rows, out.rows);
    let (across, column) = taps.seen(k % taps.side, extent.columns, out.columns);
    if across.is_empty() {
        return;
    }
    for (i, output) in down.enumerate() {
        let from = (row + i * taps.stride) * extent.columns + column;
        pair(from, output * out.columns + across.start..output * out.columns + across.end);
    }
}

/// What every tap of every channel sees.
fn columns(taps: Taps, source: Source, extent: Extent) -> Lines {
    let out = taps.output(extent).plane();
    Lines::written(Line::new(taps.output(extent), 1), source.channels * taps.count(), |line, to| {
        let (channel, k) = (line / taps.count(), line % taps.count());
        for image in 0..extent.batch {
            let from = &source.values[(image * source.channels + channel) * extent.plane()..][..extent.plane()];
            let to = &mut to[image * out..][..out];
            rows(taps, k, extent, |at, outputs| {
                let to = &mut to[outputs];
                if taps.stride == 1 {
                    to.copy_from_slice(&from[at..][..to.len()]);
                } else {
                    to.iter_mut().zip(from[at..].iter().step_by(taps.stride)).for_each(|(to, &from)| *to = from);
                }
            });
        }
    })
}

/// Output `[batch, bias.len(), rows, columns]` of [`Taps::output`]; `weight` is `[out, in, side, side]`.
pub(in super::super) fn convolve(
    level: Level,
    taps: Taps,
    source: Source,
    extent: Extent,
    weight: &[f32],
    bias: &[f32],
) -> Vec<f32> {
    let (out, inputs) = (taps.output(extent), source.channels * taps.count());
    let lines = columns(taps, source, extent);
    let pack = |Block { first, size, channels, to }: Block| {
        let n = channels.len();
        interleave(size, |output| &weight[(first + output) * inputs + channels.start..][..n], to);
    };
    let output = filled(extent.batch * bias.len() * out.plane(), |to| {
        product::<1>(level, &lines, bias, pack, stores(to, bias.len(), out));
    });
    lines.release();
    output
}

/// Places for planes of `extent`, by groups of them.
fn stores(to: &mut [f32], planes: usize, extent: Extent) -> Vec<Store<'_>> {
    Panel::cut(to, planes * extent.plane(), group(planes) * extent.plane())
        .map(|panel| Store::plain(panel, extent))
        .collect()
}

/// Cotangents of [`convolve`]: of the source, the weight, the bias (empty where not wanted).
pub(in super::super) fn convolve_vjp(
    level: Level,
    taps: Taps,
    source: Source,
    extent: Extent,
    weight: &[f32],
    output_bar: &[f32],
    wanted: Wanted,
) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
    let (out, inputs) = (taps.output(extent), source.channels * taps.count());
    let outputs = weight.len() / inputs;
    let bars = Lines::load(level, &[Source { values: output_bar, channels: outputs, slope: None }], out, 1);
    let mut source_bar = vec![];
    if wanted.inputs {
        let pack = |Block { first, size, channels, to }: Block| {
            for (channel, to) in channels.zip(to.chunks_exact_mut(size)) {
                to.copy_from_slice(&weight[channel * inputs + first..][..size]);
            }
        };
        let each = filled(extent.batch * inputs * out.plane(), |to| {
            product::<1>(level, &bars, &vec![0.0; inputs], pack, stores(to, inputs, out));
        });
        source_bar = summed(taps, &each, source.channels, extent);
        recycle::give(each);
    }
    let (mut weight_bar, mut bias_bar) = (vec![], vec![]);
    if wanted.weights {
        let values = columns(taps, source, extent);
        weight_bar = outer(level, &bars, inputs, |k| values.from(k, 0));
        bias_bar = (0..outputs).map(|o| bars.of(o).iter().sum()).collect();
        values.release();
    }
    bars.release();
    (source_bar, weight_bar, bias_bar)
}

/// The transpose of [`columns`]: each pixel's sum over the taps that see it.
fn summed(taps: Taps, each: &[f32], channels: usize, extent: Extent) -> Vec<f32> {
    let out = taps.output(extent).plane();
    let mut bar = recycle::zeros(extent.batch * channels * extent.plane());
    bar.par_chunks_mut(extent.plane()).zip(each.par_chunks(taps.count() * out)).for_each(|(to, each)| {
        for (k, from) in each.chunks_exact(out).enumerate() {
            rows(taps, k, extent, |at, outputs| {
                let from = &from[outputs];
                if taps.stride == 1 {
                    to[at..][..from.len()].iter_mut().zip(from).for_each(|(to, &from)| *to += from);
                } else {
                    to[at..].iter_mut().step_by(taps.stride).zip(from).for_each(|(to, &from)| *to += from);
                }
            });
        }
    });
    bar
}
