//! What readers hand on: interleaved samples as a file has them.

use std::path::Path;

use crate::develop::profile::Told;
use isoplanat_base::error::{Error, Result};

/// What a picture's file may be.
pub(super) const ALLOWED: &str = "a PNG, JPEG or TIFF picture, or an array (.npy)";

/// Samples of a file.
pub(super) enum Samples {
    U8(Vec<u8>),
    U16(Vec<u16>),
    /// Whole numbers of so many bits, as shares of the largest.
    Whole(Vec<f64>, u8),
    F32(Vec<f32>),
    F64(Vec<f64>),
}

/// What a file holds, interleaved: `[row, col, channel]`.
pub(super) struct Content {
    pub(super) rows: usize,
    pub(super) cols: usize,
    /// 1 or 3.
    pub(super) channels: usize,
    pub(super) samples: Samples,
    /// How to turn it upright, as Exif has it.
    pub(super) orientation: u8,
    /// What it says of its numbers.
    pub(super) told: Option<Told>,
}

/// The content, if all of it are numbers, also in the 32 bits that pictures are computed in.
pub(super) fn finite(path: &Path, content: Content) -> Result<Content> {
    let wrong = match &content.samples {
        Samples::F32(v) => v.iter().position(|v| !v.is_finite()),
        Samples::F64(v) => v.iter().position(|v| !(*v as f32).is_finite()),
        _ => None,
    };
    let Some(at) = wrong else { return Ok(content) };
    let pixel = at / content.channels;
    let place = format!("row {}, column {}", pixel / content.cols, pixel % content.cols);
    Err(Error::bad(
        path.display().to_string(),
        place,
        "a sample that is not a finite number",
        "finite numbers of 32 bits",
    ))
}
