//! The exact transposes of [`super::blur`], block by block like its cells.
//!
//! A block's cotangent is transformed once. Its correlation with the four windowed sources is added to the spectra of
//! the four nodes, which are transformed back once, when the last block of a node is done; its correlation with the four
//! kernels, windowed, is the cotangent of the block's source. Within a row of blocks every second cell is worked on at a
//! time, so that no two tasks share a node and the order of additions is fixed.

use std::collections::BTreeMap;
use std::ops::Range;

use ndarray::{Array4, Array5, ArrayView3, Axis, s};
use rayon::prelude::*;

use super::super::cfa::Real;
use super::super::node_grid::NodeGrid;
use super::super::warp::Region;
use super::frame::{Block, Frame, NodeSpectra, Shape};
use super::plane::{Scratch, add_correlation, add_weighted, reserve, zero_line};
use super::segments::{Segment, used};
use super::{Kernels, Source};
use crate::math::panel_fft::Line;

/// Pulls the cotangent of [`super::blur`] back to the kernels: `[node, channel, phase, row, col]`.
///
/// `bar` `[channel, row, col]` over `region`; `size` and `phases` are those of the kernels. Kernels of nodes whose windows
/// do not reach the source get zero. `block` as in [`super::Method::Cells`].
///
/// # Panics
/// As [`super::blur`]; if `bar` does not cover the region.
pub fn blur_kernels_vjp<T: Real>(
    grid: &NodeGrid,
    (size, phases): (usize, usize),
    source: &dyn Source<T>,
    region: Region,
    block: usize,
    bar: ArrayView3<'_, T>,
) -> Array5<T> {
    let channels = bar.len_of(Axis(0));
    let shape = Shape { size, channels, source_channels: source.channels(), phases };
    let frame = Frame::new(grid, shape, region, block);
    check(&frame, &bar);
    let mut out = Array5::from_elem((grid.len(), channels, phases, size, size), T::zero());
    let mut blocks = Vec::new();
    for strip in frame.strips_in_memory() {
        let cols = &frame.cols[strip];
        let col_nodes = used(cols);
        let mut sums = NodeSums::default();
        for row in &frame.rows {
            let row_nodes: Vec<usize> = row.windows.iter().map(|w| w.0).collect();
            sums.keep(&frame, &row_nodes, &mut out);
            frame.fill(source, row, cols, &mut blocks);
            if blocks.iter().take(cols.len()).any(|b| b.full) {
                sums.add_row(&frame, row, cols, &col_nodes, &blocks, &bar);
            }
        }
        sums.keep(&frame, &[], &mut out);
    }
    out
}

/// Pulls the cotangent of [`super::blur`] back to the source: `[channel, phase, row, col]` over
/// `region.grown(size / 2)`, the part of the source that the image sees.
///
/// `bar` `[channel, row, col]` over `region`; `source_channels` is 1 (grey) or the kernels' channels. `block` as in
/// [`super::Method::Cells`].
///
/// # Panics
/// As [`super::blur`]; if `bar` does not cover the region.
pub fn blur_source_vjp<T: Real>(
    grid: &NodeGrid,
    kernels: &dyn Kernels<T>,
    source_channels: usize,
    region: Region,
    block: usize,
    bar: ArrayView3<'_, T>,
) -> Array4<T> {
    let shape = Shape { size: kernels.size(), channels: kernels.channels(), source_channels, phases: kernels.phases() };
    let frame = Frame::new(grid, shape, region, block);
    check(&frame, &bar);
    let grown = region.grown(shape.size / 2);
    let mut out = Array4::from_elem((source_channels, shape.phases, grown.rows, grown.cols), T::zero());
    let groups = shape.groups();
    for strip in frame.strips_in_memory() {
        let cols = &frame.cols[strip];
        let col_nodes = used(cols);
        let mut spectra = NodeSpectra::new();
        for row in &frame.rows {
            let nodes: Vec<usize> =
                row.windows.iter().flat_map(|w| col_nodes.iter().map(|c| frame.node(w.0, *c))).collect();
            spectra.advance(&frame, kernels, &nodes);
            let tasks: Vec<_> =
                cols.iter().flat_map(|c| groups.iter().enumerate().map(move |(g, r)| (c, g, r))).collect();
            let parts: Vec<Vec<T>> = tasks
                .par_iter()
                .map(|(col, _, channels)| {
                    frame.pool.with(&frame.plane, |scratch| {
                        source_bar(&frame, &spectra, (row, col), (*channels).clone(), &bar, scratch)
                    })
                })
                .collect();
            for ((col, group, _), part) in tasks.iter().zip(parts) {
                let (i, j) = ((row.start - grown.row).unsigned_abs(), (col.start - grown.col).unsigned_abs());
                let part = Array4::from_shape_vec((1, shape.phases, row.len, col.len), part).expect("a block's size");
                out.slice_mut(s![*group..=*group, .., i..i + row.len, j..j + col.len]).assign(&part);
            }
        }
    }
    out
}

