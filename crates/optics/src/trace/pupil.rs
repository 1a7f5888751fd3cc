//! The pupil of one object point: chief and marginal rays, and the part of the real stop that no aperture clips.
//!
//! Every ray is aimed at the stop. The unvignetted part of the stop is described by its boundary, seen from a point
//! inside: the stop's centre or, where an aperture clips the chief ray itself, the middle of what is left. Apertures
//! are hard here; the soft edge for gradients belongs to `psf`.

use std::f64::consts::{PI, TAU};

use glam::DVec2;

use super::aim::{Aimed, Aimer};
use super::object::ObjectPoint;
use super::sequential::{Hit, first_vignetted, trace};
use super::{Failure, Ray, System};

/// An aimed ray followed to the image.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PupilRay {
    /// The ray.
    pub aimed: Aimed,
    /// Its hits, as far as it gets; not clipped.
    pub hits: Vec<Hit>,
    /// What ends it before the image: a clear aperture, a missed surface, total reflection.
    pub end: Result<(), Failure>,
}

/// One point of the pupil's boundary.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BoundaryPoint {
    /// Where it lies in the stop, mm.
    pub target: DVec2,
    /// The ray through it, frame of the first vertex: its origin lies on the launch plane, so that the origins outline
    /// the beam that enters.
    pub ray: Ray,
    /// What ends the rays beyond; `None` is the stop's own rim.
    pub limit: Option<Failure>,
}

/// The pupil of one object point and wavelength.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FieldPupil {
    /// The object.
    pub object: ObjectPoint,
    /// The ray through the stop's centre; it may end in a clear aperture.
    pub chief: Result<PupilRay, Failure>,
    /// The rays through the stop's rim at +y, −y, −x, +x.
    pub marginal: [Result<PupilRay, Failure>; 4],
    /// The point of the stop from which the boundary is seen, mm; `None` if no ray survives.
    pub centre: Option<DVec2>,
    /// The boundary, azimuth by azimuth around the centre; empty if no ray survives.
    pub boundary: Vec<BoundaryPoint>,
    /// Unvignetted part of the stop's area, 0 to 1: the vignetting factor.
    pub area_fraction: f64,
}

/// Boundary points are found to this part of the stop's semi-diameter.
const TOLERANCE: f64 = 1e-10;

impl PupilRay {
    /// Aims at `target` (mm in the stop) and follows the ray.
    pub(crate) fn new(
        aimer: &Aimer,
        object: ObjectPoint,
        target: DVec2,
        near: Option<&Aimed>,
    ) -> Result<Self, Failure> {
        let aimed = aimer.aim(object, target, near)?;
        let system = aimer.system();
        let mut hits = Vec::with_capacity(system.surfaces.len());
        let traced = trace(system, aimed.ray, system.image(), &mut hits).map(|_| ());
        let end = first_vignetted(system, &hits).map_or(traced, Err);
        Ok(Self { aimed, hits, end })
    }

    /// How far inside all apertures the ray passes, in parts of the nearest one's semi-diameter; negative outside.
    fn clearance(&self, system: &System) -> f64 {
        if self.hits.len() < system.surfaces.len() {
            return -1.0;
        }
        let inside = |(i, (h, s)): (usize, (&Hit, &super::system::TraceSurface))| {
            let counts = i != system.stop && s.semi_diameter.is_finite();
            counts.then(|| 1.0 - h.at.point.truncate().length() / s.semi_diameter)
        };
        self.hits.iter().zip(&system.surfaces).enumerate().filter_map(inside).fold(1.0, f64::min)
    }
}

