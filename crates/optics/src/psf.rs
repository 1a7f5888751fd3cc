//! What a lens does to light, as image formation reads it.
//!
//! Rays are traced from the sensor: [`table`] aims them from a few sensor radii through nodes of the real stop and keeps
//! where they come from as polynomials over the stop, for every radius and object distance. [`illumination`], `sensor_map`
//! (distortion) and [`kernel`] (point spread functions) are read from it; [`optics`] holds all of them as one value, in
//! which their cotangents add up before they go back to the lens. [`measured`] keeps kernels that were measured on a camera, which an
//! [`Optics`] holds in place of rays.

#[doc(hidden)]
pub mod bent;
mod convolved;
#[doc(hidden)]
pub mod corner;
mod fit;
pub(crate) mod hull;
#[doc(hidden)]
pub mod illumination;
#[doc(hidden)]
pub mod kernel;
pub mod measured;
mod meridian;
mod model;
pub mod optics;
mod point;
mod rays;
pub(crate) mod sensor_map;
#[doc(hidden)]
pub mod splat;
#[doc(hidden)]
pub mod stop;
#[doc(hidden)]
pub mod table;
#[doc(hidden)]
pub mod wave;

pub use kernel::KernelForm;
#[doc(hidden)]
pub use model::Model;
pub use optics::{Optics, OpticsBar, OpticsSpec, Quadrature};
pub use point::SensorPoint;
pub use sensor_map::SensorMap;
#[doc(hidden)]
pub use sensor_map::{LineBar, SensorLine};
pub use table::chief_slopes;
