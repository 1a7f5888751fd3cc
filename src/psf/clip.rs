//! The soft edge of a clear aperture over the dense points of the stop, with adjoint.
//!
//! `t = (R − r)/(|∇_s r| w)` is the distance of a ray from the aperture's edge as seen in the stop, in units of the
//! edge's width `w`: `r` is the ray's height at the aperture, `s` its place in the unit stop. A C² ramp over
//! `−1/2 < t < 1/2`, symmetric about the hard edge, is the ray's share of light. With `w` 1.5 spacings of the dense points
//! (four fifths of the rise within one spacing) the error of a cut beam's area is least: a narrower edge counts points, a
//! wider one blunts the edge. The width is the same wherever the aperture stands and however small the beam is there.

use super::old_fit::{Fit, Of};
use super::pupil::PupilSampling;

/// Width of the edge in spacings of the dense points.
const WIDTH: f64 = 1.5;

/// One aperture that clips: heights of the dense rays of the half `x > 0`, and their derivatives over the unit stop.
#[derive(Clone, Debug)]
pub(super) struct Clip {
    /// The aperture's surface.
    pub(super) surface: usize,
    radius: f64,
    width: f64,
    x: Vec<f64>,
    y: Vec<f64>,
    /// `∂x/∂s_x, ∂x/∂s_y, ∂y/∂s_x, ∂y/∂s_y`.
    jacobian: [Vec<f64>; 4],
}

/// Derivatives of one ray's share.
#[derive(Clone, Copy, Debug)]
struct ShareSlope {
    radius: f64,
    x: f64,
    y: f64,
    jacobian: [f64; 4],
}

/// Cotangents of the heights at the nodes.
pub(super) struct ClipBar {
    pub(super) x: Vec<f64>,
    pub(super) y: Vec<f64>,
}

/// C² ramp from 0 to 1 over `−1/2..1/2`, and its derivative.
fn ramp(t: f64) -> (f64, f64) {
    if t <= -0.5 {
        return (0.0, 0.0);
    }
    if t >= 0.5 {
        return (1.0, 0.0);
    }
    let s = t + 0.5;
    (s * s * s * (10.0 + s * (6.0 * s - 15.0)), 30.0 * s * s * (1.0 - s) * (1.0 - s))
}

impl Clip {
    /// The aperture of semi-diameter `radius` on `surface`, from the heights `x`, `y` of the node rays there; `None` if
    /// it takes nothing of any ray.
    pub(super) fn new(sampling: &PupilSampling, surface: usize, radius: f64, x: &[f64], y: &[f64]) -> Option<Self> {
        // No dense ray is near the edge where no node is within a few spacings of it, counted in the beam's own size.
        let farthest = x.iter().zip(y).map(|(a, b)| a.hypot(*b)).fold(0.0, f64::max);
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let middle = y.iter().sum::<f64>() / y.len() as f64;
        let size = x.iter().zip(y).map(|(a, b)| a.hypot(b - middle)).fold(0.0, f64::max);
        if farthest < radius - 3.0 * size * WIDTH * sampling.spacing {
            return None;
        }
        let (odd, even) = (&sampling.odd, &sampling.even);
        let (cx, cy) = (odd.coefficients(x), even.coefficients(y));
        let (x, y) = (odd.dense(Of::Value, &cx), even.dense(Of::Value, &cy));
        let jacobian = [odd.dense(Of::X, &cx), odd.dense(Of::Y, &cx), even.dense(Of::X, &cy), even.dense(Of::Y, &cy)];
        let clip = Self { surface, radius, width: WIDTH * sampling.spacing, x, y, jacobian };
        (0..clip.x.len()).any(|q| clip.share(q) < 1.0).then_some(clip)
    }

    /// Height, its gradient over the unit stop, and `t`; `None` where the edge has no width (a ray on the axis, a fold).
    fn edge(&self, q: usize) -> Option<(f64, [f64; 2], f64, f64)> {
        let (x, y) = (self.x[q], self.y[q]);
        let r = x.hypot(y);
        let j = [0, 1, 2, 3].map(|k: usize| self.jacobian[k][q]);
        let gradient = [(x * j[0] + y * j[2]) / r, (x * j[1] + y * j[3]) / r];
        let size = gradient[0].hypot(gradient[1]);
        let t = (self.radius - r) / (size * self.width);
        t.is_finite().then_some((r, gradient, size, t))
    }

    /// Share of light of dense ray `q`, 0 to 1; those of the mirrored half follow on those of the half.
    pub(super) fn share(&self, q: usize) -> f64 {
        let q = if q < self.x.len() { q } else { q - self.x.len() };
        let hard = || f64::from(u8::from(self.x[q].hypot(self.y[q]) <= self.radius));
        self.edge(q).map_or_else(hard, |(.., t)| ramp(t).0)
    }

