//! The warped scene, sampled `m × m` times a cell or averaged over `b × b` pixels of it, block by block; and back.
//!
//! The cell's centre, a point of the sensor, shows the object slopes that the [`SensorMap`] has there; the texture is bilinear.

use glam::{DMat2, DVec2};
use ndarray::{Array3, ArrayView3, ArrayView4, ArrayViewMut4, Axis, CowArray, Ix3, s};
use rayon::prelude::*;

use crate::frame::Frame;
use crate::plane::{Plane, Region};
use crate::render::blur::Source;
use isoplanat_base::math::real::Real;
use isoplanat_base::math::wide::{Work, wide};
use isoplanat_base::stop::look;
use isoplanat_optics::psf::{LineBar, SensorLine, SensorMap};

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

/// Where the points of a line fall on the texture: bilinear taps, structure of arrays.
#[derive(Default)]
struct Line {
    /// The points.
    points: SensorLine,
    /// Texel coordinates along columns and rows, then the weights of the second texels.
    at: [Vec<f64>; 2],
    /// Whether the coordinates were inside the texture: 1 or 0.
    inside: [Vec<f64>; 2],
    /// The first of the four texels.
    first: Vec<usize>,
}

/// Coordinates to the texels below them and the weights of those above; the border is repeated.
struct Below<'a> {
    at: &'a mut [f64],
    inside: &'a mut [f64],
    first: &'a mut [usize],
    count: usize,
    stride: usize,
}

impl Work for Below<'_> {
    type Output = ();

    #[inline(always)]
    #[expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "raster sizes")]
    fn run(self) {
        // Adding it leaves the whole number in the last bits.
        const SHIFT: f64 = 4_503_599_627_370_496.0;
        let limit = (self.count - 1) as f64;
        let last = self.count.saturating_sub(2) as f64;
        for ((at, inside), first) in self.at.iter_mut().zip(self.inside).zip(self.first) {
            let x = *at - 0.5;
            *inside = if x > 0.0 && x < limit { 1.0 } else { 0.0 };
            // Not a number becomes 0, as it lies nowhere inside.
            let x = if x > 0.0 { x } else { 0.0 };
            let x = if x < limit { x } else { limit };
            let below = x.floor();
            let below = if below < last { below } else { last };
            *at = x - below;
            *first += ((below + SHIFT).to_bits() as u32 as usize) * self.stride;
        }
    }
}

/// The texture's neighbours along columns and rows.
#[derive(Clone, Copy)]
struct Steps {
    across: usize,
    down: usize,
}

impl Line {
    #[inline]
    fn value(&self, j: usize, plane: &[f32], Steps { across, down }: Steps) -> f64 {
        let first = self.first[j];
        let at = |k: usize| f64::from(plane[first + k]);
        let (a, b) = (at(0), at(down));
        let top = a + self.at[0][j] * (at(across) - a);
        let bottom = b + self.at[0][j] * (at(down + across) - b);
        top + self.at[1][j] * (bottom - top)
    }

