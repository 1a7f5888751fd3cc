//! The one way from lens to picture: parts, depths and threads leave no trace in it, and stiff cases end as stated.

use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::render::{Channels, PlanOptions, Rendered, Renderer, Request, Settings, plan};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::variables::Variables;
use isoplanat::lens::{Aperture, Lens, Medium, Prescription, Shape, Surface, builtin, paraxial, unchecked};
use isoplanat::psf::OpticsBar;
use ndarray::{Array3, s};

/// Coarse and quick.
const QUICK: Settings = Settings { wavelengths: 3, dense: 200, ..Settings::DESIGN };

fn density() -> SpectralDensity {
    SpectralDensity::new(&Sensor::generic())
}

/// `two_element` with its axis at the corner of a frame of 20 µm.
fn two_element() -> (Lens, Frame) {
    let frame = Frame::centred(320, 220, 0.02).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
    (builtin::lens("two_element").expect("shipped"), frame)
}

fn street(vergence: f64) -> Plane {
    let texture = generate(SceneKind::Facades, 3, 240, 360);
    Plane { texture, texels_per_slope: 1300.0, axis_texel: [0.0, 0.0], vergence }
}

fn whole(frame: &Frame) -> Region {
    Region { row: 0, col: 0, rows: frame.rows, cols: frame.columns }
}

/// Cotangent of a picture: signs that do not follow it.
fn bar_of(image: &Array3<f32>) -> Array3<f32> {
    let mut rng = fastrand::Rng::with_seed(12);
    Array3::from_shape_simple_fn(image.dim(), || rng.f32() - 0.5)
}

/// Pulls a random cotangent on image, truth and illumination back to the optics.
fn pulled(renderer: &Renderer, scene: &Plane, rendered: &Rendered<f32>) -> OpticsBar {
    let bar = bar_of(&rendered.image);
    renderer.vjp(scene, rendered, bar.view(), bar.view(), bar.view())
}

