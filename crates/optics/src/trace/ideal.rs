//! The ideal lens: a plane that images as first-order optics says, at any aperture and field.
//!
//! With slopes `m = (L, M)/N` before it, `m'` behind it, the point `p` on its plane and its power `φ`: `n'm' = nm − φp`. So every point has
//! a sharp image, and planes have plane images without distortion. No glass does that for all distances at once, so the optical
//! path that such a lens adds is one of a pair of planes: it makes paths from a point of the one to its image in the other equal.
//! The pair is where the lens's own object, and the images that the surfaces before make of it, stand paraxially. `a = 1/distance` of the
//! object before the plane and `b` of the image behind it have `na + n'b = φ`; `κ = (na − n'b)/2` ([`TraceSurface::conjugate`]) turns its
//! sign when light goes the other way. The path is
//! `n(|OV| − |OP|) + n'(|VI| − |PI|)`, `V` the vertex, written without a quotient of distances:
//! `n(a p² − 2m·p)/(√(1+|m − ap|²) + √(1+m²)) + n'(b p² + 2m'·p)/(√(1+|m' + bp|²) + √(1+m'²))`.
//!
//! Light before and behind it is no light of a passive system: étendue is not conserved beyond first order. What a sensor gets is counted
//! from its own side.

use glam::{DVec2, DVec3};

use super::system::TraceSurface;

/// What an ideal lens does with rays.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ideal {
    power: f64,
    conjugate: f64,
    /// Index before and behind.
    n: [f64; 2],
}

/// Cotangents that leave [`Ideal::bend_vjp`].
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct IdealBar {
    pub(super) point: DVec2,
    pub(super) direction: DVec3,
    pub(super) power: f64,
    pub(super) conjugate: f64,
    pub(super) n: [f64; 2],
}

impl Ideal {
    /// That of `surface`, if it is one.
    #[inline]
    pub(super) fn of(surface: &TraceSurface) -> Option<Self> {
        let power = surface.shape.ideal_power()?;
        Some(Self { power, conjugate: surface.conjugate, n: [surface.index_before, surface.index_after] })
    }

    /// `a` and `b`.
    fn vergences(&self) -> [f64; 2] {
        let half = 0.5 * self.power;
        [(half + self.conjugate) / self.n[0], (half - self.conjugate) / self.n[1]]
    }

    fn slope_behind(&self, p: DVec2, m: DVec2) -> DVec2 {
        (self.n[0] * m - self.power * p) / self.n[1]
    }

    /// The unit direction behind and the optical path added, mm, of the ray with unit `direction` through `p`; `None` for a ray along the plane.
    pub(super) fn bend(&self, p: DVec2, direction: DVec3) -> Option<(DVec3, f64)> {
        let m = direction.truncate() / direction.z;
        let behind = self.slope_behind(p, m);
        let [a, b] = self.vergences();
        let path = self.n[0] * path_by(-1.0, m, p, a) + self.n[1] * path_by(1.0, behind, p, b);
        let out = behind.extend(1.0).normalize();
        (direction.z > 0.0 && out.is_finite() && path.is_finite()).then_some((out, path))
    }

    /// How the direction behind moves with the point and the direction before.
    pub(super) fn bend_jvp(&self, p: DVec2, direction: DVec3, p_dot: DVec2, direction_dot: DVec3) -> DVec3 {
        let m = direction.truncate() / direction.z;
        let m_dot = (direction_dot.truncate() - m * direction_dot.z) / direction.z;
        let moved = self.slope_behind(p_dot, m_dot).extend(0.0);
        let out = self.slope_behind(p, m).extend(1.0).normalize();
        (moved - out * out.dot(moved)) * out.z
    }

