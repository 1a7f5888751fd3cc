//! A polynomial over the stop: from node values to dense ones, and back.
//!
//! Functions are even or odd in x (the field lies on +y), so that dense points with `x > 0` stand for all; nodes give
//! coefficients by least squares, coefficients give values and derivatives. All of it is linear, the adjoint is the
//! transpose.

use glam::DVec2;
use ndarray::Array2;

use crate::math::least_squares::fit_operator;

/// What a [`Fit`] gives at the dense points.
#[derive(Clone, Copy, Debug)]
pub(super) enum Of {
    /// The value.
    Value = 0,
    /// The derivative over x of the unit stop.
    X = 1,
    /// The derivative over y.
    Y = 2,
}

/// Polynomials of one parity in x.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    /// Coefficients from node values, `[term, node]`.
    from_nodes: Array2<f64>,
    /// Node values from coefficients, `[node, term]`.
    at_nodes: Array2<f64>,
    /// Dense values and derivatives from coefficients, `[term, point]`.
    dense: [Array2<f64>; 3],
}

impl Fit {
    /// Polynomials `x^p y^q` of `degree` with `p` of `parity`, from `nodes` to `points`.
    pub(super) fn new(nodes: &[DVec2], points: &[DVec2], degree: usize, parity: usize) -> Self {
        let [at_nodes, ..] = basis(nodes, degree, parity);
        let dense = basis(points, degree, parity).map(|b| b.t().as_standard_layout().to_owned());
        Self { from_nodes: fit_operator(&at_nodes), at_nodes, dense }
    }

    /// Coefficients of the polynomial nearest to `nodes`.
    pub(super) fn coefficients(&self, nodes: &[f64]) -> Vec<f64> {
        self.from_nodes.rows().into_iter().map(|row| dot(row.as_slice().unwrap_or_default(), nodes)).collect()
    }

    /// Values or derivatives at the dense points.
    pub(super) fn dense(&self, of: Of, coefficients: &[f64]) -> Vec<f64> {
        let rows = &self.dense[of as usize];
        let count = rows.ncols();
        let mut out = vec![0.0; count];
        let all = rows.as_slice().unwrap_or_default();
        // Four terms at a time, so that the sums are loaded and stored a quarter as often.
        for (rows, c) in all.chunks(4 * count).zip(coefficients.chunks(4)) {
            if let [a, b, d, e] = *c {
                let (r0, rest) = rows.split_at(count);
                let (r1, rest) = rest.split_at(count);
                let (r2, r3) = rest.split_at(count);
                for ((((o, v0), v1), v2), v3) in out.iter_mut().zip(r0).zip(r1).zip(r2).zip(r3) {
                    *o += (a * v0 + b * v1) + (d * v2 + e * v3);
                }
            } else {
                for (row, c) in rows.chunks(count).zip(c) {
                    out.iter_mut().zip(row).for_each(|(o, v)| *o += c * v);
                }
            }
        }
        out
    }

    /// Adds a cotangent on dense values or derivatives to that of the coefficients.
    pub(super) fn pull(&self, of: Of, bar: &[f64], coefficients_bar: &mut [f64]) {
        let rows = self.dense[of as usize].rows();
        for (c, row) in coefficients_bar.iter_mut().zip(rows) {
            *c += dot(row.as_slice().unwrap_or_default(), bar);
        }
    }

    /// Pulls a cotangent on the coefficients back to the nodes.
    pub(super) fn coefficients_vjp(&self, coefficients_bar: &[f64]) -> Vec<f64> {
        let mut nodes = vec![0.0; self.from_nodes.ncols()];
        for (row, c) in self.from_nodes.rows().into_iter().zip(coefficients_bar) {
            nodes.iter_mut().zip(row).for_each(|(n, v)| *n += c * v);
        }
        nodes
    }

    /// A zero cotangent on the coefficients.
    pub(super) fn no_bar(&self) -> Vec<f64> {
        vec![0.0; self.from_nodes.nrows()]
    }

    /// Largest distance of the polynomial from what it was fitted to.
    pub(super) fn residual(&self, coefficients: &[f64], nodes: &[f64]) -> f64 {
        let fitted = self.at_nodes.rows().into_iter().map(|row| dot(row.as_slice().unwrap_or_default(), coefficients));
        fitted.zip(nodes).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }
}

