//! From rays to point spread functions.
//!
//! A PSF belongs to an object point. [`pupil`] traces a few rays aimed at the real stop and continues them to a
//! dense set by a polynomial over the stop; [`splat`] turns landings into a kernel at the sensor's pitch;
//! [`grid`] does so over field, depth and wavelength, with the adjoint of all of it; [`chief`] gives the chief-ray
//! landings that the distortion fit stands on.

pub mod chief;
mod clip;
pub mod field_table;
pub mod fine;
mod fit;
mod old_fit;
pub mod sensor_map;
pub mod stop;
pub mod table;
pub mod grid;
pub mod pupil;
pub mod illumination;
pub mod kernel;
pub mod old_splat;
pub mod optics;
pub mod splat;
#[cfg(test)]
mod tests;

pub use grid::{PsfGrid, PsfPlan};
pub use kernel::{KernelForm, Place};
pub use optics::{Optics, OpticsBar, OpticsSpec, Quadrature};
pub use sensor_map::SensorMap;
