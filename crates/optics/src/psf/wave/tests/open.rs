//! Kernels of rays convolved with the diffraction of the open pupil.

use glam::DVec2;

use super::super::*;
use crate::psf::convolved::Convolution;
use crate::psf::stop::Part;
use crate::psf::wave::fitted::Bars;
use isoplanat_base::testing::{assert_abs, assert_rel, central_difference};

/// The transfer function of a round pupil, of one that an aperture cuts along a chord, and of an ellipse, against closed forms and counting.
#[test]
fn the_open_pupil_has_its_transfer_function() {
    let (wavelength, na) = (5e-4, 0.1);
    let round = |f: f64| 2.0 / std::f64::consts::PI * (f.acos() - f * (1.0 - f * f).sqrt());
    let open = Pupil::perfect(wavelength, na, 3.0).open([0.6, 0.8]).expect("light");
    let mut worst = 0.0f64;
    for (k, turn) in [(1, 0.1), (2, 1.3), (5, 0.0), (10, 2.2), (17, 0.7), (25, 1.0), (33, 3.0)] {
        let part = f64::from(k) / 34.0;
        let at = 2.0 * na * part * DVec2::from_angle(turn);
        worst = worst.max((open.at(at) - round(part)).abs());
    }
    eprintln!("round: {worst:.1e}");
    assert!(worst < 1e-3, "{worst:e}");
    assert!(open.at(DVec2::new(2.1 * na, 0.0)).abs() < 1e-3);
    assert_abs(open.at(DVec2::new(0.05, 0.03)), open.at(DVec2::new(-0.05, -0.03)), 1e-12, "even");
    // Cut by a circle as large, two thirds of a radius away: what is left, moved over itself, by counting.
    let nodes = Part::WHOLE.nodes(4);
    let of = |f: &dyn Fn(&DVec2) -> f64| nodes.iter().map(f).collect::<Vec<f64>>();
    let clip = of(&|s| 1.0 - s.x * s.x - (s.y - 0.66).powi(2));
    let even = vec![of(&|_| 0.0), of(&|s| na * s.y), of(&|s| s.y), clip];
    let odd = vec![of(&|s| na * s.x), of(&|s| s.x)];
    let tau: Vec<DVec2> = nodes.iter().map(|s| na * *s).collect();
    let cut = Pupil::of(wavelength, Part::WHOLE, 4, (tau, [even, odd]), None).expect("an area");
    let open = cut.open([0.0, 1.0]).expect("light");
    let clear = |s: DVec2| s.length() < 1.0 && (s - DVec2::new(0.0, 0.66)).length() < 1.0;
    let count = |by: DVec2| {
        let n = 600;
        let each = (0..n * n).filter(|q| {
            let s = DVec2::new(f64::from(q % n), f64::from(q / n)) * (2.0 / f64::from(n)) - 1.0;
            clear(s - 0.5 * by) && clear(s + 0.5 * by)
        });
        each.count() as f64
    };
    // Along the meridian rows run, across it columns, against its x.
    for by in [DVec2::new(0.0, 0.3), DVec2::new(0.5, 0.0), DVec2::new(0.4, 0.2), DVec2::new(-0.7, 0.3)] {
        let expected = count(by) / count(DVec2::ZERO);
        assert_abs(open.at(na * DVec2::new(-by.x, by.y)), expected, 2e-3, &format!("cut {by}"));
    }
}

/// One ray, convolved, against the kernel of a perfect lens by waves.
#[test]
fn a_ray_becomes_a_perfect_lens() {
    let (wavelength, na) = (5e-4, 0.1);
    let (pupil, mut worst) = (Pupil::perfect(wavelength, na, 0.0), 0.0f64);
    // A lone ray's cells alias where they are small beside what bends; rays of a blur cancel that.
    for (cells, samples, limit) in [(0.25, 1, 3e-2), (0.5, 1, 4e-2), (1.0, 1, 1e-2), (2.0, 2, 5e-3), (4.0, 1, 2e-3)] {
        let cell = cells * wavelength / na;
        let raster = Raster { size: 41, samples };
        let mut right = vec![0.0; raster.len()];
        pupil.kernel([1.0, 0.0], raster, cell, &mut right);
        let mut found = vec![0.0; raster.len()];
        raster.splat(&mut found, &[(0, 1.0)], std::iter::once(([0.0; 2], 1.0)));
        Convolution::new(&pupil, [1.0, 0.0], raster, cell).expect("light").convolve(&mut found, wavelength);
        let peak = right.iter().copied().fold(0.0, f64::max);
        let off = right.iter().zip(&found).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / peak;
        eprintln!("cells of {cells} λ/NA, {samples} samples: {off:.1e} of the peak");
        worst = worst.max(off / limit);
    }
    assert!(worst < 1.0, "{worst} times the limit");
}

