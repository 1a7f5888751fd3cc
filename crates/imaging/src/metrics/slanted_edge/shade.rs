//! Uneven light: the levels on both sides of an edge as planes instead of constants.
//!
//! A sample at the distance `d` from the edge, `t` along it, is `E(d) + p₁ t (1 − e) + p₂ t e + p₃ d E(d) + p₄ d`, where `e` is the edge
//! spread function `E` from 0 to 1. Along the edge each side has a slope of its own, and within the edge they blend as the levels do. Across
//! it light that falls unevenly on a chart makes slopes in proportion to the levels: `p₃`. The tails of a spread function rise alike on both sides and are no
//! light: what rises alike goes into `p₄`, which is not taken off, so that `p₃` has no part of it. Glare whose slope across the edge is the same
//! on both sides therefore stays in, and is told (`warnings`). The numbers are fitted together with the spline, so that the spline's covariance has their doubt in it.

use nalgebra::{Cholesky, Const, DMatrix, SMatrix, SVector};

use super::line::Line;
use super::samples::Sample;
use super::spread::{Point, Spread};

/// Slopes that are fitted.
pub(super) const COUNT: usize = 4;
/// The first so many run along the edge.
const ALONG: usize = 2;
/// The first so many are the light's, and taken off.
const LIGHT: usize = 3;
/// Share of a slope's own curvature that the spline must leave it; below, the samples do not tell them apart.
const TOLD: f64 = 1e-6;

/// How far along the edge spread function a distance is.
#[derive(Clone, Debug)]
pub(super) enum Blend {
    /// A logistic step of this 10 to 90 % width.
    Logistic(f64),
    /// A fitted function.
    Spread(Box<Spread>),
}

impl Blend {
    fn at(&self, d: f64) -> f64 {
        match self {
            Self::Logistic(width) => 1.0 / (1.0 + (-2.0 * 9f64.ln() * d / width).exp()),
            Self::Spread(spread) => {
                let [low, high] = spread.levels();
                (spread.at(d) - low) / (high - low)
            }
        }
    }
}

/// How samples move with the slopes.
#[derive(Clone, Debug)]
struct Course {
    blend: Blend,
    /// The dark level over the difference of both.
    dark: f64,
    /// Whether there are slopes across the edge.
    across: bool,
}

impl Course {
    /// Columns of the slopes at a place; those that there are none of are 0.
    fn columns(&self, d: f64, t: f64) -> [f64; COUNT] {
        let (e, across) = (self.blend.at(d), f64::from(u8::from(self.across)));
        [t * (1.0 - e), t * e, across * d * (self.dark + e), across * d]
    }

    /// How many slopes there are.
    fn count(&self) -> usize {
        if self.across { COUNT } else { ALONG }
    }
}

/// Slopes of the light about a line.
#[derive(Clone, Debug)]
pub(super) struct Shade {
    line: Line,
    course: Course,
    /// `p₁` to `p₄`; the last is none of the light's, and stays 0.
    slopes: SVector<f64, COUNT>,
}

impl Shade {
    /// None yet, of light that may change `across` the edge, or along it alone.
    pub(super) fn none(line: Line, blend: Blend, spread: &Spread, across: bool) -> Self {
        Self { line, course: Course { blend, dark: dark(spread), across }, slopes: SVector::zeros() }
    }

    /// How many numbers it takes off.
    pub(super) fn numbers(&self) -> usize {
        self.course.count().min(LIGHT)
    }

    /// Its slope across the edge in its own standard errors.
    pub(super) fn certainty_across(&self, spread: &Spread, points: &[Point]) -> f64 {
        let own = self.beside(spread, points).map_or(f64::INFINITY, |b| b.own.inverse()[(ALONG, ALONG)]);
        self.slopes[ALONG].abs() / (own * spread.variance()).sqrt()
    }

    /// The samples without it.
    pub(super) fn taken_off(&self, samples: &[Sample]) -> Vec<Sample> {
        let off = |s: &Sample| {
            let [d, t] = self.line.distance(s);
            let columns = SVector::from(self.course.columns(d, t));
            Sample { value: s.value - columns.dot(&self.slopes), ..*s }
        };
        samples.iter().map(off).collect()
    }

