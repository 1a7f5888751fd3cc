//! What the lens is: validated numbers, no rays.
//!
//! A [`Lens`] is a list of rotationally symmetric [`Surface`]s in the order the light meets them, a stop, an object
//! distance (as vergence) and the raster the image falls on. Lengths mm, angles radians.

pub mod asphere;

pub use asphere::Shape;
