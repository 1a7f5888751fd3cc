//! Places along the field, from the axis to the border of what the sensor sees.

use super::table::significant;
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::lens::{Lens, paraxial};
use isoplanat_optics::psf::table::{STEEPEST, chief_slopes};

/// Chief rays of a distortion curve.
const SAMPLES: u32 = 16;
/// Places at which the end of the field is looked for, and halvings between two of them.
const FINE: (u32, u32) = (64, 52);
/// Steps of the search for a field angle.
const FALSE_POSITIONS: u32 = 60;

/// Places on the sensor along one radius, at one object distance.
#[derive(Clone, Debug)]
pub struct FieldLine {
    /// Distance from the axis, mm; the first is 0.
    pub radius_mm: Vec<f64>,
    /// Object slope seen there by the chief ray.
    pub slope: Vec<f64>,
    /// Field angle at the paraxial entrance pupil, degrees.
    pub angle_deg: Vec<f64>,
    /// Image height per object slope on the axis, mm.
    pub scale_mm: f64,
    /// Chief rays over the field: object slope and image height in mm; of [`Self::at`] none.
    pub chief: Vec<(f64, f64)>,
}

impl FieldLine {
    /// `count` places of `lens` for an object of the given vergence (1/mm), from the axis to the farthest pixel corner or
    /// to the image of the largest field angle, or to the end of the light, whichever is nearest.
    ///
    /// # Errors
    /// A sensor that sees no light on the axis.
    pub fn new(lens: &Lens, vergence: f64, count: usize) -> Result<Self> {
        lens.require_symmetry("curves over the field")?;
        let max_slope = max_slope(lens, vergence);
        let sensor = lens.sensor.radius_mm();
        let fine: Vec<f64> = (0..=FINE.0).map(|i| sensor * f64::from(i) / f64::from(FINE.0)).collect();
        let slopes = chief_slopes(lens, vergence, &fine)?;
        // The field ends where its largest slope is seen, or with the sensor, or with the light.
        let seen = slopes.iter().take_while(|s| **s <= max_slope).count().max(1);
        let mut edge = fine[seen - 1];
        if let Some(beyond) = fine.get(seen) {
            let mut high = *beyond;
            for _ in 0..FINE.1 {
                let middle = 0.5 * (edge + high);
                let inside = chief_slopes(lens, vergence, &[middle]).is_ok_and(|s| s[0] <= max_slope);
                *(if inside { &mut edge } else { &mut high }) = middle;
            }
        }
        let even = |n: u32| (0..n).map(|i| edge * f64::from(i) / f64::from(n.max(2) - 1)).collect::<Vec<f64>>();
        let samples = even(SAMPLES);
        let slopes = chief_slopes(lens, vergence, &samples)?;
        let radius_mm = even(u32::try_from(count).unwrap_or(u32::MAX));
        let slope = chief_slopes(lens, vergence, &radius_mm)?;
        let radius_mm = radius_mm[..slope.len()].to_vec();
        Self::of(lens, vergence, (radius_mm, slope), slopes.into_iter().zip(samples).collect())
    }

    /// The places where the chief rays of `angles_deg` (field angles at the paraxial entrance pupil) land, for an object of the given vergence (1/mm).
    ///
    /// # Errors
    /// A sensor that sees no light on the axis; an angle that is none, or beyond the light.
    pub fn at(lens: &Lens, vergence: f64, angles_deg: &[f64]) -> Result<Self> {
        lens.require_symmetry("kernels over the field")?;
        let (sensor, scale) = (lens.sensor.radius_mm(), slope_per_tangent(lens, vergence));
        chief_slopes(lens, vergence, &[0.0])?;
        let slope_of = |radius: f64| chief_slopes(lens, vergence, &[radius]).ok().map(|s| s[0]);
        let place = |angle: &f64| {
            if !(0.0..90.0).contains(angle) {
                return Err(Error::bad(lens.file(), "field angle", angle.to_string(), "0 to below 90 degrees"));
            }
            let wanted = angle.to_radians().tan() * scale;
            radius_of(&slope_of, wanted, sensor).map_err(|last| {
                let last = significant((last / scale).atan().to_degrees(), 5);
                let at = significant(1.0 / vergence, 6);
                let allowed = format!("up to {last} degrees, where the light ends (object at {at} mm)");
                Error::bad(lens.file(), "field angle", format!("{angle} degrees"), allowed)
            })
        };
        let radius_mm = angles_deg.iter().map(place).collect::<Result<Vec<f64>>>()?;
        let slope = radius_mm.iter().map(|r| slope_of(*r).unwrap_or(0.0)).collect();
        Self::of(lens, vergence, (radius_mm, slope), Vec::new())
    }

