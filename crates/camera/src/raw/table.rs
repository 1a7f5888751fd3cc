//! Synthetic DNGs: levels and crops against LibRaw, black by rows and columns and gain maps against closed forms, filters by name.

use std::path::Path;

use super::synthetic::{Synthetic, gain_map, opcodes, polynomial};
use super::*;

/// Largest difference that is let pass, of white.
const CLOSE: f64 = 1e-4;

fn decoded(file: &Synthetic) -> Result<RawCapture> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.dng");
    file.write(&path);
    decode(&path)
}

/// Value of a sample between black and white.
fn level(capture: &RawCapture, r: usize, c: usize, plane: usize) -> f64 {
    let (v, i) = match &capture.pixels {
        RawPixels::Mosaic { samples, .. } | RawPixels::Grey(samples) => (samples[[r, c]], (r & 1) * 2 + (c & 1)),
        RawPixels::Linear(samples) => (samples[[plane, r, c]], plane),
    };
    f64::from(v - capture.black[i]) / f64::from(capture.white[i] - capture.black[i])
}

/// `tests/peers/raw_libraw.py`: what LibRaw makes of tables of black and of crops.
#[test]
fn black_tables_and_crops_are_libraws() {
    let json: serde_json::Value =
        serde_json::from_str(include_str!("../../../../tests/peers/raw_libraw.json")).expect("JSON");
    let number = |v: &serde_json::Value| v.as_f64().expect("a number");
    let list = |v: &serde_json::Value| -> Vec<u32> {
        v.as_array().map_or_else(Vec::new, |a| a.iter().map(|v| v.as_u64().expect("a whole number") as u32).collect())
    };
    let (rows, columns) = (number(&json["rows"]) as usize, number(&json["columns"]) as usize);
    let cases = json["cases"].as_array().expect("a list");
    assert!(cases.len() >= 10);
    for case in cases {
        let name = &case["name"];
        let sample = |r: usize, c: usize, _| 4000 + ((7919 * r + 10473 * c + 13 * r * c) % 40000) as u16;
        let mut file = Synthetic::new(rows, columns, 1, sample).longs(50717, &[number(&json["white"]) as u32]);
        let repeat: Vec<u16> = list(&case["repeat"]).iter().map(|v| *v as u16).collect();
        file = file.shorts(50713, &repeat).longs(50714, &list(&case["black"]));
        if let [_, ..] = list(&case["area"])[..] {
            file = file.longs(50829, &list(&case["area"]));
        }
        if let [left, top, width, height] = list(&case["crop"])[..] {
            file = file.longs(50719, &[left, top]).longs(50720, &[width, height]);
        }
        let capture = decoded(&file).expect("decodes");
        let Area { row, column, rows, columns } = capture.crop;
        assert_eq!(vec![rows as u32, columns as u32], list(&case["size"]), "{name}");
        for pixel in case["pixels"].as_array().expect("a list") {
            let (r, c) = (row + number(&pixel[0]) as usize, column + number(&pixel[1]) as usize);
            let (found, expected) = (level(&capture, r, c, 0), number(&pixel[2]));
            assert!((found - expected).abs() < CLOSE, "{name}: {r} {c}: {found} {expected}");
        }
    }
}

/// Light of a scene, 0.05 to 0.45 of white.
fn light(r: usize, c: usize, plane: usize) -> f64 {
    0.05 + 0.4 * ((r * 31 + c * 17 + r * c * 5 + plane * 7) % 97) as f64 / 97.0
}

/// Rows, columns and white of the following.
const ROWS: usize = 40;
const COLUMNS: usize = 56;
const WHITE: f64 = 60000.0;

/// A file whose samples are `light` over white less the largest black, divided by the gain there, above a black.
fn file(
    planes: usize,
    black: impl Fn(usize, usize, usize) -> f64,
    gain: impl Fn(usize, usize, usize) -> f64,
) -> Synthetic {
    let places = || (0..ROWS).flat_map(|r| (0..COLUMNS).map(move |c| (r, c)));
    let top = |k: usize| places().map(|(r, c)| black(r, c, k)).fold(0.0, f64::max);
    let tops = [top(0), top(planes.min(2) - 1), top(planes - 1)];
    let sample = |r: usize, c: usize, k: usize| {
        (black(r, c, k) + light(r, c, k) / gain(r, c, k) * (WHITE - tops[k])).round() as u16
    };
    Synthetic::new(ROWS, COLUMNS, planes, sample).longs(50717, &vec![WHITE as u32; planes])
}

fn is_the_scene(name: &str, file: &Synthetic, planes: usize) -> RawCapture {
    let capture = decoded(file).expect(name);
    let (rows, columns) = capture.size();
    for r in 0..rows {
        for c in 0..columns {
            for k in 0..planes {
                let (found, expected) = (level(&capture, r, c, k), light(r, c, k));
                assert!((found - expected).abs() < CLOSE, "{name}: {r} {c} {k}: {found} {expected}");
            }
        }
    }
    capture
}

