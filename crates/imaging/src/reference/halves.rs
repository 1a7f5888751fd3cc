//! Error of a picture against a noisy reference, without the reference's noise.
//!
//! With two independent halves `R₁`, `R₂` of the reference `⟨(F − R₁)(F − R₂)⟩` is the mean square error of `F` itself:
//! the noises are uncorrelated and vanish from the mean. Given the picture, the variance of the estimate is
//! `Σ [e² (σ₁² + σ₂²) + σ₁² σ₂²] / n²`, from the halves' own variances and `e²` from the same product.
//!
//! The energy `ΣF/ΣR` has its noise from `ΣR` alone, which is normal with the variance `Σ (σ₁² + σ₂²)/4`: pixels are
//! independent and many. Its interval is that of `ΣR` turned over, exact for a normal sum and not symmetric.

use ndarray::ArrayView3;

use super::Rendered;
use crate::metrics::decibel;

/// Mean square error with its 95 % confidence interval, and the same as PSNR in linear light for a range of 1.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Agreement {
    /// Mean square error; noise may make it negative where the picture is as good as the reference.
    pub mean_square: f64,
    /// Its standard error.
    pub standard_error: f64,
    /// PSNR, dB; infinite where the error is not above zero.
    pub psnr_db: f64,
    /// 95 % interval of the PSNR, dB; its upper end is infinite where no error is seen.
    pub psnr_db_interval: [f64; 2],
}

/// `⟨(F − R₁)(F − R₂)⟩`: the mean square error of `f` against what both halves estimate.
///
/// # Panics
/// If the shapes differ.
pub(crate) fn unbiased_mse(f: ArrayView3<'_, f32>, r1: ArrayView3<'_, f32>, r2: ArrayView3<'_, f32>) -> f64 {
    assert_eq!((f.dim(), f.dim()), (r1.dim(), r2.dim()), "pictures of one shape");
    let pairs = f.iter().zip(r1.iter().zip(r2.iter()));
    pairs.map(|(&f, (&a, &b))| f64::from(f - a) * f64::from(f - b)).sum::<f64>() / f.len().max(1) as f64
}

/// How well `f` agrees with the reference behind `halves`, with the confidence the halves' noise leaves.
///
/// # Panics
/// If the shapes differ.
pub fn psnr_against_halves(f: ArrayView3<'_, f32>, halves: &[Rendered; 2]) -> Agreement {
    let [a, b] = halves;
    let mean_square = unbiased_mse(f, a.mean.view(), b.mean.view());
    let (mut error_part, mut noise_part) = (0.0, 0.0);
    for (((&f, &ra), &rb), (&va, &vb)) in f.iter().zip(&a.mean).zip(&b.mean).zip(a.variance.iter().zip(&b.variance)) {
        let (va, vb) = (f64::from(va), f64::from(vb));
        error_part += f64::from(f - ra) * f64::from(f - rb) * (va + vb);
        noise_part += va * vb;
    }
    let standard_error = (error_part.max(0.0) + noise_part).sqrt() / f.len().max(1) as f64;
    let psnr = |m: f64| if m > 0.0 { decibel(m) } else { f64::INFINITY };
    let interval = [mean_square + 1.96 * standard_error, mean_square - 1.96 * standard_error];
    Agreement { mean_square, standard_error, psnr_db: psnr(mean_square), psnr_db_interval: interval.map(psnr) }
}

/// Energy of a picture relative to the reference's, with its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Energy {
    /// `ΣF/ΣR`; infinite or no number where the reference is black.
    pub ratio: f64,
    /// Its standard error, to first order.
    pub standard_error: f64,
    /// 95 % interval; all numbers where the reference's sum is not certainly above zero.
    pub interval: [f64; 2],
}

