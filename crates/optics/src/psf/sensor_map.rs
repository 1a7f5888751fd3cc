//! Where on the sensor an object point's chief ray lands: the raster that scenes are warped to.
//!
//! `slope = R · P(R²) / (1 − R²/R₉₀²)`, with `P` a Chebyshev series in `2 (R/R_m)² − 1` fitted to the chief rays of a
//! [`Table`] by least squares. The divisor holds the pole of wide lenses ([`Table::horizon`]; 1 for all others), so that what
//! is fitted is smooth up to 90°, where slopes end: the map ends with the light of a plane ([`super::table::STEEPEST`]). It gives what every pixel asks for, the object slope of a sensor radius, by a sum of few products; the
//! inverse, for rays that arrive from elsewhere, by Newton. Any monotonic curve would do for the image, because kernels are
//! counted in the same coordinates; the ideal picture, and the distortion in a kit, are this map's. Beyond `R_m` it goes on
//! as a straight line.

mod lines;

pub use lines::{LineBar, SensorLine};

use ndarray::Array2;

use super::fit::chebyshev;
use super::table::{Table, TableBar};
use crate::lens::Lens;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::least_squares::fit_operator;

/// Terms at most, and knots a term.
const TERMS: (usize, usize) = (9, 1); // `lines` counts on at most 16 terms.

/// Sensor radius ⇄ object slope at one object distance.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorMap {
    /// Coefficients of the Chebyshev series, 1/mm.
    pub coefficients: Vec<f64>,
    /// Radius of the fit `R_m`, mm.
    pub radius_mm: f64,
    /// 1/distance of the object before the first vertex, 1/mm.
    pub vergence: f64,
    /// Largest distance of a chief ray from the map, mm on the sensor.
    pub residual_mm: f64,
    /// `1/R_m²`.
    inverse_square: f64,
    /// `1/R₉₀²`, or 0.
    horizon: f64,
    /// Slope at `R_m`, and its derivative there.
    edge: [f64; 2],
}

impl SensorMap {
    /// Fits the chief rays of `table` for an object at `vergence`.
    ///
    /// # Errors
    /// Object slopes that do not grow with the sensor radius: the picture folds.
    pub fn fit(lens: &Lens, table: &Table, vergence: f64) -> Result<Self> {
        Self::through(&table.spec.radii_mm, &table.chief_slopes(vergence), table.horizon, vergence)
            .map_err(|radius_mm| Self::folds(lens, radius_mm, vergence))
    }

    /// Fits object slopes at sensor radii that grow from 0, mm; `horizon` is `1/R₉₀²` where slopes have a pole, else 0.
    ///
    /// # Errors
    /// The radius, mm, from which on slopes do not grow: the picture folds there.
    #[doc(hidden)]
    pub fn through(radii: &[f64], slopes: &[f64], horizon: f64, vergence: f64) -> std::result::Result<Self, f64> {
        let radius_mm = radii[radii.len() - 1];
        let rows = operator(radii, horizon);
        let coefficients: Vec<f64> =
            rows.rows().into_iter().map(|row| row.iter().zip(slopes).map(|(a, s)| a * s).sum()).collect();
        let inverse_square = (radius_mm * radius_mm).recip();
        let mut map =
            Self { coefficients, radius_mm, vergence, residual_mm: 0.0, inverse_square, horizon, edge: [0.0; 2] };
        map.find_edge();
        for i in 0..=256 {
            let radius = radius_mm * f64::from(i) / 256.0;
            let slope = map.inside_derivative(radius);
            if slope.is_nan() || slope <= 0.0 {
                return Err(radius);
            }
        }
        let off = |(r, s): (&f64, &f64)| ((map.slope(*r) - s) / map.derivative(*r)).abs();
        map.residual_mm = radii.iter().zip(slopes).map(off).fold(0.0, f64::max);
        Ok(map)
    }

    /// What is said of a picture that folds at a radius.
    pub(super) fn folds(lens: &Lens, radius_mm: f64, vergence: f64) -> Error {
        Error::bad(
            lens.file(),
            format!("distortion at {radius_mm:.3} mm on the sensor, object at vergence {vergence} /mm"),
            "the object's height does not grow with the image's there".to_owned(),
            "an image whose height grows over the whole field; narrow the frame or change the lens",
        )
    }

    fn find_edge(&mut self) {
        self.edge = [self.inside(self.radius_mm), self.inside_derivative(self.radius_mm)];
    }

    /// The map with coefficient `k` changed by `h`, for tests.
    #[doc(hidden)]
    #[must_use]
    pub fn changed(&self, k: usize, h: f64) -> Self {
        let mut map = self.clone();
        map.coefficients[k] += h;
        map.find_edge();
        map
    }

