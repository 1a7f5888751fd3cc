//! AGF catalogues: a glass is a line `NM name formula code n_d V_d exclude status …`, with its coefficients in `CD` and its range in `LD` (µm).
//!
//! A glass without its coefficients would be one of index 1, and of two lines of them one is another glass's: both are refused. One whose coefficients make another index than its
//! line states is in the catalogue, and refused where a lens names it.

use super::{Entry, finite, glass};
use crate::lens::dispersion::Formula;
use isoplanat_base::error::{Error, Location, Result};

/// Lines of a glass that say nothing of its index at room temperature: comment, expansion and density, thermal coefficients, prices and
/// resistances, transmission, mechanics, bubbles.
const HARMLESS: [&str; 8] = ["GC", "ED", "TD", "OD", "IT", "CC", "MD", "BD"];

/// What a line of coefficients, and one of wavelengths, are.
const COEFFICIENTS: &str = "one line CD with the coefficients of its formula, behind the glass's NM";
const WAVELENGTHS: &str = "one line LD with shortest and longest wavelength in µm, behind the glass's NM";

/// A glass as its lines have it so far.
struct Glass<'a> {
    /// Where it begins, from 1.
    line: usize,
    name: &'a str,
    formula: std::result::Result<(Formula, usize), String>,
    coefficients: Option<Vec<f64>>,
    range_um: Option<[f64; 2]>,
    /// Its index at the d line, where the catalogue states one.
    n_d: Option<f64>,
    obsolete: bool,
}

/// How far an index may be from the one that the catalogue states: catalogues of infrared glasses have 1 there, others round, or mean another melt.
const NEAR: f64 = 0.02;
/// The d line, nm.
const HELIUM_NM: f64 = 587.5618;
/// Indices that a glass may have at the d line.
const STATED: std::ops::Range<f64> = 1.25..3.0;

impl Glass<'_> {
    fn entry(self, file: &str) -> Result<Entry> {
        // A formula that is none needs no coefficients: the glass is none.
        if self.formula.is_ok() && self.coefficients.is_none() {
            let found = format!("glass `{}` without coefficients", self.name);
            return Err(Error::bad(file, Location::line(self.line), found, COEFFICIENTS));
        }
        let medium = self.formula.and_then(|(formula, count)| {
            let range = self.range_um.ok_or("no wavelengths (a line LD)")?;
            let mut coefficients = self.coefficients.unwrap_or_default();
            // What stands behind a formula's own coefficients is nought, and trailing noughts may be left out.
            coefficients.resize(count, 0.0);
            let medium = glass(self.name, file, formula, coefficients, range.map(|um| um * 1e3))?;
            let stated = self.n_d.filter(|n| STATED.contains(n) && (range[0]..=range[1]).contains(&(HELIUM_NM * 1e-3)));
            let index = medium.index(HELIUM_NM);
            match stated {
                Some(n_d) if !(n_d - NEAR..=n_d + NEAR).contains(&index) => {
                    Err(format!("coefficients that make its n_d {index:.4}, where the line says {n_d}"))
                }
                _ => Ok(medium),
            }
        });
        Ok(Entry { name: self.name.to_owned(), medium, obsolete: self.obsolete })
    }
}

/// The formula of a number, and its coefficients.
fn formula(number: f64) -> std::result::Result<(Formula, usize), String> {
    #[expect(clippy::cast_possible_truncation, reason = "a small number, or another than those below")]
    Ok(match number as i64 {
        1 => (Formula::Schott, 6),
        2 => (Formula::Sellmeier, 6),
        3 => (Formula::Herzberger, 6),
        4 => (Formula::Sellmeier2, 5),
        5 => (Formula::Conrady, 3),
        6 => (Formula::Sellmeier, 8),
        7 => (Formula::Handbook1, 4),
        8 => (Formula::Handbook2, 4),
        9 => (Formula::Sellmeier4, 5),
        10 => (Formula::Extended, 8),
        11 => (Formula::Sellmeier, 10),
        12 => (Formula::Extended2, 8),
        13 => (Formula::Extended3, 9),
        _ => return Err(format!("a dispersion formula of number {number}, which is none of 1 to 13")),
    })
}

/// The glasses of `text`; `file` names it.
pub(super) fn read(text: &str, file: &str) -> Result<Vec<Entry>> {
    let mut entries = Vec::new();
    let mut open: Option<Glass<'_>> = None;
    for (i, line) in text.lines().enumerate() {
        let line = line.trim_start_matches('\u{feff}').trim();
        let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let refuse = |found: &str, allowed: &str| Error::bad(file, Location::line(i + 1), found, allowed);
        let numbers = |what: &str| finite(rest).ok_or_else(|| refuse(line, &format!("{what}: finite numbers")));
        match (key, &mut open) {
            ("NM", _) => {
                let mut words = rest.split_whitespace();
                let name = words.next().ok_or_else(|| refuse(line, "NM with a name and the number of a formula"))?;
                let number = words.next().and_then(|w| w.parse::<f64>().ok());
                let number = number.ok_or_else(|| refuse(line, "NM with a name and the number of a formula"))?;
                if number.fract() != 0.0 {
                    let found = format!("glass `{name}` with a dispersion formula of number {number}");
                    return Err(refuse(&found, "a whole number from 1 to 13"));
                }
                // Behind the formula: six digits, n_d, V_d, a flag, the status, of which 2 is a type that is no longer made.
                let n_d = words.nth(1).and_then(|w| w.parse::<f64>().ok());
                let obsolete = words.nth(2).and_then(|w| w.parse::<f64>().ok()) == Some(2.0);
                let formula = formula(number);
                let next = Glass { line: i + 1, name, formula, coefficients: None, range_um: None, n_d, obsolete };
                entries.extend(open.replace(next).map(|g| g.entry(file)).transpose()?);
            }
            ("CD", Some(glass)) => {
                let coefficients = numbers("coefficients")?;
                if coefficients.is_empty() {
                    return Err(refuse(
                        &format!("glass `{}` with a line CD without numbers", glass.name),
                        COEFFICIENTS,
                    ));
                }
                if glass.coefficients.replace(coefficients).is_some() {
                    return Err(refuse(&format!("glass `{}` with a second line CD", glass.name), COEFFICIENTS));
                }
            }
            ("LD", Some(glass)) => {
                let ends = numbers("shortest and longest wavelength in µm")?;
                let [short, long, ..] = ends[..] else {
                    return Err(refuse(line, "shortest and longest wavelength in µm"));
                };
                if glass.range_um.replace([short, long]).is_some() {
                    return Err(refuse(&format!("glass `{}` with a second line LD", glass.name), WAVELENGTHS));
                }
            }
            ("CD", None) => return Err(refuse("CD before the first glass", COEFFICIENTS)),
            ("LD", None) => return Err(refuse("LD before the first glass", WAVELENGTHS)),
            // Before the first glass some files have a line of prose.
            (_, None) => {}
            _ if key.is_empty() || key.starts_with('!') || HARMLESS.contains(&key) => {}
            _ => return Err(refuse(line, "NM, CD, LD, or a comment (GC, CC, !), ED, TD, OD, IT, MD, BD")),
        }
    }
    entries.extend(open.map(|g| g.entry(file)).transpose()?);
    if entries.is_empty() {
        return Err(Error::bad(file, "glasses", "none", "lines NM of an AGF catalogue"));
    }
    Ok(entries)
}
