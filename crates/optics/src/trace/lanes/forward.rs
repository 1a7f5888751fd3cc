//! One tile through one surface: plane, sphere and conic in closed form, even aspheres by Newton without roots.
//!
//! Every surface is written implicitly, with `w = z − P(ρ)` and `v = (1+κ)c`: `G = cρ/2 − w + vw²/2 = 0`, whose gradient
//! `N = (Ax, Ay, −φ)`, `A = c + 2P′φ`, `φ = 1 − vw`, points against the light. On a conic `q = −N·d` is the root of the
//! discriminant. Snell's law needs no unit normal: `d' = μd + γN`, `γ = (μ² − 1)/(μq + R)`, `R² = μ²q² + (1 − μ²) N·N`.
//! Each ray first advances to its point nearest the vertex, as in [`crate::trace::intersect`].
//!
//! A lane's numbers never depend on the other lanes. Where a lane is not certain of the plain trace's root, the plain
//! trace decides ([`mend`]): it stands for the accuracy and gives the failure's cause.

use super::mend::{Known, mend};
use super::program::Step;
use super::run::{AlignedFrame, Mode, Run, vectors};
use super::tile::Bundle;
use super::vector::{At, Lanes, Truth};
use isoplanat_base::math::simd::{F64, Simd, fresh};

/// Rays in registers, at their points nearest the vertex.
struct Near<S: F64> {
    x: Lanes<S>,
    y: Lanes<S>,
    z: Lanes<S>,
    l: Lanes<S>,
    m: Lanes<S>,
    n: Lanes<S>,
    /// Distance advanced.
    t: Lanes<S>,
}

impl<S: F64> Near<S> {
    #[inline(always)]
    fn load(here: At<S>, step: &Step, from: &Bundle) -> Self {
        let (x, y, z) =
            (here.load(&from.x), here.load(&from.y), here.load(&from.z) - here.splat(step.surface.distance));
        let (l, m, n) = (here.load(&from.l), here.load(&from.m), here.load(&from.n));
        let back = x.fma(l, y.fma(m, z * n));
        Self { x: back.fnma(l, x), y: back.fnma(m, y), z: back.fnma(n, z), l, m, n, t: -back }
    }

    /// Moves on by `s`.
    #[inline(always)]
    fn advance(&mut self, s: Lanes<S>) {
        self.x = s.fma(self.l, self.x);
        self.y = s.fma(self.m, self.y);
        self.z = s.fma(self.n, self.z);
        self.t = self.t + s;
    }

    /// `ρ`.
    #[inline(always)]
    fn rho(&self) -> Lanes<S> {
        self.x.fma(self.x, self.y * self.y)
    }
}

/// A point on the surface as [`finish`] takes it: `N = (nx, ny, −phi)`, `q = −N·d`, `1/q`, and which lanes are certain.
struct Met<S: F64> {
    nx: Lanes<S>,
    ny: Lanes<S>,
    phi: Lanes<S>,
    q: Lanes<S>,
    inverse_q: Lanes<S>,
    sound: Truth<S>,
    /// Lanes that have a root at least: which one it is may be proved yet.
    root: Truth<S>,
    /// Lanes that certainly miss.
    missed: Truth<S>,
}

