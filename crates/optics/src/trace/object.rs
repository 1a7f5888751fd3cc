//! Object points of any field angle, and the rays that come from them.
//!
//! An [`ObjectPoint`] is the unit direction `d` of its light at the first vertex and a vergence `v`. Its ray through
//! the point `e` runs along `d + v e`: one formula for infinitely far, near and virtual objects and for half fields of
//! 90° and more. The object itself stands at `−d/v`. Below 90° it converts to and from [`FieldPoint`], which counts in
//! slopes.
//!
//! Rays are launched from a plane perpendicular to `d` ([`LaunchPlane`]): the light of an infinitely far object moves
//! parallel to itself, that of a near one turns about the object. The plane is a wavefront of the former; of the latter
//! [`LaunchPlane::path`] is the optical path that is missing to one.

use std::f64::consts::FRAC_PI_2;

use glam::{DVec2, DVec3};

use super::launch::FieldPoint;
use super::{Ray, System};
use crate::lens::{Prescription, paraxial};

/// An object point: direction of the light and vergence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectPoint {
    /// Unit direction of the ray through the first vertex, along the light.
    pub direction: DVec3,
    /// 1/distance to the first vertex, 1/mm: 0 is infinitely far, negative a virtual object.
    pub vergence: f64,
}

/// Cotangents of an [`ObjectPoint`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ObjectBar {
    /// Of the direction, perpendicular to it.
    pub direction: DVec3,
    /// Of the vergence.
    pub vergence: f64,
}

impl ObjectBar {
    /// Adds `other`.
    pub fn add(&mut self, other: &Self) {
        self.direction += other.direction;
        self.vergence += other.vergence;
    }
}

impl ObjectPoint {
    /// An infinitely far point whose light runs along `direction` (any length but zero).
    pub fn infinite(direction: DVec3) -> Self {
        Self { direction: direction.normalize(), vergence: 0.0 }
    }

    /// A real object at `position` (mm, frame of the first vertex; not the vertex itself).
    pub fn finite(position: DVec3) -> Self {
        Self { direction: -position.normalize(), vergence: position.length().recip() }
    }

    /// The point at `angle` from the axis in the meridian `azimuth` (radians; from +x to +y), at `vergence`. A positive
    /// angle runs up for azimuth 90°, as a positive slope does.
    pub fn from_angle(angle: f64, azimuth: f64, vergence: f64) -> Self {
        let ((s, c), (sa, ca)) = (angle.sin_cos(), azimuth.sin_cos());
        Self { direction: DVec3::new(s * ca, s * sa, c), vergence }
    }

    /// The point of the object plane of `lens` whose light runs at `angle` to the axis through the middle of the paraxial
    /// entrance pupil (primary wavelength), in the meridian `azimuth`: what a field angle means in a lens file. Radians.
    /// From 90° on a plane has no such point, and the point is infinitely far; a lens that is telecentric in object space has
    /// no such pupil, and the angle is that at the first vertex.
    pub fn in_field(lens: &Prescription, angle: f64, azimuth: f64) -> Self {
        let d = Self::from_angle(angle, azimuth, 0.0).direction;
        let pupil = paraxial::first_order(lens, lens.wavelengths.primary_nm).entrance_pupil_position;
        let v = lens.object_vergence * d.z.max(0.0);
        // The object stands at P − d/w from the pupil's middle P, its plane 1/v before the first vertex.
        let w = v / (1.0 + lens.object_vergence * pupil);
        if v == 0.0 || !w.is_finite() || !pupil.is_finite() {
            return Self { direction: d, vergence: v };
        }
        // A pupil before the object is looked back at: w is negative.
        let g = (d - w * pupil * DVec3::Z) * w.signum();
        Self { direction: g.normalize(), vergence: w.abs() / g.length() }
    }

