//! Pictures in and out: PNG, JPEG, TIFF and NumPy's `.npy`. Only this file and those in `files/` name the `image` crate.
//!
//! `files/read.rs` is the one reader: 8 and 16 bits, whole numbers of 32 and 64 bits, floating point of 16, 32 and 64 bits, grey or three channels. What
//! a file says of its whole numbers counts: its ICC profile, in a PNG `cICP`, `sRGB` or `gAMA`; floating point is linear. What is written says it too. Alpha is dropped, and told where it is not opaque; grey becomes three equal channels, the orientation in the metadata is applied.
//! `.npy` holds `[row, col]` or `[row, col, channel]`, linear light from the top row. Outputs are written beside their place and renamed, so that they
//! appear whole or not at all.

mod content;
#[cfg(test)]
mod forms;
mod jpeg;
mod npy;
mod png_file;
mod read;
mod room;
mod tiff_file;

use std::io::Cursor;
use std::path::Path;

use image::codecs::{jpeg::JpegEncoder, png::PngEncoder};
use image::{ImageBuffer, ImageEncoder, ImageError, Rgb};
use ndarray::{Array3, ArrayView3, Axis, s};
use rayon::prelude::*;
use tiff::TiffError;
use tiff::encoder::{TiffEncoder, colortype};
use tiff::tags::Tag;

use crate::develop::color::srgb_from_linear;
use crate::develop::gamut::Gamut;
use crate::exif::{Exif, Undefined};
use isoplanat_base::atomic::{Target, write_atomic};
use isoplanat_base::error::{Error, Result};
pub use read::{
    Encoding, Planes, Stored, picture_size, read_linear, read_picture, read_planes, read_sensor_planes, read_stored,
};
#[doc(hidden)]
pub use read::{read_seen_within, read_stored_within};

/// Endings of pictures that are read and written.
pub const PICTURES: [&str; 6] = ["png", "tif", "tiff", "jpg", "jpeg", "npy"];

/// JPEG quality of [`write_picture`].
const JPEG_QUALITY: u8 = 95;

/// Numbers of a written picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depth {
    /// 8 bits; TIFF has 16.
    Eight,
    /// 16 bits; JPEG has 8.
    Sixteen,
    /// 32-bit floating point, linear, not cut off: TIFF and `.npy`.
    Float,
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

impl Sample for f32 {
    fn nearest(v: f32) -> Self {
        v
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
    /// The colours that the numbers stand for; a profile says so.
    pub gamut: Gamut,
    /// Facts of the exposure; none where it is empty.
    pub exif: Exif,
}

impl Annotation {
    fn profile(&self, encoding: Encoding) -> Result<Vec<u8>> {
        self.gamut.icc(encoding == Encoding::Linear)
    }

    fn color_space(&self, encoding: Encoding) -> u16 {
        self.gamut.exif(encoding == Encoding::Linear)
    }

