//! Radial distortion (paper §3.1.3, eqs. 10–11): `r_d = ξ r (1 + k₁ r² + k₂ r⁴ + k₃ r⁶)`.
//!
//! `r` is the object's radius as a slope (object height over object distance; the tangent of the field angle for an
//! object at infinity), `r_d` the radius on the sensor in mm. The fit works in normalised radius `r / r_max`,
//! where the system is well conditioned; it is linear least squares, so its derivative is one constant matrix.
//! Not covered: decentring and tilt (tangential terms).

use ndarray::Array2;
use serde::{Deserialize, Serialize};

use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::least_squares::fit_operator;
use isoplanat_optics::psf::SensorMap;

/// A fitted radial model: `r_d = x·(b₀ + b₁ x² + b₂ x⁴ + b₃ x⁶)` with `x = r / r_max`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Distortion {
    /// Object slope at the border of the fit; beyond it the polynomial is not trusted.
    pub max_slope: f64,
    /// `b` in mm: `b₀ = ξ r_max`, `b_j = ξ k_j r_max^{2j+1}`.
    pub coefficients_mm: [f64; 4],
    /// Largest residual of the fit, mm.
    pub residual_mm: f64,
}

impl Distortion {
    /// Sensor radius in mm of the object slope `r` (odd in `r`).
    pub fn sensor_from_slope(&self, r: f64) -> f64 {
        let x = r / self.max_slope;
        let [b0, b1, b2, b3] = self.coefficients_mm;
        let x2 = x * x;
        x * (b0 + x2 * (b1 + x2 * (b2 + x2 * b3)))
    }

    /// `∂r_d/∂r`, mm.
    pub fn sensor_from_slope_derivative(&self, r: f64) -> f64 {
        let x2 = (r / self.max_slope).powi(2);
        let [b0, b1, b2, b3] = self.coefficients_mm;
        (b0 + x2 * (3.0 * b1 + x2 * (5.0 * b2 + x2 * 7.0 * b3))) / self.max_slope
    }

    /// Object slope whose image lies at sensor radius `r_d` mm (≥ 0), by safeguarded Newton to 1e-14 relative.
    ///
    /// Beyond the fitted range the model is continued linearly, so that margins around the frame stay defined.
    pub fn slope_from_sensor(&self, r_d: f64) -> f64 {
        let edge = self.sensor_from_slope(self.max_slope);
        if r_d >= edge {
            return self.max_slope + (r_d - edge) / self.sensor_from_slope_derivative(self.max_slope);
        }
        let (mut lo, mut hi) = (0.0, self.max_slope);
        let mut r = self.max_slope * r_d / edge;
        for _ in 0..60 {
            let f = self.sensor_from_slope(r) - r_d;
            if f > 0.0 {
                hi = r;
            } else {
                lo = r;
            }
            let step = f / self.sensor_from_slope_derivative(r);
            let next = r - step;
            let next = if next > lo && next < hi { next } else { 0.5 * (lo + hi) };
            if (next - r).abs() <= 1e-15 * self.max_slope {
                return next;
            }
            r = next;
        }
        r
    }
}

/// Slopes at which a model of a file may end: from far below a pixel's to far beyond any lens's.
const SLOPES: std::ops::Range<f64> = 1e-12..1e9;
/// Coefficients of a model of a file, mm or pixels, are smaller than this.
const LARGEST: f64 = 1e12;
/// Largest residual of a model of a file, mm or pixels.
const FARTHEST: f64 = 1e9;

impl Distortion {
    /// Refuses a model that no lens has; `keys` are those of the end, the coefficients and the residual in its file.
    ///
    /// # Errors
    /// As said, without the file.
    #[doc(hidden)]
    pub fn check(&self, keys: [&str; 3]) -> Result<()> {
        let bad = |key: usize, found: String, allowed: String| Err(Error::bad("", keys[key], found, allowed));
        if !SLOPES.contains(&self.max_slope) {
            let allowed = format!("at least {:e} and below {:e}", SLOPES.start, SLOPES.end);
            return bad(0, format!("{:?}", self.max_slope), allowed);
        }
        if !self.coefficients_mm.iter().all(|b| b.abs() < LARGEST) {
            let listed = self.coefficients_mm.map(|b| format!("{b:?}")).join(", ");
            return bad(1, listed, format!("finite numbers below {LARGEST:e}"));
        }
        if !(0.0..FARTHEST).contains(&self.residual_mm) {
            return bad(2, format!("{:?}", self.residual_mm), format!("0 or more and below {FARTHEST:e}"));
        }
        let grows = |i: i32| self.sensor_from_slope_derivative(self.max_slope * f64::from(i) / 256.0) > 0.0;
        if !(0..=256).all(grows) {
            return bad(1, "image height stops growing".into(), "a model that grows up to max_slope".into());
        }
        Ok(())
    }
}

