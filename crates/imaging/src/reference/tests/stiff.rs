//! Extreme scenes, regions and lenses: every one has a stated outcome, and no picture holds NaN.

use super::*;

fn frame() -> Frame {
    Frame::centred(200, 150, 0.05).expect("valid")
}

const REGION: Region = Region { row: 60, col: 90, rows: 4, cols: 5 };

fn rendered(lens: &Lens, scene: &Plane, region: Region, how: Settings) -> Rendered {
    let got = render(lens, scene, &density(), &frame(), region, how, None).expect("renders");
    assert_eq!(got.mean.dim(), (3, region.rows, region.cols));
    assert!(got.mean.iter().chain(&got.variance).all(|v| v.is_finite()), "{got:?}");
    got
}

#[test]
fn radiance_that_is_no_number_is_named() {
    let lens = builtin::lens("two_element").expect("shipped");
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 2e15] {
        // Far from where any ray looks.
        let mut scene = waves(1e-3);
        scene.texture[[2, 297, 3]] = bad;
        scene.texture[[2, 298, 3]] = f32::NAN;
        let error = render(&lens, &scene, &density(), &frame(), REGION, settings(8), None).expect_err("refused");
        assert_eq!(error.exit_code(), 2);
        let text = error.to_string();
        assert!(text.contains("channel 2, row 297, column 3") && text.contains(&format!("{bad}")), "{text}");
    }
    for place in 0..4 {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut scene = waves(1e-3);
            let [x, y] = &mut scene.axis_texel;
            *[&mut scene.vergence, &mut scene.texels_per_slope, x, y][place] = bad;
            let error = render(&lens, &scene, &density(), &frame(), REGION, settings(8), None).expect_err("refused");
            assert!(error.to_string().contains("finite numbers"), "{error}");
        }
    }
}

/// Radiance of any sign and size is rendered linearly: `a R₁ + b` of the picture for `a L + b` of the scene.
#[test]
fn negative_and_huge_radiance_is_rendered_linearly() {
    let lens = builtin::lens("two_element").expect("shipped");
    let plain = rendered(&lens, &waves(1e-3), REGION, settings(16));
    let flat = rendered(&lens, &white(1e-3), REGION, settings(16));
    for (a, b) in [(-1.0f32, 0.0f32), (1.0, -3.0), (1e6, 0.0), (-1e6, 5e5)] {
        let mut scene = waves(1e-3);
        scene.texture.mapv_inplace(|v| a * v + b);
        let got = rendered(&lens, &scene, REGION, settings(16));
        for ((g, p), w) in got.mean.iter().zip(&plain.mean).zip(&flat.mean) {
            let (expected, size) = (a * p + b * w, a.abs() + b.abs());
            assert!((g - expected).abs() < 3e-7 * size, "{a} {b}: {g} {expected}");
        }
        assert_eq!((got.rays, got.passed), (plain.rays, plain.passed));
    }
}

#[test]
fn a_pixel_and_a_row_are_parts_of_the_whole() {
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let all = rendered(&lens, &waves(0.0), REGION, settings(16));
    let one = rendered(&lens, &waves(0.0), Region { row: 62, col: 93, rows: 1, cols: 1 }, settings(16));
    assert_eq!(one.mean, all.mean.slice(s![.., 2..3, 3..4]));
    let row = rendered(&lens, &waves(0.0), Region { row: 61, rows: 1, ..REGION }, settings(16));
    assert_eq!(row.mean, all.mean.slice(s![.., 1..2, ..]));
    // Two samples, and more than a tile of the sequence.
    for samples in [2, 3, 129, 1000] {
        let got = rendered(&lens, &white(0.0), Region { row: 62, col: 93, rows: 1, cols: 1 }, settings(samples));
        assert!(got.mean.iter().all(|v| (*v - 1.0).abs() < 0.5), "{samples}: {:?}", got.mean);
    }
}

