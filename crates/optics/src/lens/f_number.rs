//! A lens with its stop closed to an f-number.

use super::paraxial::{field_origin, first_order};
use super::{Aperture, Lens};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::figures::significant;

/// Largest f-number.
const LARGEST: f64 = 1e6;

/// `lens` with its stop closed to `number` (focal length over entrance pupil, at its primary wavelength), by its semi-diameter.
///
/// # Errors
/// An f-number that is none, a lens without power, one whose entrance pupil lies at infinity, a stop larger than its surface lets through. The error names no file.
#[doc(hidden)]
pub fn stopped_to(lens: &Lens, number: f64) -> Result<Lens> {
    let refuse = |found: String, allowed: String| Err(Error::bad("", "value", found, allowed));
    if !(number > 0.0 && number <= LARGEST) {
        return refuse(number.to_string(), format!("above 0 and up to {LARGEST:e}"));
    }
    let first = first_order(lens, lens.wavelengths.primary_nm);
    let powerless = !(first.f_number.is_finite() && first.f_number > 0.0 && first.effective_focal_length.abs() < 1e9);
    let file = lens.file();
    if field_origin(lens).telecentric {
        let found = format!("given for {file}, whose entrance pupil lies at infinity (telecentric in object space)");
        let allowed = "a lens with an entrance pupil; the light of this one is its object_na, in its file";
        return refuse(found, allowed.into());
    }
    if powerless {
        return refuse(format!("given for {file}, which has no power"), "a lens with a focal length".into());
    }
    // The pupil grows as the stop does.
    let radius = first.stop_semi_diameter * first.f_number / number;
    let clear = lens.surfaces[lens.stop].semi_diameter;
    if radius > clear * (1.0 + 1e-9) {
        let least = first.stop_semi_diameter * first.f_number / clear;
        let allowed = format!("{} or more: the stop's surface is clear up to {clear} mm", significant(least, 5));
        return refuse(format!("{number}, a stop of {} mm", significant(radius, 5)), allowed);
    }
    lens.changed(|l| l.aperture = Aperture::StopSemiDiameter(radius))
}
