//! Scratch rows: a strip of a picture's planes, activated, with a border of zeros around every row.
#![allow(unsafe_code, reason = "vector loads and stores within buffers whose size is checked on entry")]

use std::cell::RefCell;

use super::simd::{Rows, Simd};
use super::{Extent, Source, recycle};

/// Zeros left of every row; the next row's are the zeros on the right.
pub(super) const PAD: usize = 16;

/// Readable values beyond the last row, for vectors that reach over the end.
const SLACK: usize = 128;

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
    pub(super) fn rows_from(&self, buffer: &[f32], channel: usize, row: usize, left: usize) -> Rows {
        assert!(buffer.len() >= self.len() && left <= PAD);
        Rows {
            from: buffer[self.at(channel, row) - left..].as_ptr(),
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
///
/// # Safety
/// The processor must have the instruction set of `S`.
#[inline(always)]
pub(super) unsafe fn load_activated<S: Simd>(
    sources: &[Source],
    extent: Extent,
    image: usize,
    first: isize,
    layout: &Layout,
    buffer: &mut [f32],
) {
    assert!(buffer.len() >= layout.len());
    let n = extent.columns;
    let mut channel = 0;
    for source in sources {
        let planes = &source.values[image * source.channels * extent.plane()..][..source.channels * extent.plane()];
        for c in 0..source.channels {
            for row in 0..layout.rows {
                let at = layout.at(channel, row);
                // SAFETY: `at − PAD .. at + n rounded up` is within the layout, which fits the buffer; the plane has
                // `extent.plane()` values.
                unsafe {
                    let to = buffer.as_mut_ptr().add(at);
                    zero::<S>(to.sub(PAD), PAD);
                    let y = first + row as isize;
                    if y < 0 || y >= extent.rows as isize {
                        zero::<S>(to, n.next_multiple_of(16));
                        continue;
                    }
                    let from = planes.as_ptr().add(c * extent.plane() + y as usize * n);
                    match source.slope {
                        Some(slope) => {
                            let slope = S::splat(slope[c]);
                            let mut x = 0;
                            while x + S::LANES <= n {
                                S::store(to.add(x), activate::<S>(S::load(from.add(x)), slope));
                                x += S::LANES;
                            }
                            if x < n {
                                S::store(to.add(x), activate::<S>(S::load_first(from.add(x), n - x), slope));
                            }
                        }
                        None => copy::<S>(from, to, n),
                    }
                    if S::LANES < 16 {
                        zero::<S>(
                            to.add(n.next_multiple_of(S::LANES)),
                            n.next_multiple_of(16) - n.next_multiple_of(S::LANES),
                        );
                    }
                }
            }
            // SAFETY: the slack behind a channel's last row is within the buffer.
            unsafe {
                zero::<S>(buffer.as_mut_ptr().add(layout.at(channel, layout.rows - 1) + n.next_multiple_of(16)), PAD)
            };
            channel += 1;
        }
    }
}

/// Writes zeros over `n` values rounded up to vectors.
#[inline(always)]
unsafe fn zero<S: Simd>(to: *mut f32, n: usize) {
    let mut x = 0;
    while x < n {
        unsafe { S::store(to.add(x), S::zero()) };
        x += S::LANES;
    }
}

/// Copies `n` values, zeros up to the full vector.
#[inline(always)]
unsafe fn copy<S: Simd>(from: *const f32, to: *mut f32, n: usize) {
    let mut x = 0;
    unsafe {
        while x + S::LANES <= n {
            S::store(to.add(x), S::load(from.add(x)));
            x += S::LANES;
        }
        if x < n {
            S::store(to.add(x), S::load_first(from.add(x), n - x));
        }
    }
}

/// PReLU.
///
/// # Safety
/// The processor must have the instruction set of `S`.
#[inline(always)]
pub(super) unsafe fn activate<S: Simd>(x: S::V, slope: S::V) -> S::V {
    unsafe { S::fma(slope, S::below_zero(x), S::above_zero(x)) }
}

/// Turns the cotangent of an activated row into that of the row before its PReLU, in place; returns the cotangent of
/// the slope.
///
/// # Safety
/// The processor must have the instruction set of `S`; `bar` and `values` must have `n` values.
#[inline(always)]
pub(super) unsafe fn activate_vjp<S: Simd>(bar: *mut f32, values: *const f32, slope: f32, n: usize) -> f32 {
    unsafe {
        let (one, slope) = (S::splat(1.0), S::splat(slope));
        let mut slope_bar = S::zero();
        let mut x = 0;
        while x + S::LANES <= n {
            let (b, v) = (S::load(bar.add(x)), S::load(values.add(x)));
            slope_bar = S::fma(b, S::below_zero(v), slope_bar);
            S::store(bar.add(x), S::mul(b, S::choose(v, one, slope)));
            x += S::LANES;
        }
        if x < n {
            let (b, v) = (S::load_first(bar.add(x), n - x), S::load_first(values.add(x), n - x));
            slope_bar = S::fma(b, S::below_zero(v), slope_bar);
            S::store_first(bar.add(x), n - x, S::mul(b, S::choose(v, one, slope)));
        }
        S::sum(slope_bar)
    }
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
    SCRATCH.with_borrow_mut(work)
}

/// A pointer into an output of which every strip writes its own rows.
#[derive(Clone, Copy)]
pub(super) struct Shared(pub(super) *mut f32);

impl Shared {
    /// The value number `n`; a closure that calls this captures all of `self`, which threads may share.
    ///
    /// # Safety
    /// The output must have more than `n` values, or `n` where nothing is written.
    pub(super) unsafe fn at(self, n: usize) -> *mut f32 {
        unsafe { self.0.add(n) }
    }
}

// SAFETY: strips write disjoint rows; whoever makes one sees to that.
unsafe impl Send for Shared {}
// SAFETY: as above.
unsafe impl Sync for Shared {}

/// A vector of `n` values that `fill` writes, every one of them.
pub(super) fn filled(n: usize, fill: impl FnOnce(Shared)) -> Vec<f32> {
    let mut values = recycle::take(n);
    fill(Shared(values.as_mut_ptr()));
    // SAFETY: `fill` has written all `n`.
    unsafe { values.set_len(n) };
    values
}
