//! RAW file to samples, levels and colour facts; the only place that names the decoder crate.
//!
//! The decoder can panic, or ask for far more memory than the picture needs, on files that are not what they say.
//! [`decode`] catches what unwinds; programs should decode in a child process, see [`crate::raw_process`]. In `raw/`: black and white levels,
//! colour filters by name, what a DNG's directory says beyond the decoder, colours, and the facts of the exposure.

mod colour;
mod dng;
mod exposure;
mod filter;
mod levels;
mod opcodes;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Arc;

use ndarray::{Array2, Array3};
use rawler::decoders::{FormatHint, RawDecodeParams, WellKnownIFD};
use rawler::formats::tiff::IFD;
use rawler::rawimage::{RawImage, RawImageData, RawPhotometricInterpretation};
use rawler::rawsource::RawSource;
use rawler::tags::TiffCommonTag;

use crate::orientation::Orientation;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::exif::Exif;
use isoplanat_imaging::sensor::cfa::Cfa;

use filter::{Filter, filter};
use levels::Levels;

/// The sensor's samples in digital numbers, active area only.
#[derive(Clone, Debug, PartialEq)]
pub enum RawPixels {
    /// One sample a pixel behind a Bayer filter, `[row, col]`.
    Mosaic {
        /// The samples.
        samples: Array2<f32>,
        /// The layout at the first pixel.
        cfa: Cfa,
    },
    /// Three samples a pixel (linear DNG), `[channel, row, col]`.
    Linear(Array3<f32>),
    /// One sample a pixel without colours (monochrome cameras), `[row, col]`.
    Grey(Array2<f32>),
}

/// A part of the active area.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Area {
    /// First row.
    pub row: usize,
    /// First column.
    pub column: usize,
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
}

/// A decoded RAW file.
#[derive(Clone, Debug, PartialEq)]
pub struct RawCapture {
    /// The samples.
    pub pixels: RawPixels,
    /// Black level in digital numbers, per place in the 2×2 cell (`row parity · 2 + column parity`) of the first
    /// pixel, or per channel R, G, B (last entry unused) for linear pictures.
    pub black: [f32; 4],
    /// White level, like [`RawCapture::black`].
    pub white: [f32; 4],
    /// Whether corrections that the file asks for were made: the samples run from 0 to 1 then and are no digital numbers.
    pub corrected: bool,
    /// The part that a finished picture shows: a DNG's default crop, else all. Whatever is bound to places of the sensor counts from the active area's
    /// first pixel, so this is cut out last.
    pub crop: Area,
    /// Response `[R, G, B]` to what the camera held for neutral, green 1; `None` where the file does not say.
    pub neutral: Option<[f64; 3]>,
    /// Camera RGB from XYZ (D65 or the nearest illuminant the file or the decoder's tables offer).
    pub camera_from_xyz: Option<[[f64; 3]; 3]>,
    /// How to turn it upright.
    pub orientation: Orientation,
    /// Camera maker.
    pub make: String,
    /// Camera model.
    pub model: String,
    /// Facts of the exposure, maker and model among them.
    pub exif: Exif,
    /// What the file asks for and is not done, one sentence each.
    pub notes: Vec<String>,
}

impl RawCapture {
    /// `(rows, columns)` of the active area.
    pub fn size(&self) -> (usize, usize) {
        match &self.pixels {
            RawPixels::Mosaic { samples, .. } | RawPixels::Grey(samples) => samples.dim(),
            RawPixels::Linear(samples) => (samples.dim().1, samples.dim().2),
        }
    }
}

/// What a file to decode may be.
pub(super) const ALLOWED: &str = "a RAW file of a supported camera, or a DNG";

/// Whether a file's name ends as RAW files' do that the decoder knows.
pub fn has_raw_name(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    // The decoder goes by content: Sony's older ending of what it reads as ARW is not in its list.
    let mut known = rawler::decoders::supported_extensions().iter().copied().chain(["SR2"]);
    known.any(|known| known.eq_ignore_ascii_case(&ending))
}

/// Bytes of a RAW file at most.
const LARGEST: u64 = 4 << 30;

/// Decodes a RAW file in this process.
///
/// # Errors
/// A file that cannot be read; as [`decode_bytes`].
pub fn decode(path: &Path) -> Result<RawCapture> {
    decode_bytes(isoplanat_base::atomic::read_bounded(path, LARGEST)?, path)
}

