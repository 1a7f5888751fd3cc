//! One block's cotangent, in the frequency domain.

use std::ops::Range;

use ndarray::{ArrayView3, s};
use rustfft::num_complex::Complex;

use super::frame::{Frame, SegmentPair};
use super::lines::{twine, twine_windows};
use super::pack::{COLUMNS, correlate, next_columns, window};
use super::plane::{Scratch, reserve, zero};
use super::spectra::NodeSpectra;
use isoplanat_base::math::real::Real;
use isoplanat_base::math::wide::prefetch;

/// Rows of the cotangent that are fetched ahead.
const AHEAD: usize = 16;

/// Spectra that gather the kernels' cotangents of a cell, by channel and node.
pub(super) struct CellSums<T> {
    pub nodes: Vec<usize>,
    pub channels: Range<usize>,
    pub values: Vec<NodeSum<T>>,
}

/// `[phase][column frequency][row frequency]`; what `values` holds counts only once something is `added`.
#[derive(Default)]
pub(super) struct NodeSum<T> {
    pub values: Vec<Complex<T>>,
    pub added: bool,
}

impl<T> CellSums<T> {
    fn of(&mut self, channel: usize, node: usize) -> Option<&mut NodeSum<T>> {
        let at = self.nodes.iter().position(|n| *n == node)?;
        self.values.get_mut((channel - self.channels.start) * self.nodes.len() + at)
    }
}

impl<T: Real> NodeSum<T> {
    /// Adds `conj(seen) · column` to a span.
    fn add(&mut self, at: Range<usize>, seen: &[Complex<T>], column: &[Complex<T>]) {
        if self.added {
            correlate::<T, true>(&mut self.values[at], seen, column);
        } else {
            correlate::<T, false>(&mut self.values[at], seen, column);
        }
    }
}

/// A block and what its image was made of.
pub(super) struct Block<'a, T: Real> {
    pub frame: &'a Frame<T>,
    pub place: SegmentPair<'a, T>,
    /// Spectra of the kernels.
    pub kernels: &'a NodeSpectra<T>,
    /// Spectra of the source, if it was lit.
    pub seen: Option<&'a [Complex<T>]>,
}

