//! The MTF of a fitted spread function, its uncertainty, and where it crosses a level.
//!
//! The line spread function is a quadratic spline: `Σ Δ_k B₂` with `Δ_k = c_k − c_{k−1}`, whose Fourier transform is
//! `sinc³(fh) Σ Δ_k exp(−2πi f x)`; over its value at 0 this is the transfer function along the edge's normal, exactly. Its
//! covariance comes from the residuals themselves, summed over groups of rows across the edge (White's estimator by clusters: H.
//! White, Econometrica 48, 1980; C. Cameron, D. Miller, J. Human Resources 50, 2015), so that noise may grow with the signal
//! and neighbours across the edge may be correlated. The mean square of the noise is taken off the modulus.

use nalgebra::{DMatrix, DVector};

use super::shade::{Beside, COUNT};
use super::spread::{Point, Spread};

/// One point of an MTF.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct MtfPoint {
    /// Frequency along the edge's normal, cycles a pixel.
    #[serde(rename = "frequency_cy_per_px", serialize_with = "rounded")]
    pub frequency: f64,
    /// Modulation, 1 at frequency 0.
    pub value: f64,
    /// Standard uncertainty of the modulation.
    pub uncertainty: f64,
}

/// A frequency without the rounding of its sum.
fn rounded<S: serde::Serializer>(frequency: &f64, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_f64((frequency * 1e4).round() / 1e4)
}

/// Where an MTF first falls below a level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Frequency, cycles a pixel.
    pub frequency: f64,
    /// The 95 % interval; its end is infinite where the MTF may not fall below the level at any frequency that was measured.
    pub interval: [f64; 2],
}

/// Groups of rows that are taken as independent, at most.
const CLUSTERS: usize = 64;
/// The estimator's own error in modulation, by its tests; in every uncertainty.
const OWN_ERROR: f64 = 1e-4;
/// Steps of the curve on which crossings are sought.
const FINE: f64 = 0.0025;
/// Steps for which the upper end of the band about a curve stays below a level behind its crossing.
const STAY: usize = 8;

/// Modulation at rising frequencies.
#[derive(Clone, Debug)]
pub(super) struct Transfer {
    pub(super) curve: Vec<MtfPoint>,
    /// Half of a 95 % interval over its standard uncertainty.
    pub(super) coverage: f64,
}

