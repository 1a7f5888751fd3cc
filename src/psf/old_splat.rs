//! Landings → kernel at the sensor's pitch.
//!
//! A landing is a delta. The pixel integrates over its aperture (a box one pitch wide) and the scene's samples carry
//! a bilinear reconstruction (a tent one pitch to either side); box ⊗ tent is the quadratic B-spline `β²`, so a ray
//! at `u` (pixels from the kernel's centre) adds `w β²(i − u_x) β²(j − u_y)` to pixel `(j, i)`. Exact for a scene
//! sampled at the pitch; smooth (C¹) in the landing, so that it can be differentiated.

/// Weights of `β²` on the three pixels around `u`, their derivatives with respect to `u`, and the first pixel.
#[inline]
fn spline(u: f64) -> (isize, [f64; 3], [f64; 3]) {
    let nearest = u.round();
    let t = u - nearest;
    let (a, b) = (0.5 - t, 0.5 + t);
    #[expect(clippy::cast_possible_truncation, reason = "bounded by the caller")]
    let first = nearest as isize - 1;
    (first, [0.5 * a * a, 0.75 - t * t, 0.5 * b * b], [-a, -2.0 * t, b])
}

/// [`spline`] for `u ≥ 0`, where the nearest pixel is the whole part of `u + 1/2`; at half a pixel, where `round` takes the
/// other neighbour, both have the same values.
#[inline]
fn inner(u: f64) -> (usize, [f64; 3], [f64; 3]) {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside the kernel")]
    let nearest = (u + 0.5) as i64 as usize;
    #[expect(clippy::cast_precision_loss, reason = "inside the kernel")]
    let t = u - nearest as i64 as f64;
    let (a, b) = (0.5 - t, 0.5 + t);
    (nearest.wrapping_sub(1), [0.5 * a * a, 0.75 - t * t, 0.5 * b * b], [-a, -2.0 * t, b])
}

/// Adds one ray of weight `w` at `u` pixels (column, row) from the centre of the `size × size` kernel; returns the
/// share that fell outside.
#[inline]
pub fn splat(kernel: &mut [f64], size: usize, u: [f64; 2], w: f64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "kernel sizes are small")]
    let half = (size / 2) as f64;
    if u[0].abs() < half - 1.0 && u[1].abs() < half - 1.0 {
        // All nine pixels are there.
        let (cx, wx, _) = inner(u[0] + half);
        let (cy, wy, _) = inner(u[1] + half);
        let from = cy * size + cx;
        for (dy, vy) in wy.iter().enumerate() {
            let v = w * vy;
            if let Some([a, b, c]) = kernel.get_mut(from + dy * size..from + dy * size + 3) {
                *a += v * wx[0];
                *b += v * wx[1];
                *c += v * wx[2];
            }
        }
        return 0.0;
    }
    let limit = half + 2.0;
    if !(u[0].abs() < limit && u[1].abs() < limit) {
        return w;
    }
    let (cx, wx, _) = spline(u[0] + half);
    let (cy, wy, _) = spline(u[1] + half);
    let mut inside = 0.0;
    for (dy, vy) in wy.iter().enumerate() {
        let Some(row) = place(cy, dy, size) else { continue };
        for (dx, vx) in wx.iter().enumerate() {
            let Some(col) = place(cx, dx, size) else { continue };
            let v = w * vx * vy;
            kernel[row * size + col] += v;
            inside += v;
        }
    }
    w - inside
}

/// Pulls a cotangent on the kernel back to one ray: `(u_bar, w_bar)`.
#[inline]
pub fn splat_vjp(kernel_bar: &[f64], size: usize, u: [f64; 2], w: f64) -> ([f64; 2], f64) {
    #[expect(clippy::cast_precision_loss, reason = "kernel sizes are small")]
    let half = (size / 2) as f64;
    if u[0].abs() < half - 1.0 && u[1].abs() < half - 1.0 {
        let (cx, wx, gx) = inner(u[0] + half);
        let (cy, wy, gy) = inner(u[1] + half);
        let from = cy * size + cx;
        let (mut u_bar, mut w_bar) = ([0.0; 2], 0.0);
        for dy in 0..3 {
            if let Some([a, b, c]) = kernel_bar.get(from + dy * size..from + dy * size + 3) {
                let value = wx[0] * a + wx[1] * b + wx[2] * c;
                u_bar[0] += (gx[0] * a + gx[1] * b + gx[2] * c) * wy[dy];
                u_bar[1] += value * gy[dy];
                w_bar += value * wy[dy];
            }
        }
        return ([w * u_bar[0], w * u_bar[1]], w_bar);
    }
    let limit = half + 2.0;
    if !(u[0].abs() < limit && u[1].abs() < limit) {
        return ([0.0; 2], 0.0);
    }
    let (cx, wx, gx) = spline(u[0] + half);
    let (cy, wy, gy) = spline(u[1] + half);
    let (mut u_bar, mut w_bar) = ([0.0; 2], 0.0);
    for dy in 0..3 {
        let Some(row) = place(cy, dy, size) else { continue };
        for dx in 0..3 {
            let Some(col) = place(cx, dx, size) else { continue };
            let bar = kernel_bar[row * size + col];
            u_bar[0] += w * bar * gx[dx] * wy[dy];
            u_bar[1] += w * bar * wx[dx] * gy[dy];
            w_bar += bar * wx[dx] * wy[dy];
        }
    }
    (u_bar, w_bar)
}

#[inline]
fn place(first: isize, d: usize, size: usize) -> Option<usize> {
    usize::try_from(first + d.cast_signed()).ok().filter(|i| *i < size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_abs, assert_rel, central_difference};

    /// β² against a brute-force box ⊗ tent, total one inside, and the pull-back.
    #[test]
    fn the_spline_is_box_on_tent_and_its_vjp_is_exact() {
        let rng = &mut fastrand::Rng::with_seed(5);
        for _ in 0..50 {
            let u = [rng.f64() * 6.0 - 3.0, rng.f64() * 6.0 - 3.0];
            let mut k = vec![0.0; 81];
            assert_abs(splat(&mut k, 9, u, 2.0), 0.0, 1e-14, "outside");
            assert_abs(k.iter().sum(), 2.0, 1e-14, "energy");
            let brute = |i: f64, u: f64| {
                let n = 2000;
                let at = |k: i32| (1.0 - ((i - 0.5 + (f64::from(k) + 0.5) / f64::from(n)) - u).abs()).max(0.0);
                (0..n).map(at).sum::<f64>() / f64::from(n)
            };
            assert_abs(k[4 * 9 + 4], 2.0 * brute(0.0, u[0]) * brute(0.0, u[1]), 1e-6, "centre");
            let bar: Vec<f64> = (0..81).map(|_| rng.f64() - 0.5).collect();
            let (u_bar, w_bar) = splat_vjp(&bar, 9, u, 2.0);
            let f = |x: f64, y: f64, w: f64| {
                let mut k = vec![0.0; 81];
                splat(&mut k, 9, [x, y], w);
                k.iter().zip(&bar).map(|(a, b)| a * b).sum::<f64>()
            };
            assert_rel(u_bar[0], central_difference(|h| f(u[0] + h, u[1], 2.0), 1e-6), 1e-6, 1e-2, "∂u_x");
            assert_rel(u_bar[1], central_difference(|h| f(u[0], u[1] + h, 2.0), 1e-6), 1e-6, 1e-2, "∂u_y");
            assert_rel(w_bar, f(u[0], u[1], 3.0) - f(u[0], u[1], 2.0), 1e-9, 1e-2, "∂w");
        }
    }
}
