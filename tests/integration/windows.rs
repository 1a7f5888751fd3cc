//! Windows follow the PSF: no setting loses the light of a wide blur.

use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::render::{Channels, Renderer, Settings};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::builtin;
use isoplanat::psf::table::chief_slopes;
use ndarray::Array3;

/// Stock lenses far outside their field, and far out of focus, at 6 µm: blurs of hundreds of pixels. Settings of training, design
/// and evaluation show the same mean of a grey wall, that of white times its radiance, to the share they may leave outside.
#[test]
fn wide_blurs_keep_their_light() {
    for (name, slope, distance) in
        [("al2550_a", 0.4, 1000.0), ("ac254_050_a", 0.35, 1000.0), ("ac254_050_a", 0.05, 500.0)]
    {
        let lens = builtin::lens(name).expect("shipped");
        let v = 1.0 / distance;
        // The place that sees this slope.
        let radii: Vec<f64> = (1..=400).map(|i| 0.1 * f64::from(i)).collect();
        let slopes = chief_slopes(&lens, v, &radii).expect("light");
        let radius = radii[slopes.partition_point(|s| *s < slope).min(slopes.len() - 1)];
        let pitch = 0.006;
        let corner = (radius / pitch / 2f64.sqrt()).round();
        let frame = Frame::centred(128, 128, pitch).and_then(|f| f.with_axis([-corner, -corner])).expect("valid");
        let whole = Region { row: 0, col: 0, rows: 128, cols: 128 };
        let scene = Plane {
            texture: Array3::from_elem((3, 8, 8), 0.45),
            texels_per_slope: 10.0,
            axis_texel: [4.0, 4.0],
            vergence: v,
        };
        let density = SpectralDensity::new(&Sensor::generic());
        for settings in
            [Settings::DESIGN, Settings::TRAINING, Settings { outside: 1e-3, cells: 64, ..Settings::TRAINING }]
        {
            let renderer = Renderer::planned(&lens, &frame, &density, &[v], settings).expect("plans");
            let (image, _) = renderer.picture::<f32>(&scene, 0, whole, &Channels::from_scene(&scene), &|_| {});
            let light: Array3<f32> = renderer.light.over(&frame, whole, &[0, 1, 2]);
            let mean = |a: &Array3<f32>| a.iter().map(|v| f64::from(*v)).sum::<f64>() / a.len() as f64;
            let share = mean(&image) / (0.45 * mean(&light));
            let depth = &renderer.plan.depths[0];
            eprintln!(
                "{name} at {slope}, {distance} mm: {share:.4} of the light in {} cells of {} pixels",
                depth.size(),
                depth.bin
            );
            assert!((share - 1.0).abs() <= settings.outside + 1e-4, "{name}: {share}");
        }
    }
}

