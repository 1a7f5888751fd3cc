//! Choice of glass: index and Abbe number move freely within what glasses have, then one element after the other takes the real glass
//! that does best among the nearest, the others still free, and everything is improved again.

use super::constraint::{Constraint, Quantity};
use super::finish::Outcome;
use super::pool::Pool;
use super::problem::{KEPT, Limits, Problem};
use super::{Step, optimize};
use crate::lens::{Kind, Lens, Medium, Parameter};
use isoplanat_base::error::{Error, Location, Result};

/// Real glasses that are tried for each element.
const TRIED: usize = 4;

/// `problem` with the glasses behind `surfaces` replaced by two free numbers, kept where glasses are: `n_d` 1.45 to 1.95, Abbe number
/// 18 to 90, below the line of lanthanum crowns and fluor crowns.
///
/// # Errors
/// A surface with air behind it.
pub(crate) fn freed(problem: &Problem, surfaces: &[usize]) -> Result<Problem> {
    let name = problem.lens.file();
    let count = problem.lens.surfaces.len();
    for i in surfaces {
        if problem.lens.surfaces.get(*i).is_none_or(|s| s.medium == Medium::Air) {
            let allowed = format!("a surface from 0 to {} with glass behind it", count - 1);
            return Err(Error::bad(name, Location::surface(*i).key("medium"), "no glass", allowed));
        }
    }
    let lens = problem.lens.changed(|l| {
        for i in surfaces {
            let [n_d, v_d] = l.surfaces[*i].medium.pair();
            l.surfaces[*i].medium = Medium::Cauchy { n_d: n_d.clamp(1.45, 1.95), v_d: v_d.clamp(18.0, 90.0) };
        }
    })?;
    let known = |kind: Kind, i: usize| problem.variables.parameters.iter().any(|p| p.kind == kind && p.of == i);
    let mut parameters = problem.variables.parameters.clone();
    let mut bounds = problem.bounds.clone();
    let mut constraints = problem.constraints.clone();
    for i in surfaces {
        for kind in [Kind::Index, Kind::Abbe] {
            if !known(kind, *i) {
                parameters.push(kind.at(*i));
                bounds.push(Problem::bounds_of(&lens, kind.at(*i)));
            }
        }
        constraints.push(Constraint { quantity: Quantity::GlassLine(*i), bounds: [f64::NEG_INFINITY, 0.0] });
    }
    let free = Problem::new(&lens, parameters, constraints, problem.merit.clone());
    Ok(Problem { bounds, targets: problem.targets.clone(), ..free })
}

/// The lens with the glasses behind `surfaces` chosen among those of `pool` that are known over its wavelengths.
///
/// # Errors
/// As [`optimize`]; no glass that covers the lens's wavelengths.
pub fn choose(
    problem: &Problem,
    surfaces: &[usize],
    pool: &Pool,
    limits: Limits,
    watch: &mut dyn FnMut(Step) -> bool,
) -> Result<Outcome> {
    let real = pool.of_lens(&problem.lens)?;
    let mut free = freed(problem, surfaces)?;
    let mut best = optimize(&free, limits, watch)?;
    // Before: the start with its glasses as pairs of numbers.
    let first = best.rms_mm[0];
    let mut left = surfaces.to_vec();
    while let Some(i) = left.pop() {
        let [n, v] = best.lens.surfaces[i].medium.pair();
        let mut near: Vec<(f64, &Medium)> = real
            .iter()
            .filter(|m| pool.fits(&best.lens, i, m))
            .map(|m| {
                let [a, b] = m.pair();
                // A hundredth of the index weighs as much as three Abbe numbers.
                (((a - n) / 0.01).hypot((b - v) / 3.0), *m)
            })
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut chosen: Option<(Problem, Outcome)> = None;
        for (_, medium) in near.into_iter().take(TRIED) {
            let Ok(lens) = best.lens.changed(|l| l.surfaces[i].medium = medium.clone()) else { continue };
            let trial = fixed(&free, &lens, i);
            let Ok(outcome) = optimize(&trial, limits, watch) else { continue };
            let broken = |o: &Outcome| u8::from(o.violation > KEPT);
            let better = |o: &Outcome| {
                let less = outcome.merit_mm.total_cmp(&o.merit_mm);
                broken(&outcome).cmp(&broken(o)).then(less).is_lt()
            };
            if chosen.as_ref().is_none_or(|(_, o)| better(o)) {
                chosen = Some((trial, outcome));
            }
        }
        let Some((trial, outcome)) = chosen else {
            let found = format!("no neighbour of n_d {n:.4}, v_d {v:.1} makes a lens");
            return Err(Error::bad(problem.lens.file(), Location::surface(i).key("medium"), found, "other bounds"));
        };
        (free, best) = (Problem { lens: outcome.lens.clone(), ..trial }, outcome);
    }
    best.rms_mm[0] = first;
    Ok(best)
}

/// `problem` from `lens` with the glass behind `surface` no longer free.
fn fixed(problem: &Problem, lens: &Lens, surface: usize) -> Problem {
    let stays = |p: &Parameter| !(p.of == surface && p.kind.is_glass());
    let all = problem.variables.parameters.iter().zip(&problem.bounds).filter(|(p, _)| stays(p));
    let (parameters, bounds): (Vec<Parameter>, Vec<[f64; 2]>) = all.map(|(p, b)| (*p, *b)).unzip();
    let constraints =
        problem.constraints.iter().filter(|c| c.quantity != Quantity::GlassLine(surface)).cloned().collect();
    let targets = problem.targets.clone();
    Problem { bounds, targets, ..Problem::new(lens, parameters, constraints, problem.merit.clone()) }
}
