use std::f64::consts::{PI, TAU};

use glam::{DMat2, DVec2};
use isoplanat_base::testing::{assert_abs, assert_rel, central_difference, steady_difference};
use rustfft::num_complex::Complex;

use super::fitted::{Bars, Fitted};
use super::functions::{ODD_STOP, PATH, STOP};
use super::raster::Sampling;
use super::*;
use crate::lens::builtin;
use crate::lens::variables::Variables;
use crate::psf::fit::{Evaluation, Of, Parity};
use crate::psf::kernel::KernelForm;
use crate::psf::splat::Raster;
use crate::psf::stop::Part;
use crate::psf::{Optics, OpticsBar, OpticsSpec, Quadrature, SensorMap};

mod extreme;
mod open;
mod point_spread;
mod wide;

const NM: f64 = 550.0;

fn traced(name: &str, f_number: Option<f64>, radius_mm: f64, vergence: f64) -> (Lens, Optics) {
    let mut lens = builtin::lens(name).expect("shipped");
    if let Some(n) = f_number {
        lens = lens.changed(|l| l.aperture = crate::lens::Aperture::FNumber(n)).expect("closes");
    }
    let quadrature = Quadrature { nm: vec![NM], weight: vec![vec![1.0]] };
    let spec = OpticsSpec { degree: 12, ..OpticsSpec::even(radius_mm, vec![vergence], quadrature) };
    let optics = Optics::compute(&lens, &spec).expect("traces");
    (lens, optics)
}

/// `J₁(x)/x`, by its series and integral: Bessel's own, `J₁(x) = 1/π ∫ cos(t − x sin t) dt`.
fn jinc(x: f64) -> f64 {
    if x.abs() < 1e-6 {
        return 0.5;
    }
    let n = 400;
    let at = |k: i32| {
        let t = PI * (f64::from(k) + 0.5) / f64::from(n);
        (t - x * t.sin()).cos()
    };
    (0..n).map(at).sum::<f64>() / f64::from(n) / x
}

/// What a pixel gets of a scene sample `t` pixels away: the pixel's box on the sample's tent.
fn pixel_on_tent(t: f64) -> f64 {
    let a = t.abs();
    if a < 0.5 {
        0.75 - t * t
    } else if a < 1.5 {
        0.5 * (1.5 - a).powi(2)
    } else {
        0.0
    }
}

/// A perfect lens: the Airy pattern under pixel and tent, to 1e-4 of its peak; its first dark ring; its encircled energy of 83.8 %.
#[test]
fn a_perfect_lens_has_the_airy_pattern() {
    let (wavelength, na) = (5e-4, 0.1);
    let pupil = Pupil::perfect(wavelength, na, 0.0);
    // Cells of a twelfth of λ/NA.
    let cell = wavelength / na / 12.0;
    let raster = Raster { size: 121, samples: 1 };
    let mut kernel = vec![0.0; raster.len()];
    let spread = pupil.kernel([0.6, 0.8], raster, cell, &mut kernel);
    let density = |x: f64, y: f64| {
        let v = TAU * na / wavelength * x.hypot(y);
        (2.0 * jinc(v)).powi(2) * PI * (na / wavelength).powi(2)
    };
    // The pixel's box on the tent of the scene, by points between.
    let fine = 6;
    let weight = |k: i32| pixel_on_tent(f64::from(k) / f64::from(fine));
    let value = |i: usize, j: usize| {
        let (y, x) = ((i as f64 - 60.0) * cell, (j as f64 - 60.0) * cell);
        let reach = 3 * fine / 2;
        let step = cell / f64::from(fine);
        let mut sum = 0.0;
        for (a, b) in (-reach..=reach).flat_map(|a| (-reach..=reach).map(move |b| (a, b))) {
            sum += weight(a) * weight(b) * density(x + f64::from(b) * step, y + f64::from(a) * step);
        }
        sum * step * step
    };
    let peak = value(60, 60);
    for (i, j) in
        [(60, 60), (60, 61), (63, 62), (60, 67), (65, 65), (60, 73), (52, 70), (60, 90), (100, 30), (110, 110)]
    {
        assert_abs(kernel[i * 121 + j], value(i, j), 1e-4 * peak, &format!("({i}, {j})"));
    }
    let within = |radius: f64| {
        let inside = |k: &usize| ((k / 121) as f64 - 60.0).hypot((k % 121) as f64 - 60.0) <= radius;
        (0..kernel.len()).filter(inside).map(|k| kernel[k]).sum::<f64>()
    };
    let airy = 0.609_834_9 * 12.0;
    let (inner, outer) = (within(airy), within(airy + 0.02));
    eprintln!(
        "spread {spread:.1e}, within the first ring {inner:.4} to {outer:.4}, sum {}",
        kernel.iter().sum::<f64>()
    );
    assert!((inner - 0.838).abs() < 6e-3, "{inner}");
    assert!(spread < 1e-2, "{spread}");
    // The dark ring is where the pattern has its least along a line; pixel and tent move it a little.
    let dark = |line: &dyn Fn(usize) -> f64| {
        let k = (4..12).min_by(|a, b| line(*a).total_cmp(&line(*b))).expect("some");
        let [a, b, c] = [line(k - 1), line(k), line(k + 1)];
        k as f64 + 0.5 * (a - c) / (a - 2.0 * b + c)
    };
    let (found, exact) = (dark(&|k| kernel[60 * 121 + 60 + k]), dark(&|k| value(60, 60 + k)));
    assert!((found / exact - 1.0).abs() < 1e-3 && (exact / airy - 1.0).abs() < 0.1, "{found} {exact} {airy}");
}

