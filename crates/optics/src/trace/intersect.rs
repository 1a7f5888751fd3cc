//! Ray ∩ surface, in the surface's vertex frame: the first root, or none.
//!
//! Light goes from before a surface (`F = h − z > 0`) to behind it. The ray first advances to its point nearest the
//! vertex, so that a far origin costs no digits. Plane, sphere and conic: exact root,
//! `t = C / (B + √(B² − AC))`, for every direction, also across and against the axis. Everything else: from the base
//! conic, Newton on eq. (6); the root is taken if it is certainly the only one in the surface's cylinder
//! (`|d_xy| max|∇h| < d_z`), otherwise [`super::first_root`] searches with bounds.
//! The pull-back uses the implicit function theorem at the root, never the iterations.

use glam::DVec3;

use super::first_root::first_root;
use super::{Cause, system::TraceSurface};
use crate::lens::shape::{Local, Shape};

/// A point on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intersection {
    /// Point, mm.
    pub point: DVec3,
    /// Distance from the ray's origin along its direction, mm.
    pub t: f64,
    /// Sag and derivatives there.
    pub local: Local,
    /// Evaluations of the sag spent; 1 for exact roots.
    pub evaluations: u32,
}

/// Newton iterations before the bounded search takes over.
const ITERATIONS: u32 = 20;

/// Intersects the ray `origin + t·direction` (unit vector) with `surface`.
#[inline]
pub fn intersect(surface: &TraceSurface, origin: DVec3, direction: DVec3) -> Result<Intersection, Cause> {
    // The point of the ray nearest the vertex.
    let t0 = -origin.dot(direction);
    let near = origin + t0 * direction;
    // A ray with no numbers meets nothing.
    if !near.is_finite() {
        return Err(Cause::Missed);
    }
    let on_conic = conic_root(&surface.shape, near, direction);
    if !surface.aspheric {
        let s = on_conic.ok_or(Cause::Missed)?;
        let mut point = near + s * direction;
        // The edge itself has no normal: `at` refuses it.
        let local = surface.shape.at(point.x, point.y).ok_or(Cause::Missed)?;
        point.z = local.h;
        return Ok(Intersection { point, t: t0 + s, local, evaluations: 1 });
    }
    let start = on_conic.unwrap_or(if direction.z == 0.0 { 0.0 } else { -near.z / direction.z });
    let (root, spent) = newton(&surface.shape, near, direction, start);
    if let Some((s, local)) = root {
        let mut point = near + s * direction;
        let sideways = direction.truncate().length();
        if point.truncate().length() <= surface.domain && sideways * surface.steepest < direction.z {
            point.z = local.h;
            return Ok(Intersection { point, t: t0 + s, local, evaluations: spent });
        }
    }
    let (s, local, searched) = first_root(surface, near, direction, -t0)?;
    let mut point = near + s * direction;
    point.z = local.h;
    Ok(Intersection { point, t: t0 + s, local, evaluations: spent + searched })
}

/// Distance from `near` to the crossing of the base conic on the sheet of the vertex; `None` if there is none.
#[inline]
pub(super) fn conic_root(shape: &Shape, near: DVec3, d: DVec3) -> Option<f64> {
    let (c, k) = (shape.curvature, 1.0 + shape.conic);
    let a = c * (1.0 + shape.conic * d.z * d.z);
    let b = d.z - c * (near.x * d.x + near.y * d.y + k * near.z * d.z);
    let cc = c * (near.x * near.x + near.y * near.y + k * near.z * near.z) - 2.0 * near.z;
    let disc = b * b - a * cc;
    if disc.is_nan() || disc < 0.0 {
        return None;
    }
    // A t² − 2B t + C = 0; the crossing from before to behind is (B − √)/A, in the form without cancellation.
    let root = disc.sqrt();
    let s = if b >= 0.0 { cc / (b + root) } else { (b - root) / a };
    (s.is_finite() && 1.0 - k * c * (near.z + s * d.z) > 0.0).then_some(s)
}

/// Newton on `F(s) = h − z` from `s` until the step is rounding; `None` where it leaves the surface or does not settle.
fn newton(shape: &Shape, near: DVec3, d: DVec3, mut s: f64) -> (Option<(f64, Local)>, u32) {
    let mut before = f64::INFINITY;
    for i in 1..=ITERATIONS {
        let p = near + s * d;
        let Some(local) = shape.at(p.x, p.y) else { return (None, i) };
        let step = (local.h - p.z) / (local.slope[0] * d.x + local.slope[1] * d.y - d.z);
        if !step.is_finite() {
            return (None, i);
        }
        // Rounding: the step is a few units in the last place of what it is made of, or no longer shrinks.
        let rounding = 4.0 * f64::EPSILON * (local.h.abs() + p.z.abs() + s.abs());
        if step.abs() <= rounding || (step.abs() >= 0.5 * before && step.abs() <= 1e4 * rounding) {
            return (Some((s, local)), i);
        }
        s -= step;
        before = step.abs();
    }
    (None, ITERATIONS)
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

/// `∇F = (∂h/∂x, ∂h/∂y, −1)` of `F = h(x, y) − z`.
#[inline]
pub fn gradient(hit: &Intersection) -> DVec3 {
    DVec3::new(hit.local.slope[0], hit.local.slope[1], -1.0)
}
