//! Pictures in and out: PNG, JPEG and TIFF, 8 and 16 bits. Only this file names the `image` crate.
//!
//! Integer samples are taken as sRGB-encoded unless the caller says they are linear; floating-point TIFF is linear.
//! Embedded colour profiles are not read: pictures in wider gamuts look less saturated than they are. Alpha is dropped,
//! grey becomes three equal channels, the orientation in the metadata is applied. Outputs are written beside their place and
//! renamed, so that they appear whole or not at all.

use std::io::Cursor;
use std::path::Path;

use image::codecs::{jpeg::JpegEncoder, png::PngEncoder};
use image::{DynamicImage, ImageBuffer, ImageDecoder, ImageEncoder, ImageError, ImageReader, Rgb};
use ndarray::{Array3, ArrayView3, Axis, s};
use rayon::prelude::*;
use tiff::TiffError;
use tiff::encoder::{TiffEncoder, colortype};
use tiff::tags::Tag;

use crate::develop::color::{linear_from_srgb, srgb_from_linear};
use crate::develop::gamut::Gamut;
use crate::exif::{Exif, Undefined};
pub use isoplanat_base::atomic::{write_atomic, write_bytes};
use isoplanat_base::error::{Error, Result};

/// Endings of pictures that are read and written.
pub const PICTURES: [&str; 5] = ["png", "tif", "tiff", "jpg", "jpeg"];

/// JPEG quality of [`write_picture`].
const JPEG_QUALITY: u8 = 95;

/// What the numbers of an integer picture stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// sRGB (IEC 61966-2-1), as photographs are.
    Srgb,
    /// Proportional to light.
    Linear,
}

/// Reads a picture to linear RGB in `[0, 1]`, taking it as sRGB-encoded.
///
/// # Shapes
/// Result `[3, row, col]`.
pub fn read_linear(path: &Path) -> Result<Array3<f32>> {
    read_picture(path, Encoding::Srgb)
}

/// Rows and columns that a picture's file states, either way round; its pixels are not read.
///
/// # Errors
/// A file that cannot be read, or is no picture.
pub fn picture_size(path: &Path) -> Result<[usize; 2]> {
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
    let size = reader.map_err(|e| Error::reading(path, e))?.into_dimensions().map_err(|e| refused(path, e))?;
    Ok([size.1 as usize, size.0 as usize])
}

fn refused(path: &Path, e: ImageError) -> Error {
    match e {
        ImageError::IoError(e) if e.kind() != std::io::ErrorKind::UnexpectedEof => Error::reading(path, e),
        e => Error::bad(path.display().to_string(), "picture", e.to_string(), "a PNG, JPEG or TIFF picture"),
    }
}

/// Reads a picture to linear RGB.
///
/// # Shapes
/// Result `[3, row, col]`.
pub fn read_picture(path: &Path, encoding: Encoding) -> Result<Array3<f32>> {
    let refused = |e| refused(path, e);
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
    let mut decoder = reader.map_err(|e| Error::reading(path, e))?.into_decoder().map_err(refused)?;
    let orientation = decoder.orientation().map_err(refused)?;
    let mut picture = DynamicImage::from_decoder(decoder).map_err(refused)?;
    picture.apply_orientation(orientation);
    if matches!(picture, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_)) {
        let rgb = picture.into_rgb32f();
        return Ok(planes(rgb.dimensions(), rgb.as_raw(), |v| v));
    }
    // Decode through a table of all sample values.
    let table = |top: u16| -> Vec<f32> {
        let values = (0..=top).map(|v| f64::from(v) / f64::from(top));
        match encoding {
            Encoding::Srgb => values.map(|v| linear_from_srgb(v) as f32).collect(),
            Encoding::Linear => values.map(|v| v as f32).collect(),
        }
    };
    let deep = picture.color().bytes_per_pixel() / picture.color().channel_count() > 1;
    Ok(if deep {
        let (rgb, table) = (picture.into_rgb16(), table(u16::MAX));
        planes(rgb.dimensions(), rgb.as_raw(), |v| table[usize::from(v)])
    } else {
        let (rgb, table) = (picture.into_rgb8(), table(255));
        planes(rgb.dimensions(), rgb.as_raw(), |v| table[usize::from(v)])
    })
}

