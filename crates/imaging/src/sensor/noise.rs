//! Sensor noise and quantisation on the normalised signal (black 0, white 1).
//!
//! A pixel that collects `y` of its full well `N` has the variance `y / N + (σ / N)²`: photon shot noise, Gaussian in
//! the limit, and read noise of `σ` electrons (A. Foi et al., "Practical Poissonian-Gaussian noise modeling and fitting
//! for single-image raw-data", IEEE Trans. Image Process. 17(10), 2008). The draw `ε` is an input, so that the noisy
//! signal has a gradient and a seed repeats it: `noisy = y + √(shot·max(y, 0) + read²)·ε`.
//! Not covered: dark current, fixed pattern, the skew of the Poisson law below some ten electrons.

use ndarray::{Array2, ArrayView2, Axis, Zip};
use rayon::prelude::*;

use crate::sensor::Sensor;
pub use isoplanat_base::math::mixed;
use isoplanat_base::math::real::Real;

/// Independent draws of the standard normal law.
///
/// Row `r` has a stream of its own, seeded with `seed` and `r`: the result does not depend on the number of threads, and
/// a row does not depend on the number of rows. Box–Muller from 53-bit uniforms; magnitudes end at 8.6.
pub fn standard_normal<T: Real>(seed: u64, shape: (usize, usize)) -> Array2<T> {
    let mut eps = Array2::zeros(shape);
    if eps.is_empty() {
        return eps;
    }
    eps.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(r, mut row)| {
        let mut rng = fastrand::Rng::with_seed(mixed(seed, r as u64));
        for pair in row.as_slice_mut().expect("just allocated").chunks_mut(2) {
            // 1 − u lies in (0, 1], so the logarithm is finite.
            let radius = (-2.0 * (1.0 - rng.f64()).ln()).sqrt();
            let (sin, cos) = (std::f64::consts::TAU * rng.f64()).sin_cos();
            pair.iter_mut().zip([radius * cos, radius * sin]).for_each(|(v, draw)| *v = T::real(draw));
        }
    });
    eps
}

/// The noise of a sensor, on the normalised signal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Variance per unit of signal: 1 / full well in electrons.
    pub shot: f64,
    /// Standard deviation without light: read noise / full well.
    pub read: f64,
}

impl Noise {
    /// The noise of a sensor.
    pub fn from_sensor(sensor: &Sensor) -> Self {
        Self { shot: 1.0 / sensor.full_well_electrons, read: sensor.read_noise_electrons / sensor.full_well_electrons }
    }

    /// No noise.
    pub const NONE: Self = Self { shot: 0.0, read: 0.0 };

    /// Standard deviation of the signal `y`.
    pub(crate) fn sigma<T: Real>(&self, y: T) -> T {
        (T::real(self.shot) * y.max(T::zero()) + T::real(self.read * self.read)).sqrt()
    }

    /// The signal with noise: `y + σ(y)·ε`, `ε` from [`standard_normal`]. Not clipped.
    ///
    /// # Panics
    /// If `y` and `eps` differ in shape.
    pub fn apply<T: Real>(&self, y: ArrayView2<'_, T>, eps: ArrayView2<'_, T>) -> Array2<T> {
        assert_eq!(y.dim(), eps.dim(), "one draw a pixel");
        Zip::from(y).and(eps).par_map_collect(|&y, &e| y + self.sigma(y) * e)
    }

    /// Pulls a cotangent of [`Self::apply`] back to the signal.
    ///
    /// At and below black the slope of `σ` is taken as 0, so the result is finite even without read noise.
    ///
    /// # Panics
    /// If the shapes differ.
    pub(crate) fn apply_vjp<T: Real>(
        &self,
        y: ArrayView2<'_, T>,
        eps: ArrayView2<'_, T>,
        noisy_bar: ArrayView2<'_, T>,
    ) -> Array2<T> {
        assert_eq!((y.dim(), y.dim()), (eps.dim(), noisy_bar.dim()), "one draw and one cotangent a pixel");
        let half = T::real(0.5 * self.shot);
        Zip::from(y).and(eps).and(noisy_bar).par_map_collect(|&y, &e, &bar| {
            let slope = if y > T::zero() && self.shot > 0.0 { half / self.sigma(y) } else { T::zero() };
            bar * (T::one() + e * slope)
        })
    }
}

