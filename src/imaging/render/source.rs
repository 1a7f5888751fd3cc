//! The warped scene, sampled `m × m` times a cell or averaged over `b × b` pixels of it, block by block; and back.
//!
//! The cell's centre at `δ` mm from the axis shows the object slope `slope(|δ|)` of the [`SensorMap`] in the direction of
//! `δ`; the texture is bilinear there.

use ndarray::{Array3, ArrayView3, ArrayView4, ArrayViewMut4, Axis, CowArray, Ix3, s};
use rayon::prelude::*;

use crate::imaging::frame::Frame;
use crate::imaging::plane::{Plane, Region};
use crate::imaging::render::blur::Source;
use crate::math::real::Real;
use crate::psf::SensorMap;

/// A scene before a lens with this map, on the raster of `frame`.
pub struct WarpedScene<'a> {
    texture: CowArray<'a, f32, Ix3>,
    texels_per_slope: f64,
    axis_texel: [f64; 2],
    frame: Frame,
    map: &'a SensorMap,
    /// Samples a cell along each axis.
    samples: usize,
    /// Points along each axis whose mean a sample is.
    average: usize,
    /// The texture's channels that are sampled.
    channels: Vec<usize>,
}

/// Four texels, the weights of the second ones, and whether the place is inside the texture along columns and rows.
struct Tap {
    first: usize,
    across: usize,
    down: usize,
    tx: f64,
    ty: f64,
    inside: [bool; 2],
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

