//! The path outside the lens, from the plane of the entrance pupil.
//!
//! Edges of the stop are seen in the entrance pupil. A ray is drawn out to its plane, straight, as object space has it; what an edge there cuts off of the object's light
//! is right however far out of focus that is. From another plane, the first vertex's, a blur of an object near by would have as much too large an angle as that plane is
//! nearer.

use glam::DVec2;

/// Farthest that the plane is taken from the first vertex, mm: pupils of telecentric lenses are at infinity.
const FARTHEST: f64 = 1e4;
/// Steps of its distance to an octave: it is held, and what steps it goes by does not enter derivatives.
const STEPS: f64 = 32.0;

/// The plane of an entrance pupil.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    /// Distance behind the first vertex, mm.
    behind: f64,
    /// Slopes and vergences from there, of those from the first vertex.
    scale: f64,
}

/// What goes back from [`Plane::path`]: to the slope of the object, to the crossing of the first vertex plane, and to the slope of the ray.
pub(super) struct PathBar {
    pub(super) u: DVec2,
    pub(super) entrance: DVec2,
    pub(super) slope: DVec2,
}

impl Plane {
    /// `pupil` mm behind the first vertex, for objects at vergence `v`; the first vertex's own where the pupil lies at the object or before it.
    pub(super) fn new(pupil: f64, v: f64) -> Self {
        let held = if pupil.is_finite() { pupil.clamp(-FARTHEST, FARTHEST) } else { FARTHEST };
        let stepped = held.signum() * ((held.abs().max(1e-6).log2() * STEPS).round() / STEPS).exp2();
        // Far before the lens and far behind it are the same for a telecentric one.
        let behind = if 1.0 + v * stepped < 0.0 && stepped <= -0.9 * FARTHEST { -stepped } else { stepped };
        if 1.0 + v * behind < 0.1 {
            Self { behind: 0.0, scale: 1.0 }
        } else {
            Self { behind, scale: (1.0 + v * behind).recip() }
        }
    }

    /// Path from the crossing `entrance` of the first vertex plane by a ray of this slope, over the pupil's plane, to the object of slope `u` at vergence `v`, less that from
    /// the middle of that plane, mm; and how it changes with `u`.
    pub(super) fn path(&self, u: DVec2, v: f64, entrance: DVec2, slope: DVec2) -> (f64, DVec2) {
        let (path, by_u) = beyond(self.scale * u, self.scale * v, entrance + self.behind * slope);
        let drawn = self.behind * slope.length_squared() / ((1.0 + slope.length_squared()).sqrt() + 1.0);
        (path - drawn, self.scale * by_u)
    }

    /// Pulls cotangents on both of [`Self::path`] back.
    pub(super) fn path_vjp(
        &self,
        (u, v): (DVec2, f64),
        entrance: DVec2,
        slope: DVec2,
        path_bar: f64,
        by_u_bar: DVec2,
    ) -> PathBar {
        let at = entrance + self.behind * slope;
        let (by_u, by_at) = beyond_vjp(self.scale * u, self.scale * v, at, path_bar, self.scale * by_u_bar);
        let drawn = slope / (1.0 + slope.length_squared()).sqrt();
        PathBar { u: self.scale * by_u, entrance: by_at, slope: self.behind * (by_at - path_bar * drawn) }
    }
}

/// Path from the point `e` of a plane to the object of slope `u` at vergence `v`, less that from the plane's middle, mm; and how it changes with `u`.
fn beyond(u: DVec2, v: f64, e: DVec2) -> (f64, DVec2) {
    let (far, near) = ((1.0 + (u + v * e).length_squared()).sqrt(), (1.0 + u.length_squared()).sqrt());
    let path = (2.0 * u.dot(e) + v * e.length_squared()) / (far + near);
    (path, e / far - u * (path / (far * near)))
}

