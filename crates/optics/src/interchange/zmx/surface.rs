//! Surfaces of a Zemax file.

use super::apertures::Apertures;
use crate::interchange::draft::{Draft, Stage};
use crate::interchange::line_glass::OfLine;
use crate::interchange::media::Stated;
use crate::interchange::text::{Line, shown};
use isoplanat_base::error::{Error, Result};

/// Keywords of a surface that no ray depends on.
const HARMLESS: [&str; 26] = [
    "SSID", "FIMP", "HIDE", "MIRR", "SLAB", "MEMA", "POPS", "TRCX", "TRCY", "COAT", "COMM", "VDSZ", "SCOL", "SDRW",
    "CCOL", "DRAW", "RSCE", "SCAT", "OPDX", "PPAR", "TCEX", "PUPD", "LOCA", "IGNR", "VPAR", "TCED",
];
/// Keywords by which a thickness follows from something else; its value stands in DISZ.
const SOLVES: [&str; 12] =
    ["MAZH", "CHZH", "PZUP", "EDGT", "OPDZ", "POSI", "COMP", "CNTR", "PUPZ", "TTHI", "EDGE", "ZPLM"];
/// Parameters that a surface's type has at most.
const PARAMETERS: usize = 300;

/// A surface as it is being read; lengths in the file's unit.
pub(super) struct Raw {
    place: String,
    kind: String,
    curvature: f64,
    conic: f64,
    parameters: Vec<f64>,
    /// More data than the parameters: of types that are not supported.
    extended: bool,
    thickness: f64,
    glass: Option<(Stated, String)>,
    mirror: bool,
    stop: bool,
    tilted: bool,
    /// Whether the next surface stands at the paraxial image.
    focus: bool,
    pickup: Option<(String, usize, f64)>,
    solved: Vec<String>,
    apertures: Apertures,
}

impl Raw {
    pub(super) fn new(place: String) -> Self {
        Self {
            place,
            kind: "STANDARD".into(),
            curvature: 0.0,
            conic: 0.0,
            parameters: Vec::new(),
            extended: false,
            thickness: 0.0,
            glass: None,
            mirror: false,
            stop: false,
            tilted: false,
            focus: false,
            pickup: None,
            solved: Vec::new(),
            apertures: Apertures::default(),
        }
    }

    /// Its number, as the place says it.
    pub(super) fn index(&self) -> &str {
        self.place.rsplit("SURF ").next().unwrap_or("").trim_end_matches(')')
    }

    /// Takes a keyword; whether it is a surface's.
    pub(super) fn read(&mut self, keyword: &str, line: &Line) -> Result<bool> {
        match keyword {
            "TYPE" => self.kind = line.words.first().copied().unwrap_or("STANDARD").to_owned(),
            "STOP" => self.stop = true,
            "CURV" => {
                self.curvature = line.number(0)?;
                match line.words.get(1).copied().unwrap_or("0") {
                    "0" | "1" => {}
                    "4" => {
                        self.pickup =
                            Some((line.place.clone(), line.count(2, 100_000)?, line.optional(3)?.unwrap_or(1.0)))
                    }
                    _ => self.solved.push("its curvature".into()),
                }
            }
            "CONI" => self.conic = line.number(0)?,
            "PARM" => {
                let i = line.count(0, PARAMETERS)?;
                if self.parameters.len() <= i {
                    self.parameters.resize(i + 1, 0.0);
                }
                self.parameters[i] = line.number(1)?;
            }
            "XDAT" => self.extended |= line.optional(1)?.unwrap_or(0.0) != 0.0,
            "DISZ" => {
                let word = line.words.first().copied().unwrap_or("");
                let infinite = ["INFINITY", "INF", "1E+10", "1.0E+10"].iter().any(|w| word.eq_ignore_ascii_case(w));
                self.thickness = if infinite { f64::INFINITY } else { line.number(0)? };
            }
            "GLAS" => self.medium(line)?,
            "SCBD" => self.tilted |= (3..line.words.len()).any(|i| line.optional(i).ok().flatten() != Some(0.0)),
            _ if self.apertures.read(keyword, line)? => {}
            // The paraxial marginal ray at height 0: the image of a point on the axis.
            "MAZH" if line.optional(0)?.unwrap_or(0.0) == 0.0 && line.optional(1)?.unwrap_or(0.0) == 0.0 => {
                self.focus = true;
            }
            _ if SOLVES.contains(&keyword) => self.solved.push("its thickness".into()),
            _ => return Ok(HARMLESS.contains(&keyword)),
        }
        Ok(true)
    }

    fn medium(&mut self, line: &Line) -> Result<()> {
        let name = line.words.first().copied().ok_or_else(|| line.refused("no glass", "its name"))?;
        let kind = line.optional(1)?.unwrap_or(0.0);
        self.mirror = name == "MIRROR";
        // 1: a model glass, whose numbers follow; 4: a glass with offsets of them.
        let model = kind == 1.0 || name == "___BLANK";
        let stated = if model {
            Stated::Lines { n_d: line.number(3)?, v_d: line.number(4)? }
        } else {
            let number = |i: usize| line.optional(i).ok().flatten().unwrap_or(0.0);
            // A pickup, a substitute, a partial dispersion or numbers that vary: what stands there is another glass's, or a former model's.
            let marked = kind != 0.0 || (5..=8).any(|i| number(i) != 0.0);
            Stated::Line(OfLine::new(name, number(3), number(4), marked))
        };
        if kind == 4.0 && (line.optional(3)?.unwrap_or(0.0) != 0.0 || line.optional(4)?.unwrap_or(0.0) != 0.0) {
            return Err(line
                .refused(format!("glass `{}` with offsets", shown(name)), "a glass of a catalogue, or a model glass"));
        }
        let partial = if model { line.optional(5)?.unwrap_or(0.0) } else { 0.0 };
        let told = if partial == 0.0 {
            String::new()
        } else {
            format!("a partial dispersion of {partial} beside the normal line is left out")
        };
        self.glass = Some((stated, told));
        Ok(())
    }

