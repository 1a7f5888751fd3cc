//! From numbers to a lens that stands on its own, and what is told of it.

use serde::Serialize;

use super::constraint::{Constraint, Target};
use super::problem::{KEPT, Problem, Stop};
use super::solver::{Refused, Solved};
use crate::lens::{Lens, Parameter};
use isoplanat_base::error::{Error, Result};

/// A number that moved.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Moved {
    /// Which.
    #[serde(skip)]
    pub parameter: Parameter,
    /// Its name.
    pub name: String,
    /// In the start.
    pub before: f64,
    /// In the result.
    pub after: f64,
    /// What it may be.
    pub bounds: [f64; 2],
}

/// A bound or a held number, and what it costs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Active {
    /// What is held.
    pub name: String,
    /// Its unit; empty for plain numbers.
    #[serde(skip)]
    pub unit: &'static str,
    /// Its bound.
    pub bound: f64,
    /// Whether that is the upper one.
    pub upper: bool,
    /// How much the root of the merit falls, mm, for each unit that the bound gives way (for equalities: by which the number grows).
    #[serde(rename = "rms_mm_per_unit")]
    pub cost: f64,
}

/// A constraint or a target with its value in the result.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Valued<T> {
    /// Which.
    #[serde(flatten)]
    pub of: T,
    /// Its value.
    pub value: f64,
}

/// What came out.
#[derive(Clone, Debug, Serialize)]
pub struct Outcome {
    /// The best lens.
    #[serde(skip)]
    pub lens: Lens,
    /// Root of the rays' part of the merit before and after, mm. Before: of the start, at the part of aperture and field at which its
    /// rays arrive.
    pub rms_mm: [f64; 2],
    /// Root of the merit after, mm: with what targets add.
    pub merit_mm: f64,
    /// Largest violation of a constraint, relative to its bound or to 1.
    pub violation: f64,
    /// Why the work ended.
    pub stop: Stop,
    /// Part of aperture and field at which all rays arrive: 1 but for lenses that never got there.
    pub share: f64,
    /// Steps tried, rays of each.
    pub iterations: usize,
    /// Rays traced in each.
    pub rays: usize,
    /// Time, s.
    pub seconds: f64,
    /// Every variable.
    pub moved: Vec<Moved>,
    /// Bounds that hold the lens back, the costliest first.
    pub active: Vec<Active>,
    /// Constraints with their values in the result.
    pub held: Vec<Valued<Constraint>>,
    /// Targets with their values in the result.
    pub wanted: Vec<Valued<Target>>,
    /// Better numbers that are no lens.
    pub refused: Option<Refused>,
}

impl Outcome {
    /// Constraints that it does not keep.
    #[doc(hidden)]
    pub fn broken(&self) -> impl Iterator<Item = &Valued<Constraint>> {
        let beyond = |bound: f64, by: f64| bound.is_finite() && by > KEPT * bound.abs().max(1.0);
        self.held.iter().filter(move |h| {
            let [low, high] = h.of.bounds;
            beyond(low, low - h.value) || beyond(high, h.value - high)
        })
    }

    /// Refuses an outcome in which something that is held has no number: nobody can say how far it is from its bound. `file` names where the problem comes from.
    ///
    /// # Errors
    /// As said, with the constraint.
    pub fn require(&self, file: &str) -> Result<()> {
        if self.violation.is_finite() {
            return Ok(());
        }
        let lost = self.held.iter().find(|h| !h.value.is_finite());
        let name = lost.map_or_else(|| "constraints".to_owned(), |h| h.of.quantity.name());
        let found = "no number in the lens that was found";
        Err(Error::bad(file, name, found, "a constraint on what the lens has: without it, or from another start"))
    }
}

pub(super) struct Spent {
    pub(super) iterations: usize,
    pub(super) rays: usize,
    pub(super) reached: f64,
    pub(super) first_rms: Option<f64>,
    pub(super) started: std::time::Instant,
}

fn valued<T: Clone>(all: &[T], values: &[f64]) -> Vec<Valued<T>> {
    all.iter().zip(values).map(|(of, value)| Valued { of: of.clone(), value: *value }).collect()
}

pub(super) fn outcome(problem: &Problem, lens: Lens, solved: Solved, spent: Spent) -> Outcome {
    let variables = &problem.variables;
    let moved = variables.parameters.iter().zip(&problem.bounds).map(|(p, bounds)| Moved {
        parameter: *p,
        name: p.name(&lens),
        before: p.value(&*problem.lens).unwrap_or(0.0),
        after: p.value(&*lens).unwrap_or(0.0),
        bounds: *bounds,
    });
    let moved: Vec<Moved> = moved.collect();
    let merit = solved.merit;
    let mut active: Vec<Active> = Vec::new();
    for m in &solved.multipliers {
        // Half the sum of squares falls by the multiplier a unit; the root of the sum by that over itself.
        let cost = m.value / merit.max(f64::MIN_POSITIVE);
        if let Some(c) = problem.constraints.get(m.of) {
            let bound = c.bounds[usize::from(m.upper)];
            active.push(Active { name: c.quantity.name(), unit: c.quantity.unit(), bound, upper: m.upper, cost });
        } else {
            let j = m.of - problem.constraints.len();
            let bound = problem.bounds[j][usize::from(m.upper)];
            let cost = cost / variables.scales[j];
            active.push(Active { name: moved[j].name.clone(), unit: "", bound, upper: m.upper, cost });
        }
    }
    active.sort_by(|a, b| b.cost.abs().total_cmp(&a.cost.abs()));
    let held = valued(&problem.constraints, &solved.values);
    let wanted = valued(&problem.targets, &solved.wanted);
    let ended = matches!(solved.stop, Stop::Converged | Stop::Stalled) && solved.violation > KEPT;
    let stop = if ended { Stop::Contradiction } else { solved.stop };
    Outcome {
        lens,
        rms_mm: [spent.first_rms.unwrap_or(solved.rms[0]), solved.rms[1]],
        merit_mm: merit,
        violation: solved.violation,
        stop,
        share: spent.reached,
        iterations: spent.iterations,
        rays: spent.rays,
        seconds: spent.started.elapsed().as_secs_f64(),
        moved,
        active,
        held,
        wanted,
        refused: solved.refused,
    }
}