    /// Pulls a cotangent on [`Self::from_angle`] back to the angle and the azimuth.
    pub fn from_angle_vjp(angle: f64, azimuth: f64, bar: &ObjectBar) -> (f64, f64) {
        let ((s, c), (sa, ca)) = (angle.sin_cos(), azimuth.sin_cos());
        let d = bar.direction;
        (d.x * c * ca + d.y * c * sa - d.z * s, s * (d.y * ca - d.x * sa))
    }

    /// The same point, from slopes.
    pub fn from_field(field: FieldPoint) -> Self {
        let cosine = (1.0 + field.slope.length_squared()).sqrt().recip();
        let direction = DVec3::new(field.slope.x * cosine, field.slope.y * cosine, cosine);
        Self { direction, vergence: field.vergence * cosine }
    }

    /// Pulls a cotangent on [`Self::from_field`] back to the slope.
    pub fn from_field_vjp(field: FieldPoint, bar: &ObjectBar) -> DVec2 {
        let d = Self::from_field(field).direction;
        // d = (s, 1) N, v = v₀ N, N = (1 + s²)^{−1/2}.
        let along = d.dot(bar.direction);
        d.z * (bar.direction.truncate() - along * d.truncate())
            - field.vergence * d.z * d.z * d.truncate() * bar.vergence
    }

    /// The same point in slopes; `None` from 90° on.
    pub fn to_field(&self) -> Option<FieldPoint> {
        let d = self.direction;
        (d.z > 0.0).then(|| FieldPoint { slope: d.truncate() / d.z, vergence: self.vergence / d.z })
    }

    /// Where the object stands, mm; `None` if it is infinitely far.
    pub fn position(&self) -> Option<DVec3> {
        (self.vergence != 0.0).then(|| -self.direction / self.vergence)
    }

    /// Angle to the axis, radians, 0 to π.
    pub fn angle(&self) -> f64 {
        FRAC_PI_2 - self.direction.z.atan2(self.direction.truncate().length())
    }

    /// Direction of the light at the point `e`: `(d + v e)/|d + v e|`, and the length divided by.
    pub(super) fn direction_at(&self, e: DVec3) -> (DVec3, f64) {
        let g = self.direction + self.vergence * e;
        let length = g.length();
        (g / length, length)
    }
}

impl From<FieldPoint> for ObjectPoint {
    fn from(field: FieldPoint) -> Self {
        Self::from_field(field)
    }
}

/// The plane from which the rays of one object point start: perpendicular to its direction, before the first surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LaunchPlane {
    /// The object.
    pub object: ObjectPoint,
    standoff: f64,
    u: DVec3,
    w: DVec3,
}

impl LaunchPlane {
    /// A plane before the first surface of `system` up to 1.5 clear semi-diameters away from its vertex, or half way to
    /// a nearer object.
    pub fn new(system: &System, object: ObjectPoint) -> Self {
        let rim = system.surfaces.first().map_or(0.0, |s| s.semi_diameter);
        // A stop at infinity or an aperture without a limit says nothing of the lens's size.
        let reach = 1.5 * rim.min(100.0 * system.stop_semi_diameter);
        let standoff = if object.vergence * reach > 0.5 { 0.5 / object.vergence } else { reach };
        let (u, w) = object.direction.any_orthonormal_pair();
        Self { object, standoff, u, w }
    }

    /// Distance of the plane before the first vertex, mm.
    pub fn standoff(&self) -> f64 {
        self.standoff
    }

    /// The ray through the point `p` of the plane (mm, in the plane's own axes).
    #[inline]
    pub fn ray(&self, p: DVec2) -> Ray {
        let origin = p.x * self.u + p.y * self.w - self.standoff * self.object.direction;
        Ray { origin, direction: self.object.direction_at(origin).0 }
    }

