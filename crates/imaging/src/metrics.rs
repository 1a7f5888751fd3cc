//! How close two pictures are: PSNR and SSIM ([`isoplanat_base::math::ssim`]); [`delta_e`] for colour, [`slanted_edge`] for the MTF of one.
//!
//! `PSNR = −10 log₁₀ MSE` for a data range of 1. SSIM: Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli, "Image
//! quality assessment: from error visibility to structural similarity", IEEE Trans. Image Process. 13(4), 2004: Gaussian
//! window of σ = 1.5 over 11 × 11 pixels, K₁ = 0.01, K₂ = 0.03, population moments, mean over the positions where the
//! whole window lies inside, then over channels. These are scikit-image's `structural_similarity` with
//! `gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1`; a test holds its numbers to 1e-12.
//!
//! [`psnr`] and [`ssim`] compare as seen: both pictures are cut off to `[0, 1]` and sRGB-encoded first.

pub mod delta_e;
pub mod slanted_edge;
#[doc(hidden)]
pub mod wiener;

use ndarray::{ArrayView3, s};
use rayon::prelude::*;

use crate::develop::color::srgb_from_linear;
use isoplanat_base::error::Result;
use isoplanat_base::math::ssim::ssim_values;

pub use isoplanat_base::math::ssim::{SSIM_WINDOW, ssim_and_slopes};

/// PSNR in dB of two linear pictures as seen (sRGB-encoded); infinite where they are equal.
///
/// # Panics
/// If the shapes differ.
pub fn psnr(a: ArrayView3<'_, f32>, b: ArrayView3<'_, f32>) -> f64 {
    decibel(mean_square(a, b, seen, seen))
}

/// [`psnr`] of `a` times the factor that brings it nearest to `b` in linear light: what is left where only brightness is off is no error.
///
/// # Panics
/// If the shapes differ.
pub fn psnr_at_best_gain(a: ArrayView3<'_, f32>, b: ArrayView3<'_, f32>) -> f64 {
    assert_eq!(a.dim(), b.dim(), "pictures of one shape");
    let sums = a.iter().zip(b).fold([0.0, 0.0], |[ab, aa], (x, y)| {
        let (x, y) = (f64::from(*x), f64::from(*y));
        [ab + x * y, aa + x * x]
    });
    let gain = if sums[1] > 0.0 { sums[0] / sums[1] } else { 1.0 };
    #[expect(clippy::cast_possible_truncation, reason = "pictures are single precision")]
    let gain = gain as f32;
    decibel(mean_square(a, b, |v| seen(gain * v), seen))
}

/// PSNR in dB of the numbers themselves, in linear light, nothing cut off.
///
/// ```
/// use isoplanat_imaging::metrics::psnr_linear;
/// use ndarray::Array3;
///
/// let (a, b) = (Array3::from_elem((3, 4, 4), 0.5), Array3::from_elem((3, 4, 4), 0.51));
/// assert!((psnr_linear(a.view(), b.view()) - 40.0).abs() < 1e-3);
/// ```
///
/// # Panics
/// If the shapes differ.
pub fn psnr_linear(a: ArrayView3<'_, f32>, b: ArrayView3<'_, f32>) -> f64 {
    decibel(mean_square(a, b, f64::from, f64::from))
}

/// A value as seen: cut off and encoded.
fn seen(v: f32) -> f64 {
    srgb_from_linear(f64::from(v).clamp(0.0, 1.0))
}

/// PSNR of a mean square error.
pub fn decibel(mean_square: f64) -> f64 {
    -10.0 * mean_square.log10()
}

/// Mean square difference of values as they count; rows are summed apart and then in order, whatever the number of threads.
fn mean_square(
    a: ArrayView3<'_, f32>,
    b: ArrayView3<'_, f32>,
    of_a: impl Fn(f32) -> f64 + Sync,
    of_b: impl Fn(f32) -> f64 + Sync,
) -> f64 {
    assert_eq!(a.dim(), b.dim(), "pictures of one shape");
    let rows: Vec<(usize, usize)> = (0..a.dim().0).flat_map(|k| (0..a.dim().1).map(move |r| (k, r))).collect();
    let square = |&(k, r): &(usize, usize)| -> f64 {
        let pairs = a.slice(s![k, r, ..]).into_iter().zip(b.slice(s![k, r, ..]));
        pairs.map(|(&x, &y)| (of_a(x) - of_b(y)).powi(2)).sum()
    };
    let sums: Vec<f64> = rows.par_iter().map(square).collect();
    sums.iter().sum::<f64>() / a.len().max(1) as f64
}

