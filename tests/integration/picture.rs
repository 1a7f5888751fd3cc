//! Whole pictures: planned against everything, fast against the reference, and stated outcomes for extreme scenes.

use isoplanat::imaging::files::read_linear;
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::reference::halves::{energy_against_halves, psnr_against_halves};
use isoplanat::imaging::reference::{Channels, Sampling, Settings as Rays, render_halves};
use isoplanat::imaging::render::{PlanOptions, Request, ScenePlan, Settings, frame_of, plan};
use isoplanat::imaging::scene::placement::{Placement, Scale};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::{Lens, builtin};
use isoplanat::testing::shared;
use ndarray::Array3;

/// `texture` before a part of a lens's frame, a texel a pixel in its middle; the part's middle lies at `at` of the way from
/// the axis to the corner.
fn case(name: &str, [columns, rows]: [usize; 2], at: f64, texture: Array3<f32>) -> (Lens, Frame, Plane) {
    let lens = builtin::lens(name).expect("shipped");
    let frame = frame_of(&lens).expect("valid");
    let toward = |axis: f64, n: usize| at * if axis < 0.5 * n as f64 { n as f64 - axis } else { -axis };
    let middle = [toward(frame.axis_px[0], frame.columns), toward(frame.axis_px[1], frame.rows)];
    let axis = [0.5 * columns as f64 - middle[0], 0.5 * rows as f64 - middle[1]];
    let frame = Frame::centred(columns, rows, frame.pitch_mm).and_then(|f| f.with_axis(axis)).expect("valid");
    let (_, h, w) = texture.dim();
    let placement = Placement::centred([h, w], &frame, Scale::There(1.0));
    let scene = placement.before(&lens, &frame, texture).expect("light");
    (lens, frame, scene)
}

fn density() -> SpectralDensity {
    SpectralDensity::new(&Sensor::generic())
}

fn planned(lens: &Lens, frame: &Frame, scene: &Plane, request: Request) -> ScenePlan {
    plan(
        lens,
        std::slice::from_ref(scene),
        frame,
        &density(),
        request,
        PlanOptions { explain: true, ..PlanOptions::RAYS },
    )
    .expect("plans")
}

/// The picture of a scene that was planned for.
fn picture(plan: &ScenePlan, scene: &Plane) -> Array3<f32> {
    plan.picture(scene, &|_| ()).expect("renders").0
}

