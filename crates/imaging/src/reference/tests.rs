//! The reference renderer against closed forms and against rays from the object.

mod stiff;
mod tilted;

use glam::{DVec2, DVec3};
use ndarray::{Array3, s};

use super::*;
use crate::sensor::Sensor;
use isoplanat_optics::lens::{Aperture, Medium, Shape, Surface, builtin, unchecked};
use isoplanat_optics::trace::lanes::{Options, Rays, trace_batch};
use isoplanat_optics::trace::{ObjectPoint, Ray, System};

fn white(vergence: f64) -> Plane {
    Plane { texture: Array3::ones((1, 1, 1)), texels_per_slope: 1.0, axis_texel: [0.5, 0.5], vergence }
}

/// Smooth colour waves of a few pixels' period.
fn waves(vergence: f64) -> Plane {
    let texture = Array3::from_shape_fn((3, 300, 400), |(c, i, j)| {
        let (x, y) = (i as f32 * 0.5, j as f32 * 0.3 + c as f32);
        0.5 + 0.25 * x.sin() + 0.2 * y.cos()
    });
    Plane { texture, texels_per_slope: 400.0, axis_texel: [200.0, 150.0], vergence }
}

fn settings(samples: usize) -> Settings {
    Settings { samples, seed: 3, channels: Channels::All, sampling: Sampling::Bounded }
}

fn density() -> SpectralDensity {
    SpectralDensity::new(&Sensor::generic())
}

/// A hole of `radius` mm, `distance` mm before the sensor.
fn pinhole(radius: f64, distance: f64) -> Lens {
    let shape = Shape::default();
    let hole = Surface { shape, thickness: distance, medium: Medium::Air, semi_diameter: radius, pose: None };
    unchecked(&builtin::lens("two_element").expect("shipped"), |l| {
        (l.surfaces, l.stop, l.aperture) = (vec![hole], 0, Aperture::StopSemiDiameter(radius));
    })
}

/// Irradiance of a disk of radiance 1 and radius `a` at the distance `z` and the offset `r` (P. D. Foote, 1915).
fn disk_irradiance(a: f64, z: f64, r: f64) -> f64 {
    // π/2 (1 − (S − 2a²)/q), q² = S² − 4a²r², without its cancellation.
    let sum = r * r + z * z + a * a;
    let q = (sum * sum - 4.0 * a * a * r * r).sqrt();
    std::f64::consts::TAU * a * a * z * z / (q * (q + sum - 2.0 * a * a))
}

/// Mean and standard error of a picture's pixels.
fn mean_of(rendered: &Rendered) -> (f64, f64) {
    let n = rendered.mean.len() as f64;
    let mean = rendered.mean.iter().map(|v| f64::from(*v)).sum::<f64>() / n;
    (mean, rendered.noise_rms() / n.sqrt())
}

#[test]
fn a_hole_obeys_the_closed_form_of_a_disk_source() {
    for (radius, distance) in [(1e-4, 50.0), (0.05, 50.0), (5.0, 30.0), (20.0, 30.0)] {
        let lens = pinhole(radius, distance);
        let frame = Frame::centred(4000, 20, 0.02).expect("valid");
        for sampling in [Sampling::Bounded, Sampling::RearAperture] {
            for col in [1998, 2500, 3996] {
                let region = Region { row: 8, col, rows: 4, cols: 4 };
                let how = Settings { sampling, ..settings(64) };
                let got = render(&lens, &white(0.0), &density(), &frame, region, how, None).expect("renders");
                let (mean, error) = mean_of(&got);
                let r = (col as f64 + 2.0 - 2000.0) * 0.02;
                let on_axis = disk_irradiance(radius, distance, 0.0);
                assert!((got.axis_irradiance[1] / on_axis - 1.0).abs() < 1e-9, "{} {on_axis}", got.axis_irradiance[1]);
                let expected = disk_irradiance(radius, distance, r) / on_axis;
                // The patch of 80 µm is curved by less than 1e-6.
                assert!((mean - expected).abs() < 5.0 * error + 2e-6, "{radius} {r}: {mean} {expected} ± {error}");
                assert_eq!(got.outside, 0, "{radius} {r}");
                if radius < 0.1 {
                    let cos = distance / r.hypot(distance);
                    assert!((mean - cos.powi(4)).abs() < 5.0 * error + 1e-5, "cos⁴ at {r}: {mean}");
                }
            }
        }
    }
}