    /// Derivatives of [`Self::share`]; `None` where it is flat.
    fn share_slope(&self, q: usize) -> Option<ShareSlope> {
        let (r, [g0, g1], size, t) = self.edge(q)?;
        let slope = ramp(t).1;
        if slope == 0.0 {
            return None;
        }
        let (x, y) = (self.x[q], self.y[q]);
        let [a, b, c, d] = [0, 1, 2, 3].map(|k: usize| self.jacobian[k][q]);
        let (u, v) = (g0 / size, g1 / size);
        let by_r = -slope / (size * self.width);
        let by_size = -slope * t / size;
        Some(ShareSlope {
            radius: -by_r,
            x: by_r * x / r + by_size * ((u * a + v * b) / r - size * x / (r * r)),
            y: by_r * y / r + by_size * ((u * c + v * d) / r - size * y / (r * r)),
            jacobian: [u * x, v * x, u * y, v * y].map(|w| by_size * w / r),
        })
    }

    /// Pulls cotangents on the shares (of the half, or of both halves) back to the heights at the nodes; returns that
    /// of the semi-diameter as well.
    pub(super) fn share_vjp(&self, sampling: &PupilSampling, share_bar: &[f64]) -> (ClipBar, f64) {
        let mut radius = 0.0;
        let half = self.x.len();
        let mut bars: [Vec<f64>; 6] = std::array::from_fn(|_| vec![0.0; half]);
        for (q, bar) in share_bar.iter().enumerate() {
            if *bar == 0.0 {
                continue;
            }
            let q = if q < half { q } else { q - half };
            if let Some(s) = self.share_slope(q) {
                radius += bar * s.radius;
                let all = [s.x, s.y, s.jacobian[0], s.jacobian[1], s.jacobian[2], s.jacobian[3]];
                all.iter().zip(&mut bars).for_each(|(by, column)| column[q] += bar * by);
            }
        }
        let back = |fit: &Fit, [value, first, second]: [&[f64]; 3]| {
            let mut sum = fit.no_bar();
            fit.pull(Of::Value, value, &mut sum);
            fit.pull(Of::X, first, &mut sum);
            fit.pull(Of::Y, second, &mut sum);
            fit.coefficients_vjp(&sum)
        };
        let x = back(&sampling.odd, [&bars[0], &bars[2], &bars[3]]);
        let y = back(&sampling.even, [&bars[1], &bars[4], &bars[5]]);
        (ClipBar { x, y }, radius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_rel, central_difference};

    /// The share of a round beam beside an aperture: half on the edge, one width from none to all.
    #[test]
    fn the_edge_has_its_width_in_the_stop() {
        let sampling = PupilSampling::new(7, 400);
        // A beam of radius 2 about (0, 5): x = 2 s_x, y = 5 + 2 s_y.
        let (x, y): (Vec<f64>, Vec<f64>) = sampling.nodes.iter().map(|s| (2.0 * s.x, 5.0 + 2.0 * s.y)).unzip();
        let clip = Clip::new(&sampling, 3, 5.0, &x, &y).expect("clips");
        for (q, s) in sampling.points.iter().enumerate() {
            let distance = 2.5 - (s.x).hypot(2.5 + s.y);
            assert_rel(clip.share(q), ramp(distance / (WIDTH * sampling.spacing)).0, 1e-9, 1.0, "share");
        }
        assert!(Clip::new(&sampling, 3, 7.0 + 3.0 * sampling.spacing, &x, &y).is_none());
    }

    #[test]
    fn share_vjp_agrees_with_differences() {
        let sampling = PupilSampling::new(7, 200);
        let rng = &mut fastrand::Rng::with_seed(3);
        let wave = |s: glam::DVec2| 0.3 * s.y * s.y - 0.2 * s.y * s.x * s.x;
        let nodes: Vec<(f64, f64)> =
            sampling.nodes.iter().map(|s| (2.0 * s.x * (1.0 + 0.1 * s.y), 4.0 + 2.0 * s.y + wave(*s))).collect();
        let dots: Vec<(f64, f64)> = nodes.iter().map(|_| (rng.f64() - 0.5, rng.f64() - 0.5)).collect();
        let bar: Vec<f64> = sampling.points.iter().map(|_| rng.f64() - 0.5).collect();
        let at = |h: f64| {
            let x: Vec<f64> = nodes.iter().zip(&dots).map(|(n, d)| n.0 + h * d.0).collect();
            let y: Vec<f64> = nodes.iter().zip(&dots).map(|(n, d)| n.1 + h * d.1).collect();
            Clip::new(&sampling, 0, 4.3 + 0.7 * h, &x, &y).expect("clips")
        };
        let (back, radius) = at(0.0).share_vjp(&sampling, &bar);
        let pulled = 0.7 * radius
            + back.x.iter().zip(&dots).map(|(b, d)| b * d.0).sum::<f64>()
            + back.y.iter().zip(&dots).map(|(b, d)| b * d.1).sum::<f64>();
        let f = |h: f64| {
            let clip = at(h);
            bar.iter().enumerate().map(|(q, b)| b * clip.share(q)).sum::<f64>()
        };
        assert_rel(pulled, central_difference(f, 1e-5), 1e-7, 0.1, "share");
    }
}