    /// Derivatives along columns and rows.
    #[inline]
    fn slopes(&self, plane: &[f32]) -> [f64; 2] {
        let at = |k: usize| f64::from(plane[k]);
        let (a, b) = (at(self.first), at(self.first + self.across));
        let (c, d) = (at(self.first + self.down), at(self.first + self.down + self.across));
        let x = (b - a) + self.ty * ((d - c) - (b - a));
        let y = (c + self.tx * (d - c)) - (a + self.tx * (b - a));
        [if self.inside[0] { x } else { 0.0 }, if self.inside[1] { y } else { 0.0 }]
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
fn axis(x: f64, n: usize) -> (usize, usize, f64, bool) {
    let x = x - 0.5;
    let limit = (n - 1) as f64;
    if !(x > 0.0 && x < limit) {
        let end = if x >= limit { n - 1 } else { 0 };
        return (end, end, 0.0, false);
    }
    let i = x as usize;
    (i, i + 1, x - i as f64, true)
}

impl<'a> WarpedScene<'a> {
    /// Samples `channels` of the scene's texture on the raster `frame`: `samples × samples` times a cell, each the mean of
    /// `average × average` points.
    pub fn new(
        scene: &'a Plane,
        map: &'a SensorMap,
        frame: &Frame,
        (samples, average): (usize, usize),
        channels: Vec<usize>,
    ) -> Self {
        Self {
            texture: scene.texture.as_standard_layout(),
            texels_per_slope: scene.texels_per_slope,
            axis_texel: scene.axis_texel,
            frame: frame.clone(),
            map,
            samples,
            average,
            channels,
        }
    }

    /// Samples a cell along an axis.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Channels sampled.
    pub fn channels(&self) -> usize {
        self.channels.len()
    }

    /// Texel coordinates `[column, row]` of the sensor point `offset` cells from the axis.
    #[inline]
    pub fn texel(&self, offset: [f64; 2]) -> [f64; 2] {
        let [x, y] = offset.map(|v| v * self.frame.pitch_mm);
        let scale = self.map.ratio_at(x * x + y * y) * self.texels_per_slope;
        [self.axis_texel[0] + x * scale, self.axis_texel[1] + y * scale]
    }

    fn tap(&self, offset: [f64; 2]) -> Tap {
        let (_, rows, cols) = self.texture.dim();
        let texel = self.texel(offset);
        let ((c0, c1, tx, in_x), (r0, r1, ty, in_y)) = (axis(texel[0], cols), axis(texel[1], rows));
        Tap { first: r0 * cols + c0, across: c1 - c0, down: (r1 - r0) * cols, tx, ty, inside: [in_x, in_y] }
    }

    /// Offset from the axis, in cells, of point `k` of the `n` along an axis of the cell at `at`.
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    fn place(at: isize, k: usize, n: usize, axis_px: f64) -> f64 {
        at as f64 + (k as f64 + 0.5) / n as f64 - axis_px
    }

    fn plane(&self, channel: usize) -> &[f32] {
        let (_, rows, cols) = self.texture.dim();
        &self.texture.as_slice().expect("standard layout")[channel * rows * cols..][..rows * cols]
    }

    /// Tells `visit` every point of a row of the region: its phase, its column there, its offset.
    fn points(&self, region: Region, row: usize, mut visit: impl FnMut(usize, usize, [f64; 2])) {
        let (m, b) = (self.samples, self.average);
        let n = m * b;
        for fy in 0..n {
            let y = Self::place(region.row + row.cast_signed(), fy, n, self.frame.axis_px[1]);
            for fx in 0..n {
                let phase = (fy / b) * m + fx / b;
                for j in 0..region.cols {
                    let x = Self::place(region.col + j.cast_signed(), fx, n, self.frame.axis_px[0]);
                    visit(phase, j, [x, y]);
                }
            }
        }
    }

    /// Writes `[channel, phase, row, col]` of `region`; false if all of it is zero.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub fn fill<T: Real>(&self, region: Region, mut out: ArrayViewMut4<'_, T>) -> bool {
        let mean = ((self.average * self.average) as f64).recip();
        let mut lit = false;
        let mut sums = vec![0.0; self.channels.len() * self.samples * self.samples * region.cols];
        for i in 0..region.rows {
            sums.fill(0.0);
            let phases = self.samples * self.samples;
            self.points(region, i, |phase, j, offset| {
                let tap = self.tap(offset);
                for (c, channel) in self.channels.iter().enumerate() {
                    sums[(c * phases + phase) * region.cols + j] += tap.of(self.plane(*channel));
                }
            });
            for (k, line) in sums.chunks_exact(region.cols.max(1)).enumerate() {
                for (v, light) in out.slice_mut(s![k / phases, k % phases, i, ..]).iter_mut().zip(line) {
                    lit |= *light != 0.0;
                    *v = T::real(light * mean);
                }
            }
        }
        lit
    }

    /// Pulls a cotangent on [`Self::fill`] back to the map's coefficients (added).
    pub fn fill_vjp<T: Real>(&self, region: Region, bar: ArrayView4<'_, T>, coefficients_bar: &mut [f64]) {
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let mean = ((self.average * self.average) as f64).recip();
        let rows: Vec<Vec<f64>> = (0..region.rows)
            .into_par_iter()
            .map(|i| {
                let mut sum = vec![0.0; coefficients_bar.len()];
                self.points(region, i, |phase, j, [x, y]| {
                    let length = x.hypot(y);
                    if length == 0.0 || (0..self.channels.len()).all(|c| bar[[c, phase, i, j]] == T::zero()) {
                        return;
                    }
                    let tap = self.tap([x, y]);
                    let mut slope_bar = 0.0;
                    for (c, channel) in self.channels.iter().enumerate() {
                        let b = bar[[c, phase, i, j]].to_double();
                        if b != 0.0 {
                            let [gx, gy] = tap.slopes(self.plane(*channel));
                            slope_bar += b * (gx * x + gy * y);
                        }
                    }
                    let weight = mean * slope_bar * self.texels_per_slope / length;
                    if weight != 0.0 {
                        self.map.slope_vjp(length * self.frame.pitch_mm, weight, &mut sum);
                    }
                });
                sum
            })
            .collect();
        for row in rows {
            coefficients_bar.iter_mut().zip(row).for_each(|(a, b)| *a += b);
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

/// The ideal picture: `channels` of the scene's texture as a lens with this map and no blur would image them, at pixel
/// centres, `[channel, row, col]`.
pub fn warp<T: Real>(scene: &Plane, map: &SensorMap, frame: &Frame, region: Region, channels: &[usize]) -> Array3<T> {
    let source = WarpedScene::new(scene, map, frame, (1, 1), channels.to_vec());
    let mut out = Array3::from_elem((channels.len(), region.rows, region.cols), T::zero());
    out.axis_chunks_iter_mut(Axis(1), 16).into_par_iter().enumerate().for_each(|(k, part)| {
        let rows = part.len_of(Axis(1));
        let strip = Region { row: region.row + (16 * k).cast_signed(), rows, ..region };
        source.fill(strip, part.insert_axis(Axis(1)));
    });
    out
}

/// Pulls a cotangent on [`warp`] back to the map's coefficients (added).
pub fn warp_vjp<T: Real>(
    scene: &Plane,
    map: &SensorMap,
    frame: &Frame,
    region: Region,
    (channels, bar): (&[usize], ArrayView3<'_, T>),
    coefficients_bar: &mut [f64],
) {
    let source = WarpedScene::new(scene, map, frame, (1, 1), channels.to_vec());
    source.fill_vjp(region, bar.insert_axis(Axis(1)), coefficients_bar);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::psf::table::{Table, TableSpec};
    use crate::testing::{assert_abs, assert_rel};
    use ndarray::Array4;

    fn map() -> SensorMap {
        let lens = builtin::lens("two_element").expect("shipped");
        let radii_mm = (0..=12).map(|i| 1.5 * f64::from(i)).collect();
        let spec = TableSpec { radii_mm, wavelength_nm: vec![550.0], degree: 5 };
        SensorMap::fit(&lens, &Table::compute(&lens, &spec).expect("traces"), 1e-3).expect("grows")
    }

    fn scene() -> Plane {
        let rng = &mut fastrand::Rng::with_seed(4);
        Plane {
            texture: Array3::from_shape_fn((3, 60, 80), |_| rng.f32()),
            texels_per_slope: 100.0,
            axis_texel: [3.0, 5.0],
            vergence: 1e-3,
        }
    }

    /// Phases and means are the scene at their places.
    #[test]
    fn samples_are_the_scene_at_their_places() {
        let (map, scene) = (map(), scene());
        let frame = Frame::centred(40, 30, 0.5).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
        let region = Region { row: 2, col: 1, rows: 9, cols: 13 };
        let at = |c: usize, y: f64, x: f64| {
            let radius = x.hypot(y) * 0.5;
            let slope = map.slope(radius) / radius * 0.5;
            scene.sample(c, [3.0 + x * slope * 100.0, 5.0 + y * slope * 100.0]).0
        };
        for (samples, average) in [(1, 1), (2, 1), (4, 1), (1, 2), (1, 4)] {
            let source = WarpedScene::new(&scene, &map, &frame, (samples, average), vec![0, 1, 2]);
            let mut got = Array4::<f64>::zeros((3, samples * samples, 9, 13));
            assert!(source.fill(region, got.view_mut()));
            let n = samples * average;
            for ((c, phase, i, j), v) in got.indexed_iter() {
                let mut sum = 0.0;
                for (a, b) in (0..average).flat_map(|a| (0..average).map(move |b| (a, b))) {
                    let place =
                        |cell: usize, first: f64, sub: usize| first + cell as f64 + (sub as f64 + 0.5) / n as f64;
                    let (fy, fx) = (phase / samples * average + a, phase % samples * average + b);
                    sum += at(c, place(i, 2.0, fy), place(j, 1.0, fx));
                }
                assert_abs(*v, sum / (average * average) as f64, 1e-12, "sample");
            }
        }
        let dark = Plane { texture: Array3::zeros((1, 4, 4)), ..scene.clone() };
        let source = WarpedScene::new(&dark, &map, &frame, (1, 1), vec![0]);
        assert!(!source.fill(region, Array4::<f32>::zeros((1, 1, 9, 13)).view_mut()));
    }

    #[test]
    fn the_pull_back_agrees_with_differences() {
        let (map, scene) = (map(), scene());
        let frame = Frame::centred(40, 30, 0.6).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
        // The last columns lie beyond the fitted range.
        let region = Region { row: 2, col: 1, rows: 20, cols: 37 };
        let rng = &mut fastrand::Rng::with_seed(5);
        for how in [(1, 1), (2, 1), (1, 2)] {
            let bar = Array4::from_shape_fn((3, how.0 * how.0, 20, 37), |_| rng.f64() - 0.5);
            let value = |map: &SensorMap| {
                let mut out = Array4::<f64>::zeros(bar.dim());
                WarpedScene::new(&scene, map, &frame, how, vec![0, 1, 2]).fill(region, out.view_mut());
                (&out * &bar).sum()
            };
            let mut pulled = vec![0.0; map.coefficients.len()];
            let source = WarpedScene::new(&scene, &map, &frame, how, vec![0, 1, 2]);
            source.fill_vjp(region, bar.view(), &mut pulled);
            for (k, pulled) in pulled.iter().enumerate() {
                let f = |h: f64| value(&map.changed(k, h));
                let h = 2e-9;
                assert_rel(*pulled, (f(h) - f(-h)) / (2.0 * h), 1e-5, 1.0, &format!("coefficient {k}"));
            }
        }
    }
}
