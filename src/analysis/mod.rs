//! What an optical engineer asks of one lens: numbers and curves that [`crate::report`] draws.
//!
//! Every analysis starts from rays that are aimed at the real stop from one object point ([`beam`]); plain data come out. Nothing here is
//! differentiated: gradients belong to `psf` and `optimize`.

pub mod beam;
pub mod diffraction;
pub mod wavefront;
pub mod zernike;
