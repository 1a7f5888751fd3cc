//! Glasses that are taken in the place of others because somebody said so (`--glass-for NAME=GLASS`, `--glass-for NAME=1.5168,64.17`).
//!
//! The name may stand as the catalogue has it (`N-LAK22`), with its maker (`SCHOTT/N-LAK22`) or as the lens file spells it (`NLAK22_SCHOTT`): case,
//! hyphens and the place of the maker do not matter. Which names lenses have is kept, so that a name that no lens has can be refused.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};

use super::{Glasses, Naming, spelled};
use crate::lens::model_glass::{cauchy_of_lines, fictitious};
use isoplanat_base::error::{Error, Result};

/// What is taken in the place of what, and the names that were looked up meanwhile.
#[derive(Clone, Debug, Default)]
pub(super) struct Instead {
    pairs: Vec<Pair>,
    /// Shared by clones: whoever reads lenses has one of them.
    seen: Arc<Mutex<Seen>>,
}

#[derive(Clone, Debug)]
struct Pair {
    /// As it was given.
    name: String,
    glass: String,
}

#[derive(Debug, Default)]
struct Seen {
    names: BTreeSet<String>,
    /// Pairs by number.
    met: BTreeSet<usize>,
}

/// A glass by its maker, where a name has it, and its own name.
struct Named<'a> {
    maker: Option<&'a str>,
    short: &'a str,
}

impl Glasses {
    /// Takes `glass` wherever a lens names `name`; refused where `glass` is none. `model` stands for the index and the Abbe number that a
    /// file states beside the name, `1.5168,64.17` for a model glass of these two numbers.
    ///
    /// # Errors
    /// An unknown glass in the place of the other; a glass in the place of air.
    pub fn take_instead(&mut self, name: &str, glass: &str) -> Result<()> {
        if name.eq_ignore_ascii_case("air") {
            return Err(Error::bad("", "medium", "a glass for air", "the name of a glass"));
        }
        if let Some((n_d, v_d)) = fictitious(glass) {
            cauchy_of_lines(n_d, v_d)?;
        } else if !glass.eq_ignore_ascii_case(super::MODEL) {
            self.catalogued(glass, Naming::Foreign(&[]))?;
        }
        // What others of which this is a copy have seen is theirs.
        self.instead.seen = Arc::default();
        self.instead.pairs.push(Pair { name: name.to_owned(), glass: glass.to_owned() });
        Ok(())
    }

    /// Whether anything is taken in the place of anything.
    #[doc(hidden)]
    pub fn are_replaced(&self) -> bool {
        !self.instead.pairs.is_empty()
    }

    /// The first name of [`Self::take_instead`] that no lens had so far, as an error that tells the names that they had.
    ///
    /// # Errors
    /// There is one.
    #[doc(hidden)]
    pub fn all_taken(&self) -> Result<()> {
        let seen = self.instead.seen.lock().unwrap_or_else(PoisonError::into_inner);
        let unmet = self.instead.pairs.iter().enumerate().find(|(k, _)| !seen.met.contains(k));
        let Some((_, Pair { name, .. })) = unmet else { return Ok(()) };
        let names: Vec<&str> = seen.names.iter().map(String::as_str).collect();
        let allowed = match names[..] {
            [] => "a glass of the lens: no lens was read that names one".to_owned(),
            _ => format!("a glass of the lens, which names {}", names.join(", ")),
        };
        Err(Error::bad("", "name", format!("no surface names `{name}`"), allowed))
    }

    /// What is looked up for `name`, which a lens has; `catalogues` come first where the name says no maker.
    pub(crate) fn stands_for(&self, name: &str, catalogues: &[String]) -> Option<&str> {
        let Instead { pairs, seen } = &self.instead;
        if pairs.is_empty() || name.eq_ignore_ascii_case("air") {
            return None;
        }
        let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
        seen.names.insert(name.to_owned());
        let exact = pairs.iter().position(|p| p.name.eq_ignore_ascii_case(name));
        let at = exact.or_else(|| pairs.iter().position(|p| self.is_named(name, &p.name, catalogues)))?;
        seen.met.insert(at);
        Some(&pairs[at].glass)
    }

    /// Whether a lens's `name` is what somebody calls `given`.
    fn is_named(&self, name: &str, given: &str, catalogues: &[String]) -> bool {
        let (name, given) = (self.parts(name), self.parts(given));
        let of_maker = |maker: &str| match name.maker {
            Some(own) => own.eq_ignore_ascii_case(maker),
            // The lens says no maker: one of the catalogues that its file names, if it names any.
            None => catalogues.is_empty() || catalogues.iter().any(|c| c.eq_ignore_ascii_case(maker)),
        };
        spelled(name.short) == spelled(given.short) && given.maker.is_none_or(of_maker)
    }

    /// `MAKER/NAME`, `NAME_MAKER` of a catalogue at hand, or a name alone.
    fn parts<'a>(&self, name: &'a str) -> Named<'a> {
        if let Some((maker, short)) = name.split_once('/') {
            return Named { maker: Some(maker), short };
        }
        match name.rsplit_once('_') {
            Some((short, maker)) if self.catalogues.iter().any(|c| c.name.eq_ignore_ascii_case(maker)) => {
                Named { maker: Some(maker), short }
            }
            _ => Named { maker: None, short: name },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two numbers stand for a model glass; what no glass has is refused.
    #[test]
    fn two_numbers_are_a_glass() {
        let mut glasses = Glasses::shipped().clone();
        glasses.take_instead("N-BK7", "1.56,44.5").expect("taken");
        let medium = glasses.find("N-BK7", Naming::Exact).expect("found");
        assert!((medium.index(587.5618) - 1.56).abs() < 1e-12, "{medium}");
        for wrong in ["0.5,44", "1.56,x", "1.56,", "nan,44"] {
            assert!(glasses.take_instead("N-BK7", wrong).is_err(), "{wrong}");
        }
    }

    /// A name is met however catalogue, maker and file spell it, and another maker's is not; names that nobody has are told.
    #[test]
    fn names_are_met_in_every_spelling() {
        for (given, name, catalogues, met) in [
            ("N-LAK22", "N-LAK22", "", true),
            ("n-lak22", "SCHOTT/NLAK22", "", true),
            ("SCHOTT/N-LAK22", "N-LAK22", "SCHOTT", true),
            ("SCHOTT/N-LAK22", "N-LAK22", "", true),
            ("NLAK22", "N-LAK22", "SCHOTT", true),
            ("NLAK22_SCHOTT", "SCHOTT/NLAK22", "", true),
            ("schott/F4", "F4", "CDGM", false),
            ("SCHOTT/F4", "CDGM/F4", "", false),
            ("N-LAK2", "N-LAK22", "", false),
        ] {
            let mut glasses = Glasses::shipped().clone();
            glasses.take_instead(given, "N-BK7").expect("taken");
            let catalogues: Vec<String> = catalogues.split_whitespace().map(str::to_owned).collect();
            // A clone is what the reader has.
            assert_eq!(glasses.clone().stands_for(name, &catalogues).is_some(), met, "{given} for {name}");
            let told = glasses.all_taken().map_err(|e| e.to_string());
            assert_eq!(told.is_ok(), met, "{told:?}");
            assert!(told.is_ok() || told.is_err_and(|e| e.contains(given) && e.contains(name)), "{given}");
        }
    }
}