#[test]
fn black_by_rows_and_columns_is_taken_off() {
    let down = |r: usize| (r * 11) as f64 - 100.0;
    let across = |c: usize| ((c * 37) % 500) as f64;
    let table = |r: usize, c: usize| (200 + 300 * (r % 4) + 70 * (c % 4)) as f64;
    let one = |_, _, _| 1.0;
    let rows: Vec<f64> = (0..ROWS).map(down).collect();
    let columns: Vec<f64> = (0..COLUMNS).map(across).collect();
    let cells: Vec<u32> = (0..16).map(|i| table(i / 4, i % 4) as u32).collect();
    let by_rows = file(1, |r, _, _| 256.0 + down(r), one).longs(50714, &[256]).ratios(50716, &rows);
    let capture = is_the_scene("rows", &by_rows, 1);
    assert!(!capture.corrected, "digital numbers stay");
    let by_columns = file(1, |_, c, _| 256.0 + across(c), one).longs(50714, &[256]).ratios(50715, &columns);
    is_the_scene("columns", &by_columns, 1);
    let both = file(1, |r, c, _| table(r, c) + down(r) + across(c), one)
        .shorts(50713, &[4, 4])
        .longs(50714, &cells)
        .ratios(50716, &rows)
        .ratios(50715, &columns);
    is_the_scene("table, rows and columns", &both, 1);
    // Three colours, each with its own table; and a sensor without colours.
    let plane = |r: usize, c: usize, k: usize| table(r, c) + 150.0 * k as f64 + down(r);
    let cells: Vec<u32> = (0..48).map(|i| (table(i / 12, i / 3 % 4) + 150.0 * (i % 3) as f64) as u32).collect();
    let colours = file(3, plane, one).shorts(50713, &[4, 4]).longs(50714, &cells).ratios(50716, &rows);
    is_the_scene("three colours", &colours, 3);
    let grey = file(1, |r, _, _| 500.0 + down(r), one).longs(50714, &[500]).ratios(50716, &rows);
    let grey = grey.shorts(262, &[34892]).without(33421).without(33422).without(50710).without(50711);
    assert!(matches!(is_the_scene("grey", &grey, 1).pixels, RawPixels::Grey(_)));
    for (wrong, words) in [
        (by_rows.clone().ratios(50716, &rows[1..]), "BlackLevelDeltaV of 39 numbers"),
        (by_rows.clone().text(50716, "no numbers"), "BlackLevelDeltaV that is no list"),
        (by_rows.longs(50714, &[58000]).ratios(50716, &[2000.0; ROWS]), "black below white"),
    ] {
        let error = decoded(&wrong).expect_err(words);
        assert!(error.to_string().contains(words) && error.exit_code() == 2, "{error}");
    }
}

/// Samples without a scale (found by fuzzing): levels whose difference is lost in rounding, or is no number.
#[test]
fn levels_beyond_all_samples_are_refused() {
    let base = || file(1, |_, _, _| 0.0, |_, _, _| 1.0);
    // FLOAT.
    let floats = |all: &[f32]| all.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let stated = |tag: u16, all: &[f32]| base().put(tag, 11, all.len(), floats(all));
    let mut steps = [0.0; ROWS];
    steps[0] = -8.5e37;
    for (wrong, words) in [
        (stated(50716, &[-8.5e37; ROWS]), "a level of -8.5e37"),
        (stated(50716, &steps), "a level of -8.5e37"),
        (stated(50716, &[-4e9; ROWS]).longs(50717, &[1]), "black"),
        (base().longs(50714, &[4_294_967_040]).longs(50717, &[4_294_967_041]), "white level"),
    ] {
        match decoded(&wrong) {
            Ok(capture) => assert!(capture.black.iter().zip(&capture.white).all(|(b, w)| b < w), "{words}"),
            Err(error) => assert!(error.to_string().contains(words) && error.exit_code() == 2, "{error}"),
        }
    }
    assert!(decoded(&stated(50716, &[-8.5e37; ROWS])).is_err());
}

