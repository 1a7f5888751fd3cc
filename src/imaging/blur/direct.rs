//! The sum itself, for small kernels.
//!
//! For each row of the image and each kernel row, the kernels of the two rows of nodes around the source row are
//! interpolated (that is the row window), and the source, times one column window at a time, is convolved with them: two
//! multiply-adds a kernel entry and pixel. Sums stay in registers over a chunk of pixels; their order is fixed.

use ndarray::{Array3, Array4, Axis, s};
use rayon::prelude::*;

use super::super::cfa::Real;
use super::super::node_grid::NodeGrid;
use super::super::warp::Region;
use super::segments::{Segment, segments, used};
use super::{Kernels, Source};
use crate::math::wide::{Work, wide};

/// Rows of the image that one task computes; the source is asked for that many and a margin.
const BAND: usize = 32;
/// Pixels whose sums stay in registers.
const CHUNK: usize = 32;

pub(super) fn blur_direct<T: Real>(
    grid: &NodeGrid,
    kernels: &dyn Kernels<T>,
    source: &dyn Source<T>,
    region: Region,
    progress: &(dyn Fn(f64) + Sync),
) -> Array3<T> {
    let (size, channels, phases) = (kernels.size(), kernels.channels(), kernels.phases());
    assert!(!grid.is_empty(), "a grid has nodes");
    assert!(size % 2 == 1, "kernel size {size} is odd");
    assert!(source.channels() == 1 || source.channels() == channels, "source and kernels differ in channels");
    let mut out = Array3::from_elem((channels, region.rows, region.cols), T::zero());
    if out.is_empty() {
        return out;
    }
    let grown = region.grown(size / 2);
    let end = grown.row + grown.rows.cast_signed();
    let rows = segments::<T>(&grid.row_knots, usize::MAX, grown.row, end);
    let cols = segments::<T>(&grid.col_knots, usize::MAX, grown.col, grown.col + grown.cols.cast_signed());
    let (row_nodes, col_nodes) = (used(&rows), used(&cols));
    let nodes: Vec<usize> =
        row_nodes.iter().flat_map(|r| col_nodes.iter().map(move |c| r * grid.col_knots.len() + c)).collect();
    let mut values: Vec<Option<Array4<T>>> = vec![None; grid.len()];
    let filled: Vec<(usize, Array4<T>)> = nodes
        .par_iter()
        .map(|&n| {
            let mut k = Array4::from_elem((channels, phases, size, size), T::zero());
            kernels.fill(n, k.view_mut());
            (n, k)
        })
        .collect();
    filled.into_iter().for_each(|(n, k)| values[n] = Some(k));
    // Rows of the windows, for every source row.
    let row_windows: Vec<Vec<(usize, T)>> =
        rows.iter().flat_map(|s| (0..s.len).map(|i| s.windows.iter().map(|w| (w.0, w.1[i])).collect())).collect();
    let direct = Direct { grid, kernels: &values, cols: &cols, size, phases, row_windows: &row_windows };
    let bands: Vec<_> = out.axis_chunks_iter_mut(Axis(1), BAND).enumerate().collect();
    let (count, done) = (bands.len(), std::sync::atomic::AtomicUsize::new(0));
    bands.into_par_iter().for_each(|(band, mut out)| {
        let first = band * BAND;
        let part = Region {
            row: grown.row + first.cast_signed(),
            col: grown.col,
            rows: out.len_of(Axis(1)) + size - 1,
            cols: grown.cols,
        };
        let mut planes = Array4::from_elem((source.channels(), phases, part.rows, part.cols), T::zero());
        if source.fill(part, planes.view_mut()) {
            let mut buffers = (Vec::new(), Vec::new(), vec![T::zero(); size]);
            for (channel, mut image) in out.outer_iter_mut().enumerate() {
                let planes = planes.index_axis(Axis(0), if source.channels() == 1 { 0 } else { channel });
                for (i, mut line) in image.outer_iter_mut().enumerate() {
                    for phase in 0..phases {
                        let source = planes.slice(s![phase, i..i + size, ..]);
                        let source = source.as_slice().expect("rows of a plane in memory");
                        let at = (channel, phase, first + i);
                        direct.row(source, at, line.as_slice_mut().expect("standard layout"), &mut buffers);
                    }
                }
            }
        }
        let done = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
        progress(done as f64 / count as f64);
    });
    out
}

struct Direct<'a, T> {
    grid: &'a NodeGrid,
    kernels: &'a [Option<Array4<T>>],
    cols: &'a [Segment<T>],
    size: usize,
    phases: usize,
    row_windows: &'a [Vec<(usize, T)>],
}

impl<T: Real> Direct<'_, T> {
    /// Adds one row of the image: `source` holds the `size` source rows that reach it, `at` is channel, phase and row.
    fn row(
        &self,
        source: &[T],
        (channel, phase, row): (usize, usize, usize),
        line: &mut [T],
        (padded, sums, taps): &mut (Vec<T>, Vec<T>, Vec<T>),
    ) {
        debug_assert!(phase < self.phases);
        let margin = self.size - 1;
        let width = line.len() + margin;
        let mut from = 0;
        for col in self.cols {
            // The light of the source columns from..from + len reaches image columns from − margin.. (image columns
            // count from the region's first; the source's from half a kernel before it).
            let reach = col.len + margin;
            let whole = reach.next_multiple_of(CHUNK);
            sums.clear();
            sums.resize(whole, T::zero());
            for a in 0..self.size {
                // Kernel row a moves light by a − half: it takes source row size − 1 − a.
                let i = margin - a;
                let pixels = &source[i * width + from..][..col.len];
                for (col_knot, window) in &col.windows {
                    padded.clear();
                    padded.resize(whole + margin, T::zero());
                    for (p, (v, w)) in padded[margin..].iter_mut().zip(pixels.iter().zip(window)) {
                        *p = *v * *w;
                    }
                    taps.fill(T::zero());
                    for (row_knot, w) in &self.row_windows[row + i] {
                        let node = row_knot * self.grid.col_knots.len() + col_knot;
                        let Some(kernel) = &self.kernels[node] else { continue };
                        // Reversed, so that the taps run with the source.
                        let kernel = kernel.slice(s![channel, phase, a, ..;-1]);
                        taps.iter_mut().zip(kernel).for_each(|(t, k)| *t += *w * *k);
                    }
                    wide(Taps { sums, padded, taps });
                }
            }
            // Sum j stands at image column from + j − margin.
            let skip = margin.saturating_sub(from);
            let start = (from + skip) - margin;
            let n = (reach - skip.min(reach)).min(line.len() - start.min(line.len()));
            if n > 0 {
                line[start..start + n].iter_mut().zip(&sums[skip..skip + n]).for_each(|(o, s)| *o += *s);
            }
            from += col.len;
        }
    }
}

/// `sums[j] += Σ_b taps[b] padded[j + b]`.
struct Taps<'a, T> {
    sums: &'a mut [T],
    padded: &'a [T],
    taps: &'a [T],
}

impl<T: Real> Work for Taps<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        for (j, sums) in self.sums.chunks_exact_mut(CHUNK).enumerate() {
            let mut sum = [T::zero(); CHUNK];
            sum.copy_from_slice(sums);
            let from = &self.padded[j * CHUNK..][..CHUNK + self.taps.len() - 1];
            for (tap, x) in self.taps.iter().zip(from.windows(CHUNK)) {
                for (s, x) in sum.iter_mut().zip(x) {
                    *s += *tap * *x;
                }
            }
            sums.copy_from_slice(&sum);
        }
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
