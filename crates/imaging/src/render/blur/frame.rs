//! What the passes over a frame share: sizes, blocks of the image, strips of bounded memory.

use std::ops::Range;

use ndarray::{ArrayViewMut3, Axis};
use rustfft::num_complex::Complex;

use super::plane::{Plane, Pool};
use super::segments::{Segment, segments, used};
use super::{Kernels, Source};
use crate::plane::Region;
use crate::render::node_grid::NodeGrid;
use isoplanat_base::math::real::Real;

/// Bytes that the spectra and the source of one strip may take, unless a single block takes more.
pub(super) const STRIP_BYTES: usize = 1 << 30;

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
    pub(super) fn of<T>(kernels: &dyn Kernels<T>, source: &dyn Source<T>) -> Self {
        Self {
            size: kernels.size(),
            channels: kernels.channels(),
            source_channels: source.channels(),
            phases: kernels.phases(),
        }
    }

    /// # Panics
    /// If the grid is empty, there is no phase, the size is even, or source and kernels differ in channels.
    pub(super) fn check(&self, grid: &NodeGrid) {
        let Self { size, channels, source_channels, phases } = *self;
        assert!(!grid.is_empty(), "a grid has nodes");
        assert!(phases > 0, "a pixel has samples");
        assert!(size % 2 == 1, "kernel size {size} is odd");
        let fits = source_channels == 1 || source_channels == channels;
        assert!(fits, "{source_channels} source channels for {channels} channels");
    }

    /// Image channels that share a channel of the source, by source channel.
    pub(super) fn groups(&self) -> Vec<Range<usize>> {
        if self.source_channels == 1 {
            return std::iter::once(0..self.channels).collect();
        }
        (0..self.channels).map(|c| c..c + 1).collect()
    }
}

/// A region of the image cut into blocks that straddle no knot.
pub(super) struct Frame<T: Real> {
    pub grid: NodeGrid,
    pub shape: Shape,
    pub region: Region,
    pub rows: Vec<Segment<T>>,
    pub cols: Vec<Segment<T>>,
    pub plane: Plane<T>,
    pub pool: Pool<T>,
}

/// A block of the image: its rows and its columns.
#[derive(Clone, Copy)]
pub(super) struct SegmentPair<'a, T> {
    pub row: &'a Segment<T>,
    pub col: &'a Segment<T>,
}

/// Which real rows the lines of a block hold: the same row under both column windows, or, where there is one window,
/// two rows.
#[derive(Clone, Copy)]
pub(super) struct Pairing {
    /// Complex lines.
    pub lines: usize,
    /// The second row of line `l` is row `l + shift`.
    pub shift: usize,
    /// Lines with a second row.
    pub second: usize,
}

impl<T> SegmentPair<'_, T> {
    pub(super) fn pairing(&self) -> Pairing {
        let rows = self.row.len;
        if self.col.windows.len() == 2 {
            return Pairing { lines: rows, shift: 0, second: rows };
        }
        let lines = rows.div_ceil(2);
        Pairing { lines, shift: lines, second: rows - lines }
    }

    /// Column windows of the first and second rows of lines.
    pub(super) fn windows(&self) -> [&[T]; 2] {
        let first = &self.col.windows[0].1;
        [first, self.col.windows.get(1).map_or(first, |w| &w.1)]
    }
}

impl<T: Real> Frame<T> {
    pub(super) fn new(grid: &NodeGrid, shape: Shape, region: Region, block: usize) -> Self {
        shape.check(grid);
        let cut = |knots: &[isize], start: isize, len: usize| {
            segments::<T>(knots, block, start, start.saturating_add(len.cast_signed()))
        };
        let rows = cut(&grid.row_knots, region.row, region.rows);
        let cols = cut(&grid.col_knots, region.col, region.cols);
        let longest = |all: &[Segment<T>]| all.iter().map(|s| s.len).max().unwrap_or(1);
        let plane = Plane::new(longest(&rows) + shape.size - 1, longest(&cols) + shape.size - 1);
        Self { grid: grid.clone(), shape, region, rows, cols, plane, pool: Pool::new() }
    }