/// Decodes a RAW file's bytes in this process; `path` names them in messages.
///
/// # Errors
/// Bytes that are cut short, are no RAW, or whose facts contradict each other; a panic of the decoder becomes an error too. Memory is not limited here.
pub fn decode_bytes(bytes: Vec<u8>, path: &Path) -> Result<RawCapture> {
    if bytes.is_empty() {
        return Err(bad(path, "the file is empty", ALLOWED));
    }
    let length = bytes.len() as u64;
    let outcome = catch_unwind(AssertUnwindSafe(|| {
        let source = RawSource::new_from_shared_vec(Arc::new(bytes)).with_path(path);
        let decoder = rawler::get_decoder(&source).map_err(|e| refused(path, &e.to_string()))?;
        let directory = catch_unwind(AssertUnwindSafe(|| decoder.ifd(WellKnownIFD::Raw).ok().flatten())).ok().flatten();
        if let Some(directory) = &directory {
            check_extent(path, directory, length)?;
        }
        let dng = directory.filter(|_| decoder.format_hint() == FormatHint::DNG);
        if let Some(directory) = &dng {
            dng::check_filter(path, directory)?;
            dng::check_order(path, directory)?;
        }
        let parameters = RawDecodeParams::default();
        let image = decoder.raw_image(&source, &parameters, false).map_err(|e| refused(path, &e.to_string()))?;
        let root = catch_unwind(AssertUnwindSafe(|| decoder.ifd(WellKnownIFD::Root).ok().flatten())).ok().flatten();
        let root = root.filter(|_| dng.is_some());
        let copy = root.as_ref().map(|root| colour::of_copy(path, root, &image)).transpose()?.flatten();
        let exif = catch_unwind(AssertUnwindSafe(|| decoder.raw_metadata(&source, &parameters).ok()));
        let exif = exif.ok().flatten().map(|m| m.exif);
        let exif_orientation = exif.as_ref().and_then(|e| e.orientation);
        let orientation = exif_orientation.unwrap_or_else(|| image.orientation.to_u16());
        let mut capture = capture_from(path, image, Orientation::from_exif(orientation), dng.as_deref())?;
        capture.exif = exposure::facts_of(exif.as_ref(), &capture.make, &capture.model);
        if let (Some(root), Some(copy)) = (&root, &copy) {
            let by_chromaticity = root.get_entry(rawler::tags::DngTag::AsShotNeutral).is_none();
            (capture.neutral, capture.camera_from_xyz) =
                colour::with_copy(copy, capture.neutral, capture.camera_from_xyz, by_chromaticity);
        }
        if let Some(root) = &root {
            capture.notes.extend(dng::look_left_out(root));
        }
        if let Some(directory) = &dng {
            capture.notes.extend(dng::left_out(directory));
            dng::apply_opcodes(path, directory, &mut capture)?;
        }
        Ok(capture)
    }));
    outcome.unwrap_or_else(|_| Err(refused(path, "the decoder gave up on it")))
}

fn bad(path: &Path, found: impl Into<String>, allowed: &str) -> Error {
    Error::bad(path.display().to_string(), "RAW", found, allowed)
}

/// One sentence from the decoder's own words: its first line, without the advice to report to its authors.
fn refused(path: &Path, reason: &str) -> Error {
    if reason.contains("behind EOF") {
        return bad(path, "the file is cut short", "a complete file");
    }
    let line = reason.lines().next().unwrap_or_default();
    let line = line.split("Please ").next().unwrap_or(line);
    let line = line.split(", model '").next().unwrap_or(line);
    let line = line
        .trim_start_matches("Error: ")
        .trim_start_matches("TODO: ")
        .trim_start_matches("Failed to decode image, possibly corrupt image: ");
    let line: String = line.trim().chars().filter(|c| !c.is_control()).take(200).collect();
    bad(path, format!("cannot be decoded ({line})"), ALLOWED)
}

/// Refuses a file that ends before the samples its directory promises.
fn check_extent(path: &Path, directory: &IFD, bytes: u64) -> Result<()> {
    let pairs = [
        (TiffCommonTag::StripOffsets, TiffCommonTag::StripByteCounts),
        (TiffCommonTag::TileOffsets, TiffCommonTag::TileByteCounts),
    ];
    for (offsets, counts) in pairs {
        let (Some(offsets), Some(counts)) = (directory.get_entry(offsets), directory.get_entry(counts)) else {
            continue;
        };
        for i in 0..offsets.count().min(counts.count()) as usize {
            let end = offsets.force_u64(i).saturating_add(counts.force_u64(i));
            if end > bytes {
                let found = format!("the file is cut short: {bytes} bytes where its samples need {end}");
                return Err(bad(path, found, "a complete file"));
            }
        }
    }
    Ok(())
}