/// Raw values of a normalised signal: black level added, saturated at the white level, rounded to whole DN.
///
/// A signal that is not a number gives 0.
pub(crate) fn quantise<T: Real>(y: ArrayView2<'_, T>, sensor: &Sensor) -> Array2<u16> {
    let (black, white) = (sensor.black_level, sensor.white_level);
    y.mapv(|v| (black + v.to_double() * (white - black)).round().clamp(0.0, white.floor()) as u16)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_rel, central_difference};

    #[test]
    fn draws_are_normal_seeded_and_independent_of_threads() {
        let eps: Array2<f64> = standard_normal(7, (500, 401));
        let n = eps.len() as f64;
        let moment = |k: i32| eps.iter().map(|v| v.powi(k)).sum::<f64>() / n;
        // Five standard errors of each moment of 2e5 draws.
        assert!(moment(1).abs() < 0.012 && (moment(2) - 1.0).abs() < 0.016, "{} {}", moment(1), moment(2));
        assert!(moment(3).abs() < 0.05 && (moment(4) - 3.0).abs() < 0.12, "{} {}", moment(3), moment(4));
        let neighbours: f64 = eps.iter().zip(eps.iter().skip(1)).map(|(a, b)| a * b).sum::<f64>() / n;
        let below: f64 = eps.iter().zip(eps.iter().skip(401)).map(|(a, b)| a * b).sum::<f64>() / n;
        assert!(neighbours.abs() < 0.012 && below.abs() < 0.012, "{neighbours} {below}");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
        assert_eq!(pool.install(|| standard_normal::<f64>(7, (500, 401))), eps);
        assert_eq!(standard_normal::<f64>(7, (3, 401)), eps.slice(ndarray::s![..3, ..]));
        assert_ne!(standard_normal::<f64>(8, (500, 401)), eps);
        assert!(standard_normal::<f32>(0, (0, 3)).is_empty());
    }

    #[test]
    fn variance_follows_the_model() {
        let noise = Noise::from_sensor(&Sensor::generic());
        let eps: Array2<f64> = standard_normal(1, (400, 400));
        for level in [0.0, 0.1, 0.9] {
            let noisy = noise.apply(Array2::from_elem((400, 400), level).view(), eps.view());
            let variance = noisy.iter().map(|v| (v - level).powi(2)).sum::<f64>() / 160_000.0;
            assert_rel(variance, level / 6000.0 + (4.0f64 / 6000.0).powi(2), 0.02, 0.0, "variance");
        }
    }

    #[test]
    fn apply_vjp_matches_differences_and_is_finite_at_zero() {
        let noise = Noise::from_sensor(&Sensor::generic());
        for (y, e) in [(0.3, 1.2), (1e-4, -2.0), (0.9, 0.1), (-0.01, 1.5)] {
            let one = |v: f64| Array2::from_elem((1, 1), v);
            let pushed = central_difference(|h| noise.apply(one(y + h).view(), one(e).view())[[0, 0]], 1e-6);
            let pulled = noise.apply_vjp(one(y).view(), one(e).view(), one(1.0).view())[[0, 0]];
            assert_rel(pulled, pushed, 1e-8, 1.0, &format!("y = {y}"));
        }
        let zero = Array2::<f32>::zeros((1, 1));
        let ones = Array2::<f32>::ones((1, 1));
        for noise in [noise, Noise { shot: 1e-3, read: 0.0 }, Noise::NONE] {
            assert_eq!(noise.apply_vjp(zero.view(), ones.view(), ones.view())[[0, 0]], 1.0);
        }
    }

    #[test]
    fn quantising_rounds_and_saturates() {
        let sensor = Sensor::generic();
        let y = ndarray::arr2(&[[0.0, 1.0, 2.0, -1.0, 0.5, f64::NAN]]);
        let raw = quantise(y.view(), &sensor);
        assert_eq!(raw, ndarray::arr2(&[[256, 4095, 4095, 0, 2176, 0]]));
    }
}
