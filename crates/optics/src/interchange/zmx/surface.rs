//! Surfaces of a Zemax file.

use super::apertures::Apertures;
use super::order::Order;
use super::shapes;
use crate::interchange::draft::{Draft, Stage};
use crate::interchange::line_glass::OfLine;
use crate::interchange::media::Stated;
use crate::interchange::text::{Line, Once, shown};
use crate::lens::ImageSurface;
use isoplanat_base::error::{Error, Location, Result};

/// Keywords of a surface that no ray depends on.
const HARMLESS: [&str; 25] = [
    "SSID", "FIMP", "HIDE", "MIRR", "SLAB", "MEMA", "POPS", "TRCX", "TRCY", "COAT", "COMM", "VDSZ", "SCOL", "SDRW",
    "CCOL", "DRAW", "RSCE", "SCAT", "OPDX", "PPAR", "TCEX", "PUPD", "LOCA", "VPAR", "TCED",
];
/// Keywords by which a thickness follows from something else; its value stands in DISZ.
const SOLVES: [&str; 12] =
    ["MAZH", "CHZH", "PZUP", "EDGT", "OPDZ", "POSI", "COMP", "CNTR", "PUPZ", "TTHI", "EDGE", "ZPLM"];
/// What a surface has once, beside its parameters by their numbers.
const ONCE: [&str; 5] = ["TYPE", "CURV", "CONI", "DISZ", "GLAS"];
/// Distances from here on are infinite, in any unit.
const INFINITE: f64 = 1e10;
/// Parameters that a surface's type has at most.
const PARAMETERS: usize = 300;

/// A surface as it is being read; lengths in the file's unit.
pub(super) struct Raw {
    place: Location,
    kind: String,
    curvature: f64,
    conic: f64,
    parameters: Vec<f64>,
    /// More data than the parameters, as their numbers.
    extra: Vec<f64>,
    thickness: f64,
    glass: Option<(Stated, String)>,
    stop: bool,
    tilted: bool,
    /// Whether the next surface stands at the paraxial image.
    focus: bool,
    pickup: Option<(Location, usize, f64)>,
    solved: Vec<String>,
    apertures: Apertures,
    stated: Once,
}

impl Raw {
    pub(super) fn new(place: Location) -> Self {
        Self {
            place,
            kind: "STANDARD".into(),
            curvature: 0.0,
            conic: 0.0,
            parameters: Vec::new(),
            extra: Vec::new(),
            thickness: 0.0,
            glass: None,
            stop: false,
            tilted: false,
            focus: false,
            pickup: None,
            solved: Vec::new(),
            apertures: Apertures::default(),
            stated: Once::default(),
        }
    }

    /// Where it begins.
    pub(super) fn place(&self) -> &Location {
        &self.place
    }

