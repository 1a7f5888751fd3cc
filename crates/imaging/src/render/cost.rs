//! What settings cost, in seconds of one thread on the machine the constants were read on; ratios are what counts.

use super::plan::Settings;
use crate::plane::Region;
use crate::render::blur::cost::Task;
use crate::render::node_grid::NodeGrid;
use isoplanat_optics::psf::Model;

/// Size of a picture's work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Work {
    /// Pixels rendered.
    pub region: Region,
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
/// Seconds of a kernel by diffraction of a wavelength: constant, and a point of its raster.
const BENT: (f64, f64) = (1.1e-3, 5e-8);
/// Seconds of the convolution by an open pupil's diffraction: constant, and a point of a channel's raster.
const OPEN: (f64, f64) = (6e-4, 1.8e-7);
/// Seconds to sample the scene: a place, a channel.
const SAMPLE: (f64, f64) = (1.2e-8, 4e-9);
/// Fields a table has, about.
const FIELDS: f64 = 12.0;

/// The convolution as a task.
fn task<'a>(work: &Work, settings: &Settings, half_width: usize, grid: &'a NodeGrid) -> Task<'a> {
    Task {
        grid,
        region: work.region,
        size: 2 * half_width + 1,
        channels: work.channels,
        source_channels: work.planes,
        phases: settings.samples * settings.samples,
    }
}

/// Seconds of one thread for the convolution.
pub(crate) fn convolution(work: &Work, settings: &Settings, half_width: usize, grid: &NodeGrid) -> f64 {
    let task = task(work, settings, half_width, grid);
    1e-9 * task.cost(task.cheapest())
}

/// Seconds of one thread for all else: table, kernels, sampling of the scene.
#[expect(clippy::cast_precision_loss, reason = "counts")]
pub(crate) fn seconds(work: &Work, settings: &Settings, half_width: usize, grid: &NodeGrid) -> f64 {
    let size = (2 * half_width + 1) as f64;
    let m = settings.samples as f64;
    let (waves, dense) = (settings.wavelengths as f64, settings.dense as f64);
    let channels = work.channels as f64;
    let pixels = (work.region.rows * work.region.cols) as f64;
    let table = FIELDS * waves * (60.0 * RAY + dense * DENSE);
    let splat = SPLAT.0 + SPLAT.1 * (m + 2.0) * (m + 2.0);
    let points = (m * size).powi(2);
    let rays = waves * (dense * (MIX + splat) + points * (1.0 + channels) * POINT);
    let node = match settings.diffraction {
        Model::Rays => rays,
        Model::Approximate => rays + OPEN.0 + channels * points * OPEN.1,
        Model::Waves => waves * (BENT.0 + points * BENT.1),
    };
    let warp = pixels * m * m * (SAMPLE.0 + SAMPLE.1 * work.planes as f64);
    table + grid.len() as f64 * node + warp
}
