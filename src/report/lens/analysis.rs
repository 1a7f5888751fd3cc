//! One analysis of a lens's rays by itself: what `mtf`, `spot` and `distortion` are, as a command and in Python.

use std::ops::RangeInclusive;

use serde::Serialize;
use serde_json::Value;

use super::{Options, SHIFTS, SpotRow, arrays, look, plots, plots_json, spot_rows};
use crate::report::plot::Plot;
use isoplanat_base::math::memory::Limit;
use isoplanat_optics::analysis::overview::Overview;
use isoplanat_optics::lens::Lens;

/// Which analysis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Analysis {
    /// MTF of rays and by diffraction against frequency, field and focus.
    Mtf,
    /// Spots by field.
    Spot,
    /// Distortion over the field.
    Distortion,
}

/// Frequencies that may be asked for.
const MOST_FREQUENCIES: f64 = 100.0;

/// What a look at a lens's rays can be told, unchecked.
#[derive(Clone, Debug, PartialEq)]
pub struct Asked {
    /// Rays of a spot and wavelength.
    pub rays: usize,
    /// As [`Options::fields_deg`], in any order.
    pub fields_deg: Vec<f64>,
    /// As [`Options::max_angle_deg`].
    pub max_angle_deg: Option<f64>,
    /// As [`Options::cycles_per_mm`].
    pub max_cycles_per_mm: Option<f64>,
    /// As [`Options::asked_cycles_per_mm`], in any order.
    pub cycles_per_mm: Vec<f64>,
    /// As [`Options::shift_mm`].
    pub shift_mm: Option<f64>,
}

/// A value that is not allowed: what it is of, the value, what is allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refused {
    /// Its name: that of the field of [`Asked`].
    pub name: &'static str,
    /// The value.
    pub found: f64,
    /// What is allowed.
    pub allowed: &'static str,
}

impl Asked {
    /// The checked options of everything that is made of rays; kernels are grey.
    ///
    /// # Errors
    /// The first value that is not allowed.
    pub fn options(self, memory: Limit) -> Result<Options, Refused> {
        let Self { rays, mut fields_deg, max_angle_deg, max_cycles_per_mm, mut cycles_per_mm, shift_mm } = self;
        cycles_per_mm
            .iter()
            .try_for_each(|f| within("cycles_per_mm", Some(*f), 0.0..=1e5, "0 to 100000").map(|_| ()))?;
        #[expect(clippy::cast_precision_loss, reason = "a count that is refused where it is large")]
        let count = cycles_per_mm.len() as f64;
        within("cycles_per_mm", Some(count), 0.0..=MOST_FREQUENCIES, "up to 100 frequencies")?;
        cycles_per_mm.sort_by(f64::total_cmp);
        cycles_per_mm.dedup();
        fields_deg
            .iter()
            .try_for_each(|f| within("fields_deg", Some(*f), 0.0..=120.0, "0 to 120 degrees").map(|_| ()))?;
        if let (Some(found), false) = (max_angle_deg, fields_deg.is_empty()) {
            return Err(Refused { name: "max_angle_deg", found, allowed: "either it or fields_deg" });
        }
        fields_deg.sort_by(f64::total_cmp);
        fields_deg.dedup();
        #[expect(clippy::cast_precision_loss, reason = "a count that is refused where it is large")]
        within("rays", Some(rays as f64), 16.0..=1e6, "16 to 1000000")?;
        Ok(Options {
            rays,
            fields_deg,
            max_angle_deg: within("max_angle_deg", max_angle_deg, 0.0..=120.0, "0 to 120 degrees")?,
            cycles_per_mm: within("max_cycles_per_mm", max_cycles_per_mm, 1e-3..=1e5, "0.001 to 100000")?,
            asked_cycles_per_mm: cycles_per_mm,
            shift_mm: within("shift_mm", shift_mm, 1e-6..=1e3, "1e-6 to 1000 mm")?,
            shifts: SHIFTS,
            spots: true,
            whole: true,
            energy: true,
            colour: false,
            psf_depths_mm: Vec::new(),
            memory,
        })
    }
}

fn within(
    name: &'static str,
    value: Option<f64>,
    range: RangeInclusive<f64>,
    allowed: &'static str,
) -> Result<Option<f64>, Refused> {
    match value {
        Some(found) if !range.contains(&found) => Err(Refused { name, found, allowed }),
        _ => Ok(value),
    }
}

/// What an analysis found: for whoever goes on with it, and for machines.
#[derive(Debug)]
pub struct Found {
    /// The lens as it was looked at.
    pub overview: Overview,
    /// Its curves under their names.
    pub curves: Vec<(&'static str, Plot)>,
    /// What could not be shown, a sentence each.
    pub missing: Vec<String>,
}

/// [`Found`] for machines.
#[derive(Debug, Serialize)]
pub struct Shown {
    #[serde(skip_serializing_if = "Vec::is_empty")]
    fields: Vec<SpotRow>,
    plots: Value,
    missing: Vec<String>,
}

impl Analysis {
    /// Its command.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mtf => "mtf",
            Self::Spot => "spot",
            Self::Distortion => "distortion",
        }
    }

    /// Looks at `lens`. Spots need no maps and no MTF by diffraction, distortion chief rays alone: the rest is left out.
    pub fn of(self, lens: &Lens, options: &Options) -> Found {
        let (whole, energy, spots) = (self == Self::Mtf, self == Self::Spot, self != Self::Distortion);
        let fields_deg = if spots { options.fields_deg.clone() } else { Vec::new() };
        let (overview, missing) = look(lens, &Options { fields_deg, spots, whole, energy, ..options.clone() });
        let curves = plots(&overview).into_iter().filter(|(name, _)| self.shows(name)).collect();
        Found { overview, curves, missing }
    }

    /// Whether the plot `name` belongs to it.
    fn shows(self, name: &str) -> bool {
        match self {
            Self::Mtf => name.starts_with("mtf"),
            Self::Spot => ["rms_focus", "encircled_energy"].contains(&name),
            Self::Distortion => name == "distortion",
        }
    }

    /// Its numbers as arrays under their names.
    pub fn arrays(self, overview: &Overview) -> arrays::Arrays {
        match self {
            Self::Mtf => arrays::mtf(overview),
            Self::Spot => arrays::spot(overview),
            Self::Distortion => arrays::distortion(overview),
        }
    }
}

impl Found {
    /// For machines.
    pub fn shown(&self) -> Shown {
        Shown { fields: spot_rows(&self.overview), plots: plots_json(&self.curves), missing: self.missing.clone() }
    }
}
