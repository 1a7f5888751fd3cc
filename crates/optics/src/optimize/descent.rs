//! A lens that moves by gradients from elsewhere (a network's loss), within a problem's bounds and constraints.
//!
//! Steps are measured by what they do to rays. With `J` the Jacobian of the merit's residuals (landings about their centroid, mm) and
//! `H = JᵀJ + λ diag JᵀJ`, `√(dᵀHd)` is the rms distance by which a step `d` moves rays. A gradient `g` asks for
//! `min ĝᵀd + ½ (√v/ρ) dᵀHd`, whose free solution is `−ρ H⁻¹ĝ/√v`: `ĝ` is the mean of the last gradients and `v` that of `gᵀH⁻¹g`, so
//! steps have the length `ρ` while gradients agree and shrink with their ratio of signal to noise where they do not: Adam (Kingma and Ba,
//! 2015) with one second moment for all numbers, in the metric of rays. Numbers that rays hardly feel move further, those they feel
//! strongly less, whatever their units.
//!
//! Constraints are rows of the same quadratic program, as in [`super::optimize`]; what they do beyond first order is taken into account
//! before rays are traced, and a step is halved until all rays of the merit arrive and the numbers are a lens.

use nalgebra::{DMatrix, DVector};

use super::merit::Apertures;
use super::problem::{KEPT, Problem};
use super::quadratic::Row;
use super::solver::{Kept, Point, Solver, program};
use crate::lens::{Lens, LensGradient};
use isoplanat_base::error::{Error, Result};

/// `λ`: directions that rays feel less than this are held by the sizes of the numbers themselves.
const DAMPING: f64 = 1e-2;
/// How long gradients and their squares are remembered.
const FIRST: f64 = 0.9;
const SECOND: f64 = 0.99;
/// A step that constraints ask for is at most so many times as long as the rate.
const LONGEST: f64 = 10.0;
/// Violations up to this, relative to the bound or to 1, are left to the next step: rims move with the beam, rows do not know.
const HARDLY: f64 = 1e3 * KEPT;
/// Halvings of a step before it is given up.
const HALVINGS: usize = 12;

/// What steps remember of gradients.
#[derive(Clone, Debug, PartialEq)]
pub struct Memory {
    /// Mean gradient by scaled variable, towards 0.
    pub first: Vec<f64>,
    /// Mean of its square in the metric, towards 0.
    pub second: f64,
    /// Steps taken.
    pub steps: u64,
    /// Part of the rate that steps take: less where they had to be halved.
    pub reach: f64,
}

impl Default for Memory {
    fn default() -> Self {
        Self { first: Vec::new(), second: 0.0, steps: 0, reach: 1.0 }
    }
}

/// A linear constraint from elsewhere: `aᵀd ≥ b` for the step `d` in scaled variables.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    /// `a`.
    pub a: Vec<f64>,
    /// `b`.
    pub b: f64,
}

/// Violation of a start's constraints, relative to the bound or to 1, from which on its beam is not one that it is made for.
const UNMADE: f64 = 0.05;

/// Where a step went.
#[derive(Clone, Debug)]
pub struct Move {
    /// The lens.
    pub lens: Lens,
    /// How far its rays moved, to first order, rms, mm.
    pub length_mm: f64,
    /// Length of the mean gradient over the root of its mean square, both in the metric: 1 for gradients that agree.
    pub signal: f64,
    /// Largest violation of a constraint before the step, relative to the bound or to 1.
    pub violation: f64,
    /// Constraints and bounds that held the step back.
    pub active: Vec<String>,
}

impl Problem {
    /// The same with clear semi-diameters that follow the beam ([`Apertures::Automatic`]). Where all of the stop's light over the field would need a lens that cannot be
    /// made, as in one that vignettes, they stay as stated ([`Apertures::Stated`]): the rays that they let through are looked at.
    #[must_use]
    pub fn following_beam(mut self) -> Self {
        let violation = |problem: &Self| {
            let found = Descent::new(problem).ok().and_then(|mut d| d.violation(&problem.lens));
            found.unwrap_or(f64::INFINITY)
        };
        self.merit.apertures = Apertures::Automatic;
        let follows = violation(&self);
        if follows > UNMADE {
            self.merit.apertures = Apertures::Stated;
            if violation(&self) > 0.5 * follows {
                self.merit.apertures = Apertures::Automatic;
            }
        }
        self
    }
}

