//! SSIM of planes of numbers, with its gradients.
//!
//! Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli, "Image quality assessment: from error visibility to structural similarity", IEEE Trans. Image
//! Process. 13(4), 2004: Gaussian window of σ = 1.5 over 11 × 11 pixels, K₁ = 0.01, K₂ = 0.03, population moments, mean over the positions where the whole
//! window lies inside, then over channels. Pictures and networks are judged by it alike.

use ndarray::{Array1, Array2, Array3, ArrayView2, ArrayView3, s};
use rayon::prelude::*;

use crate::error::{Error, Result};

/// Side of SSIM's window, pixels.
pub const SSIM_WINDOW: usize = 11;

const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// SSIM of the numbers themselves for a data range of 1, mean over the channels.
///
/// # Shapes
/// `[channel, row, col]`.
///
/// # Errors
/// Pictures smaller than the window.
///
/// # Panics
/// If the shapes differ.
pub fn ssim_values(a: ArrayView3<'_, f64>, b: ArrayView3<'_, f64>) -> Result<f64> {
    require_window(a.dim())?;
    assert_eq!(a.dim(), b.dim(), "pictures of one shape");
    let channels = a.dim().0;
    let plane = |k| ssim_plane(a.slice(s![k, .., ..]), b.slice(s![k, .., ..]), Part::Whole, false).0;
    let planes: Vec<f64> = (0..channels).into_par_iter().map(plane).collect();
    Ok(planes.iter().sum::<f64>() / channels as f64)
}

/// SSIM of the numbers themselves for a data range of 1, and its gradients in both pictures.
///
/// # Errors
/// Pictures smaller than the window.
///
/// # Panics
/// If the shapes differ.
pub fn ssim_and_slopes(a: ArrayView3<'_, f64>, b: ArrayView3<'_, f64>) -> Result<(f64, [Array3<f64>; 2])> {
    require_window(a.dim())?;
    assert_eq!(a.dim(), b.dim(), "pictures of one shape");
    let channels = a.dim().0;
    let plane = |k| {
        let (a, b) = (a.slice(s![k, .., ..]), b.slice(s![k, .., ..]));
        let (value, of_a) = ssim_plane(a, b, Part::Whole, true);
        // The measure is the same both ways round.
        (value, [of_a, ssim_plane(b, a, Part::Whole, true).1])
    };
    let planes: Vec<_> = (0..channels).into_par_iter().map(plane).collect();
    let mut slopes = [Array3::zeros(a.dim()), Array3::zeros(a.dim())];
    for (k, (_, planes)) in planes.iter().enumerate() {
        for (whole, plane) in slopes.iter_mut().zip(planes) {
            let plane = plane.as_ref().map_or_else(|| Array2::zeros((a.dim().1, a.dim().2)), |p| p / channels as f64);
            whole.slice_mut(s![k, .., ..]).assign(&plane);
        }
    }
    Ok((planes.iter().map(|p| p.0).sum::<f64>() / channels as f64, slopes))
}

fn require_window((channels, rows, cols): (usize, usize, usize)) -> Result<()> {
    if rows < SSIM_WINDOW || cols < SSIM_WINDOW || channels == 0 {
        let found = format!("{channels} channels of {rows} × {cols}");
        return Err(Error::bad("", "picture for SSIM", found, "at least 11 × 11 pixels"));
    }
    Ok(())
}

/// Which of SSIM's factors count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Luminance, contrast and structure.
    Whole,
    /// Contrast and structure.
    Structure,
}

