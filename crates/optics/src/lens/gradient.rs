//! One cotangent for every number of a lens.

use super::numbers::lists;
use super::{Aperture, Element, Prescription, Surface};

/// Cotangents of a whole lens, in the lens's own form: each stands where its number does. At the stop the size of the stop counts,
/// which `aperture` states, and not the surface's own clear semi-diameter.
#[derive(Clone, Debug, PartialEq)]
pub struct LensGradient {
    /// One entry per surface.
    pub surfaces: Vec<Surface>,
    /// Displacements of the elements.
    pub elements: Vec<Element>,
    /// The number that states the aperture.
    pub aperture: Aperture,
}

impl LensGradient {
    /// All zero, in the form of `lens`.
    pub fn zeros(lens: &Prescription) -> Self {
        let mut zeros =
            Self { surfaces: lens.surfaces.clone(), elements: lens.elements.clone(), aperture: lens.aperture };
        lists(lens).for_each(|(kind, of)| kind.list_mut(&mut zeros, of).fill(0.0));
        zeros
    }

    /// Adds `other`.
    pub fn add(&mut self, other: &Self) {
        for (kind, of) in lists(other) {
            kind.list_mut(self, of).iter_mut().zip(kind.list(other, of)).for_each(|(a, b)| *a += b);
        }
    }

    /// Adds cotangents of the indices at `nm` (entry 0 is the object space), chained to the glasses' numbers.
    pub fn add_indices(&mut self, lens: &Prescription, nm: f64, index_bar: &[f64]) {
        for ((g, s), bar) in self.surfaces.iter_mut().zip(&lens.surfaces).zip(&index_bar[1..]) {
            s.medium.index_vjp(nm, *bar, &mut g.medium);
        }
    }
}
