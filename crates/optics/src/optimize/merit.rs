//! What a lens is judged by: object points, wavelengths, points of the stop, and what is asked of the rays there.

use std::f64::consts::FRAC_PI_2;

use glam::DVec2;

use super::sampling::{Part, nodes};
use crate::lens::{Lens, Prescription};
use crate::trace::object::LaunchPlane;
use crate::trace::{ObjectPoint, System};
use isoplanat_base::error::{Error, Result};

/// What is asked of the rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quality {
    /// Small transverse distance from the reference, mm.
    #[default]
    Spot,
    /// Small optical path difference, mm, to a sphere about the centroid (its radius taken as large against the spot).
    Wavefront,
}

/// What transverse distances count from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reference {
    /// The centroid of all rays of the object point, all wavelengths together.
    #[default]
    Centroid,
    /// The chief ray at the primary wavelength.
    Chief,
}

/// Which light counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Apertures {
    /// What the stated clear semi-diameters let through at the start; they grow where that light comes to need more room.
    #[default]
    Stated,
    /// All light through the stop; clear semi-diameters follow the beam when the work is done.
    Automatic,
}

/// The merit function's rays. Weights are relative.
#[derive(Clone, Debug, PartialEq)]
pub struct Merit {
    /// Field points: share of the lens's largest field angle, weight.
    pub fields: Vec<[f64; 2]>,
    /// Object distances as vergences, 1/mm, with weights; none: the lens's own.
    pub depths: Vec<[f64; 2]>,
    /// Radii in the stop.
    pub rings: usize,
    /// Angles in each half of the stop.
    pub arms: usize,
    /// What is asked.
    pub quality: Quality,
    /// What spots count from.
    pub reference: Reference,
    /// Which light counts.
    pub apertures: Apertures,
    /// Whether whole pupils and all sides of the field are looked at even where the lens is symmetric: for deviations that are not.
    pub whole: bool,
}

impl Default for Merit {
    fn default() -> Self {
        Self {
            fields: [0.0, 0.35, 0.6, 0.8, 1.0].map(|f| [f, 1.0]).to_vec(),
            depths: Vec::new(),
            rings: 4,
            arms: 4,
            quality: Quality::default(),
            reference: Reference::default(),
            apertures: Apertures::default(),
            whole: false,
        }
    }
}

impl Merit {
    /// Refuses numbers that make no merit; `file` names where they come from.
    ///
    /// # Errors
    /// The first number that is not allowed.
    pub(crate) fn check(&self, file: &str) -> Result<()> {
        let refuse = |place: &str, found: String, allowed: &str| Err(Error::bad(file, place, found, allowed));
        let weights = |list: &[[f64; 2]]| list.iter().all(|[_, w]| w.is_finite() && *w >= 0.0);
        let some = |list: &[[f64; 2]]| list.iter().any(|[_, w]| *w > 0.0);
        if let Some([f, _]) = self.fields.iter().find(|[f, _]| !(-1.0..=1.0).contains(f)) {
            return refuse("fields", f.to_string(), "shares of the largest field from -1 to 1");
        }
        if !weights(&self.fields) || !some(&self.fields) {
            return refuse(
                "fields",
                format!("{:?}", self.fields),
                "weights that are not negative, one of them above 0",
            );
        }
        if let Some([v, _]) = self.depths.iter().find(|[v, _]| !(0.0..=1e6).contains(v)) {
            return refuse("depths", v.recip().to_string(), "a positive distance from 1e-6 mm on, or inf");
        }
        if !weights(&self.depths) || !(self.depths.is_empty() || some(&self.depths)) {
            return refuse(
                "depths",
                format!("{:?}", self.depths),
                "weights that are not negative, one of them above 0",
            );
        }
        for (place, value) in [("rings", self.rings), ("arms", self.arms)] {
            if !(1..=64).contains(&value) {
                return refuse(place, value.to_string(), "1 to 64");
            }
        }
        Ok(())
    }
}

/// What a ray is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// It counts in the merit.
    Image,
    /// The chief ray of its object point.
    Chief,
    /// A ray at the rim of the stop: how wide the beam is.
    Rim,
}

/// An object point, held in space while the lens moves.
#[derive(Clone, Debug)]
pub(super) struct Point {
    pub(super) plane: LaunchPlane,
    pub(super) weight: f64,
    /// On the axis of a symmetric lens: the centroid stays on it.
    pub(super) axial: bool,
}

