//! Lenses beside each other: first-order data as a table and as JSON, and a page with all drawings.

use std::fmt;

use serde::Serialize;
use serde_json::Value;

use super::columns::{Column, csv, table};
use super::drawing::lens_svg_within;
use super::html::Page;
use super::table::{Table, numbered, significant};
use isoplanat_optics::lens::paraxial::{FirstOrder, first_order};
use isoplanat_optics::lens::{Lens, Medium};

/// Largest size of a drawing on the page, px.
const SIZE: [f64; 2] = [540.0, 330.0];
/// Letters of a source that the table shows.
const SHORT: usize = 40;

/// What `isoplanat lenses` shows.
#[derive(Clone, Debug)]
pub struct Library {
    entries: Vec<Entry>,
}

/// A lens with the name commands know it by.
#[derive(Clone, Debug)]
struct Entry {
    key: String,
    lens: Lens,
    first: FirstOrder,
}

const COLUMNS: [Column<Entry>; 13] = [
    Column::text("name", "name", |e| e.key.clone()),
    Column::value("title", |e| e.lens.name.clone()),
    Column::figure("f, mm", "effective_focal_length_mm", 5, |e| e.first.effective_focal_length),
    Column::value("back_focal_length_mm", |e| e.first.back_focal_length.to_string()),
    Column::figure("f/", "f_number", 3, |e| e.first.f_number),
    Column::figure("half field, °", "max_field_deg", 3, |e| e.lens.max_field_deg()),
    Column::text("elements", "elements", |e| elements(&e.lens).to_string()),
    Column::text("surfaces", "surfaces", |e| e.lens.surfaces.len().to_string()),
    Column::text("aspheres", "aspheric_surfaces", |e| aspheres(&e.lens).to_string()),
    Column::figure("length, mm", "length_mm", 5, |e| e.lens.length()),
    Column::shown("lens", |e| e.lens.name.clone()),
    Column::shown("source", |e| short(&e.lens.source)),
    Column::value("source", |e| e.lens.source.clone()),
];

impl Library {
    /// Of lenses with their names; data at each lens's primary wavelength.
    pub fn new(lenses: impl IntoIterator<Item = (String, Lens)>) -> Self {
        let entry = |(key, lens): (String, Lens)| {
            let first = first_order(&lens, lens.wavelengths.primary_nm);
            Entry { key, lens, first }
        };
        Self { entries: lenses.into_iter().map(entry).collect() }
    }

    /// One JSON object with a list of the lenses.
    pub fn json(&self) -> Value {
        #[derive(Serialize)]
        struct Everything<'a> {
            lenses: Vec<EntryRow<'a>>,
        }
        numbered(&Everything { lenses: self.entries.iter().map(EntryRow::from).collect() })
    }

    /// A lens a row.
    pub fn table(&self) -> Table {
        table(&COLUMNS, &self.entries)
    }

    /// The same with all digits and whole sources, as comma-separated values.
    pub fn csv(&self) -> String {
        csv(&COLUMNS, &self.entries)
    }

    /// All drawings on one page, with first-order data and sources.
    pub fn page(&self) -> String {
        let mut page = Page::new(
            "Lenses",
            "Cross-sections with three fields, first-order data at each lens's primary wavelength. Names are those that commands take.",
        );
        let cards: Vec<_> = self.entries.iter().map(Entry::card).collect();
        page.noted_drawings(&cards, 480);
        page.section("In numbers").table(&self.table());
        page.finish()
    }
}

impl fmt::Display for Library {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.table())
    }
}

/// A lens, for machines.
#[derive(Serialize)]
struct EntryRow<'a> {
    name: &'a str,
    title: &'a str,
    source: &'a str,
    sha256: String,
    wavelength_nm: f64,
    effective_focal_length_mm: f64,
    back_focal_length_mm: f64,
    f_number: f64,
    entrance_pupil_diameter_mm: f64,
    max_field_deg: f64,
    elements: usize,
    surfaces: usize,
    aspheric_surfaces: usize,
    length_mm: f64,
    object_distance_mm: f64,
}

