//! Rays that lanes cannot be certain of: proved to be right after all, or one by one through the plain trace.

use glam::DVec3;

use super::program::Step;
use super::prove::prove;
use super::run::{Extra, Mode, Run};
use super::tile::AXIAL;
use crate::trace::ideal::Ideal;
use crate::trace::intersect::{Intersection, gradient, intersect};
use crate::trace::refract::refract;
use crate::trace::{Cause, Failure, Ray};
use isoplanat_base::math::simd::Simd;

/// What lanes know of rays that did not get through, one bit per lane.
#[derive(Clone, Copy)]
pub(super) struct Known {
    /// The intersection stands if it lies within the domain.
    pub(super) sound: u64,
    /// There is a root, which may be proved to be the first.
    pub(super) found: u64,
    /// What stands gets through the aperture and is refracted.
    pub(super) through: u64,
    /// There is none.
    pub(super) missed: u64,
}

/// Lanes `at + i` for every bit `i` of `bad`: the cause where it is known, the plain trace where it is not.
///
/// `from` must still hold the rays before the surface.
#[cold]
#[inline(never)]
pub(super) fn mend<S: Simd, M: Mode>(simd: S, step: &Step, run: &mut Run, at: usize, bad: u64, known: Known) {
    let proved = if step.bends.is_some() { prove(simd, step, run, at, bad & known.found) } else { 0 };
    let mut left = bad & !(proved & known.through);
    while left != 0 {
        let i = left.trailing_zeros() as usize;
        left &= left - 1;
        let (x, y) = (run.to.x[at + i], run.to.y[at + i]);
        let rho = x * x + y * y;
        let sound = (known.sound >> i) & 1 == 1 && rho <= step.domain_sq && rho.is_finite();
        let met = sound || (proved >> i) & 1 == 1;
        if (known.missed >> i) & 1 == 1 {
            fail::<M>(step, run, at + i, Cause::Missed);
        } else if met && beyond(rho, step) {
            fail::<M>(step, run, at + i, Cause::Vignetted);
        } else if met {
            // It lies within the aperture: what is left is the root of Snell's law.
            fail::<M>(step, run, at + i, Cause::TotalReflection);
        } else {
            one_ray::<M>(step, run, at + i);
        }
    }
}

/// Beyond the clear aperture; an aperture without a number lets nothing through.
fn beyond(rho: f64, step: &Step) -> bool {
    step.clip_sq.is_nan() || rho > step.clip_sq
}

/// A surface that is not for lanes: every living ray through the plain trace.
pub(super) fn one_by_one<M: Mode>(step: &Step, run: &mut Run) {
    for lane in 0..run.len {
        if (*run.alive >> lane) & 1 == 1 {
            one_ray::<M>(step, run, lane);
        } else {
            run.to.set(lane, AXIAL);
        }
    }
}

fn one_ray<M: Mode>(step: &Step, run: &mut Run, lane: usize) {
    let mu = if M::SPECTRAL { step.ratios[run.colour[lane] as usize] } else { step.mu };
    match through(step, mu, run.from.ray(lane)) {
        Err(cause) => fail::<M>(step, run, lane, cause),
        Ok((at, incoming, ray, added)) => {
            run.to.set(lane, ray);
            if M::PATH {
                run.to.path[lane] = run.from.path[lane] + step.surface.index_before * at.t + added;
            }
            if M::RECORD {
                record(step, run, lane, &at, incoming);
                if !run.extra().is_finite(lane) {
                    // The ray touches the surface: it has no derivative.
                    fail::<M>(step, run, lane, Cause::Missed);
                }
            }
        }
    }
}

/// The plain trace of one surface: the hit, the direction before it in the surface's own frame, the ray behind it in the
/// nominal frame, the optical path that an ideal lens adds.
fn through(step: &Step, mu: f64, ray: Ray) -> Result<(Intersection, DVec3, Ray, f64), Cause> {
    let surface = &step.surface;
    let (mut origin, mut direction) = (ray.origin, ray.direction);
    origin.z -= surface.distance;
    if let Some(m) = &surface.motion {
        let back = m.rotation.transpose();
        (origin, direction) = (back * (origin - m.shift), back * direction);
    }
    let at = intersect(surface, origin, direction)?;
    if beyond(at.point.x * at.point.x + at.point.y * at.point.y, step) {
        return Err(Cause::Vignetted);
    }
    let (incoming, mut path) = (direction, 0.0);
    if let Some(ideal) = Ideal::of(surface) {
        (direction, path) = ideal.bend(at.point.truncate(), incoming).ok_or(Cause::Missed)?;
    } else if mu != 1.0 {
        let g = gradient(&at);
        let mut normal = g / g.length();
        if normal.dot(direction) > 0.0 {
            normal = -normal;
        }
        direction = refract(direction, normal, mu).ok_or(Cause::TotalReflection)?;
    }
    let mut point = at.point;
    if let Some(m) = &surface.motion {
        (point, direction) = (m.rotation * point + m.shift, m.rotation * direction);
    }
    Ok((at, incoming, Ray { origin: point, direction }, path))
}

/// Writes what the adjoint needs of a ray that the plain trace took through a surface with even terms.
fn record(step: &Step, run: &mut Run, lane: usize, at: &Intersection, incoming: DVec3) {
    let (x, y, phi) = (at.point.x, at.point.y, at.local.sag.phi);
    let rho = x * x + y * y;
    let slope = step.terms1.iter().rev().fold(0.0, |sum, a| sum * rho + a);
    let a = step.c + slope * phi;
    let normal = DVec3::new(a * x, a * y, -phi);
    let q = -normal.dot(incoming);
    let mu = step.mu;
    let root = (step.mu_sq * q * q + step.under * normal.length_squared()).sqrt();
    run.to.t[lane] = at.t;
    let extra = run.extra();
    extra.gamma[lane] = if step.refracts { step.over / (mu * q + root) } else { 0.0 };
    extra.inverse_r[lane] = if step.refracts { 1.0 / root } else { 0.0 };
    extra.inverse_q[lane] = 1.0 / q;
    extra.w[lane] = at.local.sag.conic_h;
    extra.slope[lane] = slope;
}

impl Extra {
    fn is_finite(&self, lane: usize) -> bool {
        let all = [&self.gamma, &self.inverse_r, &self.inverse_q, &self.w, &self.slope];
        all.into_iter().all(|array| array[lane].is_finite())
    }

    fn clear(&mut self, lane: usize) {
        let all = [&mut self.gamma, &mut self.inverse_r, &mut self.inverse_q, &mut self.w, &mut self.slope];
        all.into_iter().for_each(|array| array[lane] = 0.0);
    }
}

/// Notes the failure and leaves finite placeholders on both sides of the surface.
fn fail<M: Mode>(step: &Step, run: &mut Run, lane: usize, cause: Cause) {
    *run.alive &= !(1 << lane);
    run.status[lane] = Some(Failure { cause, surface: step.index });
    if !run.from.is_finite(lane) {
        run.from.set(lane, AXIAL);
    }
    run.to.set(lane, AXIAL);
    if M::PATH {
        run.to.path[lane] = 0.0;
    }
    if M::RECORD {
        run.to.t[lane] = 0.0;
        run.extra().clear(lane);
    }
}