impl<T: Real> Block<'_, T> {
    /// Makes the spectra of the source's cotangent zero.
    pub(super) fn start(&self, scratch: &mut Scratch<T>) {
        let len = self.frame.shape.phases * self.frame.plane.spectrum_len();
        reserve(&mut scratch.spectra, len);
        scratch.spectra[..len].fill(zero());
    }

    /// Adds the correlations of one channel's cotangent to the sums of the nodes, and to those of the source.
    pub(super) fn add(&self, bar: ArrayView3<'_, T>, channel: usize, sums: &mut CellSums<T>, scratch: &mut Scratch<T>) {
        self.turn(bar, channel, scratch);
        let plane = &self.frame.plane;
        let nodes = self.frame.corners(self.place);
        let Scratch { buffers, spectra, columns, mixed, .. } = scratch;
        reserve(columns, nodes.len() * COLUMNS * plane.rows);
        for from in (0..plane.half).step_by(COLUMNS) {
            let width = (plane.half - from).min(COLUMNS);
            let span = from * plane.rows..(from + width) * plane.rows;
            let columns = &mut columns[..nodes.len() * span.len()];
            self.columns(from, width, mixed, columns);
            // The next columns come while these are transformed.
            self.fetch(next_columns(plane.rows, plane.half, from), channel, &nodes, sums);
            plane.columns_forward(buffers, columns);
            for (node, column) in nodes.iter().zip(columns.chunks_exact(span.len())) {
                let mut sum = sums.of(channel, *node);
                for phase in 0..self.frame.shape.phases {
                    let at = phase * plane.spectrum_len();
                    let at = at + span.start..at + span.end;
                    if let (Some(sum), Some(seen)) = (sum.as_deref_mut(), self.seen) {
                        sum.add(at.clone(), &seen[at.clone()], column);
                    }
                    let kernel = &self.kernels.plane(self.frame, *node, channel, phase)[span.clone()];
                    correlate::<T, true>(&mut spectra[at], kernel, column);
                }
            }
        }
        self.mark(channel, sums);
    }

    /// Columns of the cotangent under the row windows, between zeros: column window by column window, row windows within.
    fn columns(&self, from: usize, width: usize, mixed: &[Complex<T>], columns: &mut [Complex<T>]) {
        let (count, first) = (self.place.row.len, self.frame.shape.size - 1);
        let (rows, across) = (&self.place.row.windows, self.place.col.windows.len());
        for (i, column) in columns.chunks_exact_mut(self.frame.plane.rows).enumerate() {
            let (b, a, c) = (i / width / rows.len(), i / width % rows.len(), i % width);
            let x = &mixed[((from + c) * across + b) * count..][..count];
            column[..first].fill(zero());
            window::<T, false>(&mut column[first..first + count], x, &rows[a].1);
            column[first + count..].fill(zero());
        }
    }

    /// Asks for what the columns of `span` will be multiplied with and added to.
    fn fetch(&self, span: Range<usize>, channel: usize, nodes: &[usize], sums: &mut CellSums<T>) {
        for phase in 0..self.frame.shape.phases {
            let at = phase * self.frame.plane.spectrum_len();
            let at = at + span.start..at + span.end;
            for node in nodes {
                if let Some(sum) = sums.of(channel, *node) {
                    prefetch(&sum.values[at.clone()]);
                }
                prefetch(&self.kernels.plane(self.frame, *node, channel, phase)[span.clone()]);
            }
            if let Some(seen) = self.seen {
                prefetch(&seen[at]);
            }
        }
    }

    /// Marks the sums of the block's nodes as added to.
    fn mark(&self, channel: usize, sums: &mut CellSums<T>) {
        if self.seen.is_some() {
            for node in self.frame.corners(self.place) {
                if let Some(sum) = sums.of(channel, node) {
                    sum.added = true;
                }
            }
        }
    }

    /// The cotangent under the column windows, transformed along its rows, into `scratch.mixed`:
    /// `[column frequency][column window][row]`.
    fn turn(&self, bar: ArrayView3<'_, T>, channel: usize, scratch: &mut Scratch<T>) {
        let (frame, place) = (self.frame, self.place);
        let (plane, pairing) = (&frame.plane, place.pairing());
        let (count, first, width) = (place.row.len, frame.shape.size - 1, place.col.len);
        let i = (place.row.start - frame.region.row).unsigned_abs();
        let j = (place.col.start - frame.region.col).unsigned_abs();
        let bar = bar.slice_move(s![channel, i..i + count, j..j + width]);
        let two = place.col.windows.len() == 2;
        let stride = place.col.windows.len() * count;
        let row = |i: usize| bar.row(i).to_slice().expect("standard layout");
        reserve(&mut scratch.mixed, plane.half * stride);
        let fill = |l: usize, line: &mut [Complex<T>]| {
            // Rows lie far apart in memory: a few are asked for ahead.
            if l + AHEAD < count {
                prefetch(row(l + AHEAD));
            }
            line[..first].fill(zero());
            let line = &mut line[first..];
            if two {
                twine_windows(row(l), place.windows(), &mut line[..width]);
                line[width..].fill(zero());
            } else if l < pairing.second {
                twine(row(l), row(l + pairing.shift), line);
            } else {
                twine(row(l), &[], line);
            }
        };
        let planes = [(0, pairing.lines), (if two { count } else { pairing.shift }, pairing.second)];
        plane.turn(&mut scratch.buffers, pairing.lines, fill, &mut scratch.mixed, stride, planes);
    }

    /// The cotangent of the source that the block saw, `[phase][row][col]`.
    pub(super) fn tile(&self, scratch: &mut Scratch<T>) -> Vec<T> {
        let seen = self.frame.seen(self.place);
        let (plane, phases) = (&self.frame.plane, self.frame.shape.phases);
        let len = plane.spectrum_len();
        let mut out = vec![T::zero(); phases * seen.rows * seen.cols];
        let Scratch { buffers, spectra, lines, .. } = scratch;
        for (spectrum, out) in spectra.chunks_exact_mut(len).zip(out.chunks_exact_mut(seen.rows * seen.cols)) {
            plane.image(buffers, lines, spectrum, (seen.rows, seen.cols), out);
        }
        out
    }
}
