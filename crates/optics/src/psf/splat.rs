//! Rays → a kernel between scene samples and pixels, and back.
//!
//! The scene is sampled `m` times a pixel along each axis and carries a bilinear reconstruction (a tent of half-width `1/m`);
//! a pixel integrates over its aperture (a box one pixel wide). A ray that moves light by `u` pixels takes it from the
//! sample at `x` to the pixel centred on `c` with the weight `W(c − x − u)` along each axis, `W = box₁ ⊗ tent_{1/m}`; over
//! all samples that reach a pixel the weights sum to one. For `m = 1` this is the quadratic B-spline. `W` is C¹, so that
//! kernels can be differentiated.
//!
//! A kernel is kept on the fine raster, `m·k` to a side: sample `m q + φ` and pixel `q + δ` meet at the index
//! `m (δ + k/2) + (m − 1) − φ`; [`phase_of`] takes one phase's `k × k` kernel out of it.

/// Kernels are smaller than this.
const SHIFT: f64 = 1_048_576.0;

/// Integral of the unit tent from −1 to `v`.
#[inline(always)]
fn tent_integral(v: f64) -> f64 {
    let v = v.clamp(-1.0, 1.0);
    if v < 0.0 { 0.5 * (1.0 + v) * (1.0 + v) } else { 1.0 - 0.5 * (1.0 - v) * (1.0 - v) }
}

/// First fine index (counted from `δ = 0`, `φ = 0`), the `N = M + 2` weights of a move of `u` pixels, and their derivatives.
#[inline(always)]
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    reason = "small numbers, bounded by the caller"
)]
fn weights<const M: usize, const N: usize>(u: f64) -> (isize, [f64; N], [f64; N]) {
    let (mut w, mut d) = ([0.0; N], [0.0; N]);
    if M == 1 {
        let nearest = (u + 0.5 + SHIFT) as isize - SHIFT as isize;
        let t = u - nearest as f64;
        let (a, b) = (0.5 - t, 0.5 + t);
        (w[0], w[1], w[2]) = (0.5 * a * a, 0.75 - t * t, 0.5 * b * b);
        (d[0], d[1], d[2]) = (-a, -2.0 * t, b);
        return (nearest - 1, w, d);
    }
    let (m, fine) = (M as f64, u * M as f64);
    // Above zero for fine − M − ½ < f < fine + 3/2. (Truncation after a shift to positive numbers is a floor without its call.)
    let first = (fine - m - 0.5 + SHIFT) as isize - SHIFT as isize + 1;
    let scale = m.recip();
    for k in 0..N {
        let v = (first + k.cast_signed()) as f64 - 0.5 - fine;
        w[k] = scale * (tent_integral(v + m) - tent_integral(v));
        d[k] = (1.0 - v.abs()).max(0.0) - (1.0 - (v + m).abs()).max(0.0);
    }
    (first, w, d)
}

/// Form of kernels: pixels along a side (odd), samples a pixel, planes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Raster {
    /// Pixels along a side, odd.
    pub size: usize,
    /// Samples a pixel along each axis: 1, 2, 4 or 8.
    pub samples: usize,
}

impl Raster {
    /// Points along a side.
    pub(crate) fn side(&self) -> usize {
        self.size * self.samples
    }

    /// Points of a plane.
    pub fn len(&self) -> usize {
        self.side() * self.side()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.size == 0
    }

    /// Adds rays to `planes`, one plane a weight: `rays` gives a move in pixels (column, row) and a weight, `scales` the
    /// planes' factors on it. Returns the weight that fell outside, before the factors.
    ///
    /// # Panics
    /// For other than 1, 2, 4 or 8 samples.
    pub fn splat(
        self,
        planes: &mut [f64],
        scales: &[(usize, f64)],
        rays: impl Iterator<Item = ([f64; 2], f64)>,
    ) -> f64 {
        match self.samples {
            1 => self.splat_at::<1, 3>(planes, scales, rays),
            2 => self.splat_at::<2, 4>(planes, scales, rays),
            4 => self.splat_at::<4, 6>(planes, scales, rays),
            8 => self.splat_at::<8, 10>(planes, scales, rays),
            m => panic!("{m} samples a pixel"),
        }
    }

