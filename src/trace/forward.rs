//! The trace without its record: one ray through a list of surfaces, only what leaves the last one is kept.
//!
//! The same rays as [`super::sequential::trace`], for renderers that need millions of them and no derivative. On a
//! conic the discriminant of the intersection is the cosine of incidence: with `G = (cx, cy, −φ)`, `φ = 1 − (1+κ)cz`,
//! `G·d = −√(B² − AC)`, so a sphere (`|G| = 1`) costs two roots and two divisions. Aspheres use
//! [`super::intersect`]. Agrees with the recorded trace to 1e-13 mm; a test holds it.

use glam::DVec3;

use super::intersect::{gradient, intersect};
use super::refract::refract;
use super::system::TraceSurface;
use super::{Ray, System};

/// `n/n'` of every surface of `surfaces`, exactly 1 where the media are equal.
pub fn index_ratios(surfaces: &[TraceSurface]) -> Vec<f64> {
    surfaces.iter().map(|s| s.index_before / s.index_after).collect()
}

/// The ray behind the last of `surfaces`, in that surface's nominal vertex frame; `None` if it fails or is clipped.
///
/// `ray` stands in the frame from which the first surface's `distance` counts. `ratios` are [`index_ratios`], so that
/// one list of surfaces serves many wavelengths. Every clear aperture clips, hard.
///
/// # Panics
/// If `ratios` is shorter than `surfaces`.
#[inline]
pub fn trace_forward(surfaces: &[TraceSurface], ratios: &[f64], ray: Ray) -> Option<Ray> {
    let ratios = &ratios[..surfaces.len()];
    let DVec3 { mut x, mut y, mut z } = ray.origin;
    let mut d = ray.direction;
    for (surface, &mu) in surfaces.iter().zip(ratios) {
        z -= surface.distance;
        if surface.aspheric || surface.motion.is_some() {
            let mut origin = DVec3::new(x, y, z);
            if let Some(m) = &surface.motion {
                let back = m.rotation.transpose();
                (origin, d) = (back * (origin - m.shift), back * d);
            }
            let at = intersect(surface, origin, d).ok()?;
            if at.point.x * at.point.x + at.point.y * at.point.y > surface.semi_diameter * surface.semi_diameter {
                return None;
            }
            if mu != 1.0 {
                let g = gradient(&at);
                let mut normal = g / g.length();
                if normal.dot(d) > 0.0 {
                    normal = -normal;
                }
                d = refract(d, normal, mu)?;
            }
            let mut point = at.point;
            if let Some(m) = &surface.motion {
                (point, d) = (m.rotation * point + m.shift, m.rotation * d);
            }
            DVec3 { x, y, z } = point;
            continue;
        }
        // Advance to the point nearest the vertex, then along the conic's exact root (see `intersect`).
        let (c, k) = (surface.shape.curvature, surface.shape.conic);
        let t0 = -(x * d.x + y * d.y + z * d.z);
        let (x0, y0, z0) = (x + t0 * d.x, y + t0 * d.y, z + t0 * d.z);
        let a = c * (1.0 + k * d.z * d.z);
        let b = d.z - c * (x0 * d.x + y0 * d.y + (1.0 + k) * z0 * d.z);
        let cc = c * (x0 * x0 + y0 * y0 + (1.0 + k) * z0 * z0) - 2.0 * z0;
        let disc = b * b - a * cc;
        if disc.is_nan() || disc < 0.0 {
            return None;
        }
        let root = disc.sqrt();
        let s = if b >= 0.0 { cc / (b + root) } else { (b - root) / a };
        (x, y, z) = (x0 + s * d.x, y0 + s * d.y, z0 + s * d.z);
        let phi = 1.0 - (1.0 + k) * c * z;
        let rho = x * x + y * y;
        // The other sheet is not the surface; negated so that a NaN fails as well.
        if !(phi > 0.0 && rho <= surface.semi_diameter * surface.semi_diameter) {
            return None;
        }
        if mu == 1.0 {
            continue;
        }
        // Refract at the normal against the light: n̂ = G/|G|.
        let scale = if k == 0.0 { 1.0 } else { (c * c * rho + phi * phi).sqrt().recip() };
        let ci = root * scale;
        let under = 1.0 - mu * mu * (1.0 - ci * ci);
        if under < 0.0 {
            return None;
        }
        let gamma = (mu * ci - under.sqrt()) * scale;
        d = DVec3::new(mu * d.x + gamma * c * x, mu * d.y + gamma * c * y, mu * d.z - gamma * phi);
    }
    Some(Ray { origin: DVec3::new(x, y, z), direction: d })
}

