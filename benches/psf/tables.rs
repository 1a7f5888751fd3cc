//! The tables of `benches/results/psf.md` on error and speed.

use crate::cases::{Case, SAMPLINGS, Seconds, best, pool, random, relative, spiral, summary};

/// Rays of the converged kernels.
const CONVERGED: usize = 1 << 17;

pub(crate) fn print() {
    // One table alone, where it is named.
    let named = |name: &str| std::env::args().any(|a| a == name);
    if !named("speed") {
        errors();
    }
    if !named("error") {
        speed();
    }
}

fn errors() {
    println!("Relative L2 error of a kernel, root mean square (worst) over 3 fields x 3 wavelengths:\n");
    println!("| lens | degree | dense points | error |\n|---|---|---|---|");
    for case in Case::all() {
        let spots = case.spots();
        let points = spiral(CONVERGED);
        let finest = case.optics(9);
        let exact: Vec<Vec<f64>> = spots.iter().map(|s| case.direct(&finest, &points, *s)).collect();
        let errors: Vec<f64> = (0u64..)
            .zip(spots.iter().zip(&exact))
            .map(|(i, (s, k))| relative(&case.direct(&finest, &random(4096, i), *s), k))
            .collect();
        let (rms, worst) = summary(&errors);
        println!("| {} | 4096 random rays | | {rms:.2e} ({worst:.1e}) |", case.name);
        for degree in [3, 5, 7, 9] {
            let optics = case.optics(degree);
            for dense in [100, 200, 300, 600, 1000, 2000, 3000] {
                let of = |(s, k): (&crate::cases::Spot, &Vec<f64>)| relative(&case.kernel(&optics, dense, *s), k);
                let (rms, worst) = summary(&spots.iter().zip(&exact).map(of).collect::<Vec<f64>>());
                println!("| {} | {degree} | {dense} | {rms:.2e} ({worst:.1e}) |", case.name);
            }
        }
    }
}

fn speed() {
    println!("\nKernels of 65 x 65 pixels a second, two threads: by the clock (by processor time of both):\n");
    println!("| lens | degree, dense points | traced radii | forward | forward + adjoint |\n|---|---|---|---|---|");
    for (case, (_, degree, dense)) in Case::all().iter().zip(SAMPLINGS) {
        for (degree, dense) in [(degree, dense), (7, 4096)] {
            let grid = case.grid(degree, dense);
            let count = grid.kernels() as f64;
            pool(2).install(|| {
                let forward = best(6, || assert!(grid.forward() > 0.0));
                let both = best(6, || assert!(grid.both().is_finite()));
                let rate = |s: Seconds| format!("{:.0} ({:.0})", count / s.wall, 2.0 * count / s.cpu);
                let (radii, forward, both) = (grid.radii(), rate(forward), rate(both));
                println!("| {} | {degree}, {dense} | {radii} | {forward} | {both} |", case.name);
            });
        }
    }
}