/// Transfer functions: the kernel's, pixel and tent divided out, of a round pupil in and out of focus against the integral over its overlap (Hopkins).
#[test]
fn transfer_functions_are_those_of_a_round_pupil() {
    let (wavelength, na) = (5e-4, 0.1);
    for waves in [0.0, 0.5, 2.0, 10.0] {
        let pupil = Pupil::perfect(wavelength, na, waves);
        let cell = wavelength / na / 5.0;
        let raster = Raster { size: 401, samples: 1 };
        let mut kernel = vec![0.0; raster.len()];
        pupil.kernel([1.0, 0.0], raster, cell, &mut kernel);
        let sinc = |x: f64| if x == 0.0 { 1.0 } else { (PI * x).sin() / (PI * x) };
        for share in [0.05, 0.1, 0.25, 0.5, 0.75] {
            let frequency = share * 2.0 * na / wavelength;
            let mut found = 0.0;
            for (k, v) in kernel.iter().enumerate() {
                let x = (k % 401) as f64 - 200.0;
                found += v * (TAU * frequency * cell * x).cos();
            }
            found /= sinc(frequency * cell) * sinc(frequency * cell).powi(2);
            // Overlap of unit circles 2s apart, phase 2π W (ρ₁² − ρ₂²) = 2π W · 4 s x.
            let n = 4000;
            let half = |x: f64| (1.0 - (x.abs() + share).powi(2)).max(0.0).sqrt();
            let at = |k: i32| {
                let x = (1.0 - share) * (2.0 * (f64::from(k) + 0.5) / f64::from(n) - 1.0);
                2.0 * half(x) * (TAU * waves * 4.0 * share * x).cos()
            };
            let exact = (0..n).map(at).sum::<f64>() * 2.0 * (1.0 - share) / f64::from(n) / PI;
            assert_abs(found, exact, 1e-3, &format!("{waves} waves at {share} of the cutoff"));
        }
    }
}

/// Displacement of the ray through a point of the stop, mm: where the path is stationary.
fn displacement(pupil: &Pupil, s: DVec2) -> DVec2 {
    let [even, odd] = &pupil.functions.fitted.halves;
    let at = |tau: DVec2, p: usize, coefficients: &[f64]| {
        let Fitted { degree, middle, half, .. } = pupil.functions.fitted;
        let at = Evaluation::new(&[(tau - middle) / half], degree, [Parity::Even, Parity::Odd][p]);
        let [value, x, y] = [Of::Value, Of::X, Of::Y].map(|of| at.at(of, coefficients)[0]);
        (value, DVec2::new(x, y) / pupil.functions.fitted.half)
    };
    let mut tau = pupil.functions.fitted.middle;
    for _ in 0..20 {
        let (x, y) = (at(tau, 1, &odd.coefficients[ODD_STOP]), at(tau, 0, &even.coefficients[STOP]));
        let jacobian = DMat2::from_cols(x.1, y.1).transpose();
        tau += jacobian.inverse() * (s - DVec2::new(x.0, y.0));
    }
    at(tau, 0, &even.coefficients[PATH]).1
}

