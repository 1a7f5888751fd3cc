//! Convolution with `SIDE × SIDE` taps, 3 or 1, and zero padding over several sources, and its cotangents.

use rayon::prelude::*;

use super::inner::{Correlation, PICTURES, PanelRow, Rows, blocks, convolve_row, correlate, largest};
use super::panel::Panel;
use super::strip::{Layout, Scratch, activate_vjp, filled, load_activated, rows_of_strip, with_scratch};
use super::{Extent, Level, Source, SourceBar, Wanted, recycle};
use isoplanat_base::math::raster;
use isoplanat_base::math::simd::{F32, Kernel, Simd};

/// Groups of strips that sum their own weight gradient; fixed, so that the order of sums is.
const GROUPS: usize = 16;

/// Pixels of the block of rows whose weight gradient is summed in one go: eight channels of it fit the first-level cache.
const CORRELATED: usize = 1024;

/// Output `[batch, bias.len(), rows, columns]` of the convolution of all sources' channels in turn.
///
/// `weight` is `[out, in, SIDE, SIDE]`.
pub(super) fn convolve<const SIDE: usize>(
    level: Level,
    sources: &[Source],
    extent: Extent,
    weight: &[f32],
    bias: &[f32],
) -> Vec<f32> {
    let inputs: usize = sources.iter().map(|s| s.channels).sum();
    let (outputs, taps) = (bias.len(), SIDE * SIDE);
    assert_eq!(weight.len(), inputs * outputs * taps);
    let packed = pack(outputs, inputs, taps, largest(level), |o, i, tap| weight[(o * inputs + i) * taps + tap]);
    let rows = rows_of_strip(extent, inputs);
    filled(extent.batch * outputs * extent.plane(), |to| {
        let parts = parts(to, outputs, extent.plane(), rows * extent.columns);
        strips(extent, rows).into_par_iter().zip(parts).for_each(|(strip, to)| {
            with_scratch(|[scratch, ..]| {
                level.run(Forward::<SIDE> { sources, extent, strip, packed: &packed, bias, inputs, to, scratch });
            });
        });
    })
}

/// The strips of an output `[batch, channels, plane]`, `part` values of every plane each, in order.
pub(super) fn parts(to: &mut [f32], channels: usize, plane: usize, part: usize) -> Vec<Panel<'_>> {
    to.chunks_mut(channels * plane).flat_map(|image| Panel::cut(image, plane, part)).collect()
}

/// Whole rows of one picture.
#[derive(Clone, Copy)]
pub(super) struct Strip {
    pub(super) image: usize,
    pub(super) first: usize,
    pub(super) rows: usize,
}

/// All strips of a batch, in order.
pub(super) fn strips(extent: Extent, rows: usize) -> Vec<Strip> {
    (0..extent.batch)
        .flat_map(|image| {
            raster::parts(extent.rows, rows).map(move |part| Strip { image, first: part.start, rows: part.len() })
        })
        .collect()
}

/// Weights in the order the kernels read them: blocks of outputs, in each `[in][tap][output of the block]`.
pub(super) fn pack(
    outputs: usize,
    inputs: usize,
    taps: usize,
    largest: usize,
    weight: impl Fn(usize, usize, usize) -> f32,
) -> Vec<f32> {
    let mut packed = Vec::with_capacity(outputs * inputs * taps);
    for (first, size) in blocks(outputs, largest) {
        for input in 0..inputs {
            for tap in 0..taps {
                packed.extend((first..first + size).map(|output| weight(output, input, tap)));
            }
        }
    }
    packed
}

struct Forward<'a, const SIDE: usize> {
    sources: &'a [Source<'a>],
    extent: Extent,
    strip: Strip,
    packed: &'a [f32],
    bias: &'a [f32],
    inputs: usize,
    to: Panel<'a>,
    scratch: &'a mut Scratch,
}

