//! Ray differentials: what a small displacement of the launch ray becomes behind the surfaces of a recorded trace.
//!
//! The forward twin of [`super::sequential::trace_vjp`] for the ray alone, without allocation: two of them are the
//! Jacobian that ray aiming needs.

use glam::DVec3;

use super::System;
use super::ideal::Ideal;
use super::intersect::gradient;
use super::sequential::Hit;

/// A displacement of a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RayDot {
    /// Of its point.
    pub point: DVec3,
    /// Of its direction.
    pub direction: DVec3,
}

/// Displacement at the last of `hits` (point on the surface, direction after it; in that surface's vertex frame) from a
/// displacement of the launch ray.
pub fn trace_jvp(system: &System, hits: &[Hit], launch: RayDot) -> RayDot {
    let RayDot { mut point, mut direction } = launch;
    for (i, (surface, hit)) in system.surfaces.iter().zip(hits).enumerate() {
        if let Some(m) = &surface.motion {
            let back = m.rotation.transpose();
            (point, direction) = (back * point, back * direction);
        }
        // On the surface: ∇F · (δo + t δd + δt d) = 0.
        let g = gradient(&hit.at);
        let moved = point + hit.at.t * direction;
        point = moved - g.dot(moved) / g.dot(hit.incoming) * hit.incoming;
        if let Some(ideal) = Ideal::of(surface) {
            direction = ideal.bend_jvp(hit.at.point.truncate(), hit.incoming, point.truncate(), direction);
        } else if surface.index_before != surface.index_after {
            let length = g.length();
            let normal = g / length;
            let flip = if normal.dot(hit.incoming) > 0.0 { -1.0 } else { 1.0 };
            let [xx, xy, yy] = hit.at.local.second;
            let g_dot = DVec3::new(xx * point.x + xy * point.y, xy * point.x + yy * point.y, 0.0);
            let n_dot = flip * (g_dot - normal * normal.dot(g_dot)) / length;
            let normal = flip * normal;
            let mu = surface.index_before / surface.index_after;
            let ci = -hit.incoming.dot(normal);
            let ct = (1.0 - mu * mu * (1.0 - ci * ci)).sqrt();
            let ci_dot = -direction.dot(normal) - hit.incoming.dot(n_dot);
            let gamma_dot = mu * ci_dot - mu * mu * ci * ci_dot / ct;
            direction = mu * direction + gamma_dot * normal + (mu * ci - ct) * n_dot;
        }
        if i + 1 < hits.len()
            && let Some(m) = &surface.motion
        {
            (point, direction) = (m.rotation * point, m.rotation * direction);
        }
    }
    RayDot { point, direction }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::trace::sequential::{HitBar, trace, trace_vjp};
    use crate::trace::test_lenses::tilt;
    use crate::trace::{Ray, SystemGradient};
    use isoplanat_base::testing::{assert_rel, between};

    /// ⟨bar, J dot⟩ = ⟨Jᵀ bar, dot⟩ with the trace's own pull-back, on tilted aspheres too.
    #[test]
    fn trace_jvp_is_the_transpose_of_trace_vjp() {
        let rng = &mut fastrand::Rng::with_seed(5);
        for name in ["two_element", "double_gauss", "phone"] {
            for tilted in [false, true] {
                let lens = builtin::lens(name).expect("shipped");
                let lens = if tilted { tilt(&lens, rng, 1.5) } else { lens };
                let system = System::new(&lens, 550.0);
                for _ in 0..20 {
                    let mut vector = |w: f64| DVec3::new(between(rng, -w, w), between(rng, -w, w), between(rng, -w, w));
                    let ray = Ray {
                        origin: vector(0.4 * system.stop_semi_diameter),
                        direction: (DVec3::Z + vector(0.1)).normalize(),
                    };
                    let turn = vector(1.0);
                    let dot = RayDot { point: vector(1.0), direction: turn - ray.direction * ray.direction.dot(turn) };
                    let (p_bar, d_bar) = (vector(1.0), vector(1.0));
                    let mut hits = Vec::new();
                    if trace(&system, ray, system.image(), &mut hits).is_err() {
                        continue;
                    }
                    for last in [0, system.stop, system.image()] {
                        let moved = trace_jvp(&system, &hits[..=last], dot);
                        let mut bars = vec![HitBar::default(); last + 1];
                        bars[last] = HitBar { point: p_bar, direction: d_bar, optical_path: 0.0 };
                        let (o, d) = trace_vjp(&system, &hits, &bars, &mut SystemGradient::zeros(&system));
                        let pulled = o.dot(dot.point) + d.dot(dot.direction);
                        // `trace_vjp` counts bars of the last surface in its own frame, before its motion.
                        let pushed = moved.point.dot(p_bar) + moved.direction.dot(d_bar);
                        assert_rel(pushed, pulled, 1e-11, 1.0, &format!("{name} {tilted} {last}"));
                    }
                }
            }
        }
    }
}
