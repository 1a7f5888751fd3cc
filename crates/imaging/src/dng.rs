//! Virtual captures, and developed ones, as DNG: uncompressed 16-bit files that raw converters open, a mosaic ([`write_dng`]) or three linear colours
//! a pixel ([`write_linear_dng`]).
//!
//! Adobe Digital Negative specification 1.4. `ColorMatrix1` takes CIE XYZ under D65 to unbalanced camera RGB:
//! `diag(neutral) · srgb_from_camera⁻¹ · XYZ_from_sRGB⁻¹`, so D65 white has the raw response `AsShotNeutral`. The noise of the
//! sensor is stored as `NoiseProfile`. There is no date in the file: equal inputs give equal bytes.
//! Not covered: previews, compression, lens corrections as opcodes.

use std::path::Path;

use ndarray::{Array3, ArrayView2, Axis};
use rayon::prelude::*;
use tiff::TiffError;
use tiff::encoder::{DirectoryEncoder, Rational, SRational, TiffEncoder, TiffKindStandard};
use tiff::tags::Tag;

use crate::develop::color::{XYZ_FROM_SRGB, inverse, product};
use crate::exif::{Exif, Undefined, ascii};
use crate::sensor::Sensor;
use isoplanat_base::atomic::{Target, write_atomic};
use isoplanat_base::error::{Error, Result};

/// Denominator of matrix entries, levels and neutral.
const UNIT: f64 = 1_000_000.0;

/// The words of a DNG. Letters outside ASCII become `?`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DngInfo {
    /// Program that wrote it.
    pub software: String,
    /// The exposure: scene, method, gain; stored as image description.
    pub description: String,
    /// Lens, stored as EXIF lens model.
    pub lens: String,
    /// Camera, stored as model and unique camera model; empty for the sensor's name.
    pub model: String,
}

/// Writes a mosaic of raw values as DNG, whole or not at all.
///
/// # Shapes
/// `mosaic_dn`: `[row, col]`, in DN of `sensor`.
pub fn write_dng<'a>(
    to: impl Into<Target<'a>>,
    mosaic_dn: ArrayView2<'_, u16>,
    sensor: &Sensor,
    info: &DngInfo,
) -> Result<()> {
    let to = to.into();
    let path = to.path;
    let (rows, cols) = mosaic_dn.dim();
    let sides = u32::try_from(rows).ok().zip(u32::try_from(cols).ok());
    // Classic TIFF counts bytes with 32 bits.
    let fits = |(h, w): &(u32, u32)| (1..1 << 31).contains(&(u64::from(*h) * u64::from(*w)));
    let Some(sides) = sides.filter(fits) else {
        let (file, found) = (path.display().to_string(), format!("{rows} × {cols} pixels"));
        return Err(Error::bad(file, "mosaic", found, "1 to 2147483647 pixels"));
    };
    let camera_from_xyz = camera_from_xyz(&sensor.srgb_from_camera, sensor.neutral_response, &sensor.name)?;
    write_atomic(to, |out| {
        write_tags(out, sides, mosaic_dn, sensor, info, &camera_from_xyz).map_err(|e| unwritten(path, e))
    })
}

fn unwritten(path: &Path, e: TiffError) -> Error {
    match e {
        TiffError::IoError(e) => Error::writing(path, e),
        e => Error::bad(path.display().to_string(), "DNG", e.to_string(), "values a DNG can hold"),
    }
}

/// CIE XYZ under D65 to unbalanced camera RGB.
fn camera_from_xyz(srgb_from_camera: &[[f64; 3]; 3], neutral: [f64; 3], name: &str) -> Result<[[f64; 3]; 3]> {
    let Some(camera_from_srgb) = inverse(srgb_from_camera) else {
        let found = format!("{srgb_from_camera:?}");
        return Err(Error::bad(name, "srgb_from_camera", found, "a matrix with an inverse"));
    };
    let srgb_from_xyz = inverse(&XYZ_FROM_SRGB).expect("a constant with an inverse");
    let mut camera_from_xyz = product(&camera_from_srgb, &srgb_from_xyz);
    for (row, response) in camera_from_xyz.iter_mut().zip(neutral) {
        row.iter_mut().for_each(|v| *v *= response);
    }
    Ok(camera_from_xyz)
}

/// What camera RGB stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraColour {
    /// Balanced camera RGB to linear sRGB.
    pub srgb_from_camera: [[f64; 3]; 3],
    /// Response to what is taken as neutral, R, G, B relative to green.
    pub neutral: [f64; 3],
}

