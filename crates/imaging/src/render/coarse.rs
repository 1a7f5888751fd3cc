//! Coarser rasters for wide kernels.
//!
//! A picture blurred over many pixels is smooth: it is computed on cells of `b × b` pixels and brought to the pixels by
//! Catmull–Rom splines, whose transpose is exact. Both are separable.

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis};
use rayon::prelude::*;

use crate::frame::Frame;
use crate::plane::Region;
use isoplanat_base::error::Result;
use isoplanat_base::math::real::Real;

/// The frame in cells of `bin × bin` pixels; its last cells may reach beyond it.
///
/// # Errors
/// None for a valid frame.
pub(crate) fn raster(frame: &Frame, bin: usize) -> Result<Frame> {
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let b = bin as f64;
    Frame::centred(frame.columns.div_ceil(bin), frame.rows.div_ceil(bin), frame.pitch_mm * b)?
        .with_axis(frame.axis_px.map(|v| v / b))
}

/// The cells that the pixels of `region` are interpolated from.
pub(crate) fn cells(region: Region, bin: usize) -> Region {
    if bin == 1 {
        return region;
    }
    let b = bin.cast_signed();
    let along = |first: isize, count: usize| {
        let from = (first - b).div_euclid(b) - 1;
        let to = (first + count.cast_signed() + b).div_euclid(b) + 2;
        (from, (to - from).unsigned_abs())
    };
    let ((row, rows), (col, cols)) = (along(region.row, region.rows), along(region.col, region.cols));
    Region { row, col, rows, cols }
}

/// First cell (in the line of cells that starts at `first_cell`) and weights of the four that pixel `at` reads.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "raster sizes"
)]
fn taps<T: Real>(at: isize, first_cell: isize, bin: usize) -> (usize, [T; 4]) {
    let x = (at as f64 + 0.5) / bin as f64 - 0.5 - first_cell as f64;
    let k = x.floor();
    let t = x - k;
    let (t2, t3) = (t * t, t * t * t);
    let w = [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ];
    ((k as usize).wrapping_sub(1), w.map(T::real))
}

/// Every line of `from` (one a row) interpolated to `count` pixels from `first` on.
fn along<T: Real>(from: ArrayView2<'_, T>, first_cell: isize, first: isize, count: usize, bin: usize) -> Array2<T> {
    let taps: Vec<(usize, [T; 4])> = (0..count).map(|j| taps(first + j.cast_signed(), first_cell, bin)).collect();
    let mut out = Array2::from_elem((from.nrows(), count), T::zero());
    for (line, mut out) in from.outer_iter().zip(out.outer_iter_mut()) {
        for (o, (k, w)) in out.iter_mut().zip(&taps) {
            *o = w[0] * line[*k] + w[1] * line[k + 1] + w[2] * line[k + 2] + w[3] * line[k + 3];
        }
    }
    out
}

fn along_vjp<T: Real>(bar: ArrayView2<'_, T>, cells: usize, first_cell: isize, first: isize, bin: usize) -> Array2<T> {
    let count = bar.ncols();
    let taps: Vec<(usize, [T; 4])> = (0..count).map(|j| taps(first + j.cast_signed(), first_cell, bin)).collect();
    let mut out = Array2::from_elem((bar.nrows(), cells), T::zero());
    for (line, mut out) in bar.outer_iter().zip(out.outer_iter_mut()) {
        for (b, (k, w)) in line.iter().zip(&taps) {
            for (i, w) in w.iter().enumerate() {
                out[k + i] += *w * *b;
            }
        }
    }
    out
}

/// A picture in cells over [`cells`]`(region, bin)`, at the pixels of `region`.
pub(crate) fn to_pixels<T: Real>(picture: Array3<T>, region: Region, bin: usize) -> Array3<T> {
    if bin == 1 {
        return picture;
    }
    let from = cells(region, bin);
    let planes: Vec<Array2<T>> = picture
        .axis_iter(Axis(0))
        .into_par_iter()
        .map(|plane| {
            let wide = along(plane, from.col, region.col, region.cols, bin);
            along(wide.t(), from.row, region.row, region.rows, bin).reversed_axes()
        })
        .collect();
    stacked(&planes)
}

/// The transpose of [`to_pixels`].
pub(crate) fn to_pixels_vjp<T: Real>(bar: ArrayView3<'_, T>, region: Region, bin: usize) -> Array3<T> {
    if bin == 1 {
        return bar.to_owned();
    }
    let from = cells(region, bin);
    let planes: Vec<Array2<T>> = bar
        .axis_iter(Axis(0))
        .into_par_iter()
        .map(|plane| {
            let high = along_vjp(plane.t(), from.rows, from.row, region.row, bin);
            along_vjp(high.t(), from.cols, from.col, region.col, bin)
        })
        .collect();
    stacked(&planes)
}

fn stacked<T: Real>(planes: &[Array2<T>]) -> Array3<T> {
    let views: Vec<_> = planes.iter().map(|p| p.view()).collect();
    ndarray::stack(Axis(0), &views).expect("equal planes").as_standard_layout().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_abs, assert_rel};

    /// Quadratics come through exactly at any place, the pull-back is the transpose, cells stay where they are.
    #[test]
    fn smooth_pictures_come_through_and_the_pull_back_is_the_transpose() {
        let rng = &mut fastrand::Rng::with_seed(3);
        for (bin, region) in [
            (2, Region { row: 3, col: -5, rows: 17, cols: 30 }),
            (4, Region { row: -7, col: 8, rows: 33, cols: 9 }),
            (8, Region { row: 0, col: 0, rows: 64, cols: 64 }),
        ] {
            let from = cells(region, bin);
            let b = bin as f64;
            let f = |y: f64, x: f64| 0.3 + 0.02 * y - 0.01 * x + 1e-3 * y * x + 2e-3 * y * y - 1e-3 * x * x;
            // Values at the cells' centres, in pixels.
            let at = |i: usize, first: isize| (first as f64 + i as f64 + 0.5) * b;
            let picture = Array3::from_shape_fn((2, from.rows, from.cols), |(c, i, j)| {
                (c as f64 + 1.0) * f(at(i, from.row), at(j, from.col))
            });
            let out = to_pixels(picture.clone(), region, bin);
            for ((c, i, j), v) in out.indexed_iter() {
                let (y, x) = (region.row as f64 + i as f64 + 0.5, region.col as f64 + j as f64 + 0.5);
                assert_abs(*v, (c as f64 + 1.0) * f(y, x), 1e-10, "quadratic");
            }
            let bar = Array3::from_shape_fn(out.dim(), |_| rng.f64() - 0.5);
            let back = to_pixels_vjp(bar.view(), region, bin);
            assert_rel((&back * &picture).sum(), (&out * &bar).sum(), 1e-12, 1.0, "transpose");
        }
    }
}
