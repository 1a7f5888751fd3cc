//! What makes the captures that a network is judged by: its own lens or another, by the fast renderer or by rays from the sensor.

use ndarray::{Array2, Array3};

use super::Settings;
use crate::design::chain::Patch;
use crate::design::subject::Subject;
use crate::error::{Error, Result};
use crate::imaging::develop::simulate::Electronics;
use crate::imaging::frame::Frame;
use crate::imaging::plane::Plane;
use crate::imaging::reference;
use crate::imaging::render::{Channels, Renderer};
use crate::imaging::sensor::Sensor;
use crate::imaging::sensor::cfa::mosaic_vjp;
use crate::imaging::sensor::noise::mixed;
use crate::imaging::sensor::spectrum::SpectralDensity;
use crate::lens::Lens;
use crate::psf::SensorMap;

/// A way to captures.
pub(super) struct Camera {
    density: SpectralDensity,
    /// Lens and rays a pixel, where rays make the image.
    rays: Option<(Lens, usize)>,
    /// The other lens, where there is one.
    other: Option<Other>,
}

/// Irradiance over a patch.
pub(super) struct Image {
    /// `[3, row, col]`; by rays, in each pixel's own colour and 0 in the others.
    pub(super) irradiance: Array3<f32>,
    /// In each pixel's own colour, `[row, col]`, where rays made it.
    pub(super) mosaic: Option<Array2<f32>>,
}

/// A lens that is not the one whose ideal picture is judged by.
struct Other {
    name: String,
    frame: Frame,
    renderer: Renderer,
    /// What slopes of a scene before the subject are multiplied by before this one, for pictures of one size.
    scale: f64,
}

impl Camera {
    /// For `subject`, which `renderer` holds, as the settings ask for it.
    ///
    /// # Errors
    /// Rays through a measured lens; another lens on a frame of another size, or at several distances.
    pub(super) fn of(subject: &Subject, sensor: &Sensor, renderer: &Renderer, settings: &Settings) -> Result<Self> {
        let density = SpectralDensity::new(sensor);
        let taken = settings.through.as_ref().unwrap_or(subject);
        let rays = match settings.rays {
            Some(rays) => Some((taken.lens("captures by rays", taken.name())?.clone(), rays)),
            None => None,
        };
        let other = settings.through.as_ref();
        let other = other.map(|other| Other::of(other, renderer, &density, settings)).transpose()?;
        Ok(Self { density, rays, other })
    }

    /// Rays through the lens that `renderer` holds.
    pub(super) fn by_rays(lens: &Lens, sensor: &Sensor, samples: usize) -> Self {
        Self { density: SpectralDensity::new(sensor), rays: Some((lens.clone(), samples)), other: None }
    }

    /// What is judged, in words: the subject, and what else makes its captures.
    pub(super) fn describe(&self, subject: &Subject) -> String {
        self.other.as_ref().map_or_else(
            || subject.name().to_owned(),
            |o| format!("{}, captured through {} (slopes x {:.5})", subject.name(), o.name, o.scale),
        )
    }

    /// The image of a patch where it does not come from `renderer`, whose lens the ideal picture is of.
    pub(super) fn image(&self, renderer: &Renderer, electronics: &Electronics, patch: &Patch) -> Result<Option<Image>> {
        let (frame, scene) = match &self.other {
            None => (&renderer.plan.frame, patch.scene.clone()),
            Some(other) => (&other.frame, other.before(renderer, &patch.scene)?),
        };
        if let Some((lens, samples)) = &self.rays {
            let (channels, seed) = (reference::Channels::Bayer(electronics.cfa), mixed(patch.noise_seed, 0x7261_7973));
            let how = reference::Settings { samples: *samples, seed, channels, sampling: reference::Sampling::Bounded };
            let mosaic = reference::render(lens, &scene, &self.density, frame, patch.region, how, None)?.mosaic();
            let cfa = electronics.at(patch.region).cfa;
            return Ok(Some(Image { irradiance: mosaic_vjp(mosaic.view(), cfa), mosaic: Some(mosaic) }));
        }
        let Some(renderer) = self.other.as_ref().map(|o| &o.renderer) else { return Ok(None) };
        let depth = renderer.plan.depth(scene.vergence)?;
        let (irradiance, _) = renderer.picture(&scene, depth, patch.region, &Channels::of(&scene), &|_| {});
        Ok(Some(Image { irradiance, mosaic: None }))
    }
}

impl Other {
    fn of(subject: &Subject, renderer: &Renderer, density: &SpectralDensity, settings: &Settings) -> Result<Self> {
        let (frame, own) = (subject.frame()?, &renderer.plan.frame);
        let refused =
            |place: &str, found: String, allowed: String| Err(Error::bad(subject.name(), place, found, allowed));
        if [own.columns, own.rows] != [frame.columns, frame.rows] {
            let allowed = format!("{} x {} pixels, as the network's own lens", own.columns, own.rows);
            return refused("sensor", format!("{} x {}", frame.columns, frame.rows), allowed);
        }
        if settings.depths_mm.len() > 1 {
            let found = format!("{} distances", settings.depths_mm.len());
            return refused("depths_mm", found, "one: the other lens stands before its own object".into());
        }
        let other = subject.renderer(density, &[subject.vergence()], settings.fineness)?;
        let scale = scale([&renderer.optics.maps[0], &other.optics.maps[0]], [own, &frame]);
        Ok(Self { name: subject.name().to_owned(), frame, renderer: other, scale })
    }

    /// A scene before the lens of `renderer` as it stands before this one: so large, and turned so that what the other lens shows where this one's axis
    /// meets the frame is on the axis.
    fn before(&self, renderer: &Renderer, scene: &Plane) -> Result<Plane> {
        let depth = renderer.plan.depth(scene.vergence)?;
        let at = renderer.plan.frame.mm_from_pixel(self.frame.axis_px);
        let ratio = renderer.optics.maps[depth].ratio(at[0].hypot(at[1]));
        let axis_texel = scene.texel_from_slope(at.map(|v| v * ratio));
        let (texels_per_slope, vergence) = (scene.texels_per_slope / self.scale, self.renderer.plan.depths[0].vergence);
        Ok(Plane { axis_texel, texels_per_slope, vergence, ..scene.clone() })
    }
}

/// The factor between the slopes that two maps show at the same pixels, by least squares over the frame's area, in pixels: focal length, centre and the
/// direction in which a camera looked say where a picture is, not what it looks like.
fn scale(maps: [&SensorMap; 2], frames: [&Frame; 2]) -> f64 {
    let far = frames[0].max_radius_mm() / frames[0].pitch_mm;
    let [mut both, mut square] = [0.0; 2];
    for i in 1..=256 {
        let radius = far * f64::from(i) / 256.0;
        let [a, b] = [0, 1].map(|k| maps[k].slope(radius * frames[k].pitch_mm));
        let weight = radius / (maps[1].derivative(radius * frames[1].pitch_mm)).powi(2);
        both += weight * a * b;
        square += weight * a * a;
    }
    both / square
}
