//! Glasses of catalogues one by one: with what a choice asks of them, and all of one name.

use super::{Catalogue, Glasses, spelled};
use crate::lens::Medium;

/// A glass with what a choice among glasses asks of it.
#[derive(Clone, Copy, Debug)]
pub struct Listed<'a> {
    /// Its catalogue.
    pub catalogue: &'a str,
    /// Its name there.
    pub name: &'a str,
    /// The medium.
    pub medium: &'a Medium,
    /// Whether it is a polymer.
    pub polymer: bool,
    /// Whether its maker marks the type as no longer made.
    pub obsolete: bool,
}

/// Words in the names of catalogues of polymers.
const POLYMERS: [&str; 5] = ["PLASTIC", "POLYMER", "ZEON", "TOPAS", "ARTON"];
/// Polymers of the catalogue MISC, which has crystals and glasses too.
const IN_MISC: [&str; 7] = ["PMMA", "ACRYLIC", "POLYCARB", "POLYSTYR", "COC", "CR39", "SAN"];

impl Glasses {
    /// Every glass that is a medium, catalogue by catalogue.
    pub fn listed_all(&self) -> impl Iterator<Item = Listed<'_>> {
        self.catalogues.iter().flat_map(|c| {
            let upper = c.name.to_ascii_uppercase();
            let (all, misc) = (POLYMERS.iter().any(|p| upper.contains(p)), upper == "MISC");
            c.entries.iter().filter_map(move |e| {
                let medium = e.medium.as_ref().ok()?;
                let polymer = all || (misc && IN_MISC.contains(&e.name.as_str()));
                Some(Listed { catalogue: &c.name, name: &e.name, medium, polymer, obsolete: e.obsolete })
            })
        })
    }

    /// Every glass of this name with its catalogue, in the order of the catalogues; where none is spelled so, those that differ by case and hyphens alone.
    pub(crate) fn candidates(&self, name: &str) -> Vec<(&str, &Medium)> {
        let of = |alike: &dyn Fn(&str) -> bool| -> Vec<(&str, &Medium)> {
            let one = |c: &'_ Catalogue| c.entries.iter().rposition(|e| alike(&e.name) && e.medium.is_ok());
            let found = self.catalogues.iter().filter_map(|c| Some((c, one(c)?)));
            found.filter_map(|(c, at)| Some((c.name.as_str(), c.entries[at].medium.as_ref().ok()?))).collect()
        };
        let exact = of(&|n| n == name);
        let key = spelled(name);
        if exact.is_empty() { of(&|n| spelled(n) == key) } else { exact }
    }
}