/// Stores rays behind a surface, refracted, and lets the plain trace mend the lanes that are not certain. `limit_sq`
/// bounds `ρ`; `UNIT` says that `N` has length 1, `PROVE` that roots may be proved that are not certain yet.
#[inline(always)]
fn finish<S: Simd, M: Mode, const UNIT: bool, const PROVE: bool>(
    simd: S,
    step: &Step,
    run: &mut Run,
    at: usize,
    mut ray: Near<S::Wide>,
    met: Met<S::Wide>,
    limit_sq: f64,
) {
    let (here, lane) = (At { simd: simd.wide(), at }, at * S::Wide::LANES);
    let Met { nx, ny, phi, q, inverse_q, sound, root: found, missed } = met;
    // What every root has to pass; with those that are certain already, unless others may be proved.
    let limit = here.splat(limit_sq);
    let mut through = if PROVE { ray.rho().at_most(limit) } else { sound.and_at_most(ray.rho(), limit) };
    let (mut gamma, mut inverse_r) = (here.splat(0.0), here.splat(0.0));
    if step.refracts {
        let (mu, mu_sq, under, over);
        if M::SPECTRAL {
            mu = here.gather(&step.ratios, &run.colour[lane..]);
            mu_sq = mu * mu;
            (under, over) = (here.splat(1.0) - mu_sq, mu_sq - here.splat(1.0));
        } else {
            (mu, mu_sq) = (here.splat(step.mu), here.splat(step.mu_sq));
            (under, over) = (here.splat(step.under), here.splat(step.over));
        }
        let root;
        if UNIT {
            (root, inverse_r) = (mu_sq * q).fma(q, under).sqrt_and_inverse();
            gamma = mu * q - root;
        } else {
            let square = nx.fma(nx, ny.fma(ny, phi * phi));
            let r_sq = (mu_sq * q).fma(q, under * square);
            if M::RECORD {
                (root, inverse_r) = r_sq.sqrt_and_inverse();
            } else {
                root = r_sq.sqrt();
            }
            gamma = over / mu.fma(q, root);
        }
        through = through.and_less(here.splat(0.0), root);
        ray.l = mu.fma(ray.l, gamma * nx);
        ray.m = mu.fma(ray.m, gamma * ny);
        ray.n = gamma.fnma(phi, mu * ray.n);
    }
    here.store(ray.x, &mut run.to.x);
    here.store(ray.y, &mut run.to.y);
    here.store(ray.z, &mut run.to.z);
    here.store(ray.l, &mut run.to.l);
    here.store(ray.m, &mut run.to.m);
    here.store(ray.n, &mut run.to.n);
    if M::PATH {
        let before = here.load(&run.from.path);
        here.store(here.splat(step.surface.index_before).fma(ray.t, before), &mut run.to.path);
    }
    if M::RECORD {
        here.store(ray.t, &mut run.to.t);
        let extra = run.extra();
        here.store(gamma, &mut extra.gamma);
        here.store(inverse_r, &mut extra.inverse_r);
        here.store(inverse_q, &mut extra.inverse_q);
    }
    let through = through.bits();
    let fine = if PROVE { through & sound.bits() } else { through };
    let bad = (*run.alive >> lane) & !fine & lanes_mask(S::Wide::LANES);
    if bad != 0 {
        let found = if PROVE { found.bits() } else { 0 };
        let known = Known { sound: sound.bits(), found, through, missed: missed.bits() };
        mend::<S, M>(simd, step, run, lane, bad, known);
    }
}

#[inline(always)]
const fn lanes_mask(lanes: usize) -> u64 {
    if lanes >= 64 { u64::MAX } else { (1 << lanes) - 1 }
}

/// A tile through a plane.
#[inline(always)]
pub(super) fn plane<S: Simd, M: Mode>(simd: S, step: &Step, run: &mut Run) {
    AlignedFrame::hold();
    for at in vectors::<S::Wide>(run.len) {
        let here = At { simd: simd.wide(), at };
        let step = fresh(step);
        let (zero, one) = (here.splat(0.0), here.splat(1.0));
        let mut ray = Near::load(here, step, run.from);
        let inverse_q = one / ray.n;
        ray.advance(-(ray.z * inverse_q));
        ray.z = zero;
        keep_flat::<_, M>(here, step, run, zero);
        // Only light that goes on crosses a plane from before to behind.
        let sound = zero.less(ray.n);
        let missed = ray.n.less(zero);
        let met = Met { nx: zero, ny: zero, phi: one, q: ray.n, inverse_q, sound, root: sound, missed };
        finish::<S, M, true, false>(simd, step, run, at, ray, met, step.limit_sq);
    }
}

/// The record of a conic whose cotangent has polynomial terms: `w = z`, no slope.
#[inline(always)]
fn keep_flat<S: F64, M: Mode>(here: At<S>, step: &Step, run: &mut Run, w: Lanes<S>) {
    if M::RECORD && !step.surface.shape.asphere.is_empty() {
        let extra = run.extra();
        here.store(w, &mut extra.w);
        here.store(here.splat(0.0), &mut extra.slope);
    }
}

/// A tile through a sphere or a conic.
#[inline(always)]
pub(super) fn conic<S: Simd, M: Mode, const SPHERE: bool>(simd: S, step: &Step, run: &mut Run) {
    AlignedFrame::hold();
    for at in vectors::<S::Wide>(run.len) {
        let here = At { simd: simd.wide(), at };
        let step = fresh(step);
        let (zero, c, v) = (here.splat(0.0), here.splat(step.c), here.splat(step.v));
        let mut ray = Near::load(here, step, run.from);
        // A s² − 2B s + C = 0 from the point nearest the vertex, where p·d = 0.
        let (a, b, cc);
        if SPHERE {
            (a, b) = (c, ray.n);
            cc = c.fma(ray.z.fma(ray.z, ray.rho()), here.splat(-2.0) * ray.z);
        } else {
            let excess = here.splat(step.excess);
            a = excess.fma(ray.n * ray.n, c);
            b = (excess * ray.z).fnma(ray.n, ray.n);
            cc = c.fma(ray.rho(), v.fma(ray.z, here.splat(-2.0)) * ray.z);
        }
        let disc = a.fnma(cc, b * b);
        let (q, inverse_q) = disc.sqrt_and_inverse();
        ray.advance(cc / (b + q));
        let phi = v.fnma(ray.z, here.splat(1.0));
        keep_flat::<_, M>(here, step, run, ray.z);
        // The crossing from before to behind on the sheet of the vertex; B < 0 is left to the plain trace.
        let mut sound = zero.less(b).and_less(zero, phi);
        let missed = zero.less(b).and_less(disc, zero);
        if M::RECORD {
            // A ray that touches has no derivative.
            sound = sound.and_less(zero, q);
        }
        let met = Met { nx: c * ray.x, ny: c * ray.y, phi, q, inverse_q, sound, root: sound, missed };
        finish::<S, M, SPHERE, false>(simd, step, run, at, ray, met, step.limit_sq);
    }
}

