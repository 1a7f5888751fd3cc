//! Bounds of an even asphere's curvature, ring by ring.

use crate::lens::Shape;

/// Rings of equal area that the domain's disk is cut into.
const RINGS: usize = 64;

/// Bounds are widened by this part: far more than the rounding of their sums, far less than matters.
pub(super) const MARGIN: f64 = 1e-9;

/// Bounds of an even asphere's curvature.
#[derive(Clone, Debug)]
pub(super) struct Bends {
    /// `(1+κ)c²`.
    pub(super) alpha: f64,
    /// Radius squared of the surface's domain, mm².
    pub(super) domain_sq: f64,
    /// Rings in a mm².
    per_square: f64,
    /// Largest `|h_rr|` and `|h_r/r|` from the axis up to the outer edge of every ring, 1/mm.
    rings: [f64; RINGS],
}

impl Bends {
    /// Of `shape` with even terms, up to `domain`; none where that has no end.
    pub(super) fn new(shape: &Shape, domain: f64) -> Option<Self> {
        let alpha = (1.0 + shape.conic) * shape.curvature * shape.curvature;
        let domain_sq = domain * domain;
        if !(domain_sq.is_finite() && domain_sq > 0.0) {
            return None;
        }
        let edge = |i: usize| domain_sq * i as f64 / RINGS as f64;
        let mut largest = 0.0f64;
        let rings = std::array::from_fn(|i| {
            largest = largest.max(ring(shape, alpha, [edge(i), edge(i + 1) * (1.0 + MARGIN)]));
            largest * (1.0 + MARGIN)
        });
        Some(Self { alpha, domain_sq, per_square: RINGS as f64 / domain_sq, rings })
    }

    /// The bound up to `ρ`.
    #[inline(always)]
    pub(super) fn up_to(&self, rho: f64) -> f64 {
        self.rings[((rho * self.per_square) as usize).min(RINGS - 1)]
    }
}

/// Bound of both principal curvatures of `h`, `h_r/r` and `h_rr`, for `ρ` in `a..=b`.
///
/// Those of the conic are monotonic, and so are the terms of each sign.
fn ring(shape: &Shape, alpha: f64, [a, b]: [f64; 2]) -> f64 {
    let inverse = |rho: f64| {
        let square = 1.0 - alpha * rho;
        if square > 0.0 { square.sqrt().recip() } else { f64::INFINITY }
    };
    // Σ 2i f(i) a_i ρ^{i−1} over the terms of one sign.
    let terms = |rho: f64, sign: f64, across: bool| {
        let (mut sum, mut power) = (0.0, 1.0);
        for (i, term) in shape.asphere.iter().enumerate() {
            let order = 2.0 * (i + 1) as f64;
            let factor = if across { order } else { order * (order - 1.0) };
            sum += factor * (term * sign).max(0.0) * power;
            power *= rho;
        }
        sum
    };
    let bound = |across: bool| {
        let conic = |rho: f64| shape.curvature * inverse(rho).powi(if across { 1 } else { 3 });
        let (c_a, c_b) = if shape.curvature == 0.0 { (0.0, 0.0) } else { (conic(a), conic(b)) };
        let high = c_a.max(c_b) + terms(b, 1.0, across) - terms(a, -1.0, across);
        let low = c_a.min(c_b) + terms(a, 1.0, across) - terms(b, -1.0, across);
        // Sums beyond f64 bound nothing.
        if high.is_nan() || low.is_nan() { f64::INFINITY } else { high.abs().max(low.abs()) }
    };
    bound(true).max(bound(false))
}