    /// Pulls cotangents on [`Self::ray`] back to `p` and to the object. The plane's distance is held: it moves origins
    /// along their rays only.
    pub fn ray_vjp(&self, ray: &Ray, origin_bar: DVec3, direction_bar: DVec3) -> (DVec2, ObjectBar) {
        let (d, v) = (self.object.direction, self.object.vergence);
        let (n, length) = self.object.direction_at(ray.origin);
        let g_bar = (direction_bar - n * n.dot(direction_bar)) / length;
        let e_bar = origin_bar + v * g_bar;
        let p_bar = DVec2::new(self.u.dot(e_bar), self.w.dot(e_bar));
        // The plane's axes turn with d: e = p − standoff d, where p stays perpendicular to d.
        let p = ray.origin + self.standoff * d;
        let bar = g_bar - self.standoff * e_bar - d.dot(e_bar) * p;
        (p_bar, ObjectBar { direction: bar - d * d.dot(bar), vergence: ray.origin.dot(g_bar) })
    }

    /// The point of the plane whose ray runs through `point` (mm, frame of the first vertex).
    pub fn through(&self, point: DVec3) -> DVec2 {
        let g = self.object.direction + self.object.vergence * point;
        let back = (self.standoff + self.object.direction.dot(point)) / self.object.direction.dot(g);
        let e = point - back * g;
        DVec2::new(self.u.dot(e), self.w.dot(e))
    }

    /// `∂(origin, direction)/∂p`, one pair for each of the plane's axes.
    #[inline]
    pub(super) fn ray_columns(&self, ray: &Ray) -> [(DVec3, DVec3); 2] {
        let v = self.object.vergence;
        let length = (self.object.direction + v * ray.origin).length();
        [self.u, self.w].map(|u| (u, v / length * (u - ray.direction * ray.direction.dot(u))))
    }

    /// Optical path from the object's wavefront through the plane's middle to the origin of `ray`, mm, divided by the
    /// object space's index: 0 for an infinitely far object.
    pub fn path(&self, ray: &Ray) -> f64 {
        let (v, p) = (self.object.vergence, ray.origin + self.standoff * self.object.direction);
        let (along, rho) = (1.0 - v * self.standoff, p.length_squared());
        // |e + d/v| − (1/v − standoff) without the difference of large numbers; the object stands before the plane.
        v * rho / ((along * along + v * v * rho).sqrt() + along)
    }

