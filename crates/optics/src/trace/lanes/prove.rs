//! Which root of ray ∩ asphere is certainly the plain trace's, where the slope of the whole surface does not tell.
//!
//! The plain trace takes the crossing nearest the ray's origin, or nearest the place where the ray enters the surface's
//! domain ([`crate::trace::first_root`]). Between a root and that start the ray is cut into pieces. On a piece
//! `F = h − z` along the ray has the second derivative `dᵀ∇∇h d`, which is at most the largest principal curvature of
//! `h` up to the piece's larger radius ([`Bends`]) times `|d_xy|²`; with value and slope in its middle that bounds `F`
//! and `F'` on all of it. The root is the nearest one if the piece that ends there falls all the way and every other
//! piece either falls or keeps the sign that `F` has before the root. What is not proved so is left to the plain trace.

use super::bends::{Bends, MARGIN};
use super::program::Step;
use super::run::Run;
use super::terms::with_terms;
use super::tile::TILE;
use super::vector::{At, Lanes};
use isoplanat_base::math::simd::{F64, Kernel, Simd};

/// Numbers of pieces that are tried.
const PIECES: [u32; 3] = [1, 4, 16];

/// Lanes `at + i`, for bits `i` of `unsure`, whose root, stored behind the surface, lies within the domain and is
/// certainly the one that the plain trace takes. `at` is the first lane of a vector.
pub(super) fn prove<S: Simd>(simd: S, step: &Step, run: &Run, at: usize, unsure: u64) -> u64 {
    with_terms!(step.count, N => simd.run(Sure::<N> { step, run, at, unsure }))
}

struct Sure<'a, 'b, const N: usize> {
    step: &'a Step,
    run: &'a Run<'b>,
    at: usize,
    unsure: u64,
}

impl<const N: usize> Kernel for Sure<'_, '_, N> {
    type Output = u64;
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> u64 {
        chords::<S, N>(simd, self.step, self.run, self.at, self.unsure)
    }
}

#[inline(always)]
fn chords<S: Simd, const N: usize>(simd: S, step: &Step, run: &Run, at: usize, unsure: u64) -> u64 {
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
