//! Other lenses in the place of a task's lens: of its focal length and aperture, on its raster, refocused for its distances, so that what differs
//! between two cameras is their glass.

use isoplanat_base::error::{Error, Result};
use isoplanat_optics::lens::{Aperture, Field, Lens, SensorRaster, paraxial};
use isoplanat_optics::optimize::{Apertures, Merit, refocused};
use isoplanat_optics::trace::apertures::{Beam, open};
use isoplanat_optics::trace::rims::require_clear;

/// What every lens of a comparison is made to be.
#[derive(Clone, Debug, PartialEq)]
pub struct Specification {
    /// Focal length, mm.
    pub focal_length_mm: f64,
    /// Diameter of the entrance pupil, mm.
    pub pupil_mm: f64,
    /// 1/distance of the object, 1/mm.
    pub vergence: f64,
    /// Distances that lenses are focused for, all alike, as vergences.
    pub focus: Vec<f64>,
    /// The raster.
    pub sensor: SensorRaster,
}

/// A lens in another's place.
#[derive(Clone, Debug)]
pub struct Placed {
    /// The lens.
    pub lens: Lens,
    /// How much larger than its file says.
    pub scale: f64,
    /// How far the sensor moved for focus, mm.
    pub shift_mm: f64,
    /// RMS spot over field and distances before and after, mm.
    pub rms_mm: [f64; 2],
    /// Half field angle to which it was focused, degrees: less than the frame's corner where light does not come through from there.
    pub field_deg: f64,
}

impl Specification {
    /// That of `lens`, others focused for its object's distance, or where they are named for `distances_mm`.
    ///
    /// # Errors
    /// A lens without a focal length.
    pub fn of_lens(lens: &Lens, distances_mm: &[f64]) -> Result<Self> {
        let first = paraxial::first_order(lens, lens.wavelengths.primary_nm);
        let focal_length_mm = first.effective_focal_length;
        if !(focal_length_mm.is_finite() && focal_length_mm > 0.0) {
            let allowed = "a lens that makes a real image: others are scaled to its focal length";
            return Err(Error::bad(&lens.name, "focal length", focal_length_mm.to_string(), allowed));
        }
        Ok(Self {
            focal_length_mm,
            pupil_mm: first.entrance_pupil_diameter,
            vergence: lens.object_vergence,
            focus: match distances_mm {
                [] => vec![lens.object_vergence],
                some => some.iter().map(|d| d.recip()).collect(),
            },
            sensor: lens.sensor,
        })
    }

    /// `lens` there. Clear apertures of its file stay but where the axis's own beam needs more.
    ///
    /// # Errors
    /// A lens without a focal length; one that is none at this size or aperture; one through which no light comes.
    pub fn put(&self, lens: &Lens) -> Result<Placed> {
        let primary = lens.wavelengths.primary_nm;
        let own = paraxial::first_order(lens, primary).effective_focal_length;
        let scale = self.focal_length_mm / own;
        if !(scale.is_finite() && scale > 0.0) {
            let allowed = "a lens that makes a real image: it is scaled to the focal length of the task's";
            return Err(Error::bad(&lens.name, "focal length", own.to_string(), allowed));
        }
        let last = lens.surfaces.len() - 1;
        let mut numbers = (**lens).clone();
        numbers.enlarge(scale);
        numbers.aperture = Aperture::EntrancePupilDiameter(self.pupil_mm);
        numbers.object_vergence = self.vergence;
        numbers.sensor = self.sensor;
        // The sensor at the paraxial image, so that there is something to begin with.
        let focus = paraxial::first_order(&numbers, primary).paraxial_image_distance;
        if !(focus.is_finite() && focus > 0.0) {
            let allowed = "an image behind the lens: it cannot be focused there";
            return Err(Error::bad(&lens.name, "paraxial image, mm", focus.to_string(), allowed));
        }
        numbers.surfaces[last].thickness = focus;
        let marked: Vec<bool> = (0..=last).map(|i| i != numbers.stop).collect();
        let mut wide = numbers.clone();
        open(&mut wide, &marked, &[Beam::full(0.0, 0.0)]);
        for (i, (s, w)) in numbers.surfaces.iter_mut().zip(&wide.surfaces).enumerate() {
            if marked[i] {
                s.semi_diameter = s.semi_diameter.max(w.semi_diameter);
            }
        }
        let stated = lens.max_field_deg();
        let lens = Lens::new(numbers, &lens.name)?;
        require_clear(&lens, &lens.name)?;
        let corner = (self.sensor.radius_mm() / self.focal_length_mm).atan().to_degrees();
        // As far out as light comes through: to the frame's corner, as far as the file says, or next to the axis.
        let fields = [corner, corner.min(stated), 0.5 * corner.min(stated), 0.1 * corner.min(stated)];
        let mut why = None;
        for field_deg in fields {
            match self.focused(&lens, field_deg) {
                Ok((lens, rms_mm)) => {
                    let shift_mm = lens.surfaces[last].thickness - focus;
                    return Ok(Placed { lens, scale, shift_mm, rms_mm, field_deg });
                }
                Err(e) => why = Some(e),
            }
        }
        Err(why.unwrap_or_else(|| Error::Internal("no field was tried".into())))
    }

