//! What the passes over a frame share: sizes, blocks, strips of bounded memory, and the spectra of the nodes in use.

use std::collections::BTreeMap;
use std::ops::Range;

use ndarray::{Array4, ArrayViewMut4};
use rayon::prelude::*;

use super::super::cfa::Real;
use super::super::node_grid::NodeGrid;
use super::super::warp::Region;
use super::plane::{Plane, Pool, Scratch, zero_line};
use super::segments::{Segment, segments, used};
use super::{Kernels, Source};
use crate::math::panel_fft::Line;

/// Bytes that the spectra and tiles of one strip may take, unless a single block takes more.
const STRIP_BYTES: usize = 1 << 30;

/// Numbers that describe the kernels and the source.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    /// Rows and columns of a kernel.
    pub size: usize,
    /// Channels of the image.
    pub channels: usize,
    /// Channels of the source, 1 or `channels`.
    pub source_channels: usize,
    /// Phases.
    pub phases: usize,
}

impl Shape {
    /// Image channels that share a channel of the source, by source channel.
    pub(super) fn groups(&self) -> Vec<Range<usize>> {
        if self.source_channels == 1 {
            return std::iter::once(0..self.channels).collect();
        }
        (0..self.channels).map(|c| c..c + 1).collect()
    }
}

/// A region cut into blocks.
pub(super) struct Frame<'a, T: Real> {
    pub grid: &'a NodeGrid,
    pub shape: Shape,
    pub region: Region,
    pub rows: Vec<Segment<T>>,
    pub cols: Vec<Segment<T>>,
    pub plane: Plane<T>,
    pub pool: Pool<T>,
}

/// The source of one block, `[channel, phase, row, col]`.
#[derive(Default)]
pub(super) struct Block<T> {
    data: Vec<T>,
    /// Whether any of it may differ from zero.
    pub full: bool,
}

impl<T: Real> Block<T> {
    /// The source of one channel and phase, row by row.
    pub(super) fn plane(
        &self,
        frame: &Frame<'_, T>,
        row: &Segment<T>,
        col: &Segment<T>,
        channel: usize,
        phase: usize,
    ) -> &[T] {
        let len = row.len * col.len;
        &self.data[(channel * frame.shape.phases + phase) * len..][..len]
    }
}

impl<'a, T: Real> Frame<'a, T> {
    pub(super) fn new(grid: &'a NodeGrid, shape: Shape, region: Region, block: usize) -> Self {
        assert!(!grid.is_empty(), "a grid has nodes");
        assert!(shape.size % 2 == 1, "kernel size {} is odd", shape.size);
        assert!(
            shape.source_channels == 1 || shape.source_channels == shape.channels,
            "{} source channels for {} channels",
            shape.source_channels,
            shape.channels
        );
        let grown = region.grown(shape.size / 2);
        let cut = |knots: &[isize], start: isize, len: usize, wanted: usize| {
            let to = if wanted == 0 { start } else { start + len.cast_signed() };
            segments::<T>(knots, block, start, to)
        };
        let rows = cut(&grid.row_knots, grown.row, grown.rows, region.rows);
        let cols = cut(&grid.col_knots, grown.col, grown.cols, region.cols);
        let longest = |all: &[Segment<T>]| all.iter().map(|s| s.len).max().unwrap_or(1);
        let plane = Plane::new(longest(&rows) + shape.size - 1, longest(&cols) + shape.size - 1);
        Self { grid, shape, region, rows, cols, plane, pool: Pool::new() }
    }

    /// The region of the block, and of the pixels its light reaches.
    pub(super) fn block(row: &Segment<T>, col: &Segment<T>) -> Region {
        Region { row: row.start, col: col.start, rows: row.len, cols: col.len }
    }

    /// Rows of the region that light from the rows of a segment reaches: first (in the region), and the first row of the
    /// block's tile that it is, count.
    pub(super) fn reach(&self, segment: &Segment<T>) -> (usize, usize, usize) {
        super::common(
            self.region.row,
            self.region.rows,
            segment.start - (self.shape.size / 2).cast_signed(),
            segment.len + self.shape.size - 1,
        )
    }

    /// Like [`Self::reach`], columns.
    pub(super) fn reach_cols(&self, segment: &Segment<T>) -> (usize, usize, usize) {
        super::common(
            self.region.col,
            self.region.cols,
            segment.start - (self.shape.size / 2).cast_signed(),
            segment.len + self.shape.size - 1,
        )
    }

    /// Values of the longest tile a channel.
    pub(super) fn tile_len(&self) -> usize {
        let rows = self.rows.iter().map(|r| self.reach(r).2).max().unwrap_or(0);
        rows * self.plane.cols
    }

    /// Ranges of column segments whose node spectra and tiles stay within the strip's memory.
    pub(super) fn strips(&self, bytes: usize) -> Vec<Range<usize>> {
        let per_node = self.shape.channels * self.shape.phases * self.plane.spectrum_len() * size_of::<Line<T>>();
        let per_block = self.shape.channels * self.tile_len() * size_of::<T>();
        let (mut all, mut from) = (Vec::new(), 0);
        for to in 1..=self.cols.len() {
            let cost = |to: usize| 2 * used(&self.cols[from..to]).len() * per_node + (to - from) * per_block;
            if to == self.cols.len() || cost(to + 1) > bytes {
                all.push(from..to);
                from = to;
            }
        }
        all
    }

