//! What the header of a Zemax file says: aperture, field, wavelengths, catalogues.

use std::collections::BTreeMap;

use super::order::Order;
use super::surface::{self, Raw};
use crate::interchange::draft::{Draft, FieldKind, Point, Size};
use crate::interchange::text::{Line, Once, shown};
use isoplanat_base::error::Result;

/// Most field points and wavelengths that a file states: more than a lens has, so that what was written is read.
const MOST: usize = 128;
/// The d line, nm: what a model glass of `n_d`, `V_d` is stated at.
const D_LINE_NM: f64 = 587.561_8;

/// What a file states once and what else would take over: its unit, its fields' kind, the number of its reference wavelength.
const ONCE: [&str; 3] = ["UNIT", "FTYP", "PWAV"];

/// What the header says.
#[derive(Default)]
pub(super) struct Header {
    scale: Option<f64>,
    size: Option<(String, Size)>,
    kind: Option<FieldKind>,
    fields: Option<usize>,
    waves: Option<usize>,
    primary: Option<usize>,
    columns: BTreeMap<&'static str, Vec<f64>>,
    wavelengths: BTreeMap<usize, (f64, f64)>,
    stated: Once,
    catalogues: Vec<String>,
    title: String,
    pub(super) notes: Vec<String>,
    /// Operands of merit function and tolerances.
    pub(super) merit: usize,
}

/// Lists: one number a field or wavelength, each with its name in older files, which counts where the newer is not there.
const COLUMNS: [(&str, &str); 9] = [
    ("XFLN", "XFLD"),
    ("YFLN", "YFLD"),
    ("VDXN", "ZVDX"),
    ("VDYN", "ZVDY"),
    ("VCXN", "ZVCX"),
    ("VCYN", "ZVCY"),
    ("VANN", "ZVAN"),
    ("WAVL", "WAVN"),
    ("WWGT", "WWGT"),
];

impl Header {
    /// Takes a keyword of the header; whether it is one.
    pub(super) fn read(&mut self, keyword: &str, line: &Line, raw: &str) -> Result<bool> {
        if ONCE.contains(&keyword) {
            self.stated.take(keyword, 0, line)?;
        }
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
                self.stated.take(&format!("WAVM {i}"), 1, line)?;
                self.wavelengths.insert(i, (um * 1e3, weight));
            }
            "PWAV" => self.primary = Some(line.count(0, 1000)?),
            "BLNK" | "TOL" | "MOFF" | "TOFF" => {}
            _ => match COLUMNS.iter().flat_map(|(new, old)| [new, old]).find(|c| **c == keyword) {
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

    /// Entry `i` of a list, by its newer name.
    fn column(&self, name: &str, i: usize) -> f64 {
        self.list(name).and_then(|c| c.get(i)).copied().unwrap_or(0.0)
    }

    /// A list by its newer name, or by the older one where the file has only that.
    fn list(&self, name: &str) -> Option<&Vec<f64>> {
        let older = COLUMNS.iter().find(|(new, _)| *new == name).map(|(_, old)| *old);
        self.columns.get(name).or_else(|| self.columns.get(older?))
    }

    /// Sets entry `i` of a list.
    pub(super) fn set_column(&mut self, name: &'static str, i: usize, value: f64) {
        let mut list = self.list(name).cloned().unwrap_or_default();
        if i < MOST {
            if list.len() <= i {
                list.resize(i + 1, 0.0);
            }
            list[i] = value;
            self.columns.insert(name, list);
        }
    }

    /// Sets the number that states the aperture, whatever kind it is; false where it has none.
    pub(super) fn set_aperture(&mut self, value: f64) -> bool {
        match self.size.as_mut().map(|(_, size)| size) {
            Some(
                Size::EntrancePupil(x)
                | Size::FNumber(x)
                | Size::WorkingFNumber(x)
                | Size::ObjectAperture(x)
                | Size::ImageAperture(x),
            ) => {
                *x = value;
                true
            }
            _ => false,
        }
    }

    /// Sets wavelength `i` (from 1), µm, or its weight.
    pub(super) fn set_wavelength(&mut self, i: usize, um: Option<f64>, weight: Option<f64>) {
        if self.wavelengths.is_empty() {
            let list = self.list("WAVL").cloned().unwrap_or_default();
            for (k, um) in list.iter().enumerate() {
                let weight = self.list("WWGT").and_then(|w| w.get(k)).copied().unwrap_or(1.0);
                self.wavelengths.insert(k + 1, (um * 1e3, weight));
            }
        }
        let entry = self.wavelengths.entry(i).or_insert((D_LINE_NM, 1.0));
        entry.0 = um.map_or(entry.0, |um| um * 1e3);
        entry.1 = weight.unwrap_or(entry.1);
    }

    /// Sets the number (from 1) of the reference wavelength.
    pub(super) fn set_primary(&mut self, i: usize) {
        self.primary = Some(i);
    }

    /// Lists of the older names that stand beside the newer ones, which count.
    fn repeated(&self) -> Vec<&'static str> {
        let both = |(new, old): &(&'static str, &'static str)| {
            (new != old && self.columns.contains_key(new) && self.columns.contains_key(old)).then_some(*old)
        };
        let mut told: Vec<&'static str> = COLUMNS.iter().filter_map(both).collect();
        if !self.wavelengths.is_empty() && self.columns.contains_key("WAVN") && !told.contains(&"WAVN") {
            told.push("WAVN");
        }
        told
    }

