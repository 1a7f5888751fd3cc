//! The one reader of pictures: whatever a file holds as interleaved samples of one or three channels, then as linear light.

use std::io::Read;
use std::panic::catch_unwind;
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageError, ImageReader};
use ndarray::{Array3, Axis};
use rayon::prelude::*;

use super::content::{ALLOWED, Alpha, Content, Samples, finite, unread};
use super::room::Room;
use super::{jpeg, npy, png_file, tiff_file};
use crate::develop::profile::{Curve, Told};
use crate::exif::Turn;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::memory::Limit;

/// What the numbers of an integer picture stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// sRGB (IEC 61966-2-1), as photographs are.
    Srgb,
    /// Proportional to light.
    Linear,
}

/// A picture as its file has it: its own number of channels, and what was known of its numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Planes {
    /// Linear values, `[channel, row, col]`: one channel for grey, three for colour; `[0, 1]` for integer samples.
    pub values: Array3<f64>,
    /// Bits a sample; `None` for floating point.
    pub bits: Option<u8>,
    /// What the samples were taken as; sRGB too where a profile of the file has another curve.
    pub encoding: Encoding,
    /// The same in words, and whether the file said so itself.
    pub taken: &'static str,
    /// In words, what of the file is left out, where that changes what is seen: alpha that is not opaque.
    pub left_out: Option<&'static str>,
}

/// A picture as it is stored, not turned upright.
#[derive(Clone, Debug, PartialEq)]
pub struct Stored {
    /// Linear light, `[3, row, col]`.
    pub image: Array3<f32>,
    /// How to turn it upright: Exif's 1 to 8.
    pub orientation: u8,
    /// Bits a sample; `None` for floating point.
    pub bits: Option<u8>,
    /// Whether the file said what its numbers stand for.
    pub told: bool,
    /// As [`Planes::left_out`].
    pub left_out: Option<&'static str>,
}

/// Reads a picture to linear sRGB, upright: whole numbers in `[0, 1]`, taken as the file says, or as sRGB-encoded where it says nothing.
///
/// # Shapes
/// Result `[3, row, col]`.
pub fn read_linear(path: &Path) -> Result<Array3<f32>> {
    Ok(read_seen_within(path, Limit::of_process())?.image)
}

/// As [`read_linear`], within `memory`; upright, with the rest of what [`read_stored`] says.
///
/// # Errors
/// As [`read_stored`].
#[doc(hidden)]
pub fn read_seen_within(path: &Path, memory: Limit) -> Result<Stored> {
    let stored = read_stored_within(path, None, memory)?;
    Ok(Stored { image: upright(stored.image, stored.orientation), orientation: 1, ..stored })
}

/// Rows and columns that a picture's file states, either way round; its pixels are not read.
///
/// # Errors
/// A file that cannot be read, or is no picture.
pub fn picture_size(path: &Path) -> Result<[usize; 2]> {
    match kind(path)? {
        Kind::Array => npy::size(path),
        Kind::Tiff => tiff_file::size(path),
        Kind::Other => {
            let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
            let size = reader.map_err(|e| Error::reading(path, e))?.into_dimensions().map_err(|e| refused(path, e))?;
            Ok([size.1 as usize, size.0 as usize])
        }
    }
}

/// Reads a picture to linear RGB, upright; whole numbers are taken as `encoding`, whatever the file says.
///
/// # Shapes
/// Result `[3, row, col]`.
pub fn read_picture(path: &Path, encoding: Encoding) -> Result<Array3<f32>> {
    let Stored { image, orientation, .. } = read_stored(path, Some(encoding))?;
    Ok(upright(image, orientation))
}

/// Reads a picture to linear RGB as it is stored; without `encoding` as the file says, in sRGB's colours (those beyond them at their border), or as sRGB-encoded where
/// it says nothing.
///
/// # Errors
/// A file that cannot be read, or is no picture; one that there is no memory for.
pub fn read_stored(path: &Path, encoding: Option<Encoding>) -> Result<Stored> {
    read_stored_within(path, encoding, Limit::of_process())
}

