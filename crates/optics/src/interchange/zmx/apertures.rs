//! Clear apertures of a Zemax surface.

use crate::interchange::text::Line;
use isoplanat_base::error::{Error, Location, Result};

/// Sizes as a surface states them, in the file's unit.
#[derive(Default)]
pub(super) struct Apertures {
    /// Semi-diameter, and whether the user fixed it.
    semi_diameter: Option<(f64, bool)>,
    /// Least and largest radius of a circular aperture.
    circular: Option<[f64; 2]>,
    /// Half widths of a rectangular or elliptical aperture, and which it is.
    other: Option<([f64; 2], &'static str)>,
    /// Something in the middle or across.
    obscured: Option<&'static str>,
    decentred: bool,
}

impl Apertures {
    /// Takes a keyword; whether it is an aperture's.
    pub(super) fn read(&mut self, keyword: &str, line: &Line) -> Result<bool> {
        match keyword {
            "DIAM" => {
                let (r, kind) = (line.number(0)?.abs(), line.optional(1)?.unwrap_or(0.0));
                self.semi_diameter = Some((r, kind == 1.0));
            }
            "CLAP" => self.circular = Some([line.number(0)?, line.number(1)?]),
            // Clips at the semi-diameter, fixed or not.
            "FLAP" => {}
            "SQAP" => self.other = Some(([line.number(0)?, line.number(1)?], "a rectangular aperture")),
            "ELAP" => self.other = Some(([line.number(0)?, line.number(1)?], "an elliptical aperture")),
            "OBSC" if line.number(1)? > 0.0 => self.obscured = Some("an obscuration"),
            "OBSC" => {}
            "SQOB" | "ELOB" => self.obscured = Some("an obscuration"),
            "SPID" => self.obscured = Some("a spider"),
            "UDAP" | "UDOB" => self.obscured = Some("an aperture of the user's own form"),
            "OBDC" => self.decentred = line.number(0)? != 0.0 || line.number(1)? != 0.0,
            _ => return Ok(false),
        }
        Ok(true)
    }

    /// Fixes the semi-diameter.
    pub(super) fn fix(&mut self, semi_diameter: f64) {
        self.semi_diameter = Some((semi_diameter.abs(), true));
    }

    /// The semi-diameter that is fixed, and the one that the program had computed.
    pub(super) fn clear(
        &self,
        place: &Location,
        file: &str,
        notes: &mut Vec<String>,
    ) -> Result<(Option<f64>, Option<f64>)> {
        let refused = |found: String| Err(Error::bad(file, place, found, "a circular aperture about the axis"));
        if let Some(what) = self.obscured {
            return refused(what.into());
        }
        let positive = |r: f64| Some(r).filter(|r| *r > 0.0);
        let drawn = self.semi_diameter.and_then(|(r, _)| positive(r));
        let fixed = self.semi_diameter.and_then(|(r, fixed)| positive(r).filter(|_| fixed));
        if self.decentred && (self.circular.is_some() || self.other.is_some()) {
            return refused("a decentred aperture".into());
        }
        if let Some([least, most]) = self.circular {
            if least > 0.0 {
                return refused(format!("an annular aperture from {least} to {most}"));
            }
            return Ok((positive(most), drawn));
        }
        if let Some((half, what)) = self.other {
            let within = half[0].min(half[1]);
            if drawn.is_none_or(|r| r > within * (1.0 + 1e-9)) {
                return refused(format!("{what} of {} × {}", half[0], half[1]));
            }
            notes.push(format!("{place}: {what} of {} × {} is wider than the beam and is left out", half[0], half[1]));
        }
        Ok((fixed, drawn))
    }
}