/// Where paths are stationary, rays land: displacements are those of geometric kernels, near and far, axis to corner.
#[test]
fn stationary_paths_are_rays() {
    for (name, radius, vergence) in
        [("double_gauss", 7.5, 0.0), ("double_gauss", 7.5, 2e-3), ("phone", 3.2, 0.0), ("two_element", 20.0, 1e-3)]
    {
        let (lens, optics) = traced(name, None, radius, vergence);
        let optics = optics.diffracting(&lens, Model::Waves).expect("traces");
        let form = optics.form(120, 3, 1, 0.01);
        for share in [0.0, 0.4, 0.9] {
            let point = SensorPoint::along([0.0, 1.0], share * radius);
            let pupil = optics.pupil(0, 0, point).expect("light");
            let rays = form.rays(optics.table(), &optics.maps[0], 0, point);
            let (mut worst, mut far) = (0.0f64, 0.0f64);
            for (q, s) in form.points.points.iter().enumerate().filter(|(q, _)| rays.share[*q] > 0.0) {
                let moved = DVec2::new(rays.x[q], rays.y[q]);
                worst = worst.max((displacement(&pupil, *s) - moved).length());
                far = far.max(moved.length());
            }
            let waves = pupil.residual_waves;
            eprintln!("{name} {vergence} {share}: {worst:.2e} of {far:.2e} mm, residual {waves:.1e} waves");
            // What the path's residual does to its slope.
            let slack = 60.0 * waves * pupil.wavelength_mm / pupil.aperture_half();
            assert!(worst < 5e-3 * far + slack, "{name} {vergence} {share}: {worst:e} of {far:e} mm");
        }
    }
}

/// A wavelet that leaves the plane of the paraxial entrance pupil: where, with what path behind it, and its amplitude times its share of the pupil.
struct Wavelet {
    entrance: DVec2,
    path: f64,
    amplitude: f64,
}

/// A ray: its crossing of that plane, its path, its cosines, whether it is clear.
type Traced = (DVec2, f64, DVec2, bool);

/// Wavelets of rays traced one by one through points of the unit stop, of equal areas over all of it; those that an aperture stops have none. No polynomials.
fn wavelets(lens: &Lens, optics: &Optics, radius_mm: f64, count: i32) -> Vec<Wavelet> {
    let view = SensorView::new(&System::new(lens, NM));
    let (at, stop) = (DVec2::new(0.0, radius_mm), view.system.stop_semi_diameter);
    let map = &optics.maps[0];
    let behind = entrance_pupil(lens);
    let far = |e: DVec2, y: DVec2| to_object(map, behind, e, y);
    let origin = DVec2::new(0.0, radius_mm);
    // Where a ray through `s` crosses, with what path and cosines, and whether it is clear.
    let ray = |s: DVec2| {
        let mut hits = Vec::new();
        let cosines = view.aim(at, s * stop, None, &mut hits).ok()?;
        let ray = view.follow(at, cosines, &mut hits).ok()?;
        let clear = hits
            .iter()
            .zip(&view.system.surfaces)
            .enumerate()
            .skip(1)
            .all(|(k, (h, of))| k == view.system.stop || h.at.point.truncate().length() <= of.semi_diameter);
        let last = hits.last()?;
        let (at, drawn) = (ray.entrance + behind * ray.slope, behind * (1.0 + ray.slope.length_squared()).sqrt());
        Some((at, last.optical_path - last.at.point.z / last.direction.z - drawn, cosines, clear))
    };
    let tau = |e: DVec2| {
        let step = 1e-4;
        let by = |d: DVec2| (far(e, origin + step * d) - far(e, origin - step * d)) / (2.0 * step);
        DVec2::new(by(DVec2::X), by(DVec2::Y))
    };
    let area = PI / f64::from(count * count);
    let mut out = Vec::new();
    for i in 0..count {
        // Rings of equal area, as many points in each.
        let rho = ((f64::from(i) + 0.5) / f64::from(count)).sqrt();
        for j in 0..count {
            let s = rho * DVec2::from_angle(TAU * (f64::from(j) + 0.5 * f64::from(i % 2)) / f64::from(count));
            let Some((entrance, path, _, true)) = ray(s) else { continue };
            let step = 1e-4;
            let pairs = [DVec2::X, DVec2::Y].map(|d| [ray(s + step * d), ray(s - step * d)]);
            let [[Some(a), Some(b)], [Some(c), Some(d)]] = pairs else { continue };
            let columns = |f: &dyn Fn(&Traced) -> DVec2| {
                DMat2::from_cols(f(&a) - f(&b), f(&c) - f(&d)).determinant().abs() / (4.0 * step * step)
            };
            let (light, of_tau) = (columns(&|r| r.2), columns(&|r| tau(r.0)));
            out.push(Wavelet { entrance, path, amplitude: (light * of_tau).sqrt() * area });
        }
    }
    out
}

