//! The source under one row of blocks: asked for once, part by part, and moved down from row to row.

use ndarray::{ArrayViewMut4, Axis};
use rayon::prelude::*;

use super::Source;
use super::frame::{Frame, SegmentPair};
use super::segments::Segment;
use crate::plane::Region;
use isoplanat_base::math::real::Real;

/// `[channel][phase][row][col]` over `region`, which grows and moves downwards.
pub(super) struct Band<T> {
    values: Vec<T>,
    region: Region,
    /// Rows there is room for.
    room: usize,
    planes: (usize, usize),
    /// Where the columns are cut: before the blocks, at their starts, behind them.
    cuts: Vec<isize>,
    /// Rows filled together: where they end, and which of the parts of columns may differ from zero.
    fills: Vec<(isize, Vec<bool>)>,
}

impl<T: Real> Band<T> {
    /// An empty band over the blocks of a strip.
    pub(super) fn new(frame: &Frame<T>, cols: &[Segment<T>]) -> Self {
        let size = frame.shape.size;
        let (first, last) = (&cols[0], &cols[cols.len() - 1]);
        let from = first.start - (size / 2).cast_signed();
        let width = (last.start - first.start).unsigned_abs() + last.len + size - 1;
        let mut cuts = vec![from];
        cuts.extend(cols.iter().map(|c| c.start));
        cuts.extend([last.start + last.len.cast_signed(), from + width.cast_signed()]);
        cuts.dedup();
        let planes = (frame.shape.source_channels, frame.shape.phases);
        let room = frame.band_rows();
        Self {
            values: vec![T::zero(); planes.0 * planes.1 * room * width],
            region: Region { row: isize::MIN, col: from, rows: 0, cols: width },
            room,
            planes,
            cuts,
            fills: Vec::new(),
        }
    }

    /// Moves to the rows that a row of blocks sees, and asks for those that are new.
    pub(super) fn advance(&mut self, source: &dyn Source<T>, start: isize, rows: usize) {
        let end = self.region.row.saturating_add(self.region.rows.cast_signed());
        let kept = if (self.region.row..end).contains(&start) { (end - start).unsigned_abs().min(rows) } else { 0 };
        let (width, room) = (self.region.cols, self.room);
        if kept > 0 {
            let from = (start - self.region.row).unsigned_abs() * width;
            for plane in self.values.chunks_exact_mut(room * width) {
                plane.copy_within(from..from + kept * width, 0);
            }
            self.fills.retain(|f| f.0 > start);
        } else {
            self.fills.clear();
        }
        self.region = Region { row: start, rows, ..self.region };
        if kept < rows {
            self.fill(source, kept);
        }
    }

    /// Asks for the rows from `kept` on, part by part.
    fn fill(&mut self, source: &dyn Source<T>, kept: usize) {
        let Region { row, rows, .. } = self.region;
        let dim = (self.planes.0, self.planes.1, self.room, self.region.cols);
        let view = ArrayViewMut4::from_shape(dim, &mut self.values[..]).expect("length of the shape");
        let mut rest = view.split_at(Axis(2), rows).0.split_at(Axis(2), kept).1;
        let mut parts = Vec::new();
        for cut in self.cuts.windows(2) {
            let cols = (cut[1] - cut[0]).unsigned_abs();
            let (part, behind) = rest.split_at(Axis(3), cols);
            rest = behind;
            parts.push((Region { row: row + kept.cast_signed(), col: cut[0], rows: rows - kept, cols }, part));
        }
        let lit = parts.into_par_iter().map(|(region, part)| source.fill(region, part)).collect();
        self.fills.push((row + rows.cast_signed(), lit));
    }

    /// Whether any of the source that a block sees may differ from zero. The band stands at the block's rows.
    pub(super) fn lit(&self, frame: &Frame<T>, place: SegmentPair<'_, T>) -> bool {
        let seen = frame.seen(place);
        let end = seen.col + seen.cols.cast_signed();
        self.fills
            .iter()
            .any(|(_, lit)| self.cuts.windows(2).zip(lit).any(|(cut, lit)| *lit && cut[0] < end && cut[1] > seen.col))
    }

    /// Spectra of what a block sees, `[phase][column frequency][row frequency]`.
    pub(super) fn spectra(
        &self,
        frame: &Frame<T>,
        place: SegmentPair<'_, T>,
        channel: usize,
        scratch: &mut super::plane::Scratch<T>,
    ) {
        let (width, len) = (self.region.cols, frame.plane.spectrum_len());
        let seen = frame.seen(place);
        let left = (seen.col - self.region.col).unsigned_abs();
        super::plane::reserve(&mut scratch.spectra, self.planes.1 * len);
        for (phase, out) in scratch.spectra.chunks_exact_mut(len).enumerate().take(self.planes.1) {
            let plane = &self.values[(channel * self.planes.1 + phase) * self.room * width..][..self.room * width];
            let row = |i: usize| &plane[i * width + left..][..seen.cols];
            frame.plane.spectrum(&mut scratch.buffers, seen.rows, row, out);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::frame::Shape;
    use super::*;
    use crate::render::node_grid::NodeGrid;
    use std::sync::Mutex;

    /// A source that counts how often it is asked for each place.
    struct Counted(Mutex<std::collections::BTreeMap<(isize, isize), usize>>);

    impl Source<f64> for Counted {
        fn channels(&self) -> usize {
            1
        }
        fn fill(&self, region: Region, mut out: ArrayViewMut4<'_, f64>) -> bool {
            let mut counts = self.0.lock().expect("no panic");
            for ((_, _, i, j), v) in out.indexed_iter_mut() {
                let at = (region.row + i.cast_signed(), region.col + j.cast_signed());
                *counts.entry(at).or_default() += 1;
                *v = at.0 as f64 * 1000.0 + at.1 as f64;
            }
            region.row + region.rows.cast_signed() > 30
        }
    }

    #[test]
    fn every_place_of_the_source_is_asked_for_once() {
        let grid = NodeGrid { row_knots: vec![0, 7, 30], col_knots: vec![2, 20] };
        for size in [1, 5, 31] {
            let shape = Shape { size, channels: 1, source_channels: 1, phases: 1 };
            let region = Region { row: -3, col: 1, rows: 50, cols: 33 };
            let frame = Frame::<f64>::new(&grid, shape, region, 9);
            let source = Counted(Mutex::default());
            let mut band = Band::new(&frame, &frame.cols);
            for row in &frame.rows {
                let seen = frame.seen(SegmentPair { row, col: &frame.cols[0] });
                band.advance(&source, seen.row, seen.rows);
                for i in 0..seen.rows {
                    for j in 0..band.region.cols {
                        let at = ((seen.row + i.cast_signed()) as f64, (band.region.col + j.cast_signed()) as f64);
                        assert_eq!(band.values[i * band.region.cols + j], at.0 * 1000.0 + at.1);
                    }
                }
                let lit = band.lit(&frame, SegmentPair { row, col: &frame.cols[1] });
                assert!(lit || seen.row + seen.rows.cast_signed() <= 30);
            }
            let counts = source.0.into_inner().expect("no panic");
            let grown = region.grown(size / 2);
            assert_eq!(counts.len(), grown.rows * grown.cols);
            assert!(counts.values().all(|n| *n == 1));
        }
    }
}
