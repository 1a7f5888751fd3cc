//! SSIM over several scales, with its gradient: a loss where no perceptual features are at hand.
//!
//! Z. Wang, E. P. Simoncelli, A. C. Bovik, "Multiscale structural similarity for image quality assessment", Asilomar 2003:
//! `Π_j cs_j^{β_j} · (l·cs)_M^{β_M}`, contrast and structure of every scale, luminance of the coarsest, mean over channels.
//! Scales are 2 × 2 means; small pictures have fewer of them, their exponents scaled to the same sum.

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis, s};
use rayon::prelude::*;

use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::ssim::{Part, SSIM_WINDOW, ssim_plane};

/// The exponents of the five scales, finest first.
const EXPONENTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];

/// A scale's mean below this counts as this, with no gradient: powers of negative numbers mean nothing.
const LEAST: f64 = 1e-4;

/// Multi-scale SSIM of two pictures of data range 1, and its gradient in `a`.
///
/// # Shapes
/// `[channel, row, col]`, at least 11 × 11; the gradient alike.
///
/// # Panics
/// If the shapes differ.
pub(crate) fn ms_ssim_and_gradient(a: ArrayView3<'_, f64>, b: ArrayView3<'_, f64>) -> Result<(f64, Array3<f64>)> {
    let (channels, rows, cols) = a.dim();
    assert_eq!(a.dim(), b.dim(), "pictures of one shape");
    let scales = (0..EXPONENTS.len()).take_while(|j| rows.min(cols) >> j >= SSIM_WINDOW).count();
    if scales == 0 || channels == 0 {
        let found = format!("{channels} channels of {rows} x {cols}");
        return Err(Error::bad("", "picture for SSIM", found, "at least 11 x 11 pixels"));
    }
    let scaled = EXPONENTS.iter().sum::<f64>() / EXPONENTS[..scales].iter().sum::<f64>();
    let exponents: Vec<f64> = EXPONENTS[..scales].iter().map(|e| e * scaled).collect();
    let planes: Vec<(f64, Array2<f64>)> = (0..channels)
        .into_par_iter()
        .map(|k| plane(a.slice(s![k, .., ..]), b.slice(s![k, .., ..]), &exponents))
        .collect();
    let mut gradient = Array3::zeros(a.dim());
    for (mut to, (_, from)) in gradient.axis_iter_mut(Axis(0)).zip(&planes) {
        to.assign(&(from / channels as f64));
    }
    Ok((planes.iter().map(|p| p.0).sum::<f64>() / channels as f64, gradient))
}

fn plane(a: ArrayView2<'_, f64>, b: ArrayView2<'_, f64>, exponents: &[f64]) -> (f64, Array2<f64>) {
    let mut pyramid = vec![(a.to_owned(), b.to_owned())];
    for j in 1..exponents.len() {
        let next = (halved(pyramid[j - 1].0.view()), halved(pyramid[j - 1].1.view()));
        pyramid.push(next);
    }
    let terms: Vec<(f64, Array2<f64>)> = pyramid
        .iter()
        .enumerate()
        .map(|(j, (a, b))| {
            let part = if j + 1 == exponents.len() { Part::Whole } else { Part::Structure };
            let (value, slope) = ssim_plane(a.view(), b.view(), part, true);
            let slope = slope.expect("asked for");
            if value > LEAST { (value, slope) } else { (LEAST, Array2::zeros(slope.dim())) }
        })
        .collect();
    let value: f64 = terms.iter().zip(exponents).map(|((t, _), e)| t.powf(*e)).product();
    // From the coarsest scale up.
    let mut gradient: Option<Array2<f64>> = None;
    for (j, ((term, slope), exponent)) in terms.into_iter().zip(exponents).enumerate().rev() {
        let mut here = slope * (value * exponent / term);
        if let Some(coarser) = gradient {
            halved_vjp(coarser.view(), &mut here);
        }
        debug_assert_eq!(here.dim(), pyramid[j].0.dim());
        gradient = Some(here);
    }
    (value, gradient.expect("one scale at least"))
}

/// Means of 2 × 2 pixels; an odd last row or column is left out.
fn halved(x: ArrayView2<'_, f64>) -> Array2<f64> {
    let (rows, cols) = (x.nrows() / 2, x.ncols() / 2);
    Array2::from_shape_fn((rows, cols), |(r, c)| x.slice(s![2 * r..2 * r + 2, 2 * c..2 * c + 2]).sum() / 4.0)
}

