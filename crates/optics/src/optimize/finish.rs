//! From numbers to a lens that stands on its own, and what is told of it.

use super::constraint::{Quantity, Target};
use super::problem::{KEPT, Problem, Stop};
use super::solver::Solved;
use crate::lens::{Lens, Parameter};
use isoplanat_base::error::{Error, Result};

/// A number that moved.
#[derive(Clone, Debug, PartialEq)]
pub struct Moved {
    /// Which.
    pub parameter: Parameter,
    /// Its name.
    pub name: String,
    /// Before and after.
    pub values: [f64; 2],
    /// What it may be.
    pub bounds: [f64; 2],
}

/// A bound or a held number, and what it costs.
#[derive(Clone, Debug, PartialEq)]
pub struct Active {
    /// What is held.
    pub name: String,
    /// Its unit; empty for plain numbers.
    pub unit: &'static str,
    /// Its bound.
    pub bound: f64,
    /// Whether that is the upper one.
    pub upper: bool,
    /// How much the root of the merit falls, mm, for each unit that the bound gives way (for equalities: by which the number grows).
    pub cost: f64,
}

/// What came out.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The best lens.
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
    pub held: Vec<(Quantity, [f64; 2], f64)>,
    /// Targets with their values in the result.
    pub wanted: Vec<(Target, f64)>,
    /// Root of the merit, mm, of better numbers that are no lens, and why they are none.
    pub refused: Option<(f64, String)>,
}

impl Outcome {
    /// Constraints that it does not keep: quantity, bounds and value.
    #[doc(hidden)]
    pub fn broken(&self) -> impl Iterator<Item = &(Quantity, [f64; 2], f64)> {
        let beyond = |bound: f64, by: f64| bound.is_finite() && by > KEPT * bound.abs().max(1.0);
        self.held.iter().filter(move |(_, [low, high], value)| beyond(*low, low - value) || beyond(*high, value - high))
    }

    /// Refuses an outcome in which something that is held has no number: nobody can say how far it is from its bound. `file` names where the problem comes from.
    ///
    /// # Errors
    /// As said, with the constraint.
    pub fn require(&self, file: &str) -> Result<()> {
        if self.violation.is_finite() {
            return Ok(());
        }
        let lost = self.held.iter().find(|(_, _, value)| !value.is_finite());
        let name = lost.map_or_else(|| "constraints".to_owned(), |(quantity, _, _)| quantity.name());
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

pub(super) fn outcome(problem: &Problem, lens: Lens, solved: Solved, spent: Spent) -> Outcome {
    let variables = &problem.variables;
    let moved = variables.parameters.iter().zip(&problem.bounds).map(|(p, bounds)| Moved {
        parameter: *p,
        name: p.name(&lens),
        values: [p.value(&*problem.lens).unwrap_or(0.0), p.value(&*lens).unwrap_or(0.0)],
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
    let held = problem.constraints.iter().zip(&solved.values).map(|(c, v)| (c.quantity, c.bounds, *v)).collect();
    let wanted = problem.targets.iter().cloned().zip(solved.wanted.iter().copied()).collect();
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
        refused: solved.refused.map(|r| (r.merit, r.why)),
    }
}