/// Cotangents that leave [`blur_vjp`].
pub struct BlurBar<T> {
    /// Of the kernels, `[node, channel, phase, row, col]`.
    pub kernels: Array5<T>,
    /// Of the source, `[channel, phase, row, col]` over the region and half a kernel around it.
    pub source: Array4<T>,
}

/// Both transposes: [`blur_kernels_vjp`] and [`blur_source_vjp`].
///
/// # Panics
/// As they do.
pub fn blur_vjp<T: Real>(
    grid: &NodeGrid,
    kernels: &dyn Kernels<T>,
    source: &dyn Source<T>,
    region: Region,
    block: usize,
    bar: ArrayView3<'_, T>,
) -> BlurBar<T> {
    let shape = (kernels.size(), kernels.phases());
    BlurBar {
        kernels: blur_kernels_vjp(grid, shape, source, region, block, bar),
        source: blur_source_vjp(grid, kernels, source.channels(), region, block, bar),
    }
}

fn check<T: Real>(frame: &Frame<'_, T>, bar: &ArrayView3<'_, T>) {
    let expected = (frame.shape.channels, frame.region.rows, frame.region.cols);
    assert_eq!(bar.dim(), expected, "the cotangent covers the region");
}

/// Row spectra of the cotangent of a block's tile into plane `at` of the scratch; lines outside the region are zero.
fn load_bar<T: Real>(
    frame: &Frame<'_, T>,
    (row, col): (&Segment<T>, &Segment<T>),
    plane: ArrayView3<'_, T>,
    channel: usize,
    at: usize,
    scratch: &mut Scratch<T>,
) {
    let (to_row, from_row, rows) = frame.reach(row);
    let (to_col, from_col, cols) = frame.reach_cols(col);
    frame.plane.rows_forward(scratch, at, row.len + frame.shape.size - 1, |i, line| {
        if i < from_row || i >= from_row + rows {
            return false;
        }
        let from = plane.slice(s![channel, to_row + i - from_row, to_col..to_col + cols]);
        line[from_col..from_col + cols].iter_mut().zip(from).for_each(|(l, v)| *l = *v);
        true
    });
}

/// Sums of correlations in the frequency domain, by node and channel: `[phase][panel][line]`.
#[derive(Default)]
struct NodeSums<T> {
    of: BTreeMap<(usize, usize), Vec<Line<T>>>,
    free: Vec<Vec<Line<T>>>,
}

/// A cell of one row of blocks: its blocks, its nodes and their sums.
struct Cell<T> {
    blocks: Range<usize>,
    channel: usize,
    nodes: Vec<usize>,
    sums: Vec<Vec<Line<T>>>,
}

