//! Gauss–Legendre rules of growing size.

use std::f64::consts::PI;

/// Sizes: each a good quarter larger than the one before.
const SIZES: [usize; 22] =
    [12, 16, 20, 24, 32, 40, 48, 64, 80, 96, 128, 160, 192, 256, 320, 384, 448, 512, 640, 768, 896, 1024];

/// Points in −1 to 1 with their weights, for every size up to the largest asked for.
pub(super) struct Rules(Vec<Vec<(f64, f64)>>);

impl Rules {
    /// The most points that are asked for: a finer sampling has 1.4 times as many.
    pub(super) const MOST: f64 = 720.0;

    /// Rules up to the first with at least `points`.
    pub(super) fn up_to(points: f64) -> Self {
        let enough = SIZES.iter().position(|n| real(*n) >= points).unwrap_or(SIZES.len() - 1);
        Self(SIZES[..=enough].iter().map(|n| rule(*n)).collect())
    }

    /// The smallest rule with at least `points`, or the largest.
    pub(super) fn of(&self, points: f64) -> &[(f64, f64)] {
        let enough = SIZES[..self.0.len()].iter().position(|n| real(*n) >= points).unwrap_or(self.0.len() - 1);
        &self.0[enough]
    }
}

fn real(n: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let n = n as f64;
    n
}

/// Newton on the Legendre polynomial from Tricomi's first guess.
fn rule(n: usize) -> Vec<(f64, f64)> {
    let root = |i: usize| {
        let mut x = (PI * (real(i) + 0.75) / (real(n) + 0.5)).cos();
        let mut slope = 0.0;
        for _ in 0..20 {
            let (mut p, mut before) = (x, 1.0);
            for k in 2..=n {
                (p, before) = (((2.0 * real(k) - 1.0) * x * p - (real(k) - 1.0) * before) / real(k), p);
            }
            slope = real(n) * (x * p - before) / (x * x - 1.0);
            let step = p / slope;
            x -= step;
            if step.abs() < 1e-15 {
                break;
            }
        }
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..n)
        .map(|i| {
            if i < n / 2 {
                root(i)
            } else {
                let (x, w) = root(n - 1 - i);
                (-x, w)
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::assert_abs;

    #[test]
    fn rules_integrate_polynomials_and_waves() {
        let rules = Rules::up_to(1e9);
        for size in [12.0, 40.0, 1024.0] {
            let rule = rules.of(size);
            assert_abs(real(rule.len()), size, 0.0, "size");
            assert_abs(rule.iter().map(|(_, w)| w).sum::<f64>(), 2.0, 1e-12, "length");
            let power = 2.0 * size - 2.0;
            assert_abs(
                rule.iter().map(|(x, w)| w * x.abs().powf(power)).sum::<f64>(),
                2.0 / (power + 1.0),
                1e-12,
                "power",
            );
            let k = 0.9 * size;
            assert_abs(rule.iter().map(|(x, w)| w * (k * x).cos()).sum::<f64>(), 2.0 * k.sin() / k, 1e-6, "wave");
        }
    }
}
