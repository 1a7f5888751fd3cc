//! Form of a surface: plane, sphere, conic, asphere with even and odd terms (paper eq. 1), freeform terms.
//!
//! With `ρ = x² + y²`, `r = √ρ`, `α = (1+κ)c²`, `φ = √(1 − αρ)`:
//! `h(x, y) = cρ / (1 + φ) + Σ a_{2i} ρ^i + Σ a_{2i+1} r^{2i+1} + freeform(x, y)`.
//! Derivatives of the rotational part are with respect to `ρ`, so that nothing is singular on the axis; odd terms
//! start at `r³`, which is twice differentiable there. [`Shape::at`] is the whole surface, [`Shape::sag`] its
//! rotationally symmetric part.

use super::freeform::{Xy, Zernike};
use super::numbers::Kind;
pub use super::sag::{Local, Sag};

/// Highest power of `r` among the aspheric terms: published ones go to 38.
#[doc(hidden)]
pub const HIGHEST_POWER: usize = 40;

/// Shape of a surface; also the type of its own cotangent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shape {
    /// Vertex curvature `c`, 1/mm; positive when the centre lies towards +z; 0 is a plane.
    pub curvature: f64,
    /// Conic constant `κ`: 0 sphere, −1 paraboloid.
    pub conic: f64,
    /// Raw even coefficients `a₂, a₄, a₆, …` (mm^(1−2i)); entry `i` multiplies `r^(2i+2)`.
    pub asphere: Vec<f64>,
    /// Raw odd coefficients `a₃, a₅, a₇, …`; entry `i` multiplies `r^(2i+3)`.
    pub odd: Vec<f64>,
    /// Zernike terms.
    pub zernike: Option<Zernike>,
    /// Polynomial in x and y.
    pub xy: Option<Xy>,
    /// Focal length of an ideal lens, mm. Its surface is a plane in air, which bends light as first-order optics says.
    pub ideal: Option<f64>,
}

impl Shape {
    /// A sphere (or plane) of curvature `c`.
    pub fn sphere(curvature: f64) -> Self {
        Self { curvature, ..Self::default() }
    }

    /// A conic with even polynomial terms `a₂, a₄, …`.
    pub fn even(curvature: f64, conic: f64, asphere: Vec<f64>) -> Self {
        Self { curvature, conic, asphere, ..Self::default() }
    }

    // What follows names every field, so that a new one is asked about here.

    /// Whether anything beyond the conic is present.
    pub fn is_aspheric(&self) -> bool {
        let Self { curvature: _, conic: _, asphere, odd, zernike, xy, ideal: _ } = self;
        asphere.iter().chain(odd).any(|a| *a != 0.0) || zernike.is_some() || xy.is_some()
    }

    /// Whether the surface is rotationally symmetric about its own axis.
    pub fn is_symmetric(&self) -> bool {
        let Self { curvature: _, conic: _, asphere: _, odd: _, zernike, xy, ideal: _ } = self;
        zernike.is_none() && xy.is_none()
    }

    /// Whether it is a conic with at most `most` even terms and nothing else.
    pub(crate) fn is_even(&self, most: usize) -> bool {
        let Self { curvature: _, conic: _, asphere, odd, zernike, xy, ideal } = self;
        asphere.len() <= most && odd.is_empty() && zernike.is_none() && xy.is_none() && ideal.is_none()
    }

    /// The surface without what breaks its symmetry.
    #[must_use]
    pub(crate) fn symmetric_part(self) -> Self {
        let Self { curvature, conic, asphere, odd, zernike: _, xy: _, ideal } = self;
        Self { curvature, conic, asphere, odd, zernike: None, xy: None, ideal }
    }

    /// Curvature of the rotational part at the vertex, 1/mm: `c + 2a₂`.
    #[doc(hidden)]
    pub fn vertex_curvature(&self) -> f64 {
        let Self { curvature, conic: _, asphere, odd: _, zernike: _, xy: _, ideal: _ } = self;
        curvature + 2.0 * asphere.first().copied().unwrap_or(0.0)
    }

    /// Coefficient of `r⁴` of the rotational part at the vertex, mm⁻³: `(1+κ)c³/8 + a₄`.
    pub(crate) fn quartic(&self) -> f64 {
        let Self { curvature, conic, asphere, odd: _, zernike: _, xy: _, ideal: _ } = self;
        (1.0 + conic) * curvature.powi(3) / 8.0 + asphere.get(1).copied().unwrap_or(0.0)
    }

