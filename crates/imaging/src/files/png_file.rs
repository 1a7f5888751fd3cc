//! What a PNG says beside its pixels, and whether its pixels are of its palette: decoders show others as black, and say nothing.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use png::{BitDepth, ColorType, Decoder, DecodingError, Info, Limits, Transformations};

use crate::develop::gamut::Gamut;
use crate::develop::profile::{Curve, Told};
use isoplanat_base::error::{Error, Result};

/// Transfer functions of H.273 that are told by `cICP`.
const HLG: u8 = 18;
const PQ: u8 = 16;
/// Primaries of Display P3 there.
const P3: u8 = 12;

fn refused(path: &Path, e: DecodingError) -> Error {
    match e {
        DecodingError::IoError(e) => super::content::unread(path, e),
        e => Error::bad(path.display().to_string(), "picture", e.to_string(), super::content::ALLOWED),
    }
}

fn open(path: &Path) -> Result<png::Reader<BufReader<File>>> {
    let file = File::open(path).map_err(|e| Error::reading(path, e))?;
    let mut decoder = Decoder::new_with_limits(BufReader::new(file), Limits { bytes: usize::MAX });
    decoder.set_transformations(Transformations::IDENTITY);
    decoder.read_info().map_err(|e| refused(path, e))
}

/// What the file says of its numbers, the first of: `cICP`, a profile, `sRGB`, `gAMA` (PNG, third edition, 4.3).
///
/// # Errors
/// A file that cannot be read; numbers of which a screen's brightness makes light (HLG, PQ).
pub(super) fn told(path: &Path) -> Result<Option<Told>> {
    let reader = open(path)?;
    let info = reader.info();
    if let Some(points) = info.coding_independent_code_points {
        let curve = match points.transfer_function {
            1 | 6 | 14 | 15 => Some(Curve::bt709()),
            4 => Some(Curve::power(2.2)),
            5 => Some(Curve::power(2.8)),
            8 => Some(Curve::Linear),
            13 => Some(Curve::Srgb),
            number @ (PQ | HLG) => {
                let name = if number == PQ { "PQ" } else { "HLG" };
                let found = format!("numbers coded as {name}, for screens of high range");
                return Err(Error::bad(
                    path.display().to_string(),
                    "cICP",
                    found,
                    "sRGB, linear light or a power of it",
                ));
            }
            _ => None,
        };
        if let Some(curve) = curve {
            let gamut = if points.color_primaries == P3 { Gamut::DisplayP3 } else { Gamut::Srgb };
            return Ok(Some(Told::of(gamut, curve)));
        }
    }
    Ok(by_profile(info).or_else(|| by_numbers(info)))
}

fn by_profile(info: &Info<'_>) -> Option<Told> {
    Told::by_icc(info.icc_profile.as_deref()?)
}

fn by_numbers(info: &Info<'_>) -> Option<Told> {
    if info.srgb.is_some() {
        return Some(Curve::Srgb.into());
    }
    let gamma = f64::from(info.gama_chunk?.into_scaled()) / 1e5;
    // That of a curve of exponents from 0.1 to 10.
    (0.1..=10.0).contains(&gamma).then(|| Curve::power(gamma.recip()).into())
}

