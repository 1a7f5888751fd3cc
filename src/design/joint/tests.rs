use super::*;
use crate::design::data::Textures;
use crate::design::joint::as_built::AsBuilt;
use crate::design::joint::designing::prepare;
use crate::design::joint::judge::Camera;
use crate::design::joint::lens_steps::{LensSteps, Steps};
use crate::design::joint::run::{JointSettings, Stage, joint_stage, network};
use crate::design::joint::scenery::Scenery;
use crate::design::schedule::Length;
use crate::design::task::Task;
use crate::design::task::stated::Stated;
use isoplanat_imaging::guide::Inputs;
use isoplanat_imaging::render::{Settings, frame_of};
use isoplanat_imaging::sensor::Sensor;
use isoplanat_imaging::sensor::noise::Noise;
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_network::Compute;
use isoplanat_optics::analysis::fabrication::tolerances::Tolerances;
use isoplanat_optics::lens::catalogue::Glasses;
use isoplanat_optics::optimize::Merit;

const SETTINGS: Settings = Settings { dense: 300, wavelengths: 3, outside: 1e-2, cells: 16, ..Settings::DESIGN };

fn task() -> Task {
    let mut task = Task::demo();
    let sensor = task.frame.raster.as_mut().expect("the demo's");
    (sensor.columns, sensor.rows, sensor.pitch_um) = (240, 160, 80.0);
    task
}

/// Scene → loss through the f32 network: the lens gradient against central differences, 1e-2. The network sees the capture alone,
/// or is guided by filters that stay while the lens moves.
#[test]
fn the_lens_gradient_through_the_network_agrees_with_differences() {
    gradient_agrees(Inputs::BARE, None);
    gradient_agrees(GUIDED, None);
}

/// The same through a lens as built, 1 % off in every radius: by the numbers of the lens that was drawn around.
#[test]
fn the_gradient_at_a_drawn_lens_is_one_of_the_lens() {
    let text = "schema = 1\n[element.all]\nthickness_tolerance_mm = 0.1\n[surface.all]\nradius_percent = 1.0\n";
    let tolerances = Tolerances::parse(text, "t.toml").expect("reads");
    gradient_agrees(Inputs::BARE, Some(&tolerances));
}

const GUIDED: Inputs = Inputs::GUIDED;

