//! Damped least squares with constraints: Gauss–Newton with Marquardt's damping as a sequence of quadratic programs, an active set and
//! its multipliers, an exact penalty as judge of steps, and a second-order correction before any ray is traced.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::{DMatrix, DVector};

use super::constraint::{Constraint, Held};
use super::first_order::{FirstOrder, Value};
use super::merit::Apertures;
use super::problem::{KEPT, Limits, Problem, Step, Stop};
use super::quadratic::{Minimum, Row, minimum};
use super::rays::{Rays, Slopes, Traced};
use super::residuals::{jacobian, residuals};
use crate::lens::{Lens, Prescription};
use crate::trace::Failure;

/// A bound that holds the lens back.
#[derive(Clone, Debug)]
pub(super) struct Multiplier {
    /// Constraint, or variable behind the last constraint.
    pub(super) of: usize,
    /// Whether it is the upper bound.
    pub(super) upper: bool,
    /// Of half the sum of squares, by the bound in its own unit.
    pub(super) value: f64,
}

/// What came out.
pub(super) struct Solved {
    pub(super) numbers: Prescription,
    pub(super) heights: Vec<f64>,
    /// Of the constraints.
    pub(super) values: Vec<f64>,
    /// Of the targets.
    pub(super) wanted: Vec<f64>,
    /// Root of the rays' part of the merit before and after, mm.
    pub(super) rms: [f64; 2],
    /// Root of the merit, mm.
    pub(super) merit: f64,
    pub(super) violation: f64,
    pub(super) iterations: usize,
    pub(super) stop: Stop,
    pub(super) multipliers: Vec<Multiplier>,
    /// What was better by numbers.
    pub(super) refused: Option<Refused>,
}

/// A lens on the way.
pub(super) struct Point {
    pub(super) x: Vec<f64>,
    pub(super) numbers: Prescription,
    pub(super) traced: Traced,
    /// The rays', then the targets'.
    residuals: Vec<f64>,
    /// Half the sum of their squares, and the rays' part of it.
    half: f64,
    of_rays: f64,
}

/// Violation, root of the merit, the lens and its rays.
type Best = (f64, f64, Prescription, Traced);

/// Better numbers that are no lens.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Refused {
    #[serde(skip)]
    violation: f64,
    /// Root of their merit, mm.
    pub merit_mm: f64,
    /// Why they are no lens.
    pub why: String,
}

/// A row of the program: which constraint or variable, which bound.
pub(super) struct Kept {
    pub(super) of: usize,
    pub(super) upper: bool,
    pub(super) row: Row,
}

/// Where the work is.
struct Way {
    point: Point,
    damping: f64,
    growth: f64,
    /// Largest diagonal of the normal matrix so far.
    scales: Vec<f64>,
    best: Option<Best>,
    refused: Option<Refused>,
    /// The rows and the step that were tried last.
    last: Option<(Vec<Kept>, Minimum)>,
    /// Steps in a row that brought next to nothing.
    calm: usize,
    iterations: usize,
}

/// The problem about a point, to first order.
struct Linear {
    slopes: Slopes,
    rims: Vec<f64>,
    violations: Vec<f64>,
    relative: f64,
    j: DMatrix<f64>,
    r: DVector<f64>,
    /// `Jᵀr` and `JᵀJ`.
    g: DVector<f64>,
    normal: DMatrix<f64>,
    kept: Vec<Kept>,
}

pub(super) struct Solver {
    pub(super) problem: Arc<Problem>,
    pub(super) rays: Rays,
    /// Clear semi-diameters of the start.
    stated: Vec<f64>,
    /// Weights of violations in the judge of steps.
    weights: Vec<f64>,
    bounds: Vec<[f64; 2]>,
}