    /// The terms that the rotational part adds to its conic: powers of `r`, from 1 on, with their coefficients. A power may come
    /// several times, of several lists; its coefficient is their sum.
    #[doc(hidden)]
    pub fn terms(&self) -> impl Iterator<Item = (usize, f64)> {
        let Self { curvature: _, conic: _, asphere, odd, zernike: _, xy: _, ideal: _ } = self;
        let of = |list, first| <[f64]>::iter(list).enumerate().map(move |(i, a)| (2 * i + first, *a));
        of(asphere, 2).chain(of(odd, 3))
    }

    /// Power of an ideal lens, 1/mm.
    pub(crate) fn ideal_power(&self) -> Option<f64> {
        self.ideal.map(f64::recip)
    }

    /// Adds the pull-back of a cotangent on [`Self::ideal_power`] to the shape's cotangent `bar`.
    pub(crate) fn ideal_power_vjp(&self, power_bar: f64, bar: &mut Self) {
        if let (Some(f), Some(f_bar)) = (self.ideal, &mut bar.ideal) {
            *f_bar -= power_bar / (f * f);
        }
    }

    /// Power between media of the indices `n` and `n1`, 1/mm: `(n' − n)(c + 2a₂)`, or an ideal lens's own.
    pub(crate) fn power(&self, n: f64, n1: f64) -> f64 {
        self.ideal_power().unwrap_or_else(|| (n1 - n) * self.vertex_curvature())
    }

    /// What a paraxial ray at height `y` loses of `n u` here: its height times [`Self::power`].
    pub(crate) fn deflection(&self, y: f64, n: f64, n1: f64) -> f64 {
        self.ideal_power().map_or_else(|| y * (n1 - n) * self.vertex_curvature(), |power| y * power)
    }

    /// Adds the pull-back of a cotangent on [`Self::power`] to the shape's cotangent `bar`; returns those of `n` and `n1`.
    pub(crate) fn power_vjp(&self, n: f64, n1: f64, power_bar: f64, bar: &mut Self) -> [f64; 2] {
        if self.ideal.is_some() {
            self.ideal_power_vjp(power_bar, bar);
            return [0.0; 2];
        }
        Self::vertex_curvature_vjp(power_bar * (n1 - n), bar);
        let by_index = power_bar * self.vertex_curvature();
        [-by_index, by_index]
    }

    /// Adds the pull-back of a cotangent on [`Self::vertex_curvature`] to the shape's cotangent `bar`.
    pub(crate) fn vertex_curvature_vjp(curvature_bar: f64, bar: &mut Self) {
        let Self { curvature, conic: _, asphere, odd: _, zernike: _, xy: _, ideal: _ } = bar;
        *curvature += curvature_bar;
        if let Some(a2) = asphere.first_mut() {
            *a2 += 2.0 * curvature_bar;
        }
    }

    /// The rotationally symmetric part at `rho = x² + y²` (mm²); `None` where the conic does not reach (`αρ ≥ 1`).
    #[inline]
    pub fn sag(&self, rho: f64) -> Option<Sag> {
        let Self { curvature, conic, asphere, odd, zernike: _, xy: _, ideal: _ } = self;
        let c = *curvature;
        let alpha = (1.0 + conic) * c * c;
        let phi_sq = 1.0 - alpha * rho;
        if phi_sq.is_nan() || phi_sq <= 0.0 {
            return None;
        }
        let phi = phi_sq.sqrt();
        let conic_h = c * rho / (1.0 + phi);
        // Horner for the polynomial and its two derivatives.
        let (mut p, mut p1, mut p2) = (0.0, 0.0, 0.0);
        for a in asphere.iter().rev() {
            p2 = p2 * rho + p1;
            p1 = p1 * rho + p;
            p = p * rho + a;
        }
        // The series starts at ρ: P = ρ p.
        let (mut q, mut q1, mut q2) = (p * rho, p + p1 * rho, 2.0 * p1 + 2.0 * p2 * rho);
        if !odd.is_empty() {
            // r³ s(ρ): the same Horner, then r³ = ρ^{3/2}.
            let (mut s, mut s1, mut s2) = (0.0, 0.0, 0.0);
            for a in odd.iter().rev() {
                s2 = s2 * rho + s1;
                s1 = s1 * rho + s;
                s = s * rho + a;
            }
            let r = rho.sqrt();
            q += r * rho * s;
            q1 += r * (1.5 * s + rho * s1);
            // 3/4r s is infinite on the axis, where the second derivative only ever meets x² or xy.
            q2 += if r > 0.0 { 0.75 * s / r + r * (3.0 * s1 + 2.0 * rho * s2) } else { 0.0 };
        }
        Some(Sag { h: conic_h + q, h1: 0.5 * c / phi + q1, h2: 0.25 * c * alpha / (phi * phi_sq) + q2, phi, conic_h })
    }

