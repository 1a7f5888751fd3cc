//! The loop over surfaces: [`trace`] forward, [`trace_vjp`] back.

use glam::{DMat3, DVec3};

use super::ideal::Ideal;
use super::intersect::{Intersection, gradient, intersect, intersect_vjp};
use super::refract::{refract, refract_vjp};
use super::{Cause, Failure, Ray, System, SystemGradient};

/// A ray at one surface, in that surface's vertex frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Intersection: point, distance from the previous point, sag derivatives.
    pub at: Intersection,
    /// Direction before the surface.
    pub incoming: DVec3,
    /// Direction after it.
    pub direction: DVec3,
    /// Optical path from the launch point, mm.
    pub optical_path: f64,
}

/// Cotangents on one [`Hit`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HitBar {
    /// Of the point.
    pub point: DVec3,
    /// Of the direction after the surface.
    pub direction: DVec3,
    /// Of the optical path from the launch point.
    pub optical_path: f64,
}

/// How far beyond the stop's rim a ray still passes, as a part of the stop's semi-diameter: rays that are aimed at the rim
/// meet it to rounding (1e-12).
const RIM: f64 = 1e-9;

/// The first surface whose clear aperture a traced ray passes outside of, the stop's own included.
pub fn first_vignetted(system: &System, hits: &[Hit]) -> Option<Failure> {
    let limit = |i: usize| system.surfaces[i].semi_diameter * if i == system.stop { 1.0 + RIM } else { 1.0 };
    let surface = hits.iter().enumerate().position(|(i, h)| h.at.point.truncate().length() > limit(i))?;
    Some(Failure { cause: Cause::Vignetted, surface })
}

/// Traces `ray` (frame of the first vertex) through surfaces `0..=last`, filling `hits`. Not clipped by apertures.
///
/// On failure `hits` holds the surfaces before it.
pub fn trace(system: &System, ray: Ray, last: usize, hits: &mut Vec<Hit>) -> Result<Hit, Failure> {
    hits.clear();
    let (mut origin, mut direction, mut path) = (ray.origin, ray.direction, 0.0);
    for (i, surface) in system.surfaces[..=last].iter().enumerate() {
        let fail = |cause| Failure { cause, surface: i };
        // Transfer to this surface's frame, then intersect.
        origin.z -= surface.distance;
        if let Some(m) = &surface.motion {
            let back = m.rotation.transpose();
            (origin, direction) = (back * (origin - m.shift), back * direction);
        }
        let at = intersect(surface, origin, direction).map_err(fail)?;
        path += surface.index_before * at.t;
        // Refract; equal media leave the direction alone to the last bit.
        let incoming = direction;
        if let Some(ideal) = Ideal::of(surface) {
            let (out, added) = ideal.bend(at.point.truncate(), incoming).ok_or_else(|| fail(Cause::Missed))?;
            (direction, path) = (out, path + added);
        } else if surface.index_before != surface.index_after {
            let g = gradient(&at);
            let mut normal = g / g.length();
            if normal.dot(direction) > 0.0 {
                normal = -normal;
            }
            direction = refract(direction, normal, surface.index_before / surface.index_after)
                .ok_or_else(|| fail(Cause::TotalReflection))?;
        }
        // Numbers beyond f64 are no place to go on from.
        if !(at.point.is_finite() && path.is_finite() && (i < last || direction.is_finite())) {
            return Err(fail(Cause::Missed));
        }
        hits.push(Hit { at, incoming, direction, optical_path: path });
        origin = at.point;
        if let Some(m) = &surface.motion {
            (origin, direction) = (m.rotation * origin + m.shift, m.rotation * direction);
        }
    }
    Ok(hits[last])
}

