//! Where kernels stand: intervals are halved until the kernel in their middle is the mean of its neighbours.
//!
//! Knots start evenly spaced from the first cell to the last; each axis is halved on its own, by the worst error along the
//! lines of the other. The error of an interval is the relative L2 distance between the kernel computed in its middle and
//! the mean of the two at its ends, all channels together, on a raster of about 25 points a side: finer structure of
//! wide kernels moves too little light to matter, and is the grain of the stop's points.

use std::collections::HashMap;

use rayon::prelude::*;

use crate::frame::Frame;
use crate::plane::Region;
use crate::render::node_grid::NodeGrid;
use isoplanat_optics::psf::{KernelForm, Optics, SensorPoint};

/// Shortest interval between nodes, cells.
pub(crate) const SHORTEST: usize = 16;
/// Longest interval between nodes, cells.
pub(crate) const LONGEST: usize = 512;

/// Points along the side of the kernels that are compared, about.
const POINTS: usize = 25;

/// Kernels fainter or more blurred than this share of the sharpest count as if they had it.
const FLOOR: f64 = 0.05;

/// The centre of cell `(row, col)`.
pub(crate) fn centre(raster: &Frame, row: isize, col: isize) -> SensorPoint {
    raster.point(col as f64 + 0.5, row as f64 + 0.5)
}

/// A grid under refinement.
pub(crate) struct Nodes<'a> {
    optics: &'a Optics,
    depth: usize,
    raster: &'a Frame,
    form: KernelForm,
    cache: HashMap<(isize, isize), Vec<f32>>,
    /// Norm of the sharpest kernel seen.
    sharpest: f64,
    /// The grid so far.
    pub grid: NodeGrid,
    /// Largest interpolation error that the last refinement left, relative L2.
    pub error: f64,
}

impl<'a> Nodes<'a> {
    /// One node in the middle if the kernel is the same all over `around` to `tolerance`, else a coarse grid. `size` is the
    /// kernels' in cells of `raster`.
    pub(crate) fn coarse(
        optics: &'a Optics,
        depth: usize,
        raster: &'a Frame,
        around: Region,
        size: usize,
        tolerance: f64,
        dense: usize,
    ) -> Self {
        let middle = (around.row + (around.rows / 2).cast_signed(), around.col + (around.cols / 2).cast_signed());
        let step = size.div_ceil(POINTS);
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let form = optics.form(dense, 2 * (size / 2).div_ceil(step) + 3, 1, raster.pitch_mm * step as f64);
        let mut nodes = Self {
            optics,
            depth,
            raster,
            form,
            cache: HashMap::new(),
            sharpest: 0.0,
            grid: NodeGrid::single(middle.0, middle.1),
            error: 0.0,
        };
        let last = |from: isize, n: usize| from + n.saturating_sub(1).cast_signed();
        let (rows, cols) = (
            [around.row, middle.0, last(around.row, around.rows)],
            [around.col, middle.1, last(around.col, around.cols)],
        );
        let corners: Vec<(isize, isize)> = rows.iter().flat_map(|r| cols.iter().map(|c| (*r, *c))).collect();
        nodes.need(corners.iter().copied());
        let constant = corners
            .iter()
            .map(|at| nodes.halfway(&nodes.cache[at], &nodes.cache[at], &nodes.cache[&middle]))
            .fold(0.0, f64::max);
        if constant <= tolerance {
            nodes.error = constant;
        } else {
            // Even intervals from the first cell to the last, two at least over the longer side.
            let longest = LONGEST.min(around.rows.max(around.cols).div_ceil(2)).max(SHORTEST);
            nodes.grid = NodeGrid {
                row_knots: even(around.row, around.rows, longest),
                col_knots: even(around.col, around.cols, longest),
            };
            nodes.error = f64::INFINITY;
        }
        nodes
    }

