//! Places along the field, from the axis to the border of what the sensor sees.

use crate::error::{Error, Result};
use crate::imaging::distortion::{Distortion, fit};
use crate::lens::{Lens, paraxial};
use crate::psf::chief::chief_heights;
use crate::trace::{Cause, Failure};

/// Chief rays the distortion is fitted to (paper §3.1.3).
const SAMPLES: u32 = 16;

/// Equidistant places on the sensor along one radius, at one object distance.
#[derive(Clone, Debug)]
pub struct FieldLine {
    /// Distance from the axis, mm; the first is 0.
    pub radius_mm: Vec<f64>,
    /// Object slope imaged there by the fitted distortion.
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
    /// A chief ray that does not reach the sensor; a distortion that folds. The file is left empty in the error.
    pub fn new(lens: &Lens, vergence: f64, count: usize) -> Result<Self> {
        lens.require_symmetry("curves over the field")?;
        let max_slope = max_slope(lens, vergence);
        let samples: Vec<f64> = (0..SAMPLES).map(|i| max_slope * f64::from(i) / f64::from(SAMPLES - 1)).collect();
        let heights = chief_heights(lens, vergence, &samples).map_err(untraceable)?;
        let distortion = fit(&samples, &heights)?;
        let edge = distortion.sensor_from_slope(max_slope).min(lens.sensor.radius_mm());
        #[expect(clippy::cast_precision_loss, reason = "a handful of places")]
        let radius_mm: Vec<f64> = (0..count).map(|i| edge * i as f64 / (count.max(2) - 1) as f64).collect();
        // The axis itself is exact: the inverse leaves rounding there.
        let slope_at = |r: &f64| if *r == 0.0 { 0.0 } else { distortion.slope_from_sensor(*r) };
        let slope: Vec<f64> = radius_mm.iter().map(slope_at).collect();
        let scale = slope_per_tangent(lens, vergence);
        let angle_deg = slope.iter().map(|s| (s / scale).atan().to_degrees()).collect();
        let chief = samples.into_iter().zip(heights).collect();
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

/// The error of a lens whose rays do not reach the sensor; its file is empty ([`Error::in_file`] puts it in).
pub fn untraceable(failure: Failure) -> Error {
    let found = match failure.cause {
        Cause::Missed => "a ray misses it",
        Cause::Vignetted => "a ray is stopped by its clear aperture",
        Cause::TotalReflection => "a ray is totally reflected",
        Cause::NotConverged => "a ray could not be aimed or intersected",
    };
    let allowed = "every field must reach the sensor; narrow field.max_angle_deg or change the lens";
    Error::bad("", format!("surface {}", failure.surface), found, allowed)
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
        let landed = chief_heights(&lens, 1e-3, &[slope]).expect("traces")[0];
        assert_abs(landed, line.radius_mm[4], 1e-3, "the chief ray of that angle lands at the corner");
        assert_abs(line.radius_mm[0] + line.slope[0], 0.0, 0.0, "axis");
        // The field ends first.
        let mut narrow = lens.clone();
        narrow.max_field_deg = 10.0;
        let line = FieldLine::new(&narrow, narrow.object_vergence, 3).expect("traces");
        assert_abs(line.angle_deg[2], 10.0, 1e-9, "field");
        narrow.max_field_deg = 0.0;
        assert_abs(FieldLine::new(&narrow, 0.0, 1).expect("traces").radius_mm[0], 0.0, 0.0, "axis only");
    }

    #[test]
    fn a_lens_that_loses_its_chief_ray_is_an_error_that_names_the_surface() {
        let mut lens = builtin::lens("cooke_triplet").expect("shipped");
        lens.max_field_deg = 80.0;
        let error = FieldLine::new(&lens, 0.0, 3).expect_err("80 degrees do not pass").to_string();
        assert!(error.contains("surface"), "{error}");
    }
}
