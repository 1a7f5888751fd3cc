//! The joint stage of a design: lens and network together. The final network for the finished lens is [`super::training`]'s.
//!
//! A budget in steps is deterministic (same seed, machine, thread count: same bits); one in seconds is for people who wait.

use std::time::Instant;

use ndarray::{Axis, s};

use super::chain::{Patch, forward};
use super::constraint::Constraints;
use super::data::Textures;
use super::joint::{Joint, Report, l1_and_psnr, middle};
use super::schedule::Budget;
use super::task::Task;
use crate::error::Result;
use crate::imaging::develop::simulate::Electronics;
use crate::imaging::frame::Frame;
use crate::imaging::guide::{Guide, Inputs};
use crate::imaging::render::gradient_error::{Chosen, Patches, cheapest};
use crate::imaging::render::{Renderer, Settings};
use crate::imaging::sensor::Sensor;
use crate::imaging::sensor::spectrum::SpectralDensity;
use crate::lens::Lens;
use crate::lens::variables::Variables;
use crate::network::{Reconstructor, UnetConfig};

/// What is trained on.
#[derive(Clone, Debug)]
pub struct Scenery<'a> {
    /// Textures to train on.
    pub textures: &'a Textures,
    /// The sensor.
    pub sensor: &'a Sensor,
    /// The frame it covers.
    pub frame: Frame,
    /// Seed of every draw.
    pub seed: u64,
}

/// One entry of the joint stage's history.
#[derive(Clone, Copy, Debug, serde::Serialize)]
pub struct Entry {
    /// Seconds since the stage began.
    pub seconds: f64,
    /// Mean L1 loss over the last steps.
    pub loss: f64,
    /// PSNR of the network's input, dB.
    pub input_psnr_db: f64,
    /// PSNR of its output, dB.
    pub output_psnr_db: f64,
}

/// Settings of the joint stage.
#[derive(Clone, Copy, Debug)]
pub struct JointSettings {
    /// When it ends.
    pub budget: Budget,
    /// Patch side, pixels; a multiple of 4.
    pub patch: usize,
    /// Patches a step.
    pub batch: usize,
    /// Largest step of the lens, scaled units; 0 freezes the lens.
    pub lens_rate: f64,
    /// Largest step of the network.
    pub network_rate: f64,
    /// How finely it is rendered; `None`: as finely as the lens gradient needs ([`cheapest`]).
    pub settings: Option<Settings>,
}

impl JointSettings {
    /// What `task` asks for.
    ///
    /// # Errors
    /// As [`Task::budget`].
    pub fn of(task: &Task) -> Result<Self> {
        Ok(Self {
            budget: task.budget()?,
            patch: task.patch_px,
            batch: task.batch,
            lens_rate: if task.freeze_lens { 0.0 } else { task.lens_rate },
            network_rate: task.network_rate,
            settings: None,
        })
    }
}

/// Average over this many steps in a history.
const SMOOTH: usize = 10;

/// Steps between plans.
const REPLAN: usize = 25;
/// Patches that settings are chosen by, and their side at most, pixels: converged kernels of large ones take much memory.
pub(super) const JUDGED: (usize, usize) = (6, 96);
/// The step at which settings are chosen again for the first time; then at every doubling.
const AGAIN: usize = 100;

/// Settings whose gradient is well below the noise of patches like those that `renderer`'s lens will be designed on.
fn choose(
    scenery: &Scenery<'_>,
    density: &SpectralDensity,
    lens: &Lens,
    renderer: &Renderer,
    (side, step): (usize, usize),
) -> Result<Chosen> {
    let mut rng = fastrand::Rng::with_seed(scenery.seed ^ 0x6669_6e65 ^ step as u64);
    let map = &renderer.optics.maps[0];
    let drawn: Vec<Patch> =
        (0..JUDGED.0).map(|_| scenery.textures.draw(&mut rng, &scenery.frame, map, side.min(JUDGED.1))).collect();
    let parts = drawn.iter().map(|p| (&p.scene, p.region)).collect();
    cheapest(&Patches { lens, frame: &scenery.frame, density, parts })
}

/// The joint stage's rates, of their largest: a rise over the first 3 %, while both of Adam's averages are young and the lens
/// must not be thrown, then a half cosine to zero.
fn schedule(used: f64) -> f64 {
    let rise = (used / 0.03).min(1.0);
    rise * 0.5 * (1.0 + (std::f64::consts::PI * used.clamp(0.0, 1.0)).cos())
}

