//! Whether the pictures of a design or a training are made by diffraction, where its task leaves that to its scenes.

use super::data::Textures;
use super::joint::run::JUDGED;
use super::places::Places;
use super::task::PictureTask;
use isoplanat_base::error::Result;
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::plane::Plane;
use isoplanat_imaging::render::{Diffraction, Renderer, Settings, needs_diffraction};
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_optics::lens::Lens;

/// Peak signal-to-noise ratio that pictures of rays are to hold, dB: that of a promise where nothing is asked.
const HELD_DB: f64 = 45.0;

/// In the place of `auto`, what a few of the task's patches tell at each of its distances; nothing else changes.
///
/// # Errors
/// A lens that cannot be rendered.
pub(super) fn settle(
    pictures: &mut PictureTask,
    lens: &Lens,
    (textures, seed): (&Textures, u64),
    (frame, density): (&Frame, &SpectralDensity),
    vergences: &[f64],
) -> Result<()> {
    if pictures.diffraction != Diffraction::Auto {
        return Ok(());
    }
    let renderer = Renderer::planned(lens, frame, density, vergences, Settings::DESIGN)?;
    let places = Places::new(frame, pictures.patch_px.min(JUDGED.1), pictures.spread);
    let mut needed = false;
    for map in &renderer.optics.maps {
        let numbers = 0..JUDGED.0 as u64;
        let drawn = numbers.map(|i| textures.numbered((seed ^ 0x6265_6e74, i), &places, frame, map, 0).scene);
        let scenes: Vec<Plane> = drawn.collect();
        needed = needed || needs_diffraction(lens, &scenes, frame, density, HELD_DB)?;
    }
    pictures.diffraction = if needed { Diffraction::On } else { Diffraction::Off };
    Ok(())
}