/// One bright texel: its light lands where rays from the object land, and as much of it.
#[test]
fn a_bright_texel_lands_where_rays_from_the_object_land() {
    for name in ["two_element", "three_element", "cooke_triplet", "phone"] {
        for (right, up) in [(0.11, 0.07), (-0.05, 0.12)] {
            let lens = builtin::lens(name).expect(name);
            let vergence = lens.object_vergence;
            let spacing = 2e-3;
            let mut texture = Array3::zeros((1, 5, 5));
            texture[[0, 2, 2]] = 1.0;
            // The bright texel's centre (2.5, 2.5) lies at the slope (right, up).
            let axis_texel = [2.5 - right / spacing, 2.5 + up / spacing];
            let scene = Plane { texture, texels_per_slope: 1.0 / spacing, axis_texel, vergence };
            // Rays from the object: an even grid of the first vertex plane, weight N⁴ (see `ObjectPoint::from_slope`).
            let channel = 1;
            let (mut flux, mut moment, mut spread) = (0.0, DVec2::ZERO, 0.0f64);
            let (cells, waves) = (400, 12);
            let half = 1.2 * lens.surfaces[0].semi_diameter;
            let cell = 2.0 * half / f64::from(cells);
            let mut landings = Vec::new();
            for k in 0..waves {
                let nm = density().sample(channel, (f64::from(k) + 0.5) / f64::from(waves));
                let system = System::new(&lens, nm);
                let at = |i: i32| (f64::from(i) + 0.5) * cell - half;
                // The object at (right, up) has its rays run the other way: slope −(right, up).
                let object = ObjectPoint::from_slope(-DVec2::new(right, up), vergence);
                let launched: Rays = (0..cells * cells)
                    .map(|i| Ray::from_object(object, DVec3::new(at(i % cells), at(i / cells), 0.0)))
                    .collect();
                let mut landed = launched.clone();
                let status = trace_batch(&system, &mut landed, Options { clip: true, ..Options::default() });
                for i in (0..launched.len()).filter(|i| status[*i].is_none()) {
                    let weight = launched.n[i].powi(4) * cell * cell / f64::from(waves);
                    let end = landed.ray(i).origin.truncate();
                    flux += weight;
                    moment += weight * end;
                    landings.push(end);
                }
            }
            let centroid = moment / flux;
            landings.iter().for_each(|p| spread = spread.max((*p - centroid).length()));
            // A tent of radiance has the integral spacing².
            let flux = flux * spacing * spacing;
            // From the sensor: a region around the centroid that holds all of it.
            let focal = centroid.length() / right.hypot(up);
            let frame = Frame::centred(1, 1, (spread + 2.5 * spacing * focal) / 16.0).expect("valid");
            let pixel = frame.pixel_from_sensor_mm(centroid.into());
            let reach = 18isize;
            let side = (2 * reach).cast_unsigned();
            let region = Region {
                row: pixel[1].floor() as isize - reach,
                col: pixel[0].floor() as isize - reach,
                rows: side,
                cols: side,
            };
            // One channel at every pixel.
            let how = Settings { channels: Channels::Bayer(Cfa([1; 4])), ..settings(1024) };
            // An object to the right and up is shown to the right and up.
            assert!((pixel[0] > frame.axis_px[0]) == (right > 0.0) && (pixel[1] < frame.axis_px[1]) == (up > 0.0));
            let got = render(&lens, &scene, &density(), &frame, region, how, None).expect("renders");
            let (mut total, mut variance, mut m, mut m_var) = (0.0, 0.0, [0.0; 2], [0.0; 2]);
            for i in 0..side {
                for j in 0..side {
                    let v = f64::from(got.mean[[0, i, j]]);
                    let e = f64::from(got.variance[[0, i, j]]);
                    let centre = [(region.col + j as isize) as f64 + 0.5, (region.row + i as isize) as f64 + 0.5];
                    total += v;
                    variance += e;
                    for a in 0..2 {
                        let offset = centre[a] - pixel[a];
                        m[a] += offset * v;
                        m_var[a] += offset * offset * e;
                    }
                }
            }
            let flux_got = total * got.axis_irradiance[channel] * frame.pitch_mm.powi(2);
            let flux_error = variance.sqrt() / total;
            // Edge cells of the grid from the object: below 1e-3 of the flux.
            let ratio = flux_got / flux - 1.0;
            assert!(ratio.abs() < 5.0 * flux_error + 1e-3, "{name} flux: {ratio:e} ± {flux_error:e}");
            assert!(flux_error < 2e-3, "{name} flux error {flux_error}");
            for a in 0..2 {
                let (off, error) = (m[a] / total, m_var[a].sqrt() / total);
                assert!(off.abs() < 5.0 * error + 0.02, "{name} centroid: {off} ± {error} pixels");
                assert!(error < 0.05, "{name} centroid error {error} pixels");
            }
            assert_eq!(got.outside, 0, "{name}");
        }
    }
}

