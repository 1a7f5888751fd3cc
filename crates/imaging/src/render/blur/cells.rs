//! Each block of the image is blurred by the at most four kernels whose windows reach it.
//!
//! The spectrum of the source that the block sees (overlap-save: half a kernel around) is multiplied by the spectra of
//! the four kernels, a few columns at a time. Back in space along the rows' axis, the row windows join the four products
//! to two planes, one a column window; both are real, so one complex transform a row gives both, and the column windows
//! join them. Memory: kernel spectra of two rows of nodes and the source of one row of blocks, in strips of columns that
//! keep them below a gibibyte or so; nodes where strips meet are transformed twice.

use std::ops::Range;

use ndarray::{Array3, ArrayViewMut2, ArrayViewMut3, Axis};
use rayon::prelude::*;
use rustfft::num_complex::Complex;

use super::band::Band;
use super::frame::{Frame, SegmentPair};
use super::lines::{part, weigh};
use super::pack::{COLUMNS, Columns, next_columns, pack, product, window};
use super::plane::{Scratch, reserve};
use super::segments::Segment;
use super::spectra::NodeSpectra;
use super::{Kernels, Source};
use isoplanat_base::math::real::Real;
use isoplanat_base::math::wide::prefetch;
use isoplanat_base::stop::look;

/// What a blur keeps for the cotangents.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Keep {
    /// Nothing: there will be none.
    Nothing,
    /// The spectra of blocks with light and of the nodes that they use.
    Lit,
    /// Those of all nodes.
    All,
}

/// A block's source spectra, `[phase][column frequency][row frequency]`.
pub(super) type Kept<T> = Vec<Complex<T>>;

/// Blurs all blocks of `frame`. With `keep` the kernels' spectra stay in `spectra`, those of the source of every block
/// (`[row][col][source channel]`, none where it is dark) in the answer.
pub(super) fn blur_cells<T: Real>(
    frame: &Frame<T>,
    kernels: &dyn Kernels<T>,
    source: &dyn Source<T>,
    spectra: &mut NodeSpectra<T>,
    keep: Keep,
    progress: &(dyn Fn(f64) + Sync),
) -> (Array3<T>, Vec<Option<Kept<T>>>) {
    let shape = frame.shape;
    let groups = shape.groups();
    let mut out = Array3::from_elem((shape.channels, frame.region.rows, frame.region.cols), T::zero());
    let across = frame.cols.len() * groups.len();
    let mut kept: Vec<Option<Kept<T>>> = Vec::new();
    if keep != Keep::Nothing {
        kept.resize_with(frame.rows.len() * across, || None);
    }
    let strips = frame.strips_in_memory();
    let steps = strips.len() * frame.rows.len();
    let mut done = 0;
    let mut image = out.view_mut();
    for strip in strips {
        let cols = &frame.cols[strip.clone()];
        let mut band = Band::new(frame, cols);
        for (r, row) in frame.rows.iter().enumerate() {
            let seen = frame.seen(SegmentPair { row, col: &cols[0] });
            band.advance(source, seen.row, seen.rows);
            let lit: Vec<bool> = cols.iter().map(|col| band.lit(frame, SegmentPair { row, col })).collect();
            let dark = keep == Keep::All;
            if lit.contains(&true) || dark {
                if keep == Keep::Nothing {
                    spectra.keep(&frame.nodes(row, cols));
                }
                let seeing = cols.iter().zip(&lit).filter(|(_, lit)| **lit || dark).map(|(col, _)| col);
                spectra.add(frame, kernels, &frame.nodes(row, seeing));
            }
            let all = Row { frame, band: &band, spectra, keep };
            let from = r * across + strip.start * groups.len();
            let new = all.blur(row, cols, &lit, &mut image);
            kept.iter_mut().skip(from).zip(new).for_each(|(k, n)| *k = n);
            done += 1;
            progress(done as f64 / steps as f64);
        }
    }
    (out, kept)
}

/// One row of blocks.
struct Row<'a, T: Real> {
    frame: &'a Frame<T>,
    band: &'a Band<T>,
    spectra: &'a NodeSpectra<T>,
    keep: Keep,
}

/// The part of the image that one channel of the source lights in one block.
struct Task<'a, 'v, T> {
    place: SegmentPair<'a, T>,
    group: usize,
    channels: Range<usize>,
    out: ArrayViewMut3<'v, T>,
}

