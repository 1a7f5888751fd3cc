//! Classical restoration to measure the network against: a Wiener filter that varies over the field.
//!
//! Around each node of a raster the image is deconvolved with that node's kernel `K`, in the frequency domain, by
//! `conj(K) / (|K|² + nsr·R(f))` (N. Wiener, "Extrapolation, interpolation, and smoothing of stationary time series", 1949).
//! `R` is the noise's power over the scene's: 1 for a white scene, or `(f / ¼)²` for a natural one, whose power falls
//! as f⁻² (f in cycles a pixel). Results are blended by bilinear weights between the nodes, a partition of unity. A tile
//! reaches beyond its support by a margin with a taper, and its mean is carried apart, so that neither the border of
//! the tile nor `nsr` changes brightness. Beyond the image's border the image is reflected.

use std::ops::Range;

use ndarray::{Array2, Array3, Array4, ArrayView2, ArrayView3, s};
use rayon::prelude::*;
use rustfft::num_complex::Complex;

use crate::metrics;
use crate::plane::mirrored;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::fft::{RealFft2, good_size};

/// Smallest margin around a tile, pixels: the filter's tails are longer than the kernel.
const MARGIN: usize = 24;

/// Kernels on a regular raster of nodes.
#[derive(Clone, Debug)]
pub struct LocalPsfs {
    rows: Vec<f64>,
    cols: Vec<f64>,
    kernels: Array4<f32>,
}

impl LocalPsfs {
    /// Kernels at the nodes `rows × cols`, positions in pixels (the centre of the first pixel is 0).
    ///
    /// `y = k * s`: a convolution whose origin is the kernel's centre pixel `((k − 1)/2, (k − 1)/2)`.
    ///
    /// # Shapes
    /// `kernels`: `[node, channel, k, k]`, `k` odd, nodes row by row; one channel serves all.
    pub fn new(rows: Vec<f64>, cols: Vec<f64>, kernels: Array4<f32>) -> Result<Self> {
        let refuse = |ok: bool, place: &str, found: String, allowed: &str| {
            if ok { Ok(()) } else { Err(Error::bad("", place, found, allowed)) }
        };
        for (positions, place) in [(&rows, "node rows"), (&cols, "node columns")] {
            let good = !positions.is_empty()
                && positions.iter().all(|v| v.is_finite())
                && positions.windows(2).all(|w| w[0] < w[1]);
            refuse(good, place, format!("{positions:?}"), "at least one, finite and increasing")?;
        }
        let (nodes, channels, k, l) = kernels.dim();
        let good = nodes == rows.len() * cols.len() && channels > 0 && k == l && k % 2 == 1;
        let allowed = format!("[{}, channels, k, k] with k odd", rows.len() * cols.len());
        refuse(good, "kernels", format!("{:?}", kernels.dim()), &allowed)?;
        refuse(kernels.iter().all(|v| v.is_finite()), "kernels", "a value that is no number".into(), "finite values")?;
        Ok(Self { rows, cols, kernels })
    }
}

/// What the filter takes the scene's power spectrum to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Prior {
    /// Equal power at all frequencies.
    White,
    /// Power falling as f⁻².
    Natural,
}

impl Prior {
    /// In a word.
    pub fn name(self) -> &'static str {
        match self {
            Self::White => "white",
            Self::Natural => "natural",
        }
    }
}

/// A filter tuned on a known scene.
#[derive(Clone, Debug)]
pub struct Tuned {
    /// Noise-to-signal ratio.
    pub nsr: f32,
    /// Prior.
    pub prior: Prior,
    /// The restored image.
    pub image: Array3<f32>,
    /// Its PSNR against the scene, dB, as seen ([`metrics::psnr`]).
    pub psnr_db: f64,
}

/// Restores an image with the natural prior; see `wiener_with`.
pub fn wiener(image: ArrayView3<'_, f32>, psfs: &LocalPsfs, nsr: f32) -> Result<Array3<f32>> {
    wiener_with(image, psfs, nsr, Prior::Natural)
}

