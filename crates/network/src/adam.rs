//! Adam (Kingma & Ba 2015) over the list of all parameters, with the gradient's global norm clipped.
//!
//! Moments are plain vectors in the order of the parameters, so that a checkpoint is exact; one pass over memory a step,
//! in chunks of a fixed size on all threads.

use rayon::prelude::*;

use isoplanat_base::math::wide::{Work, wide};

/// Parameters of one task.
const CHUNK: usize = 1 << 15;

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

pub(super) const BETA1: f64 = 0.9;
pub(super) const BETA2: f64 = 0.999;
pub(super) const EPSILON: f32 = 1e-8;

impl Adam {
    /// No steps taken, for `n` parameters.
    pub(super) fn new(n: usize) -> Self {
        Self { first: vec![0.0; n], second: vec![0.0; n], steps: 0 }
    }

    /// Starts a step with step size `learning_rate` on gradients to be scaled by `scale`: what each parameter then needs.
    pub(super) fn begin(&mut self, scale: f32, learning_rate: f64) -> Rates {
        Rates::of(&mut self.steps, scale, learning_rate)
    }

    /// Moves `parameters`, the first of which is number `first`, against `gradient`.
    ///
    /// # Panics
    /// Where the lengths differ, or the moments are fewer.
    pub(super) fn step(&mut self, rates: Rates, first: usize, parameters: &mut [f32], gradient: &[f32]) {
        let n = parameters.len();
        assert_eq!(gradient.len(), n);
        let moments =
            self.first[first..][..n].par_chunks_mut(CHUNK).zip(self.second[first..][..n].par_chunks_mut(CHUNK));
        parameters.par_chunks_mut(CHUNK).zip(gradient.par_chunks(CHUNK)).zip(moments).for_each(
            |((parameters, gradient), (first, second))| wide(Chunk { rates, parameters, gradient, first, second }),
        );
    }
}

/// Numbers of one step that all parameters share.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rates {
    pub(super) scale: f32,
    pub(super) rate: f32,
    pub(super) unbias: f32,
}

impl Rates {
    /// Of the step after `steps`, which counts it.
    pub(super) fn of(steps: &mut u64, scale: f32, learning_rate: f64) -> Self {
        *steps += 1;
        let steps = i32::try_from(*steps).unwrap_or(i32::MAX);
        Self {
            scale,
            rate: (learning_rate / (1.0 - BETA1.powi(steps))) as f32,
            unbias: (1.0 / (1.0 - BETA2.powi(steps))) as f32,
        }
    }
}

struct Chunk<'a> {
    rates: Rates,
    parameters: &'a mut [f32],
    gradient: &'a [f32],
    first: &'a mut [f32],
    second: &'a mut [f32],
}

impl Work for Chunk<'_> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let Rates { scale, rate, unbias } = self.rates;
        let (b1, b2) = (BETA1 as f32, BETA2 as f32);
        let moments = self.first.iter_mut().zip(self.second);
        for ((parameter, &gradient), (first, second)) in self.parameters.iter_mut().zip(self.gradient).zip(moments) {
            let gradient = gradient * scale;
            *first = b1 * *first + (1.0 - b1) * gradient;
            *second = b2 * *second + (1.0 - b2) * gradient * gradient;
            *parameter -= rate * *first / ((*second * unbias).sqrt() + EPSILON);
        }
    }
}

/// Euclidean norm over all entries, summed in f64 in a fixed order; NaN or infinite where an entry is.
pub(super) fn norm(gradient: &[Vec<f32>]) -> f64 {
    let squares = |part: &Vec<f32>| part.par_chunks(CHUNK).map(|c| wide(Squares(c))).collect::<Vec<_>>();
    gradient.iter().flat_map(squares).sum::<f64>().sqrt()
}

struct Squares<'a>(&'a [f32]);

impl Work for Squares<'_> {
    type Output = f64;
    #[inline(always)]
    fn run(self) -> f64 {
        let mut sums = [0.0f64; 32];
        let chunks = self.0.chunks_exact(32);
        let rest: f64 = chunks.remainder().iter().map(|&g| f64::from(g) * f64::from(g)).sum();
        for chunk in chunks {
            for (sum, &g) in sums.iter_mut().zip(chunk) {
                *sum += f64::from(g) * f64::from(g);
            }
        }
        sums.iter().sum::<f64>() + rest
    }
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
            let rates = adam.begin(0.5, 1e-3);
            for j in 0..2 {
                adam.step(rates, j, &mut p[j..=j], &g[j..=j]);
            }
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
    }

    #[test]
    fn the_norm_is_that_of_all_parts() {
        assert_eq!(norm(&[vec![3.0], vec![], vec![4.0]]), 5.0);
        assert!(norm(&[vec![1.0], vec![2.0, f32::NAN]]).is_nan());
        let mut rng = fastrand::Rng::with_seed(3);
        let parts: Vec<Vec<f32>> =
            [1, 31, 33, CHUNK, 2 * CHUNK + 17].map(|n| (0..n).map(|_| rng.f32()).collect()).into();
        let expected = parts.iter().flatten().map(|&g| f64::from(g).powi(2)).sum::<f64>().sqrt();
        assert!((norm(&parts) / expected - 1.0).abs() < 1e-12);
    }

    #[test]
    fn long_parameters_move_like_short_ones_on_any_number_of_threads() {
        let mut rng = fastrand::Rng::with_seed(4);
        let n = 3 * CHUNK + 77;
        let start: Vec<f32> = (0..n).map(|_| rng.f32()).collect();
        let gradient: Vec<f32> = (0..n).map(|_| rng.f32() - 0.5).collect();
        let with = |threads, cut: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| {
                let (mut adam, mut p) = (Adam::new(n), start.clone());
                for _ in 0..3 {
                    let rates = adam.begin(0.7, 1e-2);
                    for (i, (p, g)) in p.chunks_mut(cut).zip(gradient.chunks(cut)).enumerate() {
                        adam.step(rates, i * cut, p, g);
                    }
                }
                (p, adam)
            })
        };
        let whole = with(1, n);
        assert_eq!(whole, with(3, n));
        assert_eq!(whole, with(2, 1001));
    }
}
