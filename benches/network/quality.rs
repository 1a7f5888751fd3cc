//! What width and scales of the network, and f16 weights, cost and bring on one lens: PSNR over run time.
//!
//! Every network is trained alike on the demo's task (two-element lens, built-in scenes, 128-pixel patches, L1 and multi-scale
//! SSIM) for the same number of steps, and judged as `isoplanat evaluate` does, on built-in street scenes that no training uses.

use std::path::Path;
use std::time::Instant;

use isoplanat::design::evaluate::{FINENESS, Pictures, Settings, TEXELS_PER_PIXEL, evaluate};
use isoplanat::design::task::Task;
use isoplanat::design::training::Training;
use isoplanat::imaging::scene::SceneKind;
use isoplanat::lens::catalogue::Glasses;
use isoplanat::network::{Compute, Reconstructor};
use isoplanat::report::plot::{Mark, Plot, Series};
use ndarray::Array4;

/// Width and scales.
const NETWORKS: [(usize, usize); 6] = [(8, 3), (16, 3), (32, 3), (16, 2), (16, 5), (16, 7)];

/// Trains and judges everything; `steps` each. Writes a table to stdout and a plot to `benches/results`.
pub(crate) fn print(steps: u64) {
    let task = task(steps);
    let (lens, sensor) = (task.subject(Glasses::shipped()).expect("shipped"), task.sensor().expect("generic"));
    let pictures = Pictures::BuiltIn(SceneKind::Facades, 8);
    let settings = Settings {
        fields: 3,
        to_deg: None,
        means_deg: Vec::new(),
        depths_mm: vec![1000.0],
        patch: 256,
        seed: 5,
        fineness: FINENESS,
        rays: None,
        texels: TEXELS_PER_PIXEL,
        through: None,
    };
    println!(
        "| width, scales | 10^6 parameters | s a training step | forward, s/Mpixel | capture, dB | f32, dB | SSIM | f16, dB | f16 \
         against f32, largest |\n|---|---|---|---|---|---|---|---|---|"
    );
    let mut series = Vec::new();
    for (base_width, scales) in NETWORKS {
        let place = tempfile::tempdir().expect("a temporary folder");
        let run = place.path().join("run");
        let mut task = task.clone();
        (task.train.network.base_width, task.train.network.scales) = (Some(base_width), scales);
        let mut training = Training::create(task, &run, false, Compute::Cpu, Glasses::shipped()).expect("a task");
        let clock = Instant::now();
        training.run(&mut |_| true).expect("trains");
        let a_step = clock.elapsed().as_secs_f64() / steps as f64;
        let network = Reconstructor::load(&run.join("network.safetensors")).expect("a network");
        let half = rounded(&network);
        let judge = |network: &Reconstructor| {
            let (evaluation, _) =
                evaluate(&lens, (network, training.guide()), &sensor, &pictures, &settings, false, &mut |_| {})
                    .expect("judged");
            evaluation.rows.into_iter().find(|r| r.zone == 0).expect("the mean")
        };
        let (full, less) = (judge(&network), judge(&half));
        let mut rng = fastrand::Rng::with_seed(1);
        let picture = Array4::from_shape_simple_fn((1, 3, 1024, 1024), || rng.f32());
        let mut seconds: Vec<f64> = Vec::new();
        for _ in 0..4 {
            let clock = Instant::now();
            network.forward(picture.view()).expect("fits");
            seconds.push(clock.elapsed().as_secs_f64());
        }
        let forward = seconds.iter().copied().fold(f64::INFINITY, f64::min) / (1024.0 * 1024.0 * 1e-6);
        let outputs = [&network, &half].map(|n| n.forward(picture.view()).expect("fits"));
        let largest = (&outputs[0] - &outputs[1]).iter().fold(0f32, |m, v| m.max(v.abs()));
        let parameters: usize = network.parameters().iter().map(|p| p.values.len()).sum();
        println!(
            "| {base_width}, {scales} | {:.2} | {a_step:.3} | {forward:.3} | {:.2} | {:.2} | {:.4} | {:.2} | {largest:.1e} |",
            parameters as f64 * 1e-6,
            full.capture.psnr_db.mean,
            full.reconstruction.psnr_db.mean,
            full.reconstruction.ssim.mean,
            less.reconstruction.psnr_db.mean,
        );
        series.push(Series {
            name: format!("{base_width}, {scales}"),
            points: vec![[forward, full.reconstruction.psnr_db.mean]],
            mark: Mark::Dots,
        });
    }
    let plot = Plot {
        title: format!("PSNR after {steps} steps over run time, by width and scales"),
        x_label: "forward pass, s/Mpixel, two threads".into(),
        y_label: "PSNR of the reconstruction, dB".into(),
        series,
        ..Plot::default()
    };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/results/network.svg");
    std::fs::write(&path, plot.to_svg()).expect("written");
}

fn task(steps: u64) -> Task {
    let mut task = Task::demo();
    let train = &mut task.train;
    (train.pairs.patch_px, train.pairs.region_px, train.pairs.count, train.budget.steps) = (128, 192, 100, Some(steps));
    (train.budget.rate, train.budget.sample_steps, train.pairs.haze, train.pairs.noise) = (1e-3, 0, 0.0, [1.0, 1.0]);
    task
}

/// The network with its weights as f16 stores them: 11 bits, or steps of 2^-24 below 2^-14.
fn rounded(network: &Reconstructor) -> Reconstructor {
    let mut half = Reconstructor::new(network.config().clone(), 0).expect("valid");
    for parameter in network.parameters() {
        let round = |v: &f32| {
            if v.abs() < 6.103_515_6e-5 {
                return v.signum() * ((v.abs() + 0.5) - 0.5);
            }
            let split = v * 8193.0;
            split - (split - v)
        };
        let values: Vec<f32> = parameter.values.iter().map(round).collect();
        half.set_parameter(&parameter.name, &values).expect("the same network");
    }
    half
}
