//! CODE V sequence files `.seq`: what `WRL` and lens designers write. Statements end at line ends or semicolons.
//!
//! Here: the header, and which statement goes where. `surface.rs`: statements about surfaces; `zoom.rs`: positions of `ZOO`; `mode.rs`:
//! whether numbers are radii or curvatures where the file does not say; `statements.rs`: a text as statements.
//!
//! A statement that the reader does not know is read over with a note where it stands before the surfaces or behind the image, and refused
//! where it stands with a surface, whose shape or medium it may be.

mod mode;
mod statements;
mod surface;
mod zoom;

use super::Reading;
use super::draft::{Draft, FieldKind, Point, Size};
use super::media::Stated;
use super::text::{Line, shown};
use crate::lens::catalogue::Glasses;
use isoplanat_base::error::{Error, Location, Result};
use statements::{Statement, statements};
use zoom::Zoom;

/// Statements that no ray depends on, or that only say what may vary.
const HARMLESS: [&str; 40] = [
    "LEN", "INI", "TEM", "PRE", "DER", "GO", "WTF", "SLB", "CCY", "THC", "GLC", "KC", "CCX", "AC", "BC", "CC", "DC",
    "EC", "FC", "GC", "HC", "JC", "COM", "OUT", "VIE", "DOR", "CA", "GL2", "EXI", "CLS", "WRL", "SAV", "SET", "DRW",
    "CKC", "GLN", "MFL", "SPH", "DDM", "UID",
];
/// Statements that say what the text itself does not: they are refused by name wherever they stand.
const ELSEWHERE: [&str; 2] = ["IN", "SCA"];
/// Solves that are kept as their value, which stands in the surface.
const SOLVES: [&str; 6] = ["PIK", "UMY", "IMY", "UCY", "HCY", "CUM"];
/// Fields and wavelengths at most.
const MOST: usize = 128;
/// Beyond this an object is infinitely far, in the file's unit.
const INFINITY: f64 = 1e9;

struct Reader<'a> {
    file: &'a str,
    reading: Reading,
    scale: f64,
    /// Whether `S` states radii, as `RDM` says; `None` before the file says it.
    radii: Option<bool>,
    /// Surfaces whose number of `S` stood before any `RDM`, with that number.
    unsaid: Vec<(usize, f64)>,
    zoom: Zoom,
    draft: Draft,
    fields: [Vec<f64>; 2],
    vignetting: [Vec<f64>; 4],
    weights: Vec<f64>,
    size: Option<(String, Size)>,
    kind: Option<(&'static str, FieldKind)>,
    object: Option<f64>,
    /// Behind the image statement: how far the image stands behind the last distance.
    image: Option<f64>,
    /// Where that statement stands.
    image_at: Location,
    /// Whether terms of its form were told.
    image_terms: bool,
    /// Wavelengths of private glasses while they are being defined, and the glasses.
    private: Option<Vec<f64>>,
    glasses: Vec<(String, Stated)>,
    solved: Vec<String>,
    /// Whether the reference wavelength is stated.
    referred: bool,
    /// The surface that `PIM` stands with.
    focus: Option<usize>,
    /// Statements that were read over.
    unknown: Vec<String>,
}

/// Reads the text of a file; `file` names it in errors.
pub(super) fn read(text: &str, file: &str, glasses: &Glasses, reading: Reading) -> Result<Draft> {
    let mut reader = Reader {
        file,
        reading,
        scale: 1.0,
        radii: None,
        unsaid: Vec::new(),
        zoom: Zoom::new(reading.configuration),
        draft: Draft::new("CODE V file"),
        fields: Default::default(),
        vignetting: Default::default(),
        weights: Vec::new(),
        size: None,
        kind: None,
        object: None,
        image: None,
        image_at: Location::called("the image"),
        image_terms: false,
        private: None,
        glasses: Vec::new(),
        solved: Vec::new(),
        referred: false,
        focus: None,
        unknown: Vec::new(),
    };
    let mut known = false;
    for statement in statements(text) {
        let result = reader.take(&statement);
        // A file of another kind fails at its first word; prose has more words behind an `In`.
        let own = statement.words.len() == 2 && ELSEWHERE.iter().any(|w| statement.words[0].eq_ignore_ascii_case(w));
        if !known && !own && (result.is_err() || !reader.unknown.is_empty()) {
            let found = format!("`{}`", shown(statement.words[0]));
            let allowed = "a CODE V sequence, which begins with statements such as RDM, LEN, TITLE";
            return Err(Error::bad(file, Location::line(statement.line), found, allowed));
        }
        known = true;
        result?;
    }
    reader.finish(glasses)
}