/// Newton steps before the plain trace takes over.
const ITERATIONS: u32 = 8;

/// A tile through a conic with `N` even terms.
#[inline(always)]
pub(super) fn even<S: Simd, M: Mode, const N: usize>(simd: S, step: &Step, run: &mut Run) {
    AlignedFrame::hold();
    for at in vectors::<S::Wide>(run.len) {
        let here = At { simd: simd.wide(), at };
        let step = fresh(step);
        let mut ray = Near::load(here, step, run.from);
        // The start: near enough, so rough roots and inverses will do.
        let [u, s, excess] = step.start;
        let b = (here.splat(excess) * ray.z).fnma(ray.n, ray.n);
        let cc = here.splat(u).fma(ray.rho(), here.splat(s).fma(ray.z, here.splat(-2.0)) * ray.z);
        let a = here.splat(excess).fma(ray.n * ray.n, here.splat(u));
        let disc = a.fnma(cc, b * b).max(here.splat(f64::MIN_POSITIVE));
        ray.advance(cc * disc.fma(disc.rough_inverse_sqrt(), b).rough_inverse());
        let dead = !*run.alive >> (at * S::Wide::LANES);
        let full = lanes_mask(S::Wide::LANES);
        let mut rounds = 0;
        let (mut w, mut slope, mut a, mut dot, mut q, mut g, mut phi, mut done, mut rho);
        loop {
            rho = ray.rho();
            let mut p = here.splat(step.terms[N - 1]);
            slope = here.splat(step.terms1[N - 1]);
            for i in (0..N - 1).rev() {
                p = p.fma(rho, here.splat(step.terms[i]));
                slope = slope.fma(rho, here.splat(step.terms1[i]));
            }
            w = rho.fnma(p, ray.z);
            phi = here.splat(step.v).fnma(w, here.splat(1.0));
            g = here.splat(step.half_v).fma(w, here.splat(-1.0)).fma(w, here.splat(step.half_c) * rho);
            a = slope.fma(phi, here.splat(step.c));
            dot = ray.x.fma(ray.l, ray.y * ray.m);
            q = a.fnma(dot, phi * ray.n);
            let forth = g * q.rough_inverse();
            done = forth.abs().at_most(here.splat(step.small));
            if (done.bits() | dead) & full == full || rounds == ITERATIONS {
                break;
            }
            // Lanes that are done stay where they are, whatever their neighbours need.
            ray.advance(forth.zero_where(done));
            rounds += 1;
        }
        // The last step is small: everything follows it to first order.
        let rough = q.rough_inverse();
        let forth = g * (rough * q.fnma(rough, here.splat(2.0)));
        let mut bend = here.splat(step.terms2[N - 1]);
        for i in (1..N - 1).rev() {
            bend = bend.fma(rho, here.splat(step.terms2[i]));
        }
        ray.advance(forth);
        let half_d_rho = dot * forth;
        w = slope.fnma(half_d_rho, forth.fma(ray.n, w));
        slope = bend.fma(half_d_rho + half_d_rho, slope);
        phi = here.splat(step.v).fnma(w, here.splat(1.0));
        a = slope.fma(phi, here.splat(step.c));
        let sideways = ray.l.fma(ray.l, ray.m * ray.m);
        dot = forth.fma(sideways, dot);
        q = a.fnma(dot, phi * ray.n);
        // On the vertex's sheet, and certainly the only root in the cylinder.
        let root = done.and_less(here.splat(0.0), phi).and_less(here.splat(0.0), ray.n);
        let mut sound = root
            .and_less(here.splat(step.steepest_sq) * sideways, ray.n * ray.n)
            .and_at_most(ray.rho(), here.splat(step.domain_sq));
        if step.from_within {
            let (x, y) = (here.load(&run.from.x), here.load(&run.from.y));
            sound = sound.and_at_most(x.fma(x, y * y), here.splat(step.domain_sq));
        }
        let mut inverse_q = here.splat(0.0);
        if M::RECORD {
            inverse_q = here.splat(1.0) / q;
            let extra = run.extra();
            here.store(w, &mut extra.w);
            here.store(slope, &mut extra.slope);
        }
        let missed = here.splat(1.0).less(here.splat(0.0));
        let met = Met { nx: a * ray.x, ny: a * ray.y, phi, q, inverse_q, sound, root, missed };
        finish::<S, M, false, true>(simd, step, run, at, ray, met, step.limit_sq);
    }
}
