//! The convex hull of points: where a fit to them says something.

use glam::DVec2;

/// A convex polygon as the half planes `n · p ≤ d` that make it.
#[derive(Clone, Debug)]
pub(crate) struct Hull {
    planes: Vec<(DVec2, f64)>,
}

impl Hull {
    /// The hull of `points`, every side moved outwards by `room`. Fewer than three points apart have none: everything is within.
    pub(crate) fn around(points: &[DVec2], room: f64) -> Self {
        let corners = corners(points);
        let sides = corners.iter().zip(corners.iter().cycle().skip(1));
        let plane = |(a, b): (&DVec2, &DVec2)| {
            let outwards = -(*b - *a).perp().normalize_or_zero();
            (outwards, outwards.dot(*a) + room)
        };
        Self { planes: if corners.len() > 2 { sides.map(plane).collect() } else { Vec::new() } }
    }

    /// Whether `point` lies within.
    pub(crate) fn holds(&self, point: DVec2) -> bool {
        self.planes.iter().all(|(n, d)| n.dot(point) <= *d)
    }

    /// The part of the line `from + t · along` within it, from the least `t` to the greatest; none where it is beside the hull.
    pub(crate) fn cut(&self, from: DVec2, along: DVec2) -> Option<[f64; 2]> {
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        for (n, d) in &self.planes {
            let (slope, rest) = (n.dot(along), d - n.dot(from));
            if slope > 0.0 {
                high = high.min(rest / slope);
            } else if slope < 0.0 {
                low = low.max(rest / slope);
            } else if rest < 0.0 {
                return None;
            }
        }
        (high > low).then_some([low, high])
    }

    /// Its part of the line of constant `y`, within −1 to 1.
    pub(crate) fn chord(&self, y: f64) -> Option<[f64; 2]> {
        let [low, high] = self.cut(DVec2::new(0.0, y), DVec2::X)?;
        let (low, high) = (low.max(-1.0), high.min(1.0));
        (high > low).then_some([low, high])
    }
}

/// Corners of the hull, counterclockwise, by Andrew's two chains.
fn corners(points: &[DVec2]) -> Vec<DVec2> {
    let mut sorted: Vec<DVec2> = points.iter().copied().filter(|p| p.is_finite()).collect();
    sorted.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    sorted.dedup();
    let chain = |points: &mut dyn Iterator<Item = &DVec2>| {
        let mut kept: Vec<DVec2> = Vec::new();
        for p in points {
            while let [.., a, b] = kept[..]
                && (b - a).perp_dot(*p - b) <= 0.0
            {
                kept.pop();
            }
            kept.push(*p);
        }
        kept.pop();
        kept
    };
    let lower = chain(&mut sorted.iter());
    [lower, chain(&mut sorted.iter().rev())].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The hull of points drawn in a disk: all are within, chords are those of the disk, nearly.
    #[test]
    fn a_disks_hull_has_the_disks_chords() {
        let rng = &mut fastrand::Rng::with_seed(3);
        let drawn = |rng: &mut fastrand::Rng| rng.f64().sqrt() * DVec2::from_angle(std::f64::consts::TAU * rng.f64());
        let points: Vec<DVec2> = (0..20_000).map(|_| 0.5 * drawn(rng) + DVec2::new(0.2, -0.1)).collect();
        let hull = Hull::around(&points, 0.0);
        assert!(points.iter().all(|p| Hull::around(&points, 1e-12).holds(*p)));
        for y in [-0.59f64, -0.3, 0.0, 0.39] {
            let half = (0.25 - (y + 0.1).powi(2)).sqrt();
            let [a, b] = hull.chord(y).expect("a chord");
            assert!((a - (0.2 - half)).abs() < 0.03 && (b - (0.2 + half)).abs() < 0.03, "{y}: {a} {b}, {half}");
            assert!(a >= 0.2 - half - 1e-9 && b <= 0.2 + half + 1e-9);
        }
        assert!(hull.chord(0.41).is_none() && hull.chord(-0.61).is_none());
        assert!(!hull.holds(DVec2::new(0.2, 0.41)));
        // Along any line.
        let (from, along) = (DVec2::new(-0.7, -0.6), DVec2::new(0.02, 0.011));
        let [low, high] = hull.cut(from, along).expect("meets");
        for t in [low + 1e-9, 0.5 * (low + high), high - 1e-9] {
            assert!(hull.holds(from + t * along));
        }
        assert!(!hull.holds(from + (low - 1e-6) * along) && !hull.holds(from + (high + 1e-6) * along));
        assert_eq!(hull.cut(from, DVec2::Y), None);
    }

    /// Points on a line, or none, leave everything open.
    #[test]
    fn what_has_no_hull_leaves_everything_open() {
        for points in [&[][..], &[DVec2::ZERO], &[DVec2::ZERO, DVec2::X, 2.0 * DVec2::X]] {
            assert_eq!(Hull::around(points, 0.01).chord(0.7), Some([-1.0, 1.0]));
        }
    }
}
