//! What the kinds of blocks cost: run time in the camera's two runtimes, and of a training step, by width and scales.
//!
//! The networks of one size run in turn with one reference, round by round, so that what else the machine does meets all of them.
//! Processor time, all threads together, is what can be compared on a busy machine.

use std::path::Path;
use std::time::Instant;

use isoplanat::deploy::session::{Choice, Options, Session};
use isoplanat::network::card::ModelCard;
use isoplanat::network::{Blocks, Reconstructor, UnetConfig, onnx};
use ndarray::Array4;

use crate::tables::processor_seconds;

/// Widths and scales, for every kind of blocks.
const SIZES: [(usize, usize); 7] = [(8, 3), (16, 3), (24, 3), (32, 3), (48, 3), (16, 5), (32, 5)];

/// What every network is compared with: blocks of the paper.
const REFERENCE: (usize, usize) = (16, 3);

/// Side of a tile in the camera, pixels.
const TILE: usize = 512;

/// Side of a training patch, pixels.
const PATCH: usize = 192;

const THREADS: usize = 2;

/// Prints a line a network: seconds of `what`, which is `onnxruntime`, `tract` or `step`, over `rounds` rounds.
pub(crate) fn print(what: &str, rounds: usize) {
    println!(
        "| blocks | width, scales | 10^6 weights | {what}, s: median | least | processor time, s | of the reference's |\n\
         |---|---|---|---|---|---|---|"
    );
    let of = |blocks, (width, scales)| UnetConfig { blocks, ..UnetConfig::bare(width, scales) };
    for size in SIZES {
        let kinds = Blocks::ALL.map(|blocks| of(blocks, size));
        let networks: Vec<UnetConfig> = [of(Blocks::Paper, REFERENCE)].into_iter().chain(kinds).collect();
        let mut runs: Vec<Box<dyn FnMut() -> f64>> = networks.iter().map(|config| prepared(config, what)).collect();
        let mut seconds = vec![Vec::new(); networks.len()];
        let mut busy = vec![0.0; networks.len()];
        for round in 0..=rounds {
            for ((run, seconds), busy) in runs.iter_mut().zip(&mut seconds).zip(&mut busy) {
                let before = processor_seconds();
                let time = run();
                // The first round warms up.
                if round > 0 {
                    seconds.push(time);
                    *busy += (processor_seconds() - before) / rounds as f64;
                }
            }
        }
        for ((config, seconds), now) in networks.iter().zip(&mut seconds).zip(&busy).skip(1) {
            seconds.sort_by(f64::total_cmp);
            println!(
                "| {} | {}, {} | {:.3} | {:.4} | {:.4} | {now:.3} | {:.2} |",
                config.blocks.name(),
                config.base_width,
                config.scales,
                weights(&network(config)) as f64 * 1e-6,
                seconds[rounds / 2],
                seconds[0],
                now / busy[0]
            );
        }
    }
}

fn weights(network: &Reconstructor) -> usize {
    network.parameters().iter().map(|p| p.values.len()).sum()
}

/// A network whose residuals count.
fn network(config: &UnetConfig) -> Reconstructor {
    let mut network = Reconstructor::new(config.clone(), 1).expect("valid");
    for parameter in network.parameters().into_iter().filter(|p| p.name.contains(".scale")) {
        network.set_parameter(&parameter.name, &vec![0.3; parameter.values.len()]).expect("as many");
    }
    network
}

fn picture(side: usize, seed: u64) -> Array4<f32> {
    let mut rng = fastrand::Rng::with_seed(seed);
    Array4::from_shape_simple_fn((1, 3, side, side), || rng.f32())
}

/// What takes one measurement, seconds a tile or a step: two threads of ONNX Runtime, one of tract (the camera runs two tiles at a
/// time there), one of a training.
fn prepared(config: &UnetConfig, what: &str) -> Box<dyn FnMut() -> f64> {
    let mut network = network(config);
    if what == "step" {
        let (input, target) = (picture(PATCH, 1), picture(PATCH, 2));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
        return Box::new(move || {
            pool.install(|| {
                let start = Instant::now();
                network.step_network_only(input.view(), target.view(), None, 1e-5).expect("fits");
                start.elapsed().as_secs_f64()
            })
        });
    }
    let choice = match what {
        "onnxruntime" => Choice::OnnxRuntime,
        "tract" => Choice::Tract,
        other => panic!("{other}: onnxruntime, tract or step"),
    };
    let card = ModelCard::for_unet("bench", config.base_width, config.scales).made_of(config.blocks);
    let model = onnx::encode(&network, &card).expect("encodes");
    let options = Options { choice, threads: THREADS, ..Options::default() };
    let session = Session::open(&model, Path::new("model.onnx"), &options).expect("opens");
    let tile = picture(TILE, 1);
    Box::new(move || {
        let start = Instant::now();
        session.run(tile.view()).expect("runs");
        start.elapsed().as_secs_f64()
    })
}