/// A ray of the merit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub(super) point: usize,
    /// In stop semi-diameters.
    pub(super) target: DVec2,
    /// Of its square in the merit, all weights of all points summing to 1.
    pub(super) weight: f64,
    pub(super) role: Role,
}

/// The rays of one wavelength.
#[derive(Clone, Debug)]
pub(super) struct Colour {
    pub(super) nm: f64,
    pub(super) primary: bool,
    pub(super) samples: Vec<Sample>,
}

/// The object points of `merit` for `lens`, and the rays of every wavelength; `share` of aperture and field.
pub(super) fn rays(merit: &Merit, lens: &Lens, share: f64) -> (Vec<Point>, Vec<Colour>) {
    let symmetric = lens.is_symmetric() && !merit.whole;
    let system = System::new(lens, lens.wavelengths.primary_nm);
    let own = [[lens.object_vergence, 1.0]];
    let depths = if merit.depths.is_empty() { &own[..] } else { &merit.depths };
    let mut points = Vec::new();
    for [vergence, depth_weight] in depths {
        let at = lens.changed(|l| l.object_vergence = *vergence);
        let lens = at.as_ref().unwrap_or(lens);
        for [field, weight] in &merit.fields {
            let angle = share * field * lens.max_field_deg().to_radians();
            let azimuths = if symmetric || angle == 0.0 { 1 } else { 4 };
            for k in 0..azimuths {
                let object = ObjectPoint::in_field(lens, angle, FRAC_PI_2 * f64::from(1 + k));
                points.push(Point {
                    plane: LaunchPlane::new(&system, object),
                    weight: weight * depth_weight / f64::from(azimuths),
                    axial: symmetric && angle == 0.0,
                });
            }
        }
    }
    let total: f64 = points.iter().map(|p| p.weight).sum();
    points.iter_mut().for_each(|p| p.weight /= total);
    let primary = lens.wavelengths.primary_nm;
    let mut shares: Vec<(f64, f64)> = lens.wavelengths.shares().collect();
    if shares.iter().all(|(nm, _)| *nm != primary) {
        shares.push((primary, 0.0));
    }
    let colour = |(nm, light): (f64, f64)| {
        let mut samples = Vec::new();
        for (i, point) in points.iter().enumerate() {
            let mut push = |target: DVec2, weight: f64, role| {
                samples.push(Sample { point: i, target: share * target, weight, role });
            };
            if nm == primary {
                push(DVec2::ZERO, 0.0, Role::Chief);
                let rims: &[DVec2] = if point.axial { &[DVec2::Y] } else { &[DVec2::Y, DVec2::NEG_Y, DVec2::X] };
                rims.iter().for_each(|t| push(*t, 0.0, Role::Rim));
            }
            let part = match (symmetric, point.axial) {
                (true, true) => Part::Arm,
                (true, false) => Part::Half,
                (false, _) => Part::Whole,
            };
            if light * point.weight > 0.0 {
                for node in nodes(part, merit.rings, merit.arms) {
                    push(node.at, point.weight * light * node.weight, Role::Image);
                }
            }
        }
        Colour { nm, primary: nm == primary, samples }
    };
    let colours = shares.into_iter().map(colour).collect();
    (points, colours)
}

/// Makes the weights of every point's remaining rays sum to the point's own.
pub(super) fn balance(points: &[Point], colours: &mut [Colour]) {
    let mut sums = vec![0.0; points.len()];
    for s in colours.iter().flat_map(|c| &c.samples) {
        sums[s.point] += s.weight;
    }
    for s in colours.iter_mut().flat_map(|c| &mut c.samples) {
        if sums[s.point] > 0.0 {
            s.weight *= points[s.point].weight / sums[s.point];
        }
    }
}

/// The clear semi-diameters up to which surfaces are looked for: the lens's own and the beam's, whichever is more.
pub(super) fn opened(numbers: &mut Prescription, heights: &[f64]) {
    for (i, s) in numbers.surfaces.iter_mut().enumerate() {
        // Conics and planes are met wherever they are; terms of higher order mean something near the beam only.
        let beam = 1.5 * heights.get(i).copied().unwrap_or(0.0);
        s.semi_diameter = if s.shape.is_aspheric() { s.semi_diameter.max(beam) } else { 1e5 };
    }
}