/// Every number of a lens's gradient.
fn gradient(renderer: &Renderer, lens: &Lens, bar: &OpticsBar) -> Vec<f64> {
    Variables::all(lens).gradient(&renderer.lens_gradient(lens, bar))
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

/// Four depths in one renderer, their cotangents added up, against a renderer for each: the same images and gradients.
#[test]
fn depths_in_one_batch_are_the_depths_alone() {
    let (lens, frame) = two_element();
    let vergences = [500.0, 700.0, 1000.0, 1500.0].map(f64::recip);
    let settings = Settings { cells: 48, ..QUICK };
    let batch = Renderer::planned(&lens, &frame, &density(), &vergences, settings).expect("plans");
    let mut sum = OpticsBar::zeros(&batch.optics);
    let mut alone = vec![0.0; Variables::all(&lens).parameters.len()];
    for (k, v) in vergences.iter().enumerate() {
        let scene = street(*v);
        let region = Region { row: 20 + 30 * k.cast_signed(), col: 200 - 40 * k.cast_signed(), rows: 40, cols: 48 };
        // What is traced depends on the nearest object: the plan's knots are the batch's.
        let mut own = batch.plan.clone();
        own.spec.vergences = vec![*v];
        own.depths = vec![batch.plan.depths[k].clone()];
        let single = Renderer::new(&lens, &own).expect("traces");
        let depth = batch.plan.depth(*v).expect("planned");
        assert_eq!(depth, k);
        let (a, b) = (batch.record::<f32>(&scene, depth, region), single.record::<f32>(&scene, 0, region));
        assert_eq!((&a.image, &a.truth, &a.illumination), (&b.image, &b.truth, &b.illumination), "depth {k}");
        sum.add(&pulled(&batch, &scene, &a));
        let g = gradient(&single, &lens, &pulled(&single, &scene, &b));
        alone.iter_mut().zip(g).for_each(|(a, g)| *a += g);
    }
    let together = gradient(&batch, &lens, &sum);
    let scale = largest(&alone);
    let off = together.iter().zip(&alone).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    eprintln!("gradients of a batch and of its depths alone: {:e} of the largest", off / scale);
    assert!(scale > 0.0 && off <= 1e-11 * scale, "{off:e} of {scale:e}");
}

/// A plan made for one depth alone gives the batch's picture to what its own knots and widths leave.
#[test]
fn a_plan_of_its_own_gives_the_same_picture() {
    let (lens, frame) = two_element();
    let vergences = [500.0, 700.0, 1000.0, 1500.0].map(f64::recip);
    let settings = Settings { cells: 64, node_error: 0.1, outside: 1e-3, ..QUICK };
    let batch = Renderer::planned(&lens, &frame, &density(), &vergences, settings).expect("plans");
    let region = Region { row: 40, col: 120, rows: 48, cols: 64 };
    for (k, v) in vergences.iter().enumerate() {
        let own = Renderer::planned(&lens, &frame, &density(), &[*v], settings).expect("plans");
        let scene = street(*v);
        let (a, b) = (batch.record::<f32>(&scene, k, region).image, own.record::<f32>(&scene, 0, region).image);
        let off = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        eprintln!("{} mm: {off:e}", v.recip());
        assert!(off < 1e-3, "{} mm: {off}", v.recip());
    }
}

/// One depth that cannot be pictured refuses the batch with one line; a distance that was not planned for as well.
#[test]
fn a_depth_that_fails_is_an_error() {
    let (lens, frame) = two_element();
    // No numbers; a virtual object before the entrance pupil, where chief rays run backwards: the picture folds.
    for bad in [f64::NAN, f64::INFINITY, -1.0] {
        let error = Renderer::planned(&lens, &frame, &density(), &[1e-3, bad], QUICK).expect_err("no picture");
        let text = error.to_string();
        assert!(error.exit_code() == 2 && text.contains("vergence") && text.lines().count() == 1, "{bad}: {text}");
        // The same of a plan that was made for other distances.
        let mut plan = Renderer::planned(&lens, &frame, &density(), &[1e-3], QUICK).expect("plans").plan;
        plan.spec.vergences.push(bad);
        assert!(Renderer::new(&lens, &plan).is_err() && Renderer::replanned(&lens, &plan).is_err(), "{bad}");
    }
    // Far inside the focal length, 3 and 0.1 mm before the lens: a picture all the same.
    for near in [1.0 / 3.0, 10.0] {
        let renderer = Renderer::planned(&lens, &frame, &density(), &[1e-3, near], QUICK).expect("plans");
        let scene = street(near);
        let rendered = renderer.record::<f32>(&scene, 1, Region { row: 50, col: 60, rows: 8, cols: 8 });
        assert!(rendered.image.iter().all(|v| v.is_finite()), "{near}");
        assert!(
            gradient(&renderer, &lens, &pulled(&renderer, &scene, &rendered)).iter().all(|g| g.is_finite()),
            "{near}"
        );
    }
    let renderer = Renderer::planned(&lens, &frame, &density(), &[1e-3], QUICK).expect("plans");
    let text = renderer.plan.depth(2e-3).expect_err("not planned for").to_string();
    assert!(text.contains("500") && text.contains("1000"), "{text}");
}

/// Parts of a picture rendered alone, in pixels and in cells, at one sample a pixel and at two.
#[test]
fn a_region_alone_is_the_same_part_of_the_whole() {
    let (lens, frame) = two_element();
    for (samples, cells) in [(1, 64), (2, 64), (1, 12)] {
        let settings = Settings { samples, cells, ..QUICK };
        let renderer = Renderer::planned(&lens, &frame, &density(), &[1e-3], settings).expect("plans");
        let scene = street(1e-3);
        let channels = Channels::from_scene(&scene);
        let all = renderer.picture::<f32>(&scene, 0, whole(&frame), &channels, &|_| ()).0;
        let most = all.iter().copied().fold(0.0, f32::max);
        for (row, col, rows, cols) in [(0, 0, 32, 32), (70, 113, 50, 61), (219, 0, 1, 320), (30, 319, 100, 1)] {
            let region = Region { row, col, rows, cols };
            let (r, c) = (row.unsigned_abs(), col.unsigned_abs());
            let part = all.slice(s![.., r..r + rows, c..c + cols]);
            let alone = renderer.picture::<f32>(&scene, 0, region, &channels, &|_| ()).0;
            let recorded = renderer.record::<f32>(&scene, 0, region).image;
            for (what, image) in [("alone", alone), ("recorded", recorded)] {
                let off = image.iter().zip(&part).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                assert!(off <= 8.0 * f32::EPSILON * most, "{what}, {region:?}, {samples}, {cells}: {off:e} of {most}");
            }
        }
    }
}

/// Plans, pictures and gradients from pools of one and of three threads: the same bits.
#[test]
fn the_number_of_threads_changes_no_bit() {
    let (lens, frame) = two_element();
    let scene = street(1e-3);
    let run = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("starts").install(|| {
            let renderer = Renderer::planned(&lens, &frame, &density(), &[1e-3, 2e-3], QUICK).expect("plans");
            let image = renderer.picture::<f32>(&scene, 0, whole(&frame), &Channels::from_scene(&scene), &|_| ()).0;
            let region = Region { row: 33, col: 150, rows: 64, cols: 70 };
            let recorded = renderer.record::<f32>(&scene, 0, region);
            let bits: Vec<u64> = gradient(&renderer, &lens, &pulled(&renderer, &scene, &recorded))
                .into_iter()
                .map(f64::to_bits)
                .collect();
            (renderer.plan.clone(), image.mapv(f32::to_bits), recorded.image.mapv(f32::to_bits), bits)
        })
    };
    assert!(run(1) == run(3), "threads tell");
}