/// `Σ a b`, eight partial sums in a fixed order.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (mut a, mut b) = (a.chunks_exact(8), b.chunks_exact(8));
    for (x, y) in a.by_ref().zip(b.by_ref()) {
        for (s, (x, y)) in sums.iter_mut().zip(x.iter().zip(y)) {
            *s += x * y;
        }
    }
    let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(x, y)| x * y).sum();
    sums.iter().sum::<f64>() + rest
}

/// Values and derivatives of the basis `x^p y^q` in Chebyshev form with `p` of the given parity, `p + q ≤ degree`.
fn basis(points: &[DVec2], degree: usize, parity: usize) -> [Array2<f64>; 3] {
    let terms: Vec<(usize, usize)> =
        (parity..=degree).step_by(2).flat_map(|p| (0..=degree - p).map(move |q| (p, q))).collect();
    let shape = (points.len(), terms.len());
    let mut out = [Array2::zeros(shape), Array2::zeros(shape), Array2::zeros(shape)];
    for (i, s) in points.iter().enumerate() {
        let (tx, dx) = chebyshev(s.x, degree);
        let (ty, dy) = chebyshev(s.y, degree);
        for (j, (p, q)) in terms.iter().enumerate() {
            out[0][[i, j]] = tx[*p] * ty[*q];
            out[1][[i, j]] = dx[*p] * ty[*q];
            out[2][[i, j]] = tx[*p] * dy[*q];
        }
    }
    out
}

/// `T_0..T_degree` at `x` and their derivatives.
fn chebyshev(x: f64, degree: usize) -> (Vec<f64>, Vec<f64>) {
    let (mut t, mut d) = (vec![1.0, x], vec![0.0, 1.0]);
    for n in 1..degree.max(1) {
        t.push(2.0 * x * t[n] - t[n - 1]);
        d.push(2.0 * t[n] + 2.0 * x * d[n] - d[n - 1]);
    }
    (t, d)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::assert_rel;

    /// A polynomial of the degree comes back exactly, with its derivatives; the pull-back is the transpose.
    #[test]
    fn polynomials_of_the_degree_are_exact_and_the_pull_back_is_the_transpose() {
        let rng = &mut fastrand::Rng::with_seed(4);
        let nodes: Vec<DVec2> = (0..40).map(|_| DVec2::new(rng.f64(), 2.0 * rng.f64() - 1.0)).collect();
        let points: Vec<DVec2> = (0..37).map(|_| DVec2::new(rng.f64(), 2.0 * rng.f64() - 1.0)).collect();
        let f = |s: DVec2| s.x * (1.0 + 2.0 * s.y * s.y - s.x * s.x * s.y);
        let (fx, fy) =
            (|s: DVec2| 1.0 + 2.0 * s.y * s.y - 3.0 * s.x * s.x * s.y, |s: DVec2| s.x * (4.0 * s.y - s.x * s.x));
        let fit = Fit::new(&nodes, &points, 5, 1);
        let values: Vec<f64> = nodes.iter().map(|s| f(*s)).collect();
        let c = fit.coefficients(&values);
        assert!(fit.residual(&c, &values) < 1e-13);
        let exact: [&dyn Fn(DVec2) -> f64; 3] = [&f, &fx, &fy];
        for (of, exact) in [Of::Value, Of::X, Of::Y].into_iter().zip(exact) {
            let dense = fit.dense(of, &c);
            dense.iter().zip(&points).for_each(|(v, s)| assert_rel(*v, exact(*s), 1e-11, 1.0, "dense"));
            let bar: Vec<f64> = points.iter().map(|_| rng.f64() - 0.5).collect();
            let mut c_bar = fit.no_bar();
            fit.pull(of, &bar, &mut c_bar);
            let pulled: f64 = fit.coefficients_vjp(&c_bar).iter().zip(&values).map(|(a, b)| a * b).sum();
            let forward: f64 = dense.iter().zip(&bar).map(|(a, b)| a * b).sum();
            assert_rel(pulled, forward, 1e-12, 1.0, "transpose");
        }
    }
}
