//! One bench binary: stages of the chain on shipped lenses. `cargo bench`, figures into `benches/results`.

use std::hint::black_box;

use criterion::{Criterion, Throughput};
use glam::DVec2;
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::patches::NodeRaster;
use isoplanat::imaging::plan::{Quality, plan};
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::render::{Optics, render_region};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::builtin;
use isoplanat::trace::System;
use isoplanat::trace::launch::{FieldPoint, launch};
use isoplanat::trace::sequential::trace;

fn trace_lenses(c: &mut Criterion) {
    let mut group = c.benchmark_group("trace");
    for name in ["two_element", "cooke_triplet", "phone"] {
        let lens = builtin::lens(name).expect("shipped");
        let system = System::new(&lens, 550.0);
        let field = FieldPoint { slope: DVec2::ZERO, vergence: lens.object_vergence };
        let mut hits = Vec::new();
        group.throughput(Throughput::Elements(1000 * system.surfaces.len() as u64));
        group.bench_function(format!("{name}/1k_rays"), |b| {
            b.iter(|| {
                let mut passed = 0;
                for i in 0..1000 {
                    let e = DVec2::new(0.0, 1e-4 * f64::from(i));
                    passed += usize::from(trace(&system, launch(field, e), system.image(), &mut hits).is_ok());
                }
                assert_eq!(black_box(passed), 1000);
            });
        });
    }
    group.finish();
}

fn render_patch(c: &mut Criterion) {
    let lens = builtin::lens("two_element").expect("shipped");
    let frame = Frame::centred(960, 640, 0.02).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
    let density = SpectralDensity::new(&Sensor::generic());
    let plan = plan(&lens, 1e-3, &frame, &density, Quality::DESIGN, None).expect("plans");
    let scene = Plane {
        texture: generate(SceneKind::DeadLeaves, 1, 400, 400),
        texels_per_slope: 2500.0,
        axis_texel: [0.0, 0.0],
        vergence: 1e-3,
    };
    let region = Region { row: 100, col: 120, rows: 128, cols: 128 };
    let raster = NodeRaster::over(region.grown(plan.margin()), plan.spacing);
    let mut group = c.benchmark_group("render");
    group.sample_size(10);
    group.bench_function("two_element/psf_grid_of_a_patch", |b| {
        b.iter(|| Optics::compute(&lens, 1e-3, &plan, raster).expect("traces").grid.kept);
    });
    let optics = Optics::compute(&lens, 1e-3, &plan, raster).expect("traces");
    group.throughput(Throughput::Elements(128 * 128));
    group.bench_function("two_element/patch_128", |b| {
        b.iter(|| {
            let image = render_region::<f32>(&optics, &plan, &scene, region).image;
            assert!(black_box(image.sum()) > 0.0);
        });
    });
    group.finish();
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    trace_lenses(&mut criterion);
    render_patch(&mut criterion);
    criterion.final_summary();
}
