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

/// What pictures may lack of diffraction, dB: as much as pictures are promised to be off by where nothing is asked.
const LEFT_DB: f64 = 45.0;

/// What `task` says; in the place of `auto`, what a few of its patches tell at each of `depths_mm`, or at the lens's own distance where there are none. A lens that
/// `moves` can become sharp: of rays are its pictures where a perfect lens of its pupil shows nothing else.
///
/// # Errors
/// A lens that cannot be rendered.
pub(super) fn settled(
    task: &Task,
    lens: &Lens,
    moves: bool,
    textures: &Textures,
    depths_mm: &[f64],
) -> Result<Diffraction> {
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
        let needed = enough_diffraction(lens, &scenes, &frame, &density, LEFT_DB)?;
        match needed.model {
            Model::Rays if !(moves && needed.bends) => {}
            Model::Rays | Model::Approximate => enough = Diffraction::Approximate,
            Model::Waves => return Ok(Diffraction::On),
        }
    }
    Ok(enough)
}
