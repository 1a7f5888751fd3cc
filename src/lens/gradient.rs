//! One cotangent for every number of a lens.

use super::numbers::lists;
use super::{Aperture, Element, Lens, Medium, Surface};

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
    pub fn zeros(lens: &Lens) -> Self {
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

    /// Adds cotangents of the indices at `nm` (entry 0 is the object space), chained to `n_d` and `v_d`.
    pub fn add_indices(&mut self, lens: &Lens, nm: f64, index_bar: &[f64]) {
        for ((g, s), bar) in self.surfaces.iter_mut().zip(&lens.surfaces).zip(&index_bar[1..]) {
            if let (Some((by_n, by_v)), Medium::Cauchy { n_d, v_d }) = (s.medium.index_gradient(nm), &mut g.medium) {
                *n_d += bar * by_n;
                *v_d += bar * by_v;
            }
        }
    }
}
