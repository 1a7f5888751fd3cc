//! 3×3 convolution with zero padding over several sources, and its cotangents.
#![allow(unsafe_code, reason = "strips of one output written by several threads; see each Safety note")]

use rayon::prelude::*;

use super::simd::{Kernel, Rows, Simd, blocks, convolve_row, dispatch};
use super::strip::{Layout, Scratch, Shared, activate_vjp, filled, load_activated, rows_of_strip, with_scratch};
use super::{Extent, Level, Source, SourceBar, Wanted, recycle};

const TAPS: usize = 9;

/// Groups of strips that sum their own weight gradient; fixed, so that the order of sums is.
const GROUPS: usize = 16;

/// Pixels of the block of rows whose weight gradient is summed in one go: eight channels of it fit the first-level cache.
const CORRELATED: usize = 1024;

/// Largest block of output channels in packed weights.
fn block(level: Level) -> usize {
    if level == Level::Avx512 { 8 } else { 4 }
}

/// Output `[batch, bias.len(), rows, columns]` of the convolution of all sources' channels in turn.
///
/// `weight` is `[out, in, 3, 3]`.
pub(super) fn convolve(level: Level, sources: &[Source], extent: Extent, weight: &[f32], bias: &[f32]) -> Vec<f32> {
    let inputs: usize = sources.iter().map(|s| s.channels).sum();
    let outputs = bias.len();
    assert_eq!(weight.len(), inputs * outputs * TAPS);
    let packed = pack(outputs, inputs, block(level), |o, i, tap| weight[(o * inputs + i) * TAPS + tap]);
    let rows = rows_of_strip(extent, inputs);
    filled(extent.batch * outputs * extent.plane(), |to| {
        strips(extent, rows).into_par_iter().for_each(|strip| {
            with_scratch(|scratch| {
                dispatch(
                    level,
                    &Forward {
                        sources,
                        extent,
                        strip,
                        packed: &packed,
                        bias,
                        inputs,
                        to,
                        scratch: scratch.as_mut_ptr(),
                    },
                );
            });
        });
    })
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
            (0..extent.rows).step_by(rows).map(move |first| Strip { image, first, rows: rows.min(extent.rows - first) })
        })
        .collect()
}

/// Weights in the order the kernels read them: blocks of outputs, in each `[in][tap][output of the block]`.
pub(super) fn pack(
    outputs: usize,
    inputs: usize,
    largest: usize,
    weight: impl Fn(usize, usize, usize) -> f32,
) -> Vec<f32> {
    let mut packed = Vec::with_capacity(outputs * inputs * TAPS);
    for (first, size) in blocks(outputs, largest) {
        for input in 0..inputs {
            for tap in 0..TAPS {
                packed.extend((first..first + size).map(|output| weight(output, input, tap)));
            }
        }
    }
    packed
}

struct Forward<'a> {
    sources: &'a [Source<'a>],
    extent: Extent,
    strip: Strip,
    packed: &'a [f32],
    bias: &'a [f32],
    inputs: usize,
    to: Shared,
    scratch: *mut Scratch,
}

impl Kernel for Forward<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(&self) {
        let Strip { image, first, rows } = self.strip;
        let layout = Layout::new(self.inputs, rows + 2, self.extent.columns);
        // SAFETY: this thread's scratch, borrowed for the call.
        let buffer = unsafe { &mut *self.scratch }.get(layout.len());
        unsafe { load_activated::<S>(self.sources, self.extent, image, first as isize - 1, &layout, buffer) };
        let plane = self.extent.plane();
        let outputs = self.bias.len();
        // SAFETY: the strip's rows of picture `image`, which no other strip writes.
        let to = unsafe { self.to.0.add(image * outputs * plane + first * self.extent.columns) };
        unsafe { convolve_strip::<S>(&layout, buffer, rows, self.packed, self.bias, to, plane, self.extent.columns) };
    }
}