#[test]
fn both_samplings_agree_within_their_confidence() {
    for name in ["two_element", "cooke_triplet", "phone"] {
        let lens = builtin::lens(name).expect(name);
        let frame = Frame::centred(400, 300, lens.sensor.radius_mm() / 250.0).expect("valid");
        for (row, col) in [(140, 190), (20, 30), (0, 380)] {
            let region = Region { row, col, rows: 16, cols: 16 };
            let scene = waves(lens.object_vergence);
            let run = |sampling, samples, seed| {
                let how = Settings { sampling, seed, ..settings(samples) };
                render(&lens, &scene, &density(), &frame, region, how, None).expect("renders")
            };
            let (bounded, plain) = (run(Sampling::Bounded, 256, 1), run(Sampling::RearAperture, 2048, 2));
            assert_eq!(bounded.outside, 0, "{name}: the probe missed rays");
            let ((a, ea), (b, eb)) = (mean_of(&bounded), mean_of(&plain));
            let error = ea.hypot(eb);
            assert!((a - b).abs() < 5.0 * error && error < 0.05 * b, "{name} {row} {col}: {a} {b} ± {error}");
            // Pixel by pixel: χ² of the difference in units of the estimated variance.
            let difference: f64 = (&bounded.mean - &plain.mean).iter().map(|d| f64::from(*d).powi(2)).sum();
            let expected: f64 = bounded.variance.iter().chain(&plain.variance).map(|v| f64::from(*v)).sum();
            let ratio = difference / expected;
            // (Where only one plain ray in a thousand passes, the estimated variances are too ragged for it.)
            assert!((0.8..1.2).contains(&ratio) || plain.passed * 100 < plain.rays, "{name} {row} {col}: {ratio}");
        }
    }
}

#[test]
fn the_probe_misses_nothing_over_whole_frames() {
    for (name, _) in builtin::LENSES {
        let lens = builtin::lens(name).expect(name);
        let frame = Frame::centred(480, 360, lens.sensor.radius_mm() / 300.0).expect("valid");
        let region = Region { row: 0, col: 0, rows: 360, cols: 480 };
        let how = Settings { channels: Channels::Bayer(Cfa::RGGB), ..settings(4) };
        let got = render(&lens, &white(lens.object_vergence), &density(), &frame, region, how, None).expect("renders");
        assert_eq!(got.outside, 0, "{name}");
        // The ellipse is tight: of the rays in it (all but one a pixel) most pass.
        let inside = got.rays - 480 * 360;
        assert!(got.passed * 10 > inside * 8, "{name}: {} of {inside} pass", got.passed);
        assert!(got.mean.iter().all(|v| v.is_finite() && *v >= 0.0), "{name}");
    }
}

#[test]
fn threads_and_regions_do_not_change_a_bit() {
    let lens = builtin::lens("two_element").expect("shipped");
    let frame = Frame::centred(64, 48, 0.2).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
    let all = Region { row: 0, col: 0, rows: 48, cols: 64 };
    let how = Settings { channels: Channels::Bayer(Cfa::GRBG), ..settings(8) };
    let run = |threads, region, how| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| render(&lens, &waves(1e-3), &density(), &frame, region, how, None)).expect("renders")
    };
    let (one, two) = (run(1, all, how), run(2, all, how));
    assert_eq!((&one.mean, &one.variance, one.rays, one.passed), (&two.mean, &two.variance, two.rays, two.passed));
    let part = run(2, Region { row: 11, col: 7, rows: 20, cols: 30 }, how);
    assert_eq!(part.mean, one.mean.slice(s![.., 11..31, 7..37]));
    // A mosaic's pixel is that channel of the full rendering.
    let full = run(2, all, settings(8));
    for ((r, c), v) in one.mosaic().indexed_iter() {
        assert_eq!(*v, full.mean[[Cfa::GRBG.channel(r, c), r, c]]);
    }
}