fn gradient_agrees(inputs: Inputs, tolerances: Option<&Tolerances>) {
    let task = task();
    let (lens, sensor) = (task.lens(Glasses::shipped()).expect("shipped"), Sensor::generic());
    let frame = frame_of(&lens).expect("valid");
    let textures = Textures::built_in(3, 5, 400);
    let v = lens.object_vergence;
    let renderer = Renderer::planned(&lens, &frame, &SpectralDensity::new(&sensor), &[v], SETTINGS).expect("plans");
    let electronics = Electronics::from_sensor(&sensor);
    let guide = Guide::new(inputs, &renderer, &electronics).expect("filters");
    let mut net = network(8, inputs, 5, Compute::Cpu).expect("valid");
    let mut rng = fastrand::Rng::with_seed(2);
    let map = &renderer.optics.maps[0];
    let mut draw = || textures.draw_within(&mut rng, &frame, map, 64, guide.reach());
    // A few steps, so that the network is no identity.
    for _ in 0..30 {
        let p = draw();
        let f = forward::<f32>(&renderer, &electronics, &p).expect("renders");
        let told = guide.over(f.developed.view(), p.region, p.part);
        let truth = f.truth.slice(middle(&p)).insert_axis(Axis(0));
        net.step_network_only(told.view().insert_axis(Axis(0)), truth, None, 2e-3).expect("trains");
    }
    let patch = draw();
    assert_eq!(patch.region == patch.part, inputs.is_bare());
    // The loss in f64 from the f32 pictures, so that its own rounding stays below the differences.
    let built = tolerances.map(|t| AsBuilt::new(t, &Merit::default(), &lens, (4, 1)).expect("draws"));
    let through = |lens: &Lens| built.as_ref().map_or_else(|| lens.clone(), |b| b.lens(lens, 3).expect("a lens"));
    let off = through(&lens).surfaces[0].shape.curvature / lens.surfaces[0].shape.curvature - 1.0;
    assert_eq!(off.abs() > 1e-3, tolerances.is_some(), "{off}");
    let mut loss = |lens: &Lens| -> (f64, PatchForward<f32>, Record, isoplanat_network::Step) {
        let renderer = Renderer::new(&through(lens), &renderer.plan).expect("traces");
        let f = forward::<f32>(&renderer, &electronics, &patch).expect("renders");
        let (told, record) = guide.over_recorded(f.developed.view(), patch.region, patch.part);
        let truth = f.truth.slice(middle(&patch)).to_owned();
        let (x, t) = (told.view().insert_axis(Axis(0)), truth.view().insert_axis(Axis(0)));
        let s = net.step(x, t, None, 0.0, false).expect("runs");
        let l1 = s.output.iter().zip(&truth).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>();
        (l1 / s.output.len() as f64, f, record, s)
    };
    let (_, f, record, s) = loss(&lens);
    let x_bar = guide.over_vjp(&record, s.input_bar.index_axis(Axis(0), 0));
    let mut t_bar = Array3::zeros(f.truth.raw_dim());
    t_bar.slice_mut(middle(&patch)).assign(&s.target_bar.index_axis(Axis(0), 0));
    let drawn = through(&lens);
    let at = Renderer::new(&drawn, &renderer.plan).expect("traces");
    let bar = forward_vjp(&at, &electronics, &patch, &f, x_bar.view(), t_bar.view());
    let g = at.lens_gradient(&drawn, &bar);
    let vars = isoplanat_optics::lens::variables::Variables::refracting(&lens);
    let (x, gradient) = (vars.values(&lens), vars.gradient(&g));
    for seed in 0..6 {
        let dx = isoplanat_base::testing::leaning(&gradient, 40 + seed);
        let pulled: f64 = gradient.iter().zip(&dx).map(|(a, b)| a * b).sum();
        // The loss has a kink wherever a pixel is right, and filters make many so: at 2e-4 the slope over them is 2 % off.
        let h = 2e-5;
        let mut at = |t: f64| {
            let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + t * b).collect();
            loss(&vars.lens(&lens, &moved).expect("a lens")).0
        };
        let numeric = (at(h) - at(-h)) / (2.0 * h);
        isoplanat_base::testing::assert_rel(
            pulled,
            numeric,
            1e-2,
            0.0,
            &format!("{:?}, direction {seed}", inputs.names()),
        );
    }
}

fn settings(steps: u64, patch: usize) -> JointSettings {
    let mut task = task();
    (task.pictures.patch_px, task.pictures.batch, task.budget.steps) = (patch, 1, Some(1));
    JointSettings { length: Length::Steps(steps), ..JointSettings::from_task(&task).expect("has a length") }
}

/// A stage gives the same bits again, and the lens moves.
#[test]
fn a_joint_stage_repeats_to_the_bit() {
    for steps in [Steps::Rays, Steps::Scaled, Steps::Plain] {
        let mut task = task();
        task.lens.steps_by = steps;
        let lens = task.lens(Glasses::shipped()).expect("shipped");
        let (prepared, sensor) =
            (prepare(&task, &lens, "task", &mut |_, _| {}).expect("passes light"), Sensor::generic());
        let textures = Textures::built_in(3, 5, 400);
        let scenery = Scenery { textures: &textures, sensor: &sensor, frame: frame_of(&lens).expect("valid"), seed: 4 };
        let rate = if steps == Steps::Rays { 2e-3 } else { 1e-3 };
        let settings = JointSettings { steps, lens_rate: rate, lens_share: [0.2, 0.9], ..settings(10, 32) };
        for inputs in [Inputs::BARE, GUIDED] {
            let run = || {
                let net = network(4, inputs, 1, Compute::Cpu).expect("valid");
                joint_stage(&scenery, &prepared.problem, net, settings.clone(), &mut |_, _| {}).expect("runs").0
            };
            let (a, b) = (run(), run());
            assert_eq!(a.joint.lens, b.joint.lens);
            assert_eq!(a.fineness, b.fineness);
            assert!(a.fineness.len() == 1 && a.fineness[0].1.holds, "{:?}", a.fineness);
            assert_ne!(a.joint.lens, prepared.problem.lens);
            assert_eq!(a.joint.network.parameters(), b.joint.network.parameters());
            // At the end the filters are those of the finished lens.
            assert_eq!((a.joint.refreshed.0 > 0, &a.joint.guide), (!inputs.is_bare(), &b.joint.guide));
        }
    }
}