impl Solver {
    /// From `lens` at `share` of aperture and field.
    pub(super) fn new(problem: &Problem, lens: &Lens, share: f64) -> Result<(Self, Traced), Failure> {
        let clip = problem.merit.apertures == Apertures::Stated;
        let (rays, traced) = Rays::new(&problem.merit, lens, &problem.variables, share, clip)?;
        let scaled = |(b, s): (&[f64; 2], &f64)| {
            let [a, b] = b.map(|v| v / s);
            [a.min(b), a.max(b)]
        };
        let bounds = problem.bounds.iter().zip(&problem.variables.scales).map(scaled).collect();
        let stated = lens.surfaces.iter().map(|s| s.semi_diameter).collect();
        let weights = vec![0.0; problem.constraints.len()];
        Ok((Self { problem: Arc::new(problem.clone()), rays, stated, weights, bounds }, traced))
    }

    pub(super) fn rays(&self) -> usize {
        self.rays.count()
    }

    pub(super) fn put(&self, x: &[f64]) -> Prescription {
        let mut numbers: Prescription = (*self.problem.lens).clone();
        self.problem.variables.put(&mut numbers, x);
        numbers.surfaces.iter_mut().for_each(|s| s.shape.refresh());
        numbers
    }

    /// How far each surface has to reach: as far as the light, and no less than stated.
    pub(super) fn rims(&self, traced: &Traced) -> Vec<f64> {
        match self.problem.merit.apertures {
            Apertures::Stated => self.stated.iter().zip(&traced.heights).map(|(s, h)| s.max(*h)).collect(),
            Apertures::Automatic => traced.heights.clone(),
        }
    }

    /// Violations of the constraints, relative to nothing: in their own units. Infinite where one is no number.
    pub(super) fn violations(&self, numbers: &Prescription, traced: &Traced, rims: &[f64]) -> Vec<f64> {
        let variables = &self.problem.variables;
        let first = FirstOrder::new(numbers, variables);
        let held = Held { numbers, variables, first, rims, rays: Some((&self.rays, traced, None)) };
        let violation = |c: &Constraint| {
            let [low, high] = c.bounds.map(|b| (b, if b.is_finite() { held.near(c.quantity, b).value } else { b }));
            let beyond = |bound: f64, by: f64| match (bound.is_finite(), by.is_finite()) {
                (true, true) => by.max(0.0),
                (true, false) => f64::INFINITY,
                (false, _) => 0.0,
            };
            beyond(low.0, low.0 - low.1).max(beyond(high.0, high.1 - high.0))
        };
        self.problem.constraints.iter().map(violation).collect()
    }

    /// The rows of the program at a point.
    pub(super) fn rows(&self, point: &Point, slopes: Option<&Slopes>, rims: &[f64]) -> Vec<Kept> {
        let variables = &self.problem.variables;
        let n = variables.parameters.len();
        let first = FirstOrder::new(&point.numbers, variables);
        let held =
            Held { numbers: &point.numbers, variables, first, rims, rays: Some((&self.rays, &point.traced, slopes)) };
        let mut rows = Vec::new();
        for (of, c) in self.problem.constraints.iter().enumerate() {
            let [low, high] = c.bounds;
            let equal = low == high;
            for (upper, bound) in [(false, low), (true, high)] {
                if !bound.is_finite() || upper && equal {
                    continue;
                }
                let v = held.near(c.quantity, bound);
                let sign = if upper { -1.0 } else { 1.0 };
                let a = v.by.iter().map(|d| sign * d).collect();
                rows.push(Kept { of, upper, row: Row { a, b: sign * (bound - v.value), equal } });
            }
        }
        for (j, [low, high]) in self.bounds.iter().enumerate() {
            for (upper, bound) in [(false, *low), (true, *high)] {
                if bound.is_finite() {
                    let sign = if upper { -1.0 } else { 1.0 };
                    let mut a = vec![0.0; n];
                    a[j] = sign;
                    let b = sign * (bound - point.x[j]);
                    rows.push(Kept { of: self.problem.constraints.len() + j, upper, row: Row { a, b, equal: false } });
                }
            }
        }
        rows
    }

