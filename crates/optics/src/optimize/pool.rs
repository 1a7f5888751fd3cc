//! The glasses that a choice is made among.
//!
//! Unless they are asked for, types that their makers no longer make are left out, and polymers stand alone: they are cemented neither to glass nor glass
//! to them, since cements, heat and moulding are not the same for both.

use super::pattern::matches;
use crate::lens::catalogue::{Glasses, Listed};
use crate::lens::{Lens, Medium};
use isoplanat_base::error::{Error, Result};

/// Words for kinds of glasses.
const KINDS: [&str; 2] = ["plastic", "obsolete"];

/// Glasses to choose among.
#[derive(Clone, Debug)]
pub struct Pool {
    candidates: Vec<Medium>,
    polymers: Vec<Medium>,
    cemented: bool,
    band_nm: Option<[f64; 2]>,
}

impl Pool {
    /// Whether a part of a pattern speaks of glasses (`SCHOTT/*`, `N-BK7`, `!plastic`, `obsolete`), not of surfaces.
    pub fn is_filter(glasses: &Glasses, part: &str) -> bool {
        part.contains('/')
            || part.starts_with('!')
            || KINDS.iter().any(|k| part.eq_ignore_ascii_case(k))
            || glasses.listed_all().any(|g| part.eq_ignore_ascii_case(g.name))
    }

    /// The glasses of `glasses` that `filters` let through: `CATALOGUE/NAME` with `*` for any letters, or a glass's name, takes those and no others, `!` before it leaves
    /// them out; `plastic` lets polymers be cemented to glass, `!plastic` leaves them out; `obsolete` takes types that are no longer made, as a full name
    /// without `*` does. `place` names where the filters come from.
    ///
    /// # Errors
    /// A filter that is none of these, or that names no glass; no glass left.
    pub fn new(glasses: &Glasses, filters: &[&str], place: &str) -> Result<Self> {
        let refused = |found: &str, allowed: &str| Error::bad(place, "value", found, allowed);
        let said = |word: &str| filters.iter().any(|f| f.eq_ignore_ascii_case(word));
        let (obsolete, cemented) = (said("obsolete") && !said("!obsolete"), said("plastic"));
        let named: Vec<String> =
            glasses.listed_all().map(|g| format!("{}/{}", g.catalogue, g.name).to_ascii_uppercase()).collect();
        let (mut taken, mut left): (Vec<String>, Vec<String>) = (Vec::new(), Vec::new());
        for filter in filters {
            let bare = filter.trim_start_matches('!').to_ascii_uppercase();
            if KINDS.iter().any(|k| bare.eq_ignore_ascii_case(k)) {
                continue;
            }
            // A name alone: of whatever catalogue.
            let of_name = |n: &&String| n.split_once('/').is_some_and(|(_, name)| name == bare);
            let meant: Vec<String> = match bare.contains('/') {
                true => vec![bare.clone()],
                false => named.iter().filter(of_name).cloned().collect(),
            };
            if meant.is_empty() {
                return Err(refused(
                    filter,
                    "a glass's name, CATALOGUE/NAME such as SCHOTT/*, plastic, obsolete; `!` before one leaves it out",
                ));
            }
            if !named.iter().any(|n| meant.iter().any(|m| matches(m, n))) {
                return Err(refused(filter, "a catalogue and a name, or `*`, that a glass at hand has"));
            }
            if filter.starts_with('!') { left.extend(meant) } else { taken.extend(meant) }
        }
        let keeps = |(g, name): &(Listed<'_>, &String)| {
            let by_name = taken.iter().any(|p| !p.contains('*') && p == *name);
            (taken.is_empty() || taken.iter().any(|p| matches(p, name)))
                && !left.iter().any(|p| matches(p, name))
                && (obsolete || by_name || !g.obsolete)
                && !(g.polymer && said("!plastic"))
        };
        let candidates: Vec<Medium> =
            glasses.listed_all().zip(&named).filter(keeps).map(|(g, _)| g.medium.clone()).collect();
        if candidates.is_empty() {
            return Err(refused(&filters.join(","), "filters that leave a glass"));
        }
        let polymers = glasses.listed_all().filter(|g| g.polymer).map(|g| g.medium.clone()).collect();
        Ok(Self { candidates, polymers, cemented, band_nm: None })
    }

    /// The same pool of glasses that are known over `band_nm` too, beside the lens's own wavelengths.
    #[must_use]
    pub fn known_over(self, band_nm: [f64; 2]) -> Self {
        Self { band_nm: Some(band_nm), ..self }
    }

