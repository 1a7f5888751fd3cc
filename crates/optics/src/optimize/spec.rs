//! What to optimise, as a file and a command line say it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::constraint::{Constraint, Quantity, Target};
use super::merit::{Apertures, Merit, Quality, Reference};
use super::pattern::parameters;
use super::problem::Problem;
use super::standard::check_bounds;
use crate::lens::paraxial::first_order;
use crate::lens::{Aperture, Kind, Lens, Parameter};
use isoplanat_base::error::{Error, Result};

/// A number, or its smallest and largest value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "a number, or [LOW, HIGH], either of them inf or -inf where there is none")]
pub enum Range {
    /// Held.
    One(f64),
    /// Bounded; infinite where it is not.
    Two([f64; 2]),
}

impl Range {
    fn bounds(self) -> [f64; 2] {
        match self {
            Self::One(x) => [x, x],
            Self::Two(b) => b,
        }
    }

    /// `12`, `10..12`, `10..` or `..12`.
    ///
    /// # Errors
    /// Anything else; `file` names the argument.
    pub fn parse(text: &str, file: &str) -> Result<Self> {
        let number = |t: &str, none: f64| if t.trim().is_empty() { Ok(none) } else { t.trim().parse::<f64>() };
        let all = match text.split_once("..") {
            Some((a, b)) => number(a, f64::NEG_INFINITY).and_then(|a| Ok(Self::Two([a, number(b, f64::INFINITY)?]))),
            None => text.trim().parse().map(Self::One),
        };
        all.map_err(|_| Error::bad(file, "range", text, "a number, or LOW..HIGH with either left out"))
    }
}

/// What a quantity should be near, and how many mm of rms a unit of deviation counts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wanted {
    /// The value.
    pub value: f64,
    /// mm of rms a unit.
    pub weight: f64,
}

impl Wanted {
    /// `50@0.01`.
    ///
    /// # Errors
    /// Anything else; `file` names the argument.
    pub fn parse(text: &str, file: &str) -> Result<Self> {
        let numbers = text.split_once('@').and_then(|(v, w)| Some((v.trim().parse().ok()?, w.trim().parse().ok()?)));
        let (value, weight) =
            numbers.ok_or_else(|| Error::bad(file, "value", text, "VALUE@WEIGHT, the weight in mm of rms a unit"))?;
        Ok(Self { value, weight })
    }
}

/// The file of `isoplanat optimize --merit`; everything has a default, and what a command line says counts more.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Spec {
    /// Patterns of numbers that move; none: curvatures of refracting surfaces and thicknesses.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub vary: Vec<String>,
    /// Patterns of numbers that do not.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fix: Vec<String>,
    /// Bounds by pattern, in the units of the names (mm, 1/mm, radians). A side without a bound keeps the standard one.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub bounds: BTreeMap<String, Range>,
    /// Constraints by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub constraints: BTreeMap<String, Range>,
    /// Targets by name. A quantity that is a target is not held at its start's value.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub targets: BTreeMap<String, Wanted>,
    /// Shares of the largest field.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fields: Option<Vec<f64>>,
    /// Their weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub field_weights: Option<Vec<f64>>,
    /// Object distances, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depths_mm: Option<Vec<f64>>,
    /// Their weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_weights: Option<Vec<f64>>,
    /// Radii in the stop.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rings: Option<usize>,
    /// Angles in half the stop.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arms: Option<usize>,
    /// `spot` or `wavefront`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub quality: Option<String>,
    /// `centroid` or `chief`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reference: Option<String>,
    /// `stated` or `automatic`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub apertures: Option<String>,
}

/// Relative difference of f-numbers that are the same.
const SAME: f64 = 1e-6;

/// Names of constraints and targets; some stand for many.
const GROUPS: &str = "focal_length, f_number, working_f_number, track, back_focus, distortion, edge_glass, edge_air, slope, reach, surface[i].edge, \
                      surface[i].centre, surface[i].slope, surface[i].reach";

