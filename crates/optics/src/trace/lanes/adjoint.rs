//! One tile back through one surface.
//!
//! With `N`, `γ`, `q`, `R` of [`super::forward`], the cotangent `d̄'` of `d' = μd + γN` leaves as
//! `g = (d̄'·N)/R`, `e = d̄' + g d'`, `N̄ = γe`, `μ̄ = e·d`, `d̄ = μ(e − μg d)`. Then `N̄` goes to the point and the shape
//! through `N(x, y, z)`, and the point through the implicit function theorem on `G`: `Λ = (p̄·d + t̄)/q`, `ō = p̄ + ΛN`,
//! `d̄ += tō`, and `Λ ∂G/∂θ` to every parameter. No root and no division: the forward trace left `γ`, `1/R`, `1/q`.

use super::program::{Step, TERMS};
use super::run::{AlignedFrame, Extra, vectors};
use super::tile::{Bundle, TILE};
use super::vector::At;
use isoplanat_base::math::simd::{Simd, fresh};

/// Most lanes of a vector of sums.
pub(super) const WIDEST: usize = 8;

/// Sums over rays, lane by lane, of one surface.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct SurfaceSums {
    /// `Ā + Λρ/2`: with `bent`, the curvature's.
    pub(super) flat: [f64; WIDEST],
    /// `Λw²/2 − wφ̄`: times `1+κ` the rest of the curvature's, times `c` the conic's.
    pub(super) bent: [f64; WIDEST],
    /// Of `μ`.
    pub(super) mu: [f64; WIDEST],
    /// Of the distance to the vertex before.
    pub(super) distance: [f64; WIDEST],
    /// Of the index before the surface, through the path.
    pub(super) index: [f64; WIDEST],
    /// Of the even terms.
    pub(super) terms: [[f64; WIDEST]; TERMS],
}

impl SurfaceSums {
    pub(super) const ZERO: Self = Self {
        flat: [0.0; WIDEST],
        bent: [0.0; WIDEST],
        mu: [0.0; WIDEST],
        distance: [0.0; WIDEST],
        index: [0.0; WIDEST],
        terms: [[0.0; WIDEST]; TERMS],
    };
}

/// The same, ray by ray instead of summed.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Each {
    pub(super) flat: [f64; TILE],
    pub(super) bent: [f64; TILE],
    pub(super) mu: [f64; TILE],
    pub(super) distance: [f64; TILE],
    pub(super) index: [f64; TILE],
    pub(super) terms: [[f64; TILE]; TERMS],
}

impl Each {
    pub(super) const ZERO: Self = Self {
        flat: [0.0; TILE],
        bent: [0.0; TILE],
        mu: [0.0; TILE],
        distance: [0.0; TILE],
        index: [0.0; TILE],
        terms: [[0.0; TILE]; TERMS],
    };
}

/// A tile at one surface, on the way back.
pub(super) struct Back<'a> {
    /// Rays before the surface, in the frame of the one before.
    pub(super) before: &'a Bundle,
    /// Rays behind it.
    pub(super) after: &'a Bundle,
    pub(super) extra: &'a Extra,
    /// Cotangents of the rays behind the surface; on return, of those before it.
    pub(super) bars: &'a mut Bundle,
    /// Added to.
    pub(super) sums: &'a mut SurfaceSums,
    /// Where every ray's own part is written instead, if it is asked for.
    pub(super) each: Option<&'a mut Each>,
    /// Lanes in use.
    pub(super) len: usize,
}

