//! The virtual camera: the reference renderer's mosaic, exposed, with noise, as raw values.
//!
//! `signal = exposure · neutral_response · E`, with `E` the irradiance relative to white on the axis: at exposure 1 a
//! white object on the axis brings green to saturation. Then noise ([`crate::sensor::noise`]), saturation and quantisation in
//! the sensor's levels. The raw values are what [`crate::dng`] writes.

use ndarray::{Array2, ArrayView2};

use crate::develop::glare::check;
use crate::frame::Frame;
use crate::plane::{Plane, Region};
use crate::reference::{self, Channels, Sampling};
use crate::sensor::Sensor;
use crate::sensor::haze::add_haze_mosaic;
use crate::sensor::illuminant::Illuminant;
use crate::sensor::noise::{Noise, mixed, quantise, standard_normal};
use crate::sensor::spectrum::SpectralDensity;
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::lens::Lens;

/// How to capture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CaptureSettings {
    /// Rays a pixel.
    pub samples: usize,
    /// Seed of rays and noise.
    pub seed: u64,
    /// Signal of a white object on the axis in the green channel, relative to saturation.
    pub exposure: f64,
    /// Whether the sensor's noise is added.
    pub noise: bool,
    /// Share of the light that is spread over the frame as veiling glare.
    pub glare: f64,
    /// Light on the scene.
    pub light: Illuminant,
}

impl Default for CaptureSettings {
    /// As `isoplanat capture` without options.
    fn default() -> Self {
        Self { samples: 128, seed: 1, exposure: 1.0, noise: true, glare: 0.0, light: Illuminant::default() }
    }
}

/// A raw capture.
#[derive(Clone, Debug)]
pub struct Capture {
    /// Raw values, DN.
    pub dn: Array2<u16>,
    /// The signal before noise, saturation and quantisation (black 0, saturation 1).
    pub clean: Array2<f32>,
    /// RMS of the rendering's own noise left in `clean`, in the same units.
    pub render_noise: f64,
    /// RMS of the sensor's noise on `clean`, in the same units.
    pub sensor_noise: f64,
    /// Rays traced.
    pub rays: u64,
    /// Wall time.
    pub seconds: f64,
}

/// The signal of a mosaic of relative irradiance, before noise: `exposure · neutral_response · E`.
///
/// # Shapes
/// `irradiance`: `[row, col]`, its first pixel the sensor's; result alike.
pub fn signal(irradiance: ArrayView2<'_, f32>, sensor: &Sensor, exposure: f64) -> Array2<f32> {
    let gain = sensor.neutral_response.map(|r| (r * exposure) as f32);
    Array2::from_shape_fn(irradiance.dim(), |(r, c)| irradiance[[r, c]] * gain[sensor.cfa.channel(r, c)])
}

/// Raw values of a signal: noise drawn from `seed` (none for `None`), saturation, quantisation.
pub fn expose(signal: ArrayView2<'_, f32>, sensor: &Sensor, seed: Option<u64>) -> Array2<u16> {
    match seed {
        Some(seed) => {
            let noisy = Noise::from_sensor(sensor).apply(signal, standard_normal::<f32>(seed, signal.dim()).view());
            quantise(noisy.view(), sensor)
        }
        None => quantise(signal, sensor),
    }
}

/// Photographs `scene` through `lens` with `sensor`, the whole `frame`.
///
/// ```
/// use isoplanat_imaging::capture::{CaptureSettings, capture};
/// use isoplanat_imaging::{frame::Frame, scene::fill_frame, sensor::Sensor};
/// use isoplanat_optics::lens::builtin;
/// use ndarray::Array3;
///
/// let (lens, sensor, frame) = (builtin::lens("cooke_triplet")?, Sensor::generic(), Frame::centred(8, 6, 0.05)?);
/// let grey = fill_frame(&lens, &frame, Array3::from_elem((3, 2, 2), 0.5))?;
/// let settings = CaptureSettings { samples: 16, noise: false, ..CaptureSettings::default() };
/// let taken = capture(&lens, &grey, &sensor, &frame, settings, None)?;
/// // Half of white is half way from black to saturation in green.
/// let green = f64::from(taken.dn[[2, 3]]);
/// assert!(((green - sensor.black_level) / (sensor.white_level - sensor.black_level) - 0.5).abs() < 0.02);
/// # Ok::<(), isoplanat_base::error::Error>(())
/// ```
///
/// # Errors
/// An exposure that is not a positive number, a share of glare that is none, a light that the sensor does not see; as [`reference::render`].
pub fn capture(
    lens: &Lens,
    scene: &Plane,
    sensor: &Sensor,
    frame: &Frame,
    settings: CaptureSettings,
    progress: Option<&(dyn Fn(f64) + Sync)>,
) -> Result<Capture> {
    let CaptureSettings { samples, seed, exposure, noise, glare, light } = settings;
    if !(exposure > 0.0 && exposure.is_finite()) {
        return Err(Error::bad("", "exposure", exposure.to_string(), "a positive number"));
    }
    let how = reference::Settings {
        samples,
        seed: mixed(seed, 0),
        channels: Channels::Bayer(sensor.cfa),
        sampling: Sampling::Bounded,
    };
    let region = Region::whole(frame);
    let rendered =
        reference::render(lens, scene, &SpectralDensity::under(sensor, light)?, frame, region, how, progress)?;
    check(glare)?;
    let mut light = rendered.mosaic();
    add_haze_mosaic(&mut light, sensor.cfa, glare);
    let clean = signal(light.view(), sensor, exposure);
    let dn = expose(clean.view(), sensor, noise.then(|| mixed(seed, 1)));
    // Noises scale with the gain of each pixel's channel.
    let variance = rendered.variance.index_axis(ndarray::Axis(0), 0).mapv(f32::sqrt);
    let render_noise = root_mean_square(signal(variance.view(), sensor, exposure).iter().copied());
    let model = Noise::from_sensor(sensor);
    let sensor_noise = root_mean_square(clean.iter().map(|y| model.sigma(*y)));
    Ok(Capture { dn, clean, render_noise, sensor_noise, rays: rendered.rays, seconds: rendered.seconds })
}