impl<T: Real> Row<'_, T> {
    fn blur(
        &self,
        row: &Segment<T>,
        cols: &[Segment<T>],
        lit: &[bool],
        image: &mut ArrayViewMut3<'_, T>,
    ) -> Vec<Option<Kept<T>>> {
        let groups = self.frame.shape.groups();
        let views = self.frame.views(image, row, cols);
        let places = cols.iter().zip(lit).flat_map(|c| groups.iter().enumerate().map(move |g| (c, g)));
        let tasks: Vec<_> = places
            .zip(views)
            .map(|(((col, lit), (group, channels)), out)| {
                lit.then(|| Task { place: SegmentPair { row, col }, group, channels: channels.clone(), out })
            })
            .collect();
        tasks.into_par_iter().map(|task| task.and_then(|t| self.block(t))).collect()
    }

    fn block(&self, task: Task<'_, '_, T>) -> Option<Kept<T>> {
        look();
        let (frame, Task { place, group, channels, mut out }) = (self.frame, task);
        frame.pool.with(&frame.plane, |scratch| {
            self.band.spectra(frame, place, group, scratch);
            for (channel, mut out) in channels.zip(out.axis_iter_mut(Axis(0))) {
                convolve(frame, self.spectra, place, channel, scratch);
                write(frame, place, &scratch.lines, &mut out);
            }
            let len = frame.shape.phases * frame.plane.spectrum_len();
            (self.keep != Keep::Nothing).then(|| scratch.spectra[..len].to_vec())
        })
    }
}

/// Leaves the lines of one channel of a block in `scratch.lines`; `scratch.spectra` holds the source's.
fn convolve<T: Real>(
    frame: &Frame<T>,
    spectra: &NodeSpectra<T>,
    place: SegmentPair<'_, T>,
    channel: usize,
    scratch: &mut Scratch<T>,
) {
    let plane = &frame.plane;
    let (count, pairing) = (place.row.len, place.pairing());
    let Scratch { buffers, spectra: source, columns, mixed, lines } = scratch;
    let nodes = frame.corners(place);
    let kernels: Vec<&[Complex<T>]> = nodes
        .iter()
        .flat_map(|n| (0..frame.shape.phases).map(|phase| spectra.plane(frame, *n, channel, phase)))
        .collect();
    reserve(columns, nodes.len() * COLUMNS * plane.rows);
    reserve(mixed, 2 * COLUMNS * count);
    reserve(lines, pairing.lines * plane.cols);
    let windows = &place.row.windows;
    for from in (0..plane.half).step_by(COLUMNS) {
        let width = (plane.half - from).min(COLUMNS);
        let span = from * plane.rows..(from + width) * plane.rows;
        let columns = &mut columns[..nodes.len() * width * plane.rows];
        products(plane.spectrum_len(), source, &kernels, frame.shape.phases, span, columns);
        // The next columns come while these are transformed.
        let next = next_columns(plane.rows, plane.half, from);
        kernels.iter().for_each(|k| prefetch(&k[next.clone()]));
        plane.columns_inverse(buffers, columns);
        for (b, columns) in columns.chunks_exact(windows.len() * width * plane.rows).enumerate() {
            for c in 0..width {
                let to = &mut mixed[c * 2 * count + b * count..][..count];
                for (a, (_, values)) in windows.iter().enumerate() {
                    let x = &columns[(a * width + c) * plane.rows + frame.shape.size - 1..][..count];
                    if a == 0 { window::<T, false>(to, x, values) } else { window::<T, true>(to, x, values) }
                }
            }
        }
        let second = if place.col.windows.len() == 2 { count } else { pairing.shift };
        let planes = [(0, pairing.lines), (second, pairing.second)];
        pack(mixed, Columns { from, count: width, stride: 2 * count, planes }, lines, plane.cols);
    }
    plane.rows_inverse(buffers, &mut lines[..pairing.lines * plane.cols]);
}

/// `columns = Σ_f source_f · kernels_f` over a span of the spectra, node by node.
fn products<T: Real>(
    len: usize,
    source: &[Complex<T>],
    kernels: &[&[Complex<T>]],
    phases: usize,
    span: Range<usize>,
    columns: &mut [Complex<T>],
) {
    for (out, kernels) in columns.chunks_exact_mut(span.len()).zip(kernels.chunks_exact(phases)) {
        for (phase, kernel) in kernels.iter().enumerate() {
            let source = &source[phase * len..][span.clone()];
            let kernel = &kernel[span.clone()];
            if phase == 0 { product::<T, false>(out, source, kernel) } else { product::<T, true>(out, source, kernel) }
        }
    }
}

