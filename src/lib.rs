//! Isoplanat designs a camera lens and its reconstruction network together.
//!
//! Light and gradients run along one line of modules, in this order; a module uses only those before it:
//!
//! ```text
//! prescription ─► lens ─► trace ─► psf ─► imaging ─► network ─► loss
//!      ▲                                                          │
//!      └────────── design ◄── adjoints, stage by stage ◄──────────┘
//!                                   imaging ─► capture.dng ─► deploy: RAW ► ONNX ► undistort ► picture
//! ```
//!
//! Units are mm, radians in code, degrees in files (`_deg`), wavelengths in nm in files (`_nm`) and µm in
//! dispersion formulas (`_um`). `z` runs along the light, `+y` is up. Images are `[channel, row, col]` in linear light.

pub mod error;

pub mod atomic;
pub mod units;

#[doc(hidden)]
pub mod testing;

pub mod math;

pub mod lens;

pub mod trace;

pub mod interchange;

pub mod optimize;

pub mod psf;

pub mod analysis;

pub mod imaging;

pub mod calibrate;

pub mod report;

pub mod network;

#[cfg(feature = "train")]
pub mod design;

#[cfg(feature = "deploy")]
pub mod deploy;

pub use error::{Error, Result};
