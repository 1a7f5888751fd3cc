//! The exported network through ONNX Runtime and through tract against the in-crate forward: ≤ 1e-5 on three sizes.
//!
//! ONNX Runtime's half is skipped with a message where no library is found, and fails there when
//! `ISOPLANAT_REQUIRE_ONNXRUNTIME=1`.

use std::path::Path;

use isoplanat::deploy::session::{Choice, Options, Session};
use isoplanat::design::run::network;
use isoplanat::network::Reconstructor;
use isoplanat::network::card::ModelCard;
use isoplanat::network::onnx;
use ndarray::Array4;

/// A network that is no identity any more, on pictures in 0..1.
fn trained() -> Reconstructor {
    let mut net = network(8, 3).expect("valid");
    let rng = &mut fastrand::Rng::with_seed(5);
    for _ in 0..10 {
        let x = Array4::from_shape_simple_fn((1, 3, 32, 32), || rng.f32());
        let y = x.mapv(|v| v * v);
        net.step_network_only(x.view(), y.view(), 3e-3).expect("trains");
    }
    net
}

fn check(choice: Choice, what: &str) {
    let net = trained();
    let card = ModelCard::for_unet("parity", 8, 3);
    let model = onnx::encode(&net, &card).expect("encodes");
    let options = Options { choice, threads: 1, ..Options::default() };
    let session = match Session::open(&model, Path::new("model.onnx"), &options) {
        Ok(session) => session,
        Err(e) if std::env::var_os("ISOPLANAT_REQUIRE_ONNXRUNTIME").is_some_and(|v| v == "1") => {
            panic!("{what} is required here: {e}")
        }
        Err(e) => {
            eprintln!("SKIPPED: {e}");
            return;
        }
    };
    assert_eq!(ModelCard::from_metadata(session.metadata()).expect("a card"), card);
    let rng = &mut fastrand::Rng::with_seed(6);
    let mut worst = 0.0f32;
    for (rows, cols) in [(32, 32), (48, 100), (132, 64)] {
        let x = Array4::from_shape_simple_fn((1, 3, rows, cols), || rng.f32());
        let ours = net.forward(x.view()).expect("runs");
        let theirs = session.run(x.view()).expect("runs");
        worst = worst.max(ours.iter().zip(&theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max));
    }
    eprintln!("{what} against the in-crate forward: {worst:e}");
    assert!(worst <= 1e-5, "{what}: {worst:e}");
}

#[test]
fn onnx_runtime_agrees_with_the_in_crate_forward() {
    check(Choice::OnnxRuntime, "ONNX Runtime");
}

#[test]
fn tract_agrees_with_the_in_crate_forward() {
    check(Choice::Tract, "tract");
}
