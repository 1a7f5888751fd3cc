//! The joint design step: patches → render → network → L1 → network gradient at the image → imaging, PSF and trace
//! adjoints → lens (paper eq. 15), with Adam on both sides.
//!
//! A step whose rays fail, whose distortion folds or whose loss is not finite is taken back: the lens returns to its
//! last good numbers and its step is halved.

use std::time::Instant;

use ndarray::{Array3, ArrayView4, Axis, Ix3, SliceInfo, SliceInfoElem, s};
use rayon::prelude::*;

use super::chain::{Patch, PatchForward, forward, forward_vjp};
use super::constraint::Constraints;
use crate::error::Result;
use crate::imaging::develop::simulate::Electronics;
use crate::imaging::guide::{Guide, Record};
use crate::imaging::metrics::decibel;
use crate::imaging::render::gradient_error::Chosen;
use crate::imaging::render::{RenderPlan, Renderer};
use crate::lens::Lens;
use crate::lens::variables::Variables;
use crate::network::Reconstructor;
use crate::psf::OpticsBar;
use crate::trace::rims::overlapping_rims;

/// Adam on the lens's scaled variables (f64).
#[derive(Clone, Debug)]
struct Adam {
    first: Vec<f64>,
    second: Vec<f64>,
    steps: i32,
}

impl Adam {
    fn new(count: usize) -> Self {
        Self { first: vec![0.0; count], second: vec![0.0; count], steps: 0 }
    }

    fn step(&mut self, x: &mut [f64], g: &[f64], rate: f64) {
        const B1: f64 = 0.9;
        const B2: f64 = 0.99;
        self.steps += 1;
        let (c1, c2) = (1.0 - B1.powi(self.steps), 1.0 - B2.powi(self.steps));
        for i in 0..x.len() {
            self.first[i] = B1 * self.first[i] + (1.0 - B1) * g[i];
            self.second[i] = B2 * self.second[i] + (1.0 - B2) * g[i] * g[i];
            x[i] -= rate * (self.first[i] / c1) / ((self.second[i] / c2).sqrt() + 1e-12);
        }
    }
}

/// Lens and network on their way.
pub struct Joint {
    /// The lens now.
    pub lens: Lens,
    /// The network now.
    pub network: Reconstructor,
    /// What it is told beside the capture: its filters are those of the lens some steps ago.
    pub guide: Guide,
    /// How often the filters were made anew, and the seconds that took.
    pub refreshed: (usize, f64),
    /// Which numbers are free.
    pub variables: Variables,
    /// What the lens must keep.
    pub constraints: Constraints,
    /// Steps that were taken back.
    pub rejected: usize,
    /// How finely it was rendered: settings with their gradient's error, and the step from which on they were used.
    pub fineness: Vec<(usize, Chosen)>,
    values: Vec<f64>,
    good: (Vec<f64>, Lens),
    adam: Adam,
    damping: f64,
}

/// What a step did.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// Mean L1 loss of the batch after the network.
    pub loss: f64,
    /// Constraint penalty.
    pub penalty: f64,
    /// PSNR of the network's input against the truth, linear light, dB.
    pub input_psnr_db: f64,
    /// PSNR of its output.
    pub output_psnr_db: f64,
    /// Whether the lens moved.
    pub moved: bool,
}

/// Mean absolute difference, and PSNR in linear light (dB, at most 120), of two pictures of equal size.
pub(super) fn l1_and_psnr<'a>(
    a: impl ExactSizeIterator<Item = &'a f32>,
    b: impl Iterator<Item = &'a f32>,
) -> (f64, f64) {
    let n = a.len() as f64;
    let (mut l1, mut l2) = (0.0, 0.0);
    for (x, y) in a.zip(b) {
        let d = f64::from(x - y);
        l1 += d.abs();
        l2 += d * d;
    }
    (l1 / n, decibel((l2 / n).max(1e-12)))
}