/// Checks the decoder's result and cuts it to the active area.
fn capture_from(path: &Path, image: RawImage, orientation: Orientation, dng: Option<&IFD>) -> Result<RawCapture> {
    let (rows, columns, planes) = (image.height, image.width, image.cpp);
    if !(1..=65_536).contains(&rows) || !(1..=65_536).contains(&columns) {
        return Err(bad(path, format!("{columns} × {rows} pixels"), "1 to 65536 pixels a side"));
    }
    let (mut top, mut left, mut height, mut width) = (0, 0, rows, columns);
    if let Some(area) = image.active_area {
        let fits =
            |start: usize, size: usize, all: usize| size > 0 && start.checked_add(size).is_some_and(|e| e <= all);
        if !(fits(area.p.y, area.d.h, rows) && fits(area.p.x, area.d.w, columns)) {
            let ([x, y], [w, h]) = ([area.p.x, area.p.y], [area.d.w, area.d.h]);
            let found = format!("active area of {w} × {h} from column {x}, row {y} of {columns} × {rows} pixels");
            return Err(bad(path, found, "an area within it"));
        }
        (top, left, height, width) = (area.p.y, area.p.x, area.d.h, area.d.w);
    }
    let samples = match &image.data {
        RawImageData::Integer(data) => data.len(),
        RawImageData::Float(data) => data.len(),
    };
    if samples != rows * columns * planes {
        let found = format!("{samples} samples for {columns} × {rows} × {planes}");
        return Err(bad(path, found, "as many samples as pixels"));
    }
    if matches!(&image.data, RawImageData::Float(data) if !data.iter().all(|v| v.is_finite())) {
        return Err(bad(path, "a sample that is not a finite number", "finite samples"));
    }
    // One copy, already cut: large captures have to fit the memory limit.
    let sample = |plane: usize, row: usize, column: usize| {
        let at = ((top + row) * columns + left + column) * planes + plane;
        match &image.data {
            RawImageData::Integer(data) => f32::from(data[at]),
            RawImageData::Float(data) => data[at],
        }
    };
    let size = (height, width);
    // A DNG's table of black levels starts with its active area, others with the sensor.
    let first = if dng.is_some() { (0, 0) } else { (top, left) };
    let deltas = dng.map(|directory| dng::deltas(path, directory, size)).transpose()?;
    let levels = Levels::of(path, &image, first, size, deltas)?;
    let crop = match dng {
        Some(directory) => dng::crop(path, directory, size)?,
        None => Area { row: 0, column: 0, rows: height, columns: width },
    };
    let plane = || {
        let mut samples = Array2::from_shape_fn(size, |(r, c)| sample(0, r, c));
        levels.flatten(samples.view_mut(), None);
        samples
    };
    let pixels = match (&image.photometric, planes) {
        (RawPhotometricInterpretation::Cfa(config), 1) => {
            let cfa = &config.cfa;
            let colours = (0..cfa.height).flat_map(|r| (0..cfa.width).map(move |c| (r, c)));
            let colours: Vec<u8> = colours.map(|(r, c)| u8::try_from(cfa.color_at(r, c)).unwrap_or(u8::MAX)).collect();
            match filter(cfa.height, cfa.width, &colours) {
                Filter::Bayer(cfa) => RawPixels::Mosaic { samples: plane(), cfa: cfa.shifted(top, left) },
                Filter::Grey => RawPixels::Grey(plane()),
                Filter::Other(name) => {
                    return Err(bad(path, name, "a Bayer filter (RGGB, BGGR, GRBG, GBRG), or no colours"));
                }
            }
        }
        (RawPhotometricInterpretation::LinearRaw | RawPhotometricInterpretation::BlackIsZero, 1) => {
            RawPixels::Grey(plane())
        }
        (RawPhotometricInterpretation::LinearRaw, 3) => {
            let mut samples = Array3::from_shape_fn((3, height, width), |(plane, r, c)| sample(plane, r, c));
            for (k, samples) in samples.outer_iter_mut().enumerate() {
                levels.flatten(samples, Some(k));
            }
            RawPixels::Linear(samples)
        }
        (kind, planes) => {
            let kind = match kind {
                RawPhotometricInterpretation::BlackIsZero => "a picture without a colour filter",
                RawPhotometricInterpretation::Cfa(_) => "a filtered picture",
                RawPhotometricInterpretation::LinearRaw => "a linear picture",
            };
            let found = format!("{kind} with {planes} samples a pixel");
            return Err(bad(path, found, "a Bayer mosaic, three colours, or none"));
        }
    };
    let make = if image.clean_make.is_empty() { image.make.clone() } else { image.clean_make.clone() };
    let model = if image.clean_model.is_empty() { image.model.clone() } else { image.clean_model.clone() };
    Ok(RawCapture {
        pixels,
        black: levels.black,
        white: levels.white,
        corrected: false,
        crop,
        neutral: colour::neutral(&image, dng.is_some()),
        camera_from_xyz: colour::camera_from_xyz(&image),
        orientation,
        make,
        model,
        exif: Exif::default(),
        notes: Vec::new(),
    })
}

#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod table;
#[cfg(test)]
mod tests;
