//! The path outside the lens.

use glam::DVec2;

/// Path from the crossing `e` of the first vertex plane to the object of slope `u` at vergence `v`, less that from the plane's middle, mm; and how it changes with `u`.
pub(super) fn beyond(u: DVec2, v: f64, e: DVec2) -> (f64, DVec2) {
    let (far, near) = ((1.0 + (u + v * e).length_squared()).sqrt(), (1.0 + u.length_squared()).sqrt());
    let path = (2.0 * u.dot(e) + v * e.length_squared()) / (far + near);
    (path, e / far - u * (path / (far * near)))
}

/// Pulls cotangents on both of [`beyond`] back to `u` and `e`.
pub(super) fn beyond_vjp(u: DVec2, v: f64, e: DVec2, path_bar: f64, slope_bar: DVec2) -> (DVec2, DVec2) {
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
