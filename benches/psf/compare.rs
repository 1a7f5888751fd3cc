//! Ways from rays to a kernel: error against processor time, one thread.

use std::hint::black_box;

use glam::DVec2;
use isoplanat::psf::pupil::{PupilMap, PupilSampling};
use isoplanat::psf::splat::splat;
use isoplanat::trace::System;
use isoplanat::trace::aim::ParaxialPupil;
use isoplanat::trace::launch::FieldPoint;

use crate::cases::{Case, SIZE, Spot, best, pool, random, relative, spiral, summary};
use crate::cells::Cells;
use crate::tables::CONVERGED;

/// Largest side of a cell's part, pixels.
const PART_PX: f64 = 0.7;

pub(crate) fn print() {
    println!("\nWays from rays to one 65 x 65 kernel: relative L2 error (processor time, ms):\n");
    let mut near = Case::new("cooke_triplet");
    // f/5 and 50 mm, object at 2 m: a disc of 40 pixels.
    near.lens.object_vergence = 5e-4;
    let cases = [
        ("two_element, 90 % of the field", Case::new("two_element"), 0.9, 7),
        ("cooke_triplet, half the field", Case::new("cooke_triplet"), 0.5, 7),
        ("phone, 95 % of the field", Case::new("phone"), 0.95, 9),
        ("cooke_triplet, 30 % of the field, object at 2 m", near, 0.3, 5),
    ];
    for (name, case, share, degree) in cases {
        let spot = case.spot(share, case.lens.wavelengths.primary_nm);
        let exact = pool(2).install(|| case.direct(&spiral(CONVERGED), spot));
        pool(1).install(|| ladder(name, &case, spot, degree, &exact));
    }
}

fn ladder(name: &str, case: &Case, spot: Spot, degree: usize, exact: &[f64]) {
    let row = |way: &str, size: String, error: f64, work: &mut dyn FnMut()| {
        println!("| {name} | {way} | {size} | {error:.2e} | {:.3} |", 1e3 * best(3, work).cpu);
    };
    println!("| case | way | size | error | ms |\n|---|---|---|---|---|");
    for count in [256, 1024, 4096, 16_384] {
        let errors: Vec<f64> = (0..5).map(|i| relative(&case.direct(&random(count, i), spot), exact)).collect();
        let points = random(count, 0);
        row("a: random, traced", format!("{count} rays"), summary(&errors).0, &mut || {
            black_box(case.direct(&points, spot));
        });
    }
    for count in [256, 1024, 4096, 16_384] {
        let points = spiral(count);
        row("b: spiral, traced", format!("{count} rays"), relative(&case.direct(&points, spot), exact), &mut || {
            black_box(case.direct(&points, spot));
        });
    }
    for dense in [100, 300, 1000, 3000, 10_000, 30_000] {
        let sampling = PupilSampling::new(degree, dense);
        let size = format!("degree {degree}, {dense} points");
        row("c: polynomial", size, relative(&polynomial(case, &sampling, spot), exact), &mut || {
            black_box(polynomial(case, &sampling, spot));
        });
    }
    for (rings, sectors) in [(4, 6), (6, 10), (10, 16), (16, 26), (26, 40)] {
        let cells = Cells::new(degree, rings, sectors, PART_PX);
        let size = format!("degree {degree}, 2 x {rings} x {sectors} cells");
        row("d: cells", size, relative(&by_cells(case, &cells, spot), exact), &mut || {
            black_box(by_cells(case, &cells, spot));
        });
    }
}

fn map(case: &Case, sampling: &PupilSampling, spot: Spot) -> PupilMap {
    let system = System::new(&case.lens, spot.nm);
    let field = FieldPoint { slope: DVec2::new(0.0, spot.slope), vergence: case.lens.object_vergence };
    PupilMap::compute(&system, ParaxialPupil::new(&case.lens), sampling, field).expect("traces")
}

fn place(case: &Case, map: &PupilMap, spot: Spot) -> Vec<[f64; 2]> {
    let pixel = |(x, y): (&f64, &f64)| [x / case.pitch_mm, (y - spot.radius_mm) / case.pitch_mm];
    map.x.iter().zip(&map.y).map(pixel).collect()
}

fn polynomial(case: &Case, sampling: &PupilSampling, spot: Spot) -> Vec<f64> {
    let map = map(case, sampling, spot);
    let mut kernel = vec![0.0; SIZE * SIZE];
    for (u, w) in place(case, &map, spot).iter().zip(&map.weight) {
        splat(&mut kernel, SIZE, *u, *w);
    }
    let total: f64 = map.weight.iter().sum();
    kernel.iter_mut().for_each(|v| *v /= total);
    kernel
}

fn by_cells(case: &Case, cells: &Cells, spot: Spot) -> Vec<f64> {
    let map = map(case, &cells.sampling, spot);
    let mut kernel = vec![0.0; SIZE * SIZE];
    let (total, _) = cells.splat(&map, &place(case, &map, spot), &mut kernel, SIZE);
    kernel.iter_mut().for_each(|v| *v /= total);
    kernel
}