/// How far behind the first vertex the paraxial entrance pupil lies, mm.
fn entrance_pupil(lens: &Lens) -> f64 {
    crate::lens::paraxial::first_order(lens, lens.wavelengths.primary_nm).entrance_pupil_position
}

/// Path from a crossing of the plane `behind` the first vertex to the object that the sensor coordinates `y` show, less what all have.
fn to_object(map: &SensorMap, behind: f64, e: DVec2, y: DVec2) -> f64 {
    let [ux, uy] = map.slopes(y.to_array(), 1.0);
    let u = DVec2::new(ux, uy);
    if map.vergence == 0.0 {
        return e.dot(u) / (1.0 + u.length_squared()).sqrt();
    }
    let object = (-u / map.vergence).extend(-1.0 / map.vergence);
    (e.extend(behind) - object).length() - (object - DVec2::ZERO.extend(behind)).length()
}

/// Kernels against wavelets summed at each object point: axis and field, near and far, open and vignetted; 1e-3 of the peak.
#[test]
fn kernels_are_sums_of_wavelets() {
    const SIDE: usize = 13;
    let mut worst_of_all = 0.0f64;
    for (name, f_number, radius, vergence, share) in [
        ("double_gauss", Some(8.0), 7.5, 0.0, 0.0),
        ("double_gauss", Some(8.0), 7.5, 0.0, 0.9),
        ("double_gauss", None, 7.5, 5e-5, 0.6),
        ("double_gauss", Some(16.0), 7.5, 1e-3, 0.6),
        ("cooke_triplet", Some(16.0), 18.0, 0.0, 0.9),
        ("phone", None, 3.2, 0.0, 0.8),
        ("phone", Some(5.6), 3.2, 0.0, 0.4),
        // 47 degrees off the axis.
        ("hologon", Some(11.0), 17.0, 0.0, 0.95),
    ] {
        let (lens, optics) = traced(name, f_number, radius, vergence);
        let at = share * radius;
        let optics = optics.diffracting(&lens, Model::Waves).expect("traces");
        let pupil = optics.pupil(0, 0, SensorPoint::along([0.0, 1.0], at)).expect("light");
        let raster = Raster { size: SIDE, samples: 1 };
        let cell = NM * 1e-6 / pupil.aperture_half() / 3.0;
        let mut kernel = vec![0.0; raster.len()];
        let spread = pupil.kernel([0.0, 1.0], raster, cell, &mut kernel);
        let (from, behind) = (wavelets(&lens, &optics, at, 120), entrance_pupil(&lens));
        let k = TAU / (NM * 1e-6);
        let middle = from.iter().map(|w| w.path).sum::<f64>() / from.len() as f64;
        let density = |d: DVec2| {
            let y = DVec2::new(0.0, at) - d;
            let sum: Complex<f64> = from
                .iter()
                .map(|w| {
                    let phase = k * (w.path - middle + to_object(&optics.maps[0], behind, w.entrance, y));
                    Complex::from_polar(w.amplitude, phase)
                })
                .sum();
            sum.norm_sqr()
        };
        let fine = 4;
        let n = 6 * fine + 6;
        let step = cell / f64::from(fine);
        let side = usize::try_from(2 * n + 1).expect("small");
        let densities: Vec<f64> = (0..side * side)
            .into_par_iter()
            .map(|q| {
                let [i, j] = [q / side, q % side].map(|v| v as f64 - f64::from(n));
                // With the direction (0, 1) columns run against the meridian's x.
                density(DVec2::new(-j * step, i * step))
            })
            .collect();
        let weight = |v: i32| pixel_on_tent(f64::from(v) / f64::from(fine));
        // Light of the whole: ∫|U|² = λ² ∫ a² dτ, here of W ds.
        let view = optics.illumination().at(SensorPoint::along([0.0, 1.0], at))[0];
        let unit = (NM * 1e-6).powi(2) * view;
        let (mut worst, mut peak) = (0.0f64, 0.0f64);
        for (q, found) in kernel.iter().enumerate() {
            let [i, j] = [q / SIDE, q % SIDE].map(|v| (i32::try_from(v).expect("small") - 6) * fine + n);
            let mut sum = 0.0;
            for (a, b) in (-6..=6).flat_map(|a| (-6..=6).map(move |b| (a, b))) {
                let at = usize::try_from((i + a) * (2 * n + 1) + j + b).expect("inside");
                sum += weight(a) * weight(b) * densities[at];
            }
            let exact = sum * step * step / unit;
            (worst, peak) = (worst.max((exact - found).abs()), peak.max(exact));
        }
        let off = worst / peak;
        eprintln!(
            "{name} {f_number:?} {vergence} at {share}: {off:.1e} of the peak {peak:.3}; residual {:.1e} waves, spread {spread:.1e}",
            pupil.residual_waves
        );
        worst_of_all = worst_of_all.max(off);
    }
    assert!(worst_of_all < 1e-3, "{worst_of_all:e} of the peak");
}

