//! The joint stage of a design: lens and network together, step by step. [`Stage`] is the loop without a folder, [`super::designing`] the
//! one with it. The final network for the finished lens is [`crate::design::training`]'s.
//!
//! Patches, noise and settings depend on the seed and the number of a step alone, so a stage goes on from its [`State`] with the same
//! bits (same machine, same number of threads). A budget in time becomes one in steps when the lens has moved (`Schedule`).

use std::time::Instant;

use super::as_built::{AsBuilt, BUILT, UNSEEN, widest};
use super::distances::Distances;
use super::images::group;
use super::judge::{Camera, Tally, corner_of};
use super::lens_steps::{LensSteps, Stepped, Steps};
use super::scenery::{Entry, Scenery};
use super::sensor_loss::SensorLoss;
use super::state::State;
use super::{Joint, Report};
use crate::design::bending;
use crate::design::chain::Patch;
use crate::design::data::Textures;
use crate::design::places::{JUDGED, Places};
use crate::design::schedule::Schedule;
use isoplanat_base::error::Result;
use isoplanat_imaging::develop::simulate::Electronics;
use isoplanat_imaging::guide::{Guide, Inputs};
use isoplanat_imaging::render::gradient_error::{Chosen, Patches, cheapest};
use isoplanat_imaging::render::{Renderer, Settings};
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_network::{Compute, Reconstructor, UnetConfig};
use isoplanat_optics::lens::Lens;
use isoplanat_optics::optimize::Problem;

pub use super::settings::JointSettings;

/// Average over this many steps in a history.
pub(in crate::design) const SMOOTH: usize = 10;

/// Patches of a judgement.
const PICTURES: u64 = 24;
/// Steps between plans.
const REPLAN: usize = 25;
/// The step at which settings are chosen again for the first time; then at every doubling.
const AGAIN: usize = 100;
/// Share of a length in time after which it becomes one in steps: half, or when the lens has stood still for a while, since steps with
/// it moving take longer.
const SETTLES: f64 = 0.5;
const AFTER_LENS: f64 = 0.03;
/// Steps whose median time is the pace.
const PACE: usize = 31;

/// Lens and network on their way, with how they are rendered and what is to come.
pub struct Stage {
    settings: JointSettings,
    density: SpectralDensity,
    electronics: Electronics,
    places: Places,
    renderer: Renderer,
    vergences: Vec<f64>,
    /// The lens for which the plan's rays were chosen, and the one for which its windows and nodes were.
    planned: [Lens; 2],
    /// The lens whose filters the network is told, and the one that object points of the lens's steps are of.
    told: Lens,
    looked_at: Lens,
    /// Lenses within tolerances, and how many of those that were drawn could not be rendered.
    as_built: Option<AsBuilt>,
    lost: usize,
    /// Lens and network.
    pub joint: Joint,
    /// How finely it was rendered: settings with their gradient's error, and the step from which on they were used.
    pub fineness: Vec<(usize, Chosen)>,
    again: usize,
    step: usize,
    schedule: Schedule,
    /// Seconds before this process.
    before: f64,
    started: Instant,
    pace: Vec<f64>,
    recent: Vec<Report>,
}

impl Stage {
    /// Starts from `problem`'s lens and `network`.
    ///
    /// # Errors
    /// A lens that cannot be rendered; as `LensSteps::new`.
    pub fn new(
        scenery: &Scenery<'_>,
        problem: &Problem,
        network: Reconstructor,
        settings: JointSettings,
    ) -> Result<Self> {
        let lens = &problem.lens;
        let density = SpectralDensity::new(scenery.sensor);
        let electronics = Electronics::from_sensor(scenery.sensor);
        let own = [lens.object_vergence];
        let vergences = if settings.vergences.is_empty() { own.to_vec() } else { settings.vergences.clone() };
        let diffraction = settings.diffraction.stated();
        let first = settings.settings.unwrap_or(Settings { diffraction, ..Settings::DESIGN });
        let around = |t| AsBuilt::new(t, &problem.merit, lens, (scenery.seed, settings.worst_of));
        let as_built = settings.tolerances.as_ref().map(around).transpose()?;
        let planned = |l: &Lens| Renderer::planned(l, &scenery.frame, &density, &vergences, first);
        let (at, renderer) = widest(lens, as_built.as_ref(), planned)?;
        let guide = Guide::new(network.config().inputs, &renderer, &electronics)?;
        // A lens that is held needs no rays of its own.
        let steps = if settings.lens_rate > 0.0 { settings.steps } else { Steps::Scaled };
        let mut joint = Joint::new(lens.clone(), network, guide, LensSteps::new(steps, problem)?);
        joint.least_illumination = settings.least_illumination;
        joint.distances = Distances::new(settings.depth_power, vergences.len());
        let share = SETTLES.max(settings.lens_share[1] + AFTER_LENS).min(1.0 - AFTER_LENS);
        Ok(Self {
            places: Places::new(&scenery.frame, settings.patch, settings.spread),
            schedule: Schedule { rate: 1.0, rise: 0, share, length: settings.length, settled: None },
            planned: [at.clone(), at],
            told: lens.clone(),
            looked_at: lens.clone(),
            settings,
            density,
            electronics,
            renderer,
            vergences,
            as_built,
            lost: 0,
            joint,
            fineness: Vec::new(),
            again: 0,
            step: 0,
            before: 0.0,
            started: Instant::now(),
            pace: Vec::new(),
            recent: Vec::new(),
        })
    }

