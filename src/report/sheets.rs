//! What a workshop gets of a lens: one printable page with a sheet an element, and the same numbers as files.

mod drawing;
mod rows;
mod tables;
mod words;

use serde::Serialize;
use serde_json::Value;

use self::words::{NOT_STATED, fixed, number, superscript};
use super::drawing::lens_svg_within;
use super::html::{Fact, Page};
use super::table::{Table, numbered, significant};
use isoplanat_optics::analysis::fabrication::element::Element;
use isoplanat_optics::analysis::fabrication::face::Face;
use isoplanat_optics::analysis::fabrication::mount::{Clearance, Mount};
use isoplanat_optics::analysis::fabrication::tolerances::{OfElement, OfSurface, Tolerances};
use isoplanat_optics::analysis::fabrication::{AirSpace, Fabrication, Stop};
use isoplanat_optics::lens::Lens;

/// Largest size of the lens's drawing, px.
const SIZE: [f64; 2] = [900.0, 400.0];

/// A lens, what is made of it, and what is stated beside it.
#[derive(Debug)]
pub struct Sheets<'a> {
    /// The lens.
    pub lens: &'a Lens,
    /// Its parts.
    pub made: &'a Fabrication,
    /// What a file states.
    pub tolerances: &'a Tolerances,
    /// Files of the folder with what the lens is in them, and why others are not there: name and words.
    pub files: &'a [(String, String)],
}

/// The page's numbers, for machines.
#[derive(Serialize)]
struct Figures<'a> {
    name: &'a str,
    sha256: String,
    primary_nm: f64,
    effective_focal_length_mm: f64,
    back_focal_length_mm: f64,
    f_number: f64,
    length_mm: f64,
    stop: Stop,
    elements: &'a [Element],
    air: &'a [AirSpace],
    mount: Option<MountRow>,
    tolerances: Option<&'a str>,
    test_wavelength_nm: Option<f64>,
    of_elements: Vec<OfElement>,
    of_faces: Vec<FaceRow>,
    faults: &'a [String],
    notes: &'a [String],
    files: Vec<FileRow<'a>>,
}

/// How the lens is held, for machines.
#[derive(Serialize)]
struct MountRow {
    mount: Mount,
    clearance: Option<Clearance>,
}

/// A file beside the page.
#[derive(Serialize)]
struct FileRow<'a> {
    file: &'a str,
    what: &'a str,
}

/// What a face is held to.
#[derive(Serialize)]
struct FaceRow {
    surface: usize,
    stated: OfSurface,
}

