//! Each block of the source is blurred by the at most four kernels whose windows reach it.
//!
//! The windows are separable, so the row transforms of two column-windowed blocks serve all four nodes; row windows are
//! put on between the passes, the products are summed in the frequency domain, and there is one inverse a block and
//! channel. Memory: kernel spectra of two rows of nodes and tiles of one row of blocks, in strips of columns that keep
//! them below a gibibyte or so; nodes where strips meet are transformed twice.

use std::ops::Range;

use ndarray::Array3;

use super::super::cfa::Real;
use super::super::node_grid::NodeGrid;
use super::super::warp::Region;
use super::frame::{Frame, NodeSpectra, Shape};
use super::overlap::{Convolver, Place, overlap_add};
use super::plane::{Scratch, add_product, reserve, zero_line};
use super::segments::{Segment, used};
use super::{Kernels, Source};

pub(super) fn blur_cells<T: Real>(
    grid: &NodeGrid,
    kernels: &dyn Kernels<T>,
    source: &dyn Source<T>,
    region: Region,
    block: usize,
    progress: &(dyn Fn(f64) + Sync),
) -> Array3<T> {
    let shape = Shape {
        size: kernels.size(),
        channels: kernels.channels(),
        source_channels: source.channels(),
        phases: kernels.phases(),
    };
    let frame = Frame::new(grid, shape, region, block);
    overlap_add(&frame, source, &mut Cells { kernels, spectra: NodeSpectra::new() }, progress)
}

/// Kernels, and the spectra of those in use.
struct Cells<'a, T> {
    kernels: &'a dyn Kernels<T>,
    spectra: NodeSpectra<T>,
}

impl<T: Real> Convolver<T> for Cells<'_, T> {
    fn prepare(&mut self, frame: &Frame<'_, T>, row: &Segment<T>, cols: &[Segment<T>]) {
        let across = used(cols);
        let nodes: Vec<usize> = row.windows.iter().flat_map(|w| across.iter().map(|c| frame.node(w.0, *c))).collect();
        self.spectra.advance(frame, self.kernels, &nodes);
    }

    fn convolve(
        &self,
        frame: &Frame<'_, T>,
        Place { row, col, block }: Place<'_, T>,
        source_channel: usize,
        channels: Range<usize>,
        scratch: &mut Scratch<T>,
    ) {
        let plane = &frame.plane;
        let (_, first, count) = frame.reach(row);
        frame.load(scratch, block, source_channel, row, col);
        reserve(&mut scratch.sums, channels.len() * plane.rows);
        reserve(&mut scratch.back, channels.len() * plane.panels * count);
        for p in 0..plane.panels {
            scratch.sums[..channels.len() * plane.rows].fill(zero_line());
            for phase in 0..frame.shape.phases {
                for (b, (col_node, _)) in col.windows.iter().enumerate() {
                    for (row_node, window) in &row.windows {
                        frame.panel(scratch, phase, b, p, window);
                        let node = frame.node(*row_node, *col_node);
                        for (sums, channel) in scratch.sums.chunks_exact_mut(plane.rows).zip(channels.clone()) {
                            add_product(sums, &scratch.panel, self.spectra.panel(frame, node, channel, phase, p));
                        }
                    }
                }
            }
            for (i, sums) in scratch.sums.chunks_exact_mut(plane.rows).take(channels.len()).enumerate() {
                plane.columns_inverse(sums);
                scratch.back[(i * plane.panels + p) * count..][..count].copy_from_slice(&sums[first..first + count]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::plain::{cases, difference};
    use super::super::{KernelArray, Method, SourceArray, blur};
    use super::*;
    use ndarray::{Array4, Array5, Axis, s};

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

    /// The other convolution of this crate, where both apply.
    #[test]
    fn cells_agree_with_the_convolution_of_a_region() {
        use super::super::super::{convolve::convolve, patches::NodeRaster};
        let rng = &mut fastrand::Rng::with_seed(7);
        let region = Region { row: 3, col: -2, rows: 40, cols: 27 };
        let grown = region.grown(3);
        let raster = NodeRaster::over(grown, 12);
        let kernels = Array4::from_shape_fn((raster.len(), 2, 7, 7), |_| rng.f64());
        let source = Array3::from_shape_fn((2, grown.rows, grown.cols), |_| rng.f64());
        let ones = ndarray::Array2::ones((raster.len(), 2));
        let (old, _) = convolve(raster, &kernels, &ones, source.view(), region);
        let kernels = kernels.insert_axis(Axis(2));
        let planes = source.insert_axis(Axis(1));
        let new = blur(
            &NodeGrid::uniform(grown, 12),
            &KernelArray(kernels.view()),
            &SourceArray { region: grown, planes: planes.view() },
            region,
            Method::Cells { block: 5 },
            &|_| {},
        );
        assert!(difference(&new, &old) < 1e-13);
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
