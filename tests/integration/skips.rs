//! What a patch of a design does not need is left out, and nothing changes: loss and lens gradient with each skip forced off
//! against on.

use std::time::Instant;

use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::plane::{Plane, Region};
use isoplanat::imaging::render::node_grid::NodeGrid;
use isoplanat::imaging::render::{Channels, RenderPlan, Rendered, Renderer, Settings};
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::variables::Variables;
use isoplanat::lens::{Lens, builtin};
use isoplanat::psf::OpticsBar;
use ndarray::{Array3, s};

/// Loss and gradient may differ by so much, of the loss and of the largest component.
const BOUND: f64 = 1e-6;

/// A lens on a plan, and a patch of it.
struct Stage {
    lens: Lens,
    renderer: Renderer,
    region: Region,
}

/// What a way to compute a patch gave.
struct Outcome {
    image: Array3<f64>,
    loss: f64,
    gradient: Vec<f64>,
    kernels: usize,
    seconds: f64,
}

fn density() -> SpectralDensity {
    SpectralDensity::new(&Sensor::generic())
}

fn plan(lens: &Lens, vergences: &[f64], settings: Settings) -> RenderPlan {
    let frame = Frame::centred(320, 220, 0.02).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
    Renderer::planned(lens, &frame, &density(), vergences, settings).expect("plans").plan
}

const PATCH: Region = Region { row: 8, col: 8, rows: 200, cols: 280 };

impl Stage {
    fn new(settings: Settings, region: Region) -> Self {
        let lens = builtin::lens("two_element").expect("shipped");
        let renderer = Renderer::new(&lens, &plan(&lens, &[1e-3], settings)).expect("traces");
        Self { lens, renderer, region }
    }

    /// A sharper lens, in pixels, with a node every 32 of them.
    fn sharp(settings: Settings) -> Self {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let frame = Frame::centred(320, 220, 0.04).and_then(|f| f.with_axis([0.0, 0.0])).expect("valid");
        let mut plan = Renderer::planned(&lens, &frame, &density(), &[1e-3], settings).expect("plans").plan;
        plan.depths[0].grid = NodeGrid::uniform(Region { row: 0, col: 0, rows: 220, cols: 320 }, 32);
        let renderer = Renderer::new(&lens, &plan).expect("traces");
        Self { lens, renderer, region: PATCH }
    }

    /// Squared error of the image against its truth, pulled back through both to every number of the lens.
    fn step(&self, render: impl Fn(&Renderer) -> Rendered<f64>, scene: &Plane) -> Outcome {
        let clock = Instant::now();
        let done = render(&self.renderer);
        let off = &done.image - &done.truth;
        let (image_bar, light_bar) = (&off * 2.0, Array3::zeros(off.dim()));
        let bar: OpticsBar = self.renderer.vjp(scene, &done, image_bar.view(), (-&image_bar).view(), light_bar.view());
        let gradient = Variables::all(&self.lens).gradient(&self.renderer.lens_gradient(&self.lens, &bar));
        let seconds = clock.elapsed().as_secs_f64();
        let loss = off.mapv(|v| v * v).sum();
        Outcome { image: done.image, loss, gradient, kernels: done.seen.kernels, seconds }
    }

    /// With what the scene does not need left out, and with `channels` and `dark` forced.
    fn both(&self, scene: &Plane, channels: &Channels, dark: bool) -> [Outcome; 2] {
        let on = self.step(|r| r.record(scene, 0, self.region), scene);
        let off = self.step(|r| r.record_with(scene, 0, self.region, channels.clone(), dark), scene);
        [on, off]
    }
}

fn street(rows: usize, cols: usize) -> Plane {
    let texture = generate(SceneKind::Facades, 3, rows, cols);
    Plane { texture, texels_per_slope: 1300.0, axis_texel: [0.0, 0.0], vergence: 1e-3 }
}

/// Scenes that need less, and what is forced in turn: channels, blocks without light.
fn kinds() -> Vec<(&'static str, Plane, Channels, bool)> {
    let scene = street(240, 360);
    let with = |texture: Array3<f32>| Plane { texture, ..scene.clone() };
    let (_, rows, cols) = scene.texture.dim();
    let grey = with(Array3::from_shape_fn((3, rows, cols), |(_, i, j)| scene.texture[[1, i, j]]));
    let red =
        with(Array3::from_shape_fn((3, rows, cols), |(c, i, j)| if c == 0 { scene.texture[[0, i, j]] } else { 0.0 }));
    let mut part = Array3::zeros((3, rows, cols));
    part.slice_mut(s![.., 20..60, 30..90]).assign(&scene.texture.slice(s![.., 20..60, 30..90]));
    let narrow = with(part);
    let mut corner = red.texture.clone();
    corner.slice_mut(s![.., 60.., ..]).fill(0.0);
    let both = with(corner);
    vec![
        ("grey", grey.clone(), Channels::all(), false),
        ("one lit channel", red.clone(), Channels::all(), false),
        ("narrow lit field", narrow.clone(), Channels::from_scene(&narrow), true),
        ("one channel, narrow field", both.clone(), Channels::all(), true),
    ]
}

