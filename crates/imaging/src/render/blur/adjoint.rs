//! The exact transposes of [`super::blur`], block by block like its cells.
//!
//! A block's cotangent goes the way of its image backwards: column windows and one complex transform a row, row windows,
//! columns. Its correlation with the spectrum of the source that the block saw is added to the spectra of the four nodes,
//! which are transformed back once, when the last block of a node is done; its correlation with the four kernels is the
//! cotangent of the source that the block saw. Within a row of blocks every second cell is worked on at a time, so that
//! no two tasks share a node and the order of additions is fixed.

use std::ops::Range;

use ndarray::{Array4, Array5, ArrayView3, s};
use rayon::prelude::*;

use super::correlate::{Block, CellSums};
use super::frame::{Frame, SegmentPair, Shape};
use super::node_sums::NodeSums;
use super::record::BlurRecord;
use super::segments::{Segment, used};
use isoplanat_base::math::real::Real;
use isoplanat_base::stop::look;

/// Cotangents that leave [`blur_vjp`].
#[derive(Clone, Debug)]
pub struct BlurBar<T> {
    /// Of the kernels, `[node, channel, phase, row, col]`.
    pub kernels: Array5<T>,
    /// Of the source, `[channel, phase, row, col]` over the region and half a kernel around it.
    pub source: Array4<T>,
}

/// Pulls the cotangent of [`super::blur`] back to the kernels and to the part of the source that the image sees; `bar`
/// `[channel, row, col]` over the region.
///
/// Kernels of nodes that no lit block uses get zero. Memory: the answer, spectra of three rows of nodes, and what one row of
/// blocks sees.
///
/// # Panics
/// If `bar` does not cover the region.
pub fn blur_vjp<T: Real>(record: &BlurRecord<T>, bar: ArrayView3<'_, T>) -> BlurBar<T> {
    let Frame { grid, shape, region, .. } = &record.frame;
    assert_eq!(bar.dim(), (shape.channels, region.rows, region.cols), "the cotangent covers the region");
    let Shape { size, channels, source_channels, phases } = *shape;
    let seen = region.grown(size / 2);
    let mut all = BlurBar {
        kernels: Array5::from_elem((grid.len(), channels, phases, size, size), T::zero()),
        source: Array4::from_elem((source_channels, phases, seen.rows, seen.cols), T::zero()),
    };
    Pull { record, bar: bar.as_standard_layout().view() }.run(&mut all);
    all
}

struct Pull<'a, T: Real> {
    record: &'a BlurRecord<T>,
    bar: ArrayView3<'a, T>,
}

/// The blocks of one cell in one row of blocks, for image channels that share a channel of the source.
struct Cell<T> {
    blocks: Range<usize>,
    group: usize,
    channels: Range<usize>,
    /// Of the kernels, by channel and node.
    sums: CellSums<T>,
    /// What the source gets, by block.
    tiles: Vec<Vec<T>>,
}