    /// Pulls cotangents on what [`Self::bend`] returns back.
    pub(super) fn bend_vjp(&self, p: DVec2, direction: DVec3, out_bar: DVec3, path_bar: f64) -> IdealBar {
        let [n, n1] = self.n;
        let m = direction.truncate() / direction.z;
        let behind = self.slope_behind(p, m);
        let [a, b] = self.vergences();
        let out = behind.extend(1.0).normalize();
        let mut behind_bar = (out_bar - out * out.dot(out_bar)).truncate() * out.z;
        let (before, beyond) = (path_by(-1.0, m, p, a), path_by(1.0, behind, p, b));
        let (mut m_bar, p_before, a_bar) = path_by_vjp(-1.0, m, p, a, n * path_bar);
        let (by_path, p_beyond, b_bar) = path_by_vjp(1.0, behind, p, b, n1 * path_bar);
        behind_bar += by_path;
        m_bar += n * behind_bar / n1;
        let mut bar = IdealBar {
            point: p_before + p_beyond - self.power * behind_bar / n1,
            direction: (m_bar.extend(0.0) - DVec3::Z * m_bar.dot(m)) / direction.z,
            power: -behind_bar.dot(p) / n1 + 0.5 * (a_bar / n + b_bar / n1),
            conjugate: a_bar / n - b_bar / n1,
            n: [path_bar * before, path_bar * beyond],
        };
        bar.n[0] += (behind_bar.dot(m) / n1) - a_bar * a / n;
        bar.n[1] -= behind_bar.dot(behind) / n1 + b_bar * b / n1;
        bar
    }
}

/// `(√(1+|m + s v p|²) − √(1+m²))/v` for `s = 1`, the same with `p` turned for `s = −1`: how much longer the way from the vertex is than
/// that from the point.
fn path_by(s: f64, m: DVec2, p: DVec2, v: f64) -> f64 {
    let roots = (1.0 + (m + s * v * p).length_squared()).sqrt() + (1.0 + m.length_squared()).sqrt();
    (2.0 * s * m.dot(p) + v * p.length_squared()) / roots
}

