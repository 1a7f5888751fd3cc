//! Curves over the field and over the zones of the stop: focus, distortion, colour, vignetting, angle on the sensor.

use std::f64::consts::FRAC_PI_2;

use glam::DVec2;
use rayon::prelude::*;

use super::beam::{Beam, Landing};
use crate::lens::{Lens, paraxial};
use crate::trace::aim::Aimer;
use crate::trace::pupil::FieldPupil;
use crate::trace::{ObjectPoint, System};

/// Half the distance of the rays that make a focus, in semi-diameters of the stop; twice of it takes the error of second order away.
const CLOSE: f64 = 2e-3;
/// Focal length over the lens's length from which it counts as afocal.
const AFOCAL: f64 = 1e6;
/// Zone that stands for the paraxial one.
const INNER: f64 = 1e-3;
/// Azimuths at which the pupil's boundary is sought; its area is good to 3e-3.
const AZIMUTHS: u32 = 32;

/// One place along the field, in the meridian of y. Lengths in mm; foci are distances behind the image plane.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldRow {
    /// Field angle at the paraxial entrance pupil, degrees.
    pub angle_deg: f64,
    /// Height of the primary wavelength's chief ray on the image plane.
    pub height: f64,
    /// Focus of rays close to the chief ray in the meridian.
    pub tangential: f64,
    /// Focus of rays close to the chief ray across the meridian.
    pub sagittal: f64,
    /// Height from where the axis lands against that of a distortion-free lens of the same scale there, per cent; 0 on the axis, not a
    /// number from 90° on, where no plane picture is free of distortion.
    pub distortion_percent: f64,
    /// The same against `f tan θ`, f the effective focal length, per cent: it holds the change of scale of a plane beside the paraxial
    /// image too. Not a number for a near object.
    pub distortion_of_focal_length: f64,
    /// Height of each wavelength's chief ray less that of the primary one.
    pub lateral_colour: Vec<f64>,
    /// Angle between the chief ray and the sensor's normal, degrees; positive where it runs outwards. On a plane sensor that is its angle to the axis.
    pub chief_angle_deg: f64,
    /// Part of the stop that no clear aperture covers.
    pub open_part: f64,
}

/// Focus of a zone of the stop for an object on the axis.
#[derive(Clone, Debug, PartialEq)]
pub struct ZoneRow {
    /// Height in the stop over its semi-diameter.
    pub zone: f64,
    /// Where the zone's two rays in the meridian of y meet, on the axis of a symmetric lens, mm behind the image plane, by wavelength;
    /// not a number where a ray does not arrive.
    pub focus: Vec<f64>,
}

/// The object point of a field angle (degrees), in the meridian of y.
pub fn object(lens: &Lens, angle_deg: f64) -> ObjectPoint {
    ObjectPoint::in_field(lens, angle_deg.to_radians(), FRAC_PI_2)
}

/// Angle to the sensor's normal, in the meridian, of a ray that moves by `slope` along a sensor that moves by 1, which has the slope `steep` there.
fn incidence(slope: f64, steep: f64) -> f64 {
    (slope / (1.0 + slope * steep)).atan() + steep.atan()
}

/// Focus of two rays, mm behind the image surface, along `axis`.
fn crossing(a: &Landing, b: &Landing, axis: DVec2) -> f64 {
    -(a.at - b.at).dot(axis) / (a.slope - b.slope).dot(axis)
}

/// Foci of rays close to the chief ray, tangential and sagittal, mm behind the image plane. Apertures are left out. None where such a
/// ray does not arrive.
pub(crate) fn parabasal_foci(system: &System, object: ObjectPoint) -> Option<[f64; 2]> {
    let open = unclipped(system);
    let places = |h: f64| [DVec2::Y * h, DVec2::NEG_Y * h, DVec2::X * h, DVec2::NEG_X * h];
    let points = [places(CLOSE), places(2.0 * CLOSE)].concat();
    let beam = Beam::new(&open, object, &points);
    let l: &[Landing; 8] = beam.landings.as_slice().try_into().ok()?;
    let foci = [(0, DVec2::Y), (2, DVec2::X)].map(|(k, axis)| {
        let [near, far] = [k, k + 4].map(|k| crossing(&l[k], &l[k + 1], axis));
        (4.0 * near - far) / 3.0
    });
    foci.iter().all(|z| z.is_finite()).then_some(foci)
}