impl<'a> From<&'a Entry> for EntryRow<'a> {
    fn from(entry: &'a Entry) -> Self {
        let (lens, first) = (&entry.lens, &entry.first);
        Self {
            name: &entry.key,
            title: &lens.name,
            source: &lens.source,
            sha256: lens.sha256(),
            wavelength_nm: lens.wavelengths.primary_nm,
            effective_focal_length_mm: first.effective_focal_length,
            back_focal_length_mm: first.back_focal_length,
            f_number: first.f_number,
            entrance_pupil_diameter_mm: first.entrance_pupil_diameter,
            max_field_deg: lens.max_field_deg(),
            elements: elements(lens),
            surfaces: lens.surfaces.len(),
            aspheric_surfaces: aspheres(lens),
            length_mm: lens.length(),
            object_distance_mm: 1.0 / lens.object_vergence,
        }
    }
}

impl Entry {
    fn card(&self) -> (String, String, Vec<String>) {
        let (lens, first) = (&self.lens, &self.first);
        let shapes = match aspheres(lens) {
            0 => "spheres and planes".to_owned(),
            1 => "1 asphere".to_owned(),
            n => format!("{n} aspheres"),
        };
        let elements = match elements(lens) {
            1 => "1 element".to_owned(),
            n => format!("{n} elements"),
        };
        let data = format!(
            "f = {} mm · f/{} · ±{}° · back focal length {} mm · {} mm long · {elements}, {shapes}",
            significant(first.effective_focal_length, 5),
            significant(first.f_number, 3),
            significant(lens.max_field_deg(), 3),
            significant(first.back_focal_length, 5),
            significant(lens.length(), 5),
        );
        (lens_svg_within(lens, SIZE), format!("{}: {}", self.key, lens.name), vec![data, lens.source.clone()])
    }
}

/// Pieces of glass: spaces that are not air, one for neighbouring spaces of the same medium.
fn elements(lens: &Lens) -> usize {
    let before = std::iter::once(&Medium::Air).chain(lens.surfaces.iter().map(|s| &s.medium));
    lens.surfaces.iter().zip(before).filter(|(s, before)| s.medium != Medium::Air && s.medium != **before).count()
}

fn aspheres(lens: &Lens) -> usize {
    lens.surfaces.iter().filter(|s| s.shape.is_aspheric() || s.shape.conic != 0.0).count()
}

/// What a source begins with: up to its first colon, semicolon or bracket, or whole words that fit.
fn short(source: &str) -> String {
    let end = source.find([';', ':', '(']).unwrap_or(source.len());
    let begin = source[..end].trim_end();
    if begin.chars().count() <= SHORT {
        return begin.to_owned();
    }
    let mut kept = String::new();
    for word in begin.split_whitespace() {
        if kept.chars().count() + word.chars().count() + 2 > SHORT {
            break;
        }
        if !kept.is_empty() {
            kept.push(' ');
        }
        kept.push_str(word);
    }
    kept.trim_end_matches(',').to_owned() + "…"
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_optics::lens::builtin;

    fn library() -> Library {
        Library::new(builtin::LENSES.map(|(name, _)| (name.to_owned(), builtin::lens(name).expect(name))))
    }

    #[test]
    fn elements_and_aspheres_are_counted() {
        // A stop inside an element does not make it two; cemented glasses are.
        for (name, counts) in [
            ("hologon", (3, 0)),
            ("cooke_triplet", (3, 0)),
            ("ac254_050_a", (2, 0)),
            ("tessar", (4, 0)),
            ("sonnar", (6, 0)),
            ("phone", (6, 12)),
            ("al2550_a", (1, 1)),
        ] {
            let lens = builtin::lens(name).expect(name);
            assert_eq!((elements(&lens), aspheres(&lens)), counts, "{name}");
        }
    }

    #[test]
    fn every_form_holds_every_lens() {
        let library = library();
        let (text, csv, page, json) = (library.to_string(), library.csv(), library.page(), library.json());
        for (name, _) in builtin::LENSES {
            let lens = builtin::lens(name).expect(name);
            assert!(text.contains(name) && csv.contains(name) && page.contains(name), "{name}");
            let source = crate::report::svg::escape(&lens.source).replace("&#39;", "'");
            assert!(page.contains(&source), "{name}");
        }
        assert_eq!(json["lenses"].as_array().expect("list").len(), builtin::LENSES.len());
        assert_eq!(page.matches("<svg").count(), builtin::LENSES.len());
        assert!(!page.contains("NaN") && !text.contains("nan"));
        // Nothing is cut off inside a word, and nothing but the source is cut.
        assert_eq!(short("US patent 1,998,704 (L. Bertele)"), "US patent 1,998,704");
        assert_eq!(short("aaaa bbbb, cccc dddd eeee ffff gggg, hhhh iiii"), "aaaa bbbb, cccc dddd eeee ffff gggg…");
    }
}
