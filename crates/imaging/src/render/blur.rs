//! Frame-sized varying blur: `y_c(p) = Σ_n w_n(p) Σ_f [k_{n,c,f} * s_{c,f}](p)`, and its exact transposes.
//!
//! The windows `w_n` of a [`NodeGrid`] multiply the *image*: a kernel belongs to the place on the sensor where its light
//! arrives. The windows sum to one, so a white scene stays white whatever the nodes (kernels that sum to one), the error
//! between nodes is second order in their distance, no kernel is needed outside the image, and each source plane is
//! transformed once a block. The scene may be sampled at `m × m` points a pixel: phase `f = fy m + fx` is the fine sample
//! `(m row + fy, m col + fx)`, a source plane on the pixel raster with kernels of its own, so no fine image is ever blurred
//! only to be decimated. Two methods give the same sum ([`Method`]); [`cost::Task::cheapest`] chooses. Kernels and source
//! are asked for when needed, so a frame larger than memory allows as a whole can be blurred; [`blur_recorded`] keeps
//! their spectra for the cotangents.

pub(crate) mod adjoint;
mod band;
mod cells;
mod correlate;
pub mod cost;
mod direct;
mod frame;
mod lines;
mod node_sums;
mod pack;
#[cfg(test)]
mod plain;
mod plane;
mod record;
mod segments;
mod spectra;

use ndarray::{Array3, ArrayView4, ArrayView5, ArrayViewMut4, Axis, s};

use crate::plane::Region;
use crate::render::node_grid::NodeGrid;
use isoplanat_base::math::real::Real;

pub use adjoint::{BlurBar, blur_vjp};
pub use record::{BlurRecord, blur_recorded};

/// Kernels of the nodes, asked for when needed.
pub trait Kernels<T>: Sync {
    /// Channels of the image.
    fn channels(&self) -> usize;
    /// Rows and columns of a kernel, pixels; odd.
    fn size(&self) -> usize;
    /// Phases, `m²`.
    fn phases(&self) -> usize;
    /// Writes the kernels of `node`, `[channel, phase, row, col]`; all of `out` is written.
    ///
    /// Entry `(a, b)` moves light by `(a − size/2, b − size/2)` pixels.
    fn fill(&self, node: usize, out: ArrayViewMut4<'_, T>);
}

/// The scene, asked for block by block.
pub trait Source<T>: Sync {
    /// 1: the same planes for all channels of the image; else as many as the kernels have.
    fn channels(&self) -> usize;
    /// Writes `[channel, phase, row, col]` over `region` (pixels; it may reach beyond the frame); all of `out` is written.
    ///
    /// Returns whether any of it may differ from zero; if not, the block is skipped.
    fn fill(&self, region: Region, out: ArrayViewMut4<'_, T>) -> bool;
}

/// How to compute the sum. The results agree to rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// FFTs over blocks of the image of at most `block` pixels a side that never straddle a knot: at most four nodes.
    Cells {
        /// Largest side of a block, pixels.
        block: usize,
    },
    /// The plain sum, for small kernels.
    Direct,
}

/// Blurs `source` over `region`: `[channel, row, col]`.
///
/// `progress` is told the part done, 0 to 1. Each place of the source is asked for once ([`Method::Direct`] and regions too
/// wide for memory: a few times near the cuts). The image is the same to the bit for every number of threads; blocks
/// are cut from the knots on, so that a part of a region differs from the whole by the FFT's rounding alone.
///
/// # Panics
/// If the grid is empty, there is no phase, the kernels' size is even, or source and kernels differ in channels.
pub fn blur<T: Real>(
    grid: &NodeGrid,
    kernels: &dyn Kernels<T>,
    source: &dyn Source<T>,
    region: Region,
    method: Method,
    progress: &(dyn Fn(f64) + Sync),
) -> Array3<T> {
    let shape = frame::Shape::of(kernels, source);
    match method {
        Method::Cells { block } => {
            let frame = frame::Frame::new(grid, shape, region, block);
            cells::blur_cells(&frame, kernels, source, &mut spectra::NodeSpectra::new(), cells::Keep::Nothing, progress)
                .0
        }
        Method::Direct => direct::blur_direct(grid, kernels, source, region, progress),
    }
}

/// Kernels in memory, `[node, channel, phase, row, col]`.
#[derive(Clone, Debug)]
pub struct KernelArray<'a, T>(pub ArrayView5<'a, T>);

impl<T: Real> Kernels<T> for KernelArray<'_, T> {
    fn channels(&self) -> usize {
        self.0.len_of(Axis(1))
    }
    fn size(&self) -> usize {
        self.0.len_of(Axis(3))
    }
    fn phases(&self) -> usize {
        self.0.len_of(Axis(2))
    }
    fn fill(&self, node: usize, mut out: ArrayViewMut4<'_, T>) {
        out.assign(&self.0.index_axis(Axis(0), node));
    }
}

/// A source in memory: `planes` `[channel, phase, row, col]` over `region`, zero outside of it.
#[derive(Clone, Debug)]
pub struct SourceArray<'a, T> {
    /// Where the planes lie; for an image over `r` they cover `r.grown(size / 2)`.
    pub region: Region,
    /// The samples.
    pub planes: ArrayView4<'a, T>,
}

impl<T: Real> Source<T> for SourceArray<'_, T> {
    fn channels(&self) -> usize {
        self.planes.len_of(Axis(0))
    }
    fn fill(&self, region: Region, mut out: ArrayViewMut4<'_, T>) -> bool {
        let rows = common(region.row, region.rows, self.region.row, self.region.rows);
        let cols = common(region.col, region.cols, self.region.col, self.region.cols);
        if (rows.2, cols.2) != (region.rows, region.cols) {
            out.fill(T::zero());
        }
        if rows.2 == 0 || cols.2 == 0 {
            return false;
        }
        let part = self.planes.slice(s![.., .., rows.1..rows.1 + rows.2, cols.1..cols.1 + cols.2]);
        out.slice_mut(s![.., .., rows.0..rows.0 + rows.2, cols.0..cols.0 + cols.2]).assign(&part);
        part.iter().any(|v| *v != T::zero())
    }
}

/// What two spans share: offset in the first, offset in the second, length.
fn common(a: isize, a_len: usize, b: isize, b_len: usize) -> (usize, usize, usize) {
    let from = a.max(b);
    let to = (a + a_len.cast_signed()).min(b + b_len.cast_signed());
    if to <= from {
        return (0, 0, 0);
    }
    ((from - a).unsigned_abs(), (from - b).unsigned_abs(), (to - from).unsigned_abs())
}