/// A picture as its file has it: its own number of channels, and what was known of its numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Planes {
    /// Linear values, `[channel, row, col]`: one channel for grey, three for colour; `[0, 1]` for integer samples.
    pub values: Array3<f64>,
    /// Bits a sample; `None` for floating point.
    pub bits: Option<u8>,
    /// What the samples were taken as.
    pub encoding: Encoding,
}

/// Reads a picture to linear channels in double precision: grey stays one channel, 16 bits stay exact.
///
/// Without `encoding` 8-bit samples are taken as sRGB and 16-bit ones as linear; floating point is linear whatever is asked for.
///
/// # Shapes
/// Values `[1 or 3, row, col]`.
///
/// # Errors
/// A file that cannot be read, or is no picture.
pub fn read_planes(path: &Path, encoding: Option<Encoding>) -> Result<Planes> {
    planes_as(path, encoding, true)
}

/// As [`read_planes`], but as the sensor has it: an orientation in the metadata says how a picture is to be seen, and is not applied.
///
/// # Errors
/// As [`read_planes`].
pub fn read_sensor_planes(path: &Path, encoding: Option<Encoding>) -> Result<Planes> {
    planes_as(path, encoding, false)
}

fn planes_as(path: &Path, encoding: Option<Encoding>, turned: bool) -> Result<Planes> {
    let refused = |e| refused(path, e);
    let reader = ImageReader::open(path).and_then(ImageReader::with_guessed_format);
    let mut decoder = reader.map_err(|e| Error::reading(path, e))?.into_decoder().map_err(refused)?;
    let orientation = decoder.orientation().map_err(refused)?;
    let mut picture = DynamicImage::from_decoder(decoder).map_err(refused)?;
    if turned {
        picture.apply_orientation(orientation);
    }
    let (rows, cols) = (picture.height() as usize, picture.width() as usize);
    let channels = if picture.color().has_color() { 3 } else { 1 };
    let shaped = |samples: Vec<f64>| {
        let interleaved = Array3::from_shape_vec((rows, cols, channels), samples);
        let interleaved = interleaved.map_err(|e| Error::Internal(format!("picture buffer size: {e}")))?;
        Ok(interleaved.permuted_axes([2, 0, 1]))
    };
    if matches!(picture, DynamicImage::ImageRgb32F(_) | DynamicImage::ImageRgba32F(_)) {
        let samples = picture.into_rgb32f().into_raw().into_iter().map(f64::from).collect();
        return Ok(Planes { values: shaped(samples)?, bits: None, encoding: Encoding::Linear });
    }
    let deep = picture.color().bytes_per_pixel() / picture.color().channel_count() > 1;
    let encoding = encoding.unwrap_or(if deep { Encoding::Linear } else { Encoding::Srgb });
    let samples: Vec<u16> = match (deep, channels) {
        (true, 1) => picture.into_luma16().into_raw(),
        (true, _) => picture.into_rgb16().into_raw(),
        (false, 1) => picture.into_luma8().into_raw().into_iter().map(u16::from).collect(),
        (false, _) => picture.into_rgb8().into_raw().into_iter().map(u16::from).collect(),
    };
    let top = if deep { u16::MAX } else { 255 };
    let decoded = (0..=top).map(|v| f64::from(v) / f64::from(top)).map(|v| match encoding {
        Encoding::Srgb => linear_from_srgb(v),
        Encoding::Linear => v,
    });
    let table: Vec<f64> = decoded.collect();
    let values = shaped(samples.into_iter().map(|v| table[usize::from(v)]).collect())?;
    Ok(Planes { values, bits: Some(if deep { 16 } else { 8 }), encoding })
}

