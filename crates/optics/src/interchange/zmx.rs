//! Zemax OpticStudio `.zmx`, sequential mode. Keywords as the files of versions 2009 to 2024 have them; lengths in the file's unit.

mod apertures;
mod surface;

use super::draft::{Draft, FieldKind, Point, Size};
use super::text::{Line, shown};
use crate::lens::check::MAX_SURFACES;
use isoplanat_base::error::Result;
use surface::Raw;

/// Keywords of the header that no ray depends on, or that another keyword repeats.
const HARMLESS: [&str; 38] = [
    "VERS", "AUTH", "NOTE", "IWDP", "STUD", "PFIL", "LANG", "GFAC", "RAIM", "PUSH", "SDMA", "OMMA", "ROPD", "HYPR",
    "PICB", "FWGN", "FCOM", "POLS", "GLRS", "GSTD", "NSCD", "COFN", "LUID", "EERA", "TOLS", "SCHT", "PPRD", "FOVL",
    "CLRF", "XZOO", "FWGT", "DXFN", "RYLE", "VPCO", "DRGN", "SYMM", "COMM", "WWGN",
];
/// Most field points and wavelengths that a file states.
const MOST: usize = 64;

/// What the header says.
#[derive(Default)]
struct Header {
    scale: Option<f64>,
    size: Option<(String, Size)>,
    kind: Option<FieldKind>,
    fields: Option<usize>,
    waves: Option<usize>,
    primary: Option<usize>,
    columns: std::collections::BTreeMap<&'static str, Vec<f64>>,
    wavelengths: std::collections::BTreeMap<usize, (f64, f64)>,
    catalogues: Vec<String>,
    title: String,
    notes: Vec<String>,
    merit: usize,
}

/// Lists of the header: one number a field or wavelength.
const COLUMNS: [&str; 9] = ["XFLN", "YFLN", "VDXN", "VDYN", "VCXN", "VCYN", "VANN", "WAVL", "WWGT"];

/// Reads the text of a file; `file` names it in errors.
pub(super) fn read(text: &str, file: &str) -> Result<Draft> {
    let mut header = Header::default();
    let mut surfaces: Vec<Raw> = Vec::new();
    let mut known = false;
    for (number, raw) in text.lines().enumerate() {
        let mut words = raw.split_whitespace();
        let Some(keyword) = words.next() else { continue };
        let line = Line { file, place: format!("line {}", number + 1), words: words.collect() };
        if keyword == "SURF" {
            known = true;
            if surfaces.len() > MAX_SURFACES {
                return Err(
                    line.refused(format!("more than {MAX_SURFACES} surfaces"), format!("at most {MAX_SURFACES}"))
                );
            }
            let index = line.count(0, usize::MAX)?;
            if index != surfaces.len() {
                return Err(line.refused(format!("SURF {index}"), format!("SURF {}, the next one", surfaces.len())));
            }
            surfaces.push(Raw::new(format!("{} (SURF {index})", line.place)));
            continue;
        }
        let place = surfaces.last().map(|s| format!("{} (SURF {})", line.place, s.index()));
        let in_surface = Line { place: place.unwrap_or_else(|| line.place.clone()), ..line };
        if let Some(surface) = surfaces.last_mut()
            && surface.read(keyword, &in_surface)?
        {
            continue;
        }
        let line = in_surface;
        if header.read(keyword, &line, raw)? || HARMLESS.contains(&keyword) {
            known = true;
            continue;
        }
        // Behind the surfaces stand the merit function, tolerances and configurations, none of them indented.
        if !surfaces.is_empty() && (!raw.starts_with(' ') || header.merit > 0) && operand(keyword) {
            header.merit += 1;
            continue;
        }
        if !known {
            return Err(line.refused(
                format!("`{}`", shown(keyword)),
                "a Zemax lens file, which begins with keywords such as VERS",
            ));
        }
        return Err(line.refused(format!("the keyword `{}`", shown(keyword)), "a keyword that this reader knows"));
    }
    header.draft(surfaces, file)
}

/// Whether a word looks like an operand of the merit function.
fn operand(keyword: &str) -> bool {
    (3..=4).contains(&keyword.len())
        && keyword.chars().all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '+')
}

