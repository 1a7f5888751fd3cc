//! Whether the pictures of a design or a training are made by diffraction, where its task leaves that to its scenes.

use std::collections::BTreeMap;

use super::data::Textures;
use super::places::{JUDGED, Places};
use super::task::Task;
use isoplanat_base::error::Result;
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::plane::Plane;
use isoplanat_imaging::render::{Diffraction, Renderer, Settings, enough_diffraction, frame_of};
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::Model;

/// What pictures may lack of diffraction, dB: as much as pictures are promised to be off by where nothing is asked.
const LEFT_DB: f64 = 45.0;

/// Fact of a design's checkpoint: by what the pictures of its lens are made.
const FACT: &str = "run.diffraction";

/// Adds `model` to the facts of a checkpoint.
pub(super) fn put(model: Model, facts: &mut BTreeMap<String, String>) {
    facts.insert(FACT.to_owned(), model.name().to_owned());
}

/// By what the pictures of a checkpoint's lens are made; nothing of a version before, or of a training, whose task says it.
pub(super) fn said(facts: &BTreeMap<String, String>) -> Option<Model> {
    facts.get(FACT).and_then(|name| Model::from_name(name))
}

/// The first of rays, the open pupil's diffraction and waves that lacks at most 45 dB of diffraction in `scenes`, which may stand at several distances.
///
/// # Errors
/// A lens that cannot be rendered.
fn enough(lens: &Lens, mut scenes: Vec<Plane>, frame: &Frame, density: &SpectralDensity) -> Result<Model> {
    let mut enough = Model::Rays;
    while let Some(vergence) = scenes.first().map(|s| s.vergence) {
        let at: Vec<Plane>;
        (at, scenes) = scenes.into_iter().partition(|s| s.vergence == vergence);
        match enough_diffraction(lens, &at, frame, density, LEFT_DB)? {
            Model::Rays => {}
            Model::Approximate => enough = Model::Approximate,
            Model::Waves => return Ok(Model::Waves),
        }
    }
    Ok(enough)
}

/// By what pictures of a lens (on a frame, seen by a sensor) are made from now on: as `how` says, or as `scenes` tell; as `before` where that cannot be told.
pub(super) fn now(
    how: Diffraction,
    before: Model,
    scenes: impl Iterator<Item = Plane>,
    (lens, frame, density): (&Lens, &Frame, &SpectralDensity),
) -> Model {
    match how {
        Diffraction::Auto => enough(lens, scenes.collect(), frame, density).unwrap_or(before),
        how => how.stated(),
    }
}

/// What `task` says; in the place of `auto`, what a few of its patches through a lens that stays as it is tell at each of `depths_mm`, or at the lens's own distance where there
/// are none.
///
/// # Errors
/// A lens that cannot be rendered.
pub(super) fn settled(task: &Task, lens: &Lens, textures: &Textures, depths_mm: &[f64]) -> Result<Diffraction> {
    if task.pictures.diffraction != Diffraction::Auto {
        return Ok(task.pictures.diffraction);
    }
    let (frame, density) = (&frame_of(lens)?, SpectralDensity::new(&task.sensor()?));
    let mut vergences: Vec<f64> = depths_mm.iter().map(|d| d.recip()).collect();
    if vergences.is_empty() {
        vergences.push(lens.object_vergence);
    }
    let renderer = Renderer::planned(lens, frame, &density, &vergences, Settings::DESIGN)?;
    let places = Places::new(frame, task.pictures.patch_px.min(JUDGED.1), task.pictures.spread);
    let numbers = || (0..JUDGED.0 as u64).map(|i| (task.seed ^ 0x6265_6e74, i));
    let places = &places;
    let drawn = |map| numbers().map(move |number| textures.numbered(number, places, frame, map, 0).scene);
    let scenes = renderer.optics.maps.iter().flat_map(drawn).collect();
    enough(lens, scenes, frame, &density).map(Diffraction::from)
}
