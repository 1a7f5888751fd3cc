//! Landings → a kernel between scene samples `1/m` pixel apart and pixels.
//!
//! The scene is sampled `m` times a pixel and carries a bilinear reconstruction (a tent of half-width `1/m`); a pixel
//! integrates over its aperture (a box one pixel wide). A ray that is displaced by `u` pixels moves light from the sample
//! at `x` to the pixel centred on `c` with the weight `W(c − x − u)` along each axis, `W = box₁ ⊗ tent_{1/m}`; over all
//! samples that reach a pixel the weights sum to one. For `m = 1` this is the quadratic B-spline of [`super::splat`].
//!
//! A kernel is kept on the fine raster, `m·k` to a side: sample `m q + φ` and pixel `q + δ` meet at the index
//! `m (δ + k/2) + (m − 1) − φ`; [`phase_of`] takes one phase's `k × k` kernel out of it.

/// Weights of one axis at most: `m + 2` for `m ≤ 8`.
const MOST: usize = 10;

/// Kernels are smaller than this.
const SHIFT: f64 = 1_048_576.0;

/// Integral of the unit tent from −1 to `v`.
#[inline]
fn tent_integral(v: f64) -> f64 {
    let v = v.clamp(-1.0, 1.0);
    if v < 0.0 { 0.5 * (1.0 + v) * (1.0 + v) } else { 1.0 - 0.5 * (1.0 - v) * (1.0 - v) }
}

/// First fine index and the `m + 2` weights of a displacement of `u` pixels; the index counts from `δ = 0`, `φ = 0`.
#[inline]
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    reason = "small numbers, bounded by the caller"
)]
fn weights(u: f64, m: usize) -> (isize, [f64; MOST]) {
    let fine = u * m as f64;
    // W_f = [G(f + m − ½ − mu) − G(f − ½ − mu)]/m is above zero for mu − m − ½ < f < mu + 3/2.
    // (Truncation after a shift to positive numbers is a floor without its call.)
    let first = (fine - m as f64 - 0.5 + SHIFT) as isize - SHIFT as isize + 1;
    let mut out = [0.0; MOST];
    let scale = 1.0 / m as f64;
    for (k, w) in out[..m + 2].iter_mut().enumerate() {
        let v = (first + k.cast_signed()) as f64 - 0.5 - fine;
        *w = scale * (tent_integral(v + m as f64) - tent_integral(v));
    }
    (first, out)
}

/// Adds one ray of weight `w`, displaced by `u` pixels (column, row), to the fine raster of a kernel of `size` pixels at
/// `m` samples a pixel (`m ≤ 8`); returns the share that fell outside.
#[inline]
pub fn splat_fine(kernel: &mut [f64], size: usize, m: usize, u: [f64; 2], w: f64) -> f64 {
    let side = m * size;
    #[expect(clippy::cast_precision_loss, reason = "kernel sizes are small")]
    let limit = (size / 2) as f64 + 2.0;
    if !(u[0].abs() < limit && u[1].abs() < limit) {
        return w;
    }
    let origin = (m * (size / 2) + m - 1).cast_signed();
    let ((cx, wx), (cy, wy)) = (weights(u[0], m), weights(u[1], m));
    let (cx, cy) = (cx + origin, cy + origin);
    let taps = m + 2;
    let within = |c: isize| c >= 0 && c + taps.cast_signed() <= side.cast_signed();
    if within(cx) && within(cy) {
        let (x, y) = (cx.unsigned_abs(), cy.unsigned_abs());
        for (dy, vy) in wy[..taps].iter().enumerate() {
            let v = w * vy;
            let row = &mut kernel[(y + dy) * side + x..][..taps];
            row.iter_mut().zip(&wx[..taps]).for_each(|(k, vx)| *k += v * vx);
        }
        return 0.0;
    }
    let mut inside = 0.0;
    let place = |c: isize, d: usize| usize::try_from(c + d.cast_signed()).ok().filter(|i| *i < side);
    for (dy, vy) in wy[..taps].iter().enumerate() {
        let Some(row) = place(cy, dy) else { continue };
        for (dx, vx) in wx[..taps].iter().enumerate() {
            let Some(col) = place(cx, dx) else { continue };
            kernel[row * side + col] += w * vx * vy;
            inside += w * vx * vy;
        }
    }
    w - inside
}