/// As [`read_stored`], within `memory`: a picture that needs more is refused before its pixels are decoded.
///
/// # Errors
/// As [`read_stored`].
#[doc(hidden)]
pub fn read_stored_within(path: &Path, encoding: Option<Encoding>, memory: Limit) -> Result<Stored> {
    let content = content(path, Room::stored(memory))?;
    let taken = Taken::of(encoding, &content, Curve::Srgb);
    let (orientation, left_out) = (content.orientation, content.alpha.map(Alpha::words));
    let single = |v: f64| v as f32;
    let (bits, mut image) = match &content.samples {
        Samples::F32(v) => (None, planes(&content, 3, v, |_, v| v)),
        Samples::F64(v) => (None, planes(&content, 3, v, |_, v| single(v))),
        Samples::Whole(v, bits) => (Some(*bits), planes(&content, 3, v, |k, v| single(taken.curve.light(k, v)))),
        Samples::U16(v) => {
            let table = tables(u16::MAX, &taken.curve, single);
            (Some(16), planes(&content, 3, v, |k, v| table[k][usize::from(v)]))
        }
        Samples::U8(v) => {
            let table = tables(255, &taken.curve, single);
            (Some(8), planes(&content, 3, v, |k, v| table[k][usize::from(v)]))
        }
    };
    if let (Some(matrix), 3) = (taken.to_srgb, content.channels) {
        turn(&mut image, &matrix, bits.is_some());
    }
    Ok(Stored { image, orientation, bits, told: taken.told, left_out })
}

/// Colours by a matrix; what leaves `[0, 1]` is put at its border where the samples are whole numbers.
fn turn(image: &mut Array3<f32>, matrix: &[[f64; 3]; 3], whole: bool) {
    image.axis_iter_mut(Axis(1)).into_par_iter().for_each(|mut row| {
        for mut pixel in row.axis_iter_mut(Axis(1)) {
            let before = [pixel[0], pixel[1], pixel[2]].map(f64::from);
            for (to, line) in pixel.iter_mut().zip(matrix) {
                let v: f64 = line.iter().zip(before).map(|(m, v)| m * v).sum();
                *to = (if whole { v.clamp(0.0, 1.0) } else { v }) as f32;
            }
        }
    });
}

/// What samples are taken as.
struct Taken {
    curve: Curve,
    to_srgb: Option<[[f64; 3]; 3]>,
    told: bool,
}

impl Taken {
    /// As `encoding` says, else as the file does, else by `usual`.
    fn of(encoding: Option<Encoding>, content: &Content, usual: Curve) -> Self {
        match (encoding, &content.told) {
            (Some(Encoding::Srgb), _) => Self { curve: Curve::Srgb, to_srgb: None, told: false },
            (Some(Encoding::Linear), _) => Self { curve: Curve::Linear, to_srgb: None, told: false },
            (None, Some(Told { curve, to_srgb })) => Self { curve: curve.clone(), to_srgb: *to_srgb, told: true },
            (None, None) => Self { curve: usual, to_srgb: None, told: false },
        }
    }

    fn words(&self) -> (Encoding, &'static str) {
        match (&self.curve, self.told) {
            (Curve::Linear, false) => (Encoding::Linear, "linear"),
            (Curve::Linear, true) => (Encoding::Linear, "linear, as the file says"),
            (Curve::Srgb, false) => (Encoding::Srgb, "sRGB"),
            (Curve::Srgb, true) => (Encoding::Srgb, "sRGB, as the file says"),
            (Curve::Own(_), _) => (Encoding::Srgb, "the file's own curve"),
        }
    }
}

/// Reads a picture to linear channels in double precision, upright: grey stays one channel, 16 bits stay exact.
///
/// Without `encoding` samples are taken as the file says; where it says nothing, 8 bits as sRGB and deeper ones as linear. Floating point is linear whatever is
/// asked for. Colours stay the file's own.
///
/// # Shapes
/// Values `[1 or 3, row, col]`.
///
/// # Errors
/// A file that cannot be read, or is no picture.
pub fn read_planes(path: &Path, encoding: Option<Encoding>) -> Result<Planes> {
    let (planes, orientation) = stored_planes(path, encoding)?;
    Ok(Planes { values: upright(planes.values, orientation), ..planes })
}