    fn splat_at<const M: usize, const N: usize>(
        self,
        planes: &mut [f64],
        scales: &[(usize, f64)],
        rays: impl Iterator<Item = ([f64; 2], f64)>,
    ) -> f64 {
        let (side, len) = (self.side(), self.len());
        let mut outside = 0.0;
        for (u, weight) in rays {
            let Some([(x, wx, _), (y, wy, _)]) = self.reach::<M, N>(u) else {
                outside += weight;
                continue;
            };
            if let (Some(x), Some(y)) = (inside::<N>(x, side), inside::<N>(y, side)) {
                for (plane, scale) in scales {
                    let (plane, w) = (&mut planes[plane * len..][..len], weight * scale);
                    for (dy, vy) in wy.iter().enumerate() {
                        let v = w * vy;
                        let row = &mut plane[(y + dy) * side + x..][..N];
                        row.iter_mut().zip(&wx).for_each(|(k, vx)| *k += v * vx);
                    }
                }
            } else {
                let mut kept = 0.0;
                for (at, v, _) in clipped([(x, wx, wx), (y, wy, wy)], side) {
                    kept += v;
                    for (plane, scale) in scales {
                        planes[plane * len + at] += weight * scale * v;
                    }
                }
                outside += weight * (1.0 - kept);
            }
        }
        outside
    }

    /// For every ray `(u, weight)`: tells `take` its number, the cotangent of `u`, and the planes' values under its
    /// footprint (the cotangent of its weight in each plane, before the factors `scales`).
    ///
    /// # Panics
    /// For other than 1, 2, 4 or 8 samples.
    pub(crate) fn splat_vjp(
        self,
        planes_bar: &[f64],
        scales: &[(usize, f64)],
        rays: impl Iterator<Item = ([f64; 2], f64)>,
        take: impl FnMut(usize, [f64; 2], &[f64]),
    ) {
        match self.samples {
            1 => self.splat_vjp_at::<1, 3>(planes_bar, scales, rays, take),
            2 => self.splat_vjp_at::<2, 4>(planes_bar, scales, rays, take),
            4 => self.splat_vjp_at::<4, 6>(planes_bar, scales, rays, take),
            8 => self.splat_vjp_at::<8, 10>(planes_bar, scales, rays, take),
            m => panic!("{m} samples a pixel"),
        }
    }

    fn splat_vjp_at<const M: usize, const N: usize>(
        self,
        planes_bar: &[f64],
        scales: &[(usize, f64)],
        rays: impl Iterator<Item = ([f64; 2], f64)>,
        mut take: impl FnMut(usize, [f64; 2], &[f64]),
    ) {
        let (side, len) = (self.side(), self.len());
        let mut values = vec![0.0; scales.len()];
        for (q, (u, weight)) in rays.enumerate() {
            values.fill(0.0);
            let mut u_bar = [0.0; 2];
            if let Some([(x, wx, dx), (y, wy, dy)]) = self.reach::<M, N>(u) {
                if let (Some(x), Some(y)) = (inside::<N>(x, side), inside::<N>(y, side)) {
                    for ((plane, scale), value) in scales.iter().zip(&mut values) {
                        let plane = &planes_bar[plane * len..][..len];
                        let w = weight * scale;
                        for k in 0..N {
                            let row = &plane[(y + k) * side + x..][..N];
                            let (mut along, mut slope) = (0.0, 0.0);
                            for j in 0..N {
                                along += wx[j] * row[j];
                                slope += dx[j] * row[j];
                            }
                            *value += wy[k] * along;
                            u_bar[0] += w * wy[k] * slope;
                            u_bar[1] += w * dy[k] * along;
                        }
                    }
                } else {
                    for (at, v, [vx, vy]) in clipped([(x, wx, dx), (y, wy, dy)], side) {
                        for ((plane, scale), value) in scales.iter().zip(&mut values) {
                            let bar = planes_bar[plane * len + at];
                            *value += v * bar;
                            u_bar[0] += weight * scale * vx * bar;
                            u_bar[1] += weight * scale * vy * bar;
                        }
                    }
                }
            }
            take(q, u_bar, &values);
        }
    }

