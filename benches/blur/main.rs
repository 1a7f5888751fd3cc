//! Varying blur: `cargo bench --bench blur` for criterion's figures, `-- tables` for the tables of
//! `benches/results/blur.md`, `-- export FOLDER` for the files that `tests/peers/blur_torch.py` compares with.

mod cases;
mod tables;

use criterion::{Criterion, Throughput};
use isoplanat::imaging::render::blur::{Method, blur, blur_recorded, blur_vjp};

use cases::Case;

fn frame(c: &mut Criterion) {
    let case = Case::new(1024, 128, 65);
    let bar = case.bar();
    let mut group = c.benchmark_group("blur_1024_rgb_65");
    group.sample_size(20).throughput(Throughput::Elements((case.megapixels() * 1e6) as u64));
    let pool = cases::pool(2);
    for block in [64, 128] {
        let recorded = || blur_recorded(&case.grid, &case.kernels(), &case.source(), case.region, block, true);
        let method = Method::Cells { block };
        group.bench_function(format!("forward/{block}"), |b| {
            pool.install(|| {
                b.iter(|| blur(&case.grid, &case.kernels(), &case.source(), case.region, method, &|_| {}));
            });
        });
        group.bench_function(format!("recorded/{block}"), |b| {
            pool.install(|| b.iter(recorded));
        });
        let record = pool.install(|| recorded().1);
        group.bench_function(format!("vjp/{block}"), |b| {
            pool.install(|| b.iter(|| blur_vjp(&record, bar.view())));
        });
    }
    group.finish();
}

/// Transforms of lines by rustfft, of the sizes that blocks may have: `fast_size` chooses from them.
fn lines(c: &mut Criterion) {
    let mut group = c.benchmark_group("lines");
    for size in [160usize, 192, 200, 216, 224, 240, 256, 288, 320, 384] {
        let count = 3072 / size;
        group.throughput(Throughput::Elements((size * count) as u64));
        let fft = rustfft::FftPlanner::<f32>::new().plan_fft_forward(size);
        let mut lines = vec![rustfft::num_complex::Complex::new(0.0f32, 0.0); size * count];
        let mut scratch = vec![rustfft::num_complex::Complex::default(); fft.get_inplace_scratch_len()];
        group.bench_function(size.to_string(), |b| {
            b.iter(|| fft.process_with_scratch(&mut lines, &mut scratch));
        });
    }
    group.finish();
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if let Some(at) = arguments.iter().position(|a| a == "export") {
        tables::export(arguments.get(at + 1).map_or(".", String::as_str));
        return;
    }
    if arguments.iter().any(|a| a == "tables") {
        tables::print();
        return;
    }
    let mut criterion = Criterion::default().configure_from_args();
    lines(&mut criterion);
    frame(&mut criterion);
    criterion.final_summary();
}
