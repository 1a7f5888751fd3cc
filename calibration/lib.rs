//! The sensors that Isoplanat ships, as the texts of their files; `README.md` beside this file documents the form.

/// A generic 12-bit camera with a Bayer mosaic: TOML of a `sensor.toml`.
pub const GENERIC_RGGB: &str = include_str!("generic-rggb/sensor.toml");