/// Writes camera RGB, linear, 1 where the camera saturates, as a DNG of three colours a pixel, with the facts of its exposure.
///
/// # Shapes
/// `image`: `[3, row, col]`, upright.
///
/// # Errors
/// A picture without pixels or too large for the format, colours without an inverse, a file that cannot be written.
pub fn write_linear_dng<'a>(
    to: impl Into<Target<'a>>,
    image: &Array3<f32>,
    colour: &CameraColour,
    info: &DngInfo,
    exif: &Exif,
) -> Result<()> {
    let to = to.into();
    let path = to.path;
    let (channels, rows, cols) = image.dim();
    let sides = u32::try_from(rows).ok().zip(u32::try_from(cols).ok());
    let fits = |(h, w): &(u32, u32)| channels == 3 && (1..(1 << 32) / 6).contains(&(u64::from(*h) * u64::from(*w)));
    let Some((height, width)) = sides.filter(fits) else {
        let (file, found) = (path.display().to_string(), format!("{channels} colours of {rows} × {cols} pixels"));
        return Err(Error::bad(file, "picture", found, "three colours of 1 to 715827881 pixels"));
    };
    let matrix = camera_from_xyz(&colour.srgb_from_camera, colour.neutral, &path.display().to_string())?;
    if let Some(v) = matrix.iter().flatten().find(|v| !v.is_finite() || v.abs() * UNIT >= f64::from(i32::MAX)) {
        let file = path.display().to_string();
        return Err(Error::bad(
            file,
            "colour matrix",
            v.to_string(),
            "colours of a camera, whose matrix has entries of a few",
        ));
    }
    let model = if info.model.trim().is_empty() { "unknown camera" } else { &info.model };
    let mut samples = vec![0u16; 3 * rows * cols];
    samples.par_chunks_mut(3 * cols).zip(image.axis_iter(Axis(1))).for_each(|(to, from)| {
        for (c, pixel) in to.chunks_exact_mut(3).enumerate() {
            // `as` cuts off to the range, and makes 0 of what is no number.
            (0..3).for_each(|k| pixel[k] = (from[[k, c]] * f32::from(u16::MAX) + 0.5) as u16);
        }
    });
    let write = |out: &mut std::io::BufWriter<std::fs::File>| -> tiff::TiffResult<()> {
        let mut file = TiffEncoder::new(out)?;
        let directories = exif.write_directories(&mut file, u16::MAX)?;
        let mut dng = file.image_directory()?;
        let place = u32::try_from(dng.write_data(&samples[..])?)?;
        dng.write_tag(Tag::BitsPerSample, &[16u16; 3][..])?;
        dng.write_tag(Tag::PhotometricInterpretation, 34892u16)?; // linear camera colours
        dng.write_tag(Tag::SamplesPerPixel, 3u16)?;
        write_strip(&mut dng, (height, width), place, 2 * samples.len())?;
        // Maker and camera stand in its words, not twice.
        exif.write_picture_entries(&mut dng, directories)?;
        dng.write_tag(Tag::ImageDescription, ascii(&info.description).as_str())?;
        write_levels(&mut dng, &ascii(model), &[0.0; 3], &[65535; 3])?;
        write_colour(&mut dng, &matrix, colour.neutral)?;
        write_area(&mut dng, (height, width))?;
        dng.finish()
    };
    write_atomic(to, |out| write(out).map_err(|e| unwritten(path, e)))
}

type Directory<'a, W> = DirectoryEncoder<'a, W, TiffKindStandard>;

/// Size, and one strip of pixels.
fn write_strip<W: std::io::Write + std::io::Seek>(
    dng: &mut Directory<'_, W>,
    (rows, cols): (u32, u32),
    place: u32,
    bytes: usize,
) -> tiff::TiffResult<()> {
    dng.write_tag(Tag::NewSubfileType, 0u32)?;
    dng.write_tag(Tag::ImageWidth, cols)?;
    dng.write_tag(Tag::ImageLength, rows)?;
    dng.write_tag(Tag::Compression, 1u16)?;
    dng.write_tag(Tag::PlanarConfiguration, 1u16)?;
    dng.write_tag(Tag::RowsPerStrip, rows)?;
    dng.write_tag(Tag::StripOffsets, place)?;
    dng.write_tag(Tag::StripByteCounts, u32::try_from(bytes)?)
}

/// DNG version, camera and levels, one or one a colour.
fn write_levels<W: std::io::Write + std::io::Seek>(
    dng: &mut Directory<'_, W>,
    model: &str,
    black: &[f64],
    white: &[u32],
) -> tiff::TiffResult<()> {
    dng.write_tag(Tag::Unknown(50706), &[1u8, 4, 0, 0][..])?; // DNGVersion
    dng.write_tag(Tag::Unknown(50707), &[1u8, 1, 0, 0][..])?; // DNGBackwardVersion
    dng.write_tag(Tag::Unknown(50708), model)?; // UniqueCameraModel
    dng.write_tag(Tag::Unknown(50713), &[1u16, 1][..])?; // BlackLevelRepeatDim
    let black: Vec<Rational> = black.iter().map(|v| level(*v)).collect();
    dng.write_tag(Tag::Unknown(50714), &black[..])?; // BlackLevel
    dng.write_tag(Tag::Unknown(50717), white) // WhiteLevel
}

