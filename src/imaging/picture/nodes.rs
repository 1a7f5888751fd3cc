//! Where nodes stand: intervals are halved until the kernel in their middle is the mean of its neighbours.
//!
//! Knots start evenly spaced from the first pixel to the last; each axis is halved on its own, by the worst error along the
//! lines of the other. The error of an interval is the relative L2 distance between the kernel computed in its middle and
//! the mean of the two at its ends, all channels together, on a raster of about 25 cells a side: finer structure of
//! wide kernels moves too little light to matter, and is the grain of the pupil's points.

use std::collections::HashMap;

use rayon::prelude::*;

use super::bank::{Bank, Place, Scratch};
use crate::imaging::frame::Frame;
use crate::imaging::node_grid::NodeGrid;
use crate::imaging::warp::Region;

/// Shortest interval between nodes, pixels.
pub const SHORTEST: usize = 16;
/// Longest interval between nodes, pixels.
pub const LONGEST: usize = 512;

/// Cells along the side of the kernels that are compared, about.
const CELLS: usize = 25;

/// Kernels by pixel.
type Cache = HashMap<(isize, isize), Vec<f32>>;

/// A grid under refinement.
pub struct Nodes<'a> {
    bank: &'a Bank,
    frame: &'a Frame,
    /// Kernel size in pixels, cells of the compared kernels and pixels of a cell.
    size: usize,
    cells: usize,
    cell: usize,
    cache: Cache,
    /// Kernels at one sample a pixel, of the nodes that were asked for.
    full: Cache,
    /// Norm of the sharpest kernel seen.
    sharpest: f64,
    /// The grid so far.
    pub grid: NodeGrid,
    /// Largest interpolation error that the last refinement left, relative L2.
    pub error: f64,
}

impl<'a> Nodes<'a> {
    /// One node in the middle if the kernel is the same all over `source` to `tolerance`, else a coarse grid.
    pub fn coarse(bank: &'a Bank, frame: &'a Frame, source: Region, size: usize, tolerance: f64) -> Self {
        let middle = (source.row + (source.rows / 2).cast_signed(), source.col + (source.cols / 2).cast_signed());
        let cell = size.div_ceil(CELLS);
        let mut nodes = Self {
            bank,
            frame,
            size,
            cells: 2 * (size / 2).div_ceil(cell) + 3,
            cell,
            cache: Cache::new(),
            full: Cache::new(),
            sharpest: 0.0,
            grid: NodeGrid::single(middle.0, middle.1),
            error: 0.0,
        };
        let last = |from: isize, n: usize| from + n.saturating_sub(1).cast_signed();
        let corners = [
            (source.row, source.col),
            (source.row, last(source.col, source.cols)),
            (last(source.row, source.rows), source.col),
            (last(source.row, source.rows), last(source.col, source.cols)),
            (source.row, middle.1),
            (middle.0, source.col),
            (last(source.row, source.rows), middle.1),
            (middle.0, last(source.col, source.cols)),
        ];
        nodes.need(corners.iter().copied().chain([middle]));
        let constant = corners
            .iter()
            .map(|at| distance(&nodes.cache[at], &nodes.cache[&middle], nodes.sharpest))
            .fold(0.0, f64::max);
        if constant <= tolerance {
            nodes.error = constant;
        } else {
            // Even intervals from the first pixel to the last, two at least over the longer side.
            let longest = LONGEST.min(source.rows.max(source.cols).div_ceil(2)).max(SHORTEST);
            nodes.grid = NodeGrid {
                row_knots: even(source.row, source.rows, longest),
                col_knots: even(source.col, source.cols, longest),
            };
            nodes.error = f64::INFINITY;
        }
        nodes
    }

    /// The kernels of node `n` of the grid, channel by channel, one sample a pixel; asked for by [`Self::prepare`].
    pub fn kernel(&self, n: usize) -> Option<&[f32]> {
        self.full.get(&self.grid.pixel(n)).map(Vec::as_slice)
    }

    /// Computes the kernels of these nodes at one sample a pixel.
    pub fn prepare(&mut self, nodes: impl Iterator<Item = usize>) {
        let places = nodes.map(|n| self.grid.pixel(n)).filter(|p| !self.full.contains_key(p));
        let (bank, frame, size) = (self.bank, self.frame, self.size);
        let new = computed(places.collect(), |place, scratch| {
            flat(bank.fine(Place::pixel(frame, place.0, place.1), size, 1, scratch).0)
        });
        self.full.extend(new);
    }