/// Channel planes of interleaved samples.
fn planes<S: Copy + Sync>((cols, rows): (u32, u32), samples: &[S], value: impl Fn(S) -> f32 + Sync) -> Array3<f32> {
    let (rows, cols) = (rows as usize, cols as usize);
    let mut out = Array3::zeros((3, rows, cols));
    out.axis_iter_mut(Axis(1)).into_par_iter().zip(samples.par_chunks(3 * cols)).for_each(|(mut to, from)| {
        for (c, pixel) in from.chunks_exact(3).enumerate() {
            (0..3).for_each(|k| to[[k, c]] = value(pixel[k]));
        }
    });
    out
}

/// A sample type of written pictures.
trait Sample: Copy + Default + Send + Sync {
    /// The nearest sample to `v`, cut off to `[0, 1]`; 0 for what is no number.
    fn nearest(v: f32) -> Self;
}

impl Sample for u8 {
    fn nearest(v: f32) -> Self {
        (v * 255.0 + 0.5) as Self
    }
}

impl Sample for u16 {
    fn nearest(v: f32) -> Self {
        (v * 65535.0 + 0.5) as Self
    }
}

/// Interleaved samples of channel planes; a single channel fills all three.
fn interleaved<S: Sample>(image: &Array3<f32>, encoding: Encoding) -> Result<ImageBuffer<Rgb<S>, Vec<S>>>
where
    Rgb<S>: image::Pixel<Subpixel = S>,
{
    let (width, height) = sides(image)?;
    let samples = interleaved_rows(image.view(), encoding);
    ImageBuffer::from_raw(width, height, samples).ok_or_else(|| Error::Internal("picture buffer size".into()))
}

/// Samples of rows of a picture as [`sides`] allows it.
fn interleaved_rows<S: Sample>(rows: ArrayView3<'_, f32>, encoding: Encoding) -> Vec<S> {
    let (channels, count, cols) = rows.dim();
    let mut samples = vec![S::default(); 3 * count * cols];
    samples.par_chunks_mut(3 * cols).zip(rows.axis_iter(Axis(1))).for_each(|(to, from)| {
        for (c, pixel) in to.chunks_exact_mut(3).enumerate() {
            for (k, s) in pixel.iter_mut().enumerate() {
                *s = S::nearest(encoded(from[[k.min(channels - 1), c]], encoding));
            }
        }
    });
    samples
}

fn encoded(v: f32, encoding: Encoding) -> f32 {
    match encoding {
        Encoding::Srgb => srgb_from_linear(v),
        Encoding::Linear => v,
    }
}

/// Columns and rows of a picture that a file can hold.
fn sides(image: &Array3<f32>) -> Result<(u32, u32)> {
    let (channels, rows, cols) = image.dim();
    if !matches!(channels, 1 | 3) || rows == 0 || cols == 0 {
        let found = format!("{channels} channels of {rows} × {cols}");
        return Err(Error::bad("", "picture", found, "one or three channels and at least one pixel"));
    }
    let side = |n: usize| u32::try_from(n).ok();
    side(cols)
        .zip(side(rows))
        .ok_or_else(|| Error::bad("", "picture", format!("{rows} × {cols}"), "at most 4294967295 pixels a side"))
}

/// What stands in a picture's file beside its pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Annotation {
    /// The colours that the numbers stand for; sRGB without a profile where it is not told.
    pub gamut: Option<Gamut>,
    /// Facts of the exposure; none where it is empty.
    pub exif: Exif,
}

impl Annotation {
    fn profile(&self, encoding: Encoding) -> Result<Option<Vec<u8>>> {
        self.gamut.map(|g| g.icc(encoding == Encoding::Linear)).transpose()
    }