impl<T: Real> NodeSums<T> {
    /// Writes the kernels of all nodes but those in `rows` of nodes to `out` (adding), and forgets them.
    fn keep(&mut self, frame: &Frame<'_, T>, rows: &[usize], out: &mut Array5<T>) {
        let across = frame.grid.col_knots.len();
        let gone: Vec<(usize, usize)> =
            self.of.keys().copied().filter(|(n, _)| !rows.contains(&(n / across))).collect();
        let mut taken: Vec<_> = gone.iter().filter_map(|key| self.of.remove(key).map(|s| (*key, s))).collect();
        let Shape { size, phases, .. } = frame.shape;
        let plane = &frame.plane;
        let kernels: Vec<Vec<T>> = taken
            .par_iter_mut()
            .map(|(_, sums)| {
                let mut kernel = vec![T::zero(); phases * size * size];
                frame.pool.with(plane, |scratch| {
                    reserve(&mut scratch.back, plane.panels * size);
                    for (phase, out) in kernel.chunks_exact_mut(size * size).enumerate() {
                        for p in 0..plane.panels {
                            let panel = &mut sums[(phase * plane.panels + p) * plane.rows..][..plane.rows];
                            plane.columns_inverse(panel);
                            scratch.back[p * size..][..size].copy_from_slice(&panel[..size]);
                        }
                        plane.rows_inverse(scratch, 0, size, |i, line| {
                            out[i * size..][..size].copy_from_slice(&line[..size]);
                        });
                    }
                });
                kernel
            })
            .collect();
        for (((node, channel), sums), kernel) in taken.into_iter().zip(kernels) {
            let mut to = out.slice_mut(s![node, channel, .., .., ..]);
            to.iter_mut().zip(kernel).for_each(|(o, v)| *o += v);
            self.free.push(sums);
        }
    }

    fn take(&mut self, key: (usize, usize), len: usize) -> Vec<Line<T>> {
        self.of.remove(&key).unwrap_or_else(|| {
            let mut sums = self.free.pop().unwrap_or_default();
            sums.clear();
            sums.resize(len, zero_line());
            sums
        })
    }

    fn add_row(
        &mut self,
        frame: &Frame<'_, T>,
        row: &Segment<T>,
        cols: &[Segment<T>],
        col_nodes: &[usize],
        blocks: &[Block<T>],
        bar: &ArrayView3<'_, T>,
    ) {
        let len = frame.shape.phases * frame.plane.spectrum_len();
        for parity in 0..2 {
            let mut cells: Vec<Cell<T>> = Vec::new();
            let mut from = 0;
            while from < cols.len() {
                let to = from + cols[from..].iter().take_while(|c| c.cell == cols[from].cell).count();
                if cols[from].cell % 2 == parity && blocks[from..to].iter().any(|b| b.full) {
                    let of_cell = used(&cols[from..to]);
                    debug_assert!(of_cell.iter().all(|n| col_nodes.contains(n)));
                    let nodes: Vec<usize> =
                        row.windows.iter().flat_map(|w| of_cell.iter().map(|c| frame.node(w.0, *c))).collect();
                    for channel in 0..frame.shape.channels {
                        let sums = nodes.iter().map(|n| self.take((*n, channel), len)).collect();
                        cells.push(Cell { blocks: from..to, channel, nodes: nodes.clone(), sums });
                    }
                }
                from = to;
            }
            cells.par_iter_mut().for_each(|cell| {
                frame.pool.with(&frame.plane, |scratch| {
                    for b in cell.blocks.clone().filter(|b| blocks[*b].full) {
                        correlate(frame, cell, (row, &cols[b]), &blocks[b], bar, scratch);
                    }
                });
            });
            for cell in cells {
                self.of.extend(cell.nodes.iter().map(|n| (*n, cell.channel)).zip(cell.sums));
            }
        }
    }
}

