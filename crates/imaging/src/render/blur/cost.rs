//! What each method costs, and which is cheapest.
//!
//! Operations are counted (transforms as `n log₂ n` a line) and weighed by nanoseconds of one core, in f32, set so that
//! the frames of `benches/results/blur.md` come out within about a third. Ratios matter to the choice.

use super::Method;
use super::frame::STRIP_BYTES;
use super::segments::{Segment, segments, used};
use crate::plane::Region;
use crate::render::node_grid::NodeGrid;
use isoplanat_base::math::fft::fast_size;
use isoplanat_base::math::memory::{product, threads};

/// Transform of a line or a column, per complex point and `log₂`.
const TRANSFORM: f64 = 0.14;
/// Complex multiply-add of spectra, per point.
const PRODUCT: f64 = 0.5;
/// Turning, windows and copies, per point.
const MOVE: f64 = 0.45;
/// Blocks of more points leave the second cache, and take longer by a factor.
const SPILL: (f64, f64) = (35e3, 1.4);
/// A block and channel, whatever its size.
const BLOCK: f64 = 3e3;
/// Multiply-add of the direct sum.
const TAP: f64 = 0.07;
/// A pixel of the direct sum, whatever the kernel.
const PIXEL: f64 = 1.0;

/// Rows that a task of the direct sum computes.
const DIRECT_ROWS: usize = super::direct::BAND;

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

/// Blocks along one axis, summed.
struct Cut {
    /// Blocks.
    count: f64,
    /// Pixels that they see, of all blocks.
    seen: f64,
    /// Windows, summed over blocks.
    windows: f64,
    /// Knots in use.
    knots: f64,
    /// Transform size.
    size: usize,
}

fn cut(knots: &[isize], block: usize, start: isize, len: usize, kernel: usize) -> Cut {
    let all: Vec<Segment<f32>> = segments(knots, block, start, start + len.cast_signed());
    let sum = |f: &dyn Fn(&Segment<f32>) -> usize| all.iter().map(|s| f(s) as f64).sum::<f64>();
    Cut {
        count: all.len() as f64,
        seen: sum(&|s| s.len + kernel - 1),
        windows: sum(&|s| s.windows.len()),
        knots: used(&all).len() as f64,
        size: fast_size(all.iter().map(|s| s.len).max().unwrap_or(1) + kernel - 1),
    }
}