/// Steps of a problem's variables.
pub struct Descent {
    solver: Solver,
}

impl Descent {
    /// For `problem`, whose lens says which of its rays get through.
    ///
    /// # Errors
    /// A problem that is none; a lens through which its rays do not pass.
    pub fn new(problem: &Problem) -> Result<Self> {
        problem.check()?;
        let (solver, _) = Solver::new(problem, &problem.lens, 1.0).map_err(|f| {
            let found = format!("a ray {} at surface {}", f.cause.name(), f.surface);
            let allowed = match problem.merit.apertures {
                Apertures::Automatic => {
                    "a lens that lets all of its aperture through over its field, or stated apertures"
                }
                Apertures::Stated => "a lens that lets light through over its field",
            };
            Error::bad(problem.lens.file(), "start", found, allowed)
        })?;
        Ok(Self { solver })
    }

    /// What moves and is held.
    pub fn problem(&self) -> &Problem {
        &self.solver.problem
    }

    /// One step of `lens` against `gradient` of what is to become less: its rays move by `rate_mm`, rms, where gradients agree. `None`
    /// where no step is possible; `memory` has seen the gradient even then. A gradient that is not finite changes nothing.
    pub fn step(
        &mut self,
        memory: &mut Memory,
        lens: &Lens,
        gradient: &LensGradient,
        rate_mm: f64,
        more: &[Linear],
    ) -> Option<Move> {
        let variables = &self.solver.problem.variables;
        let g = DVector::from_vec(variables.gradient(gradient));
        if g.iter().any(|v| !v.is_finite()) || g.is_empty() {
            return None;
        }
        let mut traced = self.solver.rays.afresh(lens).ok()?;
        let x = variables.values(lens);
        let numbers = self.solver.put(&x);
        let slopes = self.solver.rays.slopes(&numbers, &mut traced).ok()?;
        let rims = self.solver.rims(&traced);
        let point = self.solver.point(x, numbers, traced);
        let h = metric(&self.solver.jacobian(&point, &slopes));
        let (mean, root) = remembered(memory, &g, &h)?;
        // Old gradients in the metric of now may be longer than any of them was: a step of the rate is as much as they ask for.
        let signal = mean.dot(&solved(&h, &mean)?).max(0.0).sqrt() / root.max(f64::MIN_POSITIVE);
        let scale = signal.max(1.0) * root.max(f64::MIN_POSITIVE.sqrt()) / (rate_mm * memory.reach);
        let mut kept = self.solver.rows(&point, Some(&slopes), &rims);
        kept.extend(more.iter().map(|l| Kept {
            of: usize::MAX,
            upper: false,
            row: Row { a: l.a.clone(), b: l.b, equal: false },
        }));
        let rows: Vec<Row> = kept.iter().map(|k| k.row.clone()).collect();
        // In units in which the program's numbers are near 1.
        let g = &mean / scale;
        let (found, _) = program(&h, &g, &rows);
        let found = found?;
        let mut d = self.solver.corrected(&point, &h, &g, &kept, &rims, &found);
        // Rims follow the beam, which rows do not know: once more with those of the step.
        if let Some(trial) = self.solver.trial(&point, &slopes, &d) {
            let moved = self.solver.rims(&trial.traced);
            d = self.solver.corrected(&point, &h, &g, &kept, &moved, &found);
        }
        let mut d = DVector::from_vec(d);
        let length = |d: &DVector<f64>| d.dot(&(&h * d)).max(0.0).sqrt();
        let longest = LONGEST * rate_mm / length(&d).max(f64::MIN_POSITIVE);
        if longest < 1.0 {
            d *= longest;
        }
        let violations = self.solver.violations(&point.numbers, &point.traced, &rims);
        let violation = self.solver.relative(&violations, &point.x);
        let active = self.names(&kept, &found.multipliers, &point);
        for halved in 0..HALVINGS {
            if let Some(trial) = self.solver.trial(&point, &slopes, d.as_slice())
                && let Some(lens) = self.stands(lens, &trial, violation)
            {
                memory.reach = if halved == 0 { 1.0f64.min(1.2 * memory.reach) } else { 0.7 * memory.reach };
                let signal = signal.min(1.0);
                return Some(Move { lens, length_mm: length(&d), signal, violation, active });
            }
            d *= 0.5;
        }
        memory.reach = (0.5 * memory.reach).max(1e-3);
        None
    }