fn root_mean_square(values: impl ExactSizeIterator<Item = f32>) -> f64 {
    let count = values.len().max(1) as f64;
    (values.map(|v| f64::from(v).powi(2)).sum::<f64>() / count).sqrt()
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;
    use isoplanat_optics::lens::builtin;

    fn white() -> Plane {
        Plane { texture: Array3::ones((1, 1, 1)), texels_per_slope: 1.0, axis_texel: [0.5, 0.5], vergence: 1e-3 }
    }

    fn settings() -> CaptureSettings {
        CaptureSettings {
            samples: 32,
            seed: 5,
            exposure: 0.8,
            noise: false,
            glare: 0.0,
            light: Illuminant::EqualEnergy,
        }
    }

    /// White on the axis: each channel holds exposure · neutral response of the full scale, in DN.
    #[test]
    fn white_on_the_axis_has_the_stated_level() {
        let (lens, sensor) = (builtin::lens("two_element").expect("shipped"), Sensor::generic());
        let frame = Frame::centred(24, 16, 0.006).expect("valid");
        let shot = capture(&lens, &white(), &sensor, &frame, settings(), None).expect("renders");
        for channel in 0..3 {
            let of = |(r, c): (usize, usize)| sensor.cfa.channel(r, c) == channel;
            let values: Vec<f64> =
                shot.dn.indexed_iter().filter(|(at, _)| of(*at)).map(|(_, v)| f64::from(*v)).collect();
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let expected = 256.0 + 0.8 * sensor.neutral_response[channel] * 3839.0;
            // Five standard errors of the rendering, and the rounding to whole DN.
            let tolerance = 5.0 * shot.render_noise / (values.len() as f64).sqrt() * 3839.0 + 0.5;
            assert!((mean - expected).abs() < tolerance, "channel {channel}: {mean} against {expected} ± {tolerance}");
        }
    }

    #[test]
    fn noise_follows_the_sensor_and_repeats_with_the_seed() {
        let (lens, sensor) = (builtin::lens("two_element").expect("shipped"), Sensor::generic());
        let frame = Frame::centred(96, 64, 0.006).expect("valid");
        let with_noise = CaptureSettings { noise: true, ..settings() };
        let shot = capture(&lens, &white(), &sensor, &frame, with_noise, None).expect("renders");
        let again = capture(&lens, &white(), &sensor, &frame, with_noise, None).expect("renders");
        assert_eq!(shot.dn, again.dn);
        let scale = sensor.white_level - sensor.black_level;
        let added = shot
            .dn
            .iter()
            .zip(&shot.clean)
            .map(|(dn, y)| ((f64::from(*dn) - sensor.black_level) / scale - f64::from(*y)) as f32);
        let rms = root_mean_square(added.collect::<Vec<_>>().into_iter());
        // 6144 draws: five standard errors of an RMS are 4.5 %.
        assert!((rms / shot.sensor_noise - 1.0).abs() < 0.05, "{rms} against {}", shot.sensor_noise);
    }

    #[test]
    fn a_bad_exposure_is_refused() {
        let (lens, sensor) = (builtin::lens("two_element").expect("shipped"), Sensor::generic());
        let frame = Frame::centred(2, 2, 0.006).expect("valid");
        for exposure in [0.0, f64::NAN, -1.0] {
            let error = capture(&lens, &white(), &sensor, &frame, CaptureSettings { exposure, ..settings() }, None);
            assert!(error.expect_err("refused").to_string().contains("exposure"));
        }
    }
}
