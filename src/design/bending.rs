//! Whether the pictures of a design or a training are made by diffraction, where its task leaves that to its scenes.

use super::data::Textures;
use super::joint::run::JUDGED;
use super::places::Places;
use super::task::Task;
use isoplanat_base::error::Result;
use isoplanat_imaging::plane::Plane;
use isoplanat_imaging::render::{Diffraction, Renderer, Settings, enough_diffraction, frame_of};
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::Model;

/// Peak signal-to-noise ratio that pictures of rays are to hold, dB: that of a promise where nothing is asked.
const HELD_DB: f64 = 45.0;

/// What `task` says; in the place of `auto`, what a few of its patches tell at each of `depths_mm`, or at the lens's own distance where there are none.
///
/// # Errors
/// A lens that cannot be rendered.
pub(super) fn settled(task: &Task, lens: &Lens, textures: &Textures, depths_mm: &[f64]) -> Result<Diffraction> {
    if task.pictures.diffraction != Diffraction::Auto {
        return Ok(task.pictures.diffraction);
    }
    let (frame, density) = (frame_of(lens)?, SpectralDensity::new(&task.sensor()?));
    let mut vergences: Vec<f64> = depths_mm.iter().map(|d| d.recip()).collect();
    if vergences.is_empty() {
        vergences.push(lens.object_vergence);
    }
    let renderer = Renderer::planned(lens, &frame, &density, &vergences, Settings::DESIGN)?;
    let places = Places::new(&frame, task.pictures.patch_px.min(JUDGED.1), task.pictures.spread);
    let mut enough = Diffraction::Off;
    for map in &renderer.optics.maps {
        let drawn = |i| textures.numbered((task.seed ^ 0x6265_6e74, i), &places, &frame, map, 0).scene;
        let scenes: Vec<Plane> = (0..JUDGED.0 as u64).map(drawn).collect();
        match enough_diffraction(lens, &scenes, &frame, &density, HELD_DB)? {
            Model::Rays => {}
            Model::Approximate => enough = Diffraction::Approximate,
            Model::Waves => return Ok(Diffraction::On),
        }
    }
    Ok(enough)
}
