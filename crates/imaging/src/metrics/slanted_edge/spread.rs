//! The edge spread function by regression: a cubic spline through all samples at their own distances, constant at both ends.
//!
//! `E(d) = Σ_k c_k B₃((d − x_k)/h)` with knots `x_k` a step `h` apart. Coefficients before the first and behind the last free
//! one are equal, so that `E` is constant outside. A penalty on third differences, too weak to be seen in any frequency that
//! the edge has, carries the spline over gaps of the distances. Nothing is binned, so nothing is corrected for bins, and all
//! results are linear in the samples: their covariance is known.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// One sample as the spline sees it: distance from the edge, place along it, value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub(super) d: f64,
    pub(super) t: f64,
    pub(super) value: f64,
    /// Row of the picture, or column for an edge nearer to a row: neighbours across the edge share it.
    pub(super) across: usize,
}

/// Knots of a spline that is constant outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Knots {
    /// Distance of knots, pixels.
    pub(super) step: f64,
    /// Steps from the edge to the last knots on the dark and on the bright side.
    pub(super) sides: [usize; 2],
}

impl Knots {
    /// Free coefficients.
    pub(super) fn count(self) -> usize {
        self.sides[0] + self.sides[1] + 1
    }

    /// Where the basis function of free coefficient `k` is centred.
    pub(super) fn place(self, k: usize) -> f64 {
        (k as f64 - self.sides[0] as f64) * self.step
    }

    /// Beginning and end of the part that is not constant, pixels.
    pub(super) fn reach(self) -> [f64; 2] {
        self.sides.map(|n| (n as f64 + 1.0) * self.step)
    }

    /// The coefficient of the first of four basis functions at `d`, before it is kept among the free ones, and their weights; with
    /// `slope`, the weights of the derivative.
    fn weights(self, d: f64, slope: bool) -> (isize, [f64; 4]) {
        let u = d / self.step + self.sides[0] as f64;
        let last = self.count() as f64;
        // Far outside all four functions carry the same coefficient.
        let u = u.clamp(-3.0, last + 2.0);
        let cell = u.floor();
        let f = u - cell;
        let g = 1.0 - f;
        let weights = if slope {
            [-0.5 * g * g, 0.5 * (3.0 * f * f - 4.0 * f), 0.5 * (4.0 * g - 3.0 * g * g), 0.5 * f * f]
                .map(|w| w / self.step)
        } else {
            let inner = |f: f64| (4.0 - 6.0 * f * f + 3.0 * f * f * f) / 6.0;
            [g * g * g / 6.0, inner(f), inner(g), f * f * f / 6.0]
        };
        (cell as isize - 1, weights)
    }

    /// The free coefficient that stands at `k`.
    fn free(self, k: isize) -> usize {
        k.clamp(0, self.count() as isize - 1).cast_unsigned()
    }

    /// Free coefficients and weights of the value, or of the slope, at `d`.
    pub(super) fn row(self, d: f64, slope: bool) -> [(usize, f64); 4] {
        let (first, weights) = self.weights(d, slope);
        std::array::from_fn(|i| (self.free(first + i.cast_signed()), weights[i]))
    }
}

/// Sums over the samples: what any spline on these or fewer knots is fitted from.
#[derive(Clone, Debug)]
pub(super) struct NormalEquations {
    knots: Knots,
    /// `BᵀB`.
    gram: DMatrix<f64>,
    /// `Bᵀv` of values less the shift.
    right: DVector<f64>,
    /// Sum of squares of values less the shift.
    squares: f64,
    /// What values are counted from, so that small residuals are not lost in rounding.
    shift: f64,
    /// Samples.
    samples: f64,
}