    /// Runs from the start of `new`.
    pub(super) fn run(
        &mut self,
        start: &Lens,
        traced: Traced,
        limits: Limits,
        watch: &mut dyn FnMut(Step) -> bool,
    ) -> Solved {
        let problem = Arc::clone(&self.problem);
        let n = problem.variables.parameters.len();
        let mut x = problem.variables.values(start);
        x.iter_mut().for_each(|x| *x = if x.is_finite() { *x } else { 0.0 });
        let point = self.point(x, self.put(&problem.variables.values(start)), traced);
        let before = (2.0 * point.of_rays).sqrt();
        let mut way = Way {
            point,
            damping: 1e-3,
            growth: 2.0,
            scales: vec![0.0; n],
            best: None,
            refused: None,
            last: None,
            calm: 0,
            iterations: 0,
        };
        let mut stop = Stop::Iterations;
        while way.iterations < limits.iterations && n > 0 {
            let Ok(slopes) = self.rays.slopes(&way.point.numbers, &mut way.point.traced) else {
                stop = Stop::Stalled;
                break;
            };
            let rims = self.rims(&way.point.traced);
            let violations = self.violations(&way.point.numbers, &way.point.traced, &rims);
            let relative = self.relative(&violations, &way.point.x);
            self.remember(&mut way.best, &mut way.refused, &way.point, relative);
            let rms = (2.0 * way.point.of_rays).sqrt();
            let asked = !watch(Step { iteration: way.iterations, rms, violation: relative });
            if asked || limits.until.is_some_and(|t| Instant::now() >= t) {
                stop = if asked { Stop::Asked } else { Stop::Time };
                break;
            }
            let j = self.jacobian(&way.point, &slopes);
            let r = DVector::from_column_slice(&way.point.residuals);
            let (jt, g) = (j.transpose(), j.tr_mul(&r));
            let normal = &jt * &j;
            way.scales.iter_mut().enumerate().for_each(|(k, s)| *s = s.max(normal[(k, k)]));
            let kept = self.rows(&way.point, Some(&slopes), &rims);
            let at = Linear { slopes, rims, violations, relative, j, r, g, normal, kept };
            if let Some(end) = self.improve(&mut way, at, limits) {
                stop = end;
                break;
            }
        }
        self.end(way, before, stop)
    }

