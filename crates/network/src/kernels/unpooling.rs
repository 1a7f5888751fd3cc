//! Transposed 2×2 convolution with stride 2, and its cotangents: a product of matrices per pixel, whose four results a
//! channel are interleaved into the finer picture.

use rayon::prelude::*;

use super::convolution::{Strip, correlate_channels, pack, parts, strips};
use super::inner::{PanelRow, blocks, convolve_row, largest, load_pairs, store_pairs};
use super::panel::Panel;
use super::strip::{Layout, Scratch, activate_vjp, filled, load_activated, rows_of_strip, with_scratch};
use super::{Extent, Level, Source, SourceBar, Wanted, recycle};
use isoplanat_base::math::simd::{F32, Kernel, Simd};

/// Taps: row and column of the 2×2 block.
const TAPS: usize = 4;

/// Groups of strips that sum their own weight gradient.
const GROUPS: usize = 16;

/// Output `[batch, bias.len(), 2 rows, 2 columns]`; `weight` is `[in, out, 2, 2]`, `extent` that of the source.
pub(super) fn unpool(level: Level, source: Source, extent: Extent, weight: &[f32], bias: &[f32]) -> Vec<f32> {
    let products = bias.len() * TAPS;
    assert_eq!(weight.len(), source.channels * products);
    let packed = pack(products, source.channels, 1, largest(level), |m, k, _| weight[k * products + m]);
    let spread: Vec<f32> = bias.iter().flat_map(|&b| [b; TAPS]).collect();
    let rows = rows_of_strip(extent, source.channels);
    filled(extent.batch * products * extent.plane(), |to| {
        let parts = parts(to, bias.len(), TAPS * extent.plane(), TAPS * rows * extent.columns);
        strips(extent, rows).into_par_iter().zip(parts).for_each(|(strip, to)| {
            with_scratch(|[a, b, _]| {
                level.run(Forward { source, extent, strip, packed: &packed, bias: &spread, to, scratch: (a, b) });
            });
        });
    })
}

struct Forward<'a> {
    source: Source<'a>,
    extent: Extent,
    strip: Strip,
    packed: &'a [f32],
    /// The bias of every product.
    bias: &'a [f32],
    to: Panel<'a>,
    scratch: (&'a mut Scratch, &'a mut Scratch),
}

impl Kernel for Forward<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        let Strip { image, first, rows } = self.strip;
        let columns = self.extent.columns;
        let layout = Layout::new(self.source.channels, rows, columns);
        let buffer = self.scratch.0.get(layout.len());
        load_activated(simd, &[self.source], self.extent, image, first as isize, &layout, buffer);
        let width = columns.next_multiple_of(16);
        let row_products = self.scratch.1.get(8 * width);
        let mut weights = self.packed;
        for (m, size) in blocks(self.bias.len(), S::BLOCK) {
            let bias = &self.bias[m..][..size];
            for row in 0..rows {
                let from = layout.rows_from(buffer, 0, row, 0);
                let panel = &mut Panel::whole(row_products, width);
                let place = PanelRow { panel, row: 0, at: 0, n: columns };
                convolve_row::<S, 1>(simd, size, from, weights, Some(bias), place);
                // Products come in pairs (left, right) of one fine row.
                for (pair, products) in row_products.chunks_exact(2 * width).take(size / 2).enumerate() {
                    let (channel, fine_row) = ((m + 2 * pair) / TAPS, (m + 2 * pair) % TAPS / 2);
                    let to = &mut self.to.row(channel)[(2 * row + fine_row) * 2 * columns..][..2 * columns];
                    let (left, right) = products.split_at(width);
                    for x in (0..columns).step_by(S::LANES) {
                        let (even, odd) = (simd.load_at(left, x), simd.load_at(right, x));
                        store_pairs(simd, &mut to[2 * x..], even, odd);
                    }
                }
            }
            weights = &weights[size * layout.channels..];
        }
    }
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
    let inputs = source.channels;
    let products = weight.len() / inputs;
    assert_eq!(output_bar.len(), extent.batch * products * extent.plane());
    let packed = pack(inputs, products, 1, largest(level), |m, k, _| weight[m * products + k]);
    let rows = rows_of_strip(extent, inputs + products);
    let mut jobs: Vec<(Strip, Option<Panel>)> = strips(extent, rows).into_iter().map(|strip| (strip, None)).collect();
    let zeros = vec![0.0; inputs];
    let mut values = recycle::take(if wanted.inputs { source.values.len() } else { 0 });
    if wanted.inputs {
        let parts = parts(&mut values, inputs, extent.plane(), rows * extent.columns);
        jobs.iter_mut().zip(parts).for_each(|((_, to), part)| *to = Some(part));
    }
    let group = jobs.len().div_ceil(GROUPS);
    let mut sums: Vec<UnpoolingSums> = jobs
        .par_chunks_mut(group)
        .map(|jobs| {
            let n = if wanted.weights { weight.len() } else { 0 };
            let mut sums =
                UnpoolingSums { weight: recycle::zeros(n), products: vec![0.0; products], slope: vec![0.0; inputs] };
            for (strip, to) in jobs {
                with_scratch(|[a, b, _]| {
                    level.run(Backward {
                        source,
                        extent,
                        strip: *strip,
                        packed: &packed,
                        zeros: &zeros,
                        output_bar,
                        wanted,
                        to: to.as_mut(),
                        sums: &mut sums,
                        scratch: (a, b),
                    });
                });
            }
            sums
        })
        .collect();
    drop(jobs);
    let mut total = |part: fn(&mut UnpoolingSums) -> &mut Vec<f32>| {
        let mut total = std::mem::take(part(&mut sums[0]));
        for more in &mut sums[1..] {
            let more = std::mem::take(part(more));
            total.iter_mut().zip(&more).for_each(|(t, m)| *t += m);
            recycle::give(more);
        }
        total
    };
    let bias =
        if wanted.weights { total(|s| &mut s.products).chunks(TAPS).map(|c| c.iter().sum()).collect() } else { vec![] };
    let slope = if source.slope.is_some() { total(|s| &mut s.slope) } else { vec![] };
    (SourceBar { values, slope }, total(|s| &mut s.weight), bias)
}

