//! A planar scene and its distorted image on the sensor's raster.
//!
//! A scene is continuous: its texels carry a bilinear reconstruction, in every renderer alike; beyond its border the
//! nearest texel continues. The pixel at offset `δ` (pixels) from the axis sees the object slope
//! `r = D⁻¹(|δ| p)` in the direction of `δ`: [`warp`]; its pull-back goes to the distortion's coefficients.

use ndarray::{Array3, ArrayView3, Axis};
use rayon::prelude::*;

use super::cfa::Real;
use super::distortion::Distortion;
use super::frame::Frame;

/// A flat, self-luminous texture facing the lens.
#[derive(Clone, Debug)]
pub struct Plane {
    /// Linear radiance `[channel, row, col]`, upright.
    pub texture: Array3<f32>,
    /// Texels per unit of object slope (object height over distance).
    pub texels_per_slope: f64,
    /// Texel coordinates `[column, row]` of the point on the optical axis (texel centres at +½).
    pub axis_texel: [f64; 2],
    /// 1/distance before the first vertex, 1/mm; 0 is infinity.
    pub vergence: f64,
}

impl Plane {
    /// Texel coordinates of the object slope `[right, up]`.
    pub fn texel_from_slope(&self, slope: [f64; 2]) -> [f64; 2] {
        [self.axis_texel[0] + slope[0] * self.texels_per_slope, self.axis_texel[1] - slope[1] * self.texels_per_slope]
    }

    /// Bilinear radiance of `channel` at texel coordinates, and its derivatives with respect to them.
    #[inline]
    pub fn sample(&self, channel: usize, texel: [f64; 2]) -> (f64, [f64; 2]) {
        bilinear(self.texture.index_axis(Axis(0), channel), texel)
    }
}

#[inline]
fn bilinear(t: ndarray::ArrayView2<'_, f32>, texel: [f64; 2]) -> (f64, [f64; 2]) {
    let (rows, cols) = t.dim();
    let axis = |x: f64, n: usize| -> (usize, usize, f64, f64) {
        #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
        let limit = n as f64 - 1.0;
        let x = x - 0.5;
        if !(x > 0.0 && x < limit) {
            let end = if x >= limit { n - 1 } else { 0 };
            return (end, end, 0.0, 0.0);
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside 0..limit")]
        let i = x as usize;
        #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
        let f = x - i as f64;
        (i, i + 1, f, 1.0)
    };
    let (c0, c1, fx, gx) = axis(texel[0], cols);
    let (r0, r1, fy, gy) = axis(texel[1], rows);
    let at = |r: usize, c: usize| f64::from(t[[r, c]]);
    let (a, b, c, d) = (at(r0, c0), at(r0, c1), at(r1, c0), at(r1, c1));
    let top = a + fx * (b - a);
    let bottom = c + fx * (d - c);
    let dx = (b - a) + fy * ((d - c) - (b - a));
    (top + fy * (bottom - top), [gx * dx, gy * (bottom - top)])
}

/// A rectangle of pixels in a frame (it may reach beyond it).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First row.
    pub row: isize,
    /// First column.
    pub col: isize,
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub cols: usize,
}

impl Region {
    /// The region with `margin` more pixels on every side.
    #[must_use]
    pub fn grown(self, margin: usize) -> Self {
        Self {
            row: self.row - margin.cast_signed(),
            col: self.col - margin.cast_signed(),
            rows: self.rows + 2 * margin,
            cols: self.cols + 2 * margin,
        }
    }

    /// Smallest and largest distance from the axis, mm, of the region less `inset` pixels on every side: 0 for all of its
    /// points, ½ for its pixels' centres.
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    pub fn radii_mm(self, frame: &Frame, inset: f64) -> [f64; 2] {
        let ends = |first: isize, count: usize, axis: f64| {
            let (a, b) = (first as f64 + inset - axis, (first + count.cast_signed()) as f64 - inset - axis);
            let nearest = if a <= 0.0 && b >= 0.0 { 0.0 } else { a.abs().min(b.abs()) };
            [nearest, a.abs().max(b.abs())]
        };
        let x = ends(self.col, self.cols, frame.axis_px[0]);
        let y = ends(self.row, self.rows, frame.axis_px[1]);
        [0, 1].map(|k| x[k].hypot(y[k]) * frame.pitch_mm)
    }

    /// Offset `[column, row]` in pixels from the frame's axis of the centre of the region's pixel `(i, j)`.
    #[inline]
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    pub fn offset(self, frame: &Frame, i: usize, j: usize) -> [f64; 2] {
        [
            (self.col + j.cast_signed()) as f64 + 0.5 - frame.axis_px[0],
            (self.row + i.cast_signed()) as f64 + 0.5 - frame.axis_px[1],
        ]
    }
}

