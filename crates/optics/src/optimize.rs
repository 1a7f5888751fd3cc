//! A lens made better: damped least squares on real rays, with bounds and constraints held by an active set.
//!
//! [`Problem`] says what moves, what is held and what is judged; [`optimize`] returns the best lens that keeps its constraints, with
//! the reason why it stopped, what moved and which bounds hold it back. [`search`] starts from many lenses, [`glass`] ends with real
//! glasses; [`sensitivity`] says what deviations cost.
//!
//! **Rays** are aimed at the real stop and stay aimed as the lens moves; what that does to them is part of the derivatives
//! (module `rays`). Paraxially launched rays would cost half as much, but fill another pupil than the lens has as soon as
//! the pupil has aberrations. Object points stay where the start lens has them. A merit is the mean over object points of the mean
//! square distance (or path difference), so its root is an rms spot in mm.
//!
//! **Constraints** are no penalties: each step solves a quadratic program in which they are linear ([`quadratic`](self), module
//! `quadratic`, which says why no library does), and their multipliers say what each of them costs. Steps are damped after
//! Marquardt, corrected to second order for the constraints before any ray is traced, and judged by an exact penalty whose weights follow
//! the multipliers (Nocedal and Wright, Numerical Optimization, 2nd ed., chapters 10, 16, 18). Constraints that contradict each other
//! end in the smallest violation, and say so.
//!
//! **Targets** ([`Target`]) are for what is wanted without being held: their deviations, times weights that say how many mm of rms a
//! unit of them is worth, are further residuals.
//!
//! **Starts whose rays fail** are improved at a smaller aperture and field first, which grow while all rays arrive.
//!
//! ```
//! use isoplanat_optics::lens::builtin;
//! use isoplanat_optics::optimize::{Limits, Problem, optimize};
//!
//! let lens = builtin::lens("cooke_triplet")?;
//! let problem = Problem::standard(&lens);
//! let found = optimize(&problem, Limits { iterations: 30, ..Limits::default() }, &mut |_| true)?;
//! assert!(found.rms_mm[1] < 0.95 * found.rms_mm[0]);
//! # Ok::<(), isoplanat_base::error::Error>(())
//! ```

pub(crate) mod constraint;
#[doc(hidden)]
pub mod descent;
mod engine;
mod finish;
pub mod first_order;
pub mod glass;
pub(crate) mod merit;
pub(crate) mod pattern;
#[doc(hidden)]
pub mod pool;
mod problem;
mod quadratic;
mod rays;
mod residuals;
pub(crate) mod sampling;
pub mod search;
pub mod sensitivity;
mod solver;
#[doc(hidden)]
pub mod spec;
mod standard;

pub use constraint::{Constraint, Quantity, Target};
pub use finish::{Active, Moved, Outcome, Valued};
pub use merit::{Apertures, Merit, Quality, Reference};
#[doc(hidden)]
pub use pattern::parameters;
pub use problem::{Limits, Problem, Step, Stop};
#[doc(hidden)]
pub use solver::Refused;

use crate::lens::{Kind, Lens};
use isoplanat_base::error::{Error, Result};
use solver::{Solved, Solver};

/// Shares of aperture and field that are tried for a start whose rays fail.
const SHARES: [f64; 6] = [1.0, 0.8, 0.6, 0.4, 0.2, 0.1];

/// Improves the lens of `problem`; `watch` is told of every step and may end the work by `false`.
///
/// # Errors
/// A merit that is none, variables without bounds, a lens through which not even a tenth of its aperture passes at a tenth of
/// its field.
pub fn optimize(problem: &Problem, limits: Limits, watch: &mut dyn FnMut(Step) -> bool) -> Result<Outcome> {
    problem.check()?;
    let started = std::time::Instant::now();
    let mut lens = problem.lens.clone();
    let mut last: Option<Solved> = None;
    let mut first_rms = None;
    let (mut iterations, mut rays) = (0, 0);
    let mut reached = 0.0;
    // The largest share all of whose rays arrive, then larger ones, each from the lens before.
    let mut trials = SHARES.iter().copied();
    let mut share = trials.next().unwrap_or(1.0);
    let mut increase = 0.2;
    loop {
        match Solver::new(problem, &lens, share) {
            Ok((mut solver, traced)) => {
                rays = solver.rays();
                let short = Limits { iterations: limits.iterations.min(12), tolerance: 1e-3, ..limits };
                let own = if share >= 1.0 { limits } else { short };
                let solved = solver.run(&lens, traced, own, watch);
                iterations += solved.iterations;
                reached = share;
                if first_rms.is_none() {
                    first_rms = Some(solved.rms[0]);
                }
                let stopped = matches!(solved.stop, Stop::Time | Stop::Asked);
                let next = problem.stands(&solved.numbers, &solved.heights);
                if next.is_err() && last.is_some() {
                    break;
                }
                lens = next?;
                last = Some(solved);
                if share >= 1.0 || stopped {
                    break;
                }
                share = (share + increase).min(1.0);
            }
            // Not yet: nearer to what the lens lets through.
            Err(_) if last.is_some() => {
                increase *= 0.5;
                share = (reached + increase).min(1.0);
                if increase < 0.02 {
                    break;
                }
            }
            Err(failure) => match trials.next() {
                Some(smaller) => share = smaller,
                None => {
                    let found = format!("a ray {} at surface {}", failure.cause.name(), failure.surface);
                    let allowed = "a lens that lets a tenth of its aperture through at a tenth of its field";
                    return Err(Error::bad(problem.lens.file(), "start", found, allowed));
                }
            },
        }
    }
    let Some(solved) = last else {
        return Err(Error::bad(problem.lens.file(), "start", "no step", "a lens that light passes"));
    };
    Ok(finish::outcome(problem, lens, solved, finish::Spent { iterations, rays, reached, first_rms, started }))
}

