//! One fixed linear demosaic with its exact transpose: the network's input, in training and in the camera.
//!
//! H. S. Malvar, L.-W. He, R. Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned color
//! images", Proc. ICASSP 2004, vol. 3, pp. 485–488, fig. 2. Each missing sample is the bilinear guess plus a gain
//! (1/2, 5/8, 3/4) times the Laplacian of the channel that was measured there, written as 5 × 5 kernels in eighths.
//! At the border the mosaic is reflected about its outermost pixels (`… 2 1 | 0 1 2 …`), which keeps the parity of rows
//! and columns, hence the colour of every tap. Constants of grey pictures are kept; the result is not clipped.
//! Not covered: anything that adapts to edges; the network does that.

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis, s};
use rayon::prelude::*;

use crate::plane::mirrored;
use crate::sensor::cfa::Cfa;
use isoplanat_base::math::real::Real;

/// Half the kernels' width.
const PAD: usize = 2;

/// Rows of one parallel strip; fixed, so that sums of the transpose do not depend on the number of threads.
const STRIP: usize = 64;

/// The measured sample itself.
const ITSELF: [[i8; 5]; 5] = [[0; 5], [0; 5], [0, 0, 16, 0, 0], [0; 5], [0; 5]];
/// Green at red or blue, in sixteenths.
const GREEN: [[i8; 5]; 5] = [[0, 0, -2, 0, 0], [0, 0, 4, 0, 0], [-2, 4, 8, 4, -2], [0, 0, 4, 0, 0], [0, 0, -2, 0, 0]];
/// Red or blue at green, where its neighbours of that colour lie left and right, in sixteenths.
const ALONG_ROW: [[i8; 5]; 5] =
    [[0, 0, 1, 0, 0], [0, -2, 0, -2, 0], [-2, 8, 10, 8, -2], [0, -2, 0, -2, 0], [0, 0, 1, 0, 0]];
/// Red or blue at green, where its neighbours of that colour lie above and below, in sixteenths.
const ALONG_COLUMN: [[i8; 5]; 5] =
    [[0, 0, -2, 0, 0], [0, -2, 8, -2, 0], [1, 0, 10, 0, 1], [0, -2, 8, -2, 0], [0, 0, -2, 0, 0]];
/// Red at blue and blue at red, in sixteenths.
const OPPOSITE: [[i8; 5]; 5] =
    [[0, 0, -3, 0, 0], [0, 4, 0, 4, 0], [-3, 0, 12, 0, -3], [0, 4, 0, 4, 0], [0, 0, -3, 0, 0]];

/// One weight of a kernel: row and column offset from the kernel's first entry.
struct Tap<T> {
    row: usize,
    col: usize,
    weight: T,
}

/// The kernels of a layout: taps of `[row parity * 2 + column parity][channel]`.
fn kernels<T: Real>(cfa: Cfa) -> [[Vec<Tap<T>>; 3]; 4] {
    std::array::from_fn(|site| {
        std::array::from_fn(|channel| {
            let here = cfa.channel(site / 2, site % 2);
            let kernel = if here == channel {
                ITSELF
            } else if channel == 1 {
                GREEN
            } else if here != 1 {
                OPPOSITE
            } else if cfa.channel(site / 2, site % 2 + 1) == channel {
                ALONG_ROW
            } else {
                ALONG_COLUMN
            };
            let entries = (0..25).map(|i| Tap {
                row: i / 5,
                col: i % 5,
                weight: T::real(f64::from(kernel[i / 5][i % 5]) / 16.0),
            });
            entries.filter(|tap| tap.weight != T::zero()).collect()
        })
    })
}

/// The index inside `0..n` that the padded index `i` (`0..n + 2 PAD`) is mirrored to.
fn reflected(i: usize, n: usize) -> usize {
    mirrored(i.cast_signed() - PAD.cast_signed(), n)
}

/// Rows whose even and odd columns lie apart, so that loops over one colour are contiguous.
struct Split {
    /// Columns of one parity, rounded up.
    half: usize,
}

impl Split {
    /// The layout of padded rows of a mosaic with `cols` columns.
    fn padded(cols: usize) -> Self {
        Self { half: (cols + 2 * PAD).div_ceil(2) }
    }

    /// Numbers in a row.
    fn stride(&self) -> usize {
        2 * self.half
    }

    /// Where column `c` of a row lies.
    fn index(&self, c: usize) -> usize {
        (c & 1) * self.half + c / 2
    }
}

/// How many of `cols` columns have the parity.
fn count(cols: usize, parity: usize) -> usize {
    (cols + 1 - parity) / 2
}