    /// The whole surface at `(x, y)`, mm; `None` where the conic does not reach.
    #[inline]
    pub fn at(&self, x: f64, y: f64) -> Option<Local> {
        let sag = self.sag(x * x + y * y)?;
        // An ideal lens is a plane.
        let Self { curvature: _, conic: _, asphere: _, odd: _, zernike, xy, ideal: _ } = self;
        let (h1, h2) = (2.0 * sag.h1, 4.0 * sag.h2);
        let mut local =
            Local { h: sag.h, slope: [h1 * x, h1 * y], second: [h1 + h2 * x * x, h2 * x * y, h1 + h2 * y * y], sag };
        if let Some(zernike) = zernike {
            zernike.polynomial().add_to(x, y, &mut local);
        }
        if let Some(xy) = xy {
            xy.polynomial().add_to(x, y, &mut local);
        }
        Some(local)
    }

    /// Adds the pull-back of cotangents on `h` and `dh/dρ` at `rho` to the shape's cotangent `bar`.
    pub fn sag_vjp(&self, rho: f64, sag: &Sag, h_bar: f64, h1_bar: f64, bar: &mut Self) {
        let Self { curvature, conic, asphere: _, odd: _, zernike: _, xy: _, ideal: _ } = self;
        let Self {
            curvature: curvature_bar,
            conic: conic_bar,
            asphere: asphere_bar,
            odd: odd_bar,
            zernike: _,
            xy: _,
            ideal: _,
        } = bar;
        let (c, k) = (*curvature, 1.0 + conic);
        let (z, inv) = (sag.conic_h, 0.5 / sag.phi);
        let inv3 = inv / (sag.phi * sag.phi);
        // ∂h/∂c = (ρ + (1+κ)z²)/2φ, ∂h′/∂c = 1/2φ³, ∂h/∂κ = cz²/2φ, ∂h′/∂κ = c³ρ/4φ³.
        *curvature_bar += h_bar * (rho + k * z * z) * inv + h1_bar * inv3;
        *conic_bar += h_bar * c * z * z * inv + h1_bar * 0.5 * c * c * c * rho * inv3;
        let mut power = 1.0;
        for (i, a_bar) in asphere_bar.iter_mut().enumerate() {
            *a_bar += h_bar * power * rho + h1_bar * order(i) * power;
            power *= rho;
        }
        if !odd_bar.is_empty() {
            let mut power = rho.sqrt();
            for (i, a_bar) in odd_bar.iter_mut().enumerate() {
                *a_bar += h_bar * power * rho + h1_bar * (order(i) + 0.5) * power;
                power *= rho;
            }
        }
    }

    /// Adds the pull-back of cotangents on `h` and its slope at `(x, y)` to the shape's cotangent `bar`.
    pub fn at_vjp(&self, x: f64, y: f64, local: &Local, h_bar: f64, slope_bar: [f64; 2], bar: &mut Self) {
        // Slope = 2 h′ (x, y).
        let h1_bar = 2.0 * (x * slope_bar[0] + y * slope_bar[1]);
        self.sag_vjp(x * x + y * y, &local.sag, h_bar, h1_bar, bar);
        let Self { curvature: _, conic: _, asphere: _, odd: _, zernike, xy, ideal: _ } = self;
        if let (Some(zernike), Some(bar)) = (zernike, &mut bar.zernike) {
            zernike.terms_vjp(x, y, h_bar, slope_bar, bar);
        }
        if let (Some(xy), Some(bar)) = (xy, &mut bar.xy) {
            xy.terms_vjp(x, y, h_bar, slope_bar, bar);
        }
    }

