//! Blur by eigen-PSFs: `y = Σ_j E_j * (a_j s)` with `a_j = Σ_n w_n c_j(n)`; blocks of any size.

use std::ops::Range;

use ndarray::{Array3, Axis};
use rayon::prelude::*;

use super::super::cfa::Real;
use super::super::node_grid::{Between, NodeGrid};
use super::super::warp::Region;
use super::Source;
use super::eigen::EigenKernels;
use super::frame::{Frame, Shape};
use super::overlap::{Convolver, Place, overlap_add};
use super::plane::{Scratch, add_product, reserve, zero_line};
use super::segments::Segment;
use crate::math::panel_fft::Line;

/// Blurs by decomposed kernels; else as [`super::blur`]. The spectra of all components stay in memory.
///
/// # Panics
/// If the grid is empty, there is no channel, or the source's channels do not fit.
pub fn blur_low_rank<T: Real>(
    grid: &NodeGrid,
    eigen: &EigenKernels<T>,
    source: &dyn Source<T>,
    region: Region,
    block: usize,
    progress: &(dyn Fn(f64) + Sync),
) -> Array3<T> {
    let (_, phases, size, _) = eigen.components.first().expect("kernels have channels").dim();
    let shape = Shape { size, channels: eigen.components.len(), source_channels: source.channels(), phases };
    // One node: blocks are cut nowhere else than every `block` pixels.
    let (row, col) = grid.pixel(0);
    let single = NodeGrid::single(row, col);
    let frame = Frame::new(&single, shape, region, block);
    overlap_add(&frame, source, &mut LowRank::new(grid, eigen, &frame), progress)
}

struct LowRank<'a, T> {
    grid: &'a NodeGrid,
    eigen: &'a EigenKernels<T>,
    /// By channel: `[component][phase][panel][line]`.
    spectra: Vec<Vec<Line<T>>>,
}

impl<'a, T: Real> LowRank<'a, T> {
    fn new(grid: &'a NodeGrid, eigen: &'a EigenKernels<T>, frame: &Frame<'_, T>) -> Self {
        let (len, size) = (frame.plane.spectrum_len(), frame.shape.size);
        let spectra = eigen.components.iter().map(|components| {
            let mut all = vec![zero_line(); components.len_of(Axis(0)) * frame.shape.phases * len];
            let planes = components.as_slice().expect("standard layout").par_chunks_exact(size * size);
            all.par_chunks_exact_mut(len).zip(planes).for_each(|(out, plane)| {
                frame.pool.with(&frame.plane, |scratch| {
                    frame.plane.rows_forward(scratch, 0, size, |i, line| {
                        line[..size].copy_from_slice(&plane[i * size..][..size]);
                        true
                    });
                    frame.plane.spectrum(scratch, size, out);
                });
            });
            all
        });
        Self { grid, eigen, spectra: spectra.collect() }
    }
}

impl<T: Real> Convolver<T> for LowRank<'_, T> {
    fn prepare(&mut self, _: &Frame<'_, T>, _: &Segment<T>, _: &[Segment<T>]) {}

    fn convolve(
        &self,
        frame: &Frame<'_, T>,
        Place { row, col, block }: Place<'_, T>,
        source_channel: usize,
        channels: Range<usize>,
        scratch: &mut Scratch<T>,
    ) {
        let plane = &frame.plane;
        let (len, phases) = (plane.spectrum_len(), frame.shape.phases);
        let (_, first, count) = frame.reach(row);
        reserve(&mut scratch.back, channels.len() * plane.panels * count);
        reserve(&mut scratch.sums, len);
        let across: Vec<Between> =
            (0..col.len).map(|i| NodeGrid::between(&self.grid.col_knots, col.start + i.cast_signed())).collect();
        for (i, channel) in channels.enumerate() {
            scratch.sums[..len].fill(zero_line());
            for (j, coefficients) in self.eigen.coefficients[channel].outer_iter().enumerate() {
                let coefficients = coefficients.to_slice().expect("standard layout");
                for phase in 0..phases {
                    let source = block.plane(frame, row, col, source_channel, phase);
                    let mut knots = Vec::new();
                    plane.rows_forward(scratch, 0, row.len, |r, line| {
                        self.down(coefficients, row.start + r.cast_signed(), &mut knots);
                        let from = source[r * col.len..][..col.len].iter().zip(&across);
                        for (to, (s, b)) in line.iter_mut().zip(from) {
                            let (k, l) = (knots[b.first], knots[b.second]);
                            *to = *s * (k + (l - k) * T::real(b.weight));
                        }
                        true
                    });
                    let Scratch { rows, panel, sums, .. } = scratch;
                    for p in 0..plane.panels {
                        plane.columns_forward(&rows[p * row.len..][..row.len], None, panel);
                        let at = (j * phases + phase) * len + p * plane.rows;
                        let spectrum = &self.spectra[channel][at..][..plane.rows];
                        add_product(&mut sums[p * plane.rows..][..plane.rows], panel, spectrum);
                    }
                }
            }
            for p in 0..plane.panels {
                let sums = &mut scratch.sums[p * plane.rows..][..plane.rows];
                plane.columns_inverse(sums);
                scratch.back[(i * plane.panels + p) * count..][..count].copy_from_slice(&sums[first..first + count]);
            }
        }
    }
}

