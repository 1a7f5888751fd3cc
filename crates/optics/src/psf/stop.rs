//! Points of the stop: the nodes that rays are aimed at, and the dense points that polynomials are evaluated at.
//!
//! All of it on the unit disk. The sensor point lies on +y, so the half `x > 0` stands for both.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::OnceLock;

use glam::DVec2;
use ndarray::Array2;

use super::fit::{Evaluation, Parity, from_nodes, terms};

/// A part of the unit stop: the disk of a radius, cut by caps that end at two heights along the meridian, the centre inside. Caps are flatter
/// than the rim (radius 2 to its 1): what fails or is closed at the ends of an oblique beam has edges like that.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// Radius.
    pub radius: f64,
    /// Lowest and highest y, within the radius.
    pub heights: [f64; 2],
}

/// Radius of the caps.
const CAP: f64 = 2.0;
/// The last rows of nodes stand at this part of the way to the ends, where rows have no length.
const POLE: f64 = 0.99;

impl Part {
    /// All of it.
    pub(crate) const WHOLE: Self = Self::disk(1.0);

    /// A smaller disk.
    pub(crate) const fn disk(radius: f64) -> Self {
        Self { radius, heights: [-radius, radius] }
    }

    /// What lies between caps at two heights.
    pub(crate) fn between(heights: [f64; 2]) -> Self {
        Self { radius: 1.0, heights }
    }

    /// Whether it is all of the stop.
    pub(crate) fn is_whole(self) -> bool {
        self == Self::WHOLE
    }

    /// Whether caps cut it at the low and at the high end.
    fn cut(self) -> [bool; 2] {
        [self.heights[0] > -self.radius, self.heights[1] < self.radius]
    }

    /// What both have.
    #[must_use]
    pub(crate) fn common(self, other: Self) -> Self {
        let radius = self.radius.min(other.radius);
        let low = self.heights[0].max(other.heights[0]).max(-radius);
        Self { radius, heights: [low, self.heights[1].min(other.heights[1]).min(radius)] }
    }

    /// The least that has all of both.
    #[must_use]
    pub(crate) fn around(self, other: Self) -> Self {
        let heights = [self.heights[0].min(other.heights[0]), self.heights[1].max(other.heights[1])];
        Self { radius: self.radius.max(other.radius), heights }
    }

    /// Turned by half a circle.
    #[must_use]
    pub(crate) fn turned(self) -> Self {
        Self { heights: [-self.heights[1], -self.heights[0]], ..self }
    }

    /// Heights of the chord at `x` that lie inside; the first above the second where there are none.
    pub(crate) fn chord(self, x: f64) -> [f64; 2] {
        let half = (self.radius * self.radius - x * x).max(0.0).sqrt();
        let sag = CAP - (CAP * CAP - x * x).sqrt();
        let [low, high] = self.cut();
        [
            if low { (self.heights[0] + sag).max(-half) } else { -half },
            if high { (self.heights[1] - sag).min(half) } else { half },
        ]
    }

    /// Half the width at a height.
    fn width(self, y: f64) -> f64 {
        let circle = |radius: f64, y: f64| (radius * radius - y * y).max(0.0).sqrt();
        let [low, high] = self.cut();
        let below = if low { circle(CAP, (self.heights[0] + CAP - y).max(0.0)) } else { f64::INFINITY };
        let above = if high { circle(CAP, (y - self.heights[1] + CAP).max(0.0)) } else { f64::INFINITY };
        circle(self.radius, y).min(below).min(above)
    }

    /// Its share of the stop's area, to 1e-3.
    pub(crate) fn share(self) -> f64 {
        const CHORDS: u32 = 200;
        if self.cut() == [false; 2] {
            return self.radius.powi(2);
        }
        let at = |k: u32| self.radius * (f64::from(k) + 0.5) / f64::from(CHORDS);
        let length = |[low, high]: [f64; 2]| (high - low).max(0.0);
        2.0 * self.radius * (0..CHORDS).map(|k| length(self.chord(at(k)))).sum::<f64>() / f64::from(CHORDS) / PI
    }

    /// How far inside a point of the stop lies, as seen from those of its borders that are not the stop's rim.
    pub fn depth(self, at: DVec2) -> f64 {
        let [low, high] = self.cut();
        let to = |middle: f64| CAP - at.distance(DVec2::new(0.0, middle));
        let by_radius = if self.radius < 1.0 { self.radius - at.length() } else { f64::INFINITY };
        let above = if low { to(self.heights[0] + CAP) } else { f64::INFINITY };
        let below = if high { to(self.heights[1] - CAP) } else { f64::INFINITY };
        by_radius.min(above).min(below)
    }

