//! Clear semi-diameters from the beam: where a file states none, and where a design moves surfaces.
//!
//! A surface that is marked is opened as far as the light of the given [`Beam`]s reaches: rays through the rim of each beam's
//! pupil, at the shortest, the primary and the longest wavelength, up to the apertures of surfaces that are not marked. Tilts and
//! decentres count. Light between the rays exceeds theirs by less than 2e-3 of the radius (32 points of a rim).

use std::f64::consts::TAU;

use glam::DVec2;

use super::aim::{Aimed, Aimer};
use super::object::ObjectPoint;
use super::pupil::PupilRay;
use super::system::TraceSurface;
use super::{Failure, System};
use crate::lens::check::MAX_FIELD_DEG;
use crate::lens::{Field, Prescription, paraxial};

/// Points of a beam's rim.
const RIM_POINTS: u32 = 32;
/// A marked surface is traced with this multiple of its paraxial beam, then with more where rays miss it.
const GENEROUS: [f64; 4] = [1.5, 2.5, 5.0, 10.0];
/// Steepest chief ray of the paraxial estimate: 76°.
const STEEPEST: f64 = 4.0;
/// Rays that fail are sought long: after so many of them, beams that end early are taken as they are.
const FAILURES: u32 = 150;
/// The rim's own rays pass, whatever the rounding.
const MARGIN: f64 = 1.0 + 1e-6;

/// The light of one field: the part of the stop that it passes through, as vignetting factors state it. Pupil coordinates `p` of
/// the unit disk become `decentre + p (1 − compression)`, in parts of the stop's semi-diameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// Angle to the axis at the entrance pupil, radians.
    pub angle: f64,
    /// Meridian, radians from +x to +y.
    pub azimuth: f64,
    /// Shift of the pupil along x and y.
    pub decentre: DVec2,
    /// Compression of the pupil along x and y.
    pub compression: DVec2,
}

impl Beam {
    /// The whole stop's.
    pub fn full(angle: f64, azimuth: f64) -> Self {
        Self { angle, azimuth, decentre: DVec2::ZERO, compression: DVec2::ZERO }
    }

    /// Whole stops over the field of `lens`.
    pub(crate) fn over_field(lens: &Prescription) -> Vec<Self> {
        let azimuths: &[f64] = if lens.is_symmetric() { &[0.25] } else { &[0.0, 0.25, 0.5, 0.75] };
        let angle = |share: f64| share * lens.max_field_deg().to_radians();
        [0.0, 0.5, 0.75, 1.0]
            .iter()
            .flat_map(|share| azimuths.iter().map(move |a| Self::full(angle(*share), a * TAU)))
            .collect()
    }

    /// The point of the stop at `p` of the unit disk, in parts of its semi-diameter.
    fn point(&self, p: DVec2) -> DVec2 {
        self.decentre + p * (DVec2::ONE - self.compression)
    }
}

/// `lens` at `nm` with marked surfaces open to `generous` times their paraxial beams.
fn opened(lens: &Prescription, marked: &[bool], nm: f64, generous: f64) -> System {
    let mut system = System::new(lens, nm);
    let slope =
        lens.max_field_deg().to_radians().min(STEEPEST.atan()).tan() * paraxial::field_origin(lens).object_slope();
    let heights = paraxial::beam_heights(lens, lens.wavelengths.primary_nm, slope);
    for (i, surface) in system.surfaces.iter_mut().enumerate().take(lens.surfaces.len()) {
        if marked.get(i).copied().unwrap_or(false) && i != lens.stop {
            let wide = generous * heights[i].max(1e-3 * system.stop_semi_diameter);
            let indices = [surface.index_before, surface.index_after];
            *surface = TraceSurface {
                motion: surface.motion,
                conjugate: surface.conjugate,
                ..TraceSurface::new(surface.shape.clone(), surface.distance, indices, wide)
            };
        }
    }
    system
}

/// Sets the clear semi-diameters of the marked surfaces of `lens` to what `beams` need. Returns the field angles (radians) none of
/// whose rays arrives: their light is not counted.
pub fn open(lens: &mut Prescription, marked: &[bool], beams: &[Beam]) -> Vec<f64> {
    let mut dark = Vec::new();
    let mut heights = Vec::new();
    let mut failures = 0;
    let [short, long] = lens.wavelengths.ends_nm();
    let mut wavelengths = vec![lens.wavelengths.primary_nm, short, long];
    wavelengths.dedup();
    for generous in GENEROUS {
        (heights, dark) = (vec![0.0f64; lens.surfaces.len()], Vec::new());
        let mut lost = false;
        for &nm in &wavelengths {
            let system = opened(lens, marked, nm, generous);
            let Ok(aimer) = Aimer::new(&system) else { continue };
            for beam in beams {
                let (arrives, whole) = follow(lens, &aimer, marked, beam, &mut heights, &mut failures);
                lost |= !whole;
                if !arrives && !dark.contains(&beam.angle) {
                    dark.push(beam.angle);
                }
            }
        }
        if !lost || failures > FAILURES {
            break;
        }
    }
    for (i, surface) in lens.surfaces.iter_mut().enumerate() {
        if marked.get(i).copied().unwrap_or(false) && heights[i] > 0.0 {
            surface.semi_diameter = heights[i] * MARGIN;
        }
    }
    dark
}

