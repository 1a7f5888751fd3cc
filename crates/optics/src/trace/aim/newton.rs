//! Newton on the launch ray: `S(p) = s`, forward through the lens, with the Jacobian from ray differentials.

use glam::{DMat2, DVec2};

use super::super::differential::{RayDot, trace_jvp};
use super::super::object::LaunchPlane;
use super::super::sequential::{Hit, trace};
use super::super::{Cause, Failure, Ray, System};

/// Aimed to this distance in the stop, relative to its semi-diameter.
const TOLERANCE: f64 = 1e-12;
/// Accepted where rounding lets no step come nearer, relative to the stop's semi-diameter.
const ROUNDING: f64 = 1e-9;
const ITERATIONS: usize = 30;
/// Given up where so many steps win less than this part of the distance: shortened more than eightfold, they end at the edge of what
/// gets through.
const STALLED: (usize, f64) = (4, 0.2);

/// A family of launch rays with two coordinates.
pub(super) trait Launching {
    /// The ray of `p`.
    fn ray(&self, p: DVec2) -> Ray;
    /// Its derivative with respect to both coordinates.
    fn columns(&self, ray: &Ray) -> [RayDot; 2];
}

impl Launching for LaunchPlane {
    #[inline]
    fn ray(&self, p: DVec2) -> Ray {
        Self::ray(self, p)
    }

    #[inline]
    fn columns(&self, ray: &Ray) -> [RayDot; 2] {
        self.ray_columns(ray).map(|(point, direction)| RayDot { point, direction })
    }
}

/// A launch ray that meets its target.
#[derive(Clone, Copy, Debug)]
pub(super) struct Solved {
    /// Its coordinates.
    pub(super) p: DVec2,
    /// Distance from the target in the stop, relative to the stop's semi-diameter.
    pub(super) residual: f64,
    /// Rays traced.
    pub(super) iterations: u32,
    /// Whether the launch plane is seen upright in the stop: on the branch of the axis it is. A folded pupil is not.
    pub(super) upright: bool,
}

/// From `start` to the launch ray that meets the stop at `target`; `hits` are its own, the stop's last.
pub(super) fn solve(
    system: &System,
    launching: &impl Launching,
    target: DVec2,
    start: DVec2,
    hits: &mut Vec<Hit>,
) -> Result<Solved, Failure> {
    let stop = system.stop;
    let scale = system.stop_semi_diameter;
    let lost = Failure { cause: Cause::NotConverged, surface: stop };
    let (mut p, mut ray) = (start, launching.ray(start));
    let (mut iterations, mut upright) = (1, true);
    let mut miss = trace(system, ray, stop, hits)?.at.point.truncate() - target;
    let (mut before, mut factor) = ([f64::INFINITY; STALLED.0], 1.0);
    // Written so that a NaN is never accepted.
    for k in 0..ITERATIONS {
        if miss.length() <= TOLERANCE * scale {
            return Ok(Solved { p, residual: miss.length() / scale, iterations, upright });
        }
        let distance = miss.length();
        if distance > ROUNDING * scale && distance > (1.0 - STALLED.1) * before[k % STALLED.0] {
            return Err(lost);
        }
        before[k % STALLED.0] = distance;
        let jacobian = stop_jacobian(system, launching, &ray, hits);
        upright = jacobian.determinant() > 0.0;
        let step = jacobian.inverse() * miss;
        if !step.is_finite() {
            return Err(lost);
        }
        // Halve the step while it loses the ray or the distance; what was shortened before begins short.
        factor = f64::min(1.0, 4.0 * factor);
        loop {
            let trial = p - factor * step;
            let trial_ray = launching.ray(trial);
            iterations += 1;
            match trace(system, trial_ray, stop, hits).map(|h| h.at.point.truncate() - target) {
                Ok(m) if m.length() < miss.length() => {
                    (p, ray, miss) = (trial, trial_ray, m);
                    break;
                }
                _ if factor > 1e-3 && miss.length() > ROUNDING * scale => factor *= 0.5,
                // No better point: rounding at the solution is accepted, anything else is not.
                _ => {
                    trace(system, ray, stop, hits)?;
                    let residual = miss.length() / scale;
                    return if residual <= ROUNDING {
                        Ok(Solved { p, residual, iterations: iterations + 1, upright })
                    } else {
                        Err(lost)
                    };
                }
            }
        }
    }
    Err(lost)
}

/// `∂(stop point)/∂p` at a traced ray.
pub(super) fn stop_jacobian(system: &System, launching: &impl Launching, ray: &Ray, hits: &[Hit]) -> DMat2 {
    let [a, b] = launching.columns(ray).map(|dot| trace_jvp(system, &hits[..=system.stop], dot).point.truncate());
    DMat2::from_cols(a, b)
}