/// How far behind the last surface a focus is looked for, of the lens's length and width.
const FOCUS: [f64; 2] = [1e-6, 1e4];

/// `lens` with its sensor where `merit` is least: nothing else moves.
///
/// ```
/// use isoplanat_optics::lens::builtin;
/// use isoplanat_optics::optimize::{Merit, refocused};
///
/// let lens = builtin::lens("cooke_triplet")?;
/// let found = refocused(&lens.changed(|l| l.surfaces[5].thickness += 0.5)?, Merit::default())?;
/// // The sensor goes back to where it was, nearly.
/// assert!((found.lens.surfaces[5].thickness - lens.surfaces[5].thickness).abs() < 0.2);
/// # Ok::<(), isoplanat_base::error::Error>(())
/// ```
///
/// # Errors
/// As [`optimize`]; a lens through which not all rays of the merit come, or behind which they do not come together.
pub fn refocused(lens: &Lens, merit: Merit) -> Result<Outcome> {
    let sensor = Kind::Thickness.at(lens.surfaces.len() - 1);
    let mut problem = Problem::new(lens, vec![sensor], Vec::new(), merit);
    let widest = lens.surfaces.iter().map(|s| s.semi_diameter).fold(0.0, f64::max);
    let [near, far] = FOCUS.map(|share| share * lens.length().max(widest));
    problem.bounds = vec![[near, far]];
    let found = optimize(&problem, Limits::default(), &mut |_| true)?;
    let at = found.lens.surfaces[sensor.of].thickness;
    if at <= 2.0 * near || at >= 0.5 * far {
        let allowed = "an object whose light comes together behind the lens";
        return Err(Error::bad(lens.file(), "focus", format!("none from {near} to {far} mm"), allowed));
    }
    if found.share < 1.0 {
        let reached = format!("{:.0} % of aperture and field", 100.0 * found.share);
        return Err(Error::bad(lens.file(), "rays", reached, "a lens that light comes through"));
    }
    Ok(found)
}

/// The rays of `merit` through `lens`.
fn traced(lens: &Lens, merit: &Merit) -> Result<(rays::Rays, rays::Traced)> {
    merit.check(lens.file())?;
    let variables = crate::lens::variables::Variables::new(lens, Vec::new());
    let clip = merit.apertures == Apertures::Stated;
    rays::Rays::new(merit, lens, &variables, 1.0, clip).map_err(|f| {
        let found = format!("{} at surface {}", f.cause.name(), f.surface);
        Error::bad(lens.file(), "rays", found, "a lens whose stop all rays of its fields pass")
    })
}

/// The residuals of `lens`, mm: wavelength by wavelength, object point by object point, ring by ring; `x` and `y` of spots. The sum of
/// their squares is the merit.
///
/// # Errors
/// A merit that is none; a ray that fails.
pub fn residuals_of(lens: &Lens, merit: &Merit) -> Result<Vec<f64>> {
    let (rays, traced) = traced(lens, merit)?;
    Ok(residuals::residuals(&rays, &traced))
}

/// How much of each object point's light gets through the stated clear semi-diameters of `lens`: 1 where they follow the beam.
///
/// # Errors
/// As [`residuals_of`].
pub fn light_of(lens: &Lens, merit: &Merit) -> Result<Vec<f64>> {
    Ok(traced(lens, merit)?.0.light)
}

/// Root of the merit of `lens`, mm: the rms over object points of the rms distance (or path difference).
///
/// # Errors
/// As [`residuals_of`].
pub fn merit_of(lens: &Lens, merit: &Merit) -> Result<f64> {
    Ok(residuals_of(lens, merit)?.iter().map(|r| r * r).sum::<f64>().sqrt())
}

#[cfg(test)]
mod tests;
