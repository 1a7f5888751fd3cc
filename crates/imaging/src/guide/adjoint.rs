//! The way back through what a network is told: the cotangent of its channels at the capture. Filters and places are constants here;
//! a design that moves its lens makes the filters anew now and then.

use ndarray::{Array3, ArrayView3, s};

use super::filters::{Mirrored, places};
use super::{Filters, Guide};
use crate::plane::Region;
use crate::render::blur::{BlurRecord, KernelArray, Method, blur_recorded, blur_vjp};

/// What [`Guide::over_vjp`] needs of a [`Guide::over_recorded`].
pub struct Record {
    at: Region,
    wanted: Region,
    filtered: Vec<BlurRecord<f32>>,
}

impl Filters {
    fn over_recorded(&self, image: ArrayView3<'_, f32>, at: Region, wanted: Region) -> (Array3<f32>, BlurRecord<f32>) {
        let (grid, kernels) = self.part(wanted);
        let block = match Self::method(&grid, kernels.dim().3, wanted) {
            Method::Cells { block } => block,
            Method::Direct => wanted.rows.max(wanted.cols),
        };
        blur_recorded(&grid, &KernelArray(kernels.view()), &Mirrored { image, at }, wanted, block, true)
    }

    /// Adds to `to` over `at` what the source beyond its edges got, at the places that it mirrors.
    fn fold(&self, source: ArrayView3<'_, f32>, wanted: Region, at: Region, to: &mut Array3<f32>) {
        let seen = wanted.grown(self.reach());
        let down = places(seen.row, seen.rows, at.row, at.rows);
        let across = places(seen.col, seen.cols, at.col, at.cols);
        for (mut to, from) in to.outer_iter_mut().zip(source.outer_iter()) {
            for (from, i) in from.outer_iter().zip(&down) {
                let mut row = to.row_mut(*i);
                from.iter().zip(&across).for_each(|(v, j)| row[*j] += v);
            }
        }
    }
}

impl Guide {
    /// [`Guide::over`] and what its pull-back needs.
    pub fn over_recorded(&self, image: ArrayView3<'_, f32>, at: Region, wanted: Region) -> (Array3<f32>, Record) {
        let (images, filtered): (Vec<Array3<f32>>, Vec<BlurRecord<f32>>) =
            self.facts.banks().map(|f| f.over_recorded(image, at, wanted)).unzip();
        (self.stacked(image, at, wanted, images.into_iter()), Record { at, wanted, filtered })
    }

    /// Pulls the cotangent of the channels, `[channel, row, col]` over what was wanted, back to the capture `[3, row, col]`.
    pub fn over_vjp(&self, record: &Record, bar: ArrayView3<'_, f32>) -> Array3<f32> {
        let Record { at, wanted, .. } = *record;
        let mut to = Array3::zeros((3, at.rows, at.cols));
        let (row, col) = Self::offset(at, wanted);
        to.slice_mut(s![.., row..row + wanted.rows, col..col + wanted.cols]).assign(&bar.slice(s![..3, .., ..]));
        for (k, (filters, filtered)) in self.facts.banks().zip(&record.filtered).enumerate() {
            let first = 3 * (k + 1);
            let source = blur_vjp(filtered, bar.slice(s![first..first + 3, .., ..])).source;
            filters.fold(source.index_axis(ndarray::Axis(1), 0), wanted, at, &mut to);
        }
        to
    }
}
