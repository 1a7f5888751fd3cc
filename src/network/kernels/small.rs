//! Convolution and transposed convolution of small planes with many channels, and their cotangents: lanes run along all
//! rows of all pictures as one line ([`super::flat`]), so that a plane of 4 × 4 fills vectors too.
#![allow(unsafe_code, reason = "tasks write disjoint parts of one output; see each Safety note")]

use super::flat::{Line, Lines};
use super::product::{Block, Finish, outer, product};
use super::simd::{Simd, store_pairs};
use super::strip::{Shared, activate_vjp, filled};
use super::{Extent, Level, Source, SourceBar, Wanted, recycle};

/// Taps of the convolution.
const TAPS: usize = 9;

/// Taps of the transposed convolution: row and column of the 2×2 block.
const CORNERS: usize = 4;

/// Widest planes that are convolved here; wider ones fill their vectors row by row.
const CONVOLVED: usize = 64;

/// Widest planes whose transposed convolution is done here.
const UNPOOLED: usize = 32;

/// Whether planes of this size are convolved here.
pub(super) fn convolves(extent: Extent) -> bool {
    extent.columns <= CONVOLVED
}

/// Whether planes of this size are unpooled here.
pub(super) fn unpools(extent: Extent) -> bool {
    extent.columns <= UNPOOLED
}

/// As [`super::convolve`].
pub(super) fn convolve(level: Level, sources: &[Source], extent: Extent, weight: &[f32], bias: &[f32]) -> Vec<f32> {
    let lines = Lines::load(level, sources, extent, 3);
    let inputs = lines.channels;
    let pack = |Block { first, size, channels, to }: Block| {
        let n = channels.len() * TAPS;
        interleave(size, |output| &weight[((first + output) * inputs + channels.start) * TAPS..][..n], to);
    };
    let output = filled(extent.batch * bias.len() * extent.plane(), |to| {
        let targets = [Target { to, channels: bias.len(), source: None }];
        product::<3>(level, &lines, bias, pack, &Store { targets: &targets, slope_bars: None });
    });
    lines.release();
    output
}

/// As [`super::convolve_vjp`].
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
    let bars = Lines::load(level, &[Source { values: output_bar, channels: outputs, slope: None }], extent, 3);
    let source_bars = if wanted.inputs {
        // The convolution of the output's cotangent with the weights turned by 180° and transposed.
        let pack = |Block { first, size, channels, to }: Block| {
            for (output, to) in channels.zip(to.chunks_exact_mut(TAPS * size)) {
                turn(size, &weight[(output * inputs + first) * TAPS..][..size * TAPS], to);
            }
        };
        pulled(sources, |store| product::<3>(level, &bars, &vec![0.0; inputs], pack, store))
    } else {
        vec![SourceBar::default(); sources.len()]
    };
    let (mut weight_bar, mut bias_bar) = (vec![], vec![]);
    if wanted.weights {
        let values = Lines::load(level, sources, extent, 3);
        let stride = values.line.row_stride() as isize;
        let column = |k: usize| {
            let (row, column) = ((k % TAPS / 3) as isize - 1, (k % 3) as isize - 1);
            // Within the buffer: lines have their reach on both sides.
            values.pixel(k / TAPS).wrapping_offset(row * stride + column)
        };
        // SAFETY: the line's reach and a vector's room on both sides.
        weight_bar = unsafe { outer(level, &bars, inputs * TAPS, column) };
        bias_bar = (0..outputs).map(|o| bars.of(o).iter().sum()).collect();
        values.release();
    }
    bars.release();
    (source_bars, weight_bar, bias_bar)
}