    fn color_space(&self, encoding: Encoding) -> u16 {
        self.gamut.unwrap_or_default().exif(encoding == Encoding::Linear)
    }

    /// Hands both to an encoder of the `image` crate.
    fn put(&self, encoder: &mut impl ImageEncoder, encoding: Encoding) -> Result<()> {
        let refused = |e: image::error::UnsupportedError| Error::Internal(format!("annotation: {e}"));
        if let Some(profile) = self.profile(encoding)? {
            encoder.set_icc_profile(profile).map_err(refused)?;
        }
        if !self.exif.entries().is_empty() {
            let block =
                self.exif.block(self.color_space(encoding)).map_err(|e| Error::Internal(format!("Exif: {e}")))?;
            encoder.set_exif_metadata(block).map_err(refused)?;
        }
        Ok(())
    }
}

/// Writes linear RGB as a PNG of 8 or 16 bits.
fn write_png<S: Sample>(path: &Path, image: &Array3<f32>, encoding: Encoding, beside: &Annotation) -> Result<()>
where
    Rgb<S>: image::PixelWithColorType + image::Pixel<Subpixel = S>,
    [S]: image::EncodableLayout,
{
    let samples = interleaved::<S>(image, encoding).map_err(|e| e.in_file(path))?;
    write_atomic(path, |out| {
        let mut encoder = PngEncoder::new(out);
        beside.put(&mut encoder, encoding)?;
        samples.write_with_encoder(encoder).map_err(|e| unwritten(path, e))
    })
}

/// Writes linear RGB as an 8-bit sRGB PNG.
pub fn write_png8(path: &Path, image: &Array3<f32>) -> Result<()> {
    write_png::<u8>(path, image, Encoding::Srgb, &Annotation::default())
}

/// Writes linear RGB as an uncompressed 16-bit TIFF, strip by strip.
fn write_tiff16(path: &Path, image: &Array3<f32>, encoding: Encoding, beside: &Annotation) -> Result<()> {
    let (width, height) = sides(image).map_err(|e| e.in_file(path))?;
    let profile = beside.profile(encoding)?;
    let write = |out: &mut std::io::BufWriter<std::fs::File>| {
        let mut file = TiffEncoder::new(out)?;
        let has_exif = !beside.exif.entries().is_empty();
        let directories =
            if has_exif { Some(beside.exif.write_directories(&mut file, beside.color_space(encoding))?) } else { None };
        let mut picture = file.new_image::<colortype::RGB16>(width, height)?;
        if let Some(profile) = &profile {
            picture.encoder().write_tag(Tag::IccProfile, Undefined(profile))?;
        }
        if let Some(directories) = directories {
            beside.exif.write_picture_entries(picture.encoder(), directories)?;
        }
        let mut row = 0;
        while row < height as usize {
            let count = usize::try_from(picture.next_strip_sample_count())? / (3 * width as usize);
            let rows = image.slice(s![.., row..row + count, ..]);
            picture.write_strip(&interleaved_rows::<u16>(rows, encoding))?;
            row += count;
        }
        picture.finish()
    };
    write_atomic(path, |out| {
        write(out).map_err(|e| match e {
            TiffError::IoError(e) => Error::writing(path, e),
            e => Error::bad(path.display().to_string(), "picture", e.to_string(), "a size the format can hold"),
        })
    })
}

/// Writes linear RGB as a JPEG of the given quality, 1 to 100.
fn write_jpeg(path: &Path, image: &Array3<f32>, quality: u8, beside: &Annotation) -> Result<()> {
    let samples = interleaved::<u8>(image, Encoding::Srgb).map_err(|e| e.in_file(path))?;
    write_atomic(path, |out| {
        let mut encoder = JpegEncoder::new_with_quality(out, quality.clamp(1, 100));
        beside.put(&mut encoder, Encoding::Srgb)?;
        samples.write_with_encoder(encoder).map_err(|e| unwritten(path, e))
    })
}

