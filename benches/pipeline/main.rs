//! Tracing, and the optics of a design step, on shipped lenses: `cargo bench --bench pipeline`; `-- tables` prints one table of the
//! step for `benches/results/pipeline.md`, `-- models` that of steps by rays, with the open pupil's diffraction and by waves for `benches/results/diffraction.md`.

mod step;

use std::hint::black_box;

use criterion::{Criterion, Throughput};
use glam::{DVec2, DVec3};
use isoplanat::lens::builtin;
use isoplanat::trace::sequential::trace;
use isoplanat::trace::{ObjectPoint, Ray, System};

fn trace_lenses(c: &mut Criterion) {
    let mut group = c.benchmark_group("trace");
    for name in ["two_element", "cooke_triplet", "phone"] {
        let lens = builtin::lens(name).expect("shipped");
        let system = System::new(&lens, 550.0);
        let object = ObjectPoint::from_slope(DVec2::ZERO, lens.object_vergence);
        let mut hits = Vec::new();
        group.throughput(Throughput::Elements(1000 * system.surfaces.len() as u64));
        group.bench_function(format!("{name}/1k_rays"), |b| {
            b.iter(|| {
                let mut passed = 0;
                for i in 0..1000 {
                    let ray = Ray::from_object(object, DVec3::new(0.0, 1e-4 * f64::from(i), 0.0));
                    passed += usize::from(trace(&system, ray, system.image(), &mut hits).is_ok());
                }
                assert_eq!(black_box(passed), 1000);
            });
        });
    }
    group.finish();
}

fn design_steps(c: &mut Criterion) {
    for step in step::Step::all() {
        let mut group = c.benchmark_group(format!("step/{}", step.name));
        group.sample_size(10).throughput(Throughput::Elements(step.pixels()));
        group.bench_function("trace", |b| b.iter(|| black_box(step.renderer().optics.table().rays)));
        group.bench_function("forward", |b| b.iter(|| black_box(step.forward())));
        group.bench_function("forward_and_gradient", |b| b.iter(|| black_box(step.gradient())));
        group.finish();
    }
}

fn main() {
    if std::env::args().any(|a| a == "models") {
        print!("{}", step::models());
        return;
    }
    if std::env::args().any(|a| a == "tables") {
        print!("{}{}", step::table(), step::choices());
        return;
    }
    let mut criterion = Criterion::default().configure_from_args();
    trace_lenses(&mut criterion);
    design_steps(&mut criterion);
    criterion.final_summary();
}
