//! Rays aimed at a point of the real stop, with the implicit derivative of the aiming.
//!
//! The unknowns are the two coordinates `p` of the launch ray: the point `e` of the first vertex plane for a field
//! point in slopes ([`aim`]), the point of a plane perpendicular to the light for an object at any angle ([`Aimer`]).
//! Newton on `S(p) = s` from the paraxial entrance pupil (`aim/newton.rs`) settles the ordinary ray in a few traces. Where it
//! fails (wide angles, fast lenses: the first guess misses a surface) the light is followed backwards from the stop
//! (`aim/backward.rs`), walking from the axis to the field, and Newton only confirms. At the solution
//! `δp = −S_p⁻¹ (S_θ δθ)`: [`aim_vjp`], [`aimed_vjp`].

mod aimer;
mod backward;
mod newton;
mod paraxial;
mod sensor;

use glam::{DVec2, DVec3};

pub use aimer::{Aimed, AimedBar, Aimer, aimed_vjp};
use backward::Front;
use newton::{solve, stop_jacobian};
pub use paraxial::ParaxialPupil;
pub use sensor::{Crossings, SceneRay, SceneRayBar, SensorView};

use super::launch::{FieldPoint, launch, launch_vjp};
use super::object::ObjectPoint;
use super::sequential::{Hit, HitBar, trace_vjp};
use super::{Failure, System, SystemGradient};

/// The point on the first vertex plane whose ray meets the stop at `target` (mm); `hits` ends with the stop.
///
/// `start` is a first guess (a neighbouring ray's); without one, or where it fails, the paraxial pupil's is taken, and
/// where that fails the ray is found backwards from the stop.
pub fn aim(
    system: &System,
    pupil: ParaxialPupil,
    field: FieldPoint,
    target: DVec2,
    start: Option<DVec2>,
    hits: &mut Vec<Hit>,
) -> Result<DVec2, Failure> {
    let mut forward = None;
    for guess in start.into_iter().chain([pupil.guess(field, target)]) {
        match solve(system, &field, target, guess, hits) {
            Ok(s) if s.upright => return Ok(s.p),
            other => forward = forward.or(Some(other)),
        }
    }
    let object = ObjectPoint::from_field(field);
    let backward = Front::new(system).and_then(|front| front.search(object, target)).and_then(|found| {
        let n = found.direction;
        // Its point on the first vertex plane, if it has one.
        let e = found.point.truncate() - n.truncate() * (found.point.z / n.z);
        solve(system, &field, target, e, hits)
    });
    match (backward, forward) {
        (Ok(s), _) => Ok(s.p),
        // A ray that reaches its point on a folded pupil is a ray still.
        (Err(_), Some(Ok(s))) => solve(system, &field, target, s.p, hits).map(|s| s.p),
        (Err(failure), _) => {
            hits.clear();
            Err(failure)
        }
    }
}

/// Cotangents that leave [`aim_vjp`].
pub struct AimBar {
    /// Of the field's slope.
    pub slope: DVec2,
    /// Of the target point in the stop.
    pub target: DVec2,
}

/// Pulls a cotangent on the aimed `e` back to the system (added to `out`), the slope and the target.
///
/// `hits` are those of the aimed ray up to the stop at least.
pub fn aim_vjp(
    system: &System,
    field: FieldPoint,
    e: DVec2,
    hits: &[Hit],
    e_bar: DVec2,
    out: &mut SystemGradient,
) -> AimBar {
    let ray = launch(field, e);
    let lambda = stop_jacobian(system, &field, &ray, hits).transpose().inverse() * e_bar;
    let mut bars = vec![HitBar::default(); system.stop + 1];
    bars[system.stop].point = DVec3::new(-lambda.x, -lambda.y, 0.0);
    let (o, d) = trace_vjp(system, hits, &bars, out);
    let (_, slope) = launch_vjp(field, ray, o, d);
    AimBar { slope, target: lambda }
}

#[cfg(test)]
mod tests;
