//! Functions over the pupil as polynomials of its coordinates `τ`, through the values that rays have there, and the pull-back to values and coordinates.
//!
//! A function even or odd across the meridian is known at nodes `τ_j` of the half `τ_x ≥ 0`; coefficients fit it by least squares. Nodes move with the lens: a
//! coefficient's cotangent goes to the values by the transpose of the fit, and to the nodes' places by the slope of the polynomial there (and by what the fit left over).

use glam::DVec2;
use nalgebra::{Cholesky, DMatrix, DVector};
use ndarray::Array2;

use super::super::fit::{self, Evaluation, Of, Parity};

/// Degrees from which the normal equations are factored twice: products of Chebyshev polynomials differ by little within a disk, from degree 22 on by less than rounding leaves of
/// squares, and one factor could not be had at some places, by chance.
const TWICE: usize = 15;
/// What the first of two factors has more on its diagonal, of the largest.
const DAMPING: f64 = 1e-14;

/// Functions of one parity.
#[derive(Clone, Debug)]
pub(super) struct Half {
    at_nodes: Evaluation,
    /// Lower factor of the normal equations.
    factor: DMatrix<f64>,
    /// Whether it was made of two, and fits are made twice.
    twice: bool,
    /// Values at the nodes.
    values: Vec<Vec<f64>>,
    /// Coefficients.
    pub(super) coefficients: Vec<Vec<f64>>,
}

/// Cotangents, in the form of [`Fitted`]: `[even, odd][function][coefficient]`, or node for node.
pub(super) type Bars = [Vec<Vec<f64>>; 2];

/// Functions over the pupil.
#[derive(Clone, Debug)]
pub(super) struct Fitted {
    pub(super) degree: usize,
    /// Middle of the nodes and half the sides of the box around them and their mirror images.
    pub(super) middle: DVec2,
    pub(super) half: DVec2,
    /// Of each parity.
    pub(super) halves: [Half; 2],
}

/// Lower factor `L` of `A Aᵀ = L Lᵀ` for the terms `A` at the nodes; nothing where the nodes do not tell the polynomials apart.
fn factor(all: &Array2<f64>, degree: usize) -> Option<DMatrix<f64>> {
    let matrix = |of: &Array2<f64>| DMatrix::from_fn(of.nrows(), of.ncols(), |i, j| of[[i, j]]);
    let squares = all.dot(&all.t());
    if degree < TWICE {
        return Some(Cholesky::new(matrix(&squares))?.unpack());
    }
    // A factor of somewhat more than the squares makes terms that are nearly orthogonal, and theirs is had without loss.
    let damping = DAMPING * squares.diag().iter().copied().fold(0.0, f64::max);
    let first = Cholesky::new(matrix(&(squares + Array2::<f64>::eye(all.nrows()) * damping)))?.unpack();
    let mut terms = matrix(all);
    let second = first.solve_lower_triangular_mut(&mut terms).then(|| Cholesky::new(&terms * terms.transpose()))??;
    Some(first * second.unpack())
}