/// Adds the correlation of one block's cotangent with its windowed sources to the sums of the cell.
fn correlate<T: Real>(
    frame: &Frame<'_, T>,
    cell: &mut Cell<T>,
    (row, col): (&Segment<T>, &Segment<T>),
    block: &Block<T>,
    bar: &ArrayView3<'_, T>,
    scratch: &mut Scratch<T>,
) {
    let plane = &frame.plane;
    let count = row.len + frame.shape.size - 1;
    load_bar(frame, (row, col), bar.view(), cell.channel, 0, scratch);
    std::mem::swap(&mut scratch.rows, &mut scratch.back);
    let channel = if frame.shape.source_channels == 1 { 0 } else { cell.channel };
    frame.load(scratch, block, channel, row, col);
    reserve(&mut scratch.sums, plane.rows);
    for p in 0..plane.panels {
        let Scratch { sums, back, .. } = scratch;
        plane.columns_forward(&back[p * count..][..count], None, &mut sums[..plane.rows]);
        for phase in 0..frame.shape.phases {
            for (b, (col_node, _)) in col.windows.iter().enumerate() {
                for (row_node, window) in &row.windows {
                    frame.panel(scratch, phase, b, p, window);
                    let node = frame.node(*row_node, *col_node);
                    let at = cell.nodes.iter().position(|n| *n == node).expect("a node of the cell");
                    let to = &mut cell.sums[at][(phase * plane.panels + p) * plane.rows..][..plane.rows];
                    add_correlation(to, &scratch.panel, &scratch.sums[..plane.rows]);
                }
            }
        }
    }
}

