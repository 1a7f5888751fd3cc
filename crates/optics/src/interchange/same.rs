//! A lens against what a reader makes of the file written of it: what a form cannot say is refused, and no file of another lens is written.
//!
//! Compared is what rays depend on: forms by their sag and slope, so that no number of a form is asked for by name, distances, media,
//! what is clear, stop, object, image, field and light. Names, sensors and other things that a form leaves out are notes of its writer.

use super::Form;
use crate::lens::{Lens, Prescription, Shape, paraxial, place_of_medium};
use isoplanat_base::error::{Error, Location, Result};

/// What is written in numbers is read to its last bit; this covers sums.
const CLOSE: f64 = 1e-12;
/// What goes through other numbers: an index through an Abbe number, a stop through a pupil, a height through an angle; also an object that
/// a form has infinitely far, 1/mm.
const NEAR: f64 = 1e-8;
/// Rings and arms on which two forms are compared.
const RINGS: u32 = 16;
const ARMS: u32 = 7;

/// Refuses `lens` where `read`, made of its text in `form`, is another.
///
/// # Errors
/// With the surface, or what else differs.
pub(super) fn require(lens: &Lens, read: &Lens, form: Form) -> Result<()> {
    match difference(lens, read) {
        None => Ok(()),
        Some((place, [own, other])) => {
            let found = format!("{own}, which as {form:?} would be read as {other}");
            Err(Error::bad(lens.file(), place, found, "what that form says; .toml says all of a lens"))
        }
    }
}

/// Where the lenses differ first, with what both have there.
fn difference(lens: &Prescription, read: &Prescription) -> Option<(Location, [String; 2])> {
    let both = [lens, read];
    let differ = |place: Location, said: [String; 2]| Some((place, said));
    let [own, other] = both.map(|l| (l.surfaces.len(), l.stop));
    if own != other {
        return differ("surface".into(), both.map(|l| format!("{} surfaces, stop {}", l.surfaces.len(), l.stop)));
    }
    for (i, (a, b)) in lens.surfaces.iter().zip(&read.surfaces).enumerate() {
        let place = |key: &str| Location::surface(i).key(key);
        if let Some(said) = forms(&a.shape, &b.shape, a.semi_diameter) {
            return differ(Location::surface(i), said);
        }
        let lengths = [a, b].map(|s| s.shape.ideal_power().map_or(f64::INFINITY, f64::recip));
        if !close(lengths, CLOSE) {
            return differ(place("ideal_focal_length_mm"), lengths.map(|f| f.to_string()));
        }
        if !close([a.thickness, b.thickness], CLOSE) {
            return differ(place("thickness_mm"), [a, b].map(|s| s.thickness.to_string()));
        }
        let poses = [a, b].map(|s| s.pose.filter(|p| !p.is_nominal()));
        if poses[0] != poses[1] {
            return differ(Location::surface(i), poses.map(|p| p.map_or("no pose".into(), |p| format!("{p:?}"))));
        }
        // At the stop its own size counts, below.
        if i != lens.stop && !close([a.semi_diameter, b.semi_diameter], NEAR) {
            return differ(place("semi_diameter_mm"), [a, b].map(|s| s.semi_diameter.to_string()));
        }
    }
    let light = both.map(|l| (l.wavelengths.primary_nm, l.wavelengths.shares().collect::<Vec<_>>()));
    let same_light = close([light[0].0, light[1].0], CLOSE)
        && light[0].1.len() == light[1].1.len()
        && light[0].1.iter().zip(&light[1].1).all(|(a, b)| close([a.0, b.0], CLOSE) && close([a.1, b.1], CLOSE));
    if !same_light {
        return differ("wavelengths".into(), both.map(|l| format!("{:?}", l.wavelengths)));
    }
    for (space, (a, b)) in lens.media().zip(read.media()).enumerate() {
        for nm in lens.wavelengths.nm.iter().chain([&lens.wavelengths.primary_nm]) {
            let indices = [a.index(*nm), b.index(*nm)];
            if !close(indices, NEAR) {
                return differ(place_of_medium(space), indices.map(|n| format!("an index of {n} at {nm} nm")));
            }
        }
    }
    let image = both.map(|l| [l.image.curvature, l.image.conic]);
    if (0..2).any(|k| !close([image[0][k], image[1][k]], CLOSE)) {
        return differ("image".into(), both.map(|l| format!("{:?}", l.image)));
    }
    let object = both.map(|l| l.object_vergence);
    if (object[0] - object[1]).abs() > NEAR {
        return differ("object.distance_mm".into(), object.map(|v| v.recip().to_string()));
    }
    let stops = both.map(paraxial::stop_semi_diameter);
    if !close(stops, NEAR) {
        return differ("aperture".into(), stops.map(|r| format!("a stop of {r} mm")));
    }
    let fields = both.map(Prescription::max_field_deg);
    (!close(fields, NEAR)).then(|| ("field".into(), fields.map(|angle| format!("{angle}°"))))
}

/// Whether two numbers are the same to `share` of the larger one.
fn close([a, b]: [f64; 2], share: f64) -> bool {
    a == b || (a - b).abs() <= share * a.abs().max(b.abs())
}