impl<const SIDE: usize> Kernel for Forward<'_, SIDE> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        let Strip { image, first, rows } = self.strip;
        let columns = self.extent.columns;
        let layout = Layout::new(self.inputs, rows + SIDE - 1, columns);
        let buffer = self.scratch.get(layout.len());
        load_activated(simd, self.sources, self.extent, image, above::<SIDE>(first), &layout, buffer);
        let mut weights = self.packed;
        for (first, size) in blocks(self.bias.len(), S::BLOCK) {
            let bias = &self.bias[first..][..size];
            for row in 0..rows {
                let from = layout.rows_from(buffer, 0, row, SIDE / 2);
                let to = PanelRow { panel: &mut self.to, row: first, at: row * columns, n: columns };
                convolve_row::<S, SIDE>(simd, size, from, weights, Some(bias), to);
            }
            weights = &weights[size * layout.channels * SIDE * SIDE..];
        }
    }
}

/// The first row that taps around `row` see.
fn above<const SIDE: usize>(row: usize) -> isize {
    row as isize - (SIDE / 2) as isize
}

/// Cotangents of [`convolve`]: of each source, of the weight, of the bias (empty where not wanted).
pub(super) fn convolve_vjp<const SIDE: usize>(
    level: Level,
    sources: &[Source],
    extent: Extent,
    weight: &[f32],
    output_bar: &[f32],
    wanted: Wanted,
) -> (Vec<SourceBar>, Vec<f32>, Vec<f32>) {
    let inputs: usize = sources.iter().map(|s| s.channels).sum();
    let taps = SIDE * SIDE;
    let outputs = weight.len() / (inputs * taps);
    assert_eq!(output_bar.len(), extent.batch * outputs * extent.plane());
    // The cotangent of the input is the convolution of the output's with the weights turned by 180° and transposed.
    let mut turned = Vec::with_capacity(weight.len());
    for source in sources {
        let before = turned.len() / (outputs * taps);
        turned.extend(pack(source.channels, outputs, taps, largest(level), |i, o, tap| {
            weight[(o * inputs + before + i) * taps + taps - 1 - tap]
        }));
    }
    let rows = rows_of_strip(extent, inputs + outputs);
    let mut jobs: Vec<(Strip, Vec<Panel>)> = strips(extent, rows).into_iter().map(|strip| (strip, vec![])).collect();
    let zeros = vec![0.0; inputs];

    let mut bars: Vec<Vec<f32>> =
        sources.iter().map(|s| recycle::take(if wanted.inputs { s.values.len() } else { 0 })).collect();
    if wanted.inputs {
        for (bar, source) in bars.iter_mut().zip(sources) {
            let parts = parts(bar, source.channels, extent.plane(), rows * extent.columns);
            jobs.iter_mut().zip(parts).for_each(|((_, to), part)| to.push(part));
        }
    }
    let group = jobs.len().div_ceil(GROUPS);
    let mut sums: Vec<StripSums> = jobs
        .par_chunks_mut(group)
        .map(|jobs| {
            let mut sums = StripSums {
                weight: recycle::zeros(if wanted.weights { weight.len() } else { 0 }),
                bias: vec![0.0; if wanted.weights { outputs } else { 0 }],
                slope: vec![0.0; inputs],
            };
            for (strip, to) in jobs {
                with_scratch(|[a, b, _]| {
                    level.run(Backward::<SIDE> {
                        sources,
                        extent,
                        strip: *strip,
                        turned: &turned,
                        zeros: &zeros,
                        output_bar: Source { values: output_bar, channels: outputs, slope: None },
                        wanted,
                        to,
                        sums: &mut sums,
                        scratch: (a, b),
                    });
                });
            }
            sums
        })
        .collect();
    drop(jobs);
    let mut total = |part: fn(&mut StripSums) -> &mut Vec<f32>| {
        let mut total = std::mem::take(part(&mut sums[0]));
        for more in &mut sums[1..] {
            let more = std::mem::take(part(more));
            total.iter_mut().zip(&more).for_each(|(t, m)| *t += m);
            recycle::give(more);
        }
        total
    };
    let slopes = total(|s| &mut s.slope);
    let mut channel = 0;
    let source_bars = bars
        .into_iter()
        .zip(sources)
        .map(|(values, source)| {
            let slope =
                if source.slope.is_some() { slopes[channel..channel + source.channels].to_vec() } else { vec![] };
            channel += source.channels;
            SourceBar { values, slope }
        })
        .collect();
    (source_bars, total(|s| &mut s.weight), total(|s| &mut s.bias))
}

