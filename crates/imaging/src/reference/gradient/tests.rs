//! The reference's gradient against differences of the reference itself.

use ndarray::Array3;

use super::super::draw::Texels;
use super::super::pixels::Row;
use super::super::{Sampling, Settings};
use super::*;
use crate::sensor::Sensor;
use isoplanat_base::testing::{assert_rel, between, central_difference};
use isoplanat_optics::lens::Kind;
use isoplanat_optics::lens::{Aperture, builtin, paraxial};

/// The picture in f64, as [`super::super::render`] makes it, with the white level `white`.
fn picture(
    lens: &Lens,
    scene: &Plane,
    frame: &Frame,
    region: Region,
    settings: Settings,
    white: Option<[f64; 3]>,
) -> (Array3<f64>, [f64; 3], u64) {
    let density = SpectralDensity::new(&Sensor::generic());
    let mut tracer = Tracer::new(lens, &density, reach_mm(frame, region), settings).expect("a tracer");
    let own = tracer.rear.axis_irradiance;
    tracer.rear.axis_irradiance = white.unwrap_or(own);
    let prepared = tracer.prepared(region.radii_mm(frame, 0.0));
    let texels = Texels::new(scene, scene.texture.as_slice().expect("standard"));
    let mut image = Array3::zeros((3, region.rows, region.cols));
    let mut passed = 0;
    for i in 0..region.rows {
        let mut row = Row::new(prepared.view(frame, settings.seed), &texels);
        let places: Vec<(usize, usize)> = (0..region.cols).flat_map(|j| (0..3).map(move |c| (c, j))).collect();
        for (channel, j) in &places {
            let (row_number, col) = (region.row + i.cast_signed(), region.col + j.cast_signed());
            row.add(Pixel { row: row_number, col, channel: *channel });
        }
        let values: Vec<f64> = row.finish().map(|(mean, _)| mean).collect();
        places.iter().zip(values).for_each(|((c, j), v)| image[[*c, i, *j]] = v);
        passed += row.tally().passed;
    }
    (image, own, passed)
}

/// Band-limited: the kinks of its bilinear texels are small.
fn smooth_scene(vergence: f64) -> Plane {
    let wave = |c: usize, i: usize, j: usize| {
        let (x, y, k) = (j as f64 / 8.0, i as f64 / 8.0, c as f64 + 1.0);
        0.5 + 0.2 * (0.31 * x * k.sqrt() + 0.2 * y).sin() + 0.2 * (0.17 * x - 0.43 * y / k).cos()
    };
    Plane {
        texture: Array3::from_shape_fn((3, 900, 900), |(c, i, j)| wave(c, i, j) as f32),
        texels_per_slope: 4000.0,
        axis_texel: [100.0, 800.0],
        vergence,
    }
}

#[test]
fn object_slopes_pull_back() {
    let rng = &mut fastrand::Rng::with_seed(1);
    for _ in 0..200 {
        let mut vector = |w: f64| DVec3::new(between(rng, -w, w), between(rng, -w, w), between(rng, -w, w));
        let (p, p_dot, d_dot, bar) = (vector(9.0), vector(1.0), vector(1.0), vector(1.0).truncate());
        let d = vector(0.5) + DVec3::Z;
        for vergence in [0.0, 1e-3, 0.3, -0.1] {
            let (p_bar, d_bar) = object_slope_vjp(p, d, vergence, bar);
            let f = |h: f64| object_slope(p + h * p_dot, d + h * d_dot, vergence).dot(bar);
            let pulled = p_bar.dot(p_dot) + d_bar.dot(d_dot);
            assert_rel(pulled, central_difference(f, 1e-3), 1e-9, 1.0, "object slope");
        }
    }
}

