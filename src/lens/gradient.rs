//! One cotangent for every number of a lens.

use super::{Lens, Pose, Shape};

/// Cotangents of one surface.
#[derive(Clone, Debug, PartialEq)]
pub struct SurfaceGradient {
    /// Curvature, conic, polynomial coefficients.
    pub shape: Shape,
    /// Thickness behind the surface.
    pub thickness: f64,
    /// Index at the d line of the medium behind it (Cauchy media only).
    pub n_d: f64,
    /// Abbe number of the medium behind it (Cauchy media only).
    pub v_d: f64,
    /// Clear semi-diameter.
    pub semi_diameter: f64,
    /// Tilt and decentre, where the surface states them.
    pub pose: Pose,
}

/// Cotangents of a whole lens, in the lens's own order.
#[derive(Clone, Debug, PartialEq)]
pub struct LensGradient {
    /// One entry per surface.
    pub surfaces: Vec<SurfaceGradient>,
    /// Displacements of the elements.
    pub elements: Vec<Pose>,
}

impl LensGradient {
    /// All zero, in the form of `lens`.
    pub fn zeros(lens: &Lens) -> Self {
        let surfaces = lens
            .surfaces
            .iter()
            .map(|s| SurfaceGradient {
                shape: s.shape.zeros_like(),
                thickness: 0.0,
                n_d: 0.0,
                v_d: 0.0,
                semi_diameter: 0.0,
                pose: Pose::default(),
            })
            .collect();
        Self { surfaces, elements: vec![Pose::default(); lens.elements.len()] }
    }

    /// Adds `other`.
    pub fn add(&mut self, other: &Self) {
        for (a, b) in self.surfaces.iter_mut().zip(&other.surfaces) {
            a.shape.add(&b.shape);
            a.pose.add(&b.pose);
            a.thickness += b.thickness;
            a.n_d += b.n_d;
            a.v_d += b.v_d;
            a.semi_diameter += b.semi_diameter;
        }
        self.elements.iter_mut().zip(&other.elements).for_each(|(a, b)| a.add(b));
    }

    /// Adds cotangents of the indices at `nm` (entry 0 is the object space), chained to `n_d` and `v_d`.
    pub fn add_indices(&mut self, lens: &Lens, nm: f64, index_bar: &[f64]) {
        for ((g, s), bar) in self.surfaces.iter_mut().zip(&lens.surfaces).zip(&index_bar[1..]) {
            if let Some((by_n, by_v)) = s.medium.index_gradient(nm) {
                g.n_d += bar * by_n;
                g.v_d += bar * by_v;
            }
        }
    }
}