fn rms(a: &Array3<f32>, b: &Array3<f32>) -> f64 {
    (a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

/// A line of one texel where a pixel has several: it is as bright as its share of a pixel, whatever its place in it, alone and on grey.
#[test]
fn thin_lines_keep_their_light() {
    let (rows, columns) = (48, 64);
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let whole = frame_of(&lens).expect("valid");
    let frame = Frame::centred(columns, rows, 6.0 * whole.pitch_mm).expect("valid");
    for (texels, phase, ground) in [(4, 0, 0.0), (4, 3, 0.2), (8, 4, 0.0), (3, 1, 0.0)] {
        let size = [texels * rows, texels * columns];
        let line = texels * rows / 2 + phase;
        let texture = Array3::from_shape_fn((1, size[0], size[1]), |(_, i, _)| if i == line { 1.0 } else { ground });
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let per_pixel = texels as f64;
        let placement = Placement::centred(size, &frame, Scale::There(per_pixel));
        let scene = placement.before(&lens, &frame, texture).expect("light");
        let everything = picture(&planned(&lens, &frame, &scene, Request::Everything), &scene);
        let plan = planned(&lens, &frame, &scene, Request::Psnr(50.0));
        let found = picture(&plan, &scene);
        let far = rms(&found, &everything);
        // The middle columns across the line, where light is even to a few per cent: a pixel's share of one texel above the ground.
        let middle = |image: &Array3<f32>| -> f64 {
            let above = (12..36).map(|i| f64::from(image[[1, i, columns / 2]] - ground)).sum::<f64>();
            above * per_pixel / f64::from(1.0 - ground)
        };
        eprintln!(
            "{texels} texels, phase {phase}: {far:.1e} rms, light {:.3} and {:.3}",
            middle(&found),
            middle(&everything)
        );
        assert!((0.9..1.1).contains(&middle(&everything)), "everything: {}", middle(&everything));
        assert!(far < 10f64.powf(-50.0 / 20.0), "{texels} texels, phase {phase}: {far:e}");
        assert!(plan.holds && plan.predicted_db.is_some_and(|db| db < 200.0), "{:?}", plan.predicted_db);
    }
}

/// A frame with next to nothing in it, far less than places that probes look at: a few stars a hundred times as bright as white, a small patch, one bright texel in a corner. What
/// was asked is held, and what is told is not better than what came.
#[test]
fn nearly_empty_frames_hold_what_they_promise() {
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let pitch_mm = frame_of(&lens).expect("valid").pitch_mm;
    let stars = [(101, 203), (440, 1003), (833, 571), (1311, 1999)];
    let at = |k: usize, i: usize, j: usize| -> f32 {
        match k {
            0 if stars.contains(&(i, j)) => 100.0,
            1 if (310..322).contains(&i) && (707..719).contains(&j) => 1.0,
            1 => 0.2,
            2 if (i, j) == (7, 9) => 3000.0,
            _ => 0.0,
        }
    };
    // Stars in a frame so large that none of the places sees one.
    for (k, (what, [rows, columns])) in
        [("stars", [1600, 2400]), ("a patch on grey", [900, 1200]), ("a texel in the corner", [900, 1200])]
            .into_iter()
            .enumerate()
    {
        let frame = Frame::centred(columns, rows, pitch_mm).expect("valid");
        let texture = Array3::from_shape_fn((1, rows, columns), |(_, i, j)| at(k, i, j));
        let placement = Placement::centred([rows, columns], &frame, Scale::There(1.0));
        let scene = placement.before(&lens, &frame, texture).expect("light");
        let everything = picture(&planned(&lens, &frame, &scene, Request::Everything), &scene);
        for asked in [50.0, 80.0] {
            let plan = planned(&lens, &frame, &scene, Request::Psnr(asked));
            let far = -20.0 * rms(&picture(&plan, &scene), &everything).log10();
            let told = plan.predicted_db.expect("measured");
            eprintln!("{what}: {asked} dB asked, {told:.1} told, {far:.1} found, holds: {}", plan.holds);
            assert!(!plan.holds || far > asked - 1.0, "{what}: {far} dB of {asked}");
            assert!(told < far + 6.0, "{what}: {told} dB told, {far} found");
        }
    }
}

/// What is left out changes the picture by no more than the plan says.
#[test]
fn planned_pictures_are_within_their_bounds() {
    let size = [128, 96];
    let street = || generate(SceneKind::Facades, 3, 96, 128);
    let green = street();
    let grey = Array3::from_shape_fn(green.dim(), |(_, i, j)| green[[1, i, j]]);
    let corner = Array3::from_shape_fn(green.dim(), |(c, i, j)| if i < 20 && j < 24 { green[[c, i, j]] } else { 0.0 });
    let red = Array3::from_shape_fn(green.dim(), |(c, i, j)| if c == 0 { green[[0, i, j]] } else { 0.0 });
    for (what, lens, at, texture) in [
        ("single depth", "two_element", 0.5, street()),
        ("grey", "two_element", 0.5, grey),
        ("red alone", "cooke_triplet", 0.5, red),
        ("one lit corner", "two_element", 0.6, corner),
        ("in focus", "phone", 0.3, street()),
        ("small central field", "cooke_triplet", 0.0, street()),
    ] {
        let (lens, frame, scene) = case(lens, size, at, texture);
        let everything = picture(&planned(&lens, &frame, &scene, Request::Everything), &scene);
        let plan = planned(&lens, &frame, &scene, Request::Psnr(45.0));
        let picture = picture(&plan, &scene);
        let (found, bound) = (rms(&picture, &everything), plan.skips.iter().map(|s| s.bound).sum::<f64>());
        let left: Vec<&str> = plan.skips.iter().map(|s| s.what).collect();
        eprintln!("{what}: {found:.1e} rms, bound {bound:.1e}; {left:?}");
        assert!(plan.holds && found <= bound, "{what}: {found:e} {bound:e}");
        assert!(found < 10f64.powf(-45.0 / 20.0), "{what}: {found:e} is not 45 dB");
        assert!(plan.skips.iter().all(|s| (0.0..=30.0).contains(&s.remaining)), "{what}: {:?}", plan.skips);
        let told = |what: &str| left.contains(&what);
        match what {
            "grey" => assert!(told("colours of the scene")),
            "red alone" => {
                assert!(told("dark channels") && picture.slice(ndarray::s![1.., .., ..]).iter().all(|v| *v == 0.0))
            }
            "one lit corner" => assert!(told("unlit part of the frame") || told("unlit blocks")),
            _ => {}
        }
    }
}

/// 50 dB and energy within 1e-3 of rays from the sensor, on a photograph.
#[test]
fn the_finest_pictures_agree_with_the_reference() {
    let Some(path) = shared("data/photos/eval/05.png") else { return };
    let photo = read_linear(&path).expect("a photograph");
    for name in ["two_element", "cooke_triplet", "phone"] {
        let (lens, frame, scene) = case(name, [96, 64], 0.6, photo.clone());
        let plan = planned(&lens, &frame, &scene, Request::Settings(Settings::FINE));
        let (picture, seen) = plan.picture::<f32>(&scene, &|_| ()).expect("renders");
        let whole = Region { row: 0, col: 0, rows: frame.rows, cols: frame.columns };
        let how = Rays { samples: 2048, seed: 3, channels: Channels::All, sampling: Sampling::Bounded };
        let halves = render_halves(&lens, &scene, &density(), &frame, whole, how, None).expect("renders");
        let agreement = psnr_against_halves(picture.view(), &halves);
        let mean = (&halves[0].mean + &halves[1].mean) * 0.5;
        let energy = f64::from(picture.sum()) / f64::from(mean.sum()) - 1.0;
        let both = energy_against_halves(picture.view(), &halves);
        eprintln!(
            "{name}: {:.1} dB {:?}, energy {energy:+.1e} {:?}, at most {:.1e} outside",
            agreement.psnr_db, agreement.psnr_db_interval, both.interval, seen.outside
        );
        assert!(agreement.psnr_db >= 50.0, "{name}: {agreement:?}");
        assert!(energy.abs() < 1e-3, "{name}: energy {energy:e}");
    }
}

/// Frames of one pixel and one row, kernels larger than the picture: parts of the larger picture.
#[test]
fn small_frames_are_parts_of_large_ones() {
    let texture = generate(SceneKind::Facades, 3, 96, 128);
    let (lens, frame, scene) = case("two_element", [96, 64], 0.9, texture);
    let settings = Settings { samples: 1, wavelengths: 3, dense: 3000, node_error: 0.02, ..Settings::FINE };
    let large = picture(&planned(&lens, &frame, &scene, Request::Settings(settings)), &scene);
    for [row, col, rows, cols] in [[20, 30, 1, 1], [63, 0, 1, 96], [0, 95, 64, 1], [10, 10, 7, 5]] {
        let axis = [frame.axis_px[0] - col as f64, frame.axis_px[1] - row as f64];
        let part = Frame::centred(cols, rows, frame.pitch_mm).and_then(|f| f.with_axis(axis)).expect("valid");
        let plan = planned(&lens, &part, &scene, Request::Settings(settings));
        assert!(plan.renderer.plan.depths[0].size() > rows, "the kernel is larger than the picture");
        let small = picture(&plan, &scene);
        for ((c, i, j), v) in small.indexed_iter() {
            let whole = large[[c, row + i, col + j]];
            assert!((v - whole).abs() < 5e-3 * whole.max(0.05), "{rows} × {cols} at {i},{j}: {v} {whole}");
        }
    }
}

/// Radiances that are no numbers are refused by name; negative and huge ones are rendered linearly.
#[test]
fn extreme_radiances_have_stated_outcomes() {
    let (lens, frame, mut scene) = case("cooke_triplet", [40, 30], 0.4, generate(SceneKind::Facades, 1, 60, 80));
    let settings = Settings { samples: 2, wavelengths: 3, dense: 200, ..Settings::FINE };
    let plain = picture(&planned(&lens, &frame, &scene, Request::Settings(settings)), &scene);
    for scale in [-1.0f32, 1e6] {
        let mut scaled = scene.clone();
        scaled.texture.mapv_inplace(|v| v * scale);
        let image = picture(&planned(&lens, &frame, &scaled, Request::Settings(settings)), &scaled);
        assert!(image.iter().zip(&plain).all(|(a, b)| (a - b * scale).abs() <= 1e-5 * scale.abs()), "{scale}");
    }
    for bad in [f32::NAN, f32::INFINITY] {
        scene.texture[[2, 7, 9]] = bad;
        let error = plan(&lens, &[scene.clone()], &frame, &density(), Request::Psnr(40.0), PlanOptions::RAYS)
            .err()
            .expect("refused");
        let text = error.to_string();
        assert!(error.exit_code() == 2 && text.contains("channel 2, row 7, column 9"), "{text}");
    }
}

/// No light, an object at the lens, a frame beyond the image: a black picture, a picture or an error, never a panic.
#[test]
fn extreme_places_have_stated_outcomes() {
    let (lens, frame, scene) = case("two_element", [24, 16], 0.4, generate(SceneKind::Facades, 1, 30, 40));
    let dark = Plane { texture: Array3::zeros((3, 4, 4)), ..scene.clone() };
    let black = planned(&lens, &frame, &dark, Request::Psnr(50.0));
    assert!(black.region.is_none());
    assert!(picture(&black, &dark).iter().all(|v| *v == 0.0));
    // One lit texel far outside the frame: nothing lands.
    let mut far = Plane { texture: Array3::zeros((1, 3, 3)), axis_texel: [-1e6, 0.0], ..scene.clone() };
    far.texture[[0, 1, 1]] = 1.0;
    assert!(picture(&planned(&lens, &frame, &far, Request::Psnr(50.0)), &far).iter().all(|v| *v == 0.0));
    for vergence in [0.0, 1.0 / 20.0, 1.0, 1e6] {
        let near = Plane { vergence, ..scene.clone() };
        let settings = Settings { samples: 1, wavelengths: 3, dense: 200, cells: 40, ..Settings::FINE };
        match plan(
            &lens,
            std::slice::from_ref(&near),
            &frame,
            &density(),
            Request::Settings(settings),
            PlanOptions::RAYS,
        ) {
            Ok(plan) => {
                let image = picture(&plan, &near);
                assert!(image.iter().all(|v| v.is_finite()), "{vergence}");
            }
            Err(error) => assert_eq!(error.exit_code(), 2, "{vergence}: {error}"),
        }
    }
    for vergence in [f64::NAN, f64::INFINITY, -1.0] {
        let bad = Plane { vergence, ..scene.clone() };
        assert!(plan(&lens, &[bad], &frame, &density(), Request::Psnr(40.0), PlanOptions::RAYS).is_err());
    }
}
