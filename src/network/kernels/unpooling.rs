//! Transposed 2×2 convolution with stride 2, and its cotangents: a product of matrices per pixel, whose four results a
//! channel are interleaved into the finer picture.
#![allow(unsafe_code, reason = "strips of one output written by several threads; see each Safety note")]

use rayon::prelude::*;

use super::convolution::{Strip, correlate_block, strips};
use super::simd::{Kernel, Rows, Simd, blocks, convolve_row, dispatch, load_pairs, store_pairs};
use super::strip::{Layout, Scratch, Shared, activate_vjp, filled, load_activated, rows_of_strip, with_scratch};
use super::{Extent, Level, Source, SourceBar, Wanted, recycle};

/// Taps: row and column of the 2×2 block.
const TAPS: usize = 4;

/// Groups of strips that sum their own weight gradient.
const GROUPS: usize = 16;

fn block(level: Level) -> usize {
    if level == Level::Avx512 { 8 } else { 4 }
}

/// `[block][k][m of the block]` of the matrix `weight(m, k)`.
fn pack(m: usize, k: usize, largest: usize, weight: impl Fn(usize, usize) -> f32) -> Vec<f32> {
    let mut packed = Vec::with_capacity(m * k);
    for (first, size) in blocks(m, largest) {
        for k in 0..k {
            packed.extend((first..first + size).map(|m| weight(m, k)));
        }
    }
    packed
}

/// One row of `O` products for a block size known at run time.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "one inner loop, forwarded")]
unsafe fn product_row<S: Simd>(
    size: usize,
    from: Rows,
    weights: *const f32,
    bias: *const f32,
    to: *mut f32,
    plane: usize,
    n: usize,
) {
    unsafe {
        match size {
            8 => convolve_row::<S, 1, 8>(from, weights, bias, to, plane, n),
            4 => convolve_row::<S, 1, 4>(from, weights, bias, to, plane, n),
            3 => convolve_row::<S, 1, 3>(from, weights, bias, to, plane, n),
            2 => convolve_row::<S, 1, 2>(from, weights, bias, to, plane, n),
            _ => convolve_row::<S, 1, 1>(from, weights, bias, to, plane, n),
        }
    }
}