impl Task<'_> {
    /// Estimated nanoseconds on one core.
    pub fn cost(&self, method: Method) -> f64 {
        match method {
            Method::Cells { block } => self.cells(block),
            Method::Direct => self.direct(),
        }
    }

    fn cells(&self, block: usize) -> f64 {
        let rows = cut(&self.grid.row_knots, block, self.region.row, self.region.rows, self.size);
        let cols = cut(&self.grid.col_knots, block, self.region.col, self.region.cols, self.size);
        let (sources, channels, phases) = self.planes();
        // Two real rows are one line.
        let line = 0.5 * cols.size as f64 * (TRANSFORM * logarithm(cols.size) + MOVE);
        let points = (cols.size / 2 + 1) as f64 * rows.size as f64;
        let column = points * TRANSFORM * logarithm(rows.size);
        let (blocks, corners) = (rows.count * cols.count, rows.windows * cols.windows);
        let pixels = rows.seen - rows.count * (self.size - 1) as f64;
        let forward = rows.seen * cols.count * line + blocks * column;
        let back = corners * column + corners * points * MOVE + pixels * cols.windows * line;
        let spill = if points > SPILL.0 { SPILL.1 } else { 1.0 };
        let blur = sources * phases * forward
            + channels * (phases * corners * points * PRODUCT + back + blocks * BLOCK)
            + rows.knots * cols.knots * channels * phases * (self.size as f64 * line + column);
        spill * blur
    }

    fn direct(&self) -> f64 {
        let rows = cut(&self.grid.row_knots, usize::MAX, self.region.row, self.region.rows, self.size);
        let cols = cut(&self.grid.col_knots, usize::MAX, self.region.col, self.region.cols, self.size);
        let (_, channels, phases) = self.planes();
        let entries = phases * (self.size * self.size) as f64;
        // One tap a kernel entry, column of nodes and pixel; once a row of the image, kernels between rows of nodes.
        let windows = cols.windows / cols.count.max(1.0);
        let pixels = self.region.rows as f64 * self.region.cols as f64;
        let mixed = self.region.rows as f64 * cols.windows * rows.windows / rows.count.max(1.0);
        channels * (pixels * (windows * entries * TAP + PIXEL) + mixed * entries * MOVE)
    }

    fn planes(&self) -> (f64, f64, f64) {
        (self.source_channels as f64, self.channels as f64, self.phases as f64)
    }

    /// Bytes that the blur takes beside its source's own, from above, in numbers of `word` bytes: the picture, spectra or kernels of
    /// the nodes, the source of a row of blocks, buffers of every thread.
    pub fn bytes(&self, method: Method, word: usize) -> u64 {
        let Self { region, size, channels, source_channels, phases, .. } = *self;
        let threads = threads();
        let kernels = channels * phases;
        let filling = product(&[threads, kernels, size, size, word + size_of::<f64>()]);
        let picture = product(&[channels, region.rows, region.cols, word]);
        let Method::Cells { block } = method else {
            let bands = product(&[threads, source_channels * phases, DIRECT_ROWS + size, region.cols + 2 * size, word]);
            let nodes = product(&[self.grid.len(), kernels, size, size, word]);
            return [picture, filling, bands, nodes].into_iter().fold(0, u64::saturating_add);
        };
        let rows = cut(&self.grid.row_knots, block, region.row, region.rows, size);
        let cols = cut(&self.grid.col_knots, block, region.col, region.cols, size);
        let spectrum = product(&[rows.size, cols.size / 2 + 1, 2 * word]);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "counts")]
        let across = cols.knots as usize;
        let nodes = |across: usize| spectrum.saturating_mul(product(&[2 * across, kernels]));
        let band = |width: usize| product(&[source_channels * phases, rows.size, width + size, word]);
        let whole = nodes(across).saturating_add(band(region.cols));
        let least = nodes(2).saturating_add(band(cols.size));
        let buffers = spectrum.saturating_mul(product(&[threads, phases + 3]));
        let strip = whole.min(least.max(STRIP_BYTES as u64));
        [picture, filling, buffers, strip].into_iter().fold(0, u64::saturating_add)
    }

    /// The cheapest method.
    pub fn cheapest(&self) -> Method {
        let cells = self.blocks().into_iter().map(|block| Method::Cells { block });
        let direct = (self.size <= 31).then_some(Method::Direct);
        let all = cells.chain(direct).map(|m| (self.cost(m), m));
        all.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(Method::Direct, |m| m.1)
    }

    /// Sides worth trying: cells in equal parts, and those that fill a transform.
    pub(crate) fn blocks(&self) -> Vec<usize> {
        let gaps = |k: &[isize]| k.windows(2).map(|w| (w[1] - w[0]).unsigned_abs()).max().unwrap_or(0);
        let cell = gaps(&self.grid.row_knots).max(gaps(&self.grid.col_knots));
        let longest = self.region.rows.max(self.region.cols) + self.size - 1;
        let mut all: Vec<usize> = (1..=8).map(|n| cell.div_ceil(n)).collect();
        let mut side = 16;
        while side < 2 * (longest + self.size) && side < 4096 {
            side = fast_size(side + 1);
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

#[cfg(test)]
mod tests {
    use super::*;

    fn task(grid: &NodeGrid, size: usize) -> Task<'_> {
        let region = Region { row: 0, col: 0, rows: 1024, cols: 1024 };
        Task { grid, region, size, channels: 3, source_channels: 3, phases: 1 }
    }

    /// What no measurement contradicts: sums for tiny kernels, transforms for large ones.
    #[test]
    fn the_choice_follows_size() {
        let region = Region { row: 0, col: 0, rows: 1025, cols: 1025 };
        let grid = NodeGrid::uniform(region, 128);
        assert_eq!(task(&grid, 3).cheapest(), Method::Direct);
        assert!(matches!(task(&grid, 65).cheapest(), Method::Cells { block: 32..=128 }));
        assert!(matches!(task(&grid, 901).cheapest(), Method::Cells { .. }));
    }

    /// More of anything costs more.
    #[test]
    fn costs_grow() {
        let grid = NodeGrid::uniform(Region { row: 0, col: 0, rows: 1025, cols: 1025 }, 128);
        let base = task(&grid, 65);
        for method in [Method::Cells { block: 64 }, Method::Direct] {
            let cost = |t: Task<'_>| t.cost(method);
            assert!(cost(base) > 0.0);
            assert!(cost(Task { size: 129, ..base }) > cost(base));
            assert!(cost(Task { phases: 4, ..base }) > cost(base));
            assert!(cost(Task { source_channels: 1, ..base }) <= cost(base));
            assert!(cost(Task { channels: 1, source_channels: 1, ..base }) < cost(base));
        }
    }
}
