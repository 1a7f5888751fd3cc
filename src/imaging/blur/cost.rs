//! What each method costs, and which is cheapest.
//!
//! Operations are counted (transforms as `n log₂ n` a line) and weighed by nanoseconds of one core, in f32, set so that
//! the frames of `benches/results/blur.md` come out within about a third. Ratios matter to the choice.

use super::super::node_grid::NodeGrid;
use super::super::warp::Region;
use super::Method;
use super::segments::{Segment, segments};
use crate::math::fft::good_size;
use crate::math::panel_fft::LANES;

/// Real line transform, per point and `log₂`.
const ROW: f64 = 0.5;
/// Column transform, per complex point and `log₂`.
const COLUMN: f64 = 0.35;
/// Complex multiply-add of spectra, per point.
const PRODUCT: f64 = 1.1;
/// Windows, tiles and their sums, per point.
const MOVE: f64 = 2.6;
/// Multiply-add of the direct sum.
const TAP: f64 = 0.2;
/// A block and channel, whatever its size.
const BLOCK: f64 = 1e4;
/// Multiply-add of the Gram matrix (f64).
const GRAM: f64 = 0.5;

/// A frame to be blurred.
#[derive(Clone, Copy, Debug)]
pub struct Task<'a> {
    /// Where the kernels stand.
    pub grid: &'a NodeGrid,
    /// The image.
    pub region: Region,
    /// Rows and columns of a kernel.
    pub size: usize,
    /// Channels of the image.
    pub channels: usize,
    /// Channels of the source.
    pub source_channels: usize,
    /// Phases.
    pub phases: usize,
}

fn logarithm(n: usize) -> f64 {
    (n.max(2) as f64).log2()
}

/// Rows and columns of the blocks along both axes, summed.
struct Cut {
    /// Blocks.
    count: f64,
    /// Pixels, of all blocks.
    pixels: f64,
    /// Windows, summed over blocks.
    windows: f64,
    /// Pixels times windows.
    windowed: f64,
    /// Pixels of tiles inside the region, at most.
    tiles: f64,
    /// Transform size.
    size: usize,
}

fn cut(knots: &[isize], block: usize, start: isize, len: usize, kernel: usize) -> Cut {
    let half = kernel / 2;
    let from = start - half.cast_signed();
    let all: Vec<Segment<f32>> = segments(knots, block, from, from + (len + 2 * half).cast_signed());
    let sum = |f: &dyn Fn(&Segment<f32>) -> usize| all.iter().map(|s| f(s) as f64).sum::<f64>();
    Cut {
        count: all.len() as f64,
        pixels: sum(&|s| s.len),
        windows: sum(&|s| s.windows.len()),
        windowed: sum(&|s| s.len * s.windows.len()),
        tiles: sum(&|s| (s.len + kernel - 1).min(len)),
        size: good_size(all.iter().map(|s| s.len).max().unwrap_or(1) + kernel - 1),
    }
}