impl<T: Real> Pull<'_, T> {
    fn run(&self, all: &mut BlurBar<T>) {
        let frame = &self.record.frame;
        for strip in frame.strips_in_memory() {
            let cols = &frame.cols[strip.clone()];
            let mut sums = NodeSums::default();
            for (r, row) in frame.rows.iter().enumerate() {
                for parity in 0..2 {
                    let mut done = sums.done(&frame.nodes(row, cols));
                    let mut cells = self.cells((r, cols), strip.start, parity, |blocks, channels| {
                        let nodes = cell_nodes(frame, row, &frame.cols[blocks]);
                        sums.take(frame, nodes, channels)
                    });
                    let work = || cells.par_iter_mut().for_each(|c| self.cell(r, c));
                    rayon::join(|| done.finish(frame, &mut all.kernels), work);
                    sums.reuse(done);
                    for cell in cells {
                        add_tiles(frame, row, &cell, &mut all.source);
                        sums.give(cell.sums);
                    }
                }
            }
            sums.done(&[]).finish(frame, &mut all.kernels);
        }
    }

    /// Cells of a row of blocks whose number is even or odd, a task for the channels that share a channel of the source; dark ones
    /// matter only to the source, if at all.
    fn cells(
        &self,
        (r, cols): (usize, &[Segment<T>]),
        first: usize,
        parity: usize,
        mut sums: impl FnMut(Range<usize>, Range<usize>) -> CellSums<T>,
    ) -> Vec<Cell<T>> {
        let groups = self.record.frame.shape.groups();
        let mut cells = Vec::new();
        let mut from = 0;
        while from < cols.len() {
            let to = from + cols[from..].iter().take_while(|c| c.cell == cols[from].cell).count();
            let blocks = first + from..first + to;
            if cols[from].cell % 2 == parity {
                for (group, channels) in groups.iter().cloned().enumerate() {
                    if !self.record.dark && blocks.clone().all(|b| self.record.seen(r, b, group).is_none()) {
                        continue;
                    }
                    let sums = sums(blocks.clone(), channels.clone());
                    cells.push(Cell { blocks: blocks.clone(), group, channels, sums, tiles: Vec::new() });
                }
            }
            from = to;
        }
        cells
    }

    fn cell(&self, r: usize, cell: &mut Cell<T>) {
        let frame = &self.record.frame;
        frame.pool.with(&frame.plane, |scratch| {
            for b in cell.blocks.clone() {
                look();
                let place = SegmentPair { row: &frame.rows[r], col: &frame.cols[b] };
                let seen = self.record.seen(r, b, cell.group);
                if seen.is_none() && !self.record.dark {
                    cell.tiles.push(Vec::new());
                    continue;
                }
                let block = Block { frame, place, kernels: &self.record.kernels, seen };
                block.start(scratch);
                for channel in cell.channels.clone() {
                    block.add(self.bar, channel, &mut cell.sums, scratch);
                }
                cell.tiles.push(block.tile(scratch));
            }
        });
    }
}

/// The nodes of a cell's blocks.
fn cell_nodes<T: Real>(frame: &Frame<T>, row: &Segment<T>, cols: &[Segment<T>]) -> Vec<usize> {
    let across = used(cols);
    across.iter().flat_map(|c| row.windows.iter().map(|r| frame.node(r.0, *c))).collect()
}

