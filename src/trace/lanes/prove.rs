//! Which root of ray ∩ asphere is certainly the plain trace's, where the slope of the whole surface does not tell.
//!
//! The plain trace takes the crossing nearest the ray's origin, or nearest the place where the ray enters the surface's
//! domain ([`crate::trace::first_root`]). Between a root and that start the ray is cut into pieces. On a piece
//! `F = h − z` along the ray has the second derivative `dᵀ∇∇h d`, which is at most the largest principal curvature of
//! `h` up to the piece's larger radius ([`bends`]) times `|d_xy|²`; with value and slope in its middle that bounds `F`
//! and `F'` on all of it. The root is the nearest one if the piece that ends there falls all the way and every other
//! piece either falls or keeps the sign that `F` has before the root. What is not proved so is left to the plain trace.

use super::forward::Run;
use super::program::Step;
use super::tile::TILE;
use super::vector::{At, Lanes};
use crate::lens::Shape;
use crate::math::simd::{F64, Simd};

/// Rings of equal area that the domain's disk is cut into.
const RINGS: usize = 64;

/// Numbers of pieces that are tried.
const PIECES: [u32; 3] = [1, 4, 16];

/// Bounds are widened by this part: far more than the rounding of their sums, far less than matters.
const MARGIN: f64 = 1e-9;

/// Bounds of an even asphere's curvature.
#[derive(Clone, Debug)]
pub(super) struct Bends {
    /// `(1+κ)c²`.
    alpha: f64,
    /// Radius squared of the surface's domain, mm².
    domain_sq: f64,
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
    fn up_to(&self, rho: f64) -> f64 {
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

/// Lanes `at + i`, for bits `i` of `unsure`, whose root, stored behind the surface, lies within the domain and is
/// certainly the one that the plain trace takes. `at` is the first lane of a vector.
#[inline(always)]
pub(super) fn prove<S: Simd, const N: usize>(simd: S, step: &Step, run: &Run, at: usize, unsure: u64) -> u64 {
    let Some(bends) = &step.bends else { return 0 };
    let simd = simd.doubles();
    let lanes = <S::Doubles as F64>::LANES;
    let mut proved = 0;
    for first in (0..TILE - at).step_by(lanes) {
        let asked = (unsure >> first) & (u64::MAX >> (u64::BITS as usize - lanes));
        if asked != 0 {
            let chord = Chord::load(At { simd, at: (at + first) / lanes }, bends, step, run);
            proved |= chord.prove::<N>(simd, bends, step, asked) << first;
        }
    }
    proved
}

/// The ray from a root back to its start.
struct Chord<S: F64> {
    /// The root.
    x: Lanes<S>,
    y: Lanes<S>,
    z: Lanes<S>,
    l: Lanes<S>,
    m: Lanes<S>,
    n: Lanes<S>,
    /// `|d_xy|²`.
    sideways: Lanes<S>,
    /// Distance from the start to the root along the ray; negative where the start lies behind the surface.
    length: Lanes<S>,
    /// Lanes whose root lies within the domain.
    inside: u64,
}

impl<S: F64> Chord<S> {
    #[inline(always)]
    fn load(here: At<S>, bends: &Bends, step: &Step, run: &Run) -> Self {
        let (from, to) = (&*run.from, &*run.to);
        let (x, y, z) = (here.load(&to.x), here.load(&to.y), here.load(&to.z));
        let (l, m, n) = (here.load(&from.l), here.load(&from.m), here.load(&from.n));
        let [dx, dy] = [x - here.load(&from.x), y - here.load(&from.y)];
        let dz = z - (here.load(&from.z) - here.splat(step.surface.distance));
        let full = dx.fma(l, dy.fma(m, dz * n));
        // Where the ray, seen from the root, leaves the domain on both sides: `ρ(τ) = ρ − 2bτ + |d_xy|²τ²`.
        let sideways = l.fma(l, m * m);
        let (rho, b) = (x.fma(x, y * y), x.fma(l, y * m));
        let domain_sq = here.splat(bends.domain_sq);
        let root = b.fma(b, sideways * (domain_sq - rho)).sqrt();
        let (back, forth) = ((b + root) / sideways, (root - b) / sideways);
        // Without a way sideways there are no such places, and `max` gives its second argument.
        let length = -((-back).max(-(-forth).max(full)));
        Self { x, y, z, l, m, n, sideways, length, inside: rho.at_most(domain_sq).bits() }
    }

    /// Lanes of `asked` that are proved.
    #[inline(always)]
    fn prove<const N: usize>(&self, simd: S, bends: &Bends, step: &Step, asked: u64) -> u64 {
        let mut proved = 0;
        for pieces in PIECES {
            let mut left = asked & self.inside & !proved;
            for piece in 0..pieces {
                if left == 0 {
                    break;
                }
                left &= self.piece::<N>(simd, bends, step, piece, pieces);
            }
            proved |= left;
        }
        proved
    }

    /// Lanes in which `F` falls along the piece, or, where it is not the first from the root, has no zero on it.
    #[inline(always)]
    fn piece<const N: usize>(&self, simd: S, bends: &Bends, step: &Step, piece: u32, pieces: u32) -> u64 {
        let here = At { simd, at: 0 };
        let (one, widened) = (here.splat(1.0), here.splat(1.0 + MARGIN));
        let place = |share: f64| {
            let back = self.length * here.splat(share);
            (back.fnma(self.l, self.x), back.fnma(self.m, self.y), back.fnma(self.n, self.z))
        };
        let share = f64::from(pieces).recip();
        // The largest radius on the piece is that of an end.
        let end = |i: u32| {
            let (x, y, _) = place(f64::from(i) * share);
            x.fma(x, y * y)
        };
        let bend = bound(simd, bends, end(piece).max(end(piece + 1)));
        let (x, y, z) = place((f64::from(piece) + 0.5) * share);
        let rho = x.fma(x, y * y);
        let (phi, inverse_phi) = here.splat(bends.alpha).fnma(rho, one).sqrt_and_inverse();
        let mut p = here.splat(step.terms[N - 1]);
        let mut slope = here.splat(step.terms1[N - 1]);
        for i in (0..N - 1).rev() {
            p = p.fma(rho, here.splat(step.terms[i]));
            slope = slope.fma(rho, here.splat(step.terms1[i]));
        }
        slope = here.splat(step.c).fma(inverse_phi, slope);
        let falls = slope.fma(x.fma(self.l, y * self.m), -self.n);
        // Half the piece, and how far the slope may turn on it.
        let half = (self.length * here.splat(0.5 * share)).abs();
        let turn = bend * self.sideways * half * widened;
        let mut sure = (falls + turn).less(here.splat(-MARGIN)).bits();
        if piece > 0 {
            let f = (here.splat(step.c) / (one + phi) + p).fma(rho, -z);
            // Before the surface where the ray comes from before it, behind it where it starts there.
            let sign = self.length / self.length.abs();
            let reach = (falls.abs() + turn) * half;
            sure |= (reach * widened + here.splat(MARGIN * bends.domain_sq.sqrt())).less(f * sign).bits();
        }
        sure
    }
}

/// [`Bends::up_to`] of every lane.
#[inline(always)]
fn bound<S: F64>(simd: S, bends: &Bends, rho: Lanes<S>) -> Lanes<S> {
    let mut all = [0.0; TILE];
    let here = At { simd, at: 0 };
    here.store(rho, &mut all);
    all[..S::LANES].iter_mut().for_each(|value| *value = bends.up_to(*value));
    here.load(&all)
}
