//! Which numbers of a lens are free: a flat vector of scaled values ⇄ [`Lens`].
//!
//! Scales make one unit of each variable move a ray by a comparable amount: curvature `2/R²`, conic
//! `8/(c³R⁴)`-like but bounded, polynomial terms `1/R^k` (mm of sag at the rim), freeform
//! terms, decentres and thickness 1 mm, tilt `1/R`, index 1, Abbe number 100,
//! with `R` the clear semi-diameter **when the set was made**.

use super::{Lens, LensGradient, Medium};

/// One free number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// Vertex curvature of a surface.
    Curvature(usize),
    /// Conic constant of a surface.
    Conic(usize),
    /// Even polynomial coefficient: surface, entry (0 is a₂).
    Asphere(usize, usize),
    /// Odd polynomial coefficient: surface, entry (0 is a₃).
    Odd(usize, usize),
    /// Zernike coefficient: surface, entry (0 is Z₁).
    Zernike(usize, usize),
    /// Coefficient of the polynomial in x and y: surface, entry in the file's order.
    Xy(usize, usize),
    /// Tilt of a surface about axis 0, 1, 2.
    Tilt(usize, usize),
    /// Decentre of a surface along axis 0, 1.
    Decentre(usize, usize),
    /// Tilt of an element about axis 0, 1, 2.
    ElementTilt(usize, usize),
    /// Decentre of an element along axis 0, 1.
    ElementDecentre(usize, usize),
    /// Thickness behind a surface.
    Thickness(usize),
    /// `n_d` of the medium behind a surface.
    Index(usize),
    /// `v_d` of the medium behind a surface.
    Abbe(usize),
}

const AXES: [&str; 3] = ["x", "y", "z"];

impl std::fmt::Display for Parameter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Curvature(i) => write!(f, "surface[{i}].curvature"),
            Self::Conic(i) => write!(f, "surface[{i}].conic"),
            Self::Asphere(i, j) => write!(f, "surface[{i}].a{}", 2 * j + 2),
            Self::Odd(i, j) => write!(f, "surface[{i}].a{}", 2 * j + 3),
            Self::Zernike(i, j) => write!(f, "surface[{i}].z{}", j + 1),
            Self::Xy(i, j) => write!(f, "surface[{i}].xy[{j}]"),
            Self::Tilt(i, k) => write!(f, "surface[{i}].tilt_{}", AXES[*k]),
            Self::Decentre(i, k) => write!(f, "surface[{i}].decentre_{}", AXES[*k]),
            Self::ElementTilt(i, k) => write!(f, "element[{i}].tilt_{}", AXES[*k]),
            Self::ElementDecentre(i, k) => write!(f, "element[{i}].decentre_{}", AXES[*k]),
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

    /// Every curvature, conic, polynomial coefficient, thickness, stated pose and Cauchy glass of `lens`.
    pub fn all(lens: &Lens) -> Self {
        let mut p = Vec::new();
        for (i, s) in lens.surfaces.iter().enumerate() {
            p.push(Parameter::Curvature(i));
            p.push(Parameter::Conic(i));
            polynomial_terms(i, s, &mut p);
            if s.pose.is_some() {
                p.extend((0..3).map(|k| Parameter::Tilt(i, k)));
                p.extend((0..2).map(|k| Parameter::Decentre(i, k)));
            }
            p.push(Parameter::Thickness(i));
            if matches!(s.medium, Medium::Cauchy { .. }) {
                p.push(Parameter::Index(i));
                p.push(Parameter::Abbe(i));
            }
        }
        for i in 0..lens.elements.len() {
            p.extend((0..3).map(|k| Parameter::ElementTilt(i, k)));
            p.extend((0..2).map(|k| Parameter::ElementDecentre(i, k)));
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
                polynomial_terms(i, s, &mut p);
            }
            p.push(Parameter::Thickness(i));
        }
        Self::new(lens, p)
    }

    /// Scaled values of `lens`.
    pub fn values(&self, lens: &Lens) -> Vec<f64> {
        let mut lens = lens.clone();
        self.parameters.iter().zip(&self.scales).map(|(p, s)| *entry(&mut lens, *p) / s).collect()
    }

    /// `base` with the scaled `values` put in.
    #[must_use]
    pub fn lens(&self, base: &Lens, values: &[f64]) -> Lens {
        let mut lens = base.clone();
        for ((p, s), v) in self.parameters.iter().zip(&self.scales).zip(values) {
            *entry(&mut lens, *p) = v * s;
        }
        lens.surfaces.iter_mut().for_each(|s| s.shape.refresh());
        lens
    }

    /// Gradient with respect to the scaled values.
    pub fn gradient(&self, g: &LensGradient) -> Vec<f64> {
        let entry = |p: &Parameter| match *p {
            Parameter::Curvature(i) => g.surfaces[i].shape.curvature,
            Parameter::Conic(i) => g.surfaces[i].shape.conic,
            Parameter::Asphere(i, j) => g.surfaces[i].shape.asphere[j],
            Parameter::Odd(i, j) => g.surfaces[i].shape.odd[j],
            Parameter::Zernike(i, j) => g.surfaces[i].shape.zernike.as_ref().map_or(0.0, |z| z.terms()[j]),
            Parameter::Xy(i, j) => g.surfaces[i].shape.xy.as_ref().map_or(0.0, |p| p.terms()[j]),
            Parameter::Tilt(i, k) => g.surfaces[i].pose.tilt[k],
            Parameter::Decentre(i, k) => g.surfaces[i].pose.decentre[k],
            Parameter::ElementTilt(i, k) => g.elements[i].tilt[k],
            Parameter::ElementDecentre(i, k) => g.elements[i].decentre[k],
            Parameter::Thickness(i) => g.surfaces[i].thickness,
            Parameter::Index(i) => g.surfaces[i].n_d,
            Parameter::Abbe(i) => g.surfaces[i].v_d,
        };
        self.parameters.iter().zip(&self.scales).map(|(p, s)| entry(p) * s).collect()
    }
}