impl Transfer {
    /// Up to `highest` cycles a pixel; `rounding` is the relative uncertainty of the contrast beyond noise, `light` the slopes that were
    /// fitted with the spline.
    pub(super) fn new(spread: &Spread, points: &[Point], highest: f64, rounding: f64, light: Option<&Beside>) -> Self {
        let count = (highest / FINE + 1e-9).floor() as usize + 1;
        let frequencies: Vec<f64> = (0..count).map(|i| FINE * i as f64).collect();
        let (values, functionals) = linear(spread, &frequencies);
        let (scores, coverage) = scores(spread, points, light);
        // Each row of `parts` is one group's share in the error of every real and imaginary part.
        let n = spread.knots.count();
        let alone = spread.solve(&functionals);
        let parts = match light {
            None => scores.transpose() * alone,
            Some(light) => {
                let (coefficients, slopes) = light.joint(alone);
                let (own, beside) = (scores.rows(0, n), scores.rows(n, scores.nrows() - n));
                own.transpose() * coefficients + beside.transpose() * slopes
            }
        };
        let point = |(i, [re, im]): (usize, &[f64; 2])| {
            let (mut rr, mut ri, mut ii) = (0.0, 0.0, 0.0);
            for row in parts.row_iter() {
                let (a, b) = (row[2 * i], row[2 * i + 1]);
                (rr, ri, ii) = (rr + a * a, ri + a * b, ii + b * b);
            }
            let (square, noise) = (re * re + im * im, rr + ii);
            // Noise across the transfer function lengthens it by half its mean square; where there is little but noise, and
            // frequencies to choose from, its peaks go too.
            let ratio = square / noise.max(f64::MIN_POSITIVE);
            let taken = noise * (0.5 + 2.0 * (-0.25 * ratio).exp());
            let value = (square - taken).max(0.0).sqrt();
            // Along the transfer function where it is known, in any direction where it is not.
            let along = (re * re * rr + 2.0 * re * im * ri + im * im * ii) / square.max(f64::MIN_POSITIVE);
            let share = (value * value / square.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            let variance = share * along + (1.0 - share) * 0.5 * noise;
            let own = if i == 0 { 0.0 } else { OWN_ERROR.hypot(rounding) };
            MtfPoint { frequency: frequencies[i], value, uncertainty: (variance.max(0.0) + own * own).sqrt() }
        };
        Self { curve: values.iter().enumerate().map(point).collect(), coverage }
    }

    /// Where the modulation first falls below `level`; `None` where it does not.
    pub(super) fn crossing(&self, level: f64) -> Option<Crossing> {
        let below = |shift: f64, from: usize| -> Option<(usize, f64)> {
            let y = |p: &MtfPoint| p.value + shift * self.coverage * p.uncertainty - level;
            let pairs = self.curve.windows(2).enumerate().skip(from);
            // What may still be noise about the level has to stay below for a while.
            let stays = |i: usize| shift <= 0.0 || self.curve[i + 1..].iter().take(STAY).all(|p| y(p) < 0.0);
            let mut falls = pairs.filter(|(i, w)| y(&w[0]) >= 0.0 && y(&w[1]) < 0.0 && stays(*i));
            falls.next().map(|(i, w)| (i, w[0].frequency + FINE * y(&w[0]) / (y(&w[0]) - y(&w[1]))))
        };
        let (at, frequency) = below(0.0, 0)?;
        let (first, low) = below(-1.0, 0)?;
        let high = below(1.0, first.saturating_sub(1)).map_or(f64::INFINITY, |b| b.1);
        // Noise that makes the curve steep here by chance does not make it certain: at least what a Gaussian of this crossing has.
        let half = self.coverage * self.curve[at].uncertainty * frequency / (2.0 * level * (1.0 / level).ln());
        let (low, high) = (low.min(frequency - half).max(0.0), high.max(frequency + half));
        Some(Crossing { frequency, interval: [low, high] })
    }
}

/// Transfer function, and how its real and imaginary parts (columns in turn) move with every coefficient.
fn linear(spread: &Spread, frequencies: &[f64]) -> (Vec<[f64; 2]>, DMatrix<f64>) {
    let (knots, c) = (spread.knots, &spread.coefficients);
    let [low, high] = spread.levels();
    let contrast = high - low;
    let n = knots.count();
    let mut values = Vec::with_capacity(frequencies.len());
    let mut functionals = DMatrix::zeros(n, 2 * frequencies.len());
    for (i, f) in frequencies.iter().enumerate() {
        let width = sinc(f * knots.step).powi(3);
        let wave: Vec<[f64; 2]> = (1..n)
            .map(|k| {
                let (sin, cos) = (std::f64::consts::TAU * f * (knots.place(k) - 0.5 * knots.step)).sin_cos();
                [width * cos, -width * sin]
            })
            .collect();
        let mut z = [0.0; 2];
        for (k, w) in wave.iter().enumerate() {
            let step = (c[k + 1] - c[k]) / contrast;
            z = [z[0] + step * w[0], z[1] + step * w[1]];
        }
        for part in 0..2 {
            let mut column = functionals.column_mut(2 * i + part);
            for (k, w) in wave.iter().enumerate() {
                column[k + 1] += w[part] / contrast;
                column[k] -= w[part] / contrast;
            }
            column[n - 1] -= z[part] / contrast;
            column[0] += z[part] / contrast;
        }
        values.push(z);
    }
    (values, functionals)
}

/// Sums of residuals times basis functions (then the light's) over each group of rows, one column a group; and the factor of a 95 % interval.
fn scores(spread: &Spread, points: &[Point], light: Option<&Beside>) -> (DMatrix<f64>, f64) {
    let (first, last) = points.iter().fold((usize::MAX, 0), |(a, b), p| (a.min(p.across), b.max(p.across)));
    let rows = last.saturating_sub(first) + 1;
    let thick = rows.div_ceil(CLUSTERS);
    let n = spread.knots.count();
    let mut sums = DMatrix::zeros(n + if light.is_some() { COUNT } else { 0 }, rows.div_ceil(thick));
    let leverages = spread.leverages(points);
    for (p, leverage) in points.iter().zip(leverages) {
        // A residual is smaller than the error by the root of what the fit leaves free.
        let r = (p.value - spread.at(p.d)) / (1.0 - leverage).max(0.05).sqrt();
        let mut column = sums.column_mut((p.across - first) / thick);
        spread.knots.row(p.d, false).into_iter().for_each(|(k, w)| column[k] += w * r);
        if let Some(light) = light {
            light.columns(p).into_iter().enumerate().for_each(|(k, w)| column[n + k] += w * r);
        }
    }
    let used = sums.column_iter().filter(|c| c.iter().any(|v| *v != 0.0)).count();
    (sums, student(used.saturating_sub(1).max(2) as f64))
}

/// The 97.5 % quantile of Student's distribution (Cornish–Fisher; 0.3 % from 4 degrees of freedom on).
fn student(freedom: f64) -> f64 {
    const Z: f64 = 1.959_964;
    let [a, b, c] = [
        (Z.powi(3) + Z) / 4.0,
        (5.0 * Z.powi(5) + 16.0 * Z.powi(3) + 3.0 * Z) / 96.0,
        (3.0 * Z.powi(7) + 19.0 * Z.powi(5) + 17.0 * Z.powi(3) - 15.0 * Z) / 384.0,
    ];
    Z + a / freedom + b / freedom.powi(2) + c / freedom.powi(3)
}

fn sinc(x: f64) -> f64 {
    let y = std::f64::consts::PI * x;
    if y.abs() < 1e-9 { 1.0 } else { y.sin() / y }
}

/// Distances and values of a spread function, normalised, and its slope, 1/px, in steps of an eighth of a pixel or of a knot.
pub(super) fn drawn(spread: &Spread) -> Vec<[f64; 3]> {
    let [low, high] = spread.levels();
    let [before, behind] = spread.knots.reach();
    let step = spread.knots.step.min(0.25) * 0.5;
    let count = ((before + behind + 2.0) / step).floor() as usize;
    let values = DVector::from_fn(count + 1, |i, _| -before - 1.0 + i as f64 * step);
    values.iter().map(|d| [*d, (spread.at(*d) - low) / (high - low), spread.slope(*d) / (high - low)]).collect()
}