/// As [`super::unpool`].
pub(super) fn unpool(level: Level, source: Source, extent: Extent, weight: &[f32], bias: &[f32]) -> Vec<f32> {
    let products = bias.len() * CORNERS;
    let lines = Lines::load(level, &[source], extent, 1);
    let spread: Vec<f32> = bias.iter().flat_map(|&b| [b; CORNERS]).collect();
    let pack = |Block { first, size, channels, to }: Block| {
        for (channel, to) in channels.zip(to.chunks_exact_mut(size)) {
            let from = &weight[channel * products + first..][..size];
            to.iter_mut().zip(from).for_each(|(to, &from)| *to = from);
        }
    };
    let output = filled(extent.batch * products * extent.plane(), |to| {
        product::<1>(level, &lines, &spread, pack, &Interleave { to, channels: bias.len(), extent });
    });
    lines.release();
    output
}

/// As [`super::unpool_vjp`].
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
    let outputs = products / CORNERS;
    let bars = Lines::written(Line::new(extent, 1), products, |m, line| {
        let (channel, y, x) = (m / CORNERS, m % CORNERS / 2, m % 2);
        for (row, to) in line.chunks_exact_mut(extent.columns).enumerate() {
            let (image, row) = (row / extent.rows, row % extent.rows);
            let from = ((image * outputs + channel) * 2 * extent.rows + 2 * row + y) * 2 * extent.columns;
            let from = &output_bar[from..][..2 * extent.columns];
            to.iter_mut().zip(from[x..].iter().step_by(2)).for_each(|(to, &from)| *to = from);
        }
    });
    let mut source_bar = SourceBar::default();
    if wanted.inputs {
        let pack = |Block { first, size, channels, to }: Block| {
            let n = channels.len();
            interleave(size, |input| &weight[(first + input) * products + channels.start..][..n], to);
        };
        source_bar = pulled(&[source], |store| product::<1>(level, &bars, &vec![0.0; inputs], pack, store)).remove(0);
    }
    let (mut weight_bar, mut bias_bar) = (vec![], vec![]);
    if wanted.weights {
        let values = Lines::load(level, &[source], extent, 1);
        // SAFETY: all lines have a vector's room behind them.
        weight_bar = unsafe { outer(level, &values, products, |m| bars.pixel(m)) };
        let sum = |m: usize| bars.of(m).iter().sum::<f32>();
        bias_bar = (0..outputs).map(|o| (0..CORNERS).map(|c| sum(CORNERS * o + c)).sum()).collect();
        values.release();
    }
    bars.release();
    (source_bar, weight_bar, bias_bar)
}

/// Writes `size` rows as `[value][row]`.
#[inline(always)]
fn interleave<'a>(size: usize, row: impl Fn(usize) -> &'a [f32], to: &mut [f32]) {
    if size == 8 {
        // The usual block, with its loop over rows unrolled.
        let rows: [&[f32]; 8] = std::array::from_fn(&row);
        let n = rows[0].len();
        let rows = rows.map(|row| &row[..n]);
        for (k, to) in to.as_chunks_mut::<8>().0[..n].iter_mut().enumerate() {
            for (to, row) in to.iter_mut().zip(&rows) {
                *to = row[k];
            }
        }
        return;
    }
    for at in 0..size {
        to[at..].iter_mut().step_by(size).zip(row(at)).for_each(|(to, &from)| *to = from);
    }
}

/// Writes `[channel][tap]` as `[tap, last first][channel]` for `size` channels.
#[inline(always)]
fn turn(size: usize, from: &[f32], to: &mut [f32]) {
    if let (8, [from], [to]) = (size, from.as_chunks::<{ 8 * TAPS }>().0, to.as_chunks_mut::<{ 8 * TAPS }>().0) {
        for tap in 0..TAPS {
            for channel in 0..8 {
                to[tap * 8 + channel] = from[channel * TAPS + TAPS - 1 - tap];
            }
        }
        return;
    }
    for (channel, from) in from.chunks_exact(TAPS).enumerate() {
        to[channel..].iter_mut().step_by(size).zip(from.iter().rev()).for_each(|(to, &from)| *to = from);
    }
}