/// Grey scenes (one source for three channels) and black ones against the full computation: image and gradient.
#[test]
fn grey_and_black_scenes_are_the_full_computation() {
    let (lens, frame) = two_element();
    let renderer = Renderer::planned(&lens, &frame, &density(), &[1e-3], QUICK).expect("plans");
    let region = Region { row: 60, col: 100, rows: 48, cols: 56 };
    let coloured = street(1e-3);
    let green = coloured.texture.slice(s![1..2, .., ..]).to_owned();
    let three = Array3::from_shape_fn(coloured.texture.dim(), |(_, i, j)| green[[0, i, j]]);
    let mut nearly = three.clone();
    // No longer grey to the eye of the program, in a place that no pixel shows.
    let (_, rows, cols) = nearly.dim();
    nearly[[0, rows - 1, cols - 1]] += 0.5;
    let of = |texture: Array3<f32>| {
        let scene = Plane { texture, ..coloured.clone() };
        let rendered = renderer.record::<f32>(&scene, 0, region);
        let (lit, sources) = (Channels::from_scene(&scene).lit.len(), Channels::from_scene(&scene).sources());
        let g = gradient(&renderer, &lens, &pulled(&renderer, &scene, &rendered));
        (rendered.image, rendered.truth, g, (lit, sources))
    };
    let (single, grey, full) = (of(green), of(three), of(nearly));
    assert_eq!((single.3, grey.3, full.3), ((3, 1), (3, 1), (3, 3)));
    for (what, one) in [("one channel", &single), ("three that are the same", &grey)] {
        let off = one.0.iter().zip(&full.0).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let by = one.2.iter().zip(&full.2).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / largest(&full.2);
        eprintln!("{what}: image {off:e}, gradient {by:e} of the largest");
        assert_eq!(one.1, full.1, "{what}: truth");
        assert!(off < 1e-6 && by < 1e-5, "{what}: {off:e} {by:e}");
        assert!(one.2.iter().all(|g| g.is_finite()), "{what}");
    }
    let black = Plane { texture: Array3::zeros((3, 4, 4)), ..coloured.clone() };
    let dark = renderer.record::<f32>(&black, 0, region);
    assert!(dark.image.iter().chain(&dark.truth).all(|v| *v == 0.0));
    let bar = bar_of(&dark.image);
    let zero = Array3::zeros(bar.dim());
    // The illumination lives on: a cotangent of its own is not the scene's.
    let by = |light: &Array3<f32>| {
        let bar = renderer.vjp(&black, &dark, bar.view(), bar.view(), light.view());
        gradient(&renderer, &lens, &bar)
    };
    assert!(by(&zero).iter().all(|g| *g == 0.0), "a black scene pulls at nothing");
    assert!(by(&bar).iter().all(|g| g.is_finite()) && largest(&by(&bar)) > 0.0);
}