fn write_colour<W: std::io::Write + std::io::Seek>(
    dng: &mut Directory<'_, W>,
    camera_from_xyz: &[[f64; 3]; 3],
    neutral: [f64; 3],
) -> tiff::TiffResult<()> {
    let matrix: Vec<SRational> = camera_from_xyz.iter().flatten().map(|v| signed(*v)).collect();
    dng.write_tag(Tag::Unknown(50721), &matrix[..])?; // ColorMatrix1
    let neutral: Vec<Rational> = neutral.iter().map(|v| unsigned(*v)).collect();
    dng.write_tag(Tag::Unknown(50728), &neutral[..])?; // AsShotNeutral
    dng.write_tag(Tag::Unknown(50730), &[signed(0.0)][..])?; // BaselineExposure
    dng.write_tag(Tag::Unknown(50778), 21u16) // CalibrationIlluminant1: D65
}

fn write_area<W: std::io::Write + std::io::Seek>(
    dng: &mut Directory<'_, W>,
    (rows, cols): (u32, u32),
) -> tiff::TiffResult<()> {
    dng.write_tag(Tag::Unknown(50829), &[0u32, 0, rows, cols][..])?; // ActiveArea
    dng.write_tag(Tag::Unknown(50719), &[0u32, 0][..])?; // DefaultCropOrigin
    dng.write_tag(Tag::Unknown(50720), &[cols, rows][..]) // DefaultCropSize
}

fn write_tags<W: std::io::Write + std::io::Seek>(
    out: W,
    (rows, cols): (u32, u32),
    mosaic_dn: ArrayView2<'_, u16>,
    sensor: &Sensor,
    info: &DngInfo,
    camera_from_xyz: &[[f64; 3]; 3],
) -> tiff::TiffResult<()> {
    let mut file = TiffEncoder::new(out)?;
    // The lens stands in an EXIF directory of its own.
    let mut exif = file.extra_directory()?;
    exif.write_tag(Tag::Unknown(36864), Undefined(b"0230"))?; // ExifVersion
    exif.write_tag(Tag::Unknown(42036), ascii(&info.lens).as_str())?; // LensModel
    let exif = exif.finish_with_offsets()?;

    let model = ascii(if info.model.is_empty() { &sensor.name } else { &info.model });
    let mut dng = file.image_directory()?;
    let standard = mosaic_dn.as_standard_layout();
    let pixels = standard.as_slice().expect("standard layout");
    let offset = dng.write_data(pixels)?;
    let place = u32::try_from(offset)?;
    // Pixels.
    dng.write_tag(Tag::BitsPerSample, 16u16)?;
    dng.write_tag(Tag::PhotometricInterpretation, 32803u16)?; // colour filter array
    dng.write_tag(Tag::SamplesPerPixel, 1u16)?;
    write_strip(&mut dng, (rows, cols), place, 2 * pixels.len())?;
    dng.write_tag(Tag::Orientation, 1u16)?;
    // Words.
    dng.write_tag(Tag::ImageDescription, ascii(&info.description).as_str())?;
    dng.write_tag(Tag::Make, "Isoplanat")?;
    dng.write_tag(Tag::Model, model.as_str())?;
    dng.write_tag(Tag::Software, ascii(&info.software).as_str())?;
    dng.write_tag(Tag::ExifDirectory, exif.offset)?;
    // Filter array.
    dng.write_tag(Tag::Unknown(33421), &[2u16, 2][..])?; // CFARepeatPatternDim
    dng.write_tag(Tag::Unknown(33422), &sensor.cfa.0[..])?; // CFAPattern
    dng.write_tag(Tag::Unknown(50710), &[0u8, 1, 2][..])?; // CFAPlaneColor
    dng.write_tag(Tag::Unknown(50711), 1u16)?; // CFALayout: rectangular
    write_levels(&mut dng, &model, &[sensor.black_level], &[sensor.white_level.round() as u32])?;
    write_colour(&mut dng, camera_from_xyz, sensor.neutral_response)?;
    write_area(&mut dng, (rows, cols))?;
    // Variance = S·signal + O, the model of `imaging::sensor::noise`.
    let read = sensor.read_noise_electrons / sensor.full_well_electrons;
    dng.write_tag(Tag::Unknown(51041), &[1.0 / sensor.full_well_electrons, read * read][..])?; // NoiseProfile
    dng.finish()
}

