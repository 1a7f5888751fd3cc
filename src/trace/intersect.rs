//! Ray ∩ surface, in the surface's vertex frame.
//!
//! The ray first advances to the vertex plane, so that a far origin costs no digits. Plane, sphere and conic: exact
//! root, `t = C / (B + √(B² − AC))`. Aspheres: from the base conic, Newton on eq. (6) safeguarded by a step limit.
//! The pull-back uses the implicit function theorem at the root, never the iterations.
//! Not covered yet: proof that the root is the first one.

use glam::DVec3;

use super::{Cause, system::TraceSurface};
use crate::lens::shape::Sag;

/// A point on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intersection {
    /// Point, mm.
    pub point: DVec3,
    /// Distance from the ray's origin along its direction, mm.
    pub t: f64,
    /// Sag and derivatives there.
    pub sag: Sag,
}

/// Newton iterations before a ray counts as not converged.
const ITERATIONS: usize = 40;

/// Intersects the ray `origin + t·direction` with `surface`.
#[inline]
pub fn intersect(surface: &TraceSurface, origin: DVec3, direction: DVec3) -> Result<Intersection, Cause> {
    let DVec3 { x: l, y: m, z: n } = direction;
    if n == 0.0 {
        return Err(Cause::Missed);
    }
    // Advance to the vertex plane.
    let t0 = -origin.z / n;
    let (x0, y0) = (origin.x + t0 * l, origin.y + t0 * m);
    let shape = &surface.shape;
    let (c, k) = (shape.curvature, shape.conic);
    // Exact root on the base conic; none there leaves the vertex plane as the start of an asphere.
    let a = c * (1.0 + k * n * n);
    let b = n - c * (x0 * l + y0 * m);
    let cc = c * (x0 * x0 + y0 * y0);
    let disc = b * b - a * cc;
    let on_conic = if disc >= 0.0 { Some(cc / (b + disc.sqrt().copysign(n))) } else { None };
    let mut s = match on_conic {
        Some(s) if s.is_finite() => s,
        _ if surface.aspheric => 0.0,
        _ => return Err(Cause::Missed),
    };
    let at = |s: f64| DVec3::new(x0 + s * l, y0 + s * m, s * n);
    if !surface.aspheric {
        let mut p = at(s);
        let sag = shape.sag(p.x * p.x + p.y * p.y).ok_or(Cause::Missed)?;
        // The other sheet of the conic is not the surface.
        if (sag.h - p.z).abs() > 1e-6 * (1.0 + p.z.abs()) {
            return Err(Cause::Missed);
        }
        p.z = sag.h;
        return Ok(Intersection { point: p, t: t0 + s, sag });
    }
    let limit = surface.semi_diameter.min(1e6);
    for _ in 0..ITERATIONS {
        let p = at(s);
        let Some(sag) = shape.sag(p.x * p.x + p.y * p.y) else { return Err(Cause::Missed) };
        let f = sag.h - p.z;
        let slope = 2.0 * sag.h1 * (p.x * l + p.y * m) - n;
        let step = (f / slope).clamp(-limit, limit);
        if !step.is_finite() {
            return Err(Cause::NotConverged);
        }
        s -= step;
        // The last Newton step is quadratic: one below 1e-9 mm leaves rounding only.
        if step.abs() <= 1e-9 {
            let mut p = at(s);
            let sag = shape.sag(p.x * p.x + p.y * p.y).ok_or(Cause::Missed)?;
            p.z = sag.h;
            return Ok(Intersection { point: p, t: t0 + s, sag });
        }
    }
    Err(Cause::NotConverged)
}

/// Cotangents that leave [`intersect_vjp`].
pub struct IntersectBar {
    /// Of the ray's origin.
    pub origin: DVec3,
    /// Of its direction.
    pub direction: DVec3,
    /// Of the sag: `λ`.
    pub sag: f64,
}

/// Pulls cotangents on the point and on `t` back: `λ = −(p̄·d + t̄)/(∇F·d)`, `ō = p̄ + λ∇F`, `d̄ = t ō`, `h̄ = λ`.
#[inline]
pub fn intersect_vjp(hit: &Intersection, direction: DVec3, point_bar: DVec3, t_bar: f64) -> IntersectBar {
    let gradient = gradient(hit);
    let lambda = -(point_bar.dot(direction) + t_bar) / gradient.dot(direction);
    let origin = point_bar + lambda * gradient;
    IntersectBar { origin, direction: hit.t * origin, sag: lambda }
}

/// `∇F = (2x h′, 2y h′, −1)` of `F = h(ρ) − z`.
#[inline]
pub fn gradient(hit: &Intersection) -> DVec3 {
    let h1 = 2.0 * hit.sag.h1;
    DVec3::new(h1 * hit.point.x, h1 * hit.point.y, -1.0)
}