/// All output channels of a strip whose scratch has one more row above and below.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "one inner loop, called from two kernels")]
unsafe fn convolve_strip<S: Simd>(
    layout: &Layout,
    buffer: &[f32],
    rows: usize,
    packed: &[f32],
    bias: &[f32],
    to: *mut f32,
    plane: usize,
    columns: usize,
) {
    let mut weights = packed.as_ptr();
    for (first, size) in blocks(bias.len(), S::BLOCK) {
        for row in 0..rows {
            let from = layout.rows_from(buffer, 0, row, 1);
            unsafe {
                let (bias, to) = (bias.as_ptr().add(first), to.add(first * plane + row * columns));
                match size {
                    8 => convolve_row::<S, 3, 8>(from, weights, bias, to, plane, columns),
                    4 => convolve_row::<S, 3, 4>(from, weights, bias, to, plane, columns),
                    3 => convolve_row::<S, 3, 3>(from, weights, bias, to, plane, columns),
                    2 => convolve_row::<S, 3, 2>(from, weights, bias, to, plane, columns),
                    _ => convolve_row::<S, 3, 1>(from, weights, bias, to, plane, columns),
                }
            }
        }
        weights = unsafe { weights.add(size * layout.channels * TAPS) };
    }
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
    let inputs: usize = sources.iter().map(|s| s.channels).sum();
    let outputs = weight.len() / (inputs * TAPS);
    assert_eq!(output_bar.len(), extent.batch * outputs * extent.plane());
    // The cotangent of the input is the convolution of the output's with the weights turned by 180° and transposed.
    let mut turned = Vec::with_capacity(weight.len());
    for source in sources {
        let before = turned.len() / (outputs * TAPS);
        turned.extend(pack(source.channels, outputs, block(level), |i, o, tap| {
            weight[(o * inputs + before + i) * TAPS + TAPS - 1 - tap]
        }));
    }
    let all = strips(extent, rows_of_strip(extent, inputs + outputs));
    let groups: Vec<&[Strip]> = all.chunks(all.len().div_ceil(GROUPS)).collect();
    let zeros = vec![0.0; inputs];

    let mut bars: Vec<Vec<f32>> =
        sources.iter().map(|s| recycle::take(if wanted.inputs { s.values.len() } else { 0 })).collect();
    let to: Vec<Shared> = bars.iter_mut().map(|bar| Shared(bar.as_mut_ptr())).collect();
    let mut sums: Vec<Sums> = groups
        .par_iter()
        .map(|strips| {
            let mut sums = Sums {
                weight: recycle::zeros(if wanted.weights { weight.len() } else { 0 }),
                bias: vec![0.0; if wanted.weights { outputs } else { 0 }],
                slope: vec![0.0; inputs],
            };
            for &strip in *strips {
                with_scratch(|[a, b, _]| {
                    let job = Backward {
                        sources,
                        extent,
                        strip,
                        turned: &turned,
                        zeros: &zeros,
                        output_bar: Source { values: output_bar, channels: outputs, slope: None },
                        wanted,
                        to: &to,
                        sums: &raw mut sums,
                        scratch: (a, b),
                    };
                    dispatch(level, &job);
                });
            }
            sums
        })
        .collect();
    if wanted.inputs {
        for (bar, source) in bars.iter_mut().zip(sources) {
            // SAFETY: the strips have written every value.
            unsafe { bar.set_len(source.values.len()) };
        }
    }
    let mut total = |part: fn(&mut Sums) -> &mut Vec<f32>| {
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
struct Sums {
    weight: Vec<f32>,
    bias: Vec<f32>,
    slope: Vec<f32>,
}

struct Backward<'a> {
    sources: &'a [Source<'a>],
    extent: Extent,
    strip: Strip,
    turned: &'a [f32],
    zeros: &'a [f32],
    output_bar: Source<'a>,
    wanted: Wanted,
    to: &'a [Shared],
    sums: *mut Sums,
    scratch: (*mut Scratch, *mut Scratch),
}

impl Kernel for Backward<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(&self) {
        let Strip { image, first, rows } = self.strip;
        let (extent, outputs, inputs) = (self.extent, self.output_bar.channels, self.zeros.len());
        let above = first as isize - 1;
        // SAFETY: this group's sums and this thread's scratch, borrowed for the call.
        let (sums, bars, values) = unsafe { (&mut *self.sums, &mut *self.scratch.0, &mut *self.scratch.1) };
        let bar_layout = Layout::new(outputs, rows + 2, extent.columns);
        let bars = bars.get(bar_layout.len());
        unsafe { load_activated::<S>(&[self.output_bar], extent, image, above, &bar_layout, bars) };
        if self.wanted.inputs {
            unsafe { self.inputs::<S>(&bar_layout, bars, sums) };
        }
        if self.wanted.weights {
            let layout = Layout::new(inputs, rows + 2, extent.columns);
            let values = values.get(layout.len());
            unsafe {
                load_activated::<S>(self.sources, extent, image, above, &layout, values);
                weight_strip::<S>((&bar_layout, bars), (&layout, values), rows, extent.columns, &mut sums.weight);
                bias_strip::<S>(&bar_layout, bars, rows, extent.columns, &mut sums.bias);
            }
        }
    }
}

