//! Global search: many starts from thin-lens powers and bendings, each improved; then basin hopping from the best.
//!
//! A start draws a power and a bending for every element and new gaps, is scaled to the focal length, and is taken up only if it is
//! among the best of many draws by third-order sums and Petzval curvature, which cost no rays. Improved lenses are compared, the same minimum counts once, and
//! the best are moved on by random displacements of all variables. Everything is drawn by number from one seed; where no time ends
//! the work the result does not depend on the number of threads.

use std::time::Instant;

use rayon::prelude::*;

use super::constraint::Quantity;
use super::finish::Outcome;
use super::problem::{KEPT, Limits, Problem, Stop};
use super::{Apertures, Merit, merit_of, optimize};
use crate::lens::{Kind, Lens, Medium, Parameter, Prescription, paraxial};
use isoplanat_base::error::Result;

/// How long and how widely to search.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Starts that are improved.
    pub starts: usize,
    /// Rounds of hops from the best.
    pub hops: usize,
    /// Lenses that are kept.
    pub keep: usize,
    /// Of all draws.
    pub seed: u64,
    /// When to stop at the latest.
    pub until: Option<Instant>,
}

impl Default for Plan {
    fn default() -> Self {
        Self { starts: 256, hops: 12, keep: 10, seed: 1, until: None }
    }
}

/// Draws for each start that is taken up.
const DRAWS: usize = 400;
/// Starts and hops that run side by side before the time is looked at.
const BATCH: usize = 32;
/// Two lenses are the same minimum if their merits are this near and their curvatures, in thicknesses of the beam.
const SAME_RMS: f64 = 5e-3;
const SAME_BEND: f64 = 2e-2;

/// Where the search is.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Share of the work done.
    pub share: f64,
    /// Smallest rms so far, mm; infinite before there is one.
    pub rms: f64,
    /// Different minima found.
    pub minima: usize,
}

/// The best lenses, the best first. The variables of `problem` say what may move (curvatures and thicknesses among them are drawn);
/// a focal length among its constraints is what starts are scaled to.
///
/// # Errors
/// What `Problem::check` refuses.
pub fn search(problem: &Problem, plan: &Plan, watch: &mut dyn FnMut(Progress) -> bool) -> Result<Vec<Outcome>> {
    problem.check()?;
    let coarse = Problem { merit: Merit { rings: 3, arms: 3, ..problem.merit.clone() }, ..problem.clone() };
    let over = || plan.until.is_some_and(|t| Instant::now() >= t);
    let first = Limits { iterations: 60, tolerance: 1e-4, until: plan.until };
    let full = Limits { iterations: 150, tolerance: 1e-6, until: plan.until };
    let mut found: Vec<Outcome> = Vec::new();
    let work = (plan.starts + plan.hops * plan.keep).max(1);
    let mut done = 0;
    let mut tell = |found: &[Outcome], done: usize| {
        #[expect(clippy::cast_precision_loss, reason = "a share")]
        let share = done as f64 / work as f64;
        let rms = found.first().map_or(f64::INFINITY, |o| o.rms_mm[1]);
        watch(Progress { share, rms, minima: found.len() })
    };
    // The lens as it is comes first, where light passes it.
    found.extend(optimize(problem, full, &mut |_| true).ok().filter(|o| kept(o, problem)));
    for batch in (0..plan.starts).collect::<Vec<_>>().chunks(BATCH) {
        if over() || !tell(&found, done) {
            break;
        }
        let improved: Vec<Outcome> = batch
            .par_iter()
            .filter_map(|k| {
                let lens = start(problem, plan.seed.wrapping_mul(1 << 20).wrapping_add(*k as u64))?;
                let rough = optimize(&Problem { lens, ..coarse.clone() }, first, &mut |_| true)
                    .ok()
                    .filter(|o| kept(o, problem))?;
                Some(rough)
            })
            .collect();
        merge(&mut found, improved, 4 * plan.keep);
        done += batch.len();
    }
    // The best once more with all rays.
    let polished: Vec<Outcome> = found
        .par_iter()
        .filter_map(|o| {
            optimize(&Problem { lens: o.lens.clone(), ..problem.clone() }, full, &mut |_| true)
                .ok()
                .filter(|o| kept(o, problem))
        })
        .collect();
    found.clear();
    merge(&mut found, polished, plan.keep);
    for hop in 0..plan.hops {
        if over() || !tell(&found, done) {
            break;
        }
        let moved: Vec<Outcome> = found
            .par_iter()
            .enumerate()
            .filter_map(|(k, o)| {
                let seed = plan.seed.wrapping_mul(1 << 20).wrapping_add((1 << 19) + (hop * plan.keep + k) as u64);
                let size = [0.03, 0.1, 0.2][hop % 3];
                let lens = displaced(problem, &o.lens, size, &mut fastrand::Rng::with_seed(seed))?;
                optimize(&Problem { lens, ..problem.clone() }, full, &mut |_| true).ok().filter(|o| kept(o, problem))
            })
            .collect();
        merge(&mut found, moved, plan.keep);
        done += plan.keep;
    }
    tell(&found, work);
    Ok(found)
}