impl FieldPupil {
    /// The pupil of `object`, its boundary at `azimuths` points (32 give the area to about 3e-3).
    pub(crate) fn new(aimer: &Aimer, object: ObjectPoint, azimuths: u32) -> Self {
        let radius = aimer.system().stop_semi_diameter;
        let chief = PupilRay::new(aimer, object, DVec2::ZERO, None);
        let near = chief.as_ref().ok().map(|c| c.aimed.clone());
        let marginal = [DVec2::Y, DVec2::NEG_Y, DVec2::NEG_X, DVec2::X]
            .map(|rim| PupilRay::new(aimer, object, radius * rim, near.as_ref()));
        let mut pupil = Self { object, chief, marginal, centre: None, boundary: Vec::new(), area_fraction: 0.0 };
        let inside = match &pupil.chief {
            Ok(c) if c.end.is_ok() => Some(c.clone()),
            _ => survivor(aimer, object, near.as_ref()),
        };
        let Some(mut inside) = inside else { return pupil };
        let central = pupil.chief.as_ref().is_ok_and(|c| c.end.is_ok());
        let mut centre = DVec2::ZERO;
        if !central {
            // A first boundary from any surviving ray, then a better one from its middle.
            centre = inside.aimed.hits.last().map_or(centre, |h| h.at.point.truncate());
            let rough = outline(aimer, &inside, centre, azimuths);
            let middle = centroid(centre, &rough);
            if let Ok(better) = PupilRay::new(aimer, object, middle, Some(&inside.aimed))
                && better.end.is_ok()
            {
                (inside, centre) = (better, middle);
            }
        }
        pupil.boundary = outline(aimer, &inside, centre, azimuths);
        pupil.centre = Some(centre);
        let sum: f64 = pupil.boundary.iter().map(|b| (b.target - centre).length_squared()).sum();
        pupil.area_fraction = sum / (f64::from(azimuths) * radius * radius);
        pupil
    }

    /// Whether any ray of the object reaches the image.
    #[cfg(test)]
    pub(crate) fn is_open(&self) -> bool {
        self.centre.is_some()
    }

    /// The entrance pupil's middle as the chief ray shows it: the point where it crosses the axis or passes nearest to
    /// it, mm. `None` for a chief ray along the axis, or without one.
    #[cfg(test)]
    pub(crate) fn entrance_pupil(&self) -> Option<glam::DVec3> {
        let ray = self.chief.as_ref().ok()?.aimed.ray;
        let across = ray.direction.truncate();
        let t = -ray.origin.truncate().dot(across) / across.length_squared();
        let point = ray.origin + t * ray.direction;
        point.is_finite().then_some(point)
    }
}

/// Boundary of the surviving part around `centre`, whose own ray is `inside`.
fn outline(aimer: &Aimer, inside: &PupilRay, centre: DVec2, azimuths: u32) -> Vec<BoundaryPoint> {
    let radius = aimer.system().stop_semi_diameter;
    (0..azimuths)
        .map(|k| {
            let u = DVec2::from_angle(TAU * f64::from(k) / f64::from(azimuths));
            // From the centre to the stop's rim.
            let b = centre.dot(u);
            let rim = (b * b + radius * radius - centre.length_squared()).max(0.0).sqrt() - b;
            let (mut low, mut high) = (0.0, rim);
            let mut last = inside.aimed.clone();
            let mut limit = None;
            let mut at = rim;
            loop {
                match PupilRay::new(aimer, inside.aimed.plane.object, centre + at * u, Some(&last)) {
                    Ok(ray) if ray.end.is_ok() => {
                        low = at;
                        last = ray.aimed;
                        if at == rim {
                            break;
                        }
                    }
                    other => {
                        limit = other.map_or_else(Some, |r| r.end.err());
                        high = at;
                    }
                }
                if high - low <= TOLERANCE * radius {
                    break;
                }
                at = 0.5 * (low + high);
            }
            BoundaryPoint { target: centre + low * u, ray: last.ray, limit }
        })
        .collect()
}

/// Middle of the area that `boundary` encloses.
fn centroid(centre: DVec2, boundary: &[BoundaryPoint]) -> DVec2 {
    let (mut area, mut moment) = (0.0, DVec2::ZERO);
    for b in boundary {
        let r = b.target - centre;
        area += r.length_squared();
        moment += r * r.length_squared();
    }
    let shift = moment * (2.0 / 3.0) / area;
    if shift.is_finite() { centre + shift } else { centre }
}