    /// First index, weights and slopes along both axes of a ray that may reach the raster.
    #[inline(always)]
    #[expect(clippy::type_complexity, reason = "two axes of the same three things")]
    fn reach<const M: usize, const N: usize>(self, u: [f64; 2]) -> Option<[(isize, [f64; N], [f64; N]); 2]> {
        #[expect(clippy::cast_precision_loss, reason = "kernel sizes are small")]
        let limit = (self.size / 2) as f64 + 2.0;
        if !(u[0].abs() < limit && u[1].abs() < limit) {
            return None;
        }
        let origin = (M * (self.size / 2) + M - 1).cast_signed();
        Some(u.map(|u| {
            let (first, w, d) = weights::<M, N>(u);
            (first + origin, w, d)
        }))
    }
}

#[inline(always)]
fn inside<const N: usize>(first: isize, side: usize) -> Option<usize> {
    (first >= 0 && first + N.cast_signed() <= side.cast_signed()).then_some(first.unsigned_abs())
}

/// Points of a footprint that lie on the raster: index, weight, slopes of the weight along columns and rows.
#[inline(always)]
fn clipped<const N: usize>(
    [(x, wx, dx), (y, wy, dy)]: [(isize, [f64; N], [f64; N]); 2],
    side: usize,
) -> impl Iterator<Item = (usize, f64, [f64; 2])> {
    let place = move |c: isize, k: usize| usize::try_from(c + k.cast_signed()).ok().filter(|i| *i < side);
    (0..N).flat_map(move |a| (0..N).map(move |b| (a, b))).filter_map(move |(a, b)| {
        let (row, col) = (place(y, a)?, place(x, b)?);
        Some((row * side + col, wx[b] * wy[a], [dx[b] * wy[a], wx[b] * dy[a]]))
    })
}

/// Copies phase `(φ_row, φ_col)` of a fine kernel into `out`, `size × size`.
#[inline]
pub fn phase_of<T>(
    fine: &[f64],
    raster: Raster,
    phase: [usize; 2],
    mut out: ndarray::ArrayViewMut2<'_, T>,
    cast: impl Fn(f64) -> T,
) {
    let (side, m) = (raster.side(), raster.samples);
    for (a, mut row) in out.outer_iter_mut().enumerate() {
        let line = &fine[(m * a + m - 1 - phase[0]) * side..][..side];
        row.iter_mut().zip(line[m - 1 - phase[1]..].iter().step_by(m)).for_each(|(k, v)| *k = cast(*v));
    }
}