    /// Adds the pull-back of a cotangent on the coefficients to `bar`.
    pub(crate) fn fit_vjp(&self, table: &Table, coefficients_bar: &[f64], bar: &mut TableBar) {
        let rows = operator(&table.spec.radii_mm, self.horizon);
        let slopes_bar: Vec<f64> =
            rows.columns().into_iter().map(|c| c.iter().zip(coefficients_bar).map(|(a, b)| a * b).sum()).collect();
        table.chief_slopes_vjp(self.vergence, &slopes_bar, bar);
    }

    /// `P` and `dP/dt` at `t = 2 x² − 1`, `x = R/R_m`, by Clenshaw's recurrence.
    #[inline]
    fn series(&self, x2: f64) -> (f64, f64) {
        let t = 2.0 * x2 - 1.0;
        let (mut b1, mut b2, mut d1, mut d2) = (0.0, 0.0, 0.0, 0.0);
        for c in self.coefficients[1..].iter().rev() {
            (d2, d1) = (d1, 2.0 * b1 + 2.0 * t * d1 - d2);
            (b2, b1) = (b1, c + 2.0 * t * b1 - b2);
        }
        (self.coefficients[0] + t * b1 - b2, b1 + t * d1 - d2)
    }

    /// `(R/R_m)²`.
    #[inline]
    fn share(&self, radius_mm: f64) -> f64 {
        radius_mm * radius_mm * self.inverse_square
    }

    /// `1 − R²/R₉₀²`.
    #[inline]
    fn below(&self, square_mm2: f64) -> f64 {
        1.0 - square_mm2 * self.horizon
    }

    fn inside(&self, radius_mm: f64) -> f64 {
        radius_mm * self.series(self.share(radius_mm)).0 / self.below(radius_mm * radius_mm)
    }

    fn inside_derivative(&self, radius_mm: f64) -> f64 {
        let (x2, square) = (self.share(radius_mm), radius_mm * radius_mm);
        let ((p, dp), q) = (self.series(x2), self.below(square));
        (p + 4.0 * x2 * dp + 2.0 * square * self.horizon * p / q) / q
    }

    /// Object slope of the sensor radius (≥ 0).
    #[inline]
    pub fn slope(&self, radius_mm: f64) -> f64 {
        if radius_mm <= self.radius_mm {
            self.inside(radius_mm)
        } else {
            self.edge[0] + (radius_mm - self.radius_mm) * self.edge[1]
        }
    }

    /// Object slope over sensor radius, 1/mm; finite on the axis.
    #[inline]
    pub fn ratio(&self, radius_mm: f64) -> f64 {
        if radius_mm <= self.radius_mm {
            self.series(self.share(radius_mm)).0 / self.below(radius_mm * radius_mm)
        } else {
            self.slope(radius_mm) / radius_mm
        }
    }

    /// [`Self::ratio`] at the squared sensor radius, mm².
    #[inline]
    fn ratio_at(&self, square_mm2: f64) -> f64 {
        let x2 = square_mm2 * self.inverse_square;
        if x2 <= 1.0 { self.series(x2).0 / self.below(square_mm2) } else { self.ratio(square_mm2.sqrt()) }
    }

    /// `∂slope/∂R`, 1/mm.
    #[inline]
    pub fn derivative(&self, radius_mm: f64) -> f64 {
        if radius_mm <= self.radius_mm { self.inside_derivative(radius_mm) } else { self.edge[1] }
    }

    /// Adds `weight · ∂slope/∂c` at a sensor radius to the coefficients' cotangent.
    #[doc(hidden)]
    #[inline]
    pub fn slope_vjp(&self, radius_mm: f64, weight: f64, coefficients_bar: &mut [f64]) {
        let inner = radius_mm.min(self.radius_mm);
        let beyond = radius_mm - inner;
        let x = inner / self.radius_mm;
        let t = 2.0 * x * x - 1.0;
        let q = self.below(inner * inner);
        let (weight, pole) = (weight / q, 2.0 * inner * inner * self.horizon / q);
        // slope = R T_j / q, and beyond the edge its tangent: that of R T_j is T_j + 4 T_j' at t = 1.
        let (mut a, mut b, mut da, mut db) = (1.0, t, 0.0, 1.0);
        for c in coefficients_bar {
            *c += weight * (inner * a + beyond * (a + 4.0 * x * x * da + pole * a));
            (a, b, da, db) = (b, 2.0 * t * b - a, db, 2.0 * b + 2.0 * t * db - da);
        }
    }

