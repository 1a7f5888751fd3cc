//! The reference renderer: rays from the sensor, the paper's own image formation (§3.1.2).
//!
//! A point `p` of the sensor collects `E = ∫ n'² L cos⁴θ′ / Z² dA` over the plane of the rear aperture's rim, at the
//! distance `Z`; `L` is the scene's radiance where the ray through `p` and `dA` leaves the lens, 0 where an aperture
//! stops it. Position in the pixel, point of `dA` and wavelength are sampled together; failed rays count as zero. The
//! result is relative to a white scene's value on the axis, which [`rear`] integrates to 1e-9 (a lens without
//! symmetry: 2e-5 to 4e-3). Apertures are hard.
//!
//! It shares lens and trace with the fast path, and neither PSF grid nor convolution: it is the judge of both. The
//! estimate is unbiased but for the grid of wavelengths ([`rear`], below 1e-5). Directions come from the whole rear
//! aperture ([`Sampling::RearAperture`]) or from an ellipse that holds every ray a probe saw pass
//! ([`Sampling::Bounded`], [`bounds`]); in that mode one more ray a pixel searches the rest of the rear aperture, so
//! that a probe's mistake costs noise, not truth. Tilts, decentres and freeform terms are traced as they are; the ellipses
//! of such a lens are those of the same lens without them, a little larger.
//! Not covered: diffraction, Fresnel losses, depth within a scene. Gradients: [`gradient`].

#[doc(hidden)]
pub mod bounds;
mod draw;
pub mod gradient;
pub mod halves;
mod pixels;
#[doc(hidden)]
pub mod rear;
mod sampler;
#[doc(hidden)]
pub mod seen;
mod stream;
mod tracer;

use std::time::Instant;

use ndarray::{Array2, Array3, Axis};

use crate::frame::Frame;
use crate::plane::{Plane, Region};
use crate::sensor::cfa::Cfa;
use crate::sensor::noise::mixed;
use crate::sensor::spectrum::SpectralDensity;
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::lens::Lens;

pub use tracer::Tracer;

/// Independent groups of rays a pixel: as few as show the noise, because larger groups are spread more evenly.
const GROUPS: usize = 2;

/// Largest radiance of a scene: its square is far inside f32, in which variances are stored.
const LARGEST: f32 = 1e15;

/// Which channels a pixel gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channels {
    /// Red, green and blue.
    All,
    /// The one its colour filter lets through; the layout's first pixel is the frame's row 0, column 0.
    Bayer(Cfa),
}

/// Where directions are drawn from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sampling {
    /// The whole rear aperture: the paper's plain sampling.
    RearAperture,
    /// An ellipse around the rays that pass, by sensor radius: the same mean, less noise.
    Bounded,
    /// The ellipses that a lens without symmetry has for [`Self::Bounded`], for any lens: where both are compared.
    Wide,
}

/// How to render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Rays a pixel and channel, 2 or more; in two groups, best of 2ᵏ rays each.
    pub samples: usize,
    /// Seed of the draws; every pixel has a stream of its own.
    pub seed: u64,
    /// Channels.
    pub channels: Channels,
    /// Directions.
    pub sampling: Sampling,
}

/// A rendered region.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// Irradiance relative to white on the axis: `[3, row, col]`, or `[1, row, col]` for a mosaic.
    pub mean: Array3<f32>,
    /// Variance of the mean, estimated from two independent groups of rays, in the shape of `mean`.
    ///
    /// A single pixel's estimate is coarse (two groups: one degree of freedom); sums over pixels are good.
    pub variance: Array3<f32>,
    /// Rays started.
    pub rays: u64,
    /// Rays that reached the scene.
    pub passed: u64,
    /// Rays that passed outside the bounding ellipse (0 unless the probe missed a part of the pupil).
    pub outside: u64,
    /// Irradiance of white on the axis in the lens's units (sr, for a sensor in air): R, G, B.
    pub axis_irradiance: [f64; 3],
    /// Wall time; of [`render`] what is found out about the lens included.
    pub seconds: f64,
}

impl Rendered {
    /// The first plane: the mosaic of a Bayer rendering.
    pub fn mosaic(&self) -> Array2<f32> {
        self.mean.index_axis(Axis(0), 0).to_owned()
    }

    /// Root of the mean variance of the mean: the noise that is left.
    pub fn noise_rms(&self) -> f64 {
        let sum: f64 = self.variance.iter().map(|v| f64::from(*v)).sum();
        (sum / self.variance.len().max(1) as f64).sqrt()
    }
}

/// Renders `region` of `frame` as `lens` images `scene`, by rays from the sensor: [`Tracer::render`] for one picture.
///
/// # Errors
/// As [`Tracer::new`] and [`Tracer::render`].
pub fn render(
    lens: &Lens,
    scene: &Plane,
    density: &SpectralDensity,
    frame: &Frame,
    region: Region,
    settings: Settings,
    progress: Option<&(dyn Fn(f64) + Sync)>,
) -> Result<Rendered> {
    let start = Instant::now();
    check(scene, region)?;
    let tracer = Tracer::new(lens, density, reach_mm(frame, region), settings)?;
    tracer.drawn(scene, frame, region, settings.seed, progress, start)
}

/// Largest distance from the axis, mm, of the whole frame and of a region: a part of a picture equals the same part of the whole.
fn reach_mm(frame: &Frame, region: Region) -> f64 {
    region.radii_mm(frame, 0.0)[1].max(frame.max_radius_mm())
}

/// Two independent renderings with half the samples each, for [`halves`].
///
/// # Errors
/// As [`render`].
pub fn render_halves(
    lens: &Lens,
    scene: &Plane,
    density: &SpectralDensity,
    frame: &Frame,
    region: Region,
    settings: Settings,
    progress: Option<&(dyn Fn(f64) + Sync)>,
) -> Result<[Rendered; 2]> {
    let half = |k: u64| {
        let settings = Settings { samples: settings.samples.div_ceil(2), seed: mixed(settings.seed, k), ..settings };
        let share = |done: f64| {
            if let Some(progress) = progress {
                progress(0.5 * (k as f64 + done));
            }
        };
        render(lens, scene, density, frame, region, settings, Some(&share))
    };
    Ok([half(0)?, half(1)?])
}

fn check(scene: &Plane, region: Region) -> Result<()> {
    let (channels, rows, cols) = scene.texture.dim();
    if !(channels == 1 || channels == 3) || rows == 0 || cols == 0 {
        let found = format!("{channels} channels of {rows} × {cols} texels");
        return Err(Error::bad("", "scene", found, "1 or 3 channels, at least one texel"));
    }
    // The first that is wrong; NaN is not within anything.
    let fine = |v: f32| v.abs() <= LARGEST;
    if let Some(((channel, row, col), v)) = scene.texture.indexed_iter().find(|(_, v)| !fine(**v)) {
        let place = format!("scene, channel {channel}, row {row}, column {col}");
        return Err(Error::bad("", place, format!("radiance {v}"), format!("finite numbers within ±{LARGEST:e}")));
    }
    let [x, y] = scene.axis_texel;
    if ![scene.vergence, scene.texels_per_slope, x, y].iter().all(|v| v.is_finite()) {
        let found =
            format!("vergence {} /mm, {} texels per slope, axis at {x}, {y}", scene.vergence, scene.texels_per_slope);
        return Err(Error::bad("", "scene", found, "finite numbers; vergence 0 for an infinite distance"));
    }
    if region.rows == 0 || region.cols == 0 {
        let found = format!("{} × {} pixels", region.rows, region.cols);
        return Err(Error::bad("", "rendered region", found, "at least one pixel"));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
