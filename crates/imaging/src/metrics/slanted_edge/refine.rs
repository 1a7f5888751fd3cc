//! Edge and spread function together: the line, or parabola, at whose distances the samples agree best with one curve.
//!
//! First a logistic step of free width, so that the width is known; then Gauss–Newton on angle and curvature with the spline
//! fitted anew at every step (variable projection: G. Golub, V. Pereyra, Inverse Problems 19, 2003). The position is where the
//! spline passes half way.

use nalgebra::{DMatrix, Matrix2, Vector2};

use super::line::Line;
use super::samples::Sample;
use super::spread::{Knots, NormalEquations, Point, Spread};

/// Knots a pixel at least, and knots across the 10 to 90 % width of a blurred edge.
const KNOTS: [f64; 2] = [4.0, 6.0];
/// What the penalty takes off at the highest frequency a Gaussian edge of this width has.
const PENALTY: f64 = 1e-5;
/// Steps of the penalty, and how much weaker than the best one it is taken.
const STRONGER: f64 = 3.0;
const WEAKER: f64 = 10.0;
/// How much farther the spline goes than where noise hides what it leaves.
const WIDER: f64 = 1.4;
/// Rows of samples a level needs beyond the spline's ends, pixels.
const FLAT: f64 = 2.0;

/// Edge and spread function.
#[derive(Clone, Debug)]
pub(super) struct Fitted {
    pub(super) line: Line,
    pub(super) spread: Spread,
    pub(super) points: Vec<Point>,
    /// Standard uncertainty of the angle, rad.
    pub(super) angle_error: f64,
    /// Of the curvature, 1/px, where it was fitted.
    pub(super) curvature_error: Option<f64>,
    /// 10 to 90 % width, pixels.
    pub(super) width: f64,
    /// Whether the spread function takes all the room there is.
    pub(super) open: bool,
}

impl Fitted {
    /// Where the edge itself begins and ends in the region, along it, pixels.
    pub(super) fn ends(&self) -> [f64; 2] {
        let near = self.points.iter().filter(|p| p.d.abs() < 1.5);
        near.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], p| [a.min(p.t), b.max(p.t)])
    }
}

/// Distances of the samples between `-sides[0]` and `sides[1]`.
pub(super) fn points(samples: &[Sample], line: &Line, sides: [f64; 2]) -> Vec<Point> {
    let upright = line.angle.cos().abs() >= line.angle.sin().abs();
    let point = |s: &Sample| {
        let [d, t] = line.distance(s);
        let across = if upright { s.y } else { s.x };
        (-sides[0] <= d && d <= sides[1]).then_some(Point { d, t, value: s.value, across: across as usize })
    };
    samples.iter().filter_map(point).collect()
}

/// How far the region reaches on both sides of the line with at least a third of the samples that it has at the line.
pub(super) fn sides(samples: &[Sample], line: &Line) -> [f64; 2] {
    // Two pixels a bin: every second column of a mosaic may be empty.
    const BIN: f64 = 2.0;
    let mut counts = [Vec::new(), Vec::new()];
    for s in samples {
        let [d, _] = line.distance(s);
        let (side, bin) = (usize::from(d >= 0.0), (d.abs() / BIN) as usize);
        if counts[side].len() <= bin {
            counts[side].resize(bin + 1, 0usize);
        }
        counts[side][bin] += 1;
    }
    let first = counts.iter().filter_map(|c| c.first()).max().copied().unwrap_or(0);
    counts.map(|c| BIN * c.iter().take_while(|n| 3 * **n >= first).count() as f64)
}

