//! TIFF samples that the `image` crate does not take: grey floating point, 16- and 64-bit floating point, whole numbers beyond 16 bits, bands.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{CompressionMethod, ExtraSamples, SampleFormat, Tag};
use tiff::{ColorType, TiffError};

use super::content::{ALLOWED, Alpha, Content, Samples, finite, unread};
use super::room::Room;
use crate::develop::profile::Told;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::memory::product;

/// Bytes of a picture at most.
const LARGEST: usize = 4 << 30;
/// How many bytes one of a compressed file can stand for: what deflate reaches, and some.
const EXPANSION: usize = 1100;

/// Compressions that differences of pixels belong to: LZW, deflate by both numbers, Zstandard.
const PREDICTED: [u16; 4] = [5, 8, 32946, 50000];

fn refused(path: &Path, e: TiffError) -> Error {
    match e {
        TiffError::IoError(e) => unread(path, e),
        e => Error::bad(path.display().to_string(), "picture", e.to_string(), ALLOWED),
    }
}

fn open(path: &Path) -> Result<Decoder<BufReader<File>>> {
    let file = File::open(path).map_err(|e| Error::reading(path, e))?;
    let bytes = file.metadata().map_err(|e| Error::reading(path, e))?.len();
    let most = usize::try_from(bytes).unwrap_or(usize::MAX).saturating_mul(EXPANSION).min(LARGEST);
    let mut limits = Limits::default();
    (limits.decoding_buffer_size, limits.intermediate_buffer_size) = (most, most);
    Ok(Decoder::new(BufReader::new(file)).map_err(|e| refused(path, e))?.with_limits(limits))
}

/// Rows and columns.
pub(super) fn size(path: &Path) -> Result<[usize; 2]> {
    let (cols, rows) = open(path)?.dimensions().map_err(|e| refused(path, e))?;
    Ok([rows as usize, cols as usize])
}

/// The samples of the first picture; `None` for forms that go another way.
pub(super) fn read(path: &Path, room: Room) -> Result<Option<Content>> {
    let refused = |e| refused(path, e);
    let bad = |found: String, allowed: &str| Error::bad(path.display().to_string(), "picture", found, allowed);
    let mut decoder = open(path)?;
    let (cols, rows) = decoder.dimensions().map_err(refused)?;
    let fill = decoder.find_tag_unsigned::<u16>(Tag::FillOrder).map_err(refused)?;
    if fill.is_some_and(|order| order != 1) {
        return Err(bad("bits in reverse order (FillOrder 2)".into(), "FillOrder 1"));
    }
    let compression = decoder.find_tag_unsigned::<u16>(Tag::Compression).map_err(refused)?.unwrap_or(1);
    let predictor = decoder.find_tag_unsigned::<u16>(Tag::Predictor).map_err(refused)?.unwrap_or(1);
    if predictor != 1 && !PREDICTED.contains(&compression) {
        // Some readers add the differences up, others take them as they stand: TIFF 6.0 (section 14) has them beside LZW alone.
        let found = format!("differences of pixels (Predictor {predictor}) that are not compressed by LZW or deflate");
        return Err(bad(found, "Predictor 1, or LZW or deflate"));
    }
    let (bits, bands) = match decoder.colortype().map_err(refused)? {
        ColorType::Gray(bits) => (bits, 1),
        ColorType::GrayA(bits) => (bits, 2),
        ColorType::RGB(bits) => (bits, 3),
        ColorType::RGBA(bits) => (bits, 4),
        ColorType::Multiband { bit_depth, num_samples } => (bit_depth, usize::from(num_samples)),
        _ => return Ok(None),
    };
    if !matches!(bits, 8 | 16 | 32 | 64) {
        return Ok(None);
    }
    // Grey with or without alpha, or colour with or without: what stands behind them is dropped.
    let channels = match bands {
        1 | 2 => 1,
        3 | 4 => 3,
        _ => return Err(bad(format!("{bands} bands"), "grey or three colours, with or without alpha")),
    };
    let orientation = decoder.find_tag_unsigned::<u16>(Tag::Orientation).map_err(refused)?;
    let orientation = orientation.and_then(|v| u8::try_from(v).ok()).filter(|v| (1..=8).contains(v)).unwrap_or(1);
    let extra = decoder.find_tag_unsigned_vec::<u16>(Tag::ExtraSamples).map_err(refused)?;
    let multiplied = extra.is_some_and(|v| v.first() == Some(&ExtraSamples::AssociatedAlpha.to_u16()));
    let profile = decoder.find_tag(Tag::IccProfile).map_err(refused)?;
    let told = profile.and_then(|v| v.into_u8_vec().ok()).and_then(|profile| Told::by_icc(&profile));
    let format = decoder.find_tag_unsigned_vec::<u16>(Tag::SampleFormat).map_err(refused)?;
    let float = format.is_some_and(|v| v.first() == Some(&SampleFormat::IEEEFP.to_u16()));
    let size = [rows as usize, cols as usize];
    room.allow(path, size, decoding(&mut decoder, size, bands, bits).map_err(refused)?, (channels, kept(bits, float)))?;
    let mut result = DecodingResult::U8(Vec::new());
    let layout = decoder.read_image_to_buffer(&mut result).map_err(refused)?;
    if result.as_buffer(0).as_bytes().len() < layout.complete_len {
        return Err(bad(format!("{} bytes of samples", layout.complete_len), "at most 4 GiB of samples"));
    }
    let shape = Shape { pixels: rows as usize * cols as usize, bands, channels, planar: layout.planes > 1 };
    let whole = |v: Vec<f64>, bits: u8| Samples::Whole(v, bits);
    let mut opaque = true;
    let seen = &mut opaque;
    let samples = match result {
        DecodingResult::U8(v) => shape.taken(&v, |v| v, u8::MAX, seen).map(Samples::U8),
        DecodingResult::U16(v) => shape.taken(&v, |v| v, u16::MAX, seen).map(Samples::U16),
        DecodingResult::U32(v) => {
            shape.taken(&v, |v| f64::from(v) / f64::from(u32::MAX), 1.0, seen).map(|v| whole(v, 32))
        }
        DecodingResult::U64(v) => shape.taken(&v, |v| v as f64 / u64::MAX as f64, 1.0, seen).map(|v| whole(v, 64)),
        DecodingResult::F16(v) => shape.taken(&v, |v| v.to_f32(), 1.0, seen).map(Samples::F32),
        DecodingResult::F32(v) => shape.taken(&v, |v| v, 1.0, seen).map(Samples::F32),
        DecodingResult::F64(v) => shape.taken(&v, |v| v, 1.0, seen).map(Samples::F64),
        DecodingResult::I8(_) | DecodingResult::I16(_) | DecodingResult::I32(_) | DecodingResult::I64(_) => {
            return Err(bad("signed whole numbers".into(), "whole numbers from 0, or floating point"));
        }
    };
    let samples = samples.ok_or_else(|| bad("fewer samples than pixels".into(), "a complete file"))?;
    let alpha = (!opaque).then_some(if multiplied { Alpha::Multiplied } else { Alpha::Apart });
    let [rows, cols] = size;
    finite(path, Content { rows, cols, channels, samples, orientation, alpha, told }).map(Some)
}