/// The same rays on both sides of a difference: elements before the stop, no ray's clipping changes.
#[test]
fn elements_before_the_stop_agree_with_differences_of_the_renderer() {
    for (name, parameters) in [
        (
            "two_element",
            vec![
                Kind::Curvature.at(0),
                Kind::Conic.at(0),
                Kind::Thickness.at(0),
                Kind::Index.at(0),
                Kind::Abbe.at(0),
                Kind::Curvature.at(1),
                Kind::Conic.at(1),
                Kind::Thickness.at(1),
            ],
        ),
        (
            "cooke_triplet",
            vec![
                Kind::Curvature.at(0),
                Kind::Conic.at(0),
                Kind::Thickness.at(0),
                Kind::Curvature.at(1),
                Kind::Thickness.at(1),
                Kind::Curvature.at(2),
            ],
        ),
    ] {
        let lens = builtin::lens(name).expect("shipped");
        // An entrance pupil of given size would move the stop's edge.
        let stop = paraxial::stop_semi_diameter(&lens);
        let lens = lens.changed(|l| l.aperture = Aperture::StopSemiDiameter(stop)).expect("a lens");
        let density = SpectralDensity::new(&Sensor::generic());
        let frame = Frame::centred(400, 400, 0.02).expect("valid");
        let region = Region { row: 150, col: 240, rows: 6, cols: 6 };
        let scene = smooth_scene(lens.object_vergence);
        // Ellipses and their probe would move with the lens; the rear aperture does not.
        let how = Settings { samples: 128, seed: 5, channels: Channels::All, sampling: Sampling::RearAperture };
        let rng = &mut fastrand::Rng::with_seed(2);
        let bar = Array3::from_shape_fn((3, region.rows, region.cols), |_| rng.f64() - 0.3);
        let gradient = render_vjp(&lens, &scene, &density, &frame, region, how, 1, bar.view()).expect("pulls back");
        // The one pass's own seed.
        let own = Settings { seed: mixed(how.seed, 0), ..how };
        let variables = Variables::new(&lens, parameters);
        let (x, components) = (variables.values(&lens), gradient.components(&variables));
        let (_, white, passed) = picture(&lens, &scene, &frame, region, own, None);
        let norm = components.iter().map(|c| c.mean.abs()).fold(0.0, f64::max);
        for (k, parameter) in variables.parameters.iter().map(|p| p.name(&lens)).enumerate() {
            let f = |h: f64| {
                let mut moved = x.clone();
                moved[k] += h;
                let lens = variables.lens(&lens, &moved).expect("a lens");
                let (image, _, now) = picture(&lens, &scene, &frame, region, own, Some(white));
                assert_eq!(now, passed, "{name} {parameter}: clipping changed");
                (&image * &bar).sum()
            };
            // Kinks of the texels cost as h, rounding as 1/h.
            let numeric = (f(1e-8) - f(-1e-8)) / 2e-8;
            let pulled = components[k].mean;
            eprintln!("{name} {parameter}: {pulled:e} {numeric:e} {:e}", (pulled / numeric - 1.0).abs());
            assert_rel(pulled, numeric, 1e-5, 1e-3 * norm, &format!("{name} {parameter}"));
        }
    }
}

/// What stands behind the stop, where nothing clips but the stop's edge, which a wide-open stop takes away: ray, weight
/// and plane of the rear rim, against differences with the rays held by hand.
#[test]
fn one_ray_agrees_with_differences() {
    let lens = builtin::lens("two_element").expect("shipped");
    let density = SpectralDensity::new(&Sensor::generic());
    let scene = smooth_scene(lens.object_vergence);
    let variables = Variables::all(&lens);
    let x = variables.values(&lens);
    let rear = RearView::new(&lens, &density, 10.0).expect("a view");
    let frame = Frame::centred(400, 400, 0.02).expect("valid");
    let how = Settings { samples: 64, seed: 5, channels: Channels::All, sampling: Sampling::RearAperture };
    let view = View { frame: &frame, rear: &rear, footprints: None, settings: how };
    let systems = Systems::new(&lens, &rear);
    // One ray at a time by a sink that pulls back the first that passes.
    struct One<'a> {
        sums: LensCotangents<'a>,
        found: Option<(DVec2, DVec2, usize, usize, f64)>,
    }
    impl Sink for One<'_> {
        fn take(&mut self, traced: &Waiting) {
            for span in &traced.spans {
                for lane in span.first..span.end {
                    if self.found.is_none() && traced.passed(self.sums.view.rear, lane) {
                        let [p, target] = traced.draw.ends(lane);
                        let colour = traced.tile.colour[lane] as usize;
                        // Weight without n'² cos⁴/Z²: the area.
                        let area = std::f64::consts::PI * self.sums.view.rear.disk_radius.powi(2);
                        self.found = Some((p, target, colour, span.channel, area));
                        self.sums.ray_vjp(traced, lane, span.channel, 0.7);
                    }
                }
            }
        }
    }
    for (row, col) in [(100, 300), (205, 190), (350, 80), (20, 30)] {
        for channel in 0..3 {
            let mut one = One { sums: LensCotangents::new(&scene, &systems, view), found: None };
            let mut stream = Stream::new(view);
            (0..8).for_each(|k| stream.add(Pixel { row: row + k, col, channel }, &mut one));
            stream.finish(&mut one);
            let Some((p, target, colour, channel, area)) = one.found else { panic!("no ray passes at {row}, {col}") };
            let pulled = variables.gradient(&one.sums.into_lens(&lens));
            let nm = systems.nm[colour];
            let value = |lens: &Lens| {
                let mut system = System::new(lens, nm).reversed();
                system.surfaces.remove(0);
                let surface = &system.surfaces[0];
                let z = surface.distance + surface.shape.sag(surface.semi_diameter.powi(2)).expect("reaches").h;
                let offset = (target - p).extend(z);
                let ray = isoplanat_optics::trace::Ray { origin: target.extend(z), direction: offset.normalize() };
                let hit = trace(&system, ray, system.surfaces.len() - 1, &mut Vec::new()).expect("passes");
                let slope = object_slope(hit.at.point, hit.direction, scene.vergence);
                let radiance = scene.sample(channel, scene.texel_from_slope(slope.into())).0;
                let n = surface.index_before;
                0.7 * radiance * area * n * n * z * z / offset.length_squared().powi(2)
            };
            let norm = pulled.iter().map(|v| v.abs()).fold(0.0, f64::max);
            for (k, parameter) in variables.parameters.iter().map(|p| p.name(&lens)).enumerate() {
                let f = |h: f64| {
                    let mut moved = x.clone();
                    moved[k] += h;
                    value(&variables.lens(&lens, &moved).expect("a lens"))
                };
                assert_rel(
                    pulled[k],
                    central_difference(f, 3e-6),
                    1e-6,
                    1e-3 * norm,
                    &format!("{row} {col} {parameter}"),
                );
            }
        }
    }
}

