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

use super::correlate::{Block, Sums};
use super::frame::{Frame, Place, Shape};
use super::node_sums::NodeSums;
use super::record::{BlurRecord, Wanted};
use super::segments::{Segment, used};
use crate::math::real::Real;

/// Cotangents that leave [`blur_vjp`].
#[derive(Clone, Debug)]
pub struct BlurBar<T> {
    /// Of the kernels, `[node, channel, phase, row, col]`.
    pub kernels: Array5<T>,
    /// Of the source, `[channel, phase, row, col]` over the region and half a kernel around it.
    pub source: Array4<T>,
}

/// Pulls the cotangent of [`super::blur`] back to the kernels: `[node, channel, phase, row, col]`.
///
/// `bar` `[channel, row, col]` over the region. Kernels of nodes that no lit block uses get zero. Memory: the answer, and
/// spectra of three rows of nodes.
///
/// # Panics
/// If `bar` does not cover the region, or the record was not made for the kernels' cotangent.
pub fn blur_kernels_vjp<T: Real>(record: &BlurRecord<T>, bar: ArrayView3<'_, T>) -> Array5<T> {
    record.check(&bar, Wanted::Kernels);
    let mut kernels = kernels_like(&record.frame);
    Pull { record, bar: bar.as_standard_layout().view() }.run(Some(&mut kernels), None);
    kernels
}

/// Pulls the cotangent of [`super::blur`] back to the source: `[channel, phase, row, col]` over
/// `region.grown(size / 2)`, the part of the source that the image sees.
///
/// `bar` `[channel, row, col]` over the region. Memory: the answer, and what one row of blocks sees.
///
/// # Panics
/// If `bar` does not cover the region, or the record was not made for the source's cotangent.
pub fn blur_source_vjp<T: Real>(record: &BlurRecord<T>, bar: ArrayView3<'_, T>) -> Array4<T> {
    record.check(&bar, Wanted::Source);
    let mut source = source_like(&record.frame);
    Pull { record, bar: bar.as_standard_layout().view() }.run(None, Some(&mut source));
    source
}

/// Both transposes, the cotangent transformed once.
///
/// # Panics
/// If `bar` does not cover the region, or the record was not made for [`Wanted::Both`].
pub fn blur_vjp<T: Real>(record: &BlurRecord<T>, bar: ArrayView3<'_, T>) -> BlurBar<T> {
    record.check(&bar, Wanted::Both);
    let mut all = BlurBar { kernels: kernels_like(&record.frame), source: source_like(&record.frame) };
    Pull { record, bar: bar.as_standard_layout().view() }.run(Some(&mut all.kernels), Some(&mut all.source));
    all
}

fn kernels_like<T: Real>(frame: &Frame<T>) -> Array5<T> {
    let Shape { size, channels, phases, .. } = frame.shape;
    Array5::from_elem((frame.grid.len(), channels, phases, size, size), T::zero())
}

fn source_like<T: Real>(frame: &Frame<T>) -> Array4<T> {
    let grown = frame.region.grown(frame.shape.size / 2);
    Array4::from_elem((frame.shape.source_channels, frame.shape.phases, grown.rows, grown.cols), T::zero())
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
    sums: Option<Sums<T>>,
    /// What the source gets, by block.
    tiles: Vec<Vec<T>>,
}

