//! The sum itself, for small kernels.
//!
//! For each row of the image the kernels of the two rows of nodes around it are interpolated (that is the row window).
//! A chunk of pixels is convolved with those of the column of nodes before and behind it, the source loaded once for
//! both, and the column windows join the two sums. Sums stay in registers; their order is fixed. Memory: all kernels in
//! use, and the source of a band of rows a thread.

use std::sync::atomic::{AtomicUsize, Ordering};

use ndarray::{Array3, Array4, ArrayViewMut3, Axis, s};
use rayon::prelude::*;

use super::frame::Shape;
use super::segments::{Segment, segments, used};
use super::{Kernels, Source};
use crate::plane::Region;
use crate::render::node_grid::NodeGrid;
use isoplanat_base::math::real::Real;
use isoplanat_base::math::wide::{Work, wide};
use isoplanat_base::stop::look;

/// Rows of the image that one task computes; the source is asked for that many and a margin.
pub(super) const BAND: usize = 32;
/// Pixels whose sums stay in registers.
const CHUNK: usize = 32;

pub(super) fn blur_direct<T: Real>(
    grid: &NodeGrid,
    kernels: &dyn Kernels<T>,
    source: &dyn Source<T>,
    region: Region,
    progress: &(dyn Fn(f64) + Sync),
) -> Array3<T> {
    let shape = Shape::of(kernels, source);
    shape.check(grid);
    let mut out = Array3::from_elem((shape.channels, region.rows, region.cols), T::zero());
    if out.is_empty() {
        return out;
    }
    let rows = segments::<T>(&grid.row_knots, usize::MAX, region.row, region.row + region.rows.cast_signed());
    let cols = segments::<T>(&grid.col_knots, usize::MAX, region.col, region.col + region.cols.cast_signed());
    let row_windows = rows
        .iter()
        .flat_map(|s| (0..s.len).map(|i| s.windows.iter().map(|w| (w.0, w.1[i])).collect::<Vec<_>>()))
        .collect();
    let (row_nodes, col_nodes) = (used(&rows), used(&cols));
    let nodes: Vec<usize> =
        row_nodes.iter().flat_map(|r| col_nodes.iter().map(move |c| r * grid.col_knots.len() + c)).collect();
    let mut values = vec![None; grid.len()];
    let filled: Vec<_> = nodes.par_iter().map(|n| (*n, reversed(kernels, shape, *n))).collect();
    filled.into_iter().for_each(|(n, k)| values[n] = Some(k));
    let direct = Direct { grid, shape, region, kernels: values, cols, row_windows };
    let bands: Vec<_> = out.axis_chunks_iter_mut(Axis(1), BAND).enumerate().collect();
    let (count, done) = (bands.len(), AtomicUsize::new(0));
    bands.into_par_iter().for_each(|(band, out)| {
        look();
        direct.band(source, band * BAND, out);
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        progress(done as f64 / count as f64);
    });
    out
}

/// Kernels of a node, turned by half a circle, so that the taps run with the source.
fn reversed<T: Real>(kernels: &dyn Kernels<T>, shape: Shape, node: usize) -> Array4<T> {
    let mut k = Array4::from_elem((shape.channels, shape.phases, shape.size, shape.size), T::zero());
    kernels.fill(node, k.view_mut());
    k.slice(s![.., .., ..;-1, ..;-1]).as_standard_layout().into_owned()
}

struct Direct<'a, T> {
    grid: &'a NodeGrid,
    shape: Shape,
    region: Region,
    /// `[channel, phase, row, col]`, turned, of the nodes in use.
    kernels: Vec<Option<Array4<T>>>,
    cols: Vec<Segment<T>>,
    /// For every row of the image.
    row_windows: Vec<Vec<(usize, T)>>,
}