/// Raises `heights` to where the rays of `beam` meet the surfaces; whether any ray arrives, and whether every one ended at an aperture
/// that the lens states, if it ended.
fn follow(
    lens: &Prescription,
    aimer: &Aimer,
    marked: &[bool],
    beam: &Beam,
    heights: &mut [f64],
    failures: &mut u32,
) -> (bool, bool) {
    let system = aimer.system();
    let object = ObjectPoint::in_field(lens, beam.angle, beam.azimuth);
    let aim =
        |p: DVec2, near: Option<&Aimed>| PupilRay::new(aimer, object, system.stop_semi_diameter * beam.point(p), near);
    // A stated aperture may clip; what a marked surface loses is for more room to find.
    let stated = |f: &Failure| f.surface < marked.len() && !marked[f.surface] && f.cause == super::Cause::Vignetted;
    let (mut arrives, mut whole) = (false, true);
    let mut centre = aim(DVec2::ZERO, None).ok().filter(|r| r.end.is_ok());
    let mut middle = DVec2::ZERO;
    if centre.is_none() {
        // A chief ray that is clipped: the first of a few points that is not.
        for k in 0..24 {
            let p = DVec2::from_angle(TAU * f64::from(k % 8) / 8.0) * (f64::from(k / 8 + 1) / 3.5);
            if let Some(ray) = aim(p, None).ok().filter(|r| r.end.is_ok()) {
                (middle, centre) = (p, Some(ray));
                break;
            }
        }
    }
    let Some(centre) = centre else { return (false, false) };
    let mut count = |ray: &PupilRay| {
        for (h, height) in ray.hits.iter().zip(heights.iter_mut()) {
            *height = height.max(h.at.point.truncate().length());
        }
        arrives = true;
    };
    count(&centre);
    for k in 0..RIM_POINTS {
        let rim = DVec2::from_angle(TAU * f64::from(k) / f64::from(RIM_POINTS));
        match aim(rim, Some(&centre.aimed)) {
            Ok(ray) if ray.end.is_ok() => count(&ray),
            other => {
                let why = other.map_or_else(Some, |r| r.end.err());
                whole &= why.is_some_and(|f| stated(&f));
                *failures += 1;
                // The last point that arrives on the way from the middle.
                let (mut low, mut high) = (0.0, 1.0);
                for _ in 0..if *failures > FAILURES { 0 } else { 12 } {
                    let at = 0.5 * (low + high);
                    match aim(middle + at * (rim - middle), Some(&centre.aimed)) {
                        Ok(ray) if ray.end.is_ok() => {
                            count(&ray);
                            low = at;
                        }
                        _ => {
                            *failures += 1;
                            high = at;
                        }
                    }
                }
            }
        }
    }
    (arrives, whole)
}

/// Where the chief ray of the field angle `angle` (radians) lands, mm from the axis, primary wavelength; marked surfaces are open.
pub(crate) fn image_height(lens: &Prescription, marked: &[bool], angle: f64) -> Option<f64> {
    let system = opened(lens, marked, lens.wavelengths.primary_nm, 2.5);
    landing(lens, &Aimer::new(&system).ok()?, angle)
}

fn landing(lens: &Prescription, aimer: &Aimer, angle: f64) -> Option<f64> {
    let object = ObjectPoint::in_field(lens, angle, TAU / 4.0);
    let ray = PupilRay::new(aimer, object, DVec2::ZERO, None).ok()?;
    let image = aimer.system().image();
    ray.hits.get(image).map(|h| h.at.point.truncate().length())
}

/// The field angle (radians) whose chief ray lands at `height` (mm) from the axis, primary wavelength; the farthest
/// angle with its height where none up to the largest field of a lens (120°) lands so far out. Marked surfaces are open.
pub(crate) fn angle_of_image_height(lens: &Prescription, marked: &[bool], height: f64) -> Option<Reached> {
    let wide = Prescription { field: Field::Angle(75.0), ..lens.clone() };
    let system = opened(&wide, marked, lens.wavelengths.primary_nm, 2.5);
    let aimer = Aimer::new(&system).ok()?;
    let landing = |angle: f64| landing(lens, &aimer, angle);
    // Outwards until it is passed, then between.
    let (mut low, mut farthest, mut high) = (0.0f64, (0.0, 0.0), None);
    let steps = (1..=1000).map(|k| 0.5 * f64::from(k)).take_while(|a| *a <= MAX_FIELD_DEG);
    for angle in steps.map(f64::to_radians) {
        match landing(angle) {
            Some(h) if h >= height => {
                high = Some(angle);
                break;
            }
            Some(h) => {
                low = angle;
                if h > farthest.1 {
                    farthest = (angle, h);
                }
            }
            None => break,
        }
    }
    let Some(mut high) = high else { return Some(Reached::UpTo { angle: farthest.0, height: farthest.1 }) };
    while high - low > 1e-13 {
        let middle = 0.5 * (low + high);
        if landing(middle)? < height {
            low = middle
        } else {
            high = middle
        }
        if middle == low && middle == high {
            break;
        }
    }
    Some(Reached::Angle(0.5 * (low + high)))
}

