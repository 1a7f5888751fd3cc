//! How well gradients of each of a lens's numbers are known: patches are a sample, and what they agree on is what moves a design.

use serde::{Deserialize, Serialize};

/// Gradients of some steps, by variable.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    /// Steps.
    count: usize,
    /// Sums of gradients.
    sums: Vec<f64>,
    /// Sums of their squares.
    squares: Vec<f64>,
}

impl Noise {
    /// Takes the gradient of a step in; one with a number that is not finite is left out.
    pub fn add(&mut self, gradient: &[f64]) {
        if gradient.iter().any(|g| !g.is_finite()) {
            return;
        }
        if self.sums.len() != gradient.len() {
            *self = Self { count: 0, sums: vec![0.0; gradient.len()], squares: vec![0.0; gradient.len()] };
        }
        self.count += 1;
        for (k, g) in gradient.iter().enumerate() {
            self.sums[k] += g;
            self.squares[k] += g * g;
        }
    }

    /// Mean gradient of each variable in its own standard errors (mean over deviation, times the root of the number of steps): below about 2
    /// nothing is known of its sign. Empty for fewer than three steps; 0 where all gradients are.
    pub fn certainty(&self) -> Vec<f64> {
        if self.count < 3 {
            return Vec::new();
        }
        let n = self.count as f64;
        let of = |sum: &f64, squares: &f64| {
            let mean = sum / n;
            let variance = ((squares / n - mean * mean) * n / (n - 1.0)).max(f64::MIN_POSITIVE);
            if mean == 0.0 { 0.0 } else { mean / (variance / n).sqrt() }
        };
        self.sums.iter().zip(&self.squares).map(|(s, q)| of(s, q)).collect()
    }

    /// Begins anew.
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Means of 1 ± 1 and of 0 ± 1 in their standard errors, and what is no sample.
    #[test]
    fn a_mean_is_measured_by_its_error() {
        let mut noise = Noise::default();
        assert!(noise.certainty().is_empty());
        for k in 0..400 {
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            noise.add(&[1.0 + sign, sign, 0.0]);
            noise.add(&[f64::NAN, 1.0, 1.0]);
        }
        let found = noise.certainty();
        // Deviation √(400/399).
        assert!((found[0] - 20.0 * (399.0f64 / 400.0).sqrt()).abs() < 1e-9, "{found:?}");
        assert_eq!(found[1..], [0.0, 0.0]);
        noise.add(&[1.0]);
        assert!(noise.certainty().is_empty(), "other variables");
        noise.clear();
        assert_eq!(noise, Noise::default());
    }
}