/// Pulls cotangents on hits `0..bars.len()` back to the system and to the launch ray (origin, direction).
pub fn trace_vjp(system: &System, hits: &[Hit], bars: &[HitBar], out: &mut SystemGradient) -> (DVec3, DVec3) {
    let mut point_bar = DVec3::ZERO;
    let mut direction_bar = DVec3::ZERO;
    let mut path_bar = 0.0;
    for i in (0..bars.len()).rev() {
        let (surface, hit, bar) = (&system.surfaces[i], &hits[i], &bars[i]);
        // Back to the nominal frame.
        if let Some(m) = &surface.motion {
            let motion_bar = &mut out.motions[i];
            motion_bar.shift += point_bar;
            motion_bar.rotation += outer(point_bar, hit.at.point) + outer(direction_bar, hit.direction);
            let back = m.rotation.transpose();
            (point_bar, direction_bar) = (back * point_bar, back * direction_bar);
        }
        point_bar += bar.point;
        direction_bar += bar.direction;
        path_bar += bar.optical_path;
        let mut slope_bar = [0.0; 2];
        let (x, y) = (hit.at.point.x, hit.at.point.y);
        // Refraction.
        if let Some(ideal) = Ideal::of(surface) {
            let back = ideal.bend_vjp(hit.at.point.truncate(), hit.incoming, direction_bar, path_bar);
            (point_bar, direction_bar) = (point_bar + back.point.extend(0.0), back.direction);
            out.indices[i] += back.n[0];
            out.indices[i + 1] += back.n[1];
            out.conjugates[i] += back.conjugate;
            surface.shape.ideal_power_vjp(back.power, &mut out.shapes[i]);
        } else if surface.index_before != surface.index_after {
            let g = gradient(&hit.at);
            let length = g.length();
            let mut normal = g / length;
            let flip = if normal.dot(hit.incoming) > 0.0 { -1.0 } else { 1.0 };
            normal *= flip;
            let mu = surface.index_before / surface.index_after;
            let (d_bar, n_bar, mu_bar) = refract_vjp(hit.incoming, normal, mu, direction_bar);
            direction_bar = d_bar;
            out.indices[i] += mu_bar / surface.index_after;
            out.indices[i + 1] -= mu_bar * mu / surface.index_after;
            // Normal to slope to point.
            let g_bar = flip * (n_bar - normal * normal.dot(n_bar)) / length;
            slope_bar = [g_bar.x, g_bar.y];
            let [xx, xy, yy] = hit.at.local.second;
            point_bar.x += xx * g_bar.x + xy * g_bar.y;
            point_bar.y += xy * g_bar.x + yy * g_bar.y;
        } else {
            // Equal media bend nothing, but would if one of them changed: μ d + (μ cosθ − cosθ') n̂ at μ = 1.
            let g = gradient(&hit.at);
            let ci = -g.dot(hit.incoming);
            if ci != 0.0 {
                let mu_bar = direction_bar.dot(hit.incoming) + direction_bar.dot(g) / ci;
                out.indices[i] += mu_bar / surface.index_after;
                out.indices[i + 1] -= mu_bar / surface.index_after;
            }
        }
        // Path.
        out.indices[i] += path_bar * hit.at.t;
        // Intersection.
        let back = intersect_vjp(&hit.at, hit.incoming, point_bar, path_bar * surface.index_before);
        surface.shape.at_vjp(x, y, &hit.at.local, back.sag, slope_bar, &mut out.shapes[i]);
        point_bar = back.origin;
        direction_bar += back.direction;
        // Into the surface's frame: p = Rᵀ(p₀ − s), d = Rᵀ d₀.
        if let Some(m) = &surface.motion {
            let motion_bar = &mut out.motions[i];
            let origin = hit.at.point - hit.at.t * hit.incoming;
            motion_bar.rotation +=
                outer(m.rotation * origin, point_bar) + outer(m.rotation * hit.incoming, direction_bar);
            (point_bar, direction_bar) = (m.rotation * point_bar, m.rotation * direction_bar);
            motion_bar.shift -= point_bar;
        }
        // Transfer.
        out.distances[i] -= point_bar.z;
    }
    (point_bar, direction_bar)
}

/// `a bᵀ`.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}
