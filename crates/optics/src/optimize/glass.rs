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

/// The lens with the glasses behind `surfaces` chosen among those of `pool` that are known over its wavelengths. Its own glasses stay where all of them are
/// of the pool and no others do better.
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
    let own = optimize(problem, limits, watch)?;
    let mut best = optimize(&free, limits, watch)?;
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
            if chosen.as_ref().is_none_or(|(_, o)| better(&outcome, o)) {
                chosen = Some((trial, outcome));
            }
        }
        let Some((trial, outcome)) = chosen else {
            let found = format!("no neighbour of n_d {n:.4}, v_d {v:.1} makes a lens");
            return Err(Error::bad(problem.lens.file(), Location::surface(i).key("medium"), found, "other bounds"));
        };
        (free, best) = (Problem { lens: outcome.lens.clone(), ..trial }, outcome);
    }
    let stays = surfaces.iter().all(|i| real.contains(&&problem.lens.surfaces[*i].medium));
    if stays && !better(&best, &own) {
        return Ok(own);
    }
    // Before: the lens as it was given.
    best.rms_mm[0] = own.rms_mm[0];
    for moved in &mut best.moved {
        moved.before = moved.parameter.value(&*problem.lens).unwrap_or(moved.before);
    }
    Ok(best)
}

/// Whether `a` keeps its constraints where `b` does not, or as well with less merit.
fn better(a: &Outcome, b: &Outcome) -> bool {
    let broken = |o: &Outcome| u8::from(o.violation > KEPT);
    broken(a).cmp(&broken(b)).then(a.merit_mm.total_cmp(&b.merit_mm)).is_lt()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::lens::catalogue::{Glasses, Naming};

    fn chosen(problem: &Problem, among: &[&str]) -> Outcome {
        let pool = Pool::new(Glasses::shipped(), among, "test").expect("a pool");
        choose(problem, &[0, 2, 4], &pool, Limits { iterations: 60, ..Limits::default() }, &mut |_| true)
            .expect("a lens")
    }

    /// Before is the lens as it was given, whatever stood in for its glasses on the way; its own glasses stay where no others do better.
    #[test]
    fn the_start_is_the_lens_that_was_given() {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let problem = Problem::standard(&lens);
        let own = optimize(&problem, Limits { iterations: 60, ..Limits::default() }, &mut |_| true).expect("a lens");
        // Crowns in place of the flint: whatever comes is worse.
        let worse = chosen(&problem, &["SCHOTT/N-BK7", "SCHOTT/N-K5", "N-SK16"]);
        assert_eq!(worse.rms_mm[0].to_bits(), own.rms_mm[0].to_bits());
        assert!(worse.rms_mm[1] > own.rms_mm[1], "{:?}", worse.rms_mm);
        for m in &worse.moved {
            assert_eq!(Some(m.before), m.parameter.value(&*lens), "{}", m.name);
        }
        // Its own among worse ones.
        let kept = chosen(&problem, &["N-SK16", "SCHOTT/F2", "SCHOTT/N-BK7", "SCHOTT/N-K5"]);
        assert!(kept.merit_mm <= own.merit_mm && kept.rms_mm[0] == own.rms_mm[0], "{:?}", kept.rms_mm);
        let flint = Glasses::shipped().find("SCHOTT/F2", Naming::Exact).expect("shipped");
        assert_eq!(kept.lens.surfaces[2].medium, flint);
    }
}