/// Mean SSIM of one channel and, where asked for, its gradient in `a`.
pub fn ssim_plane(
    a: ArrayView2<'_, f64>,
    b: ArrayView2<'_, f64>,
    part: Part,
    slope: bool,
) -> (f64, Option<Array2<f64>>) {
    let (mean_a, mean_b) = (windowed(a), windowed(b));
    let (aa, bb, ab) = (windowed((&a * &a).view()), windowed((&b * &b).view()), windowed((&a * &b).view()));
    let n = mean_a.len() as f64;
    let mut sum = 0.0;
    // Slopes with respect to the windowed a, a² and ab.
    let mut slopes: [Array2<f64>; 3] =
        std::array::from_fn(|_| Array2::zeros(if slope { mean_a.dim() } else { (0, 0) }));
    for ((r, c), &ma) in mean_a.indexed_iter() {
        let mb = mean_b[[r, c]];
        let (top_2, whole) = (2.0 * (ab[[r, c]] - ma * mb) + C2, part == Part::Whole);
        let (top_1, bottom_1) = if whole { (2.0 * ma * mb + C1, ma * ma + mb * mb + C1) } else { (1.0, 1.0) };
        let bottom_2 = aa[[r, c]] - ma * ma + bb[[r, c]] - mb * mb + C2;
        let bottom = bottom_1 * bottom_2;
        let value = top_1 * top_2 / bottom;
        sum += value;
        if slope {
            let luminance = f64::from(u8::from(whole));
            slopes[0][[r, c]] = (2.0 * mb * (luminance * top_2 - top_1) / bottom
                - 2.0 * ma * value * (luminance / bottom_1 - 1.0 / bottom_2))
                / n;
            slopes[1][[r, c]] = -value / bottom_2 / n;
            slopes[2][[r, c]] = 2.0 * top_1 / bottom / n;
        }
    }
    let gradient = slope.then(|| {
        let [mean, square, cross] = slopes.map(|s| windowed_vjp(s.view()));
        mean + 2.0 * &a * square + &b * cross
    });
    (sum / n, gradient)
}

/// The one-dimensional window, summing to 1.
fn window() -> [f64; SSIM_WINDOW] {
    let raw: [f64; SSIM_WINDOW] = std::array::from_fn(|i| (-0.5 * ((i as f64 - 5.0) / 1.5).powi(2)).exp());
    let sum: f64 = raw.iter().sum();
    raw.map(|v| v / sum)
}

/// Weighted mean under the window wherever it lies inside: 10 rows and columns fewer.
fn windowed(x: ArrayView2<'_, f64>) -> Array2<f64> {
    let (rows, cols) = (x.nrows() + 1 - SSIM_WINDOW, x.ncols() + 1 - SSIM_WINDOW);
    let weights = window();
    let mut out = Array2::zeros((rows, cols));
    // Row by row, so that what is summed stays in the cache.
    let mut along = Array1::zeros(x.ncols());
    for (r, mut row) in out.outer_iter_mut().enumerate() {
        along.fill(0.0);
        for (i, w) in weights.into_iter().enumerate() {
            along.scaled_add(w, &x.row(r + i));
        }
        for (i, w) in weights.into_iter().enumerate() {
            row.scaled_add(w, &along.slice(s![i..i + cols]));
        }
    }
    out
}

/// The transpose of [`windowed`].
fn windowed_vjp(bar: ArrayView2<'_, f64>) -> Array2<f64> {
    let (rows, cols) = bar.dim();
    let weights = window();
    let mut out = Array2::zeros((rows + SSIM_WINDOW - 1, cols + SSIM_WINDOW - 1));
    let mut along = Array1::zeros(cols + SSIM_WINDOW - 1);
    for (r, row) in bar.outer_iter().enumerate() {
        along.fill(0.0);
        for (i, w) in weights.into_iter().enumerate() {
            along.slice_mut(s![i..i + cols]).scaled_add(w, &row);
        }
        for (i, w) in weights.into_iter().enumerate() {
            out.row_mut(r + i).scaled_add(w, &along);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Axis;

    use crate::testing::{assert_rel, central_difference, two_pictures};

    #[test]
    fn the_gradient_of_ssim_matches_differences() {
        let (a, b) = two_pictures();
        let rng = &mut fastrand::Rng::with_seed(4);
        let d = Array3::from_shape_fn(a.dim(), |_| rng.f64() - 0.5);
        for (k, d) in d.outer_iter().enumerate() {
            let (a, b) = (a.index_axis(Axis(0), k), b.index_axis(Axis(0), k));
            let value = |h: f64| ssim_plane((&a + &(h * &d)).view(), b, Part::Whole, false).0;
            let gradient = ssim_plane(a, b, Part::Whole, true).1.expect("asked for");
            assert_rel((&gradient * &d).sum(), central_difference(value, 1e-4), 1e-8, 0.0, "gradient of SSIM");
        }
    }
}
