//! How rays go through a lens, and how cotangents come back.
//!
//! One ray, one surface: transfer to the surface's frame, intersect ([`intersect`]), refract ([`refract`]); the loop
//! over surfaces is [`sequential`]. Rays are launched from a field point through a point of the first vertex plane
//! ([`launch`]), or at any angle from a plane before the lens ([`object`]), and aimed at the real stop ([`aim`]).
//! [`pupil`] finds what apertures leave of it, [`wavefront`] the optical path difference in it. All of it is f64. A ray
//! that fails is data: [`Failure`].

pub mod aim;
pub mod differential;
pub mod exact;
pub mod exit_pupil;
pub mod first_root;
pub mod health;
pub mod intersect;
mod landing;
pub mod lanes;
pub mod launch;
pub mod object;
pub mod precise;
pub mod pupil;
pub mod refract;
pub mod rims;
pub mod sequential;
pub mod system;
#[cfg(test)]
pub(crate) mod test_lenses;
pub mod wavefront;

use glam::DVec3;

pub use launch::FieldPoint;
pub use object::ObjectPoint;
pub use system::{System, SystemGradient};

/// A ray: a point and a unit direction, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Point, in the frame of the first vertex unless said otherwise.
    pub origin: DVec3,
    /// Unit direction.
    pub direction: DVec3,
}

/// Why a ray went no further.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// No intersection with the surface.
    Missed,
    /// Beyond a clear aperture.
    Vignetted,
    /// Total internal reflection.
    TotalReflection,
    /// The intersection or the aiming did not converge.
    NotConverged,
}

impl Cause {
    /// Its name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Missed => "missed",
            Self::Vignetted => "vignetted",
            Self::TotalReflection => "total_reflection",
            Self::NotConverged => "not_converged",
        }
    }
}

/// A failed ray: cause and surface (counted from 0; the image plane is the last).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Failure {
    /// Why.
    pub cause: Cause,
    /// Where.
    pub surface: usize,
}