    /// `lens` with the sensor at the least rms spot over field and distances, and that before and after.
    fn focused(&self, lens: &Lens, field_deg: f64) -> Result<(Lens, [f64; 2])> {
        let lens = lens.changed(|l| l.field = Field::Angle(field_deg))?;
        let depths = self.focus.iter().map(|v| [*v, 1.0]).collect();
        let found = refocused(&lens, Merit { depths, apertures: Apertures::Stated, ..Merit::default() })?;
        Ok((found.lens, found.rms_mm))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_abs, assert_rel};
    use isoplanat_optics::lens::builtin;

    fn place() -> Specification {
        let lens = builtin::lens("two_element").expect("shipped");
        Specification::of_lens(&lens, &[]).expect("has a focal length")
    }

    /// Every shipped lens, or the reason in words: 50 mm, F/4, at 1 m, the sensor where spots are least.
    #[test]
    fn shipped_lenses_stand_in_one_place() {
        let place = place();
        let mut stood = 0;
        for (name, _) in builtin::LENSES {
            let lens = builtin::lens(name).expect("shipped");
            let placed = match place.put(&lens) {
                Ok(placed) => placed,
                Err(why) => {
                    eprintln!("{name}: {why}");
                    continue;
                }
            };
            stood += 1;
            let first = paraxial::first_order(&placed.lens, placed.lens.wavelengths.primary_nm);
            assert_rel(first.effective_focal_length, place.focal_length_mm, 1e-9, 0.0, name);
            assert_rel(first.f_number, place.focal_length_mm / place.pupil_mm, 1e-9, 0.0, name);
            assert_abs(placed.lens.object_vergence, 1e-3, 1e-12, name);
            assert!(placed.rms_mm[1] <= placed.rms_mm[0] * (1.0 + 1e-9), "{name}: {:?}", placed.rms_mm);
            // On either side the spots are larger.
            let at = |d: f64| {
                let last = placed.lens.surfaces.len() - 1;
                let moved = placed.lens.changed(|l| l.surfaces[last].thickness += d).expect("a lens");
                let merit = Merit { depths: vec![[1e-3, 1.0]], apertures: Apertures::Stated, ..Merit::default() };
                isoplanat_optics::optimize::merit_of(&moved, &merit).expect("traces")
            };
            assert!(at(0.1) > at(0.0) && at(-0.1) > at(0.0), "{name}: {} {} {}", at(-0.1), at(0.0), at(0.1));
        }
        assert!(stood >= 12, "{stood} of {}", builtin::LENSES.len());
    }

    /// An afocal lens has no place, and neither has one that bends light apart.
    #[test]
    fn what_makes_no_image_is_refused_by_name() {
        let lens = builtin::lens("landscape").expect("shipped");
        let apart = builtin::lens("ac254_050_a").expect("shipped").changed(|l| {
            l.surfaces[0].shape.curvature = -0.01;
            l.surfaces[1].shape.curvature = 0.0;
        });
        let why = place().put(&apart.expect("a lens")).expect_err("no image").to_string();
        assert!(why.contains("focal length"), "{why}");
        let flat = lens.changed(|l| l.surfaces.iter_mut().for_each(|s| s.shape.curvature = 0.0)).expect("a window");
        let why = place().put(&flat).expect_err("no image").to_string();
        assert!(why.contains("focal length"), "{why}");
    }
}