/// Cotangent of one block's source, `[phase][row][col]`: summed over the image channels that share it.
fn source_bar<T: Real>(
    frame: &Frame<'_, T>,
    spectra: &NodeSpectra<T>,
    (row, col): (&Segment<T>, &Segment<T>),
    channels: Range<usize>,
    bar: &ArrayView3<'_, T>,
    scratch: &mut Scratch<T>,
) -> Vec<T> {
    let plane = &frame.plane;
    let phases = frame.shape.phases;
    let count = row.len + frame.shape.size - 1;
    for (i, channel) in channels.clone().enumerate() {
        load_bar(frame, (row, col), bar.view(), channel, i, scratch);
    }
    let lines = plane.panels * row.len;
    reserve(&mut scratch.back, 2 * phases * lines);
    scratch.back[..2 * phases * lines].fill(zero_line());
    reserve(&mut scratch.sums, channels.len() * plane.rows);
    let Scratch { rows, panel, sums, back, .. } = scratch;
    for p in 0..plane.panels {
        for (i, sums) in sums.chunks_exact_mut(plane.rows).take(channels.len()).enumerate() {
            plane.columns_forward(&rows[(i * plane.panels + p) * count..][..count], None, sums);
        }
        for phase in 0..phases {
            for (b, (col_node, _)) in col.windows.iter().enumerate() {
                for (row_node, window) in &row.windows {
                    let node = frame.node(*row_node, *col_node);
                    panel.fill(zero_line());
                    for (sums, channel) in sums.chunks_exact(plane.rows).zip(channels.clone()) {
                        add_correlation(panel, spectra.panel(frame, node, channel, phase, p), sums);
                    }
                    plane.columns_inverse(panel);
                    let to = &mut back[(2 * phase + b) * lines + p * row.len..][..row.len];
                    add_weighted(to, &panel[..row.len], window);
                }
            }
        }
    }
    let mut out = vec![T::zero(); phases * row.len * col.len];
    for (phase, out) in out.chunks_exact_mut(row.len * col.len).enumerate() {
        for (b, (_, window)) in col.windows.iter().enumerate() {
            plane.rows_inverse(scratch, 2 * phase + b, row.len, |i, line| {
                let to = &mut out[i * col.len..][..col.len];
                for ((to, v), w) in to.iter_mut().zip(line).zip(window) {
                    *to += *v * *w;
                }
            });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::plain::{Case, cases};
    use super::super::{Method, blur};
    use super::*;
    use ndarray::Array3;

    fn dot<T: Real>(a: impl IntoIterator<Item = T>, b: impl IntoIterator<Item = T>) -> f64 {
        a.into_iter().zip(b).map(|(a, b)| a.to_double() * b.to_double()).sum()
    }

    /// ⟨ȳ, y⟩ = ⟨k̄, k⟩ = ⟨s̄, s⟩, relative to ‖ȳ‖ ‖y‖: the map is linear in kernels and in source.
    fn check<T: Real>(case: &Case<T>, tolerance: f64) {
        let rng = &mut fastrand::Rng::with_seed(8);
        let method = Method::Cells { block: case.block };
        let y = blur(&case.grid, &case.kernels(), &case.source(), case.region, method, &|_| {});
        let bar = Array3::from_shape_fn(y.dim(), |_| T::real(rng.f64() - 0.5));
        let pairing = dot(y.iter().copied(), bar.iter().copied());
        let scale = (dot(y.iter().copied(), y.iter().copied()) * dot(bar.iter().copied(), bar.iter().copied())).sqrt();
        let bars = blur_vjp(&case.grid, &case.kernels(), &case.source(), case.region, case.block, bar.view());
        let (kernels_bar, source_bar) = (bars.kernels, bars.source);
        assert_eq!((kernels_bar.dim(), source_bar.dim()), (case.kernels.dim(), case.planes.dim()));
        let kernels = dot(kernels_bar.iter().copied(), case.kernels.iter().copied());
        let source = dot(source_bar.iter().copied(), case.planes.iter().copied());
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

    /// The pairing cannot see a wrong cotangent orthogonal to the point; one entry at a time can.
    #[test]
    fn blur_vjps_agree_entry_by_entry() {
        let rng = &mut fastrand::Rng::with_seed(5);
        for case in cases().iter().filter(|c| !c.kernels.is_empty() && !c.planes.is_empty()) {
            let method = Method::Cells { block: case.block };
            let (_, _, phases, size, _) = case.kernels.dim();
            let dim = (case.kernels.dim().1, case.region.rows, case.region.cols);
            let bar = Array3::from_shape_fn(dim, |_| rng.f64() - 0.5);
            let kernels_bar =
                blur_kernels_vjp(&case.grid, (size, phases), &case.source(), case.region, case.block, bar.view());
            let source_bar =
                blur_source_vjp(&case.grid, &case.kernels(), case.planes.dim().0, case.region, case.block, bar.view());
            for _ in 0..3 {
                let mut unit = case.cast::<f64>();
                unit.kernels.fill(0.0);
                let at = rng.usize(..unit.kernels.len());
                *unit.kernels.iter_mut().nth(at).expect("inside") = 1.0;
                let y = blur(&unit.grid, &unit.kernels(), &case.source(), unit.region, method, &|_| {});
                let (pulled, pushed) = (*kernels_bar.iter().nth(at).expect("inside"), (&y * &bar).sum());
                assert!((pulled - pushed).abs() < 1e-11, "{}: kernel {at}: {pulled} {pushed}", case.name);
                unit.planes.fill(0.0);
                let at = rng.usize(..unit.planes.len());
                *unit.planes.iter_mut().nth(at).expect("inside") = 1.0;
                let y = blur(&unit.grid, &case.kernels(), &unit.source(), unit.region, method, &|_| {});
                let (pulled, pushed) = (*source_bar.iter().nth(at).expect("inside"), (&y * &bar).sum());
                assert!((pulled - pushed).abs() < 1e-11, "{}: source {at}: {pulled} {pushed}", case.name);
            }
        }
    }

    #[test]
    fn blur_kernels_vjp_does_not_depend_on_threads() {
        for case in cases().iter().take(4) {
            let (_, channels, phases, size, _) = case.kernels.dim();
            let bar = Array3::from_shape_fn((channels, case.region.rows, case.region.cols), |(c, i, j)| {
                (c + 3 * i + 7 * j) as f64 * 0.1
            });
            let of = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
                let (source, block) = (case.source(), case.block);
                pool.install(|| blur_kernels_vjp(&case.grid, (size, phases), &source, case.region, block, bar.view()))
            };
            assert_eq!(of(1), of(3), "{}", case.name);
        }
    }
}