/// Colour image of a Bayer mosaic.
///
/// # Shapes
/// `mosaic`: `[row, col]`; result `[3, row, col]`. Any size, empty ones too.
pub(crate) fn demosaic<T: Real>(mosaic: ArrayView2<'_, T>, cfa: Cfa) -> Array3<T> {
    let (rows, cols) = mosaic.dim();
    let mut rgb = Array3::zeros((3, rows, cols));
    if rows == 0 || cols == 0 {
        return rgb;
    }
    let (kernels, split) = (kernels::<T>(cfa), Split::padded(cols));
    rgb.axis_chunks_iter_mut(Axis(1), STRIP).into_par_iter().enumerate().for_each(|(strip, mut rgb)| {
        // The strip's rows and those around them, the border reflected.
        let (first, count_of_rows) = (strip * STRIP, rgb.len_of(Axis(1)));
        let mut padded = vec![T::zero(); (count_of_rows + 2 * PAD) * split.stride()];
        for (r, row) in padded.chunks_mut(split.stride()).enumerate() {
            let source = mosaic.row(reflected(first + r, rows));
            for c in 0..cols + 2 * PAD {
                row[split.index(c)] = source[reflected(c, cols)];
            }
        }
        // Sum the taps, row by row and one column parity at a time.
        let mut sums = vec![T::zero(); count(cols, 0)];
        for (r, mut out) in rgb.axis_iter_mut(Axis(1)).enumerate() {
            for parity in 0..2 {
                let n = count(cols, parity);
                let site = ((first + r) & 1) * 2 + parity;
                for (taps, mut row) in kernels[site].iter().zip(out.axis_iter_mut(Axis(0))) {
                    sums[..n].fill(T::zero());
                    for tap in taps {
                        let from = (r + tap.row) * split.stride() + split.index(parity + tap.col);
                        for (sum, v) in sums[..n].iter_mut().zip(&padded[from..from + n]) {
                            *sum += tap.weight * *v;
                        }
                    }
                    let row = row.as_slice_mut().expect("rows are contiguous");
                    row[parity..].iter_mut().step_by(2).zip(&sums[..n]).for_each(|(v, sum)| *v = *sum);
                }
            }
        }
    });
    rgb
}

