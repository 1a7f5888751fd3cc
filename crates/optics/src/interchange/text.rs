//! Lines of a file with the place that errors name.

use crate::lens::{Field, Lens, paraxial};
use isoplanat_base::error::{Error, Location, Result};
use std::collections::BTreeMap;

/// The largest object's height, mm, where a file states heights: those of the lens, or those of its angles where it is telecentric in
/// object space and other programs know no angles.
fn object_height(lens: &Lens) -> Option<f64> {
    let origin = paraxial::field_origin(lens);
    match lens.field {
        Field::ObjectHeight(height) => Some(height),
        Field::Angle(angle) if origin.telecentric => Some(angle.to_radians().tan() / lens.object_vergence),
        Field::Angle(_) => None,
    }
}

/// The fields to write, in a file that states heights or angles: those of the lens, or the axis, 0.7 of the largest and the largest.
pub(super) fn fields(lens: &Lens) -> (bool, Vec<f64>) {
    let heights = object_height(lens);
    let largest = heights.unwrap_or(lens.max_field_deg());
    let angles = lens.field_points_deg();
    let own: Vec<f64> = match (lens.field, heights) {
        (Field::Angle(_), Some(_)) => angles.iter().map(|a| a.to_radians().tan() / lens.object_vergence).collect(),
        (Field::Angle(_), None) => angles,
        (Field::ObjectHeight(_), _) => lens.field_points.iter().copied().filter(|p| *p <= largest).collect(),
    };
    let usual = || [0.0, 0.7, 1.0].map(|share| share * largest).to_vec();
    (heights.is_some(), if own.last() == Some(&largest) { own } else { usual() })
}

/// What is told of a file with more wavelengths than its own program, which takes `most`, reads.
pub(super) fn many_wavelengths(count: usize, program: &str, most: usize) -> Option<String> {
    (count > most).then(|| {
        format!(
            "{count} wavelengths are written, and {program} reads {most} at most: there it is a lens for other light"
        )
    })
}

/// The words of one line.
pub(super) struct Line<'a> {
    pub(super) file: &'a str,
    /// Where the line stands, for errors.
    pub(super) place: Location,
    /// Words behind the keyword.
    pub(super) words: Vec<&'a str>,
}

impl Line<'_> {
    /// An error of this line.
    pub(super) fn refused(&self, found: impl Into<String>, allowed: impl Into<String>) -> Error {
        Error::bad(self.file, &self.place, found, allowed)
    }

    /// The word `i` as a finite number.
    pub(super) fn number(&self, i: usize) -> Result<f64> {
        self.optional(i)?
            .ok_or_else(|| self.refused(format!("{} numbers", self.words.len()), format!("at least {}", i + 1)))
    }

    /// [`Self::number`], `None` where the line is shorter.
    pub(super) fn optional(&self, i: usize) -> Result<Option<f64>> {
        let Some(word) = self.words.get(i) else { return Ok(None) };
        let number = word.parse::<f64>().ok().filter(|x| x.is_finite());
        number.map(Some).ok_or_else(|| self.refused(format!("`{}`", shown(word)), "a finite number"))
    }

    /// All words as finite numbers.
    pub(super) fn numbers(&self) -> Result<Vec<f64>> {
        (0..self.words.len()).map(|i| self.number(i)).collect()
    }

    /// The word `i` as a count from 0 to `most`.
    pub(super) fn count(&self, i: usize, most: usize) -> Result<usize> {
        let word = self.words.get(i).copied().unwrap_or("");
        // Some programs write counts as 6.0.
        let digits = word
            .split_once('.')
            .map_or(word, |(whole, rest)| if rest.bytes().all(|b| b == b'0') { whole } else { word });
        let number = digits.parse::<usize>().ok().filter(|n| *n <= most);
        number.ok_or_else(|| self.refused(format!("`{}`", shown(word)), format!("a whole number up to {most}")))
    }
}

/// Lines that a file states once: what each of them said first, and where.
#[derive(Default)]
pub(super) struct Once(BTreeMap<String, (Vec<String>, Location)>);

impl Once {
    /// Takes the line `key`, whose numbers begin with the word `from`. The same line again is the same statement.
    ///
    /// # Errors
    /// A second line of that key with other words: which one counts is not for this program to choose.
    pub(super) fn take(&mut self, key: &str, from: usize, line: &Line) -> Result<()> {
        let words = line.words.get(from..).unwrap_or_default();
        match self.0.get(key) {
            None => {
                let stated = words.iter().map(|w| (*w).to_owned()).collect();
                self.0.insert(key.to_owned(), (stated, line.place.clone()));
                Ok(())
            }
            Some((first, _)) if alike(first, words) => Ok(()),
            Some((first, place)) => {
                let found = format!("{key} {} beside {} at {place}", shown(&words.join(" ")), shown(&first.join(" ")));
                Err(line.refused(found, format!("one statement of {key}")))
            }
        }
    }
}

/// Whether two lines say the same: what the shorter one leaves out is 0 or an empty text.
fn alike(a: &[String], b: &[&str]) -> bool {
    let number = |w: &str| if w.trim_matches('"').is_empty() { Some(0.0) } else { w.parse::<f64>().ok() };
    let word = |w: Option<&str>| w.unwrap_or("\"\"").to_owned();
    (0..a.len().max(b.len())).all(|i| {
        let (a, b) = (word(a.get(i).map(String::as_str)), word(b.get(i).copied()));
        a == b || number(&a).is_some_and(|a| number(&b) == Some(a))
    })
}

/// A word of a file as an error shows it: short, without control characters.
pub(super) fn shown(word: &str) -> String {
    let clean: String = word.chars().filter(|c| !c.is_control()).take(40).collect();
    if word.chars().count() > 40 { format!("{clean}…") } else { clean }
}

/// A number as files state it: it reads back to the last bit.
pub(super) fn plain(x: f64) -> String {
    if x == 0.0 || (1e-4..1e7).contains(&x.abs()) { format!("{x}") } else { format!("{x:e}") }
}

/// [`plain`] numbers with spaces between.
pub(super) fn list(numbers: &[f64]) -> String {
    numbers.iter().copied().map(plain).collect::<Vec<_>>().join(" ")
}

/// Refuses a lens with tilts, decentres or freeform terms, which `what` cannot say.
pub fn on_one_axis(lens: &Lens, what: &str) -> Result<()> {
    for (i, s) in lens.surfaces.iter().enumerate() {
        let freeform = !s.shape.is_symmetric();
        if freeform || s.pose.is_some_and(|p| !p.is_nominal()) {
            let found = if freeform { "freeform terms" } else { "a tilt or decentre" };
            let allowed = format!("surfaces of revolution on one axis in {what}; a TOML file takes any");
            return Err(Error::bad(lens.file(), Location::surface(i), found, allowed));
        }
    }
    match lens.elements.iter().position(|e| !e.pose.is_nominal()) {
        Some(i) => {
            let allowed = format!("surfaces on one axis in {what}; a TOML file takes any");
            Err(Error::bad(lens.file(), format!("element[{i}]"), "a tilt or decentre", allowed))
        }
        None => Ok(()),
    }
}