impl Spec {
    /// The focal length that the lens is to have, mm, where one value is held or wanted.
    pub fn focal_length_mm(&self) -> Option<f64> {
        let name = Quantity::FocalLength.name();
        let held = self.constraints.get(&name).map(|range| range.bounds()).filter(|[a, b]| a == b).map(|[f, _]| f);
        held.or_else(|| self.targets.get(&name).map(|t| t.value)).filter(|f| f.is_finite() && *f != 0.0)
    }

    /// From TOML; `file` names it.
    ///
    /// # Errors
    /// What is no such file, with its line.
    pub fn from_toml(text: &str, file: &str) -> Result<Self> {
        isoplanat_base::exact::from_toml(text)
            .map_err(|e| Error::toml(file, text, &e, "the keys of `isoplanat optimize --merit`"))
    }

    /// The problem for `lens`; `file` names where the spec comes from.
    ///
    /// # Errors
    /// Patterns that name nothing, constraints that are none, numbers that are not allowed.
    pub fn problem(&self, lens: &Lens, file: &str) -> Result<Problem> {
        self.problem_varying(lens, Problem::standard(lens).variables.parameters, file)
    }

    /// [`Self::problem`], with `chosen` moving where the spec names nothing that does.
    ///
    /// # Errors
    /// As [`Self::problem`].
    pub fn problem_varying(&self, lens: &Lens, mut chosen: Vec<Parameter>, file: &str) -> Result<Problem> {
        let mut problem = Problem::standard(lens);
        if !self.vary.is_empty() {
            chosen.clear();
            for pattern in &self.vary {
                let more = parameters(lens, pattern, file)?;
                chosen.extend(more.into_iter().filter(|p| !chosen.contains(p)).collect::<Vec<_>>());
            }
        }
        for pattern in &self.fix {
            let fixed = parameters(lens, pattern, file)?;
            chosen.retain(|p| !fixed.contains(p));
        }
        if chosen.is_empty() {
            return Err(Error::bad(file, "fix", self.fix.join(", "), "patterns that leave something to move"));
        }
        let mut constraints = problem.constraints.clone();
        let merit = self.merit(file)?;
        // The cone of light is that of the nearest distance; whoever says what focal length or f-number should be, says what light there is.
        constraints.retain(|c| !matches!(c.quantity, Quantity::WorkingFNumber(_)));
        let says = |name: &str| self.constraints.contains_key(name) || self.targets.contains_key(name);
        if !["focal_length", "f_number", "working_f_number"].into_iter().any(says) {
            let nearest = merit.depths.iter().map(|d| d[0]).reduce(f64::max);
            constraints.extend(Problem::light(lens, nearest.unwrap_or(lens.object_vergence)));
        }
        let mut targets = Vec::new();
        for (name, Wanted { value, weight }) in &self.targets {
            for quantity in quantities(lens, &merit, "target", name, file)? {
                constraints.retain(|c| c.quantity != quantity || c.bounds[0] != c.bounds[1]);
                targets.push(Target { quantity, value: *value, weight: *weight });
            }
        }
        if self.releases_focal_length(lens) {
            constraints.retain(|c| c.quantity != Quantity::FocalLength);
        }
        // What the lens does not have is not held; what is stated is, or is refused below.
        constraints.retain(|c| c.bounds.iter().any(|b| b.is_finite()));
        for (name, range) in &self.constraints {
            for quantity in quantities(lens, &merit, "constraint", name, file)? {
                constraints.retain(|c| c.quantity != quantity);
                constraints.push(Constraint { quantity, bounds: range.bounds() });
            }
        }
        constraints.retain(|c| c.bounds != [f64::NEG_INFINITY, f64::INFINITY]);
        problem = Problem { targets, ..Problem::new(lens, chosen, constraints, merit) };
        for (pattern, range) in &self.bounds {
            let named = parameters(lens, pattern, file)?;
            // Of numbers that are not moved, too.
            check_bounds(file, pattern, range.bounds())?;
            for (p, b) in problem.variables.parameters.iter().zip(&mut problem.bounds) {
                if named.contains(p) {
                    *b = within_standard(range.bounds(), *b);
                }
            }
        }
        problem.check().map_err(|e| e.of_file(file))?;
        Ok(problem)
    }

