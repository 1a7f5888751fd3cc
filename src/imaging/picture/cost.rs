//! What settings cost, in seconds of one thread on the machine the constants were read on; ratios are what counts.

use super::settings::Settings;
use crate::imaging::blur::Method;
use crate::imaging::node_grid::NodeGrid;
use crate::imaging::warp::Region;

/// Size of a picture's work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Work {
    /// Pixels rendered.
    pub pixels: usize,
    /// Channels of the image.
    pub channels: usize,
    /// Channels of the scene.
    pub planes: usize,
}

/// Seconds a ray that is aimed and traced, a dense point made of them, and one interpolated.
const RAY: f64 = 6e-6;
const DENSE: f64 = 4e-7;
const MIX: f64 = 4e-9;
/// Seconds to splat a point: constant, and a tap.
const SPLAT: (f64, f64) = (1.2e-8, 8e-10);
/// Seconds a point of a kernel's raster and wavelength, channels included.
const POINT: f64 = 1.5e-9;
/// Seconds to sample the scene: a place, a channel.
const SAMPLE: (f64, f64) = (1.2e-8, 4e-9);
/// Seconds a butterfly of an FFT.
const BUTTERFLY: f64 = 7e-10;
/// Fields a table has, about.
const FIELDS: f64 = 12.0;

impl Work {
    /// The work of `region`.
    pub fn of(region: Region, channels: usize, planes: usize) -> Self {
        Self { pixels: region.rows * region.cols, channels, planes }
    }
}

/// Side of the blocks for a grid and a kernel: a power of two, near the kernel's size, no longer than most intervals.
fn block(grid: &NodeGrid, size: usize) -> usize {
    let mean = |knots: &[isize]| match (knots.first(), knots.last()) {
        (Some(a), Some(b)) if knots.len() > 1 => (b - a).unsigned_abs() / (knots.len() - 1),
        _ => usize::MAX,
    };
    let spacing = mean(&grid.row_knots).max(mean(&grid.col_knots)).min(1024);
    let wanted = (size + size / 2).next_power_of_two().clamp(64, 512);
    let mut block = wanted;
    while block > 16 && block > spacing.next_power_of_two() {
        block /= 2;
    }
    block
}

/// The method of convolution.
pub fn pick(_work: &Work, _settings: &Settings, half_width: usize, grid: &NodeGrid) -> Method {
    Method::Cells { block: block(grid, 2 * half_width + 1) }
}

/// Seconds of one thread for a picture.
#[expect(clippy::cast_precision_loss, reason = "counts")]
pub fn seconds(work: &Work, settings: &Settings, half_width: usize, grid: &NodeGrid) -> f64 {
    let size = (2 * half_width + 1) as f64;
    let m = settings.samples as f64;
    let (waves, dense) = (settings.wavelengths as f64, settings.dense as f64);
    let channels = work.channels as f64;
    let table = FIELDS * waves * (60.0 * RAY + dense * DENSE);
    let splat = SPLAT.0 + SPLAT.1 * (m + 2.0) * (m + 2.0);
    let node = waves * (dense * (MIX + splat) + m * m * size * size * (1.0 + channels) * POINT);
    let side = block(grid, 2 * half_width + 1) as f64;
    let length = side + size;
    let transform = length * length * (length * length).log2() * BUTTERFLY;
    let blocks = work.pixels as f64 / (side * side);
    let windows = if grid.len() == 1 { 1.0 } else { 3.0 };
    let blur = blocks * transform * (windows * m * m * work.planes as f64 + channels);
    let kernels = grid.len() as f64 * m * m * channels * 0.6 * transform;
    let warp = work.pixels as f64 * m * m * (SAMPLE.0 + SAMPLE.1 * work.planes as f64);
    table + grid.len() as f64 * node + blur + kernels + warp
}