    /// Steps from a point, shorter and shorter until one is better; why the work ends where none is.
    fn improve(&mut self, way: &mut Way, at: Linear, limits: Limits) -> Option<Stop> {
        let Linear { slopes, rims, violations, relative, j, r, g, normal, kept } = at;
        let floor = 1e-9 * way.scales.iter().copied().fold(1e-300, f64::max);
        let judge = |half: f64, v: &[f64], w: &[f64]| half + v.iter().zip(w).map(|(v, w)| v * w).sum::<f64>();
        // What is asked of violated rows: less of it where steps that would satisfy them are refused, however short they are meant
        // to be.
        let (mut asked, mut refused, mut tried) = (1.0, 0, None);
        let end = loop {
            let part = |b: f64, equal: bool| if b > 0.0 || equal { asked * b } else { b };
            let rows: Vec<Row> = kept.iter().map(|k| Row { b: part(k.row.b, k.row.equal), ..k.row.clone() }).collect();
            way.iterations += 1;
            let mut h = normal.clone();
            for (k, scale) in way.scales.iter().enumerate() {
                h[(k, k)] += way.damping * scale.max(floor);
            }
            let (step, torn) = program(&h, &g, &rows);
            let Some(step) = step else { break Some(Stop::Stalled) };
            let ended = |otherwise| if torn { Stop::Contradiction } else { otherwise };
            for (k, u) in kept.iter().zip(&step.multipliers) {
                if let Some(w) = self.weights.get_mut(k.of) {
                    *w = w.max(1.5 * u.abs());
                }
            }
            let d = DVector::from_column_slice(&step.d);
            let model = 0.5 * (&r + &j * &d).norm_squared();
            let promised: Vec<f64> = self.promised(&kept, &step.d);
            let here = judge(way.point.half, &violations, &self.weights);
            let gain = here - judge(model, &promised, &self.weights);
            if gain <= limits.tolerance * 0.01 * here && (relative <= KEPT || torn) {
                tried = Some(step);
                break Some(if relative > KEPT { ended(Stop::Converged) } else { Stop::Converged });
            }
            let corrected =
                if asked < 1.0 { step.d.clone() } else { self.corrected(&way.point, &h, &g, &kept, &rims, &step) };
            let accepted = self.trial(&way.point, &slopes, &corrected).is_some_and(|trial| {
                let v = self.violations(&trial.numbers, &trial.traced, &rims);
                let real = here - judge(trial.half, &v, &self.weights);
                let ratio = real / gain;
                let better = ratio > 1e-4 && real.is_finite();
                if better {
                    way.damping = (way.damping * (1.0 - (2.0 * ratio - 1.0).powi(3)).max(0.2)).max(1e-12);
                    way.growth = 2.0;
                    way.calm = if real <= limits.tolerance * here && relative <= KEPT { way.calm + 1 } else { 0 };
                    way.point = trial;
                }
                better
            });
            tried = Some(step);
            if accepted {
                break (way.calm >= 3).then(|| ended(Stop::Converged));
            }
            way.damping = (way.damping * way.growth).max(1e-9);
            way.growth *= 2.0;
            refused += 1;
            if refused > 2 && relative > KEPT {
                asked *= 0.3;
            }
            if way.damping > 1e14 {
                break Some(ended(Stop::Stalled));
            }
            if way.iterations >= limits.iterations || limits.until.is_some_and(|t| Instant::now() >= t) {
                break Some(Stop::Iterations);
            }
        };
        way.last = tried.map(|step| (kept, step)).or(way.last.take());
        end
    }

    /// The best of the way, with its own figures.
    fn end(&self, way: Way, before: f64, stop: Stop) -> Solved {
        let Way { point, mut best, mut refused, last, iterations, .. } = way;
        let rims = self.rims(&point.traced);
        let relative = self.relative(&self.violations(&point.numbers, &point.traced, &rims), &point.x);
        self.remember(&mut best, &mut refused, &point, relative);
        let (violation, merit, numbers, traced) =
            best.unwrap_or((relative, (2.0 * point.half).sqrt(), point.numbers, point.traced));
        let rms = [before, (2.0 * half_square(&residuals(&self.rays, &traced))).sqrt()];
        let variables = &self.problem.variables;
        let rims = &self.rims(&traced);
        let first = FirstOrder::new(&numbers, variables);
        let held = Held { numbers: &numbers, variables, first, rims, rays: Some((&self.rays, &traced, None)) };
        let values = self.problem.constraints.iter().map(|c| held.value(c.quantity).value).collect();
        let wanted = self.problem.targets.iter().map(|t| held.value(t.quantity).value).collect();
        let heights = traced.heights.clone();
        // Those of better numbers say nothing of this lens.
        let multipliers = match last {
            Some((kept, step)) if refused.is_none() => multipliers(&kept, &step),
            _ => Vec::new(),
        };
        Solved { numbers, heights, values, wanted, rms, merit, violation, iterations, stop, multipliers, refused }
    }

    /// Largest violation, relative to the bound or to 1, of constraints and of variables' bounds.
    pub(super) fn relative(&self, violations: &[f64], x: &[f64]) -> f64 {
        let of = |(v, c): (&f64, &Constraint)| {
            let size = c.bounds.iter().filter(|b| b.is_finite()).fold(0.0f64, |m, b| m.max(b.abs()));
            v / size.max(1.0)
        };
        let outside = x.iter().zip(&self.bounds).map(|(x, [a, b])| (a - x).max(x - b).max(0.0));
        violations.iter().zip(&self.problem.constraints).map(of).chain(outside).fold(0.0, f64::max)
    }

