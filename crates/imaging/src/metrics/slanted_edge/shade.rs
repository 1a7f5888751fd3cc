//! Uneven light: the levels on both sides of an edge as curved surfaces instead of constants.
//!
//! A sample at the distance `d` from the edge, `t` along it, is `E(d)` and a sum of slopes and bends of the light; `e` is the edge spread function `E` from 0 to 1.
//! Along the edge each side has its own (`t` and `t²` times `1 − e` and `e`), and within the edge they blend as the levels do. Across
//! it light that falls unevenly on a chart changes both sides in proportion to their levels: `d E`, `t d E`, `d² E`. The tails of a spread function rise alike on both sides and are no
//! light: what rises alike goes into `d` and `d |d|`, which are fitted beside and not taken off, so that the light has no part of it. Glare whose slope across the edge is the same
//! on both sides therefore stays in, and is told (`warnings`). All are fitted together with the spline, so that the spline's covariance has their doubt in it.

use nalgebra::{Cholesky, Const, DMatrix, SMatrix, SVector};

use super::line::Line;
use super::samples::Sample;
use super::spread::{Point, Spread};

/// Slopes and bends that may be fitted.
pub(super) const COUNT: usize = 9;
/// The first so many run along the edge.
const ALONG: usize = 4;
/// The first so many are the light's, and taken off.
const LIGHT: usize = 7;

/// Which of them are fitted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kind {
    /// Across the edge, too.
    pub(super) across: bool,
    /// Bends, too.
    pub(super) bent: bool,
}

impl Kind {
    /// All of them, the plainest first.
    pub(super) const ALL: [Self; 4] = [
        Self { across: false, bent: false },
        Self { across: false, bent: true },
        Self { across: true, bent: false },
        Self { across: true, bent: true },
    ];

    fn active(self) -> [bool; COUNT] {
        let Self { across, bent } = self;
        let both = across && bent;
        [true, true, bent, bent, across, both, both, across, both]
    }
}
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
    kind: Kind,
}

impl Course {
    /// Columns of the slopes at a place; those that there are none of are 0.
    fn columns(&self, d: f64, t: f64) -> [f64; COUNT] {
        let (e, level) = (self.blend.at(d), self.dark + self.blend.at(d));
        let all = [
            t * (1.0 - e),
            t * e,
            t * t * (1.0 - e),
            t * t * e,
            d * level,
            t * d * level,
            d * d * level,
            d,
            d * d.abs(),
        ];
        let active = self.kind.active();
        std::array::from_fn(|i| if active[i] { all[i] } else { 0.0 })
    }
}

/// Slopes of the light about a line.
#[derive(Clone, Debug)]
pub(super) struct Shade {
    line: Line,
    course: Course,
    /// In the order of the columns; the last two are none of the light's, and stay 0.
    slopes: SVector<f64, COUNT>,
}

impl Shade {
    /// None yet.
    pub(super) fn none(line: Line, blend: Blend, spread: &Spread, kind: Kind) -> Self {
        Self { line, course: Course { blend, dark: dark(spread), kind }, slopes: SVector::zeros() }
    }

    /// How many numbers it takes off.
    pub(super) fn numbers(&self) -> usize {
        self.course.kind.active()[..LIGHT].iter().filter(|a| **a).count()
    }

    /// Whether it changes across the edge.
    pub(super) fn is_across(&self) -> bool {
        self.course.kind.across
    }

    /// The surest of what changes across the edge in its own standard errors.
    pub(super) fn certainty_across(&self, spread: &Spread, points: &[Point]) -> f64 {
        let Some(beside) = self.beside(spread, points) else { return 0.0 };
        let inverse = beside.own.inverse();
        let certainty = |i: usize| self.slopes[i].abs() / (inverse[(i, i)] * spread.variance()).sqrt();
        (ALONG..LIGHT).filter(|i| self.course.kind.active()[*i]).map(certainty).fold(0.0, f64::max)
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
            Course { blend: Blend::Spread(Box::new(spread.clone())), dark: dark(spread), kind: self.course.kind };
        Self { line, course, ..self }
    }

    /// How its columns stand beside the spline's.
    pub(super) fn beside(&self, spread: &Spread, points: &[Point]) -> Option<Beside> {
        Beside::new(&self.course, spread, points)
    }

    /// How much a side's level changes over the points, at most, of the contrast.
    pub(super) fn change(&self, points: &[Point], contrast: f64) -> f64 {
        let side = |sign: f64| {
            let of = points.iter().filter(|q| sign * q.d >= 0.0).map(|q| {
                let columns = self.course.columns(q.d, q.t);
                (0..LIGHT).map(|i| columns[i] * self.slopes[i]).sum::<f64>()
            });
            let (low, high) = of.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
            (high - low).max(0.0)
        };
        side(-1.0).max(side(1.0)) / contrast
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
        let active = course.kind.active();
        let told = (0..COUNT).filter(|i| active[*i]).all(|i| own[(i, i)] > TOLD * square[(i, i)]);
        // Those that there are none of stand apart.
        (0..COUNT).filter(|i| !active[*i]).for_each(|i| own[(i, i)] = 1.0);
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
