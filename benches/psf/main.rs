//! PSF grids: `cargo bench --bench psf` for criterion's figures, `cargo bench --bench psf -- tables` for the tables of
//! `benches/results/psf.md` (`-- tables error`, `speed`, `ways` for one of them).
//!
//! A grid has 9 x 9 nodes over a square whose corner is the edge of the field, and 3 wavelengths in 3 channels of their
//! own: 243 monochromatic kernels of 65 x 65 pixels.

mod cases;
mod cells;
mod compare;
mod tables;

use criterion::{Criterion, Throughput};
use isoplanat::psf::pupil::PupilSampling;

use cases::{Case, SAMPLINGS};

fn grids(c: &mut Criterion) {
    for (case, (_, degree, dense)) in Case::all().iter().zip(SAMPLINGS) {
        let sampling = PupilSampling::new(degree, dense);
        let mut group = c.benchmark_group(case.name);
        for symmetric in [true, false] {
            let grid = case.grid(&sampling, symmetric);
            let name = if symmetric { "symmetric" } else { "every node alone" };
            group.throughput(Throughput::Elements(grid.kernels()));
            let pool = cases::pool(2);
            group.bench_function(format!("forward/{name}"), |b| pool.install(|| b.iter(|| grid.forward())));
            group.bench_function(format!("forward_and_adjoint/{name}"), |b| pool.install(|| b.iter(|| grid.both())));
        }
        group.finish();
    }
}

fn main() {
    if std::env::args().any(|a| a == "tables") {
        let named = |name: &str| std::env::args().any(|a| a == name);
        if !named("ways") {
            tables::print();
        }
        if !named("speed") && !named("error") {
            compare::print();
        }
        return;
    }
    let mut criterion = Criterion::default().configure_from_args();
    grids(&mut criterion);
    criterion.final_summary();
}