    /// Goes on from `state`, which a stage of the same problem and settings had, with the network as it was then.
    ///
    /// # Errors
    /// Lenses that cannot be rendered.
    pub(crate) fn restore(&mut self, scenery: &Scenery<'_>, state: &State) -> Result<()> {
        let [at, seen, told, looked_at, lens] = state.lenses()?;
        let chosen = state.settings.unwrap_or(self.renderer.plan.settings);
        let first = Renderer::planned(&at, &scenery.frame, &self.density, &self.vergences, chosen)?;
        let plan = if at == seen { first.plan } else { Renderer::replanned(&seen, &first.plan)?.plan };
        if self.joint.guide.facts().is_some() {
            let inputs = self.joint.guide.inputs();
            self.joint.guide = Guide::new(inputs, &Renderer::new(&told, &plan)?, &self.electronics)?;
        }
        self.renderer = Renderer::new(&lens, &plan)?;
        if looked_at != self.looked_at {
            self.joint.steps.look_at(&looked_at)?;
        }
        (self.planned, self.told, self.looked_at) = ([at, seen], told, looked_at);
        if let (Some(built), Some(around)) = (&mut self.as_built, state.around()?) {
            built.follow(&around);
        }
        self.joint.good = lens.clone();
        self.joint.lens = lens;
        self.joint.damping = state.damping;
        self.joint.rejected = state.rejected;
        self.joint.refreshed = (state.refreshed, state.refreshing_seconds);
        self.joint.steps.remember(state.remembered.clone());
        self.joint.noise = state.noise.clone();
        if let Some(distances) = &state.distances {
            self.joint.distances.go_on(distances);
        }
        self.lost = state.lost;
        self.fineness = state.fineness.iter().map(|f| (f.step, f.chosen)).collect();
        (self.again, self.step, self.before) = (state.again, state.step, state.seconds);
        self.schedule.settled = state.settled;
        (self.started, self.recent, self.pace) = (Instant::now(), Vec::new(), Vec::new());
        Ok(())
    }

    /// Where it stands, but for the network.
    pub fn state(&self) -> State {
        let lenses = [&self.planned[0], &self.planned[1], &self.told, &self.looked_at, &self.joint.lens];
        State::new(lenses, |state| {
            state.settings = Some(self.renderer.plan.settings);
            state.damping = self.joint.damping;
            state.rejected = self.joint.rejected;
            (state.refreshed, state.refreshing_seconds) = self.joint.refreshed;
            state.remembered = self.joint.steps.remembered();
            state.noise = self.joint.noise.clone();
            state.distances = Some(self.joint.distances.clone());
            state.keep_around(self.as_built.as_ref().map(|b| &b.around));
            state.fineness = self
                .fineness
                .iter()
                .map(|(step, chosen)| super::state::Fineness { step: *step, chosen: *chosen })
                .collect();
            (state.again, state.step, state.seconds) = (self.again, self.step, self.seconds());
            state.lost = self.lost;
            state.settled = self.schedule.settled;
        })
    }

    /// Steps done.
    pub fn steps(&self) -> usize {
        self.step
    }

    /// Drawn lenses that showed nothing: in a step the lens itself stood in for them, in a judgement they counted as wrong.
    pub fn lost(&self) -> usize {
        self.lost
    }

    /// Steps in all, where that is known.
    pub(crate) fn total(&self) -> Option<u64> {
        self.schedule.total()
    }

    /// Seconds so far, those before a resume included.
    pub fn seconds(&self) -> f64 {
        self.before + self.started.elapsed().as_secs_f64()
    }