impl<T: Real> LowRank<'_, T> {
    /// Coefficients at the column knots, interpolated down to the pixel row `at`.
    fn down(&self, coefficients: &[T], at: isize, knots: &mut Vec<T>) {
        let across = self.grid.col_knots.len();
        let b = NodeGrid::between(&self.grid.row_knots, at);
        let (first, second) =
            (&coefficients[b.first * across..][..across], &coefficients[b.second * across..][..across]);
        knots.clear();
        knots.extend(first.iter().zip(second).map(|(k, l)| *k + (*l - *k) * T::real(b.weight)));
    }
}

#[cfg(test)]
mod tests {
    use super::super::plain::{Case, cases, difference};
    use super::super::{Method, blur};
    use super::*;
    use ndarray::{Array5, Zip, s};

    fn of<T: Real>(case: &Case<T>, rank: usize, tolerance: f64) -> Array3<T> {
        let method = Method::LowRank { block: case.block, rank, tolerance };
        blur(&case.grid, &case.kernels(), &case.source(), case.region, method, &|_| {})
    }

    #[test]
    fn full_rank_is_the_plain_sum() {
        for case in cases() {
            let plain = case.plain();
            let error = difference(&of(&case, usize::MAX, 0.0), &plain);
            assert!(error < 1e-12, "{}: {error:e}", case.name);
            let single = case.cast::<f32>();
            let error = difference(&of(&single, usize::MAX, 0.0), &single.plain());
            assert!(error < 2e-6, "{} in f32: {error:e}", case.name);
        }
    }

    /// Kernels of rank two give two components; cut to one, the stated error bounds that of the kernels.
    #[test]
    fn the_rank_is_found_and_the_truncation_is_measured() {
        let case = cases().swap_remove(0);
        let (nodes, channels, phases, size, _) = case.kernels.dim();
        let mut two = case.cast::<f64>();
        two.kernels = Array5::from_shape_fn((nodes, channels, phases, size, size), |(n, c, _, a, b)| {
            let t = n as f64 / nodes as f64;
            (1.0 - t) * (-((a * a + b * c) as f64) / 9.0).exp() + t * 0.1 * (a + b) as f64
        });
        let eigen = EigenKernels::new(&two.grid, &two.kernels(), usize::MAX, 1e-12);
        assert_eq!(eigen.ranks(), [2, 2]);
        assert!(eigen.error <= 1e-12);
        let error = difference(&blur_low_rank(&two.grid, &eigen, &two.source(), two.region, 9, &|_| {}), &two.plain());
        assert!(error < 1e-12, "{error:e}");

        let eigen = EigenKernels::new(&two.grid, &two.kernels(), 1, 0.0);
        assert_eq!(eigen.ranks(), [1, 1]);
        let mut worst = 0.0f64;
        for (n, c) in (0..nodes).flat_map(|n| (0..channels).map(move |c| (n, c))) {
            let exact = two.kernels.slice(s![n, c, .., .., ..]);
            let mut missed = exact.to_owned();
            let part = eigen.components[c].index_axis(Axis(0), 0);
            Zip::from(&mut missed).and(&part).for_each(|m, e| *m -= eigen.coefficients[c][[0, n]] * e);
            let norm = |a: &mut dyn Iterator<Item = f64>| a.map(|v| v * v).sum::<f64>().sqrt();
            worst = worst.max(norm(&mut missed.iter().copied()) / norm(&mut exact.iter().copied()));
        }
        assert!((worst - eigen.error).abs() < 1e-10 && worst > 1e-3, "{worst} {}", eigen.error);
    }
}
