//! The fast trace: `cargo bench --bench trace` for criterion's figures, `cargo bench --bench trace -- tables` for the
//! tables of `benches/results/trace.md`.
//!
//! Throughput counts rays × refracting surfaces: stops and the image plane are traced and not counted. Rays are made in
//! the source of the stream, from a stored list.

mod cases;
mod peak;
mod tables;

use criterion::{Criterion, Throughput};
use isoplanat::trace::lanes::Level;

use cases::{Case, RAYS};

fn lenses(c: &mut Criterion) {
    for case in Case::all() {
        let mut group = c.benchmark_group(case.name);
        group.throughput(Throughput::Elements(RAYS as u64 * case.refracting() as u64));
        for level in Level::available() {
            for threads in [1, 2] {
                let pool = cases::pool(threads);
                group.bench_function(format!("forward/{level:?}/{threads}"), |b| {
                    pool.install(|| b.iter(|| assert_eq!(case.forward(level, RAYS), RAYS)));
                });
                group.bench_function(format!("forward_and_adjoint/{level:?}/{threads}"), |b| {
                    pool.install(|| b.iter(|| assert!(case.gradient(level, RAYS) > 0.0)));
                });
            }
        }
        group.finish();
    }
}

fn main() {
    if std::env::args().any(|a| a == "tables") {
        tables::print();
        return;
    }
    let mut criterion = Criterion::default().configure_from_args();
    lenses(&mut criterion);
    criterion.final_summary();
}
