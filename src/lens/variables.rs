//! Which numbers of a lens are free: a flat vector of scaled values ⇄ [`Lens`].
//!
//! Scales make one unit of each variable move a ray by a comparable amount: curvature `2/R²`, conic
//! `8/(c³R⁴)`-like but bounded, asphere `1/R^{2i}` (mm of sag at the rim), thickness 1 mm, index 1, Abbe number 100,
//! with `R` the clear semi-diameter **when the set was made**.

use super::{Lens, LensGradient, Medium};

/// One free number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// Vertex curvature of a surface.
    Curvature(usize),
    /// Conic constant of a surface.
    Conic(usize),
    /// Polynomial coefficient: surface, entry (0 is a₂).
    Asphere(usize, usize),
    /// Thickness behind a surface.
    Thickness(usize),
    /// `n_d` of the medium behind a surface.
    Index(usize),
    /// `v_d` of the medium behind a surface.
    Abbe(usize),
}

impl std::fmt::Display for Parameter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Curvature(i) => write!(f, "surface[{i}].curvature"),
            Self::Conic(i) => write!(f, "surface[{i}].conic"),
            Self::Asphere(i, j) => write!(f, "surface[{i}].a{}", 2 * j + 2),
            Self::Thickness(i) => write!(f, "surface[{i}].thickness"),
            Self::Index(i) => write!(f, "surface[{i}].n_d"),
            Self::Abbe(i) => write!(f, "surface[{i}].v_d"),
        }
    }
}

/// An ordered set of free numbers with their scales.
#[derive(Clone, Debug, PartialEq)]
pub struct Variables {
    /// The numbers.
    pub parameters: Vec<Parameter>,
    /// `value = scaled × scale`.
    pub scales: Vec<f64>,
}

impl Variables {
    /// The given numbers, scaled for `lens`.
    pub fn new(lens: &Lens, parameters: Vec<Parameter>) -> Self {
        let scales = parameters.iter().map(|p| scale(lens, *p)).collect();
        Self { parameters, scales }
    }

    /// Every curvature, conic, asphere coefficient, thickness and Cauchy glass of `lens`.
    pub fn all(lens: &Lens) -> Self {
        let mut p = Vec::new();
        for (i, s) in lens.surfaces.iter().enumerate() {
            p.push(Parameter::Curvature(i));
            p.push(Parameter::Conic(i));
            p.extend((0..s.shape.asphere.len()).map(|j| Parameter::Asphere(i, j)));
            p.push(Parameter::Thickness(i));
            if matches!(s.medium, Medium::Cauchy { .. }) {
                p.push(Parameter::Index(i));
                p.push(Parameter::Abbe(i));
            }
        }
        Self::new(lens, p)
    }

    /// What a designer frees first: curvature and conic of refracting surfaces, polynomial terms that are present,
    /// and every thickness.
    pub fn refracting(lens: &Lens) -> Self {
        let mut p = Vec::new();
        let n = lens.indices(lens.wavelengths.primary_nm);
        for (i, s) in lens.surfaces.iter().enumerate() {
            if n[i] != n[i + 1] {
                p.push(Parameter::Curvature(i));
                p.push(Parameter::Conic(i));
                p.extend((0..s.shape.asphere.len()).map(|j| Parameter::Asphere(i, j)));
            }
            p.push(Parameter::Thickness(i));
        }
        Self::new(lens, p)
    }

    /// Scaled values of `lens`.
    pub fn values(&self, lens: &Lens) -> Vec<f64> {
        let value = |p: &Parameter| match *p {
            Parameter::Curvature(i) => lens.surfaces[i].shape.curvature,
            Parameter::Conic(i) => lens.surfaces[i].shape.conic,
            Parameter::Asphere(i, j) => lens.surfaces[i].shape.asphere[j],
            Parameter::Thickness(i) => lens.surfaces[i].thickness,
            Parameter::Index(i) => cauchy(lens, i).0,
            Parameter::Abbe(i) => cauchy(lens, i).1,
        };
        self.parameters.iter().zip(&self.scales).map(|(p, s)| value(p) / s).collect()
    }

    /// `base` with the scaled `values` put in.
    #[must_use]
    pub fn lens(&self, base: &Lens, values: &[f64]) -> Lens {
        let mut lens = base.clone();
        for ((p, s), v) in self.parameters.iter().zip(&self.scales).zip(values) {
            let v = v * s;
            match *p {
                Parameter::Curvature(i) => lens.surfaces[i].shape.curvature = v,
                Parameter::Conic(i) => lens.surfaces[i].shape.conic = v,
                Parameter::Asphere(i, j) => lens.surfaces[i].shape.asphere[j] = v,
                Parameter::Thickness(i) => lens.surfaces[i].thickness = v,
                Parameter::Index(i) => {
                    if let Medium::Cauchy { n_d, .. } = &mut lens.surfaces[i].medium {
                        *n_d = v;
                    }
                }
                Parameter::Abbe(i) => {
                    if let Medium::Cauchy { v_d, .. } = &mut lens.surfaces[i].medium {
                        *v_d = v;
                    }
                }
            }
        }
        lens
    }

    /// Gradient with respect to the scaled values.
    pub fn gradient(&self, g: &LensGradient) -> Vec<f64> {
        let entry = |p: &Parameter| match *p {
            Parameter::Curvature(i) => g.surfaces[i].shape.curvature,
            Parameter::Conic(i) => g.surfaces[i].shape.conic,
            Parameter::Asphere(i, j) => g.surfaces[i].shape.asphere[j],
            Parameter::Thickness(i) => g.surfaces[i].thickness,
            Parameter::Index(i) => g.surfaces[i].n_d,
            Parameter::Abbe(i) => g.surfaces[i].v_d,
        };
        self.parameters.iter().zip(&self.scales).map(|(p, s)| entry(p) * s).collect()
    }
}

fn cauchy(lens: &Lens, i: usize) -> (f64, f64) {
    match lens.surfaces[i].medium {
        Medium::Cauchy { n_d, v_d } => (n_d, v_d),
        _ => panic!("surface {i} has no Cauchy glass to vary"),
    }
}

/// Sizes of one scaled unit; see the module's head.
fn scale(lens: &Lens, p: Parameter) -> f64 {
    let radius = |i: usize| lens.surfaces[i].semi_diameter;
    match p {
        Parameter::Curvature(i) => 2.0 / radius(i).powi(2),
        Parameter::Conic(i) => {
            let (c, r) = (lens.surfaces[i].shape.curvature.abs(), radius(i));
            // Sag of the conic term at the rim is κ c³ R⁴ / 8.
            (8.0 / (c.powi(3) * r.powi(4)).max(1e-9)).min(1e3)
        }
        Parameter::Asphere(i, j) => radius(i).powi(-2 * (i32::try_from(j).unwrap_or(8) + 1)),
        Parameter::Thickness(_) | Parameter::Index(_) => 1.0,
        Parameter::Abbe(_) => 100.0,
    }
}