    /// Whether somebody asked for a constraint of [`Self::problem`], in place of the standard ones.
    #[doc(hidden)]
    pub fn asks_for(&self, problem: &Problem, quantity: Quantity) -> bool {
        let of = |name: &String| quantities(&problem.lens, &problem.merit, "constraint", name, "");
        self.constraints.keys().any(|name| of(name).is_ok_and(|all| all.contains(&quantity)))
    }

    /// Whether another f-number than the lens has is asked for, to which its focal length has to give way: its aperture is stated by another size, which stays.
    fn releases_focal_length(&self, lens: &Lens) -> bool {
        if matches!(lens.aperture, Aperture::FNumber(_))
            || self.constraints.contains_key("focal_length")
            || self.targets.contains_key("focal_length")
        {
            return false;
        }
        let own = first_order(lens, lens.wavelengths.primary_nm).f_number;
        let other = |[low, high]: [f64; 2]| own < low * (1.0 - SAME) || own > high * (1.0 + SAME);
        self.targets.contains_key("f_number") || self.constraints.get("f_number").is_some_and(|r| other(r.bounds()))
    }

    /// What bounds take in that their pattern does not say by name: the distance to the sensor among thicknesses. One line each.
    ///
    /// # Errors
    /// Patterns that name nothing.
    pub fn notes(&self, lens: &Lens, file: &str) -> Result<Vec<String>> {
        let sensor = Kind::Thickness.at(lens.surfaces.len() - 1);
        let name = sensor.name(lens);
        let mut out = Vec::new();
        if self.releases_focal_length(lens) {
            out.push("f_number is asked for, so that focal_length is not held".into());
        }
        for pattern in self.bounds.keys().filter(|p| **p != name) {
            if parameters(lens, pattern, file)?.contains(&sensor) && !self.bounds.contains_key(&name) {
                out.push(format!("the bound on {pattern} takes in {name}, the distance to the sensor"));
            }
        }
        Ok(out)
    }

    /// What is judged; `file` names where the spec comes from.
    ///
    /// # Errors
    /// Words, weights and numbers that make no merit.
    pub fn merit(&self, file: &str) -> Result<Merit> {
        let mut merit = Merit::default();
        let word = |place: &str, found: &Option<String>, words: [&str; 2]| match found.as_deref() {
            None => Ok(false),
            Some(w) if w == words[0] => Ok(false),
            Some(w) if w == words[1] => Ok(true),
            Some(w) => Err(Error::bad(file, place, w, words.join(" or "))),
        };
        if word("quality", &self.quality, ["spot", "wavefront"])? {
            merit.quality = Quality::Wavefront;
        }
        if word("reference", &self.reference, ["centroid", "chief"])? {
            merit.reference = Reference::Chief;
        }
        if word("apertures", &self.apertures, ["stated", "automatic"])? {
            merit.apertures = Apertures::Automatic;
        }
        let weighed = |place: &str, values: &[f64], weights: &Option<Vec<f64>>| {
            let weights = weights.clone().unwrap_or_else(|| vec![1.0; values.len()]);
            if weights.len() != values.len() {
                let found = format!("{} weights for {} values", weights.len(), values.len());
                return Err(Error::bad(file, place, found, "as many weights as values"));
            }
            Ok(values.iter().zip(weights).map(|(v, w)| [*v, w]).collect::<Vec<_>>())
        };
        let own: Vec<f64> = merit.fields.iter().map(|f| f[0]).collect();
        merit.fields = weighed("field_weights", self.fields.as_deref().unwrap_or(&own), &self.field_weights)?;
        if let Some(depths) = &self.depths_mm {
            let vergences: Vec<f64> = depths.iter().map(|d| d.recip()).collect();
            merit.depths = weighed("depth_weights", &vergences, &self.depth_weights)?;
        }
        merit.rings = self.rings.unwrap_or(merit.rings);
        merit.arms = self.arms.unwrap_or(merit.arms);
        merit.check(file)?;
        Ok(merit)
    }
}

