//! What the farthest corner of a frame sees through a lens, and the distortion that is held there while the lens changes.

use super::SensorMap;
use crate::lens::Field;
use crate::optimize::{Constraint, Quantity};

/// How much farther than the corner object points reach, and where they end, degrees.
pub const MARGIN: f64 = 1.02;
const STEEPEST_DEG: f64 = 85.0;
/// Largest distortion at the corner, and how much more than its own a lens may get that has more.
const BARREL: f64 = 0.08;
const SLACK: f64 = 0.02;

/// The farthest corner of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Half field angle that it sees, degrees; NaN where no light comes from outside.
    pub angle_deg: f64,
    /// Distortion there.
    pub distortion: f64,
}

impl Corner {
    /// The corner `radius_mm` from the axis of a sensor with this map.
    pub fn new(map: &SensorMap, radius_mm: f64) -> Self {
        let slope = map.slope(radius_mm).abs();
        Self { angle_deg: slope.atan().to_degrees(), distortion: radius_mm * map.ratio(0.0) / slope - 1.0 }
    }

    /// The half field angle that object points reach to, degrees: the corner's and a margin.
    pub fn reach_deg(&self) -> f64 {
        (MARGIN * self.angle_deg).min(STEEPEST_DEG)
    }

    /// The field of those object points.
    pub fn field(&self) -> Field {
        Field::Angle(self.reach_deg())
    }
}

/// That what the frame sees stays what it is, at field number `outermost`, for a lens that has this distortion at the start: left alone, lenses buy sharpness by barrels
/// that see ever more. Nothing where there is no distortion to speak of.
pub fn distortion_held(distortion: f64, outermost: usize) -> Option<Constraint> {
    let bounds = [(-BARREL).min(distortion - SLACK), BARREL.max(distortion + SLACK)];
    distortion.is_finite().then_some(Constraint { quantity: Quantity::Distortion(outermost), bounds })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distortion_stays_within_bounds_or_near_what_it_is() {
        let bounds = |distortion| distortion_held(distortion, 3).map(|c| (c.quantity, c.bounds));
        assert_eq!(bounds(0.01), Some((Quantity::Distortion(3), [-0.08, 0.08])));
        assert_eq!(bounds(-0.25).map(|b| b.1), Some([-0.27, 0.08]));
        assert_eq!(bounds(f64::NAN), None);
    }

    #[test]
    fn object_points_reach_farther_and_end() {
        let of = |angle_deg| Corner { angle_deg, distortion: 0.0 };
        assert_eq!(of(50.0).field(), Field::Angle(51.0));
        assert_eq!(of(84.9).reach_deg(), 85.0);
    }
}