/// A level in DN: whole where it is whole, so that readers without fractions lose nothing.
fn level(v: f64) -> Rational {
    if v.fract() == 0.0 { Rational { n: v as u32, d: 1 } } else { Rational { n: (v * 1000.0).round() as u32, d: 1000 } }
}

fn unsigned(v: f64) -> Rational {
    Rational { n: (v * UNIT).round() as u32, d: UNIT as u32 }
}

fn signed(v: f64) -> SRational {
    SRational { n: (v * UNIT).round() as i32, d: UNIT as i32 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    fn mosaic() -> Array2<u16> {
        let rng = &mut fastrand::Rng::with_seed(9);
        Array2::from_shape_fn((34, 51), |_| rng.u16(200..=4095))
    }

    fn info() -> DngInfo {
        DngInfo {
            software: "isoplanat 0.1".into(),
            description: "test chart, 1 m → 8 ms".into(),
            lens: "Cooke triplet 50 mm".into(),
            model: "virtual".into(),
        }
    }

    #[test]
    fn equal_inputs_give_equal_bytes_and_the_pixels_read_back() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let (a, b) = (folder.path().join("a.dng"), folder.path().join("b.dng"));
        let sensor = Sensor { black_level: 255.6, ..Sensor::generic() };
        // A transposed view is written in its own order.
        let turned = mosaic().reversed_axes();
        write_dng(&a, turned.view(), &sensor, &info()).expect("writes");
        write_dng(&b, turned.as_standard_layout().view(), &sensor, &info()).expect("writes");
        let bytes = std::fs::read(&a).expect("reads");
        assert_eq!(bytes, std::fs::read(&b).expect("reads"));
        let holds = |part: Vec<u8>| bytes.windows(part.len()).any(|w| w == part);
        assert!(holds(turned.iter().flat_map(|v| v.to_ne_bytes()).collect()), "the pixels, row by row");
        assert!(holds([255_600u32, 1000].iter().flat_map(|v| v.to_ne_bytes()).collect()), "the black level");
        assert!(holds(b"test chart, 1 m ? 8 ms\0".to_vec()));
    }

    #[test]
    fn empty_mosaics_and_singular_colours_are_refused() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.dng");
        let empty = Array2::zeros((0, 4));
        assert!(write_dng(&path, empty.view(), &Sensor::generic(), &info()).is_err());
        let flat = Sensor { srgb_from_camera: [[0.5, 0.25, 0.25]; 3], ..Sensor::generic() };
        let error = write_dng(&path, mosaic().view(), &flat, &info()).expect_err("singular").to_string();
        assert!(error.contains("srgb_from_camera"), "{error}");
        assert!(!path.exists());
    }

    /// An independent reader finds the pixels, the layout, the levels and the neutral.
    #[test]
    fn rawler_reads_what_was_written() {
        use crate::sensor::cfa::Cfa;
        use rawler::rawimage::{RawImageData, RawPhotometricInterpretation};

        let folder = tempfile::tempdir().expect("a temporary folder");
        for cfa in Cfa::ALL {
            let path = folder.path().join(format!("{cfa}.dng"));
            let sensor = Sensor { cfa, ..Sensor::generic() };
            write_dng(&path, mosaic().view(), &sensor, &info()).expect("writes");
            let raw = rawler::decode_file(&path).expect("rawler reads it");
            assert_eq!((raw.height, raw.width, raw.cpp), (34, 51, 1));
            assert!(matches!(&raw.data, RawImageData::Integer(v) if *v == mosaic().into_raw_vec_and_offset().0));
            let RawPhotometricInterpretation::Cfa(config) = &raw.photometric else { panic!("no CFA") };
            assert_eq!(config.cfa.name, cfa.name());
            assert_eq!(raw.whitelevel.0, [4095]);
            assert!(raw.blacklevel.levels.iter().all(|v| v.as_f32() == 256.0));
            let gain: Vec<f32> = raw.wb_coeffs[..3].iter().map(|v| v / raw.wb_coeffs[1]).collect();
            for (g, response) in gain.iter().zip(sensor.neutral_response) {
                assert!((f64::from(*g) * response - 1.0).abs() < 1e-5, "{gain:?}");
            }
            // D65 white gives the neutral.
            let matrix = raw.color_matrix.values().next().expect("a colour matrix");
            let white: Vec<f64> = XYZ_FROM_SRGB.iter().map(|row| row.iter().sum()).collect();
            for (row, response) in matrix.chunks(3).zip(sensor.neutral_response) {
                let seen: f64 = row.iter().zip(&white).map(|(m, w)| f64::from(*m) * w).sum();
                assert!((seen - response).abs() < 1e-5, "{seen} against {response}");
            }
        }
    }
}
