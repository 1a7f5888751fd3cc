//! `isoplanat slanted-edge` on edges whose MTF is known in closed form, on published edges, and on what is no edge.

use isoplanat::imaging::files::{Encoding, write_picture};
use isoplanat::testing::shared;
use ndarray::Array3;
use serde_json::Value;

use crate::support::Workplace;

/// The program's JSON for a picture of the shared data.
fn measured(path: &std::path::Path, options: &str) -> Value {
    let text = Workplace::new().run(&format!("slanted-edge {} --json {options}", path.display())).done();
    serde_json::from_str(&text).expect("JSON")
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or(f64::NAN)
}

/// Panics unless MTF50 is within 1 %, the curve within 0.02 up to Nyquist, and the interval of MTF50 holds the truth.
#[track_caller]
fn holds(found: &Value, truth: &Value, name: &str) {
    let (f50, expected) = (number(found, "mtf50_cy_per_px"), number(truth, "mtf50_cy_per_px"));
    assert!((f50 / expected - 1.0).abs() < 0.01, "{name}: MTF50 {f50} against {expected}");
    let ends = &found["mtf50_interval_cy_per_px"];
    let [low, high] = [0, 1].map(|i| ends[i].as_f64().expect("an end"));
    assert!(low <= expected && expected <= high, "{name}: {expected} in {low} to {high}");
    let curve = found["mtf"].as_array().expect("points");
    for (frequency, value) in truth["mtf"].as_object().expect("a curve") {
        let frequency: f64 = frequency.parse().expect("a number");
        if frequency > 0.5 {
            continue;
        }
        let near = |p: &&Value| (number(p, "frequency_cy_per_px") - frequency).abs() < 1e-6;
        let point = number(curve.iter().find(near).expect("a point"), "value");
        let value = value.as_f64().expect("a number");
        assert!((point - value).abs() < 0.02, "{name} at {frequency}: {point} against {value}");
    }
}

#[test]
fn synthetic_edges_have_their_mtf() {
    let Some(file) = shared("data/mtf/synthetic/truth.json") else { return };
    let truth: Value = serde_json::from_str(&std::fs::read_to_string(&file).expect("reads")).expect("JSON");
    let mut edges = 0;
    for (name, truth) in truth.as_object().expect("cases").iter().filter(|(name, _)| *name != "_about") {
        let picture = file.with_file_name(truth["file"].as_str().expect("a file"));
        let found = measured(&picture, if name.contains("bayer") { "--cfa RGGB" } else { "" });
        let angle = (number(&found, "edge_angle_deg") - number(truth, "edge_angle_from_vertical_deg")).abs();
        assert!(angle < 0.02, "{name}: {angle}° off");
        match truth["channels"].as_object() {
            None => holds(&found, truth, name),
            Some(channels) => {
                for (channel, truth) in channels {
                    holds(&found["channels"][channel], truth, &format!("{name} {channel}"));
                    edges += 1;
                }
            }
        }
        edges += usize::from(truth["channels"].is_null());
        // Channels are shifted along x by (0.8, 0, -0.6) pixels.
        if name.contains("lateral") {
            let shift = |colour: &str| found["lateral_colour_x_px"][colour].as_f64().expect("a shift");
            assert!(
                (shift("R") - 0.8).abs() < 2e-3 && (shift("B") + 0.6).abs() < 2e-3,
                "{}",
                found["lateral_colour_x_px"]
            );
        }
    }
    assert!(edges >= 11, "{edges}");
}

#[test]
fn published_edges_agree_with_another_program() {
    let Some(file) = shared("data/mtf/published/approx_reference.json") else { return };
    let reference: Value = serde_json::from_str(&std::fs::read_to_string(&file).expect("reads")).expect("JSON");
    for (name, expected) in reference.as_object().expect("cases") {
        let found = measured(&file.with_file_name(name), "--encoding linear");
        let (f50, expected) = (number(&found, "mtf50_cy_per_px"), number(expected, "mtf50_cy_per_px_ours"));
        assert!((f50 / expected - 1.0).abs() < 0.03, "{name}: {f50} against {expected}");
    }
    // A Gaussian edge that carries its angle and its width along the rows in its name.
    let name = "MTF_Estimator_myedge_angle_16.776550_fwhm_2.101313.tif";
    let found = measured(&file.with_file_name(name), "");
    let angle: f64 = 16.776_550;
    assert!((number(&found, "edge_angle_deg").abs() - angle).abs() < 1e-3, "{}", found["edge_angle_deg"]);
    let sigma = 2.101_313 * angle.to_radians().cos() / (8.0 * 2f64.ln()).sqrt();
    let f50 = (0.5 * 2f64.ln()).sqrt() / (std::f64::consts::PI * sigma);
    assert!((number(&found, "mtf50_cy_per_px") / f50 - 1.0).abs() < 1e-3, "{} against {f50}", found["mtf50_cy_per_px"]);
}

