//! The exported network through ONNX Runtime and through tract against the in-crate forward: ≤ 1e-5 of the largest output, on
//! three sizes, with every kind of blocks, 3 and 7 scales, f32 and f16 weights; and through the camera's tiles.
//!
//! ONNX Runtime's half is skipped with a message where no library is found, and fails there when
//! `ISOPLANAT_REQUIRE_ONNXRUNTIME=1`. Models, inputs and outputs are left in the folder `ISOPLANAT_ONNX_CHECK` where that is
//! set, for `tests/peers/onnx_check.py`.

use std::path::{Path, PathBuf};

use isoplanat::deploy::session::{Choice, Options, Session};
use isoplanat::deploy::tiles::{self, Tiling};
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::guide::Guide;
use isoplanat::imaging::plane::Region;
use isoplanat::network::card::{ModelCard, Weights};
use isoplanat::network::{Blocks, Reconstructor, UnetConfig, onnx};
use ndarray::{Array4, ArrayView4, Axis, s};

/// Largest difference, of the largest output.
const TOLERANCE: f32 = 1e-5;

/// Sizes that the network takes as they are, and one that must be continued to a multiple first: one pixel off.
const SIZES: [(usize, usize); 3] = [(128, 128), (64, 192), (127, 65)];

/// What a network is made of, its width and its scales.
type Size = (Blocks, usize, usize);

const NETWORKS: [Size; 6] = [
    (Blocks::Paper, 8, 3),
    (Blocks::Paper, 4, 7),
    (Blocks::Separable, 8, 3),
    (Blocks::Separable, 4, 7),
    (Blocks::Gated, 8, 3),
    (Blocks::Gated, 4, 7),
];

/// A network that is no identity any more, on pictures in 0..1.
fn trained((blocks, base_width, scales): Size) -> Reconstructor {
    let config = UnetConfig { blocks, ..UnetConfig::bare(base_width, scales) };
    let mut net = Reconstructor::new(config, 3).expect("valid");
    let rng = &mut fastrand::Rng::with_seed(5);
    for _ in 0..10 {
        let x = Array4::from_shape_simple_fn((1, 3, 64, 64), || rng.f32());
        let y = x.mapv(|v| v * v);
        net.step_network_only(x.view(), y.view(), None, 3e-3).expect("trains");
    }
    net
}

/// `v` rounded to 11 significant bits, by arithmetic on its exponent (spacing 2^−24 below 2^−14).
fn to_half(v: f32) -> f32 {
    let exponent = f64::from(v.abs()).log2().floor().max(-14.0);
    let spacing = (exponent - 10.0).exp2();
    ((f64::from(v) / spacing).round_ties_even() * spacing) as f32
}

/// The network as the file holds it.
fn stored(mut net: Reconstructor, weights: Weights) -> Reconstructor {
    if weights == Weights::F16 {
        for parameter in net.parameters() {
            let rounded: Vec<f32> = parameter.values.iter().map(|v| to_half(*v)).collect();
            net.set_parameter(&parameter.name, &rounded).expect("as many");
        }
    }
    net
}

/// A trained network as a file: its card, the bytes, and the network with the weights the file holds.
fn exported(size: Size, weights: Weights) -> (ModelCard, Vec<u8>, Reconstructor) {
    let (net, (blocks, base_width, scales)) = (trained(size), size);
    let mut card = ModelCard::for_unet("parity", base_width, scales).made_of(blocks);
    card.weights = weights;
    let model = onnx::encode(&net, &card).expect("encodes");
    (card, model, stored(net, weights))
}

/// A session, or `None` after a visible message; a failure where the environment requires ONNX Runtime.
fn open(model: &[u8], choice: Choice) -> Option<Session> {
    match Session::open(model, Path::new("model.onnx"), &Options { choice, threads: 2, ..Options::default() }) {
        Ok(session) => Some(session),
        Err(e) if choice != Choice::OnnxRuntime => panic!("{choice:?}: {e}"),
        Err(e) if std::env::var_os("ISOPLANAT_REQUIRE_ONNXRUNTIME").is_some_and(|v| v == "1") => {
            panic!("ONNX Runtime is required here: {e}")
        }
        Err(e) => {
            eprintln!("SKIPPED: {e}");
            None
        }
    }
}

fn picture(rows: usize, cols: usize) -> Array4<f32> {
    let rng = &mut fastrand::Rng::with_seed(6);
    Array4::from_shape_simple_fn((1, 3, rows, cols), || rng.f32())
}

/// Largest difference over the largest value of `a`.
fn difference<'a>(a: impl IntoIterator<Item = &'a f32> + Clone, b: impl IntoIterator<Item = &'a f32>) -> f32 {
    let largest = a.clone().into_iter().fold(0f32, |m, v| m.max(v.abs()));
    a.into_iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0f32, f32::max) / largest
}

/// Mirrored below and to the right to the next multiple, pixel by pixel.
fn continued(x: &Array4<f32>, multiple: usize) -> Array4<f32> {
    let (_, _, rows, cols) = x.dim();
    let fold = |i: usize, n: usize| if i < n { i } else { 2 * (n - 1) - i };
    let shape = (1, 3, rows.next_multiple_of(multiple), cols.next_multiple_of(multiple));
    Array4::from_shape_fn(shape, |(_, c, i, j)| x[[0, c, fold(i, rows), fold(j, cols)]])
}