/// SSIM of two linear pictures as seen (sRGB-encoded), mean over the channels.
///
/// Refuses pictures smaller than the window.
///
/// # Panics
/// If the shapes differ.
pub fn ssim(a: ArrayView3<'_, f32>, b: ArrayView3<'_, f32>) -> Result<f64> {
    ssim_values(a.mapv(seen).view(), b.mapv(seen).view())
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    use isoplanat_base::testing::{assert_abs, two_pictures};

    /// Half the brightness is no error after the best gain, and noise is as much as before.
    #[test]
    fn the_best_gain_forgives_brightness_alone() {
        let rng = &mut fastrand::Rng::with_seed(3);
        let b = Array3::from_shape_simple_fn((3, 24, 32), || 0.1 + 0.4 * rng.f32());
        let dark = b.mapv(|v| 0.5 * v);
        assert!(psnr(dark.view(), b.view()) < 20.0 && psnr_at_best_gain(dark.view(), b.view()) > 100.0);
        let noisy = b.mapv(|v| v + 0.02 * (rng.f32() - 0.5));
        let [plain, best] = [psnr(noisy.view(), b.view()), psnr_at_best_gain(noisy.view(), b.view())];
        assert!((plain - best).abs() < 0.01, "{plain} {best}");
        let black = Array3::<f32>::zeros((3, 4, 4));
        assert!(psnr_at_best_gain(black.view(), b.slice(ndarray::s![.., ..4, ..4])).is_finite());
    }

    /// scikit-image 0.26.0 on the same formulas, in f64.
    #[test]
    fn scikit_image_gives_the_same_numbers() {
        let (a, b) = two_pictures();
        let (sa, sb) = (a.mapv(srgb_from_linear), b.mapv(srgb_from_linear));
        assert_abs(ssim_values(sa.view(), sb.view()).expect("large enough"), 0.899_561_062_635_329_3, 1e-12, "mean");
        for (k, value) in [0.880_134_713_114_250_8, 0.903_185_234_942_039_8, 0.915_363_239_849_696_5].iter().enumerate()
        {
            let plane = s![k..k + 1, .., ..];
            assert_abs(ssim_values(sa.slice(plane), sb.slice(plane)).expect("large enough"), *value, 1e-12, "channel");
        }
        // The public functions take f32: the inputs' rounding moves the result by some 1e-7.
        let (fa, fb) = (a.mapv(|v| v as f32), b.mapv(|v| v as f32));
        assert_abs(ssim(fa.view(), fb.view()).expect("large enough"), 0.899_561_062_635_329_3, 1e-6, "f32");
        assert_abs(psnr(fa.view(), fb.view()), 25.310_421_325_412_89, 1e-5, "PSNR");
        assert_abs(psnr_linear(fa.view(), fb.view()), 24.467_331_754_220_425, 1e-5, "linear PSNR");
    }

    /// Photographs against damaged versions of themselves: the numbers of `tests/peers/ssim_skimage.py`, scikit-image's on the
    /// same 8-bit values.
    #[test]
    fn scikit_image_gives_the_same_numbers_on_photographs() {
        type Damage = fn(&Array3<i64>) -> Array3<i64>;
        let blurred: Damage = |v| {
            let (_, rows, cols) = v.dim();
            Array3::from_shape_fn(v.dim(), |(k, r, c)| {
                let at = |i: usize, j: usize| {
                    v[[k, (r + i).saturating_sub(1).min(rows - 1), (c + j).saturating_sub(1).min(cols - 1)]]
                };
                ((0..9).map(|n| at(n / 3, n % 3)).sum::<i64>() + 4) / 9
            })
        };
        let noisy: Damage = |v| {
            Array3::from_shape_fn(v.dim(), |(k, r, c)| {
                let place = (r * 7919 + c * 104_729 + k * 1_299_709 + 1) as u32;
                let hashed = i64::from(place.wrapping_mul(2_654_435_761) >> 16);
                (v[[k, r, c]] + hashed % 31 - 15).clamp(0, 255)
            })
        };
        let coarse: Damage = |v| v.mapv(|v| v / 32 * 32 + 16);
        let record: serde_json::Value = serde_json::from_str(include_str!("metrics/ssim_skimage.json")).expect("JSON");
        let pairs = record["pairs"].as_array().expect("pairs");
        assert!(pairs.len() >= 5);
        for pair in pairs {
            let name = pair["photo"].as_str().expect("name");
            let Some(path) = isoplanat_base::testing::shared(&format!("data/photos/eval/{name}")) else { return };
            let linear = crate::files::read_linear(&path).expect("reads");
            let a = linear.mapv(|v| (255.0 * srgb_from_linear(f64::from(v))).round() as i64);
            let b = match pair["damage"].as_str().expect("damage") {
                "blurred" => blurred(&a),
                "noisy" => noisy(&a),
                other => {
                    assert_eq!(other, "coarse");
                    coarse(&a)
                }
            };
            let [a, b] = [a, b].map(|v| v.mapv(|v| v as f64 / 255.0));
            let number = |key: &str| pair[key].as_f64().expect("number");
            assert_abs(ssim_values(a.view(), b.view()).expect("large enough"), number("ssim"), 1e-12, name);
            let [a, b] = [a, b].map(|v| v.mapv(|v| crate::develop::color::linear_from_srgb(v) as f32));
            assert_abs(ssim(a.view(), b.view()).expect("large enough"), number("ssim"), 1e-6, name);
            assert_abs(psnr(a.view(), b.view()), number("psnr_db"), 1e-5, name);
        }
    }

    #[test]
    fn equal_small_and_out_of_range_pictures() {
        let a = Array3::<f32>::from_elem((3, 11, 11), 0.4);
        assert_eq!((psnr(a.view(), a.view()), ssim(a.view(), a.view()).expect("11 × 11")), (f64::INFINITY, 1.0));
        assert!(ssim(a.slice(s![.., ..10, ..]), a.slice(s![.., ..10, ..])).is_err());
        // Beyond white all is white.
        assert_eq!(psnr((&a + 1.0).view(), (&a + 2.0).view()), f64::INFINITY);
        assert_abs(psnr_linear((&a + 0.1).view(), a.view()), 20.0, 1e-5, "a tenth");
    }
}
