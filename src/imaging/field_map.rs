//! What the frame sees of the field: fitted distortion, object slope and Jacobian at each sensor radius, and
//! relative illumination, each with its pull-back to the lens.
//!
//! Illumination at radius `R` and channel `c`: `a = T_c(R) J(R) / (T_c(0) J(0))`, with the étendue `T` per object slope
//! squared and `J = (r/R) · dr/dR` the object slope area per sensor area (design §4).

use ndarray::Array2;

use super::distortion::{Distortion, fit, fit_vjp};
use super::warp::slope_per_mm;
use crate::error::{Error, Result};
use crate::lens::{Lens, LensGradient};
use crate::psf::chief::{chief_heights, chief_heights_vjp};
use crate::trace::Failure;

/// Samples of the distortion fit (paper §3.1.3).
const SAMPLES: u32 = 16;

/// Object slopes the distortion is fitted at: centre to `max_slope`.
pub fn fit_slopes(max_slope: f64) -> Vec<f64> {
    (0..SAMPLES).map(|i| max_slope * f64::from(i) / f64::from(SAMPLES - 1)).collect()
}

/// A ray failure as the error a user sees.
pub fn failed(lens: &Lens, what: &str, f: Failure) -> Error {
    Error::bad(
        lens.name.clone(),
        what.to_owned(),
        format!("no ray reaches the sensor: {:?} at surface {}", f.cause, f.surface),
        "a lens whose chief and pupil rays pass over the whole frame; narrow the frame or change the lens",
    )
}

/// Fits the distortion of `lens` for objects at `vergence` over `0..max_slope`, chief rays of the primary wavelength.
pub fn fit_distortion(lens: &Lens, vergence: f64, max_slope: f64) -> Result<Distortion> {
    lens.require_symmetry("radial distortion")?;
    let slopes = fit_slopes(max_slope);
    let heights = chief_heights(lens, vergence, &slopes).map_err(|f| failed(lens, "distortion fit", f))?;
    fit(&slopes, &heights).map_err(|e| e.in_file(std::path::Path::new(&lens.name)))
}

/// Pulls a cotangent on the fitted coefficients back to the lens.
pub fn fit_distortion_vjp(
    lens: &Lens,
    vergence: f64,
    max_slope: f64,
    coefficients_bar: [f64; 4],
    gradient: &mut LensGradient,
) -> Result<()> {
    let slopes = fit_slopes(max_slope);
    let heights_bar = fit_vjp(&slopes, max_slope, coefficients_bar);
    chief_heights_vjp(lens, vergence, &slopes, &heights_bar, gradient).map_err(|f| failed(lens, "distortion fit", f))
}

/// The object slope whose chief ray lands at `radius_mm`, by bisection and secant to 1e-6 mm.
///
/// The field of a fit: called once a lens (or once a run), then held.
pub fn slope_at_height(lens: &Lens, vergence: f64, radius_mm: f64) -> Result<f64> {
    lens.require_symmetry("radial distortion")?;
    let height = |s: f64| chief_heights(lens, vergence, &[s]).ok().map(|h| h[0].abs());
    let (mut lo, mut hi) = (0.0, 0.02);
    // Double until the height is reached; a ray that fails ends the search.
    loop {
        match height(hi) {
            Some(h) if h >= radius_mm => break,
            Some(_) if hi < 50.0 => (lo, hi) = (hi, 1.3 * hi),
            _ => {
                let reached = height(lo).unwrap_or(0.0);
                return Err(Error::bad(
                    lens.name.clone(),
                    "sensor",
                    format!("its corner at {radius_mm:.3} mm lies beyond the image (reaches {reached:.3} mm)"),
                    "a sensor inside the image circle",
                ));
            }
        }
    }
    for _ in 0..60 {
        let mid = 0.5 * (lo + hi);
        if height(mid).is_some_and(|h| h < radius_mm) {
            lo = mid;
        } else {
            hi = mid;
        }
    }
    Ok(0.5 * (lo + hi))
}

/// Object slope and area Jacobian at one sensor radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldAt {
    /// Object slope `r = D⁻¹(R)`.
    pub slope: f64,
    /// `J = (r/R) dr/dR`, 1/mm².
    pub jacobian: f64,
}

/// Slope and Jacobian at `radius_mm`.
pub fn field_at(distortion: &Distortion, radius_mm: f64) -> FieldAt {
    let slope = distortion.slope_from_sensor(radius_mm);
    let derivative = distortion.sensor_from_slope_derivative(slope.min(distortion.max_slope));
    FieldAt { slope, jacobian: slope_per_mm(distortion, radius_mm) / derivative }
}

/// Pulls cotangents on [`field_at`] back to the coefficients.
pub fn field_at_vjp(distortion: &Distortion, radius_mm: f64, slope_bar: f64, jacobian_bar: f64) -> [f64; 4] {
    let at = field_at(distortion, radius_mm);
    let inside = at.slope < distortion.max_slope;
    let r = at.slope.min(distortion.max_slope);
    let derivative = distortion.sensor_from_slope_derivative(r);
    // J = q/D′ with q = r/R (1/D′ on the axis).
    let derivative_bar = -jacobian_bar * at.jacobian / derivative;
    let mut total_slope_bar = slope_bar;
    let mut explicit = derivative_bar;
    if radius_mm < 1e-9 {
        explicit *= 2.0;
    } else {
        total_slope_bar += jacobian_bar / (radius_mm * derivative);
        if inside {
            total_slope_bar += derivative_bar * distortion.sensor_from_slope_second_derivative(r);
        }
    }
    let implicit = distortion.slope_from_sensor_vjp(radius_mm, total_slope_bar);
    let change = distortion.derivative_basis(r);
    std::array::from_fn(|j| implicit[j] + explicit * change[j])
}

