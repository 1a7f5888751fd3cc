//! The share of a cell of the pupil's raster that an edge leaves open.

use glam::DVec2;

/// Area of the unit square around the origin where `n · p + t ≥ 0`, `n` a unit vector: an edge at distance `t` from the middle.
pub(super) fn open(normal: DVec2, t: f64) -> f64 {
    let [a, b] = [normal.x.abs(), normal.y.abs()];
    let (small, large) = (a.min(b), a.max(b));
    // By the corner that the edge leaves last, distance along the normal from the lowest corner.
    let (half, side) = (0.5 * (small + large), t.abs());
    let area = if side >= half {
        1.0
    } else if side <= 0.5 * (large - small) {
        0.5 + side / large
    } else {
        1.0 - (half - side).powi(2) / (2.0 * small * large)
    };
    if t >= 0.0 { area } else { 1.0 - area }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against counted points, edges of all directions and distances.
    #[test]
    fn areas_are_counted_ones() {
        let rng = &mut fastrand::Rng::with_seed(2);
        for k in 0..200 {
            let angle = if k < 8 { f64::from(k) * std::f64::consts::FRAC_PI_4 } else { 7.0 * rng.f64() };
            let (normal, t) = (DVec2::from_angle(angle), 2.0 * rng.f64() - 1.0);
            let n = 400;
            let at = |i: i32| (f64::from(i) + 0.5) / f64::from(n) - 0.5;
            let inside = |i: i32, j: i32| normal.dot(DVec2::new(at(i), at(j))) + t >= 0.0;
            let count = (0..n).flat_map(|i| (0..n).map(move |j| (i, j))).filter(|(i, j)| inside(*i, *j)).count();
            let counted = count as f64 / f64::from(n * n);
            assert!((open(normal, t) - counted).abs() < 4e-3, "{angle} {t}: {} for {counted}", open(normal, t));
        }
        assert_eq!((open(DVec2::X, 0.25), open(DVec2::Y, -0.75)), (0.75, 0.0));
    }
}