/// The part of a patch that the network sees, in what is rendered.
pub(super) fn middle(patch: &Patch) -> SliceInfo<[SliceInfoElem; 3], Ix3, Ix3> {
    let Patch { region, part, .. } = patch;
    let (row, col) = ((part.row - region.row).unsigned_abs(), (part.col - region.col).unsigned_abs());
    s![.., row..row + part.rows, col..col + part.cols]
}

impl Joint {
    /// Starts from `lens` and `network`, which `guide` tells what it asks for.
    pub fn new(
        lens: Lens,
        network: Reconstructor,
        guide: Guide,
        variables: Variables,
        constraints: Constraints,
    ) -> Self {
        let values = variables.values(&lens);
        let adam = Adam::new(values.len());
        Self {
            good: (values.clone(), lens.clone()),
            lens,
            network,
            guide,
            refreshed: (0, 0.0),
            variables,
            constraints,
            rejected: 0,
            fineness: Vec::new(),
            values,
            adam,
            damping: 1.0,
        }
    }

    /// The lens now, traced for `plan`, with widths and nodes anew if `replan`; a lens that fails is taken back to its last good
    /// numbers.
    ///
    /// # Errors
    /// A lens that fails and is the last good one.
    pub fn renderer(&mut self, plan: &RenderPlan, replan: bool) -> Result<Renderer> {
        if replan && let Ok(renderer) = Renderer::replanned(&self.lens, plan) {
            return Ok(renderer);
        }
        match Renderer::new(&self.lens, plan) {
            Err(_) if self.values != self.good.0 => {
                self.take_back();
                Renderer::new(&self.lens, plan)
            }
            other => other,
        }
    }

    /// Makes the network's filters anew for the lens that `renderer` holds; a lens that has none keeps the old ones.
    pub fn refresh(&mut self, renderer: &Renderer, electronics: &Electronics) {
        if self.guide.filters().is_none() {
            return;
        }
        let started = Instant::now();
        if let Ok(guide) = Guide::new(self.guide.inputs(), renderer, electronics) {
            self.guide = guide;
            self.refreshed.0 += 1;
        }
        self.refreshed.1 += started.elapsed().as_secs_f64();
    }

