//! Polynomials over the stop: from values at nodes to coefficients, from coefficients to values, and back.
//!
//! Functions are even or odd in x (the sensor point lies on +y), so that points with `x > 0` stand for all; nodes give
//! coefficients by least squares, coefficients give values and derivatives. All of it is linear, the adjoint is the
//! transpose. The basis is `T_p(x) T_q(y)` with `p` of the function's parity and `p + q ≤ degree`.

use glam::DVec2;
use ndarray::Array2;

use isoplanat_base::math::least_squares::fit_operator;
use isoplanat_base::math::wide::{Work, wide};

/// Parity in x of a function over the stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parity {
    /// Even in x.
    Even = 0,
    /// Odd in x.
    Odd = 1,
}

/// Value or derivative of a function over the stop.
#[derive(Clone, Copy, Debug)]
pub enum Of {
    /// The value.
    Value = 0,
    /// The derivative over x of the unit stop.
    X = 1,
    /// The derivative over y.
    Y = 2,
}

/// Exponents `(p, q)` of the terms of one parity.
pub(super) fn terms(degree: usize, parity: Parity) -> Vec<(usize, usize)> {
    (parity as usize..=degree).step_by(2).flat_map(|p| (0..=degree - p).map(move |q| (p, q))).collect()
}

/// From values at nodes to the coefficients that fit them best, `[term, node]`; the transpose is the adjoint.
pub(super) fn from_nodes(nodes: &[DVec2], degree: usize, parity: Parity) -> Array2<f64> {
    let [at_nodes, ..] = basis(nodes, degree, parity);
    fit_operator(&at_nodes.t().to_owned())
}

/// `M v`.
pub(super) fn apply(matrix: &Array2<f64>, v: &[f64]) -> Vec<f64> {
    matrix.rows().into_iter().map(|row| dot(row.as_slice().unwrap_or_default(), v)).collect()
}

/// `Mᵀ v`.
pub(super) fn apply_transposed(matrix: &Array2<f64>, v: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; matrix.ncols()];
    add_transposed(matrix, v, &mut out);
    out
}

/// Adds `Mᵀ v`.
pub(super) fn add_transposed(matrix: &Array2<f64>, v: &[f64], out: &mut [f64]) {
    wide(AddTransposed { all: matrix.as_slice().unwrap_or_default(), v, out });
}

/// `out += Mᵀ v`, four rows at a time, so that the sums are loaded and stored a quarter as often.
struct AddTransposed<'a> {
    all: &'a [f64],
    v: &'a [f64],
    out: &'a mut [f64],
}

impl Work for AddTransposed<'_> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let Self { all, v, out } = self;
        let count = out.len();
        for (rows, c) in all.chunks(4 * count.max(1)).zip(v.chunks(4)) {
            if let [a, b, d, e] = *c {
                let (r0, rest) = rows.split_at(count);
                let (r1, rest) = rest.split_at(count);
                let (r2, r3) = rest.split_at(count);
                for ((((o, v0), v1), v2), v3) in out.iter_mut().zip(r0).zip(r1).zip(r2).zip(r3) {
                    *o += (a * v0 + b * v1) + (d * v2 + e * v3);
                }
            } else {
                for (row, c) in rows.chunks(count.max(1)).zip(c) {
                    out.iter_mut().zip(row).for_each(|(o, v)| *o += c * v);
                }
            }
        }
    }
}

/// Values and derivatives of the functions of one parity at fixed points.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// `[term, point]` of the value and both derivatives.
    rows: [Array2<f64>; 3],
    /// Largest absolute derivatives of every term over the points.
    steepest: [Vec<f64>; 2],
}

impl Evaluation {
    /// At `points` of the unit stop.
    pub fn new(points: &[DVec2], degree: usize, parity: Parity) -> Self {
        let rows = basis(points, degree, parity);
        let largest = |rows: &Array2<f64>| -> Vec<f64> {
            rows.rows().into_iter().map(|row| row.iter().fold(0.0, |m: f64, v| m.max(v.abs()))).collect()
        };
        let steepest = [largest(&rows[1]), largest(&rows[2])];
        Self { rows, steepest }
    }

    /// Values of the terms, `[term, point]`.
    pub(super) fn values(&self) -> &Array2<f64> {
        &self.rows[0]
    }

    /// Values or derivatives at the points.
    pub fn at(&self, of: Of, coefficients: &[f64]) -> Vec<f64> {
        apply_transposed(&self.rows[of as usize], coefficients)
    }

    /// A bound on the length of the gradient at every point.
    pub(crate) fn steepest(&self, coefficients: &[f64]) -> f64 {
        let along = |terms: &[f64]| terms.iter().zip(coefficients).map(|(t, c)| t * c.abs()).sum::<f64>();
        along(&self.steepest[0]).hypot(along(&self.steepest[1]))
    }

    /// Adds a cotangent on values or derivatives to that of the coefficients.
    pub(crate) fn pull(&self, of: Of, bar: &[f64], coefficients_bar: &mut [f64]) {
        for (c, row) in coefficients_bar.iter_mut().zip(self.rows[of as usize].rows()) {
            *c += dot(row.as_slice().unwrap_or_default(), bar);
        }
    }
}

/// `Σ a b`, eight partial sums in a fixed order.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    wide(Dot(a, b))
}

struct Dot<'a>(&'a [f64], &'a [f64]);

