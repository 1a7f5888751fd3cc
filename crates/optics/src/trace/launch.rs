//! Field points and launch rays.
//!
//! A [`FieldPoint`] is a slope `s` (image side sign: a positive slope runs up and lands above the axis of a lens with
//! positive power) and a vergence `v`. Its ray through the point `e` of the first vertex plane runs along
//! `(v e_x + s_x, v e_y + s_y, 1)`: one formula for near and infinitely far objects. The object itself stands at
//! `−s/v` on the plane `z = −1/v`.
//!
//! Étendue: `dL dM` per unit of object slope squared is `N⁴ dx dy` on the vertex plane, exactly and for every
//! vergence; that is the weight of a ray (times `|∂e/∂(stop point)|`).

use glam::{DVec2, DVec3};

use super::Ray;

/// An object point as slope and vergence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldPoint {
    /// Slope of the ray through the first vertex.
    pub slope: DVec2,
    /// 1/distance before the first vertex, 1/mm.
    pub vergence: f64,
}

/// Ray of `field` through `e` on the first vertex plane.
#[inline]
pub fn launch(field: FieldPoint, e: DVec2) -> Ray {
    let d = DVec3::new(field.vergence * e.x + field.slope.x, field.vergence * e.y + field.slope.y, 1.0);
    Ray { origin: DVec3::new(e.x, e.y, 0.0), direction: d / d.length() }
}

/// Pulls cotangents on the launch ray back to `(e, slope)`.
#[inline]
pub fn launch_vjp(field: FieldPoint, ray: Ray, origin_bar: DVec3, direction_bar: DVec3) -> (DVec2, DVec2) {
    // d̂ = d/|d| with d_z = 1, so 1/|d| = d̂_z.
    let d = ray.direction;
    let raw = (direction_bar - d * d.dot(direction_bar)) * d.z;
    let slope_bar = raw.truncate();
    (origin_bar.truncate() + field.vergence * slope_bar, slope_bar)
}