/// Sums over the strips of one group.
struct StripSums {
    weight: Vec<f32>,
    bias: Vec<f32>,
    slope: Vec<f32>,
}

struct Backward<'a, 'p, const SIDE: usize> {
    sources: &'a [Source<'a>],
    extent: Extent,
    strip: Strip,
    turned: &'a [f32],
    zeros: &'a [f32],
    output_bar: Source<'a>,
    wanted: Wanted,
    to: &'a mut [Panel<'p>],
    sums: &'a mut StripSums,
    scratch: (&'a mut Scratch, &'a mut Scratch),
}

impl<const SIDE: usize> Kernel for Backward<'_, '_, SIDE> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { sources, extent, strip, turned, zeros, output_bar, wanted, to, sums, scratch } = self;
        let Strip { image, first, rows } = strip;
        let (outputs, inputs) = (output_bar.channels, zeros.len());
        let above = above::<SIDE>(first);
        let bar_layout = Layout::new(outputs, rows + SIDE - 1, extent.columns);
        let bars = scratch.0.get(bar_layout.len());
        load_activated(simd, &[output_bar], extent, image, above, &bar_layout, bars);
        if wanted.inputs {
            let mut weights = turned;
            let mut channel = 0;
            for (source, to) in sources.iter().zip(to) {
                let slope_bars = &mut sums.slope[channel..][..source.channels];
                input_strip::<S, SIDE>(
                    simd,
                    (extent, strip),
                    *source,
                    (&bar_layout, bars),
                    weights,
                    zeros,
                    to,
                    slope_bars,
                );
                weights = &weights[source.channels * outputs * SIDE * SIDE..];
                channel += source.channels;
            }
        }
        if wanted.weights {
            let layout = Layout::new(inputs, rows + SIDE - 1, extent.columns);
            let values = scratch.1.get(layout.len());
            load_activated(simd, sources, extent, image, above, &layout, values);
            let (bars, values) = ((&bar_layout, &*bars), (&layout, &*values));
            weight_strip::<S, SIDE>(simd, bars, values, rows, extent.columns, &mut sums.weight);
            bias_strip(simd, bars, SIDE / 2, rows, extent.columns, &mut sums.bias);
        }
    }
}

/// Cotangents of one source's rows, through their PReLU.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "one part of a kernel")]
fn input_strip<S: Simd, const SIDE: usize>(
    simd: S,
    (extent, strip): (Extent, Strip),
    source: Source,
    (layout, bars): (&Layout, &[f32]),
    mut weights: &[f32],
    zeros: &[f32],
    to: &mut Panel,
    slope_bars: &mut [f32],
) {
    let Strip { image, first, rows } = strip;
    let (plane, columns) = (extent.plane(), extent.columns);
    for (start, size) in blocks(source.channels, S::BLOCK) {
        for row in 0..rows {
            let from = layout.rows_from(bars, 0, row, SIDE / 2);
            let place = PanelRow { panel: &mut *to, row: start, at: row * columns, n: columns };
            convolve_row::<S, SIDE>(simd, size, from, weights, Some(zeros), place);
            if let Some(slope) = source.slope {
                for o in start..start + size {
                    let at = (image * source.channels + o) * plane + (first + row) * columns;
                    let bar = &mut to.row(o)[row * columns..][..columns];
                    slope_bars[o] += activate_vjp(simd, bar, &source.values[at..][..columns], slope[o]);
                }
            }
        }
        weights = &weights[size * layout.channels * SIDE * SIDE..];
    }
}