/// Bytes that a sample takes once it is decoded, in [`Samples`].
fn kept(bits: u8, float: bool) -> usize {
    match (bits, float) {
        (8, _) => 1,
        (16, false) => 2,
        (16 | 32, true) => 4,
        _ => 8,
    }
}

/// Bytes that a decoder takes: all bands, and what it holds of the piece in hand, a JPEG all of it and others a row.
fn decoding(
    decoder: &mut Decoder<BufReader<File>>,
    [rows, cols]: [usize; 2],
    bands: usize,
    bits: u8,
) -> Result<u64, TiffError> {
    let compression = decoder.find_tag_unsigned::<u16>(Tag::Compression)?;
    let (wide, high) = decoder.chunk_dimensions();
    let high = match compression.map(CompressionMethod::from_u16_exhaustive) {
        Some(CompressionMethod::JPEG | CompressionMethod::ModernJPEG) => (high as usize).min(rows),
        _ => 1,
    };
    let sample = usize::from(bits / 8);
    Ok(product(&[rows, cols, bands, sample]).saturating_add(product(&[high, wide as usize, bands, sample])))
}

/// How samples lie.
struct Shape {
    pixels: usize,
    /// Stored.
    bands: usize,
    /// Kept.
    channels: usize,
    /// Band after band, not pixel after pixel.
    planar: bool,
}

impl Shape {
    /// The kept channels, pixel after pixel; `None` where samples are missing. `opaque` becomes false where what stands behind them is below `top` anywhere.
    fn taken<S: Copy, T: PartialOrd>(
        &self,
        samples: &[S],
        value: impl Fn(S) -> T,
        top: T,
        opaque: &mut bool,
    ) -> Option<Vec<T>> {
        if samples.len() < self.pixels.checked_mul(self.bands)? {
            return None;
        }
        let at = |pixel: usize, k: usize| if self.planar { k * self.pixels + pixel } else { pixel * self.bands + k };
        // Room for all of it at once: a list that grows takes twice as much.
        let mut kept = Vec::with_capacity(self.pixels * self.channels);
        for pixel in 0..self.pixels {
            kept.extend((0..self.channels).map(|k| value(samples[at(pixel, k)])));
        }
        *opaque = self.bands == self.channels
            || (0..self.pixels).all(|pixel| value(samples[at(pixel, self.channels)]) >= top);
        Some(kept)
    }
}
