//! Whether any clear ray of an object point gets to a point of the stop, asked without aiming.
//!
//! Where no ray was aimed, either the aiming failed or there is none to find. Rays over the whole first surface tell: those that
//! pass every clear aperture, and among them the one that meets the stop nearest to the point, around which the raster is drawn
//! closer and closer.

use std::f64::consts::TAU;

use glam::DVec2;

use super::super::object::{LaunchPlane, ObjectPoint};
use super::super::sequential::{first_vignetted, trace};
use super::super::{Ray, System};

/// Rays along each side of a raster.
const SIDE: u32 = 48;
/// Rasters, each about the best ray of the one before.
const ROUNDS: u32 = 6;
/// Reached from this distance on, in parts of the stop's semi-diameter.
const REACHED: f64 = 1e-3;

/// Whether a ray of `object` within all clear apertures meets the stop of `system` at `target` (mm), within a thousandth of its
/// semi-diameter.
pub(super) fn clear_ray_reaches(system: &System, object: ObjectPoint, target: DVec2) -> bool {
    let plane = LaunchPlane::new(system, object);
    let Some([low, high]) = entrance(system, &plane) else { return false };
    let (mut middle, mut half) = (0.5 * (low + high), 0.5 * (high - low));
    let mut hits = Vec::with_capacity(system.surfaces.len());
    let mut met = |ray: Ray| {
        let arrives = trace(system, ray, system.image(), &mut hits).is_ok();
        (arrives && first_vignetted(system, &hits).is_none()).then(|| hits[system.stop].at.point.truncate())
    };
    let mut before = f64::INFINITY;
    for _ in 0..ROUNDS {
        let mut best: Option<(f64, DVec2)> = None;
        for i in 0..SIDE * SIDE {
            let at = |k: u32| 2.0 * (f64::from(k) + 0.5) / f64::from(SIDE) - 1.0;
            let p = middle + half * DVec2::new(at(i % SIDE), at(i / SIDE));
            let Some(point) = met(plane.ray(p)) else { continue };
            let distance = point.distance(target);
            if best.is_none_or(|(d, _)| distance < d) {
                best = Some((distance, p));
            }
        }
        match best {
            Some((distance, _)) if distance <= REACHED * system.stop_semi_diameter => return true,
            Some((distance, p)) if distance < before => (before, middle) = (distance, p),
            // Before any ray is found, the raster is drawn closer about where it is.
            _ => {}
        }
        half *= 4.0 / f64::from(SIDE);
        if best.is_none() {
            return false;
        }
    }
    false
}

/// The part of the launch plane whose rays meet the first surface within its clear semi-diameter: lowest and highest coordinates.
fn entrance(system: &System, plane: &LaunchPlane) -> Option<[DVec2; 2]> {
    let first = system.surfaces.first()?;
    let rim = first.semi_diameter.min(100.0 * system.stop_semi_diameter);
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for ring in 0..=6 {
        for k in 0..24 {
            let at = rim * f64::from(ring) / 6.0 * DVec2::from_angle(TAU * f64::from(k) / 24.0);
            let Some(sag) = first.shape.at(at.x, at.y) else { continue };
            let point = at.extend(sag.h);
            let p = plane.through(first.motion.map_or(point, |m| m.rotation * point + m.shift));
            if p.is_finite() {
                (low, high) = (low.min(p), high.max(p));
            }
        }
    }
    let margin = 0.02 * (high - low);
    (low.is_finite() && high.is_finite()).then_some([low - margin, high + margin])
}

#[cfg(test)]
mod tests {
    use super::super::super::aim::Aimer;
    use super::super::super::pupil::PupilRay;
    use super::*;
    use crate::lens::{Lens, builtin};
    use crate::trace::test_lenses::{laikin_100, nikkor_180};

    /// Of rays that are aimed, those within all apertures are found to be there, those that an aperture stops well inside are not.
    #[test]
    fn it_agrees_with_rays_that_are_aimed() {
        let (mut clear, mut stopped) = (0, 0);
        for lens in [builtin::lens("double_gauss").expect("shipped"), laikin_100(), nikkor_180()] {
            for cut in [1.0, 0.6] {
                let mut system = System::new(&lens, lens.wavelengths.primary_nm);
                system.surfaces[0].semi_diameter *= cut;
                (clear, stopped) = compared(&lens, &system, (clear, stopped));
            }
        }
        assert!(clear > 20 && stopped > 10, "{clear} {stopped}");
    }

    fn compared(lens: &Lens, system: &System, (mut clear, mut stopped): (u32, u32)) -> (u32, u32) {
        let aimer = Aimer::new(system).expect("a stop");
        for share in [0.0, 0.6, 0.97] {
            let object = ObjectPoint::in_field(lens, share * lens.max_field_deg().to_radians(), 1.2);
            for k in 0..6 {
                let target = 0.9 * system.stop_semi_diameter * DVec2::from_angle(f64::from(k));
                let ray = PupilRay::new(&aimer, object, target, None).expect("aims");
                // Close to an aperture's edge either is right.
                let near_edge = |(s, h): (&crate::trace::system::TraceSurface, &crate::trace::sequential::Hit)| {
                    (h.at.point.truncate().length() / s.semi_diameter - 1.0).abs() < 0.02
                };
                if system.surfaces.iter().zip(&ray.hits).any(near_edge) {
                    continue;
                }
                let found = clear_ray_reaches(system, object, target);
                assert_eq!(found, ray.end.is_ok(), "{} {share} {k}", lens.name);
                if found { clear += 1 } else { stopped += 1 }
            }
        }
        (clear, stopped)
    }
}