/// As [`read_planes`], but as the sensor has it: an orientation in the metadata says how a picture is to be seen, and is not applied.
///
/// # Errors
/// As [`read_planes`].
pub fn read_sensor_planes(path: &Path, encoding: Option<Encoding>) -> Result<Planes> {
    Ok(stored_planes(path, encoding)?.0)
}

/// Channels as they are stored, and Exif's orientation.
fn stored_planes(path: &Path, encoding: Option<Encoding>) -> Result<(Planes, u8)> {
    let content = content(path, Room::planes(Limit::of_process()))?;
    let usual = if matches!(content.samples, Samples::U8(_)) { Curve::Srgb } else { Curve::Linear };
    let taken = Taken::of(encoding, &content, usual);
    let channels = content.channels;
    let (bits, values) = match &content.samples {
        Samples::F32(v) => (None, planes(&content, channels, v, |_, v| f64::from(v))),
        Samples::F64(v) => (None, planes(&content, channels, v, |_, v| v)),
        Samples::Whole(v, bits) => (Some(*bits), planes(&content, channels, v, |k, v| taken.curve.light(k, v))),
        Samples::U16(v) => {
            let table = tables(u16::MAX, &taken.curve, |v| v);
            (Some(16), planes(&content, channels, v, |k, v| table[k][usize::from(v)]))
        }
        Samples::U8(v) => {
            let table = tables(255, &taken.curve, |v| v);
            (Some(8), planes(&content, channels, v, |k, v| table[k][usize::from(v)]))
        }
    };
    // Floating point is linear.
    let (encoding, taken) = if bits.is_some() { taken.words() } else { (Encoding::Linear, "linear") };
    let left_out = content.alpha.map(Alpha::words);
    Ok((Planes { values, bits, encoding, taken, left_out }, content.orientation))
}

/// Light of all sample values of each channel.
fn tables<T>(top: u16, curve: &Curve, value: impl Fn(f64) -> T) -> [Vec<T>; 3] {
    let light = |channel: usize| (0..=top).map(move |v| (channel, f64::from(v) / f64::from(top)));
    [0, 1, 2].map(|k| light(k).map(|(channel, v)| value(curve.light(channel, v))).collect())
}

/// Channel planes of interleaved samples; a single channel fills all that are asked for.
fn planes<S: Copy + Sync, T: Copy + Default + Send + Sync>(
    content: &Content,
    channels: usize,
    samples: &[S],
    value: impl Fn(usize, S) -> T + Sync,
) -> Array3<T> {
    let stored = content.channels;
    let mut out = Array3::from_elem((channels, content.rows, content.cols), T::default());
    let rows = samples.par_chunks((stored * content.cols).max(1));
    out.axis_iter_mut(Axis(1)).into_par_iter().zip(rows).for_each(|(mut to, from)| {
        for (c, pixel) in from.chunks_exact(stored).enumerate() {
            (0..channels).for_each(|k| to[[k, c]] = value(k, pixel[k.min(stored - 1)]));
        }
    });
    out
}

/// A picture turned as Exif's orientation says.
fn upright<T: Clone>(mut image: Array3<T>, orientation: u8) -> Array3<T> {
    let Some(Turn { transpose, flip_rows, flip_columns }) = Turn::from_exif(orientation) else { return image };
    if transpose {
        image.swap_axes(1, 2);
    }
    if flip_rows {
        image.invert_axis(Axis(1));
    }
    if flip_columns {
        image.invert_axis(Axis(2));
    }
    image.as_standard_layout().into_owned()
}

/// What reads a file.
enum Kind {
    Array,
    Tiff,
    Other,
}

/// By the first bytes; by name what is an array by name alone, so that its reader says what is wrong.
fn kind(path: &Path) -> Result<Kind> {
    isoplanat_base::atomic::regular(path)?;
    let file = std::fs::File::open(path).map_err(|e| Error::reading(path, e))?;
    let mut start = Vec::new();
    file.take(6).read_to_end(&mut start).map_err(|e| Error::reading(path, e))?;
    let is_array = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npy"));
    Ok(match &start[..] {
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => Kind::Tiff,
        start if start == npy::MAGIC || is_array => Kind::Array,
        _ => Kind::Other,
    })
}

