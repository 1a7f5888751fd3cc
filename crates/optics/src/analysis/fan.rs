//! Fans: errors of rays along one line through the stop, across the image (transverse) and in path.

use glam::DVec2;

use super::beam::Beam;
use crate::trace::aim::Aimer;
use crate::trace::wavefront::{Reference, Wavefront};
use crate::trace::{ObjectPoint, System};

/// One fan.
#[derive(Clone, Debug, PartialEq)]
pub struct Fan {
    /// Wavelength, nm.
    pub wavelength_nm: f64,
    /// Places in the unit stop, −1 to 1, with the error along the fan's own line; rays that do not arrive are missing.
    pub points: Vec<[f64; 2]>,
}

/// The two fans of one object point and wavelength: in the meridian of y, across it.
pub type Fans = [Fan; 2];

/// Places along a fan.
fn line(count: u32) -> Vec<f64> {
    (0..count).map(|k| 2.0 * f64::from(k) / f64::from(count.max(2) - 1) - 1.0).collect()
}

/// Landing of the chief ray, on the image surface: what fans of every wavelength are measured from.
pub(crate) fn reference(system: &System, object: ObjectPoint) -> Option<DVec2> {
    Beam::new(system, object, &[]).chief.map(|l| l.at)
}

/// Transverse errors, mm: landing less `from`, along y over the stop's y, along x over its x.
pub(crate) fn transverse(system: &System, object: ObjectPoint, from: DVec2, count: u32) -> Fans {
    [DVec2::Y, DVec2::X].map(|axis| {
        let points: Vec<DVec2> = line(count).into_iter().map(|t| t * axis).collect();
        let beam = Beam::new(system, object, &points);
        let points = beam.landings.iter().map(|l| [l.stop.dot(axis), (l.at - from).dot(axis)]).collect();
        Fan { wavelength_nm: system.wavelength_nm, points }
    })
}

/// Path differences, waves, from the reference sphere about `from`; positive where the wavefront is ahead ([`Wavefront`]).
pub fn path(system: &System, object: ObjectPoint, from: DVec2, count: u32) -> Fans {
    let about = Reference::Point(system.image_surface().point(from));
    [DVec2::Y, DVec2::X].map(|axis| {
        let places = line(count);
        let points: Vec<DVec2> = places.iter().map(|t| *t * axis).collect();
        let aimer = Aimer::new(system);
        let front = aimer.and_then(|a| Wavefront::compute(&a, object, &points, about, true));
        let waves = front.map_or(Vec::new(), |f| f.waves());
        let points = places.iter().zip(waves).filter_map(|(t, w)| Some([*t, w.ok()?])).collect();
        Fan { wavelength_nm: system.wavelength_nm, points }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::curves::object;
    use crate::lens::builtin;
    use isoplanat_base::testing::assert_rel;

    /// The slope of a path fan is the transverse error: `∂W/∂s` over the stop against `−(n'/R) ε ∂(exit pupil)/∂s`, which for a small
    /// error is the same factor at every place of a fan. Nijboer's relation, by differences.
    #[test]
    fn path_fans_slope_as_transverse_errors_say() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let system = crate::trace::System::new(&lens, 587.5618);
        let axis = object(&lens, 0.0);
        let from = reference(&system, axis).expect("light");
        let (errors, waves) = (transverse(&system, axis, from, 201), path(&system, axis, from, 201));
        for (error, wave) in errors.iter().zip(&waves) {
            assert_eq!((error.points.len(), wave.points.len()), (201, 201));
            let slope = |k: usize| (wave.points[k + 1][1] - wave.points[k - 1][1]) / 0.02;
            let ratio = |k: usize| slope(k) / error.points[k][1];
            // Zones apart: 0.5, 0.8, 0.95 of the stop.
            assert_rel(ratio(150), ratio(180), 0.03, 0.0, "one factor over the stop");
            assert_rel(ratio(180), ratio(195), 0.03, 0.0, "one factor over the stop");
            // The factor: marginal numerical aperture over the wavelength, in waves per mm.
            let first = crate::lens::paraxial::first_order(&lens, 587.5618);
            assert_rel(ratio(150).abs(), 1.0 / (2.0 * first.working_f_number * 587.5618e-6), 0.03, 0.0, "its size");
        }
    }

    #[test]
    fn vignetted_rays_are_missing_from_fans() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let narrow = lens.changed(|l| l.surfaces[5].semi_diameter *= 0.6).expect("a lens");
        let system = crate::trace::System::new(&narrow, 587.5618);
        let point = object(&narrow, 20.0);
        let from = reference(&system, point).expect("a chief ray");
        let (errors, waves) = (transverse(&system, point, from, 41), path(&system, point, from, 41));
        assert!(errors[0].points.len() < 41 && errors[0].points.len() == waves[0].points.len());
    }
}
