//! Which numbers of a lens are free: a flat vector of scaled values ⇄ [`Lens`].
//!
//! Scales make one unit of each variable move a ray by a comparable amount: curvature `2/R²`, conic
//! `8/(c³R⁴)`-like but bounded, polynomial terms `1/R^k` (mm of sag at the rim), freeform
//! terms, decentres and thickness 1 mm, tilt `1/R`, index 1, Abbe number 100,
//! with `R` the clear semi-diameter **when the set was made**. The table of [`super::numbers`] holds them.

use super::numbers::{Kind, Parameter};
use super::{Lens, LensGradient, Prescription};
use isoplanat_base::error::Result;

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
        let scales = parameters.iter().map(|p| p.scale(lens)).collect();
        Self { parameters, scales }
    }

    /// Every free number of `lens`: forms, thicknesses, stated poses and Cauchy glasses.
    pub fn all(lens: &Lens) -> Self {
        Self::new(lens, Parameter::all(lens).filter(|p| p.kind.is_free()).collect())
    }

    /// What a designer frees first: the form of refracting surfaces, polynomial terms where they are present, and every
    /// thickness.
    pub fn refracting(lens: &Lens) -> Self {
        let n = lens.indices(lens.wavelengths.primary_nm);
        let chosen = |p: &Parameter| p.kind == Kind::Thickness || p.kind.is_shape() && n[p.of] != n[p.of + 1];
        Self::new(lens, Parameter::all(lens).filter(chosen).collect())
    }

    /// Scaled values of `lens`; 0 for what it has no number of.
    pub fn values(&self, lens: &Lens) -> Vec<f64> {
        self.parameters.iter().zip(&self.scales).map(|(p, s)| p.value(&**lens).unwrap_or(0.0) / s).collect()
    }

    /// `base` with the scaled `values` put in.
    ///
    /// # Errors
    /// Values that are no lens.
    pub fn lens(&self, base: &Lens, values: &[f64]) -> Result<Lens> {
        base.changed(|lens| self.put(lens, values))
    }

    /// Puts the scaled `values` into the numbers of a lens.
    pub fn put(&self, lens: &mut Prescription, values: &[f64]) {
        for ((p, s), v) in self.parameters.iter().zip(&self.scales).zip(values) {
            if let Some(number) = p.kind.list_mut(lens, p.of).get_mut(p.entry) {
                *number = v * s;
            }
        }
    }

    /// Gradient with respect to the scaled values.
    pub fn gradient(&self, g: &LensGradient) -> Vec<f64> {
        self.parameters.iter().zip(&self.scales).map(|(p, s)| p.value(g).unwrap_or(0.0) * s).collect()
    }
}
