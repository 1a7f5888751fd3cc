//! A running mean of a network's weights over its training (exponential; B. T. Polyak, A. B. Juditsky 1992): quieter than the last
//! step's. It never steers the training.

use super::learner::Parameter;

/// Before the names of averaged weights in a checkpoint.
pub(super) const PREFIX: &str = "average.";

/// Averaged weights, in the order of the network's parameters.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Average {
    /// Share of the old mean that a step keeps, once there were many.
    pub(super) decay: f64,
    /// Steps in it.
    pub(super) steps: u64,
    /// The mean.
    pub(super) weights: Vec<f32>,
}

impl Average {
    /// Of a network that has not been trained yet.
    pub(super) fn new(decay: f64, parameters: &[Parameter]) -> Self {
        Self { decay, steps: 0, weights: flat(parameters) }
    }

    /// Takes a step's weights in. The first steps count more, so that the start is forgotten.
    pub(super) fn update(&mut self, parameters: &[Parameter]) {
        self.steps += 1;
        #[expect(clippy::cast_precision_loss, reason = "a count of steps")]
        let n = self.steps as f64;
        #[expect(clippy::cast_possible_truncation, reason = "weights are f32")]
        let new = (1.0 - self.decay.min(n / (9.0 + n))) as f32;
        let now = parameters.iter().flat_map(|p| &p.values);
        self.weights.iter_mut().zip(now).for_each(|(mean, w)| *mean += new * (w - *mean));
    }

    /// By name, as `like` has them.
    pub(super) fn parameters(&self, like: &[Parameter]) -> Vec<Parameter> {
        let mut rest = self.weights.as_slice();
        let mut next = |n: usize| {
            let (some, behind) = rest.split_at(n);
            rest = behind;
            some.to_vec()
        };
        like.iter().map(|p| Parameter { values: next(p.values.len()), ..p.clone() }).collect()
    }
}

fn flat(parameters: &[Parameter]) -> Vec<f32> {
    parameters.iter().flat_map(|p| p.values.iter().copied()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The recursion written out, and constants stay.
    #[test]
    fn the_mean_follows_the_weights() {
        let at = |v: f32| [Parameter { name: "w".into(), shape: vec![2], values: vec![v, 1.0] }];
        let mut average = Average::new(0.5, &at(8.0));
        let mut mean = 8.0f64;
        for n in 1..40 {
            let value = (n % 7) as f32;
            average.update(&at(value));
            let keep = (n as f64 / (9.0 + n as f64)).min(0.5);
            mean = keep * mean + (1.0 - keep) * f64::from(value);
            assert!((f64::from(average.weights[0]) - mean).abs() < 1e-5, "step {n}");
        }
        assert_eq!(average.parameters(&at(0.0))[0].values[1], 1.0);
    }
}
