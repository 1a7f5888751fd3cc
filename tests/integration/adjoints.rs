//! Single adjoints of the trace, each against central differences of its own forward function.

use glam::DVec3;
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::render::light::Light;
use isoplanat::imaging::render::source::{warp, warp_vjp};
use isoplanat::imaging::render::{Renderer, Settings};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::{Aperture, Lens, LensGradient, Shape, builtin, variables::Variables};
use isoplanat::psf::{Model, Optics, OpticsBar, OpticsSpec, Quadrature, SensorPoint};
use isoplanat::testing::{assert_rel, between, central_difference, steady_difference};
use isoplanat::trace::intersect::{intersect, intersect_vjp};
use isoplanat::trace::refract::{refract, refract_vjp};
use isoplanat::trace::system::TraceSurface;
use ndarray::Array3;

fn vector(rng: &mut fastrand::Rng, size: f64) -> DVec3 {
    DVec3::new(between(rng, -size, size), between(rng, -size, size), between(rng, -size, size))
}

/// Normal incidence included: seed 0 has direction and normal on the axis.
#[test]
fn refract_vjp_agrees_with_differences() {
    for seed in 0..100 {
        let rng = &mut fastrand::Rng::with_seed(seed);
        let tilt = if seed == 0 { 0.0 } else { 0.3 };
        let direction = (DVec3::Z + vector(rng, tilt)).normalize();
        let normal = -(DVec3::Z + vector(rng, tilt)).normalize();
        let mu = between(rng, 0.6, 1.2);
        let (bar, d_dot, n_dot, mu_dot) =
            (vector(rng, 1.0), vector(rng, 1.0), vector(rng, 1.0), between(rng, -1.0, 1.0));
        let (d_bar, n_bar, mu_bar) = refract_vjp(direction, normal, mu, bar);
        // The function itself takes any vectors, so the differences need no sphere.
        let f = |h: f64| refract(direction + h * d_dot, normal + h * n_dot, mu + h * mu_dot).expect("passes").dot(bar);
        let pulled = d_bar.dot(d_dot) + n_bar.dot(n_dot) + mu_bar * mu_dot;
        assert_rel(pulled, central_difference(f, 1e-4), 1e-9, 0.1, &format!("seed {seed}"));
    }
}

/// Point and path length at the root, with respect to the ray and to the surface's shape, from planes to aspheres.
#[test]
fn intersect_vjp_agrees_with_differences() {
    for seed in 0..100 {
        let rng = &mut fastrand::Rng::with_seed(seed);
        let asphere = |rng: &mut fastrand::Rng, size: [f64; 2]| {
            if seed % 2 == 0 { vec![] } else { size.iter().map(|a| between(rng, -a, *a)).collect() }
        };
        let curvature = if seed == 0 { 0.0 } else { between(rng, -0.04, 0.04) };
        let shape = Shape::even(curvature, between(rng, -2.0, 0.5), asphere(rng, [1e-3, 2e-6]));
        let shape_dot = Shape::even(between(rng, -0.01, 0.01), between(rng, -0.5, 0.5), asphere(rng, [1e-5, 1e-5]));
        let surface = |h: f64| {
            let moved = Shape::even(
                shape.curvature + h * shape_dot.curvature,
                shape.conic + h * shape_dot.conic,
                shape.asphere.iter().zip(&shape_dot.asphere).map(|(a, b)| a + h * b).collect(),
            );
            TraceSurface::new(moved, 0.0, [1.0, 1.5], 12.0)
        };
        let origin = DVec3::new(between(rng, -6.0, 6.0), between(rng, -6.0, 6.0), between(rng, -9.0, -3.0));
        let direction = (DVec3::Z + vector(rng, 0.25)).normalize();
        // Directions stay unit vectors: the exact conic root counts on it.
        let (o_dot, turn) = (vector(rng, 1.0), vector(rng, 0.2));
        let d_dot = turn - direction * direction.dot(turn);
        let (bar, t_bar) = (vector(rng, 1.0), between(rng, -1.0, 1.0));
        let f = |h: f64| {
            let hit = intersect(&surface(h), origin + h * o_dot, (direction + h * d_dot).normalize()).expect("meets");
            hit.point.dot(bar) + t_bar * hit.t
        };
        let hit = intersect(&surface(0.0), origin, direction).expect("meets");
        let back = intersect_vjp(&hit, direction, bar, t_bar);
        let mut shape_bar = shape.zeros_like();
        shape.at_vjp(hit.point.x, hit.point.y, &hit.local, back.sag, [0.0; 2], &mut shape_bar);
        let pulled = back.origin.dot(o_dot)
            + back.direction.dot(d_dot)
            + shape_bar.curvature * shape_dot.curvature
            + shape_bar.conic * shape_dot.conic
            + shape_bar.asphere.iter().zip(&shape_dot.asphere).map(|(a, b)| a * b).sum::<f64>();
        assert_rel(pulled, central_difference(f, 1e-3), 1e-7, 0.1, &format!("seed {seed}"));
    }
}

