//! All rays of one object point and wavelength, over the stop: where they land, how steeply, and how much light each stands for.

use glam::DVec2;

use crate::psf::stop::equal_area_rings;
use crate::trace::aim::Aimer;
use crate::trace::pupil::PupilRay;
use crate::trace::{Cause, Failure, ObjectPoint, System};
use isoplanat_base::stop::look;

/// Where one ray meets the image surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landing {
    /// Point of the unit stop that it was aimed at.
    pub stop: DVec2,
    /// Place on the image surface, mm.
    pub at: DVec2,
    /// Slopes `dx/dz`, `dy/dz`: with the image surface `dz` mm behind its place the ray is at `at + dz · slope`. (Of a curved one as on the plane that touches it where
    /// the ray lands.)
    pub slope: DVec2,
    /// Light that it stands for, in units of its beam (`Aimer::flux`).
    pub weight: f64,
}

impl Landing {
    /// Place with the image surface moved by `dz` mm.
    pub fn at_focus(&self, dz: f64) -> DVec2 {
        self.at + dz * self.slope
    }
}

/// Rays of one object point and wavelength that reach the image surface within all clear apertures.
#[derive(Clone, Debug)]
pub struct Beam {
    /// The object.
    pub object: ObjectPoint,
    /// Wavelength, nm.
    pub wavelength_nm: f64,
    /// The ray through the stop's middle, whether or not an aperture stops it; none where it does not land.
    pub chief: Option<Landing>,
    /// What arrives, in the order of the asked points.
    pub landings: Vec<Landing>,
    /// Rays asked for.
    pub asked: usize,
    /// Rays that end at a clear aperture.
    pub vignetted: usize,
    /// Why the chief ray, or where there is one the first ray that no aperture stopped, does not arrive.
    pub failure: Option<Failure>,
}

/// About `count` points of the unit disk that stand for equal areas, symmetric about both axes.
pub fn stop_points(count: usize) -> Vec<DVec2> {
    let mut points = equal_area_rings(count);
    points.extend_from_within(..);
    let half = points.len() / 2;
    points[half..].iter_mut().for_each(|p| p.x = -p.x);
    points
}

impl Beam {
    /// The rays of `object` through `points` of the unit stop.
    pub fn new(system: &System, object: ObjectPoint, points: &[DVec2]) -> Self {
        let empty = Self {
            object,
            wavelength_nm: system.wavelength_nm,
            chief: None,
            landings: Vec::new(),
            asked: points.len(),
            vignetted: 0,
            failure: None,
        };
        let aimer = match Aimer::new(system) {
            Ok(aimer) => aimer,
            Err(failure) => return Self { failure: Some(failure), ..empty },
        };
        let mut beam = empty;
        let chief = PupilRay::new(&aimer, object, DVec2::ZERO, None);
        let mut near = chief.as_ref().ok().map(|c| c.aimed.clone());
        match &chief {
            Ok(ray) => beam.chief = landing(&aimer, ray, DVec2::ZERO),
            Err(failure) => beam.failure = Some(*failure),
        }
        for point in points {
            look();
            let ray = PupilRay::new(&aimer, object, *point * system.stop_semi_diameter, near.as_ref());
            let end = ray.as_ref().map_err(|f| *f).and_then(|r| r.end);
            match (&ray, end) {
                (Ok(ray), Ok(())) => beam.landings.extend(landing(&aimer, ray, *point)),
                (_, Err(Failure { cause: Cause::Vignetted, .. })) => beam.vignetted += 1,
                (_, Err(failure)) => beam.failure = beam.failure.or(Some(failure)),
                (Err(_), Ok(())) => {}
            }
            if let Ok(ray) = ray {
                near = Some(ray.aimed);
            }
        }
        beam
    }

    /// Part of the asked rays that arrive.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub(crate) fn open_part(&self) -> f64 {
        self.landings.len() as f64 / self.asked.max(1) as f64
    }
}

/// The end of a ray that gets to the image surface.
fn landing(aimer: &Aimer, ray: &PupilRay, stop: DVec2) -> Option<Landing> {
    let last = ray.hits.get(aimer.system().image())?;
    let (d, steep) = (last.direction, DVec2::from(last.at.local.slope));
    let slope = d.truncate() / (d.z - d.truncate().dot(steep));
    let weight = aimer.flux(&ray.aimed);
    let found = Landing { stop, at: last.at.point.truncate(), slope, weight };
    (found.at.is_finite() && slope.is_finite() && weight.is_finite()).then_some(found)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use crate::lens::builtin;
    use isoplanat_base::testing::assert_rel;

    #[test]
    fn points_stand_for_equal_areas() {
        for count in [8, 100, 1000] {
            let points = stop_points(count);
            #[expect(clippy::cast_precision_loss, reason = "small counts")]
            let mean = |f: &dyn Fn(&DVec2) -> f64| points.iter().map(f).sum::<f64>() / points.len() as f64;
            // The moments of the unit disk: ⟨r²⟩ = 1/2, ⟨x⟩ = ⟨y⟩ = ⟨xy⟩ = 0.
            assert!(
                (mean(&|p| p.length_squared()) - 0.5).abs() < 2.0 / f64::from(u32::try_from(count).expect("small"))
            );
            assert!(mean(&|p| p.x).abs() < 1e-12 && mean(&|p| p.y).abs() < 0.02 && mean(&|p| p.x * p.y).abs() < 1e-12);
        }
    }

    /// Of a far object the light is what falls on the entrance pupil: the sum of the weights is its area.
    #[test]
    fn weights_add_up_to_the_light_that_enters() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let system = System::new(&lens, 587.5618);
        let points = stop_points(400);
        let beam = Beam::new(&system, ObjectPoint::in_field(&lens, 0.0, FRAC_PI_2), &points);
        assert_eq!((beam.landings.len(), beam.vignetted), (points.len(), 0));
        // A ray bundle from the rim inwards: mean of 1/det over the disk is the ratio of areas of the beam before the lens and the stop.
        let mean = beam.landings.iter().map(|l| l.weight).sum::<f64>() / beam.landings.len() as f64;
        let aimer = Aimer::new(&system).expect("a stop");
        let rim = aimer.aim(beam.object, DVec2::Y * system.stop_semi_diameter, None).expect("light");
        let ratio = (rim.ray.origin.truncate().length() / system.stop_semi_diameter).powi(2);
        assert_rel(mean, ratio, 1e-3, 0.0, "area of the light that enters");
        // Weights are not all alike, so the sum is no accident.
        let spread = beam.landings.iter().fold([f64::INFINITY, 0.0f64], |[a, b], l| [a.min(l.weight), b.max(l.weight)]);
        assert!(spread[1] / spread[0] > 1.005, "{spread:?}");
    }

    #[test]
    fn what_apertures_stop_is_counted_and_failures_are_told() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let system = System::new(&lens, 587.5618);
        let points = stop_points(300);
        let edge = Beam::new(&system, ObjectPoint::in_field(&lens, 20f64.to_radians(), FRAC_PI_2), &points);
        let narrow = lens.changed(|l| l.surfaces[5].semi_diameter *= 0.7).expect("a lens");
        let cut = Beam::new(&System::new(&narrow, 587.5618), edge.object, &points);
        assert!(cut.vignetted > edge.vignetted && cut.vignetted + cut.landings.len() == points.len(), "{cut:?}");
        let far = Beam::new(&system, ObjectPoint::in_field(&lens, 1.5, FRAC_PI_2), &points);
        assert!(far.landings.is_empty() && (far.failure.is_some() || far.vignetted == points.len()));
        assert_eq!(far.open_part(), 0.0);
    }
}
