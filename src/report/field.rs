//! Places along the field, from the axis to the border of what the sensor sees.

use crate::error::Result;
use crate::imaging::develop::distortion::{Distortion, fit};
use crate::lens::{Lens, paraxial};
use crate::psf::table::chief_slopes;

/// Chief rays the distortion is fitted to (paper §3.1.3).
const SAMPLES: u32 = 16;
/// Places at which the end of the field is looked for.
const FINE: u32 = 64;

/// Equidistant places on the sensor along one radius, at one object distance.
#[derive(Clone, Debug)]
pub struct FieldLine {
    /// Distance from the axis, mm; the first is 0.
    pub radius_mm: Vec<f64>,
    /// Object slope seen there by the chief ray.
    pub slope: Vec<f64>,
    /// Field angle at the paraxial entrance pupil, degrees.
    pub angle_deg: Vec<f64>,
    /// The fit between the two.
    pub distortion: Distortion,
    /// Chief rays behind the fit: object slope and image height in mm.
    pub chief: Vec<(f64, f64)>,
}

impl FieldLine {
    /// `count` places of `lens` for an object of the given vergence (1/mm), from the axis to the farthest pixel corner or
    /// to the image of the largest field angle, whichever is nearer.
    ///
    /// # Errors
    /// A sensor that sees no light on the axis; a distortion that folds.
    pub fn new(lens: &Lens, vergence: f64, count: usize) -> Result<Self> {
        lens.require_symmetry("curves over the field")?;
        let max_slope = max_slope(lens, vergence);
        let sensor = lens.sensor.radius_mm();
        let place = |share: f64| sensor * share;
        let fine: Vec<f64> = (0..=FINE).map(|i| place(f64::from(i) / f64::from(FINE))).collect();
        let slopes = chief_slopes(lens, vergence, &fine)?;
        // The field ends where its largest slope is seen, or with the sensor, or with the light.
        let seen = slopes.partition_point(|s| *s < max_slope);
        let edge = if seen < slopes.len() {
            let (a, b) = (seen.saturating_sub(1), seen.max(1));
            let part = (max_slope - slopes[a]) / (slopes[b] - slopes[a]);
            let mut near = fine[a] + part.clamp(0.0, 1.0) * (fine[b] - fine[a]);
            // A few steps along the interval's chord.
            for _ in 0..8 {
                let here = chief_slopes(lens, vergence, &[near])?[0];
                near += (max_slope - here) * (fine[b] - fine[a]) / (slopes[b] - slopes[a]);
            }
            near
        } else {
            fine[slopes.len() - 1]
        };
        let even = |n: u32| (0..n).map(|i| edge * f64::from(i) / f64::from(n.max(2) - 1)).collect::<Vec<f64>>();
        let samples = even(SAMPLES);
        let slopes = chief_slopes(lens, vergence, &samples)?;
        let distortion = fit(&slopes, &samples[..slopes.len()])?;
        let radius_mm = even(u32::try_from(count).unwrap_or(u32::MAX));
        let slope = chief_slopes(lens, vergence, &radius_mm)?;
        let radius_mm = radius_mm[..slope.len()].to_vec();
        let scale = slope_per_tangent(lens, vergence);
        let angle_deg = slope.iter().map(|s| (s / scale).atan().to_degrees()).collect();
        let chief = slopes.into_iter().zip(samples).collect();
        Ok(Self { radius_mm, slope, angle_deg, distortion, chief })
    }

    /// Image height against that of a distortion-free lens of the same scale on the axis: `(field angle in degrees,
    /// per cent)` of every chief ray off the axis.
    pub fn distortion_percent(&self, lens: &Lens, vergence: f64) -> Vec<(f64, f64)> {
        let scale = slope_per_tangent(lens, vergence);
        let per_slope = self.distortion.sensor_from_slope_derivative(0.0);
        let off_axis = self.chief.iter().filter(|(s, _)| *s > 0.0);
        off_axis.map(|(s, h)| ((s / scale).atan().to_degrees(), 100.0 * (h / (per_slope * s) - 1.0))).collect()
    }
}

/// Object slope at the first vertex per tangent of the field angle at the entrance pupil.
fn slope_per_tangent(lens: &Lens, vergence: f64) -> f64 {
    1.0 + vergence * paraxial::first_order(lens, lens.wavelengths.primary_nm).entrance_pupil_position
}

/// Object slope of the largest field angle; a lens for the axis alone gets a thousandth, so that a scale exists.
pub fn max_slope(lens: &Lens, vergence: f64) -> f64 {
    lens.max_field_deg.to_radians().tan().max(1e-3) * slope_per_tangent(lens, vergence)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::testing::assert_abs;

    #[test]
    fn places_run_from_the_axis_to_the_border_of_the_sensor_or_of_the_field() {
        // The sensor ends first.
        let lens = builtin::lens("two_element").expect("shipped");
        let line = FieldLine::new(&lens, lens.object_vergence, 5).expect("traces");
        assert_abs(line.radius_mm[4], lens.sensor.radius_mm(), 1e-12, "sensor radius");
        let slope = line.angle_deg[4].to_radians().tan() * (1.0 + 1e-3 * 14.3162);
        let seen = chief_slopes(&lens, 1e-3, &[line.radius_mm[4]]).expect("traces")[0];
        assert_abs(seen, slope, 1e-7, "the chief ray of that angle lands at the corner");
        assert_abs(line.radius_mm[0] + line.slope[0], 0.0, 0.0, "axis");
        // The field ends first.
        let mut narrow = lens.clone();
        narrow.max_field_deg = 10.0;
        let line = FieldLine::new(&narrow, narrow.object_vergence, 3).expect("traces");
        assert_abs(line.angle_deg[2], 10.0, 1e-9, "field");
        narrow.max_field_deg = 0.0;
        assert_abs(FieldLine::new(&narrow, 0.0, 1).expect("traces").radius_mm[0], 0.0, 0.0, "axis only");
    }

    /// A stated field beyond what the lens shows ends with the sensor or with the light.
    #[test]
    fn a_field_beyond_the_light_ends_with_it() {
        let mut lens = builtin::lens("cooke_triplet").expect("shipped");
        lens.max_field_deg = 80.0;
        let line = FieldLine::new(&lens, 0.0, 3).expect("traces");
        assert!(line.radius_mm[2] <= lens.sensor.radius_mm() && line.angle_deg[2] < 45.0, "{line:?}");
    }
}