/// Adds what the blocks of a cell saw, from left to right.
fn add_tiles<T: Real>(frame: &Frame<T>, row: &Segment<T>, cell: &Cell<T>, out: &mut Array4<T>) {
    for (b, tile) in cell.blocks.clone().zip(&cell.tiles) {
        let col = &frame.cols[b];
        let seen = frame.seen(SegmentPair { row, col });
        let (i, j) = ((row.start - frame.region.row).unsigned_abs(), (col.start - frame.region.col).unsigned_abs());
        for (phase, tile) in tile.chunks_exact(seen.rows * seen.cols).enumerate() {
            let mut to = out.slice_mut(s![cell.group, phase, i..i + seen.rows, j..j + seen.cols]);
            for (mut to, from) in to.outer_iter_mut().zip(tile.chunks_exact(seen.cols)) {
                let to = to.as_slice_mut().expect("rows of a plane in memory");
                to.iter_mut().zip(from).for_each(|(t, f)| *t += *f);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::plain::{Case, cases, difference};
    use super::super::{Method, blur, blur_recorded};
    use super::*;
    use ndarray::Array3;

    fn dot<T: Real>(a: impl IntoIterator<Item = T>, b: impl IntoIterator<Item = T>) -> f64 {
        a.into_iter().zip(b).map(|(a, b)| a.to_double() * b.to_double()).sum()
    }

    fn recorded<T: Real>(case: &Case<T>) -> (Array3<T>, BlurRecord<T>) {
        blur_recorded(&case.grid, &case.kernels(), &case.source(), case.region, case.block, true)
    }

    fn random<T: Real>(dim: (usize, usize, usize), rng: &mut fastrand::Rng) -> Array3<T> {
        Array3::from_shape_fn(dim, |_| T::real(rng.f64() - 0.5))
    }

    /// ⟨ȳ, y⟩ = ⟨k̄, k⟩ = ⟨s̄, s⟩, relative to ‖ȳ‖ ‖y‖: the map is linear in kernels and in source.
    fn check<T: Real>(case: &Case<T>, tolerance: f64) {
        let rng = &mut fastrand::Rng::with_seed(8);
        let (y, record) = recorded(case);
        let bar = random::<T>(y.dim(), rng);
        let pairing = dot(y.iter().copied(), bar.iter().copied());
        let scale = (dot(y.iter().copied(), y.iter().copied()) * dot(bar.iter().copied(), bar.iter().copied())).sqrt();
        let bars = blur_vjp(&record, bar.view());
        assert_eq!((bars.kernels.dim(), bars.source.dim()), (case.kernels.dim(), case.planes.dim()));
        let kernels = dot(bars.kernels.iter().copied(), case.kernels.iter().copied());
        let source = dot(bars.source.iter().copied(), case.planes.iter().copied());
        for (pulled, what) in [(kernels, "kernels"), (source, "source")] {
            let error = (pulled - pairing).abs();
            assert!(error <= tolerance * scale, "{}, {what}: {pulled} against {pairing} of {scale}", case.name);
        }
    }

    #[test]
    fn blur_vjps_are_the_transposes() {
        for case in cases() {
            check(&case, 1e-12);
            check(&case.cast::<f32>(), 1e-5);
        }
    }

    /// The plain sum's derivative along each entry: `k̄(t) = Σ_p ȳ w s(p − t)`, `s̄(q) = Σ_t Σ_n k_n(t) (w_n ȳ)(q + t)`.
    #[test]
    fn blur_vjps_are_the_plain_sums() {
        let rng = &mut fastrand::Rng::with_seed(5);
        for case in cases() {
            let (_, channels, ..) = case.kernels.dim();
            let bar = random::<f64>((channels, case.region.rows, case.region.cols), rng);
            let (kernels, source) = case.plain_vjp(&bar);
            let bars = blur_vjp(&recorded(&case).1, bar.view());
            let single = case.cast::<f32>();
            let (single, bar) = (recorded(&single).1, bar.mapv(|v| v as f32));
            let singles = blur_vjp(&single, bar.view());
            for (error, tolerance) in [
                (difference(&bars.kernels, &kernels), 1e-12),
                (difference(&bars.source, &source), 1e-12),
                (difference(&singles.kernels, &kernels), 1e-5),
                (difference(&singles.source, &source), 1e-5),
            ] {
                assert!(error <= tolerance, "{}: {error:e} of {tolerance:e}", case.name);
            }
        }
    }

    /// The recorded image is that of the blur, to the bit.
    #[test]
    fn a_recorded_image_is_the_blurs() {
        for case in cases() {
            let method = Method::Cells { block: case.block };
            let image = blur(&case.grid, &case.kernels(), &case.source(), case.region, method, &|_| {});
            assert_eq!(recorded(&case).0, image, "{}", case.name);
        }
    }

    #[test]
    fn vjps_do_not_depend_on_threads() {
        for case in cases() {
            let channels = case.kernels.dim().1;
            let dim = (channels, case.region.rows, case.region.cols);
            let bar = Array3::from_shape_fn(dim, |(c, i, j)| (c + 3 * i + 7 * j) as f64 * 0.1);
            let of = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
                pool.install(|| blur_vjp(&recorded(&case).1, bar.view()))
            };
            let (one, three) = (of(1), of(3));
            assert_eq!(one.kernels, three.kernels, "{}", case.name);
            assert_eq!(one.source, three.source, "{}", case.name);
        }
    }
}