    /// Nodes for polynomials of a degree, `x ≥ 0`: rings at Gauss–Lobatto-like radii, the rim included, with half-turns of azimuths symmetric
    /// about y; where there are caps, rows at such heights instead.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub(crate) fn nodes(self, degree: usize) -> Vec<DVec2> {
        let rings = degree / 2 + 2;
        let outwards = |i: usize| (FRAC_PI_2 * (i as f64 + 1.0) / rings as f64).sin();
        if self.cut() == [false; 2] {
            let azimuths = degree + 2;
            let place = |i: usize, j: usize| {
                let angle = PI * ((j as f64 + 0.5) / azimuths as f64 - 0.5);
                self.radius * outwards(i) * DVec2::new(angle.cos(), angle.sin())
            };
            return (0..rings).flat_map(|i| (0..azimuths).map(move |j| place(i, j))).collect();
        }
        let [low, high] = self.heights;
        let rows = degree + 3;
        let place = |i: usize, j: usize| {
            let t = POLE * (PI * (j as f64 / (rows - 1) as f64 - 0.5)).sin();
            let y = 0.5 * (low + high) + 0.5 * (high - low) * t;
            DVec2::new(outwards(i) * self.width(y), y)
        };
        (0..rings).flat_map(|i| (0..rows).map(move |j| place(i, j))).collect()
    }
}

/// Nodes of the stop for polynomials of a degree, and the matrices between them, which are made when they are first asked for: of most parts that rays are tried through, none is.
#[derive(Clone, Debug)]
pub(crate) struct StopNodes {
    /// Degree of the polynomials.
    pub degree: usize,
    /// The nodes, `x ≥ 0`.
    pub nodes: Vec<DVec2>,
    coefficients: OnceLock<[Array2<f64>; 2]>,
    at_nodes: OnceLock<[Evaluation; 2]>,
}

impl StopNodes {
    /// For polynomials of `degree` through [`Part::nodes`].
    pub(crate) fn new(degree: usize, part: Part) -> Self {
        let nodes = part.nodes(degree);
        Self { degree, nodes, coefficients: OnceLock::new(), at_nodes: OnceLock::new() }
    }

    /// From node values to coefficients, `[term, node]`, even and odd in x.
    pub(crate) fn coefficients(&self) -> &[Array2<f64>; 2] {
        let made = || [Parity::Even, Parity::Odd].map(|parity| from_nodes(&self.nodes, self.degree, parity));
        self.coefficients.get_or_init(made)
    }

    /// Values and derivatives at the nodes, even and odd in x.
    pub(crate) fn at_nodes(&self) -> &[Evaluation; 2] {
        let made = || [Parity::Even, Parity::Odd].map(|parity| Evaluation::new(&self.nodes, self.degree, parity));
        self.at_nodes.get_or_init(made)
    }

    /// Number of even and odd terms.
    pub(crate) fn terms(degree: usize) -> [usize; 2] {
        [Parity::Even, Parity::Odd].map(|parity| terms(degree, parity).len())
    }
}

/// Dense points of the half `x > 0`, of equal area, and what evaluates polynomials there.
#[derive(Clone, Debug)]
pub struct StopPoints {
    /// Degree of the polynomials.
    pub degree: usize,
    /// The points.
    pub points: Vec<DVec2>,
    /// Evaluation of functions even and odd in x.
    pub at: [Evaluation; 2],
    /// Spacing of the points on the unit stop.
    pub spacing: f64,
}

impl StopPoints {
    /// About `count` points of the whole disk, half of them kept.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub fn new(degree: usize, count: usize) -> Self {
        let points = equal_area_rings(count);
        let at = [Parity::Even, Parity::Odd].map(|parity| Evaluation::new(&points, degree, parity));
        let spacing = (FRAC_PI_2 / points.len() as f64).sqrt();
        Self { degree, points, at, spacing }
    }
}

