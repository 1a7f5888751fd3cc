//! What rays have at a pupil's coordinates.

use glam::DVec2;

use super::super::stop::Part;
use super::fitted::Fitted;

/// Functions over the pupil, even across the meridian: path (mm, less the nodes' mean), direction cosine and place in the stop along it, and from [`CLIPS`] on
/// what is positive within each clear aperture.
pub(super) const PATH: usize = 0;
pub(super) const COSINE: usize = 1;
pub(super) const STOP: usize = 2;
pub(super) const CLIPS: usize = 3;
/// Functions odd across it: direction cosine and place in the stop.
pub(super) const ODD_COSINE: usize = 0;
pub(super) const ODD_STOP: usize = 1;

/// Path, direction cosines, places in the stop and clear apertures over the pupil.
#[derive(Clone, Debug)]
pub(super) struct PupilFunctions {
    pub(super) wavelength_mm: f64,
    /// Part of the stop that is known.
    pub(super) part: Part,
    pub(super) fitted: Fitted,
    /// `τ` of the rays, of the half across the meridian that is not negative.
    pub(super) tau: Vec<DVec2>,
}

impl PupilFunctions {
    /// How far inside the border of what is known a point of the stop lies.
    pub(super) fn border(&self, s: DVec2) -> f64 {
        self.part.depth(DVec2::new(s.x.abs(), s.y)).min(1.0)
    }

    /// How [`Self::border`] changes.
    pub(super) fn border_slope(&self, s: DVec2) -> DVec2 {
        let step = 1e-6;
        let along = |d: DVec2| (self.border(s + step * d) - self.border(s - step * d)) / (2.0 * step);
        DVec2::new(along(DVec2::X), along(DVec2::Y))
    }
}
