//! The tables of `benches/results/blur.md`: every figure is the best of many runs.

use std::fmt::Write;
use std::time::Instant;

use isoplanat::imaging::render::blur::cost::Task;
use isoplanat::imaging::render::blur::{Method, blur, blur_recorded, blur_vjp};

use crate::cases::{Case, pool};

/// Seconds of the fastest of `runs`.
fn best(runs: u32, mut work: impl FnMut()) -> f64 {
    (0..runs)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min)
}

fn forward(case: &Case, method: Method) -> f64 {
    best(8, || {
        let y = blur(&case.grid, &case.kernels(), &case.source(), case.region, method, &|_| {});
        assert!(y[[0, 5, 5]].is_finite());
    })
}

pub(crate) fn print() {
    let mut text = String::from(
        "# Varying blur\n\n`cargo bench --bench blur -- tables` writes this page; `tests/peers/blur_torch.py` is the peer.\n\n",
    );
    pool(2).install(|| {
        frame(&mut text);
        choice(&mut text);
    });
    print!("{text}");
    std::fs::write("benches/results/blur.md", text).expect("writable");
}

fn frame(text: &mut String) {
    let case = Case::new(1024, 128, 65);
    let bar = case.bar();
    let line = "1024 × 1024 RGB, 9 × 9 nodes 128 pixels apart, 65 × 65 kernels, f32, two threads:\n\n\
                | block | forward, ms | Mpixel/s | forward + both gradients, ms | Mpixel/s | ratio | record, MB |\n\
                |---|---|---|---|---|---|---|";
    writeln!(text, "{line}").expect("a string");
    for block in [32, 64, 96, 128] {
        let ahead = forward(&case, Method::Cells { block });
        let mut bytes = 0;
        let both = best(8, || {
            let (_, record) = blur_recorded(&case.grid, &case.kernels(), &case.source(), case.region, block, true);
            let k = blur_vjp(&record, bar.view()).kernels;
            assert!(k[[0, 0, 0, 1, 1]].is_finite());
            bytes = record.bytes();
        });
        let rate = |s: f64| case.megapixels() / s;
        let (ms, ms_both, megabytes) = (ahead * 1e3, both * 1e3, bytes as f64 * 1e-6);
        writeln!(
            text,
            "| {block} | {ms:.1} | {:.1} | {ms_both:.1} | {:.1} | {:.2} | {megabytes:.0} |",
            rate(ahead),
            rate(both),
            both / ahead
        )
        .expect("a string");
    }
}

/// The cost model's choice against the best of all it considers.
fn choice(text: &mut String) {
    writeln!(text, "\nThe cost model's choice, 512 × 512 RGB, two threads:\n\n| kernel | spacing | choice | ms | best | ms | estimate, ms on one core |\n|---|---|---|---|---|---|---|")
        .expect("a string");
    for (size, spacing) in [(5, 64), (9, 64), (15, 64), (31, 64), (65, 64), (65, 256), (129, 128), (257, 128)] {
        let case = Case::new(512, spacing, size);
        let task = Task { grid: &case.grid, region: case.region, size, channels: 3, source_channels: 3, phases: 1 };
        let chosen = task.cheapest();
        let run = |method: Method| {
            best(3, || {
                let y = blur(&case.grid, &case.kernels(), &case.source(), case.region, method, &|_| {});
                assert!(y[[0, 5, 5]].is_finite());
            })
        };
        let mut all: Vec<Method> =
            [16, 32, 48, 64, 96, 128, 192, 256].iter().map(|b| Method::Cells { block: *b }).collect();
        all.retain(|m| matches!(m, Method::Cells { block } if *block <= spacing));
        if size <= 31 {
            all.push(Method::Direct);
        }
        let (fastest, seconds) =
            all.into_iter().map(|m| (m, run(m))).min_by(|a, b| a.1.total_cmp(&b.1)).expect("methods");
        let estimate = task.cost(chosen) * 1e-6;
        writeln!(
            text,
            "| {size} | {spacing} | {chosen:?} | {:.1} | {fastest:?} | {:.1} | {estimate:.1} |",
            run(chosen) * 1e3,
            seconds * 1e3
        )
        .expect("a string");
    }
}

/// Inputs and results as `.npy` files for `tests/peers/blur_torch.py`.
pub(crate) fn export(folder: &str) {
    let case = Case::new(1024, 128, 65);
    let write = |name: &str| format!("{folder}/{name}.npy");
    let (y, record) = blur_recorded(&case.grid, &case.kernels(), &case.source(), case.region, 128, true);
    let bar = case.bar();
    let k = blur_vjp(&record, bar.view()).kernels;
    ndarray_npy::write_npy(write("kernels"), &case.kernels).expect("writable");
    ndarray_npy::write_npy(write("source"), &case.planes).expect("writable");
    ndarray_npy::write_npy(write("image"), &y).expect("writable");
    ndarray_npy::write_npy(write("bar"), &bar).expect("writable");
    ndarray_npy::write_npy(write("kernels_bar"), &k).expect("writable");
}
