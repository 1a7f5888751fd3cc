//! Lenses with tilts, decentres and freeform terms, met from the sensor.

use glam::{DVec2, DVec3};
use ndarray::s;

use super::super::rear::RearView;
use super::*;
use isoplanat_base::testing::assert_abs;
use isoplanat_optics::lens::pose::{Element, Pose};
use isoplanat_optics::lens::{Xy, Zernike};
use isoplanat_optics::trace::Ray;
use isoplanat_optics::trace::lanes::Tile;
use isoplanat_optics::trace::sequential::trace;

/// All surfaces of a lens moved as one, about its first vertex.
fn moved(lens: &Lens, pose: Pose) -> Lens {
    let last = lens.surfaces.len() - 1;
    lens.changed(|l| l.elements.push(Element { first: 0, last, pose, pivot: 0.0 })).expect("a lens")
}

/// The same light within the noise: χ² of the difference pixel by pixel, and the mean.
fn agree(a: &Rendered, b: &Rendered, what: &str) {
    let ((x, ex), (y, ey)) = (mean_of(a), mean_of(b));
    assert!((x - y).abs() < 5.0 * ex.hypot(ey), "{what}: {x} {y} ± {}", ex.hypot(ey));
    let difference: f64 = (&a.mean - &b.mean).iter().map(|d| f64::from(*d).powi(2)).sum();
    let expected: f64 = a.variance.iter().chain(&b.variance).map(|v| f64::from(*v)).sum();
    let ratio = difference / expected;
    assert!((0.8..1.25).contains(&ratio), "{what}: {ratio}");
    for (p, q) in a.axis_irradiance.iter().zip(b.axis_irradiance) {
        // White of a lens without symmetry: straight lines between wavelengths.
        assert_abs(p / q, 1.0, 2e-5, what);
    }
}

/// A lens turned about its axis is itself; one that is shifted as a whole, before objects far away, is itself over a sensor that is shifted the other way.
#[test]
fn a_lens_that_is_turned_or_shifted_is_itself_elsewhere() {
    for name in ["two_element", "cooke_triplet"] {
        let lens = builtin::lens(name).and_then(|l| l.changed(|l| l.object_vergence = 0.0)).expect(name);
        let frame = Frame::centred(400, 300, lens.sensor.radius_mm() / 250.0).expect("valid");
        let region = Region { row: 30, col: 60, rows: 24, cols: 24 };
        let scene = waves(0.0);
        let run = |lens: &Lens, frame: &Frame, seed| {
            let how = Settings { seed, ..settings(256) };
            render(lens, &scene, &density(), frame, region, how, None).expect("renders")
        };
        let plain = run(&lens, &frame, 1);
        let turned = moved(&lens, Pose { tilt: [0.0, 0.0, 0.7], ..Pose::default() });
        agree(&plain, &run(&turned, &frame, 2), &format!("{name} turned"));
        // (The axial point then looks through the lens from the side: white there is another.)
        let by = [0.4, -0.25];
        let shifted = run(&moved(&lens, Pose { decentre: by, ..Pose::default() }), &frame, 3);
        // The lens frame's x is to the left on the sensor, its y downwards.
        let axis = [frame.axis_px[0] - by[0] / frame.pitch_mm, frame.axis_px[1] + by[1] / frame.pitch_mm];
        let over = run(&lens, &frame.clone().with_axis(axis).expect("finite"), 4);
        let brighter = over.axis_irradiance[1] / shifted.axis_irradiance[1];
        assert!((brighter - 1.0).abs() < 2e-3, "{name}: {brighter}");
        let as_bright = |r: &Rendered, by: f64| Rendered {
            mean: r.mean.mapv(|v| v * by as f32),
            axis_irradiance: over.axis_irradiance,
            ..r.clone()
        };
        agree(&over, &as_bright(&shifted, 1.0 / brighter), &format!("{name} shifted"));
    }
}

