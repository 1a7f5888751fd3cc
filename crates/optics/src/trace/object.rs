//! Object points of any field angle, and the rays that come from them.
//!
//! An [`ObjectPoint`] is the unit direction `d` of its light at the first vertex and a vergence `v`. Its ray through
//! the point `e` runs along `d + v e`: one formula for infinitely far, near and virtual objects and for half fields of
//! 90° and more. The object itself stands at `−d/v`. A slope (image side sign: a positive one runs up and lands above the
//! axis of a lens with positive power) and a distance from the plane of the first vertex make one, too: [`ObjectPoint::from_slope`].
//!
//! Rays are launched from a plane perpendicular to `d` ([`LaunchPlane`]): the light of an infinitely far object moves
//! parallel to itself, that of a near one turns about the object. The plane is a wavefront of the former; of the latter
//! [`LaunchPlane::path`] is the optical path that is missing to one.

use std::f64::consts::FRAC_PI_2;

use glam::{DVec2, DVec3};

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

    /// The point of the object plane of `lens` at the field angle `angle` in the meridian `azimuth`, radians: what a field angle means
    /// in a lens file. It is the angle to the axis at which light runs through the middle of the paraxial entrance pupil (primary
    /// wavelength); in a lens that is telecentric in object space ([`paraxial::FieldOrigin`]), and has no such pupil, through the first vertex. From 90° on a
    /// plane has no such point, and the point is infinitely far.
    pub fn in_field(lens: &Prescription, angle: f64, azimuth: f64) -> Self {
        let d = Self::from_angle(angle, azimuth, 0.0).direction;
        let v = lens.object_vergence;
        if v == 0.0 || d.z <= 0.0 {
            return Self { direction: d, vergence: 0.0 };
        }
        // The object's plane stands 1/v before the first vertex, its height is counted at the pupil's middle: no quotient of a
        // distant pupil enters.
        let origin = paraxial::field_origin(lens);
        let g = (origin.reach * d.truncate()).extend(origin.scale * d.z);
        let length = g.length() * g.z.signum();
        Self { direction: g / length, vergence: v * (g.z / length) }
    }

    /// The point of slope `slope` (tangents of the light's angle at the first vertex, along x and y) in the plane 1/`vergence` before
    /// the first vertex (1/mm; 0 is infinitely far): it stands at `−slope/vergence` there.
    ///
    /// Étendue: `dL dM` per unit of object slope squared is `N⁴ dx dy` on the plane of the first vertex, exactly and for every
    /// vergence; that is the weight of a ray (times `|∂(x, y)/∂(stop point)|`).
    ///
    /// ```
    /// use glam::DVec2;
    /// use isoplanat_optics::trace::ObjectPoint;
    ///
    /// // An object 1 m before the lens whose light falls by 0.1 stands 100 mm above the axis.
    /// let at = ObjectPoint::from_slope(DVec2::new(0.0, -0.1), 1e-3).position().expect("near");
    /// assert!((at.y - 100.0).abs() < 1e-9 && (at.z + 1000.0).abs() < 1e-9);
    /// ```
    pub fn from_slope(slope: DVec2, vergence: f64) -> Self {
        let cosine = (1.0 + slope.length_squared()).sqrt().recip();
        Self { direction: (slope * cosine).extend(cosine), vergence: vergence * cosine }
    }

    /// Slope of the light at the first vertex and vergence of the plane in which the point stands, as [`Self::from_slope`] takes them;
    /// `None` from 90° on.
    pub fn slope(&self) -> Option<(DVec2, f64)> {
        let d = self.direction;
        (d.z > 0.0).then(|| (d.truncate() / d.z, self.vergence / d.z))
    }

    /// Pulls a cotangent on [`Self::from_angle`] back to the angle and the azimuth.
    pub fn from_angle_vjp(angle: f64, azimuth: f64, bar: &ObjectBar) -> (f64, f64) {
        let ((s, c), (sa, ca)) = (angle.sin_cos(), azimuth.sin_cos());
        let d = bar.direction;
        (d.x * c * ca + d.y * c * sa - d.z * s, s * (d.y * ca - d.x * sa))
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

impl Ray {
    /// The ray of `object` through `point` (mm, frame of the first vertex), starting there.
    pub fn from_object(object: ObjectPoint, point: DVec3) -> Self {
        Self { origin: point, direction: object.direction_at(point).0 }
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
        Ray::from_object(self.object, p.x * self.u + p.y * self.w - self.standoff * self.object.direction)
    }

    /// Pulls cotangents on [`Self::ray`] back to `p` and to the object. The plane's distance is held: it moves origins
    /// along their rays only.
    pub(crate) fn ray_vjp(&self, ray: &Ray, origin_bar: DVec3, direction_bar: DVec3) -> (DVec2, ObjectBar) {
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
    pub(crate) fn through(&self, point: DVec3) -> DVec2 {
        self.towards(point, 1.0)
    }

    /// The point of the plane whose ray runs through `point/weight`: a point in homogeneous coordinates, so that one at infinity
    /// (`weight` 0: all rays along `point`) is no special case.
    pub(crate) fn towards(&self, point: DVec3, weight: f64) -> DVec2 {
        let (d, v) = (self.object.direction, self.object.vergence);
        let along = (1.0 - v * self.standoff) / (weight + v * d.dot(point));
        along * DVec2::new(self.u.dot(point), self.w.dot(point))
    }

    /// `∂(origin, direction)/∂p`, one pair for each of the plane's axes.
    #[inline]
    pub(crate) fn ray_columns(&self, ray: &Ray) -> [(DVec3, DVec3); 2] {
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
    pub(crate) fn path_vjp(&self, ray: &Ray, path_bar: f64) -> (DVec3, ObjectBar) {
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
            let (slope, vergence) = (vector(rng, 3.0).truncate(), between(rng, -1e-2, 1e-2));
            let object = ObjectPoint::from_slope(slope, vergence);
            let back = object.slope().expect("below 90°");
            assert!((back.0 - slope).length() < 1e-14 * (1.0 + slope.length_squared()));
            assert_rel(back.1, vergence, 1e-14, 1e-12, "vergence");
            // At −s/v on the plane z = −1/v.
            let position = object.position().expect("finite");
            let expected = (-slope / vergence).extend(-1.0 / vergence);
            assert!((position - expected).length() < 1e-12 * expected.length());
            let again = ObjectPoint::from_angle(slope.length().atan(), slope.y.atan2(slope.x), object.vergence);
            assert!((again.direction - object.direction).length() < 1e-14);
            assert_abs(object.angle(), slope.length().atan(), 1e-14, "angle");
            if vergence > 0.0 {
                let real = ObjectPoint::finite(position);
                assert!((real.direction - object.direction).length() < 1e-14);
                assert_rel(real.vergence, object.vergence, 1e-14, 1e-12, "vergence of a position");
            }
        }
        for angle in [1.6, 2.5, 3.1] {
            let object = ObjectPoint::from_angle(angle, 0.3, 0.0);
            assert_abs(object.angle(), angle, 1e-15, "angle");
            assert_eq!(object.slope(), None);
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
