//! `calibrate-sensor` on RAW files of a sensor whose numbers are known, and what the camera program makes of its files.

use std::path::Path;
use std::process::Command;

use isoplanat::calibrate::shading::MeasuredShading;
use isoplanat::imaging::dng::{DngInfo, write_dng};
use isoplanat::imaging::files::{Encoding, read_picture};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::cfa::Cfa;
use isoplanat::imaging::sensor::noise::{Noise, standard_normal};
use isoplanat::psf::SensorPoint;
use ndarray::{Array2, s};

use crate::support::Workplace;

const SIZE: (usize, usize) = (240, 320);

fn sensor() -> Sensor {
    Sensor {
        name: "Test 7".into(),
        cfa: Cfa::GRBG,
        bits: 14,
        black_level: 512.0,
        white_level: 15000.0,
        full_well_electrons: 40_000.0,
        read_noise_electrons: 12.0,
        ..Sensor::generic()
    }
}

/// A frame of an even light of `level` of saturation behind a lens whose light falls to about three fifths in the corner.
fn frame(path: &Path, level: f64, seed: u64) {
    let sensor = sensor();
    let light = Array2::from_shape_fn(SIZE, |(r, c)| {
        let far = (r as f64 + 0.5 - 120.0).hypot(c as f64 + 0.5 - 160.0) / 200.0;
        level * sensor.neutral_response[sensor.cfa.channel(r, c)] * (1.0 - 0.4 * far * far)
    });
    let noisy = Noise::from_sensor(&sensor).apply(light.view(), standard_normal(seed, SIZE).view());
    let dn = noisy.mapv(|y| {
        (sensor.black_level + y * (sensor.white_level - sensor.black_level)).round().clamp(0.0, 15000.0) as u16
    });
    let info = DngInfo { lens: "Old 50".into(), ..DngInfo::default() };
    write_dng(path, dn.view(), &sensor, &info).expect("writes");
}

#[test]
fn a_known_sensor_and_lens_are_measured_and_used() {
    let place = Workplace::new();
    for k in 0..3 {
        frame(&place.path(&format!("d{k}.dng")), 0.0, k);
    }
    for (k, level) in [0.2, 0.2, 0.8, 0.8].into_iter().enumerate() {
        frame(&place.path(&format!("f{k}.dng")), level, 10 + k as u64);
    }
    let command = "calibrate-sensor --darks d0.dng d1.dng d2.dng --flats f0.dng f1.dng f2.dng f3.dng -o sensor.toml --shading shading.toml \
                   --svg curve.svg --csv curve.csv --json";
    let ran = place.run(command);
    assert_eq!(ran.code, 0, "{}", ran.err);
    assert!(!ran.err.contains("warning"), "{}", ran.err);
    let json: serde_json::Value = serde_json::from_str(&ran.out).expect("JSON");
    let (truth, found) = (sensor(), Sensor::load(&place.path("sensor.toml")).expect("a sensor"));
    assert_eq!((found.cfa, found.bits, found.white_level), (truth.cfa, truth.bits, truth.white_level));
    assert!((found.black_level - 512.0).abs() < 0.1, "{}", found.black_level);
    let gain = truth.full_well_electrons / (truth.white_level - truth.black_level);
    let error = json["electrons_per_dn_error"].as_f64().expect("a number");
    assert!(error < 0.01 * gain, "{error} of {gain}");
    assert!((json["electrons_per_dn"].as_f64().expect("a number") - gain).abs() < 4.0 * error, "{json}");
    assert!((found.full_well_electrons / 40_000.0 - 1.0).abs() < 0.02, "{}", found.full_well_electrons);
    // Rounding to whole numbers is noise, too.
    let noise = 12f64.hypot(gain / 12f64.sqrt());
    assert!((found.read_noise_electrons / noise - 1.0).abs() < 0.02, "{} {noise}", found.read_noise_electrons);
    for (a, b) in found.neutral_response.iter().zip(truth.neutral_response) {
        assert!((a - b).abs() < 1e-5, "{:?}", found.neutral_response);
    }
    assert!(found.source.contains("NOT measured"), "{}", found.source);
    let shading = MeasuredShading::load(&place.path("shading.toml")).expect("a shading");
    assert_eq!((shading.lens.as_str(), shading.columns, shading.rows), ("Old 50", 320, 240));
    let illumination = shading.shading().expect("valid");
    for radius in [10.0, 50.0, 110.0, 160.0, 195.0f64] {
        let expected = 1.0 - 0.4 * (radius / 200.0).powi(2);
        for k in 0..3 {
            let found = illumination.at(k, SensorPoint::along([1.0, 0.0], radius));
            assert!((found - expected).abs() < 8e-3, "{k} at {radius}: {found}");
        }
    }
    assert!(std::fs::read_to_string(place.path("curve.svg")).expect("reads").contains("Photon transfer"));

    // The flat is even behind it, to the noise of its means.
    let develop = |more: &str| {
        let ran = Command::new(env!("CARGO_BIN_EXE_isoplanat-camera"))
            .args(format!("f2.dng -o flat.tif --linear --force {more}").split_whitespace())
            .current_dir(place.path(""))
            .output()
            .expect("starts");
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
        let picture = read_picture(&place.path("flat.tif"), Encoding::Linear).expect("reads");
        let mean = |rows, columns| picture.slice(s![1, rows..rows + 20, columns..columns + 20]).mean().expect("pixels");
        mean(4, 4) / mean(110, 150)
    };
    // 180 pixels from the centre.
    assert!((develop("") - 0.676).abs() < 0.01, "{}", develop(""));
    assert!((develop("--shading shading.toml") - 1.0).abs() < 5e-3, "{}", develop("--shading shading.toml"));
}