impl Sheets<'_> {
    /// The page.
    pub fn page(&self) -> String {
        let lens = self.lens;
        let mut page = Page::new(&lens.name, &lens.source);
        page.drawings(&[(lens_svg_within(lens, SIZE), String::new())], 480);
        page.facts(&self.facts());
        if !self.made.faults.is_empty() {
            page.section("To be settled before it is made").list(&self.made.faults);
        }
        if !self.made.notes.is_empty() {
            page.section("To be known").list(&self.made.notes);
        }
        page.section("Parts along the axis").table(&self.parts());
        page.note(
            "Positions are those of first vertices, from the first vertex of the lens. Air is measured along the axis: between vertices, and at the smaller mechanical diameter of both \
             neighbours, where rims are flat.",
        );
        if let Some(table) = self.mount() {
            page.section("Mount").table(&table);
            page.note("In air: a cover glass or filter of thickness t and index n behind the lens takes t (1 − 1/n) of the distance.");
        }
        self.terms(&mut page);
        page.section("Files")
            .list(&self.files.iter().map(|(name, words)| format!("{name}: {words}")).collect::<Vec<_>>());
        for element in &self.made.elements {
            self.sheet(&mut page, element);
        }
        page.finish_with_contents()
    }

    /// The page's numbers as one JSON object.
    pub fn json(&self) -> Value {
        let Self { lens, made, tolerances, files } = self;
        let of_face = |f: &Face| FaceRow { surface: f.surface, stated: tolerances.surface(f.surface) };
        numbered(&Figures {
            name: &lens.name,
            sha256: lens.sha256(),
            primary_nm: lens.wavelengths.primary_nm,
            effective_focal_length_mm: made.first_order.effective_focal_length,
            back_focal_length_mm: made.first_order.back_focal_length,
            f_number: made.first_order.f_number,
            length_mm: lens.length(),
            stop: made.stop,
            elements: &made.elements,
            air: &made.air,
            mount: made.mount.map(|(mount, clearance)| MountRow { mount, clearance }),
            tolerances: tolerances.file.as_deref(),
            test_wavelength_nm: tolerances.test_wavelength_nm,
            of_elements: made.elements.iter().map(|e| tolerances.element(e.first())).collect(),
            of_faces: made.faces().map(|(_, f)| of_face(f)).collect(),
            faults: &made.faults,
            notes: &made.notes,
            files: files.iter().map(|(file, what)| FileRow { file, what }).collect(),
        })
    }

    /// One row a surface, comma-separated, to all digits.
    pub fn surfaces_csv(&self) -> String {
        rows::surfaces(self.lens, self.made)
    }

    /// The sags of each face, to all digits: its surface, comma-separated values.
    pub fn sags_csv(&self) -> Vec<(usize, String)> {
        self.made.faces().map(|(_, f)| (f.surface, rows::sags(f))).collect()
    }

    fn facts(&self) -> Vec<Fact> {
        let (lens, f) = (self.lens, &self.made.first_order);
        let fact = |value: f64, unit: &str, label: &str| {
            let value = value.is_finite().then(|| format!("{}{unit}", significant(value, 5)))?;
            Some(Fact { value, label: label.to_owned() })
        };
        let s = &lens.sensor;
        #[expect(clippy::cast_precision_loss, reason = "at most 65,536")]
        let [w, h] = [s.columns, s.rows].map(|n| significant(n as f64 * s.pitch_mm(), 4));
        let sensor = Fact {
            // A value stands on one line of a narrow box.
            value: format!("{w} mm"),
            label: format!("by {h} mm: sensor, {} × {} pixels of {} µm", s.columns, s.rows, s.pitch_um),
        };
        let last = self.made.air.last().map_or(f64::NAN, |a| a.axial_mm);
        let f_number = f
            .f_number
            .is_finite()
            .then(|| Fact { value: format!("f/{}", significant(f.f_number, 3)), label: "f-number".into() });
        let nm = significant(lens.wavelengths.primary_nm, 7);
        [
            fact(f.effective_focal_length, " mm", &format!("focal length (EFL) at {nm} nm")),
            fact(f.back_focal_length, " mm", "back focal length (BFL)"),
            f_number,
            fact(lens.length(), " mm", "total track, first vertex to sensor"),
            fact(last, " mm", "last glass to sensor"),
            fact(self.made.stop.diameter_mm, " mm", "stop diameter"),
            fact(lens.object_vergence.recip(), " mm", "object distance"),
            fact(lens.max_field_deg(), "°", "largest half field angle"),
            Some(sensor),
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    /// Elements, stop and sensor in the order of the light.
    fn parts(&self) -> Table {
        let made = self.made;
        let mut table = Table::new([
            "part",
            "position, mm",
            "centre thickness, mm",
            "⌀, mm",
            "air behind, mm",
            "air at the rim, mm",
        ]);
        let mut rows: Vec<(f64, Vec<String>)> = Vec::new();
        for (e, air) in made.elements.iter().zip(&made.air) {
            let names: Vec<&str> = e.glasses.iter().map(|g| g.name.as_str()).collect();
            let cells = vec![
                format!("element {}: {}", e.number, names.join(" + ")),
                fixed(e.position_mm, 4),
                significant(e.centre_thickness_mm, 8),
                significant(e.diameter_mm, 6),
                fixed(air.axial_mm, 4),
                format!("{} at ⌀ {}", fixed(air.rim_mm, 4), significant(air.rim_diameter_mm, 5)),
            ];
            rows.push((e.position_mm, cells));
        }
        let stop = &made.stop;
        let on_face = made.faces().any(|(_, f)| f.surface == stop.surface);
        let name =
            if on_face { format!("aperture stop, on face {}", stop.surface) } else { "aperture stop".to_owned() };
        rows.push((
            stop.position_mm,
            vec![name, fixed(stop.position_mm, 4), String::new(), number(Some(stop.diameter_mm), 6)],
        ));
        rows.push((self.lens.length(), vec!["sensor".to_owned(), fixed(self.lens.length(), 4)]));
        rows.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (_, cells) in rows {
            table.row(cells);
        }
        table
    }

    fn mount(&self) -> Option<Table> {
        let (mount, clearance) = self.made.mount?;
        let mut table = Table::new(["mount", "value"]);
        table.row(["name".to_owned(), format!("{}, {}", mount.name, mount.thread)]);
        table.row(["flange focal distance in air, mm".to_owned(), mount.flange_mm.to_string()]);
        table.row(["first vertex to flange, mm".to_owned(), fixed(self.lens.length() - mount.flange_mm, 4)]);
        if let Some(c) = clearance {
            table.row(["last vertex before the flange by, mm".to_owned(), fixed(c.vertex_mm, 4)]);
            table.row(["rearmost glass, rim included, before the flange by, mm".to_owned(), fixed(c.rearmost_mm, 4)]);
        }
        Some(table)
    }

    /// What the words and signs of the sheets mean.
    fn terms(&self, page: &mut Page) {
        page.section("Terms");
        let powers: Vec<usize> = {
            let mut all: Vec<usize> = self.made.faces().flat_map(|(_, f)| f.asphere.iter().map(|t| t.power)).collect();
            all.sort_unstable();
            all.dedup();
            all
        };
        let terms: String =
            powers.iter().map(|p| format!(" + A{p} h{}", superscript(i32::try_from(*p).unwrap_or(0)))).collect();
        page.paragraph(&format!("z(h) = h² / (R (1 + √(1 − (1 + κ) h²/R²))){terms}, as in ISO 10110-12: h is the distance from the axis, z the sag from the vertex."));
        let file = self.tolerances.file.as_ref().map_or_else(
            || "No tolerances are stated: indications have a dash in their place.".to_owned(),
            |_| {
                let test = self.tolerances.test_wavelength_nm;
                let of = test.map_or_else(String::new, |nm| format!(", fringes are those of {nm} nm, half a wavelength of sag at the clear rim each"));
                format!("Tolerances are those of the file that was given; what it does not state has a dash ({NOT_STATED}){of}.")
            },
        );
        page.list(&[
            "Light goes from left to right. z and R are positive towards the sensor: R where the centre of curvature lies to the right of the vertex. κ: 0 sphere, −1 paraboloid.".to_owned(),
            "CX convex, CC concave, at the vertex and as seen from outside the glass; a cemented face has both, that of its front glass first. Faces carry the number of their surface in lens.toml, counted from 0.".to_owned(),
            "Best-fit sphere: through the vertex, with the radius that makes the mean square of z(h) less its sag least over the area of the clear aperture. Departures are z less its sag.".to_owned(),
            "⌀e is the optically effective (clear) diameter, ⌀ the mechanical one. Beyond its clear aperture a face is drawn as a flat rim at right angles to the axis; \
             edges with faces continued are those of the formulas out to ⌀."
                .to_owned(),
            "A hollow radius is that of the meridian where the glass is hollow: a turning tool's nose must be smaller.".to_owned(),
            "Indications are those of ISO 10110: 0/ stress birefringence, 1/ bubbles and inclusions, 2/ inhomogeneity and striae, 3/ surface form A(B/C), 4/ centring, 5/ surface imperfections, 6/ laser damage.".to_owned(),
            file,
        ]);
    }

    /// The sheet of one element.
    fn sheet(&self, page: &mut Page, e: &Element) {
        let surfaces: Vec<String> = e.faces.iter().map(|f| f.surface.to_string()).collect();
        page.sheet(&format!("Element {}: faces {}", e.number, surfaces.join(", ")));
        for fault in e.faults().iter().chain(&e.notes()) {
            page.paragraph(fault);
        }
        page.drawing_beside(&drawing::element_svg(e), "Faces", &tables::faces(e));
        let nm = self.lens.wavelengths.primary_nm;
        let mut columns = vec![
            vec![("Glass".to_owned(), tables::glass(e, nm)), ("Body".to_owned(), tables::body(e, self.tolerances))],
            vec![("Indications of ISO 10110".to_owned(), tables::indications(e, self.tolerances))],
        ];
        columns.extend(tables::sags(e).into_iter().map(|named| vec![named]));
        page.tables_beside(&columns);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_optics::lens::builtin;

    /// Every shipped lens: a sheet an element, no number that is none, nothing invented.
    #[test]
    fn shipped_lenses_have_their_sheets() {
        for (name, _) in builtin::LENSES {
            let lens = builtin::lens(name).expect("shipped");
            let tolerances = Tolerances::default();
            let made = Fabrication::new(&lens, &tolerances, None).expect("made");
            let sheets = Sheets { lens: &lens, made: &made, tolerances: &tolerances, files: &[] };
            let (page, json) = (sheets.page(), sheets.json());
            assert_eq!(page.matches(" class=\"sheet\"").count(), made.elements.len(), "{name}");
            for text in [&page, &sheets.surfaces_csv()] {
                assert!(!text.contains("NaN") && !text.contains("nan,") && !text.contains(">nan<"), "{name}");
            }
            assert!(!page.contains(">inf<") && page.contains("3/ –") && page.contains("5/ –"), "{name}");
            assert!(!page.contains(">±"), "{name}: nothing is stated");
            assert_eq!(json["elements"].as_array().map(Vec::len), Some(made.elements.len()));
            assert_eq!(sheets.surfaces_csv().lines().count(), lens.surfaces.len() + 1);
            for (_, csv) in sheets.sags_csv() {
                assert_eq!(csv.lines().count(), 202);
                assert!(!csv.contains("NaN") && !csv.contains("inf"), "{name}");
            }
        }
    }

    /// What a file states is on the page, where it belongs.
    #[test]
    fn stated_tolerances_are_printed() {
        let lens = builtin::lens("two_element").expect("shipped");
        let text = "schema = 1\ntest_wavelength_nm = 632.8\n[surface.all]\nradius_fringes = 3\nirregularity_fringes = 0.5\nimperfections = \"5×0.16\"\n\
                    centring_arcmin = 2\nroughness_nm = 5\n[element.all]\nthickness_tolerance_mm = 0.05\nbubbles = \"1×0.25\"\n";
        let tolerances = Tolerances::parse(text, "t.toml").expect("reads");
        let made = Fabrication::new(&lens, &tolerances, None).expect("made");
        let page = Sheets { lens: &lens, made: &made, tolerances: &tolerances, files: &[] }.page();
        for expected in [
            "tolerance of n_d",
            "3/ 3(0.5)",
            "5/ 5×0.16",
            "4/ 2′",
            "Rq 5 nm",
            "±0.05 mm",
            "1/ 1×0.25",
            "0/ –",
            "632.8 nm",
        ] {
            assert!(page.contains(expected), "{expected}");
        }
    }
}
