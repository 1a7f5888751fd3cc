//! A lens as a CODE V sequence. Reading it again gives the same rays.

use std::fmt::Write;

use super::text::plain;
use crate::lens::catalogue::{Glasses, Naming};
use crate::lens::{Aperture, Lens, Medium, Shape, paraxial};
use isoplanat_base::error::{Error, Location, Result};

/// Wavelengths that CODE V takes.
const MOST_WAVELENGTHS: usize = 21;

/// The file's text, and notes on what it cannot say.
pub(super) fn write(lens: &Lens, glasses: &Glasses) -> Result<(String, Vec<String>)> {
    super::text::on_one_axis(lens, "a CODE V file")?;
    let mut notes = Vec::new();
    let mut private = Vec::new();
    let object_medium = medium(lens, &lens.object_medium, glasses, &mut private);
    let mut body = String::new();
    for (i, s) in lens.surfaces.iter().enumerate() {
        let medium = medium(lens, &s.medium, glasses, &mut private);
        // `on_one_axis` has refused what is not symmetric, and nothing else. A rotational form is written here or refused here by name; one
        // that is left out is refused when the text is read again (`same.rs`).
        let Shape { curvature, conic, asphere, odd, zernike: _, xy: _, ideal } = &s.shape;
        if let Some(f) = ideal {
            let place = Location::surface(i).key("ideal_focal_length_mm");
            let allowed = "surfaces that refract: a sequence has no ideal lens; .zmx and .toml have";
            return Err(Error::bad(lens.file(), place, f.to_string(), allowed));
        }
        let _ = writeln!(body, "S {} {}{medium}", plain(*curvature), plain(s.thickness));
        let even = asphere.iter().enumerate().filter(|(_, a)| **a != 0.0).map(|(k, _)| 2 * (k + 1));
        let odd = odd.iter().enumerate().filter(|(_, a)| **a != 0.0).map(|(k, _)| 2 * k + 3);
        if let Some(power) = even.filter(|p| !(4..=20).contains(p)).chain(odd).next() {
            let allowed = "even terms from a4 to a20, which an asphere of CODE V has; .zmx and .toml take all";
            let place = Location::surface(i).key("asphere");
            return Err(Error::bad(lens.file(), place, format!("a term of r^{power}"), allowed));
        }
        if *conic != 0.0 || asphere.iter().any(|a| *a != 0.0) {
            let _ = writeln!(body, "  ASP\n  K {}", plain(*conic));
            for (letter, a) in "ABCDEFGHJ".chars().zip(asphere.iter().skip(1)) {
                let _ = writeln!(body, "  {letter} {}", plain(*a));
            }
        }
        if i == lens.stop {
            body.push_str("  STO\n");
        }
        let _ = writeln!(body, "  CIR {}", plain(s.semi_diameter));
    }
    let w = &lens.wavelengths;
    let mut colours: Vec<(f64, f64)> = w.nm.iter().copied().zip(w.weights.iter().copied()).collect();
    let primary = w.nm.iter().position(|nm| *nm == w.primary_nm).unwrap_or_else(|| {
        colours.push((w.primary_nm, 0.0));
        colours.len() - 1
    });
    notes.extend(super::text::many_wavelengths(colours.len(), "CODE V", MOST_WAVELENGTHS));
    let first = paraxial::first_order(lens, w.primary_nm);
    let list = |number: fn(&(f64, f64)) -> f64| colours.iter().map(|c| plain(number(c))).collect::<Vec<_>>().join(" ");
    let name: String = lens.name.split_whitespace().collect::<Vec<_>>().join(" ").replace('\'', "’");
    let mut out = String::from("RDM N;LEN\n");
    // A pupil at infinity has no diameter.
    let by_angle = matches!(lens.aperture, Aperture::ObjectNa(_)) || paraxial::field_origin(lens).telecentric;
    let size = if by_angle {
        let slope = lens.object_vergence * paraxial::marginal_height(lens, w.primary_nm);
        format!("NAO {}", plain(lens.object_medium.index(w.primary_nm) * slope.atan().sin()))
    } else {
        format!("EPD {}", plain(first.entrance_pupil_diameter))
    };
    let _ = writeln!(out, "TITLE '{name}'\n{size}\nDIM M");
    let _ = writeln!(out, "WL {}\nREF {}\nWTW {}", list(|c| c.0), primary + 1, list(|c| c.1));
    let (heights, fields) = super::text::fields(lens);
    let kind = if heights { "OB" } else { "AN" };
    let _ = writeln!(out, "X{kind}{}\nY{kind} {}", " 0".repeat(fields.len()), super::text::list(&fields));
    if !private.is_empty() {
        notes.push(format!("media without a catalogue are written as tables: {} of them", private.len()));
        out.push_str("PRV\n");
        for (name, table) in &private {
            let numbers = |of: fn(&(f64, f64)) -> f64| table.iter().map(|t| plain(of(t))).collect::<Vec<_>>().join(" ");
            let _ = writeln!(out, "PWL {}\n'{name}' {}", numbers(|t| t.0), numbers(|t| t.1));
        }
        out.push_str("END\n");
    }
    let object = 1.0 / lens.object_vergence;
    let object = if object.is_finite() { plain(object) } else { "1e13".into() };
    let image = lens.image;
    let conic = if image.conic == 0.0 { String::new() } else { format!("  CON\n  K {}\n", plain(image.conic)) };
    let _ = write!(out, "SO 0 {object}{object_medium}\n{body}SI {} 0\n{conic}GO\n", plain(image.curvature));
    notes.push("a CODE V file states no sensor: its pixels are left out".into());
    notes.push(if by_angle {
        "the aperture is written as the numerical aperture in object space".into()
    } else {
        "the aperture is written as the diameter of the entrance pupil".into()
    });
    Ok((out, notes))
}

