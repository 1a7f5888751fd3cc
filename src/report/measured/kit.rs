//! The MTF of capture and reconstruction, by slanted edges in front of a lens and the kit that was made for it.

use ndarray::s;

use crate::report::measured::{Measured, Seen, Settings, by_rays, close};
use isoplanat_base::error::{Error, Result};
use isoplanat_camera::kit::Kit;
use isoplanat_camera::network_process::Apart;
use isoplanat_camera::reconstruct::{Camera, Steps};
use isoplanat_camera::session::Options;
use isoplanat_imaging::capture::{expose, signal};
use isoplanat_imaging::plane::{Plane, Region};
use isoplanat_imaging::sensor::noise::mixed;
use isoplanat_optics::lens::Lens;

/// Sets the seed of rays apart from that of noise.
const RAYS: u64 = 0x7261_7973;

/// The loop of [`crate::report::measured`] with what the camera program makes of the captures: raw values with the sensor's noise, levels and steps, the
/// kit's flat field and network, here or apart. There is no veiling glare in these scenes, and none is taken off.
///
/// # Errors
/// A model that the runtime refuses; as [`close`]. Whether the kit was made for this lens, [`Kit::require`] tells.
pub fn measured(
    lens: &Lens,
    kit: &Kit,
    (options, apart): (&Options, Option<&Apart>),
    settings: Settings,
    progress: &mut dyn FnMut(f64),
) -> Result<Measured> {
    let (sensor, frame) = (&kit.sensor, &kit.frame);
    let camera = Camera::opened(kit.clone(), Steps { network: true, undistort: false }, options, apart)?;
    let rays = by_rays(lens, sensor, frame, Settings { seed: mixed(settings.seed, RAYS), ..settings });
    let seen = |scene: &Plane, region: Region| -> Result<Seen> {
        let at = camera.around(region).ok_or_else(|| Error::Internal("a camera with a kit".into()))?;
        let mosaic = rays(scene, at)?.mosaic;
        let dn = expose(signal(mosaic.view(), sensor, 1.0).view(), sensor, Some(settings.seed));
        let developed = camera.part(dn.mapv(f32::from).view(), at)?;
        let (i, j) = ((region.row - at.row).unsigned_abs(), (region.col - at.col).unsigned_abs());
        let (rows, cols) = (i..i + region.rows, j..j + region.cols);
        Ok(Seen {
            mosaic: mosaic.slice(s![rows.clone(), cols.clone()]).to_owned(),
            developed: Some(developed.map(|a| a.slice(s![.., rows.clone(), cols.clone()]).to_owned())),
        })
    };
    let found = close(lens, sensor, frame, settings, &seen, progress)?;
    let runtime = camera.network().map_or_else(String::new, |s| s.runtime().name());
    Ok(Measured { by: format!("{}, {runtime}", kit.name), ..found })
}