/// Cotangents of the sources, whose activated ones `product` computes as outputs of one list.
fn pulled(sources: &[Source], product: impl FnOnce(&Store)) -> Vec<SourceBar> {
    let mut bars: Vec<Vec<f32>> = sources.iter().map(|s| recycle::take(s.values.len())).collect();
    let mut slopes = vec![0.0; sources.iter().map(|s| s.channels).sum()];
    let targets: Vec<Target> = bars
        .iter_mut()
        .zip(sources)
        .map(|(bar, source)| Target { to: Shared(bar.as_mut_ptr()), channels: source.channels, source: Some(*source) })
        .collect();
    product(&Store { targets: &targets, slope_bars: Some(Shared(slopes.as_mut_ptr())) });
    let mut slopes = slopes.into_iter();
    let pulled = bars.into_iter().zip(sources).map(|(mut values, source)| {
        // SAFETY: all channels have been written.
        unsafe { values.set_len(source.values.len()) };
        let slope: Vec<f32> = slopes.by_ref().take(source.channels).collect();
        SourceBar { values, slope: if source.slope.is_some() { slope } else { vec![] } }
    });
    pulled.collect()
}

/// Pictures that some outputs go to.
struct Target<'a> {
    to: Shared,
    channels: usize,
    /// The picture whose cotangent this is.
    source: Option<Source<'a>>,
}

/// Writes lines as rows of pictures; cotangents go through the PReLU of their source.
struct Store<'a> {
    targets: &'a [Target<'a>],
    /// One value an output.
    slope_bars: Option<Shared>,
}

impl Finish for Store<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(&self, line: &Line, first: usize, count: usize, lines: *const f32, stride: usize) {
        let Extent { batch, rows, columns } = line.extent;
        for output in 0..count {
            let mut channel = first + output;
            let mut targets = self.targets.iter();
            let target = loop {
                let Some(target) = targets.next() else { return };
                if channel < target.channels {
                    break target;
                }
                channel -= target.channels;
            };
            let activation = target.source.and_then(|s| Some((s.values.as_ptr(), s.slope?[channel])));
            let mut slope_bar = 0.0;
            for (image, row) in (0..batch).flat_map(|image| (0..rows).map(move |row| (image, row))) {
                let at = ((image * target.channels + channel) * rows + row) * columns;
                // SAFETY: a row of this output, which no other task writes; a line has all rows.
                unsafe {
                    let (from, to) = (lines.add(output * stride + line.at(image, row)), target.to.at(at));
                    let mut x = 0;
                    while x < columns {
                        S::store_first(to.add(x), columns - x, S::load_first(from.add(x), columns - x));
                        x += S::LANES;
                    }
                    if let Some((values, slope)) = activation {
                        slope_bar += activate_vjp::<S>(to, values.add(at), slope, columns);
                    }
                }
            }
            if let Some(slopes) = self.slope_bars {
                // SAFETY: one value an output.
                unsafe { slopes.at(first + output).write(slope_bar) };
            }
        }
    }
}

/// Writes the four products of every channel into 2×2 blocks of the finer pictures.
struct Interleave {
    to: Shared,
    channels: usize,
    /// Of the coarse pictures.
    extent: Extent,
}

impl Finish for Interleave {
    #[inline(always)]
    unsafe fn run<S: Simd>(&self, _: &Line, first: usize, count: usize, lines: *const f32, stride: usize) {
        let Extent { batch, rows, columns } = self.extent;
        for pair in 0..count / 2 {
            let (channel, y) = ((first + 2 * pair) / CORNERS, (first + 2 * pair) % CORNERS / 2);
            for (image, row) in (0..batch).flat_map(|image| (0..rows).map(move |row| (image, row))) {
                let at = ((image * self.channels + channel) * 2 * rows + 2 * row + y) * 2 * columns;
                // SAFETY: a fine row of this task's channels; lines hold all rows of all pictures.
                unsafe {
                    let left = lines.add(2 * pair * stride + (image * rows + row) * columns);
                    let to = self.to.at(at);
                    let mut x = 0;
                    while x < columns {
                        let n = columns - x;
                        let (even, odd) = (S::load_first(left.add(x), n), S::load_first(left.add(stride + x), n));
                        store_pairs::<S>(to.add(2 * x), n, even, odd);
                        x += S::LANES;
                    }
                }
            }
        }
    }
}
