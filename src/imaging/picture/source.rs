//! The warped scene, sampled `m × m` times a pixel, block by block.

use ndarray::{ArrayViewMut4, CowArray, Ix3, s};

use crate::imaging::cfa::Real;
use crate::imaging::distortion::Distortion;
use crate::imaging::frame::Frame;
use crate::imaging::warp::{Plane, Region, slope_per_mm};

/// Object slope over sensor radius as piecewise cubics of the radius squared (an even, smooth function).
#[derive(Clone, Debug)]
pub struct RatioTable {
    /// Intervals per square pixel.
    per_square: f64,
    /// Coefficients of `t³ … 1` over each interval, slope per pixel.
    pieces: Vec<[f64; 4]>,
}

impl RatioTable {
    /// Intervals; their cubics are below 1e-9 of the ratio on all shipped lenses (tested).
    const INTERVALS: usize = 4096;

    /// The table over radii up to `max_px` pixels.
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    pub fn new(distortion: &Distortion, pitch_mm: f64, max_px: f64) -> Self {
        let n = Self::INTERVALS;
        let per_square = n as f64 / (max_px * max_px).max(1.0);
        let at = |k: f64| slope_per_mm(distortion, (k.max(0.0) / per_square).sqrt() * pitch_mm) * pitch_mm;
        let values: Vec<f64> = (0..=n).map(|k| at(k as f64)).collect();
        // Through four neighbours; one-sided at the ends.
        let pieces = (0..n)
            .map(|k| {
                let first = k.saturating_sub(1).min(n - 3);
                let t = |j: usize| (first + j) as f64 - k as f64;
                let mut coefficients = [0.0; 4];
                for i in 0..4 {
                    let others: Vec<f64> = (0..4).filter(|j| *j != i).map(t).collect();
                    let scale = values[first + i] / others.iter().map(|o| t(i) - o).product::<f64>();
                    let (a, b, c) = (others[0], others[1], others[2]);
                    let terms = [1.0, -(a + b + c), a * b + b * c + c * a, -a * b * c];
                    coefficients.iter_mut().zip(terms).for_each(|(s, v)| *s += scale * v);
                }
                coefficients
            })
            .collect();
        Self { per_square, pieces }
    }

    /// Object slope per pixel at the squared radius, pixels².
    #[inline]
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "an index"
    )]
    pub fn at(&self, square: f64) -> f64 {
        let x = square * self.per_square;
        let k = (x as usize).min(self.pieces.len() - 1);
        let t = (x - k as f64).min(2.0);
        let [a, b, c, d] = self.pieces[k];
        ((a * t + b) * t + c) * t + d
    }
}

/// A scene before a lens with this distortion, sampled `samples²` times a pixel.
pub struct WarpedScene<'a> {
    texture: CowArray<'a, f32, Ix3>,
    texels_per_slope: f64,
    axis_texel: [f64; 2],
    frame: Frame,
    table: RatioTable,
    samples: usize,
    /// The texture's channels that are sampled.
    channels: Vec<usize>,
}

impl<'a> WarpedScene<'a> {
    /// Samples `channels` of the scene's texture, `samples × samples` times a pixel, up to `margin` pixels outside the
    /// frame.
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    pub fn new(
        scene: &'a Plane,
        distortion: &Distortion,
        frame: &Frame,
        samples: usize,
        channels: Vec<usize>,
        margin: usize,
    ) -> Self {
        let farthest = frame.max_radius_mm() / frame.pitch_mm + 1.5 * margin as f64 + 4.0;
        let table = RatioTable::new(distortion, frame.pitch_mm, farthest);
        Self {
            texture: scene.texture.as_standard_layout(),
            texels_per_slope: scene.texels_per_slope,
            axis_texel: scene.axis_texel,
            frame: frame.clone(),
            table,
            samples,
            channels,
        }
    }

    /// Channels sampled.
    pub fn channels(&self) -> usize {
        self.channels.len()
    }

    /// Samples a pixel along an axis.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Texel coordinates `[column, row]` of the sensor point `offset` pixels from the axis.
    #[inline]
    pub fn texel(&self, offset: [f64; 2]) -> [f64; 2] {
        let [x, y] = offset;
        let scale = self.table.at(x * x + y * y) * self.texels_per_slope;
        [self.axis_texel[0] + x * scale, self.axis_texel[1] + y * scale]
    }

    /// Writes `[channel, phase, row, col]` of `region`; false if all of it is zero.
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    pub fn fill<T: Real>(&self, region: Region, mut out: ArrayViewMut4<'_, T>) -> bool {
        let m = self.samples;
        let (_, rows, cols) = self.texture.dim();
        let texels = self.texture.as_slice().expect("standard layout");
        let mut taps = Vec::with_capacity(region.cols);
        let mut lit = false;
        for (i, phase) in (0..region.rows).flat_map(|i| (0..m * m).map(move |phase| (i, phase))) {
            let (fy, fx) = ((phase / m) as f64, (phase % m) as f64);
            let y = (region.row + i.cast_signed()) as f64 + (fy + 0.5) / m as f64 - self.frame.axis_px[1];
            let start = region.col as f64 + (fx + 0.5) / m as f64 - self.frame.axis_px[0];
            taps.clear();
            taps.extend((0..region.cols).map(|j| {
                let texel = self.texel([start + j as f64, y]);
                let ((c0, c1, tx), (r0, r1, ty)) = (axis(texel[0], cols), axis(texel[1], rows));
                Tap { first: r0 * cols + c0, across: c1 - c0, down: (r1 - r0) * cols, tx, ty }
            }));
            for (c, channel) in self.channels.iter().enumerate() {
                let plane = &texels[channel * rows * cols..][..rows * cols];
                for (v, tap) in out.slice_mut(s![c, phase, i, ..]).iter_mut().zip(&taps) {
                    let light = tap.of(plane);
                    lit |= light != 0.0;
                    *v = T::real(light);
                }
            }
        }
        lit
    }
}

