//! Scratch rows: a strip of a picture's planes, activated, with a border of zeros around every row.

use std::cell::RefCell;

use super::inner::Rows;
use super::{Extent, Source, recycle};
use isoplanat_base::math::simd::F32;

/// Zeros left of every row; the next row's are the zeros on the right.
pub(super) const PAD: usize = 16;

/// Readable values beyond the last row, for vectors that reach over the end.
const SLACK: usize = 128;

/// Most values that a thread keeps in each scratch buffer from one strip to the next: 16 MiB.
const MOST: usize = 1 << 22;

/// Where rows lie in a scratch buffer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    /// Distance of rows: left zeros and the width rounded up.
    pub(super) row_stride: usize,
    /// Distance of channels; an odd number of cache lines, so that channels do not share a cache set.
    pub(super) channel_stride: usize,
    /// Rows of a channel.
    pub(super) rows: usize,
    /// Channels.
    pub(super) channels: usize,
}

impl Layout {
    /// Room for `channels` × `rows` × `columns`.
    pub(super) fn new(channels: usize, rows: usize, columns: usize) -> Self {
        let row_stride = columns.next_multiple_of(16) + PAD;
        let lines = row_stride * rows / 16;
        Self { row_stride, channel_stride: 16 * (lines | 1), rows, channels }
    }

    /// Values in the buffer.
    pub(super) fn len(&self) -> usize {
        self.channels * self.channel_stride + SLACK
    }

    /// Where `channel`, `row`, column 0 lies.
    pub(super) fn at(&self, channel: usize, row: usize) -> usize {
        channel * self.channel_stride + row * self.row_stride + PAD
    }

    /// Rows to read from `buffer` from `channel`, `row`, and column −`left` on.
    pub(super) fn rows_from<'a>(&self, buffer: &'a [f32], channel: usize, row: usize, left: usize) -> Rows<'a> {
        Rows {
            from: &buffer[self.at(channel, row) - left..],
            channel_stride: self.channel_stride,
            row_stride: self.row_stride,
            channels: self.channels,
        }
    }
}

/// Rows of a strip such that the scratch of `channels` stays within half the second-level cache.
pub(super) fn rows_of_strip(extent: Extent, channels: usize) -> usize {
    const BUDGET: usize = 640 * 1024 / 4;
    let row = channels * (extent.columns.next_multiple_of(16) + PAD);
    let rows = (BUDGET / row).saturating_sub(2);
    // At least eight strips where rows allow it, so that threads share the work.
    let shared = (extent.batch * extent.rows).div_ceil(8);
    rows.min(shared).clamp(2, 32).min(extent.rows)
}

/// Copies rows `first..first + layout.rows` (those outside the picture are zero) of picture `image` of all sources into
/// `buffer`, through their PReLU, with zeros around.
#[inline(always)]
pub(super) fn load_activated<S: F32>(
    simd: S,
    sources: &[Source],
    extent: Extent,
    image: usize,
    first: isize,
    layout: &Layout,
    buffer: &mut [f32],
) {
    let n = extent.columns;
    let width = n.next_multiple_of(16);
    let mut channel = 0;
    for source in sources {
        let planes = &source.values[image * source.channels * extent.plane()..][..source.channels * extent.plane()];
        for (c, plane) in planes.chunks_exact(extent.plane()).enumerate() {
            for row in 0..layout.rows {
                let (left, to) = buffer[layout.at(channel, row) - PAD..][..PAD + width].split_at_mut(PAD);
                left.fill(0.0);
                let y = first + row as isize;
                if y < 0 || y >= extent.rows as isize {
                    to.fill(0.0);
                    continue;
                }
                let from = &plane[y as usize * n..][..n];
                match source.slope {
                    Some(slope) => activate_row(simd, from, to, slope[c]),
                    None => {
                        let (to, behind) = to.split_at_mut(n);
                        to.copy_from_slice(from);
                        behind.fill(0.0);
                    }
                }
            }
            // The slack behind the channel's last row.
            buffer[layout.at(channel, layout.rows - 1) + width..][..PAD].fill(0.0);
            channel += 1;
        }
    }
}