impl Backward<'_> {
    /// Cotangents of the sources' rows, through their PReLU.
    #[inline(always)]
    unsafe fn inputs<S: Simd>(&self, layout: &Layout, bars: &[f32], sums: &mut Sums) {
        let Strip { image, first, rows } = self.strip;
        let (plane, columns) = (self.extent.plane(), self.extent.columns);
        let mut weights = self.turned.as_ptr();
        let mut channel = 0;
        for (source, to) in self.sources.iter().zip(self.to) {
            let offset = image * source.channels * plane + first * columns;
            for (start, size) in blocks(source.channels, S::BLOCK) {
                for row in 0..rows {
                    let from = layout.rows_from(bars, 0, row, 1);
                    unsafe {
                        let at = offset + start * plane + row * columns;
                        let (bias, to) = (self.zeros.as_ptr(), to.0.add(at));
                        match size {
                            8 => convolve_row::<S, 3, 8>(from, weights, bias, to, plane, columns),
                            4 => convolve_row::<S, 3, 4>(from, weights, bias, to, plane, columns),
                            3 => convolve_row::<S, 3, 3>(from, weights, bias, to, plane, columns),
                            2 => convolve_row::<S, 3, 2>(from, weights, bias, to, plane, columns),
                            _ => convolve_row::<S, 3, 1>(from, weights, bias, to, plane, columns),
                        }
                        if let Some(slope) = source.slope {
                            for o in 0..size {
                                let values = source.values.as_ptr().add(at + o * plane);
                                sums.slope[channel + start + o] +=
                                    activate_vjp::<S>(to.add(o * plane), values, slope[start + o], columns);
                            }
                        }
                    }
                }
                weights = unsafe { weights.add(size * layout.channels * TAPS) };
            }
            channel += source.channels;
        }
    }
}

/// Adds a strip's part of the weight gradient `[out, in, 3, 3]`.
#[inline(always)]
unsafe fn weight_strip<S: Simd>(
    (bar_layout, bars): (&Layout, &[f32]),
    (layout, values): (&Layout, &[f32]),
    rows: usize,
    columns: usize,
    sums: &mut [f32],
) {
    let inputs = layout.channels;
    let chunk = (CORRELATED / columns.next_multiple_of(16)).clamp(1, rows);
    for (output, size) in blocks(bar_layout.channels, S::BLOCK) {
        let mut row = 0;
        while row < rows {
            let chunk = chunk.min(rows - row);
            let a = bar_layout.rows_from(bars, output, row + 1, 0);
            for input in 0..inputs {
                for ky in 0..3 {
                    let b = layout.rows_from(values, input, row + ky, 1);
                    unsafe {
                        let b = [b.from, b.from.add(1), b.from.add(2)];
                        let to = sums.as_mut_ptr().add((output * inputs + input) * TAPS + 3 * ky);
                        correlate_block::<S>(size, a, b, layout.row_stride, chunk, columns, to, (inputs * TAPS, 1));
                    }
                }
            }
            row += chunk;
        }
    }
}

/// [`Simd::correlate`] for a block size known at run time.
#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "one inner loop, forwarded")]
pub(super) unsafe fn correlate_block<S: Simd>(
    size: usize,
    a: Rows,
    b: [*const f32; 3],
    b_row_stride: usize,
    rows: usize,
    n: usize,
    to: *mut f32,
    strides: (usize, usize),
) {
    unsafe {
        match size {
            8 => S::correlate::<8>(&a, &b, b_row_stride, rows, n, to, strides),
            4 => S::correlate::<4>(&a, &b, b_row_stride, rows, n, to, strides),
            3 => S::correlate::<3>(&a, &b, b_row_stride, rows, n, to, strides),
            2 => S::correlate::<2>(&a, &b, b_row_stride, rows, n, to, strides),
            _ => S::correlate::<1>(&a, &b, b_row_stride, rows, n, to, strides),
        }
    }
}

/// Adds a strip's part of the bias gradient: the sum of every channel's rows.
#[inline(always)]
unsafe fn bias_strip<S: Simd>(layout: &Layout, bars: &[f32], rows: usize, columns: usize, sums: &mut [f32]) {
    for (channel, sum) in sums.iter_mut().enumerate() {
        let mut total = unsafe { S::zero() };
        for row in 0..rows {
            let from = layout.rows_from(bars, channel, row + 1, 0).from;
            let mut x = 0;
            while x < columns {
                total = unsafe { S::add(total, S::load(from.add(x))) };
                x += S::LANES;
            }
        }
        *sum += unsafe { S::sum(total) };
    }
}