    /// Violations that the linearised constraints promise after `d`.
    fn promised(&self, kept: &[Kept], d: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0f64; self.problem.constraints.len()];
        for k in kept {
            if let Some(out) = out.get_mut(k.of) {
                let left = k.row.b - k.row.a.iter().zip(d).map(|(a, d)| a * d).sum::<f64>();
                *out = out.max(if k.row.equal { left.abs() } else { left.max(0.0) });
            }
        }
        out
    }

    /// The step with what constraints do beyond first order taken into account; distortion, which takes rays, is left out.
    pub(super) fn corrected(
        &self,
        point: &Point,
        h: &DMatrix<f64>,
        g: &DVector<f64>,
        kept: &[Kept],
        rims: &[f64],
        step: &Minimum,
    ) -> Vec<f64> {
        let mut d = step.d.clone();
        let variables = &self.problem.variables;
        for _ in 0..2 {
            let x: Vec<f64> = point.x.iter().zip(&d).map(|(x, d)| x + d).collect();
            let numbers = self.put(&x);
            let first = FirstOrder::new(&numbers, variables);
            let held = Held { numbers: &numbers, variables, first, rims, rays: None };
            let mut off = 0.0f64;
            let mut rows = Vec::with_capacity(kept.len());
            for k in kept {
                let mut row = k.row.clone();
                if let Some(c) = self.problem.constraints.get(k.of)
                    && !matches!(c.quantity, super::constraint::Quantity::Distortion(_))
                {
                    let bound = c.bounds[usize::from(k.upper)];
                    let sign = if k.upper { -1.0 } else { 1.0 };
                    let left = sign * (bound - held.near(c.quantity, bound).value);
                    let linear: f64 = row.a.iter().zip(&d).map(|(a, d)| a * d).sum();
                    let b = left + linear;
                    if !b.is_finite() {
                        return step.d.clone();
                    }
                    let size = bound.abs().max(1.0);
                    off = off.max(if row.equal { left.abs() } else { left } / size);
                    row.b = b;
                }
                rows.push(row);
            }
            if off <= 0.1 * KEPT {
                break;
            }
            let Some(better) = minimum(h, g, &rows) else { break };
            d = better.d;
        }
        d
    }

    /// Keeps the best lens: the smallest merit among those that keep the constraints, the smallest violation where none does. Numbers
    /// that are no lens are told of instead.
    fn remember(&self, best: &mut Option<Best>, refused: &mut Option<Refused>, point: &Point, violation: f64) {
        let merit = (2.0 * point.half).sqrt();
        let kept = violation <= KEPT;
        let better = |than: f64, at: f64| match (kept, at <= KEPT) {
            (true, true) => merit < than,
            (false, false) => violation < at,
            (now, _) => now,
        };
        let Some((at, than, _, _)) = best else {
            *best = Some((violation, merit, point.numbers.clone(), point.traced.clone()));
            return;
        };
        if !better(*than, *at) {
            return;
        }
        let first = refused.as_ref().is_none_or(|r| better(r.merit_mm, r.violation));
        match self.problem.stands(&point.numbers, &point.traced.heights) {
            Ok(_) => {
                *best = Some((violation, merit, point.numbers.clone(), point.traced.clone()));
                *refused = refused.take().filter(|_| !first);
            }
            Err(why) if first => *refused = Some(Refused { violation, merit_mm: merit, why: why.to_string() }),
            Err(_) => {}
        }
    }

    pub(super) fn trial(&mut self, point: &Point, slopes: &Slopes, d: &[f64]) -> Option<Point> {
        let x: Vec<f64> = point.x.iter().zip(d).map(|(x, d)| x + d).collect();
        let numbers = self.put(&x);
        let traced = self.rays.trace(&numbers, &point.traced, slopes, d).ok()?;
        let point = self.point(x, numbers, traced);
        point.half.is_finite().then_some(point)
    }

    /// A lens with its residuals.
    pub(super) fn point(&self, x: Vec<f64>, numbers: Prescription, traced: Traced) -> Point {
        let mut residuals = residuals(&self.rays, &traced);
        let of_rays = half_square(&residuals);
        residuals.extend(self.wanted(&numbers, &traced, None).iter().map(|v| v.value));
        let half = half_square(&residuals);
        Point { x, numbers, traced, residuals, half, of_rays }
    }

    /// The targets' residuals with their derivatives (how far surfaces have to reach is taken as it is).
    fn wanted(&self, numbers: &Prescription, traced: &Traced, slopes: Option<&Slopes>) -> Vec<Value> {
        let (problem, rims) = (&self.problem, self.rims(traced));
        if problem.targets.is_empty() {
            return Vec::new();
        }
        let first = FirstOrder::new(numbers, &problem.variables);
        let rays = Some((&self.rays, traced, slopes));
        let held = Held { numbers, variables: &problem.variables, first, rims: &rims, rays };
        problem.targets.iter().map(|t| held.residual(t)).collect()
    }

    /// The Jacobian of a lens's residuals.
    pub(super) fn jacobian(&self, point: &Point, slopes: &Slopes) -> DMatrix<f64> {
        let of_rays = jacobian(&self.rays, &point.traced, slopes, point.x.len());
        let wanted = self.wanted(&point.numbers, &point.traced, Some(slopes));
        let mut all = of_rays.insert_rows(point.residuals.len() - wanted.len(), wanted.len(), 0.0);
        for (k, value) in wanted.iter().enumerate() {
            let row = point.residuals.len() - wanted.len() + k;
            value.by.iter().enumerate().for_each(|(j, d)| all[(row, j)] = *d);
        }
        all
    }
}

