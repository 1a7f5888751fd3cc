//! A lens as a Zemax OpticStudio file. Reading it again gives the same rays.

use std::fmt::Write;

use super::text::plain;
use crate::lens::catalogue::{Glasses, Naming};
use crate::lens::model_glass::{lines_of, lines_of_table};
use crate::lens::{Aperture, Lens, Medium, Shape, Surface, paraxial, place_of_medium};
use isoplanat_base::error::{Error, Result};

/// Wavelengths that OpticStudio takes.
const MOST_WAVELENGTHS: usize = 24;

/// The file's text, and notes on what it cannot say.
pub(super) fn write(lens: &Lens, glasses: &Glasses) -> Result<(String, Vec<String>)> {
    super::text::on_one_axis(lens, "a Zemax file")?;
    let mut notes = Vec::new();
    let mut catalogues: Vec<String> = Vec::new();
    let object_glass = glass(lens, 0, glasses, &mut catalogues)?;
    let mut body = String::new();
    for (i, s) in lens.surfaces.iter().enumerate() {
        let _ = write!(body, "SURF {}\n{}", i + 1, surface(lens, i, s, glasses, &mut catalogues, &mut notes)?);
    }
    let catalogues = ordered(lens, glasses, catalogues)?;
    let mut out = String::from("VERS 190513 0 0\nMODE SEQ\n");
    let name: String = lens.name.split_whitespace().collect::<Vec<_>>().join(" ");
    let _ = writeln!(out, "NAME {name}\nUNIT MM X W X CM MR CPMM");
    let _ = match lens.aperture {
        Aperture::EntrancePupilDiameter(d) => writeln!(out, "ENPD {}", plain(d)),
        Aperture::FNumber(f) => writeln!(out, "FNUM {} 0", plain(f)),
        Aperture::StopSemiDiameter(_) => writeln!(out, "FLOA"),
        Aperture::ObjectNa(na) => writeln!(out, "OBNA {} 0", plain(na)),
    };
    let _ = writeln!(out, "ENVD 20 1 0");
    if !catalogues.is_empty() {
        let _ = writeln!(out, "GCAT {}", catalogues.join(" "));
    }
    let w = &lens.wavelengths;
    let primary = w.nm.iter().position(|nm| *nm == w.primary_nm);
    let mut colours: Vec<(f64, f64)> = w.nm.iter().copied().zip(w.weights.iter().copied()).collect();
    if primary.is_none() {
        // A reference that is none of the wavelengths becomes one without weight.
        colours.push((w.primary_nm, 0.0));
    }
    // Angles are those at an entrance pupil: a lens that is telecentric in object space has none.
    let telecentric = paraxial::field_origin(lens).telecentric;
    let (heights, fields) = super::text::fields(lens);
    let kind = u8::from(heights);
    let _ = writeln!(out, "FTYP {kind} {} {} {}", u8::from(telecentric), fields.len(), colours.len());
    let _ = writeln!(out, "XFLN{}\nYFLN {}", " 0".repeat(fields.len()), super::text::list(&fields));
    for (i, (nm, weight)) in colours.iter().enumerate() {
        let _ = writeln!(out, "WAVM {} {} {}", i + 1, micrometres(*nm), plain(*weight));
    }
    notes.extend(super::text::many_wavelengths(colours.len(), "OpticStudio", MOST_WAVELENGTHS));
    let _ = writeln!(out, "PWAV {}", primary.unwrap_or(colours.len() - 1) + 1);
    let object = 1.0 / lens.object_vergence;
    let distance = if object.is_finite() { plain(object) } else { "INFINITY".into() };
    let _ = write!(out, "SURF 0\n  TYPE STANDARD\n  CURV 0\n  DISZ {distance}\n{object_glass}{body}");
    let image = lens.image;
    let _ =
        write!(out, "SURF {}\n  TYPE STANDARD\n  CURV {}\n  DISZ 0\n", lens.surfaces.len() + 1, plain(image.curvature));
    if image.conic != 0.0 {
        let _ = writeln!(out, "  CONI {}", plain(image.conic));
    }
    notes.push("a Zemax file states no sensor: its pixels are left out".into());
    Ok((out, notes))
}

/// The catalogues in an order in which every glass is found as itself: several have glasses of one name.
fn ordered(lens: &Lens, glasses: &Glasses, mut names: Vec<String>) -> Result<Vec<String>> {
    let colours: Vec<f64> = lens.wavelengths.nm.iter().copied().chain([lens.wavelengths.primary_nm]).collect();
    // Each wrong find moves the right catalogue before the wrong one; a circle ends it.
    for _ in 0..=names.len() * names.len() {
        let wrong = lens.media().enumerate().find_map(|(space, medium)| {
            let (catalogue, name) = glasses.named_as(medium)?;
            let found = glasses.catalogued(&name, Naming::Foreign(&names));
            // A newer edition of a catalogue may give the glass another range, and the same indices.
            let alike = |m: Medium| colours.iter().all(|nm| (m.index(*nm) - medium.index(*nm)).abs() <= 1e-12);
            (!found.is_ok_and(alike)).then_some((space, medium, catalogue))
        });
        let Some((space, medium, catalogue)) = wrong else { return Ok(names) };
        match names.iter().position(|n| *n == catalogue) {
            Some(at) if at > 0 => {
                let moved = names.remove(at);
                names.insert(0, moved);
            }
            _ => {
                let found = format!("the glass {medium} of {catalogue}, whose name others have");
                return Err(Error::bad(
                    lens.file(),
                    place_of_medium(space),
                    found,
                    "glasses that one list of catalogues tells apart",
                ));
            }
        }
    }
    Err(Error::bad(lens.file(), "medium", "glasses of one name", "glasses that one list of catalogues tells apart"))
}