    /// Pulls a cotangent on [`Self::path`] back to the ray's origin and the object, its plane's distance held.
    pub fn path_vjp(&self, ray: &Ray, path_bar: f64) -> (DVec3, ObjectBar) {
        let v = self.object.vergence;
        let p = ray.origin + self.standoff * self.object.direction;
        let (along, rho) = (1.0 - v * self.standoff, p.length_squared());
        let root = (along * along + v * v * rho).sqrt();
        let sum = root + along;
        // path = v ρ/sum; root and along depend on v.
        let sum_by_v = (v * rho - along * self.standoff) / root - self.standoff;
        let by_v = rho / sum - v * rho / (sum * sum) * sum_by_v;
        let by_rho = v / sum - v * rho / (sum * sum) * 0.5 * v * v / root;
        let p_bar = 2.0 * by_rho * path_bar * p;
        (p_bar, ObjectBar { direction: self.standoff * p_bar, vergence: by_v * path_bar })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use isoplanat_base::testing::{assert_abs, assert_rel, between, central_difference};

    fn vector(rng: &mut fastrand::Rng, w: f64) -> DVec3 {
        DVec3::new(between(rng, -w, w), between(rng, -w, w), between(rng, -w, w))
    }

    /// A field angle is that of the ray from the object plane through the middle of the entrance pupil.
    #[test]
    fn field_angles_are_counted_at_the_entrance_pupil() {
        for (name, distance) in
            [("two_element", 1000.0), ("two_element", 40.0), ("cooke_triplet", 90.0), ("phone", 25.0)]
        {
            let lens = builtin::lens(name).expect("shipped");
            let lens = lens.changed(|l| l.object_vergence = 1.0 / distance).expect("a lens");
            let first = paraxial::first_order(&lens, lens.wavelengths.primary_nm);
            for angle in [0.0f64, 0.2, 0.5, 1.2] {
                let object = ObjectPoint::in_field(&lens, angle, 1.1);
                let position = object.position().expect("a plane at a distance");
                let height = -(distance + first.entrance_pupil_position) * angle.tan();
                let expected = DVec3::new(height * 1.1f64.cos(), height * 1.1f64.sin(), -distance);
                assert!((position - expected).length() < 1e-10 * expected.length(), "{name}, {angle}: {position}");
                assert!(object.vergence > 0.0 && object.direction.z > 0.0);
            }
            let lens = lens.changed(|l| l.object_vergence = 0.0).expect("a lens");
            assert_eq!(ObjectPoint::in_field(&lens, 1.7, 0.3), ObjectPoint::from_angle(1.7, 0.3, 0.0));
        }
    }

    #[test]
    fn slopes_and_angles_convert_both_ways() {
        let rng = &mut fastrand::Rng::with_seed(2);
        for _ in 0..100 {
            let field = FieldPoint { slope: vector(rng, 3.0).truncate(), vergence: between(rng, -1e-2, 1e-2) };
            let object = ObjectPoint::from(field);
            let back = object.to_field().expect("below 90°");
            assert!((back.slope - field.slope).length() < 1e-14 * (1.0 + field.slope.length_squared()));
            assert_rel(back.vergence, field.vergence, 1e-14, 1e-12, "vergence");
            // The object is where `launch` says: at −s/v on the plane z = −1/v.
            let position = object.position().expect("finite");
            let expected = (-field.slope / field.vergence).extend(-1.0 / field.vergence);
            assert!((position - expected).length() < 1e-12 * expected.length());
            let slope = field.slope;
            let again = ObjectPoint::from_angle(slope.length().atan(), slope.y.atan2(slope.x), object.vergence);
            assert!((again.direction - object.direction).length() < 1e-14);
            assert_abs(object.angle(), slope.length().atan(), 1e-14, "angle");
            if field.vergence > 0.0 {
                let real = ObjectPoint::finite(position);
                assert!((real.direction - object.direction).length() < 1e-14);
                assert_rel(real.vergence, object.vergence, 1e-14, 1e-12, "vergence of a position");
            }
        }
        for angle in [1.6, 2.5, 3.1] {
            let object = ObjectPoint::from_angle(angle, 0.3, 0.0);
            assert_abs(object.angle(), angle, 1e-15, "angle");
            assert_eq!(object.to_field(), None);
            assert_eq!(object.position(), None);
        }
        assert_eq!(ObjectPoint::from_angle(0.0, 0.0, 0.0), ObjectPoint::infinite(DVec3::Z));
    }

    /// The direction moves on the unit sphere, so cotangents are compared along tangents.
    #[test]
    fn conversions_pull_back() {
        let rng = &mut fastrand::Rng::with_seed(3);
        for _ in 0..50 {
            let (bar, v_bar) = (vector(rng, 1.0), between(rng, -1.0, 1.0));
            let value = |o: ObjectPoint| o.direction.dot(bar) + 1e2 * o.vergence * v_bar;
            let full = ObjectBar { direction: bar, vergence: 1e2 * v_bar };
            let (angle, azimuth) = (between(rng, 0.0, 3.0), between(rng, -3.0, 3.0));
            let pulled = ObjectPoint::from_angle_vjp(angle, azimuth, &full);
            let by_angle = central_difference(|h| value(ObjectPoint::from_angle(angle + h, azimuth, 0.0)), 1e-3);
            let by_azimuth = central_difference(|h| value(ObjectPoint::from_angle(angle, azimuth + h, 0.0)), 1e-3);
            assert_rel(pulled.0, by_angle, 1e-9, 0.1, "angle");
            assert_rel(pulled.1, by_azimuth, 1e-9, 0.1, "azimuth");
            let field = FieldPoint { slope: vector(rng, 1.0).truncate(), vergence: between(rng, -1e-2, 1e-2) };
            let dot = vector(rng, 1.0).truncate();
            let tangent = {
                let d = ObjectPoint::from_field(field).direction;
                ObjectBar { direction: bar - d * d.dot(bar), vergence: 1e2 * v_bar }
            };
            let f = |h: f64| value(ObjectPoint::from_field(FieldPoint { slope: field.slope + h * dot, ..field }));
            let pulled = ObjectPoint::from_field_vjp(field, &tangent).dot(dot);
            assert_rel(pulled, central_difference(f, 1e-3), 1e-8, 0.1, "slope");
        }
    }

    /// Rays and paths of the launch plane: geometry, then cotangents against differences.
    #[test]
    fn launch_planes_pull_back() {
        let system = System::new(&builtin::lens("double_gauss").expect("shipped"), 550.0);
        let rng = &mut fastrand::Rng::with_seed(4);
        for round in 0..60 {
            let vergence = [0.0, 1e-3, 0.2, -0.05][round % 4];
            let object = ObjectPoint::from_angle(between(rng, 0.0, 3.0), between(rng, -3.0, 3.0), vergence);
            let plane = LaunchPlane::new(&system, object);
            let p = 5.0 * vector(rng, 1.0).truncate();
            let ray = plane.ray(p);
            assert!((plane.through(ray.origin + 3.0 * ray.direction) - p).length() < 1e-12);
            if let Some(position) = object.position() {
                // The ray runs through its object, and the path is the difference of two distances.
                assert!((position - ray.origin).cross(ray.direction).length() < 1e-12 * position.length());
                let middle = -plane.standoff() * object.direction;
                let far = vergence.signum() * ((ray.origin - position).length() - (middle - position).length());
                assert_abs(plane.path(&ray), far, 1e-10, "path");
            } else {
                assert_eq!(plane.path(&ray), 0.0);
            }
            // Cotangents: p, direction (on the sphere), vergence; the plane's distance is held.
            let (o_bar, d_bar, path_bar) = (vector(rng, 1.0), vector(rng, 1.0), between(rng, -1.0, 1.0));
            let (p_dot, v_dot) = (vector(rng, 1.0).truncate(), 0.01 * between(rng, -1.0, 1.0));
            let axis = vector(rng, 1.0);
            let d_dot = axis.cross(object.direction);
            let f = |h: f64| {
                let turned = glam::DQuat::from_scaled_axis(h * axis);
                let moved = LaunchPlane {
                    object: ObjectPoint { direction: turned * object.direction, vergence: object.vergence + h * v_dot },
                    // The smallest turn that takes the direction along; a turn about the direction itself is taken out.
                    u: turned * plane.u,
                    w: turned * plane.w,
                    ..plane
                };
                let ray = moved.ray(p + h * p_dot);
                ray.origin.dot(o_bar) + ray.direction.dot(d_bar) + moved.path(&ray) * path_bar
            };
            let (o_path, path_back) = plane.path_vjp(&ray, path_bar);
            let (p_bar, mut bar) = plane.ray_vjp(&ray, o_bar + o_path, d_bar);
            bar.add(&path_back);
            // The test's turn about the direction rotates p within the plane.
            let spin = axis.dot(object.direction) * object.direction.cross(p.x * plane.u + p.y * plane.w);
            let p_spin = DVec2::new(plane.u.dot(spin), plane.w.dot(spin));
            let pulled = p_bar.dot(p_dot + p_spin) + bar.direction.dot(d_dot) + bar.vergence * v_dot;
            assert_rel(pulled, central_difference(f, 1e-4), 1e-7, 0.1, &format!("round {round}"));
        }
    }
}