/// A bare hole of radius 0.05 mm, 20 mm before the sensor.
fn pinhole() -> Lens {
    let hole =
        Surface { shape: Shape::default(), thickness: 20.0, medium: Medium::Air, semi_diameter: 0.05, pose: None };
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let alone = |l: &mut Prescription| {
        (l.surfaces, l.stop, l.aperture) = (vec![hole], 0, Aperture::StopSemiDiameter(0.05));
        l.object_vergence = 0.0;
    };
    lens.changed(alone).expect("a lens")
}

/// White through a hole, to 40° on either side: the disk's view factor (cos⁴ to 1e-5), and no distortion.
#[test]
fn a_pinhole_darkens_as_the_fourth_power_of_the_cosine() {
    let lens = pinhole();
    // 40° along the columns: 33.6 mm of half a frame.
    let frame = Frame::centred(672, 96, 0.05).expect("valid");
    let planned = Renderer::planned(&lens, &frame, &density(), &[0.0], QUICK).expect("plans").plan;
    let edge = frame.max_radius_mm();
    let mut fine = planned.clone();
    fine.spec.radii_mm = (0..=24).map(|k| edge * f64::from(k) / 24.0).collect();
    // Closed form of a disk of radius 0.05 at 20 mm, over its middle's.
    let seen = |a: f64| {
        let (h2, r2, a2) = (400.0, 0.0025, a * a);
        0.5 * (1.0 - (a2 + h2 - r2) / ((a2 + h2 + r2).powi(2) - 4.0 * r2 * a2).sqrt())
    };
    // A plan's table states its own error.
    let stated = planned.table_error.weight;
    assert!(stated <= 1e-4, "{stated:e}");
    for (what, plan, most) in [("planned", planned, stated.max(1e-5)), ("25 radii", fine, 1e-5)] {
        let renderer = Renderer::new(&lens, &plan).expect("traces");
        for k in 0..=40 {
            let radius = edge * f64::from(k) / 40.0;
            let slope = renderer.optics.maps[0].slope(radius);
            assert!((slope - radius / 20.0).abs() < 1e-10, "{radius} mm: slope {slope}");
        }
        let white =
            Plane { texture: Array3::ones((1, 2, 2)), texels_per_slope: 1.0, axis_texel: [1.0; 2], vergence: 0.0 };
        let image = renderer.picture::<f64>(&white, 0, whole(&frame), &Channels::from_scene(&white), &|_| ()).0;
        let mut worst = 0.0f64;
        for ((_, i, j), v) in image.indexed_iter() {
            let radius = frame.radius_mm(j as f64 + 0.5, i as f64 + 0.5);
            let (exact, cosine) = (seen(radius) / seen(0.0), 20.0 / radius.hypot(20.0));
            assert!((exact / cosine.powi(4) - 1.0).abs() < 1e-5, "a small hole at {radius} mm");
            worst = worst.max((v / exact - 1.0).abs());
        }
        let radii = plan.spec.radii_mm.len();
        eprintln!(
            "white through a pinhole, {what}: {worst:e} off to {:.1}°, {radii} radii",
            (edge / 20.0).atan().to_degrees()
        );
        assert!(worst < most, "{what}: {worst:e}");
    }
}