/// The pull-back of a kernel's loss to the functions' values and places, the raster held, against differences: a pupil with aberrations that an aperture and the border of
/// what is known cut.
#[test]
fn kernel_vjp_agrees_with_differences() {
    let rng = &mut fastrand::Rng::with_seed(11);
    for part in [Part::WHOLE, Part::between([-0.7, 0.9])] {
        let nodes = part.nodes(6);
        let of = |f: &dyn Fn(&DVec2) -> f64| nodes.iter().map(f).collect::<Vec<f64>>();
        let (wavelength, na) = (5e-4, 0.12);
        let square = |s: &DVec2| s.length_squared();
        let even = vec![
            of(&|s| wavelength * (1.3 * square(s) - 0.8 * square(s).powi(2) + 0.4 * s.y * square(s))),
            of(&|s| na * (s.y + 0.05 * s.x * s.x)),
            of(&|s| s.y),
            of(&|s| 1.0 - (s.x * s.x + (s.y - 0.35).powi(2)) / 1.1),
        ];
        let odd = vec![of(&|s| na * s.x * (1.0 + 0.04 * s.y)), of(&|s| s.x)];
        let tau: Vec<DVec2> = nodes.iter().map(|s| na * *s * (1.0 + 0.03 * s.y) + DVec2::new(0.0, 0.01)).collect();
        let made = |tau: &[DVec2], values: &Bars| {
            Pupil::of(wavelength, part, 6, (tau.to_vec(), values.clone()), None).expect("spans an area")
        };
        let values: Bars = [even, odd];
        let pupil = made(&tau, &values);
        let outward = [0.6, 0.8];
        let (raster, cell) = (Raster { size: 15, samples: 2 }, 2.5e-3);
        let period = pupil.period(15.0 * cell);
        let sampling = Sampling::new(&pupil.functions, outward, period);
        let bar: Vec<f64> = (0..raster.len()).map(|_| rng.f64() - 0.5).collect();
        let loss = |pupil: &Pupil| {
            let mut kernel = vec![0.0; raster.len()];
            pupil.made_at(sampling.clone(), raster, cell, &mut kernel);
            kernel.iter().zip(&bar).map(|(a, b)| a * b).sum::<f64>()
        };
        let mut kernel = vec![0.0; raster.len()];
        let forward = pupil.made_at(sampling.clone(), raster, cell, &mut kernel).expect("light");
        let mut bars = pupil.functions.fitted.no_bars();
        pupil.kernel_vjp(&forward, &kernel, &bar, &mut bars);
        let (of_values, of_nodes) = pupil.functions.fitted.vjp(&bars);
        for j in [0, 5, 17, 30, nodes.len() - 1] {
            for (p, k) in [(0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1)] {
                let scale = if k == 0 && p == 0 { wavelength } else { na };
                let moved = |h: f64| {
                    let mut values = values.clone();
                    values[p][k][j] += h * scale;
                    loss(&made(&tau, &values))
                };
                let expected = central_difference(moved, 1e-5);
                assert_rel(of_values[p][k][j] * scale, expected, 1e-6, 1e-3, &format!("{part:?} {p} {k} {j}"));
            }
            for axis in [DVec2::X, DVec2::Y] {
                let moved = |h: f64| {
                    let mut tau = tau.clone();
                    tau[j] += h * na * axis;
                    loss(&made(&tau, &values))
                };
                let expected = central_difference(moved, 1e-5);
                assert_rel(of_nodes[j].dot(axis) * na, expected, 1e-6, 1e-3, &format!("{part:?} place {j}"));
            }
        }
    }
}