/// The medium behind a surface, with a space before it; private glasses are added to `private`.
fn medium(lens: &Lens, medium: &Medium, glasses: &Glasses, private: &mut Vec<(String, Vec<(f64, f64)>)>) -> String {
    if *medium == Medium::Air {
        return String::new();
    }
    let listed = glasses.named_as(medium);
    // By its name alone where it is found again without further catalogues; any other glass goes along as a table.
    if let Some((catalogue, name)) = &listed
        && !catalogue.contains(['_', ' '])
        && Glasses::shipped().find(&format!("{catalogue}/{name}"), Naming::Foreign(&[])).is_ok_and(|m| m == *medium)
    {
        return format!(" {}_{catalogue}", name.replace('-', ""));
    }
    let table: Vec<(f64, f64)> = match medium {
        Medium::Table { wavelength_nm, index } => wavelength_nm.iter().copied().zip(index.iter().copied()).collect(),
        _ => {
            // The lens's own wavelengths and some between; a two-term Cauchy curve is the table's own between them.
            let [short, long] = medium.range_nm().map(|nm| nm.clamp(200.0, 20_000.0));
            let w = &lens.wavelengths;
            let mut nm: Vec<f64> = w.nm.iter().copied().chain([w.primary_nm]).collect();
            if matches!(medium, Medium::Cauchy { .. }) {
                nm.extend([short, long]);
            } else {
                nm.extend((1..8).map(|k| short + (long - short) * f64::from(k) / 8.0));
            }
            nm.sort_by(f64::total_cmp);
            nm.dedup();
            nm.into_iter().map(|nm| (nm, medium.index(nm))).collect()
        }
    };
    let known = private.iter().find(|(_, t)| *t == table).map(|(n, _)| n.clone());
    let name = known.unwrap_or_else(|| {
        // A glass keeps its name; a table of its own is numbered.
        let own = listed.map(|(catalogue, name)| format!("{}_{catalogue}", name.replace('-', "")));
        let own = own.filter(|n| !n.contains([' ', '\'', ';']) && private.iter().all(|(other, _)| other != n));
        let name = own.unwrap_or_else(|| format!("G{}", private.len() + 1));
        private.push((name.clone(), table));
        name
    });
    format!(" '{name}'")
}