/// A soft edge at this slope (columns a row), of three colours that lie apart.
fn picture(slope: f32) -> Array3<f32> {
    Array3::from_shape_fn((3, 60, 80), |(k, r, c)| {
        let d = c as f32 - 39.5 - 0.5 * k as f32 + slope * (r as f32 - 29.5);
        0.2 + 0.5 / (1.0 + (-2.0 * d).exp())
    })
}

#[test]
fn the_command_writes_what_it_is_asked_for_and_overwrites_nothing() {
    let place = Workplace::new();
    write_picture(&place.path("edge.png"), &picture(0.1), Encoding::Linear).expect("writes");
    let text = place.run("slanted-edge edge.png --svg edge.svg --csv edge.csv").done();
    for words in ["16 bits, taken as linear, as the file says", "luminance", "R lies", "MTF50", "0.50"] {
        assert!(text.contains(words), "`{words}` in {text}");
    }
    let csv = std::fs::read_to_string(place.path("edge.csv")).expect("written");
    assert!(csv.starts_with("frequency_cy_per_px,mtf_R,uncertainty_R") && csv.lines().count() == 102, "{csv}");
    let svg = std::fs::read_to_string(place.path("edge.svg")).expect("written");
    assert!(svg.contains("Edge spread function") && !svg.contains("NaN"), "{svg}");
    assert_eq!(svg.matches("<svg").count(), svg.matches("</svg>").count());
    place.run("slanted-edge edge.png --svg edge.svg").refused(&["edge.svg", "--force"]);
    place.run("slanted-edge edge.png --csv edge.csv").refused(&["edge.csv", "--force"]);
    place.run("slanted-edge edge.png --csv edge.csv --svg edge.svg --force").done();
    let whole: Value = serde_json::from_str(&place.run("slanted-edge edge.png --json").done()).expect("JSON");
    let part = place.run("slanted-edge edge.png --json --channel R --region 10,5,60,50").done();
    let part: Value = serde_json::from_str(&part).expect("JSON");
    assert_eq!((part["channel"].as_str(), whole["channel"].as_str()), (Some("R"), Some("G")));
    assert_eq!(part["region_px"]["width"], 60);
    assert!((number(&part, "mtf50_cy_per_px") / number(&whole, "mtf50_cy_per_px") - 1.0).abs() < 0.01);
    for channel in ["R", "G", "B", "luminance"] {
        assert!(number(&whole["channels"][channel], "mtf10_cy_per_px") > 0.0, "{channel}");
    }
    assert!((whole["lateral_colour_x_px"]["R"].as_f64().expect("a shift") + 0.5).abs() < 0.01);
}

#[test]
fn what_cannot_be_measured_is_one_line() {
    let place = Workplace::new();
    write_picture(&place.path("edge.png"), &picture(0.1), Encoding::Linear).expect("writes");
    write_picture(&place.path("upright.png"), &picture(0.0), Encoding::Linear).expect("writes");
    write_picture(&place.path("flat.png"), &Array3::from_elem((3, 60, 80), 0.4), Encoding::Linear).expect("writes");
    place.write("text.png", "no picture");
    place.run("slanted-edge upright.png").refused(&["upright.png", "0.00°", "0° or 90°"]);
    place.run("slanted-edge flat.png").refused(&["flat.png", "all pixels are equal"]);
    place.run("slanted-edge text.png").refused(&["text.png", "PNG, JPEG or TIFF"]);
    place.run("slanted-edge none.png").refused(&["none.png"]);
    place.run("slanted-edge edge.png --region 0,0,50").refused(&["--region", "x,y,w,h"]);
    place.run("slanted-edge edge.png --region -1,0,50,50").refused(&["--region", "x,y,w,h"]);
    place.run("slanted-edge edge.png --region 40,0,50,50").refused(&["edge.png", "region", "80 x 60"]);
    place.run("slanted-edge edge.png --region 0,0,20,60").refused(&["edge.png", "region x 0, y 0, 20 x 60"]);
    place.run("slanted-edge edge.png --cfa RGBW").refused(&["--cfa", "RGGB, GRBG, GBRG or BGGR"]);
    place.run("slanted-edge edge.png --cfa RGGB").refused(&["edge.png", "one channel"]);
    place.run("slanted-edge edge.png --channel grey").refused(&["--channel", "R, G, B, luminance"]);
    if cfg!(not(feature = "deploy")) {
        place.write("a.dng", "x").run("slanted-edge a.dng").refused(&["a.dng", "`deploy`"]);
    }
}

