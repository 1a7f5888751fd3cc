//! A plan's picture.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use ndarray::{Array3, ArrayViewMut4, Axis, s};

use super::bank::{Place, Scratch};
use super::plan::PicturePlan;
use super::source::WarpedScene;
use crate::imaging::blur::{Kernels, Source, blur};
use crate::imaging::cfa::Real;
use crate::imaging::warp::Region;

/// A picture and what was seen on the way.
#[derive(Clone, Debug)]
pub struct Picture<T> {
    /// Irradiance `[3, row, col]`, 1 = white on the axis.
    pub image: Array3<T>,
    /// Kernels computed.
    pub kernels: usize,
    /// Largest share of a node's light outside its kernel.
    pub outside: f64,
}

/// Kernels of a plan's nodes.
struct NodeKernels<'a, 'b> {
    plan: &'a PicturePlan<'b>,
    count: AtomicUsize,
    outside: Mutex<f64>,
}

impl<T: Real> Kernels<T> for NodeKernels<'_, '_> {
    fn channels(&self) -> usize {
        self.plan.bank.channels()
    }
    fn size(&self) -> usize {
        2 * self.plan.half_width + 1
    }
    fn phases(&self) -> usize {
        self.plan.settings.samples * self.plan.settings.samples
    }
    fn fill(&self, node: usize, out: ArrayViewMut4<'_, T>) {
        let (row, col) = self.plan.grid.pixel(node);
        let place = Place::pixel(&self.plan.frame, row, col);
        let lost = self.plan.bank.fill(place, self.plan.settings.samples, &mut Scratch::default(), out);
        self.count.fetch_add(1, Ordering::Relaxed);
        if let Ok(mut outside) = self.outside.lock() {
            *outside = lost.into_iter().fold(*outside, f64::max);
        }
    }
}

impl<T: Real> Source<T> for WarpedScene<'_> {
    fn channels(&self) -> usize {
        self.channels()
    }
    fn fill(&self, region: Region, out: ArrayViewMut4<'_, T>) -> bool {
        self.fill(region, out)
    }
}

/// Renders `plan`; `progress` hears the share done.
pub fn render<T: Real>(plan: &PicturePlan<'_>, progress: &(dyn Fn(f64) + Sync)) -> Picture<T> {
    let mut image = Array3::from_elem((3, plan.frame.rows, plan.frame.columns), T::zero());
    let kernels = NodeKernels { plan, count: AtomicUsize::new(0), outside: Mutex::new(0.0) };
    if let (Some(region), false) = (plan.region, plan.needs.lit_channels.is_empty()) {
        let texture = plan.scene.texture.len_of(Axis(0));
        let channels = if plan.needs.grey {
            vec![0]
        } else {
            plan.needs.lit_channels.iter().map(|c| (*c).min(texture - 1)).collect()
        };
        let source = WarpedScene::new(
            plan.scene,
            &plan.distortion,
            &plan.frame,
            plan.settings.samples,
            channels,
            plan.half_width,
        );
        let part = blur::<T>(&plan.grid, &kernels, &source, region, plan.method, progress);
        let (r, c) = (region.row.unsigned_abs(), region.col.unsigned_abs());
        for (plane, channel) in part.axis_iter(Axis(0)).zip(&plan.needs.lit_channels) {
            image.slice_mut(s![*channel, r..r + region.rows, c..c + region.cols]).assign(&plane);
        }
    }
    progress(1.0);
    let outside = kernels.outside.into_inner().unwrap_or(f64::NAN);
    Picture { image, kernels: kernels.count.into_inner(), outside }
}
