//! How a lens moves by the gradient of a network's loss: in the metric of its own rays within constraints ([`Descent`]), or by Adam on
//! its numbers, scaled or plain as in the paper, with constraints as penalties.

use serde::{Deserialize, Serialize};

use super::constraint::Constraints;
use isoplanat_base::error::Result;
use isoplanat_optics::lens::variables::Variables;
use isoplanat_optics::lens::{Lens, LensGradient};
use isoplanat_optics::optimize::Problem;
use isoplanat_optics::optimize::descent::{Descent, Linear, Memory};
use isoplanat_optics::trace::rims::require_clear;

/// What a step of the lens is measured by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Steps {
    /// By what it does to rays; the rate is in mm. Constraints are held.
    #[default]
    Rays,
    /// Each number by itself, in units of its size ([`Variables`]); constraints are penalties.
    Scaled,
    /// Each number by itself, in its own unit (mm, 1/mm), as the paper does with conics; constraints are penalties.
    Plain,
}

/// Adam on the lens's variables.
#[derive(Clone, Debug, Default, PartialEq)]
struct Adam {
    first: Vec<f64>,
    second: Vec<f64>,
    steps: u64,
}

impl Adam {
    fn step(&mut self, x: &mut [f64], g: &[f64], rate: f64) {
        const B1: f64 = 0.9;
        const B2: f64 = 0.99;
        self.first.resize(x.len(), 0.0);
        self.second.resize(x.len(), 0.0);
        self.steps += 1;
        let steps = i32::try_from(self.steps).unwrap_or(i32::MAX);
        let (c1, c2) = (1.0 - B1.powi(steps), 1.0 - B2.powi(steps));
        for i in 0..x.len() {
            self.first[i] = B1 * self.first[i] + (1.0 - B1) * g[i];
            self.second[i] = B2 * self.second[i] + (1.0 - B2) * g[i] * g[i];
            x[i] -= rate * (self.first[i] / c1) / ((self.second[i] / c2).sqrt() + 1e-12);
        }
    }
}

/// A step of the lens.
#[derive(Clone, Debug)]
pub struct Stepped {
    /// Where it went; `None` where no lens was found there.
    pub lens: Option<Lens>,
    /// Penalty of constraints before it.
    pub penalty: f64,
    /// How far rays moved, rms, mm, where that is known.
    pub length_mm: f64,
    /// Agreement of the last gradients, 0 to 1, where that is known.
    pub signal: f64,
    /// What held it back.
    pub active: Vec<String>,
}

/// A lens's steps and what they remember.
pub struct LensSteps(Way);

enum Way {
    Rays { descent: Box<Descent>, memory: Memory },
    Adam { variables: Variables, constraints: Constraints, adam: Adam },
}

/// What steps remember, as numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Remembered {
    /// First moments by variable.
    pub first: Vec<f64>,
    /// Second moments by variable; or the one of all, and the part of the rate that steps take.
    pub second: Vec<f64>,
    /// Steps taken.
    pub steps: u64,
}

impl LensSteps {
    /// Steps of `problem`'s variables.
    ///
    /// # Errors
    /// As [`Descent::new`].
    pub fn new(steps: Steps, problem: &Problem) -> Result<Self> {
        let lens = &problem.lens;
        Ok(Self(match steps {
            Steps::Rays => Way::Rays { descent: Box::new(Descent::new(problem)?), memory: Memory::default() },
            Steps::Scaled | Steps::Plain => {
                let mut variables = problem.variables.clone();
                if steps == Steps::Plain {
                    variables.scales.fill(1.0);
                }
                Way::Adam { variables, constraints: Constraints::of(lens), adam: Adam::default() }
            }
        }))
    }

    /// Takes object points over the field of `lens` from now on; what is remembered stays.
    ///
    /// # Errors
    /// A lens through which its rays do not pass; nothing changes then.
    pub(crate) fn look_at(&mut self, lens: &Lens) -> Result<()> {
        if let Way::Rays { descent, .. } = &mut self.0 {
            let problem = Problem { lens: lens.clone(), ..descent.problem().clone() };
            **descent = Descent::new(&problem)?;
        }
        Ok(())
    }

    /// The numbers that move, scaled.
    pub fn variables(&self) -> &Variables {
        match &self.0 {
            Way::Rays { descent, .. } => &descent.problem().variables,
            Way::Adam { variables, .. } => variables,
        }
    }

    /// One step of `lens` against `gradient`, within `more`, which only steps by rays know.
    pub fn step(&mut self, lens: &Lens, mut gradient: LensGradient, rate: f64, more: &[Linear]) -> Stepped {
        match &mut self.0 {
            Way::Rays { descent, memory } => {
                let moved = descent.step(memory, lens, &gradient, rate, more);
                let clear = |l: Lens| require_clear(&l, &l.name).is_ok().then_some(l);
                match moved {
                    Some(m) => Stepped {
                        lens: clear(m.lens),
                        penalty: m.violation,
                        length_mm: m.length_mm,
                        signal: m.signal,
                        active: m.active,
                    },
                    None => Stepped::nowhere(0.0),
                }
            }
            Way::Adam { variables, constraints, adam } => {
                let penalty = constraints.penalty(lens, &mut gradient);
                let g = variables.gradient(&gradient);
                if g.iter().any(|v| !v.is_finite()) {
                    return Stepped::nowhere(penalty);
                }
                let mut x = variables.values(lens);
                adam.step(&mut x, &g, rate);
                let clear = |moved: Lens| require_clear(&moved, &moved.name).map(|_| moved);
                let lens = variables.lens(lens, &x).and_then(clear).ok();
                Stepped { lens, ..Stepped::nowhere(penalty) }
            }
        }
    }

    /// Forgets where gradients pointed: after a lens that failed.
    pub(crate) fn forget(&mut self) {
        match &mut self.0 {
            Way::Rays { memory, .. } => memory.first.fill(0.0),
            Way::Adam { adam, .. } => adam.first.fill(0.0),
        }
    }

    /// What it remembers.
    pub fn remembered(&self) -> Remembered {
        match &self.0 {
            Way::Rays { memory: m, .. } => {
                Remembered { first: m.first.clone(), second: vec![m.second, m.reach], steps: m.steps }
            }
            Way::Adam { adam, .. } => {
                Remembered { first: adam.first.clone(), second: adam.second.clone(), steps: adam.steps }
            }
        }
    }

    /// Goes on with what another of the same kind remembered.
    pub(crate) fn remember(&mut self, r: Remembered) {
        match &mut self.0 {
            Way::Rays { memory, .. } => {
                let second = r.second.first().copied().unwrap_or(0.0);
                let reach = r.second.get(1).copied().unwrap_or(1.0);
                *memory = Memory { first: r.first, second, steps: r.steps, reach };
            }
            Way::Adam { adam, .. } => *adam = Adam { first: r.first, second: r.second, steps: r.steps },
        }
    }
}

impl Stepped {
    fn nowhere(penalty: f64) -> Self {
        Self { lens: None, penalty, length_mm: 0.0, signal: 0.0, active: Vec::new() }
    }
}