    /// Largest radius the conic part reaches, mm (infinite for planes, paraboloids, hyperboloids); what stands beside it goes on without end.
    pub fn reach(&self) -> f64 {
        let Self { curvature, conic, asphere: _, odd: _, zernike: _, xy: _, ideal: _ } = self;
        let alpha = (1.0 + conic) * curvature * curvature;
        if alpha > 0.0 { alpha.sqrt().recip() } else { f64::INFINITY }
    }

    /// An upper bound of `|∇h|` for `r ≤ radius`; infinite where the conic does not reach that far.
    pub(crate) fn steepest(&self, radius: f64) -> f64 {
        self.steepest_of(radius, 64)
    }

    /// [`Self::steepest`], ring by ring: the conic's slope is monotonic in `ρ`, and so are the positive and the negative terms of the
    /// polynomials, each for itself. More rings come closer to the largest slope. Numbers that are none have no bound.
    pub(crate) fn steepest_of(&self, radius: f64, rings: u32) -> f64 {
        if !radius.is_finite() || radius >= self.reach() {
            let flat = self.curvature == 0.0 && !self.is_aspheric();
            return if flat { 0.0 } else { f64::INFINITY };
        }
        let Self { curvature, conic, asphere, odd, zernike, xy, ideal: _ } = self;
        let conic = |r: f64| {
            let phi_sq = 1.0 - (1.0 + conic) * (curvature * r).powi(2);
            curvature * r / phi_sq.sqrt()
        };
        // Slopes of the terms of one sign: Σ k |a_k| r^{k−1} over the terms whose sign is `sign`.
        let terms = |r: f64, sign: f64| {
            let mut sum = 0.0;
            let mut power = r;
            for i in 0..asphere.len().max(odd.len()) {
                let even = asphere.get(i).copied().unwrap_or(0.0) * sign;
                let odd = odd.get(i).copied().unwrap_or(0.0) * sign;
                let [even, odd] = [even, odd].map(|a| larger(a, 0.0));
                sum += 2.0 * order(i) * even * power + (2.0 * order(i) + 1.0) * odd * power * r;
                power *= r * r;
            }
            sum
        };
        let mut bound = 0.0f64;
        for ring in 0..rings {
            let (a, b) = (radius * f64::from(ring) / f64::from(rings), radius * f64::from(ring + 1) / f64::from(rings));
            let (c_a, c_b) = (conic(a), conic(b));
            let high = larger(c_a, c_b) + terms(b, 1.0) - terms(a, -1.0);
            let low = -larger(-c_a, -c_b) + terms(a, 1.0) - terms(b, -1.0);
            bound = larger(larger(bound, high.abs()), low.abs());
        }
        let freeform = zernike.as_ref().map_or(0.0, |z| z.polynomial().steepest(radius))
            + xy.as_ref().map_or(0.0, |p| p.polynomial().steepest(radius));
        // A part in 1e12 covers the rounding of the sums.
        let steepest = (bound + freeform) * (1.0 + 1e-12);
        if steepest.is_nan() { f64::INFINITY } else { steepest }
    }

    /// A cotangent of the same form, all zero.
    #[must_use]
    pub fn zeros_like(&self) -> Self {
        let mut zeros = self.clone();
        Kind::each_of(&mut zeros, |_, _, list| list.fill(0.0));
        zeros
    }

    /// Adds the cotangent `other` of the same form.
    pub fn add(&mut self, other: &Self) {
        Kind::each_of(self, |_, of, list| list.iter_mut().zip(of(other)).for_each(|(a, b)| *a += b));
    }

    /// Brings the freeform polynomials up to date after their terms were changed.
    pub fn refresh(&mut self) {
        let Self { curvature: _, conic: _, asphere: _, odd: _, zernike, xy, ideal: _ } = self;
        if let Some(z) = zernike {
            z.refresh();
        }
        if let Some(p) = xy {
            p.refresh();
        }
    }

    /// The same surface met from the other side: z changes sign, x and y stay.
    #[must_use]
    pub fn reversed(&self) -> Self {
        let mut reversed = self.clone();
        Kind::each_of(&mut reversed, |kind, _, list| {
            if kind.turns() {
                list.iter_mut().for_each(|a| *a = -*a);
            }
        });
        reversed.refresh();
        reversed
    }
}

/// `i + 1` as a number: the power of `ρ` of entry `i`.
fn order(i: usize) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a handful of terms")]
    let order = (i + 1) as f64;
    order
}

/// The larger of two numbers; no number where one of them is none.
fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}

#[cfg(test)]
mod tests;