#[test]
fn gain_maps_are_applied() {
    let all = [0, 0, ROWS as u32, COLUMNS as u32, 0, 1, 1, 1];
    let none = |_, _, _| 0.0;
    let (y, x) = (|r: usize| (r as f64 + 0.5) / ROWS as f64, |c: usize| (c as f64 + 0.5) / COLUMNS as f64);
    let unit = [[1.0, 1.0], [0.0, 0.0]];
    let second = |list: &[(u32, Vec<u8>)], file: Synthetic| file.undefined(51009, opcodes(list));
    let constant = second(&[gain_map(all, [1, 1], unit, 1, &[1.5])], file(1, none, |_, _, _| 1.5));
    assert!(is_the_scene("one point", &constant, 1).corrected);
    let plane = |r, c, _| 1.0 + y(r) + 0.5 * x(c);
    let ramp = second(&[gain_map(all, [2, 2], unit, 1, &[1.0, 1.5, 2.0, 2.5])], file(1, none, plane));
    is_the_scene("a plane", &ramp, 1);
    // Points from 0.25 to 0.75: the outermost gains beyond.
    let clamped = |r: usize, _, _| 1.0 + ((y(r) - 0.25) / 0.25).clamp(0.0, 2.0);
    let inner = gain_map(all, [3, 1], [[0.25, 1.0], [0.25, 0.0]], 1, &[1.0, 2.0, 3.0]);
    is_the_scene("beyond the points", &second(&[inner], file(1, none, clamped)), 1);
    // A map a place of the mosaic, over an active area, with black by rows.
    let gains = [1.2, 1.4, 1.6, 1.8];
    let maps: Vec<_> = (0..4u32)
        .map(|i| {
            let area = [i / 2, i % 2, ROWS as u32, COLUMNS as u32, 0, 1, 2, 2];
            gain_map(area, [1, 2], [[1.0, 1.0], [0.0, 0.0]], 1, &[gains[i as usize], gains[i as usize] + 1.0])
        })
        .collect();
    let place = |r: usize, c: usize, _| f64::from(gains[(r % 2) * 2 + c % 2]) + x(c);
    let rows: Vec<f64> = (0..ROWS).map(|r| 20.0 * r as f64).collect();
    let shaded = file(1, |r, _, _| 100.0 + 20.0 * r as f64, place).longs(50714, &[100]).ratios(50716, &rows);
    is_the_scene("a map a place", &second(&maps, shaded), 1);
    // Three colours by one map of three planes; then only the last two planes, by the last plane of a map of two.
    let colours = |_, c: usize, k: usize| 1.0 + k as f64 * (0.5 + x(c));
    let three: Vec<f32> = [1.0, 1.5, 2.0, 1.0, 2.5, 4.0].to_vec();
    let whole = [0, 0, ROWS as u32, COLUMNS as u32, 0, 3, 1, 1];
    is_the_scene("three planes", &second(&[gain_map(whole, [1, 2], unit, 3, &three)], file(3, none, colours)), 3);
    let part = [0, 0, ROWS as u32, COLUMNS as u32, 1, 2, 1, 1];
    let last = |_, _, k: usize| if k == 0 { 1.0 } else { 2.0 };
    is_the_scene("two planes", &second(&[gain_map(part, [1, 1], unit, 2, &[9.0, 2.0])], file(3, none, last)), 3);
    // In the list's order: y = (2 x)², written as gain and polynomial; the other way round it would be 2 x².
    let square = |r, c, k| light(r, c, k) / (light(r, c, k).sqrt() / 2.0);
    let list = [gain_map(all, [1, 1], unit, 1, &[2.0]), polynomial(all, &[0.0, 0.0, 1.0])];
    is_the_scene("in order", &second(&list, file(1, none, square)), 1);
    // White stays white under a gain, and what is left out is told, list by list.
    let bright = Synthetic::new(ROWS, COLUMNS, 1, |_, _, _| 65535);
    let bright = second(&[gain_map(all, [1, 1], unit, 1, &[3.0]), (5, vec![0; 8])], bright);
    let bright = bright
        .undefined(51008, opcodes(&[(4, vec![0; 8])]))
        .undefined(51022, opcodes(&[(1, vec![0; 8]), (77, Vec::new())]));
    let capture = decoded(&bright).expect("decodes");
    assert!((level(&capture, 3, 3, 0) - 1.0).abs() < 1e-6);
    let told = [
        "OpcodeList1: FixBadPixelsConstant",
        "OpcodeList2: FixBadPixelsList",
        "OpcodeList3: WarpRectilinear, opcode 77",
    ];
    assert_eq!(capture.notes.len(), 3);
    for (note, words) in capture.notes.iter().zip(told) {
        assert!(note.contains(words), "{note}");
    }
    for bad in
        [vec![0, 0], opcodes(&[(9, vec![0; 20])]), opcodes(&[gain_map(all, [2, 1], [[0.0; 2]; 2], 1, &[1.0, 1.0])])]
    {
        let error = decoded(&file(1, none, |_, _, _| 1.0).undefined(51009, bad)).expect_err("damaged");
        assert!(error.to_string().contains("OpcodeList2"), "{error}");
    }
    let text = decoded(&file(1, none, |_, _, _| 1.0).longs(51022, &[1, 2])).expect_err("no bytes");
    assert!(text.to_string().contains("OpcodeList3"), "{text}");
}

