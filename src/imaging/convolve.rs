//! Varying blur: `y(p) = Σ_r [k_r * (w_r a_r s)](p)`, exact transposes to kernels, amplitudes and scene.
//!
//! The window multiplies the *source*, because a PSF belongs to its object point. A region is computed from a source
//! grown by half a kernel on every side; circular wrap then touches only pixels outside the region, so the FFT is as
//! large as the source. All nodes of a channel are summed in the frequency domain: two forward FFTs a node, one
//! inverse a channel. Whole frames: [`super::blur`].

use ndarray::{Array2, Array3, Array4, ArrayView2, ArrayView3, Axis, s};
use rayon::prelude::*;
use rustfft::num_complex::Complex;

use super::cfa::Real;
use super::patches::NodeRaster;
use super::warp::Region;
use crate::math::fft::{RealFft2, Spectrum, good_size};

/// What the forward call leaves for its adjoint.
pub struct ConvolveRecord<T: Real> {
    plan: RealFft2<T>,
    /// Nodes that touch the source.
    nodes: Vec<usize>,
    /// Spectra of kernels and windowed sources, `[node][channel]`.
    kernels: Vec<Vec<Spectrum<T>>>,
    sources: Vec<Vec<Spectrum<T>>>,
}

/// Blurs `source` (covering `region` grown by half the kernel); gives `[channel, region rows, region cols]`.
///
/// `kernels` `[node, channel, k, k]` with odd `k`, `amplitude` `[node, channel]`.
pub fn convolve<T: Real>(
    raster: NodeRaster,
    kernels: &Array4<T>,
    amplitude: &Array2<T>,
    source: ArrayView3<'_, T>,
    region: Region,
) -> (Array3<T>, ConvolveRecord<T>) {
    let size = kernels.len_of(Axis(3));
    assert!(size % 2 == 1, "kernel size {size} is odd");
    let grown = region.grown(size / 2);
    assert_eq!((source.len_of(Axis(1)), source.len_of(Axis(2))), (grown.rows, grown.cols), "source covers the region");
    let channels = source.len_of(Axis(0));
    let plan = RealFft2::new(good_size(grown.rows), good_size(grown.cols));
    let nodes: Vec<usize> = (0..raster.len()).filter(|n| raster.support(*n, grown).is_some()).collect();
    let spectra: Vec<(Vec<_>, Vec<_>)> = nodes
        .par_iter()
        .map(|&n| {
            (0..channels)
                .map(|c| {
                    let windowed = windowed(raster, n, grown, source.index_axis(Axis(0), c), amplitude[[n, c]]);
                    (plan.forward(kernels.slice(s![n, c, .., ..])), plan.forward(windowed.view()))
                })
                .unzip()
        })
        .collect();
    let (kernel_spectra, source_spectra): (Vec<_>, Vec<_>) = spectra.into_iter().unzip();
    let planes: Vec<Array2<T>> = (0..channels)
        .into_par_iter()
        .map(|c| {
            let mut sum = zero_like(&kernel_spectra[0][c]);
            for (k, x) in kernel_spectra.iter().zip(&source_spectra) {
                sum.iter_mut().zip(k[c].iter().zip(&x[c])).for_each(|(s, (a, b))| *s += *a * *b);
            }
            plan.inverse(sum, size - 1, region.rows).slice(s![.., size - 1..size - 1 + region.cols]).to_owned()
        })
        .collect();
    let views: Vec<ArrayView2<'_, T>> = planes.iter().map(|p| p.view()).collect();
    let out = ndarray::stack(Axis(0), &views).expect("equal planes");
    (out, ConvolveRecord { plan, nodes, kernels: kernel_spectra, sources: source_spectra })
}

/// Cotangents that leave [`convolve_vjp`].
pub struct ConvolveBar<T> {
    /// Of the kernels, `[node, channel, k, k]`.
    pub kernels: Array4<T>,
    /// Of the amplitudes, `[node, channel]`.
    pub amplitude: Array2<T>,
    /// Of the grown source.
    pub source: Array3<T>,
}