    /// Halves intervals until every error is at most `tolerance`, or the interval is the shortest.
    pub(crate) fn refine(&mut self, tolerance: f64) {
        if self.grid.len() == 1 {
            return;
        }
        loop {
            let rows = self.errors(true);
            let cols = self.errors(false);
            let open = |errors: &[f64], knots: &[isize]| -> Vec<isize> {
                let long = |w: &[isize]| (w[1] - w[0]).unsigned_abs() >= 2 * SHORTEST;
                let pairs = knots.windows(2).zip(errors);
                pairs.filter(|(w, e)| long(w) && **e > tolerance).map(|(w, _)| w[0].midpoint(w[1])).collect()
            };
            let (new_rows, new_cols) = (open(&rows, &self.grid.row_knots), open(&cols, &self.grid.col_knots));
            self.error = rows.iter().chain(&cols).copied().fold(0.0, f64::max);
            if new_rows.is_empty() && new_cols.is_empty() {
                return;
            }
            let merge = |knots: &mut Vec<isize>, new: Vec<isize>| {
                knots.extend(new);
                knots.sort_unstable();
            };
            merge(&mut self.grid.row_knots, new_rows);
            merge(&mut self.grid.col_knots, new_cols);
        }
    }

    /// Largest error of each interval along the rows (or columns) over the other axis's knots.
    fn errors(&mut self, along_rows: bool) -> Vec<f64> {
        let (along, across) = if along_rows {
            (self.grid.row_knots.clone(), self.grid.col_knots.clone())
        } else {
            (self.grid.col_knots.clone(), self.grid.row_knots.clone())
        };
        let at = |a: isize, b: isize| if along_rows { (a, b) } else { (b, a) };
        let places: Vec<(isize, isize)> = along
            .windows(2)
            .flat_map(|w| [w[0], w[0].midpoint(w[1]), w[1]])
            .flat_map(|a| across.iter().map(move |b| at(a, *b)))
            .collect();
        self.need(places.into_iter());
        along
            .par_windows(2)
            .map(|w| {
                let error = |b: &isize| {
                    let [first, middle, last] = [w[0], w[0].midpoint(w[1]), w[1]].map(|a| &self.cache[&at(a, *b)]);
                    self.halfway(first, last, middle)
                };
                across.iter().map(error).fold(0.0, f64::max)
            })
            .collect()
    }

    /// Computes the compared kernels of all `places` that are not there yet.
    fn need(&mut self, places: impl Iterator<Item = (isize, isize)>) {
        let mut missing: Vec<(isize, isize)> = places.filter(|p| !self.cache.contains_key(p)).collect();
        missing.sort_unstable();
        missing.dedup();
        let points: Vec<SensorPoint> = missing.iter().map(|(row, col)| centre(self.raster, *row, *col)).collect();
        #[expect(clippy::cast_possible_truncation, reason = "kernels in single precision")]
        let single = |i: usize, kernel: &[f64], _: &[f64]| (missing[i], kernel.iter().map(|v| *v as f32).collect());
        let new: Vec<((isize, isize), Vec<f32>)> = self.optics.kernels_each(&self.form, self.depth, &points, single);
        self.sharpest = new.iter().map(|(_, k)| norm(k)).fold(self.sharpest, f64::max);
        self.cache.extend(new);
    }

    /// L2 distance of the mean of `a` and `b` from `middle`, relative to `middle` or to [`FLOOR`] of the sharpest.
    fn halfway(&self, a: &[f32], b: &[f32], middle: &[f32]) -> f64 {
        let off = a.iter().zip(b).zip(middle).map(|((a, b), m)| f64::from(0.5 * (a + b) - m).powi(2)).sum::<f64>();
        if off > 0.0 { off.sqrt() / norm(middle).max(FLOOR * self.sharpest) } else { 0.0 }
    }
}

/// The fewest knots from the first of `n` cells to the last that are at most `longest` apart, evenly spaced.
fn even(first: isize, n: usize, longest: usize) -> Vec<isize> {
    let length = n.saturating_sub(1);
    let intervals = length.div_ceil(longest);
    (0..=intervals).map(|k| first + (k * length / intervals.max(1)).cast_signed()).collect()
}

fn norm(a: &[f32]) -> f64 {
    a.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt()
}