/// A stage that goes on from its state has the bits of one that was never left, filters, settings and moments included.
#[test]
fn a_stage_goes_on_from_its_state() {
    let built = || Some(Stated::Keys(toml::from_str(TOLERANCES).expect("keys")));
    for (steps, inputs, tolerances) in [
        (Steps::Rays, Inputs::BARE, None),
        (Steps::Rays, GUIDED, None),
        (Steps::Scaled, Inputs::BARE, None),
        (Steps::Rays, GUIDED, built()),
    ] {
        let mut task = task();
        (task.lens.steps_by, task.lens.tolerances) = (steps, tolerances);
        let lens = task.lens(Glasses::shipped()).expect("shipped");
        let (problem, sensor) =
            (prepare(&task, &lens, "task", &mut |_, _| {}).expect("passes light").problem, Sensor::generic());
        let textures = Textures::built_in(3, 5, 400);
        let scenery = Scenery { textures: &textures, sensor: &sensor, frame: frame_of(&lens).expect("valid"), seed: 4 };
        let tolerances = task.stated_tolerances().expect("reads");
        let settings = JointSettings { steps, tolerances, lens_share: [0.1, 0.9], ..settings(60, 32) };
        let fresh = || {
            let net = network(4, inputs, 1, Compute::Cpu).expect("valid");
            Stage::new(&scenery, &problem, net, settings.clone()).expect("starts")
        };
        let mut whole = fresh();
        while whole.step(&scenery).expect("runs").is_some() {}
        for left in [3, 25, 37] {
            let mut first = fresh();
            while first.steps() < left {
                first.step(&scenery).expect("runs");
            }
            let folder = tempfile::tempdir().expect("temporary folder");
            let path = folder.path().join("network.safetensors");
            first.joint.network.save(&path).expect("written");
            let text = first.state().to_text().expect("text");
            let network = Reconstructor::load(&path).expect("read");
            assert_eq!(network.parameters(), first.joint.network.parameters());
            let mut second = Stage::new(&scenery, &problem, network, settings.clone()).expect("starts");
            let state = crate::design::joint::state::State::from_text(&text, "state").expect("own text");
            second.restore(&scenery, &state).expect("goes on");
            assert_eq!(second.joint.lens, first.joint.lens, "{steps:?}, left at {left}");
            assert_eq!(second.renderer().plan, first.renderer().plan, "{steps:?}, left at {left}");
            assert_eq!(second.joint.steps.remembered(), first.joint.steps.remembered());
            for k in 0..3 {
                let [a, b] = [&mut first, &mut second].map(|s| s.step(&scenery).expect("runs").expect("not over"));
                assert_eq!(a.step, b.step);
                assert_eq!(
                    first.joint.network.parameters(),
                    second.joint.network.parameters(),
                    "{steps:?}, {left} + {k}"
                );
                assert_eq!(first.joint.lens, second.joint.lens, "{steps:?}, {left} + {k}");
            }
            while second.step(&scenery).expect("runs").is_some() {}

            assert_eq!(second.joint.lens, whole.joint.lens, "{steps:?}, left at {left}");
            assert_eq!(
                second.joint.network.parameters(),
                whole.joint.network.parameters(),
                "{steps:?}, left at {left}"
            );
            assert_eq!(second.joint.guide, whole.joint.guide, "{steps:?}, left at {left}");
        }
    }
}