/// Adds a strip's part of the weight gradient `[out, in, SIDE, SIDE]`.
#[inline(always)]
fn weight_strip<S: Simd, const SIDE: usize>(
    simd: S,
    (bar_layout, bars): (&Layout, &[f32]),
    (layout, values): (&Layout, &[f32]),
    rows: usize,
    columns: usize,
    sums: &mut [f32],
) {
    let (inputs, taps) = (layout.channels, SIDE * SIDE);
    let chunk = (CORRELATED / columns.next_multiple_of(16)).clamp(1, rows);
    for (output, size) in blocks(bar_layout.channels, S::BLOCK) {
        let mut row = 0;
        while row < rows {
            let chunk = chunk.min(rows - row);
            let a = bar_layout.rows_from(bars, output, row + SIDE / 2, 0);
            if SIDE == 1 {
                let to = &mut sums[output * inputs..];
                correlate_channels(simd, (a, size), (layout, values), (row, chunk, columns), to, (inputs, 1));
            } else {
                for input in 0..inputs {
                    for ky in 0..SIDE {
                        let b = layout.rows_from(values, input, row + ky, 1).from;
                        let b = [b, &b[1..], &b[2..]];
                        let of = Correlation { a, b, b_row_stride: layout.row_stride, rows: chunk, n: columns };
                        let to = &mut sums[(output * inputs + input) * taps + SIDE * ky..];
                        correlate(simd, size, of, to, (inputs * taps, 1));
                    }
                }
            }
            row += chunk;
        }
    }
}

/// Adds the products of `size` planes of `a` with every channel of `values`, summed over `(first, rows, columns)`, to
/// `to[plane·strides.0 + channel·strides.1]`.
#[inline(always)]
pub(super) fn correlate_channels<S: Simd>(
    simd: S,
    (a, size): (Rows, usize),
    (layout, values): (&Layout, &[f32]),
    (first, rows, n): (usize, usize, usize),
    to: &mut [f32],
    strides: (usize, usize),
) {
    let channels = layout.channels;
    // Three channels a time; where fewer are left the last one is computed again into a bin.
    let mut bin = [0.0f32; 8 * PICTURES];
    for channel in (0..channels).step_by(PICTURES) {
        let b = [0, 1, 2].map(|t| layout.rows_from(values, (channel + t).min(channels - 1), first, 0).from);
        let of = Correlation { a, b, b_row_stride: layout.row_stride, rows, n };
        if channel + PICTURES <= channels {
            correlate(simd, size, of, &mut to[channel * strides.1..], strides);
            continue;
        }
        bin.fill(0.0);
        correlate(simd, size, of, &mut bin, (PICTURES, 1));
        for t in 0..channels - channel {
            for o in 0..size {
                to[o * strides.0 + (channel + t) * strides.1] += bin[PICTURES * o + t];
            }
        }
    }
}

/// Adds a strip's part of the bias gradient: the sum of every channel's rows, behind `above` others.
#[inline(always)]
pub(super) fn bias_strip<S: F32>(
    simd: S,
    (layout, bars): (&Layout, &[f32]),
    above: usize,
    rows: usize,
    columns: usize,
    sums: &mut [f32],
) {
    for (channel, sum) in sums.iter_mut().enumerate() {
        let mut total = simd.splat(0.0);
        for row in 0..rows {
            let from = &bars[layout.at(channel, row + above)..][..columns.next_multiple_of(S::LANES)];
            for from in simd.cut(from).0 {
                total = simd.add(total, simd.load(from));
            }
        }
        *sum += simd.sum(total);
    }
}