fn check(choice: Choice) {
    for size in NETWORKS {
        for weights in [Weights::F32, Weights::F16] {
            let (card, model, net) = exported(size, weights);
            let what = format!("{choice:?}, {} blocks, {} scales, {} weights", size.0.name(), size.2, weights.name());
            let Some(session) = open(&model, choice) else { return };
            assert_eq!(ModelCard::from_metadata(session.metadata()).expect("a card"), card);
            let mut worst = 0f32;
            for (rows, cols) in SIZES {
                let x = picture(rows, cols);
                let ours = net.forward_padded(x.view()).expect("runs");
                let theirs = session.run(continued(&x, card.multiple).view()).expect("runs");
                worst = worst.max(difference(&ours, theirs.slice(s![.., .., ..rows, ..cols])));
            }
            eprintln!("{what}: {worst:e} of the largest output");
            assert!(worst <= TOLERANCE, "{what}: {worst:e}");
        }
    }
}

#[test]
fn onnx_runtime_agrees_with_the_in_crate_forward() {
    check(Choice::OnnxRuntime);
}

#[test]
fn tract_agrees_with_the_in_crate_forward() {
    check(Choice::Tract);
}

/// Seven scales through the camera's tiles: pictures one pixel off a multiple, in several tiles and in one, against the
/// in-crate network on the whole mirrored picture.
#[test]
fn seven_scales_in_tiles_give_what_they_give_in_one_piece() {
    let (card, model, net) = exported((Blocks::Paper, 2, 7), Weights::F32);
    let session = open(&model, Choice::Best).expect("one of the two");
    let overlap = card.receptive_radius_px.next_multiple_of(card.multiple);
    assert_eq!((card.multiple, card.receptive_radius_px, overlap), (64, 444, 448));
    let tiling = Tiling::new(1024, overlap, card.multiple).expect("keeps something");
    let bare = Guide::bare(&Frame::centred(64, 48, 0.01).expect("valid"));
    for (rows, cols, count) in [(65, 127, 1), (1087, 833, 3)] {
        let image = picture(rows, cols).index_axis_move(Axis(0), 0);
        // Mirrored by 64 on every side and below and to the right to the next multiple.
        let fold = |i: usize, n: usize| {
            let (mut at, last) = (i as i64 - 64, n as i64 - 1);
            while !(0..=last).contains(&at) {
                at = if at < 0 { -at } else { 2 * last - at };
            }
            at as usize
        };
        let side = |n: usize| (n + 128).next_multiple_of(64);
        let whole = Array4::from_shape_fn((1, 3, side(rows), side(cols)), |(_, c, i, j)| {
            image[[c, fold(i, rows), fold(j, cols)]]
        });
        let ours = net.forward(whole.view()).expect("runs");
        let ours = ours.slice(s![0, .., 64..64 + rows, 64..64 + cols]);
        let run = |tile: ArrayView4<'_, f32>| session.run(tile);
        let all = Region { row: 0, col: 0, rows, cols };
        let theirs = tiles::run(image.to_owned(), all, &bare, tiling, 1, &run, &|_, _| ()).expect("runs");
        assert_eq!(tiling.count(rows, cols), count, "{rows} × {cols}");
        let worst = difference(ours, &theirs);
        eprintln!("{rows} × {cols} in {count} tiles: {worst:e} of the largest output");
        assert!(worst <= TOLERANCE, "{rows} × {cols}: {worst:e}");
    }
}

/// Models with inputs and the in-crate network's outputs, as `tests/peers/onnx_check.py` takes them, read back.
#[test]
fn recorded_models_can_be_checked_by_other_programs() {
    let temporary = tempfile::tempdir().expect("a folder");
    let folder = std::env::var_os("ISOPLANAT_ONNX_CHECK").map_or(temporary.path().to_owned(), PathBuf::from);
    for size in NETWORKS {
        for weights in [Weights::F32, Weights::F16] {
            let (card, model, net) = exported(size, weights);
            let name = format!("{}-{}-{}", size.0.name(), size.2, weights.name());
            std::fs::write(folder.join(format!("{name}.onnx")), &model).expect("written");
            for (rows, cols) in SIZES {
                let x = continued(&picture(rows, cols), card.multiple);
                let y = net.forward(x.view()).expect("runs");
                for (what, array) in [("input", &x), ("output", &y)] {
                    let path = folder.join(format!("{name}.{rows}x{cols}.{what}.npy"));
                    ndarray_npy::write_npy(path, array).expect("written");
                }
            }
            let path = folder.join(format!("{name}.127x65.output.npy"));
            let back: Array4<f32> = ndarray_npy::read_npy(path).expect("reads");
            let x = continued(&picture(127, 65), card.multiple);
            let theirs = open(&model, Choice::Tract).expect("compiled in").run(x.view()).expect("runs");
            assert!(difference(&back, &theirs) <= TOLERANCE, "{name}");
        }
    }
}