/// What chief rays say of an image height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Reached {
    /// The field angle, radians, whose chief ray lands there.
    Angle(f64),
    /// None lands so far out: the angle that lands farthest, radians, and where, mm.
    UpTo {
        /// Radians.
        angle: f64,
        /// mm.
        height: f64,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{Lens, builtin};
    use crate::trace::rims::beam_semi_diameters;
    use isoplanat_base::testing::assert_abs;

    fn cases() -> Vec<Lens> {
        ["cooke_triplet", "double_gauss", "phone", "two_element", "ac254_050_a"]
            .map(|n| builtin::lens(n).expect(n))
            .into()
    }

    /// Against the dense beam of a lens whose own apertures are out of the way.
    #[test]
    fn opened_surfaces_are_as_wide_as_the_beam() {
        for lens in cases() {
            let mut numbers = (*lens).clone();
            let marked = vec![true; numbers.surfaces.len()];
            let beams = Beam::over_field(&numbers);
            assert_eq!(open(&mut numbers, &marked, &beams), Vec::<f64>::new(), "{}", lens.name);
            // Rays of the rim pass all, and touch each surface's edge.
            let system = System::new(&numbers, numbers.wavelengths.primary_nm);
            let aimer = Aimer::new(&system).expect("a stop");
            for beam in &beams {
                let object = ObjectPoint::in_field(&numbers, beam.angle, beam.azimuth);
                for k in 0..RIM_POINTS {
                    let u = DVec2::from_angle(TAU * f64::from(k) / f64::from(RIM_POINTS));
                    let ray = PupilRay::new(&aimer, object, system.stop_semi_diameter * u, None).expect("aims");
                    assert_eq!(ray.end, Ok(()), "{} at {}", lens.name, beam.angle);
                }
            }
            if let Ok(whole) = Lens::new(numbers.clone(), "opened") {
                for (i, (h, s)) in beam_semi_diameters(&whole).iter().zip(&numbers.surfaces).enumerate() {
                    let stop = if i == lens.stop { system.stop_semi_diameter } else { s.semi_diameter };
                    // Colours at the ends may need a little more than the primary one.
                    assert!(*h <= stop * (1.0 + 1e-6) && *h > 0.95 * stop, "{} {i}: {h} of {stop}", lens.name);
                }
            }
        }
    }

    /// What a file states stays, and limits what follows; a vignetted field needs less.
    #[test]
    fn stated_apertures_and_vignetting_limit_the_rest() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let widths = |stated: Option<f64>, compression: f64| {
            let mut numbers = (*lens).clone();
            let mut marked = vec![true; numbers.surfaces.len()];
            if let Some(r) = stated {
                (marked[0], numbers.surfaces[0].semi_diameter) = (false, r);
            }
            let mut beams = Beam::over_field(&numbers);
            for beam in &mut beams[1..] {
                beam.compression = DVec2::splat(compression);
            }
            open(&mut numbers, &marked, &beams);
            numbers.surfaces.iter().map(|s| s.semi_diameter).collect::<Vec<_>>()
        };
        let (open, clipped, vignetted) = (widths(None, 0.0), widths(Some(6.0), 0.0), widths(None, 0.4));
        assert_eq!(clipped[0], 6.0);
        assert!(clipped[1] < open[1] && vignetted[0] < open[0], "{open:?} {clipped:?} {vignetted:?}");
    }

    #[test]
    fn image_heights_are_those_of_chief_rays() {
        for lens in cases() {
            let marked = vec![true; lens.surfaces.len()];
            let system = System::new(&lens, lens.wavelengths.primary_nm);
            let aimer = Aimer::new(&system).expect("a stop");
            for share in [0.1, 0.6, 0.9] {
                let angle = share * lens.max_field_deg().to_radians();
                let object = ObjectPoint::in_field(&lens, angle, TAU / 4.0);
                let ray = PupilRay::new(&aimer, object, DVec2::ZERO, None).expect("aims");
                let height = ray.hits[system.image()].at.point.y.abs();
                let Some(Reached::Angle(found)) = angle_of_image_height(&lens, &marked, height) else {
                    panic!("{}", lens.name)
                };
                assert_abs(found, angle, 1e-10, &lens.name);
            }
            let Some(Reached::UpTo { angle, height }) = angle_of_image_height(&lens, &marked, 1e6) else {
                panic!("1 km")
            };
            assert_abs(image_height(&lens, &marked, angle).expect("lands"), height, 1e-9, &lens.name);
        }
    }
}
