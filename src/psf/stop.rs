//! Points of the stop: the nodes that rays are aimed at, and the dense points that polynomials are evaluated at.
//!
//! All of it on the unit disk. The sensor point lies on +y, so the half `x > 0` stands for both.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::DVec2;
use ndarray::Array2;

use super::fit::{Evaluation, Parity, from_nodes, terms};

/// Nodes of the stop for polynomials of a degree, and the matrices between them.
#[derive(Clone, Debug)]
pub struct StopNodes {
    /// Degree of the polynomials.
    pub degree: usize,
    /// The nodes, `x ≥ 0`.
    pub nodes: Vec<DVec2>,
    /// From node values to coefficients, `[term, node]`, even and odd in x.
    pub coefficients: [Array2<f64>; 2],
    /// Values and derivatives at the nodes, even and odd in x.
    pub at_nodes: [Evaluation; 2],
}

impl StopNodes {
    /// For polynomials of `degree` through nodes within the part `kept` of the unit disk.
    ///
    /// Rings at Gauss–Lobatto-like radii, the rim included, with half-turns of azimuths symmetric about y.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub fn new(degree: usize, kept: f64) -> Self {
        let (rings, azimuths) = (degree / 2 + 2, degree + 2);
        let place = |i: usize, j: usize| {
            let radius = kept * (FRAC_PI_2 * (i as f64 + 1.0) / rings as f64).sin();
            let angle = PI * ((j as f64 + 0.5) / azimuths as f64 - 0.5);
            radius * DVec2::new(angle.cos(), angle.sin())
        };
        let nodes: Vec<DVec2> = (0..rings).flat_map(|i| (0..azimuths).map(move |j| place(i, j))).collect();
        let coefficients = [Parity::Even, Parity::Odd].map(|parity| from_nodes(&nodes, degree, parity));
        let at_nodes = [Parity::Even, Parity::Odd].map(|parity| Evaluation::new(&nodes, degree, parity));
        Self { degree, nodes, coefficients, at_nodes }
    }

    /// Number of even and odd terms.
    pub fn terms(degree: usize) -> [usize; 2] {
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
pub fn equal_area_rings(count: usize) -> Vec<DVec2> {
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
    use crate::testing::assert_rel;

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