/// The exact transpose of [`convolve`].
pub fn convolve_vjp<T: Real>(
    raster: NodeRaster,
    record: &ConvolveRecord<T>,
    kernel_dim: (usize, usize, usize, usize),
    amplitude: &Array2<T>,
    source: ArrayView3<'_, T>,
    region: Region,
    image_bar: ArrayView3<'_, T>,
) -> ConvolveBar<T> {
    let (count, channels, size, _) = kernel_dim;
    let grown = region.grown(size / 2);
    // The cotangent stands where the forward call read: rows and columns size − 1 and on.
    let bars: Vec<Spectrum<T>> = (0..channels)
        .into_par_iter()
        .map(|c| {
            let mut placed = Array2::from_elem((grown.rows, grown.cols), T::zero());
            placed.slice_mut(s![size - 1.., size - 1..]).assign(&image_bar.index_axis(Axis(0), c));
            record.plan.forward(placed.view())
        })
        .collect();
    let parts: Vec<Vec<(Array2<T>, Array2<T>)>> = record
        .nodes
        .par_iter()
        .enumerate()
        .map(|(i, _)| {
            (0..channels)
                .map(|c| {
                    let kernel = record.plan.inverse(correlated(&bars[c], &record.sources[i][c]), 0, size);
                    let field = record.plan.inverse(correlated(&bars[c], &record.kernels[i][c]), 0, grown.rows);
                    (kernel.slice(s![.., ..size]).to_owned(), field.slice(s![.., ..grown.cols]).to_owned())
                })
                .collect()
        })
        .collect();
    let mut out = ConvolveBar {
        kernels: Array4::from_elem((count, channels, size, size), T::zero()),
        amplitude: Array2::from_elem((count, channels), T::zero()),
        source: Array3::from_elem((channels, grown.rows, grown.cols), T::zero()),
    };
    for (&n, channel_parts) in record.nodes.iter().zip(&parts) {
        for (c, (kernel, field)) in channel_parts.iter().enumerate() {
            out.kernels.slice_mut(s![n, c, .., ..]).assign(kernel);
            let (r0, nr, c0, nc) = raster.support(n, grown).expect("recorded nodes touch the source");
            let (row, col) = raster.pixel(n);
            let mut sum = T::zero();
            for i in r0..r0 + nr {
                let wy = raster.hat(grown.row + i.cast_signed() - row);
                for j in c0..c0 + nc {
                    let w = T::real(wy * raster.hat(grown.col + j.cast_signed() - col));
                    let v = w * field[[i, j]];
                    sum += v * source[[c, i, j]];
                    out.source[[c, i, j]] += v * amplitude[[n, c]];
                }
            }
            out.amplitude[[n, c]] = sum;
        }
    }
    out
}

/// The interpolated amplitude `Σ_r w_r(p) a_r` over `region`, `[channel, row, col]`: relative illumination.
pub fn interpolate<T: Real>(raster: NodeRaster, amplitude: &Array2<T>, region: Region) -> Array3<T> {
    let channels = amplitude.len_of(Axis(1));
    let mut out = Array3::from_elem((channels, region.rows, region.cols), T::zero());
    for_windows(raster, region, |n, i, j, w| {
        for c in 0..channels {
            out[[c, i, j]] += T::real(w) * amplitude[[n, c]];
        }
    });
    out
}

/// The transpose of [`interpolate`].
pub fn interpolate_vjp<T: Real>(raster: NodeRaster, region: Region, bar: ArrayView3<'_, T>) -> Array2<T> {
    let channels = bar.len_of(Axis(0));
    let mut out = Array2::from_elem((raster.len(), channels), T::zero());
    for_windows(raster, region, |n, i, j, w| {
        for c in 0..channels {
            out[[n, c]] += T::real(w) * bar[[c, i, j]];
        }
    });
    out
}

fn for_windows(raster: NodeRaster, region: Region, mut f: impl FnMut(usize, usize, usize, f64)) {
    for n in 0..raster.len() {
        let Some((r0, nr, c0, nc)) = raster.support(n, region) else { continue };
        let (row, col) = raster.pixel(n);
        for i in r0..r0 + nr {
            let wy = raster.hat(region.row + i.cast_signed() - row);
            for j in c0..c0 + nc {
                f(n, i, j, wy * raster.hat(region.col + j.cast_signed() - col));
            }
        }
    }
}

fn windowed<T: Real>(
    raster: NodeRaster,
    n: usize,
    grown: Region,
    source: ArrayView2<'_, T>,
    amplitude: T,
) -> Array2<T> {
    let mut out = Array2::from_elem(source.dim(), T::zero());
    let Some((r0, nr, c0, nc)) = raster.support(n, grown) else { return out };
    let (row, col) = raster.pixel(n);
    for i in r0..r0 + nr {
        let wy = raster.hat(grown.row + i.cast_signed() - row);
        for j in c0..c0 + nc {
            let w = T::real(wy * raster.hat(grown.col + j.cast_signed() - col));
            out[[i, j]] = w * amplitude * source[[i, j]];
        }
    }
    out
}

fn zero_like<T: Real>(a: &Spectrum<T>) -> Spectrum<T> {
    Array2::from_elem(a.dim(), Complex::new(T::zero(), T::zero()))
}

