//! This program's own form: what a file leaves out follows from the beam, as in other programs' files.

use super::{Imported, Reading, start};
use crate::lens::catalogue::Glasses;
use crate::lens::check::check_surface;
use crate::lens::prescription::{self, Read};
use crate::lens::{Aperture, Lens, Prescription, clearance, paraxial};
use crate::trace::apertures::{self, Beam};
use isoplanat_base::error::{Error, Location, Result};

/// Which clear semi-diameters the lens of a text leaves out.
///
/// # Errors
/// As [`read`].
pub(super) fn left_out(text: &str, file: &str, glasses: &Glasses) -> Result<Vec<bool>> {
    Ok(prescription::read(text, file, glasses)?.marked)
}

/// The lens of a text; `file` names it in errors.
pub(super) fn read(text: &str, file: &str, glasses: &Glasses, reading: Reading) -> Result<Imported> {
    let Read { mut numbers, marked } = prescription::read(text, file, glasses)?;
    let mut notes = namesakes(&numbers, glasses);
    let count = marked.iter().filter(|m| **m).count();
    if reading.focal_length_mm.is_some() {
        numbers.check_numbers(file)?;
        notes.extend(start::size_pupil(&mut numbers, reading.focal_length_mm));
    }
    if count > 0 {
        // Each number by itself, before rays go through them.
        numbers.check_numbers(file)?;
        for (i, s) in numbers.surfaces.iter().enumerate().filter(|(i, _)| !marked[*i]) {
            check_surface(s, i, file)?;
        }
        let stop = numbers.stop;
        if marked[stop] {
            let asked = paraxial::stop_semi_diameter(&numbers);
            if matches!(numbers.aperture, Aperture::FNumber(_)) && numbers.is_powerless() || !asked.is_finite() {
                let found = "left out, and no size by `aperture`, since the lens has no power";
                let place = Location::surface(stop).key("semi_diameter_mm");
                return Err(Error::bad(
                    file,
                    place,
                    found,
                    "a clear semi-diameter, or stop_semi_diameter_mm; `optimize` takes a start with one focal length, such as --constraint focal_length=50",
                ));
            }
            numbers.surfaces[stop].semi_diameter = asked;
        }
        let beams = Beam::over_field(&numbers);
        let dark = apertures::open(&mut numbers, &marked, &beams);
        notes.push(format!(
            "{count} of {} clear semi-diameters are left out: they follow from the beam over the field",
            marked.len()
        ));
        if !dark.is_empty() {
            let list: Vec<String> = dark.iter().map(|a| format!("{:.3}°", a.to_degrees())).collect();
            notes.push(format!("no ray of the field {} arrives: clear semi-diameters leave it out", list.join(", ")));
        }
    }
    notes.extend(clearance::limit_stop(&mut numbers));
    Ok(Imported { lens: Lens::new(numbers, file)?, notes })
}