/// A ray that survives though the chief ray does not: the clearest of a raster, then uphill.
fn survivor(aimer: &Aimer, object: ObjectPoint, near: Option<&Aimed>) -> Option<PupilRay> {
    const RINGS: u32 = 6;
    const AZIMUTHS: u32 = 16;
    let (system, radius) = (aimer.system(), aimer.system().stop_semi_diameter);
    let look = |target: DVec2| {
        let ray = PupilRay::new(aimer, object, target, near).ok()?;
        let clearance = ray.clearance(system);
        Some((clearance, target, ray))
    };
    let better = |best: Option<(f64, DVec2, PupilRay)>, new: Option<(f64, DVec2, PupilRay)>| match (best, new) {
        (Some(a), Some(b)) => Some(if b.0 > a.0 { b } else { a }),
        (a, b) => a.or(b),
    };
    let mut best = None;
    for ring in 1..=RINGS {
        for k in 0..AZIMUTHS {
            let r = radius * f64::from(ring) / f64::from(RINGS);
            best = better(best, look(r * DVec2::from_angle(2.0 * PI * f64::from(k) / f64::from(AZIMUTHS))));
        }
    }
    let mut step = 0.5 * radius / f64::from(RINGS);
    let mut best = best?;
    while best.0 <= 0.0 && step > 1e-4 * radius {
        let before = best.0;
        for k in 0..8 {
            let target = best.1 + step * DVec2::from_angle(TAU * f64::from(k) / 8.0);
            if target.length() <= radius {
                best = better(Some(best), look(target))?;
            }
        }
        if best.0 <= before {
            step *= 0.5;
        }
    }
    (best.0 > 0.0 && best.2.end.is_ok()).then_some(best.2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{builtin, unchecked};
    use crate::trace::Cause;
    use crate::trace::test_lenses::nikkor_180;
    use isoplanat_base::testing::{assert_abs, assert_rel};

    /// Counts surviving rays of a dense raster of the stop, each aimed and clipped by itself.
    fn counted(aimer: &Aimer, object: ObjectPoint) -> f64 {
        let radius = aimer.system().stop_semi_diameter;
        let (mut all, mut alive) = (0.0, 0.0);
        for i in 0..200 {
            for j in 0..200 {
                let target = radius * DVec2::new(f64::from(i) - 99.5, f64::from(j) - 99.5) / 100.0;
                if target.length() <= radius {
                    all += 1.0;
                    let ray = PupilRay::new(aimer, object, target, None);
                    alive += f64::from(u8::from(ray.is_ok_and(|r| r.end.is_ok())));
                }
            }
        }
        alive / all
    }

    #[test]
    fn area_fractions_agree_with_counted_rays() {
        let cases = [("cooke_triplet", 0.3), ("double_gauss", 0.2), ("double_gauss", 0.3), ("two_element", 0.4)];
        let mut clipped = 0;
        for (name, angle) in cases {
            let lens = builtin::lens(name).expect("shipped");
            let mut system = System::new(&lens, 550.0);
            let object = ObjectPoint::from_angle(angle, 1.3, lens.object_vergence);
            // First and last surface are cut so that each takes a part of the beam.
            let open = FieldPupil::new(&Aimer::new(&system).expect("has a stop"), object, 4);
            for (surface, part) in [(0, 0.4), (system.image() - 1, 0.6)] {
                let height = |r: &PupilRay| r.hits[surface].at.point.truncate().length();
                let chief = height(open.chief.as_ref().expect("aims"));
                let far = open.marginal.iter().map(|m| height(m.as_ref().expect("aims"))).fold(0.0, f64::max);
                system.surfaces[surface].semi_diameter = chief + part * (far - chief);
            }
            let aimer = Aimer::new(&system).expect("has a stop");
            let pupil = FieldPupil::new(&aimer, object, 64);
            let expected = counted(&aimer, object);
            eprintln!("{name} {angle}: {} open, counted {expected}", pupil.area_fraction);
            assert_abs(pupil.area_fraction, expected, 3e-3, name);
            clipped += u32::from(pupil.area_fraction < 0.99);
            for b in &pupil.boundary {
                // On the boundary: alive, and dead a little further out (at the rim: outside the stop).
                let alive = PupilRay::new(&aimer, object, b.target, None).expect("aims");
                assert!(alive.end.is_ok(), "{name}: {:?}", alive.end);
                match b.limit {
                    None => assert_rel(b.target.length(), system.stop_semi_diameter, 1e-9, 0.0, "rim"),
                    Some(f) => {
                        let beyond = b.target + 1e-6 * (b.target - pupil.centre.expect("open"));
                        let dead = PupilRay::new(&aimer, object, beyond, None).expect("aims");
                        assert_eq!(dead.end, Err(f), "{name}");
                        assert_eq!(first_vignetted(&system, &dead.hits).map(|f| f.cause), Some(Cause::Vignetted));
                    }
                }
            }
        }
        assert!(clipped == 4, "{clipped} vignetted pupils");
    }

    /// On the axis: the whole stop, and rays that are mirror images of each other.
    #[test]
    fn the_axis_has_a_round_pupil() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let system = System::new(&lens, lens.wavelengths.primary_nm);
        let aimer = Aimer::new(&system).expect("has a stop");
        let pupil = FieldPupil::new(&aimer, ObjectPoint::from_angle(0.0, 0.0, lens.object_vergence), 32);
        assert_abs(pupil.area_fraction, 1.0, 1e-9, "area");
        assert!(pupil.boundary.iter().all(|b| b.limit.is_none()));
        assert_eq!(pupil.entrance_pupil(), None);
        let [top, bottom, left, right] = pupil.marginal.map(|m| m.expect("aims").aimed.ray.origin);
        assert!((top + bottom).truncate().length() < 1e-9 && (left + right).truncate().length() < 1e-9);
        assert_abs(top.y, right.x, 1e-9, "round");
        // Near the axis the chief ray crosses it in the paraxial entrance pupil.
        let pupil = FieldPupil::new(&aimer, ObjectPoint::from_angle(1e-4, 0.7, 0.0), 4);
        let first = crate::lens::paraxial::first_order(&lens, lens.wavelengths.primary_nm);
        assert_abs(pupil.entrance_pupil().expect("inclined").z, first.entrance_pupil_position, 1e-5, "pupil");
    }

    /// The pupil of a fisheye moves towards the light and stays open at 90°.
    #[test]
    fn a_fisheye_has_a_pupil_at_ninety_degrees() {
        // Room for the pupil's wandering.
        let lens = unchecked(&nikkor_180(), |l| l.surfaces.iter_mut().for_each(|s| s.semi_diameter *= 1.3));
        let system = System::new(&lens, 587.5618);
        let aimer = Aimer::new(&system).expect("has a stop");
        let z = |angle: f64| {
            let pupil = FieldPupil::new(&aimer, ObjectPoint::from_angle(angle, 0.3, 0.0), 16);
            eprintln!("{angle}: {} open, pupil {:?}", pupil.area_fraction, pupil.entrance_pupil());
            assert!(pupil.area_fraction > 0.3);
            pupil.entrance_pupil().expect("inclined").z
        };
        let (near, half, full) = (z(1e-3), z(0.8), z(1.57));
        assert!(near > half && half > full, "{near} {half} {full}");
    }

    /// A small first aperture beside the chief ray: the ray is data, the pupil is found beside it, or there is none.
    #[test]
    fn the_chief_ray_may_be_vignetted() {
        let lens = builtin::lens("double_gauss").expect("shipped");
        let system = System::new(&lens, 550.0);
        let aimer = Aimer::new(&system).expect("has a stop");
        let object = ObjectPoint::from_angle(0.3, 0.0, lens.object_vergence);
        let chief = PupilRay::new(&aimer, object, DVec2::ZERO, None).expect("aims");
        let height = chief.hits[0].at.point.truncate().length();
        let mut last = 1.0;
        for part in [1.1, 0.95, 0.8, 0.6] {
            let mut narrow = System::new(&lens, 550.0);
            narrow.surfaces[0].semi_diameter = part * height;
            let aimer = Aimer::new(&narrow).expect("has a stop");
            let pupil = FieldPupil::new(&aimer, object, 64);
            let ended = pupil.chief.as_ref().expect("aims").end;
            let expected = if part < 1.0 { Err(Failure { cause: Cause::Vignetted, surface: 0 }) } else { Ok(()) };
            assert_eq!(ended, expected);
            assert!(pupil.is_open(), "{part}");
            assert_abs(pupil.area_fraction, counted(&aimer, object), 3e-3, "area");
            assert!(pupil.area_fraction < last, "{part}");
            last = pupil.area_fraction;
        }
        let mut shut = System::new(&lens, 550.0);
        // Through the first surface's middle, but not through the last one's as well.
        let last = shut.image() - 1;
        for surface in [0, last] {
            shut.surfaces[surface].semi_diameter = 1e-3 * height;
        }
        let pupil = FieldPupil::new(&Aimer::new(&shut).expect("has a stop"), object, 32);
        assert!(!pupil.is_open() && pupil.boundary.is_empty() && pupil.area_fraction == 0.0);
    }
}