    /// Share done, 0 to 1.
    pub(crate) fn used(&self) -> f64 {
        self.schedule.done(self.step as u64, self.seconds())
    }

    /// The lens as it is rendered now.
    pub fn renderer(&self) -> &Renderer {
        &self.renderer
    }

    /// One step; `None` when the stage is over. Every tenth has its entry.
    ///
    /// # Errors
    /// A lens that cannot be rendered any more, a network that fails.
    pub fn step(&mut self, scenery: &Scenery<'_>) -> Result<Option<Entry>> {
        let clock = Instant::now();
        let known = self.pace.len() >= 5;
        if known {
            let mut sorted = self.pace.clone();
            sorted.sort_by(f64::total_cmp);
            self.schedule.settle(self.step as u64, self.seconds(), sorted[sorted.len() / 2]);
        }
        let used = self.used();
        if used >= 1.0 {
            return Ok(None);
        }
        let [lens_rate, network_rate] = self.settings.rates(used);
        let lens_rate = self.settings.lens_rate * lens_rate;
        self.look_again(scenery, lens_rate > 0.0)?;
        let mut groups = Vec::new();
        let report = match &self.settings.sensor_loss {
            Some(loss) => {
                groups = self.groups(scenery, loss);
                self.joint.step_by_images(&self.renderer, loss, &groups, lens_rate)?
            }
            None => {
                let built = self.built(self.step as u64);
                self.lost += usize::from(self.as_built.is_some() && built.is_none());
                let built = built.as_ref().map(|(lens, renderer)| (lens, renderer));
                let patches = self.patches(scenery, built.map_or(&self.renderer, |(_, renderer)| renderer));
                let rates = [lens_rate, self.settings.network_rate * network_rate];
                self.joint.step(&self.renderer, built, &self.electronics, &patches, rates)?
            }
        };
        self.step += 1;
        if report.lens.as_ref().is_some_and(|l| l.lens.is_some()) {
            self.renderer = self.joint.renderer(&self.renderer.plan, false)?;
            if let Some(loss) = &self.settings.sensor_loss
                && self.joint.is_worse(&self.renderer, loss, &groups, report.loss)?
            {
                self.renderer = self.joint.renderer(&self.renderer.plan, false)?;
            }
        }
        self.recent.push(report);
        self.pace.push(clock.elapsed().as_secs_f64());
        self.pace.drain(..self.pace.len().saturating_sub(PACE));
        let entry = self.average();
        if self.step.is_multiple_of(SMOOTH) {
            self.recent.clear();
        }
        Ok(Some(entry))
    }

    /// Windows, nodes, settings and filters follow the lens.
    fn look_again(&mut self, scenery: &Scenery<'_>, moves: bool) -> Result<()> {
        // The lens moved since.
        let since = self.as_built.as_ref().map_or(&self.planned[1], |built| &built.around);
        if self.step > 0 && self.step.is_multiple_of(REPLAN) && *since != self.joint.lens {
            if let Some(built) = &mut self.as_built {
                built.follow(&self.joint.lens);
            }
            self.replan();
            self.refresh();
            self.follow_the_corner();
        }
        if self.step != self.again {
            return Ok(());
        }
        self.again = (2 * self.again).max(AGAIN);
        // A lens that grows sharper needs finer settings; one that cannot be judged now keeps those it has.
        if self.settings.settings.is_some() || !moves && self.settings.lens_rate == 0.0 {
            return Ok(());
        }
        let drawn = self.drawn(scenery);
        if let Ok(mut chosen) = self.choose(scenery, &drawn) {
            // What rays ask for is judged by rays.
            let before = self.renderer.plan.settings.diffraction;
            let scenes = drawn.into_iter().map(|p| p.scene);
            let seen = (&self.joint.lens, &scenery.frame, &self.density);
            chosen.settings.diffraction = bending::now(self.settings.diffraction, before, scenes, seen);
            if chosen.settings != self.renderer.plan.settings {
                let (frame, density) = (&scenery.frame, &self.density);
                let planned = |l: &Lens| Renderer::planned(l, frame, density, &self.vergences, chosen.settings);
                match widest(&self.joint.lens, self.as_built.as_ref(), planned) {
                    Ok((at, renderer)) => {
                        self.renderer = renderer;
                        self.planned = [at.clone(), at];
                        self.refresh();
                    }
                    Err(_) => return Ok(()),
                }
            }
            self.fineness.push((self.step, chosen));
        }
        Ok(())
    }

