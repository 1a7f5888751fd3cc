//! Rims that overlap, and whether light gets there.

use glam::DVec2;

use super::aim::Aimer;
use super::object::ObjectPoint;
use super::sequential::{first_vignetted, trace};
use super::{Ray, System};
use crate::lens::Lens;
use crate::lens::clearance::{DEEPEST_MM, Overlap, overlaps, overlaps_of_parts};
use isoplanat_base::error::Result;

/// Points of the stop's rim that rays are aimed at.
const RIM_POINTS: u32 = 16;

/// One line for each pair of neighbouring surfaces that overlap, by how much and whether light gets there; `file` names the lens.
pub fn overlapping_rims(lens: &Lens, file: &str) -> Vec<String> {
    let line = |(o, widest): (Overlap, f64)| {
        let Overlap { surface, next, from_mm, depth_mm } = o;
        let light = if from_mm <= widest {
            format!("light goes there, up to {widest:.4} mm, and is traced through both as they stand")
        } else {
            format!("the beam ends at {widest:.4} mm")
        };
        format!(
            "{file}: surface[{surface}] and surface[{next}]: they overlap by {depth_mm:.4} mm from {from_mm:.4} mm off the axis on; {light}"
        )
    };
    with_beam(lens, overlaps(lens)).into_iter().map(line).collect()
}

/// Refuses parts, the stop among them, that overlap where light goes, or by more than rims do, for a lens that is to be made; `file` names it.
///
/// # Errors
/// The first such pair.
pub fn require_clear(lens: &Lens, file: &str) -> Result<()> {
    let unmade = |(o, widest): &(Overlap, f64)| o.depth_mm > DEEPEST_MM || o.from_mm <= *widest;
    match with_beam(lens, overlaps_of_parts(lens)).into_iter().find(unmade) {
        Some((o, _)) => Err(o.refused_in_light(file)),
        None => Ok(()),
    }
}

/// Overlaps, each with how far from the axis light meets its surfaces.
fn with_beam(lens: &Lens, overlaps: Vec<Overlap>) -> Vec<(Overlap, f64)> {
    if overlaps.is_empty() {
        return Vec::new();
    }
    let beam = beam_semi_diameters(lens);
    overlaps.into_iter().map(|o| (o, beam[o.surface].max(beam[o.next]))).collect()
}

/// Largest distance from the axis at which light of any field meets each surface, mm, primary wavelength: rays through the stop's rim
/// over the field, up to the aperture that stops them.
pub(crate) fn beam_semi_diameters(lens: &Lens) -> Vec<f64> {
    let system = System::new(lens, lens.wavelengths.primary_nm);
    let mut heights = vec![0.0f64; system.image()];
    // A stop that cannot be aimed at says nothing: light may go everywhere.
    let Ok(aimer) = Aimer::new(&system) else { return system.surfaces.iter().map(|s| s.semi_diameter).collect() };
    let azimuths: &[f64] = if lens.is_symmetric() { &[90.0] } else { &[0.0, 90.0, 180.0, 270.0] };
    let mut hits = Vec::new();
    let mut follow = |ray: Ray| {
        // A ray that gets lost has met the surfaces before.
        let _ = trace(&system, ray, system.image(), &mut hits);
        let end = first_vignetted(&system, &hits).map_or(hits.len(), |f| f.surface + 1);
        for ((h, s), height) in hits[..end].iter().zip(&system.surfaces).zip(&mut heights) {
            *height = height.max(h.at.point.truncate().length().min(s.semi_diameter));
        }
    };
    for share in [0.0, 0.25, 0.5, 0.7, 0.85, 1.0] {
        for azimuth in azimuths {
            let object = ObjectPoint::in_field(lens, share * lens.max_field_deg().to_radians(), azimuth.to_radians());
            for k in 0..RIM_POINTS {
                let u = DVec2::from_angle(std::f64::consts::TAU * f64::from(k) / f64::from(RIM_POINTS));
                if let Ok(aimed) = aimer.aim(object, u * system.stop_semi_diameter, None) {
                    follow(aimed.ray);
                }
            }
        }
    }
    heights
}
