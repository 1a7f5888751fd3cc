//! CODE V sequence files `.seq`: what `WRL` and lens designers write. Statements end at line ends or semicolons.

mod statements;

use super::draft::{Draft, FieldKind, Point, Size, Stage};
use super::media::Stated;
use super::text::{Line, shown};
use crate::lens::check::MAX_SURFACES;
use isoplanat_base::error::{Error, Result};
use statements::{Statement, statements};

/// Statements that no ray depends on, or that only say what may vary.
const HARMLESS: [&str; 40] = [
    "LEN", "INI", "TEM", "PRE", "DER", "GO", "WTF", "SLB", "CCY", "THC", "GLC", "KC", "CCX", "AC", "BC", "CC", "DC",
    "EC", "FC", "GC", "HC", "JC", "COM", "IN", "OUT", "VIE", "DOR", "CA", "GL2", "EXI", "CLS", "WRL", "SAV", "SET",
    "DRW", "CKC", "GLN", "MFL", "SPH", "DDM",
];
/// Solves whose value stands in the surface.
const SOLVES: [&str; 8] = ["PIM", "PIK", "UMY", "HMY", "IMY", "UCY", "HCY", "CUM"];
/// Fields and wavelengths at most.
const MOST: usize = 64;
/// Beyond this an object is infinitely far, in the file's unit.
const INFINITY: f64 = 1e9;

struct Reader<'a> {
    file: &'a str,
    scale: f64,
    radii: bool,
    draft: Draft,
    fields: [Vec<f64>; 2],
    vignetting: [Vec<f64>; 4],
    weights: Vec<f64>,
    size: Option<(String, Size)>,
    kind: Option<(&'static str, FieldKind)>,
    object: Option<f64>,
    /// Behind the image statement: how far the image stands behind the last distance.
    image: Option<f64>,
    /// Wavelengths of private glasses while they are being defined, and the glasses.
    private: Option<Vec<f64>>,
    glasses: Vec<(String, Stated)>,
    solved: Vec<String>,
}

/// Reads the text of a file; `file` names it in errors.
pub(super) fn read(text: &str, file: &str) -> Result<Draft> {
    let mut reader = Reader {
        file,
        scale: 1.0,
        radii: true,
        draft: Draft::new("CODE V file"),
        fields: Default::default(),
        vignetting: Default::default(),
        weights: Vec::new(),
        size: None,
        kind: None,
        object: None,
        image: None,
        private: None,
        glasses: Vec::new(),
        solved: Vec::new(),
    };
    let mut known = false;
    for statement in statements(text) {
        match reader.take(&statement) {
            Ok(()) => known = true,
            // A file of another kind fails at its first word.
            Err(_) if !known => {
                let found = format!("`{}`", shown(statement.words[0]));
                let allowed = "a CODE V sequence, which begins with statements such as RDM, LEN, TITLE";
                return Err(Error::bad(file, format!("line {}", statement.line), found, allowed));
            }
            Err(error) => return Err(error),
        }
    }
    reader.finish()
}

