//! Statements about surfaces, and their media.

use std::ops::Range;

use super::{Reader, few};
use crate::interchange::draft::Stage;
use crate::interchange::media::Stated;
use crate::interchange::text::{Line, shown};
use crate::lens::check::MAX_SURFACES;
use crate::lens::model_glass::fictitious;
use isoplanat_base::error::{Location, Result};

/// Decentres and tilts.
const MOVES: [&str; 6] = ["XDE", "YDE", "ZDE", "ADE", "BDE", "CDE"];

/// Refuses a decentre or tilt that is one.
fn unmoved(keyword: &str, line: &Line) -> Result<()> {
    if line.number(0)? == 0.0 {
        return Ok(());
    }
    let found = format!("{keyword} {}", line.words[0]);
    Err(line.refused(found, "surfaces on one axis; tilts and decentres go in a TOML file"))
}

/// What a statement is about.
#[derive(Clone, Debug, PartialEq)]
enum Subject {
    /// Nothing: it stands before the object.
    None,
    Object,
    /// Numbers from 0.
    Surfaces(Range<usize>),
    Image,
    /// A surface that is not there.
    Beyond,
}

impl Reader<'_> {
    /// A statement about the surface that it names (`S2`, `SI`, …), or else the one before it.
    pub(super) fn of_surface(&mut self, keyword: &str, line: &Line) -> Result<()> {
        let named = line.words.first().and_then(|w| self.named(w));
        let words = line.words[usize::from(named.is_some())..].to_vec();
        let rest = &Line { file: line.file, place: line.place.clone(), words };
        let count = self.draft.surfaces.len();
        let place = named.clone().unwrap_or(match count {
            _ if self.image.is_some() => Subject::Image,
            0 if self.object.is_some() => Subject::Object,
            0 => Subject::None,
            _ => Subject::Surfaces(count - 1..count),
        });
        match place {
            Subject::Surfaces(range) => range.into_iter().try_for_each(|i| self.of_one(i, keyword, rest)),
            Subject::Beyond => {
                let found = format!("the surface {}", shown(line.words[0]));
                Err(line.refused(found, format!("S1 to S{count}, which stand before it")))
            }
            Subject::Object if keyword == "THI" => {
                self.object = Some(super::object(length(rest, 0)? * self.scale));
                Ok(())
            }
            Subject::Object if keyword == "GLA" => {
                self.draft.object_medium = self.glass(rest)?;
                Ok(())
            }
            Subject::Image if keyword == "THI" => {
                self.image = Some(rest.number(0)? * self.scale);
                Ok(())
            }
            Subject::Image if keyword == "PIM" && count > 0 => self.of_one(count - 1, keyword, rest),
            // A plane needs none of them.
            Subject::Object | Subject::Image if ["CIR", "REX", "REY", "STO", "RMD"].contains(&keyword) => Ok(()),
            Subject::Image if ["CUY", "RDY", "K", "CON", "ASP"].contains(&keyword) => {
                let form = &mut self.draft.image;
                match keyword {
                    "CUY" => form.curvature = rest.number(0)? / self.scale,
                    "RDY" => form.curvature = curvature(length(rest, 0)?, true) / self.scale,
                    "K" => form.conic = rest.number(0)?,
                    _ => {}
                }
                self.unsaid.retain(|(of, _)| *of != count || !["CUY", "RDY"].contains(&keyword));
                Ok(())
            }
            Subject::Image if keyword.len() == 1 && "ABCDEFGHJ".contains(keyword) => {
                if rest.number(0)? != 0.0 && !self.image_terms {
                    self.image_terms = true;
                    let told = format!("{}: terms of the image's form beyond its conic are left out", line.place);
                    self.draft.notes.push(told);
                }
                Ok(())
            }
            Subject::Object | Subject::Image if MOVES.contains(&keyword) => unmoved(keyword, rest),
            Subject::Object if ["CUY", "RDY"].contains(&keyword) => {
                if rest.number(0)? == 0.0 {
                    return Ok(());
                }
                Err(line.refused("a curved object", "a plane one"))
            }
            Subject::Object | Subject::Image if named.is_some() => Err(rest.refused(
                format!("the statement `{}` of the object or the image", shown(keyword)),
                "THI, and apertures, of them, GLA of the object, CUY, RDY and K of the image",
            )),
            Subject::Object | Subject::Image | Subject::None => self.read_over(keyword, line),
        }
    }

    /// The medium that `GLA` names.
    fn glass(&self, line: &Line) -> Result<Stated> {
        let name = line.words.first().ok_or_else(|| line.refused("no glass", "its name"))?;
        Ok(self.medium(name))
    }

    /// What `S2`, `S2..4`, `SA`, `SO`, `SI`, `SI-1` and `SS` name; `None` for another word.
    fn named(&self, word: &str) -> Option<Subject> {
        let word = word.to_ascii_uppercase();
        let rest = word.strip_prefix('S')?;
        let count = self.draft.surfaces.len();
        let number = |text: &str| -> Option<usize> {
            match text.strip_prefix('I') {
                Some("") => Some(count + 1),
                Some(back) => (count + 1).checked_sub(back.strip_prefix('-')?.parse().ok()?),
                None => match text {
                    "O" => Some(0),
                    "S" => Some(1 + self.draft.surfaces.iter().position(|s| s.stop)?),
                    _ => text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse().ok())?,
                },
            }
        };
        if rest == "A" {
            return Some(Subject::Surfaces(0..count));
        }
        let (from, to) = match rest.split_once("..") {
            Some((from, to)) => (number(from)?, number(to.trim_start_matches('S'))?),
            None => (number(rest)?, number(rest)?),
        };
        Some(match (from, to) {
            (0, 0) => Subject::Object,
            _ if from == count + 1 && to == from && self.image.is_some() => Subject::Image,
            _ if 1 <= from && from <= to && to <= count => Subject::Surfaces(from - 1..to),
            _ => Subject::Beyond,
        })
    }

    /// A statement about the surface `i`.
    fn of_one(&mut self, i: usize, keyword: &str, line: &Line) -> Result<()> {
        let unit = self.scale;
        if keyword == "GLA" {
            self.draft.surfaces[i].medium = self.glass(line)?;
            return Ok(());
        }
        if keyword == "PIM" {
            let off = line.words.first().is_some_and(|w| ["N", "NO"].iter().any(|n| w.eq_ignore_ascii_case(n)));
            self.focus = (!off).then_some(i);
            return Ok(());
        }
        // A solve stands in the place of a distance: `THI S2 PIM`. What it gives stands with the surface.
        let solve = line.words.first().map(|w| w.to_ascii_uppercase()).filter(|_| keyword == "THI");
        match solve.as_deref() {
            Some("PIM" | "HMY") => {
                let rest = Line { file: line.file, place: line.place.clone(), words: line.words[1..].to_vec() };
                return self.of_one(i, solve.as_deref().unwrap_or_default(), &rest);
            }
            Some(solve) if solve == "OAL" || super::SOLVES.contains(&solve) => {
                self.solved.push(format!("THI {solve} ({})", line.place));
                return Ok(());
            }
            _ => {}
        }
        if keyword == "STO" {
            // The last one said is it.
            self.draft.surfaces.iter_mut().for_each(|s| s.stop = false);
        }
        if ["CUY", "RDY"].contains(&keyword) {
            self.unsaid.retain(|(of, _)| *of != i);
        }
        let stage = &mut self.draft.surfaces[i];
        // Coefficients of the asphere: A is the term in r⁴.
        let order = "ABCDEFGHJ".find(keyword).filter(|_| keyword.len() == 1);
        if let Some(order) = order {
            let power = 2 * order + 4;
            if stage.shape.asphere.len() < order + 2 {
                stage.shape.asphere.resize(order + 2, 0.0);
            }
            stage.shape.asphere[order + 1] = line.number(0)? * unit.powi(1 - i32::try_from(power).unwrap_or(0));
            return Ok(());
        }
        match keyword {
            "STO" => stage.stop = true,
            "ASP" | "CON" => {}
            "CUF" if line.number(0)? == 0.0 => {}
            "CUF" => return Err(line.refused("a Fresnel surface (CUF)", "surfaces without steps")),
            "HMY" if line.optional(0)?.unwrap_or(0.0) == 0.0 => stage.solved = Some(0.0),
            "HMY" => self.solved.push(format!("HMY ({})", line.place)),
            "K" => stage.shape.conic = line.number(0)?,
            "CUY" => stage.shape.curvature = line.number(0)? / unit,
            "RDY" => stage.shape.curvature = curvature(length(line, 0)?, true) / unit,
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
            _ if MOVES.contains(&keyword) => unmoved(keyword, line)?,
            "DAR" | "BEN" | "RET" | "REV" => {
                // Without an amount they break nothing.
            }
            "REX" | "REY" | "ELX" | "ELY" => {
                return Err(line.refused(
                    format!("a rectangular or elliptical aperture ({keyword})"),
                    "a circular aperture (CIR)",
                ));
            }
            _ => {
                let found = format!("the statement `{}`", shown(keyword));
                let allowed = "with a surface, whose shape or medium it may be: a statement that this reader knows";
                return Err(line.refused(found, allowed));
            }
        }
        Ok(())
    }

    /// The statement `S`.
    pub(super) fn surface(&mut self, line: &Line) -> Result<()> {
        if self.image.is_some() || self.draft.surfaces.len() >= MAX_SURFACES {
            let found = format!("surface {} here", self.draft.surfaces.len() + 1);
            return Err(line.refused(found, format!("at most {MAX_SURFACES} surfaces, before SI")));
        }
        let mut stage =
            Stage::plane(Location { label: format!("S {}", self.draft.surfaces.len() + 1), ..line.place.clone() });
        let number = length(line, 0)?;
        if self.radii == Some(false) && number.is_infinite() {
            return Err(line.refused("an infinite curvature", "a finite one; `RDM` states radii"));
        }
        if self.radii.is_none() && number != 0.0 && number.is_finite() {
            self.unsaid.push((self.draft.surfaces.len(), number));
        }
        // Without RDM numbers are curvatures; an infinite one is a plane's radius.
        stage.shape.curvature = curvature(number, self.radii == Some(true) || number.is_infinite()) / self.scale;
        stage.thickness = line.number(1)? * self.scale;
        stage.medium = self.medium_behind(line)?;
        self.draft.surfaces.push(stage);
        Ok(())
    }

    /// The medium behind curvature and distance on the line of a surface or of the object.
    pub(super) fn medium_behind(&self, line: &Line) -> Result<Stated> {
        let Some(name) = line.words.get(2) else { return Ok(Stated::Air) };
        if name.eq_ignore_ascii_case("REFL") || line.words.get(3).is_some_and(|w| w.eq_ignore_ascii_case("REFL")) {
            return Err(line.refused("a mirror (REFL)", "refracting surfaces"));
        }
        // Index and Abbe number in the glass's place.
        let number = |i: usize| line.words.get(i).and_then(|w| w.parse::<f64>().ok());
        Ok(match (number(2), number(3)) {
            (Some(n_d), Some(v_d)) if (1.0..=5.0).contains(&n_d) => Stated::Lines { n_d, v_d },
            _ => self.medium(name),
        })
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

    /// A statement between `PRV` and `END`.
    pub(super) fn private_glass(&mut self, keyword: &str, name: &str, line: &Line) -> Result<()> {
        match keyword {
            "END" => self.private = None,
            "PWL" => self.private = Some(few(line)?),
            _ => {
                let wavelengths = self.private.clone().unwrap_or_default();
                // A formula's letters stand before its coefficients: such a glass is refused where a surface names it.
                if let Some(formula) = line.words.first().filter(|w| w.chars().all(|c| c.is_ascii_alphabetic())) {
                    let name = name.trim_matches('\'');
                    self.draft.notes.push(format!(
                        "private glass {}: the formula {} is not read",
                        shown(name),
                        shown(formula)
                    ));
                    self.glasses.push((name.to_owned(), Stated::Glass(format!("PRIVATE/{name}"))));
                    return Ok(());
                }
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
}

/// The curvature that a number of a surface states.
pub(super) fn curvature(number: f64, radius: bool) -> f64 {
    if !radius || number == 0.0 { number } else { 1.0 / number }
}

/// A length, which may be infinite.
pub(super) fn length(line: &Line, i: usize) -> Result<f64> {
    let word = line.words.get(i).copied().unwrap_or("");
    let plain = word.trim_start_matches(['+', '-']);
    if ["inf", "infinity"].iter().any(|w| plain.eq_ignore_ascii_case(w)) {
        return Ok(if word.starts_with('-') { f64::NEG_INFINITY } else { f64::INFINITY });
    }
    line.number(i)
}
