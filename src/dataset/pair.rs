//! One capture and its truth.

use isoplanat_base::error::Result;
use isoplanat_base::math::mixed;
use isoplanat_imaging::develop::simulate::{Electronics, simulate};
use isoplanat_imaging::plane::Region;
use isoplanat_imaging::sensor::Sensor;
use isoplanat_imaging::sensor::noise::{Noise, standard_normal};
use ndarray::{Array3, ArrayView3, s};

use super::judge::judged;
use super::record::Row;
use super::stage::{Cut, Stage};

/// How a sensor's mosaic and noise become part of a picture.
#[derive(Clone, Copy, Debug)]
pub struct Exposure<'a> {
    /// The sensor.
    pub sensor: &'a Sensor,
    /// Noise deviation over the sensor's own.
    pub level: f64,
    /// Whether falling light is divided out before demosaicking.
    pub flat_field: bool,
    /// Seed of the noise.
    pub seed: u64,
}

impl Exposure<'_> {
    /// The noise of the signal, black 0 and saturation 1.
    pub fn noise(&self) -> Noise {
        let own = Noise::from_sensor(self.sensor);
        Noise { shot: own.shot * self.level * self.level, read: own.read * self.level }
    }

    /// The picture of `region` that comes of irradiance relative to white on the axis: mosaic, response, noise, white balance, demosaicking. Nothing
    /// is cut off or rounded.
    ///
    /// # Shapes
    /// `image`, `illumination` (relative, of white) and result: `[3, row, col]`.
    pub fn developed(
        &self,
        image: ArrayView3<'_, f32>,
        illumination: ArrayView3<'_, f32>,
        region: Region,
    ) -> Array3<f32> {
        let electronics = Electronics { noise: self.noise(), ..Electronics::from_sensor(self.sensor) }.at(region);
        let (_, rows, cols) = image.dim();
        let eps = standard_normal(self.seed, (rows, cols));
        let even = Array3::ones(if self.flat_field { (0, 0, 0) } else { illumination.dim() });
        let light = if self.flat_field { illumination } else { even.view() };
        simulate(&electronics, image, light, eps).0
    }
}

/// A pair with its line.
pub(super) struct Pair {
    /// Its line.
    pub row: Row,
    /// `[3, row, col]`.
    pub capture: Array3<f32>,
    /// `[3, row, col]`.
    pub truth: Array3<f32>,
}

/// A pair's number and the files it stands in.
pub(super) struct Place {
    /// Number of the pair.
    pub pair: usize,
    /// Photograph.
    pub photo: usize,
    /// Crop of it.
    pub crop: usize,
    /// Files of capture and truth.
    pub files: [String; 2],
    /// Place in a shard.
    pub place: usize,
    /// Whether rays judge it.
    pub judged: bool,
}

/// Makes a pair of a photograph, read as `texture`.
///
/// # Errors
/// A photograph that cannot be placed or rendered.
pub(super) fn made(stage: &Stage<'_>, place: Place, texture: &Array3<f32>) -> Result<Pair> {
    let Stage { settings, frame, plan, .. } = stage;
    let Cut { part, around, scene } = stage.cut(place.photo, place.crop, texture)?;
    let (image, _) = plan.part::<f32>(&scene, around, &|_| ())?;
    let truth = plan.truth::<f32>(&scene, part)?;
    let inside = |image: &Array3<f32>| {
        let (r, c) = ((part.row - around.row).unsigned_abs(), (part.col - around.col).unsigned_abs());
        image.slice(s![.., r..r + part.rows, c..c + part.cols]).to_owned()
    };
    let seed = mixed(settings.seed ^ 0x6461_7461, place.pair as u64);
    let level = level(settings.noise_level, seed);
    let verdict = if place.judged { Some(judged(stage, &scene, part, inside(&image).view(), seed)?) } else { None };
    let exposure = Exposure { sensor: &settings.sensor, level, flat_field: settings.flat_field, seed };
    let illumination = |region| plan.renderer.light.over::<f32>(frame, region, &[0, 1, 2]);
    let capture = match (settings.noise, settings.flat_field) {
        (true, _) => inside(&exposure.developed(image.view(), illumination(around).view(), around)),
        (false, true) => isoplanat_imaging::develop::shading::evened(inside(&image), illumination(part).view()),
        (false, false) => inside(&image),
    };
    let noise = if settings.noise { exposure.noise() } else { Noise::NONE };
    let photo = stage.photos.paths()[place.photo].file_name().unwrap_or_default().to_string_lossy().into_owned();
    let [capture_file, truth_file] = place.files;
    let row = Row {
        pair: place.pair,
        lens: stage.name().to_owned(),
        lens_index: stage.lens_index,
        photo,
        distance_mm: stage.distance_mm(),
        row: part.row.unsigned_abs(),
        column: part.col.unsigned_abs(),
        rows: part.rows,
        columns: part.cols,
        field_deg: field_deg(stage, part),
        sensor: if settings.noise { settings.sensor.name.clone() } else { String::new() },
        noise_level: if settings.noise { level } else { 0.0 },
        shot: noise.shot,
        read: noise.read,
        seed,
        predicted_psnr_db: plan.predicted_db.filter(|db| db.is_finite()),
        judged: verdict,
        capture: capture_file,
        truth: truth_file,
        place: place.place,
    };
    Ok(Pair { row, capture, truth })
}

/// The noise's level of a pair.
fn level([low, high]: [f64; 2], seed: u64) -> f64 {
    let drawn = fastrand::Rng::with_seed(mixed(seed, 0x6c65_7665)).f64();
    if low < high { (low.ln() + (high / low).ln() * drawn).exp() } else { low }
}

/// Half field angle that the middle of a region sees, degrees.
fn field_deg(stage: &Stage<'_>, region: Region) -> f64 {
    let middle = |first: isize, n: usize| first as f64 + 0.5 * n as f64;
    let radius = stage.frame.radius_mm(middle(region.col, region.cols), middle(region.row, region.rows));
    stage.plan.renderer.optics.maps[0].slope(radius).atan().to_degrees()
}