    /// One step on `patches` (equal parts) through `renderer`, which holds the lens now. `lens_rate` 0 holds the lens.
    ///
    /// # Errors
    /// A patch at a distance that the renderer was not made for; a network that fails.
    pub fn step(
        &mut self,
        renderer: &Renderer,
        electronics: &Electronics,
        patches: &[Patch],
        lens_rate: f64,
        network_rate: f64,
    ) -> Result<Report> {
        let done = patches
            .par_iter()
            .map(|patch| forward::<f32>(renderer, electronics, patch))
            .collect::<Result<Vec<PatchForward<f32>>>>()?;
        // What the network sees: the middle of each patch, told.
        let told: Vec<(Array3<f32>, Record)> = patches
            .par_iter()
            .zip(&done)
            .map(|(patch, f)| self.guide.over_recorded(f.developed.view(), patch.region, patch.part))
            .collect();
        let truths: Vec<_> = patches.iter().zip(&done).map(|(patch, f)| f.truth.slice(middle(patch))).collect();
        let inputs: Vec<_> = told.iter().map(|(channels, _)| channels.view()).collect();
        let [input, target] = [&inputs, &truths].map(|all| ndarray::stack(Axis(0), all).expect("equal sizes"));
        let psnr = |a: ArrayView4<'_, f32>| l1_and_psnr(a.iter(), target.iter()).1;
        let input_psnr_db = psnr(input.slice(s![.., ..3, .., ..]));
        if lens_rate == 0.0 {
            let s = self.network.step_network_only(input.view(), target.view(), network_rate)?;
            return Ok(Report {
                loss: f64::from(s.loss),
                penalty: 0.0,
                input_psnr_db,
                output_psnr_db: psnr(s.output.view()),
                moved: false,
            });
        }
        let s = self.network.step(input.view(), target.view(), network_rate, true)?;
        // Back through imaging, patch by patch, and through the lens once.
        let bars: Vec<OpticsBar> = patches
            .par_iter()
            .zip(&done)
            .enumerate()
            .map(|(i, (patch, f))| {
                let x_bar = self.guide.over_vjp(&told[i].1, s.input_bar.index_axis(Axis(0), i));
                let mut t_bar = Array3::zeros(f.truth.raw_dim());
                t_bar.slice_mut(middle(patch)).assign(&s.target_bar.index_axis(Axis(0), i));
                forward_vjp(renderer, electronics, patch, f, x_bar.view(), t_bar.view())
            })
            .collect();
        let mut bar = OpticsBar::zeros(&renderer.optics);
        bars.iter().for_each(|b| bar.add(b));
        let mut gradient = renderer.lens_gradient(&self.lens, &bar);
        let penalty = self.constraints.penalty(&self.lens, &mut gradient);
        let g = self.variables.gradient(&gradient);
        let finite = s.loss.is_finite() && g.iter().all(|v| v.is_finite());
        if finite {
            self.good = (self.values.clone(), self.lens.clone());
            self.adam.step(&mut self.values, &g, lens_rate * self.damping);
            self.damping = (self.damping * 1.02).min(1.0);
            let clear = |moved: Lens| overlapping_rims(&moved, &moved.name).map(|_| moved);
            match self.variables.lens(&self.lens, &self.values).and_then(clear) {
                Ok(moved) => self.lens = moved,
                Err(_) => self.take_back(),
            }
        }
        Ok(Report {
            loss: f64::from(s.loss),
            penalty,
            input_psnr_db,
            output_psnr_db: psnr(s.output.view()),
            moved: finite,
        })
    }