    /// Derivatives along columns and rows.
    #[inline]
    fn slopes(&self, j: usize, plane: &[f32], Steps { across, down }: Steps) -> [f64; 2] {
        let first = self.first[j];
        let at = |k: usize| f64::from(plane[first + k]);
        let (a, b) = (at(0), at(across));
        let (c, d) = (at(down), at(down + across));
        let x = (b - a) + self.at[1][j] * ((d - c) - (b - a));
        let y = (c + self.at[0][j] * (d - c)) - (a + self.at[0][j] * (b - a));
        [self.inside[0][j] * x, self.inside[1][j] * y]
    }
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
        let [x, y] = self.map.slopes(offset.map(|v| v * self.frame.pitch_mm), self.texels_per_slope);
        [self.axis_texel[0] + x, self.axis_texel[1] + y]
    }

    /// The pixel `[row, col]` of `region` that shows the texel of the largest second differences there, and their energy; none where the texture is even.
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "raster sizes"
    )]
    pub(crate) fn peak(&self, region: Region) -> Option<([isize; 2], f32)> {
        let [x0, y0] = self.frame.axis_px;
        // In pixels from the frame's corner.
        let shown = |at: DVec2| DVec2::from(self.texel([at.x - x0, at.y - y0]));
        let corner = DVec2::new(region.col as f64, region.row as f64);
        let size = DVec2::new(region.cols as f64, region.rows as f64);
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for (i, j) in (0..5).flat_map(|i| (0..5).map(move |j| (i, j))) {
            let at = shown(corner + size * DVec2::new(f64::from(i), f64::from(j)) / 4.0);
            (low, high) = (low.min(at), high.max(at));
        }
        let (_, rows, cols) = self.texture.dim();
        let bounds = |low: f64, high: f64, count: usize| {
            let last = (count - 1) as f64;
            ((low - 1.0).clamp(0.0, last) as usize)..=((high + 1.0).clamp(0.0, last) as usize)
        };
        let (wide, tall) = (bounds(low.x, high.x, cols), bounds(low.y, high.y, rows));
        let planes: Vec<&[f32]> = self.channels.iter().map(|c| self.plane(*c)).collect();
        let (first, last) = (*wide.start(), *wide.end());
        let mut best = (0.0f32, [0, 0]);
        let mut energies = vec![0.0f32; last + 1 - first];
        for i in tall {
            energies.fill(0.0);
            for plane in &planes {
                let row = |i: usize| &plane[i * cols..(i + 1) * cols];
                let (above, here, below) = (row(i.saturating_sub(1)), row(i), row((i + 1).min(rows - 1)));
                let second = |j: usize, left: usize, right: usize| {
                    (4.0 * here[j] - above[j] - below[j] - here[left] - here[right]).powi(2)
                };
                for (j, e) in (first..=last).zip(&mut energies) {
                    *e += second(j, j.saturating_sub(1), (j + 1).min(cols - 1));
                }
            }
            for (j, e) in (first..=last).zip(&energies) {
                if *e > best.0 {
                    best = (*e, [i, j]);
                }
            }
        }
        if best.0 == 0.0 {
            return None;
        }
        // Which pixel shows it: steps along the map's own growth.
        let wanted = DVec2::new(best.1[1] as f64 + 0.5, best.1[0] as f64 + 0.5);
        let mut at = corner + 0.5 * size;
        for _ in 0..8 {
            let [by_x, by_y] = [DVec2::X, DVec2::Y].map(|e| shown(at + 0.5 * e) - shown(at - 0.5 * e));
            let step = DMat2::from_cols(by_x, by_y).inverse() * (wanted - shown(at));
            if !step.is_finite() {
                return None;
            }
            at = (at + step).clamp(corner, corner + size);
        }
        Some(([at.y.floor() as isize, at.x.floor() as isize], best.0))
    }

    /// Offset from the axis, in cells, of point `k` of the `n` along an axis of the cell at `at`.
    #[inline(always)]
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    fn place(at: isize, k: usize, n: usize, axis_px: f64) -> f64 {
        at as f64 + (k as f64 + 0.5) / n as f64 - axis_px
    }

    fn plane(&self, channel: usize) -> &[f32] {
        let (_, rows, cols) = self.texture.dim();
        &self.texture.as_slice().expect("standard layout")[channel * rows * cols..][..rows * cols]
    }

    fn steps(&self) -> Steps {
        let (_, rows, cols) = self.texture.dim();
        Steps { across: usize::from(cols > 1), down: if rows > 1 { cols } else { 0 } }
    }

    /// Tells `visit` every line of points of a row of `region`: its phase and its points.
    fn lines(&self, region: Region, row: usize, line: &mut Line, mut visit: impl FnMut(usize, &Line)) {
        let (_, rows, cols) = self.texture.dim();
        let (m, b) = (self.samples, self.average);
        let n = m * b;
        line.points.cell_mm = self.frame.pitch_mm;
        for fy in 0..n {
            line.points.row = Self::place(region.row + row.cast_signed(), fy, n, self.frame.axis_px[1]);
            for fx in 0..n {
                let of = |j: usize| Self::place(region.col + j.cast_signed(), fx, n, self.frame.axis_px[0]);
                line.points.columns.clear();
                line.points.columns.extend((0..region.cols).map(of));
                self.map.line(&mut line.points, self.texels_per_slope, line.at.each_mut());
                for (at, axis) in line.at.iter_mut().zip(self.axis_texel) {
                    at.iter_mut().for_each(|v| *v += axis);
                }
                line.first.clear();
                line.first.resize(region.cols, 0);
                for (k, (count, stride)) in [(cols, 1), (rows, cols)].into_iter().enumerate() {
                    line.inside[k].resize(region.cols, 0.0);
                    let (at, inside) = (&mut line.at[k][..], &mut line.inside[k][..]);
                    wide(Below { at, inside, first: &mut line.first, count, stride });
                }
                visit((fy / b) * m + fx / b, line);
            }
        }
    }

    /// Writes `[channel, phase, row, col]` of `region`; false if all of it is zero.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub(crate) fn fill<T: Real>(&self, region: Region, mut out: ArrayViewMut4<'_, T>) -> bool {
        let mean = ((self.average * self.average) as f64).recip();
        let (phases, steps) = (self.samples * self.samples, self.steps());
        let (mut lit, mut line) = (false, Line::default());
        let mut sums = vec![0.0; self.channels.len() * phases * region.cols];
        for i in 0..region.rows {
            sums.fill(0.0);
            self.lines(region, i, &mut line, |phase, line| {
                for (c, channel) in self.channels.iter().enumerate() {
                    let plane = self.plane(*channel);
                    let sums = &mut sums[(c * phases + phase) * region.cols..][..region.cols];
                    sums.iter_mut().enumerate().for_each(|(j, sum)| *sum += line.value(j, plane, steps));
                }
            });
            for (k, values) in sums.chunks_exact(region.cols.max(1)).enumerate() {
                for (v, light) in out.slice_mut(s![k / phases, k % phases, i, ..]).iter_mut().zip(values) {
                    lit |= *light != 0.0;
                    *v = T::real(light * mean);
                }
            }
        }
        lit
    }

    /// Pulls a cotangent on [`Self::fill`] back to the map's coefficients (added).
    pub(crate) fn fill_vjp<T: Real>(&self, region: Region, bar: ArrayView4<'_, T>, coefficients_bar: &mut [f64]) {
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let mean = ((self.average * self.average) as f64).recip();
        let scale = mean * self.texels_per_slope;
        let steps = self.steps();
        let rows: Vec<Vec<f64>> = (0..region.rows)
            .into_par_iter()
            .map_init(
                || (Line::default(), LineBar::default()),
                |(line, pulled), i| {
                    look();
                    let mut sum = vec![0.0; coefficients_bar.len()];
                    self.lines(region, i, line, |phase, line| {
                        pulled.begin(&line.points, scale);
                        for (c, channel) in self.channels.iter().enumerate() {
                            let plane = self.plane(*channel);
                            let bars = bar.slice(s![c, phase, i, ..]);
                            for (j, b) in bars.iter().enumerate() {
                                pulled.add(&line.points, j, b.to_double(), line.slopes(j, plane, steps));
                            }
                        }
                        self.map.line_vjp(&line.points, pulled, &mut sum);
                    });
                    sum
                },
            )
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
        look();
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
    use isoplanat_base::testing::{assert_abs, assert_rel};
    use isoplanat_optics::lens::builtin;
    use isoplanat_optics::psf::table::{Table, TableSpec};
    use ndarray::Array4;

    fn map() -> SensorMap {
        let lens = builtin::lens("two_element").expect("shipped");
        let radii_mm = (0..=12).map(|i| 1.5 * f64::from(i)).collect();
        let spec = TableSpec { radii_mm, wavelength_nm: vec![550.0], degree: 5, lit: false };
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
