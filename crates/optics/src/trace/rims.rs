//! Rims that overlap, and whether light gets there.

use glam::DVec2;

use super::aim::Aimer;
use super::object::ObjectPoint;
use super::sequential::{first_vignetted, trace};
use super::{Ray, System};
use crate::lens::Lens;
use crate::lens::clearance::overlaps;
use isoplanat_base::error::Result;

/// Points of the stop's rim that rays are aimed at.
const RIM_POINTS: u32 = 16;

/// One line for each pair of neighbouring surfaces that overlap beyond the beam, naming by how much; `file` names the lens.
///
/// # Errors
/// Surfaces that overlap where light goes.
pub fn overlapping_rims(lens: &Lens, file: &str) -> Result<Vec<String>> {
    let overlaps = overlaps(lens);
    if overlaps.is_empty() {
        return Ok(Vec::new());
    }
    let beam = beam_semi_diameters(lens);
    let mut warnings = Vec::with_capacity(overlaps.len());
    for o in overlaps {
        let widest = beam[o.surface].max(beam[o.surface + 1]);
        if o.from_mm <= widest {
            return Err(o.refused(file));
        }
        warnings.push(format!(
            "{file}: surface[{}] and surface[{}]: their rims overlap by {:.4} mm from {:.4} mm off the axis on; the beam ends at \
             {widest:.4} mm",
            o.surface,
            o.surface + 1,
            o.depth_mm,
            o.from_mm,
        ));
    }
    Ok(warnings)
}

/// Largest distance from the axis at which light of any field meets each surface, mm, primary wavelength: rays through the stop's rim
/// over the field, up to the aperture that stops them.
pub fn beam_semi_diameters(lens: &Lens) -> Vec<f64> {
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
