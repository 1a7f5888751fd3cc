//! What every lens must be, whether a file states it or a design step made it.

use super::glass::TABLE_NM;
use super::{Aperture, Field, Medium, Prescription, Shape, Surface, clearance, numbers, paraxial};
use isoplanat_base::error::{Error, Location, Result};

/// Most surfaces that a lens has: the largest published ones have some sixty.
pub(crate) const MAX_SURFACES: usize = 400;
/// Most wavelengths that a lens states; other programs take up to 24.
const MAX_WAVELENGTHS: usize = 100;
/// Fields that a lens states, at most.
pub(crate) const MAX_FIELD_POINTS: usize = 200;
/// Largest curvature (1/mm) and conic constant of the image surface.
const MOST_CURVED: f64 = 1e6;
/// Largest object.
const MAX_HEIGHT_MM: f64 = 1e6;
/// Largest half field angle. Work on a flat image asks for less than 90.
pub(crate) const MAX_FIELD_DEG: f64 = 120.0;
/// A freeform's radius lies within this factor of the clear semi-diameter, either way: ten powers of it and of a search up to 70
/// semi-diameters wide stay within 1e50, and their derivatives with them.
const RADII: f64 = 1e3;
/// Focal length, in the larger of the lens's width and its length without the last distance, beyond which it has no power.
const POWERLESS: f64 = 1e5;
/// Bound of the slope of the polynomial terms: 1000 is 89.94°. Aspheres whose terms cancel stay far below.
const STEEPEST: f64 = 1e3;
/// Rings by which it is bounded.
const RINGS: [u32; 2] = [64, 4096];

impl Prescription {
    /// Refuses what is no lens; `file` names it. [`super::Lens::new`] asks here, and nothing else does.
    pub(super) fn check(&self, file: &str) -> Result<()> {
        self.check_numbers(file)?;
        for (i, s) in self.surfaces.iter().enumerate() {
            check_surface(s, i, file)?;
            let before = self.medium_before(i);
            if s.shape.ideal.is_some() && [before, &s.medium] != [&Medium::Air; 2] {
                let place = Location::surface(i).key("ideal_focal_length_mm");
                let found = format!("between {before} and {}", s.medium);
                return Err(Error::bad(file, place, found, "air on both sides of an ideal lens"));
            }
        }
        if let Aperture::FNumber(number) = self.aperture
            && self.is_powerless()
        {
            let found = format!("{number} of a lens without power, whose stop it cannot size");
            let allowed = "a lens with power, or entrance_pupil_diameter_mm or stop_semi_diameter_mm instead; `optimize` takes a start with one focal length, such as --constraint focal_length=50";
            return Err(Error::bad(file, "aperture.f_number", found, allowed));
        }
        clearance::check(self, file)
    }

    /// Whether the lens has no power that an f-number could be of: afocal, or a focal length that is next to what rounding leaves of one.
    pub(crate) fn is_powerless(&self) -> bool {
        let efl = paraxial::first_order(self, self.wavelengths.primary_nm).effective_focal_length;
        let widest = self.surfaces.iter().map(|s| s.semi_diameter).fold(0.0, f64::max);
        let within: f64 = self.surfaces.iter().take(self.surfaces.len() - 1).map(|s| s.thickness.abs()).sum();
        efl.is_nan() || efl.abs() > POWERLESS * widest.max(within)
    }