/// A lens traced in one colour out to a sensor radius.
fn traced(lens: &Lens, radius_mm: f64) -> Optics {
    let quadrature = Quadrature { nm: vec![lens.wavelengths.primary_nm], weight: vec![vec![1.0]] };
    Optics::compute(lens, &OpticsSpec::even(radius_mm, vec![lens.object_vergence], quadrature)).expect("traces")
}

/// Inside the fitted range and on its linear continuation. The slope is linear in the coefficients, so the pull-back times
/// the coefficients of any map is the slope of that map: exact, where differences would round.
#[test]
fn the_slope_of_a_sensor_radius_pulls_back_exactly() {
    let lens = builtin::lens("two_element").expect("shipped");
    let near = lens.changed(|l| l.object_vergence = 2e-3).expect("a lens");
    let maps = [traced(&lens, 22.0), traced(&near, 22.0)];
    for radius in [0.0, 3.0, 15.0, 22.0, 23.5, 30.0] {
        let mut pulled = vec![0.0; maps[0].maps[0].coefficients.len()];
        maps[0].maps[0].slope_vjp(radius, 1.7, &mut pulled);
        for map in maps.iter().map(|m| &m.maps[0]) {
            let found: f64 = pulled.iter().zip(&map.coefficients).map(|(a, c)| a * c).sum();
            assert_rel(found, 1.7 * map.slope(radius), 1e-12, 1e-3, &format!("{radius} mm"));
        }
    }
}

/// Steps of differences where texels have kinks.
const STEPS: [f64; 8] = [3e-7, 4e-7, 5e-7, 6e-7, 8e-7, 1e-6, 1.2e-6, 1.5e-6];

/// A value of the lens against its pulled-back gradient, along random directions of all its numbers.
fn assert_lens_gradient(lens: &Lens, gradient: &LensGradient, value: impl Fn(&Lens) -> f64, steps: &[f64], tol: f64) {
    let variables = Variables::all(lens);
    let (x, gradient) = (variables.values(lens), variables.gradient(gradient));
    let norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    for seed in 0..6 {
        let rng = &mut fastrand::Rng::with_seed(seed);
        let dx: Vec<f64> = x.iter().map(|_| between(rng, -0.5, 0.5)).collect();
        let pulled: f64 = gradient.iter().zip(&dx).map(|(a, b)| a * b).sum();
        let at = |h: f64| {
            let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
            value(&variables.lens(lens, &moved).expect("a lens"))
        };
        let numeric = steady_difference(|h| central_difference(at, h), steps.iter().copied());
        assert_rel(pulled, numeric, tol, 1e-3 * norm, &format!("{}, direction {seed}", lens.name));
    }
}

