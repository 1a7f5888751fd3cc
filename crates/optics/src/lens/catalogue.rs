//! Catalogues of glasses: the shipped one, AGF files and pages of refractiveindex.info, and a glass found by its name.
//!
//! A glass is never replaced by another: a name that several catalogues give to different glasses is refused unless a catalogue is named
//! (`SCHOTT/F2`) or preferred, and an unknown name is an error that tells near ones. A glass whose entry is no dispersion stands in
//! its catalogue with the reason, and is refused when it is asked for.

use std::path::Path;
use std::sync::LazyLock;

use serde::Deserialize;

use super::Medium;
use super::dispersion::{Dispersion, Formula};
use super::model_glass::{cauchy_of_lines, fictitious};
use isoplanat_base::error::{Error, Result};

mod agf;
mod instead;
mod listed;
mod page;

use instead::Instead;
pub use listed::Listed;

/// Stands in a glass's place for the two numbers that a lens file states beside its name.
pub(crate) const MODEL: &str = "model";
/// Indices of a glass lie within.
const INDICES: std::ops::RangeInclusive<f64> = 1.0..=5.0;
/// Indices of a formula that differ by no more are one.
const ROUNDING: f64 = 1e-14;
/// Largest file that is read: the largest catalogues have 2 MB.
const LARGEST: u64 = 64 << 20;

/// How a glass is named by whoever asks for it.
#[derive(Clone, Copy, Debug)]
pub enum Naming<'a> {
    /// To the letter.
    Exact,
    /// To the letter, as lens files of this program's own form do: the glass is that of the shipped catalogues, whatever others are at hand, and of those where the
    /// shipped ones have none.
    Own,
    /// As CODE V and other programs spell: a name that is none is taken for the one glass that differs from it by case and hyphens alone (`SCHOTT/NSK16` is
    /// N-SK16). Of different glasses of one name it is that of the first of these catalogues.
    Foreign(&'a [String]),
}

/// A glass of a catalogue.
#[derive(Clone, Debug)]
struct Entry {
    name: String,
    /// The medium, or why there is none.
    medium: std::result::Result<Medium, String>,
    /// Whether the maker marks the type as no longer made.
    obsolete: bool,
}

/// A catalogue by its name.
#[derive(Clone, Debug)]
struct Catalogue {
    name: String,
    entries: Vec<Entry>,
}

/// The catalogues that names are looked up in.
#[derive(Clone, Debug, Default)]
pub struct Glasses {
    catalogues: Vec<Catalogue>,
    /// Names that stand for others because somebody said so.
    instead: Instead,
}

/// Checks a formula over its range: what stands in a catalogue may be no glass.
pub(super) fn glass(
    name: &str,
    source: &str,
    formula: Formula,
    coefficients: Vec<f64>,
    range_nm: [f64; 2],
) -> std::result::Result<Medium, String> {
    let count = coefficients.len();
    let dispersion = Dispersion::new(formula, coefficients)
        .ok_or_else(|| format!("{count} coefficients for the formula {formula:?}, or one that is no number"))?;
    let [short, long] = range_nm;
    if !(short > 0.0 && short < long && long.is_finite()) {
        return Err(format!("a range of {short} to {long} nm"));
    }
    let range_nm = normal(&dispersion, range_nm).ok_or_else(|| {
        let n = dispersion.index(0.5e-3 * (short + long));
        format!("its formula is no dispersion: an index of {n} at {} nm", 0.5 * (short + long))
    })?;
    Ok(Medium::Glass { name: name.to_owned(), dispersion, range_nm, source: source.to_owned() })
}

/// Media whose index is this near 1 are vacuum and gases, which may rise with wavelength relative to air.
const THIN: f64 = 1e-3;

/// The longest part of a range in which the index lies within [`INDICES`] and falls with wavelength, or all of it where the index is constant: some catalogues state ranges
/// beyond the poles of their formulas.
fn normal(dispersion: &Dispersion, [short, long]: [f64; 2]) -> Option<[f64; 2]> {
    const STEPS: u16 = 256;
    let nm = |k: u16| if k == STEPS { long } else { short + (long - short) * f64::from(k) / f64::from(STEPS) };
    let at = |k: u16| dispersion.index(nm(k) * 1e-3);
    // One index for all wavelengths.
    if INDICES.contains(&at(0)) && (1..=STEPS).all(|k| (at(k) - at(0)).abs() <= ROUNDING) {
        return Some([short, long]);
    }
    if (0..=STEPS).all(|k| (at(k) - 1.0).abs() <= THIN) {
        return Some([short, long]);
    }
    let (mut best, mut from) = ([0u16; 2], 0);
    for k in 0..STEPS {
        let (a, b) = (at(k), at(k + 1));
        if !(INDICES.contains(&a) && INDICES.contains(&b) && a > b) {
            from = k + 1;
        } else if k + 1 - from > best[1] - best[0] {
            best = [from, k + 1];
        }
    }
    let [first, last] = best;
    if last == 0 {
        return None;
    }
    // Where a part ends within the range a pole is near: a step is kept away from it.
    let (first, last) = (first + u16::from(first > 0), last - u16::from(last < STEPS));
    (first < last).then(|| [nm(first), nm(last)])
}