    /// The node where a row window and a column window meet.
    pub(super) fn node(&self, row: usize, col: usize) -> usize {
        row * self.grid.col_knots.len() + col
    }

    /// The nodes that blocks of a row of blocks use.
    pub(super) fn nodes<'a>(&self, row: &Segment<T>, cols: impl IntoIterator<Item = &'a Segment<T>>) -> Vec<usize>
    where
        T: 'a,
    {
        let across = used(cols);
        row.windows.iter().flat_map(|w| across.iter().map(|c| self.node(w.0, *c))).collect()
    }

    /// The nodes of a block, column window by column window, row windows within.
    pub(super) fn corners(&self, place: SegmentPair<'_, T>) -> Vec<usize> {
        let rows = &place.row.windows;
        place.col.windows.iter().flat_map(|c| rows.iter().map(|r| self.node(r.0, c.0))).collect()
    }

    /// The source that a block sees.
    pub(super) fn seen(&self, place: SegmentPair<'_, T>) -> Region {
        let half = (self.shape.size / 2).cast_signed();
        Region {
            row: place.row.start - half,
            col: place.col.start - half,
            rows: place.row.len + self.shape.size - 1,
            cols: place.col.len + self.shape.size - 1,
        }
    }

    /// Rows of the source that the longest row of blocks sees.
    pub(super) fn band_rows(&self) -> usize {
        self.rows.iter().map(|r| r.len).max().unwrap_or(0) + self.shape.size - 1
    }

    /// Ranges of column segments whose node spectra and source stay within `bytes`.
    pub(super) fn strips(&self, bytes: usize) -> Vec<Range<usize>> {
        let Shape { size, channels, source_channels, phases } = self.shape;
        let per_node = channels * phases * self.plane.spectrum_len() * size_of::<Complex<T>>();
        let per_column = source_channels * phases * self.band_rows() * size_of::<T>();
        let (mut all, mut from) = (Vec::new(), 0);
        for to in 1..=self.cols.len() {
            let cost = |to: usize| {
                let cols = &self.cols[from..to];
                let width = cols.iter().map(|c| c.len).sum::<usize>() + size - 1;
                2 * used(cols).len() * per_node + width * per_column
            };
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

    /// Cuts one row of blocks out of the image: for each of `cols`, the channels of each group.
    pub(super) fn views<'v>(
        &self,
        image: &'v mut ArrayViewMut3<'_, T>,
        row: &Segment<T>,
        cols: &[Segment<T>],
    ) -> Vec<ArrayViewMut3<'v, T>> {
        let offset = |at: isize, from: isize| (at - from).unsigned_abs();
        let (top, left) = (offset(row.start, self.region.row), offset(cols[0].start, self.region.col));
        let band = image.view_mut().split_at(Axis(1), top).1.split_at(Axis(1), row.len).0;
        let mut rest = band.split_at(Axis(2), left).1;
        let mut all = Vec::new();
        for col in cols {
            let (mut block, behind) = rest.split_at(Axis(2), col.len);
            rest = behind;
            for group in self.shape.groups() {
                let (part, others) = block.split_at(Axis(0), group.len());
                all.push(part);
                block = others;
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_cover_all_blocks_whatever_the_memory() {
        let grid = NodeGrid { row_knots: vec![0, 40], col_knots: vec![0, 10, 33, 60] };
        let shape = Shape { size: 7, channels: 2, source_channels: 1, phases: 1 };
        let frame = Frame::<f32>::new(&grid, shape, Region { row: -3, col: -8, rows: 50, cols: 90 }, 8);
        for (bytes, count) in [(0, frame.cols.len()), (usize::MAX, 1)] {
            let strips = frame.strips(bytes);
            assert_eq!(strips.len(), count);
            assert_eq!(strips.iter().cloned().flatten().collect::<Vec<_>>(), (0..frame.cols.len()).collect::<Vec<_>>());
        }
    }
}