    fn refused(&self, file: &str, found: impl Into<String>, allowed: &str) -> Error {
        Error::bad(file, self.place.as_str(), found, allowed)
    }

    /// Even and odd terms, scaled to mm.
    fn terms(&self, scale: f64, file: &str) -> Result<(Vec<f64>, Vec<f64>)> {
        let parameter = |i: usize| self.parameters.get(i).copied().unwrap_or(0.0);
        let scaled = |a: f64, power: i32| a * scale.powi(1 - power);
        let supported = "STANDARD, EVENASPH, ODDASPHE";
        match self.kind.as_str() {
            _ if self.extended => {
                Err(self.refused(file, format!("extra data of a surface of type {}", shown(&self.kind)), supported))
            }
            "STANDARD" => Ok((Vec::new(), Vec::new())),
            // A break that breaks nothing marks a place.
            "COORDBRK" if self.parameters.iter().all(|p| *p == 0.0) => Ok((Vec::new(), Vec::new())),
            "COORDBRK" => Err(self.refused(
                file,
                "a coordinate break",
                "surfaces on one axis; tilts and decentres go in a TOML file",
            )),
            "EVENASPH" => {
                Ok(((1..=8).map(|i| scaled(parameter(i), 2 * i32::try_from(i).unwrap_or(0))).collect(), Vec::new()))
            }
            "ODDASPHE" => {
                if parameter(1) != 0.0 {
                    return Err(self.refused(
                        file,
                        format!("a term {} r", parameter(1)),
                        "terms from r² on: a cone has no tangent plane",
                    ));
                }
                let term = |power: usize| scaled(parameter(power), i32::try_from(power).unwrap_or(0));
                Ok(((1..=4).map(|i| term(2 * i)).collect(), (1..=3).map(|i| term(2 * i + 1)).collect()))
            }
            other => Err(self.refused(file, format!("a surface of type {}", shown(other)), supported)),
        }
    }

    /// The surface in mm.
    fn stage(&self, scale: f64, file: &str, notes: &mut Vec<String>) -> Result<Stage> {
        if self.tilted {
            return Err(self.refused(file, "a tilted or decentred surface (SCBD)", "surfaces on one axis"));
        }
        let (even, odd) = self.terms(scale, file)?;
        let mut stage = Stage::plane(self.place.clone());
        (stage.even, stage.odd) = (even, odd);
        (stage.curvature, stage.conic, stage.thickness) = (self.curvature / scale, self.conic, self.thickness * scale);
        stage.stop = self.stop;
        stage.solved = self.focus.then_some(0.0);
        if self.kind == "COORDBRK" {
            return Ok(stage);
        }
        (stage.semi_diameter, stage.computed) = self.apertures.clear(&self.place, file, notes)?;
        (stage.semi_diameter, stage.computed) =
            (stage.semi_diameter.map(|r| r * scale), stage.computed.map(|r| r * scale));
        if let Some((stated, told)) = &self.glass {
            stage.medium = stated.clone();
            if !told.is_empty() {
                notes.push(format!("{}: {told}", self.place));
            }
        }
        Ok(stage)
    }
}

/// Object, surfaces and image of a file.
pub(super) fn put(draft: &mut Draft, surfaces: Vec<Raw>, scale: f64, file: &str) -> Result<()> {
    let [object, middle @ .., image] = &surfaces[..] else {
        let found = format!("{} surfaces", surfaces.len());
        return Err(Error::bad(file, "SURF", found, "an object, at least one surface, an image"));
    };
    if middle.is_empty() {
        return Err(Error::bad(file, "SURF", "2 surfaces", "an object, at least one surface, an image"));
    }
    for (s, what) in [(object, "object"), (image, "image")] {
        if s.curvature != 0.0 || !["STANDARD"].contains(&s.kind.as_str()) {
            return Err(s.refused(file, format!("a curved {what}"), &format!("a plane {what}")));
        }
    }
    // What a mirror brings along (breaks, holes, distances backwards) is not the reason.
    if let Some(s) = middle.iter().find(|s| s.mirror) {
        return Err(s.refused(file, "a mirror (GLAS MIRROR)", "refracting surfaces"));
    }
    draft.object_mm = object.thickness * scale;
    if object.glass.is_some() {
        return Err(object.refused(file, "an object within glass", "an object in air"));
    }
    let mut solved = Vec::new();
    for (i, s) in middle.iter().enumerate() {
        let stage = s.stage(scale, file, &mut draft.notes)?;
        solved.extend(s.solved.iter().map(|what| format!("{what} at {}", s.place)));
        if let Some((place, of, factor)) = &s.pickup {
            let expected = surfaces.get(*of).map(|o| o.curvature * factor);
            if expected.is_none_or(|e| (e - s.curvature).abs() > 1e-6 * s.curvature.abs()) {
                draft
                    .notes
                    .push(format!("{place}: the pickup of SURF {of} does not give this curvature, which is kept"));
            } else {
                solved.push(format!("the curvature at {}", s.place));
            }
        }
        if i + 1 < middle.len() && !stage.thickness.is_finite() {
            return Err(s.refused(file, "an infinite distance", "a finite one behind every surface"));
        }
        draft.surfaces.push(stage);
    }
    if !solved.is_empty() {
        draft.notes.push(format!("solves and pickups are kept as their values: {}", solved.join(", ")));
    }
    Ok(())
}
