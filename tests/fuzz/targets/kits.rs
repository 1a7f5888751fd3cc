//! `kit.toml` beside the smallest model. A kit that is loaded is written with a text that loads as the same.

use std::path::PathBuf;
use std::sync::LazyLock;

use isoplanat::deploy::kit::{FILE, Kit, LensEntry};
use isoplanat::imaging::develop::distortion::Distortion;
use isoplanat::imaging::develop::shading::Shading;
use isoplanat::imaging::frame::Frame;
use isoplanat::network::onnx::encode;

use super::{again, file, made, models, place, read, tables};

/// A kit of the smallest network and a sensor with a short response.
fn smallest() -> Kit {
    let (model, mut card) = models::smallest();
    let sensor = tables::sensor();
    card.lens_sha256 = "0".repeat(64);
    card.lens_name = "l".into();
    card.calibration_sha256 = sensor.sha256();
    let distortion = Distortion { max_slope: 0.5, coefficients_mm: [10.0, -0.5, 0.1, 0.0], residual_mm: 0.001 };
    let shading = Shading::new(vec![0.0, 10.0], [vec![1.0, 0.5], vec![1.0, 0.6], vec![1.0, 0.7]]).expect("valid");
    let frame = Frame::centred(96, 64, 0.01).expect("valid");
    let lens = LensEntry { name: "l".into(), sha256: card.lens_sha256.clone() };
    let model = encode(&model, &card).expect("a model");
    Kit::new("k", lens, model, 320, sensor, frame, distortion, shading, None).expect("valid")
}

/// The model's bytes in a folder of this thread's own.
fn folder() -> PathBuf {
    static MODEL: LazyLock<Vec<u8>> = LazyLock::new(|| smallest().model_bytes);
    let folder = place("kit");
    if !folder.is_dir() {
        std::fs::create_dir(&folder).expect("a folder");
        std::fs::write(folder.join("model.onnx"), &*MODEL).expect("writes");
    }
    folder
}

pub(super) fn kit(bytes: &[u8]) {
    let folder = folder();
    file(&format!("kit/{FILE}"), bytes);
    let Some(kit) = read("kit", Kit::load(&folder)) else { return };
    let text = again(kit.to_toml(), "");
    file(&format!("kit/{FILE}"), text.as_bytes());
    assert_eq!(again(again(Kit::load(&folder), &text).to_toml(), &text), text);
    assert!(made(kit.tiling()).is_some());
}

pub(super) fn starts() -> Vec<Vec<u8>> {
    let mut kit = smallest();
    let plain = kit.to_toml().expect("valid");
    for range in ["iso=100..400", "f_number=4", "focal_length_mm=40..60", "distance_m=2..inf"] {
        kit.valid.put(range).expect("a range");
    }
    kit.glare = Some(0.02);
    vec![plain.into_bytes(), kit.to_toml().expect("valid").into_bytes()]
}