impl Reader<'_> {
    fn take(&mut self, statement: &Statement) -> Result<()> {
        let keyword = statement.words[0].to_ascii_uppercase();
        let words: Vec<&str> = statement.words[1..].to_vec();
        let line = Line { file: self.file, place: format!("line {}", statement.line), words };
        if self.private.is_some() {
            return self.private_glass(&keyword, statement.words[0], &line);
        }
        let unit = self.scale;
        match keyword.as_str() {
            "RDM" => self.radii = !line.words.first().is_some_and(|w| w.eq_ignore_ascii_case("N")),
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
            "EPD" => self.size(&line, &keyword, Size::EntrancePupil(line.number(0)?))?,
            "FNO" => self.size(&line, &keyword, Size::WorkingFNumber(line.number(0)?))?,
            "NA" => self.size(&line, &keyword, Size::ImageAperture(line.number(0)?))?,
            "NAO" => self.size(&line, &keyword, Size::ObjectAperture(line.number(0)?))?,
            "WL" => self.draft.wavelengths = few(&line)?.into_iter().map(|nm| (nm, 1.0)).collect(),
            "WTW" => self.weights = few(&line)?,
            "REF" => self.draft.primary = line.count(0, MOST)?.saturating_sub(1),
            "XAN" | "YAN" => self.field(&keyword, "angles", FieldKind::Angle, &line)?,
            "XOB" | "YOB" => self.field(&keyword, "object heights", FieldKind::ObjectHeight, &line)?,
            "XIM" | "YIM" => self.field(&keyword, "paraxial image heights", FieldKind::ParaxialImageHeight, &line)?,
            "XRI" | "YRI" => self.field(&keyword, "image heights", FieldKind::ImageHeight, &line)?,
            "VUX" => self.vignetting[0] = few(&line)?,
            "VLX" => self.vignetting[1] = few(&line)?,
            "VUY" => self.vignetting[2] = few(&line)?,
            "VLY" => self.vignetting[3] = few(&line)?,
            "PRV" => self.private = Some(Vec::new()),
            "SO" => {
                if line.number(0)? != 0.0 {
                    return Err(line.refused("a curved object", "a plane object"));
                }
                let distance = line.number(1)?;
                self.object = Some(if distance.abs() >= INFINITY { f64::INFINITY } else { distance * unit });
            }
            "S" => self.surface(&line)?,
            "SI" => {
                if line.optional(0)?.unwrap_or(0.0) != 0.0 {
                    return Err(line.refused("a curved image", "a plane image"));
                }
                self.image = Some(line.optional(1)?.unwrap_or(0.0) * unit);
            }
            _ if HARMLESS.contains(&keyword.as_str()) => {}
            _ if self.image.is_some() && ["CIR", "REX", "REY", "STO"].contains(&keyword.as_str()) => {}
            _ if SOLVES.contains(&keyword.as_str()) => self.solved.push(format!("{keyword} (line {})", statement.line)),
            _ => self.of_surface(&keyword, &line)?,
        }
        Ok(())
    }

    /// A statement about the surface before it.
    fn of_surface(&mut self, keyword: &str, line: &Line) -> Result<()> {
        let unit = self.scale;
        let unknown =
            || line.refused(format!("the statement `{}`", shown(keyword)), "a statement that this reader knows");
        let Some(stage) = self.draft.surfaces.last_mut().filter(|_| self.image.is_none()) else {
            return Err(unknown());
        };
        // Coefficients of the asphere: A is the term in r⁴.
        let order = "ABCDEFGHJ".find(keyword).filter(|_| keyword.len() == 1);
        if let Some(order) = order {
            let power = 2 * order + 4;
            if stage.even.len() < order + 2 {
                stage.even.resize(order + 2, 0.0);
            }
            stage.even[order + 1] = line.number(0)? * unit.powi(1 - i32::try_from(power).unwrap_or(0));
            return Ok(());
        }
        match keyword {
            "STO" => stage.stop = true,
            "ASP" | "CON" => {}
            "K" => stage.conic = line.number(0)?,
            "CUY" => stage.curvature = line.number(0)? / unit,
            "RDY" => stage.curvature = curvature(line.number(0)?, true) / unit,
            "THI" => stage.thickness = line.number(0)? * unit,
            "CIR" => match line.words.first().copied().unwrap_or("").to_ascii_uppercase().as_str() {
                "EDG" => {}
                word @ ("OBS" | "HOL") => {
                    return Err(line.refused(format!("CIR {word}"), "a circular aperture without an obscuration"));
                }
                _ => {
                    let r = line.number(0)?.abs() * unit;
                    stage.semi_diameter = Some(r).filter(|r| *r > 0.0);
                }
            },
            "RMD" if line.words.first().is_some_and(|w| w.eq_ignore_ascii_case("REFL")) => {
                return Err(line.refused("a mirror (RMD REFL)", "refracting surfaces"));
            }
            "RMD" => {}
            "XDE" | "YDE" | "ZDE" | "ADE" | "BDE" | "CDE" => {
                if line.number(0)? != 0.0 {
                    let found = format!("{keyword} {}", line.words[0]);
                    return Err(line.refused(found, "surfaces on one axis; tilts and decentres go in a TOML file"));
                }
            }
            "DAR" | "BEN" | "RET" | "REV" => {
                // Without an amount they break nothing.
            }
            "REX" | "REY" | "ELX" | "ELY" => {
                return Err(line.refused(
                    format!("a rectangular or elliptical aperture ({keyword})"),
                    "a circular aperture (CIR)",
                ));
            }
            _ => return Err(unknown()),
        }
        Ok(())
    }

    fn surface(&mut self, line: &Line) -> Result<()> {
        if self.image.is_some() || self.draft.surfaces.len() >= MAX_SURFACES {
            let found = format!("surface {} here", self.draft.surfaces.len() + 1);
            return Err(line.refused(found, format!("at most {MAX_SURFACES} surfaces, before SI")));
        }
        let mut stage = Stage::plane(format!("{} (S {})", line.place, self.draft.surfaces.len() + 1));
        stage.curvature = curvature(line.number(0)?, self.radii) / self.scale;
        stage.thickness = line.number(1)? * self.scale;
        if let Some(name) = line.words.get(2) {
            if name.eq_ignore_ascii_case("REFL") || line.words.get(3).is_some_and(|w| w.eq_ignore_ascii_case("REFL")) {
                return Err(line.refused("a mirror (REFL)", "refracting surfaces"));
            }
            stage.medium = self.medium(name);
        }
        self.draft.surfaces.push(stage);
        Ok(())
    }

    fn medium(&self, name: &str) -> Stated {
        if name.eq_ignore_ascii_case("AIR") {
            return Stated::Air;
        }
        if let Some((_, stated)) = self.glasses.iter().find(|(n, _)| n == name) {
            return stated.clone();
        }
        if let Some((n_d, v_d)) = fictitious(name) {
            return Stated::Lines { n_d, v_d };
        }
        // NSK16_SCHOTT: the catalogue stands behind the name.
        match name.rsplit_once('_') {
            Some((glass, catalogue)) => Stated::Glass(format!("{catalogue}/{glass}")),
            None => Stated::Glass(name.to_owned()),
        }
    }

    fn private_glass(&mut self, keyword: &str, name: &str, line: &Line) -> Result<()> {
        match keyword {
            "END" => self.private = None,
            "PWL" => self.private = Some(few(line)?),
            _ => {
                let wavelengths = self.private.clone().unwrap_or_default();
                let indices = few(line)?;
                if wavelengths.is_empty() || wavelengths.len() != indices.len() {
                    let found = format!("{} indices of `{}`", indices.len(), shown(name));
                    return Err(
                        line.refused(found, format!("one for each of the {} wavelengths of PWL", wavelengths.len()))
                    );
                }
                if self.glasses.len() >= MAX_SURFACES {
                    return Err(line.refused("one more private glass", format!("at most {MAX_SURFACES}")));
                }
                self.glasses.push((name.to_owned(), Stated::Table(wavelengths.into_iter().zip(indices).collect())));
            }
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
        self.fields[usize::from(keyword.starts_with('Y'))] = few(line)?;
        Ok(())
    }

    fn finish(self) -> Result<Draft> {
        let mut draft = self.draft;
        let missing = |what: &str| Error::bad(self.file, what, "none in the file", "SO, at least one S, SI");
        draft.object_mm = self.object.ok_or_else(|| missing("SO"))?;
        let defocus = self.image.ok_or_else(|| missing("SI"))?;
        let last = draft.surfaces.last_mut().ok_or_else(|| missing("S"))?;
        last.thickness += defocus;
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
        if !self.solved.is_empty() {
            draft.notes.push(format!("solves and pickups are kept as their values: {}", self.solved.join(", ")));
        }
        Ok(draft)
    }
}

