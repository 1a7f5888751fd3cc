//! Smooth functions of two variables as Chebyshev series over the square −1 to 1, by least squares.
//!
//! The columns stand in the order of their total degree, so that one factorisation `QR` serves every lower degree: a function gets
//! the least degree that leaves less than a given residual.

use glam::DVec2;
use nalgebra::{DMatrix, DVector, Dyn, QR};

/// `T_0 … T_degree` at `x`.
pub(super) fn chebyshev(x: f64, degree: usize, out: &mut Vec<f64>) {
    out.clear();
    out.push(1.0);
    if degree > 0 {
        out.push(x);
    }
    for n in 2..=degree {
        out.push(2.0 * x * out[n - 1] - out[n - 2]);
    }
}

/// Terms `T_p(ξ) T_q(η)`, `p + q ≤ degree`, in the order of `p + q`.
fn terms(degree: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..=degree).flat_map(|d| (0..=d).map(move |p| (p, d - p)))
}

/// Number of terms up to a degree.
pub(super) const fn count(degree: usize) -> usize {
    (degree + 1) * (degree + 2) / 2
}

/// A factorised set of points.
pub(super) struct Fitter {
    qr: QR<f64, Dyn, Dyn>,
    r: DMatrix<f64>,
    degree: usize,
    rows: usize,
}

/// A series in both variables: `[p]` is the series in `η` that multiplies `T_p(ξ)`.
#[derive(Clone, Debug)]
pub(super) struct Surface {
    by_power: Vec<Vec<f64>>,
}

impl Fitter {
    /// For values at `points` of the square; the degree falls where the points do not tell its terms apart.
    pub(super) fn new(points: &[DVec2], degree: usize) -> Self {
        let mut degree = degree;
        while degree > 0 && count(degree) > points.len() {
            degree -= 1;
        }
        let (mut at_x, mut at_y) = (Vec::new(), Vec::new());
        let mut matrix = DMatrix::zeros(points.len(), count(degree));
        for (i, point) in points.iter().enumerate() {
            chebyshev(point.x, degree, &mut at_x);
            chebyshev(point.y, degree, &mut at_y);
            for (j, (p, q)) in terms(degree).enumerate() {
                matrix[(i, j)] = at_x[p] * at_y[q];
            }
        }
        let qr = matrix.qr();
        let r = qr.r();
        let least = 1e-9 * r[(0, 0)].abs();
        while degree > 0 && (0..count(degree)).any(|j| r[(j, j)].abs() <= least) {
            degree -= 1;
        }
        Self { qr, r, degree, rows: points.len() }
    }

    /// The series of least degree whose root mean square residual is at most `tolerance`, or the best, and its residual.
    pub(super) fn fit(&self, values: &[f64], tolerance: f64) -> (Surface, f64) {
        let mut turned = DVector::from_column_slice(values);
        self.qr.q_tr_mul(&mut turned);
        let residual = |degree: usize| {
            let free = (self.rows - count(degree)).max(1);
            #[expect(clippy::cast_precision_loss, reason = "small counts")]
            let free = free as f64;
            (turned.rows_range(count(degree)..).norm_squared() / free).sqrt()
        };
        let degree = (0..=self.degree).find(|d| residual(*d) <= tolerance).unwrap_or(self.degree);
        let size = count(degree);
        let solved = self.r.view((0, 0), (size, size)).solve_upper_triangular(&turned.rows(0, size));
        let mut by_power: Vec<Vec<f64>> = (0..=degree).map(|p| vec![0.0; degree - p + 1]).collect();
        if let Some(c) = solved {
            terms(degree).zip(c.iter()).for_each(|((p, q), c)| by_power[p][q] = *c);
        }
        (Surface { by_power }, residual(degree))
    }
}

impl Surface {
    /// The series in `ξ` along the line of constant `η`, whose `T_q` are `at_eta`.
    pub(super) fn along(&self, at_eta: &[f64], out: &mut Vec<f64>) {
        out.clear();
        out.extend(self.by_power.iter().map(|c| c.iter().zip(at_eta).map(|(c, t)| c * t).sum::<f64>()));
    }

    /// Degree of the series.
    pub(super) fn degree(&self) -> usize {
        self.by_power.len() - 1
    }
}

/// Value of a Chebyshev series, by Clenshaw's recurrence.
#[inline]
pub(super) fn value(c: &[f64], x: f64) -> f64 {
    let (mut b1, mut b2) = (0.0, 0.0);
    let twice = 2.0 * x;
    for c in c[1..].iter().rev() {
        (b2, b1) = (b1, c + twice * b1 - b2);
    }
    c[0] + x * b1 - b2
}

/// Value and derivative.
pub(super) fn slope(c: &[f64], x: f64) -> (f64, f64) {
    let (mut b1, mut b2, mut d1, mut d2) = (0.0, 0.0, 0.0, 0.0);
    for c in c[1..].iter().rev() {
        (d2, d1) = (d1, 2.0 * b1 + 2.0 * x * d1 - d2);
        (b2, b1) = (b1, c + 2.0 * x * b1 - b2);
    }
    (c[0] + x * b1 - b2, b1 + x * d1 - d2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_abs, between};

    /// A polynomial comes back at its own degree; another function to its residual; derivatives against differences.
    #[test]
    fn polynomials_come_back() {
        let rng = &mut fastrand::Rng::with_seed(3);
        let points: Vec<DVec2> =
            (0..300).map(|_| DVec2::new(between(rng, -1.0, 1.0), between(rng, -1.0, 1.0))).collect();
        let fitter = Fitter::new(&points, 12);
        let f = |p: &DVec2| 0.3 + p.x * p.y * p.y - 2.0 * p.x.powi(5) * p.y + 0.1 * p.y.powi(6);
        let values: Vec<f64> = points.iter().map(f).collect();
        let (surface, residual) = fitter.fit(&values, 1e-12);
        assert!(residual < 1e-12 && surface.degree() == 6, "{residual} {}", surface.degree());
        let (mut at, mut line) = (Vec::new(), Vec::new());
        chebyshev(0.37, surface.degree(), &mut at);
        surface.along(&at, &mut line);
        for x in [-0.9, 0.0, 0.61] {
            assert_abs(value(&line, x), f(&DVec2::new(x, 0.37)), 1e-12, "value");
            let (v, d) = slope(&line, x);
            assert_abs(v, value(&line, x), 1e-15, "the same value");
            let h = 1e-5;
            assert_abs(d, (value(&line, x + h) - value(&line, x - h)) / (2.0 * h), 1e-8, "slope");
        }
        let wave: Vec<f64> = points.iter().map(|p| (3.0 * p.x + p.y).sin()).collect();
        let (best, residual) = fitter.fit(&wave, 1e-12);
        assert!(residual > 1e-12 && residual < 1e-4 && best.degree() == 12, "{residual}");
    }

    /// Points on a line tell no degree across it.
    #[test]
    fn points_that_do_not_tell_terms_apart_lower_the_degree() {
        let points: Vec<DVec2> = (0..40).map(|i| DVec2::new(f64::from(i) / 20.0 - 1.0, 0.0)).collect();
        assert_eq!(Fitter::new(&points, 5).degree, 0);
    }
}
