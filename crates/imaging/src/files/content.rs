//! What readers hand on: interleaved samples as a file has them.

use std::path::Path;

use crate::develop::profile::Told;
use isoplanat_base::error::{Error, Result};

/// What a picture's file may be.
pub(super) const ALLOWED: &str = "a PNG, JPEG or TIFF picture, or an array (.npy)";

/// A decoder's failure to read: the system's where it has a number, else what the decoder says of damaged bytes.
pub(super) fn unread(path: &Path, e: std::io::Error) -> Error {
    if e.raw_os_error().is_some() {
        return Error::reading(path, e);
    }
    Error::bad(path.display().to_string(), "picture", format!("damaged ({e})"), ALLOWED)
}

/// Samples of a file.
pub(super) enum Samples {
    U8(Vec<u8>),
    U16(Vec<u16>),
    /// Whole numbers of so many bits, as shares of the largest.
    Whole(Vec<f64>, u8),
    F32(Vec<f32>),
    F64(Vec<f64>),
}

/// A channel behind the colours that is not opaque everywhere. It is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Alpha {
    /// The colours are whole.
    Apart,
    /// The colours are multiplied by it.
    Multiplied,
}

impl Alpha {
    /// What was done, for whoever reads the picture.
    pub(super) fn words(self) -> &'static str {
        match self {
            Self::Apart => "its alpha (transparency) is left out: colours are taken as if they covered all behind them",
            Self::Multiplied => {
                "its colours are multiplied by alpha (transparency) and are taken so: as they stand before black"
            }
        }
    }
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
    /// What stands beside the colours and changes them.
    pub(super) alpha: Option<Alpha>,
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