/// From kernels of all colours at points near and far to every number of the lens, against differences: to 1e-3 of the number, or 1e-6 of all where it is small.
#[test]
fn kernels_by_diffraction_pull_back_to_the_lens() {
    let rng = &mut fastrand::Rng::with_seed(12);
    for (name, f_number, radius, vergence, cell, model) in [
        ("two_element", Some(8.0), 10.0, 0.0, 3e-3, Model::Waves),
        ("cooke_triplet", Some(11.0), 15.0, 1e-3, 4e-3, Model::Waves),
        ("phone", None, 2.6, 0.0, 1.1e-3, Model::Waves),
        ("two_element", Some(8.0), 10.0, 0.0, 3e-3, Model::Approximate),
        ("cooke_triplet", Some(11.0), 15.0, 1e-3, 4e-3, Model::Approximate),
    ] {
        let mut lens = builtin::lens(name).expect("shipped");
        if let Some(n) = f_number {
            lens = lens.changed(|l| l.aperture = crate::lens::Aperture::FNumber(n)).expect("closes");
        }
        let weight = vec![vec![0.3, 0.7], vec![0.9, 0.1]];
        let quadrature = Quadrature { nm: vec![480.0, 600.0], weight };
        let spec = OpticsSpec { degree: 12, ..OpticsSpec::even(radius, vec![vergence], quadrature) };
        let traced =
            |lens: &Lens| Optics::compute(lens, &spec).and_then(|o| o.diffracting(lens, model)).expect("traces");
        let optics = traced(&lens);
        // Of many rays: where one goes from cell to cell, a kernel of rays has a kink.
        let dense = if model == Model::Approximate { 4000 } else { 400 };
        let form = KernelForm { keeps_light: true, ..optics.form(dense, 15, 2, cell) };
        let points = [SensorPoint::at([0.3 * radius, 0.2 * radius]), SensorPoint::at([-0.1 * radius, 0.85 * radius])];
        let len = form.channels() * form.raster.len();
        // Smooth weights: a loss of pixels here and there would show rasters' errors.
        let (a, b) = (rng.f64(), rng.f64());
        let weights: Vec<f64> = (0..len)
            .map(|q| {
                let q = q % form.raster.len();
                let [i, j] = [q / 30, q % 30].map(|v| v as f64 - 14.5);
                (0.4 * i + a).sin() + (0.3 * j + b).cos() * 0.7 + 0.02 * i * j / 5.0
            })
            .collect();
        let loss = |optics: &Optics| {
            let each = optics
                .kernels_each(&form, 0, &points, |_, k, _| k.iter().zip(&weights).map(|(a, b)| a * b).sum::<f64>());
            each.iter().sum::<f64>()
        };
        let mut bar = OpticsBar::zeros(&optics);
        let fill = |_: usize, out: &mut [f64]| {
            out.copy_from_slice(&weights);
            true
        };
        for back in optics.kernels_vjp(&form, 0, &points, fill) {
            bar.add_kernel(&optics, 0, &back);
        }
        let variables = Variables::all(&lens);
        let (x, pulled) = (variables.values(&lens), variables.gradient(&optics.vjp(&lens, &bar)));
        let size = pulled.iter().map(|v| v * v).sum::<f64>().sqrt();
        let mut worst = 0.0f64;
        for k in 0..x.len() {
            // As far as the loss changes by a thousandth.
            let step: f64 = f64::min(1e-3 / pulled[k].abs().max(1e-9), 1e-5);
            let moved = |h: f64| {
                let mut moved = x.clone();
                moved[k] += h;
                loss(&traced(&variables.lens(&lens, &moved).expect("a lens")))
            };
            // Rays that go from cell to cell make kinks: the step at which differences stand still.
            let expected = match model {
                Model::Approximate => {
                    steady_difference(|h| central_difference(moved, h), (0..6).map(|p| 0.1 * step * 1.6f64.powi(p)))
                }
                _ => central_difference(moved, step),
            };
            worst = worst.max((pulled[k] - expected).abs() / expected.abs().max(1e-3 * size));
        }
        eprintln!("{name} {model:?}: {} numbers, worst {worst:.1e}", x.len());
        assert!(worst < 1e-3, "{name} {model:?}: {worst:e}");
    }
}
