//! Pages of refractiveindex.info: `DATA` with a formula and its coefficients (λ in µm), or a table of indices.

use yaml_rust2::parser::{Event, EventReceiver, Parser};
use yaml_rust2::{Yaml, YamlLoader};

use super::{Entry, finite, glass};
use crate::lens::Medium;
use crate::lens::dispersion::Formula;
use crate::lens::glass::TABLE_NM;
use isoplanat_base::error::{Error, Result};

fn formula(number: &str) -> Option<Formula> {
    Some(match number {
        "1" => Formula::SellmeierSquares,
        "2" => Formula::SellmeierOffset,
        "3" => Formula::PowersOfSquare,
        "4" => Formula::Rational,
        "5" => Formula::Powers,
        "6" => Formula::Gas,
        "7" => Formula::Herzberger,
        "8" => Formula::Retro,
        "9" => Formula::Exotic,
        _ => return None,
    })
}

/// Parts of a page, at most: that of a long table of indices has a handful.
const PARTS: usize = 100_000;

/// Refuses what the loader would make more of than the page holds: anchors and aliases, and pages of more parts than any has.
fn plain(text: &str) -> std::result::Result<(), String> {
    struct Looked {
        shared: bool,
        parts: usize,
    }
    impl EventReceiver for Looked {
        fn on_event(&mut self, event: Event) {
            self.parts += 1;
            self.shared |= match event {
                Event::Alias(_) => true,
                Event::Scalar(_, _, anchor, _) | Event::SequenceStart(anchor, _) | Event::MappingStart(anchor, _) => {
                    anchor > 0
                }
                _ => false,
            };
        }
    }
    let mut looked = Looked { shared: false, parts: 0 };
    Parser::new_from_str(text).load(&mut looked, true).map_err(|e| e.to_string().replace('\n', " "))?;
    if looked.shared {
        return Err("anchors and aliases, which such a page has none of".into());
    }
    if looked.parts > PARTS {
        return Err(format!("{} parts, more than {PARTS}", looked.parts));
    }
    Ok(())
}

/// The glass of the page `text`, called `name`; `file` names it.
pub(super) fn read(text: &str, name: &str, file: &str) -> Result<Entry> {
    let refuse = |place: &str, found: String, allowed: &str| Error::bad(file, place, found, allowed);
    let form = "a page of refractiveindex.info with a list DATA";
    plain(text).map_err(|found| refuse("form", found, form))?;
    let pages = YamlLoader::load_from_str(text).map_err(|e| refuse("form", e.to_string().replace('\n', " "), form))?;
    let page = pages.first().unwrap_or(&Yaml::BadValue);
    let blocks = page["DATA"].as_vec().ok_or_else(|| refuse("DATA", "no list".into(), form))?;
    if page["CONDITIONS"]["n_is_absolute"].as_bool() == Some(true) {
        return Err(refuse("CONDITIONS.n_is_absolute", "true".into(), "indices relative to air"));
    }
    // One number alone is a number to YAML, several are a text.
    let words = |value: &Yaml| match value {
        Yaml::String(text) | Yaml::Real(text) => text.clone(),
        Yaml::Integer(n) => n.to_string(),
        _ => String::new(),
    };
    let numbers = |place: &str, text: &str| {
        let no_number = |w: &&str| !w.parse::<f64>().is_ok_and(f64::is_finite);
        let word = || text.split_whitespace().find(no_number).unwrap_or("").chars().take(40).collect::<String>();
        finite(text).ok_or_else(|| refuse(place, format!("`{}`", word()), "finite numbers"))
    };
    // What says nothing of the index (extinction) is passed over; the first that does counts.
    for block in blocks {
        let kind = words(&block["type"]);
        if let Some(number) = kind.strip_prefix("formula ") {
            let formula = formula(number.trim())
                .ok_or_else(|| refuse("DATA.type", kind.clone(), "formula 1 to 9, tabulated n, tabulated nk"))?;
            let coefficients = numbers("DATA.coefficients", &words(&block["coefficients"]))?;
            let range = numbers("DATA.wavelength_range", &words(&block["wavelength_range"]))?;
            let [short, long] = range[..] else {
                return Err(refuse("DATA.wavelength_range", format!("{range:?}"), "two numbers of µm"));
            };
            let medium = glass(name, file, formula, coefficients, [short * 1e3, long * 1e3]);
            return Ok(Entry { name: name.to_owned(), medium, obsolete: false });
        }
        let columns = match kind.as_str() {
            "tabulated n" => 2,
            "tabulated nk" => 3,
            _ => continue,
        };
        let all = numbers("DATA.data", &words(&block["data"]))?;
        let rows: Vec<&[f64]> = all.chunks(columns).collect();
        let rising = rows.windows(2).all(|w| w[0][0] < w[1][0]);
        if rows.is_empty() || rows.iter().any(|r| r.len() != columns) || !rising {
            let found = format!("{} numbers", all.len());
            return Err(refuse("DATA.data", found, "rows of a rising wavelength in µm and an index"));
        }
        // A lens takes no others: what a page has beyond (X-rays, radio) is not of lenses, nor is what absorbs (indices below 1, above 5).
        let of_lenses = |r: &&[f64]| TABLE_NM.contains(&(r[0] * 1e3)) && super::INDICES.contains(&r[1]);
        let rows = rows.split(|r| !of_lenses(r)).max_by_key(|part| part.len()).unwrap_or_default();
        if rows.is_empty() {
            let found = "no row from 0.1 to 100 µm with an index from 1 to 5".into();
            return Err(refuse("DATA.data", found, "indices of a lens's light"));
        }
        let medium = Medium::Table {
            wavelength_nm: rows.iter().map(|r| r[0] * 1e3).collect(),
            index: rows.iter().map(|r| r[1]).collect(),
        };
        return Ok(Entry { name: name.to_owned(), medium: Ok(medium), obsolete: false });
    }
    Err(refuse("DATA.type", "no index".into(), "formula 1 to 9, tabulated n, tabulated nk"))
}