/// The pull-back of a convolved plane: to the plane by dot products, to the pupil's values and places by differences.
#[test]
fn convolve_vjp_and_open_vjp_agree_with_differences() {
    let rng = &mut fastrand::Rng::with_seed(4);
    let nodes = Part::WHOLE.nodes(6);
    let of = |f: &dyn Fn(&DVec2) -> f64| nodes.iter().map(f).collect::<Vec<f64>>();
    let (wavelength, na) = (5e-4, 0.12);
    let clip = of(&|s| 1.0 - (s.x * s.x + (s.y - 0.35).powi(2)) / 1.1);
    let even = vec![of(&|_| 0.0), of(&|s| na * (s.y + 0.05 * s.x * s.x)), of(&|s| s.y), clip];
    let odd = vec![of(&|s| na * s.x * (1.0 + 0.04 * s.y)), of(&|s| s.x)];
    let tau: Vec<DVec2> = nodes.iter().map(|s| na * *s * (1.0 + 0.03 * s.y)).collect();
    let values: Bars = [even, odd];
    let made = |tau: &[DVec2], values: &Bars| {
        Pupil::of(wavelength, Part::WHOLE, 6, (tau.to_vec(), values.clone()), None).expect("spans an area")
    };
    let pupil = made(&tau, &values);
    let (outward, raster, cell) = ([0.6, 0.8], Raster { size: 15, samples: 2 }, 2.5e-3);
    let random = |rng: &mut fastrand::Rng| (0..raster.len()).map(|_| rng.f64() - 0.5).collect::<Vec<f64>>();
    let (plane, bar) = (random(rng), random(rng));
    let convolved = |pupil: &Pupil, plane: &[f64]| {
        let mut out = plane.to_vec();
        Convolution::new(pupil, outward, raster, cell).expect("light").convolve(&mut out, 1.1 * wavelength);
        out
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let convolution = Convolution::new(&pupil, outward, raster, cell).expect("light");
    let (mut pulled, mut open, mut bars) = (bar.clone(), convolution.no_bar(), PupilBars::zeros(&pupil));
    convolution.convolve_vjp(&plane, 1.1 * wavelength, &mut pulled, &mut open);
    let other = random(rng);
    assert_rel(dot(&pulled, &other), dot(&bar, &convolved(&pupil, &other)), 1e-10, 1e-6, "plane");
    convolution.open_vjp(&pupil, &open, &mut bars);
    let (of_values, of_nodes) = pupil.functions.fitted.vjp(&bars.0);
    let loss = |pupil: &Pupil| dot(&convolved(pupil, &plane), &bar);
    for j in [0, 5, 17, 30, nodes.len() - 1] {
        for (p, k) in [(0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1)] {
            let scale = if k == 0 && p == 0 { wavelength } else { na };
            let moved = |h: f64| {
                let mut values = values.clone();
                values[p][k][j] += h * scale;
                loss(&made(&tau, &values))
            };
            let expected = central_difference(moved, 1e-5);
            assert_rel(of_values[p][k][j] * scale, expected, 1e-6, 1e-3, &format!("{p} {k} {j}"));
        }
        for axis in [DVec2::X, DVec2::Y] {
            let moved = |h: f64| {
                let mut tau = tau.clone();
                tau[j] += h * na * axis;
                loss(&made(&tau, &values))
            };
            let expected = central_difference(moved, 1e-5);
            assert_rel(of_nodes[j].dot(axis) * na, expected, 1e-6, 1e-3, &format!("place {j}"));
        }
    }
}
