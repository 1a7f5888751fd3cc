//! Everything in pixels: from scene to RAW, and the tools that design and camera share.
//!
//! [`scene`] makes scenes, [`render`] takes them through a lens, [`mod@reference`] does so by rays from the sensor and judges it;
//! [`sensor`] says what a capture is, [`capture`] takes one, [`develop`] a capture into a picture, [`metrics`] compares pictures. [`calibrate`]
//! measures real cameras. [`plane`], [`frame`] and [`files`] are common ground. Images are `ndarray::Array3` `[channel, row, col]`, linear light, channel 0 = R,
//! 1 = G, 2 = B.

pub mod calibrate;
pub mod capture;
pub mod develop;
pub mod dng;
pub mod exif;
pub mod files;
pub mod frame;
pub mod guide;
pub mod metrics;
pub mod plane;
pub mod reference;
pub mod render;
pub mod scene;
pub mod sensor;