impl NormalEquations {
    /// Over `points`.
    pub(super) fn new(points: &[Point], knots: Knots) -> Self {
        let n = knots.count();
        let (mut gram, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let samples = points.len() as f64;
        let shift = points.iter().map(|p| p.value).sum::<f64>() / samples;
        let mut squares = 0.0;
        for p in points {
            let (row, v) = (knots.row(p.d, false), p.value - shift);
            for (i, a) in row {
                right[i] += a * v;
                for (j, b) in row {
                    gram[(i, j)] += a * b;
                }
            }
            squares += v * v;
        }
        Self { knots, gram, right, squares, shift, samples }
    }

    /// The same for fewer knots: coefficients outside become one with the last.
    pub(super) fn narrowed(&self, sides: [usize; 2]) -> Self {
        let knots = Knots { sides, ..self.knots };
        let (n, all) = (knots.count(), self.knots.count());
        let to = |k: usize| knots.free(k.cast_signed() - (self.knots.sides[0].cast_signed() - sides[0].cast_signed()));
        let (mut gram, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for j in 0..all {
            right[to(j)] += self.right[j];
            for i in 0..all {
                gram[(to(i), to(j))] += self.gram[(i, j)];
            }
        }
        Self { knots, gram, right, ..*self }
    }

    /// The spline that fits best under `penalty` on the squares of third differences; `None` where the samples leave it open.
    pub(super) fn fit(&self, penalty: f64) -> Option<Spread> {
        let n = self.knots.count();
        let mut matrix = self.gram.clone();
        // Third differences reach into the constant ends.
        for k in -3..n.cast_signed() {
            let row: [(usize, f64); 4] =
                std::array::from_fn(|i| (self.knots.free(k + i.cast_signed()), [-1.0, 3.0, -3.0, 1.0][i]));
            for (i, a) in row {
                for (j, b) in row {
                    matrix[(i, j)] += penalty * a * b;
                }
            }
        }
        let factor = Cholesky::new(matrix)?;
        let c = factor.solve(&self.right);
        let residual = self.squares - 2.0 * c.dot(&self.right) + c.dot(&(&self.gram * &c));
        // Rounding of the sums bounds what a residual can be.
        let residual = residual.max(1e-15 * self.squares);
        let coefficients = c.add_scalar(self.shift);
        let good = coefficients.iter().all(|v| v.is_finite());
        good.then(|| Spread {
            knots: self.knots,
            coefficients,
            factor,
            gram: self.gram.clone(),
            residual,
            samples: self.samples,
        })
    }
}

/// A fitted edge spread function.
#[derive(Clone, Debug)]
pub(super) struct Spread {
    pub(super) knots: Knots,
    pub(super) coefficients: DVector<f64>,
    /// Of the normal equations with their penalty.
    factor: Cholesky<f64, Dyn>,
    /// Sum of squares of what it leaves.
    pub(super) residual: f64,
    gram: DMatrix<f64>,
    /// Samples it was fitted to.
    pub(super) samples: f64,
}

impl Spread {
    /// Value at the distance `d`.
    pub(super) fn at(&self, d: f64) -> f64 {
        self.knots.row(d, false).iter().map(|(k, w)| w * self.coefficients[*k]).sum()
    }

    /// Slope at the distance `d`: the line spread function, not normalised.
    pub(super) fn slope(&self, d: f64) -> f64 {
        self.knots.row(d, true).iter().map(|(k, w)| w * self.coefficients[*k]).sum()
    }

    /// Levels of the dark and of the bright side.
    pub(super) fn levels(&self) -> [f64; 2] {
        [self.coefficients[0], self.coefficients[self.knots.count() - 1]]
    }

    /// Variance of one sample about the curve.
    pub(super) fn variance(&self) -> f64 {
        self.residual / (self.samples - self.knots.count() as f64).max(1.0)
    }

    /// How many free numbers the fit amounts to: the trace of the hat matrix.
    pub(super) fn freedom(&self) -> f64 {
        self.factor.solve(&self.gram).trace()
    }

    /// Solves the normal equations for the columns of `right`.
    pub(super) fn solve(&self, right: &DMatrix<f64>) -> DMatrix<f64> {
        self.factor.solve(right)
    }

    /// Share of its own value in the curve at every point: the diagonal of the hat matrix.
    pub(super) fn leverages(&self, points: &[Point]) -> Vec<f64> {
        let inverse = self.factor.inverse();
        let of = |p: &Point| {
            let row = self.knots.row(p.d, false);
            row.iter()
                .flat_map(|(i, a)| row.iter().map(move |(j, b)| (i, j, a * b)))
                .map(|(i, j, w)| w * inverse[(*i, *j)])
                .sum()
        };
        points.iter().map(of).collect()
    }

    /// Where the curve passes `share` of the way from dark to bright, nearest the edge.
    pub(super) fn crossing(&self, share: f64) -> f64 {
        let [low, high] = self.levels();
        let level = low + share * (high - low);
        let [before, behind] = self.knots.reach();
        let fine = 0.25 * self.knots.step;
        let cells = ((before + behind) / fine).ceil() as usize;
        let place = |i: usize| -before + i as f64 * fine;
        let crossings = (0..cells).filter_map(|i| {
            let (a, b) = (self.at(place(i)) - level, self.at(place(i + 1)) - level);
            (a <= 0.0 && b > 0.0).then(|| place(i) + fine * a / (a - b))
        });
        crossings.min_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(0.0)
    }
}