/// Pairs for training, captures for evaluation and patches of a design show the same light: the mean of a region at 26.5°,
/// 500 mm and 6 µm, where a blur is hundreds of pixels wide. Before a grey wall it is white's times the wall's; developed, it is
/// the wall's.
#[cfg(feature = "train")]
#[test]
fn captures_for_training_evaluation_and_design_have_equal_means() {
    use isoplanat::design::chain::{Patch, forward};
    use isoplanat::design::evaluate::FINENESS;
    use isoplanat::design::training::pairs::{Augmentation, cut, render_pair};
    use isoplanat::imaging::develop::simulate::Electronics;
    use isoplanat::imaging::scene::{SceneKind, generate};
    use isoplanat::imaging::sensor::cfa::Cfa;
    use isoplanat::imaging::sensor::noise::Noise;

    const SIDE: usize = 96;
    let mean = |a: &mut dyn Iterator<Item = f32>| {
        let (sum, n) = a.fold((0.0, 0.0), |(s, n), v| (s + f64::from(v), n + 1.0));
        sum / n
    };
    let electronics = Electronics { cfa: Cfa::RGGB, noise: Noise::NONE, neutral: [0.55, 1.0, 0.7] };
    for name in ["al2550_a", "ac254_050_a"] {
        let lens = builtin::lens(name).expect("shipped");
        let (v, pitch, slope) = (1.0 / 500.0, 0.006, 26.5f64.to_radians().tan());
        let radii: Vec<f64> = (1..=400).map(|i| 0.1 * f64::from(i)).collect();
        let slopes = chief_slopes(&lens, v, &radii).expect("light");
        let k = slopes.partition_point(|s| *s < slope).min(slopes.len() - 1);
        let corner = (radii[k] / pitch / 2f64.sqrt()).round();
        let frame = Frame::centred(SIDE, SIDE, pitch).and_then(|f| f.with_axis([-corner, -corner])).expect("valid");
        let region = Region { row: 0, col: 0, rows: SIDE, cols: SIDE };
        let density = SpectralDensity::new(&Sensor::generic());
        let street = generate(SceneKind::Facades, 3, 200, 200);
        // Grey, its middle before the region, a texel in three pixels: wider than the blur.
        let grey = Array3::from_shape_fn((1, 200, 200), |(_, i, j)| street[[1, i, j]]);
        let per_slope = radii[k] / slopes[k] / pitch / 3.0;
        let at = 100.0 - slopes[k] / 2f64.sqrt() * per_slope;
        for (what, texture, wall) in [("wall", Array3::from_elem((1, 8, 8), 0.45), Some(0.45)), ("street", grey, None)]
        {
            let scene = Plane { texture, texels_per_slope: per_slope, axis_texel: [at, at], vergence: v };
            let patch = Patch::whole(scene, region, 1);
            let ways = [("training", Settings::TRAINING), ("evaluation", FINENESS), ("design", Settings::DESIGN)];
            let found: Vec<(f64, [f64; 2])> = ways
                .into_iter()
                .map(|(way, settings)| {
                    let renderer = Renderer::planned(&lens, &frame, &density, &[v], settings).expect("traces");
                    let light: Array3<f32> = renderer.light.over(&frame, region, &[0, 1, 2]);
                    let (image, developed) = if way == "training" {
                        let pair = render_pair(&renderer, &patch).expect("renders");
                        let rng = &mut fastrand::Rng::with_seed(1);
                        let (input, _) = cut(&electronics, &isoplanat::imaging::guide::Guide::bare(&frame), &pair, SIDE, Augmentation::NONE, rng);
                        (pair.image, mean(&mut input.into_iter()))
                    } else {
                        let done = forward::<f32>(&renderer, &electronics, &patch).expect("renders");
                        let image = renderer.record::<f32>(&patch.scene, 0, region).image;
                        (image, mean(&mut done.developed.into_iter()))
                    };
                    let (shown, white) = (mean(&mut image.into_iter()), mean(&mut light.into_iter()));
                    let depth = &renderer.plan.depths[0];
                    eprintln!(
                        "{name}, {what}, {way}: mean {shown:.5} of white's {white:.5}, developed {developed:.5}; kernels of {} cells of {} pixels",
                        depth.size(),
                        depth.bin
                    );
                    if let Some(wall) = wall {
                        let most = settings.outside + 1e-4;
                        assert!((shown / (wall * white) - 1.0).abs() <= most, "{name}, {way}: {shown} of {white}");
                        assert!((developed / wall - 1.0).abs() <= most, "{name}, {way}: {developed} developed");
                    }
                    (settings.outside, [shown, developed])
                })
                .collect();
            for (a, b) in [(0, 1), (1, 2), (0, 2)] {
                let most = found[a].0 + found[b].0 + 1e-4;
                for (x, y) in found[a].1.iter().zip(&found[b].1) {
                    assert!(
                        (x / y - 1.0).abs() <= most,
                        "{name}, {what}: {x} and {y}, {} and {}",
                        ways[a].0,
                        ways[b].0
                    );
                }
            }
        }
    }
}
