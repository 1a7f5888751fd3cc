//! The two products of matrices that small planes need: weights by lines of pixels, and lines by lines over the pixels.
//!
//! Small planes come with many channels, so that the weights, not the pixels, fill the memory: tasks are blocks of
//! weights, each of which is read once, packed where it is used, and no task keeps a sum of its own.

use std::ops::Range;

use rayon::prelude::*;

use super::flat::{Line, Lines};
use super::inner::{PanelRow, Rows, blocks, convolve_row, largest, transpose};
use super::panel::Panel;
use super::strip::{Scratch, filled, with_scratch};
use super::{Level, recycle};
use isoplanat_base::math::simd::{F32, Kernel, Simd};

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

/// Where the lines of one group's outputs go.
pub(super) trait Finish: Send {
    /// Takes the lines, `stride` apart.
    fn run<S: F32>(&mut self, simd: S, line: &Line, lines: &[f32], stride: usize);
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

/// Outputs that [`product`] works on in one task.
///
/// A result does not depend on its group: how outputs are grouped is a matter of speed alone.
pub(super) fn group(outputs: usize) -> usize {
    (outputs / 16).next_multiple_of(SMALLEST).clamp(SMALLEST, GROUP)
}

/// `SIDE × SIDE` taps of all channels of `lines` for every output, with weights as `pack` gives them; starts at `bias`.
/// `groups` has one place for the lines of each [`group`].
pub(super) fn product<const SIDE: usize>(
    level: Level,
    lines: &Lines,
    bias: &[f32],
    pack: impl Fn(Block) + Sync,
    groups: Vec<impl Finish>,
) {
    let size = group(bias.len());
    assert_eq!(groups.len(), bias.len().div_ceil(size));
    groups.into_par_iter().zip(bias.par_chunks(size)).enumerate().for_each(|(group, (finish, bias))| {
        with_scratch(|[results, weights, _]| {
            let scratch = (results, weights);
            level.run(Group::<SIDE, _, _> { lines, bias, first: group * size, pack: &pack, finish, scratch });
        });
    });
}

struct Group<'a, const SIDE: usize, P, F> {
    lines: &'a Lines,
    bias: &'a [f32],
    first: usize,
    pack: &'a P,
    finish: F,
    scratch: (&'a mut Scratch, &'a mut Scratch),
}

impl<const SIDE: usize, P: Fn(Block), F: Finish> Kernel for Group<'_, SIDE, P, F> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        let (channels, n) = (self.lines.channels, self.lines.line.len());
        let stride = 16 * (n.div_ceil(16) | 1);
        let step = (INPUTS / self.lines.stride).clamp(8, WEIGHTS / (SIDE * SIDE)).min(channels);
        let results = self.scratch.0.get(self.bias.len() * stride);
        let weights = self.scratch.1.get(step * SIDE * SIDE * S::BLOCK);
        let mut panel = Panel::whole(results, stride);
        for channel in (0..channels).step_by(step) {
            let end = channels.min(channel + step);
            let from = self.lines.rows(channel, end - channel);
            for (output, size) in blocks(self.bias.len(), S::BLOCK) {
                let weights = &mut weights[..(end - channel) * SIDE * SIDE * size];
                (self.pack)(Block { first: self.first + output, size, channels: channel..end, to: &mut *weights });
                let bias = (channel == 0).then(|| &self.bias[output..][..size]);
                let place = PanelRow { panel: &mut panel, row: output, at: 0, n };
                convolve_row::<S, SIDE>(simd, size, from, weights, bias, place);
            }
        }
        self.finish.run(simd, &self.lines.line, results, stride);
    }
}

/// The matrix `[a.channels, columns]` of the products of each line of `a` with each column, summed over the pixels.
///
/// `column(c)` starts at the first pixel of a line of `a` and reaches to a vector behind its last; its values are finite
/// or of a picture.
pub(super) fn outer<'a>(
    level: Level,
    a: &Lines,
    columns: usize,
    column: impl Fn(usize) -> &'a [f32] + Sync,
) -> Vec<f32> {
    let n = a.line.len();
    let packed = filled(a.channels * n, |to| {
        let blocks: Vec<(usize, usize)> = blocks(a.channels, largest(level)).collect();
        let all = to.len();
        let parts: Vec<Panel> = Panel::cut_at(to, all, blocks.iter().map(|(_, size)| size * n)).collect();
        blocks.into_par_iter().zip(parts).for_each(|((first, size), mut to)| {
            let to = to.row(0);
            for row in 0..size {
                for (&value, to) in a.of(first + row).iter().zip(to[row..].iter_mut().step_by(size)) {
                    *to = value;
                }
            }
        });
    });
    let products = filled(a.channels * columns, |to| {
        let panels: Vec<Panel> = Panel::cut(to, columns, PANEL).collect();
        panels.into_par_iter().enumerate().for_each(|(panel, to)| {
            with_scratch(|[scratch, ..]| {
                let (first, rows) = (panel * PANEL, a.channels);
                let count = PANEL.min(columns - first);
                let (packed, column) = (&packed[..], &column);
                level.run(Strip { packed, rows, n, first, count, column, to, scratch });
            });
        });
    });
    recycle::give(packed);
    products
}

/// The products of all lines with some columns.
struct Strip<'a, C> {
    /// `[block][pixel][row of the block]`.
    packed: &'a [f32],
    rows: usize,
    n: usize,
    first: usize,
    count: usize,
    column: &'a C,
    to: Panel<'a>,
    scratch: &'a mut Scratch,
}

impl<'c, C: Fn(usize) -> &'c [f32]> Kernel for Strip<'_, C> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(mut self, simd: S) {
        let step = self.n.div_ceil(self.n.div_ceil(PIXELS)).next_multiple_of(16);
        let last = self.first + self.count - 1;
        let panel = self.scratch.get(step * PANEL);
        let zeros = [0.0f32; 8];
        for pixel in (0..self.n).step_by(step) {
            let pixels = step.min(self.n - pixel);
            for x in (0..self.count).step_by(S::LANES) {
                for p in (0..pixels).step_by(S::LANES) {
                    let row = |c: usize| &(self.column)((self.first + x + c).min(last))[pixel + p..];
                    transpose(simd, row, &mut panel[p * PANEL + x..], PANEL);
                }
            }
            for (row, size) in blocks(self.rows, S::BLOCK) {
                let weights = &self.packed[row * self.n + pixel * size..][..pixels * size];
                let bias = (pixel == 0).then_some(&zeros[..]);
                for x in (0..self.count).step_by(3 * S::LANES) {
                    let n = (self.count - x).min(3 * S::LANES);
                    let from = Rows { from: &panel[x..], channel_stride: PANEL, row_stride: 0, channels: pixels };
                    let place = PanelRow { panel: &mut self.to, row, at: x, n };
                    convolve_row::<S, 1>(simd, size, from, weights, bias, place);
                }
            }
        }
    }
}
