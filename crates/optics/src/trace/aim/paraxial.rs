//! Paraxial aiming: the first guess of every aimed ray.

use glam::{DVec2, DVec3};

use super::super::System;
use super::super::object::LaunchPlane;

/// How the stop is seen paraxially from object space. The entrance pupil stands at `skew/parallel` from the first vertex, `1/parallel` times
/// as large as the stop; kept as the pair, so that a pupil at infinity is no special case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ParaxialStop {
    /// Height in the stop of the ray that enters parallel to the axis at height 1.
    parallel: f64,
    /// Height in the stop of the ray through the first vertex with slope 1.
    skew: f64,
}

impl ParaxialStop {
    /// Of `system`, tilts and freeform terms left out.
    pub(super) fn of(system: &System) -> Self {
        let height = |y: f64, w: f64| {
            let (mut y, mut w) = (y, w);
            for (i, s) in system.surfaces[..=system.stop].iter().enumerate() {
                if i > 0 {
                    y += s.distance / s.index_before * w;
                }
                if i < system.stop {
                    w -= s.shape.deflection(y, s.index_before, s.index_after);
                }
            }
            y
        };
        Self { parallel: height(1.0, 0.0), skew: height(0.0, system.surfaces[0].index_before) }
    }

    /// The point of `plane` whose ray runs through the paraxial pupil's point of `target`.
    pub(super) fn guess(&self, plane: &LaunchPlane, target: DVec2) -> DVec2 {
        let DVec2 { x, y } = target;
        plane.towards(DVec3::new(x, y, self.skew), self.parallel)
    }
}