/// A tile back through a conic with `N` even terms.
#[inline(always)]
pub(super) fn surface_vjp<S: Simd, const N: usize>(simd: S, step: &Step, back: &mut Back) {
    AlignedFrame::hold();
    let simd = simd.doubles();
    let sum = At { simd, at: 0 };
    let Back { before, after, extra, bars, sums, each, len } = back;
    let (mut flat, mut bent, mut mu_sum) = (sum.load(&sums.flat), sum.load(&sums.bent), sum.load(&sums.mu));
    let (mut distance, mut path_sum) = (sum.load(&sums.distance), sum.load(&sums.index));
    let mut term_sums = [sum.splat(0.0); N];
    for (term, from) in term_sums.iter_mut().zip(&sums.terms) {
        *term = sum.load(from);
    }
    for at in vectors::<S::Doubles>(*len) {
        let here = At { simd, at };
        let step = fresh(step);
        let (one, half, c, v, mu) =
            (here.splat(1.0), here.splat(0.5), here.splat(step.c), here.splat(step.v), here.splat(step.mu));
        let index = here.splat(step.surface.index_before);
        let (x, y) = (here.load(&after.x), here.load(&after.y));
        let (l, m, n, t) = (here.load(&before.l), here.load(&before.m), here.load(&before.n), here.load(&after.t));
        let (mut px, mut py, mut pz) = (here.load(&bars.x), here.load(&bars.y), here.load(&bars.z));
        let (mut dl, mut dm, mut dn) = (here.load(&bars.l), here.load(&bars.m), here.load(&bars.n));
        let path = here.load(&bars.path);
        let (w, slope) =
            if N > 0 { (here.load(&extra.w), here.load(&extra.slope)) } else { (here.load(&after.z), here.splat(0.0)) };
        let rho = x.fma(x, y * y);
        let phi = v.fnma(w, one);
        let a = if N > 0 { slope.fma(phi, c) } else { c };
        let (nx, ny) = (a * x, a * y);
        // Cotangents through N: of A, φ, w.
        let (mut a_bar, mut w_bar, mut slope_bar) = (here.splat(0.0), here.splat(0.0), here.splat(0.0));
        if step.refracts {
            let gamma = here.load(&extra.gamma);
            let (l1, m1, n1) = (here.load(&after.l), here.load(&after.m), here.load(&after.n));
            let g = phi.fnma(dn, dl.fma(nx, dm * ny)) * here.load(&extra.inverse_r);
            let (el, em, en) = (g.fma(l1, dl), g.fma(m1, dm), g.fma(n1, dn));
            mu_sum = el.fma(l, em.fma(m, en.fma(n, mu_sum)));
            let mg = mu * g;
            (dl, dm, dn) = (mu * mg.fnma(l, el), mu * mg.fnma(m, em), mu * mg.fnma(n, en));
            let (nx_bar, ny_bar, phi_bar) = (gamma * el, gamma * em, gamma * en);
            a_bar = x.fma(nx_bar, y * ny_bar);
            // N_z = −φ, and A holds φ times the slope.
            let phi_bar = if N > 0 { slope.fma(a_bar, -phi_bar) } else { -phi_bar };
            slope_bar = phi * a_bar;
            w_bar = -(v * phi_bar);
            bent = w.fnma(phi_bar, bent);
            (px, py, pz) = (a.fma(nx_bar, px), a.fma(ny_bar, py), pz + w_bar);
            if N > 0 {
                // w = z − P: P̄ = −w̄; of x and y through ρ.
                let mut bend = here.splat(step.terms2[N - 1]);
                for i in (1..N - 1).rev() {
                    bend = bend.fma(rho, here.splat(step.terms2[i]));
                }
                let rho_bar = bend.fma(slope_bar, -(half * slope * w_bar));
                let twice = rho_bar + rho_bar;
                (px, py) = (twice.fma(x, px), twice.fma(y, py));
            }
        } else {
            // Equal media bend nothing, but would if one of them changed: `μ̄ = d̄·d + (d̄·N)/q`.
            let across = phi.fnma(dn, dl.fma(nx, dm * ny));
            let along = dl.fma(l, dm.fma(m, dn.fma(n, mu_sum)));
            mu_sum = across.fma(here.load(&extra.inverse_q), along);
        }
        // Intersection.
        let lambda = px.fma(l, py.fma(m, pz.fma(n, path * index))) * here.load(&extra.inverse_q);
        (px, py, pz) = (lambda.fma(nx, px), lambda.fma(ny, py), lambda.fnma(phi, pz));
        (dl, dm, dn) = (t.fma(px, dl), t.fma(py, dm), t.fma(pz, dn));
        path_sum = path.fma(t, path_sum);
        distance = distance - pz;
        let half_lambda = half * lambda;
        flat = flat + half_lambda.fma(rho, a_bar);
        bent = (half_lambda * w).fma(w, bent);
        if N > 0 {
            // ρ^i (2(i+1) φĀ + ρ(φΛ − w̄)).
            let each = slope_bar + slope_bar;
            let mut term = rho.fma(phi.fma(lambda, -w_bar), each);
            let mut power = one;
            for (i, sum) in term_sums.iter_mut().enumerate() {
                if i > 0 {
                    power = power * rho;
                    term = term + each;
                }
                *sum = term.fma(power, *sum);
            }
        }
        here.store(px, &mut bars.x);
        here.store(py, &mut bars.y);
        here.store(pz, &mut bars.z);
        here.store(dl, &mut bars.l);
        here.store(dm, &mut bars.m);
        here.store(dn, &mut bars.n);
        if let Some(each) = each {
            here.store(flat, &mut each.flat);
            here.store(bent, &mut each.bent);
            here.store(mu_sum, &mut each.mu);
            here.store(distance, &mut each.distance);
            here.store(path_sum, &mut each.index);
            let zero = here.splat(0.0);
            (flat, bent, mu_sum, distance, path_sum) = (zero, zero, zero, zero, zero);
            for (term, to) in term_sums.iter_mut().zip(&mut each.terms) {
                here.store(*term, to);
                *term = zero;
            }
        }
    }
    sum.store(flat, &mut sums.flat);
    sum.store(bent, &mut sums.bent);
    sum.store(mu_sum, &mut sums.mu);
    sum.store(distance, &mut sums.distance);
    sum.store(path_sum, &mut sums.index);
    for (term, to) in term_sums.into_iter().zip(&mut sums.terms) {
        sum.store(term, to);
    }
}