impl Header {
    /// Takes a keyword of the header; whether it is one.
    fn read(&mut self, keyword: &str, line: &Line, raw: &str) -> Result<bool> {
        match keyword {
            "MODE" if line.words.first() != Some(&"SEQ") => {
                return Err(line.refused(format!("mode {}", shown(&line.words.join(" "))), "SEQ: sequential lenses"));
            }
            "MODE" => {}
            "NAME" => self.title = raw.trim().trim_start_matches("NAME").trim().chars().take(200).collect(),
            "UNIT" => {
                let unit = line.words.first().copied().unwrap_or("");
                let scale = [("MM", 1.0), ("CM", 10.0), ("IN", 25.4), ("METER", 1e3), ("M", 1e3)];
                let found = scale.iter().find(|(name, _)| *name == unit);
                self.scale = Some(
                    found.ok_or_else(|| line.refused(format!("the unit `{}`", shown(unit)), "MM, CM, IN, METER"))?.1,
                );
            }
            "ENPD" => self.size(line, keyword, Size::EntrancePupil(line.number(0)?))?,
            "FNUM" => {
                let (n, paraxial) = (line.number(0)?, line.optional(1)?.unwrap_or(0.0));
                self.size(line, keyword, if paraxial == 0.0 { Size::FNumber(n) } else { Size::WorkingFNumber(n) })?;
            }
            "OBNA" => {
                let (n, cone) = (line.number(0)?, line.optional(1)?.unwrap_or(0.0));
                self.size(line, keyword, Size::ObjectAperture(if cone == 0.0 { n } else { n.to_radians().sin() }))?;
            }
            "FLOA" => self.size(line, keyword, Size::Stop)?,
            "ENVD" => {
                let (t, p, adjusted) = (line.number(0)?, line.number(1)?, line.optional(2)?.unwrap_or(0.0));
                if adjusted != 0.0 && (t != 20.0 || p != 1.0) {
                    self.notes
                        .push(format!("{t} °C and {p} atm are not taken into account: indices are the catalogue's"));
                }
            }
            "GCAT" => self.catalogues = line.words.iter().map(|w| (*w).to_owned()).collect(),
            "FTYP" => {
                let kinds =
                    [FieldKind::Angle, FieldKind::ObjectHeight, FieldKind::ParaxialImageHeight, FieldKind::ImageHeight];
                let kind = line.count(0, 9)?;
                let allowed = "0 angle, 1 object height, 2 paraxial image height, 3 image height";
                let kind = *kinds.get(kind).ok_or_else(|| line.refused(format!("field type {kind}"), allowed))?;
                // Two image heights stand in files as 2 (paraxial) and 3 (real).
                self.kind = Some(kind);
                if line.optional(1)?.unwrap_or(0.0) != 0.0 {
                    self.notes.push("telecentric object space: rays are aimed at the stop instead".into());
                }
                if line.words.len() > 2 {
                    self.fields = Some(line.count(2, MOST)?);
                }
                if line.words.len() > 3 {
                    self.waves = Some(line.count(3, MOST)?);
                }
            }
            "WAVM" => {
                let (i, um, weight) = (line.count(0, 1000)?, line.number(1)?, line.optional(2)?.unwrap_or(1.0));
                self.wavelengths.insert(i, (um * 1e3, weight));
            }
            "PWAV" => self.primary = Some(line.count(0, 1000)?),
            "MNUM" => {
                let configurations = line.count(0, 10_000)?;
                if configurations > 1 {
                    self.notes
                        .push(format!("{configurations} configurations: the one that the surfaces state is read"));
                }
            }
            "BLNK" | "TOL" | "MOFF" | "TOFF" => {}
            _ => match COLUMNS.iter().find(|c| **c == keyword) {
                Some(column) => {
                    let numbers = line.numbers()?;
                    if numbers.len() > 4 * MOST {
                        return Err(line.refused(format!("{} numbers", numbers.len()), format!("at most {}", 4 * MOST)));
                    }
                    self.columns.insert(column, numbers);
                }
                None => return Ok(false),
            },
        }
        Ok(true)
    }

    fn size(&mut self, line: &Line, keyword: &str, size: Size) -> Result<()> {
        let empty = matches!(size, Size::EntrancePupil(x) | Size::FNumber(x) | Size::WorkingFNumber(x) | Size::ObjectAperture(x) if x == 0.0);
        if empty {
            return Ok(());
        }
        if let Some((other, _)) = self.size.as_ref().filter(|(_, s)| *s != size) {
            return Err(line.refused(format!("{keyword} beside {other}"), "one statement of the aperture"));
        }
        self.size = Some((keyword.to_owned(), size));
        Ok(())
    }

    fn column(&self, name: &str, i: usize) -> f64 {
        self.columns.get(name).and_then(|c| c.get(i)).copied().unwrap_or(0.0)
    }

    fn draft(mut self, surfaces: Vec<Raw>, file: &str) -> Result<Draft> {
        let mut draft = Draft::new("Zemax file");
        let scale = self.scale.unwrap_or(1.0);
        draft.title = std::mem::take(&mut self.title);
        draft.aperture = self.size.as_ref().map(|(_, size)| match *size {
            Size::EntrancePupil(d) => Size::EntrancePupil(d * scale),
            other => other,
        });
        draft.field = self.kind.unwrap_or(FieldKind::Angle);
        let stated = self.columns.get("YFLN").map_or(0, Vec::len).max(self.columns.get("XFLN").map_or(0, Vec::len));
        let unit = if draft.field == FieldKind::Angle { 1.0 } else { scale };
        for i in 0..self.fields.filter(|n| *n > 0).unwrap_or(stated).min(MOST) {
            if self.column("VANN", i) != 0.0 {
                self.notes.push(format!("field {}: the vignetting angle is not taken into account", i + 1));
            }
            draft.points.push(Point {
                x: unit * self.column("XFLN", i),
                y: unit * self.column("YFLN", i),
                decentre: [self.column("VDXN", i), self.column("VDYN", i)],
                compression: [self.column("VCXN", i), self.column("VCYN", i)],
            });
        }
        let mut wavelengths: Vec<(f64, f64)> = self.wavelengths.values().copied().collect();
        if wavelengths.is_empty() {
            let list = self.columns.get("WAVL").cloned().unwrap_or_default();
            let weight = |i: usize| self.columns.get("WWGT").and_then(|w| w.get(i)).copied().unwrap_or(1.0);
            wavelengths = list.iter().enumerate().map(|(i, um)| (um * 1e3, weight(i))).collect();
        }
        wavelengths.truncate(self.waves.filter(|n| *n > 0).unwrap_or(usize::MAX));
        draft.primary = self.primary.unwrap_or(1).saturating_sub(1);
        draft.wavelengths = wavelengths;
        draft.catalogues = std::mem::take(&mut self.catalogues);
        if self.merit > 0 {
            draft.notes.push(format!("{} operands of the merit function and of tolerances are not read", self.merit));
        }
        draft.notes.append(&mut self.notes);
        surface::put(&mut draft, surfaces, scale, file)?;
        Ok(draft)
    }
}
