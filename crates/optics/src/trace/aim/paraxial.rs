//! The paraxial entrance pupil: the first guess of every aimed ray.

use glam::{DVec2, DVec3};

use super::super::System;
use super::super::launch::FieldPoint;

/// First guess: the paraxial entrance pupil at `z`, `scale` mm of pupil per mm of stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParaxialPupil {
    /// Position from the first vertex, mm.
    pub z: f64,
    /// Entrance-pupil radius over stop radius.
    pub scale: f64,
}

impl ParaxialPupil {
    /// The entrance pupil of `lens` at its primary wavelength.
    pub fn new(lens: &crate::lens::Lens) -> Self {
        let p = crate::lens::paraxial::first_order(lens, lens.wavelengths.primary_nm);
        Self { z: p.entrance_pupil_position, scale: 0.5 * p.entrance_pupil_diameter / p.stop_semi_diameter }
    }

    /// The entrance pupil of `system`, tilts and freeform terms left out.
    pub fn of(system: &System) -> Self {
        // Heights at the stop of the parallel ray and of the ray through the first vertex.
        let height = |y: f64, w: f64| {
            let (mut y, mut w) = (y, w);
            for (i, s) in system.surfaces[..=system.stop].iter().enumerate() {
                if i > 0 {
                    y += s.distance / s.index_before * w;
                }
                if i < system.stop {
                    let curvature = s.shape.curvature + 2.0 * s.shape.asphere.first().copied().unwrap_or(0.0);
                    w -= y * (s.index_after - s.index_before) * curvature;
                }
            }
            y
        };
        let n = system.surfaces[0].index_before;
        let (a, b) = (height(1.0, 0.0), height(0.0, n));
        Self { z: b / a, scale: a.recip() }
    }

    /// Guess on the first vertex plane.
    pub(super) fn guess(&self, field: FieldPoint, target: DVec2) -> DVec2 {
        (target * self.scale - self.z * field.slope) / (1.0 + self.z * field.vergence)
    }

    /// The pupil's point of `target`, frame of the first vertex.
    pub(super) fn point(&self, target: DVec2) -> DVec3 {
        (target * self.scale).extend(self.z)
    }
}