    /// With what `spread` leaves of `points`, from which it has been taken off; `None` where the samples do not tell it.
    pub(super) fn improved(&self, spread: &Spread, points: &[Point]) -> Option<Self> {
        let beside = self.beside(spread, points)?;
        let mut right = SVector::<f64, COUNT>::zeros();
        for p in points {
            right += SVector::from(beside.columns(p)) * (p.value - spread.at(p.d));
        }
        let mut slopes = self.slopes + beside.own.solve(&right);
        slopes.iter_mut().skip(LIGHT).for_each(|v| *v = 0.0);
        slopes.iter().all(|v| v.is_finite()).then(|| Self { slopes, ..self.clone() })
    }

    /// The same slopes about another line and within another edge.
    pub(super) fn about(self, line: Line, spread: &Spread) -> Self {
        let course =
            Course { blend: Blend::Spread(Box::new(spread.clone())), dark: dark(spread), across: self.course.across };
        Self { line, course, ..self }
    }

    /// How its columns stand beside the spline's.
    pub(super) fn beside(&self, spread: &Spread, points: &[Point]) -> Option<Beside> {
        Beside::new(&self.course, spread, points)
    }

    /// How much a side's level changes over the points, at most, of the contrast.
    pub(super) fn change(&self, points: &[Point], contrast: f64) -> f64 {
        let p = self.slopes;
        let side = |sign: f64, along: f64, across: f64| {
            let of = points.iter().filter(|q| sign * q.d >= 0.0).map(|q| along * q.t + across * q.d);
            let (low, high) = of.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
            (high - low).max(0.0)
        };
        side(-1.0, p[0], p[2] * self.course.dark).max(side(1.0, p[1], p[2] * (self.course.dark + 1.0))) / contrast
    }
}

/// The dark level over the difference of both.
fn dark(spread: &Spread) -> f64 {
    let [low, high] = spread.levels();
    low / (high - low)
}

/// The slopes' columns `S` beside the spline's `B`, whose normal matrix with its penalty is `A`.
#[derive(Clone, Debug)]
pub(super) struct Beside {
    course: Course,
    /// `BᵀS`.
    mixed: DMatrix<f64>,
    /// `A⁻¹BᵀS`.
    solved: DMatrix<f64>,
    /// `SᵀS − SᵀB A⁻¹BᵀS`.
    own: Cholesky<f64, Const<COUNT>>,
}

impl Beside {
    fn new(course: &Course, spread: &Spread, points: &[Point]) -> Option<Self> {
        let mut mixed = DMatrix::zeros(spread.knots.count(), COUNT);
        let mut square = SMatrix::<f64, COUNT, COUNT>::zeros();
        for p in points {
            let columns = SVector::from(course.columns(p.d, p.t));
            for (k, w) in spread.knots.row(p.d, false) {
                (0..COUNT).for_each(|j| mixed[(k, j)] += w * columns[j]);
            }
            square += columns * columns.transpose();
        }
        let solved = spread.solve(&mixed);
        let rest = mixed.transpose() * &solved;
        let mut own = square - SMatrix::from_fn(|i, j| 0.5 * (rest[(i, j)] + rest[(j, i)]));
        let told = (0..course.count()).all(|i| own[(i, i)] > TOLD * square[(i, i)]);
        // Slopes that there are none of stand apart.
        (course.count()..COUNT).for_each(|i| own[(i, i)] = 1.0);
        told.then(|| own.cholesky()).flatten().map(|own| Self { course: course.clone(), mixed, solved, own })
    }

    /// Slopes' columns at a point.
    pub(super) fn columns(&self, p: &Point) -> [f64; COUNT] {
        self.course.columns(p.d, p.t)
    }

    /// The solution of both together for functionals of the spline's coefficients, from that of the spline alone: coefficients, then slopes.
    pub(super) fn joint(&self, alone: DMatrix<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
        let mut right = self.mixed.transpose() * &alone;
        // What is not taken off moves nothing.
        right.rows_mut(LIGHT, COUNT - LIGHT).fill(0.0);
        let inverse = self.own.inverse();
        let slopes = DMatrix::from_fn(COUNT, COUNT, |i, j| -inverse[(i, j)]) * right;
        (alone - &self.solved * &slopes, slopes)
    }
}