fn polynomial_terms(i: usize, s: &super::Surface, p: &mut Vec<Parameter>) {
    p.extend((0..s.shape.asphere.len()).map(|j| Parameter::Asphere(i, j)));
    p.extend((0..s.shape.odd.len()).map(|j| Parameter::Odd(i, j)));
    p.extend((0..s.shape.zernike.as_ref().map_or(0, |z| z.terms().len())).map(|j| Parameter::Zernike(i, j)));
    p.extend((0..s.shape.xy.as_ref().map_or(0, |p| p.terms().len())).map(|j| Parameter::Xy(i, j)));
}

/// The number itself.
///
/// # Panics
/// If the lens has no such number: a set of variables belongs to lenses of the form it was made for.
fn entry(lens: &mut Lens, p: Parameter) -> &mut f64 {
    const PRESENT: &str = "the variables were made for a lens of this form";
    match p {
        Parameter::Curvature(i) => &mut lens.surfaces[i].shape.curvature,
        Parameter::Conic(i) => &mut lens.surfaces[i].shape.conic,
        Parameter::Asphere(i, j) => &mut lens.surfaces[i].shape.asphere[j],
        Parameter::Odd(i, j) => &mut lens.surfaces[i].shape.odd[j],
        Parameter::Zernike(i, j) => &mut lens.surfaces[i].shape.zernike.as_mut().expect(PRESENT).terms_mut()[j],
        Parameter::Xy(i, j) => &mut lens.surfaces[i].shape.xy.as_mut().expect(PRESENT).terms_mut()[j],
        Parameter::Tilt(i, k) => &mut lens.surfaces[i].pose.get_or_insert_default().tilt[k],
        Parameter::Decentre(i, k) => &mut lens.surfaces[i].pose.get_or_insert_default().decentre[k],
        Parameter::ElementTilt(i, k) => &mut lens.elements[i].pose.tilt[k],
        Parameter::ElementDecentre(i, k) => &mut lens.elements[i].pose.decentre[k],
        Parameter::Thickness(i) => &mut lens.surfaces[i].thickness,
        Parameter::Index(i) => cauchy(lens, i).0,
        Parameter::Abbe(i) => cauchy(lens, i).1,
    }
}

fn cauchy(lens: &mut Lens, i: usize) -> (&mut f64, &mut f64) {
    match &mut lens.surfaces[i].medium {
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
        Parameter::Odd(i, j) => radius(i).powi(-(2 * i32::try_from(j).unwrap_or(8) + 3)),
        // Terms of a freeform are mm already; one unit of tilt moves the rim by 1 mm.
        Parameter::Zernike(..) | Parameter::Xy(..) | Parameter::Decentre(..) | Parameter::ElementDecentre(..) => 1.0,
        Parameter::Tilt(i, _) => 1.0 / radius(i),
        Parameter::ElementTilt(i, _) => 1.0 / radius(lens.elements[i].first),
        Parameter::Thickness(_) | Parameter::Index(_) => 1.0,
        Parameter::Abbe(_) => 100.0,
    }
}