/// `bar · conj(x)`: spectrum of the correlation.
fn correlated<T: Real>(bar: &Spectrum<T>, x: &Spectrum<T>) -> Spectrum<T> {
    let mut out = bar.clone();
    out.iter_mut().zip(x).for_each(|(a, b)| *a *= b.conj());
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::assert_rel;

    type Case = (NodeRaster, Array4<f64>, Array2<f64>, Array3<f64>, Region);

    fn case() -> Case {
        let rng = &mut fastrand::Rng::with_seed(7);
        let region = Region { row: 3, col: -2, rows: 20, cols: 27 };
        let grown = region.grown(3);
        let raster = NodeRaster::over(grown, 12);
        let kernels = Array4::from_shape_fn((raster.len(), 2, 7, 7), |_| rng.f64());
        let amplitude = Array2::from_shape_fn((raster.len(), 2), |_| rng.f64());
        let source = Array3::from_shape_fn((2, grown.rows, grown.cols), |_| rng.f64());
        (raster, kernels, amplitude, source, region)
    }

    /// Against the plain sum of the definition.
    #[test]
    fn convolve_is_the_plain_sum() {
        let (raster, kernels, amplitude, source, region) = case();
        let (fast, _) = convolve(raster, &kernels, &amplitude, source.view(), region);
        let grown = region.grown(3);
        for c in 0..2 {
            for i in 0..region.rows {
                for j in 0..region.cols {
                    let mut sum = 0.0;
                    for a in 0..7 {
                        for b in 0..7 {
                            // Kernel entry (a, b) moves light by (a − 3, b − 3).
                            let (si, sj) = (i + 6 - a, j + 6 - b);
                            for n in 0..raster.len() {
                                let (row, col) = raster.pixel(n);
                                let w = raster.hat(grown.row + si.cast_signed() - row)
                                    * raster.hat(grown.col + sj.cast_signed() - col);
                                sum += kernels[[n, c, a, b]] * w * amplitude[[n, c]] * source[[c, si, sj]];
                            }
                        }
                    }
                    assert_rel(fast[[c, i, j]], sum, 1e-12, 1.0, "pixel");
                }
            }
        }
    }

    /// ⟨ȳ, A x⟩ = ⟨Aᵀ ȳ, x⟩ for kernels, amplitudes and source: 1e-12 in f64, 1e-5 in f32.
    #[test]
    fn convolve_vjp_is_the_transpose() {
        let (raster, kernels, amplitude, source, region) = case();
        let rng = &mut fastrand::Rng::with_seed(8);
        let (out, record) = convolve(raster, &kernels, &amplitude, source.view(), region);
        let bar = Array3::from_shape_fn(out.dim(), |_| rng.f64() - 0.5);
        let back = convolve_vjp(raster, &record, kernels.dim(), &amplitude, source.view(), region, bar.view());
        let forward = (&out * &bar).sum();
        // The map is linear in each argument, so each pairing gives the same number.
        assert_rel((&back.kernels * &kernels).sum(), forward, 1e-12, 1.0, "kernels");
        assert_rel((&back.amplitude * &amplitude).sum(), forward, 1e-12, 1.0, "amplitude");
        assert_rel((&back.source * &source).sum(), forward, 1e-12, 1.0, "source");
        let (k, a, x, b) = (
            kernels.mapv(|v| v as f32),
            amplitude.mapv(|v| v as f32),
            source.mapv(|v| v as f32),
            bar.mapv(|v| v as f32),
        );
        let (out, record) = convolve(raster, &k, &a, x.view(), region);
        let back = convolve_vjp(raster, &record, k.dim(), &a, x.view(), region, b.view());
        // In f64 and relative to ‖y‖‖ȳ‖, so that neither the sum's own rounding nor its cancellation is measured.
        let dot = |x: &mut dyn Iterator<Item = (f32, f32)>| x.map(|(a, b)| f64::from(a) * f64::from(b)).sum::<f64>();
        let pairs = |x: &Array3<f32>, y: &Array3<f32>| dot(&mut x.iter().copied().zip(y.iter().copied()));
        let size = (pairs(&out, &out) * pairs(&b, &b)).sqrt();
        let forward = pairs(&out, &b);
        let kernels = dot(&mut back.kernels.iter().copied().zip(k.iter().copied()));
        assert!((kernels - forward).abs() < 1e-5 * size, "kernels f32: {kernels} {forward} of {size}");
        let source = pairs(&back.source, &x);
        assert!((source - forward).abs() < 1e-5 * size, "source f32: {source} {forward} of {size}");
    }

    /// `interpolate` and `interpolate_vjp` are transposes.
    #[test]
    fn interpolate_vjp_is_the_transpose() {
        let (raster, _, amplitude, _, region) = case();
        let rng = &mut fastrand::Rng::with_seed(9);
        let out = interpolate(raster, &amplitude, region);
        let bar = Array3::from_shape_fn(out.dim(), |_| rng.f64() - 0.5);
        let back = interpolate_vjp(raster, region, bar.view());
        assert_rel((&back * &amplitude).sum(), (&out * &bar).sum(), 1e-12, 1.0, "amplitude");
    }
}
