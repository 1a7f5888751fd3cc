//! Error of a picture against a noisy reference, without the reference's noise.
//!
//! With two independent halves `R₁`, `R₂` of the reference `⟨(F − R₁)(F − R₂)⟩` is the mean square error of `F` itself:
//! the noises are uncorrelated and vanish from the mean. Given the picture, the variance of the estimate is
//! `Σ [e² (σ₁² + σ₂²) + σ₁² σ₂²] / n²`, from the halves' own variances and `e²` from the same product.

use ndarray::ArrayView3;

use super::Rendered;
use crate::imaging::metrics::decibel;

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
pub fn unbiased_mse(f: ArrayView3<'_, f32>, r1: ArrayView3<'_, f32>, r2: ArrayView3<'_, f32>) -> f64 {
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
                    crate::imaging::noise::standard_normal(seed * 2 + k, (1, truth.len())).into_raw_vec_and_offset().0;
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
}