/// The fitted map as a whole: its coefficients, and slopes inside and on the continuation.
#[test]
fn the_fitted_map_pulls_back_to_the_lens() {
    for (name, radius) in [("two_element", 20.0), ("cooke_triplet", 17.0), ("phone", 3.2)] {
        let lens = builtin::lens(name).expect("shipped");
        let optics = traced(&lens, radius);
        let map = &optics.maps[0];
        let rng = &mut fastrand::Rng::with_seed(3);
        let bar: Vec<f64> = map.coefficients.iter().map(|_| between(rng, -1.0, 1.0)).collect();
        let (inside, beyond) = (0.6 * radius, 1.2 * radius);
        let mut pulled = OpticsBar::zeros(&optics);
        map.slope_vjp(inside, 0.8, &mut pulled.maps[0]);
        map.slope_vjp(beyond, -1.3, &mut pulled.maps[0]);
        pulled.maps[0].iter_mut().zip(&bar).for_each(|(a, b)| *a += b);
        let gradient = optics.vjp(&lens, &pulled);
        let value = |lens: &Lens| {
            let optics = traced(lens, radius);
            let map = &optics.maps[0];
            let fitted: f64 = map.coefficients.iter().zip(&bar).map(|(c, b)| c * b).sum();
            fitted + 0.8 * map.slope(inside) - 1.3 * map.slope(beyond)
        };
        assert_lens_gradient(&lens, &gradient, value, &[1e-5], 1e-6);
    }
}

/// Kernels, relative illumination and ideal picture, as a renderer reads them.
#[test]
fn what_is_read_from_the_optics_pulls_back_to_the_lens() {
    let lens = builtin::lens("two_element").expect("shipped");
    let frame = Frame::centred(320, 220, 0.02).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
    let region = Region { row: 141, col: 210, rows: 20, cols: 24 };
    let quadrature =
        Quadrature { nm: vec![480.0, 600.0], weight: vec![vec![0.7, 0.3], vec![0.4, 0.6], vec![0.1, 0.9]] };
    let radii_mm = (0..=10).map(|i| frame.max_radius_mm() * f64::from(i) / 10.0).collect();
    let spec = OpticsSpec {
        radii_mm,
        vergences: vec![1e-3],
        quadrature,
        degree: 5,
        lit: false,
        illuminations: 48,
        diffraction: Model::Rays,
    };
    let scene = Plane {
        texture: Array3::from_shape_fn((3, 300, 300), |(c, i, j)| {
            (0.3 + 0.02 * (c + i) as f32 * (0.05 * j as f32).sin()).abs()
        }),
        texels_per_slope: 2500.0,
        axis_texel: [-80.0, -10.0],
        vergence: 1e-3,
    };
    let rng = &mut fastrand::Rng::with_seed(9);
    let [light_bar, truth_bar]: [Array3<f64>; 2] =
        std::array::from_fn(|_| Array3::from_shape_fn((3, 20, 24), |_| rng.f64() - 0.5));
    let kernels_bar: Vec<f64> = (0..3 * 25 * 25).map(|_| rng.f64() - 0.5).collect();
    let place = SensorPoint::along([0.6, 0.8], 5.3);
    let value = |lens: &Lens| {
        let optics = Optics::compute(lens, &spec).expect("traces");
        let light: Array3<f64> = Light::new(&optics, &frame).over(&frame, region, &[0, 1, 2]);
        let truth: Array3<f64> = warp(&scene, &optics.maps[0], &frame, region, &[0, 1, 2]);
        let mut kernels = vec![0.0; kernels_bar.len()];
        optics.kernels(&optics.form(80, 25, 1, 0.02), 0, place, &mut kernels);
        (&light * &light_bar).sum()
            + (&truth * &truth_bar).sum()
            + kernels.iter().zip(&kernels_bar).map(|(a, b)| a * b).sum::<f64>()
    };
    let optics = Optics::compute(&lens, &spec).expect("traces");
    let mut bar = OpticsBar::zeros(&optics);
    Light::new(&optics, &frame).over_vjp(&optics, &frame, region, light_bar.view(), &mut bar);
    warp_vjp(&scene, &optics.maps[0], &frame, region, (&[0, 1, 2], truth_bar.view()), &mut bar.maps[0]);
    let written = |_: usize, to: &mut [f64]| {
        to.copy_from_slice(&kernels_bar);
        true
    };
    for back in optics.kernels_vjp(&optics.form(80, 25, 1, 0.02), 0, &[place], written) {
        bar.add_kernel(&optics, 0, &back);
    }
    assert_lens_gradient(&lens, &optics.vjp(&lens, &bar), value, &STEPS, 1e-6);
}