/// A lens on a small frame, one scene: finite picture and gradient, or one line.
fn outcome(what: &str, lens: &Lens, frame: &Frame, vergence: f64, settings: Settings) -> Option<Renderer> {
    let scene = Plane { texels_per_slope: 400.0, axis_texel: [180.0, 120.0], ..street(vergence) };
    let renderer = match Renderer::planned(lens, frame, &density(), &[vergence], settings) {
        Ok(renderer) => renderer,
        Err(error) => {
            let text = error.to_string();
            eprintln!("{what}: {text}");
            assert!(error.exit_code() == 2 && text.lines().count() == 1, "{what}: {text}");
            return None;
        }
    };
    let d = &renderer.plan.depths[0];
    let rendered = renderer.record::<f32>(&scene, 0, whole(frame));
    let finite = |a: &Array3<f32>| a.iter().all(|v| v.is_finite());
    assert!(finite(&rendered.image) && finite(&rendered.truth) && finite(&rendered.illumination), "{what}");
    let g = gradient(&renderer, lens, &pulled(&renderer, &scene, &rendered));
    assert!(g.iter().all(|g| g.is_finite()), "{what}: {g:?}");
    let brightest = rendered.image.iter().copied().fold(0.0, f32::max);
    assert!(brightest < 2.0, "{what}: {brightest} of scenes up to 1");
    eprintln!(
        "{what}: half-width {} cells of {} px, {} nodes, kept {:.2}, light to {:.2} mm of {:.2}, brightest {brightest:.3}",
        d.half_width,
        d.bin,
        d.grid.len(),
        renderer.optics.table().kept(),
        renderer.optics.table().edge_mm,
        frame.max_radius_mm()
    );
    Some(renderer)
}

#[test]
fn stiff_kernels_end_as_stated() {
    // Below a pixel: all of the light in the window of box and tent.
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let coarse = Frame::centred(48, 32, 0.6).expect("valid");
    let sharp = outcome("below a pixel", &lens, &coarse, lens.object_vergence, QUICK).expect("renders");
    assert!(sharp.plan.depths[0].half_width <= 3);
    // Wider than the frame.
    let achromat = builtin::lens("ac254_050_a").expect("shipped");
    let small = Frame::centred(48, 32, 0.01).expect("valid");
    let wide = outcome("wider than the frame", &achromat, &small, 1.0 / 500.0, QUICK).expect("renders");
    let depth = &wide.plan.depths[0];
    assert!(2 * depth.half_width * depth.bin > 48, "{depth:?}");
    outcome("far out of focus", &achromat, &small, 1.0 / 80.0, QUICK);
    // Within the caustic: between the marginal and the paraxial focus of a plano-convex lens's like.
    let last = achromat.surfaces.len() - 1;
    for step in [-1.5, -0.7, -0.3, 0.3] {
        let inside = achromat.changed(|l| l.surfaces[last].thickness += step).expect("a lens");
        outcome(&format!("{step} mm from focus"), &inside, &small, achromat.object_vergence, QUICK);
    }
}

#[test]
fn stiff_places_end_as_stated() {
    for name in ["two_element", "cooke_triplet", "phone", "double_gauss"] {
        let lens = builtin::lens(name).expect("shipped");
        let reach = (1.4 * lens.max_field_deg().min(55.0)).to_radians().tan();
        let focal = paraxial::first_order(&lens, lens.wavelengths.primary_nm).effective_focal_length;
        // A frame that reaches beyond the image circle.
        let pitch = 2.0 * reach * focal / 96.0;
        let beyond = Frame::centred(96, 64, pitch).expect("valid");
        let settings = Settings { cells: 24, ..QUICK };
        outcome(&format!("{name}, beyond the image"), &lens, &beyond, lens.object_vergence, settings);
        let far = Frame::centred(96, 64, 3.0 * pitch).expect("valid");
        outcome(&format!("{name}, far beyond the image"), &lens, &far, lens.object_vergence, settings);
        // A stop three times as large.
        let fast = unchecked(&lens, |l| {
            l.aperture = Aperture::StopSemiDiameter(3.0 * paraxial::stop_semi_diameter(&lens));
            l.surfaces[lens.stop].semi_diameter *= 3.0;
        });
        let frame = Frame::centred(48, 32, lens.sensor.pitch_mm() * 8.0).expect("valid");
        outcome(&format!("{name}, stop × 3"), &fast, &frame, lens.object_vergence, settings);
    }
}