impl<T: Real> Pull<'_, T> {
    fn run(&self, mut kernels: Option<&mut Array5<T>>, mut source: Option<&mut Array4<T>>) {
        let frame = &self.record.frame;
        for strip in frame.strips_in_memory() {
            let cols = &frame.cols[strip.clone()];
            let mut sums = NodeSums::default();
            for (r, row) in frame.rows.iter().enumerate() {
                for parity in 0..2 {
                    let mut cells = self.cells(r, cols, strip.start, parity, source.is_some());
                    let wanted = source.is_some();
                    let work = |cells: &mut Vec<Cell<T>>| cells.par_iter_mut().for_each(|c| self.cell(r, c, wanted));
                    if let Some(out) = kernels.as_deref_mut() {
                        let mut done = sums.done(&frame.nodes(row, cols));
                        for cell in &mut cells {
                            let nodes = cell_nodes(frame, row, &frame.cols[cell.blocks.clone()]);
                            cell.sums = Some(sums.take(frame, nodes, cell.channels.clone()));
                        }
                        rayon::join(|| done.finish(frame, out), || work(&mut cells));
                        sums.reuse(done);
                    } else {
                        work(&mut cells);
                    }
                    for cell in cells {
                        if let Some(out) = source.as_deref_mut() {
                            add_tiles(frame, row, &cell, out);
                        }
                        if let Some(of_cell) = cell.sums {
                            sums.give(of_cell);
                        }
                    }
                }
            }
            if let Some(out) = kernels.as_deref_mut() {
                sums.done(&[]).finish(frame, out);
            }
        }
    }

    /// Cells of a row of blocks whose number is even or odd; dark ones matter only to the source, if at all.
    fn cells(&self, r: usize, cols: &[Segment<T>], first: usize, parity: usize, source: bool) -> Vec<Cell<T>> {
        let shape = self.record.frame.shape;
        let dark = source && self.record.dark();
        // The source's cotangent is summed over the channels that share it; else every channel is a task.
        let groups: Vec<_> = if source || shape.source_channels > 1 {
            shape.groups().into_iter().enumerate().collect()
        } else {
            (0..shape.channels).map(|c| (0, c..c + 1)).collect()
        };
        let mut cells = Vec::new();
        let mut from = 0;
        while from < cols.len() {
            let to = from + cols[from..].iter().take_while(|c| c.cell == cols[from].cell).count();
            let blocks = first + from..first + to;
            if cols[from].cell % 2 == parity {
                for (group, channels) in &groups {
                    if dark || blocks.clone().any(|b| self.record.seen(r, b, *group).is_some()) {
                        let (blocks, channels) = (blocks.clone(), channels.clone());
                        cells.push(Cell { blocks, group: *group, channels, sums: None, tiles: Vec::new() });
                    }
                }
            }
            from = to;
        }
        cells
    }

    fn cell(&self, r: usize, cell: &mut Cell<T>, source: bool) {
        let frame = &self.record.frame;
        frame.pool.with(&frame.plane, |scratch| {
            for b in cell.blocks.clone() {
                let place = Place { row: &frame.rows[r], col: &frame.cols[b] };
                let seen = self.record.seen(r, b, cell.group);
                let block = Block { frame, place, kernels: &self.record.kernels, seen, source };
                if seen.is_none() && !(source && self.record.dark()) {
                    cell.tiles.push(Vec::new());
                    continue;
                }
                block.start(scratch);
                for channel in cell.channels.clone() {
                    block.add(self.bar, channel, cell.sums.as_mut(), scratch);
                }
                if source {
                    cell.tiles.push(block.tile(scratch));
                }
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
        let seen = frame.seen(Place { row, col });
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

    fn recorded<T: Real>(case: &Case<T>, wanted: Wanted) -> (Array3<T>, BlurRecord<T>) {
        blur_recorded(&case.grid, &case.kernels(), &case.source(), case.region, case.block, wanted)
    }

    fn random<T: Real>(dim: (usize, usize, usize), rng: &mut fastrand::Rng) -> Array3<T> {
        Array3::from_shape_fn(dim, |_| T::real(rng.f64() - 0.5))
    }

    /// ⟨ȳ, y⟩ = ⟨k̄, k⟩ = ⟨s̄, s⟩, relative to ‖ȳ‖ ‖y‖: the map is linear in kernels and in source.
    fn check<T: Real>(case: &Case<T>, tolerance: f64) {
        let rng = &mut fastrand::Rng::with_seed(8);
        let (y, record) = recorded(case, Wanted::Both);
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
            let bars = blur_vjp(&recorded(&case, Wanted::Both).1, bar.view());
            let single = case.cast::<f32>();
            let (single, bar) = (recorded(&single, Wanted::Both).1, bar.mapv(|v| v as f32));
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

    /// One cotangent alone is that of both, from a smaller record, and the image is that of the blur, to the bit.
    #[test]
    fn what_is_not_wanted_is_left_out() {
        for case in cases() {
            let image = blur(
                &case.grid,
                &case.kernels(),
                &case.source(),
                case.region,
                Method::Cells { block: case.block },
                &|_| {},
            );
            let (y, both) = recorded(&case, Wanted::Both);
            assert_eq!(y, image, "{}", case.name);
            let bar = image.mapv(|v| (v * 3.0).sin());
            let bars = blur_vjp(&both, bar.view());
            let (_, kernels) = recorded(&case, Wanted::Kernels);
            let (_, source) = recorded(&case, Wanted::Source);
            let error = difference(&blur_kernels_vjp(&kernels, bar.view()), &bars.kernels);
            assert!(error < 1e-14, "{}: {error:e}", case.name);
            assert_eq!(blur_source_vjp(&source, bar.view()), bars.source, "{}", case.name);
            assert_eq!(kernels.bytes() + source.bytes(), both.bytes());
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
                pool.install(|| blur_vjp(&recorded(&case, Wanted::Both).1, bar.view()))
            };
            let (one, three) = (of(1), of(3));
            assert_eq!(one.kernels, three.kernels, "{}", case.name);
            assert_eq!(one.source, three.source, "{}", case.name);
        }
    }
}