    /// Takes a keyword; whether it is a surface's.
    pub(super) fn read(&mut self, keyword: &str, line: &Line) -> Result<bool> {
        if ONCE.contains(&keyword) {
            self.stated.take(keyword, 0, line)?;
        }
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
                self.stated.take(&format!("PARM {i}"), 1, line)?;
                if self.parameters.len() <= i {
                    self.parameters.resize(i + 1, 0.0);
                }
                self.parameters[i] = line.number(1)?;
            }
            "XDAT" => {
                let i = line.count(0, PARAMETERS)?;
                self.stated.take(&format!("XDAT {i}"), 1, line)?;
                if self.extra.len() <= i {
                    self.extra.resize(i + 1, 0.0);
                }
                self.extra[i] = line.optional(1)?.unwrap_or(0.0);
            }
            "DISZ" => self.thickness = distance(line)?,
            "GLAS" => self.medium(line)?,
            "IGNR" if line.optional(0)?.is_some_and(|on| on != 0.0) => {
                return Err(line.refused("a surface that is to be ignored", "IGNR 0, or a file without that surface"));
            }
            "IGNR" => {}
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
        let name = name.trim_matches('"');
        let kind = line.optional(1)?.unwrap_or(0.0);
        let mut mirror = name == "MIRROR";
        // Some files write a mirror as a model glass of the index −1.
        if kind == 1.0 && line.optional(3).ok().flatten().is_some_and(|n| n < 0.0) {
            mirror = true;
        }
        if mirror {
            // What a mirror brings along (breaks, holes, distances backwards) is not the reason.
            return Err(
                line.refused(format!("a mirror (GLAS {})", shown(&line.words.join(" "))), "refracting surfaces")
            );
        }
        // 1: a model glass, whose numbers follow; 4: a glass with offsets of them.
        let model = kind == 1.0 || name == "___BLANK";
        let stated = if model {
            Stated::Lines { n_d: line.number(3)?, v_d: line.optional(4)?.unwrap_or(0.0) }
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

    /// Takes the value of a configuration's operand.
    pub(super) fn set(&mut self, operand: &str, line: &Line) -> Result<()> {
        match operand {
            "THIC" => self.thickness = distance(line)?,
            "CRVT" | "CURV" => (self.curvature, self.pickup) = (line.number(0)?, None),
            "CONN" | "CONI" => self.conic = line.number(0)?,
            "SDIA" => self.apertures.fix(line.number(0)?),
            "GLSS" => {
                self.glass = None;
                if !["AIR", "-", "0", ""].contains(&line.words[0].trim_matches('"')) {
                    self.medium(line)?;
                }
            }
            parameter => {
                let i = parameter.trim_start_matches("PAR").parse::<usize>().ok().filter(|i| *i <= PARAMETERS);
                let i = i.ok_or_else(|| line.refused(format!("`{}`", shown(parameter)), "an operand of a surface"))?;
                if self.parameters.len() <= i {
                    self.parameters.resize(i + 1, 0.0);
                }
                self.parameters[i] = line.number(0)?;
            }
        }
        Ok(())
    }

    /// Makes it the stop, or not.
    pub(super) fn set_stop(&mut self, stop: bool) {
        self.stop = stop;
    }

    fn refused(&self, file: &str, found: impl Into<String>, allowed: &str) -> Error {
        Error::bad(file, &self.place, found, allowed)
    }

    /// Even and odd terms, in mm.
    fn shape(&self, scale: f64, file: &str) -> Result<(Vec<f64>, Vec<f64>)> {
        let refuse = |found: String, allowed: &str| self.refused(file, found, allowed);
        shapes::Terms { kind: &self.kind, parameters: &self.parameters, extra: &self.extra }.in_mm(scale, refuse)
    }

    /// Focal length of an ideal lens, mm.
    fn ideal(&self, scale: f64, file: &str) -> Result<Option<f64>> {
        if self.kind != shapes::IDEAL {
            return Ok(None);
        }
        let f = self.parameters.get(1).map_or(0.0, |f| f * scale);
        if f == 0.0 || !f.is_finite() {
            let found = format!("a focal length of {f} mm (PARM 1 of a surface of type PARAXIAL)");
            return Err(self.refused(file, found, "a length other than 0"));
        }
        Ok(Some(f))
    }

    /// Whether it is no plane.
    fn is_curved(&self) -> bool {
        self.curvature != 0.0 || self.has_terms()
    }

    /// Whether its type's parameters are used.
    fn has_terms(&self) -> bool {
        self.parameters.iter().chain(self.extra.iter().skip(3)).any(|p| *p != 0.0)
    }

    /// The surface in mm.
    fn stage(&self, scale: f64, file: &str, notes: &mut Vec<String>) -> Result<Stage> {
        if self.tilted {
            return Err(self.refused(file, "a tilted or decentred surface (SCBD)", "surfaces on one axis"));
        }
        let (even, odd) = self.shape(scale, file)?;
        let mut stage = Stage::plane(self.place.clone());
        (stage.shape.asphere, stage.shape.odd) = (even, odd);
        (stage.shape.curvature, stage.shape.conic, stage.thickness) =
            (self.curvature / scale, self.conic, self.thickness * scale);
        stage.stop = self.stop;
        stage.solved = self.focus.then_some(0.0);
        if self.kind == "COORDBRK" {
            return Ok(stage);
        }
        stage.shape.ideal = self.ideal(scale, file)?;
        if let Some(f) = stage.shape.ideal {
            // Its plane has no form, whatever stands there.
            (stage.shape.curvature, stage.shape.conic) = (0.0, 0.0);
            notes.push(format!(
                "{}: an ideal lens of {f} mm; optical paths through it are those between its paraxial object and image",
                self.place
            ));
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

/// A distance along the axis.
fn distance(line: &Line) -> Result<f64> {
    let word = line.words.first().copied().unwrap_or("");
    let infinite = ["INFINITY", "INF", "1E+10", "1.0E+10"].iter().any(|w| word.eq_ignore_ascii_case(w));
    if infinite {
        return Ok(f64::INFINITY);
    }
    let distance = line.number(0)?;
    // The number that the program itself writes for it.
    Ok(if distance >= INFINITE { f64::INFINITY } else { distance })
}

/// Object, surfaces and image of a file.
pub(super) fn put(draft: &mut Draft, mut surfaces: Vec<Raw>, order: &Order, scale: f64, file: &str) -> Result<()> {
    if order.starts_at_one() {
        surfaces.insert(0, Raw { thickness: f64::INFINITY, ..Raw::new(Location::called("the object")) });
        // The last distance reaches the image plane, which some of these files name and others do not.
        if surfaces.last().is_some_and(|s| s.thickness != 0.0 || s.glass.is_some() || s.is_curved()) {
            surfaces.push(Raw::new(Location::called("the image")));
        }
    }
    let [object, middle @ .., image] = &surfaces[..] else {
        let found = format!("{} surfaces", surfaces.len());
        return Err(Error::bad(file, "SURF", found, "an object, at least one surface, an image"));
    };
    if middle.is_empty() {
        return Err(Error::bad(file, "SURF", "2 surfaces", "an object, at least one surface, an image"));
    }
    for (s, what) in [(object, "object"), (image, "image")] {
        s.shape(scale, file)?;
        if s.kind == "COORDBRK" || s.tilted {
            return Err(s.refused(file, format!("a tilted {what}"), &format!("the {what} on the axis")));
        }
    }
    if object.is_curved() {
        let radius = if object.curvature == 0.0 {
            "an aspheric form".into()
        } else {
            format!("a radius of {} mm", scale / object.curvature)
        };
        let place = &object.place;
        draft.notes.push(format!(
            "{place}: the object is curved, with {radius}: object points are taken on the plane through its vertex"
        ));
    }
    let form = ImageSurface { curvature: image.curvature / scale, conic: image.conic };
    draft.curve_image(&image.place, if form.is_plane() { ImageSurface::default() } else { form });
    if image.has_terms() {
        let place = &image.place;
        draft.notes.push(format!("{place}: terms of the image's form beyond its conic are left out"));
    }
    draft.object_mm = object.thickness * scale;
    if let Some((stated, told)) = &object.glass {
        draft.object_medium = stated.clone();
        draft.object_at = object.place.clone();
        if !told.is_empty() {
            draft.notes.push(format!("{}: {told}", object.place));
        }
    }
    let mut solved = Vec::new();
    for (i, s) in middle.iter().enumerate() {
        let stage = s.stage(scale, file, &mut draft.notes)?;
        solved.extend(s.solved.iter().map(|what| format!("{what} at {}", s.place)));
        if let Some((place, of, factor)) = &s.pickup {
            let picked = order.position(*of).and_then(|at| surfaces.get(at + usize::from(order.starts_at_one())));
            let expected = picked.map(|o| o.curvature * factor);
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