/// The same system with no clear aperture but the stop.
fn unclipped(system: &System) -> System {
    let mut open = system.clone();
    open.surfaces.iter_mut().for_each(|s| s.semi_diameter = f64::INFINITY);
    open
}

/// The curves at `angles_deg` for `wavelengths_nm`; places whose chief ray does not arrive are left out. All threads.
pub fn over_field(lens: &Lens, wavelengths_nm: &[f64], angles_deg: &[f64]) -> Vec<FieldRow> {
    let primary = System::new(lens, lens.wavelengths.primary_nm);
    let systems: Vec<System> = wavelengths_nm.iter().map(|nm| System::new(lens, *nm)).collect();
    let chief = |system: &System, angle: f64| Beam::new(system, object(lens, angle), &[]).chief;
    let largest = angles_deg.iter().copied().fold(0.0, f64::max);
    let near = 1e-3 * largest;
    // Zero but for tilted lenses, whose axis lands elsewhere.
    let origin = chief(&primary, 0.0).map_or(f64::NAN, |l| l.at.y);
    let scale = chief(&primary, near).map_or(f64::NAN, |l| (l.at.y - origin) / near.to_radians().tan());
    let focal = match lens.object_vergence {
        0.0 => Some(paraxial::first_order(lens, lens.wavelengths.primary_nm).effective_focal_length),
        _ => None,
    };
    // An afocal lens has none, however rounding leaves it.
    let focal = focal.filter(|f| f.abs() < AFOCAL * lens.length().abs().max(1.0)).unwrap_or(f64::NAN);
    // Per cent against `by`, mm per unit of the field angle's tangent.
    let against = |by: f64, angle: f64, height: f64| match angle {
        // What it tends to.
        0.0 => 100.0 * (scale / by - 1.0),
        _ if angle.abs() >= 90.0 => f64::NAN,
        _ => 100.0 * ((height - origin) / (by * angle.to_radians().tan()) - 1.0),
    };
    let row = |&angle: &f64| {
        let at = chief(&primary, angle)?;
        let [tangential, sagittal] = parabasal_foci(&primary, object(lens, angle)).unwrap_or([f64::NAN; 2]);
        let height = at.at.y;
        let colour = |s| chief(s, angle).map_or(f64::NAN, |l: Landing| l.at.y - height);
        let open_part =
            Aimer::new(&primary).map_or(0.0, |a| FieldPupil::new(&a, object(lens, angle), AZIMUTHS).area_fraction);
        Some(FieldRow {
            angle_deg: angle,
            height,
            tangential,
            sagittal,
            // A field of the axis alone has no scale.
            distortion_percent: if angle == 0.0 { 0.0 } else { against(scale, angle, height) },
            distortion_of_focal_length: against(focal, angle, height),
            lateral_colour: systems.iter().map(colour).collect(),
            chief_angle_deg: incidence(at.slope.y, primary.image_surface().slope(at.at).y).to_degrees(),
            open_part,
        })
    };
    angles_deg.par_iter().filter_map(row).collect()
}