/// The number of µm that a reader turns into exactly `nm`.
fn micrometres(nm: f64) -> String {
    let um = nm * 1e-3;
    let exact = [um, um.next_up(), um.next_down()].into_iter().find(|x| x * 1e3 == nm);
    plain(exact.unwrap_or(um))
}

/// The line of the medium of a space, counted as [`crate::lens::Prescription::media`] does; nothing of air.
fn glass(lens: &Lens, space: usize, glasses: &Glasses, catalogues: &mut Vec<String>) -> Result<String> {
    let Some(medium) = lens.media().nth(space) else { return Ok(String::new()) };
    let of_two = if matches!(medium, Medium::Cauchy { .. }) { Some(lines_of(medium)) } else { lines_of_table(medium) };
    Ok(match medium {
        Medium::Air => String::new(),
        // One index for all wavelengths.
        Medium::Table { index, .. } if index.iter().all(|n| *n == index[0]) => {
            format!("  GLAS ___BLANK 1 0 {} 0 0 0 0 0 0 0\n", plain(index[0]))
        }
        medium => {
            if let Some((n, v)) = of_two {
                return Ok(format!("  GLAS ___BLANK 1 0 {} {} 0 0 0 0 0 0\n", plain(n), plain(v)));
            }
            let Some((catalogue, name)) = glasses.named_as(medium) else {
                let allowed =
                    "a glass of a catalogue, or { n_d, v_d }, as its `medium` in a .toml: a Zemax file has no tables";
                return Err(Error::bad(lens.file(), place_of_medium(space), medium.to_string(), allowed));
            };
            let (n, v) = lines_of(medium);
            if !catalogues.contains(&catalogue) {
                catalogues.push(catalogue);
            }
            format!("  GLAS {name} 0 0 {} {} 0 0 0 0 0 0\n", plain(n), plain(v))
        }
    })
}

fn surface(
    lens: &Lens,
    i: usize,
    s: &Surface,
    glasses: &Glasses,
    catalogues: &mut Vec<String>,
    notes: &mut Vec<String>,
) -> Result<String> {
    let mut out = String::new();
    if i == lens.stop {
        out.push_str("  STOP\n");
    }
    // `on_one_axis` has refused what is not symmetric, and nothing else. A rotational form is written here or refused here by name; one
    // that is left out is refused when the text is read again (`same.rs`).
    let Shape { curvature, conic, asphere, odd: odd_terms, zernike: _, xy: _, ideal } = &s.shape;
    let used = |terms: &[f64]| terms.iter().rposition(|a| *a != 0.0).map_or(0, |last| last + 1);
    let (even, odd) = (used(asphere), used(odd_terms));
    let kind = match (even, odd) {
        _ if ideal.is_some() => "PARAXIAL",
        (0, 0) => "STANDARD",
        (1..=8, 0) => "EVENASPH",
        (0..=4, 1..=3) => "ODDASPHE",
        (_, 0) => "XASPHERE",
        _ => "XOSPHERE",
    };
    let _ = writeln!(out, "  TYPE {kind}\n  CURV {} 0 0 0 0 \"\"", plain(*curvature));
    if let Some(f) = ideal {
        let _ = writeln!(out, "  PARM 1 {}\n  PARM 2 1", plain(*f));
    }
    let powers = (1..=even).map(|k| 2 * k).zip(asphere).chain((1..=odd).map(|k| 2 * k + 1).zip(odd_terms));
    let step = if ["EVENASPH", "XASPHERE"].contains(&kind) { 2 } else { 1 };
    if kind.starts_with('X') {
        // Terms of r in mm: the normalising radius is 1.
        let count = (2 * even).max(2 * odd + 1) / step;
        let _ = writeln!(out, "  XDAT 1 {count} 0 0 1 0 0 \"\"\n  XDAT 2 1 0 0 1 0 0 \"\"");
    }
    for (power, a) in powers {
        let _ = match kind.starts_with('X') {
            true => writeln!(out, "  XDAT {} {} 0 0 1 0 0 \"\"", power / step + 2, plain(*a)),
            false => writeln!(out, "  PARM {} {}", power / step, plain(*a)),
        };
    }
    let _ = writeln!(out, "  DISZ {}", plain(s.thickness));
    out.push_str(&glass(lens, i + 1, glasses, catalogues)?);
    if *conic != 0.0 {
        let _ = writeln!(out, "  CONI {}", plain(*conic));
    }
    let r =
        if let (true, Aperture::StopSemiDiameter(r)) = (i == lens.stop, lens.aperture) { r } else { s.semi_diameter };
    let _ = writeln!(out, "  DIAM {} 1 0 0 1 \"\"\n  FLAP 0 {} 0", plain(r), plain(r));
    if matches!(s.medium, Medium::Cauchy { .. }) && notes.is_empty() {
        notes.push("media of two numbers are written by their index at 587.5618 nm and their Abbe number of d, F, C: the same curve".into());
    }
    Ok(out)
}