/// How much worse a lens may be by rays aimed anew over its own field than by those it was improved with.
const ANEW: f64 = 1.5;

/// Whether a lens is worth keeping: all its rays arrive, all constraints hold, and it is as good over the field as its own pupil sees it.
/// Object points stay where the start had them: far from the field's angles where the start's pupil was somewhere else.
fn kept(o: &Outcome, problem: &Problem) -> bool {
    let stands = || merit_of(&o.lens, &problem.merit).is_ok_and(|rms| rms <= ANEW * o.rms_mm[1] + 1e-6);
    o.share >= 1.0 && o.violation <= KEPT && o.stop != Stop::Contradiction && o.merit_mm.is_finite() && stands()
}

/// Adds lenses, the same minimum once, the best first, at most `keep`.
fn merge(found: &mut Vec<Outcome>, more: Vec<Outcome>, keep: usize) {
    found.extend(more);
    found.sort_by(|a, b| a.merit_mm.total_cmp(&b.merit_mm));
    let mut different: Vec<Outcome> = Vec::new();
    for o in found.drain(..) {
        if different.len() < keep && !different.iter().any(|d| same(d, &o)) {
            different.push(o);
        }
    }
    *found = different;
}

fn same(a: &Outcome, b: &Outcome) -> bool {
    let near = |(s, t): (&crate::lens::Surface, &crate::lens::Surface)| {
        (s.shape.curvature - t.shape.curvature).abs() * s.semi_diameter.max(t.semi_diameter) < SAME_BEND
    };
    (a.merit_mm - b.merit_mm).abs() < SAME_RMS * a.merit_mm && a.lens.surfaces.iter().zip(&b.lens.surfaces).all(near)
}

/// The best of many drawn lenses by sums that cost no rays; `None` where no draw is a lens.
fn start(problem: &Problem, seed: u64) -> Option<Lens> {
    let mut rng = fastrand::Rng::with_seed(seed);
    let mut best: Option<(f64, Prescription)> = None;
    for _ in 0..DRAWS {
        let Some(numbers) = drawn(problem, &mut rng) else { continue };
        let Some(score) = score(&numbers) else { continue };
        if best.as_ref().is_none_or(|(s, _)| score < *s) {
            best = Some((score, numbers));
        }
    }
    let (_, mut numbers) = best?;
    room(problem, &mut numbers);
    problem.made(numbers).ok()
}

fn focal_length(problem: &Problem) -> f64 {
    let held = problem.constraints.iter().find(|c| c.quantity == Quantity::FocalLength);
    let bound = held.and_then(|c| c.bounds.into_iter().find(|b| b.is_finite()));
    bound.unwrap_or_else(|| {
        paraxial::first_order(&problem.lens, problem.lens.wavelengths.primary_nm).effective_focal_length
    })
}