/// The transpose of [`phase_of`]: writes one phase's cotangent to its places of the fine raster.
#[inline]
pub fn phase_of_vjp<T: Copy>(
    bar: ndarray::ArrayView2<'_, T>,
    raster: Raster,
    phase: [usize; 2],
    fine_bar: &mut [f64],
    cast: impl Fn(T) -> f64,
) {
    let (side, m) = (raster.side(), raster.samples);
    for (a, row) in bar.outer_iter().enumerate() {
        let line = &mut fine_bar[(m * a + m - 1 - phase[0]) * side..][..side];
        line[m - 1 - phase[1]..].iter_mut().step_by(m).zip(row).for_each(|(k, v)| *k = cast(*v));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_abs, assert_rel, central_difference};

    fn one(raster: Raster, u: [f64; 2], w: f64) -> (Vec<f64>, f64) {
        let mut k = vec![0.0; raster.len()];
        let outside = raster.splat(&mut k, &[(0, 1.0)], std::iter::once((u, w)));
        (k, outside)
    }

    /// Phase by phase against the integral over the pixel of the moved tents; one in sum for every pixel.
    #[test]
    fn phases_are_box_on_tent() {
        let rng = &mut fastrand::Rng::with_seed(5);
        for samples in [1, 2, 4, 8] {
            let raster = Raster { size: 9, samples };
            let m = samples as f64;
            for _ in 0..5 {
                let u = [rng.f64() * 3.0 - 1.5, rng.f64() * 3.0 - 1.5];
                let (fine, outside) = one(raster, u, 1.0);
                assert_abs(outside, 0.0, 1e-14, "outside");
                assert_abs(fine.iter().sum(), 1.0, 1e-14, "weights of a pixel");
                let brute = |x: f64, u: f64| {
                    let n = 4000;
                    let at = |k: i32| {
                        let z = (f64::from(k) + 0.5) / f64::from(n) - u - x;
                        (1.0 - (z * m).abs()).max(0.0)
                    };
                    (0..n).map(at).sum::<f64>() / f64::from(n)
                };
                let mut out = ndarray::Array2::<f64>::zeros((9, 9));
                for phase in [[0, 0], [samples - 1, samples / 2]] {
                    phase_of(&fine, raster, phase, out.view_mut(), |v| v);
                    for ((a, b), v) in out.indexed_iter() {
                        // Entry (a, b) moves light by (a − 4, b − 4): from the pixel −(a − 4).
                        let x = |a: usize, f: usize| -(a as f64 - 4.0) + (f as f64 + 0.5) / m;
                        let expected = brute(x(a, phase[0]), u[1]) * brute(x(b, phase[1]), u[0]);
                        assert_abs(*v, expected, 1e-6, "phase");
                    }
                }
            }
        }
    }

    /// Moves and weights against differences, across the border too; planes with factors of their own.
    #[test]
    fn splat_vjp_agrees_with_differences() {
        let rng = &mut fastrand::Rng::with_seed(6);
        for samples in [1, 2, 4, 8] {
            let raster = Raster { size: 7, samples };
            let scales = [(0, 0.7), (1, -1.3)];
            let bar: Vec<f64> = (0..2 * raster.len()).map(|_| rng.f64() - 0.5).collect();
            for _ in 0..40 {
                let (u, w) = ([rng.f64() * 10.0 - 5.0, rng.f64() * 10.0 - 5.0], 0.5 + rng.f64());
                let f = |u: [f64; 2], w: f64| {
                    let mut k = vec![0.0; 2 * raster.len()];
                    raster.splat(&mut k, &scales, std::iter::once((u, w)));
                    k.iter().zip(&bar).map(|(a, b)| a * b).sum::<f64>()
                };
                raster.splat_vjp(&bar, &scales, std::iter::once((u, w)), |_, u_bar, values| {
                    let by = |d: [f64; 2]| central_difference(|h| f([u[0] + h * d[0], u[1] + h * d[1]], w), 1e-6);
                    assert_rel(u_bar[0], by([1.0, 0.0]), 1e-6, 1e-2, "∂u_x");
                    assert_rel(u_bar[1], by([0.0, 1.0]), 1e-6, 1e-2, "∂u_y");
                    let w_bar: f64 = values.iter().zip(&scales).map(|(v, s)| v * s.1).sum();
                    assert_rel(w_bar, f(u, w + 1.0) - f(u, w), 1e-9, 1e-2, "∂w");
                });
            }
        }
    }

    /// The phases' transpose takes every point of the raster once.
    #[test]
    fn phases_come_back_to_their_places() {
        let raster = Raster { size: 5, samples: 2 };
        let fine: Vec<f64> = (0..raster.len()).map(|k| k as f64).collect();
        let mut back = vec![-1.0; raster.len()];
        for phase in (0..2).flat_map(|a| (0..2).map(move |b| [a, b])) {
            let mut out = ndarray::Array2::<f64>::zeros((5, 5));
            phase_of(&fine, raster, phase, out.view_mut(), |v| v);
            phase_of_vjp(out.view(), raster, phase, &mut back, |v| v);
        }
        assert_eq!(fine, back);
    }

    /// Rays far outside, and not numbers: lost, nothing touched; at the border nothing is lost unseen.
    #[test]
    fn what_falls_outside_is_told() {
        let raster = Raster { size: 3, samples: 2 };
        for u in [[1e9, 0.0], [0.0, f64::NAN], [f64::NEG_INFINITY, 0.0]] {
            let (k, lost) = one(raster, u, 0.5);
            assert_eq!(lost, 0.5);
            assert!(k.iter().all(|v| *v == 0.0));
        }
        let (k, lost) = one(raster, [1.5, 0.0], 1.0);
        assert_abs(lost + k.iter().sum::<f64>(), 1.0, 1e-14, "nothing is lost unseen");
        assert!(lost > 0.1);
    }
}