fn half_square(r: &[f64]) -> f64 {
    0.5 * r.iter().map(|r| r * r).sum::<f64>()
}

/// The step of one program. Where rows contradict each other those that are violated are sought by least squares, far above the merit,
/// and the others kept; the second value says so.
pub(super) fn program(h: &DMatrix<f64>, g: &DVector<f64>, rows: &[Row]) -> (Option<Minimum>, bool) {
    if let Some(found) = minimum(h, g, rows) {
        return (Some(found), false);
    }
    let (mut h, mut g) = (h.clone(), g.clone());
    let size = h.diagonal().max();
    let mut kept = Vec::new();
    for row in rows {
        let length: f64 = row.a.iter().map(|a| a * a).sum();
        if !(row.b > 0.0 || row.equal && row.b != 0.0) {
            kept.push(Row { b: row.b.min(0.0), ..row.clone() });
            continue;
        }
        // A row that is satisfied by the step for all of the variables: never asked for.
        kept.push(Row { a: vec![0.0; row.a.len()], b: 0.0, equal: false });
        if length > 0.0 {
            let a = DVector::from_column_slice(&row.a);
            let weight = 1e4 * size / length;
            h.ger(weight, &a, &a, 1.0);
            g.axpy(-weight * row.b, &a, 1.0);
        }
    }
    let mut found = minimum(&h, &g, &kept);
    if let Some(found) = &mut found {
        for ((row, u), d) in rows.iter().zip(&mut found.multipliers).zip(std::iter::repeat(found.d.clone())) {
            if row.b > 0.0 || row.equal && row.b != 0.0 {
                let length: f64 = row.a.iter().map(|a| a * a).sum();
                let left = row.b - row.a.iter().zip(&d).map(|(a, d)| a * d).sum::<f64>();
                *u = if length > 0.0 { 1e4 * size / length * left } else { 0.0 };
            }
        }
    }
    (found, true)
}

fn multipliers(kept: &[Kept], step: &Minimum) -> Vec<Multiplier> {
    let active = |(k, u): (&Kept, &f64)| (*u != 0.0).then_some(Multiplier { of: k.of, upper: k.upper, value: *u });
    kept.iter().zip(&step.multipliers).filter_map(active).collect()
}