    /// The nodes whose windows reach `region`.
    pub fn around(&self, region: Region) -> impl Iterator<Item = usize> + use<> {
        let reach = |knots: &[isize], first: isize, n: usize| {
            let (a, b) = (NodeGrid::between(knots, first), NodeGrid::between(knots, first + n.cast_signed() - 1));
            a.first..=b.second
        };
        let columns = self.grid.col_knots.len();
        let cols = reach(&self.grid.col_knots, region.col, region.cols);
        let rows = reach(&self.grid.row_knots, region.row, region.rows);
        rows.flat_map(move |r| cols.clone().map(move |c| r * columns + c))
    }

    /// Halves intervals until every error is at most `tolerance`, or the interval is the shortest.
    pub fn refine(&mut self, tolerance: f64) {
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
        let (cache, sharpest) = (&self.cache, self.sharpest);
        along
            .par_windows(2)
            .map(|w| {
                let error = |b: &isize| {
                    let [first, middle, last] = [w[0], w[0].midpoint(w[1]), w[1]].map(|a| &cache[&at(a, *b)]);
                    halfway(first, last, middle, sharpest)
                };
                across.iter().map(error).fold(0.0, f64::max)
            })
            .collect()
    }

    /// Computes the compared kernels of all `places` that are not there yet.
    fn need(&mut self, places: impl Iterator<Item = (isize, isize)>) {
        let missing: Vec<(isize, isize)> = places.filter(|p| !self.cache.contains_key(p)).collect();
        let (bank, frame, cells, cell) = (self.bank, self.frame, self.cells, self.cell);
        let new = computed(missing, |place, scratch| {
            flat(bank.coarse(Place::pixel(frame, place.0, place.1), cells, cell, scratch))
        });
        self.sharpest = new.iter().map(|(_, k)| norm(k)).fold(self.sharpest, f64::max);
        self.cache.extend(new);
    }
}

/// Kernels of all channels, one after the other.
#[expect(clippy::cast_possible_truncation, reason = "kernels in single precision")]
fn flat(kernels: &[Vec<f64>]) -> Vec<f32> {
    kernels.iter().flatten().map(|v| *v as f32).collect()
}

/// `f` of every place, each once.
fn computed(
    mut places: Vec<(isize, isize)>,
    f: impl Fn((isize, isize), &mut Scratch) -> Vec<f32> + Sync,
) -> Vec<((isize, isize), Vec<f32>)> {
    places.sort_unstable();
    places.dedup();
    places.into_par_iter().map_init(Scratch::default, |scratch, place| (place, f(place, scratch))).collect()
}

/// The fewest knots from the first of `n` pixels to the last that are at most `longest` apart, evenly spaced.
fn even(first: isize, n: usize, longest: usize) -> Vec<isize> {
    let length = n.saturating_sub(1);
    let intervals = length.div_ceil(longest);
    (0..=intervals).map(|k| first + (k * length / intervals.max(1)).cast_signed()).collect()
}

/// Kernels fainter or more blurred than this share of the sharpest count as if they had it.
const FLOOR: f64 = 0.05;

fn norm(a: &[f32]) -> f64 {
    a.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt()
}

/// L2 distance of `a` from `b`, relative to `b` or to [`FLOOR`] of the sharpest.
fn distance(a: &[f32], b: &[f32], sharpest: f64) -> f64 {
    halfway(a, a, b, sharpest)
}

/// L2 distance of the mean of `a` and `b` from `middle`, relative to `middle` or to [`FLOOR`] of the sharpest.
fn halfway(a: &[f32], b: &[f32], middle: &[f32], sharpest: f64) -> f64 {
    let (mut off, mut size) = (0.0f64, 0.0f64);
    for ((a, b), m) in a.iter().zip(b).zip(middle) {
        off += f64::from(0.5 * (a + b) - m).powi(2);
        size += f64::from(*m).powi(2);
    }
    if off > 0.0 { off.sqrt() / size.sqrt().max(FLOOR * sharpest) } else { 0.0 }
}