/// A row through its PReLU, with zeros behind it.
#[inline(always)]
fn activate_row<S: F32>(simd: S, from: &[f32], to: &mut [f32], slope: f32) {
    let slope = simd.splat(slope);
    let (whole, rest) = simd.cut(from);
    let (to, behind) = simd.cut_mut(to).0.split_at_mut(whole.len());
    for (to, from) in to.iter_mut().zip(whole) {
        simd.store(to, activate(simd, simd.load(from), slope));
    }
    let mut last = if rest.is_empty() { simd.splat(0.0) } else { activate(simd, simd.load_first(rest), slope) };
    for to in behind {
        simd.store(to, last);
        last = simd.splat(0.0);
    }
}

/// PReLU.
#[inline(always)]
pub(super) fn activate<S: F32>(simd: S, x: S::V, slope: S::V) -> S::V {
    simd.fma(slope, simd.below_zero(x), simd.above_zero(x))
}

/// Turns the cotangent of an activated row into that of the row before its PReLU, in place; returns the cotangent of
/// the slope.
#[inline(always)]
pub(super) fn activate_vjp<S: F32>(simd: S, bar: &mut [f32], values: &[f32], slope: f32) -> f32 {
    let slope = simd.splat(slope);
    let mut slope_bar = simd.splat(0.0);
    let (bars, bars_rest) = simd.cut_mut(bar);
    let (values, values_rest) = simd.cut(values);
    for (bar, value) in bars.iter_mut().zip(values) {
        let pulled = pull(simd, simd.load(bar), simd.load(value), slope, &mut slope_bar);
        simd.store(bar, pulled);
    }
    if !bars_rest.is_empty() {
        let pulled = pull(simd, simd.load_first(bars_rest), simd.load_first(values_rest), slope, &mut slope_bar);
        simd.store_first(bars_rest, pulled);
    }
    simd.sum(slope_bar)
}

/// Cotangent of `value` before its PReLU; adds to that of the slope.
#[inline(always)]
pub(super) fn pull<S: F32>(simd: S, bar: S::V, value: S::V, slope: S::V, slope_bar: &mut S::V) -> S::V {
    *slope_bar = simd.fma(bar, simd.below_zero(value), *slope_bar);
    simd.mul(bar, simd.choose(value, simd.splat(1.0), slope))
}

/// A buffer whose values start at a cache line; keeps its memory for the next strip.
#[derive(Default)]
pub(super) struct Scratch {
    memory: Vec<f32>,
}

impl Scratch {
    /// `n` values, whatever they were.
    pub(super) fn get(&mut self, n: usize) -> &mut [f32] {
        if self.memory.len() < n + 16 {
            self.memory.resize(n + 16, 0.0);
        }
        let offset = self.memory.as_ptr().align_offset(64).min(16);
        &mut self.memory[offset..offset + n]
    }
}

thread_local! {
    static SCRATCH: RefCell<[Scratch; 3]> = RefCell::default();
}

/// Gives `work` this thread's scratch buffers. `work` must not use rayon.
pub(super) fn with_scratch<R>(work: impl FnOnce(&mut [Scratch; 3]) -> R) -> R {
    SCRATCH.with_borrow_mut(|buffers| {
        let result = work(buffers);
        for buffer in buffers.iter_mut().filter(|buffer| buffer.memory.len() > MOST) {
            *buffer = Scratch::default();
        }
        result
    })
}

/// A vector of `n` values that `fill` writes, every one of them: they are whatever they were before.
pub(super) fn filled(n: usize, fill: impl FnOnce(&mut [f32])) -> Vec<f32> {
    let mut values = recycle::take(n);
    fill(&mut values);
    values
}
