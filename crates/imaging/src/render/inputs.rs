//! What a blur asks a lens and a scene for: kernels of nodes, and a source that is kept as the ideal picture.

use std::borrow::Cow;
use std::sync::Mutex;

use ndarray::{Array3, ArrayViewMut4, s};

use super::nodes::centre;
use super::source::WarpedScene;
use crate::frame::Frame;
use crate::plane::Region;
use crate::render::blur::{Kernels, Source};
use crate::render::node_grid::NodeGrid;
use isoplanat_base::math::real::Real;
use isoplanat_optics::psf::splat::phase_of;
use isoplanat_optics::psf::{KernelForm, Optics};

/// What was seen while a picture was rendered.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// Kernels computed.
    pub kernels: usize,
    /// Largest share of a node's light outside its kernel.
    pub outside: f64,
}

/// Kernels of the nodes of one grid.
pub(super) struct NodeKernels<'a> {
    pub(super) optics: &'a Optics,
    pub(super) depth: usize,
    pub(super) raster: &'a Frame,
    pub(super) grid: &'a NodeGrid,
    /// Of the channels with light.
    pub(super) form: Cow<'a, KernelForm>,
    pub(super) seen: Mutex<Seen>,
}

impl<T: Real> Kernels<T> for NodeKernels<'_> {
    fn channels(&self) -> usize {
        self.form.channels()
    }
    fn size(&self) -> usize {
        self.form.raster.size
    }
    fn phases(&self) -> usize {
        self.form.raster.samples.pow(2)
    }
    fn fill(&self, node: usize, mut out: ArrayViewMut4<'_, T>) {
        let form = &*self.form;
        let raster = form.raster;
        let mut fine = vec![0.0; form.channels() * raster.len()];
        let (row, col) = self.grid.pixel(node);
        let at = centre(self.raster, row, col);
        let outside = self.optics.kernels(form, self.depth, at, &mut fine);
        for (k, plane) in fine.chunks_exact(raster.len()).enumerate() {
            for phase in 0..raster.samples.pow(2) {
                let view = out.slice_mut(s![k, phase, .., ..]);
                phase_of(plane, raster, [phase / raster.samples, phase % raster.samples], view, T::real);
            }
        }
        if let Ok(mut seen) = self.seen.lock() {
            seen.kernels += 1;
            seen.outside = outside.into_iter().fold(seen.outside, f64::max);
        }
    }
}

/// A source that also keeps what it writes over a region: the ideal picture, where a cell is a pixel and has one sample.
pub(super) struct Kept<'a, T> {
    pub(super) source: &'a WarpedScene<'a>,
    pub(super) region: Region,
    /// `[channel of the source, row, col]`.
    pub(super) planes: Mutex<Array3<T>>,
}

impl<T: Real> Source<T> for Kept<'_, T> {
    fn channels(&self) -> usize {
        self.source.channels()
    }
    fn fill(&self, part: Region, mut out: ArrayViewMut4<'_, T>) -> bool {
        let lit = self.source.fill(part, out.view_mut());
        let common = self.region.common(part);
        if common.rows == 0 || common.cols == 0 {
            return lit;
        }
        let within = |of: Region| {
            let at = |from: isize, first: isize| (from - first).unsigned_abs();
            let (row, col) = (at(common.row, of.row), at(common.col, of.col));
            (row..row + common.rows, col..col + common.cols)
        };
        let ((rows, cols), (to_rows, to_cols)) = (within(part), within(self.region));
        if let Ok(mut planes) = self.planes.lock() {
            planes.slice_mut(s![.., to_rows, to_cols]).assign(&out.slice(s![.., 0, rows, cols]));
        }
        lit
    }
}