    /// Adds the pull-back of cotangents on [`Self::slope`], [`Self::ratio`] and [`Self::derivative`] at a sensor radius within the fit to the coefficients' cotangent.
    pub(super) fn local_vjp(&self, radius_mm: f64, [slope, ratio, derivative]: [f64; 3], coefficients_bar: &mut [f64]) {
        let (x2, square) = (self.share(radius_mm), radius_mm * radius_mm);
        let (t, q) = (2.0 * x2 - 1.0, self.below(square));
        let by_value = (slope * radius_mm + ratio + derivative * (1.0 + 2.0 * square * self.horizon / q)) / q;
        let by_series = derivative * 4.0 * x2 / q;
        let (mut a, mut b, mut da, mut db) = (1.0, t, 0.0, 1.0);
        for c in coefficients_bar {
            *c += by_value * a + by_series * da;
            (a, b, da, db) = (b, 2.0 * t * b - a, db, 2.0 * b + 2.0 * t * db - da);
        }
    }

    /// Sensor radius of an object slope (≥ 0), by safeguarded Newton from `near` to 1e-13 of the fit's radius.
    pub fn radius(&self, slope: f64, near: f64) -> f64 {
        if slope >= self.edge[0] {
            return self.radius_mm + (slope - self.edge[0]) / self.edge[1];
        }
        let (mut low, mut high) = (0.0, self.radius_mm);
        let mut r = near.clamp(low, high);
        for _ in 0..60 {
            // R P − slope · q has no pole.
            let (x2, (p, dp)) = (self.share(r), self.series(self.share(r)));
            let off = r * p - slope * self.below(r * r);
            if off > 0.0 {
                high = r;
            } else {
                low = r;
            }
            let next = r - off / (p + 4.0 * x2 * dp + 2.0 * slope * r * self.horizon);
            let next = if next >= low && next <= high { next } else { 0.5 * (low + high) };
            if (next - r).abs() <= 1e-13 * self.radius_mm {
                return next;
            }
            r = next;
        }
        r
    }

    /// The sensor point (mm) of the object slope `u`, and what `Self::point_vjp` needs.
    #[doc(hidden)]
    #[inline]
    pub fn point(&self, u: [f64; 2], near: f64) -> ([f64; 2], f64) {
        let radius = self.radius(u[0].hypot(u[1]), near);
        let scale = self.ratio(radius).recip();
        ([u[0] * scale, u[1] * scale], radius)
    }

    /// Pulls a cotangent on [`Self::point`] back to `u` (returned) and to the coefficients (added); `radius` is the point's.
    pub(crate) fn point_vjp(&self, u: [f64; 2], radius: f64, bar: [f64; 2], coefficients_bar: &mut [f64]) -> [f64; 2] {
        let size = u[0].hypot(u[1]);
        let scale = self.ratio(radius).recip();
        if size <= 1e-12 * self.edge[0] {
            // On the axis the point is u / ratio(0); its change with the coefficients vanishes with u.
            return [bar[0] * scale, bar[1] * scale];
        }
        let unit = [u[0] / size, u[1] / size];
        let along = bar[0] * unit[0] + bar[1] * unit[1];
        // Along u the radius follows 1/slope', across it the scale.
        let radial = along / self.derivative(radius);
        self.slope_vjp(radius, -radial, coefficients_bar);
        [0, 1].map(|k| scale * (bar[k] - along * unit[k]) + radial * unit[k])
    }
}