/// The bounds `stated`, with the `standard` one on a side where none is stated, unless the other side is beyond it.
fn within_standard([low, high]: [f64; 2], standard: [f64; 2]) -> [f64; 2] {
    let keeps =
        |stated: f64, standard: f64, crosses: bool| if stated.is_infinite() && !crosses { standard } else { stated };
    [keeps(low, standard[0], high < standard[0]), keeps(high, standard[1], low > standard[1])]
}

/// The quantities that a name of a constraint or target (`place`) stands for.
fn quantities(lens: &Lens, merit: &Merit, place: &str, name: &str, file: &str) -> Result<Vec<Quantity>> {
    let n = lens.indices(lens.wavelengths.primary_nm);
    let count = lens.surfaces.len();
    let glass = |i: &usize| n[i + 1] > 1.0;
    let refracts = |i: &usize| n[*i] != n[i + 1];
    let places = 0..count;
    Ok(match name {
        "focal_length" => vec![Quantity::FocalLength],
        "f_number" => vec![Quantity::FNumber],
        "working_f_number" => vec![Quantity::WorkingFNumber(lens.object_vergence)],
        "track" => vec![Quantity::Track],
        "back_focus" => vec![Quantity::BackFocus],
        "edge_glass" => places.take(count - 1).filter(glass).map(Quantity::Edge).collect(),
        "edge_air" => places.take(count - 1).filter(|i| !glass(i)).map(Quantity::Edge).collect(),
        "slope" => places.filter(refracts).map(Quantity::Slope).collect(),
        "reach" => places.filter(refracts).map(Quantity::Reach).collect(),
        "distortion" => {
            let depths = merit.depths.len().max(1);
            let off_axis = |(_, f): &(usize, [f64; 2])| f[0] != 0.0;
            let of = |d: usize| {
                let fields = merit.fields.iter().copied().enumerate().filter(off_axis);
                fields.map(move |(k, _)| Quantity::Distortion(d * merit.fields.len() + k))
            };
            (0..depths).flat_map(of).collect()
        }
        _ => {
            let inner = name.strip_prefix("surface[").and_then(|r| r.split_once("]."));
            let found = inner.and_then(|(i, what)| Some((i.parse::<usize>().ok().filter(|i| *i < count)?, what)));
            match found {
                Some((i, "edge")) if i + 1 < count => vec![Quantity::Edge(i)],
                Some((i, "centre")) => vec![Quantity::Centre(i)],
                Some((i, "slope")) => vec![Quantity::Slope(i)],
                Some((i, "reach")) => vec![Quantity::Reach(i)],
                _ => return Err(Error::bad(file, place, name, GROUPS)),
            }
        }
    })
}

/// The surfaces with glass behind them that patterns of media name: `surface[2].medium`, `surface[*].medium`.
///
/// # Errors
/// A pattern that names no glass.
pub fn glasses(lens: &Lens, pattern: &str, file: &str) -> Result<Vec<usize>> {
    let n = lens.indices(lens.wavelengths.primary_nm);
    let named: Vec<usize> = match pattern.replace("medium", "thickness") {
        p if p == "*" => (0..lens.surfaces.len()).collect(),
        p => parameters(lens, &p, file)?.into_iter().filter(|p| p.kind == Kind::Thickness).map(|p| p.of).collect(),
    };
    let glass: Vec<usize> = named.into_iter().filter(|i| n[i + 1] > 1.0).collect();
    if glass.is_empty() {
        return Err(Error::bad(file, "glass", pattern, "`*` or a pattern such as surface[2].medium that names glass"));
    }
    Ok(glass)
}