/// Samples of the fit (paper §3.1.3).
const SAMPLES: u32 = 16;
/// What the radius of a fit that folds is multiplied by.
const SHRINK: f64 = 0.97;

impl Distortion {
    /// The paper's polynomial for a kit: fitted to 16 points of `map` from the axis to `radius_mm` on the sensor, or to the end of
    /// its light. A polynomial in the slope has no form for fields near 90°: where it is not monotonic, the radius is made smaller
    /// until it is. [`Self::max_slope`] and [`Self::residual_mm`] say how far out it holds, and how well.
    ///
    /// # Errors
    /// A polynomial that is not monotonic next to the axis.
    pub fn of_map(map: &SensorMap, radius_mm: f64) -> Result<Self> {
        let mut radius_mm = radius_mm.min(map.radius_mm);
        let least = 0.1 * radius_mm;
        loop {
            let radii: Vec<f64> = (0..SAMPLES).map(|i| radius_mm * f64::from(i) / f64::from(SAMPLES - 1)).collect();
            let slopes: Vec<f64> = radii.iter().map(|r| map.slope(*r)).collect();
            match fit(&slopes, &radii) {
                Err(_) if radius_mm > least => radius_mm *= SHRINK,
                done => return done,
            }
        }
    }

    /// The same for the chief rays of `lens` over `radius_mm`, object at `vergence`.
    ///
    /// # Errors
    /// As [`Self::of_map`]; a lens whose sensor sees no light there.
    pub fn of_lens(lens: &isoplanat_optics::lens::Lens, vergence: f64, radius_mm: f64) -> Result<Self> {
        let radii: Vec<f64> = (0..SAMPLES).map(|i| radius_mm * f64::from(i) / f64::from(SAMPLES - 1)).collect();
        let slopes = isoplanat_optics::psf::table::chief_slopes(lens, vergence, &radii)?;
        fit(&slopes, &radii[..slopes.len()]).map_err(|e| e.in_file(lens.file()))
    }
}

/// Least-squares fit of [`Distortion`] to samples `(slope, sensor radius)`; `slopes` must reach `max_slope > 0`.
///
/// Refuses a fit that is not monotonic over the field.
pub(crate) fn fit(slopes: &[f64], sensor_mm: &[f64]) -> Result<Distortion> {
    assert_eq!(slopes.len(), sensor_mm.len());
    let max_slope = slopes.iter().copied().fold(0.0, f64::max);
    let rows = operator(slopes, max_slope);
    let coefficients: [f64; 4] = std::array::from_fn(|j| rows.row(j).iter().zip(sensor_mm).map(|(a, s)| a * s).sum());
    let mut model = Distortion { max_slope, coefficients_mm: coefficients, residual_mm: 0.0 };
    model.residual_mm =
        slopes.iter().zip(sensor_mm).map(|(&r, &s)| (model.sensor_from_slope(r) - s).abs()).fold(0.0, f64::max);
    for i in 0..=256 {
        let r = max_slope * f64::from(i) / 256.0;
        let slope = model.sensor_from_slope_derivative(r);
        if slope.is_nan() || slope <= 0.0 {
            return Err(Error::bad(
                "",
                "distortion fit",
                format!("image height stops growing at object slope {r:.4}"),
                "the image height must grow over the whole field; narrow the field or change the lens",
            ));
        }
    }
    Ok(model)
}

/// From sampled sensor radii to the four coefficients, `[4, n]`.
fn operator(slopes: &[f64], max_slope: f64) -> Array2<f64> {
    fit_operator(&Array2::from_shape_fn((slopes.len(), 4), |(i, j)| {
        (slopes[i] / max_slope).powi(2 * i32::try_from(j).expect("small") + 1)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(b: [f64; 4]) -> (Vec<f64>, Vec<f64>) {
        let model = Distortion { max_slope: 0.5, coefficients_mm: b, residual_mm: 0.0 };
        let r: Vec<f64> = (0..16).map(|i| 0.5 * f64::from(i) / 15.0).collect();
        let s = r.iter().map(|&r| model.sensor_from_slope(r)).collect();
        (r, s)
    }

    #[test]
    fn the_fit_recovers_a_known_model_and_its_inverse() {
        let b = [25.0, -2.5, 0.3, -0.1];
        let (r, s) = samples(b);
        let model = fit(&r, &s).expect("monotonic");
        for (found, planted) in model.coefficients_mm.iter().zip(b) {
            assert!((found - planted).abs() < 1e-11, "{:?}", model.coefficients_mm);
        }
        for i in 0..100 {
            let r = 0.5 * f64::from(i) / 100.0;
            assert!((model.slope_from_sensor(model.sensor_from_slope(r)) - r).abs() < 1e-14);
        }
    }

    #[test]
    fn a_folding_distortion_is_refused() {
        let (r, s) = samples([25.0, -15.0, 0.0, 0.0]);
        assert!(fit(&r, &s).is_err());
    }
}
