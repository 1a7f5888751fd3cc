//! Aiming backwards: from a point of the stop through the reversed front group to the object.
//!
//! Every ray that leaves the stop's point has the right place in the stop; the unknown is its direction `m`, sought so
//! that in the object space the ray comes from the object. The map `m ↦ object` stays smooth where the forward map's
//! first guess already misses a surface. The field is approached from the axis: object direction and target grow
//! together, each solution (and its trend) the start of the next, the step halved where it fails.

use glam::{DMat2, DVec2, DVec3};

use super::super::differential::{RayDot, trace_jvp};
use super::super::object::ObjectPoint;
use super::super::sequential::{Hit, trace};
use super::super::{Cause, Failure, Ray, System};

/// The surfaces before the stop, met from the stop's side.
pub(super) struct Front<'a> {
    system: &'a System,
    reversed: System,
}

/// A ray in object space: where it meets the first surface (frame of the first vertex), direction along the light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    /// Point, mm.
    pub(super) point: DVec3,
    /// Rays traced.
    pub(super) iterations: u32,
}

/// First step of the walk, radians of field.
const STEP: f64 = 0.3;
/// Steps grow no smaller than this part of the whole way.
const SMALLEST: f64 = 1e-4;
/// Attempts in one walk.
const ATTEMPTS: u32 = 200;
const ITERATIONS: u32 = 20;
/// Angle to the object, radians: on the way, and at the end (the forward trace settles the rest).
const ON_THE_WAY: f64 = 1e-6;
const AT_THE_END: f64 = 1e-11;

/// z turned round: between the frames of the lens and of its reverse.
fn mirror(v: DVec3) -> DVec3 {
    DVec3::new(v.x, v.y, -v.z)
}

/// A backward ray in object space, and how far its direction is from the object's.
struct Exit {
    point: DVec3,
    direction: DVec3,
    /// Direction of the object's light at `point`, and the length of `d + v e` there.
    wanted: DVec3,
    length: f64,
    miss: f64,
}

impl<'a> Front<'a> {
    /// The front group of `system`; fails if its stop is no surface of it.
    pub(super) fn new(system: &'a System) -> Result<Self, Failure> {
        let stop = system.stop;
        let Some(before) = system.surfaces.get(..stop).filter(|_| stop < system.surfaces.len()) else {
            return Err(Failure { cause: Cause::NotConverged, surface: stop });
        };
        let mut reversed = System { surfaces: Vec::with_capacity(stop), ..*system };
        let mut distance = system.surfaces[stop].distance;
        for s in before.iter().rev() {
            reversed.surfaces.push(s.reversed(distance));
            distance = s.distance;
        }
        Ok(Self { system, reversed })
    }

    /// The point `target` of the stop in the reversed frame of its nominal vertex.
    fn origin(&self, target: DVec2) -> Result<DVec3, Failure> {
        let stop = &self.system.surfaces[self.system.stop];
        let missed = Failure { cause: Cause::Missed, surface: self.system.stop };
        let local = target.extend(stop.shape.at(target.x, target.y).ok_or(missed)?.h);
        Ok(mirror(stop.motion.map_or(local, |m| m.rotation * local + m.shift)))
    }

    /// The ray from `origin` along `m`, in object space.
    fn exit(&self, object: ObjectPoint, origin: DVec3, m: DVec3, hits: &mut Vec<Hit>) -> Result<Exit, Failure> {
        let ray = Ray { origin, direction: m };
        let (point, direction) = match self.reversed.surfaces.len().checked_sub(1) {
            // No front group: the stop's own frame is the first vertex's.
            None => (origin, m),
            Some(last) => {
                let hit =
                    trace(&self.reversed, ray, last, hits).map_err(|f| Failure { surface: last - f.surface, ..f })?;
                let motion = self.reversed.surfaces[last].motion;
                motion.map_or((hit.at.point, hit.direction), |m| {
                    (m.rotation * hit.at.point + m.shift, m.rotation * hit.direction)
                })
            }
        };
        let (point, direction) = (mirror(point), -mirror(direction));
        let (wanted, length) = object.direction_at(point);
        let miss = (direction - wanted).length();
        if miss.is_finite() {
            Ok(Exit { point, direction, wanted, length, miss })
        } else {
            Err(Failure { cause: Cause::NotConverged, surface: self.system.stop })
        }
    }

    /// `∂(direction − wanted)/∂m` in the planes perpendicular to the two, and the miss there.
    fn linear(&self, object: ObjectPoint, m: DVec3, exit: &Exit, hits: &[Hit]) -> (DMat2, DVec2, [DVec3; 2]) {
        let (a, b) = m.any_orthonormal_pair();
        let (u, w) = exit.wanted.any_orthonormal_pair();
        let column = |turn: DVec3| {
            let mut dot = RayDot { point: DVec3::ZERO, direction: turn };
            if let Some(last) = self.reversed.surfaces.last() {
                dot = trace_jvp(&self.reversed, hits, dot);
                if let Some(motion) = &last.motion {
                    dot = RayDot { point: motion.rotation * dot.point, direction: motion.rotation * dot.direction };
                }
            }
            let moved = -mirror(dot.direction) - object.vergence / exit.length * mirror(dot.point);
            DVec2::new(u.dot(moved), w.dot(moved))
        };
        (DMat2::from_cols(column(a), column(b)), DVec2::new(u.dot(exit.direction), w.dot(exit.direction)), [a, b])
    }