    /// Windows and nodes for the lens now; one that has none keeps the old ones.
    fn replan(&mut self) {
        let plan = &self.renderer.plan;
        if let Ok((at, renderer)) =
            widest(&self.joint.lens, self.as_built.as_ref(), |lens| Renderer::replanned(lens, plan))
        {
            self.renderer = renderer;
            self.planned[1] = at;
        }
    }

    /// Object points reach as far as the frame's corner sees, which moves with the distortion.
    fn follow_the_corner(&mut self) {
        let corner = corner_of(&self.renderer);
        let off = corner.angle_deg / self.looked_at.max_field_deg() - 1.0;
        if !(-0.05..0.0).contains(&off)
            && corner.angle_deg.is_finite()
            && let Ok(lens) = self.joint.lens.changed(|l| l.field = corner.field())
            && self.joint.steps.look_at(&lens).is_ok()
        {
            self.joint.lens = lens.clone();
            self.looked_at = lens;
        }
    }

    /// Filters of the lens now.
    fn refresh(&mut self) {
        let before = self.joint.refreshed.0;
        self.joint.refresh(&self.renderer, &self.electronics);
        if self.joint.refreshed.0 > before {
            self.told = self.joint.lens.clone();
        }
    }

    /// Patches like those that the lens will be designed on.
    fn drawn(&self, scenery: &Scenery<'_>) -> Vec<Patch> {
        let places = Places::new(&scenery.frame, self.settings.patch.min(JUDGED.1), self.settings.spread);
        let drawn = |i| {
            let map = &self.renderer.optics.maps[i as usize % self.vergences.len()];
            let number = (self.step as u64) << 16 | i;
            scenery.textures.numbered((scenery.seed ^ 0x6669_6e65, number), &places, &scenery.frame, map, 0)
        };
        (0..JUDGED.0 as u64).map(drawn).collect()
    }

    /// Settings whose gradient is well below the noise of patches like `drawn`.
    fn choose(&self, scenery: &Scenery<'_>, drawn: &[Patch]) -> Result<Chosen> {
        let parts = drawn.iter().map(|p| (&p.scene, p.region)).collect();
        cheapest(&Patches { lens: &self.joint.lens, frame: &scenery.frame, density: &self.density, parts })
    }

    /// The lens as draw `number` builds it, rendered as the lens itself is; none where nothing is drawn, or no light comes through.
    fn built(&self, number: u64) -> Option<(Lens, Renderer)> {
        let lens = self.as_built.as_ref()?.lens(&self.joint.lens, number)?;
        let renderer = Renderer::new(&lens, &self.renderer.plan).ok()?;
        Some((lens, renderer))
    }

    /// The patches of a step, through what `renderer` holds.
    fn patches(&self, scenery: &Scenery<'_>, renderer: &Renderer) -> Vec<Patch> {
        let reach = self.joint.guide.reach();
        let batch = self.settings.batch as u64;
        let numbered = |i: u64| {
            let number = self.step as u64 * batch + i;
            // Depths take turns that places do not.
            let depth = ((number / batch + number) % self.vergences.len() as u64) as usize;
            let map = &renderer.optics.maps[depth];
            scenery.textures.numbered((scenery.seed, number), &self.places, &scenery.frame, map, reach)
        };
        (0..batch).map(numbered).collect()
    }

    /// The scenes of a step, each at every distance.
    fn groups(&self, scenery: &Scenery<'_>, loss: &SensorLoss) -> Vec<Vec<Patch>> {
        let batch = self.settings.batch as u64;
        let number = |g: u64| self.step as u64 * batch + g;
        let drawn = |g| group(&self.renderer, loss, scenery.textures, (scenery.seed, number(g)), &self.places);
        (0..batch).map(drawn).collect()
    }

    fn average(&self) -> Entry {
        let mean =
            |f: &dyn Fn(&Report) -> f64| self.recent.iter().map(f).sum::<f64>() / self.recent.len().max(1) as f64;
        let of_lens = |f: fn(&Stepped) -> f64| mean(&|r| r.lens.as_ref().map_or(0.0, f));
        Entry {
            step: self.step,
            seconds: self.seconds(),
            loss: mean(&|r| r.loss),
            input_psnr_db: mean(&|r| r.input_psnr_db),
            output_psnr_db: mean(&|r| r.output_psnr_db),
            moved_um: of_lens(|l| 1e3 * l.length_mm),
            signal: of_lens(|l| l.signal),
            penalty: of_lens(|l| l.penalty),
            step_seconds: self.pace.iter().rev().take(self.recent.len()).sum::<f64>() / self.recent.len().max(1) as f64,
            network_seconds: mean(&|r| r.network_seconds),
        }
    }