/// Output `[batch, bias.len(), 2 rows, 2 columns]`; `weight` is `[in, out, 2, 2]`, `extent` that of the source.
pub(super) fn unpool(level: Level, source: Source, extent: Extent, weight: &[f32], bias: &[f32]) -> Vec<f32> {
    let products = bias.len() * TAPS;
    assert_eq!(weight.len(), source.channels * products);
    let packed = pack(products, source.channels, block(level), |m, k| weight[k * products + m]);
    let spread: Vec<f32> = bias.iter().flat_map(|&b| [b; TAPS]).collect();
    let rows = rows_of_strip(extent, source.channels);
    filled(extent.batch * products * extent.plane(), |to| {
        strips(extent, rows).into_par_iter().for_each(|strip| {
            with_scratch(|[a, b, _]| {
                let job = Forward { source, extent, strip, packed: &packed, bias: &spread, to, scratch: (a, b) };
                dispatch(level, &job);
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
    to: Shared,
    scratch: (*mut Scratch, *mut Scratch),
}

impl Kernel for Forward<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(&self) {
        let Strip { image, first, rows } = self.strip;
        let columns = self.extent.columns;
        let products = self.bias.len();
        let layout = Layout::new(self.source.channels, rows, columns);
        // SAFETY: this thread's scratch, borrowed for the call.
        let (buffer, row_products) = unsafe { (&mut *self.scratch.0, &mut *self.scratch.1) };
        let buffer = buffer.get(layout.len());
        unsafe { load_activated::<S>(&[self.source], self.extent, image, first as isize, &layout, buffer) };
        let width = columns.next_multiple_of(16);
        let row_products = row_products.get(8 * width);
        let mut weights = self.packed.as_ptr();
        for (m, size) in blocks(products, S::BLOCK) {
            for row in 0..rows {
                let from = layout.rows_from(buffer, 0, row, 0);
                let bias = self.bias[m..].as_ptr();
                unsafe { product_row::<S>(size, from, weights, bias, row_products.as_mut_ptr(), width, columns) };
                // Products come in pairs (left, right) of one fine row.
                for pair in 0..size / 2 {
                    let (channel, fine_row) = ((m + 2 * pair) / TAPS, (m + 2 * pair) % TAPS / 2);
                    let at =
                        ((image * products / TAPS + channel) * 2 * self.extent.rows + 2 * (first + row) + fine_row)
                            * 2
                            * columns;
                    // SAFETY: the strip's rows, which no other strip writes.
                    unsafe {
                        let left = row_products.as_ptr().add(2 * pair * width);
                        let to = self.to.0.add(at);
                        let mut x = 0;
                        while x < columns {
                            let (even, odd) = (S::load(left.add(x)), S::load(left.add(width + x)));
                            store_pairs::<S>(to.add(2 * x), columns - x, even, odd);
                            x += S::LANES;
                        }
                    }
                }
            }
            weights = unsafe { weights.add(size * layout.channels) };
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
    let packed = pack(inputs, products, block(level), |m, k| weight[m * products + k]);
    let all = strips(extent, rows_of_strip(extent, inputs + products));
    let groups: Vec<&[Strip]> = all.chunks(all.len().div_ceil(GROUPS)).collect();
    let zeros = vec![0.0; inputs];
    let n = if wanted.inputs { source.values.len() } else { 0 };
    let mut sums = Vec::new();
    let values = filled(n, |to| {
        sums = groups
            .par_iter()
            .map(|strips| {
                let n = if wanted.weights { weight.len() } else { 0 };
                let mut sums =
                    Sums { weight: recycle::zeros(n), products: vec![0.0; products], slope: vec![0.0; inputs] };
                for &strip in *strips {
                    with_scratch(|[a, b, _]| {
                        let job = Backward {
                            source,
                            extent,
                            strip,
                            packed: &packed,
                            zeros: &zeros,
                            output_bar,
                            wanted,
                            to,
                            sums: &raw mut sums,
                            scratch: (a, b),
                        };
                        dispatch(level, &job);
                    });
                }
                sums
            })
            .collect();
    });
    let mut total = |part: fn(&mut Sums) -> &mut Vec<f32>| {
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
struct Sums {
    /// `[in, out, 2, 2]`.
    weight: Vec<f32>,
    /// Of every product's cotangent.
    products: Vec<f32>,
    slope: Vec<f32>,
}

struct Backward<'a> {
    source: Source<'a>,
    extent: Extent,
    strip: Strip,
    packed: &'a [f32],
    zeros: &'a [f32],
    output_bar: &'a [f32],
    wanted: Wanted,
    to: Shared,
    sums: *mut Sums,
    scratch: (*mut Scratch, *mut Scratch),
}

impl Kernel for Backward<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(&self) {
        let Strip { image, first, rows } = self.strip;
        let (extent, columns, inputs) = (self.extent, self.extent.columns, self.zeros.len());
        // SAFETY: this group's sums and this thread's scratch, borrowed for the call.
        let (sums, bars, values) = unsafe { (&mut *self.sums, &mut *self.scratch.0, &mut *self.scratch.1) };
        let bar_layout = Layout::new(sums.products.len(), rows, columns);
        let bars = bars.get(bar_layout.len());
        unsafe { self.separate::<S>(&bar_layout, bars, &mut sums.products) };
        if self.wanted.inputs {
            let mut weights = self.packed.as_ptr();
            for (start, size) in blocks(inputs, S::BLOCK) {
                for row in 0..rows {
                    let from = bar_layout.rows_from(bars, 0, row, 0);
                    let at = (image * inputs + start) * extent.plane() + (first + row) * columns;
                    // SAFETY: the strip's rows, which no other strip writes.
                    unsafe {
                        let to = self.to.0.add(at);
                        product_row::<S>(size, from, weights, self.zeros.as_ptr(), to, extent.plane(), columns);
                        if let Some(slope) = self.source.slope {
                            for o in 0..size {
                                let values = self.source.values.as_ptr().add(at + o * extent.plane());
                                sums.slope[start + o] +=
                                    activate_vjp::<S>(to.add(o * extent.plane()), values, slope[start + o], columns);
                            }
                        }
                    }
                }
                weights = unsafe { weights.add(size * bar_layout.channels) };
            }
        }
        if self.wanted.weights {
            let layout = Layout::new(inputs, rows, columns);
            let values = values.get(layout.len());
            unsafe { load_activated::<S>(&[self.source], extent, image, first as isize, &layout, values) };
            let products = bar_layout.channels;
            // Three inputs a time; where fewer are left the last one is computed again into a bin.
            let mut bin = [0.0f32; 8 * 3];
            for (m, size) in blocks(products, S::BLOCK) {
                let a = bar_layout.rows_from(bars, m, 0, 0);
                for input in (0..inputs).step_by(3) {
                    let b = [0, 1, 2].map(|t| layout.rows_from(values, (input + t).min(inputs - 1), 0, 0).from);
                    unsafe {
                        if input + 3 <= inputs {
                            let to = sums.weight.as_mut_ptr().add(input * products + m);
                            correlate_block::<S>(size, a, b, layout.row_stride, rows, columns, to, (1, products));
                        } else {
                            bin.fill(0.0);
                            correlate_block::<S>(
                                size,
                                a,
                                b,
                                layout.row_stride,
                                rows,
                                columns,
                                bin.as_mut_ptr(),
                                (3, 1),
                            );
                            for t in 0..inputs - input {
                                for o in 0..size {
                                    sums.weight[(input + t) * products + m + o] += bin[3 * o + t];
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

impl Backward<'_> {
    /// Brings the fine cotangents of the strip into one plane a product, and adds up each product's.
    #[inline(always)]
    unsafe fn separate<S: Simd>(&self, layout: &Layout, bars: &mut [f32], totals: &mut [f32]) {
        let Strip { image, first, rows } = self.strip;
        let (columns, channels) = (self.extent.columns, totals.len() / TAPS);
        assert!(bars.len() >= layout.len());
        for pair in 0..totals.len() / 2 {
            let (channel, fine_row) = (pair / 2, pair % 2);
            // SAFETY: two columns of the finer picture for each of this one's; rows of the layout, which fits.
            unsafe {
                let (mut left, mut right) = (S::zero(), S::zero());
                for row in 0..rows {
                    let y = 2 * (first + row) + fine_row;
                    let from = ((image * channels + channel) * 2 * self.extent.rows + y) * 2 * columns;
                    let from = self.output_bar[from..][..2 * columns].as_ptr();
                    let to = bars.as_mut_ptr();
                    let mut x = 0;
                    while x < columns {
                        let (even, odd) = load_pairs::<S>(from.add(2 * x), columns - x);
                        S::store(to.add(layout.at(2 * pair, row) + x), even);
                        S::store(to.add(layout.at(2 * pair + 1, row) + x), odd);
                        left = S::add(left, even);
                        right = S::add(right, odd);
                        x += S::LANES;
                    }
                }
                totals[2 * pair] += S::sum(left);
                totals[2 * pair + 1] += S::sum(right);
            }
        }
    }
}
