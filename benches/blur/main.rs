//! Varying blur: `cargo bench --bench blur` for criterion's figures, `-- tables` for the tables of
//! `benches/results/blur.md`, `-- export FOLDER` for the files that `tests/peers/blur_torch.py` compares with.

mod cases;
mod tables;

use criterion::{Criterion, Throughput};
use isoplanat::imaging::blur::{Method, blur, blur_kernels_vjp, blur_source_vjp};

use cases::Case;

fn frame(c: &mut Criterion) {
    let case = Case::new(1024, 128, 65);
    let bar = case.bar();
    let mut group = c.benchmark_group("blur_1024_rgb_65");
    group.sample_size(20).throughput(Throughput::Elements((case.megapixels() * 1e6) as u64));
    let pool = cases::pool(2);
    for block in [64, 128] {
        let method = Method::Cells { block };
        group.bench_function(format!("forward/{block}"), |b| {
            pool.install(|| {
                b.iter(|| blur(&case.grid, &case.kernels(), &case.source(), case.region, method, &|_| {}));
            });
        });
        group.bench_function(format!("kernels_vjp/{block}"), |b| {
            pool.install(|| {
                b.iter(|| blur_kernels_vjp(&case.grid, (65, 1), &case.source(), case.region, block, bar.view()));
            });
        });
        group.bench_function(format!("source_vjp/{block}"), |b| {
            pool.install(|| {
                b.iter(|| blur_source_vjp(&case.grid, &case.kernels(), 3, case.region, block, bar.view()));
            });
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
    frame(&mut criterion);
    criterion.final_summary();
}