/// Lens and network together. A network that is told of its lens gets filters made anew whenever windows and nodes are, and of the
/// finished lens at the end. `progress(share, last entry)` is called after every step.
pub fn joint_stage(
    scenery: &Scenery<'_>,
    lens: &Lens,
    network: Reconstructor,
    settings: JointSettings,
    progress: &mut dyn FnMut(f64, &Entry),
) -> Result<(Joint, Vec<Entry>)> {
    let density = SpectralDensity::new(scenery.sensor);
    let electronics = Electronics::of(scenery.sensor);
    let v = lens.object_vergence;
    let first = settings.settings.unwrap_or(Settings::DESIGN);
    let mut renderer = Renderer::planned(lens, &scenery.frame, &density, &[v], first)?;
    let chooses = settings.settings.is_none() && settings.lens_rate > 0.0;
    let mut again = 0;
    let guide = Guide::new(network.config().inputs, &renderer, &electronics)?;
    let mut joint = Joint::new(lens.clone(), network, guide, Variables::refracting(lens), Constraints::of(lens));
    let mut rng = fastrand::Rng::with_seed(scenery.seed);
    let (mut history, mut recent) = (Vec::new(), Vec::new());
    let started = Instant::now();
    let mut step = 0;
    loop {
        let used = settings.budget.used(step, started);
        if used >= 1.0 {
            break;
        }
        if step > 0 && settings.lens_rate > 0.0 {
            // Windows and nodes follow the PSF as the lens gets better.
            renderer = joint.renderer(&renderer.plan, step % REPLAN == 0)?;
            if step % REPLAN == 0 {
                joint.refresh(&renderer, &electronics);
            }
        }
        // A lens that grows sharper needs finer settings; one that cannot be judged now keeps those it has.
        if chooses
            && step == again
            && let Ok(chosen) = choose(scenery, &density, &joint.lens, &renderer, (settings.patch, step))
        {
            let planned = if chosen.settings == renderer.plan.settings {
                Ok(renderer)
            } else {
                Renderer::planned(&joint.lens, &scenery.frame, &density, &[v], chosen.settings).map_err(|_| renderer)
            };
            if planned.is_ok() {
                joint.fineness.push((step, chosen));
            }
            renderer = planned.unwrap_or_else(|kept| kept);
        }
        if step == again {
            again = (2 * again).max(AGAIN);
        }
        let map = &renderer.optics.maps[0];
        let reach = joint.guide.reach();
        let mut draw = || scenery.textures.draw_within(&mut rng, &scenery.frame, map, settings.patch, reach);
        let patches: Vec<Patch> = (0..settings.batch).map(|_| draw()).collect();
        let rate = schedule(used);
        let lens_rate = settings.lens_rate * rate;
        let report = joint.step(&renderer, &electronics, &patches, lens_rate, settings.network_rate * rate)?;
        step += 1;
        recent.push(report);
        let entry = average(&recent, started);
        if recent.len() == SMOOTH {
            history.push(entry);
            recent.clear();
        }
        progress(used.min(1.0), &entry);
    }
    if settings.lens_rate > 0.0
        && joint.guide.filters().is_some()
        && let Ok(finished) = joint.renderer(&renderer.plan, true)
    {
        joint.refresh(&finished, &electronics);
    }
    Ok((joint, history))
}

fn average(recent: &[Report], started: Instant) -> Entry {
    let mean = |f: fn(&Report) -> f64| recent.iter().map(f).sum::<f64>() / recent.len().max(1) as f64;
    Entry {
        seconds: started.elapsed().as_secs_f64(),
        loss: mean(|r| r.loss),
        input_psnr_db: mean(|r| r.input_psnr_db),
        output_psnr_db: mean(|r| r.output_psnr_db),
    }
}

/// Mean L1 and PSNR after the network over held-out patches: how a design is judged.
pub fn validate(
    scenery: &Scenery<'_>,
    lens: &Lens,
    (network, guide): (&Reconstructor, &Guide),
    patch: usize,
    count: usize,
    settings: Settings,
) -> Result<Entry> {
    let density = SpectralDensity::new(scenery.sensor);
    let electronics = Electronics::of(scenery.sensor);
    let v = lens.object_vergence;
    let started = Instant::now();
    let renderer = Renderer::planned(lens, &scenery.frame, &density, &[v], settings)?;
    let mut rng = fastrand::Rng::with_seed(scenery.seed);
    let mut reports = Vec::with_capacity(count);
    for _ in 0..count {
        let map = &renderer.optics.maps[0];
        let p = scenery.textures.draw_within(&mut rng, &scenery.frame, map, patch, guide.reach());
        let f = forward::<f32>(&renderer, &electronics, &p)?;
        let told = guide.over(f.developed.view(), p.region, p.part);
        let output = network.forward(told.view().insert_axis(Axis(0)))?;
        let truth = f.truth.slice(middle(&p));
        let error = |a: ndarray::ArrayView3<'_, f32>| l1_and_psnr(a.iter(), truth.iter());
        let (input, out) = (error(told.slice(s![..3, .., ..])), error(output.index_axis(Axis(0), 0)));
        reports.push(Report { loss: out.0, penalty: 0.0, input_psnr_db: input.1, output_psnr_db: out.1, moved: false });
    }
    Ok(average(&reports, started))
}

/// A fresh network that sees `inputs` beside the capture.
pub fn network(base_width: usize, inputs: Inputs, seed: u64) -> Result<Reconstructor> {
    Reconstructor::new(UnetConfig { inputs, ..UnetConfig::bare(base_width, 3) }, seed)
}
