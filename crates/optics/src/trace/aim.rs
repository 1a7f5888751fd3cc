//! Rays aimed at a point of the real stop, with the implicit derivative of the aiming.
//!
//! The unknowns are the two coordinates `p` of the launch ray in a plane perpendicular to the light of its object ([`Aimer`]: any angle,
//! near, infinitely far and virtual objects, pupils anywhere, at infinity too), or its direction cosines at the sensor ([`SensorView`]).
//! Newton on `S(p) = s` from the paraxial pupil (`aim/newton.rs`) settles the ordinary ray in a few traces. Where it
//! fails (wide angles, fast lenses: the first guess misses a surface) the light is followed backwards from the stop
//! (`aim/backward.rs`), walking from the axis to the field, and Newton only confirms. At the solution
//! `δp = −S_p⁻¹ (S_θ δθ)`: [`aimed_vjp`].

mod aimer;
mod backward;
mod newton;
mod paraxial;
mod sensor;

pub use aimer::{Aimed, AimedBar, Aimer, aimed_vjp};
pub use sensor::{Crossings, SceneRay, SceneRayBar, SensorView};

#[cfg(test)]
mod tests;