/// The crop is cut out of the finished picture: what it shows is what the whole shows there, and what a calibration of either size straightens.
#[test]
fn crops_are_cut_out_last() {
    use crate::reconstruct::Camera;
    use isoplanat_imaging::calibrate::file::MeasuredDistortion;
    let whole = file(1, |_, _, _| 0.0, |_, _, _| 1.0);
    // An odd place: the mosaic's layout does not start with it.
    let cropped = whole.clone().longs(50719, &[5, 3]).longs(50720, &[40, 30]);
    let measured = |columns: usize, rows: usize, [x, y]: [f64; 2]| {
        let text = format!(
            "schema = 1\ncamera = \"\"\nlens = \"\"\nsource = \"test\"\ncolumns = {columns}\nrows = {rows}\n\
             focal_length_px = 50.0\ncentre_px = [{x:?}, {y:?}]\nk = [-0.2, 0.01, 0.0]\nmax_slope = 0.7\nrms_px = 0.1\n"
        );
        MeasuredDistortion::parse(&text, "d.toml").expect("valid")
    };
    let picture = |file: &Synthetic, camera: Camera| {
        camera.reconstruct(decoded(file).expect("decodes"), Path::new("a.dng"), &|_, _| ()).expect("develops").image
    };
    let part = |image: &Array3<f32>| image.slice(ndarray::s![.., 3..33, 5..45]).to_owned();
    let straight =
        |columns, rows, centre| Camera::plain().straightening(&measured(columns, rows, centre)).expect("a frame");
    assert_eq!(picture(&cropped, Camera::plain()), part(&picture(&whole, Camera::plain())));
    let expected = part(&picture(&whole, straight(COLUMNS, ROWS, [30.0, 19.0])));
    assert_ne!(expected, part(&picture(&whole, Camera::plain())));
    // Measured over the active area, and in pictures that show the part.
    assert_eq!(picture(&cropped, straight(COLUMNS, ROWS, [30.0, 19.0])), expected);
    assert_eq!(picture(&cropped, straight(40, 30, [25.0, 16.0])), expected);
    // Fractions are rounded; a part beyond the picture is refused.
    let fractions = whole.clone().ratios(50719, &[4.6, 3.2]).ratios(50720, &[40.0, 30.0]);
    assert_eq!(decoded(&fractions).expect("decodes").crop, Area { row: 3, column: 5, rows: 30, columns: 40 });
    for (wrong, words) in [
        (whole.clone().longs(50719, &[20, 0]).longs(50720, &[40, 30]), "40 × 30 pixels from column 20"),
        (whole.clone().longs(50719, &[0, 0]).longs(50720, &[0, 30]), "0 × 30"),
        (whole.clone().longs(50719, &[1]), "DefaultCropOrigin"),
    ] {
        let error = decoded(&wrong).expect_err(words);
        assert!(error.to_string().contains(words) && error.exit_code() == 2, "{error}");
    }
    let notes = decoded(&whole.ratios(50718, &[1.0, 2.0]).ratios(51125, &[0.1, 0.0, 1.0, 1.0])).expect("decodes").notes;
    assert!(notes[0].contains("not square") && notes[1].contains("DefaultUserCrop"), "{notes:?}");
}

#[test]
fn filters_that_are_not_developed_are_refused_by_name() {
    let grey = |_, _, _| 1000;
    let xtrans = "GGRGGBGGBGGRBRGRBGGGBGGRGGRGGBRBGBRG";
    let colour = |letter: u8| match letter {
        b'R' => 0,
        b'G' => 1,
        _ => 2,
    };
    let xtrans: Vec<u8> = xtrans.bytes().map(colour).collect();
    let quad: Vec<u8> = (0..16).map(|i| [0, 1, 1, 2][(i / 8) * 2 + i % 4 / 2]).collect();
    let base = Synthetic::new(24, 24, 1, grey);
    for (file, words) in [
        (base.clone().shorts(33421, &[6, 6]).bytes(33422, &xtrans), "X-Trans"),
        (base.clone().shorts(33421, &[4, 4]).bytes(33422, &quad), "Quad Bayer"),
        (base.clone().shorts(33421, &[2, 2]).bytes(33422, &[0, 1, 6, 2]), "`RGWB`"),
        (base.clone().shorts(33421, &[8, 2]).bytes(33422, &[0; 3]), "with 3 colours"),
        (base.clone().shorts(33421, &[2]), "size of the colour filter"),
        (base.clone().bytes(33422, &[1; 4]), "of one colour"),
        (base.clone().shorts(50711, &[2]), "staggered"),
        (base.clone().bytes(50710, &[0, 1, 3]), "CFAPlaneColor"),
    ] {
        let error = decoded(&file).expect_err(words);
        assert!(error.to_string().contains(words) && error.exit_code() == 2, "{words}: {error}");
    }
    assert!(decoded(&base).is_ok());
}