/// From slopes at the knots to coefficients, `[term, knot]`.
fn operator(radii: &[f64], horizon: f64) -> Array2<f64> {
    let last = radii[radii.len() - 1];
    let count = (radii.len() - TERMS.1).clamp(1, TERMS.0);
    // What is fitted is slope · q: its errors are those on the sensor, where slopes grow without end.
    let mut rows = fit_operator(&Array2::from_shape_fn((radii.len(), count), |(i, j)| {
        let x = radii[i] / last;
        radii[i] * chebyshev(2.0 * x * x - 1.0, count).0[j]
    }));
    for (mut column, r) in rows.columns_mut().into_iter().zip(radii) {
        column *= 1.0 - r * r * horizon;
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::psf::table::TableSpec;
    use isoplanat_base::testing::{assert_rel, central_difference};

    pub(super) fn map(name: &str, radius_mm: f64, vergence: f64) -> SensorMap {
        let lens = builtin::lens(name).expect("shipped");
        let radii_mm = (0..=12).map(|i| radius_mm * f64::from(i) / 12.0).collect();
        let spec = TableSpec { radii_mm, wavelength_nm: vec![550.0], degree: 7, lit: false };
        let table = Table::compute(&lens, &spec).expect("traces");
        SensorMap::fit(&lens, &table, vergence).expect("grows")
    }

    /// The inverse undoes the map, inside and beyond; chief rays lie on it.
    #[test]
    fn the_map_has_its_inverse() {
        for (name, radius, v) in [("two_element", 20.0, 1e-3), ("cooke_triplet", 18.0, 0.0), ("phone", 3.2, 0.0)] {
            let map = map(name, radius, v);
            assert!(map.residual_mm < 2e-4 * radius, "{name}: {}", map.residual_mm);
            for i in 0..150 {
                let r = radius * f64::from(i) / 100.0;
                let back = map.radius(map.slope(r), 0.7 * r);
                assert!((back - r).abs() < 1e-10 * radius, "{name} {r} {back}");
            }
        }
    }

    /// Slope, ratio and derivative at once, on the axis, inside and at the edge, with and without a pole.
    #[test]
    fn local_vjp_agrees_with_differences() {
        for (name, radius) in [("two_element", 20.0), ("wide_angle", 20.0)] {
            let map = map(name, radius, 1e-3);
            let bars = [0.4, -1.3, 0.7];
            for r in [0.0, 0.3 * radius, radius] {
                let mut found = vec![0.0; map.coefficients.len()];
                map.local_vjp(r, bars, &mut found);
                let value = |m: &SensorMap| bars[0] * m.slope(r) + bars[1] * m.ratio(r) + bars[2] * m.derivative(r);
                for (k, found) in found.into_iter().enumerate() {
                    let expected = central_difference(|h| value(&map.changed(k, h)), 1e-3);
                    assert_rel(found, expected, 1e-9, 1e-2, &format!("{name} {r} {k}"));
                }
            }
        }
    }

    #[test]
    fn pull_backs_agree_with_differences() {
        let map = map("two_element", 20.0, 1e-3);
        for (u, bar) in [([0.1, 0.2], [0.3, -0.8]), ([-0.02, 0.41], [1.0, 0.5]), ([0.3, 0.6], [-0.4, 0.9])] {
            let value = |map: &SensorMap, u: [f64; 2]| {
                let p = map.point(u, 3.0).0;
                p[0] * bar[0] + p[1] * bar[1]
            };
            let mut c_bar = vec![0.0; map.coefficients.len()];
            let u_bar = map.point_vjp(u, map.point(u, 3.0).1, bar, &mut c_bar);
            for (k, found) in u_bar.into_iter().enumerate() {
                let f = |h: f64| {
                    let mut u = u;
                    u[k] += h;
                    value(&map, u)
                };
                assert_rel(found, central_difference(f, 1e-5), 1e-8, 1e-2, "slope");
            }
            for (j, found) in c_bar.into_iter().enumerate() {
                let f = |h: f64| value(&map.changed(j, h), u);
                assert_rel(found, central_difference(f, 1e-7), 1e-6, 1e-2, "coefficients");
            }
        }
    }

    /// The fit's coefficients along a direction, by the lens moved: each of its curvatures and thicknesses.
    #[test]
    fn the_fit_pulls_back_to_the_lens() {
        let (lens, vergence) = (builtin::lens("cooke_triplet").expect("shipped"), 1e-3);
        let radii_mm: Vec<f64> = (0..=12).map(|i| 1.5 * f64::from(i)).collect();
        let fitted = |lens: &Lens| {
            let spec = TableSpec { radii_mm: radii_mm.clone(), wavelength_nm: vec![550.0], degree: 7, lit: false };
            let table = Table::compute(lens, &spec).expect("traces");
            (SensorMap::fit(lens, &table, vergence).expect("grows"), table)
        };
        let (map, table) = fitted(&lens);
        let rng = &mut fastrand::Rng::with_seed(3);
        let weights: Vec<f64> = map.coefficients.iter().map(|_| rng.f64() - 0.5).collect();
        let mut bar = TableBar::zeros(&table);
        map.fit_vjp(&table, &weights, &mut bar);
        let gradient = table.vjp(&lens, &bar);
        for k in 0..lens.surfaces.len() {
            let along = |change: &dyn Fn(&mut crate::lens::Surface, f64)| {
                let value = |h: f64| {
                    let moved = lens.changed(|l| change(&mut l.surfaces[k], h)).expect("a lens");
                    fitted(&moved).0.coefficients.iter().zip(&weights).map(|(c, w)| c * w).sum()
                };
                central_difference(value, 1e-4)
            };
            let found = &gradient.surfaces[k];
            let curvature = along(&|s, h| s.shape.curvature += 1e-2 * h) / 1e-2;
            assert_rel(found.shape.curvature, curvature, 1e-6, 1e-4, &format!("curvature {k}"));
            let thickness = along(&|s, h| s.thickness += h);
            assert_rel(found.thickness, thickness, 1e-6, 1e-6, &format!("thickness {k}"));
        }
    }
}