/// White on a frame beyond the image circle: black outside of it, the relative illumination inside, up to the edge.
#[test]
fn a_frame_beyond_the_image_is_black_there() {
    for (name, pitch) in [("cooke_triplet", 0.6), ("phone", 0.12), ("two_element", 1.2)] {
        let lens = builtin::lens(name).expect("shipped");
        let frame = Frame::centred(96, 64, pitch).expect("valid");
        let vergence = lens.object_vergence;
        let white = Plane { texture: Array3::ones((1, 2, 2)), texels_per_slope: 1.0, axis_texel: [1.0; 2], vergence };
        for request in [Request::Settings(QUICK), Request::Everything] {
            let plan = plan(&lens, std::slice::from_ref(&white), &frame, &density(), request, PlanOptions::RAYS)
                .expect("plans");
            let (image, seen) = plan.picture::<f64>(&white, &|_| ()).expect("renders");
            let edge = plan.renderer.optics.table().edge_mm;
            assert!(edge < frame.max_radius_mm(), "{name}: light everywhere");
            let light = plan.renderer.light.over::<f64>(&frame, whole(&frame), &[0, 1, 2]);
            let mut worst = 0.0f64;
            for ((at, v), light) in image.indexed_iter().zip(&light) {
                let radius = frame.radius_mm(at.2 as f64 + 0.5, at.1 as f64 + 0.5);
                assert!(v.is_finite() && (radius <= edge + pitch || *v == 0.0), "{name}, {radius} mm: {v}");
                worst = worst.max((v - light).abs());
            }
            eprintln!("{name}: light to {edge:.2} mm, {worst:e} off its illumination, {:e} outside", seen.outside);
            assert!(
                worst <= seen.outside + 1e-9 && seen.outside <= 2e-2,
                "{name}: {worst:e}, {:e} outside",
                seen.outside
            );
        }
    }
}

/// Nodes beyond the frame's corner (grids of even spacing, cells that reach over its edge) keep the kernels of its corner.
#[test]
fn nodes_beyond_the_frame_keep_their_light() {
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let white = Plane { texture: Array3::ones((1, 2, 2)), texels_per_slope: 1.0, axis_texel: [1.0; 2], vergence: 0.0 };
    let whole_frame = Frame::centred(64, 48, 0.04).expect("valid");
    for (columns, rows, axis) in [(24, 16, [12.0, 14.0]), (17, 33, [40.0, -3.0]), (64, 48, whole_frame.axis_px)] {
        let frame = Frame::centred(columns, rows, 0.04).and_then(|f| f.with_axis(axis)).expect("valid");
        for request in [Request::Everything, Request::Settings(Settings { cells: 4, ..QUICK })] {
            let plan = plan(&lens, std::slice::from_ref(&white), &frame, &density(), request, PlanOptions::RAYS)
                .expect("plans");
            let (image, seen) = plan.picture::<f64>(&white, &|_| ()).expect("renders");
            assert!(seen.outside < 1e-2, "{columns} × {rows}: {} of a node's light outside", seen.outside);
            let light = plan.renderer.light.over::<f64>(&frame, whole(&frame), &[0, 1, 2]);
            let off = image.iter().zip(&light).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off <= seen.outside + 1e-9, "{columns} × {rows}: {off:e}");
        }
    }
}