    /// What held the lens back in the last steps, the most frequent first.
    pub fn active(&self) -> Vec<String> {
        let mut counts: Vec<(String, usize)> = Vec::new();
        for name in self.recent.iter().filter_map(|r| r.lens.as_ref()).flat_map(|l| &l.active) {
            match counts.iter_mut().find(|c| &c.0 == name) {
                Some(c) => c.1 += 1,
                None => counts.push((name.clone(), 1)),
            }
        }
        counts.sort_by(|a, b| b.1.cmp(&a.1).then_with(|| a.0.cmp(&b.0)));
        counts.into_iter().map(|c| c.0).collect()
    }

    /// Brings the network's filters up to the lens: when the stage is over.
    pub(crate) fn finish(&mut self) {
        if self.joint.guide.facts().is_some() && self.told != self.joint.lens {
            self.replan();
            self.refresh();
        }
    }

    /// Seconds of the last step, and of its network.
    pub(in crate::design) fn last_seconds(&self) -> [f64; 2] {
        let network = self.recent.last().map_or(0.0, |r| r.network_seconds);
        [self.pace.last().copied().unwrap_or(0.0), network]
    }

    /// Makes a restored stage one that is over as `spent` was.
    pub(in crate::design) fn over(&mut self, spent: &State) {
        (self.step, self.before, self.started) = (spent.step, spent.seconds, Instant::now());
        self.schedule.settled = spent.settled;
    }

    /// What renders it, its electronics, the network and what that is told: all that a picture takes.
    pub(in crate::design) fn camera(&self) -> Camera<'_> {
        let (renderer, electronics) = (&self.renderer, &self.electronics);
        let sensor_loss = self.settings.sensor_loss.as_ref();
        let worst = self.settings.depth_power > 1.0;
        Camera { renderer, electronics, network: &self.joint.network, guide: &self.joint.guide, sensor_loss, worst }
    }

    /// PSNR and loss on [`PICTURES`] patches of `side` pixels of pictures that are not trained on; where pictures are taken through drawn lenses, through
    /// [`BUILT`] others of them.
    ///
    /// # Errors
    /// A network that fails.
    pub(in crate::design) fn judged(&mut self, held_out: &Textures, side: usize) -> Result<Entry> {
        if self.as_built.is_none() {
            return self.camera().judged(held_out, side, 0..PICTURES);
        }
        let mut all = Tally::default();
        for k in 0..BUILT {
            let numbers = k * PICTURES / BUILT..(k + 1) * PICTURES / BUILT;
            match self.built(UNSEEN + k) {
                Some((_, renderer)) => {
                    all.add(&Camera { renderer: &renderer, ..self.camera() }.sums(held_out, side, numbers)?);
                }
                None => {
                    self.lost += 1;
                    all.add(&Tally::nothing(numbers, self.vergences.len()));
                }
            }
        }
        Ok(all.entry(self.settings.depth_power > 1.0))
    }

    /// How good what was judged is, dB: the more the better.
    pub(in crate::design) fn score(&self, judged: &Entry) -> f64 {
        if self.settings.sensor_loss.is_some() { -20.0 * judged.loss.log10() } else { judged.output_psnr_db }
    }
}

/// Lens and network together, in memory. `progress(share, entry)` is called after every step.
///
/// # Errors
/// As [`Stage::new`] and [`Stage::step`].
pub fn joint_stage(
    scenery: &Scenery<'_>,
    problem: &Problem,
    network: Reconstructor,
    settings: JointSettings,
    progress: &mut dyn FnMut(f64, &Entry),
) -> Result<(Stage, Vec<Entry>)> {
    let mut stage = Stage::new(scenery, problem, network, settings)?;
    let mut history = Vec::new();
    while let Some(entry) = stage.step(scenery)? {
        progress(stage.used().min(1.0), &entry);
        if stage.steps().is_multiple_of(SMOOTH) {
            history.push(entry);
        }
    }
    stage.finish();
    Ok((stage, history))
}

/// A fresh network that sees `inputs` beside the capture.
///
/// # Errors
/// A size that is no network, or a device that this build or machine has not.
pub fn network(base_width: usize, inputs: Inputs, seed: u64, compute: Compute) -> Result<Reconstructor> {
    Reconstructor::on(compute, UnetConfig::bare(base_width, 3).seeing(inputs), seed)
}
