//! Adam (Kingma & Ba 2015) over the flat list of all parameters, with the gradient's global norm clipped.
//!
//! Moments are plain vectors in the order of the parameters, so that a checkpoint is exact; one pass over memory a step.

/// First and second moments, and how many steps have been taken.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Adam {
    /// Running mean of the gradient.
    pub(super) first: Vec<f32>,
    /// Running mean of its square.
    pub(super) second: Vec<f32>,
    /// Steps taken.
    pub(super) steps: u64,
}

const BETA1: f64 = 0.9;
const BETA2: f64 = 0.999;
const EPSILON: f32 = 1e-8;

impl Adam {
    /// No steps taken, for `n` parameters.
    pub(super) fn new(n: usize) -> Self {
        Self { first: vec![0.0; n], second: vec![0.0; n], steps: 0 }
    }

    /// Moves `parameters` against `gradient` (scaled by `scale`) with step size `learning_rate`.
    ///
    /// # Panics
    /// Where the lengths differ from those of the moments.
    pub(super) fn step(
        &mut self,
        parameters: &mut [f32],
        gradient: &[f32],
        scale: f32,
        learning_rate: f64,
    ) {
        assert_eq!(parameters.len(), self.first.len());
        assert_eq!(gradient.len(), self.first.len());
        self.steps += 1;
        let steps = i32::try_from(self.steps).unwrap_or(i32::MAX);
        let (b1, b2) = (BETA1 as f32, BETA2 as f32);
        let rate = (learning_rate / (1.0 - BETA1.powi(steps))) as f32;
        let unbias = (1.0 / (1.0 - BETA2.powi(steps))) as f32;
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((parameter, &gradient), (first, second)) in
            parameters.iter_mut().zip(gradient).zip(moments)
        {
            let gradient = gradient * scale;
            *first = b1 * *first + (1.0 - b1) * gradient;
            *second = b2 * *second + (1.0 - b2) * gradient * gradient;
            *parameter -= rate * *first / ((*second * unbias).sqrt() + EPSILON);
        }
    }
}

/// Euclidean norm over all entries, summed in f64; NaN or infinite where an entry is.
pub(super) fn norm(gradient: &[f32]) -> f64 {
    gradient.iter().map(|&g| f64::from(g) * f64::from(g)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_follow_the_published_recursion() {
        let (mut adam, mut p) = (Adam::new(2), [1.0f32, -2.0]);
        let (mut m, mut v, mut expected) = ([0.0f64; 2], [0.0f64; 2], [1.0f64, -2.0]);
        for t in 1..=20 {
            let g: [f32; 2] = [(t as f32 * 0.7).sin(), 0.01 * t as f32];
            adam.step(&mut p, &g, 0.5, 1e-3);
            for j in 0..2 {
                let g = 0.5 * f64::from(g[j]);
                m[j] = 0.9 * m[j] + 0.1 * g;
                v[j] = 0.999 * v[j] + 0.001 * g * g;
                let (mh, vh) = (m[j] / (1.0 - 0.9f64.powi(t)), v[j] / (1.0 - 0.999f64.powi(t)));
                expected[j] -= 1e-3 * mh / (vh.sqrt() + 1e-8);
            }
        }
        for j in 0..2 {
            assert!((f64::from(p[j]) - expected[j]).abs() < 2e-6, "{p:?} {expected:?}");
        }
        assert_eq!(adam.steps, 20);
        assert!((norm(&[3.0, 4.0]) - 5.0).abs() < 1e-12 && norm(&[1.0, f32::NAN]).is_nan());
    }
}
