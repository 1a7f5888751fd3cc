//! Where in a file a value stands: a line, a surface, a key.

use std::fmt;

/// A place in a file or argument. What is not known is left out: `line 12 (SURF 3): surface[2].medium`.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Location {
    /// The line, from 1.
    pub line: Option<usize>,
    /// What the file itself calls the place: `SURF 3`.
    pub label: String,
    /// Surfaces of the lens, from 0; two where it is about a gap.
    pub surfaces: Vec<usize>,
    /// The key: of the surface where there is one, of the file where there is none.
    pub key: String,
}

impl Location {
    /// The line `line`, from 1.
    #[must_use]
    pub fn line(line: usize) -> Self {
        Self { line: Some(line), ..Self::default() }
    }

    /// A place by the file's own name for it.
    #[must_use]
    pub fn called(label: impl Into<String>) -> Self {
        Self { label: label.into(), ..Self::default() }
    }

    /// Surface `surface` of the lens, from 0.
    #[must_use]
    pub fn surface(surface: usize) -> Self {
        Self { surfaces: vec![surface], ..Self::default() }
    }

    /// The key `key` below it.
    #[must_use]
    pub fn key(mut self, key: impl AsRef<str>) -> Self {
        self.key = joined(&self.key, key.as_ref());
        self
    }

    /// Whether nothing is known.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// The same place below `outer`: its line and name where there are none here, its keys before the ones here.
    #[must_use]
    pub fn within(self, outer: impl Into<Self>) -> Self {
        let outer: Self = outer.into();
        let own = !outer.key.is_empty() || !outer.surfaces.is_empty();
        let (surfaces, key) = match own {
            // Surfaces of a lens that stands below a key are part of the path.
            true => (outer.surfaces.clone(), joined(&outer.key, &self.path())),
            false => (self.surfaces, self.key),
        };
        let stated = self.line.is_some() || !self.label.is_empty();
        let (line, label) = if stated { (self.line, self.label) } else { (outer.line, outer.label) };
        Self { line, label, surfaces, key }
    }

    /// Surfaces and key: `surface[2].medium`.
    fn path(&self) -> String {
        let surfaces: Vec<String> = self.surfaces.iter().map(|i| format!("surface[{i}]")).collect();
        joined(&surfaces.join(" and "), &self.key)
    }
}

/// A key below another, either of which may be missing.
fn joined(outer: &str, key: &str) -> String {
    let dot = if outer.is_empty() || key.is_empty() { "" } else { "." };
    format!("{outer}{dot}{key}")
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = self.line.map(|line| format!("line {line}")).unwrap_or_default();
        let outer = match (line.is_empty(), self.label.is_empty()) {
            (false, false) => format!("{line} ({})", self.label),
            _ => line + &self.label,
        };
        let path = self.path();
        let colon = if outer.is_empty() || path.is_empty() { "" } else { ": " };
        write!(f, "{outer}{colon}{path}")
    }
}

impl From<&str> for Location {
    fn from(key: &str) -> Self {
        Self::default().key(key)
    }
}

impl From<String> for Location {
    fn from(key: String) -> Self {
        Self { key, ..Self::default() }
    }
}

impl From<&String> for Location {
    fn from(key: &String) -> Self {
        Self::from(key.as_str())
    }
}

impl From<&Self> for Location {
    fn from(place: &Self) -> Self {
        place.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is known is said, from the outside in.
    #[test]
    fn places_print_what_is_known() {
        let medium = Location::surface(2).key("medium");
        let line = Location { label: "SURF 3".into(), ..Location::line(12) };
        for (place, text) in [
            (Location::default(), ""),
            ("wavelengths.nm".into(), "wavelengths.nm"),
            (Location::line(4), "line 4"),
            (line.clone(), "line 12 (SURF 3)"),
            (Location::called("the object"), "the object"),
            (Location::surface(2), "surface[2]"),
            (medium.clone(), "surface[2].medium"),
            (Location { surfaces: vec![0, 1], ..Location::default() }, "surface[0] and surface[1]"),
            (medium.clone().within(line.clone()), "line 12 (SURF 3): surface[2].medium"),
            (Location::from("medium").within(line), "line 12 (SURF 3): medium"),
            (Location::from("train.batch").within("stages[1]"), "stages[1].train.batch"),
            (medium.clone().within("lens"), "lens.surface[2].medium"),
            (Location::from("terms").within(Location::surface(1).key("xy")), "surface[1].xy.terms"),
            (medium.within(Location::called("channel red")), "channel red: surface[2].medium"),
            (Location::line(3).within("tolerances"), "line 3: tolerances"),
        ] {
            assert_eq!(place.to_string(), text);
        }
    }
}
