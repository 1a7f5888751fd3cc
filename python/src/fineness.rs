//! How finely a layer renders: the coarsest settings whose gradient is well below the scatter of patches, as a design chooses them.

use isoplanat::imaging::render::Settings;
use isoplanat::imaging::render::gradient_error::{Chosen, Patches, cheapest};
use isoplanat::{Error, Plane, Region, Renderer, Result};

use crate::layer::Planned;

/// Settings as text.
///
/// # Errors
/// What is no such text.
pub(crate) fn read(text: &str) -> Result<Settings> {
    serde_json::from_str(text).map_err(|e| Error::bad("", "settings", e.to_string(), "as a layer has them"))
}

/// The same of [`read`].
pub(crate) fn text(settings: &Settings) -> Result<String> {
    serde_json::to_string(settings).map_err(|e| Error::Internal(e.to_string()))
}

/// `planned` for `lens` by the coarsest settings of a ladder whose gradient is near enough on these patches, and how near.
///
/// # Errors
/// A lens that cannot be rendered.
pub(crate) fn tuned(planned: &Planned, lens: isoplanat::Lens, scenes: &[(Plane, Region)]) -> Result<(Planned, Chosen)> {
    let frame = &planned.frame.inner;
    let parts = scenes.iter().map(|(scene, region)| (scene, *region)).collect();
    let chosen = cheapest(&Patches { lens: &lens, frame, density: &planned.density, parts })?;
    // What rays ask for is judged by rays.
    let settings = Settings { diffraction: planned.plan.settings.diffraction, ..chosen.settings };
    Ok((by(planned, lens, settings)?, chosen))
}

/// `planned` for `lens` by these settings.
///
/// # Errors
/// As [`tuned`].
pub(crate) fn by(planned: &Planned, lens: isoplanat::Lens, settings: Settings) -> Result<Planned> {
    let vergences: Vec<f64> = planned.plan.depths.iter().map(|d| d.vergence).collect();
    let renderer = Renderer::planned(&lens, &planned.frame.inner, &planned.density, &vergences, settings)?;
    Ok(planned.laid_out(lens, &renderer))
}