impl Reader<'_> {
    fn take(&mut self, statement: &Statement) -> Result<()> {
        let keyword = statement.words[0].to_ascii_uppercase();
        let words: Vec<&str> = statement.words[1..].to_vec();
        let line = Line { file: self.file, place: Location::line(statement.line), words };
        if self.private.is_some() {
            return self.private_glass(&keyword, statement.words[0], &line);
        }
        if keyword != "ZOO" {
            return self.state(&keyword, &line);
        }
        match self.zoom.take(&line)? {
            Some((keyword, line)) => self.state(&keyword, &line),
            None => Ok(()),
        }
    }

    fn state(&mut self, keyword: &str, line: &Line) -> Result<()> {
        let unit = self.scale;
        match keyword {
            "RDM" => {
                let no = |w: &&str| ["N", "NO"].iter().any(|n| w.eq_ignore_ascii_case(n));
                self.radii = Some(!line.words.first().is_some_and(no));
            }
            // `TIT Z2 "NEAR"` is that of one zoom position.
            "TITLE" | "TIT" if line.words.len() > 1 && zoom_position(line.words[0]) => {}
            "TITLE" | "TIT" => self.draft.title = line.words.join(" ").chars().take(200).collect(),
            "DIM" => {
                let unit = line.words.first().copied().unwrap_or("");
                let found =
                    [("M", 1.0), ("C", 10.0), ("I", 25.4)].iter().find(|(n, _)| n.eq_ignore_ascii_case(unit)).copied();
                let (_, scale) =
                    found.ok_or_else(|| line.refused(format!("the unit `{}`", shown(unit)), "M mm, C cm, I inches"))?;
                if self.object.is_some() && scale != self.scale {
                    return Err(line.refused("DIM behind the surfaces", "the unit before them"));
                }
                self.scale = scale;
            }
            "EPD" => self.size(line, keyword, Size::EntrancePupil(line.number(0)?))?,
            "FNO" => self.size(line, keyword, Size::WorkingFNumber(line.number(0)?))?,
            "NA" => self.size(line, keyword, Size::ImageAperture(line.number(0)?))?,
            "NAO" => self.size(line, keyword, Size::ObjectAperture(line.number(0)?))?,
            "WL" => {
                let mut all: Vec<f64> = self.draft.wavelengths.iter().map(|w| w.0).collect();
                list(&mut all, line, 'W')?;
                self.draft.wavelengths = all.into_iter().map(|nm| (nm, 1.0)).collect();
            }
            "WTW" => list(&mut self.weights, line, 'W')?,
            "REF" => (self.draft.primary, self.referred) = (line.count(0, MOST)?.saturating_sub(1), true),
            "XAN" | "YAN" => self.field(keyword, "angles", FieldKind::Angle, line)?,
            "XOB" | "YOB" => self.field(keyword, "object heights", FieldKind::ObjectHeight, line)?,
            "XIM" | "YIM" => self.field(keyword, "paraxial image heights", FieldKind::ParaxialImageHeight, line)?,
            "XRI" | "YRI" => self.field(keyword, "image heights", FieldKind::ImageHeight, line)?,
            "VUX" => list(&mut self.vignetting[0], line, 'F')?,
            "VLX" => list(&mut self.vignetting[1], line, 'F')?,
            "VUY" => list(&mut self.vignetting[2], line, 'F')?,
            "VLY" => list(&mut self.vignetting[3], line, 'F')?,
            "PRV" => self.private = Some(Vec::new()),
            "SO" => {
                if ![0.0, f64::INFINITY].contains(&surface::length(line, 0)?.abs()) {
                    return Err(line.refused("a curved object", "a plane object"));
                }
                self.object = Some(object(surface::length(line, 1)? * unit));
                self.draft.object_medium = self.medium_behind(line)?;
                self.draft.object_at = line.place.clone();
            }
            "S" => self.surface(line)?,
            "SI" => {
                self.image_at = line.place.clone();
                if !line.words.is_empty() {
                    let number = surface::length(line, 0)?;
                    if self.radii.is_none() && number != 0.0 && number.is_finite() {
                        self.unsaid.push((self.draft.surfaces.len(), number));
                    }
                    let radius = self.radii == Some(true) || number.is_infinite();
                    self.draft.image.curvature = surface::curvature(number, radius) / unit;
                }
                self.image = Some(line.optional(1)?.unwrap_or(0.0) * unit);
            }
            "IN" => {
                let found = format!("the file `{}` is included (IN)", shown(&line.words.join(" ")));
                return Err(
                    line.refused(found, "all statements in one file: put those of that file in the place of the line")
                );
            }
            "SCA" if line.words.len() == 1 && line.words[0].parse::<f64>() == Ok(1.0) => {}
            "SCA" => {
                let found =
                    format!("the lens is to be scaled: {}", shown(format!("SCA {}", line.words.join(" ")).trim_end()));
                return Err(line.refused(found, "a lens that was saved scaled, without SCA or with SCA 1"));
            }
            _ if HARMLESS.contains(&keyword) => {}
            _ if SOLVES.contains(&keyword) => self.solved.push(format!("{keyword} ({})", line.place)),
            _ => self.of_surface(keyword, line)?,
        }
        Ok(())
    }

    /// A statement of the header, or behind the image, that this reader does not know.
    fn read_over(&mut self, keyword: &str, line: &Line) -> Result<()> {
        if self.reading.strict {
            let found = format!("the statement `{}`", shown(keyword));
            return Err(line.refused(found, "a statement that this reader knows; without --strict it is read over"));
        }
        if self.unknown.len() < MOST {
            self.unknown.push(format!("{} ({})", shown(keyword), line.place));
        }
        Ok(())
    }

    fn size(&mut self, line: &Line, keyword: &str, size: Size) -> Result<()> {
        if let Some((other, _)) = self.size.as_ref().filter(|(k, _)| k != keyword) {
            return Err(line.refused(format!("{keyword} beside {other}"), "one statement of the aperture"));
        }
        self.size = Some((keyword.to_owned(), size));
        Ok(())
    }

    fn field(&mut self, keyword: &str, what: &'static str, kind: FieldKind, line: &Line) -> Result<()> {
        if let Some((other, _)) = self.kind.filter(|(_, k)| *k != kind) {
            return Err(line.refused(format!("field {what} beside {other}"), "one kind of field points"));
        }
        self.kind = Some((what, kind));
        list(&mut self.fields[usize::from(keyword.starts_with('Y'))], line, 'F')
    }

    fn finish(self, glasses: &Glasses) -> Result<Draft> {
        let mut draft = self.draft;
        self.zoom.finish(self.file, &mut draft.notes)?;
        let missing = |what: &str| Error::bad(self.file, what, "none in the file", "SO, at least one S, SI");
        draft.object_mm = self.object.ok_or_else(|| missing("SO"))?;
        let defocus = self.image.ok_or_else(|| missing("SI"))?;
        let last = draft.surfaces.last_mut().ok_or_else(|| missing("S"))?;
        last.thickness += defocus;
        if let Some(i) = self.focus {
            draft.surfaces[i].solved = Some(if i + 1 == draft.surfaces.len() { defocus } else { 0.0 });
        }
        if !draft.surfaces.iter().any(|s| s.stop) {
            draft.surfaces[0].stop = true;
            draft.notes.push("no stop is stated: the first surface is it".into());
        }
        draft.aperture = self.size.map(|(_, size)| match size {
            Size::EntrancePupil(d) => Size::EntrancePupil(d * self.scale),
            other => other,
        });
        draft.field = self.kind.map_or(FieldKind::Angle, |(_, kind)| kind);
        let unit = if draft.field == FieldKind::Angle { 1.0 } else { self.scale };
        let at = |list: &[f64], i: usize| list.get(i).copied().unwrap_or(0.0);
        for i in 0..self.fields[0].len().max(self.fields[1].len()) {
            let [ux, lx, uy, ly] = [0, 1, 2, 3].map(|k| at(&self.vignetting[k], i));
            draft.points.push(Point {
                x: unit * at(&self.fields[0], i),
                y: unit * at(&self.fields[1], i),
                decentre: [0.5 * (lx - ux), 0.5 * (ly - uy)],
                compression: [0.5 * (ux + lx), 0.5 * (uy + ly)],
            });
        }
        for (w, weight) in draft.wavelengths.iter_mut().zip(&self.weights) {
            w.1 = *weight;
        }
        if !self.unknown.is_empty() {
            draft.notes.push(format!(
                "statements that this reader does not know are read over: {} (--strict refuses them)",
                self.unknown.join(", ")
            ));
        }
        if !self.referred && draft.wavelengths.len() > 1 {
            draft.notes.push(format!(
                "no reference wavelength is stated (REF): the first is it, {} nm",
                draft.wavelengths[0].0
            ));
        }
        mode::decide(&mut draft, &self.unsaid, self.scale, self.file, glasses)?;
        draft.curve_image(&self.image_at, draft.image);
        if !self.solved.is_empty() {
            draft.notes.push(format!("solves and pickups are kept as their values: {}", self.solved.join(", ")));
        }
        Ok(draft)
    }
}

/// Whether a word names a zoom position: `Z2`.
fn zoom_position(word: &str) -> bool {
    word.strip_prefix(['Z', 'z']).is_some_and(|n| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
}

/// An object distance: infinite from [`INFINITY`] on.
fn object(distance: f64) -> f64 {
    if distance.abs() >= INFINITY { f64::INFINITY } else { distance }
}

/// The numbers of a line; behind a word such as `F2` that one of the list alone.
fn list(all: &mut Vec<f64>, line: &Line, of: char) -> Result<()> {
    let one = line.words.first().and_then(|w| w.to_ascii_uppercase().strip_prefix(of)?.parse::<usize>().ok());
    let Some(one) = one else {
        *all = few(line)?;
        return Ok(());
    };
    if !(1..=MOST).contains(&one) {
        return Err(line.refused(format!("{of}{one}"), format!("{of}1 to {of}{MOST}")));
    }
    if all.len() < one {
        all.resize(one, 0.0);
    }
    all[one - 1] = line.number(1)?;
    Ok(())
}

fn few(line: &Line) -> Result<Vec<f64>> {
    if line.words.len() > MOST {
        return Err(line.refused(format!("{} numbers", line.words.len()), format!("at most {MOST}")));
    }
    line.numbers()
}