/// The text of a catalogue: UTF-16 with its mark, UTF-8, else Latin-1.
pub(crate) fn decoded(bytes: &[u8]) -> String {
    let wide = |pairs: &[u8], unit: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = pairs.chunks_exact(2).map(|p| unit([p[0], p[1]])).collect();
        String::from_utf16_lossy(&units)
    };
    match bytes {
        [0xff, 0xfe, rest @ ..] => wide(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => wide(rest, u16::from_be_bytes),
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8_lossy(rest).into_owned(),
        _ => std::str::from_utf8(bytes).map_or_else(|_| bytes.iter().map(|b| char::from(*b)).collect(), str::to_owned),
    }
}

/// The numbers of a line; none where a word is no finite number.
fn finite(line: &str) -> Option<Vec<f64>> {
    line.split_whitespace().map(|word| word.parse::<f64>().ok().filter(|x| x.is_finite())).collect()
}

/// What a catalogue's file is called, without its ending.
fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned())
}

impl Glasses {
    /// The catalogue of `models/glasses`, read once.
    pub fn shipped() -> &'static Self {
        static SHIPPED: LazyLock<Glasses> = LazyLock::new(Glasses::read_shipped);
        &SHIPPED
    }

    fn read_shipped() -> Self {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct File {
            #[expect(dead_code, reason = "checked for presence only")]
            schema: u32,
            glass: Vec<Glass>,
        }
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Glass {
            name: String,
            catalogue: String,
            formula: Formula,
            coefficients: Vec<f64>,
            range_nm: [f64; 2],
            source: String,
            #[serde(default)]
            obsolete: bool,
        }
        let file: File = toml::from_str(isoplanat_models::GLASSES).expect("the shipped catalogue is tested");
        let mut all = Self { catalogues: Vec::new(), instead: Instead::default() };
        for Glass { name, catalogue, formula, coefficients, range_nm, source, obsolete } in file.glass {
            let medium = glass(&name, &source, formula, coefficients, range_nm);
            all.catalogue(&catalogue).entries.push(Entry { name, medium, obsolete });
        }
        all
    }

    /// The catalogue of this name; a new one behind the others where there is none.
    fn catalogue(&mut self, name: &str) -> &mut Catalogue {
        let at = self.catalogues.iter().position(|c| c.name.eq_ignore_ascii_case(name));
        let at = at.unwrap_or_else(|| {
            self.catalogues.push(Catalogue { name: name.to_owned(), entries: Vec::new() });
            self.catalogues.len() - 1
        });
        &mut self.catalogues[at]
    }

    /// Adds an AGF catalogue or a page of refractiveindex.info (`.yml`), or all of a folder. A catalogue is called as its file; a page's
    /// glass is called as its file, in the catalogue `page`.
    ///
    /// # Errors
    /// A file that cannot be read, is neither, or has a line that is neither a glass's nor a comment's.
    pub fn add(&mut self, path: &Path) -> Result<()> {
        if path.is_dir() {
            let listed = std::fs::read_dir(path).map_err(|e| Error::reading(path, e))?;
            let mut files = Vec::new();
            for entry in listed {
                files.push(entry.map_err(|e| Error::reading(path, e))?.path());
            }
            files.sort();
            let of_kind = |p: &&std::path::PathBuf| kind(p).is_some();
            if !files.iter().any(|file| of_kind(&file)) {
                let allowed = "a folder of AGF catalogues (.agf) or pages of refractiveindex.info (.yml, .yaml)";
                return Err(Error::bad(path.display().to_string(), "folder", "no catalogue in it", allowed));
            }
            return files.iter().filter(of_kind).try_for_each(|file| self.add(file));
        }
        let file = path.display().to_string();
        let allowed = "an AGF catalogue (.agf), a page of refractiveindex.info (.yml, .yaml), or a folder of them";
        let kind = kind(path).ok_or_else(|| Error::bad(file.as_str(), "name", "another ending", allowed))?;
        let text = decoded(&isoplanat_base::atomic::read_bounded(path, LARGEST)?);
        let name = stem(path);
        match kind {
            Kind::Agf => {
                let entries = agf::read(&text, &file)?;
                self.catalogue(&name).entries.extend(entries);
            }
            Kind::Page => {
                let entry = page::read(&text, &name, &file)?;
                self.catalogue("page").entries.push(entry);
            }
        }
        Ok(())
    }

    /// The glass `name`, or `catalogue/name`, which is named as `naming` says; the glass that is taken in its place where somebody said so.
    ///
    /// ```
    /// use isoplanat_optics::lens::catalogue::{Glasses, Naming};
    ///
    /// let flint = Glasses::shipped().find("N-F2", Naming::Exact)?;
    /// assert!((flint.index(587.5618) - 1.62005).abs() < 1e-5);
    /// assert!(Glasses::shipped().find("N-NONE", Naming::Exact).is_err());
    /// # Ok::<(), isoplanat_base::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// An unknown name (with near ones), several glasses of that name, an entry that is no dispersion. The error names no file.
    pub fn find(&self, name: &str, naming: Naming<'_>) -> Result<Medium> {
        let catalogues = match naming {
            Naming::Foreign(preferred) => preferred,
            Naming::Exact | Naming::Own => &[],
        };
        match self.stands_for(name, catalogues) {
            Some(glass) if glass.eq_ignore_ascii_case(MODEL) => {
                let found = format!("no index and no Abbe number of `{name}` in the file");
                let allowed = "two numbers beside the name, as --glass-for NAME=model takes them";
                Err(Error::bad("", "medium", found, allowed))
            }
            Some(glass) => match fictitious(glass) {
                Some((n_d, v_d)) => cauchy_of_lines(n_d, v_d),
                None => self.respelled(glass, &[]),
            },
            None => self.catalogued(name, naming),
        }
    }

    /// [`Self::find`], whatever is taken in its place: glasses that are no lens's names.
    ///
    /// # Errors
    /// As [`Self::find`].
    pub(crate) fn catalogued(&self, name: &str, naming: Naming<'_>) -> Result<Medium> {
        match naming {
            Naming::Own if Self::shipped().has(name) => Self::shipped().listed(name, &[]),
            Naming::Exact | Naming::Own => self.listed(name, &[]),
            Naming::Foreign(preferred) => self.respelled(name, preferred),
        }
    }

    /// Whether a catalogue has an entry of this very name.
    fn has(&self, name: &str) -> bool {
        self.catalogues.iter().any(|c| c.entries.iter().any(|e| e.name == name))
    }

    /// The glass of this very name by the catalogues alone, whatever is taken instead.
    fn listed(&self, name: &str, preferred: &[String]) -> Result<Medium> {
        if name.eq_ignore_ascii_case("air") {
            return Ok(Medium::Air);
        }
        let bad = |found: String, allowed: String| Error::bad("", "medium", found, allowed);
        let (of, short) = match name.split_once('/') {
            Some((of, short)) if self.catalogues.iter().any(|c| c.name.eq_ignore_ascii_case(of)) => (Some(of), short),
            _ => (None, name),
        };
        let held = |c: &&Catalogue| of.is_none_or(|of| c.name.eq_ignore_ascii_case(of));
        let of_name = |c: &'_ Catalogue| c.entries.iter().rev().find(|e| e.name == short).cloned();
        let mut found: Vec<(&str, Entry)> =
            self.catalogues.iter().filter(held).filter_map(|c| Some((c.name.as_str(), of_name(c)?))).collect();
        let choice = preferred.iter().find_map(|p| found.iter().position(|(c, _)| c.eq_ignore_ascii_case(p)));
        if let Some(at) = choice {
            found = vec![found.swap_remove(at)];
        }
        let Some((catalogue, first)) = found.first() else {
            return Err(bad(format!("unknown glass `{name}`"), self.near(short)));
        };
        if found[1..].iter().any(|(_, e)| !same(&e.medium, &first.medium)) {
            let names: Vec<String> = found.iter().map(|(c, _)| format!("`{c}/{short}`")).collect();
            return Err(bad(format!("`{name}` is a glass of several catalogues that differ"), names.join(" or ")));
        }
        first.medium.clone().map_err(|why| {
            bad(format!("glass `{name}` of {catalogue}: {why}"), "a dispersion that holds within its range".into())
        })
    }

    /// [`Self::listed`], or the one glass that differs by case and hyphens alone.
    fn respelled(&self, name: &str, preferred: &[String]) -> Result<Medium> {
        let (of, short) = match name.split_once('/') {
            Some((of, short)) => (self.catalogues.iter().find(|c| c.name.eq_ignore_ascii_case(of)), short),
            None => (None, name),
        };
        if let (Some((stated, _)), None) = (name.split_once('/'), of) {
            let found = format!("glass `{short}` of the catalogue `{stated}`, which is not at hand");
            return Err(Error::bad(
                "",
                "medium",
                found,
                format!("that catalogue by --glass FILE, or {}", self.near(short)),
            ));
        }
        let exact = of.map_or_else(|| short.to_owned(), |c| format!("{}/{short}", c.name));
        let result = self.listed(&exact, preferred);
        if result.is_ok() || name.is_empty() {
            return result;
        }
        let key = spelled(short);
        let among = self.catalogues.iter().filter(|c| of.is_none_or(|of| of.name == c.name));
        let mut names: Vec<&str> = among
            .flat_map(|c| &c.entries)
            .map(|e| e.name.as_str())
            .filter(|n| spelled(n) == key && *n != short)
            .collect();
        names.sort_unstable();
        names.dedup();
        match names[..] {
            [one] => self.listed(&of.map_or_else(|| one.to_owned(), |c| format!("{}/{one}", c.name)), preferred),
            _ => result,
        }
    }

    /// Catalogue and name by which a medium is found again; `None` where no catalogue has it.
    pub(crate) fn named_as(&self, medium: &Medium) -> Option<(String, String)> {
        let Medium::Glass { name, .. } = medium else { return None };
        let holds = |e: &Entry| e.name == *name && e.medium.as_ref() == Ok(medium);
        let catalogue = self.catalogues.iter().find(|c| c.entries.iter().any(holds))?;
        Some((catalogue.name.clone(), name.clone()))
    }

    /// Entries of other catalogues that have the name of `medium` and other indices: `catalogue/name`.
    pub(crate) fn namesakes(&self, medium: &Medium) -> Vec<String> {
        let Medium::Glass { name, .. } = medium else { return Vec::new() };
        let other = |c: &&Catalogue| {
            c.entries.iter().any(|e| e.name == *name && e.medium.is_ok() && !same(&e.medium, &Ok(medium.clone())))
        };
        self.catalogues.iter().filter(other).map(|c| format!("{}/{name}", c.name)).collect()
    }

    /// What is told of a medium whose catalogue has its name more than once with other indices: the last one is what the name stands for.
    pub(crate) fn repeated(&self, medium: &Medium) -> Option<String> {
        let Medium::Glass { name, source, .. } = medium else { return None };
        self.catalogues.iter().find_map(|c| {
            let all: Vec<&Entry> = c.entries.iter().filter(|e| e.name == *name && e.medium.is_ok()).collect();
            let last = all.last().filter(|e| e.medium.as_ref() == Ok(medium))?;
            let differ = all.iter().any(|e| !same(&e.medium, &last.medium));
            differ.then(|| {
                let (catalogue, count) = (&c.name, all.len());
                format!("glass {name}: the catalogue {catalogue} has that name {count} times, with different data; the last one is taken, of {source}")
            })
        })
    }

    /// Near names, in words.
    fn near(&self, name: &str) -> String {
        let key = spelled;
        let mut all: Vec<(usize, &str)> = self
            .catalogues
            .iter()
            .flat_map(|c| &c.entries)
            .map(|e| (strsim::damerau_levenshtein(&key(&e.name), &key(name)), e.name.as_str()))
            .collect();
        all.sort_unstable();
        all.dedup();
        let names: Vec<&str> = all.iter().filter(|(d, _)| *d <= 2).take(6).map(|(_, n)| *n).collect();
        let near = if names.is_empty() { String::new() } else { format!("near names: {}; ", names.join(", ")) };
        format!(
            "{near}a glass of {}, of a catalogue given by --glass FILE, or {{ n_d = …, v_d = … }}, or {{ wavelength_nm = […], index = […] }}",
            self.catalogues.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ")
        )
    }
}

/// A name without what programs write differently.
fn spelled(name: &str) -> String {
    name.to_ascii_uppercase().replace(['-', '_', ' '], "")
}

/// Whether two entries give the same indices.
fn same(a: &std::result::Result<Medium, String>, b: &std::result::Result<Medium, String>) -> bool {
    let (Ok(a), Ok(b)) = (a, b) else { return false };
    let ([a_short, a_long], [b_short, b_long]) = (a.range_nm(), b.range_nm());
    let (short, long) = (a_short.max(b_short), a_long.min(b_long));
    (0..=16).all(|k| {
        let nm = short + (long - short) * f64::from(k) / 16.0;
        (a.index(nm) - b.index(nm)).abs() <= 1e-6
    })
}

enum Kind {
    Agf,
    Page,
}

fn kind(path: &Path) -> Option<Kind> {
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "agf" => Some(Kind::Agf),
        "yml" | "yaml" => Some(Kind::Page),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