/// About `count / 2` points of equal area on the half `x > 0` of the unit disk: rings of as many points as their area asks
/// for, mirror images in y or nearly so, so that a beam cut from above and one cut from below come out alike.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "small counts"
)]
pub(crate) fn equal_area_rings(count: usize) -> Vec<DVec2> {
    let half = count.div_ceil(2).max(1);
    let rings = ((count as f64 / PI).sqrt().round() as usize).clamp(1, half);
    // Ring by ring; the last takes what is left.
    let mut in_ring: Vec<usize> = (0..rings)
        .map(|k| ((2 * k + 1) as f64 * half as f64 / (rings * rings) as f64).round().max(1.0) as usize)
        .collect();
    let inner: usize = in_ring[..rings - 1].iter().sum();
    in_ring[rings - 1] = half.saturating_sub(inner).max(1);
    let total: usize = in_ring.iter().sum();
    let mut points = Vec::with_capacity(total);
    let mut before = 0;
    for n in in_ring {
        let radius = ((before as f64 + 0.5 * n as f64) / total as f64).sqrt();
        before += n;
        points.extend((0..n).map(|j| {
            let (x, y) = (PI * (j as f64 + 0.5) / n as f64).sin_cos();
            radius * DVec2::new(x, y)
        }));
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::assert_rel;

    /// Polynomials of the degree come back, as values, from the nodes of every part; shares are areas.
    #[test]
    fn parts_have_nodes_and_areas() {
        let parts = [
            Part::WHOLE,
            Part::disk(0.6),
            Part::between([-0.45, 1.0]),
            Part::between([-1.0, 0.3]),
            Part::between([-0.3, 0.15]),
            Part::between([-1.0, 0.6]).common(Part::disk(0.75)),
        ];
        let rng = &mut fastrand::Rng::with_seed(3);
        for part in parts {
            let stop = StopNodes::new(9, part);
            let c: Vec<f64> = (0..StopNodes::terms(9)[0]).map(|_| rng.f64() - 0.5).collect();
            let values = stop.at_nodes()[0].at(super::super::fit::Of::Value, &c);
            let back = super::super::fit::apply(&stop.coefficients()[0], &values);
            // Of small parts other polynomials have nearly the same values there: values count; 2e-9 of a fifth of the stop.
            let again = stop.at_nodes()[0].at(super::super::fit::Of::Value, &back);
            for (a, b) in again.iter().zip(&values) {
                assert_rel(*a, *b, 1e-8, 1.0, "values");
            }
            let n = 400;
            let at = |i: i32| (f64::from(i) + 0.5) / f64::from(n) * 2.0 - 1.0;
            let inside = |p: DVec2| p.length() <= 1.0 && part.depth(p) > 0.0;
            let grid = (0..n).flat_map(|i| (0..n).map(move |j| DVec2::new(at(i), at(j))));
            let area = grid.filter(|p| inside(*p)).count() as f64 * 4.0 / f64::from(n * n);
            assert_rel(part.share(), area / PI, 2e-3, 1.0, "share");
            assert!(stop.nodes.iter().all(|p| p.length() < 1.0 + 1e-12 && part.depth(*p) > -1e-12));
            for x in [0.0, 0.3, 0.7].into_iter().filter(|x| *x < part.radius) {
                let [low, high] = part.chord(x);
                for y in [low, high] {
                    let at = DVec2::new(x, y);
                    assert!(low > high || part.depth(at).abs().min((1.0 - at.length()).abs()) < 1e-9, "{part:?} {at}");
                }
            }
        }
        assert_eq!(Part::between([-0.45, 1.0]).turned(), Part::between([-1.0, 0.45]));
    }

    /// Rings of equal area: their count, moments those of the disk.
    #[test]
    fn dense_points_cover_the_disk_evenly() {
        for count in [1, 2, 7, 60, 100, 200, 512, 3000] {
            let points = equal_area_rings(count);
            let n = points.len() as f64;
            assert!((2 * points.len()).abs_diff(count) <= 1, "{count}: {}", points.len());
            assert!(points.iter().all(|p| p.x > 0.0));
            let mean = |f: &dyn Fn(&DVec2) -> f64| points.iter().map(f).sum::<f64>() / n;
            // ⟨y⟩ = 0, ⟨r²⟩ = 1/2, ⟨y²⟩ = 1/4 over the disk.
            assert!(mean(&|p| p.y).abs() < 1e-12, "{count}");
            assert_rel(mean(&|p| p.length_squared()), 0.5, 1e-12, 0.0, "second moment");
            if count >= 60 {
                assert_rel(mean(&|p| p.y * p.y), 0.25, 1e-2, 0.0, "moment of y");
            }
        }
    }
}