fn compare(what: &str, [on, off]: &[Outcome; 2]) {
    let scale = off.gradient.iter().fold(0.0f64, |m, g| m.max(g.abs()));
    let by = on.gradient.iter().zip(&off.gradient).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / scale;
    let loss = (on.loss - off.loss).abs() / off.loss;
    let image = on.image.iter().zip(&off.image).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    eprintln!("{what}: loss off by {loss:.1e}, gradient by {by:.1e}, image by {image:.1e}");
    assert!(off.loss > 0.0 && scale > 0.0, "{what}: nothing to compare");
    assert!(loss <= BOUND && by <= BOUND && image <= BOUND, "{what}: {loss:e} {by:e} {image:e}");
}

/// Channels, colours and blocks without light: the same loss and gradient as with all of it computed, and kernels saved.
#[test]
fn what_a_patch_does_not_need_changes_nothing() {
    let settings = Settings { wavelengths: 5, dense: 200, cells: 12, ..Settings::DESIGN };
    for (stage, bins) in
        [(Stage::new(settings, PATCH), true), (Stage::sharp(Settings { cells: 64, ..settings }), false)]
    {
        assert_eq!(stage.renderer.plan.depths[0].bin > 1, bins, "cells and pixels");
        for (what, scene, channels, dark) in kinds() {
            let outcomes = stage.both(&scene, &channels, dark);
            compare(what, &outcomes);
            let [on, off] = outcomes.map(|o| o.kernels);
            eprintln!("  {on} kernels of {off}");
            assert!(on > 0 && (!dark || bins || 2 * on <= off), "{what}: {on} of {off} kernels");
        }
    }
}

/// A patch that sees no light computes no kernel, whatever lies beside it.
#[test]
fn a_dark_patch_costs_no_kernel() {
    let settings = Settings { wavelengths: 3, dense: 200, cells: 64, ..Settings::DESIGN };
    let stage = Stage::new(settings, Region { row: 150, col: 250, rows: 32, cols: 32 });
    let (_, scene, ..) = kinds().remove(2);
    let done = stage.step(|r| r.record(&scene, 0, stage.region), &scene);
    assert!(done.kernels == 0 && done.loss == 0.0 && done.gradient.iter().all(|g| *g == 0.0));
    let lit = stage.step(|r| r.record(&scene, 0, Region { row: 16, col: 40, ..stage.region }), &scene);
    assert!(lit.kernels > 0 && lit.loss > 0.0, "the same scene lights another patch");
}

/// A patch at one distance of a plan for several, against a plan for that distance alone with the same knots: the same bits
/// forward, the same gradient.
#[test]
fn distances_that_a_patch_does_not_use_change_nothing() {
    let settings = Settings { wavelengths: 3, dense: 200, cells: 24, ..Settings::DESIGN };
    let vergences = [1e-3, 1.0 / 700.0, 1.0 / 1500.0, 2e-3];
    let mut stage = Stage::new(settings, Region { row: 40, col: 60, rows: 48, cols: 64 });
    let all = plan(&stage.lens, &vergences, settings);
    let mut own = all.clone();
    own.spec.vergences.truncate(1);
    own.depths.truncate(1);
    let scene = street(240, 360);
    let [off, on] = [all, own].map(|plan| {
        stage.renderer = Renderer::new(&stage.lens, &plan).expect("traces");
        stage.step(|r| r.record(&scene, 0, stage.region), &scene)
    });
    assert_eq!((&on.image, on.loss, on.kernels), (&off.image, off.loss, off.kernels));
    compare("one distance of four", &[on, off]);
}

/// Seconds of a patch's forward and gradient with each skip on and off.
#[test]
#[ignore = "a measurement"]
fn seconds_that_skips_save() {
    let least = |f: &dyn Fn() -> f64| (0..5).map(|_| f()).fold(f64::INFINITY, f64::min);
    let sharp = Stage::sharp(Settings { cells: 64, ..Settings::DESIGN });
    let mut stage = Stage::new(Settings::DESIGN, PATCH);
    for (name, stage) in [("two elements", &stage), ("triplet, a node every 32 pixels", &sharp)] {
        eprintln!("{name}:");
        for (what, scene, channels, dark) in kinds() {
            let on = least(&|| stage.step(|r| r.record(&scene, 0, stage.region), &scene).seconds);
            let of = |r: &Renderer| r.record_with(&scene, 0, stage.region, channels.clone(), dark);
            let off = least(&|| stage.step(of, &scene).seconds);
            eprintln!("  {what}: {:.1} ms on, {:.1} ms off", 1e3 * on, 1e3 * off);
        }
    }
    let vergences = [1e-3, 1.0 / 700.0, 1.0 / 1500.0, 2e-3];
    let scene = street(240, 360);
    for count in [1, 4] {
        let plan = plan(&stage.lens, &vergences[..count], Settings::DESIGN);
        let trace = least(&|| {
            let clock = Instant::now();
            Renderer::new(&stage.lens, &plan).expect("traces");
            clock.elapsed().as_secs_f64()
        });
        stage.renderer = Renderer::new(&stage.lens, &plan).expect("traces");
        let step = least(&|| stage.step(|r| r.record(&scene, 0, stage.region), &scene).seconds);
        eprintln!("one distance of {count}: lens traced in {:.1} ms, a patch in {:.1} ms", 1e3 * trace, 1e3 * step);
    }
}