/// A logistic step `1/(1 + exp(−d/q))` of free line and width by damped Gauss–Newton: the line, and the 10 to 90 % width.
pub(super) fn logistic(samples: &[Sample], start: Line) -> (Line, f64) {
    const WIDTH: f64 = 4.394_449; // 2 ln 9
    // Residual sum, and the normal equations of (angle, offset, ln q, low, high − low).
    let look = |line: &Line, q: f64| -> (f64, DMatrix<f64>, DMatrix<f64>) {
        let [mut n, mut s, mut ss, mut v, mut sv] = [0.0; 5];
        let step = |d: f64| 1.0 / (1.0 + (-d / q).exp());
        for p in samples {
            let e = step(line.distance(p)[0]);
            [n, s, ss, v, sv] = [n + 1.0, s + e, ss + e * e, v + p.value, sv + e * p.value];
        }
        let contrast = (n * sv - s * v) / (n * ss - s * s).max(f64::MIN_POSITIVE);
        let low = (v - contrast * s) / n;
        let (mut gram, mut right, mut sum) = (DMatrix::zeros(5, 5), DMatrix::zeros(5, 1), 0.0);
        for p in samples {
            let [d, t] = line.distance(p);
            let e = step(d);
            let slope = contrast * e * (1.0 - e) / q;
            let row = [slope * t, -slope, -slope * d, 1.0, e];
            let r = p.value - low - contrast * e;
            sum += r * r;
            for i in 0..5 {
                right[(i, 0)] += row[i] * r;
                (0..5).for_each(|j| gram[(i, j)] += row[i] * row[j]);
            }
        }
        (sum, gram, right)
    };
    let widths = (0..8).map(|i| 0.25 * 2f64.powi(i));
    let mut q = widths.map(|q| (look(&start, q).0, q)).min_by(|a, b| a.0.total_cmp(&b.0)).map_or(1.0, |b| b.1);
    let (mut line, mut damping) = (start, 1e-3);
    let (mut sum, mut gram, mut right) = look(&line, q);
    for _ in 0..40 {
        let mut damped = gram.clone();
        (0..5).for_each(|i| damped[(i, i)] *= 1.0 + damping);
        let Some(step) = damped.cholesky().map(|c| c.solve(&right)) else { break };
        let moved = Line { angle: line.angle + step[0].clamp(-0.05, 0.05), offset: line.offset + step[1], ..line };
        let wider = (q * step[2].clamp(-0.7, 0.7).exp()).clamp(0.05, 1e4);
        let next = look(&moved, wider);
        if next.0 < sum {
            let gain = sum - next.0;
            (line, q, damping) = (moved, wider, 0.3 * damping);
            (sum, gram, right) = next;
            if gain < 1e-9 * sum {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e6 {
                break;
            }
        }
    }
    (line, WIDTH * q)
}

/// The largest distance from an edge of this 10 to 90 % width that its samples are taken from, pixels.
pub(super) fn most(width: f64) -> f64 {
    10.0 * width.max(0.5) + 16.0
}

/// Line and spread function; `curved` with a curvature. `None` where the samples leave them open.
pub(super) fn refine(samples: &[Sample], start: Line, width: f64, curved: bool) -> Option<Fitted> {
    let mut line = start;
    let width = width.max(0.5);
    let sides = sides(samples, &line).map(|s| s.min(most(width)));
    let step = (width / KNOTS[1]).max(1.0 / KNOTS[0]);
    // Room of the spline on either side.
    let room = sides.map(|s| (((s - FLAT) / step).floor() as usize).max(2));
    let near = room.map(|n| n.min(((2.0 * width + 1.5) / step).ceil() as usize));
    let mut steps = 0;
    let (points, error) = loop {
        let points = points(samples, &line, sides);
        let sums = NormalEquations::new(&points, Knots { step, sides: near });
        let spread = sums.fit(penalty(&points, sides, step, width))?;
        line.offset += spread.crossing(0.5);
        let (moved, error) = newton(&points, &spread, curved)?;
        let half = points.iter().fold(1.0f64, |m, p| m.max(p.t.abs()));
        line.angle += moved[0].clamp(-0.05, 0.05);
        line.curvature += moved[1].clamp(-0.1 / half, 0.1 / half);
        steps += 1;
        let shift = (moved[0] * half).abs() + (0.5 * moved[1] * half * half).abs();
        if shift < 1e-5 || steps == 25 {
            break (self::points(samples, &line, sides), error);
        }
    };
    let all = NormalEquations::new(&points, Knots { step, sides: room });
    let (spread, open) = choose(&all, penalty(&points, sides, step, width), room, width / step)?;
    line.offset += spread.crossing(0.5);
    let deviation = spread.variance().sqrt();
    Some(Fitted {
        line,
        spread,
        points,
        angle_error: error[0] * deviation,
        curvature_error: curved.then_some(error[1] * deviation),
        width,
        open,
    })
}

/// A spline that ends close to the edge, and its points: what lies beyond is left to the light.
pub(super) fn narrow(samples: &[Sample], line: &Line, width: f64) -> Option<(Spread, Vec<Point>)> {
    let width = width.max(0.5);
    let sides = sides(samples, line).map(|s| s.min(most(width)));
    let step = (width / KNOTS[1]).max(1.0 / KNOTS[0]);
    let near = sides.map(|s| (((s - FLAT).min(2.0 * width + 1.5) / step).ceil() as usize).max(2));
    let points = points(samples, line, sides);
    let spread =
        NormalEquations::new(&points, Knots { step, sides: near }).fit(penalty(&points, sides, step, width))?;
    Some((spread, points))
}

/// The penalty on third differences of coefficients: `ρ h⁻⁵ (2πf)⁻⁶` times what it may take off at the frequency `f`, at a
/// density of `ρ` samples a pixel.
fn penalty(points: &[Point], sides: [f64; 2], step: f64, width: f64) -> f64 {
    let density = points.len() as f64 / (sides[0] + sides[1]).max(1.0);
    let highest = 1.2 / width.max(0.8);
    PENALTY * density * step.powi(-5) * (std::f64::consts::TAU * highest).powi(-6)
}

/// The step of Gauss–Newton in angle and curvature with the spline's coefficients eliminated; their standard uncertainties for
/// samples of unit variance.
fn newton(points: &[Point], spread: &Spread, curved: bool) -> Option<([f64; 2], [f64; 2])> {
    let mut border = DMatrix::zeros(spread.knots.count(), 2);
    let (mut square, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for p in points {
        let slope = spread.slope(p.d);
        let r = p.value - spread.at(p.d);
        let u = Vector2::new(slope * p.t, if curved { -0.5 * slope * p.t * p.t } else { 0.0 });
        square += u * u.transpose();
        right += u * r;
        for (k, w) in spread.knots.row(p.d, false) {
            border[(k, 0)] += w * u[0];
            border[(k, 1)] += w * u[1];
        }
    }
    let inner = border.transpose() * spread.solve(&border);
    let mut schur = square - Matrix2::new(inner[(0, 0)], inner[(0, 1)], inner[(1, 0)], inner[(1, 1)]);
    if !curved {
        schur[(1, 1)] = 1.0;
    }
    let inverse = schur.try_inverse()?;
    let moved = inverse * right;
    let finite = moved.iter().chain(inverse.iter()).all(|v| v.is_finite());
    finite.then(|| ([moved[0], moved[1]], [inverse[(0, 0)], inverse[(1, 1)]].map(|v| v.max(0.0).sqrt())))
}

/// The narrowest and smoothest spline that does not leave more than noise behind: least Mallows' `Cp` over its ends, then over its
/// penalty. Also whether it is the widest.
fn choose(all: &NormalEquations, penalty: f64, room: [usize; 2], width: f64) -> Option<(Spread, bool)> {
    let widest = all.fit(penalty)?;
    let variance = widest.variance();
    let score = |s: &Spread, freedom: f64| s.residual / variance + 2.0 * freedom;
    let count = |s: &Spread| s.knots.count() as f64;
    let (mut best, mut least) = (room, score(&widest, count(&widest)));
    let most = room[0].max(room[1]) as f64;
    let mut n = (0.6 * width).max(2.0);
    while n < most {
        let sides = room.map(|r| r.min(n.round() as usize));
        if let Some(fit) = all.narrowed(sides).fit(penalty)
            && score(&fit, count(&fit)) < least
        {
            (best, least) = (sides, score(&fit, count(&fit)));
        }
        n = (1.15 * n).max(n + 1.0);
    }
    let open = best.iter().zip(room).any(|(s, r)| *s == r);
    let wider = |n: usize| (WIDER * n as f64).ceil() as usize;
    let sums = all.narrowed([0, 1].map(|i| room[i].min(wider(best[i]))));
    let (mut strength, mut least) = (1.0, f64::INFINITY);
    for power in 0..16 {
        let Some(fit) = sums.fit(penalty * STRONGER.powi(power)) else { break };
        let score = score(&fit, fit.freedom());
        if score < least {
            (least, strength) = (score, STRONGER.powi(power));
        }
    }
    // A penalty that balances its bias against noise would hide the bias in the noise: a weaker one leaves intervals true.
    Some((sums.fit(penalty * f64::max(strength / WEAKER, 1.0))?, open))
}