/// Refuses pixels beyond the palette.
///
/// # Errors
/// As said, with the first of them; a file that cannot be read.
pub(super) fn check_palette(path: &Path) -> Result<()> {
    let mut reader = open(path)?;
    let info = reader.info();
    if info.color_type != ColorType::Indexed {
        return Ok(());
    }
    let colours = info.palette.as_ref().map_or(0, |p| p.len() / 3);
    let (width, depth) = (info.width as usize, info.bit_depth);
    let bits = match depth {
        BitDepth::One => 1,
        BitDepth::Two => 2,
        BitDepth::Four => 4,
        _ => 8,
    };
    if colours >= 1 << bits {
        return Ok(());
    }
    let mut pixels = vec![0; reader.output_buffer_size().unwrap_or(0)];
    reader.next_frame(&mut pixels).map_err(|e| refused(path, e))?;
    let row = (width * bits).div_ceil(8).max(1);
    for (r, bytes) in pixels.chunks_exact(row).enumerate() {
        let index = |c: usize| usize::from(bytes[c * bits / 8] >> (8 - bits - c * bits % 8)) & ((1 << bits) - 1);
        if let Some(c) = (0..width).find(|c| index(*c) >= colours) {
            let found = format!("colour {} of a palette of {colours}", index(c));
            let allowed = format!("colours from 0 to {}", colours.saturating_sub(1));
            return Err(Error::bad(path.display().to_string(), format!("row {r}, column {c}"), found, allowed));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::{Encoding, read_linear, read_planes};
    use png::{Encoder, ScaledFloat};

    /// A PNG of `samples`, with what `say` puts beside them; the transfer function of `cICP` where it is not 0.
    fn written(
        path: &Path,
        size: (u32, u32),
        form: (ColorType, BitDepth),
        samples: &[u8],
        transfer: u8,
        say: impl FnOnce(&mut Info<'static>),
    ) {
        let mut info = Info::with_size(size.0, size.1);
        (info.color_type, info.bit_depth) = form;
        say(&mut info);
        let file = File::create(path).expect("a file");
        let mut writer = Encoder::with_info(file, info).expect("a form").write_header().expect("writes");
        if transfer > 0 {
            writer.write_chunk(png::chunk::ChunkType(*b"cICP"), &[1, transfer, 0, 1]).expect("writes");
        }
        writer.write_image_data(samples).expect("writes");
    }

    /// Rows of five pixels end within a byte: what stands in the bits behind them is no pixel.
    #[test]
    fn colours_beyond_a_palette_are_refused() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.png");
        for (depth, bits) in [(BitDepth::One, 1_usize), (BitDepth::Two, 2), (BitDepth::Four, 4), (BitDepth::Eight, 8)] {
            let colours = if bits == 1 { 1 } else { 3 };
            for bad in [None, Some(0), Some(4), Some(7), Some(9)] {
                let row = (5 * bits).div_ceil(8);
                let mut samples = vec![0u8; 2 * row];
                for pixel in 0..10 {
                    let index = if bad == Some(pixel) { colours } else { pixel % colours };
                    let at = pixel % 5 * bits;
                    samples[pixel / 5 * row + at / 8] |= (index as u8) << (8 - bits - at % 8);
                }
                if bits < 8 {
                    samples[row - 1] |= 1;
                }
                written(&path, (5, 2), (ColorType::Indexed, depth), &samples, 0, |info| {
                    info.palette = Some(vec![90; 3 * colours].into());
                });
                let read = read_linear(&path).map(|image| image.dim());
                let Some(pixel) = bad else {
                    assert_eq!(read.expect("of the palette"), (3, 2, 5), "{bits}");
                    continue;
                };
                let error = read.expect_err("beyond the palette").to_string();
                let place = format!("row {}, column {}", pixel / 5, pixel % 5);
                assert!(error.contains(&place) && error.contains(&format!("palette of {colours}")), "{error}");
            }
        }
    }

    /// What a file says of its numbers counts: `cICP` before a profile, that before `sRGB`, that before `gAMA`; what is asked for counts more.
    #[test]
    fn what_a_file_says_of_its_numbers_counts() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.png");
        let linear = Gamut::Srgb.icc(true).expect("writes");
        // Half of the range, of 16 bits.
        let light = |say: &dyn Fn(&mut Info<'static>), transfer: u8, encoding: Option<Encoding>| {
            let form = (ColorType::Grayscale, BitDepth::Sixteen);
            written(&path, (1, 1), form, &[0x80, 0x00], transfer, say);
            read_planes(&path, encoding).map(|planes| planes.values[[0, 0, 0]])
        };
        let half = 32768.0 / 65535.0f64;
        let srgb = crate::develop::color::linear_from_srgb(half);
        let gamma = |info: &mut Info<'static>| info.source_gamma = Some(ScaledFloat::from_scaled(50_000));
        let profile = |info: &mut Info<'static>| info.icc_profile = Some(linear.clone().into());
        let standard = |info: &mut Info<'static>| info.srgb = Some(png::SrgbRenderingIntent::Perceptual);
        let close = |found: Result<f64>, wanted: f64| {
            let found = found.expect("reads");
            assert!((found - wanted).abs() < 1e-6, "{found} {wanted}");
        };
        let nothing = |_: &mut Info<'static>| {};
        close(light(&nothing, 0, None), half);
        close(light(&gamma, 0, None), half.powi(2));
        close(light(&standard, 0, None), srgb);
        close(light(&profile, 0, None), half);
        close(light(&nothing, 13, None), srgb);
        close(light(&nothing, 8, None), half);
        close(light(&standard, 4, None), half.powf(2.2));
        close(light(&standard, 0, Some(Encoding::Linear)), half);
        close(light(&gamma, 0, Some(Encoding::Srgb)), srgb);
        for (number, name) in [(PQ, "PQ"), (HLG, "HLG")] {
            let error = light(&nothing, number, None).expect_err("of high range");
            assert!(error.to_string().contains(name) && error.exit_code() == 2, "{error}");
        }
    }
}
