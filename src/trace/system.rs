//! A lens at one wavelength: what a ray meets, image plane included.

use crate::lens::{Lens, LensGradient, Shape, paraxial};

/// One surface as a ray meets it.
#[derive(Clone, Debug, PartialEq)]
pub struct TraceSurface {
    /// Form.
    pub shape: Shape,
    /// Axial distance from the previous vertex, mm (0 for the first).
    pub distance: f64,
    /// Index before the surface.
    pub index_before: f64,
    /// Index behind it.
    pub index_after: f64,
    /// Clear semi-diameter, mm (infinite for the image plane).
    pub semi_diameter: f64,
    /// Whether polynomial terms are present (kept so that the inner loop does not search).
    pub aspheric: bool,
}

/// All surfaces of a lens at one wavelength; the image plane is the last.
#[derive(Clone, Debug, PartialEq)]
pub struct System {
    /// Wavelength, nm.
    pub wavelength_nm: f64,
    /// Surfaces, image plane last.
    pub surfaces: Vec<TraceSurface>,
    /// The stop's surface.
    pub stop: usize,
    /// Semi-diameter of the stop, mm.
    pub stop_semi_diameter: f64,
}

impl System {
    /// `lens` at `nm`.
    pub fn new(lens: &Lens, nm: f64) -> Self {
        let n = lens.indices(nm);
        let stop_semi_diameter = paraxial::stop_semi_diameter(lens);
        let mut surfaces = Vec::with_capacity(lens.surfaces.len() + 1);
        let mut distance = 0.0;
        for (i, s) in lens.surfaces.iter().enumerate() {
            surfaces.push(TraceSurface {
                shape: s.shape.clone(),
                distance,
                index_before: n[i],
                index_after: n[i + 1],
                semi_diameter: if i == lens.stop { stop_semi_diameter } else { s.semi_diameter },
                aspheric: s.shape.is_aspheric(),
            });
            distance = s.thickness;
        }
        let last = n[n.len() - 1];
        surfaces.push(TraceSurface {
            shape: Shape::default(),
            distance,
            index_before: last,
            index_after: last,
            semi_diameter: f64::INFINITY,
            aspheric: false,
        });
        Self { wavelength_nm: nm, surfaces, stop: lens.stop, stop_semi_diameter }
    }

    /// The same lens met from the sensor's side: the first vertex is the image plane, the last surface the former
    /// first vertex.
    #[must_use]
    pub fn reversed(&self) -> Self {
        let count = self.surfaces.len();
        let mut surfaces = Vec::with_capacity(count);
        let mut distance = 0.0;
        for s in self.surfaces.iter().rev() {
            surfaces.push(TraceSurface {
                shape: s.shape.reversed(),
                distance,
                index_before: s.index_after,
                index_after: s.index_before,
                semi_diameter: s.semi_diameter,
                aspheric: s.aspheric,
            });
            distance = s.distance;
        }
        Self {
            wavelength_nm: self.wavelength_nm,
            surfaces,
            stop: count - 1 - self.stop,
            stop_semi_diameter: self.stop_semi_diameter,
        }
    }

    /// Index of the image plane in [`Self::surfaces`].
    pub fn image(&self) -> usize {
        self.surfaces.len() - 1
    }
}

/// Cotangents of a [`System`].
#[derive(Clone, Debug, PartialEq)]
pub struct SystemGradient {
    /// Shapes of the surfaces (image plane included, unused).
    pub shapes: Vec<Shape>,
    /// Distances to the previous vertex.
    pub distances: Vec<f64>,
    /// Index of space `i`: entry 0 before the first surface, entry `i + 1` behind surface `i`.
    pub indices: Vec<f64>,
    /// Clear semi-diameters.
    pub semi_diameters: Vec<f64>,
    /// Semi-diameter of the stop.
    pub stop_semi_diameter: f64,
}

impl SystemGradient {
    /// All zero, in the form of `system`.
    pub fn zeros(system: &System) -> Self {
        let count = system.surfaces.len();
        Self {
            shapes: system.surfaces.iter().map(|s| s.shape.zeros_like()).collect(),
            distances: vec![0.0; count],
            indices: vec![0.0; count + 1],
            semi_diameters: vec![0.0; count],
            stop_semi_diameter: 0.0,
        }
    }

    /// Adds these cotangents to `gradient` of `lens`, glasses and stop size included.
    pub fn add_to(&self, lens: &Lens, wavelength_nm: f64, gradient: &mut LensGradient) {
        for (i, g) in gradient.surfaces.iter_mut().enumerate() {
            g.shape.curvature += self.shapes[i].curvature;
            g.shape.conic += self.shapes[i].conic;
            g.shape.asphere.iter_mut().zip(&self.shapes[i].asphere).for_each(|(a, b)| *a += b);
            g.thickness += self.distances[i + 1];
            if i != lens.stop {
                g.semi_diameter += self.semi_diameters[i];
            }
        }
        let image = lens.surfaces.len();
        let mut indices = self.indices[..=image].to_vec();
        // The image plane stands in the last space.
        indices[image] += self.indices[image + 1];
        gradient.add_indices(lens, wavelength_nm, &indices);
        let stop_bar = self.stop_semi_diameter + self.semi_diameters[lens.stop];
        if stop_bar != 0.0 {
            paraxial::first_order_vjp(lens, lens.wavelengths.primary_nm, 0.0, stop_bar, gradient);
        }
    }
}