    pub(super) fn strips_in_memory(&self) -> Vec<Range<usize>> {
        self.strips(STRIP_BYTES)
    }

    /// Asks for the source of a row of blocks.
    pub(super) fn fill(
        &self,
        source: &dyn Source<T>,
        row: &Segment<T>,
        cols: &[Segment<T>],
        blocks: &mut Vec<Block<T>>,
    ) {
        blocks.resize_with(cols.len().max(blocks.len()), || Block { data: Vec::new(), full: false });
        let planes = (self.shape.source_channels, self.shape.phases);
        blocks.par_iter_mut().zip(cols).for_each(|(block, col)| {
            let dim = (planes.0, planes.1, row.len, col.len);
            let len = dim.0 * dim.1 * dim.2 * dim.3;
            if block.data.len() < len {
                block.data.resize(len, T::zero());
            }
            let view = ArrayViewMut4::from_shape(dim, &mut block.data[..len]).expect("length of the shape");
            block.full = source.fill(Self::block(row, col), view);
        });
    }

    /// Row spectra of the column-windowed source of `channel`, plane `2 phase + window` of the scratch.
    pub(super) fn load(
        &self,
        scratch: &mut Scratch<T>,
        block: &Block<T>,
        channel: usize,
        row: &Segment<T>,
        col: &Segment<T>,
    ) {
        for phase in 0..self.shape.phases {
            let plane = block.plane(self, row, col, channel, phase);
            for (b, (_, window)) in col.windows.iter().enumerate() {
                self.plane.rows_forward(scratch, 2 * phase + b, row.len, |i, line| {
                    let from = &plane[i * col.len..][..col.len];
                    for ((line, from), w) in line.iter_mut().zip(from).zip(window) {
                        *line = *from * *w;
                    }
                    true
                });
            }
        }
    }

    /// One panel of the windowed source's spectrum into `scratch.panel`.
    #[inline]
    pub(super) fn panel(&self, scratch: &mut Scratch<T>, phase: usize, b: usize, p: usize, window: &[T]) {
        let count = window.len();
        let from = &scratch.rows[((2 * phase + b) * self.plane.panels + p) * count..][..count];
        self.plane.columns_forward(from, Some(window), &mut scratch.panel);
    }

    /// The node where a row window and a column window meet.
    pub(super) fn node(&self, row: usize, col: usize) -> usize {
        row * self.grid.col_knots.len() + col
    }
}

/// Spectra of the kernels of the nodes in use, `[channel][phase][panel][line]`.
pub(super) struct NodeSpectra<T> {
    of: BTreeMap<usize, Vec<Line<T>>>,
    free: Vec<Vec<Line<T>>>,
}

impl<T: Real> NodeSpectra<T> {
    pub(super) fn new() -> Self {
        Self { of: BTreeMap::new(), free: Vec::new() }
    }

    /// Keeps the spectra of `nodes`, computes those that are missing and drops the others.
    pub(super) fn advance(&mut self, frame: &Frame<'_, T>, kernels: &dyn Kernels<T>, nodes: &[usize]) {
        let gone: Vec<usize> = self.of.keys().copied().filter(|n| !nodes.contains(n)).collect();
        self.free.extend(gone.iter().filter_map(|n| self.of.remove(n)));
        let Shape { size, channels, phases, .. } = frame.shape;
        let len = frame.plane.spectrum_len();
        let mut new: Vec<(usize, Vec<Line<T>>)> = Vec::new();
        for &n in nodes.iter().filter(|n| !self.of.contains_key(*n)) {
            new.push((n, self.free.pop().unwrap_or_else(|| vec![zero_line(); channels * phases * len])));
        }
        new.par_iter_mut().for_each(|(node, spectra)| {
            let mut values = Array4::from_elem((channels, phases, size, size), T::zero());
            kernels.fill(*node, values.view_mut());
            frame.pool.with(&frame.plane, |scratch| {
                let planes = values.as_slice().expect("standard layout").chunks_exact(size * size);
                for (plane, out) in planes.zip(spectra.chunks_exact_mut(len)) {
                    frame.plane.rows_forward(scratch, 0, size, |i, line| {
                        line[..size].copy_from_slice(&plane[i * size..][..size]);
                        true
                    });
                    frame.plane.spectrum(scratch, size, out);
                }
            });
        });
        self.of.extend(new);
    }

    /// One panel of the spectrum of a node's kernel.
    #[inline]
    pub(super) fn panel(
        &self,
        frame: &Frame<'_, T>,
        node: usize,
        channel: usize,
        phase: usize,
        p: usize,
    ) -> &[Line<T>] {
        let at = (channel * frame.shape.phases + phase) * frame.plane.panels + p;
        &self.of[&node][at * frame.plane.rows..][..frame.plane.rows]
    }
}