/// An object as near as the first vertex and nearer: white stays what it is, and a scene is blurred beyond its border
/// or lies within a texel.
#[test]
fn objects_at_the_first_vertex_are_rendered() {
    let lens = builtin::lens("two_element").expect("shipped");
    let expected = rendered(&lens, &white(1e-3), REGION, settings(32));
    for vergence in [1.0, 1e3, 1e6, -1e6, 1e300, f64::MIN_POSITIVE] {
        let got = rendered(&lens, &white(vergence), REGION, settings(32));
        assert_eq!((&got.mean, got.passed), (&expected.mean, expected.passed), "{vergence}");
        let got = rendered(&lens, &waves(vergence), REGION, settings(32));
        // Every texel lies between 0.05 and 0.95.
        let within = got.mean.iter().zip(&expected.mean).all(|(g, w)| (0.04 * w..=0.96 * w).contains(g));
        assert!(within, "{vergence}: {:?}", got.mean);
    }
}

/// A stop so small that hardly a ray passes (in a bin of radii its image moves by more than its size): a picture of
/// numbers, or the error that no ray came through.
#[test]
fn a_nearly_closed_stop_has_an_outcome() {
    for (name, vergence) in [("two_element", 1e-3), ("cooke_triplet", 0.0), ("phone", 1e-3)] {
        for radius in [1e-3, 1e-5, 1e-7] {
            let lens =
                unchecked(&builtin::lens(name).expect(name), |l| l.aperture = Aperture::StopSemiDiameter(radius));
            let region = Region { row: 74, col: 99, rows: 2, cols: 2 };
            for sampling in [Sampling::Bounded, Sampling::RearAperture] {
                let how = Settings { sampling, ..settings(64) };
                match render(&lens, &white(vergence), &density(), &frame(), region, how, None) {
                    Ok(got) => assert!(got.passed > 0 && got.mean.iter().all(|v| v.is_finite() && *v >= 0.0)),
                    Err(error) => assert!(error.to_string().contains("no rays reach the sensor"), "{error}"),
                }
            }
        }
        let closed = unchecked(&builtin::lens(name).expect(name), |l| l.aperture = Aperture::StopSemiDiameter(0.0));
        match render(&closed, &white(vergence), &density(), &frame(), REGION, settings(8), None) {
            Ok(got) => assert!(got.mean.iter().all(|v| v.is_finite())),
            Err(error) => assert!(error.to_string().contains("no rays reach the sensor"), "{error}"),
        }
    }
}

/// Exactly one ray passes: its pixel is lit, its variance is a number, the other pixels are black.
#[test]
fn one_surviving_ray_is_a_picture() {
    let lens = builtin::lens("two_element").expect("shipped");
    let lens = lens.changed(|l| l.aperture = Aperture::StopSemiDiameter(0.6)).expect("a lens");
    let plain = Settings { sampling: Sampling::RearAperture, ..settings(8) };
    let mut seen = false;
    for seed in 0..60 {
        let how = Settings { seed, ..plain };
        let Ok(got) = render(&lens, &white(1e-3), &density(), &frame(), REGION, how, None) else { continue };
        assert!(got.mean.iter().chain(&got.variance).all(|v| v.is_finite()));
        if got.passed == 1 {
            assert_eq!(got.mean.iter().filter(|v| **v > 0.0).count(), 1);
            assert_eq!(got.variance.iter().filter(|v| **v > 0.0).count(), 1);
            seen = true;
            break;
        }
    }
    assert!(seen, "no seed let exactly one ray through");
}

/// One bright texel on the axis, whose image lies on the corner of four pixels: each gets a quarter.
#[test]
fn a_focus_on_a_pixel_corner_is_shared_by_four() {
    for name in ["two_element", "cooke_triplet"] {
        let lens = builtin::lens(name).expect(name);
        let mut texture = Array3::zeros((1, 3, 3));
        texture[[0, 1, 1]] = 1.0;
        let scene = Plane { texture, texels_per_slope: 5e3, axis_texel: [1.5, 1.5], vergence: lens.object_vergence };
        let region = Region { row: 73, col: 98, rows: 4, cols: 4 };
        let got = rendered(&lens, &scene, region, settings(4096));
        let middle = |i: usize, j: usize| f64::from(got.mean.slice(s![.., i, j]).sum());
        let four = [middle(1, 1), middle(1, 2), middle(2, 1), middle(2, 2)];
        let sum: f64 = four.iter().sum();
        let variance: f64 = got.variance.slice(s![.., 1..3, 1..3]).iter().map(|v| f64::from(*v)).sum();
        let error = variance.sqrt();
        assert!(sum > 0.0, "{name}: no light in the four");
        for share in four {
            assert!((share - sum / 4.0).abs() < 5.0 * error + 1e-12, "{name}: {four:?} ± {error}");
        }
    }
}
