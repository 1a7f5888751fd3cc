//! Pictures judged by rays from the sensor.

use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::mixed;
use isoplanat_imaging::plane::{Plane, Region};
use isoplanat_imaging::reference::Tracer;
use isoplanat_imaging::reference::halves::psnr_against_halves;
use isoplanat_imaging::reference::{Channels, Sampling, Settings as Rays};
use ndarray::ArrayView3;

use super::record::Judged;
use super::stage::Stage;

/// The mean square error of `image`, the picture of `part` before noise.
///
/// # Errors
/// A lens without light there.
pub(super) fn judged(
    stage: &Stage<'_>,
    scene: &Plane,
    part: Region,
    image: ArrayView3<'_, f32>,
    seed: u64,
) -> Result<Judged> {
    let tracer = match stage.tracer.get() {
        Some(tracer) => tracer,
        None => {
            let samples = stage.settings.judging.samples.div_ceil(2);
            let how = Rays { samples, seed: 0, channels: Channels::All, sampling: Sampling::Bounded };
            let named = |e: Error| e.in_file(stage.name());
            let made = Tracer::new(&stage.lens, stage.density, stage.frame.max_radius_mm(), how).map_err(named)?;
            stage.tracer.get_or_init(|| made)
        }
    };
    let half = |k: u64| tracer.render(scene, &stage.frame, part, mixed(seed, k), None);
    let found = psnr_against_halves(image, &[half(0)?, half(1)?]);
    Ok(Judged { mean_square: found.mean_square, standard_error: found.standard_error })
}
