//! Kernels: `cargo bench --bench psf` for criterion's figures, `cargo bench --bench psf -- tables` for the tables of
//! `benches/results/psf.md` (`-- tables error`, `speed` for one of them), `-- waves` for that of kernels by diffraction.
//!
//! A grid has 9 x 9 nodes over a square whose corner is the edge of the field, and 3 wavelengths in 3 channels of their
//! own: 243 monochromatic kernels of 65 x 65 pixels, from the lens on.

mod cases;
mod tables;
mod waves;

use criterion::{Criterion, Throughput};

use cases::{Case, SAMPLINGS};

fn grids(c: &mut Criterion) {
    for (case, (_, degree, dense)) in Case::all().iter().zip(SAMPLINGS) {
        let mut group = c.benchmark_group(case.name);
        for (what, degree, dense) in [("equal error", degree, dense), ("4096 rays", 7, 4096)] {
            let grid = case.grid(degree, dense);
            group.throughput(Throughput::Elements(grid.kernels()));
            let pool = cases::pool(2);
            group.bench_function(format!("forward/{what}"), |b| pool.install(|| b.iter(|| grid.forward())));
            group.bench_function(format!("forward_and_adjoint/{what}"), |b| pool.install(|| b.iter(|| grid.both())));
        }
        group.finish();
    }
}

fn main() {
    if std::env::args().any(|a| a == "waves") {
        waves::print();
        return;
    }
    if std::env::args().any(|a| a == "tables") {
        tables::print();
        return;
    }
    let mut criterion = Criterion::default().configure_from_args();
    grids(&mut criterion);
    criterion.final_summary();
}