/// A name of this program's own form is a shipped glass's: told where a catalogue that was given has another of that name, and of another glass where its own
/// catalogue has the name more than once.
fn namesakes(numbers: &Prescription, glasses: &Glasses) -> Vec<String> {
    let mut told: Vec<String> = Vec::new();
    for medium in numbers.media() {
        let shipped = Glasses::shipped().named_as(medium).is_some();
        let others = if shipped { glasses.namesakes(medium) } else { Vec::new() };
        let another = (!others.is_empty()).then(|| {
            format!(
                "glass {medium} is that of the shipped catalogues; {} is another of that name, which a file names so",
                others.join(" and ")
            )
        });
        for note in another.into_iter().chain(glasses.repeated(medium)) {
            if !told.contains(&note) {
                told.push(note);
            }
        }
    }
    told
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::lens::catalogue::Naming;
    use isoplanat_base::testing::assert_rel;

    /// A shipped glass keeps its name where a catalogue beside has another of that name, and says so; the same glass there says nothing.
    #[test]
    fn namesakes_of_other_catalogues_are_told() {
        let text = builtin::text("cooke_triplet").expect("shipped");
        let glass = text.split('"').find(|w| w.ends_with("SK16")).expect("its crown");
        let text = text.replace(&format!("\"{glass}\""), "\"F2\"");
        let folder = tempfile::tempdir().expect("made");
        let path = folder.path().join("mine.agf");
        for (first, notes) in [("1.3", 1), ("1.34533359", 0)] {
            let agf = format!(
                "NM F2 2 0 1.62 36.4 0 1\nCD {first} 0.00997743871 0.209073176 0.0470450767 0.937357162 111.886764\nLD 0.32 2.5\n"
            );
            std::fs::write(&path, agf).expect("written");
            let mut glasses = Glasses::shipped().clone();
            glasses.add(&path).expect("reads");
            let read = read(&text, "own.toml", &glasses, Reading::default()).expect("reads");
            assert_eq!(read.notes.len(), notes, "{:?}", read.notes);
            assert!(read.notes.iter().all(|n| n.contains("mine/F2")), "{:?}", read.notes);
            let shipped = Glasses::shipped().find("F2", Naming::Exact).expect("shipped");
            assert!(read.lens.surfaces.iter().any(|s| s.medium == shipped));
        }
    }

    /// A catalogue that has a name twice with other data: it is told which catalogue, and that the last is taken, by the name alone and with its catalogue; nothing
    /// is said of shipped catalogues, which do not have it. Twice the same data says nothing.
    #[test]
    fn names_twice_in_one_catalogue_are_told() {
        let own = builtin::text("cooke_triplet").expect("shipped");
        let glass = own.split('"').find(|w| w.ends_with("SK16")).expect("its crown");
        let folder = tempfile::tempdir().expect("made");
        let path = folder.path().join("dup.agf");
        for (first, notes) in [("1.2", 1), ("1.5", 0)] {
            let one = |b: &str| {
                let (strength, square) = (b.parse::<f64>().expect("a number"), 0.587_561_8f64.powi(2));
                let n_d = (1.0 + strength * square / (square - 0.006)).sqrt();
                format!("NM HX 2 0 {n_d} 64 0 1\nCD {b} 0.006\nLD 0.3 2.5\n")
            };
            std::fs::write(&path, one(first) + &one("1.5")).expect("written");
            let mut glasses = Glasses::shipped().clone();
            glasses.add(&path).expect("reads");
            let zmx = "VERS 1\nMODE SEQ\nUNIT MM\nENPD 5\nFTYP 0 0 1 1\nYFLN 3\nWAVM 1 0.5875618 1\nPWAV 1\nSURF 0\n  DISZ INFINITY\n\
                       SURF 1\n  STOP\n  CURV 0.02\n  DISZ 3\n  GLAS HX\nSURF 2\n  DISZ 45\nSURF 3\n  DISZ 0\n";
            let toml = |name: &str| own.replace(&format!("\"{glass}\""), &format!("\"{name}\""));
            let form = crate::interchange::Form::Zmx;
            for read in [
                read(&toml("HX"), "own.toml", &glasses, Reading::default()),
                read(&toml("dup/HX"), "own.toml", &glasses, Reading::default()),
                crate::interchange::parse(zmx, form, "a.zmx", &glasses),
            ] {
                let Imported { lens, notes: told } = read.expect("reads");
                let told: Vec<&String> = told.iter().filter(|n| n.contains("HX")).collect();
                assert_eq!(told.len(), notes, "{told:?}");
                for note in told {
                    assert!(
                        note.contains("catalogue dup has that name 2 times") && note.contains("the last"),
                        "{note}"
                    );
                    assert!(!note.contains("shipped") && note.contains("dup.agf"), "{note}");
                }
                let index = lens.surfaces[0].medium.index(500.0);
                assert_rel(index, (1.0 + 1.5 * 0.25 / (0.25 - 0.006_f64)).sqrt(), 1e-12, 0.0, "the last");
            }
        }
    }

    /// A file without clear semi-diameters but the stop's: they are those that [`apertures::open`] finds, and every ray of the field's beams passes.
    #[test]
    fn clear_semi_diameters_may_be_left_out() {
        for name in ["cooke_triplet", "double_gauss", "two_element"] {
            let lens = builtin::lens(name).expect("shipped");
            let text = prescription::to_toml(&lens);
            let without: String =
                text.lines().filter(|l| !l.starts_with("semi_diameter_mm")).map(|l| format!("{l}\n")).collect();
            assert_ne!(text, without);
            let read = read(&without, "own.toml", Glasses::shipped(), Reading::default())
                .unwrap_or_else(|e| panic!("{name}: {e}"));
            let told = format!("{0} of {0} clear", lens.surfaces.len());
            assert!(read.notes[0].contains(&told), "{name}: {:?}", read.notes);
            let size = |l: &Lens| paraxial::stop_semi_diameter(l);
            assert_rel(size(&read.lens), size(&lens), 1e-12, 0.0, name);
            // Twice found is once found.
            let mut again = (*read.lens).clone();
            apertures::open(&mut again, &vec![true; lens.surfaces.len()], &Beam::over_field(&lens));
            for (i, (a, b)) in again.surfaces.iter().zip(&read.lens.surfaces).enumerate() {
                assert_rel(a.semi_diameter, b.semi_diameter, 1e-5, 0.0, &format!("{name} {i}"));
            }
            // One alone, beside stated ones.
            let mut first = true;
            let keep = |l: &&str| !(l.starts_with("semi_diameter_mm") && std::mem::take(&mut first));
            let one: String = text.lines().filter(keep).map(|l| format!("{l}\n")).collect();
            let read = super::read(&one, "own.toml", Glasses::shipped(), Reading::default()).expect("reads");
            assert!(read.notes[0].starts_with("1 of"), "{:?}", read.notes);
            for (a, b) in read.lens.surfaces.iter().zip(&lens.surfaces).skip(1) {
                assert_eq!(a.semi_diameter, b.semi_diameter, "{name}");
            }
        }
    }

    /// An f-number of a lens without power is refused by one sentence, exactly afocal or by what rounding leaves.
    #[test]
    fn f_numbers_without_power_are_refused() {
        let plate = |radii: [f64; 2], aperture: &str| {
            format!(
                "schema = 1\nname = \"plate\"\nsource = \"own\"\naperture = {{ {aperture} }}\nobject = {{ distance_mm = inf }}\n\
                 field = {{ max_angle_deg = 5.0 }}\n\
                 wavelengths = {{ nm = [587.6], weights = [1.0], primary_nm = 587.6 }}\n\
                 sensor = {{ columns = 64, rows = 48, pitch_um = 5.0 }}\n\
                 [[surface]]\nradius_mm = {}\nthickness_mm = 3.0\nmedium = {{ n_d = 1.5, v_d = 60.0 }}\nsemi_diameter_mm = 8.0\n\
                 stop = true\n[[surface]]\nradius_mm = {}\nthickness_mm = 20.0\nmedium = \"air\"\nsemi_diameter_mm = 9.0\n",
                radii[0], radii[1]
            )
        };
        for radii in [[f64::INFINITY; 2], [50.0, 49.0], [-30.0, -31.0]] {
            let read_for = |aperture: &str, focal_length_mm: Option<f64>| {
                let reading = Reading { focal_length_mm, ..Reading::default() };
                read(&plate(radii, aperture), "p.toml", Glasses::shipped(), reading)
            };
            let read = |aperture: &str| read_for(aperture, None);
            // A start of an optimisation has the focal length that it is to have.
            let start = read_for("f_number = 4.0", Some(50.0)).expect("a start");
            assert_eq!(start.lens.aperture, Aperture::EntrancePupilDiameter(12.5), "{radii:?}");
            assert!(start.notes[0].contains("an entrance pupil of 12.5 mm"), "{:?}", start.notes);
            let error = read("f_number = 4.0").expect_err("no power").to_string();
            assert!(error.contains("aperture.f_number") && error.contains("without power"), "{radii:?}: {error}");
            assert!(read("stop_semi_diameter_mm = 5.0").is_ok(), "{radii:?}");
        }
    }
}