    /// Hands both to an encoder of the `image` crate.
    fn put(&self, encoder: &mut impl ImageEncoder, encoding: Encoding) -> Result<()> {
        let refused = |e: image::error::UnsupportedError| Error::Internal(format!("annotation: {e}"));
        encoder.set_icc_profile(self.profile(encoding)?).map_err(refused)?;
        if !self.exif.entries().is_empty() {
            let block =
                self.exif.block(self.color_space(encoding)).map_err(|e| Error::Internal(format!("Exif: {e}")))?;
            encoder.set_exif_metadata(block).map_err(refused)?;
        }
        Ok(())
    }
}

/// Writes linear RGB as a PNG of 8 or 16 bits.
fn write_png<S: Sample>(to: Target<'_>, image: &Array3<f32>, encoding: Encoding, beside: &Annotation) -> Result<()>
where
    Rgb<S>: image::PixelWithColorType + image::Pixel<Subpixel = S>,
    [S]: image::EncodableLayout,
{
    let path = to.path;
    let samples = interleaved::<S>(image, encoding).map_err(|e| e.in_file(path))?;
    write_atomic(to, |out| {
        let mut encoder = PngEncoder::new(out);
        beside.put(&mut encoder, encoding)?;
        samples.write_with_encoder(encoder).map_err(|e| unwritten(path, e))
    })
}

/// Writes linear RGB as an 8-bit sRGB PNG.
pub fn write_png8<'a>(to: impl Into<Target<'a>>, image: &Array3<f32>) -> Result<()> {
    write_png::<u8>(to.into(), image, Encoding::Srgb, &Annotation::default())
}

/// Writes linear RGB as an uncompressed TIFF of samples of a form, strip by strip.
fn write_tiff<C>(to: Target<'_>, image: &Array3<f32>, encoding: Encoding, beside: &Annotation) -> Result<()>
where
    C: colortype::ColorType,
    C::Inner: Sample,
    [C::Inner]: tiff::encoder::TiffValue,
{
    let path = to.path;
    let (width, height) = sides(image).map_err(|e| e.in_file(path))?;
    let profile = beside.profile(encoding)?;
    let write = |out: &mut std::io::BufWriter<std::fs::File>| {
        let mut file = TiffEncoder::new(out)?;
        let has_exif = !beside.exif.entries().is_empty();
        let directories =
            if has_exif { Some(beside.exif.write_directories(&mut file, beside.color_space(encoding))?) } else { None };
        let mut picture = file.new_image::<C>(width, height)?;
        picture.encoder().write_tag(Tag::IccProfile, Undefined(&profile))?;
        if let Some(directories) = directories {
            beside.exif.write_picture_entries(picture.encoder(), directories)?;
        }
        let mut row = 0;
        while row < height as usize {
            let count = usize::try_from(picture.next_strip_sample_count())? / (3 * width as usize);
            let rows = image.slice(s![.., row..row + count, ..]);
            picture.write_strip(&interleaved_rows::<C::Inner>(rows, encoding))?;
            row += count;
        }
        picture.finish()
    };
    write_atomic(to, |out| {
        write(out).map_err(|e| match e {
            TiffError::IoError(e) => Error::writing(path, e),
            e => Error::bad(path.display().to_string(), "picture", e.to_string(), "a size the format can hold"),
        })
    })
}

/// Writes linear RGB as a JPEG of the given quality, 1 to 100.
fn write_jpeg(to: Target<'_>, image: &Array3<f32>, quality: u8, beside: &Annotation) -> Result<()> {
    let path = to.path;
    let samples = interleaved::<u8>(image, Encoding::Srgb).map_err(|e| e.in_file(path))?;
    write_atomic(to, |out| {
        let mut encoder = JpegEncoder::new_with_quality(out, quality.clamp(1, 100));
        beside.put(&mut encoder, Encoding::Srgb)?;
        samples.write_with_encoder(encoder).map_err(|e| unwritten(path, e))
    })
}

/// Writes linear RGB in the format the name's ending asks for: `.png` and `.tif`/`.tiff` with 16 bits, `.jpg`/`.jpeg`, `.npy`.
///
/// JPEG has the sRGB curve always, `.npy` linear light.
///
/// ```
/// use isoplanat_imaging::files::{Encoding, read_linear, write_picture};
/// use ndarray::Array3;
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("grey.png");
/// write_picture(&path, &Array3::from_elem((3, 4, 6), 0.18), Encoding::Srgb)?;
/// let again = read_linear(&path)?;
/// assert!(again.iter().all(|v| (v - 0.18).abs() < 1e-4));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write_picture<'a>(to: impl Into<Target<'a>>, image: &Array3<f32>, encoding: Encoding) -> Result<()> {
    write_annotated(to, image, encoding, Depth::Sixteen, &Annotation::default())
}

/// The same with what stands beside the pixels, and as deep as is asked for.
///
/// # Errors
/// An ending or a size that is none, floating point in a format that has none, a file that cannot be written.
pub fn write_annotated<'a>(
    to: impl Into<Target<'a>>,
    image: &Array3<f32>,
    encoding: Encoding,
    depth: Depth,
    beside: &Annotation,
) -> Result<()> {
    let to = to.into();
    let path = to.path;
    match (extension(path).as_str(), depth) {
        ("npy", _) => {
            sides(image).map_err(|e| e.in_file(path))?;
            npy::write(to, image)
        }
        ("tif" | "tiff", Depth::Float) => write_tiff::<colortype::RGB32Float>(to, image, Encoding::Linear, beside),
        ("tif" | "tiff", _) => write_tiff::<colortype::RGB16>(to, image, encoding, beside),
        (other @ ("png" | "jpg" | "jpeg"), Depth::Float) => {
            let found = format!("floating point as `.{other}`");
            Err(Error::bad(path.display().to_string(), "file name", found, ".tif, .tiff or .npy for floating point"))
        }
        ("png", Depth::Sixteen) => write_png::<u16>(to, image, encoding, beside),
        ("png", Depth::Eight) => write_png::<u8>(to, image, encoding, beside),
        ("jpg" | "jpeg", _) => write_jpeg(to, image, JPEG_QUALITY, beside),
        (other, _) => {
            let (file, found) = (path.display().to_string(), format!("`.{other}`"));
            let allowed = "a picture's name ends in .png, .tif, .tiff, .jpg, .jpeg or .npy";
            Err(Error::bad(file, "file name", found, allowed))
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
        let deep = ImageBuffer::<image::Luma<u16>, Vec<u16>>::from_fn(5, 3, |x, y| {
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
        isoplanat_base::atomic::write_bytes(&kept, b"old").expect("writes");
        let failed = write_atomic(&kept, |_| Err(Error::Interrupted));
        assert!(failed.is_err() && fs::read(&kept).expect("reads") == b"old");
        assert_eq!(fs::read_dir(folder.path()).expect("lists").count(), 2);
    }

    /// A TIFF of one of the forms that the `image` crate does not read, by the `tiff` crate's writer.
    fn tiff_of<C: colortype::ColorType>(
        path: &Path,
        size: (u32, u32),
        samples: &[C::Inner],
        compression: tiff::encoder::Compression,
        predict: bool,
    ) where
        [C::Inner]: tiff::encoder::TiffValue,
    {
        let file = std::fs::File::create(path).expect("a file");
        let mut writer = TiffEncoder::new(std::io::BufWriter::new(file)).expect("writes").with_compression(compression);
        if predict {
            writer = writer.with_predictor(tiff::encoder::Predictor::Horizontal);
        }
        writer.write_image::<C>(size.0, size.1, samples).expect("writes");
    }

    /// Every depth and every packing of grey and colour is the same picture.
    #[test]
    fn forms_of_numbers_are_one_picture() {
        use tiff::encoder::Compression;
        use tiff::encoder::compression::DeflateLevel;
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name);
        let (size, count) = ((5, 3), 15);
        let values: Vec<f64> = (0..3 * count).map(|k| (k * 37 % 101) as f64 / 100.0).collect();
        let (f32s, f64s): (Vec<f32>, Vec<f64>) = (values.iter().map(|v| *v as f32).collect(), values.clone());
        let u32s: Vec<u32> = values.iter().map(|v| (v * f64::from(u32::MAX)).round() as u32).collect();
        for (k, compression) in [
            Compression::Uncompressed,
            Compression::Lzw,
            Compression::Deflate(DeflateLevel::Balanced),
            Compression::Packbits,
        ]
        .into_iter()
        .enumerate()
        {
            tiff_of::<colortype::Gray32Float>(&at(&format!("g32f{k}.tif")), size, &f32s[..count], compression, false);
            tiff_of::<colortype::Gray64Float>(&at(&format!("g64f{k}.tif")), size, &f64s[..count], compression, false);
            tiff_of::<colortype::RGB32Float>(&at(&format!("c32f{k}.tif")), size, &f32s, compression, false);
            tiff_of::<colortype::RGB64Float>(&at(&format!("c64f{k}.tif")), size, &f64s, compression, false);
            tiff_of::<colortype::Gray32>(&at(&format!("g32{k}.tif")), size, &u32s[..count], compression, k == 1);
            tiff_of::<colortype::RGB32>(&at(&format!("c32{k}.tif")), size, &u32s, compression, k == 2);
            for (name, channels, bits) in [
                ("g32f", 1, None),
                ("g64f", 1, None),
                ("c32f", 3, None),
                ("c64f", 3, None),
                ("g32", 1, Some(32)),
                ("c32", 3, Some(32)),
            ] {
                let path = at(&format!("{name}{k}.tif"));
                let read = read_planes(&path, None).unwrap_or_else(|e| panic!("{e}"));
                assert_eq!(
                    (read.values.dim(), read.bits, read.encoding),
                    ((channels, 3, 5), bits, Encoding::Linear),
                    "{name}{k}"
                );
                for ((ch, r, c), v) in read.values.indexed_iter() {
                    assert!((v - values[(r * 5 + c) * channels + ch]).abs() < 6e-8, "{name}{k}");
                }
                let rgb = read_picture(&path, Encoding::Linear).expect("reads");
                assert_eq!(rgb.dim(), (3, 3, 5));
                assert!((rgb[[2, 1, 2]] - read.values[[channels - 1, 1, 2]] as f32).abs() < 1e-7);
                assert_eq!(picture_size(&path).expect("a picture"), [3, 5]);
            }
        }
        // What is no number is no light.
        tiff_of::<colortype::Gray32Float>(&at("nan.tif"), (2, 1), &[0.5, f32::NAN], Compression::Uncompressed, false);
        let error = read_linear(&at("nan.tif")).expect_err("no number").to_string();
        assert!(error.contains("nan.tif") && error.contains("row 0, column 1"), "{error}");
        tiff_of::<colortype::GrayI16>(&at("signed.tif"), (2, 1), &[1, -2], Compression::Uncompressed, false);
        assert!(read_linear(&at("signed.tif")).expect_err("signed").to_string().contains("signed"));
        // Cut short at any length: refused.
        let whole = fs::read(at("g32f0.tif")).expect("reads");
        for keep in [4, 8, 20, whole.len() / 2, whole.len() - 1] {
            fs::write(at("cut.tif"), &whole[..keep]).expect("writes");
            assert!(read_linear(&at("cut.tif")).is_err(), "{keep}");
        }
    }

    /// Floating point goes out and comes in as it was, beyond 0 and 1 too.
    #[test]
    fn floating_point_reads_back_to_the_bit() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name);
        let image = picture().mapv(|v| 3.0 * v - 0.25);
        let beside = Annotation { gamut: Gamut::Srgb, exif: Exif::default() };
        for name in ["a.tif", "a.npy"] {
            write_annotated(&at(name), &image, Encoding::Srgb, Depth::Float, &beside).expect("writes");
            assert_eq!(read_linear(&at(name)).expect("reads"), image, "{name}");
            assert_eq!(read_planes(&at(name), None).expect("reads").values.mapv(|v| v as f32), image, "{name}");
            assert_eq!(picture_size(&at(name)).expect("a picture"), [7, 11]);
        }
        for name in ["a.png", "a.jpg"] {
            let error =
                write_annotated(&at(name), &image, Encoding::Linear, Depth::Float, &beside).expect_err("none there");
            assert!(error.to_string().contains("floating point"), "{error}");
        }
    }
}