    /// The glasses whose index is known over the wavelengths of `lens`.
    ///
    /// # Errors
    /// None of them.
    pub(super) fn of_lens(&self, lens: &Lens) -> Result<Vec<&Medium>> {
        let [mut short, mut long] = lens.wavelengths.ends_nm();
        if let Some([from, to]) = self.band_nm {
            (short, long) = (short.min(from), long.max(to));
        }
        let covers = |m: &&Medium| m.range_nm()[0] <= short && m.range_nm()[1] >= long;
        let real: Vec<&Medium> = self.candidates.iter().filter(covers).collect();
        if real.is_empty() {
            let allowed = format!("glasses whose index is known from {short} to {long} nm");
            return Err(Error::bad(lens.file(), "glasses", "none", allowed));
        }
        Ok(real)
    }

    /// Whether `medium` may stand behind the surface `i` of `lens`, beside what stands there.
    pub(super) fn fits(&self, lens: &Lens, i: usize, medium: &Medium) -> bool {
        let polymer = |m: &Medium| self.polymers.contains(m);
        let before = [lens.medium_before(i)];
        let behind = lens.surfaces.get(i + 1).map(|s| &s.medium);
        // Two numbers or a table do not say what they are of.
        let differs = |m: &&Medium| matches!(m, Medium::Glass { .. }) && polymer(m) != polymer(medium);
        self.cemented || !before.into_iter().chain(behind).any(|m| differs(&m))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::lens::catalogue::Naming;

    fn pool(filters: &[&str]) -> Pool {
        Pool::new(Glasses::shipped(), filters, "--choose-glass").expect("a pool")
    }

    fn has(pool: &Pool, name: &str) -> bool {
        pool.candidates.contains(&Glasses::shipped().find(name, Naming::Exact).expect(name))
    }

    #[test]
    fn filters_by_catalogue_and_kind() {
        let all = pool(&[]);
        for (name, there) in [("N-BK7", true), ("MISC/PMMA", true), ("OHARA/S-TIH57", true), ("SCHOTT/F4", false)] {
            assert_eq!(has(&all, name), there, "{name}");
        }
        let schott = pool(&["SCHOTT/*", "!plastic", "!schott/n-bk7"]);
        assert!(has(&schott, "N-SK16") && !has(&schott, "OHARA/S-TIH57") && !has(&schott, "N-BK7"));
        assert!(
            !has(&pool(&["!plastic"]), "MISC/PMMA")
                && !has(&pool(&["!plastic"]), "PLASTIC/E48R")
                && has(&pool(&["!plastic"]), "N-BK7")
        );
        assert!(has(&pool(&["obsolete"]), "SCHOTT/F4") && has(&pool(&["SCHOTT/F4"]), "SCHOTT/F4"));
        // A name alone is that glass of whatever catalogue, and no surface.
        let two = pool(&["n-sk16", "F2"]);
        assert!(has(&two, "N-SK16") && has(&two, "SCHOTT/F2") && !has(&two, "N-BK7"));
        assert!(
            Pool::is_filter(Glasses::shipped(), "N-BK7") && !Pool::is_filter(Glasses::shipped(), "surface[2].medium")
        );
        for wrong in ["UNOBTAINIUM", "NOBODY/*", "!cheap", "SCHOTT/UNOBTAINIUM"] {
            assert!(Pool::new(Glasses::shipped(), &[wrong], "--choose-glass").is_err(), "{wrong}");
        }
    }

    /// What a sensor sees counts beside the lens's own wavelengths: S-TIH57 begins at 404.656 nm.
    #[test]
    fn glasses_are_known_where_they_are_used() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let tih57 = Glasses::shipped().find("OHARA/S-TIH57", Naming::Exact).expect("shipped");
        let all = pool(&[]);
        assert!(all.of_lens(&lens).expect("glasses").contains(&&tih57));
        let seen = all.known_over([400.0, 700.0]);
        let left = seen.of_lens(&lens).expect("glasses");
        assert!(!left.contains(&&tih57) && left.len() > 200);
        assert!(left.iter().all(|m| m.range_nm()[0] <= 400.0 && m.range_nm()[1] >= 700.0));
        assert!(seen.known_over([10.0, 700.0]).of_lens(&lens).is_err());
    }

    #[test]
    fn polymers_are_not_cemented_to_glass() {
        let doublet = builtin::lens("ac254_050_a").expect("shipped");
        let [pmma, bk7] = ["MISC/PMMA", "N-BK7"].map(|n| Glasses::shipped().find(n, Naming::Exact).expect(n));
        assert!(!pool(&[]).fits(&doublet, 0, &pmma) && pool(&[]).fits(&doublet, 0, &bk7));
        assert!(pool(&["plastic"]).fits(&doublet, 0, &pmma));
        // Between air it stands alone.
        let triplet = builtin::lens("cooke_triplet").expect("shipped");
        assert!(pool(&[]).fits(&triplet, 0, &pmma));
    }
}
