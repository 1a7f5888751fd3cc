//! How rays go through a lens, and how cotangents come back.
//!
//! One ray, one surface: transfer to the surface's frame, intersect ([`intersect`]), refract ([`refract`]); the loop
//! over surfaces is [`sequential`]. Rays are launched from an object point at any angle through a plane before the lens
//! ([`object`]) and aimed at the real stop ([`aim`]).
//! `pupil` finds what apertures leave of it, [`wavefront`] the optical path difference in it. All of it is f64. A ray
//! that fails is data: [`Failure`].
//!
//! ```
//! use glam::{DVec2, DVec3};
//! use isoplanat_optics::lens::{LensGradient, builtin};
//! use isoplanat_optics::trace::aim::Aimer;
//! use isoplanat_optics::trace::sequential::{HitBar, trace, trace_vjp};
//! use isoplanat_optics::trace::{ObjectPoint, System, SystemGradient};
//!
//! let lens = builtin::lens("cooke_triplet")?;
//! let system = System::new(&lens, 587.6);
//! // The chief ray of 14°: where it meets the sensor, mm.
//! let object = ObjectPoint::in_field(&lens, 14f64.to_radians(), std::f64::consts::FRAC_PI_2);
//! let aimed = Aimer::new(&system).and_then(|a| a.aim(object, DVec2::ZERO, None)).expect("light");
//! let mut hits = Vec::new();
//! let height = trace(&system, aimed.ray, system.image(), &mut hits).expect("lands").at.point.y.abs();
//! assert!((height - 12.4).abs() < 0.1, "{height}");
//! // How the height of this ray (held before the lens) answers to the first curvature.
//! let mut bars = vec![HitBar::default(); hits.len()];
//! bars[system.image()].point = DVec3::Y;
//! let mut back = SystemGradient::zeros(&system);
//! trace_vjp(&system, &hits, &bars, &mut back);
//! let mut gradient = LensGradient::zeros(&lens);
//! back.add_to(&lens, 587.6, &mut gradient);
//! assert!(gradient.surfaces[0].shape.curvature != 0.0);
//! # Ok::<(), isoplanat_base::error::Error>(())
//! ```

pub mod aim;
#[doc(hidden)]
pub mod apertures;
#[doc(hidden)]
pub mod differential;
#[doc(hidden)]
pub mod exact;
pub(crate) mod exit_pupil;
#[doc(hidden)]
pub mod first_root;
pub mod health;
mod ideal;
pub mod intersect;
mod landing;
#[doc(hidden)]
pub mod lanes;
pub mod object;
#[doc(hidden)]
pub mod precise;
pub(crate) mod pupil;
#[doc(hidden)]
pub mod refract;
#[doc(hidden)]
pub mod rims;
pub mod sequential;
pub mod system;
#[cfg(test)]
pub(crate) mod test_lenses;
pub mod wavefront;

use glam::DVec3;

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

    /// In words.
    pub(crate) fn words(self) -> &'static str {
        match self {
            Self::Missed => "no intersection",
            Self::Vignetted => "beyond the clear aperture",
            Self::TotalReflection => "total reflection",
            Self::NotConverged => "an intersection that was not found",
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