/// What two forms are where they differ first within `radius`, or none.
fn forms(a: &Shape, b: &Shape, radius: f64) -> Option<[String; 2]> {
    for (ring, arm) in (1..=RINGS).flat_map(|ring| (0..ARMS).map(move |arm| (ring, arm))) {
        let r = radius * f64::from(ring) / f64::from(RINGS);
        let (sin, cos) = (std::f64::consts::TAU * f64::from(arm) / f64::from(ARMS)).sin_cos();
        let both = [a, b].map(|shape| shape.at(r * cos, r * sin));
        let same = match &both {
            [None, None] => true,
            [Some(a), Some(b)] => {
                let steep = a.slope[0].hypot(a.slope[1]);
                let apart = (a.slope[0] - b.slope[0]).hypot(a.slope[1] - b.slope[1]);
                (a.h - b.h).abs() <= CLOSE * r && apart <= CLOSE * (1.0 + steep)
            }
            _ => false,
        };
        if !same {
            return Some(both.map(|local| {
                let Some(local) = local else { return "no surface there".into() };
                let [x, y] = local.slope;
                format!("a sag of {} mm and slopes of {x} and {y} at {r} mm", local.h)
            }));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interchange::{parse, text_of};
    use crate::lens::catalogue::Glasses;
    use crate::lens::test_lenses::{every_kind, forms, numbers, with_number};
    use crate::lens::variables::Variables;
    use crate::lens::{Kind, Parameter, builtin, unchecked};

    fn told(lens: &Lens, other: &Lens) -> String {
        require(lens, other, Form::Zmx).expect_err("another lens").to_string()
    }

    /// A form that gets lost is told with its surface, whichever it is; so is any of its numbers.
    #[test]
    fn a_form_that_is_lost_is_told() {
        let lens = builtin::lens("two_element").expect("shipped");
        let base = crate::lens::Shape { conic: 0.3, ..lens.surfaces[0].shape.clone() };
        let put = |shape: Shape| unchecked(&lens, |l| l.surfaces[0].shape = shape);
        for (name, shape) in forms(&mut fastrand::Rng::with_seed(2), lens.surfaces[0].semi_diameter, 1e-3) {
            require(&put(shape.clone()), &put(shape.clone()), Form::Zmx).expect(name);
            let why = told(&put(shape.clone()), &put(base.clone()));
            assert!(why.contains("surface[0]") && why.contains("as Zmx would be read as"), "{name}: {why}");
            for entry in 0..numbers(&shape).len() {
                let (kind, other) = with_number(&shape, entry, |a| 0.5 * a);
                // A number that is zero stays what it is.
                let lost = || told(&put(shape.clone()), &put(other.clone()));
                assert!(other == shape || lost().contains("surface[0]"), "{name}: {kind:?}, number {entry}");
            }
        }
    }

    /// Every number that rays depend on is compared; poses of elements are refused before anything is written.
    #[test]
    fn every_number_is_compared() {
        for lens in every_kind().all() {
            for p in Parameter::all(&lens) {
                let variables = Variables::new(&lens, vec![p]);
                let x = variables.values(&lens)[0];
                // The last terms of a dispersion hardly move an index.
                let step = if p.kind == Kind::Dispersion { 0.1 } else { 1e-3 };
                let other = unchecked(&lens, |l| variables.put(l, &[x + step]));
                let of_element = [Kind::ElementTilt, Kind::ElementDecentre, Kind::Pivot].contains(&p.kind);
                let of_stop = p == Kind::SemiDiameter.at(lens.stop);
                // A conic constant of a plane is none.
                let of_plane = p.kind == Kind::Conic && lens.surfaces[p.of].shape.curvature == 0.0;
                assert_eq!(difference(&lens, &other).is_none(), of_element || of_stop || of_plane, "{}", p.name(&lens));
            }
        }
    }

    /// Shipped lenses, and all test lenses that stand on one axis, are written as what they are, or refused by their writer.
    #[test]
    fn what_is_written_is_the_lens() {
        let shipped = builtin::LENSES.map(|(name, _)| (name, builtin::lens(name).expect("shipped")));
        let tests = every_kind().all().into_iter().map(|lens| ("test", lens.upright().expect("a lens")));
        let mut written = [0, 0];
        for (name, lens) in shipped.into_iter().chain(tests).chain(every_kind().alone) {
            for (form, count) in [Form::Zmx, Form::Seq].into_iter().zip(&mut written) {
                match text_of(&lens, form, Glasses::shipped()) {
                    Ok((text, _)) => {
                        let read = parse(&text, form, "", Glasses::shipped()).expect("what was written").lens;
                        require(&lens, &read, form).expect(name);
                        *count += 1;
                    }
                    Err(e) => assert!(!e.to_string().contains("would be read as"), "{name}: {e}"),
                }
            }
        }
        // Tables of indices have no form in Zemax files, odd terms and ideal lenses none in sequences.
        assert!(written[0] > 24 && written[1] > 20, "{written:?}");
    }
}