/// The curvature that a number of a surface states.
fn curvature(number: f64, radius: bool) -> f64 {
    if !radius || number == 0.0 { number } else { 1.0 / number }
}

fn few(line: &Line) -> Result<Vec<f64>> {
    if line.words.len() > MOST {
        return Err(line.refused(format!("{} numbers", line.words.len()), format!("at most {MOST}")));
    }
    line.numbers()
}

/// Index and Abbe number of a fictitious glass: `517642`, `516800.641673` or `1.5168:64.17`.
fn fictitious(name: &str) -> Option<(f64, f64)> {
    if let Some((n, v)) = name.split_once(':') {
        return Some((n.parse().ok()?, v.parse().ok()?));
    }
    let digits = |s: &str| !s.is_empty() && s.len() <= 12 && s.bytes().all(|b| b.is_ascii_digit());
    let (n, v) = match name.split_once('.') {
        Some((n, v)) if digits(n) && digits(v) && n.len() >= 3 => (n, v),
        None if digits(name) && name.len() == 6 => name.split_at(3),
        _ => return None,
    };
    let v = if v.len() <= 2 { v.to_owned() } else { format!("{}.{}", &v[..2], &v[2..]) };
    Some((format!("1.{n}").parse().ok()?, v.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::fictitious;

    #[test]
    fn fictitious_glasses() {
        assert_eq!(fictitious("517642"), Some((1.517, 64.2)));
        assert_eq!(fictitious("516800.641673"), Some((1.5168, 64.1673)));
        assert_eq!(fictitious("1.5168:64.17"), Some((1.5168, 64.17)));
        assert_eq!(fictitious("NBK7_SCHOTT"), None);
        assert_eq!(fictitious("F2"), None);
    }
}
