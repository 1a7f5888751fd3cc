//! What an optical engineer asks of one lens: numbers and curves, which reports draw.
//!
//! Every analysis starts from rays that are aimed at the real stop from one object point: [`beam`] for what rays say ([`spot`], [`fan`], [`curves`]), [`wavefront`] with [`zernike`] and [`diffraction`] for what waves
//! say; [`overview`] is all of it for one lens; [`fabrication`] is what a workshop makes, [`deviations`] what may be off in one that is built, [`tolerancing`] what that costs, [`scatter`] what its polish does. Plain data come out. Nothing here is
//! differentiated: gradients belong to `psf` and `optimize`.

pub mod beam;
#[cfg(test)]
mod curved_image;
pub mod curves;
#[doc(hidden)]
pub mod deviations;
pub mod diffraction;
pub mod fabrication;
pub mod fan;
#[cfg(test)]
mod immersion;
pub mod overview;
pub mod scatter;
pub mod spot;
#[cfg(test)]
mod telecentric;
pub mod tolerancing;
pub mod wavefront;
pub mod zernike;
