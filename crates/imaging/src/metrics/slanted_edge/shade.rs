//! Uneven light: the levels on both sides of an edge as planes instead of constants.
//!
//! A sample at the distance `d` from the edge, `t` along it, is `E(d) + p₁ t (1 − e) + p₂ t e + p₃ d (1 − e) + p₄ d e`, where `e` is the edge
//! spread function from 0 to 1: each side has a slope of its own in both directions, and within the edge they blend as the levels do.
//! Light that falls unevenly on a chart makes both slopes in proportion to their levels, glare makes equal ones; both are held. The four
//! numbers are fitted together with the spline, so that the spline's covariance has their doubt in it.

use nalgebra::{Cholesky, Const, DMatrix, SMatrix, SVector};

use super::line::Line;
use super::samples::Sample;
use super::spread::{Point, Spread};

/// Slopes of two sides in two directions.
const COUNT: usize = 4;
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

    fn columns(&self, d: f64, t: f64) -> [f64; COUNT] {
        let e = self.at(d);
        [t * (1.0 - e), t * e, d * (1.0 - e), d * e]
    }
}

/// Slopes of the light about a line.
#[derive(Clone, Debug)]
pub(super) struct Shade {
    line: Line,
    blend: Blend,
    /// `p₁` to `p₄`.
    slopes: SVector<f64, COUNT>,
}

impl Shade {
    /// None yet.
    pub(super) fn none(line: Line, blend: Blend) -> Self {
        Self { line, blend, slopes: SVector::zeros() }
    }

    /// The samples without it.
    pub(super) fn taken_off(&self, samples: &[Sample]) -> Vec<Sample> {
        let off = |s: &Sample| {
            let [d, t] = self.line.distance(s);
            let columns = SVector::from(self.blend.columns(d, t));
            Sample { value: s.value - columns.dot(&self.slopes), ..*s }
        };
        samples.iter().map(off).collect()
    }

    /// With what `spread` leaves of `points`, from which it has been taken off; `None` where the samples do not tell it.
    pub(super) fn improved(&self, spread: &Spread, points: &[Point]) -> Option<Self> {
        let beside = Beside::new(&self.blend, spread, points)?;
        let mut right = SVector::<f64, COUNT>::zeros();
        for p in points {
            right += SVector::from(self.blend.columns(p.d, p.t)) * (p.value - spread.at(p.d));
        }
        let slopes = self.slopes + beside.own.solve(&right);
        slopes.iter().all(|v| v.is_finite()).then(|| Self { slopes, ..self.clone() })
    }

    /// The same slopes about another line and within another edge.
    pub(super) fn about(self, line: Line, spread: &Spread) -> Self {
        Self { line, blend: Blend::Spread(Box::new(spread.clone())), ..self }
    }

    /// How its columns stand beside the spline's.
    pub(super) fn beside(&self, spread: &Spread, points: &[Point]) -> Option<Beside> {
        Beside::new(&self.blend, spread, points)
    }

    /// How much a side's level changes over the points, at most, of the contrast.
    pub(super) fn change(&self, points: &[Point], contrast: f64) -> f64 {
        let p = self.slopes;
        let side = |sign: f64, along: f64, across: f64| {
            let of = points.iter().filter(|q| sign * q.d >= 0.0).map(|q| along * q.t + across * q.d);
            let (low, high) = of.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
            (high - low).max(0.0)
        };
        side(-1.0, p[0], p[2]).max(side(1.0, p[1], p[3])) / contrast
    }
}

/// The slopes' columns `S` beside the spline's `B`, whose normal matrix with its penalty is `A`.
#[derive(Clone, Debug)]
pub(super) struct Beside {
    blend: Blend,
    /// `BᵀS`.
    mixed: DMatrix<f64>,
    /// `A⁻¹BᵀS`.
    solved: DMatrix<f64>,
    /// `SᵀS − SᵀB A⁻¹BᵀS`.
    own: Cholesky<f64, Const<COUNT>>,
}

impl Beside {
    fn new(blend: &Blend, spread: &Spread, points: &[Point]) -> Option<Self> {
        let mut mixed = DMatrix::zeros(spread.knots.count(), COUNT);
        let mut square = SMatrix::<f64, COUNT, COUNT>::zeros();
        for p in points {
            let columns = SVector::from(blend.columns(p.d, p.t));
            for (k, w) in spread.knots.row(p.d, false) {
                (0..COUNT).for_each(|j| mixed[(k, j)] += w * columns[j]);
            }
            square += columns * columns.transpose();
        }
        let solved = spread.solve(&mixed);
        let rest = mixed.transpose() * &solved;
        let own = square - SMatrix::from_fn(|i, j| 0.5 * (rest[(i, j)] + rest[(j, i)]));
        let told = (0..COUNT).all(|i| own[(i, i)] > TOLD * square[(i, i)]);
        told.then(|| own.cholesky()).flatten().map(|own| Self { blend: blend.clone(), mixed, solved, own })
    }

    /// Slopes' columns at a point.
    pub(super) fn columns(&self, p: &Point) -> [f64; COUNT] {
        self.blend.columns(p.d, p.t)
    }

    /// The solution of both together for functionals of the spline's coefficients, from that of the spline alone: coefficients, then slopes.
    pub(super) fn joint(&self, alone: DMatrix<f64>) -> (DMatrix<f64>, DMatrix<f64>) {
        let right = self.mixed.transpose() * &alone;
        let inverse = self.own.inverse();
        let slopes = DMatrix::from_fn(COUNT, COUNT, |i, j| -inverse[(i, j)]) * right;
        (alone - &self.solved * &slopes, slopes)
    }
}