/// Adds the transpose of [`halved`] to `to`.
fn halved_vjp(bar: ArrayView2<'_, f64>, to: &mut Array2<f64>) {
    for ((r, c), v) in bar.indexed_iter() {
        to.slice_mut(s![2 * r..2 * r + 2, 2 * c..2 * c + 2]).mapv_inplace(|t| t + v / 4.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::math::ssim::ssim_values;
    use isoplanat_base::testing::{assert_abs, assert_rel, central_difference};

    /// Two pictures by formula, the second with a ripple on the first.
    fn pair(rows: usize, cols: usize) -> (Array3<f64>, Array3<f64>) {
        let a = Array3::from_shape_fn((3, rows, cols), |(k, r, c)| {
            let (k, r, c) = (k as f64, r as f64, c as f64);
            0.5 + 0.45 * (0.031 * c + 0.017 * r * (k + 1.0)).sin() * (0.23 * r - 0.11 * c + k).cos()
        });
        let b = Array3::from_shape_fn((3, rows, cols), |(k, r, c)| {
            let (x, y, z) = (c as f64, r as f64, k as f64);
            a[[k, r, c]] + 0.08 * (1.7 * x + 2.3 * y + z).sin() + 0.03 * (0.05 * x * y).cos()
        });
        (a, b)
    }

    /// The same formulas written once more in NumPy, f64; and pytorch-msssim 1.0.0 in f64 (`win_size=11, win_sigma=1.5,
    /// data_range=1`), whose window is rounded to f32.
    #[test]
    fn other_programs_give_the_same_number() {
        let (a, b) = pair(192, 208);
        let value = ms_ssim_and_gradient(a.view(), b.view()).expect("large enough").0;
        assert_abs(value, 0.978_298_511_157_543_2, 1e-12, "NumPy");
        assert_abs(value, 0.978_298_612_769_098_7, 2e-7, "pytorch-msssim");
    }

    #[test]
    fn the_gradient_agrees_with_differences_at_every_number_of_scales() {
        for (rows, cols) in [(11, 17), (25, 30), (51, 47), (180, 177)] {
            let (b, a) = pair(rows, cols);
            let (value, gradient) = ms_ssim_and_gradient(a.view(), b.view()).expect("large enough");
            assert!(value < 1.0);
            let rng = &mut fastrand::Rng::with_seed(5);
            let d = Array3::from_shape_simple_fn(a.dim(), || rng.f64() - 0.5);
            let f = |h: f64| ms_ssim_and_gradient((&a + &(&d * h)).view(), b.view()).expect("large enough").0;
            assert_rel((&gradient * &d).sum(), central_difference(f, 1e-5), 1e-6, 1e-4, &format!("{rows} x {cols}"));
        }
        let (a, b) = pair(15, 21);
        let (one, _) = ms_ssim_and_gradient(a.view(), b.view()).expect("large enough");
        // One scale is plain SSIM; the published exponents sum to 1.0001.
        let plain: f64 = (0..3)
            .map(|k| {
                let channel = |x: &Array3<f64>| x.slice(s![k..=k, .., ..]).to_owned();
                ssim_values(channel(&a).view(), channel(&b).view()).expect("large enough").powf(1.0001) / 3.0
            })
            .sum();
        assert_abs(one, plain, 1e-12, "one scale");
    }

    #[test]
    fn extreme_pictures_have_finite_values() {
        let black = Array3::<f64>::zeros((3, 64, 64));
        let (value, gradient) = ms_ssim_and_gradient(black.view(), black.view()).expect("large enough");
        assert_abs(value, 1.0, 1e-12, "equal pictures");
        assert!(gradient.iter().all(|g| g.abs() < 1e-9));
        let (a, _) = pair(64, 64);
        let (value, gradient) = ms_ssim_and_gradient((1.0 - &a).view(), a.view()).expect("large enough");
        assert!(value > 0.0 && value < 0.2 && gradient.iter().all(|g| g.is_finite()));
        assert!(ms_ssim_and_gradient(Array3::zeros((3, 10, 64)).view(), Array3::zeros((3, 10, 64)).view()).is_err());
    }
}