/// Foci of `zones` evenly spaced zones from the axis to the stop's rim, an object on the axis.
pub(crate) fn over_zones(lens: &Lens, wavelengths_nm: &[f64], zones: u32) -> Vec<ZoneRow> {
    let systems: Vec<System> = wavelengths_nm.iter().map(|nm| System::new(lens, *nm)).collect();
    let row = |k: u32| {
        let zone = (f64::from(k) / f64::from(zones.max(2) - 1)).max(INNER);
        let focus = |s: &System| {
            let beam = Beam::new(s, object(lens, 0.0), &[DVec2::Y * zone, DVec2::NEG_Y * zone]);
            if let [a, b] = &beam.landings[..] { crossing(a, b, DVec2::Y) } else { f64::NAN }
        };
        ZoneRow { zone, focus: systems.iter().map(focus).collect() }
    };
    (0..zones.max(2)).map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{Shape, builtin};
    use crate::trace::system::TraceSurface;
    use isoplanat_base::testing::{assert_abs, assert_rel};

    /// A. Gullstrand's and Coddington's equations at one sphere with the stop on it, collimated light at 25°:
    /// `n' cos²θ'/t = (n' cosθ' − cosθ) c`, `n'/s = (n' cosθ' − cosθ) c`, distances along the chief ray.
    #[test]
    fn foci_at_one_sphere_are_those_of_coddington() {
        let (n, c, distance) = (1.6f64, 1.0 / 40.0, 60.0);
        let surfaces = vec![
            TraceSurface::new(Shape::sphere(c), 0.0, [1.0, n], 40.0),
            TraceSurface::new(Shape::default(), distance, [n, n], f64::INFINITY),
        ];
        let system = System { wavelength_nm: 550.0, surfaces, stop: 0, stop_semi_diameter: 5.0 };
        let angle = 25f64.to_radians();
        let [tangential, sagittal] =
            parabasal_foci(&system, ObjectPoint::from_angle(angle, FRAC_PI_2, 0.0)).expect("light");
        let refracted = (angle.sin() / n).asin();
        let power = (n * refracted.cos() - angle.cos()) * c;
        let along_axis = |path: f64| path * refracted.cos() - distance;
        assert_abs(tangential, along_axis(n * refracted.cos().powi(2) / power), 1e-8, "tangential");
        assert_abs(sagittal, along_axis(n / power), 1e-8, "sagittal");
    }

    #[test]
    fn curves_begin_at_the_paraxial_image() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let nm: Vec<f64> = lens.wavelengths.nm.clone();
        let rows = over_field(&lens, &nm, &[0.0, 10.0, 20.0]);
        assert_eq!(rows.len(), 3);
        let last = lens.surfaces[lens.surfaces.len() - 1].thickness;
        let image = paraxial::first_order(&lens, lens.wavelengths.primary_nm).paraxial_image_distance - last;
        for focus in [rows[0].tangential, rows[0].sagittal] {
            assert_abs(focus, image, 1e-6, "focus on the axis");
        }
        let zones = over_zones(&lens, &nm, 5);
        for (k, nm) in nm.iter().enumerate() {
            let image = paraxial::first_order(&lens, *nm).paraxial_image_distance - last;
            assert_abs(zones[0].focus[k], image, 1e-5, "focus of the inmost zone");
        }
        // Third-order figures of the same lens: Petzval and astigmatism of small fields.
        let small = over_field(&lens, &nm, &[0.0, 0.5]);
        let sums = crate::lens::seidel::total(&crate::lens::seidel::per_surface(&lens, lens.wavelengths.primary_nm));
        let first = paraxial::first_order(&lens, lens.wavelengths.primary_nm);
        let part = (0.5f64.to_radians().tan() / lens.max_field_deg().to_radians().tan()).powi(2);
        // Welford: the tangential surface lies −(3 S_III + S_IV)/(2 n'u'²) from the image plane, the sagittal −(S_III + S_IV)/(2 n'u'²).
        let by = 2.0 * first.working_f_number.powi(2) * part;
        let expected = [3.0 * sums.astigmatism + sums.petzval, sums.astigmatism + sums.petzval].map(|s| -by * s);
        let found = [small[1].tangential - small[0].tangential, small[1].sagittal - small[0].sagittal];
        for (f, e) in found.into_iter().zip(expected) {
            assert_rel(f, e, 5e-3, 0.0, "curvature of the image");
        }
        assert_eq!(rows[0].distortion_percent, 0.0);
        assert!(rows[0].lateral_colour.iter().all(|c| c.abs() < 1e-12) && rows[0].open_part > 0.999);
    }

    /// A tilt moves the picture; that is no distortion.
    #[test]
    fn a_displaced_picture_is_not_distorted() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let straight = over_field(&lens, &[587.5618], &[0.0, 10.0]);
        let tilt = |l: &mut crate::lens::Prescription| {
            let tilt = [0.5f64.to_radians(), 0.0, 0.0];
            l.surfaces[5].pose = Some(crate::lens::Pose { decentre: [0.0; 2], tilt });
        };
        let tilted = over_field(&lens.changed(tilt).expect("a lens"), &[587.5618], &[0.0, 10.0]);
        assert!((tilted[0].height - straight[0].height).abs() > 0.05, "{tilted:?}");
        assert!((tilted[1].distortion_percent - straight[1].distortion_percent).abs() < 0.5, "{tilted:?}");
    }

    #[test]
    fn a_field_that_no_chief_ray_reaches_is_left_out() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let rows = over_field(&lens, &[587.6], &[0.0, 20.0, 88.0]);
        assert!((2..=3).contains(&rows.len()) && rows.iter().all(|r| r.height.is_finite()), "{rows:?}");
    }
}
