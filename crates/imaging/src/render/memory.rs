//! What rendering takes of memory, estimated from above before it is taken.

use super::blur::cost::Task;
use super::scene_plan::ScenePlan;
use crate::frame::Frame;
use crate::plane::Region;
use isoplanat_base::math::memory::{BASE, product, threads};

/// Kernels of all channels, f64, that probes hold: fixed, and a thread.
const PROBES: (usize, usize) = (24, 3);
/// Samples a pixel along an axis of the finest probes, by the kernel's size.
const FINEST: [(usize, usize); 3] = [(33, 8), (65, 4), (201, 2)];

/// Bytes of a scene: its texels, and as much again while they are made or read.
pub fn scene([rows, cols]: [usize; 2]) -> u64 {
    product(&[rows, cols, 2 * 3 * size_of::<f32>()])
}

/// Bytes of the planes of a picture of `frame` and of its file, whatever the lens and the scene.
pub fn planes(frame: &Frame) -> u64 {
    product(&[frame.rows, frame.columns, 3 * 3 * size_of::<f32>() + 12])
}

/// Bytes of tracing rays from the sensor to a picture of `frame`: sums, means and variances.
pub fn rays(frame: &Frame) -> u64 {
    BASE.saturating_add(product(&[frame.rows, frame.columns, 3 * 6 * size_of::<f32>()]))
}

impl ScenePlan {
    /// Bytes, from above, of planning as was done and of [`Self::picture`] of a scene of so many texels in f32, with the file it is
    /// written to.
    pub fn bytes(&self, texels: [usize; 2]) -> u64 {
        let render = &self.renderer.plan;
        let depth = &render.depths[0];
        let around = super::coarse::cells(self.region.unwrap_or_else(|| Region::whole(&render.frame)), depth.bin);
        let grid = depth.grid.part(around);
        let channels = self.needs.channels.lit.len();
        let task = Task {
            grid: &grid,
            region: around,
            size: depth.size(),
            channels,
            source_channels: self.needs.channels.sources(),
            phases: depth.samples * depth.samples,
        };
        let size = depth.size();
        let finest = if depth.bin > 1 { 1 } else { FINEST.iter().find(|f| size <= f.0).map_or(2, |f| f.1) };
        let probes = PROBES.0 + PROBES.1 * threads();
        let planning = product(&[probes, 3, size * finest, size * finest, size_of::<f64>()]);
        let counts = product(&[texels[0] + 1, texels[1] + 1, size_of::<u64>()]);
        let picture = task.bytes(self.method, size_of::<f32>()).saturating_add(planes(&render.frame));
        // Probes and pictures make kernels on every thread beside what they hold.
        let bending = self.renderer.optics.bending_bytes(size, depth.raster.pitch_mm);
        let planning = planning.max(self.look_bytes);
        [BASE, scene(texels), counts, planning.max(picture), bending].into_iter().fold(0, u64::saturating_add)
    }
}
