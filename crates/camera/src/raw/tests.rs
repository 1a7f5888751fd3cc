//! Files of cameras against LibRaw, and files that are none.

use super::*;
use isoplanat_base::testing::shared;
use isoplanat_imaging::exif::{Directory, Value, tags};
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

/// A DNG of a neutral beside a colour, whose matrix is no camera's in particular.
fn coloured() -> super::synthetic::Synthetic {
    let matrix = [0.6, 0.05, -0.05, -0.5, 1.3, 0.2, -0.1, 0.2, 0.55];
    super::synthetic::Synthetic::new(8, 8, 1, |_, _, _| 1000).ratios(50721, &matrix).put(
        50728,
        5,
        3,
        [55u32, 100, 1, 1, 7, 10].iter().flat_map(|v| v.to_le_bytes()).collect(),
    )
}

fn decoded(file: &super::synthetic::Synthetic) -> Result<RawCapture> {
    decode_bytes(file.file(), std::path::Path::new("a.dng"))
}

/// What 544, 744, 344 of 3839 above black become, in linear sRGB.
fn light(capture: &RawCapture) -> [f64; 3] {
    let matrix = capture.camera_from_xyz.expect("a matrix");
    let srgb = isoplanat_imaging::develop::srgb_from_camera(&matrix).expect("regular");
    let neutral = capture.neutral.expect("as shot");
    let seen = [544.0, 744.0, 344.0].map(|v| v / 3839.0);
    srgb.map(|row| (0..3).map(|k| row[k] * seen[k] / neutral[k]).sum())
}

/// DNG specification, "Mapping camera colour space to CIE XYZ": XYZ to camera is `AB · CC · CM`; expected, by a computation of its own in Python, is the inverse of that times
/// sRGB's primaries, its rows over their sums.
#[test]
fn gains_and_calibration_of_the_copy_are_in_its_matrix() {
    let close = |file: &super::synthetic::Synthetic, wanted: [f64; 3]| {
        let found = light(&decoded(file).expect("decodes"));
        assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 2e-4), "{found:?} {wanted:?}");
    };
    let (plain, copied) = ([0.3497, 0.2028, 0.0980], [0.3541, 0.2050, 0.0923]);
    let calibration = [1.1, 0.05, -0.02, 0.03, 0.95, 0.04, -0.02, 0.06, 1.05];
    close(&coloured(), plain);
    close(&coloured().ratios(50723, &calibration), copied);
    // What only scales the channels goes out again with the balance.
    close(&coloured().ratios(50727, &[2.0, 1.0, 1.0]), plain);
    close(&coloured().ratios(50723, &calibration).ratios(50727, &[2.0, 1.0, 0.5]), copied);
    // A calibration of the other matrix, or for another profile, is none of this one's.
    close(&coloured().ratios(50724, &calibration), plain);
    close(&coloured().ratios(50723, &calibration).text(50931, "a").text(50932, "b"), plain);
    close(&coloured().ratios(50723, &calibration).text(50931, "a").text(50932, "a"), copied);
    // A white that is stated by its chromaticity is seen by the copy.
    let stated = coloured().without(50728).ratios(50729, &[0.3127, 0.329]);
    let neutral = |file: &super::synthetic::Synthetic| decoded(file).expect("decodes").neutral.expect("stated");
    let (model, copy) = (neutral(&stated), neutral(&stated.clone().ratios(50727, &[2.0, 1.0, 1.0])));
    assert!((copy[0] / model[0] - 2.0).abs() < 1e-4 && (copy[2] / model[2] - 1.0).abs() < 1e-4, "{model:?} {copy:?}");
    for (wrong, words) in [
        (coloured().ratios(50727, &[0.0, 1.0, 1.0]), "AnalogBalance"),
        (coloured().ratios(50723, &[0.0; 9]), "CameraCalibration1"),
        (coloured().shorts(266, &[2]), "FillOrder 2"),
        (coloured().longs(50717, &[u32::MAX]), "levels in digital numbers, as the sensor gave them"),
        (coloured().longs(50717, &[65536]), "white level 65536"),
    ] {
        let error = decoded(&wrong).expect_err(words).to_string();
        assert!(error.contains("a.dng") && error.contains(words), "{error}");
    }
}

/// What is not done is told, and nothing where nothing is asked for.
#[test]
fn looks_that_are_left_out_are_told() {
    let notes = |file: &super::synthetic::Synthetic| decoded(file).expect("decodes").notes.join("; ");
    let nothing = coloured().ratios(50730, &[0.0]).bytes(50707, &[1, 7, 1, 0]);
    assert_eq!(notes(&nothing), "");
    for (file, words) in [
        (coloured().ratios(50730, &[1.0]), "--exposure 1 "),
        (coloured().ratios(50964, &[0.4, 0.3, 0.2, 0.2, 0.7, 0.1, 0.0, 0.1, 0.7]), "ForwardMatrix1"),
        (coloured().bytes(50707, &[9, 9, 9, 9]), "9.9.9.9"),
    ] {
        assert!(notes(&file).contains(words), "{words}: {}", notes(&file));
    }
}