/// Which of the problem's variables a number is.
fn variable(problem: &Problem, kind: Kind, of: usize) -> Option<usize> {
    problem.variables.parameters.iter().position(|p| p.kind == kind && p.of == of)
}

/// A random lens of the focal length: powers, bendings, gaps.
fn drawn(problem: &Problem, rng: &mut fastrand::Rng) -> Option<Prescription> {
    let f = focal_length(problem);
    let mut numbers = (*problem.lens).clone();
    let n = numbers.indices(numbers.wavelengths.primary_nm);
    let count = numbers.surfaces.len();
    let free = |i: usize| variable(problem, Kind::Curvature, i).is_some();
    let mut i = 0;
    while i < count {
        if n[i + 1] <= 1.0 || i + 1 >= count {
            // Between air and air, or the last surface of a cemented group.
            i += 1;
            continue;
        }
        let power = (rng.f64() - 0.4) * 6.0 / f;
        let bending = (rng.f64() - 0.5) * 5.0;
        let difference = power / (n[i + 1] - 1.0);
        if free(i) && !(i > 0 && n[i] > 1.0) {
            numbers.surfaces[i].shape.curvature = 0.5 * difference * (bending + 1.0);
        }
        if free(i + 1) {
            numbers.surfaces[i + 1].shape.curvature = numbers.surfaces[i].shape.curvature - difference;
        }
        i += 1;
    }
    let mut lengths = 0.0;
    for i in 0..count {
        let Some(j) = variable(problem, Kind::Thickness, i) else { continue };
        let [low, high] = problem.bounds[j];
        let glass = n[i + 1] > 1.0;
        let high = high.min(if glass { 0.12 } else { 0.25 } * f).max(low);
        numbers.surfaces[i].thickness = low + (high - low) * rng.f64().powi(2);
        lengths += numbers.surfaces[i].thickness;
    }
    if !(lengths.is_finite() && f.is_finite()) {
        return None;
    }
    // One factor on all drawn curvatures gives the power asked for.
    let scaled = |s: f64| {
        let mut all = numbers.clone();
        (0..count).filter(|i| free(*i)).for_each(|i| all.surfaces[i].shape.curvature *= s);
        all
    };
    let power = |s: f64| {
        let f = paraxial::first_order(&scaled(s), numbers.wavelengths.primary_nm).effective_focal_length;
        if f == 0.0 { f64::NAN } else { f.recip() }
    };
    let (mut low, mut high) = (0.05, 0.05);
    while high < 3.0 && power(high) < 1.0 / f {
        (low, high) = (high, 1.2 * high);
    }
    let reached = power(high);
    if reached.is_nan() || reached < 1.0 / f {
        return None;
    }
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if power(middle) < 1.0 / f { low = middle } else { high = middle }
    }
    let mut numbers = scaled(high);
    let first = paraxial::first_order(&numbers, numbers.wavelengths.primary_nm);
    let last = count - 1;
    if let Some(j) = variable(problem, Kind::Thickness, last) {
        let [low, high] = problem.bounds[j];
        if !(low..=high).contains(&first.paraxial_image_distance) {
            return None;
        }
        numbers.surfaces[last].thickness = first.paraxial_image_distance;
    }
    for c in &problem.constraints {
        let value = match c.quantity {
            Quantity::Track => numbers.length(),
            Quantity::BackFocus => numbers.surfaces[last].thickness,
            _ => continue,
        };
        // A little room: improvement brings it back.
        if value < 0.9 * c.bounds[0] || value > 1.1 * c.bounds[1] {
            return None;
        }
    }
    Some(numbers)
}

