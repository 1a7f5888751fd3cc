//! Isoplanat designs a camera lens and its reconstruction network together.
//!
//! Light and gradients run along one line of floors, each a crate of its own that is found here under its modules' names; a floor uses only those
//! before it:
//!
//! ```text
//! prescription ─► lens ─► trace ─► psf ─► imaging ─► network ─► loss
//!      ▲                                                          │
//!      └────────── design ◄── adjoints, stage by stage ◄──────────┘
//!                                   imaging ─► capture.dng ─► deploy: RAW ► ONNX ► undistort ► picture
//! ```
//!
//! | here | crate |
//! |---|---|
//! | [`error`], [`atomic`], [`units`], [`math`] | `isoplanat-base` |
//! | [`lens`], [`trace`], [`interchange`], [`optimize`], [`psf`], [`analysis`] | `isoplanat-optics` |
//! | [`imaging`], [`calibrate`] | `isoplanat-imaging` |
//! | [`network`] | `isoplanat-network` (feature `train`), its contract with the camera `isoplanat-card` |
//! | `deploy` | `isoplanat-camera` (feature `deploy`) |
//! | [`report`], `design` (feature `train`) | this one |
//!
//! Units are mm, radians in code, degrees in files (`_deg`), wavelengths in nm in files (`_nm`) and µm in
//! dispersion formulas (`_um`). `z` runs along the light, `+y` is up. Images are `[channel, row, col]` in linear light.

#[doc(hidden)]
pub use isoplanat_base::testing;
pub use isoplanat_base::{Error, Result, atomic, error, figures, math, refusing, terminal, units};

pub use isoplanat_optics::{analysis, interchange, lens, optimize, psf, trace};

pub use isoplanat_imaging as imaging;
pub use isoplanat_imaging::calibrate;

pub mod report;

/// The reconstruction network: the contract with the camera without burn; model, training and export behind the feature `train`.
pub mod network {
    pub use isoplanat_card::{self as card, Blocks};
    #[cfg(feature = "train")]
    pub use isoplanat_network::*;
}

#[cfg(feature = "train")]
pub mod design;

#[cfg(feature = "deploy")]
pub use isoplanat_camera as deploy;