const TOLERANCES: &str = "schema = 1\n[element.all]\nthickness_tolerance_mm = 0.1\nn_d_tolerance = 1e-3\n[surface.all]\nradius_percent = 0.5\n";

/// Pictures through lenses that are off by next to nothing give the steps of the lens itself: the gradient at a drawn lens is pulled back to this one. Off by
/// something, they give others, and judge by other lenses.
#[test]
fn lenses_as_built_stand_around_the_lens() {
    let task = task();
    let lens = task.lens(Glasses::shipped()).expect("shipped");
    let (problem, sensor) =
        (prepare(&task, &lens, "task", &mut |_, _| {}).expect("passes light").problem, Sensor::generic());
    let textures = Textures::built_in(3, 5, 400);
    let scenery = Scenery { textures: &textures, sensor: &sensor, frame: frame_of(&lens).expect("valid"), seed: 4 };
    let run = |percent: Option<f64>| {
        let text = |p: f64| format!("schema = 1\n[surface.all]\nradius_percent = {p}\n");
        let tolerances = percent.map(|p| Tolerances::parse(&text(p), "t.toml").expect("reads"));
        let settings =
            JointSettings { tolerances, settings: Some(SETTINGS), lens_share: [0.0, 1.0], ..settings(6, 32) };
        let net = network(4, Inputs::BARE, 1, Compute::Cpu).expect("valid");
        let (stage, _) = joint_stage(&scenery, &problem, net, settings, &mut |_, _| {}).expect("runs");
        assert_eq!(stage.lost(), 0);
        stage
    };
    let values = |stage: &Stage| problem.variables.values(&stage.joint.lens);
    let [mut own, mut near, mut far] = [None, Some(1e-9), Some(2.0)].map(run);
    let start = problem.variables.values(&problem.lens);
    let apart = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    let moved = apart(&values(&own), &start);
    assert!(moved > 0.0);
    let off = apart(&values(&near), &values(&own)) / moved;
    assert!(off < 1e-3, "{off}");
    assert!(apart(&values(&far), &values(&own)) > 10.0 * off * moved, "2 % of every radius");
    let judged = |stage: &mut Stage| stage.judged(&textures, 32).expect("judged").loss;
    assert!((judged(&mut near) / judged(&mut own) - 1.0).abs() < 1e-3);
    // Through the lens itself the same pictures are others.
    let itself = far.camera().judged(&textures, 32, 0..24).expect("judged").loss;
    assert!((judged(&mut far) / itself - 1.0).abs() > 1e-3, "{itself}");
}

/// Patches with more rows than the frame: what the network sees is still all there, told or not.
#[test]
fn a_patch_may_be_larger_than_the_frame() {
    let task = task();
    let lens = task.lens(Glasses::shipped()).expect("shipped");
    let (problem, sensor) =
        (prepare(&task, &lens, "task", &mut |_, _| {}).expect("passes light").problem, Sensor::generic());
    let textures = Textures::built_in(3, 1, 400);
    let scenery = Scenery { textures: &textures, sensor: &sensor, frame: frame_of(&lens).expect("valid"), seed: 4 };
    let settings = JointSettings { settings: Some(SETTINGS), lens_share: [0.0, 1.0], ..settings(1, 192) };
    for inputs in [Inputs::BARE, GUIDED] {
        let net = network(4, inputs, 1, Compute::Cpu).expect("valid");
        let (_, history) =
            joint_stage(&scenery, &problem, net, settings.clone(), &mut |_, e| assert!(e.loss.is_finite()))
                .expect("runs");
        assert!(history.is_empty(), "one step fills no entry");
    }
}