    /// The draft of header and surfaces; `notes` come first.
    pub(super) fn draft(mut self, surfaces: Vec<Raw>, order: &Order, notes: Vec<String>, file: &str) -> Result<Draft> {
        let mut draft = Draft::new("Zemax file");
        draft.notes = notes;
        let scale = self.scale.unwrap_or(1.0);
        draft.title = std::mem::take(&mut self.title);
        draft.aperture = self.size.as_ref().map(|(_, size)| match *size {
            Size::EntrancePupil(d) => Size::EntrancePupil(d * scale),
            other => other,
        });
        draft.field = self.kind.unwrap_or(FieldKind::Angle);
        let stated = self.list("YFLN").map_or(0, Vec::len).max(self.list("XFLN").map_or(0, Vec::len));
        let unit = if draft.field == FieldKind::Angle { 1.0 } else { scale };
        for i in 0..self.fields.filter(|n| *n > 0).unwrap_or(stated).min(MOST) {
            if self.column("VANN", i) != 0.0 {
                draft.notes.push(format!("field {}: the vignetting angle is not taken into account", i + 1));
            }
            draft.points.push(Point {
                x: unit * self.column("XFLN", i),
                y: unit * self.column("YFLN", i),
                decentre: [self.column("VDXN", i), self.column("VDYN", i)],
                compression: [self.column("VCXN", i), self.column("VCYN", i)],
            });
        }
        let repeated = self.repeated();
        if !repeated.is_empty() {
            draft.notes.push(format!("read over, a newer list of the file says it: {}", repeated.join(", ")));
        }
        let mut wavelengths: Vec<(f64, f64)> = self.wavelengths.values().copied().collect();
        if wavelengths.is_empty() {
            let list = self.list("WAVL").cloned().unwrap_or_default();
            let weight = |i: usize| self.list("WWGT").and_then(|w| w.get(i)).copied().unwrap_or(1.0);
            wavelengths = list.iter().enumerate().map(|(i, um)| (um * 1e3, weight(i))).collect();
        }
        wavelengths.truncate(self.waves.filter(|n| *n > 0).unwrap_or(usize::MAX));
        draft.primary = self.primary.unwrap_or(1).saturating_sub(1);
        if wavelengths.is_empty() && self.waves.is_none() && self.primary.is_none() {
            draft.notes.push(format!("no wavelength is stated: {D_LINE_NM} nm, the d line, is taken"));
            wavelengths.push((D_LINE_NM, 1.0));
        }
        draft.wavelengths = wavelengths;
        draft.catalogues = std::mem::take(&mut self.catalogues);
        if self.merit > 0 {
            draft.notes.push(format!("{} operands of the merit function and of tolerances are not read", self.merit));
        }
        surface::put(&mut draft, surfaces, order, scale, file)?;
        Ok(draft)
    }
}