    /// Newton on the direction from `m`; returns it with its exit and the sign of the map there.
    fn newton(
        &self,
        object: ObjectPoint,
        target: DVec2,
        start: DVec3,
        tolerance: f64,
        walk: &mut Walk,
    ) -> Result<(DVec3, Exit, bool), Failure> {
        let lost = Failure { cause: Cause::NotConverged, surface: self.system.stop };
        let origin = self.origin(target)?;
        let mut m = start;
        walk.traced += 1;
        let mut exit = self.exit(object, origin, m, &mut walk.hits)?;
        for _ in 0..ITERATIONS {
            let (jacobian, miss, [a, b]) = self.linear(object, m, &exit, &walk.hits);
            if exit.miss <= tolerance {
                return Ok((m, exit, jacobian.determinant() > 0.0));
            }
            let step = jacobian.inverse() * miss;
            if !step.is_finite() {
                return Err(lost);
            }
            // Half a radian at most, halved while it loses the ray or the angle.
            let mut factor = (0.5 / step.length()).min(1.0);
            loop {
                let trial = (m - factor * (step.x * a + step.y * b)).normalize();
                walk.traced += 1;
                match self.exit(object, origin, trial, &mut walk.hits) {
                    Ok(e) if e.miss < exit.miss => {
                        (m, exit) = (trial, e);
                        break;
                    }
                    _ if factor > 1e-3 && exit.miss > 1e-9 => factor *= 0.5,
                    // No better direction: rounding at the solution is good enough for the forward trace.
                    _ if exit.miss <= 1e-9 => {
                        exit = self.exit(object, origin, m, &mut walk.hits)?;
                        return Ok((m, exit, jacobian.determinant() > 0.0));
                    }
                    Err(f) => return Err(f),
                    Ok(_) => return Err(lost),
                }
            }
        }
        Err(lost)
    }

    /// The ray of `object` through `target` of the stop, on the branch that is connected with the axis.
    ///
    /// Field and target grow together; where that way is blocked, one grows before the other.
    pub(super) fn search(&self, object: ObjectPoint, target: DVec2) -> Result<Found, Failure> {
        let angle = object.angle();
        if !(angle.is_finite() && target.is_finite() && object.vergence.is_finite()) {
            return Err(Failure { cause: Cause::NotConverged, surface: self.system.stop });
        }
        let mut walk = Walk { hits: Vec::with_capacity(self.reversed.surfaces.len()), traced: 0 };
        // The meridian of the object; any, if it lies straight behind.
        let across = object.direction.truncate().try_normalize().unwrap_or(DVec2::X);
        let at = |field: f64, part: f64| {
            let (sin, cos) = (field * angle).sin_cos();
            let direction = if field == 1.0 { object.direction } else { (sin * across).extend(cos) };
            (ObjectPoint { direction, ..object }, part * target)
        };
        let first = self.newton(at(0.0, 0.0).0, DVec2::ZERO, DVec3::Z, ON_THE_WAY, &mut walk)?;
        let start = (first.0, first.2);
        let step = (STEP / angle).min(1.0);
        let failure = match self.walk(start, step, &|s| at(s, s), &mut walk) {
            Ok(found) => return Ok(found),
            Err(f) => f,
        };
        let first_half = |s: f64| (2.0 * s).min(1.0);
        let second_half = |s: f64| (2.0 * s - 1.0).max(0.0);
        self.walk(start, 0.5 * step, &|s| at(first_half(s), second_half(s)), &mut walk)
            .or_else(|_| self.walk(start, 0.5 * step, &|s| at(second_half(s), first_half(s)), &mut walk))
            .map_err(|_| failure)
    }

    /// Follows the solution along `at(s)` from `s = 0` (direction and sign of the map there) to 1.
    fn walk(
        &self,
        (mut last, sign): (DVec3, bool),
        first_step: f64,
        at: &dyn Fn(f64) -> (ObjectPoint, DVec2),
        walk: &mut Walk,
    ) -> Result<Found, Failure> {
        let lost = Failure { cause: Cause::NotConverged, surface: self.system.stop };
        let mut before = None::<(f64, DVec3)>;
        let (mut s, mut step) = (0.0, first_step);
        let mut failure = lost;
        for _ in 0..ATTEMPTS {
            let next = if s + 1.01 * step >= 1.0 { 1.0 } else { s + step };
            let (there, target) = at(next);
            let trend = match before {
                Some((s0, m0)) => (last + (last - m0) * ((next - s) / (s - s0))).normalize(),
                None => last,
            };
            let tolerance = if next == 1.0 { AT_THE_END } else { ON_THE_WAY };
            match self.newton(there, target, trend, tolerance, walk) {
                Ok((_, exit, sign_here)) if next == 1.0 && sign_here == sign => {
                    return Ok(Found { point: exit.point, iterations: walk.traced });
                }
                Ok((m, _, sign_here)) if sign_here == sign => {
                    before = Some((s, last));
                    (s, last) = (next, m);
                    step = (1.6 * step).min(1.0);
                }
                other => {
                    failure = other.err().unwrap_or(lost);
                    step = 0.5 * (next - s);
                    if step < SMALLEST {
                        break;
                    }
                }
            }
        }
        Err(failure)
    }
}

/// What one walk uses again and again.
struct Walk {
    hits: Vec<Hit>,
    traced: u32,
}