/// Restores an image that was blurred by `psfs`, with noise-to-signal ratio `nsr ≥ 0`.
///
/// Refuses a channel count the kernels do not serve, and an `nsr` that is no number of 0 or more.
///
/// # Shapes
/// `image`: `[channel, row, col]`, and so is the result.
pub(crate) fn wiener_with(image: ArrayView3<'_, f32>, psfs: &LocalPsfs, nsr: f32, prior: Prior) -> Result<Array3<f32>> {
    let (channels, rows, cols) = image.dim();
    let served = psfs.kernels.dim().1;
    if served != 1 && served != channels {
        let (found, allowed) = (format!("{served} channels of kernels"), format!("1 or the image's {channels}"));
        return Err(Error::bad("", "kernels", found, allowed));
    }
    if !nsr.is_finite() || nsr < 0.0 {
        return Err(Error::bad("", "nsr", nsr.to_string(), "a number of 0 or more"));
    }
    let mut out = Array3::zeros(image.dim());
    if out.is_empty() {
        return Ok(out);
    }
    let tiles = tiles(psfs, rows, cols);
    // One channel after the other keeps few tiles in memory; tiles are added in order.
    for channel in 0..channels {
        let restored: Vec<Array2<f32>> = tiles
            .par_iter()
            .map(|tile| {
                let kernel = psfs.kernels.slice(s![tile.node, channel.min(served - 1), .., ..]);
                tile.restore(image.slice(s![channel, .., ..]), kernel, nsr, prior)
            })
            .collect();
        for (tile, part) in tiles.iter().zip(restored) {
            let mut target = out.slice_mut(s![channel, tile.rows.clone(), tile.cols.clone()]);
            target += &part;
        }
    }
    Ok(out)
}

/// The prior and the `nsr` between 1e-7 and 10 that bring the image closest to the scene, by golden section over log nsr.
///
/// # Panics
/// If `image` and `truth` differ in shape.
pub fn tune(image: ArrayView3<'_, f32>, truth: ArrayView3<'_, f32>, psfs: &LocalPsfs) -> Result<Tuned> {
    let mut best: Option<Tuned> = None;
    for prior in [Prior::Natural, Prior::White] {
        let mut measure = |log_nsr: f64| -> Result<f64> {
            let nsr = 10f64.powf(log_nsr) as f32;
            let restored = wiener_with(image, psfs, nsr, prior)?;
            let psnr_db = metrics::psnr(restored.view(), truth);
            if best.as_ref().is_none_or(|b| psnr_db > b.psnr_db) {
                best = Some(Tuned { nsr, prior, image: restored, psnr_db });
            }
            Ok(psnr_db)
        };
        let golden = 0.5 * (5f64.sqrt() - 1.0);
        let (mut low, mut high) = (-7.0, 1.0);
        let (mut a, mut b) = (high - golden * (high - low), low + golden * (high - low));
        let (mut at_a, mut at_b) = (measure(a)?, measure(b)?);
        // To a twentieth of a decade, where the PSNR is flat to 0.01 dB.
        while high - low > 0.05 {
            if at_a >= at_b {
                (high, b, at_b) = (b, a, at_a);
                a = high - golden * (high - low);
                at_a = measure(a)?;
            } else {
                (low, a, at_a) = (a, b, at_b);
                b = low + golden * (high - low);
                at_b = measure(b)?;
            }
        }
    }
    best.ok_or_else(|| Error::Internal("no Wiener filter was tried".into()))
}

/// The part of the image in which a node has weight, and its weights.
struct Tile {
    node: usize,
    rows: Range<usize>,
    cols: Range<usize>,
    weight_row: Vec<f32>,
    weight_col: Vec<f32>,
}

fn tiles(psfs: &LocalPsfs, rows: usize, cols: usize) -> Vec<Tile> {
    let (along_rows, along_cols) = (tents(&psfs.rows, rows), tents(&psfs.cols, cols));
    let mut tiles = Vec::new();
    for (i, (row_span, weight_row)) in along_rows.iter().enumerate() {
        for (j, (col_span, weight_col)) in along_cols.iter().enumerate() {
            if !row_span.is_empty() && !col_span.is_empty() {
                tiles.push(Tile {
                    node: i * psfs.cols.len() + j,
                    rows: row_span.clone(),
                    cols: col_span.clone(),
                    weight_row: weight_row.clone(),
                    weight_col: weight_col.clone(),
                });
            }
        }
    }
    tiles
}

/// For each position: the pixels of `0..n` where its tent is above 0, and the tent there. Tents sum to 1 everywhere.
fn tents(positions: &[f64], n: usize) -> Vec<(Range<usize>, Vec<f32>)> {
    let last = positions.len() - 1;
    (0..=last)
        .map(|i| {
            let tent = |x: f64| {
                if x < positions[i] {
                    if i == 0 { 1.0 } else { 1.0 - (positions[i] - x) / (positions[i] - positions[i - 1]) }
                } else if i == last {
                    1.0
                } else {
                    1.0 - (x - positions[i]) / (positions[i + 1] - positions[i])
                }
            };
            let inside = |p: &usize| tent(*p as f64) > 0.0;
            let Some(start) = (0..n).find(inside) else { return (0..0, Vec::new()) };
            let end = (start..n).find(|p| !inside(p)).unwrap_or(n);
            (start..end, (start..end).map(|p| tent(p as f64) as f32).collect())
        })
        .collect()
}

