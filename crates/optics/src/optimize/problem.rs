//! What is solved, when to stop, and why the work stopped.

use std::time::Instant;

use super::constraint::{Constraint, Quantity, Target};
use super::merit::{Apertures, Merit};
use crate::lens::clearance::require_clear_axis;
use crate::lens::variables::Variables;
use crate::lens::{Lens, Prescription};
use isoplanat_base::error::Result;

/// Constraints count as kept within this, relative to the bound (or to 1).
pub(super) const KEPT: f64 = 1e-6;

/// Clear semi-diameters that follow the beam are this much wider.
const WIDER: f64 = 1.0 + 1e-3;

/// What is solved.
#[derive(Clone, Debug)]
pub struct Problem {
    /// The lens to start from.
    pub lens: Lens,
    /// What may move.
    pub variables: Variables,
    /// Smallest and largest value of every variable, in the lens's own units.
    pub bounds: Vec<[f64; 2]>,
    /// What is held.
    pub constraints: Vec<Constraint>,
    /// What is wanted without being held.
    pub targets: Vec<Target>,
    /// What is judged.
    pub merit: Merit,
}

impl Problem {
    /// A quantity's name, with the field angle behind it where it is one field's.
    #[doc(hidden)]
    pub fn words(&self, quantity: Quantity) -> String {
        let name = quantity.name();
        let Quantity::Distortion(k) = quantity else { return name };
        let Some([share, _]) = self.merit.fields.get(k) else { return name };
        format!("{name} at {:.2}°", share * self.lens.max_field_deg())
    }

    /// The lens of solved numbers whose beam has these heights, its clear semi-diameters after the beam where they are automatic.
    ///
    /// # Errors
    /// Numbers that are no lens.
    pub(super) fn stands(&self, numbers: &Prescription, heights: &[f64]) -> Result<Lens> {
        let mut numbers = numbers.clone();
        let automatic = self.merit.apertures == Apertures::Automatic;
        for (i, (s, h)) in numbers.surfaces.iter_mut().zip(heights).enumerate() {
            if i != numbers.stop && *h > 0.0 && (automatic || *h > s.semi_diameter) {
                s.semi_diameter = (h * WIDER).min(0.999 * s.shape.reach());
            }
        }
        if automatic {
            // The stop's own surface follows the stop.
            let stop = crate::lens::paraxial::stop_semi_diameter(&numbers);
            if stop.is_finite() && stop > 0.0 {
                numbers.surfaces[numbers.stop].semi_diameter = stop;
            }
        }
        self.made(numbers)
    }

    /// The lens of `numbers`, whose faces do not cross in the light of the axis unless those of the start do.
    ///
    /// # Errors
    /// Numbers that are no lens, or none that can be made.
    pub(super) fn made(&self, numbers: Prescription) -> Result<Lens> {
        let made = Lens::new(numbers, self.lens.file())?;
        if require_clear_axis(&self.lens, self.lens.file()).is_ok() {
            require_clear_axis(&made, &made.name)?;
        }
        Ok(made)
    }
}

/// When to stop at the latest.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Accepted and refused steps.
    pub iterations: usize,
    /// Relative improvement that is not worth another step.
    pub tolerance: f64,
    /// When to stop.
    pub until: Option<Instant>,
}

impl Default for Limits {
    fn default() -> Self {
        Self { iterations: 200, tolerance: 1e-6, until: None }
    }
}

/// Why the work ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum Stop {
    /// No step promises more.
    Converged,
    /// As many steps as were allowed.
    Iterations,
    /// The time is over.
    Time,
    /// The caller said so.
    Asked,
    /// No shorter step helps: rounding, or derivatives that say nothing.
    Stalled,
    /// Constraints contradict each other; the least violation was sought.
    Contradiction,
}

impl Stop {
    /// In words.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Converged => "converged: no step promises more",
            Self::Iterations => "the number of steps allowed is used up",
            Self::Time => "the time is over",
            Self::Asked => "asked to stop: the best lens so far",
            Self::Stalled => "no shorter step helps: the derivatives promise what rays do not keep",
            Self::Contradiction => "the constraints contradict each other: the smallest violation was sought",
        }
    }
}

/// Where the solver is.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// Steps tried.
    pub iteration: usize,
    /// Root of the rays' part of the merit, mm.
    pub rms: f64,
    /// Largest violation, relative.
    pub violation: f64,
}