/// Writes linear RGB in the format the name's ending asks for: `.png` and `.tif`/`.tiff` with 16 bits, `.jpg`/`.jpeg`.
///
/// JPEG has the sRGB curve always.
pub fn write_picture(path: &Path, image: &Array3<f32>, encoding: Encoding) -> Result<()> {
    write_annotated(path, image, encoding, true, &Annotation::default())
}

/// The same with what stands beside the pixels; PNG with 16 bits only if `deep`.
pub fn write_annotated(
    path: &Path,
    image: &Array3<f32>,
    encoding: Encoding,
    deep: bool,
    beside: &Annotation,
) -> Result<()> {
    match extension(path).as_str() {
        "png" if deep => write_png::<u16>(path, image, encoding, beside),
        "png" => write_png::<u8>(path, image, encoding, beside),
        "tif" | "tiff" => write_tiff16(path, image, encoding, beside),
        "jpg" | "jpeg" => write_jpeg(path, image, JPEG_QUALITY, beside),
        other => {
            let (file, found) = (path.display().to_string(), format!("`.{other}`"));
            Err(Error::bad(file, "file name", found, "a picture's name ends in .png, .tif, .tiff, .jpg or .jpeg"))
        }
    }
}

/// The letters after the last dot of a file's name, in lower case.
pub fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

/// Linear RGB as an 8-bit sRGB PNG in memory, for reports.
pub fn png_bytes_srgb(image: &Array3<f32>) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    let samples = interleaved::<u8>(image, Encoding::Srgb)?;
    samples.write_with_encoder(PngEncoder::new(&mut bytes)).map_err(|e| unwritten(Path::new("PNG"), e))?;
    Ok(bytes.into_inner())
}

/// Linear RGB as an sRGB JPEG in memory, for photographs in reports.
pub fn jpeg_bytes_srgb(image: &Array3<f32>) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    let samples = interleaved::<u8>(image, Encoding::Srgb)?;
    let encoder = JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY);
    samples.write_with_encoder(encoder).map_err(|e| unwritten(Path::new("JPEG"), e))?;
    Ok(bytes.into_inner())
}

