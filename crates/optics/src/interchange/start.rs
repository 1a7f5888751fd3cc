//! Starts of optimisations: of a lens without power an f-number is that of the focal length which it is to have.

use crate::lens::{Aperture, Prescription};
use isoplanat_base::figures::significant;

/// Sizes the pupil of `numbers`, whose f-number says nothing since it has no power, for a focal length; the line that says so. Where there is none, or the lens has
/// power, it stays.
pub(super) fn size_pupil(numbers: &mut Prescription, focal_length_mm: Option<f64>) -> Option<String> {
    let (Aperture::FNumber(number), Some(focal)) = (numbers.aperture, focal_length_mm) else { return None };
    if !numbers.is_powerless() {
        return None;
    }
    let diameter = (focal / number).abs();
    numbers.aperture = Aperture::EntrancePupilDiameter(diameter);
    Some(format!(
        "aperture.f_number: f/{number} of a start without power is taken with the focal length of {focal} mm that it is to have: an entrance pupil of {} mm",
        significant(diameter, 7)
    ))
}