/// Depths take turns, and the lens is judged at all of them.
#[test]
fn a_stage_over_depths_sees_all_of_them() {
    let mut task = task();
    task.pictures.depths_mm = vec![700.0, 1000.0, 2000.0];
    let lens = task.lens(Glasses::shipped()).expect("shipped");
    let (problem, sensor) =
        (prepare(&task, &lens, "task", &mut |_, _| {}).expect("passes light").problem, Sensor::generic());
    assert_eq!(problem.merit.depths.len(), 3);
    let textures = Textures::built_in(3, 3, 400);
    let scenery = Scenery { textures: &textures, sensor: &sensor, frame: frame_of(&lens).expect("valid"), seed: 4 };
    let vergences = task.pictures.depths_mm.iter().map(|d| d.recip()).collect();
    let depth_power = 4.0;
    let settings = JointSettings { vergences, depth_power, settings: Some(SETTINGS), batch: 3, ..settings(4, 32) };
    let (stage, _) =
        joint_stage(&scenery, &problem, network(4, GUIDED, 1, Compute::Cpu).expect("valid"), settings, &mut |_, _| {})
            .expect("runs");
    assert_eq!(stage.renderer().plan.depths.len(), 3);
    // The power mean of their losses: those above it count more than once, the others less; judged by the worst of them.
    let weights: Vec<f64> = (0..3).map(|d| stage.joint.distances.weight(d)).collect();
    let (least, most) = weights.iter().fold((f64::INFINITY, 0.0f64), |(a, b), w| (a.min(*w), b.max(*w)));
    assert!(least > 0.0 && least < 1.0 && most > 1.0, "{weights:?}");
    assert_eq!(stage.state().distances.as_ref(), Some(&stage.joint.distances));
    let worst = stage.camera().judged(&textures, 32, 0..6).expect("judged");
    let mean = Camera { worst: false, ..stage.camera() }.judged(&textures, 32, 0..6).expect("judged");
    assert!(worst.output_psnr_db > 5.0 && worst.output_psnr_db < mean.output_psnr_db, "{worst:?} {mean:?}");
    assert!(worst.loss == mean.loss && worst.input_psnr_db != mean.input_psnr_db);
}

/// A black scene without noise says nothing about the lens: it stays as it is, and everything stays finite.
#[test]
fn a_scene_without_light_leaves_the_lens_alone() {
    let task = task();
    let lens = task.lens(Glasses::shipped()).expect("shipped");
    let (frame, v) = (frame_of(&lens).expect("valid"), lens.object_vergence);
    let mut problem = prepare(&task, &lens, "task", &mut |_, _| {}).expect("passes light").problem;
    // Nothing is held, so that the scene alone could move it.
    problem.constraints.clear();
    problem.bounds.fill([f64::NEG_INFINITY, f64::INFINITY]);
    let lens = problem.lens.clone();
    let renderer =
        Renderer::planned(&lens, &frame, &SpectralDensity::new(&Sensor::generic()), &[v], SETTINGS).expect("plans");
    let electronics = Electronics { noise: Noise::NONE, ..Electronics::from_sensor(&Sensor::generic()) };
    let textures = Textures::built_in(3, 1, 400);
    let mut patch = textures.draw(&mut fastrand::Rng::with_seed(2), &frame, &renderer.optics.maps[0], 32);
    patch.scene.texture.fill(0.0);
    let net = network(4, Inputs::BARE, 1, Compute::Cpu).expect("valid");
    let steps = LensSteps::new(Steps::Rays, &problem).expect("rays pass");
    let mut joint = Joint::new(lens.clone(), net, Guide::bare(&frame), steps);
    for _ in 0..3 {
        let renderer = joint.renderer(&renderer.plan, false).expect("traces");
        let report = joint.step(&renderer, None, &electronics, &[patch.clone()], [0.01, 1e-3]).expect("runs");
        assert!(report.loss.is_finite(), "{report:?}");
    }
    let variables = &problem.variables;
    let moved = variables.values(&joint.lens).into_iter().zip(variables.values(&lens));
    assert!(moved.into_iter().all(|(a, b)| (a - b).abs() < 1e-6), "the lens moved without light");
    assert!(joint.network.parameters().iter().all(|p| p.values.iter().all(|w| w.is_finite())));
}
