//! From irradiance to the network's input, differentiably: mosaic, sensor response, noise, white balance, flat field,
//! demosaic (the camera's own order, [`crate::develop`]), for training and design.
//!
//! Saturation and quantisation are left out here (scenes stay below white; 12-bit steps are far below the noise); the
//! virtual camera has both. The noise draw is held, so its scale is differentiated with the signal.

use ndarray::{Array2, Array3, ArrayView3, Zip};

use crate::develop::demosaic::{demosaic, demosaic_vjp};
use crate::develop::shading::DARKEST;
use crate::plane::Region;
use crate::sensor::Sensor;
use crate::sensor::cfa::{Cfa, mosaic, mosaic_vjp};
use crate::sensor::noise::Noise;
use isoplanat_base::math::real::Real;

/// What of the sensor the simulation needs.
#[derive(Clone, Debug)]
pub struct Electronics {
    /// Mosaic layout, as seen by the region's first pixel.
    pub cfa: Cfa,
    /// Noise of the normalised raw signal.
    pub noise: Noise,
    /// Raw response to a neutral white.
    pub neutral: [f64; 3],
}

impl Electronics {
    /// Of `sensor`.
    pub fn from_sensor(sensor: &Sensor) -> Self {
        Self { cfa: sensor.cfa, noise: Noise::from_sensor(sensor), neutral: sensor.neutral_response }
    }

    /// As the first pixel of `region` sees them.
    #[must_use]
    pub fn at(&self, region: Region) -> Self {
        let parity = |v: isize| usize::from(v.rem_euclid(2) == 1);
        Self { cfa: self.cfa.shifted(parity(region.row), parity(region.col)), ..self.clone() }
    }
}

/// What the forward call leaves for its adjoint.
pub struct SimulateRecord<T> {
    raw: Array2<T>,
    gain: Array2<T>,
    eps: Array2<T>,
    balanced: Array2<T>,
}

/// Irradiance `[channel, row, col]` and relative illumination of the same shape → developed picture.
///
/// `eps`: one standard normal draw a pixel.
pub fn simulate<T: Real>(
    electronics: &Electronics,
    image: ArrayView3<'_, T>,
    illumination: ArrayView3<'_, T>,
    eps: Array2<T>,
) -> (Array3<T>, SimulateRecord<T>) {
    let cfa = electronics.cfa;
    let neutral = |i: usize, j: usize| T::real(electronics.neutral[cfa.channel(i, j)]);
    let mut raw = mosaic(image, cfa);
    raw.indexed_iter_mut().for_each(|((i, j), v)| *v *= neutral(i, j));
    let mut gain = mosaic(illumination, cfa);
    // Where no light comes, none is made up, and where little comes, not more than by the camera's flat field.
    let darkest = T::real(DARKEST);
    let gained = |v: T, n: T| if v > T::zero() { T::one() / (v.max(darkest) * n) } else { T::zero() };
    gain.indexed_iter_mut().for_each(|((i, j), v)| *v = gained(*v, neutral(i, j)));
    let balanced = &electronics.noise.apply(raw.view(), eps.view()) * &gain;
    let developed = demosaic(balanced.view(), cfa);
    (developed, SimulateRecord { raw, gain, eps, balanced })
}

/// Pulls a cotangent on the developed picture back to `(image, illumination)`.
pub fn simulate_vjp<T: Real>(
    electronics: &Electronics,
    record: &SimulateRecord<T>,
    bar: ArrayView3<'_, T>,
) -> (Array3<T>, Array3<T>) {
    let cfa = electronics.cfa;
    let neutral = |i: usize, j: usize| T::real(electronics.neutral[cfa.channel(i, j)]);
    let balanced_bar = demosaic_vjp(bar, cfa);
    // gain = 1/(a n): ∂(x·gain)/∂a = −balanced · gain · n.
    let mut a_bar =
        Zip::from(&balanced_bar).and(&record.balanced).and(&record.gain).map_collect(|b, v, g| -*b * *v * *g);
    let most = T::real((1.0 - 1e-6) / DARKEST);
    Zip::indexed(&mut a_bar).and(&record.gain).for_each(|(i, j), v, g| {
        let n = neutral(i, j);
        // The largest gain is one number.
        *v = if *g * n < most { *v * n } else { T::zero() };
    });
    let noisy_bar = &balanced_bar * &record.gain;
    let mut raw_bar = electronics.noise.apply_vjp(record.raw.view(), record.eps.view(), noisy_bar.view());
    raw_bar.indexed_iter_mut().for_each(|((i, j), v)| *v *= neutral(i, j));
    (mosaic_vjp(raw_bar.view(), cfa), mosaic_vjp(a_bar.view(), cfa))
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_rel, central_difference};

    #[test]
    fn simulate_vjp_agrees_with_differences() {
        let rng = &mut fastrand::Rng::with_seed(6);
        let electronics =
            Electronics { cfa: Cfa::GRBG, noise: Noise { shot: 1e-2, read: 1e-2 }, neutral: [0.5, 1.0, 0.7] };
        let shape = (3, 14, 11);
        let mut draw = |a: f64, b: f64| Array3::from_shape_fn(shape, |_| a + (b - a) * rng.f64());
        let (image, mut shade, bar) = (draw(0.1, 1.0), draw(0.4, 1.0), draw(-1.0, 1.0));
        // Too dark for the flat field.
        shade[[0, 4, 4]] = 3e-3;
        shade.slice_mut(ndarray::s![.., 9, 7]).fill(1e-3);
        let (di, da) = (draw(-1.0, 1.0), draw(-1.0, 1.0));
        let eps = crate::sensor::noise::standard_normal::<f64>(3, (14, 11));
        let (_, record) = simulate(&electronics, image.view(), shade.view(), eps.clone());
        let (i_bar, a_bar) = simulate_vjp(&electronics, &record, bar.view());
        let f = |h: f64| {
            let (x, a) = (&image + &(&di * h), &shade + &(&da * h));
            (&simulate(&electronics, x.view(), a.view(), eps.clone()).0 * &bar).sum()
        };
        let pulled = (&i_bar * &di).sum() + (&a_bar * &da).sum();
        assert_rel(pulled, central_difference(f, 1e-4), 1e-9, 1e-3, "simulate");
    }
}