/// Four texels and the weights of the second ones.
struct Tap {
    first: usize,
    across: usize,
    down: usize,
    tx: f64,
    ty: f64,
}

impl Tap {
    #[inline]
    fn of(&self, plane: &[f32]) -> f64 {
        let at = |k: usize| f64::from(plane[k]);
        let (a, b) = (at(self.first), at(self.first + self.down));
        let top = a + self.tx * (at(self.first + self.across) - a);
        let bottom = b + self.tx * (at(self.first + self.down + self.across) - b);
        top + self.ty * (bottom - top)
    }
}

/// The two texels around a coordinate and the weight of the second; the border is repeated.
#[inline]
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "raster sizes"
)]
fn axis(x: f64, n: usize) -> (usize, usize, f64) {
    let x = x - 0.5;
    let limit = (n - 1) as f64;
    if !(x > 0.0 && x < limit) {
        let end = if x >= limit { n - 1 } else { 0 };
        return (end, end, 0.0);
    }
    let i = x as usize;
    (i, i + 1, x - i as f64)
}

#[cfg(test)]
mod tests {
    use ndarray::{Array3, Array4};

    use super::*;
    use crate::imaging::field_map::fit_distortion;
    use crate::imaging::plan::{field_slope, frame_of};
    use crate::imaging::warp::warp;
    use crate::lens::builtin;

    /// The table against the root of the polynomial: 1e-6 pixel all over the frame of every shipped lens.
    #[test]
    fn the_table_holds_a_millionth_of_a_pixel() {
        for (name, _) in builtin::LENSES {
            let lens = builtin::lens(name).expect("shipped");
            let frame = frame_of(&lens).expect("valid");
            let v = lens.object_vergence;
            let d = fit_distortion(&lens, v, field_slope(&lens, v, &frame).expect("reaches")).expect("fits");
            let most = frame.max_radius_mm() / frame.pitch_mm;
            let table = RatioTable::new(&d, frame.pitch_mm, most + 100.0);
            let per_pixel = slope_per_mm(&d, 0.0) * frame.pitch_mm;
            let mut worst = 0.0f64;
            for i in 0..20_000 {
                let r = most * f64::from(i) / 20_000.0;
                let exact = slope_per_mm(&d, r * frame.pitch_mm) * frame.pitch_mm * r;
                worst = worst.max((table.at(r * r) * r - exact).abs() / per_pixel);
            }
            assert!(worst < 1e-6, "{name}: {worst:e} pixel");
        }
    }

    /// One sample a pixel is `warp::warp`; four are the scene at finer places.
    #[test]
    fn one_sample_a_pixel_is_the_warped_scene() {
        let lens = builtin::lens("two_element").expect("shipped");
        let frame = frame_of(&lens).expect("valid");
        let v = lens.object_vergence;
        let d = fit_distortion(&lens, v, field_slope(&lens, v, &frame).expect("reaches")).expect("fits");
        let rng = &mut fastrand::Rng::with_seed(1);
        let scene = Plane {
            texture: Array3::from_shape_fn((3, 50, 70), |_| rng.f32()),
            texels_per_slope: 150.0,
            axis_texel: [5.0, 4.0],
            vergence: v,
        };
        let region = Region { row: 100, col: 2000, rows: 9, cols: 13 };
        let plain = warp::<f64>(&scene, &d, &frame, region);
        let source = WarpedScene::new(&scene, &d, &frame, 1, vec![0, 1, 2], 50);
        let mut got = Array4::<f64>::zeros((3, 1, 9, 13));
        assert!(source.fill(region, got.view_mut()));
        for ((c, i, j), v) in plain.indexed_iter() {
            assert!((got[[c, 0, i, j]] - v).abs() < 1e-6, "{c} {i} {j}");
        }
        // Three samples: the middle one is the pixel's centre.
        let source = WarpedScene::new(&scene, &d, &frame, 3, vec![1], 50);
        let mut got = Array4::<f64>::zeros((1, 9, 9, 13));
        assert!(source.fill(region, got.view_mut()));
        for ((c, i, j), v) in plain.indexed_iter().filter(|((c, ..), _)| *c == 1) {
            assert!((got[[c - 1, 4, i, j]] - v).abs() < 1e-6);
        }
        let dark = Plane { texture: Array3::zeros((1, 4, 4)), ..scene.clone() };
        assert!(
            !WarpedScene::new(&dark, &d, &frame, 1, vec![0], 50)
                .fill(region, Array4::<f32>::zeros((1, 1, 9, 13)).view_mut())
        );
    }
}
