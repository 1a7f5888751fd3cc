//! How much each object distance counts in a loss over several.
//!
//! With the power `p` the loss is the power mean of the distances' own, `L = (Σ ℓ_d^p / n)^(1/p)`: 1 is their mean, and the larger `p`, the more the worst of them
//! decides. The derivative by `ℓ_d` is `(ℓ_d / L)^(p − 1) / n`, so that a picture at distance `d` counts `(ℓ_d / L)^(p − 1)` times. What a distance's loss is, is a
//! running mean over the steps, for pictures differ more than distances do.

use serde::{Deserialize, Serialize};

/// Share of a running mean that a new loss gets.
const NEW: f64 = 0.1;

/// Losses by distance, and the power of their mean.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Distances {
    power: f64,
    /// Running means; 0 where no loss was seen yet. None of it where nobody asks.
    losses: Vec<f64>,
}

impl Distances {
    /// Of `count` distances; `power` 1 or more.
    pub fn new(power: f64, count: usize) -> Self {
        Self { power, losses: vec![0.0; count] }
    }

    /// Goes on with the losses of `other`, where they are of as many distances.
    pub(crate) fn go_on(&mut self, other: &Self) {
        let sound = other.losses.len() == self.losses.len() && other.losses.iter().all(|l| l.is_finite() && *l >= 0.0);
        if sound {
            self.losses.clone_from(&other.losses);
        }
    }

    /// How often a picture at a distance counts; 1 for all until each has been seen.
    pub fn weight(&self, distance: usize) -> f64 {
        let all = &self.losses;
        if self.power <= 1.0 || all.iter().any(|l| *l <= 0.0) {
            return 1.0;
        }
        // Against the largest, so that no power overflows.
        let largest = all.iter().fold(0.0f64, |m, l| m.max(*l));
        #[expect(clippy::cast_precision_loss, reason = "a handful")]
        let mean = all.iter().map(|l| (l / largest).powf(self.power)).sum::<f64>() / all.len() as f64;
        (all[distance] / largest / mean.powf(1.0 / self.power)).powf(self.power - 1.0)
    }

    /// Takes in what a picture's loss was at a distance.
    pub(crate) fn see(&mut self, distance: usize, loss: f64) {
        if loss.is_finite()
            && loss > 0.0
            && let Some(now) = self.losses.get_mut(distance)
        {
            *now = if *now > 0.0 { (1.0 - NEW) * *now + NEW * loss } else { loss };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_rel, central_difference};

    fn seen(power: f64, losses: &[f64]) -> Distances {
        let mut distances = Distances::new(power, losses.len());
        losses.iter().enumerate().for_each(|(d, l)| distances.see(d, *l));
        distances
    }

    /// Weights over the number of distances are the slopes of the power mean.
    #[test]
    fn weights_are_slopes_of_the_power_mean() {
        let losses = [0.06, 0.11, 0.08];
        for power in [1.0, 2.0, 4.0, 9.5] {
            let mean = |l: &[f64]| (l.iter().map(|v| v.powf(power)).sum::<f64>() / 3.0).powf(1.0 / power);
            for d in 0..3 {
                let moved = |h: f64| {
                    let mut l = losses;
                    l[d] += h;
                    mean(&l)
                };
                let slope = central_difference(moved, 1e-6);
                assert_rel(seen(power, &losses).weight(d) / 3.0, slope, 1e-7, 1e-9, "weight");
            }
        }
    }

    #[test]
    fn extremes_stay_finite_and_plain_means_weigh_alike() {
        let all = |d: &Distances| (0..3).map(|k| d.weight(k)).collect::<Vec<f64>>();
        assert_eq!(all(&seen(1.0, &[1e-9, 3.0, 0.1])), [1.0; 3]);
        assert_eq!(all(&Distances::new(8.0, 3)), [1.0; 3], "nothing seen");
        let worst = seen(64.0, &[1e-9, 3.0, 0.1]);
        assert!(all(&worst).iter().all(|w| w.is_finite()) && worst.weight(1) > 2.9 && worst.weight(0) == 0.0);
        let mut steady = seen(4.0, &[0.1; 3]);
        for bad in [f64::NAN, f64::INFINITY, 0.0, -1.0] {
            steady.see(0, bad);
        }
        assert_eq!(all(&steady), [1.0; 3]);
        let mut resumed = Distances::new(4.0, 3);
        for other in [Distances::new(4.0, 2), Distances { power: 4.0, losses: vec![f64::NAN; 3] }] {
            resumed.go_on(&other);
            assert_eq!(resumed, Distances::new(4.0, 3));
        }
        resumed.go_on(&steady);
        assert_eq!(resumed, steady);
        steady.see(0, 0.2);
        assert!(steady.weight(0) > 1.1 && steady.weight(1) < 1.0);
    }
}