    fn of(
        lens: &Lens,
        vergence: f64,
        (radius_mm, slope): (Vec<f64>, Vec<f64>),
        chief: Vec<(f64, f64)>,
    ) -> Result<Self> {
        let near = 1e-3 * lens.sensor.radius_mm();
        let scale_mm = near / chief_slopes(lens, vergence, &[near])?[0];
        let scale = slope_per_tangent(lens, vergence);
        let angle_deg = slope.iter().map(|s| (s / scale).atan().to_degrees()).collect();
        Ok(Self { radius_mm, slope, angle_deg, scale_mm, chief })
    }
}

/// The radius at which a chief ray has the slope `wanted`, looked for from `start`, mm; where light ends before it, the last slope.
fn radius_of(slope_of: &dyn Fn(f64) -> Option<f64>, wanted: f64, start: f64) -> std::result::Result<f64, f64> {
    if wanted == 0.0 {
        return Ok(0.0);
    }
    // The farthest place with less, and the nearest without light.
    let (mut low, mut dark, mut high) = ((0.0, 0.0), f64::INFINITY, start);
    let mut end = loop {
        match slope_of(high) {
            Some(slope) if slope >= wanted => break (high, slope),
            Some(slope) => low = (high, slope),
            None => dark = high,
        }
        if low.0 > 1e6 * start || dark - low.0 < 1e-9 * dark.min(1e9) {
            return Err(low.1);
        }
        high = if dark.is_finite() { 0.5 * (low.0 + dark) } else { 2.0 * low.0 };
    };
    // False position; an end that stays twice counts half (the Illinois rule).
    let (mut stays, mut weights) = (0, [1.0, 1.0]);
    for _ in 0..FALSE_POSITIONS {
        let (a, b) = (weights[0] * (low.1 - wanted), weights[1] * (end.1 - wanted));
        let radius = low.0 - a * (end.0 - low.0) / (b - a);
        let Some(slope) = slope_of(radius).filter(|_| radius > low.0 && radius < end.0) else { break };
        let side = if slope < wanted { 1 } else { -1 };
        if side > 0 {
            low = (radius, slope);
        } else {
            end = (radius, slope);
        }
        weights = match (side == stays, side) {
            (true, 1) => [1.0, 0.5 * weights[1]],
            (true, _) => [0.5 * weights[0], 1.0],
            _ => [1.0, 1.0],
        };
        stays = side;
        if (slope - wanted).abs() <= 1e-14 * wanted {
            return Ok(radius);
        }
    }
    Ok(if wanted - low.1 < end.1 - wanted { low.0 } else { end.0 })
}

/// Object slope at the first vertex per tangent of the field angle at the entrance pupil; 1 for a lens that is telecentric in object
/// space, whose field angles are those at the first vertex.
fn slope_per_tangent(lens: &Lens, vergence: f64) -> f64 {
    if vergence == 0.0 {
        return 1.0;
    }
    paraxial::field_origin_at(lens, vergence).object_slope().abs()
}

/// Object slope of the field angle `angle` at the entrance pupil (radians), at most [`STEEPEST`]'s.
pub(crate) fn slope_at(lens: &Lens, vergence: f64, angle: f64) -> f64 {
    // Inside the edge of the light, which is found to a part of its radius.
    let tangent = angle.min((0.97 * STEEPEST).atan()).tan();
    if tangent == 0.0 { 0.0 } else { tangent * slope_per_tangent(lens, vergence) }
}

/// Object slope of the largest field angle; a lens for the axis alone gets a thousandth, so that a scale exists.
pub fn max_slope(lens: &Lens, vergence: f64) -> f64 {
    slope_at(lens, vergence, lens.max_field_deg().to_radians().max(1e-3))
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::assert_abs;
    use isoplanat_optics::lens::{Field, builtin};

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
        let narrow = lens.changed(|l| l.field = Field::Angle(10.0)).expect("a lens");
        let line = FieldLine::new(&narrow, narrow.object_vergence, 3).expect("traces");
        assert_abs(line.angle_deg[2], 10.0, 1e-9, "field");
        let narrow = lens.changed(|l| l.field = Field::Angle(0.0)).expect("a lens");
        assert_abs(FieldLine::new(&narrow, 0.0, 1).expect("traces").radius_mm[0], 0.0, 0.0, "axis only");
    }

    /// A stated field beyond what the lens shows ends with the sensor or with the light.
    #[test]
    fn a_field_beyond_the_light_ends_with_it() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let lens = lens.changed(|l| l.field = Field::Angle(80.0)).expect("a lens");
        let line = FieldLine::new(&lens, 0.0, 3).expect("traces");
        assert!(line.radius_mm[2] <= lens.sensor.radius_mm() && line.angle_deg[2] < 45.0, "{line:?}");
    }
}
