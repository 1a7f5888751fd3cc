//! Zemax OpticStudio `.zmx`, sequential mode. Keywords as the files of versions 2009 to 2024 have them; lengths in the file's unit.

mod apertures;
mod configurations;
mod header;
mod order;
mod shapes;
mod surface;

use super::Reading;
use super::draft::Draft;
use super::text::{Line, shown};
use crate::lens::check::MAX_SURFACES;
use configurations::Configurations;
use header::Header;
use isoplanat_base::error::{Location, Result};
use order::Order;
use surface::Raw;

/// Keywords that no ray depends on and that every file has, or that another keyword repeats.
const HARMLESS: [&str; 38] = [
    "VERS", "AUTH", "NOTE", "IWDP", "STUD", "PFIL", "LANG", "GFAC", "RAIM", "PUSH", "SDMA", "OMMA", "ROPD", "HYPR",
    "PICB", "FWGN", "FCOM", "POLS", "GLRS", "GSTD", "NSCD", "COFN", "LUID", "EERA", "TOLS", "SCHT", "PPRD", "FOVL",
    "CLRF", "XZOO", "FWGT", "DXFN", "RYLE", "VPCO", "DRGN", "SYMM", "COMM", "WWGN",
];
/// Keywords of some versions and vendors that no ray depends on, in a surface or outside. They are told.
const READ_OVER: [&str; 6] = ["DBDT", "OEMA", "VCON", "TOLE", "FENF", "FEFD"];

/// Reads the text of a file; `file` names it in errors.
pub(super) fn read(text: &str, file: &str, reading: Reading) -> Result<Draft> {
    let mut header = Header::default();
    let mut surfaces: Vec<Raw> = Vec::new();
    let mut order = Order::default();
    let mut configurations = Configurations::default();
    let (mut read_over, mut commas) = (Told::default(), Told::default());
    let mut unknown: Vec<String> = Vec::new();
    let mut known = false;
    for (number, raw) in text.lines().enumerate() {
        let mut words = raw.split_whitespace();
        let Some(keyword) = words.next() else { continue };
        // What stands behind the surfaces is none's.
        let outside = keyword == "SURF" || configurations.begun() && !raw.starts_with(char::is_whitespace);
        let surface = surfaces.last().filter(|_| !outside);
        let label = surface.map(|s| s.place().label.clone()).unwrap_or_default();
        let place = Location { label, ..Location::line(number + 1) };
        let stated: Vec<&str> = words.collect();
        // Titles and comments have commas that are no decimal points.
        let text = ["NAME", "NOTE", "COMM", "GCAT"].contains(&keyword);
        let dotted: Vec<Option<String>> = stated.iter().map(|w| with_point(w).filter(|_| !text)).collect();
        let comma = stated.iter().zip(&dotted).find_map(|(w, d)| d.as_ref().map(|_| *w));
        if let Some(word) = comma {
            commas.add(word, &place);
        }
        let words = stated.iter().zip(&dotted).map(|(w, d)| d.as_deref().unwrap_or(w)).collect();
        let line = Line { file, place, words };
        if keyword == "SURF" {
            known = true;
            if surfaces.len() > MAX_SURFACES {
                return Err(
                    line.refused(format!("more than {MAX_SURFACES} surfaces"), format!("at most {MAX_SURFACES}"))
                );
            }
            let label = order.next(&line)?;
            surfaces.push(Raw::new(Location { label: format!("SURF {label}"), ..line.place }));
            continue;
        }
        let indented = raw.starts_with(char::is_whitespace);
        // Behind the surfaces stand configurations, the merit function and tolerances, none of them indented.
        let behind = !surfaces.is_empty() && !indented;
        if behind && configurations.read(keyword, &line)? {
            continue;
        }
        if !(behind && configurations.begun())
            && let Some(surface) = surfaces.last_mut()
            && surface.read(keyword, &line)?
        {
            continue;
        }
        if header.read(keyword, &line, raw)? || configurations.begin(keyword, &line)? || HARMLESS.contains(&keyword) {
            known = true;
            continue;
        }
        if READ_OVER.contains(&keyword) {
            known = true;
            read_over.add(keyword, &line.place);
            continue;
        }
        if !surfaces.is_empty() && (!indented || header.merit > 0) && operand(keyword) {
            header.merit += 1;
            continue;
        }
        if !known {
            return Err(line.refused(
                format!("`{}`", shown(keyword)),
                "a Zemax lens file, which begins with keywords such as VERS",
            ));
        }
        let found = format!("the keyword `{}`", shown(keyword));
        if !surfaces.is_empty() && indented {
            let allowed =
                "keywords that this reader knows: within a surface another one may change its shape or medium";
            return Err(line.refused(found, allowed));
        }
        if reading.strict {
            return Err(line.refused(found, "a keyword that this reader knows; without --strict it is read over"));
        }
        unknown.push(format!("`{}` at {}", shown(keyword), line.place));
    }
    let mut notes = Vec::new();
    notes.extend(read_over.note("read over, no ray depends on it"));
    notes.extend(commas.note("a decimal comma, read as a point"));
    if !unknown.is_empty() {
        let [more, rest] = [unknown.len().min(8), unknown.len().saturating_sub(8)];
        let rest = if rest > 0 { format!(" and {rest} more") } else { String::new() };
        notes.push(format!(
            "unknown keywords are read over (--strict refuses them): {}{rest}",
            unknown[..more].join(", ")
        ));
    }
    notes.append(&mut header.notes);
    notes.extend(order.notes());
    notes.extend(configurations.apply(reading.configuration, &mut header, &mut surfaces, &order, file)?);
    header.draft(surfaces, &order, notes, file)
}

/// Words of a file that are told once, with the place of the first and how many there are.
#[derive(Default)]
struct Told(std::collections::BTreeMap<String, (String, usize)>);

impl Told {
    fn add(&mut self, word: &str, place: &Location) {
        let word = shown(word);
        if self.0.len() < 40 || self.0.contains_key(&word) {
            self.0.entry(word).or_insert_with(|| (place.to_string(), 0)).1 += 1;
        }
    }

    fn note(&self, what: &str) -> Option<String> {
        let one = |(word, (place, count)): (&String, &(String, usize))| match count {
            1 => format!("{word} ({place})"),
            n => format!("{word} ({n} times, first {place})"),
        };
        let list: Vec<String> = self.0.iter().map(one).collect();
        (!list.is_empty()).then(|| format!("{what}: {}", list.join(", ")))
    }
}

/// A number with one decimal comma, with a point in its place: numbers of a line stand between blanks, never between commas.
fn with_point(word: &str) -> Option<String> {
    let (whole, rest) = word.split_once(',')?;
    let digits = |s: &str| !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit());
    let mantissa = rest.split(['e', 'E']).next().unwrap_or("");
    let number = format!("{whole}.{rest}");
    (digits(whole.trim_start_matches(['-', '+'])) && digits(mantissa) && number.parse::<f64>().is_ok())
        .then_some(number)
}

/// Whether a word looks like an operand of the merit function.
fn operand(keyword: &str) -> bool {
    (3..=4).contains(&keyword.len())
        && keyword.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '+')
}