/// Frames that do not belong together, and outputs that exist, are refused; nothing is written.
#[test]
fn frames_that_do_not_belong_together_are_refused() {
    let place = Workplace::new();
    for k in 0..2 {
        frame(&place.path(&format!("d{k}.dng")), 0.0, k);
        frame(&place.path(&format!("f{k}.dng")), 0.5, 9 + k);
        frame(&place.path(&format!("cut{k}.dng")), 3.0, 9 + k);
    }
    let small = Sensor { bits: 14, ..sensor() };
    write_dng(&place.path("small.dng"), Array2::from_elem((100, 100), 3000u16).view(), &small, &DngInfo::default())
        .expect("writes");
    std::fs::copy(place.path("d0.dng"), place.path("copy.dng")).expect("copied");
    let before = place.files();
    for (frames, words) in [
        ("--darks d0.dng d0.dng --flats f0.dng f1.dng", "d0.dng: contents: given twice"),
        (
            "--darks d0.dng d1.dng copy.dng --flats f0.dng f1.dng",
            "copy.dng: contents: the same as d0.dng, byte for byte",
        ),
        ("--darks d0.dng d1.dng --flats f0.dng f0.dng", "f0.dng: contents: given twice"),
        ("--darks d0.dng d1.dng --flats f0.dng d1.dng", "d1.dng: contents: given twice"),
        ("--darks d0.dng --flats f0.dng f1.dng", "two frames and more"),
        ("--darks d0.dng d1.dng --flats f0.dng", "no two of one exposure"),
        ("--darks d0.dng d1.dng --flats cut0.dng cut1.dng", "below saturation"),
        ("--darks d0.dng d1.dng --flats f0.dng small.dng", "small.dng: size"),
        ("--darks d0.dng d1.dng --flats f0.dng missing.dng", "missing.dng"),
        ("--darks d0.dng d1.dng --flats f0.dng f1.dng --centre 900,3", "--centre"),
    ] {
        let ran = place.run(&format!("calibrate-sensor {frames} -o sensor.toml --shading shading.toml"));
        assert!(ran.code == 2 && ran.err.contains(words), "{frames}: {}", ran.err);
    }
    assert_eq!(place.files(), before);
}