impl<T: Real> Direct<'_, T> {
    /// The rows of `out`, from `first` on.
    fn band(&self, source: &dyn Source<T>, first: usize, mut out: ArrayViewMut3<'_, T>) {
        let Shape { size, phases, source_channels, .. } = self.shape;
        let grown = self.region.grown(size / 2);
        let rows = out.len_of(Axis(1)) + size - 1;
        let part = Region { row: grown.row + first.cast_signed(), rows, ..grown };
        // A chunk may read beyond the last pixel.
        let width = part.cols + CHUNK;
        let mut planes = Array4::from_elem((source_channels, phases, rows, width), T::zero());
        if !source.fill(part, planes.slice_mut(s![.., .., .., ..part.cols])) {
            return;
        }
        let mut taps = [Vec::new(), Vec::new()];
        for (channel, mut image) in out.outer_iter_mut().enumerate() {
            let planes = planes.index_axis(Axis(0), if source_channels == 1 { 0 } else { channel });
            let planes = planes.as_slice().expect("standard layout");
            for (i, mut line) in image.outer_iter_mut().enumerate() {
                let line = line.as_slice_mut().expect("rows of an image in memory");
                let mut from = 0;
                for col in &self.cols {
                    for ((knot, _), taps) in col.windows.iter().zip(&mut taps) {
                        self.mix(channel, first + i, *knot, taps);
                    }
                    let source = &planes[i * width + from..];
                    let sum = Sum { source, width, plane: rows * width, size, taps: &taps, col };
                    sum.segment(&mut line[from..from + col.len]);
                    from += col.len;
                }
            }
        }
    }

    /// Kernels of one column of nodes between its rows, `[phase][row][col]`.
    fn mix(&self, channel: usize, row: usize, col_knot: usize, taps: &mut Vec<T>) {
        taps.clear();
        taps.resize(self.shape.phases * self.shape.size * self.shape.size, T::zero());
        for (row_knot, w) in &self.row_windows[row] {
            let node = row_knot * self.grid.col_knots.len() + col_knot;
            let Some(kernel) = &self.kernels[node] else { continue };
            taps.iter_mut().zip(kernel.index_axis(Axis(0), channel)).for_each(|(t, k)| *t += *w * *k);
        }
    }
}

/// One row of the image between two columns of nodes.
struct Sum<'a, T> {
    /// From the first pixel that the first pixel of the segment sees.
    source: &'a [T],
    /// Numbers a row of the source, and a phase.
    width: usize,
    plane: usize,
    size: usize,
    taps: &'a [Vec<T>; 2],
    col: &'a Segment<T>,
}

impl<T: Real> Sum<'_, T> {
    fn segment(&self, line: &mut [T]) {
        for (j, line) in line.chunks_mut(CHUNK).enumerate() {
            let at = j * CHUNK;
            let mut sums = [[T::zero(); CHUNK]; 2];
            if self.col.windows.len() == 2 {
                wide(Taps::<T, 2> { sum: self, at, sums: &mut sums });
                let (a, b) = (&self.col.windows[0].1[at..], &self.col.windows[1].1[at..]);
                for (l, o) in line.iter_mut().enumerate() {
                    *o = a[l] * sums[0][l] + b[l] * sums[1][l];
                }
            } else {
                wide(Taps::<T, 1> { sum: self, at, sums: &mut sums });
                line.copy_from_slice(&sums[0][..line.len()]);
            }
        }
    }
}

/// `sums[n][l] = Σ taps[n] source[l + …]` for the first `N` columns of nodes.
struct Taps<'a, 'b, T, const N: usize> {
    sum: &'a Sum<'b, T>,
    at: usize,
    sums: &'a mut [[T; CHUNK]; 2],
}

impl<T: Real, const N: usize> Work for Taps<'_, '_, T, N> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let Sum { source, width, plane, size, taps, .. } = *self.sum;
        let mut sums = [[T::zero(); CHUNK]; N];
        for (line, from) in (0..taps[0].len() / size).zip((0..).step_by(size)) {
            let row = &source[line / size * plane + line % size * width + self.at..][..CHUNK + size - 1];
            let taps: [&[T]; N] = std::array::from_fn(|n| &taps[n][from..from + size]);
            for (b, x) in row.windows(CHUNK).enumerate().take(size) {
                let Some(x) = x.first_chunk::<CHUNK>() else { continue };
                for n in 0..N {
                    let tap = taps[n][b];
                    for (s, x) in sums[n].iter_mut().zip(x) {
                        *s += tap * *x;
                    }
                }
            }
        }
        self.sums[..N].copy_from_slice(&sums);
    }
}

#[cfg(test)]
mod tests {
    use super::super::plain::{cases, difference};
    use super::super::{Method, blur};

    #[test]
    fn direct_is_the_plain_sum() {
        for case in cases() {
            let plain = case.plain();
            let fast = blur(&case.grid, &case.kernels(), &case.source(), case.region, Method::Direct, &|_| {});
            let error = difference(&fast, &plain);
            assert!(error < 1e-13, "{}: {error:e}", case.name);
            let single = case.cast::<f32>();
            let fast = blur(&case.grid, &single.kernels(), &single.source(), case.region, Method::Direct, &|_| {});
            let error = difference(&fast, &single.plain());
            assert!(error < 1e-6, "{} in f32: {error:e}", case.name);
        }
    }
}
