//! RAW file to samples, levels and colour facts; the only place that names the decoder crate.
//!
//! The decoder can panic, or ask for far more memory than the picture needs, on files that are not what they say.
//! [`decode`] catches what unwinds; programs should decode in a child process, see [`crate::raw_process`].

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use ndarray::{Array2, Array3};
use rawler::decoders::{Decoder, FormatHint, RawDecodeParams, WellKnownIFD};
use rawler::formats::tiff::{Rational, SRational};
use rawler::imgop::xyz::Illuminant;
use rawler::rawimage::{RawImage, RawImageData, RawPhotometricInterpretation};
use rawler::rawsource::RawSource;
use rawler::tags::{DngTag, TiffCommonTag};

use crate::opcodes;
use crate::orientation::Orientation;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::exif::{Directory, Exif, Value, tags};
use isoplanat_imaging::sensor::cfa::Cfa;

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
            RawPixels::Mosaic { samples, .. } => samples.dim(),
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

/// Decodes a RAW file in this process.
///
/// # Errors
/// A file that cannot be read, is cut short, is no RAW, or whose facts contradict each other; a panic of the decoder
/// becomes an error too. Memory is not limited here.
pub fn decode(path: &Path) -> Result<RawCapture> {
    let facts = std::fs::metadata(path).map_err(|e| Error::reading(path, e))?;
    if !facts.is_file() {
        return Err(bad(path, "not a file", ALLOWED));
    }
    if facts.len() == 0 {
        return Err(bad(path, "the file is empty", ALLOWED));
    }
    // The decoder maps the file; opening it first gives the system's own reason.
    std::fs::File::open(path).map_err(|e| Error::reading(path, e))?;
    let outcome = catch_unwind(AssertUnwindSafe(|| {
        let source = RawSource::new(path).map_err(|e| Error::reading(path, e))?;
        let decoder = rawler::get_decoder(&source).map_err(|e| refused(path, &e.to_string()))?;
        check_extent(path, decoder.as_ref(), facts.len())?;
        let parameters = RawDecodeParams::default();
        let image = decoder.raw_image(&source, &parameters, false).map_err(|e| refused(path, &e.to_string()))?;
        let exif = catch_unwind(AssertUnwindSafe(|| decoder.raw_metadata(&source, &parameters).ok()));
        let exif = exif.ok().flatten().map(|m| m.exif);
        let exif_orientation = exif.as_ref().and_then(|e| e.orientation);
        let orientation = exif_orientation.unwrap_or_else(|| image.orientation.to_u16());
        let dng = decoder.format_hint() == FormatHint::DNG;
        let mut capture = capture_from(path, image, Orientation::from_exif(orientation), dng)?;
        capture.exif = facts_of(exif.as_ref(), &capture.make, &capture.model);
        if dng {
            apply_opcodes(path, decoder.as_ref(), &mut capture)?;
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
fn check_extent(path: &Path, decoder: &dyn Decoder, bytes: u64) -> Result<()> {
    let directory = catch_unwind(AssertUnwindSafe(|| decoder.ifd(WellKnownIFD::Raw).ok().flatten()));
    let Ok(Some(directory)) = directory else { return Ok(()) };
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
fn capture_from(path: &Path, image: RawImage, orientation: Orientation, dng: bool) -> Result<RawCapture> {
    let (rows, columns, planes) = (image.height, image.width, image.cpp);
    if !(1..=65_536).contains(&rows) || !(1..=65_536).contains(&columns) {
        return Err(bad(path, format!("{columns} × {rows} pixels"), "1 to 65536 pixels a side"));
    }
    let (mut top, mut left, mut height, mut width) = (0, 0, rows, columns);
    if let Some(area) = image.active_area {
        let fits =
            |start: usize, size: usize, all: usize| size > 0 && start.checked_add(size).is_some_and(|e| e <= all);
        if !(fits(area.p.y, area.d.h, rows) && fits(area.p.x, area.d.w, columns)) {
            return Err(bad(path, format!("active area {area:?} of {columns} × {rows} pixels"), "an area within it"));
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
    let (black, white) = if dng { levels(path, &image, 0, 0) } else { levels(path, &image, top, left) }?;
    let pixels = match (&image.photometric, planes) {
        (RawPhotometricInterpretation::Cfa(config), 1) => {
            let cfa = Cfa::from_name(&config.cfa.name).ok_or_else(|| {
                let name: String = config.cfa.name.chars().take(12).collect();
                bad(path, format!("colour filter layout `{name}`"), "a Bayer layout: RGGB, BGGR, GRBG or GBRG")
            })?;
            let samples = Array2::from_shape_fn((height, width), |(r, c)| sample(0, r, c));
            RawPixels::Mosaic { samples, cfa: cfa.shifted(top, left) }
        }
        (RawPhotometricInterpretation::LinearRaw, 3) => {
            RawPixels::Linear(Array3::from_shape_fn((3, height, width), |(plane, r, c)| sample(plane, r, c)))
        }
        (kind, planes) => {
            let kind = match kind {
                RawPhotometricInterpretation::BlackIsZero => "a picture without a colour filter",
                RawPhotometricInterpretation::Cfa(_) => "a filtered picture",
                RawPhotometricInterpretation::LinearRaw => "a linear picture",
            };
            return Err(bad(path, format!("{kind} with {planes} samples a pixel"), "a Bayer mosaic or three colours"));
        }
    };
    let make = if image.clean_make.is_empty() { image.make.clone() } else { image.clean_make.clone() };
    let model = if image.clean_model.is_empty() { image.model.clone() } else { image.clean_model.clone() };
    Ok(RawCapture {
        pixels,
        black,
        white,
        neutral: neutral(&image, dng),
        camera_from_xyz: camera_from_xyz(&image),
        orientation,
        make,
        model,
        exif: Exif::default(),
        notes: Vec::new(),
    })
}

/// What the decoder found of the exposure's facts.
fn facts_of(found: Option<&rawler::exif::Exif>, make: &str, model: &str) -> Exif {
    use Directory::{Exposure, Picture, Place};
    let mut facts = Exif::default();
    let text = |v: &Option<String>| v.clone().map(Value::Text);
    let short = |v: Option<u16>| v.map(Value::Short);
    let ratio = |v: &Option<Rational>| v.as_ref().map(|r| Value::Ratios(vec![[r.n, r.d]]));
    let signed = |v: &Option<SRational>| v.as_ref().map(|r| Value::SignedRatios(vec![[r.n, r.d]]));
    let three =
        |v: &Option<[Rational; 3]>| v.as_ref().map(|all| Value::Ratios(all.iter().map(|r| [r.n, r.d]).collect()));
    let mut put = |directory, entries: Vec<(u16, Option<Value>)>| {
        entries.into_iter().for_each(|(tag, v)| {
            if let Some(v) = v {
                facts.set(directory, tag, v);
            }
        });
    };
    put(Picture, vec![(tags::MAKE, Some(Value::Text(make.into()))), (tags::MODEL, Some(Value::Text(model.into())))]);
    let Some(e) = found else { return facts };
    put(Picture, vec![(0x013b, text(&e.artist)), (0x8298, text(&e.copyright)), (0x0132, text(&e.modify_date))]);
    // Which of the two is named has to be there.
    let sensitivity = e.sensitivity_type.filter(|kind| match kind {
        2 => e.recommended_exposure_index.is_some(),
        3 => e.iso_speed.is_some(),
        6 => e.recommended_exposure_index.is_some() && e.iso_speed.is_some(),
        _ => false,
    });
    let lens_spec = e.lens_spec.as_ref().map(|all| Value::Ratios(all.iter().map(|r| [r.n, r.d]).collect()));
    put(
        Exposure,
        vec![
            (tags::EXPOSURE_TIME, ratio(&e.exposure_time)),
            (tags::F_NUMBER, ratio(&e.fnumber)),
            (0x8822, short(e.exposure_program)),
            (tags::ISO, short(e.iso_speed_ratings)),
            (tags::SENSITIVITY_TYPE, short(sensitivity)),
            (tags::EXPOSURE_INDEX, e.recommended_exposure_index.map(Value::Long)),
            (tags::ISO_LONG, e.iso_speed.map(Value::Long)),
            (tags::TAKEN, text(&e.date_time_original)),
            (0x9004, text(&e.create_date)),
            (0x9010, text(&e.offset_time)),
            (0x9011, text(&e.offset_time_original)),
            (0x9012, text(&e.offset_time_digitized)),
            (0x9201, signed(&e.shutter_speed_value)),
            (0x9202, ratio(&e.aperture_value)),
            (0x9203, signed(&e.brightness_value)),
            (0x9204, signed(&e.exposure_bias)),
            (0x9205, ratio(&e.max_aperture_value)),
            (tags::SUBJECT_DISTANCE, ratio(&e.subject_distance)),
            (0x9207, short(e.metering_mode)),
            (0x9208, short(e.light_source)),
            (0x9209, short(e.flash)),
            (tags::FOCAL_LENGTH, ratio(&e.focal_length)),
            (0x9290, text(&e.sub_sec_time)),
            (0x9291, text(&e.sub_sec_time_original)),
            (0x9292, text(&e.sub_sec_time_digitized)),
            (0xa402, short(e.exposure_mode)),
            (0xa403, short(e.white_balance)),
            (0xa406, short(e.scene_capture_type)),
            (0xa430, text(&e.owner_name)),
            (0xa431, text(&e.serial_number)),
            (0xa432, lens_spec),
            (0xa433, text(&e.lens_make)),
            (tags::LENS_MODEL, text(&e.lens_model)),
            (0xa435, text(&e.lens_serial_number)),
        ],
    );
    let Some(g) = &e.gps else { return facts };
    put(
        Place,
        vec![
            (0x0001, text(&g.gps_latitude_ref)),
            (0x0002, three(&g.gps_latitude)),
            (0x0003, text(&g.gps_longitude_ref)),
            (0x0004, three(&g.gps_longitude)),
            (0x0005, g.gps_altitude_ref.map(|v| Value::Bytes(vec![v]))),
            (0x0006, ratio(&g.gps_altitude)),
            (0x0007, three(&g.gps_timestamp)),
            (0x0010, text(&g.gps_img_direction_ref)),
            (0x0011, ratio(&g.gps_img_direction)),
            (0x0012, text(&g.gps_map_datum)),
            (0x001d, text(&g.gps_date_stamp)),
        ],
    );
    facts
}

/// Does what the DNG's second opcode list asks; the samples then run from 0 to 1.
fn apply_opcodes(path: &Path, decoder: &dyn Decoder, capture: &mut RawCapture) -> Result<()> {
    let Ok(Some(directory)) = decoder.ifd(WellKnownIFD::Raw) else { return Ok(()) };
    let Some(entry) = directory.get_entry(DngTag::OpcodeList2) else { return Ok(()) };
    let (maps, others) = opcodes::parse(entry.get_data()).ok_or_else(|| {
        bad(path, "a damaged list of corrections (OpcodeList2)", "a list as the DNG specification has it")
    })?;
    if !others.is_empty() {
        capture.notes.push(format!("corrections the file asks for are left out (DNG opcodes {others:?})"));
    }
    if maps.is_empty() {
        return Ok(());
    }
    let (black, white) = (capture.black, capture.white);
    let mapped = |plane: usize, row: usize, column: usize, level: usize, sample: f32| {
        let x = f64::from(sample - black[level]) / f64::from(white[level] - black[level]);
        let y = maps.iter().filter(|m| m.covers(plane, row, column)).fold(x, |x, m| m.at(x));
        y as f32
    };
    match &mut capture.pixels {
        RawPixels::Mosaic { samples, .. } => {
            for ((r, c), v) in samples.indexed_iter_mut() {
                *v = mapped(0, r, c, (r & 1) * 2 + (c & 1), *v);
            }
        }
        RawPixels::Linear(samples) => {
            for ((plane, r, c), v) in samples.indexed_iter_mut() {
                *v = mapped(plane, r, c, plane, *v);
            }
        }
    }
    (capture.black, capture.white) = ([0.0; 4], [1.0; 4]);
    Ok(())
}

/// Black and white level of the four places of the active area's 2×2 cell, or of the three channels; the area starts
/// at `top`, `left` of the level table.
fn levels(path: &Path, image: &RawImage, top: usize, left: usize) -> Result<([f32; 4], [f32; 4])> {
    let table = &image.blacklevel;
    let all = table.as_vec();
    let entries = table.width.checked_mul(table.height).and_then(|n| n.checked_mul(table.cpp));
    if all.is_empty() || entries != Some(all.len()) {
        return Err(bad(path, "a table of black levels of the wrong size", ALLOWED));
    }
    let white_levels = image.whitelevel.as_vec();
    let Some(&first_white) = white_levels.first() else {
        return Err(bad(path, "no white level", ALLOWED));
    };
    let (mut black, mut white) = ([0.0; 4], [0.0; 4]);
    for i in 0..4 {
        if image.cpp == 3 {
            black[i] = all[i.min(table.cpp.min(3) - 1)];
            white[i] = white_levels.get(i.min(2)).copied().unwrap_or(first_white);
        } else {
            let (row, column) = ((top + i / 2) % table.height, (left + i % 2) % table.width);
            black[i] = all[(row * table.width + column) * table.cpp];
            white[i] = if white_levels.len() == 4 {
                white_levels[((top + i / 2) % 2) * 2 + (left + i % 2) % 2]
            } else {
                first_white
            };
        }
        if !(black[i].is_finite() && white[i].is_finite() && white[i] > black[i]) {
            return Err(bad(
                path,
                format!("black level {} and white level {}", black[i], white[i]),
                "black below white",
            ));
        }
    }
    Ok((black, white))
}

/// Camera response to neutral, green 1, from the gains the file names; `None` where they are missing or absurd.
fn neutral(image: &RawImage, dng: bool) -> Option<[f64; 3]> {
    let [mut r, g, mut b, _] = image.wb_coeffs;
    if image.clean_model == "D1" && !dng {
        // The Nikon D1 writes its gains on top of fixed ones that its samples already carry (dcraw and RawSpeed: 527/256
        // for red, 317/256 for blue); the decoder leaves them in.
        r *= 256.0 / 527.0;
        b *= 256.0 / 317.0;
    }
    let response = [f64::from(g / r), 1.0, f64::from(g / b)];
    response.iter().all(|v| v.is_finite() && (0.02..=50.0).contains(v)).then_some(response)
}

/// The colour matrix for the illuminant nearest to D65.
fn camera_from_xyz(image: &RawImage) -> Option<[[f64; 3]; 3]> {
    use Illuminant::{
        A, B, C, CloudyWeather, D50, D55, D65, D75, Daylight, FineWeather, Flash, Shade, Tungsten, Unknown,
    };
    let order = [D65, D75, D55, D50, Daylight, C, B, CloudyWeather, FineWeather, Shade, Flash, Unknown, A, Tungsten];
    let flat = image.color_matrix_find_first(order).map(|(_, m)| m)?;
    if flat.len() != 9 || !flat.iter().all(|v| v.is_finite()) {
        return None;
    }
    let matrix = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(flat[3 * i + j])));
    matrix.iter().flatten().any(|v: &f64| *v != 0.0).then_some(matrix)
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::shared;
    use ndarray::s;

    fn facts(name: &str) -> Option<(RawCapture, serde_json::Value)> {
        let file = shared(&format!("data/raw/{name}"))?;
        let json = std::fs::read_to_string(shared(&format!("data/raw/{name}.json"))?).expect("readable");
        Some((decode(&file).expect("decodes"), serde_json::from_str(&json).expect("JSON")))
    }

    #[test]
    fn mosaics_levels_and_layout_equal_libraws() {
        for name in ["RAW_NIKON_D1.NEF", "nikon_crop_gbrg_u16.dng", "nikon_crop_rggb_lj92.dng"] {
            let Some((capture, json)) = facts(name) else { return };
            let RawPixels::Mosaic { samples, cfa } = &capture.pixels else { panic!("{name}: a mosaic") };
            let visible = &json["raw_image_visible"];
            assert_eq!(samples.nrows() as u64, visible["shape"][0].as_u64().expect("rows"), "{name}");
            assert_eq!(samples.ncols() as u64, visible["shape"][1].as_u64().expect("columns"), "{name}");
            for (phase, (r, c)) in [("00", (0, 0)), ("01", (0, 1)), ("10", (1, 0)), ("11", (1, 1))] {
                let sum: f64 = samples.slice(s![r..;2, c..;2]).iter().map(|&v| f64::from(v)).sum();
                assert_eq!(sum, visible["sum_by_2x2_phase"][phase].as_f64().expect("sum"), "{name} {phase}");
                // LibRaw counts the second green as 3.
                let color = json["raw_pattern"][r][c].as_u64().expect("colour");
                assert_eq!(cfa.channel(r, c) as u64, if color == 3 { 1 } else { color }, "{name} {phase}");
            }
            for pixel in visible["pixels_row_col_value"].as_array().expect("pixels") {
                let at = |i: usize| pixel[i].as_u64().expect("number") as usize;
                assert_eq!(samples[[at(0), at(1)]], at(2) as f32, "{name}");
            }
            for i in 0..4 {
                assert_eq!(f64::from(capture.black[i]), json["black_level_per_channel"][i].as_f64().expect("black"));
            }
            if name.ends_with("dng") {
                let wb = |i: usize| json["camera_whitebalance"][i].as_f64().expect("gain");
                let neutral = capture.neutral.expect("as shot");
                for i in 0..3 {
                    assert!((neutral[i] * wb(i) / wb(1) - 1.0).abs() < 1e-5, "{name}: {neutral:?}");
                }
            }
        }
    }

    #[test]
    fn the_d1s_gains_leave_its_grey_pavement_grey() {
        let Some(path) = shared("data/raw/RAW_NIKON_D1.NEF") else { return };
        let neutral = decode(&path).expect("decodes").neutral.expect("as shot");
        // The file's own gains, 1.97656 and 1.28906, by 256/527 and 256/317; LibRaw reports 1 and 1 for this file.
        assert!((neutral[0] - 1.0415).abs() < 1e-3 && (neutral[2] - 0.9606).abs() < 1e-3, "{neutral:?}");
    }

    #[test]
    fn a_linear_dng_gives_three_channels_close_to_libraws() {
        let Some((capture, json)) = facts("canon_eos_6d_linear_lossy.dng") else { return };
        let RawPixels::Linear(samples) = &capture.pixels else { panic!("three colours") };
        assert_eq!(samples.dim(), (3, 816, 1224));
        let mean = samples.iter().map(|&v| f64::from(v)).sum::<f64>() / (816.0 * 1224.0);
        // LibRaw applies the file's polynomial and scales to 16 bits.
        let expected = json["raw_image"]["sum"].as_f64().expect("sum") / (816.0 * 1224.0) / 65_535.0;
        // Lossy JPEG: decoders differ by rounding in the transform.
        assert!((mean / expected - 1.0).abs() < 2e-3, "{mean} {expected}");
    }

    /// An independent reader finds the colours, the neutral and the facts of the exposure.
    #[test]
    fn linear_pictures_come_back() {
        use isoplanat_imaging::dng::{CameraColour, DngInfo, write_linear_dng};
        use isoplanat_imaging::sensor::Sensor;
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("linear.dng");
        let image = Array3::from_shape_fn((3, 5, 8), |(k, r, c)| (k * 40 + r * 8 + c) as f32 / 130.0);
        let (sensor, mut exif) = (Sensor::generic(), Exif::default());
        exif.set(Directory::Picture, tags::MAKE, Value::Text("Some".into()));
        exif.set(Directory::Picture, tags::MODEL, Value::Text("Some 5".into()));
        exif.set(Directory::Exposure, tags::ISO, Value::Short(400));
        exif.set(Directory::Exposure, tags::F_NUMBER, Value::Ratios(vec![[56, 10]]));
        exif.set(Directory::Exposure, tags::LENS_MODEL, Value::Text("Old lens".into()));
        let colour = CameraColour { srgb_from_camera: sensor.srgb_from_camera, neutral: sensor.neutral_response };
        let info = DngInfo { model: "Some 5".into(), ..DngInfo::default() };
        write_linear_dng(&path, &image, &colour, &info, &exif).expect("writes");
        let back = decode(&path).expect("decodes");
        let RawPixels::Linear(samples) = &back.pixels else { panic!("three colours") };
        assert_eq!((back.black[..3].to_vec(), back.white[..3].to_vec()), (vec![0.0; 3], vec![65535.0; 3]));
        let worst = (samples / 65535.0 - &image).iter().fold(0.0f32, |m, v| m.max(v.abs()));
        assert!(worst <= 0.501 / 65535.0, "{worst}");
        let neutral = back.neutral.expect("as shot");
        for (a, b) in neutral.iter().zip(colour.neutral) {
            assert!((a - b / colour.neutral[1]).abs() < 1e-5, "{neutral:?}");
        }
        let facts = &back.exif;
        assert_eq!((facts.iso(), facts.f_number(), facts.lens()), (Some(400.0), Some(5.6), Some("Old lens")));
        // Colours come out as they went in.
        let again =
            isoplanat_imaging::develop::srgb_from_camera(&back.camera_from_xyz.expect("a matrix")).expect("regular");
        for (a, b) in again.iter().flatten().zip(sensor.srgb_from_camera.iter().flatten()) {
            assert!((a - b).abs() < 1e-3, "{again:?}");
        }
        assert!(write_linear_dng(&path, &Array3::zeros((3, 0, 4)), &colour, &info, &exif).is_err());
    }

    #[test]
    fn files_that_are_not_what_they_say_are_refused() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let write = |name: &str, bytes: &[u8]| {
            let path = dir.path().join(name);
            std::fs::write(&path, bytes).expect("writes");
            path
        };
        for path in [
            write("empty.nef", b""),
            write("text.dng", b"not a picture"),
            write("tiff.dng", b"II*\0\x08\0\0\0\0\0\0\0\0\0"),
            dir.path().to_owned(),
            dir.path().join("missing.nef"),
        ] {
            let error = decode(&path).expect_err("refused");
            assert_eq!(error.exit_code(), 2);
            assert!(!error.to_string().contains('\n'), "{error}");
        }
        if let Some(header) = shared("data/raw/sony_zv-e10_header_only_100000B.arw") {
            assert_eq!(decode(&header).expect_err("refused").exit_code(), 2);
        }
    }

    #[test]
    fn a_file_cut_short_is_an_error_not_a_panic() {
        for name in ["nikon_crop_gbrg_u16.dng", "nikon_crop_rggb_lj92.dng"] {
            let Some(path) = shared(&format!("data/raw/{name}")) else { return };
            let bytes = std::fs::read(path).expect("readable");
            let dir = tempfile::tempdir().expect("temporary folder");
            let cut = dir.path().join(name);
            for keep in [1, 8, 64, 300, 1000, bytes.len() / 2, bytes.len() - 100] {
                std::fs::write(&cut, &bytes[..keep.min(bytes.len())]).expect("writes");
                assert!(decode(&cut).is_err(), "{name}: {keep} bytes");
            }
        }
    }
}