    /// Refuses numbers that may not stand where they do, each for itself: what paraxial and real rays need to be asked at all.
    pub(crate) fn check_numbers(&self, file: &str) -> Result<()> {
        let refuse =
            |place: &str, found: String, allowed: &str| -> Result<()> { Err(Error::bad(file, place, found, allowed)) };
        if self.surfaces.len() > MAX_SURFACES {
            let found = format!("{} surfaces", self.surfaces.len());
            return refuse("surface", found, &format!("at most {MAX_SURFACES}"));
        }
        if self.stop >= self.surfaces.len() {
            return refuse(
                "surface",
                format!("{} surfaces, stop {}", self.surfaces.len(), self.stop),
                "a stop among them",
            );
        }
        for (i, e) in self.elements.iter().enumerate() {
            if e.first > e.last || e.last >= self.surfaces.len() {
                let found = format!("surfaces {} to {}", e.first, e.last);
                let allowed = format!("first ≤ last, both from 0 to {}", self.surfaces.len() - 1);
                return refuse(&format!("element[{i}]"), found, &allowed);
            }
        }
        // Minus zero is the reciprocal of minus infinity.
        if !(0.0..=1e6).contains(&self.object_vergence) || self.object_vergence.is_sign_negative() {
            let distance = self.object_vergence.recip().to_string();
            return refuse("object.distance_mm", distance, "a positive distance from 1e-6 mm on, or inf");
        }
        match self.field {
            Field::Angle(angle) if !(0.0..=MAX_FIELD_DEG).contains(&angle) => {
                return refuse("field.max_angle_deg", angle.to_string(), &format!("0 to {MAX_FIELD_DEG}"));
            }
            Field::ObjectHeight(height) if !(0.0..=MAX_HEIGHT_MM).contains(&height) => {
                let allowed = format!("0 to {MAX_HEIGHT_MM} mm");
                return refuse("field.max_object_height_mm", height.to_string(), &allowed);
            }
            Field::ObjectHeight(height) if self.object_vergence == 0.0 => {
                let found = format!("{height} mm at infinity");
                return refuse("field.max_object_height_mm", found, "a finite object.distance_mm, or max_angle_deg");
            }
            _ => {}
        }
        let (points, most) = (&self.field_points, MAX_FIELD_DEG.max(MAX_HEIGHT_MM));
        let rising = points.iter().all(|p| (0.0..=most).contains(p)) && points.windows(2).all(|w| w[0] < w[1]);
        if !rising || points.len() > MAX_FIELD_POINTS {
            let allowed = format!("up to {MAX_FIELD_POINTS} rising numbers from 0 to the largest field");
            return refuse("field", format!("the fields {points:?}"), &allowed);
        }
        if matches!(self.aperture, Aperture::ObjectNa(_)) && self.object_vergence == 0.0 {
            let allowed = "a finite object.distance_mm, or another statement of the aperture";
            return refuse("aperture.object_space_na", "an object at infinity".into(), allowed);
        }
        self.check_wavelengths(file)?;
        self.check_sensor(file)?;
        numbers::check(self, file)?;
        for (space, medium) in self.media().enumerate() {
            check_table(medium, space, file)?;
        }
        for nm in self.wavelengths.nm.iter().chain([&self.wavelengths.primary_nm]) {
            self.require_indices(*nm, file)?;
        }
        let index = self.object_medium.index(self.wavelengths.primary_nm);
        if let Aperture::ObjectNa(na) = self.aperture
            && na >= index
        {
            let allowed = format!("above 0, below {index}, the index that the object lies in");
            return refuse("aperture.object_space_na", na.to_string(), &allowed);
        }
        Ok(())
    }

    fn check_wavelengths(&self, file: &str) -> Result<()> {
        let w = &self.wavelengths;
        if w.nm.is_empty() || w.nm.len() != w.weights.len() {
            let found = format!("{} wavelengths, {} weights", w.nm.len(), w.weights.len());
            return Err(Error::bad(file, "wavelengths", found, "as many weights as wavelengths, at least one"));
        }
        if w.nm.len() > MAX_WAVELENGTHS {
            let (found, allowed) = (format!("{} wavelengths", w.nm.len()), format!("at most {MAX_WAVELENGTHS}"));
            return Err(Error::bad(file, "wavelengths", found, allowed));
        }
        for nm in w.nm.iter().chain([&w.primary_nm]) {
            if !(200.0..=20_000.0).contains(nm) {
                return Err(Error::bad(file, "wavelengths.nm", nm.to_string(), "200 to 20000 nm"));
            }
        }
        let sum: f64 = w.weights.iter().sum();
        if w.weights.iter().any(|x| !x.is_finite() || *x < 0.0) || !(sum > 0.0 && sum.is_finite()) {
            let found = format!("{:?}", w.weights);
            return Err(Error::bad(
                file,
                "wavelengths.weights",
                found,
                "weights that are not negative and not all zero, whose sum is a number",
            ));
        }
        Ok(())
    }