/// Pulls a cotangent of [`demosaic`] back to the mosaic: the exact transpose.
///
/// # Shapes
/// `rgb_bar`: `[3, row, col]`; result `[row, col]`.
///
/// # Panics
/// If `rgb_bar` has not three channels.
pub(crate) fn demosaic_vjp<T: Real>(rgb_bar: ArrayView3<'_, T>, cfa: Cfa) -> Array2<T> {
    let (channels, rows, cols) = rgb_bar.dim();
    assert_eq!(channels, 3, "a demosaicked image has three channels");
    let mut mosaic_bar = Array2::zeros((rows, cols));
    if rows == 0 || cols == 0 {
        return mosaic_bar;
    }
    // Scatter the taps of each strip of rows into a padded strip of its own.
    let kernels = kernels::<T>(cfa);
    let split = Split::padded(cols);
    let strips: Vec<Vec<T>> = (0..rows.div_ceil(STRIP))
        .into_par_iter()
        .map(|strip| {
            let span = strip * STRIP..rows.min((strip + 1) * STRIP);
            let mut local = vec![T::zero(); (span.len() + 2 * PAD) * split.stride()];
            let mut bars = vec![T::zero(); count(cols, 0)];
            for r in span.clone() {
                for parity in 0..2 {
                    let n = count(cols, parity);
                    for (channel, taps) in kernels[(r & 1) * 2 + parity].iter().enumerate() {
                        let row = rgb_bar.slice(s![channel, r, parity..;2]);
                        bars[..n].iter_mut().zip(row).for_each(|(bar, v)| *bar = *v);
                        for tap in taps {
                            let to = (r - span.start + tap.row) * split.stride() + split.index(parity + tap.col);
                            for (sum, bar) in local[to..to + n].iter_mut().zip(&bars[..n]) {
                                *sum += tap.weight * *bar;
                            }
                        }
                    }
                }
            }
            local
        })
        .collect();
    // Fold the strips and the reflected border onto the mosaic, in order.
    for (strip, local) in strips.iter().enumerate() {
        for (i, row) in local.chunks(split.stride()).enumerate() {
            let mut target = mosaic_bar.row_mut(reflected(strip * STRIP + i, rows));
            for c in 0..cols + 2 * PAD {
                target[reflected(c, cols)] += row[split.index(c)];
            }
        }
    }
    mosaic_bar
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::cfa;

    const SIZES: [(usize, usize); 9] = [(1, 1), (1, 2), (2, 1), (2, 2), (3, 5), (4, 1), (17, 12), (67, 9), (130, 31)];

    #[test]
    fn demosaic_vjp_is_the_transpose() {
        let rng = &mut fastrand::Rng::with_seed(2);
        for cfa in Cfa::ALL {
            for (rows, cols) in SIZES {
                let mosaic = Array2::from_shape_fn((rows, cols), |_| rng.f64() - 0.5);
                let bar = Array3::from_shape_fn((3, rows, cols), |_| rng.f64() - 0.5);
                let image = demosaic(mosaic.view(), cfa);
                let pushed = (&image * &bar).sum();
                let pulled = (&mosaic * &demosaic_vjp(bar.view(), cfa)).sum();
                let size = (image.mapv(|v| v * v).sum() * bar.mapv(|v| v * v).sum()).sqrt();
                assert!((pushed - pulled).abs() <= 1e-12 * size, "{cfa} {rows}×{cols}: {pushed} {pulled}");
            }
        }
    }

    /// Green of the paper's filter at a red pixel, by its formula: bilinear plus half the red Laplacian.
    #[test]
    fn the_kernels_follow_the_papers_formulas() {
        let rng = &mut fastrand::Rng::with_seed(3);
        let x = Array2::from_shape_fn((9, 9), |_| rng.f64());
        let at = |r: usize, c: usize| x[[r, c]];
        let out = demosaic(x.view(), Cfa::RGGB);
        let laplacian =
            |r: usize, c: usize| at(r, c) - (at(r - 2, c) + at(r + 2, c) + at(r, c - 2) + at(r, c + 2)) / 4.0;
        let cross = |r: usize, c: usize| (at(r - 1, c) + at(r + 1, c) + at(r, c - 1) + at(r, c + 1)) / 4.0;
        let corners =
            |r: usize, c: usize| (at(r - 1, c - 1) + at(r - 1, c + 1) + at(r + 1, c - 1) + at(r + 1, c + 1)) / 4.0;
        // Red pixel (4, 4): green gains α = 1/2, blue gains γ = 3/4.
        assert!((out[[1, 4, 4]] - cross(4, 4) - laplacian(4, 4) / 2.0).abs() < 1e-15);
        assert!((out[[2, 4, 4]] - corners(4, 4) - 0.75 * laplacian(4, 4)).abs() < 1e-15);
        assert_eq!(out[[0, 4, 4]], at(4, 4));
        // Green pixel (4, 5) of a red row: red gains β = 5/8 times the paper's nine-point Laplacian of green.
        let nine = |r: usize, c: usize, along: f64, across: f64| {
            at(r, c)
                - corners(r, c) * 4.0 / 5.0
                - (at(r, c - 2) + at(r, c + 2)) * along
                - (at(r - 2, c) + at(r + 2, c)) * across
        };
        let red = (at(4, 4) + at(4, 6)) / 2.0 + 0.625 * nine(4, 5, 0.2, -0.1);
        assert!((out[[0, 4, 5]] - red).abs() < 1e-15);
        let blue = (at(3, 5) + at(5, 5)) / 2.0 + 0.625 * nine(4, 5, -0.1, 0.2);
        assert!((out[[2, 4, 5]] - blue).abs() < 1e-15);
    }

    #[test]
    fn grey_gradients_are_reproduced_and_measured_samples_kept() {
        for cfa in Cfa::ALL {
            let ramp = Array3::from_shape_fn((3, 12, 14), |(_, r, c)| 0.1 + 0.02 * r as f64 + 0.01 * c as f64);
            let out = demosaic(cfa::mosaic(ramp.view(), cfa).view(), cfa);
            let inner = s![.., 2..10, 2..12];
            let worst = (&out.slice(inner) - &ramp.slice(inner)).mapv(f64::abs).fold(0.0, |a: f64, &b| a.max(b));
            assert!(worst < 1e-14, "{cfa}: {worst}");
            let flat = Array2::from_elem((7, 6), 0.3);
            assert!(demosaic(flat.view(), cfa).iter().all(|v: &f64| (v - 0.3).abs() < 1e-15));
            let rng = &mut fastrand::Rng::with_seed(4);
            let raw = Array2::from_shape_fn((8, 8), |_| rng.f32());
            assert_eq!(cfa::mosaic(demosaic(raw.view(), cfa).view(), cfa), raw);
        }
    }

    #[test]
    fn a_crop_with_its_shifted_layout_agrees_inside() {
        let rng = &mut fastrand::Rng::with_seed(5);
        let raw = Array2::from_shape_fn((20, 22), |_| rng.f64());
        let whole = demosaic(raw.view(), Cfa::RGGB);
        let crop = demosaic(raw.slice(s![3..17, 4..21]), Cfa::RGGB.shifted(3, 4));
        assert_eq!(crop.slice(s![.., 2..12, 2..15]), whole.slice(s![.., 5..15, 6..19]));
    }

    #[test]
    fn empty_mosaics_pass() {
        assert_eq!(demosaic(Array2::<f32>::zeros((0, 4)).view(), Cfa::RGGB).dim(), (3, 0, 4));
        assert_eq!(demosaic_vjp(Array3::<f32>::zeros((3, 4, 0)).view(), Cfa::RGGB).dim(), (4, 0));
    }
}