fn unwritten(path: &Path, e: ImageError) -> Error {
    match e {
        ImageError::IoError(e) => Error::writing(path, e),
        e => Error::bad(path.display().to_string(), "picture", e.to_string(), "a size the format can hold"),
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn picture() -> Array3<f32> {
        Array3::from_shape_fn((3, 7, 11), |(k, r, c)| ((k * 77 + r * 11 + c) as f32 / 230.0).powi(2))
    }

    fn worst(a: &Array3<f32>, b: &Array3<f32>) -> f32 {
        assert_eq!(a.dim(), b.dim());
        (a - b).iter().fold(0.0, |m: f32, v| m.max(v.abs()))
    }

    #[test]
    fn pictures_read_back_to_half_a_step() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name);
        let image = picture();
        // The slope of the decoding curve is at most 2.28.
        let (deep, shallow) = (2.28 * 0.51 / 65535.0, 2.28 * 0.51 / 255.0);
        write_png8(&at("a.png"), &image).expect("writes");
        assert!(worst(&read_linear(&at("a.png")).expect("reads"), &image) < shallow);
        for encoding in [Encoding::Srgb, Encoding::Linear] {
            for name in ["b.png", "c.tif", "d.TIFF"] {
                write_picture(&at(name), &image, encoding).expect("writes");
                assert!(worst(&read_picture(&at(name), encoding).expect("reads"), &image) < deep, "{name}");
            }
        }
        let flat = Array3::from_elem((3, 16, 16), 0.3);
        write_picture(&at("e.jpg"), &flat, Encoding::Srgb).expect("writes");
        assert!(worst(&read_linear(&at("e.jpg")).expect("reads"), &flat) < 0.01);
        assert_eq!(fs::read_dir(folder.path()).expect("lists").count(), 5, "no partial file is left");
    }

    /// Grey stays grey, 16 bits stay exact, and the default encoding follows the bits.
    #[test]
    fn planes_keep_channels_and_bits() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name);
        let deep = ImageBuffer::<image::Luma<u16>, _>::from_fn(5, 3, |x, y| {
            image::Luma([(7919 * (5 * y + x) % 65536) as u16])
        });
        deep.save(at("deep.png")).expect("writes");
        let read = read_planes(&at("deep.png"), None).expect("reads");
        assert_eq!((read.values.dim(), read.bits, read.encoding), ((1, 3, 5), Some(16), Encoding::Linear));
        for ((_, r, c), v) in read.values.indexed_iter() {
            assert_eq!(*v * 65535.0, (7919 * (5 * r + c) % 65536) as f64);
        }
        write_png8(&at("rgb.png"), &picture()).expect("writes");
        let read = read_planes(&at("rgb.png"), None).expect("reads");
        assert_eq!((read.values.dim(), read.bits, read.encoding), ((3, 7, 11), Some(8), Encoding::Srgb));
        assert_eq!(read.values.mapv(|v| v as f32), read_linear(&at("rgb.png")).expect("reads"));
        let linear = read_planes(&at("rgb.png"), Some(Encoding::Linear)).expect("reads");
        assert!(
            linear.values.iter().all(|v| (v * 255.0).fract() == 0.0 || (v * 255.0 - (v * 255.0).round()).abs() < 1e-12)
        );
        assert!(read_planes(&at("none.png"), None).expect_err("missing").to_string().contains("none.png"));
    }

    #[test]
    fn bytes_in_memory_are_the_same_picture() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.png");
        fs::write(&path, png_bytes_srgb(&picture()).expect("encodes")).expect("writes");
        assert!(worst(&read_linear(&path).expect("reads"), &picture()) < 0.005);
        let single = Array3::from_elem((1, 5, 6), 0.3);
        assert!(png_bytes_srgb(&single).is_ok() && png_bytes_srgb(&Array3::zeros((2, 3, 3))).is_err());
        assert!(png_bytes_srgb(&Array3::zeros((3, 0, 3))).is_err());
    }

    #[test]
    fn values_outside_the_range_are_cut_off() {
        assert_eq!([-1.0, f32::NAN, 0.5, 2.0].map(u8::nearest), [0, 0, 128, 255]);
        assert_eq!([-1.0, f32::INFINITY].map(u16::nearest), [0, 65535]);
    }

    #[test]
    fn errors_name_the_file_and_leave_nothing() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let bad = folder.path().join("bad.png");
        let mut bytes = png_bytes_srgb(&picture()).expect("encodes");
        bytes.truncate(bytes.len() / 2);
        for content in [&b"no picture"[..], &bytes, b""] {
            fs::write(&bad, content).expect("writes");
            let error = read_linear(&bad).expect_err("refused");
            assert!(error.to_string().contains("bad.png") && error.exit_code() == 2, "{error}");
        }
        assert!(read_linear(&folder.path().join("none.png")).expect_err("missing").to_string().contains("none.png"));
        let nowhere = folder.path().join("none/x.png");
        assert!(write_png8(&nowhere, &picture()).expect_err("no folder").to_string().contains("x.png"));
        let webp = folder.path().join("x.webp");
        assert!(write_picture(&webp, &picture(), Encoding::Srgb).expect_err("webp").to_string().contains("x.webp"));
        let kept = folder.path().join("kept.txt");
        write_bytes(&kept, b"old").expect("writes");
        let failed = write_atomic(&kept, |_| Err(Error::Interrupted));
        assert!(failed.is_err() && fs::read(&kept).expect("reads") == b"old");
        assert_eq!(fs::read_dir(folder.path()).expect("lists").count(), 2);
    }
}