    /// The lens of a trial, all of whose rays arrive when aimed anew, and which violates constraints no more than `before`, or hardly.
    fn stands(&mut self, from: &Lens, trial: &Point, before: f64) -> Option<Lens> {
        let rims = self.solver.rims(&trial.traced);
        let violations = self.solver.violations(&trial.numbers, &trial.traced, &rims);
        if self.solver.relative(&violations, &trial.x) > 1.001 * before.max(HARDLY) {
            return None;
        }
        let problem = &self.solver.problem;
        let mut lens = problem.stands(&trial.numbers, &trial.traced.heights).ok()?;
        if problem.merit.apertures == Apertures::Stated {
            // Surfaces that opened stay open.
            let grown = |(i, s): (usize, &mut crate::lens::Surface)| {
                s.semi_diameter = s.semi_diameter.max(from.surfaces[i].semi_diameter.min(0.999 * s.shape.reach()));
            };
            lens = lens.changed(|l| l.surfaces.iter_mut().enumerate().for_each(grown)).ok()?;
        }
        self.solver.rays.afresh(&lens).ok()?;
        Some(lens)
    }

    /// Largest violation of a constraint by `lens`, relative to the bound or to 1; `None` where its rays do not arrive.
    pub fn violation(&mut self, lens: &Lens) -> Option<f64> {
        let traced = self.solver.rays.afresh(lens).ok()?;
        let x = self.solver.problem.variables.values(lens);
        let rims = self.solver.rims(&traced);
        let violations = self.solver.violations(lens, &traced, &rims);
        Some(self.solver.relative(&violations, &x))
    }

    /// Root of the merit of `lens`, mm; `None` where its rays do not arrive.
    pub fn merit(&mut self, lens: &Lens) -> Option<f64> {
        let traced = self.solver.rays.afresh(lens).ok()?;
        Some(super::residuals::residuals(&self.solver.rays, &traced).iter().map(|r| r * r).sum::<f64>().sqrt())
    }

    fn names(&self, kept: &[Kept], multipliers: &[f64], point: &Point) -> Vec<String> {
        let problem = &self.solver.problem;
        let name = |k: &Kept| match (problem.constraints.get(k.of), k.of.checked_sub(problem.constraints.len())) {
            (Some(c), _) => c.quantity.name(),
            (None, Some(j)) if j < point.x.len() => problem.variables.parameters[j].name(&problem.lens),
            _ => "relative_illumination".to_owned(),
        };
        kept.iter().zip(multipliers).filter(|(_, u)| **u != 0.0).map(|(k, _)| name(k)).collect()
    }
}

/// `JᵀJ` with its damping.
fn metric(j: &DMatrix<f64>) -> DMatrix<f64> {
    let mut h = j.tr_mul(j);
    let largest = h.diagonal().max();
    for k in 0..h.nrows() {
        let own = h[(k, k)];
        h[(k, k)] += DAMPING * own.max(1e-9 * largest).max(f64::MIN_POSITIVE);
    }
    h
}

fn solved(h: &DMatrix<f64>, g: &DVector<f64>) -> Option<DVector<f64>> {
    Some(h.clone().cholesky()?.solve(g))
}

