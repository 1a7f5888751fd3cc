//! The two products of matrices that small planes need: weights by lines of pixels, and lines by lines over the pixels.
//!
//! Small planes come with many channels, so that the weights, not the pixels, fill the memory: tasks are blocks of
//! weights, each of which is read once, packed where it is used, and no task keeps a sum of its own.
#![allow(unsafe_code, reason = "tasks write disjoint parts of one output; see each Safety note")]

use std::ops::Range;
use std::ptr;

use rayon::prelude::*;

use super::flat::{Line, Lines};
use super::simd::{Kernel, Rows, Simd, blocks, convolve_row, dispatch, transpose};
use super::strip::{Scratch, Shared, filled, with_scratch};
use super::{Level, recycle};

/// Most outputs of one task: its lines and the input channels worked on stay in the second-level cache.
const GROUP: usize = 32;

/// Fewest, where there are so few outputs that threads would wait: a block of the inner loop.
const SMALLEST: usize = 8;

/// Values of the input channels worked on at a time, at most.
const INPUTS: usize = 72 * 1024;

/// Values of one output's weights worked on at a time, at most: eight outputs' stay in the first-level cache.
const WEIGHTS: usize = 576;

/// Columns of one task of [`outer`]; three vectors of 16.
const PANEL: usize = 48;

/// Pixels of a panel worked on at a time, about: panel and sums stay in the first-level cache.
const PIXELS: usize = 128;

/// Where the lines of a product go.
pub(super) trait Finish: Sync {
    /// Takes the lines of outputs `first..first + count`, `stride` apart.
    ///
    /// # Safety
    /// The processor must have the instruction set of `S`.
    unsafe fn run<S: Simd>(&self, line: &Line, first: usize, count: usize, lines: *const f32, stride: usize);
}

/// A block of weights to be written as `[channel][tap][output]`.
pub(super) struct Block<'a> {
    /// First output.
    pub(super) first: usize,
    /// Outputs.
    pub(super) size: usize,
    /// Input channels.
    pub(super) channels: Range<usize>,
    /// Where to write.
    pub(super) to: &'a mut [f32],
}

/// `SIDE × SIDE` taps of all channels of `lines` for every output, with weights as `pack` gives them; starts at `bias`.
pub(super) fn product<const SIDE: usize>(
    level: Level,
    lines: &Lines,
    bias: &[f32],
    pack: impl Fn(Block) + Sync,
    finish: &impl Finish,
) {
    // A result does not depend on its group: how outputs are grouped is a matter of speed alone.
    let size = (bias.len() / 16).next_multiple_of(SMALLEST).clamp(SMALLEST, GROUP);
    (0..bias.len().div_ceil(size)).into_par_iter().for_each(|group| {
        with_scratch(|[results, weights, _]| {
            let first = group * size;
            let count = size.min(bias.len() - first);
            let scratch = (&raw mut *results, &raw mut *weights);
            dispatch(level, &Group::<SIDE, _, _> { lines, bias, first, count, pack: &pack, finish, scratch });
        });
    });
}

struct Group<'a, const SIDE: usize, P, F> {
    lines: &'a Lines,
    bias: &'a [f32],
    first: usize,
    count: usize,
    pack: &'a P,
    finish: &'a F,
    scratch: (*mut Scratch, *mut Scratch),
}

impl<const SIDE: usize, P: Fn(Block), F: Finish> Kernel for Group<'_, SIDE, P, F> {
    #[inline(always)]
    unsafe fn run<S: Simd>(&self) {
        let (channels, n) = (self.lines.channels, self.lines.line.len());
        let stride = 16 * (n.div_ceil(16) | 1);
        let step = (INPUTS / self.lines.stride).clamp(8, WEIGHTS / (SIDE * SIDE)).min(channels);
        // SAFETY: this thread's scratch, borrowed for the call.
        let (results, weights) = unsafe { (&mut *self.scratch.0, &mut *self.scratch.1) };
        let results = results.get(self.count * stride);
        let weights = weights.get(step * SIDE * SIDE * S::BLOCK);
        for channel in (0..channels).step_by(step) {
            let end = channels.min(channel + step);
            let from = self.lines.rows(channel, end - channel);
            for (output, size) in blocks(self.count, S::BLOCK) {
                let to = &mut weights[..(end - channel) * SIDE * SIDE * size];
                (self.pack)(Block { first: self.first + output, size, channels: channel..end, to });
                let weights = weights.as_ptr();
                let bias = if channel == 0 { self.bias[self.first + output..].as_ptr() } else { ptr::null() };
                // SAFETY: lines have their reach and a vector's room on both sides; `size` results of `stride ≥ n`.
                unsafe {
                    let to = results.as_mut_ptr().add(output * stride);
                    match size {
                        8 => convolve_row::<S, SIDE, 8>(from, weights, bias, to, stride, n),
                        4 => convolve_row::<S, SIDE, 4>(from, weights, bias, to, stride, n),
                        3 => convolve_row::<S, SIDE, 3>(from, weights, bias, to, stride, n),
                        2 => convolve_row::<S, SIDE, 2>(from, weights, bias, to, stride, n),
                        _ => convolve_row::<S, SIDE, 1>(from, weights, bias, to, stride, n),
                    }
                }
            }
        }
        unsafe { self.finish.run::<S>(&self.lines.line, self.first, self.count, results.as_ptr(), stride) };
    }
}