#[test]
fn threads_do_not_change_a_bit_and_passes_average() {
    let lens = builtin::lens("two_element").expect("shipped");
    let density = SpectralDensity::new(&Sensor::generic());
    let frame = Frame::centred(400, 400, 0.02).expect("valid");
    let region = Region { row: 150, col: 240, rows: 5, cols: 4 };
    let scene = smooth_scene(lens.object_vergence);
    let how = Settings { samples: 16, seed: 5, channels: Channels::All, sampling: Sampling::Bounded };
    let bar = Array3::from_shape_fn((3, 5, 4), |(c, i, j)| (c + 2 * i) as f64 - j as f64);
    let run = |threads, passes, seed| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        let how = Settings { seed, ..how };
        pool.install(|| render_vjp(&lens, &scene, &density, &frame, region, how, passes, bar.view())).expect("renders")
    };
    let (one, two) = (run(1, 3, 5), run(2, 3, 5));
    assert_eq!((&one.mean, one.rays), (&two.mean, two.rays));
    // The error that many passes state is that of their mean: two runs differ by it.
    let variables = Variables::refracting(&lens);
    let (a, b) = (run(2, 24, 5).components(&variables), run(2, 24, 6).components(&variables));
    let mut square = 0.0;
    for (a, b) in a.iter().zip(&b) {
        let off = (a.mean - b.mean) / a.standard_error.hypot(b.standard_error);
        assert!(off.abs() < 5.0, "{a:?} {b:?}");
        square += off * off / variables.parameters.len() as f64;
    }
    assert!((0.02..6.0).contains(&square), "{square}");
    assert!(run(2, 1, 5).components(&variables).iter().all(|c| c.standard_error == f64::INFINITY));
}

#[test]
fn bad_requests_are_errors() {
    let lens = builtin::lens("two_element").expect("shipped");
    let density = SpectralDensity::new(&Sensor::generic());
    let frame = Frame::centred(400, 400, 0.02).expect("valid");
    let region = Region { row: 150, col: 240, rows: 2, cols: 2 };
    let scene = smooth_scene(lens.object_vergence);
    let how = Settings { samples: 16, seed: 5, channels: Channels::All, sampling: Sampling::Bounded };
    let refused = |how, passes, bar: &Array3<f64>, expected: &str| {
        let error = render_vjp(&lens, &scene, &density, &frame, region, how, passes, bar.view()).expect_err(expected);
        assert!(error.to_string().contains(expected), "{error}");
    };
    let bar = Array3::ones((3, 2, 2));
    refused(how, 0, &bar, "passes");
    refused(how, 1, &Array3::ones((1, 2, 2)), "(3, 2, 2)");
    refused(how, 1, &(&bar * f64::NAN), "finite");
    refused(Settings { channels: Channels::Bayer(crate::sensor::cfa::Cfa::RGGB), ..how }, 1, &bar, "mosaic");
}
