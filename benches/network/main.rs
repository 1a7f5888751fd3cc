//! A training step of the network alone: `cargo bench --bench network` for criterion's figures, `-- tables` for the table
//! of `benches/results/network.md`, which `tests/peers/unet_torch.py` prints for PyTorch. `-- measure NAME` is one line
//! of it: every network has a process of its own, so that no other's memory counts. `-- quality [STEPS]` trains networks of
//! several sizes on one lens and prints PSNR against run time (about a quarter of an hour). `-- blocks onnxruntime|tract|step
//! [ROUNDS]` times networks of every kind of blocks for `benches/results/blocks.md`.

mod blocks;
mod cases;
mod quality;
mod tables;

use criterion::{Criterion, Throughput};

use cases::{CASES, Case};

fn step(c: &mut Criterion) {
    let mut group = c.benchmark_group("step");
    group.sample_size(10).throughput(Throughput::Elements(256 * 256));
    for case in CASES {
        let mut run = case.build();
        group.bench_function(case.name, |b| cases::pool().install(|| b.iter(|| run.step())));
    }
    group.finish();
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if let Some(at) = arguments.iter().position(|a| a == "measure") {
        let name = arguments.get(at + 1).expect("the name of a network");
        let case: &Case = CASES.iter().find(|c| c.name == name).expect("one of the networks");
        println!("{}", tables::measure(case));
        return;
    }
    if arguments.iter().any(|a| a == "tables") {
        tables::print();
        return;
    }
    if let Some(at) = arguments.iter().position(|a| a == "quality") {
        quality::print(arguments.get(at + 1).and_then(|n| n.parse().ok()).unwrap_or(600));
        return;
    }
    if let Some(at) = arguments.iter().position(|a| a == "blocks") {
        let what = arguments.get(at + 1).expect("onnxruntime, tract or step");
        blocks::print(what, arguments.get(at + 2).and_then(|n| n.parse().ok()).unwrap_or(5));
        return;
    }
    let mut criterion = Criterion::default().configure_from_args();
    step(&mut criterion);
    criterion.final_summary();
}