/// The mean gradient, and the root of its mean square in the metric.
fn remembered(memory: &mut Memory, g: &DVector<f64>, h: &DMatrix<f64>) -> Option<(DVector<f64>, f64)> {
    let square = g.dot(&solved(h, g)?);
    if !square.is_finite() {
        return None;
    }
    memory.first.resize(g.len(), 0.0);
    memory.steps += 1;
    for (m, g) in memory.first.iter_mut().zip(g.iter()) {
        *m = FIRST * *m + (1.0 - FIRST) * g;
    }
    memory.second = SECOND * memory.second + (1.0 - SECOND) * square;
    // Both averages are made whole as Adam's are.
    let whole = |b: f64| 1.0 - b.powf(memory.steps as f64);
    let mean = DVector::from_column_slice(&memory.first) / whole(FIRST);
    Some((mean, (memory.second / whole(SECOND)).max(0.0).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::lens::variables::Variables;

    /// The gradient of half the merit's square by a slow way: differences.
    fn merit_gradient(descent: &mut Descent, lens: &Lens) -> LensGradient {
        let vars = descent.problem().variables.clone();
        let x = vars.values(lens);
        let mut gradient = LensGradient::zeros(lens);
        let mut at = |k: usize, h: f64| {
            let mut y = x.clone();
            y[k] += h;
            let moved = vars.lens(lens, &y).expect("a lens");
            0.5 * descent.merit(&moved).expect("rays arrive").powi(2)
        };
        let slopes: Vec<f64> = (0..x.len()).map(|k| (at(k, 1e-6) - at(k, -1e-6)) / 2e-6).collect();
        for ((p, s), v) in vars.parameters.iter().zip(&vars.scales).zip(&slopes) {
            if let Some(number) = p.kind.list_mut(&mut gradient, p.of).get_mut(p.entry) {
                *number = v / s;
            }
        }
        gradient
    }

    /// Along the merit's own gradient the descent goes where [`super::super::optimize`] goes, within its constraints.
    #[test]
    fn steps_along_the_merits_gradient_make_the_lens_sharper() {
        const STEPS: u32 = 60;
        let lens = builtin::lens("two_element").expect("shipped");
        let mut problem = Problem::standard(&lens);
        problem.merit.apertures = Apertures::Automatic;
        let best = super::super::optimize(&problem, super::super::Limits::default(), &mut |_| true).expect("optimises");
        let mut descent = Descent::new(&problem).expect("rays pass");
        let (mut lens, mut memory) = (lens, Memory::default());
        let before = descent.merit(&lens).expect("arrives");
        for k in 0..STEPS {
            let gradient = merit_gradient(&mut descent, &lens);
            let rate = 8e-3 * (1.0 - f64::from(k) / f64::from(STEPS));
            let Some(moved) = descent.step(&mut memory, &lens, &gradient, rate, &[]) else {
                panic!("no step {k}: violation {:?}, merit {:?}", descent.violation(&lens), descent.merit(&lens));
            };
            assert!(moved.length_mm <= 10.001 * rate, "step {k}: {}", moved.length_mm);
            lens = moved.lens;
            assert!(descent.violation(&lens).expect("arrives") < 1.01 * HARDLY, "step {k}");
        }
        let after = descent.merit(&lens).expect("arrives");
        eprintln!("{before} -> {after}; optimize: {}", best.rms_mm[1]);
        assert!(after < before - 0.6 * (before - best.rms_mm[1]), "{before} -> {after}, {}", best.rms_mm[1]);
        assert!(descent.violation(&lens).expect("arrives") < 1e-5);
    }

    /// Gradients that point along one direction, then ever more of another that rays feel less: no step is longer than its rate.
    #[test]
    fn no_step_is_longer_than_its_rate() {
        let lens = builtin::lens("two_element").expect("shipped");
        let mut problem = Problem::standard(&lens);
        problem.merit.apertures = Apertures::Automatic;
        problem.constraints.clear();
        problem.bounds.fill([f64::NEG_INFINITY, f64::INFINITY]);
        let mut descent = Descent::new(&problem).expect("rays pass");
        let (mut lens, mut memory) = (lens, Memory::default());
        for k in 0..12 {
            let mut gradient = LensGradient::zeros(&lens);
            gradient.surfaces[1].thickness = 10f64.powi(k);
            gradient.surfaces[4].thickness = -100f64.powi(k - 6);
            let moved = descent.step(&mut memory, &lens, &gradient, 1e-3, &[]).expect("a step");
            assert!(moved.length_mm < 1.3e-3 && moved.signal <= 1.0, "step {k}: {} {}", moved.length_mm, moved.signal);
            lens = moved.lens;
        }
    }

    /// Gradients that say nothing leave the lens where it is; those that are no numbers, too, and the memory with it.
    #[test]
    fn what_says_nothing_moves_nothing() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let problem = Problem::standard(&lens);
        let mut descent = Descent::new(&problem).expect("rays pass");
        let mut memory = Memory::default();
        let mut gradient = LensGradient::zeros(&lens);
        let moved = descent.step(&mut memory, &lens, &gradient, 1e-3, &[]).expect("a step");
        let variables = Variables::new(&lens, problem.variables.parameters.clone());
        let (a, b) = (variables.values(&lens), variables.values(&moved.lens));
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-9), "{a:?} {b:?}");
        gradient.surfaces[0].thickness = f64::NAN;
        let kept = memory.clone();
        assert!(descent.step(&mut memory, &lens, &gradient, 1e-3, &[]).is_none());
        assert_eq!(memory, kept);
    }

    /// Every shipped lens can be gone down from, also one that vignettes (its clear semi-diameters stay, or grow with the light that they let through), and becomes sharper.
    #[test]
    fn every_shipped_lens_moves() {
        let mut vignetting = 0;
        for (name, _) in builtin::LENSES {
            let lens = builtin::lens(name).expect("shipped");
            let problem = Problem::standard(&lens).following_beam();
            let mut descent = Descent::new(&problem).unwrap_or_else(|e| panic!("{name}: {e}"));
            vignetting += usize::from(problem.merit.apertures == Apertures::Stated);
            let before = descent.merit(&lens).expect("arrives");
            let gradient = merit_gradient(&mut descent, &lens);
            let rate = 0.02 * before;
            let moved = descent.step(&mut Memory::default(), &lens, &gradient, rate, &[]);
            let moved = moved.unwrap_or_else(|| panic!("{name}: no step, merit {before}"));
            let after = descent.merit(&moved.lens).unwrap_or_else(|| panic!("{name}: no rays"));
            eprintln!("{name}: {before:.6} -> {after:.6} mm, violation {:.1e}", moved.violation);
            // A start that violates what is held is brought back first.
            assert!(after < before || moved.violation > HARDLY, "{name}: {before} -> {after}");
            if problem.merit.apertures == Apertures::Stated {
                lens.surfaces
                    .iter()
                    .zip(&moved.lens.surfaces)
                    .for_each(|(a, b)| assert!(b.semi_diameter >= a.semi_diameter, "{name}"));
            }
        }
        assert!(vignetting > 0);
    }

    /// A linear constraint from elsewhere is kept.
    #[test]
    fn constraints_from_elsewhere_hold_a_step_back() {
        let lens = builtin::lens("two_element").expect("shipped");
        let mut problem = Problem::standard(&lens);
        problem.merit.apertures = Apertures::Automatic;
        let mut descent = Descent::new(&problem).expect("rays pass");
        let gradient = merit_gradient(&mut descent, &lens);
        let free = descent.step(&mut Memory::default(), &lens, &gradient, 1e-3, &[]).expect("a step");
        let x = |l: &Lens| problem.variables.values(l);
        let k = (0..x(&lens).len())
            .max_by(|a, b| {
                let by = |k: &usize| (x(&free.lens)[*k] - x(&lens)[*k]).abs();
                by(a).total_cmp(&by(b))
            })
            .expect("variables");
        let sign = (x(&free.lens)[k] - x(&lens)[k]).signum();
        let mut a = vec![0.0; x(&lens).len()];
        a[k] = -sign;
        let held =
            descent.step(&mut Memory::default(), &lens, &gradient, 1e-3, &[Linear { a, b: 0.0 }]).expect("a step");
        assert!(sign * (x(&held.lens)[k] - x(&lens)[k]) < 1e-12);
        assert!(held.active.contains(&"relative_illumination".to_owned()));
    }
}