/// The matrix `[a.channels, columns]` of the products of each line of `a` with each column, summed over the pixels.
///
/// # Safety
/// `column(c)` must point to values that are readable, and finite or of a picture, from the first pixel of a line of `a`
/// to a vector behind its last.
pub(super) unsafe fn outer(
    level: Level,
    a: &Lines,
    columns: usize,
    column: impl Fn(usize) -> *const f32 + Sync,
) -> Vec<f32> {
    let n = a.line.len();
    let packed = filled(a.channels * n, |to| {
        blocks(a.channels, block(level)).collect::<Vec<_>>().into_par_iter().for_each(|(first, size)| {
            for row in 0..size {
                for (pixel, &value) in a.of(first + row).iter().enumerate() {
                    // SAFETY: this block's part of the matrix.
                    unsafe { to.at(first * n + pixel * size + row).write(value) };
                }
            }
        });
    });
    let products = filled(a.channels * columns, |to| {
        (0..columns.div_ceil(PANEL)).into_par_iter().for_each(|panel| {
            with_scratch(|[scratch, ..]| {
                let (first, rows) = (panel * PANEL, a.channels);
                let count = PANEL.min(columns - first);
                let (packed, column, scratch) = (&packed[..], &column, &raw mut *scratch);
                dispatch(level, &Panel { packed, rows, n, columns, first, count, column, to, scratch });
            });
        });
    });
    recycle::give(packed);
    products
}

/// Largest block of rows.
fn block(level: Level) -> usize {
    if level == Level::Avx512 { 8 } else { 4 }
}

struct Panel<'a, C> {
    /// `[block][pixel][row of the block]`.
    packed: &'a [f32],
    rows: usize,
    n: usize,
    columns: usize,
    first: usize,
    count: usize,
    column: &'a C,
    to: Shared,
    scratch: *mut Scratch,
}

impl<C: Fn(usize) -> *const f32> Kernel for Panel<'_, C> {
    #[inline(always)]
    unsafe fn run<S: Simd>(&self) {
        let step = self.n.div_ceil(self.n.div_ceil(PIXELS)).next_multiple_of(16);
        let last = self.first + self.count - 1;
        // SAFETY: this thread's scratch, borrowed for the call.
        let panel = unsafe { &mut *self.scratch }.get(step * PANEL).as_mut_ptr();
        let zeros = [0.0f32; 8];
        for pixel in (0..self.n).step_by(step) {
            let pixels = step.min(self.n - pixel);
            for x in (0..self.count).step_by(S::LANES) {
                for p in (0..pixels).step_by(S::LANES) {
                    // SAFETY: columns are readable to a vector behind the last pixel, the panel has room for whole squares.
                    unsafe {
                        let from = |c: usize| (self.column)((self.first + x + c).min(last)).add(pixel + p);
                        transpose::<S>(from, panel.add(p * PANEL + x), PANEL);
                    }
                }
            }
            for (row, size) in blocks(self.rows, S::BLOCK) {
                let weights = self.packed[row * self.n + pixel * size..][..pixels * size].as_ptr();
                let bias = if pixel == 0 { zeros.as_ptr() } else { ptr::null() };
                for x in (0..self.count).step_by(3 * S::LANES) {
                    let left = self.count - x;
                    // SAFETY: the panel's columns of `size` rows, which no other panel writes.
                    unsafe {
                        let from = Rows { from: panel.add(x), channel_stride: PANEL, row_stride: 0, channels: pixels };
                        let to = self.to.at(row * self.columns + self.first + x);
                        let n = left.min(3 * S::LANES);
                        match size {
                            8 => convolve_row::<S, 1, 8>(from, weights, bias, to, self.columns, n),
                            4 => convolve_row::<S, 1, 4>(from, weights, bias, to, self.columns, n),
                            3 => convolve_row::<S, 1, 3>(from, weights, bias, to, self.columns, n),
                            2 => convolve_row::<S, 1, 2>(from, weights, bias, to, self.columns, n),
                            _ => convolve_row::<S, 1, 1>(from, weights, bias, to, self.columns, n),
                        }
                    }
                }
            }
        }
    }
}
