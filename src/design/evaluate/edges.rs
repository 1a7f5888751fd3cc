//! The MTF of capture and reconstruction, by slanted edges in front of a lens and its network.

use super::{Behind, Camera, at_depths, context_of};
use crate::design::evaluate::{FINENESS, Settings as Evaluated, TEXELS_PER_PIXEL};
use crate::design::subject::Subject;
use crate::report::measured::{Measured, Seen, Settings, close};
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::develop::simulate::Electronics;
use isoplanat_imaging::guide::Guide;
use isoplanat_imaging::plane::{Plane, Region};
use isoplanat_imaging::sensor::Sensor;
use isoplanat_network::Reconstructor;
use isoplanat_optics::lens::Lens;

/// The loop of [`crate::report::measured`] with what `network`, told by its guide, makes of the captures; they carry the sensor's noise.
///
/// # Errors
/// As [`close`]; a lens that cannot image its frame.
pub fn measured(
    lens: &Lens,
    (network, guide): (&Reconstructor, &Guide),
    sensor: &Sensor,
    settings: Settings,
    progress: &mut dyn FnMut(f64),
) -> Result<Measured> {
    let subject = Subject::from(lens.clone());
    let frame = subject.frame()?;
    let depths_mm = vec![1.0 / lens.object_vergence];
    let evaluated = Evaluated {
        fields: 1,
        to_deg: None,
        means_deg: Vec::new(),
        depths_mm,
        patch: 64,
        seed: settings.seed,
        fineness: FINENESS,
        rays: Some(settings.rays),
        texels: TEXELS_PER_PIXEL,
        through: None,
    };
    let renderer = at_depths(&subject, sensor, &evaluated)?;
    let electronics = Electronics::from_sensor(sensor);
    let by_rays = Camera::of(&subject, sensor, &renderer, &evaluated)?;
    let context = context_of(network);
    let behind = Behind { renderer: &renderer, electronics: &electronics, network, guide, wiener: None, context };
    let camera = |scene: &Plane, region: Region| -> Result<Seen> {
        let taken = behind.take(scene.clone(), region, settings.seed, &by_rays)?;
        let mosaic = taken.mosaic.ok_or_else(|| Error::Internal("a capture by rays has a mosaic".into()))?;
        Ok(Seen { mosaic, developed: Some([taken.developed, taken.restored]) })
    };
    close(lens, sensor, &frame, settings, &camera, progress)
}