/// The lines of a block, under the column windows.
fn write<T: Real>(frame: &Frame<T>, place: SegmentPair<'_, T>, lines: &[Complex<T>], out: &mut ArrayViewMut2<'_, T>) {
    let pairing = place.pairing();
    let (scale, first) = (frame.plane.scale(), frame.shape.size - 1);
    for (l, line) in lines.chunks_exact(frame.plane.cols).enumerate().take(pairing.lines) {
        let line = &line[first..first + place.col.len];
        let mut row = |i: usize, write: &dyn Fn(&mut [T])| {
            let mut row = out.row_mut(i);
            write(row.as_slice_mut().expect("rows of an image in memory"));
        };
        if place.col.windows.len() == 2 {
            row(l, &|row| weigh(line, place.windows(), scale, row));
            continue;
        }
        row(l, &|row| part::<T, 0>(line, scale, row));
        if l < pairing.second {
            row(l + pairing.shift, &|row| part::<T, 1>(line, scale, row));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::plain::{cases, difference};
    use super::super::{KernelArray, Method, SourceArray, blur};
    use crate::plane::Region;
    use crate::render::node_grid::NodeGrid;
    use ndarray::{Array4, Array5, s};

    #[test]
    fn cells_are_the_plain_sum() {
        for case in cases() {
            let method = Method::Cells { block: case.block };
            let plain = case.plain();
            let fast = blur(&case.grid, &case.kernels(), &case.source(), case.region, method, &|_| {});
            let error = difference(&fast, &plain);
            assert!(error < 1e-13, "{}: {error:e}", case.name);
            let single = case.cast::<f32>();
            let fast = blur(&case.grid, &single.kernels(), &single.source(), case.region, method, &|_| {});
            let error = difference(&fast, &single.plain());
            assert!(error < 1e-6, "{} in f32: {error:e}", case.name);
        }
    }

    /// White stays white wherever the nodes stand and whatever the kernels, as long as they sum to one.
    #[test]
    fn a_white_scene_stays_white() {
        let rng = &mut fastrand::Rng::with_seed(4);
        let grid = NodeGrid { row_knots: vec![-5, 3, 40], col_knots: vec![10, 11, 37] };
        let region = Region { row: -9, col: 0, rows: 60, cols: 50 };
        let mut kernels = Array5::from_shape_fn((grid.len(), 1, 1, 9, 9), |_| rng.f64());
        kernels.outer_iter_mut().for_each(|mut k| k /= k.sum());
        let white = Array4::ones((1, 1, 68, 58));
        let source = SourceArray { region: region.grown(4), planes: white.view() };
        for method in [Method::Cells { block: 16 }, Method::Direct] {
            let y = blur(&grid, &KernelArray(kernels.view()), &source, region, method, &|_| {});
            assert!(y.iter().all(|v| (v - 1.0).abs() < 1e-14));
        }
    }

    /// Threads change no bit; parts of a region differ by rounding alone; progress ends at one.
    #[test]
    fn results_do_not_depend_on_threads_or_regions() {
        let rng = &mut fastrand::Rng::with_seed(9);
        let grid = NodeGrid { row_knots: vec![0, 20, 50], col_knots: vec![0, 33, 40, 80] };
        let whole = Region { row: -5, col: 0, rows: 70, cols: 90 };
        let kernels = Array5::from_shape_fn((grid.len(), 3, 1, 9, 9), |_| rng.f32());
        let planes = Array4::from_shape_fn((3, 1, 78, 98), |_| rng.f32());
        let source = SourceArray { region: whole.grown(4), planes: planes.view() };
        let last = std::sync::Mutex::new(0.0);
        let of = |threads: usize, region: Region| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
            pool.install(|| {
                let set = |f: f64| *last.lock().expect("no panic") = f;
                blur(&grid, &KernelArray(kernels.view()), &source, region, Method::Cells { block: 16 }, &set)
            })
        };
        let once = of(1, whole);
        assert_eq!(once, of(3, whole));
        assert_eq!(*last.lock().expect("no panic"), 1.0);
        let part = of(2, Region { row: 10, col: 30, rows: 31, cols: 22 });
        let cut = once.slice(s![.., 15..46, 30..52]).mapv(f64::from);
        let error = difference(&part, &cut);
        assert!(error < 1e-6, "{error:e}");
    }
}