/// A RAW file of a slanted edge: each colour at its own pixels, and the MTF that the report's loop has of this lens (0.31 cycles a pixel in
/// green on the axis, of which the scene's three texels a pixel take 3 %).
#[cfg(feature = "deploy")]
#[test]
fn a_raw_file_is_measured_by_colour() {
    let place = Workplace::new();
    let (sin, cos) = 5f64.to_radians().sin_cos();
    let edge = Array3::from_shape_fn((3, 400, 400), |(_, r, c)| {
        let d = (c as f64 - 199.5) * cos + (r as f64 - 199.5) * sin;
        0.1 + 0.4 * (d + 0.5).clamp(0.0, 1.0) as f32
    });
    write_picture(&place.path("edge.png"), &edge, Encoding::Srgb).expect("written");
    let frame = "--columns 120 --rows 120 --pitch-um 6 --texels-per-pixel 3";
    place.run(&format!("capture cooke_triplet edge.png -o edge.dng --samples 256 {frame}")).done();
    let text = place.run("slanted-edge edge.dng --json").done();
    let found: Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(found["channel"], "G");
    let f50 = number(&found, "mtf50_cy_per_px");
    assert!((0.29..0.32).contains(&f50), "{f50}");
    for channel in ["R", "G", "B"] {
        let own = &found["channels"][channel];
        assert!(
            number(own, "samples") > 1000.0 && (number(own, "edge_angle_deg") - 5.0).abs() < 0.1,
            "{channel}: {own}"
        );
    }
    place.run("slanted-edge edge.dng --cfa RGGB").refused(&["--cfa", "RAW"]);
}

/// Grey floating point is what the same numbers are in three channels, and as an array.
#[test]
fn grey_floating_point_is_measured_as_three_channels_are() {
    use isoplanat::imaging::files::{Annotation, Depth, read_picture, write_annotated};
    let Some(grey) = shared("cases/grey_float32.tif") else { return };
    let place = Workplace::new();
    let image: Array3<f32> = read_picture(&grey, Encoding::Linear).expect("reads");
    assert_eq!(image.dim(), (3, 160, 200));
    let found = measured(&grey, "");
    let mtf50 = number(&found, "mtf50_cy_per_px");
    assert!(mtf50 > 0.05 && mtf50 < 0.6, "{mtf50}");
    for name in ["three.tif", "array.npy"] {
        let path = place.path(name);
        write_annotated(&path, &image, Encoding::Linear, Depth::Float, &Annotation::default()).expect("writes");
        assert_eq!(number(&measured(&path, ""), "mtf50_cy_per_px"), mtf50, "{name}");
    }
}

/// A rendered edge is the same edge in every format that is written: 16 bits with the sRGB curve and floating point give one MTF, to the rounding of the samples.
#[test]
fn rendered_edges_are_read_as_they_were_written() {
    let place = Workplace::new();
    let scene = Array3::from_shape_fn((3, 400, 600), |(_, r, c)| {
        let d = (c as f32 - 300.0) * 0.9962 + (r as f32 - 200.0) * 0.0872;
        0.1 + 0.7 * (d + 0.5).clamp(0.0, 1.0)
    });
    write_picture(&place.path("scene.npy"), &scene, Encoding::Linear).expect("writes");
    let measured = |name: &str, more: &str| -> Value {
        let size = "--columns 300 --rows 200 --depth-mm inf";
        place.run(&format!("render cooke_triplet scene.npy -o {name} {size}{more}")).done();
        serde_json::from_str(&place.run(&format!("slanted-edge {name} --json")).done()).expect("JSON")
    };
    let exact = measured("a.npy", "");
    for (name, more) in [("b.tif", " --float"), ("c.tif", ""), ("d.png", "")] {
        let found = measured(name, more);
        assert_eq!(found["region_px"], exact["region_px"], "{name}");
        for (a, b) in found["mtf"].as_array().expect("a curve").iter().zip(exact["mtf"].as_array().expect("a curve")) {
            let off = number(a, "value") - number(b, "value");
            assert!(off.abs() < 1e-3, "{name} at {}: {off}", a["frequency_cy_per_px"]);
        }
    }
}
