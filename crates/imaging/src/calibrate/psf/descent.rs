//! Least squares with no weight below zero, smooth over moves and radius: projected gradients with momentum (Beck and Teboulle, SIAM J. Imaging
//! Sci. 2(1), 2009), started anew where it goes astray (O'Donoghue and Candès, Found. Comput. Math. 15, 2015).

use std::collections::HashMap;

use ndarray::Array1;

use super::gram::Gram;
use isoplanat_optics::psf::measured::Moves;

/// Steps at most, and the change of the weights that ends them, of their size.
const STEPS: usize = 600;
const CHANGE: f64 = 1e-6;
/// Steps that find the largest curvature, and how much is added to it.
const POWER: usize = 30;
const SAFE: f64 = 1.1;

/// Second differences over moves and over radius, squared and added up over the whole plane.
pub(super) struct Smoothness {
    /// The four neighbours of a move, mirror images put back; none beyond the reach, where there is no light.
    neighbours: Vec<[Option<usize>; 4]>,
    /// How often a move stands in the plane.
    counts: Vec<f64>,
}

impl Smoothness {
    pub(super) fn new(moves: &Moves) -> Self {
        let places: HashMap<[i32; 2], usize> = moves.steps().iter().enumerate().map(|(i, s)| (*s, i)).collect();
        let neighbours = moves
            .steps()
            .iter()
            .map(|[a, b]| {
                [[a - 1, *b], [a + 1, *b], [*a, b - 1], [*a, b + 1]].map(|[a, b]| places.get(&[a, b.abs()]).copied())
            })
            .collect();
        Self { neighbours, counts: moves.iter().map(|m| m.1).collect() }
    }

    /// Second differences of one kernel.
    fn differences(&self, weights: &Array1<f64>) -> Array1<f64> {
        let one = |(i, n): (usize, &[Option<usize>; 4])| {
            n.iter().flatten().map(|k| weights[*k]).sum::<f64>() - 4.0 * weights[i]
        };
        self.neighbours.iter().enumerate().map(one).collect()
    }

    /// Adds half the gradient of the whole roughness, times `scale`.
    fn add(&self, weights: &[Array1<f64>], scale: f64, to: &mut [Array1<f64>]) {
        for (w, to) in weights.iter().zip(to.iter_mut()) {
            let rough = self.differences(w);
            for (i, n) in self.neighbours.iter().enumerate() {
                let v = scale * self.counts[i] * rough[i];
                to[i] -= 4.0 * v;
                n.iter().flatten().for_each(|k| to[*k] += v);
            }
        }
        for j in 1..weights.len().saturating_sub(1) {
            for i in 0..self.counts.len() {
                let v = scale * self.counts[i] * (weights[j - 1][i] - 2.0 * weights[j][i] + weights[j + 1][i]);
                to[j - 1][i] += v;
                to[j][i] -= 2.0 * v;
                to[j + 1][i] += v;
            }
        }
    }
}

/// The best weights, from `start`, both `[knot][move]`; `smoothness` counts in the mean of the equations' diagonal.
pub(super) fn descend(gram: &Gram, smooth: &Smoothness, smoothness: f64, start: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let diagonal = gram.diagonal();
    let count = diagonal.iter().map(Array1::len).sum::<usize>() as f64;
    let mean = diagonal.iter().map(|d| d.sum()).sum::<f64>() / count;
    let scale = smoothness * mean;
    let product = |w: &[Array1<f64>]| {
        let mut out = gram.times(w);
        smooth.add(w, scale, &mut out);
        out
    };
    // In units in which every weight has the same curvature: second differences have 20 and 6 on their diagonals.
    let unit: Vec<Array1<f64>> = diagonal
        .iter()
        .map(|d| {
            d.iter().zip(&smooth.counts).map(|(d, n)| (d + 26.0 * scale * n).max(1e-9 * mean).sqrt().recip()).collect()
        })
        .collect();
    let scaled = |w: &[Array1<f64>]| -> Vec<Array1<f64>> {
        let inner: Vec<Array1<f64>> = w.iter().zip(&unit).map(|(w, u)| w * u).collect();
        product(&inner).into_iter().zip(&unit).map(|(g, u)| g * u).collect()
    };
    let norm = |w: &[Array1<f64>]| w.iter().map(|w| w.dot(w)).sum::<f64>().sqrt();
    let rng = &mut fastrand::Rng::with_seed(3);
    let mut vector: Vec<Array1<f64>> = unit.iter().map(|u| u.iter().map(|_| rng.f64()).collect()).collect();
    let mut largest = 0.0;
    for _ in 0..POWER {
        let size = norm(&vector);
        vector.iter_mut().for_each(|v| *v /= size);
        vector = scaled(&vector);
        largest = norm(&vector);
    }
    let step = (SAFE * largest).recip();
    let right: Vec<Array1<f64>> = gram.right.iter().zip(&unit).map(|(r, u)| r * u).collect();
    let mut at: Vec<Array1<f64>> = start.into_iter().zip(&unit).map(|(w, u)| Array1::from(w) / u).collect();
    let (mut ahead, mut t) = (at.clone(), 1.0f64);
    for _ in 0..STEPS {
        let gradient = scaled(&ahead);
        let next: Vec<Array1<f64>> = ahead
            .iter()
            .zip(gradient.iter().zip(&right))
            .map(|(a, (g, r))| ndarray::Zip::from(a).and(g).and(r).map_collect(|a, g, r| (a - step * (g - r)).max(0.0)))
            .collect();
        let moved: Vec<Array1<f64>> = next.iter().zip(&at).map(|(n, a)| n - a).collect();
        // Momentum that leads back uphill starts anew.
        let uphill: f64 = ahead.iter().zip(&next).zip(&moved).map(|((a, n), m)| (a - n).dot(m)).sum();
        let (change, size) = (norm(&moved), norm(&next));
        if uphill > 0.0 {
            t = 1.0;
            ahead = next.clone();
        } else {
            let grown = 0.5 * (1.0 + (1.0 + 4.0 * t * t).sqrt());
            let by = (t - 1.0) / grown;
            ahead = next.iter().zip(&moved).map(|(n, m)| n + &(by * m)).collect();
            t = grown;
        }
        at = next;
        if change <= CHANGE * size {
            break;
        }
    }
    at.into_iter().zip(&unit).map(|(w, u)| (w * u).to_vec()).collect()
}