    fn take_back(&mut self) {
        self.rejected += 1;
        self.damping *= 0.5;
        (self.values, self.lens) = self.good.clone();
        self.adam.first.fill(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::design::data::Textures;
    use crate::design::run::{JointSettings, Scenery, joint_stage, network};
    use crate::design::schedule::Budget;
    use crate::design::task::Task;
    use crate::imaging::guide::Inputs;
    use crate::imaging::render::{Settings, frame_of};
    use crate::imaging::sensor::Sensor;
    use crate::imaging::sensor::noise::Noise;
    use crate::imaging::sensor::spectrum::SpectralDensity;
    use crate::lens::catalogue::Glasses;

    const SETTINGS: Settings = Settings { dense: 300, wavelengths: 3, outside: 1e-2, cells: 16, ..Settings::DESIGN };

    fn task() -> Task {
        let mut task = Task::demo();
        let sensor = task.sensor.as_mut().expect("the demo's");
        (sensor.columns, sensor.rows, sensor.pitch_um) = (240, 160, 80.0);
        task
    }

    /// Scene → loss through the f32 network: the lens gradient against central differences, 1e-2. The network sees the capture alone,
    /// or is told of its lens by filters that stay while the lens moves.
    #[test]
    fn the_lens_gradient_through_the_network_agrees_with_differences() {
        gradient_agrees(Inputs::BARE);
        gradient_agrees(TOLD);
    }

    const TOLD: Inputs = Inputs { wiener: true, field: true };

    fn gradient_agrees(inputs: Inputs) {
        let task = task();
        let (lens, sensor) = (task.lens(Glasses::shipped()).expect("shipped"), Sensor::generic());
        let frame = frame_of(&lens).expect("valid");
        let textures = Textures::built_in(3, 5, 400);
        let v = lens.object_vergence;
        let renderer = Renderer::planned(&lens, &frame, &SpectralDensity::new(&sensor), &[v], SETTINGS).expect("plans");
        let electronics = Electronics::of(&sensor);
        let guide = Guide::new(inputs, &renderer, &electronics).expect("filters");
        let mut net = network(8, inputs, 5).expect("valid");
        let mut rng = fastrand::Rng::with_seed(2);
        let map = &renderer.optics.maps[0];
        let mut draw = || textures.draw_within(&mut rng, &frame, map, 64, guide.reach());
        // A few steps, so that the network is no identity.
        for _ in 0..30 {
            let p = draw();
            let f = forward::<f32>(&renderer, &electronics, &p).expect("renders");
            let told = guide.over(f.developed.view(), p.region, p.part);
            let truth = f.truth.slice(middle(&p)).insert_axis(Axis(0));
            net.step_network_only(told.view().insert_axis(Axis(0)), truth, 2e-3).expect("trains");
        }
        let patch = draw();
        assert_eq!(patch.region == patch.part, inputs.is_bare());
        // The loss in f64 from the f32 pictures, so that its own rounding stays below the differences.
        let mut loss = |lens: &Lens| -> (f64, PatchForward<f32>, Record, crate::network::Step) {
            let renderer = Renderer::new(lens, &renderer.plan).expect("traces");
            let f = forward::<f32>(&renderer, &electronics, &patch).expect("renders");
            let (told, record) = guide.over_recorded(f.developed.view(), patch.region, patch.part);
            let truth = f.truth.slice(middle(&patch)).to_owned();
            let (x, t) = (told.view().insert_axis(Axis(0)), truth.view().insert_axis(Axis(0)));
            let s = net.step(x, t, 0.0, false).expect("runs");
            let l1 = s.output.iter().zip(&truth).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>();
            (l1 / s.output.len() as f64, f, record, s)
        };
        let (_, f, record, s) = loss(&lens);
        let x_bar = guide.over_vjp(&record, s.input_bar.index_axis(Axis(0), 0));
        let mut t_bar = Array3::zeros(f.truth.raw_dim());
        t_bar.slice_mut(middle(&patch)).assign(&s.target_bar.index_axis(Axis(0), 0));
        let bar = forward_vjp(&renderer, &electronics, &patch, &f, x_bar.view(), t_bar.view());
        let g = renderer.lens_gradient(&lens, &bar);
        let vars = Variables::refracting(&lens);
        let (x, gradient) = (vars.values(&lens), vars.gradient(&g));
        let norm = gradient.iter().map(|v| v * v).sum::<f64>().sqrt();
        for seed in 0..6 {
            let rng = &mut fastrand::Rng::with_seed(40 + seed);
            // Half along the gradient, half at random, unit length: a slope that f32 can resolve.
            let mut dx: Vec<f64> = gradient.iter().map(|v| v / norm).collect();
            dx.iter_mut().for_each(|d| *d += (rng.f64() - 0.5) * 0.8);
            let length = dx.iter().map(|v| v * v).sum::<f64>().sqrt();
            dx.iter_mut().for_each(|d| *d /= length);
            let pulled: f64 = gradient.iter().zip(&dx).map(|(a, b)| a * b).sum();
            let h = 2e-4;
            let mut at = |t: f64| {
                let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + t * b).collect();
                loss(&vars.lens(&lens, &moved).expect("a lens")).0
            };
            let numeric = (at(h) - at(-h)) / (2.0 * h);
            crate::testing::assert_rel(pulled, numeric, 1e-2, 0.0, &format!("{:?}, direction {seed}", inputs.names()));
        }
    }

    /// A budget in steps gives the same bits again, and the lens moves.
    #[test]
    fn a_joint_stage_repeats_to_the_bit() {
        let task = task();
        let (lens, sensor) = (task.lens(Glasses::shipped()).expect("shipped"), Sensor::generic());
        let textures = Textures::built_in(3, 5, 400);
        let scenery = Scenery { textures: &textures, sensor: &sensor, frame: frame_of(&lens).expect("valid"), seed: 4 };
        let settings = JointSettings {
            budget: Budget::Steps(6),
            patch: 32,
            batch: 1,
            lens_rate: 0.01,
            network_rate: 1e-3,
            settings: None,
        };
        for inputs in [Inputs::BARE, TOLD] {
            let run = || {
                let net = network(4, inputs, 1).expect("valid");
                joint_stage(&scenery, &lens, net, settings, &mut |_, _| {}).expect("runs").0
            };
            let (a, b) = (run(), run());
            assert_eq!(a.lens, b.lens);
            assert_eq!(a.fineness, b.fineness);
            assert!(a.fineness.len() == 1 && a.fineness[0].1.holds, "{:?}", a.fineness);
            assert_ne!(a.lens, lens);
            assert_eq!(a.network.parameters(), b.network.parameters());
            // At the end the filters are those of the finished lens.
            assert_eq!((a.refreshed.0, &a.guide), (usize::from(!inputs.is_bare()), &b.guide));
        }
    }

    /// Patches with more rows than the frame: what the network sees is still all there, told or not.
    #[test]
    fn a_patch_may_be_larger_than_the_frame() {
        let task = task();
        let (lens, sensor) = (task.lens(Glasses::shipped()).expect("shipped"), Sensor::generic());
        let textures = Textures::built_in(3, 1, 400);
        let scenery = Scenery { textures: &textures, sensor: &sensor, frame: frame_of(&lens).expect("valid"), seed: 4 };
        let budget = Budget::Steps(1);
        let (lens_rate, network_rate, settings) = (0.01, 1e-3, Some(SETTINGS));
        let settings = JointSettings { budget, patch: 192, batch: 1, lens_rate, network_rate, settings };
        for inputs in [Inputs::BARE, TOLD] {
            let net = network(4, inputs, 1).expect("valid");
            let (_, history) =
                joint_stage(&scenery, &lens, net, settings, &mut |_, e| assert!(e.loss.is_finite())).expect("runs");
            assert!(history.is_empty(), "one step fills no entry");
        }
    }

    /// A black scene without noise says nothing about the lens: it stays as it is, and everything stays finite.
    #[test]
    fn a_scene_without_light_leaves_the_lens_alone() {
        let task = task();
        let (lens, sensor) = (task.lens(Glasses::shipped()).expect("shipped"), Sensor::generic());
        let (frame, v) = (frame_of(&lens).expect("valid"), lens.object_vergence);
        let renderer = Renderer::planned(&lens, &frame, &SpectralDensity::new(&sensor), &[v], SETTINGS).expect("plans");
        let electronics = Electronics { noise: Noise::NONE, ..Electronics::of(&sensor) };
        let textures = Textures::built_in(3, 1, 400);
        let mut patch = textures.draw(&mut fastrand::Rng::with_seed(2), &frame, &renderer.optics.maps[0], 32);
        patch.scene.texture.fill(0.0);
        let mut constraints = Constraints::of(&lens);
        // Bounds that the lens meets, so that the scene alone could move it.
        (constraints.min_centre_mm, constraints.min_edge_mm, constraints.min_gap_mm) = (0.0, -50.0, -50.0);
        (constraints.min_back_mm, constraints.max_reach) = (0.0, 10.0);
        let mut joint = Joint::new(
            lens.clone(),
            network(4, Inputs::BARE, 1).expect("valid"),
            Guide::bare(&frame),
            Variables::refracting(&lens),
            constraints,
        );
        for _ in 0..3 {
            let renderer = joint.renderer(&renderer.plan, false).expect("traces");
            let report = joint.step(&renderer, &electronics, &[patch.clone()], 0.01, 1e-3).expect("runs");
            assert!(report.loss.is_finite() && report.penalty < 1e-20, "{report:?}");
        }
        let moved = joint.variables.values(&joint.lens).into_iter().zip(joint.variables.values(&lens));
        assert!(moved.into_iter().all(|(a, b)| (a - b).abs() < 1e-9), "the lens moved without light");
        assert!(joint.network.parameters().iter().all(|p| p.values.iter().all(|w| w.is_finite())));
    }
}