impl Tile {
    /// The tile's part of the restored plane, weighted.
    fn restore(&self, plane: ArrayView2<'_, f32>, kernel: ArrayView2<'_, f32>, nsr: f32, prior: Prior) -> Array2<f32> {
        let margin = MARGIN.max(kernel.nrows());
        let [rows, cols] = [&self.rows, &self.cols].map(|range| good_size(range.len() + 2 * margin));
        let fft = RealFft2::<f32>::new(rows, cols);
        // Cut out the tile with its margin, reflected at the image's border.
        let cut = |r: usize, c: usize| {
            let row = mirrored((self.rows.start + r) as isize - margin as isize, plane.nrows());
            let col = mirrored((self.cols.start + c) as isize - margin as isize, plane.ncols());
            plane[[row, col]]
        };
        let mut field = Array2::from_shape_fn((rows, cols), |(r, c)| cut(r, c));
        // Take the mean out and taper the margin to it, so that the tile repeats without a jump.
        let mean = (field.iter().map(|v| f64::from(*v)).sum::<f64>() / field.len() as f64) as f32;
        let taper = |i: usize, n: usize, support: usize| {
            let off = margin.saturating_sub(i).max((i + 1).saturating_sub(margin + support));
            let room = if i < margin { margin } else { n - margin - support };
            // The inner half of the margin keeps its values.
            let t = (2.0 * off as f32 / room as f32 - 1.0).clamp(0.0, 1.0);
            0.5 + 0.5 * (std::f32::consts::PI * t).cos()
        };
        let taper_row: Vec<f32> = (0..rows).map(|r| taper(r, rows, self.rows.len())).collect();
        let taper_col: Vec<f32> = (0..cols).map(|c| taper(c, cols, self.cols.len())).collect();
        field.indexed_iter_mut().for_each(|((r, c), v)| *v = (*v - mean) * taper_row[r] * taper_col[c]);
        // Centre the kernel on the origin.
        let half = kernel.nrows() / 2;
        let mut spread = Array2::zeros((rows, cols));
        for ((r, c), &v) in kernel.indexed_iter() {
            spread[[(r + rows - half) % rows, (c + cols - half) % cols]] += v;
        }
        // Filter.
        let (mut spectrum, transfer) = (fft.forward(field.view()), fft.forward(spread.view()));
        for (((c, r), v), k) in spectrum.indexed_iter_mut().zip(&transfer) {
            let ratio = match prior {
                Prior::White => nsr,
                Prior::Natural => {
                    let (fr, fc) = (r.min(rows - r) as f32 / rows as f32, c as f32 / cols as f32);
                    nsr * 16.0 * (fr * fr + fc * fc)
                }
            };
            let bottom = k.norm_sqr() + ratio;
            *v = if bottom > 1e-20 { *v * k.conj() / bottom } else { Complex::default() };
        }
        let restored = fft.unscaled(spectrum, margin, self.rows.len()) / (rows * cols) as f32;
        let gain: f32 = kernel.sum();
        let level = if gain.abs() > 1e-6 { mean / gain } else { 0.0 };
        Array2::from_shape_fn((self.rows.len(), self.cols.len()), |(r, c)| {
            (restored[[r, c + margin]] + level) * self.weight_row[r] * self.weight_col[c]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{SceneKind, generate};
    use crate::sensor::noise::standard_normal;

    fn gaussian(k: usize, sigma: f32, shift: f32) -> Array2<f32> {
        let c = (k / 2) as f32;
        let g = Array2::from_shape_fn((k, k), |(i, j)| {
            (-((i as f32 - c - shift).powi(2) + (j as f32 - c).powi(2)) / (2.0 * sigma * sigma)).exp()
        });
        &g / g.sum()
    }

    /// `y = Σ k[q] s[p − q + c]`, by definition, reflected at the border.
    fn blurred(scene: &Array3<f32>, kernel_at: impl Fn(usize, usize) -> Array2<f32>) -> Array3<f32> {
        let (channels, rows, cols) = scene.dim();
        let mut out = Array3::zeros(scene.dim());
        for r in 0..rows {
            for c in 0..cols {
                let kernel = kernel_at(r, c);
                let half = kernel.nrows() as isize / 2;
                for ((i, j), k) in kernel.indexed_iter() {
                    let row = mirrored(r as isize - (i as isize - half), rows);
                    let col = mirrored(c as isize - (j as isize - half), cols);
                    (0..channels).for_each(|ch| out[[ch, r, c]] += k * scene[[ch, row, col]]);
                }
            }
        }
        out
    }

    #[test]
    fn identity_kernels_return_the_image() {
        let image = generate(SceneKind::Mixed, 3, 150, 170);
        let mut kernels = Array4::zeros((6, 3, 7, 7));
        kernels.slice_mut(s![.., .., 3, 3]).fill(1.0);
        let psfs = LocalPsfs::new(vec![10.0, 120.0], vec![-20.0, 80.0, 160.0], kernels).expect("well formed");
        for prior in [Prior::White, Prior::Natural] {
            let restored = wiener_with(image.view(), &psfs, 0.0, prior).expect("restores");
            let worst = (&restored - &image).iter().fold(0.0f32, |a, v| a.max(v.abs()));
            assert!(worst < 1e-5, "{worst}");
        }
    }

    #[test]
    fn a_shift_is_undone_in_the_right_direction() {
        let scene = generate(SceneKind::DeadLeaves, 1, 96, 96);
        let mut kernel = Array2::zeros((9, 9));
        kernel[[6, 3]] = 1.0;
        let image = blurred(&scene, |_, _| kernel.clone());
        assert_eq!(image[[0, 50, 50]], scene[[0, 48, 51]]);
        let kernels = kernel.into_shape_with_order((1, 1, 9, 9)).expect("same size");
        let psfs = LocalPsfs::new(vec![48.0], vec![48.0], kernels).expect("well formed");
        let restored = wiener(image.view(), &psfs, 0.0).expect("restores");
        let inside = s![.., 4..92, 4..92];
        let worst = (&restored.slice(inside) - &scene.slice(inside)).iter().fold(0.0f32, |a, v| a.max(v.abs()));
        assert!(worst < 1e-4, "{worst}");
    }

    #[test]
    fn a_known_blur_with_noise_is_restored() {
        let scene = generate(SceneKind::Mixed, 7, 160, 200);
        // The blur grows from left to right.
        let sigma = |c: f64| (1.0 + 1.2 * c / 200.0) as f32;
        let mut image = blurred(&scene, |_, c| gaussian(15, sigma(c as f64), 0.0));
        for (k, mut plane) in image.outer_iter_mut().enumerate() {
            plane += &(0.003 * standard_normal::<f32>(k as u64, (160, 200)));
        }
        let (rows, cols) = (vec![40.0, 120.0], vec![25.0, 75.0, 125.0, 175.0]);
        let mut kernels = Array4::zeros((8, 1, 15, 15));
        for (node, mut kernel) in kernels.outer_iter_mut().enumerate() {
            kernel.index_axis_mut(ndarray::Axis(0), 0).assign(&gaussian(15, sigma(cols[node % 4]), 0.0));
        }
        let psfs = LocalPsfs::new(rows, cols, kernels).expect("well formed");
        let tuned = tune(image.view(), scene.view(), &psfs).expect("tunes");
        let before = metrics::psnr(image.view(), scene.view());
        assert!(
            tuned.psnr_db > before + 2.0,
            "{before} dB to {tuned:?}",
            tuned = (tuned.psnr_db, tuned.nsr, tuned.prior)
        );
        // A tuned filter beats its neighbours.
        for factor in [0.1, 10.0] {
            let other = wiener_with(image.view(), &psfs, tuned.nsr * factor, tuned.prior).expect("restores");
            assert!(metrics::psnr(other.view(), scene.view()) < tuned.psnr_db);
        }
    }

    #[test]
    fn weights_sum_to_one_and_bad_input_is_refused() {
        for positions in [vec![5.0], vec![-3.0, 8.5, 40.0], vec![0.0, 9.0]] {
            let mut sum = [0.0f32; 20];
            for (span, weight) in tents(&positions, 20) {
                span.zip(weight).for_each(|(p, w)| sum[p] += w);
            }
            assert!(sum.iter().all(|v| (v - 1.0).abs() < 1e-6), "{positions:?}: {sum:?}");
        }
        let kernels = |k: usize| Array4::from_elem((2, 1, k, k), 0.1f32);
        assert!(LocalPsfs::new(vec![0.0], vec![0.0, 1.0], kernels(4)).is_err());
        assert!(LocalPsfs::new(vec![0.0], vec![1.0, 0.0], kernels(3)).is_err());
        assert!(LocalPsfs::new(vec![0.0], vec![0.0], kernels(3)).is_err());
        let psfs = LocalPsfs::new(vec![0.0], vec![0.0, 1.0], kernels(3)).expect("well formed");
        let image = Array3::zeros((3, 1, 5));
        assert!(wiener(image.view(), &psfs, f32::NAN).is_err() && wiener(image.view(), &psfs, -1.0).is_err());
        assert!(wiener(image.view(), &psfs, 0.1).expect("restores").iter().all(|v| *v == 0.0));
        assert!(wiener(Array3::zeros((3, 0, 5)).view(), &psfs, 0.1).expect("empty").is_empty());
    }
}
