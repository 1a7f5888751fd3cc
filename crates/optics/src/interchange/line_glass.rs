//! A glass by its name with the index and the Abbe number that its line states beside it, as `GLAS` of Zemax files does.
//!
//! The glass of a name is the maker's: another maker's of the same name is another glass. The catalogues that the file names come first; the line's own
//! `n_d` is held against every candidate, and a glass more than [`SAME_INDEX`] away from it is refused.
//!
//! Not every number is a statement. Programs write 1.5 and 40, or 0 and 0, where nothing is known. Where a glass replaced a model glass, was picked
//! up from another line or may be substituted, the line keeps the numbers of what stood there before; 1.5168 and 64.17, those of N-BK7, are what it keeps most
//! often. Such numbers are not held against a glass; where they differ that is told. They still serve as a model glass when that is asked for.

use crate::lens::Medium;
use crate::lens::catalogue::{Glasses, MODEL, Naming};
use crate::lens::model_glass::{LINES_NM, cauchy_of_lines, fictitious, lines_of};
use isoplanat_base::error::{Error, Result};

/// Largest difference of two statements of one index at 587.5618 nm.
const SAME_INDEX: f64 = 1e-4;
/// Largest difference of two statements of one Abbe number, in parts of it; beyond it another candidate is looked for.
const SAME_ABBE: f64 = 0.01;

/// A glass by name, and the numbers of its line.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct OfLine {
    name: String,
    /// Index at the d line and Abbe number (0: none stated); `None` where the line has none, or those of "nothing known".
    lines: Option<(f64, f64)>,
    /// Whether the numbers may be left from another glass.
    left_over: bool,
    /// Whether a model glass of the numbers may be offered: it is known in the visible alone.
    offered: bool,
}

impl OfLine {
    /// The glass `name` with the numbers `n_d`, `v_d`; `marked` where the line itself says that they are another's.
    pub(super) fn new(name: &str, n_d: f64, v_d: f64, marked: bool) -> Self {
        let nothing = n_d == 0.0 || (n_d, v_d) == (1.5, 40.0);
        let of_bk7 = (n_d - 1.5168).abs() < 5e-5 && (v_d - 64.17).abs() < 0.02;
        Self {
            name: name.to_owned(),
            lines: (!nothing).then_some((n_d, v_d)),
            left_over: marked || of_bk7,
            offered: true,
        }
    }

    /// Says whether the light has wavelengths at which a model glass is known.
    pub(super) fn offering(&mut self, offered: bool) {
        self.offered = offered;
    }

    pub(super) fn resolve(&self, glasses: &Glasses, catalogues: &[String]) -> Result<(Medium, Option<String>)> {
        let name = self.name.as_str();
        match (glasses.stands_for(name, catalogues), self.lines) {
            (Some(glass), Some((n_d, v_d))) if glass.eq_ignore_ascii_case(MODEL) => {
                let told = format!("glass {name}: the model glass of its line, n_d {n_d}, V_d {v_d}");
                return Ok((cauchy_of_lines(n_d, v_d)?, Some(told)));
            }
            (Some(_), _) => return Ok((glasses.find(name, Naming::Foreign(catalogues))?, None)),
            (None, _) => {}
        }
        let found = glasses.candidates(name);
        if let (true, Some((n_d, v_d))) = (found.is_empty(), fictitious(name)) {
            return Ok((cauchy_of_lines(n_d, v_d)?, None));
        }
        let Some((n_d, v_d)) = self.lines.filter(|_| !found.is_empty() && !self.left_over) else {
            let medium = glasses.find(name, Naming::Foreign(catalogues)).map_err(|e| self.or_model(e))?;
            let told = self.told(&medium, glasses, catalogues);
            return Ok((medium, told));
        };
        let rank = |catalogue: &str| catalogues.iter().position(|c| c.eq_ignore_ascii_case(catalogue));
        // An index outside of what the catalogue knows says nothing.
        let known = |m: &Medium| Some(m.index(LINES_NM[0])).filter(|n| n.is_finite());
        let agrees = |m: &Medium| known(m).is_none_or(|n| (n - n_d).abs() <= SAME_INDEX);
        let other_abbe = |m: &Medium| v_d > 0.0 && (lines_of(m).1 / v_d - 1.0).abs() > SAME_ABBE;
        let mut alike: Vec<&(&str, &Medium)> = found.iter().filter(|(_, m)| agrees(m)).collect();
        alike.sort_by_key(|(c, m)| (other_abbe(m), rank(c).unwrap_or(usize::MAX)));
        let Some((_, medium)) = alike.first() else {
            let stated: Vec<String> = found
                .iter()
                .map(|(c, m)| format!("{c}/{} has {:.6}", shown(m), known(m).unwrap_or(f64::NAN)))
                .collect();
            let (first, of) = (&found[0], name);
            let found = format!("glass `{of}` of n_d {n_d}, V_d {v_d}, while {}", stated.join(", "));
            let model =
                if self.offered { format!("--glass-for {of}={MODEL} for these two numbers, ") } else { String::new() };
            let allowed = format!(
                "a glass within {SAME_INDEX} of it: its maker's catalogue by --glass FILE; or {model}--glass-for {of}={}/{} for that glass",
                first.0,
                shown(first.1)
            );
            return Err(Error::bad("", "medium", found, allowed));
        };
        let told = self.told(medium, glasses, catalogues);
        Ok(((*medium).clone(), told))
    }

    /// What is told of a medium that was found.
    fn told(&self, medium: &Medium, glasses: &Glasses, catalogues: &[String]) -> Option<String> {
        let name = self.name.as_str();
        let mut told = Vec::new();
        let of = glasses.named_as(medium).map(|(catalogue, _)| catalogue);
        if let Some(of) =
            of.filter(|of| !catalogues.is_empty() && !catalogues.iter().any(|c| c.eq_ignore_ascii_case(of)))
        {
            told.push(format!(
                "taken from {of}: the file's own catalogues ({}) do not have it at hand",
                catalogues.join(", ")
            ));
        }
        let index = medium.index(LINES_NM[0]);
        if let Some((n_d, _)) = self.lines.filter(|(n, _)| self.left_over && (n - index).abs() > SAME_INDEX) {
            told.push(format!(
                "its n_d is {index:.6}; the line's {n_d} is taken as left from another glass (--glass-for {name}={MODEL} takes it)"
            ));
        }
        let (d, abbe) = lines_of(medium);
        let stated = self.lines.filter(|(n, v)| *v > 0.0 && (n - d).abs() <= SAME_INDEX);
        if let Some((_, v_d)) = stated.filter(|(_, v)| (abbe / v - 1.0).abs() > SAME_ABBE) {
            told.push(format!("its V_d is {abbe:.2}, the line's {v_d} is not used"));
        }
        (!told.is_empty()).then(|| format!("glass {name}: {}", told.join("; ")))
    }

    /// The error of an unknown glass, which the line's numbers may stand in for.
    fn or_model(&self, error: Error) -> Error {
        let name = &self.name;
        let Some((n_d, v_d)) = self.lines.filter(|_| self.offered) else {
            return error.or_else_allowed(&format!("--glass-for {name}=GLASS for another in its place"));
        };
        error.or_else_allowed(&format!("--glass-for {name}={MODEL} for the n_d {n_d} and V_d {v_d} of its line"))
    }
}

fn shown(medium: &Medium) -> String {
    match medium {
        Medium::Glass { name, .. } => name.clone(),
        other => other.to_string(),
    }
}