#[test]
fn no_light_and_bad_requests_are_errors() {
    let lens = builtin::lens("two_element").expect("shipped");
    let frame = Frame::centred(100, 100, 0.02).expect("valid");
    let region = Region { row: 0, col: 0, rows: 4, cols: 4 };
    let refused = |lens: &Lens, scene: &Plane, region, how, expected: &str| {
        let error = render(lens, scene, &density(), &frame, region, how, None).expect_err(expected);
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(expected), "{error}");
    };
    // Far outside the image circle.
    let far = Region { row: 500_000, col: 0, rows: 2, cols: 2 };
    refused(&lens, &white(0.0), far, settings(8), "no rays reach the sensor");
    let closed = unchecked(&lens, |l| l.aperture = Aperture::StopSemiDiameter(f64::NAN));
    refused(&closed, &white(0.0), region, settings(8), "no rays reach the sensor");
    let touching = unchecked(&lens, |l| l.surfaces[4].thickness = 0.0);
    refused(&touching, &white(0.0), region, settings(8), "room before the sensor");
    refused(&lens, &white(0.0), region, settings(1), "2 or more");
    refused(&lens, &white(0.0), Region { rows: 0, ..region }, settings(8), "at least one pixel");
    let empty = Plane { texture: Array3::ones((2, 4, 4)), ..white(0.0) };
    refused(&lens, &empty, region, settings(8), "1 or 3 channels");
}

#[test]
fn halves_are_independent_and_progress_ends_at_one() {
    let lens = builtin::lens("two_element").expect("shipped");
    let frame = Frame::centred(40, 30, 0.2).expect("valid");
    let region = Region { row: 0, col: 0, rows: 30, cols: 40 };
    let last = std::sync::Mutex::new(0.0f64);
    let progress = |done: f64| {
        let mut last = last.lock().expect("not poisoned");
        *last = last.max(done);
    };
    let [a, b] =
        render_halves(&lens, &waves(1e-3), &density(), &frame, region, settings(32), Some(&progress)).expect("renders");
    assert_eq!(*last.lock().expect("not poisoned"), 1.0);
    let fine = render(&lens, &waves(1e-3), &density(), &frame, region, Settings { seed: 99, ..settings(512) }, None)
        .expect("renders");
    // The noises of the halves are uncorrelated, and as large as they say.
    let product = halves::unbiased_mse(fine.mean.view(), a.mean.view(), b.mean.view());
    let agreement = halves::psnr_against_halves(fine.mean.view(), &[a.clone(), b.clone()]);
    assert!((product - fine.noise_rms().powi(2)).abs() < 4.0 * agreement.standard_error, "{agreement:?}");
    let off =
        |r: &Rendered| (&r.mean - &fine.mean).iter().map(|d| f64::from(*d).powi(2)).sum::<f64>() / r.mean.len() as f64;
    let expected = a.noise_rms().powi(2) + fine.noise_rms().powi(2);
    assert!((off(&a) / expected - 1.0).abs() < 0.15, "{} {expected}", off(&a));
}

/// Rays a second, and the noise of a 960 × 640 Bayer capture. Run with `--ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
fn measure_a_capture() {
    let lens = builtin::lens("two_element").expect("shipped");
    let frame = Frame::centred(960, 640, 0.02).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
    let region = Region { row: 0, col: 0, rows: 640, cols: 960 };
    for sampling in [Sampling::Bounded, Sampling::RearAperture] {
        let how = Settings { channels: Channels::Bayer(Cfa::RGGB), sampling, ..settings(64) };
        for (name, scene) in [("white", white(1e-3)), ("waves", waves(1e-3))] {
            let r = render(&lens, &scene, &density(), &frame, region, how, None).expect("renders");
            eprintln!(
                "{name} {sampling:?}: {:.2} s, {:.2} Mray/s, passed {:.3}, outside {}, noise {:.5}, mean {:.4}",
                r.seconds,
                r.rays as f64 / r.seconds * 1e-6,
                r.passed as f64 / r.rays as f64,
                r.outside,
                r.noise_rms(),
                mean_of(&r).0,
            );
        }
    }
}
