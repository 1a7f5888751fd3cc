//! What rounding of the values leaves unknown about the levels on both sides of an edge.
//!
//! A level between two steps of `q` is off by up to half a step wherever noise of deviation `s` does not carry values across
//! steps: uniformly, `q/√12`, less the factor `exp(−2π²s²/q²)` by which Gaussian noise averages the rounding out.

use super::spread::{Point, Spread};

/// Standard uncertainty of the contrast through rounding, relative to the contrast.
pub(super) fn rounding(spread: &Spread, points: &[Point]) -> f64 {
    let mut values: Vec<f64> = points.iter().map(|p| p.value).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    let ([low, high], [before, behind]) = (spread.levels(), spread.knots.reach());
    let side = |level: f64, beside: &dyn Fn(f64) -> bool| -> f64 {
        let off = points.iter().filter(|p| beside(p.d)).map(|p| (p.value - level).powi(2));
        let (count, squares) = off.fold((0.0, 0.0), |(n, s), v| (n + 1.0, s + v));
        let at = values.partition_point(|v| *v < level);
        // Steps between the values around the level.
        let around = &values[at.saturating_sub(2)..(at + 2).min(values.len())];
        let step = around.windows(2).map(|w| w[1] - w[0]).fold(f64::INFINITY, f64::min);
        if !step.is_finite() {
            return 0.0;
        }
        let noise = squares / f64::max(count, 1.0);
        step / 12f64.sqrt() * (-2.0 * std::f64::consts::PI.powi(2) * noise / (step * step)).exp()
    };
    side(low, &|d| d < -before).hypot(side(high, &|d| d > behind)) / (high - low)
}