/// Image, ideal picture and illumination of one region, each with a random cotangent, through `Renderer::vjp` and
/// `Renderer::lens_gradient`: kernels of pixels, of two samples a pixel, and of cells of two pixels; by diffraction far off the axis.
#[test]
fn a_rendered_region_pulls_back_to_the_lens() {
    for (pitch_mm, off, samples, cells, bin, diffraction) in [
        (0.02, 0.0, 1, 64, 1, Model::Rays),
        (0.02, 0.0, 2, 64, 1, Model::Rays),
        (0.02, 0.0, 1, 8, 2, Model::Rays),
        (0.004, 1500.0, 1, 64, 1, Model::Waves),
        (0.004, 1500.0, 1, 64, 1, Model::Approximate),
    ] {
        let mut lens = builtin::lens("two_element").expect("shipped");
        if diffraction.diffracts() {
            lens = lens.changed(|l| l.aperture = Aperture::FNumber(8.0)).expect("closes");
        }
        let frame = Frame::centred(320, 220, pitch_mm).and_then(|f| f.with_axis([-off, -off])).expect("valid");
        let scene = Plane {
            texture: Array3::from_shape_fn((3, 300, 300), |(c, i, j)| {
                let (x, y, k) = (j as f32, i as f32, c as f32 + 1.0);
                0.5 + 0.2 * (0.31 * x + 0.2 * y * k).sin() + 0.2 * (0.17 * x - 0.43 * y / k).cos()
            }),
            texels_per_slope: 50.0 / pitch_mm,
            axis_texel: [-80.0 - off, -10.0 - off],
            vergence: 1e-3,
        };
        let region = Region { row: 141, col: 210, rows: 24, cols: 30 };
        let density = SpectralDensity::new(&Sensor::generic());
        let settings = Settings {
            samples,
            cells,
            diffraction,
            wavelengths: 3,
            dense: 80,
            node_error: 0.2,
            outside: 0.1,
            ..Settings::DESIGN
        };
        let plan = Renderer::planned(&lens, &frame, &density, &[1e-3], settings).expect("plans").plan;
        assert!(plan.depths[0].bin >= bin && (bin > 1 || plan.depths[0].bin == 1), "{}", plan.depths[0].half_width);
        let rng = &mut fastrand::Rng::with_seed(8);
        let bars: [Array3<f64>; 3] = std::array::from_fn(|_| Array3::from_shape_fn((3, 24, 30), |_| rng.f64() - 0.5));
        let value = |lens: &Lens| {
            let r = Renderer::new(lens, &plan).expect("traces").record::<f64>(&scene, 0, region);
            (&r.image * &bars[0]).sum() + (&r.truth * &bars[1]).sum() + (&r.illumination * &bars[2]).sum()
        };
        let here = Renderer::new(&lens, &plan).expect("traces");
        let rendered = here.record::<f64>(&scene, 0, region);
        let [image, truth, illumination] = bars.each_ref().map(|b| b.view());
        let bar = here.vjp(&scene, &rendered, image, truth, illumination);
        let gradient = here.lens_gradient(&lens, &bar);
        assert_lens_gradient(&lens, &gradient, value, &STEPS, 1e-6);
    }
}
