//! What a picture's white and black squares are where no edge is near: smooth over the picture, as light and print are.

use glam::DVec2;
use nalgebra::{DMatrix, DVector};

use super::Pixels;
use super::board::Board;
use isoplanat_base::error::{Error, Result};

/// Degree of the polynomials over the picture.
const DEGREE: usize = 3;
/// Pixels that are tried, and that are used at least for each of both.
const TRIED: usize = 60_000;
const LEAST: usize = 60;
/// Pixels farther than so many deviations from the fit are dust or shadow, in the second round.
const FAR: f64 = 4.0;
/// Share of the clear pixels that may be cut off (hot ones are).
const CUT: f64 = 0.01;
/// Contrast of white over black at least, of white.
const CONTRAST: f64 = 0.1;

/// Levels of one channel of one picture.
#[derive(Clone, Debug)]
pub(super) struct Levels {
    span: [[f64; 2]; 2],
    /// Of odd and even squares.
    terms: [DVector<f64>; 2],
    /// Root mean square distance of clear pixels from the fit, of the contrast in the middle: noise, paper.
    pub(super) noise: f64,
}

impl Levels {
    /// Fits clear pixels, `reach_px` and more from any edge.
    pub(super) fn fit(pixels: &Pixels<'_>, channel: usize, board: &Board, reach_px: f64, seed: u64) -> Result<Self> {
        let rng = &mut fastrand::Rng::with_seed(seed);
        let (plane, sites) = &pixels.channels[channel];
        let (rows, columns) = plane.dim();
        let inside = |[low, high]: [f64; 2], n: usize| [low.max(0.0), high.min(n as f64)];
        let (x, y) = (inside(board.span[0], columns), inside(board.span[1], rows));
        let span = [x, y];
        let mut cut = 0;
        let mut clear: [Vec<(DVec2, f64)>; 2] = [Vec::new(), Vec::new()];
        let size = [x[1] - x[0], y[1] - y[0]];
        if size.iter().all(|s| *s >= 1.0) {
            for _ in 0..TRIED {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside the picture")]
                let (c, r) = ((x[0] + rng.f64() * size[0]) as usize, (y[0] + rng.f64() * size[1]) as usize);
                if c >= columns || r >= rows || !sites.has(r, c) {
                    continue;
                }
                let at = DVec2::new(c as f64 + 0.5, r as f64 + 0.5);
                if let Some((spot, far)) = board.clear_px(at)
                    && far > reach_px + 1.0
                {
                    let value = plane[[r, c]];
                    if pixels.range.is_some_and(|[low, high]| value <= low || value >= high) {
                        cut += 1;
                    } else if value.is_finite() {
                        clear[usize::from(spot.even)].push((at, value));
                    }
                }
            }
        }
        let all = cut + clear.iter().map(Vec::len).sum::<usize>();
        if cut as f64 > CUT * all as f64 {
            let found = format!("{cut} of {all} pixels of its squares are cut off at white or black");
            return Err(Error::bad("", "chart", found, "an exposure between black and white"));
        }
        let fewest = clear.iter().map(Vec::len).min().unwrap_or(0);
        if fewest < LEAST {
            let found = format!("{fewest} pixels of a colour that are clear of every edge");
            let allowed = format!("{LEAST}: larger squares, a smaller reach");
            return Err(Error::bad("", "chart", found, allowed));
        }
        let mut levels = Self { span, terms: [DVector::zeros(1), DVector::zeros(1)], noise: 0.0 };
        let (mut square, mut count) = (0.0, 0.0);
        for (terms, mut pixels) in levels.terms.iter_mut().zip(clear) {
            let mut fitted = solve(span, &pixels)?;
            let off = |t: &DVector<f64>, (at, v): &(DVec2, f64)| v - value(t, span, *at);
            let spread = (pixels.iter().map(|p| off(&fitted, p).powi(2)).sum::<f64>() / pixels.len() as f64).sqrt();
            pixels.retain(|p| off(&fitted, p).abs() <= FAR * spread);
            fitted = solve(span, &pixels)?;
            square += pixels.iter().map(|p| off(&fitted, p).powi(2)).sum::<f64>();
            count += pixels.len() as f64;
            *terms = fitted;
        }
        let middle = DVec2::new(0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1]));
        let [odd, even] = levels.at(middle);
        let contrast = (even - odd).abs();
        if contrast.is_nan() || contrast < CONTRAST * even.max(odd) {
            let found = format!("levels of {odd:.4} and {even:.4}");
            return Err(Error::bad("", "chart", found, "black and white squares"));
        }
        levels.noise = f64::sqrt(square / count) / contrast;
        Ok(levels)
    }

    /// Levels of odd and even squares at a point of the picture.
    pub(super) fn at(&self, at: DVec2) -> [f64; 2] {
        [0, 1].map(|k| value(&self.terms[k], self.span, at))
    }
}

fn basis(span: [[f64; 2]; 2], at: DVec2, mut take: impl FnMut(f64)) {
    let unit = |[low, high]: [f64; 2], v: f64| (2.0 * v - low - high) / (high - low);
    let (x, y) = (unit(span[0], at.x), unit(span[1], at.y));
    for p in 0..=DEGREE {
        for q in 0..=DEGREE - p {
            take(x.powi(p as i32) * y.powi(q as i32));
        }
    }
}

fn value(terms: &DVector<f64>, span: [[f64; 2]; 2], at: DVec2) -> f64 {
    let (mut sum, mut k) = (0.0, 0);
    basis(span, at, |v| {
        sum += v * terms[k];
        k += 1;
    });
    sum
}

/// Least squares.
fn solve(span: [[f64; 2]; 2], pixels: &[(DVec2, f64)]) -> Result<DVector<f64>> {
    let count = (DEGREE + 1) * (DEGREE + 2) / 2;
    let (mut matrix, mut right) = (DMatrix::<f64>::zeros(count, count), DVector::<f64>::zeros(count));
    for (at, v) in pixels {
        let mut row = Vec::with_capacity(count);
        basis(span, *at, |b| row.push(b));
        for (i, a) in row.iter().enumerate() {
            right[i] += a * v;
            row.iter().enumerate().for_each(|(j, b)| matrix[(i, j)] += a * b);
        }
    }
    // Pixels in one corner of the picture tell few of the terms.
    let ridge = 1e-9 * matrix[(0, 0)].max(1.0);
    (0..count).for_each(|i| matrix[(i, i)] += ridge);
    let solved = matrix.cholesky().map(|c| c.solve(&right)).filter(|t| t.iter().all(|v| v.is_finite()));
    solved.ok_or_else(|| Error::bad("", "chart", "levels that are no numbers", "a picture with finite values"))
}