/// Pulls a cotangent on [`path_by`] back to `(m, p, v)`.
fn path_by_vjp(s: f64, m: DVec2, p: DVec2, v: f64, bar: f64) -> (DVec2, DVec2, f64) {
    let e = m + s * v * p;
    let [far, near] = [e, m].map(|x| (1.0 + x.length_squared()).sqrt());
    let over = bar / (far + near);
    let roots_bar = -over * path_by(s, m, p, v);
    let e_bar = roots_bar * e / far;
    let m_bar = 2.0 * s * over * p + roots_bar * m / near + e_bar;
    let p_bar = 2.0 * over * (s * m + v * p) + s * v * e_bar;
    (m_bar, p_bar, over * p.length_squared() + s * e_bar.dot(p))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::Shape;
    use isoplanat_base::testing::{assert_abs, assert_rel, between, central_difference};

    fn lens(power: f64, object: f64, n: [f64; 2]) -> TraceSurface {
        let mut surface = TraceSurface::new(Shape { ideal: Some(power.recip()), ..Shape::default() }, 0.0, n, 10.0);
        surface.conjugate = n[0] / object - 0.5 * power;
        surface
    }

    /// Points of the object's plane, near, far and virtual, on both sides of a lens that gathers or spreads: one image each, at the height
    /// that first-order optics gives, and one path to it.
    #[test]
    fn points_have_sharp_images_and_paths_are_equal() {
        for (power, n) in [(1.0 / 50.0, [1.0, 1.0]), (-1.0 / 30.0, [1.0, 1.0]), (1.0 / 20.0, [1.0, 1.5])] {
            for object in [80.0, 1e3, 1e9, -25.0, 15.0] {
                let surface = lens(power, object, n);
                let ideal = Ideal::of(&surface).expect("ideal");
                let image = n[1] / (power - n[0] / object);
                // A point half the distance off the axis. Lengths along rays are counted from it and to its image, with their signs.
                let off = DVec2::new(0.3, 0.4);
                let long = |distance: f64, slope: DVec2| distance * slope.extend(1.0).length();
                let excess = |p: DVec2| {
                    let m = p / object - off;
                    let (out, added) = ideal.bend(p, m.extend(1.0).normalize()).expect("passes");
                    let behind = out.truncate() / out.z;
                    let height = -n[0] / n[1] * image * off;
                    assert_abs((p + image * behind - height).length(), 0.0, 1e-12 * image.abs(), "sharp");
                    let through_vertex = n[0] * long(object, off) + n[1] * long(image, n[0] / n[1] * off);
                    n[0] * long(object, m) + added + n[1] * long(image, behind) - through_vertex
                };
                for p in [DVec2::new(0.0, 5.0), DVec2::new(-7.0, 3.0), DVec2::new(2.0, -9.0)] {
                    let rounding = 4.0 * f64::EPSILON * (object.abs() + image.abs());
                    assert_abs(excess(p), 0.0, 1e-12 + rounding, &format!("{power} {object}"));
                }
            }
        }
    }

    /// Light that goes back takes the same way and the same path.
    #[test]
    fn the_way_back_is_the_way_there() {
        let surface = lens(1.0 / 35.0, 120.0, [1.0, 1.5]);
        let (ideal, back) = (Ideal::of(&surface).expect("ideal"), Ideal::of(&surface.reversed(0.0)).expect("ideal"));
        let (p, direction) = (DVec2::new(3.0, -8.0), DVec3::new(0.2, -0.3, 1.0).normalize());
        let (out, path) = ideal.bend(p, direction).expect("passes");
        let (home, again) = back.bend(p, DVec3::new(-out.x, -out.y, out.z)).expect("passes");
        assert_abs((DVec3::new(-home.x, -home.y, home.z) - direction).length(), 0.0, 1e-15, "direction");
        assert_rel(again, path, 1e-14, 0.0, "path");
    }

    /// `bend_vjp` against differences of every argument, `bend_jvp` against `bend_vjp`.
    #[test]
    fn bend_vjp_is_the_transpose_of_the_jacobian() {
        let rng = &mut fastrand::Rng::with_seed(7);
        for _ in 0..200 {
            let mut draw = |w: f64| between(rng, -w, w);
            let at =
                [draw(9.0), draw(9.0), draw(0.5), draw(0.5), draw(0.05), draw(0.03), 1.0 + draw(0.3), 1.2 + draw(0.3)];
            let by: [f64; 8] =
                [draw(1.0), draw(1.0), draw(0.1), draw(0.1), draw(0.01), draw(0.01), draw(0.1), draw(0.1)];
            let (out_bar, path_bar) = (DVec3::new(draw(1.0), draw(1.0), draw(1.0)), draw(1.0));
            let made = |x: [f64; 8]| Ideal { power: x[4], conjugate: x[5], n: [x[6], x[7]] };
            // Directions of unit length along any line of slopes.
            let ray = |x: [f64; 8]| (DVec2::new(x[0], x[1]), DVec3::new(x[2], x[3], 1.0).normalize());
            let value = |h: f64| {
                let x: [f64; 8] = std::array::from_fn(|k| at[k] + h * by[k]);
                let (p, d) = ray(x);
                let (out, path) = made(x).bend(p, d).expect("passes");
                out.dot(out_bar) + path * path_bar
            };
            let (p, d) = ray(at);
            let bar = made(at).bend_vjp(p, d, out_bar, path_bar);
            let slope_dot = DVec3::new(by[2], by[3], 0.0);
            let d_dot = (slope_dot - d * d.dot(slope_dot)) * d.z;
            let p_dot = DVec2::new(by[0], by[1]);
            let pulled = bar.point.dot(p_dot)
                + bar.direction.dot(d_dot)
                + bar.power * by[4]
                + bar.conjugate * by[5]
                + bar.n[0] * by[6]
                + bar.n[1] * by[7];
            assert_rel(pulled, central_difference(value, 1e-3), 1e-9, 1e-2, "bend");
            let rays = made(at).bend_vjp(p, d, out_bar, 0.0);
            let pushed = made(at).bend_jvp(p, d, p_dot, d_dot).dot(out_bar);
            assert_rel(pushed, rays.point.dot(p_dot) + rays.direction.dot(d_dot), 1e-12, 1e-3, "jvp");
        }
    }
}