fn less(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

impl Half {
    /// Nothing where the nodes do not tell the polynomials apart.
    fn new(nodes: &[DVec2], degree: usize, parity: Parity, values: Vec<Vec<f64>>) -> Option<Self> {
        let at_nodes = Evaluation::new(nodes, degree, parity);
        let factor = factor(at_nodes.values(), degree)?;
        let twice = degree >= TWICE;
        let mut half = Self { at_nodes, factor, twice, values: Vec::new(), coefficients: Vec::new() };
        half.coefficients = values.iter().map(|v| half.fit(v)).collect();
        half.values = values;
        Some(half)
    }

    fn solved(&self, right: Vec<f64>) -> Vec<f64> {
        let mut right = DVector::from_vec(right);
        let done =
            self.factor.solve_lower_triangular_mut(&mut right) && self.factor.tr_solve_lower_triangular_mut(&mut right);
        if done { right.data.into() } else { vec![f64::NAN; right.len()] }
    }

    /// The coefficients that fit values at the nodes best.
    fn fit(&self, values: &[f64]) -> Vec<f64> {
        let first = self.fit_once(values);
        if !self.twice {
            return first;
        }
        // What the equations' rounding left over is fitted once more.
        let left = less(values, &self.at_nodes.at(Of::Value, &first));
        first.iter().zip(self.fit_once(&left)).map(|(a, b)| a + b).collect()
    }

    /// The transpose of [`Self::fit`].
    fn fit_vjp(&self, coefficients_bar: &[f64]) -> Vec<f64> {
        let first = self.at_nodes.at(Of::Value, &self.solved(coefficients_bar.to_vec()));
        if !self.twice {
            return first;
        }
        let again = self.at_nodes.at(Of::Value, &self.fit_once(&first));
        first.iter().zip(less(&first, &again)).map(|(a, b)| a + b).collect()
    }

    fn fit_once(&self, values: &[f64]) -> Vec<f64> {
        let mut right = vec![0.0; self.factor.nrows()];
        self.at_nodes.pull(Of::Value, values, &mut right);
        self.solved(right)
    }

    /// Values at the nodes of the functions from `first` on.
    pub(super) fn values(&self, first: usize) -> &[Vec<f64>] {
        &self.values[first.min(self.values.len())..]
    }

    /// Values of function `k` at the nodes less the polynomial's.
    fn left(&self, k: usize) -> Vec<f64> {
        less(&self.values[k], &self.at_nodes.at(Of::Value, &self.coefficients[k]))
    }

    /// Pulls cotangents on the coefficients back to the values (returned) and to the nodes (added).
    fn vjp(&self, bars: &[Vec<f64>], nodes: &mut [DVec2]) -> Vec<Vec<f64>> {
        let one = |(k, bar): (usize, &Vec<f64>)| {
            let values = self.fit_vjp(bar);
            if bar.iter().all(|b| *b == 0.0) {
                return values;
            }
            let (left, turned) = (self.left(k), self.fit(&values));
            for (axis, of) in [(DVec2::X, Of::X), (DVec2::Y, Of::Y)] {
                let (slopes, turned) = (self.at_nodes.at(of, &self.coefficients[k]), self.at_nodes.at(of, &turned));
                for (j, node) in nodes.iter_mut().enumerate() {
                    *node += axis * (left[j] * turned[j] - values[j] * slopes[j]);
                }
            }
            values
        };
        bars.iter().enumerate().map(one).collect()
    }
}

impl Fitted {
    /// Through the values `[even, odd][function][node]` at `nodes`; nothing where they span no area.
    pub(super) fn new(nodes: &[DVec2], degree: usize, [even, odd]: Bars) -> Option<Self> {
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for t in nodes.iter().flat_map(|t| [*t, DVec2::new(-t.x, t.y)]) {
            (low, high) = (low.min(t), high.max(t));
        }
        let (middle, half) = (0.5 * (high + low), 0.5 * (high - low));
        if !(half.is_finite() && half.min_element() > 0.0) {
            return None;
        }
        let places: Vec<DVec2> = nodes.iter().map(|t| (*t - middle) / half).collect();
        let even = Half::new(&places, degree, Parity::Even, even)?;
        let halves = [even, Half::new(&places, degree, Parity::Odd, odd)?];
        let told = |h: &Half| h.coefficients.iter().flatten().all(|c| c.is_finite());
        halves.iter().all(told).then_some(Self { degree, middle, half, halves })
    }

    /// Zero cotangents on the coefficients.
    pub(super) fn no_bars(&self) -> Bars {
        [0, 1].map(|p: usize| self.halves[p].coefficients.iter().map(|c| vec![0.0; c.len()]).collect())
    }

    /// Root mean square of what the fit of an even function leaves over.
    pub(super) fn residual(&self, k: usize) -> f64 {
        let left = self.halves[0].left(k);
        (left.iter().map(|v| v * v).sum::<f64>() / left.len().max(1) as f64).sqrt()
    }

    /// Least and largest value of an even function at the nodes.
    pub(super) fn range(&self, k: usize) -> (f64, f64) {
        let all = self.halves[0].values[k].iter();
        all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)))
    }

    /// Slopes of an even function over `τ` at the nodes.
    pub(super) fn slopes(&self, k: usize) -> Vec<DVec2> {
        let half = &self.halves[0];
        let [x, y] = [Of::X, Of::Y].map(|of| half.at_nodes.at(of, &half.coefficients[k]));
        x.into_iter().zip(y).map(|(x, y)| DVec2::new(x, y) / self.half).collect()
    }

    /// Pulls cotangents on the coefficients back to the values and to the nodes' `τ`.
    pub(super) fn vjp(&self, bars: &Bars) -> (Bars, Vec<DVec2>) {
        let count = self.halves[0].values[0].len();
        let mut nodes = vec![DVec2::ZERO; count];
        let values = [0, 1].map(|p: usize| self.halves[p].vjp(&bars[p], &mut nodes));
        nodes.iter_mut().for_each(|n| *n /= self.half);
        (values, nodes)
    }

    /// The terms of both parities at points of the pupil, `[term, point]`.
    pub(super) fn terms(&self, points: impl Iterator<Item = DVec2>) -> [Array2<f64>; 2] {
        let places: Vec<DVec2> = points.map(|t| (t - self.middle) / self.half).collect();
        [Parity::Even, Parity::Odd].map(|parity| fit::values(&places, self.degree, parity))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_rel, central_difference};

    /// A polynomial comes back; the pull-back to values and to places is that of differences, of a function that no polynomial of the degree is.
    #[test]
    fn the_pull_back_agrees_with_differences() {
        let rng = &mut fastrand::Rng::with_seed(7);
        let nodes: Vec<DVec2> =
            (0..40).map(|_| 0.1 * DVec2::new(rng.f64(), 2.0 * rng.f64() - 1.0) + DVec2::new(0.0, 0.3)).collect();
        let even = |t: DVec2| (20.0 * t.x * t.x + 9.0 * t.y).sin() + 1.0;
        let odd = |t: DVec2| t.x * (7.0 * t.y).cos();
        let values: Bars =
            [vec![nodes.iter().map(|t| even(*t)).collect()], vec![nodes.iter().map(|t| odd(*t)).collect()]];
        let fitted = Fitted::new(&nodes, 4, values.clone()).expect("spans an area");
        let mut bars = fitted.no_bars();
        let places = [DVec2::new(0.02, 0.31), DVec2::new(0.07, 0.24), DVec2::new(-0.05, 0.36)];
        let loss = |fitted: &Fitted| {
            let at = fitted.terms(places.into_iter());
            let [e, o] = [0, 1].map(|p: usize| fit::apply_transposed(&at[p], &fitted.halves[p].coefficients[0]));
            [e, o].map(|v| v[0] - 2.0 * v[1] + 3.0 * v[2]).iter().sum::<f64>()
        };
        let at = fitted.terms(places.into_iter());
        for p in 0..2 {
            bars[p][0] = fit::apply(&at[p], &[1.0, -2.0, 3.0]);
        }
        let (of_values, of_nodes) = fitted.vjp(&bars);
        for j in [0, 7, 23] {
            for p in 0..2 {
                let moved = |h: f64| {
                    let mut values = values.clone();
                    values[p][0][j] += h;
                    loss(&Fitted::new(&nodes, 4, values).expect("as before"))
                };
                assert_rel(of_values[p][0][j], central_difference(moved, 1e-5), 1e-8, 1.0, "value");
            }
            for axis in [DVec2::X, DVec2::Y] {
                let moved = |h: f64| {
                    let mut nodes = nodes.clone();
                    nodes[j] += h * axis;
                    loss(&Fitted::new(&nodes, 4, values.clone()).expect("as before"))
                };
                let found = of_nodes[j].dot(axis);
                assert_rel(found, central_difference(moved, 1e-7), 1e-6, 1.0, "place");
            }
        }
    }
}