/// Third-order aberrations weighed against each other, and how strongly surfaces are bent; smaller is better.
fn score(numbers: &Prescription) -> Option<f64> {
    let first = paraxial::first_order(numbers, numbers.wavelengths.primary_nm);
    let height = 0.5 * first.entrance_pupil_diameter;
    let field = numbers.max_field_deg().to_radians().min(1.2).tan();
    let n = numbers.indices(numbers.wavelengths.primary_nm);
    // Marginal and chief ray, for incidences: what is bent strongly has high orders.
    let (mut y, mut u, mut yc, mut uc) = (height, 0.0, -field * first.entrance_pupil_position, field);
    let mut sum = [0.0f64; 5];
    let invariant = n[0] * height * field;
    let mut bends = 0.0;
    for (i, s) in numbers.surfaces.iter().enumerate() {
        let (before, after, c) = (n[i], n[i + 1], s.shape.curvature);
        let (incidence, chief) = (u + y * c, uc + yc * c);
        let (a, b) = (before * incidence, before * chief);
        let u_after = (before * u - y * (after - before) * c) / after;
        let uc_after = (before * uc - yc * (after - before) * c) / after;
        let delta = u_after / after - u / before;
        sum[0] += a * a * y * delta;
        sum[1] += a * b * y * delta;
        sum[2] += b * b * y * delta;
        sum[3] += invariant * invariant * c * (before - after) / (before * after);
        let dispersion = |m: &Medium| {
            let [short, long] = numbers.wavelengths.ends_nm();
            m.index(short) - m.index(long)
        };
        let behind = dispersion(&s.medium) / after;
        let ahead = dispersion(numbers.medium_before(i)) / before;
        sum[4] += a * y * (behind - ahead);
        bends += incidence.powi(4) + chief.powi(4);
        (u, uc) = (u_after, uc_after);
        y += s.thickness * u;
        yc += s.thickness * uc;
        let reach = (y.abs() + yc.abs()) * c.abs();
        if reach > 1.0 {
            return None;
        }
    }
    let total: f64 = sum.iter().map(|s| s.abs()).sum::<f64>();
    let score = total + 0.05 * height * bends;
    score.is_finite().then_some(score)
}

/// Clear semi-diameters by paraxial rays, and gaps wide enough that surfaces do not cross there.
fn room(problem: &Problem, numbers: &mut Prescription) {
    if problem.merit.apertures == Apertures::Stated {
        return;
    }
    let height = paraxial::marginal_heights(numbers, numbers.wavelengths.primary_nm);
    for (i, h) in height.iter().enumerate() {
        let reach = 0.95 * numbers.surfaces[i].shape.reach();
        numbers.surfaces[i].semi_diameter = (1.05 * h).max(1e-3).min(reach);
    }
    for i in 0..numbers.surfaces.len().saturating_sub(1) {
        let r = numbers.surfaces[i].semi_diameter.min(numbers.surfaces[i + 1].semi_diameter);
        let sag = |k: usize| numbers.surfaces[k].shape.sag(r * r).map_or(0.0, |s| s.h);
        let edge = numbers.surfaces[i].thickness + sag(i + 1) - sag(i);
        if edge < 0.1 && variable(problem, Kind::Thickness, i).is_some() {
            numbers.surfaces[i].thickness += 0.1 - edge;
        }
    }
}

/// `lens` with every variable displaced by up to `size` of its range or of what bends light.
fn displaced(problem: &Problem, lens: &Lens, size: f64, rng: &mut fastrand::Rng) -> Option<Lens> {
    let f = focal_length(problem);
    let mut numbers = (**lens).clone();
    for (p, [low, high]) in problem.variables.parameters.iter().zip(&problem.bounds) {
        let draw = 2.0 * rng.f64() - 1.0;
        let Parameter { kind, of, entry } = *p;
        let Some(value) = p.value(&**lens) else { continue };
        let scale = match kind {
            Kind::Curvature => 2.0 / f,
            Kind::Thickness => 0.1 * f,
            _ if low.is_finite() && high.is_finite() => high - low,
            _ => 0.0,
        };
        if let Some(number) = kind.list_mut(&mut numbers, of).get_mut(entry) {
            *number = (value + size * scale * draw).clamp(*low, *high);
        }
    }
    room(problem, &mut numbers);
    problem.made(numbers).ok()
}