/// What a file holds. A decoder that gives up in the middle of a form that it does not know is refused as any.
fn content(path: &Path, room: Room) -> Result<Content> {
    catch_unwind(|| decoded_content(path, room)).unwrap_or_else(|_| {
        let file = path.display().to_string();
        Err(Error::bad(file, "picture", "a form that its decoder gives up on", ALLOWED))
    })
}

fn decoded_content(path: &Path, room: Room) -> Result<Content> {
    match kind(path)? {
        Kind::Array => npy::read(path, Some(room)),
        // Forms that the `image` crate knows too go its way: palettes, CMYK, bilevel.
        Kind::Tiff => tiff_file::read(path, room)?.map_or_else(|| picture(path, room), Ok),
        Kind::Other => picture(path, room),
    }
}

/// A picture that the `image` crate reads.
fn picture(path: &Path, room: Room) -> Result<Content> {
    let refused = |e| refused(path, e);
    let failed = |e| Error::reading(path, e);
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format).map_err(failed)?;
    if reader.format() == Some(image::ImageFormat::Jpeg) {
        let file = std::fs::File::open(path).map_err(failed)?;
        if !jpeg::has_end(&mut std::io::BufReader::new(file)).map_err(failed)? {
            let found = "it ends before its end marker: a part of the picture is missing";
            return Err(Error::bad(path.display().to_string(), "picture", found, "a whole JPEG"));
        }
    }
    let png = reader.format() == Some(image::ImageFormat::Png);
    let mut decoder = reader.into_decoder().map_err(refused)?;
    let (cols, rows) = decoder.dimensions();
    let color = decoder.color_type();
    let samples = (if color.has_color() { 3 } else { 1 }, usize::from(color.bytes_per_pixel() / color.channel_count()));
    room.allow(path, [rows as usize, cols as usize], decoder.total_bytes(), samples)?;
    let told = if png {
        png_file::check_palette(path)?;
        png_file::told(path)?
    } else {
        decoder.icc_profile().map_err(refused)?.and_then(|profile| Told::by_icc(&profile))
    };
    let orientation = decoder.orientation().map_err(refused)?.to_exif();
    let picture = DynamicImage::from_decoder(decoder).map_err(refused)?;
    let (rows, cols) = (picture.height() as usize, picture.width() as usize);
    let channels = if picture.color().has_color() { 3 } else { 1 };
    let alpha = is_seen_through(&picture).then_some(Alpha::Apart);
    if matches!(picture, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_)) {
        let samples = picture.into_rgb32f().into_raw();
        return finite(
            path,
            Content { rows, cols, channels, samples: Samples::F32(samples), orientation, alpha, told },
        );
    }
    let deep = picture.color().bytes_per_pixel() / picture.color().channel_count() > 1;
    let samples = match (deep, channels) {
        (true, 1) => Samples::U16(picture.into_luma16().into_raw()),
        (true, _) => Samples::U16(picture.into_rgb16().into_raw()),
        (false, 1) => Samples::U8(picture.into_luma8().into_raw()),
        (false, _) => Samples::U8(picture.into_rgb8().into_raw()),
    };
    Ok(Content { rows, cols, channels, samples, orientation, alpha, told })
}

/// Whether a picture has an alpha that is not opaque everywhere.
fn is_seen_through(picture: &DynamicImage) -> bool {
    match picture {
        DynamicImage::ImageLumaA8(v) => v.pixels().any(|p| p.0[1] < u8::MAX),
        DynamicImage::ImageLumaA16(v) => v.pixels().any(|p| p.0[1] < u16::MAX),
        DynamicImage::ImageRgba8(v) => v.pixels().any(|p| p.0[3] < u8::MAX),
        DynamicImage::ImageRgba16(v) => v.pixels().any(|p| p.0[3] < u16::MAX),
        DynamicImage::ImageRgba32F(v) => v.pixels().any(|p| p.0[3] < 1.0),
        _ => false,
    }
}

fn refused(path: &Path, e: ImageError) -> Error {
    match e {
        ImageError::IoError(e) => unread(path, e),
        e => Error::bad(path.display().to_string(), "picture", e.to_string(), ALLOWED),
    }
}