/// [`trace_forward`] through all surfaces of `system`, image plane included; `ray` in the frame of the first vertex.
pub fn trace_through(system: &System, ray: Ray) -> Option<Ray> {
    trace_forward(&system.surfaces, &index_ratios(&system.surfaces), ray)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::Pose;
    use crate::lens::builtin::{self, LENSES};
    use crate::testing::between;
    use crate::trace::exact::first_vignetted;
    use crate::trace::sequential::trace;

    /// Random rays through every shipped lens, both ways, conics and aspheres put in: the same rays pass, and agree.
    #[test]
    fn forward_agrees_with_the_recorded_trace() {
        let rng = &mut fastrand::Rng::with_seed(11);
        let mut hits = Vec::new();
        for (name, _) in LENSES {
            for variant in 0..3 {
                let mut lens = builtin::lens(name).expect(name);
                for s in lens.surfaces.iter_mut().filter(|_| variant > 0) {
                    s.shape.conic += between(rng, -1.5, 0.5);
                    if variant == 2 {
                        s.shape.asphere = vec![between(rng, -1e-4, 1e-4), between(rng, -1e-6, 1e-6)];
                        s.pose = Some(Pose { decentre: [0.1, -0.05], tilt: [0.01, 0.02, 0.3] });
                    }
                }
                let there = System::new(&lens, between(rng, 420.0, 680.0));
                for system in [there.reversed(), there] {
                    let (mut passed, size) = (0, system.stop_semi_diameter * 1.5);
                    for _ in 0..2000 {
                        let mut draw = |w: f64| between(rng, -w, w);
                        let origin = DVec3::new(draw(size), draw(size), draw(1.0));
                        let direction = DVec3::new(draw(0.3), draw(0.3), 1.0).normalize();
                        let ray = Ray { origin, direction };
                        let recorded = trace(&system, ray, system.image(), &mut hits).ok();
                        let recorded = recorded.filter(|_| first_vignetted(&system, &hits).is_none());
                        let lean = trace_through(&system, ray);
                        assert_eq!(lean.is_some(), recorded.is_some(), "{name} {variant}");
                        if let (Some(a), Some(b)) = (lean, recorded) {
                            passed += 1;
                            let m = system.surfaces[system.image()].motion;
                            let (p, d) = m.map_or((b.at.point, b.direction), |m| {
                                (m.rotation * b.at.point + m.shift, m.rotation * b.direction)
                            });
                            let scale = 1.0 + b.at.point.length();
                            assert!((a.origin - p).length() < 1e-13 * scale, "{name} {variant}: {a:?} {b:?}");
                            assert!((a.direction - d).length() < 1e-13, "{name} {variant}: {a:?} {b:?}");
                        }
                    }
                    assert!(passed > 20, "{name} {variant}: {passed} rays passed");
                }
            }
        }
    }

    #[test]
    fn hopeless_rays_fail_without_numbers() {
        let system = System::new(&builtin::lens("two_element").expect("shipped"), 550.0);
        for (x, direction) in [(0.0, DVec3::X), (30.0, DVec3::Z), (f64::NAN, DVec3::Z), (0.0, DVec3::NAN)] {
            assert_eq!(trace_through(&system, Ray { origin: DVec3::new(x, 0.0, 0.0), direction }), None);
        }
    }
}