/// Sums over the strips of one group.
struct UnpoolingSums {
    /// `[in, out, 2, 2]`.
    weight: Vec<f32>,
    /// Of every product's cotangent.
    products: Vec<f32>,
    slope: Vec<f32>,
}

struct Backward<'a, 'p> {
    source: Source<'a>,
    extent: Extent,
    strip: Strip,
    packed: &'a [f32],
    zeros: &'a [f32],
    output_bar: &'a [f32],
    wanted: Wanted,
    to: Option<&'a mut Panel<'p>>,
    sums: &'a mut UnpoolingSums,
    scratch: (&'a mut Scratch, &'a mut Scratch),
}

impl Kernel for Backward<'_, '_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { source, extent, strip, packed, zeros, output_bar, wanted, to, sums, scratch } = self;
        let Strip { image, first, rows } = strip;
        let (columns, inputs, products) = (extent.columns, zeros.len(), sums.products.len());
        let bar_layout = Layout::new(products, rows, columns);
        let bars = scratch.0.get(bar_layout.len());
        separate(simd, (extent, strip), output_bar, &bar_layout, bars, &mut sums.products);
        if let Some(to) = to {
            let mut weights = packed;
            for (start, size) in blocks(inputs, S::BLOCK) {
                for row in 0..rows {
                    let from = bar_layout.rows_from(bars, 0, row, 0);
                    let place = PanelRow { panel: &mut *to, row: start, at: row * columns, n: columns };
                    convolve_row::<S, 1>(simd, size, from, weights, Some(zeros), place);
                    if let Some(slope) = source.slope {
                        for (o, slope_bar) in sums.slope.iter_mut().enumerate().skip(start).take(size) {
                            let at = (image * inputs + o) * extent.plane() + (first + row) * columns;
                            let bar = &mut to.row(o)[row * columns..][..columns];
                            *slope_bar += activate_vjp(simd, bar, &source.values[at..][..columns], slope[o]);
                        }
                    }
                }
                weights = &weights[size * bar_layout.channels..];
            }
        }
        if wanted.weights {
            let layout = Layout::new(inputs, rows, columns);
            let values = scratch.1.get(layout.len());
            load_activated(simd, &[source], extent, image, first as isize, &layout, values);
            for (m, size) in blocks(products, S::BLOCK) {
                let a = bar_layout.rows_from(bars, m, 0, 0);
                let to = &mut sums.weight[m..];
                correlate_channels(simd, (a, size), (&layout, &*values), (0, rows, columns), to, (1, products));
            }
        }
    }
}

/// Brings the fine cotangents of the strip into one plane a product, and adds up each product's.
#[inline(always)]
fn separate<S: F32>(
    simd: S,
    (extent, strip): (Extent, Strip),
    output_bar: &[f32],
    layout: &Layout,
    bars: &mut [f32],
    totals: &mut [f32],
) {
    let Strip { image, first, rows } = strip;
    let (columns, channels) = (extent.columns, totals.len() / TAPS);
    for (pair, totals) in totals.chunks_exact_mut(2).enumerate() {
        let (channel, fine_row) = (pair / 2, pair % 2);
        let (mut left, mut right) = (simd.splat(0.0), simd.splat(0.0));
        for row in 0..rows {
            let y = 2 * (first + row) + fine_row;
            let from = ((image * channels + channel) * 2 * extent.rows + y) * 2 * columns;
            let from = &output_bar[from..][..2 * columns];
            let (at, width) = (layout.at(2 * pair, row), columns.next_multiple_of(S::LANES));
            let (to_left, to_right) = bars[at..].split_at_mut(layout.channel_stride);
            let to_left = simd.cut_mut(&mut to_left[..width]).0.iter_mut();
            let to_right = simd.cut_mut(&mut to_right[..width]).0.iter_mut();
            for ((to_left, to_right), from) in to_left.zip(to_right).zip(from.chunks(2 * S::LANES)) {
                let (even, odd) = load_pairs(simd, from);
                simd.store(to_left, even);
                simd.store(to_right, odd);
                left = simd.add(left, even);
                right = simd.add(right, odd);
            }
        }
        totals[0] += simd.sum(left);
        totals[1] += simd.sum(right);
    }
}