/// Copies phase `(φ_row, φ_col)` of a fine kernel into `out`, `size × size`.
#[inline]
pub fn phase_of<T>(
    fine: &[f64],
    size: usize,
    m: usize,
    phase: [usize; 2],
    mut out: ndarray::ArrayViewMut2<'_, T>,
    cast: impl Fn(f64) -> T,
) {
    let side = m * size;
    for (a, mut row) in out.outer_iter_mut().enumerate() {
        let line = &fine[(m * a + m - 1 - phase[0]) * side..][..side];
        row.iter_mut().zip(line[m - 1 - phase[1]..].iter().step_by(m)).for_each(|(k, v)| *k = cast(*v));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::assert_abs;

    /// One sample a pixel: the spline of `psf::splat`, to the last digits.
    #[test]
    fn one_sample_a_pixel_is_the_plain_splat() {
        let rng = &mut fastrand::Rng::with_seed(4);
        for _ in 0..200 {
            let u = [rng.f64() * 12.0 - 6.0, rng.f64() * 12.0 - 6.0];
            let (mut a, mut b) = (vec![0.0; 81], vec![0.0; 81]);
            let lost = [splat_fine(&mut a, 9, 1, u, 2.0), super::super::old_splat::splat(&mut b, 9, u, 2.0)];
            assert_abs(lost[0], lost[1], 1e-14, "outside");
            a.iter().zip(&b).for_each(|(a, b)| assert_abs(*a, *b, 1e-14, "kernel"));
        }
    }

    /// Phase by phase against the integral over the pixel of the displaced tents.
    #[test]
    fn phases_are_box_on_tent() {
        let rng = &mut fastrand::Rng::with_seed(5);
        for m in [1, 2, 3, 4] {
            for _ in 0..5 {
                let u = [rng.f64() * 3.0 - 1.5, rng.f64() * 3.0 - 1.5];
                let size = 9;
                let mut fine = vec![0.0; (m * size) * (m * size)];
                assert_abs(splat_fine(&mut fine, size, m, u, 1.0), 0.0, 1e-14, "outside");
                assert_abs(fine.iter().sum(), 1.0, 1e-14, "weights of a pixel");
                // Pixel 0 at ½ sees sample `x` displaced by `u`.
                let brute = |x: f64, u: f64| {
                    let n = 4000;
                    let at = |k: i32| {
                        let z = (f64::from(k) + 0.5) / f64::from(n) - u - x;
                        (1.0 - (z * m as f64).abs()).max(0.0)
                    };
                    (0..n).map(at).sum::<f64>() / f64::from(n)
                };
                let mut out = ndarray::Array2::<f64>::zeros((size, size));
                for phase in [[0, 0], [m - 1, m / 2]] {
                    phase_of(&fine, size, m, phase, out.view_mut(), |v| v);
                    for ((a, b), v) in out.indexed_iter() {
                        // Entry (a, b) moves light by (a − 4, b − 4): from the pixel −(a − 4).
                        let x = |a: usize, f: usize| -(a as f64 - 4.0) + (f as f64 + 0.5) / m as f64;
                        let expected = brute(x(a, phase[0]), u[1]) * brute(x(b, phase[1]), u[0]);
                        assert_abs(*v, expected, 1e-6, "phase");
                    }
                }
            }
        }
    }

    /// Rays far outside, and not numbers: lost, nothing touched.
    #[test]
    fn what_falls_outside_is_told() {
        for u in [[1e9, 0.0], [0.0, f64::NAN], [f64::NEG_INFINITY, 0.0]] {
            let mut fine = vec![0.0; 36];
            assert_eq!(splat_fine(&mut fine, 3, 2, u, 0.5), 0.5);
            assert!(fine.iter().all(|v| *v == 0.0));
        }
        let mut fine = vec![0.0; 36];
        let lost = splat_fine(&mut fine, 3, 2, [1.5, 0.0], 1.0);
        assert_abs(lost + fine.iter().sum::<f64>(), 1.0, 1e-14, "nothing is lost unseen");
        assert!(lost > 0.1);
    }
}
