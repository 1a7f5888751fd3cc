//! Form of a rotationally symmetric surface: plane, sphere, conic, even asphere (paper eq. 1).
//!
//! With `ρ = x² + y²`, `α = (1+κ)c²`, `φ = √(1 − αρ)`:  `h(ρ) = cρ / (1 + φ) + Σ_{i≥1} a_{2i} ρ^i`.
//! All derivatives are with respect to `ρ`, so that nothing is singular on the axis. Not covered: odd terms,
//! freeform terms, tilt.

/// Shape of a surface; also the type of its own cotangent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shape {
    /// Vertex curvature `c`, 1/mm; positive when the centre lies towards +z; 0 is a plane.
    pub curvature: f64,
    /// Conic constant `κ`: 0 sphere, −1 paraboloid.
    pub conic: f64,
    /// Raw coefficients `a₂, a₄, a₆, …` (mm^(1−2i)); entry `i` multiplies `ρ^(i+1)`.
    pub asphere: Vec<f64>,
}

/// Value and derivatives of the sag at one `ρ`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sag {
    /// `h`, mm.
    pub h: f64,
    /// `dh/dρ`, 1/mm.
    pub h1: f64,
    /// `d²h/dρ²`, 1/mm³.
    pub h2: f64,
    /// `φ` of the conic part.
    pub phi: f64,
    /// Sag of the conic part alone, mm.
    pub conic_h: f64,
}

impl Shape {
    /// A sphere (or plane) of curvature `c`.
    pub fn sphere(curvature: f64) -> Self {
        Self { curvature, ..Self::default() }
    }

    /// Whether polynomial terms are present.
    pub fn is_aspheric(&self) -> bool {
        self.asphere.iter().any(|a| *a != 0.0)
    }

    /// Sag and its derivatives at `rho = x² + y²` (mm²); `None` where the conic does not reach (`αρ ≥ 1`).
    #[inline]
    pub fn sag(&self, rho: f64) -> Option<Sag> {
        let c = self.curvature;
        let alpha = (1.0 + self.conic) * c * c;
        let phi_sq = 1.0 - alpha * rho;
        if phi_sq.is_nan() || phi_sq <= 0.0 {
            return None;
        }
        let phi = phi_sq.sqrt();
        let conic_h = c * rho / (1.0 + phi);
        // Horner for the polynomial and its two derivatives.
        let (mut p, mut p1, mut p2) = (0.0, 0.0, 0.0);
        for a in self.asphere.iter().rev() {
            p2 = p2 * rho + p1;
            p1 = p1 * rho + p;
            p = p * rho + a;
        }
        // The sum starts at ρ¹: multiply by ρ once more.
        let (q, q1, q2) = (p * rho, p + p1 * rho, 2.0 * p1 + 2.0 * p2 * rho);
        Some(Sag { h: conic_h + q, h1: 0.5 * c / phi + q1, h2: 0.25 * c * alpha / (phi * phi_sq) + q2, phi, conic_h })
    }

    /// Adds the pull-back of cotangents on `h` and `dh/dρ` at `rho` to the shape's cotangent `bar`.
    pub fn sag_vjp(&self, rho: f64, sag: &Sag, h_bar: f64, h1_bar: f64, bar: &mut Self) {
        let (c, k) = (self.curvature, 1.0 + self.conic);
        let (z, inv) = (sag.conic_h, 0.5 / sag.phi);
        let inv3 = inv / (sag.phi * sag.phi);
        // ∂h/∂c = (ρ + (1+κ)z²)/2φ, ∂h′/∂c = 1/2φ³, ∂h/∂κ = cz²/2φ, ∂h′/∂κ = c³ρ/4φ³.
        bar.curvature += h_bar * (rho + k * z * z) * inv + h1_bar * inv3;
        bar.conic += h_bar * c * z * z * inv + h1_bar * 0.5 * c * c * c * rho * inv3;
        let mut power = 1.0;
        for (i, a_bar) in bar.asphere.iter_mut().enumerate() {
            #[expect(clippy::cast_precision_loss, reason = "a handful of terms")]
            let order = (i + 1) as f64;
            *a_bar += h_bar * power * rho + h1_bar * order * power;
            power *= rho;
        }
    }

    /// Largest radius the conic part reaches, mm (infinite for planes, paraboloids, hyperboloids).
    pub fn reach(&self) -> f64 {
        let alpha = (1.0 + self.conic) * self.curvature * self.curvature;
        if alpha > 0.0 { alpha.sqrt().recip() } else { f64::INFINITY }
    }

    /// A cotangent of the same form, all zero.
    #[must_use]
    pub fn zeros_like(&self) -> Self {
        Self { curvature: 0.0, conic: 0.0, asphere: vec![0.0; self.asphere.len()] }
    }

    /// The same surface met from the other side: curvature and polynomial change sign.
    #[must_use]
    pub fn reversed(&self) -> Self {
        Self { curvature: -self.curvature, conic: self.conic, asphere: self.asphere.iter().map(|a| -a).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_rel, between, central_difference};

    /// ⟨h̄, J dθ⟩ for sag and slope, from planes to hyperboloids, against fourth-order differences.
    #[test]
    fn sag_vjp_is_the_transpose_of_the_jacobian() {
        for seed in 0..200 {
            let rng = &mut fastrand::Rng::with_seed(seed);
            let c = if seed == 0 { 0.0 } else { between(rng, -0.05, 0.05) };
            let shape = Shape {
                curvature: c,
                conic: between(rng, -3.0, 1.0),
                asphere: vec![between(rng, -1e-3, 1e-3), between(rng, -1e-5, 1e-5), between(rng, -1e-7, 1e-7)],
            };
            let rho = between(rng, 0.0, 80.0);
            let step = Shape {
                curvature: between(rng, -0.01, 0.01),
                conic: between(rng, -1.0, 1.0),
                asphere: vec![between(rng, -1e-3, 1e-3), between(rng, -1e-5, 1e-5), between(rng, -1e-7, 1e-7)],
            };
            let d_rho = between(rng, -1.0, 1.0);
            let sag = shape.sag(rho).expect("inside");
            let mut bar = shape.zeros_like();
            shape.sag_vjp(rho, &sag, 1.0, 100.0, &mut bar);
            let pulled = bar.curvature * step.curvature
                + bar.conic * step.conic
                + bar.asphere.iter().zip(&step.asphere).map(|(a, b)| a * b).sum::<f64>()
                + d_rho * (sag.h1 + 100.0 * sag.h2);
            let moved = |t: f64| {
                let s = Shape {
                    curvature: c + t * step.curvature,
                    conic: shape.conic + t * step.conic,
                    asphere: shape.asphere.iter().zip(&step.asphere).map(|(a, b)| a + t * b).collect(),
                };
                let v = s.sag(rho + t * d_rho).expect("inside");
                v.h + 100.0 * v.h1
            };
            assert_rel(pulled, central_difference(moved, 1e-3), 1e-8, 1e-3, &format!("seed {seed}"));
        }
    }
}