impl Task<'_> {
    /// Estimated nanoseconds on one core; `rank` is the number of components of [`Method::LowRank`].
    pub fn cost(&self, method: Method, rank: usize) -> f64 {
        match method {
            Method::Cells { block } => self.cells(block),
            Method::Direct => self.direct(),
            Method::LowRank { block, .. } => self.low_rank(block, rank),
        }
    }

    fn cells(&self, block: usize) -> f64 {
        let rows = cut(&self.grid.row_knots, block, self.region.row, self.region.rows, self.size);
        let cols = cut(&self.grid.col_knots, block, self.region.col, self.region.cols, self.size);
        let (line, column, points) = transforms(&rows, &cols);
        let (sources, channels, phases) = self.planes();
        let forward =
            rows.pixels * cols.windows * (line + MOVE * cols.size as f64) + rows.windows * cols.windows * column;
        let product = rows.windows * cols.windows * points * PRODUCT;
        sources * phases * forward
            + channels * phases * product
            + channels * back(&rows, &cols, line, column)
            + self.grid.len() as f64 * channels * phases * (self.size as f64 * line + column)
    }

    fn low_rank(&self, block: usize, rank: usize) -> f64 {
        let (row, col) = (self.grid.row_knots[..1].to_vec(), self.grid.col_knots[..1].to_vec());
        let rows = cut(&row, block, self.region.row, self.region.rows, self.size);
        let cols = cut(&col, block, self.region.col, self.region.cols, self.size);
        let (line, column, points) = transforms(&rows, &cols);
        let (_, channels, phases) = self.planes();
        let terms = rank as f64 * phases * channels;
        let forward = rows.pixels * cols.count * (line + 3.0 * MOVE * cols.size as f64)
            + rows.count * cols.count * (column + points * PRODUCT);
        let nodes = self.grid.len() as f64;
        let kernel = phases * (self.size * self.size) as f64;
        terms * forward
            + channels * back(&rows, &cols, line, column)
            + terms * (self.size as f64 * line + column)
            + channels * nodes * kernel * GRAM * (0.5 * nodes + 3.0 * rank as f64)
            + channels * nodes.powi(3) * 10.0 * GRAM
    }

    fn direct(&self) -> f64 {
        let rows = cut(&self.grid.row_knots, usize::MAX, self.region.row, self.region.rows, self.size);
        let cols = cut(&self.grid.col_knots, usize::MAX, self.region.col, self.region.cols, self.size);
        let (_, channels, phases) = self.planes();
        // Two taps a kernel entry between columns of nodes; windows, copies and taps once a kernel row.
        let points = cols.windowed + cols.windows * (self.size - 1) as f64;
        let lines = self.region.rows as f64 * self.size as f64;
        let taps = cols.windows * rows.windowed / (self.region.rows + self.size - 1) as f64;
        channels * phases * lines * (points * (TAP * self.size as f64 + MOVE) + taps * self.size as f64)
    }

    fn planes(&self) -> (f64, f64, f64) {
        (self.source_channels as f64, self.channels as f64, self.phases as f64)
    }

    /// The cheapest method; eigen-PSFs are considered with the `rank` expected at a `tolerance`, if given.
    ///
    /// Their rank is known only after the decomposition: [`super::eigen::EigenKernels::ranks`].
    pub fn cheapest(&self, low_rank: Option<(usize, f64)>) -> Method {
        let mut all = Vec::new();
        if self.size <= 31 {
            all.push((self.cost(Method::Direct, 0), Method::Direct));
        }
        for block in self.blocks() {
            let method = Method::Cells { block };
            all.push((self.cost(method, 0), method));
            if let Some((rank, tolerance)) = low_rank {
                let method = Method::LowRank { block, rank, tolerance };
                all.push((self.cost(method, rank), method));
            }
        }
        all.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map_or(Method::Direct, |m| m.1)
    }

    /// Sides worth trying: cells in equal parts, and those that fill a transform.
    pub fn blocks(&self) -> Vec<usize> {
        let gaps = |k: &[isize]| k.windows(2).map(|w| (w[1] - w[0]).unsigned_abs()).max().unwrap_or(0);
        let cell = gaps(&self.grid.row_knots).max(gaps(&self.grid.col_knots));
        let longest = self.region.rows.max(self.region.cols) + self.size - 1;
        let mut all: Vec<usize> = (1..=8).map(|n| cell.div_ceil(n)).collect();
        let mut side = 16;
        while side < 2 * (longest + self.size) && side < 4096 {
            side = good_size(side + 1);
            if side > self.size + self.size / 4 {
                all.push(side - self.size + 1);
            }
        }
        all.retain(|b| (8..=longest.max(8)).contains(b));
        all.sort_unstable();
        all.dedup();
        if all.is_empty() { vec![longest.max(1)] } else { all }
    }
}

/// One line, the columns of one block, and the points of one half spectrum.
fn transforms(rows: &Cut, cols: &Cut) -> (f64, f64, f64) {
    let points = ((cols.size / 2 + 1).div_ceil(LANES) * LANES * rows.size) as f64;
    (ROW * cols.size as f64 * logarithm(cols.size), COLUMN * points * logarithm(rows.size), points)
}

/// The way back of all blocks, one channel.
fn back(rows: &Cut, cols: &Cut, line: f64, column: f64) -> f64 {
    rows.count * cols.count * (column + BLOCK) + rows.tiles * cols.count * (line + MOVE * cols.size as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn task(grid: &NodeGrid, size: usize) -> Task<'_> {
        let region = Region { row: 0, col: 0, rows: 1024, cols: 1024 };
        Task { grid, region, size, channels: 3, source_channels: 3, phases: 1 }
    }

    /// What no measurement contradicts: sums for tiny kernels, transforms for large ones, no long sums of components.
    #[test]
    fn the_choice_follows_size_and_rank() {
        let region = Region { row: 0, col: 0, rows: 1025, cols: 1025 };
        let grid = NodeGrid::uniform(region, 128);
        assert_eq!(task(&grid, 3).cheapest(None), Method::Direct);
        assert!(matches!(task(&grid, 65).cheapest(None), Method::Cells { block: 32..=128 }));
        assert!(matches!(task(&grid, 901).cheapest(None), Method::Cells { .. }));
        assert!(matches!(task(&grid, 65).cheapest(Some((80, 1e-3))), Method::Cells { .. }));
    }

    /// More of anything costs more.
    #[test]
    fn costs_grow() {
        let grid = NodeGrid::uniform(Region { row: 0, col: 0, rows: 1025, cols: 1025 }, 128);
        let base = task(&grid, 65);
        for method in
            [Method::Cells { block: 64 }, Method::Direct, Method::LowRank { block: 192, rank: 5, tolerance: 0.0 }]
        {
            let cost = |t: Task<'_>| t.cost(method, 5);
            assert!(cost(base) > 0.0);
            assert!(cost(Task { size: 129, ..base }) > cost(base));
            assert!(cost(Task { phases: 4, ..base }) > cost(base));
            assert!(cost(Task { source_channels: 1, ..base }) <= cost(base));
            assert!(cost(Task { channels: 1, source_channels: 1, ..base }) < cost(base));
        }
    }
}