/// Energy of `f` over that of the reference behind `halves`: the ratio of the sums over all pixels and channels.
///
/// # Panics
/// If the shapes differ.
pub fn energy_against_halves(f: ArrayView3<'_, f32>, halves: &[Rendered; 2]) -> Energy {
    let [a, b] = halves;
    assert_eq!((f.dim(), f.dim()), (a.mean.dim(), b.mean.dim()), "pictures of one shape");
    let sum = |values: ArrayView3<'_, f32>| values.iter().map(|v| f64::from(*v)).sum::<f64>();
    let energy = sum(f);
    let reference = 0.5 * (sum(a.mean.view()) + sum(b.mean.view()));
    let sigma = 0.5 * (sum(a.variance.view()) + sum(b.variance.view())).sqrt();
    let ratio = energy / reference;
    let ends = [reference + 1.96 * sigma, reference - 1.96 * sigma];
    // A sum that may be zero bounds nothing.
    let certain = ends[0] * ends[1] > 0.0;
    let [x, y] = if certain { ends.map(|r| energy / r) } else { [f64::NEG_INFINITY, f64::INFINITY] };
    Energy { ratio, standard_error: (ratio * sigma / reference).abs(), interval: [x.min(y), x.max(y)] }
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    /// Normal noise of known size around a known truth: the estimate hits the true error within its own interval.
    #[test]
    fn the_references_noise_does_not_count() {
        let shape = (3, 80, 90);
        let (mut inside, runs) = (0, 60);
        for seed in 0..runs {
            let rng = &mut fastrand::Rng::with_seed(seed);
            let truth = Array3::from_shape_fn(shape, |_| rng.f32());
            let off = truth.mapv(|v| v + 0.004 * (7.0 * v).sin());
            let exact = off.iter().zip(&truth).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / truth.len() as f64;
            let sigma = 0.03;
            let halves = [1, 2].map(|k| {
                let plane: Vec<f32> =
                    crate::sensor::noise::standard_normal(seed * 2 + k, (1, truth.len())).into_raw_vec_and_offset().0;
                let noise = Array3::from_shape_vec(shape, plane).expect("as many");
                Rendered {
                    mean: &truth + &(noise * sigma),
                    variance: Array3::from_elem(shape, sigma * sigma),
                    rays: 0,
                    passed: 0,
                    outside: 0,
                    axis_irradiance: [1.0; 3],
                    seconds: 0.0,
                }
            });
            let found = psnr_against_halves(off.view(), &halves);
            assert!((found.mean_square - exact).abs() < 5.0 * found.standard_error, "{found:?} {exact}");
            inside += u32::from((found.mean_square - exact).abs() < 1.96 * found.standard_error);
            // The plain error against one half would be a hundred times too large.
            assert!(found.mean_square < 3.0 * exact && found.psnr_db_interval[0] <= found.psnr_db);
        }
        // 95 % of 60 is 57; 50 or fewer has a chance below 1e-3.
        assert!(inside > 50, "{inside} of {runs} inside the 95 % interval");
    }

    /// Independent groups with Poisson-like spread, variances estimated from two groups a half as the renderer does: the
    /// interval holds the true ratio in 95 % of 2000 pictures, and a ratio four errors off in hardly any.
    #[test]
    fn the_energy_interval_covers_the_truth_at_its_rate() {
        let shape = (3, 12, 16);
        let (mut inside, mut wrong, runs) = (0, 0, 2000);
        for seed in 0..runs {
            let rng = &mut fastrand::Rng::with_seed(seed);
            let truth = Array3::from_shape_fn(shape, |_| 0.1 + rng.f32());
            let f = truth.mapv(|v| 1.02 * v + 0.001);
            let exact = f.iter().map(|v| f64::from(*v)).sum::<f64>() / truth.iter().map(|v| f64::from(*v)).sum::<f64>();
            let halves = [(); 2].map(|()| {
                let (mut mean, mut variance) = (truth.clone(), truth.clone());
                for (m, v) in mean.iter_mut().zip(&mut variance) {
                    // Skewed noise whose size goes with the signal.
                    let sigma = 0.3 * m.sqrt();
                    let mut group = || *m + sigma * (-(1.0 - rng.f32()).ln() - 1.0);
                    let (a, b) = (group(), group());
                    (*m, *v) = (0.5 * (a + b), 0.25 * (a - b) * (a - b));
                }
                Rendered { mean, variance, rays: 0, passed: 0, outside: 0, axis_irradiance: [1.0; 3], seconds: 0.0 }
            });
            let found = energy_against_halves(f.view(), &halves);
            let holds = |ratio: f64| found.interval[0] <= ratio && ratio <= found.interval[1];
            inside += u32::from(holds(exact));
            wrong += u32::from(holds(exact + 4.0 * found.standard_error));
            assert!(holds(found.ratio) && found.standard_error > 0.0);
        }
        // 1900 ± 9.7: four standard deviations; off by four errors 2 % are inside.
        assert!((1861..=1939).contains(&inside), "{inside} of {runs} inside the 95 % interval");
        assert!((5..120).contains(&wrong), "{wrong} of {runs} hold a ratio four errors off");
    }

    /// Without noise the interval is the ratio; a reference that may be black bounds nothing.
    #[test]
    fn energies_at_the_ends() {
        let half = |mean: f32, variance: f32| Rendered {
            mean: Array3::from_elem((1, 2, 2), mean),
            variance: Array3::from_elem((1, 2, 2), variance),
            rays: 0,
            passed: 0,
            outside: 0,
            axis_irradiance: [1.0; 3],
            seconds: 0.0,
        };
        let f = Array3::from_elem((1, 2, 2), 3.0);
        let sure = energy_against_halves(f.view(), &[half(2.0, 0.0), half(2.0, 0.0)]);
        assert_eq!((sure.ratio, sure.standard_error, sure.interval), (1.5, 0.0, [1.5, 1.5]));
        let dark = energy_against_halves(f.view(), &[half(0.01, 1.0), half(0.0, 1.0)]);
        assert_eq!(dark.interval, [f64::NEG_INFINITY, f64::INFINITY]);
        let negative = energy_against_halves(f.view(), &[half(-2.0, 1e-4), half(-2.0, 1e-4)]);
        assert!(
            negative.interval[0] < -1.5 && -1.5 < negative.interval[1] && negative.interval[1] < 0.0,
            "{negative:?}"
        );
    }
}