impl Work for Dot<'_> {
    type Output = f64;
    #[inline(always)]
    fn run(self) -> f64 {
        let mut sums = [0.0; 8];
        let (mut a, mut b) = (self.0.chunks_exact(8), self.1.chunks_exact(8));
        for (x, y) in a.by_ref().zip(b.by_ref()) {
            for (s, (x, y)) in sums.iter_mut().zip(x.iter().zip(y)) {
                *s += x * y;
            }
        }
        let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(x, y)| x * y).sum();
        sums.iter().sum::<f64>() + rest
    }
}

/// Values of the basis alone, `[term, point]`.
pub(super) fn values(points: &[DVec2], degree: usize, parity: Parity) -> Array2<f64> {
    let terms = terms(degree, parity);
    let [mut t, mut d] = [const { Vec::new() }; 2];
    let mut along = |of: fn(&DVec2) -> f64| {
        let mut all = Array2::zeros((degree.max(1) + 1, points.len()));
        for (mut column, s) in all.columns_mut().into_iter().zip(points) {
            chebyshev_into(of(s), degree, &mut t, &mut d);
            column.iter_mut().zip(&t).for_each(|(c, t)| *c = *t);
        }
        all
    };
    let [x, y] = [along(|s| s.x), along(|s| s.y)];
    let mut out = Array2::zeros((terms.len(), points.len()));
    for (mut row, (p, q)) in out.rows_mut().into_iter().zip(terms) {
        row.assign(&x.row(p));
        row *= &y.row(q);
    }
    out
}

/// Values and derivatives of the basis, `[term, point]`.
fn basis(points: &[DVec2], degree: usize, parity: Parity) -> [Array2<f64>; 3] {
    let terms = terms(degree, parity);
    let shape = (terms.len(), points.len());
    let mut out = [Array2::zeros(shape), Array2::zeros(shape), Array2::zeros(shape)];
    let [mut tx, mut dx, mut ty, mut dy] = [const { Vec::new() }; 4];
    for (i, s) in points.iter().enumerate() {
        chebyshev_into(s.x, degree, &mut tx, &mut dx);
        chebyshev_into(s.y, degree, &mut ty, &mut dy);
        for (j, (p, q)) in terms.iter().enumerate() {
            out[0][[j, i]] = tx[*p] * ty[*q];
            out[1][[j, i]] = dx[*p] * ty[*q];
            out[2][[j, i]] = tx[*p] * dy[*q];
        }
    }
    out
}

/// `T_0..T_degree` at `x` and their derivatives.
pub(super) fn chebyshev(x: f64, degree: usize) -> (Vec<f64>, Vec<f64>) {
    let (mut t, mut d) = (Vec::new(), Vec::new());
    chebyshev_into(x, degree, &mut t, &mut d);
    (t, d)
}

/// The same, in place of what `t` and `d` hold.
fn chebyshev_into(x: f64, degree: usize, t: &mut Vec<f64>, d: &mut Vec<f64>) {
    for (all, first) in [(&mut *t, [1.0, x]), (&mut *d, [0.0, 1.0])] {
        all.clear();
        all.reserve(degree + 2);
        all.extend(first);
    }
    for n in 1..degree.max(1) {
        t.push(2.0 * x * t[n] - t[n - 1]);
        d.push(2.0 * t[n] + 2.0 * x * d[n] - d[n - 1]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::assert_rel;

    /// A polynomial of the degree comes back exactly, with its derivatives; the pull-back is the transpose.
    #[test]
    fn polynomials_of_the_degree_are_exact_and_the_pull_back_is_the_transpose() {
        let rng = &mut fastrand::Rng::with_seed(4);
        let nodes: Vec<DVec2> = (0..40).map(|_| DVec2::new(rng.f64(), 2.0 * rng.f64() - 1.0)).collect();
        let points: Vec<DVec2> = (0..37).map(|_| DVec2::new(rng.f64(), 2.0 * rng.f64() - 1.0)).collect();
        let f = |s: DVec2| s.x * (1.0 + 2.0 * s.y * s.y - s.x * s.x * s.y);
        let (fx, fy) =
            (|s: DVec2| 1.0 + 2.0 * s.y * s.y - 3.0 * s.x * s.x * s.y, |s: DVec2| s.x * (4.0 * s.y - s.x * s.x));
        let fit = from_nodes(&nodes, 5, Parity::Odd);
        let values: Vec<f64> = nodes.iter().map(|s| f(*s)).collect();
        let c = apply(&fit, &values);
        let evaluation = Evaluation::new(&points, 5, Parity::Odd);
        let exact: [&dyn Fn(DVec2) -> f64; 3] = [&f, &fx, &fy];
        for (of, exact) in [Of::Value, Of::X, Of::Y].into_iter().zip(exact) {
            let dense = evaluation.at(of, &c);
            dense.iter().zip(&points).for_each(|(v, s)| assert_rel(*v, exact(*s), 1e-11, 1.0, "dense"));
            let bar: Vec<f64> = points.iter().map(|_| rng.f64() - 0.5).collect();
            let mut c_bar = vec![0.0; c.len()];
            evaluation.pull(of, &bar, &mut c_bar);
            let pulled = dot(&apply_transposed(&fit, &c_bar), &values);
            assert_rel(pulled, dot(&dense, &bar), 1e-12, 1.0, "transpose");
        }
    }
}