    fn check_sensor(&self, file: &str) -> Result<()> {
        let s = &self.sensor;
        if !(1..=65_536).contains(&s.columns) || !(1..=65_536).contains(&s.rows) {
            let found = format!("{} columns × {} rows", s.columns, s.rows);
            return Err(Error::bad(file, "sensor", found, "1 to 65536 each"));
        }
        if s.axis_px.iter().any(|a| !a.is_finite() || a.abs() > 1e6) {
            let found = format!("{:?}", s.axis_px);
            return Err(Error::bad(file, "sensor.axis_px", found, "two numbers of pixels from -1e6 to 1e6"));
        }
        if !(LEAST_PITCH_UM..=MOST_PITCH_UM).contains(&s.pitch_um) {
            let allowed = format!("{LEAST_PITCH_UM} to {MOST_PITCH_UM} µm");
            return Err(Error::bad(file, "sensor.pitch_um", s.pitch_um.to_string(), allowed));
        }
        self.check_image(file)
    }

    fn check_image(&self, file: &str) -> Result<()> {
        let image = self.image;
        for (key, value) in [("curvature_per_mm", image.curvature), ("conic", image.conic)] {
            if !value.is_finite() || value.abs() > MOST_CURVED {
                let allowed = format!("a number up to {MOST_CURVED:e} either way");
                return Err(Error::bad(file, Location::from("image").key(key), value.to_string(), allowed));
            }
        }
        image.require_reach(self.sensor.radius_mm(), "a sensor (the field's image, where none is stated)", file)
    }
}

/// Pixels that light can tell apart, and more: a twentieth of a wavelength, a metre.
const LEAST_PITCH_UM: f64 = 0.02;
const MOST_PITCH_UM: f64 = 1e6;

/// What a table of indices must be, that of the medium of `space`.
fn check_table(medium: &Medium, space: usize, file: &str) -> Result<()> {
    if let Medium::Table { wavelength_nm, index } = medium {
        let ascending = wavelength_nm.windows(2).all(|w| w[0] < w[1]);
        if index.is_empty()
            || index.len() != wavelength_nm.len()
            || !ascending
            || !wavelength_nm.iter().all(|w| TABLE_NM.contains(w))
        {
            let found = format!("wavelength_nm = {wavelength_nm:?}, index = {index:?}");
            let allowed = "ascending wavelengths from 100 to 100000 nm, as many indices from 1 to 5";
            return Err(Error::bad(file, super::place_of_medium(space), found, allowed));
        }
    }
    Ok(())
}

/// What the numbers of surface `surface` must be to each other.
pub(crate) fn check_surface(s: &Surface, surface: usize, file: &str) -> Result<()> {
    let place = |key: &str| Location::surface(surface).key(key);
    let (shape, semi_diameter) = (&s.shape, s.semi_diameter);
    if shape.ideal.is_some() && (shape.curvature != 0.0 || shape.is_aspheric()) {
        let allowed = "radius_mm = inf and no terms: an ideal lens is a plane";
        return Err(Error::bad(file, place("ideal_focal_length_mm"), "a form beside it", allowed));
    }
    if semi_diameter > shape.reach() {
        let allowed = format!("at most the conic's reach of {:.6} mm", shape.reach());
        return Err(Error::bad(file, place("semi_diameter_mm"), semi_diameter.to_string(), allowed));
    }
    // Terms that no surface has within its clear semi-diameter: their search would not end in sensible time, or their derivatives
    // would leave the numbers. Every field is named: one that has a radius is looked at here, one that has terms is named below.
    let Shape { curvature: _, conic: _, asphere: _, odd: _, zernike, xy, ideal: _ } = shape;
    let radii = [("zernike", zernike.as_ref().map(|z| z.radius())), ("xy", xy.as_ref().map(|p| p.radius()))];
    let [least, most] = [semi_diameter / RADII, semi_diameter * RADII];
    for (key, radius) in radii {
        if let Some(r) = radius.filter(|r| !(least..=most).contains(r)) {
            let allowed = format!("{least:e} to {most:e} mm, 1/1000 to 1000 semi_diameter_mm");
            return Err(Error::bad(file, place(key).key("radius_mm"), format!("{r:e}"), allowed));
        }
    }
    let terms = Shape { curvature: 0.0, conic: 0.0, ..shape.clone() };
    // Many terms that cancel need narrow rings to show it.
    let slopes = RINGS.map(|rings| terms.steepest_of(semi_diameter, rings));
    if slopes.iter().any(|slope| *slope <= STEEPEST) {
        return Ok(());
    }
    let slope = slopes[RINGS.len() - 1];
    let found = format!("a slope of up to {slope:e} within the clear semi-diameter");
    let allowed = format!("terms whose slopes add to at most {STEEPEST}");
    Err(Error::bad(file, place("asphere, zernike, xy"), found, allowed))
}