/// Relative illumination `[radius, channel]`; entry 0 of both lists is the axis.
pub fn illumination(throughput: &Array2<f64>, fields: &[FieldAt]) -> Array2<f64> {
    Array2::from_shape_fn(throughput.dim(), |(i, c)| {
        throughput[[i, c]] * fields[i].jacobian / (throughput[[0, c]] * fields[0].jacobian)
    })
}

/// Pulls a cotangent on [`illumination`] back to throughputs and Jacobians.
pub fn illumination_vjp(throughput: &Array2<f64>, fields: &[FieldAt], bar: &Array2<f64>) -> (Array2<f64>, Vec<f64>) {
    let a = illumination(throughput, fields);
    let mut t_bar = Array2::zeros(throughput.dim());
    let mut j_bar = vec![0.0; fields.len()];
    for ((i, c), b) in bar.indexed_iter() {
        // d ln a = d ln T − d ln T₀ + d ln J − d ln J₀.
        let v = b * a[[i, c]];
        t_bar[[i, c]] += v / throughput[[i, c]];
        t_bar[[0, c]] -= v / throughput[[0, c]];
        j_bar[i] += v / fields[i].jacobian;
        j_bar[0] -= v / fields[0].jacobian;
    }
    (t_bar, j_bar)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_rel, central_difference};

    #[test]
    fn field_at_vjp_agrees_with_differences() {
        let model = Distortion { max_slope: 0.4, coefficients_mm: [18.0, -1.5, 0.2, -0.1], residual_mm: 0.0 };
        for radius in [0.0, 3.0, 12.0, 18.5] {
            let pulled = field_at_vjp(&model, radius, 0.7, 30.0);
            for (k, pulled) in pulled.into_iter().enumerate() {
                let f = |h: f64| {
                    let mut m = model.clone();
                    m.coefficients_mm[k] += h;
                    let at = field_at(&m, radius);
                    0.7 * at.slope + 30.0 * at.jacobian
                };
                assert_rel(pulled, central_difference(f, 1e-4), 1e-8, 1e-3, &format!("radius {radius}, b{k}"));
            }
        }
    }

    /// Coefficients of the fit against differences of the whole lens.
    #[test]
    fn fit_distortion_vjp_agrees_with_differences() {
        let lens = crate::lens::builtin::lens("two_element").expect("shipped");
        let (v, bar) = (lens.object_vergence, [0.3, -1.0, 0.5, 2.0]);
        let mut g = LensGradient::zeros(&lens);
        fit_distortion_vjp(&lens, v, 0.4, bar, &mut g).expect("fits");
        let vars = crate::lens::variables::Variables::all(&lens);
        let x = vars.values(&lens);
        for seed in 0..3 {
            let rng = &mut fastrand::Rng::with_seed(seed);
            let dx: Vec<f64> = x.iter().map(|_| rng.f64() - 0.5).collect();
            let pulled: f64 = vars.gradient(&g).iter().zip(&dx).map(|(a, b)| a * b).sum();
            let f = |h: f64| {
                let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                let d = fit_distortion(&vars.lens(&lens, &moved), v, 0.4).expect("fits");
                d.coefficients_mm.iter().zip(&bar).map(|(a, b)| a * b).sum::<f64>()
            };
            assert_rel(pulled, central_difference(f, 1e-5), 1e-7, 1e-3, &format!("seed {seed}"));
        }
    }

    #[test]
    fn illumination_vjp_agrees_with_differences() {
        let rng = &mut fastrand::Rng::with_seed(1);
        let t = Array2::from_shape_fn((3, 2), |_| 1.0 + rng.f64());
        let fields: Vec<FieldAt> = (0..3).map(|_| FieldAt { slope: 0.0, jacobian: 1.0 + rng.f64() }).collect();
        let bar = Array2::from_shape_fn((3, 2), |_| rng.f64() - 0.5);
        let dt = Array2::from_shape_fn((3, 2), |_| rng.f64() - 0.5);
        let dj: Vec<f64> = (0..3).map(|_| rng.f64() - 0.5).collect();
        let (t_bar, j_bar) = illumination_vjp(&t, &fields, &bar);
        let pulled = (&t_bar * &dt).sum() + j_bar.iter().zip(&dj).map(|(a, b)| a * b).sum::<f64>();
        let f = |h: f64| {
            let moved: Vec<FieldAt> =
                fields.iter().zip(&dj).map(|(f, d)| FieldAt { slope: 0.0, jacobian: f.jacobian + h * d }).collect();
            (&illumination(&(&t + &(&dt * h)), &moved) * &bar).sum()
        };
        assert_rel(pulled, central_difference(f, 1e-4), 1e-9, 1e-3, "illumination");
    }
}