/// Pulls cotangents on both of [`beyond`] back to `u` and `e`.
fn beyond_vjp(u: DVec2, v: f64, e: DVec2, path_bar: f64, slope_bar: DVec2) -> (DVec2, DVec2) {
    let w = u + v * e;
    let (far, near) = ((1.0 + w.length_squared()).sqrt(), (1.0 + u.length_squared()).sqrt());
    let path = (2.0 * u.dot(e) + v * e.length_squared()) / (far + near);
    let along = slope_bar.dot(u);
    let path_bar = path_bar - along / (far * near);
    let (mut u_bar, mut e_bar) = (-slope_bar * (path / (far * near)), slope_bar / far);
    let by_sum = path_bar / (far + near);
    let far_bar = along * path / (far * far * near) - slope_bar.dot(e) / (far * far) - by_sum * path;
    let near_bar = along * path / (far * near * near) - by_sum * path;
    u_bar += 2.0 * by_sum * e + far_bar / far * w + near_bar / near * u;
    e_bar += 2.0 * by_sum * w + v * far_bar / far * w;
    (u_bar, e_bar)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_rel, central_difference};

    /// Of the whole path, near and far; the plane does not matter to a ray that meets the object.
    #[test]
    fn path_vjp_agrees_with_differences() {
        let (e, m, path_bar, by_u_bar) = (DVec2::new(3.0, -5.0), DVec2::new(0.1, 0.35), 0.7, DVec2::new(-0.4, 1.3));
        for (u, v, pupil) in
            [(DVec2::new(0.0, 0.4), 0.0, 12.0), (DVec2::new(0.1, -0.7), 0.01, -20.0), (DVec2::ZERO, 0.003, 80.0)]
        {
            let plane = Plane::new(pupil, v);
            assert_rel(plane.behind, pupil, 0.011, 1e-9, "near the pupil");
            let value = |u: DVec2, e: DVec2, m: DVec2| {
                let (path, by_u) = plane.path(u, v, e, m);
                path * path_bar + by_u.dot(by_u_bar)
            };
            let back = plane.path_vjp((u, v), e, m, path_bar, by_u_bar);
            for axis in [DVec2::X, DVec2::Y] {
                let differences = [
                    (back.u, central_difference(|h| value(u + h * axis, e, m), 1e-6)),
                    (back.entrance, central_difference(|h| value(u, e + h * axis, m), 1e-6)),
                    (back.slope, central_difference(|h| value(u, e, m + h * axis), 1e-6)),
                ];
                for (pulled, found) in differences {
                    assert_rel(pulled.dot(axis), found, 1e-7, 1.0, "pulled back");
                }
            }
            // The slope that meets the object from `e`: the path from the first vertex plane, but for a constant.
            let meeting = |e: DVec2| u + v * e;
            let through = |plane: &Plane, e: DVec2| plane.path(u, v, e, meeting(e)).0;
            let vertex = Plane { behind: 0.0, scale: 1.0 };
            let of = |e: DVec2| through(&plane, e) - through(&vertex, e);
            assert_rel(of(e), of(DVec2::new(-1.0, 2.0)), 1e-9, 1e-3, "any plane");
        }
        // Telecentric, and pupils that lie at the object.
        assert!(Plane::new(f64::INFINITY, 0.01).behind > 9e3 && Plane::new(-1e16, 0.01).behind > 9e3);
        assert!(Plane::new(-99.0, 0.01).behind == 0.0);
    }

    /// Near and far, against differences; the slope is the path's change.
    #[test]
    fn beyond_vjp_agrees_with_differences() {
        let (e, path_bar, slope_bar) = (DVec2::new(3.0, -5.0), 0.7, DVec2::new(-0.4, 1.3));
        for (u, v) in [(DVec2::new(0.0, 0.4), 0.0), (DVec2::new(0.1, -0.7), 0.01), (DVec2::ZERO, 0.003)] {
            let value = |u: DVec2, e: DVec2| {
                let (path, slope) = beyond(u, v, e);
                path * path_bar + slope.dot(slope_bar)
            };
            let (u_bar, e_bar) = beyond_vjp(u, v, e, path_bar, slope_bar);
            for axis in [DVec2::X, DVec2::Y] {
                let by_u = central_difference(|h| value(u + h * axis, e), 1e-6);
                let by_e = central_difference(|h| value(u, e + h * axis), 1e-6);
                assert_rel(u_bar.dot(axis), by_u, 1e-8, 1.0, "over u");
                assert_rel(e_bar.dot(axis), by_e, 1e-8, 1.0, "over e");
                let slope = central_difference(|h| beyond(u + h * axis, v, e).0, 1e-6);
                assert_rel(beyond(u, v, e).1.dot(axis), slope, 1e-8, 1.0, "slope");
            }
        }
    }
}