/// Object slope per mm of sensor radius at `radius_mm`, finite on the axis.
#[inline]
pub fn slope_per_mm(distortion: &Distortion, radius_mm: f64) -> f64 {
    if radius_mm < 1e-9 {
        distortion.sensor_from_slope_derivative(0.0).recip()
    } else {
        distortion.slope_from_sensor(radius_mm) / radius_mm
    }
}

/// The scene as an ideal lens with this distortion would image it: sampled at pixel centres, `[channel, row, col]`.
pub fn warp<T: Real>(scene: &Plane, distortion: &Distortion, frame: &Frame, region: Region) -> Array3<T> {
    let channels = scene.texture.len_of(Axis(0));
    let mut out = Array3::from_elem((channels, region.rows, region.cols), T::zero());
    out.axis_iter_mut(Axis(1)).into_par_iter().enumerate().for_each(|(i, mut row)| {
        for j in 0..region.cols {
            let texel = texel_at(scene, distortion, frame, region, i, j).0;
            for c in 0..channels {
                row[[c, j]] = T::from(scene.sample(c, texel).0).unwrap_or_else(T::zero);
            }
        }
    });
    out
}

#[inline]
fn texel_at(
    scene: &Plane,
    distortion: &Distortion,
    frame: &Frame,
    region: Region,
    i: usize,
    j: usize,
) -> ([f64; 2], [f64; 2], f64) {
    let d = region.offset(frame, i, j);
    let radius = d[0].hypot(d[1]) * frame.pitch_mm;
    let scale = slope_per_mm(distortion, radius) * frame.pitch_mm * scene.texels_per_slope;
    ([scene.axis_texel[0] + d[0] * scale, scene.axis_texel[1] + d[1] * scale], d, radius)
}

/// Pulls a cotangent on [`warp`] back to the distortion's coefficients.
pub fn warp_vjp<T: Real>(
    scene: &Plane,
    distortion: &Distortion,
    frame: &Frame,
    region: Region,
    bar: ArrayView3<'_, T>,
) -> [f64; 4] {
    let rows: Vec<[f64; 4]> = (0..region.rows)
        .into_par_iter()
        .map(|i| {
            let mut sum = [0.0; 4];
            for j in 0..region.cols {
                let (texel, d, radius) = texel_at(scene, distortion, frame, region, i, j);
                if radius < 1e-9 {
                    continue;
                }
                let mut slope_bar = 0.0;
                for c in 0..bar.len_of(Axis(0)) {
                    let g = scene.sample(c, texel).1;
                    let along = (g[0] * d[0] + g[1] * d[1]) * frame.pitch_mm / radius * scene.texels_per_slope;
                    slope_bar += bar[[c, i, j]].to_f64().unwrap_or(0.0) * along;
                }
                let b = distortion.slope_from_sensor_vjp(radius, slope_bar);
                sum.iter_mut().zip(b).for_each(|(s, v)| *s += v);
            }
            sum
        })
        .collect();
    rows.iter().fold([0.0; 4], |mut s, r| {
        s.iter_mut().zip(r).for_each(|(a, b)| *a += b);
        s
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_rel, central_difference};

    #[test]
    fn warp_vjp_agrees_with_differences() {
        let rng = &mut fastrand::Rng::with_seed(4);
        let scene = Plane {
            texture: Array3::from_shape_fn((3, 60, 80), |_| rng.f32()),
            texels_per_slope: 100.0,
            axis_texel: [3.0, 5.0],
            vergence: 1e-3,
        };
        let frame = Frame::centred(40, 30, 0.5).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
        let region = Region { row: 2, col: 1, rows: 20, cols: 37 };
        let model = Distortion { max_slope: 0.4, coefficients_mm: [18.0, -1.5, 0.2, -0.1], residual_mm: 0.0 };
        let bar = Array3::from_shape_fn((3, 20, 37), |_| rng.f64() - 0.5);
        let pulled = warp_vjp(&scene, &model, &frame, region, bar.view());
        for (k, pulled) in pulled.into_iter().enumerate() {
            let f = |h: f64| {
                let mut m = model.clone();
                m.coefficients_mm[k] += h;
                (&warp::<f64>(&scene, &m, &frame, region) * &bar).sum()
            };
            // The last columns lie beyond the fitted range and use the linear continuation.
            assert_rel(pulled, central_difference(f, 1e-6), 1e-6, 1e-3, &format!("b{k}"));
        }
    }
}