/// Rays through tilted, shifted and freeform surfaces, met from the sensor, traced forward from where they left: they land where they came from. Shares
/// of light lost to the ellipses of the upright twin are small, and light comes out the same without ellipses.
#[test]
fn rays_from_the_sensor_are_rays_from_the_object() {
    let lens = builtin::lens("two_element").and_then(|l| {
        l.changed(|l| {
            l.surfaces[0].pose = Some(Pose { decentre: [0.05, -0.1], tilt: [0.004, -0.002, 0.1] });
            l.surfaces[1].shape.xy = Some(Xy::new(12.0, &[(1, 2, 0.002)]));
            l.surfaces[4].shape.zernike = Some(Zernike::new(20.0, vec![0.0, 0.0, 0.0, 0.003]));
            l.elements.push(Element {
                first: 3,
                last: 4,
                pose: Pose { decentre: [0.1, 0.15], tilt: [-0.006, 0.003, 0.0] },
                pivot: 2.0,
            });
        })
    });
    let lens = lens.expect("a lens");
    assert!(!lens.is_symmetric());
    let rear = RearView::new(&lens, &density(), 12.0).expect("a view");
    let forward = System::new(&lens, rear.wavelengths_nm()[400]);
    let colour = rear.at(400);
    let (rng, mut tile, mut hits) = (&mut fastrand::Rng::with_seed(5), Tile::new(), Vec::new());
    let mut met = 0;
    for _ in 0..400 {
        let p = DVec2::new(rng.f64() - 0.5, rng.f64() - 0.5) * 16.0;
        let target = DVec2::from_angle(rng.f64() * 6.3) * rear.disk_radius * rng.f64();
        tile.resize(1);
        tile.rays.set(0, rear.ray(p, target, colour).1);
        tile.colour[0] = colour.number;
        rear.program.trace_tile(&mut tile);
        if !rear.passed(&tile, 0) {
            continue;
        }
        // From the sensor z runs the other way, from the first vertex.
        let Ray { origin, direction } = tile.rays.ray(0);
        let back = Ray {
            origin: DVec3::new(origin.x, origin.y, -origin.z),
            direction: DVec3::new(-direction.x, -direction.y, direction.z),
        };
        let hit = trace(&forward, back, forward.image(), &mut hits).expect("arrives");
        assert_abs((hit.at.point.truncate() - p).length(), 0.0, 1e-9, "where it came from");
        met += 1;
    }
    assert!(met > 10, "{met}");
    let frame = Frame::centred(400, 300, 0.04).expect("valid");
    let region = Region { row: 200, col: 290, rows: 16, cols: 16 };
    let run = |sampling, samples, seed| {
        let how = Settings { sampling, seed, ..settings(samples) };
        render(&lens, &waves(1e-3), &density(), &frame, region, how, None).expect("renders")
    };
    let (bounded, plain) = (run(Sampling::Bounded, 256, 1), run(Sampling::RearAperture, 2048, 2));
    assert!(bounded.outside * 20_000 < bounded.passed, "{} of {}", bounded.outside, bounded.passed);
    agree(&bounded, &plain, "with and without ellipses");
    // It is not what the upright lens shows.
    let upright =
        render(&lens.upright().expect("a lens"), &waves(1e-3), &density(), &frame, region, settings(256), None);
    let off = (&upright.expect("renders").mean - &bounded.mean).mapv(f32::abs).slice(s![1, .., ..]).mean();
    assert!(off.expect("pixels") > 0.02, "{off:?}");
}

/// One tracer for many pictures makes those that are made each for itself, and refuses places that it does not know.
#[test]
fn one_tracer_serves_many_pictures() {
    let lens =
        moved(&builtin::lens("two_element").expect("shipped"), Pose { decentre: [0.1, 0.0], tilt: [0.01, 0.0, 0.0] });
    let frame = Frame::centred(60, 40, 0.1).expect("valid");
    let scene = Plane {
        texture: Array3::from_shape_fn((3, 60, 60), |(c, i, j)| ((i * (c + 1) + j) % 7) as f32 / 7.0),
        texels_per_slope: 400.0,
        axis_texel: [30.0; 2],
        vergence: lens.object_vergence,
    };
    let settings = Settings { samples: 8, seed: 5, channels: Channels::All, sampling: Sampling::Bounded };
    let tracer =
        Tracer::new(&lens, &density(), frame.max_radius_mm(), Settings { seed: 99, ..settings }).expect("a tracer");
    for (row, seed) in [(2, 5), (30, 6)] {
        let region = Region { row, col: 10, rows: 4, cols: 7 };
        let own =
            render(&lens, &scene, &density(), &frame, region, Settings { seed, ..settings }, None).expect("renders");
        let shared = tracer.render(&scene, &frame, region, seed, None).expect("renders");
        assert_eq!((own.mean, own.variance, own.rays), (shared.mean, shared.variance, shared.rays));
    }
    let beyond = Region { row: 300, col: 10, rows: 2, cols: 2 };
    let error = tracer.render(&scene, &frame, beyond, 1, None).expect_err("beyond").to_string();
    assert!(error.contains("mm from it"), "{error}");
    let one =
        Tracer::new(&lens, &density(), 1.0, Settings { samples: 1, ..settings }).expect_err("one ray").to_string();
    assert!(one.contains("2 or more"), "{one}");
}
