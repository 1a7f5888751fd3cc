//! `isoplanat train`: the final network for a finished lens, in a folder that can be killed and resumed at any point.
//!
//! The folder holds the task (paths in full), the lens (or what was measured of it), `network.safetensors` (the last checkpoint: generator,
//! discriminators, optimisers, step; readable as a plain network), `log.csv`, sample pictures, and kept pairs while it runs.
//! A step's draws depend on the seed and its number alone, so a resumed training repeats what a kill has lost, bit by bit
//! on the same machine and number of threads.

#[doc(hidden)]
pub mod pairs;

mod guard;
mod state;

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::Instant;

use ndarray::{Array4, Axis, s};

use self::pairs::{Augmentation, PairSettings, Pairs, cut};
use crate::design::bending;
use crate::design::bound::{Bound, guide_of};
use crate::design::data::Textures;
use crate::design::folder::{MARKER, SCENES, check, lock, made, same_scenes, sweep};
use crate::design::going::{Stepped, Work, run_to_end};
use crate::design::log::{Entry, HEADER, Log};
use crate::design::schedule::Schedule;
use crate::design::subject::Subject;
use crate::design::task::Task;
use crate::design::task::train::NETWORK;
use crate::report::picture_sheet::picture_sheet;
use guard::Guard;
use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::develop::simulate::Electronics;
use isoplanat_imaging::files::write_png8;
use isoplanat_imaging::guide::{self, Filters, Guide};
use isoplanat_imaging::metrics::psnr;
use isoplanat_imaging::plane::Region;
use isoplanat_imaging::sensor::noise::mixed;
use isoplanat_imaging::sensor::spectrum::SpectralDensity;
use isoplanat_network::{Compute, Reconstructor, TrainStep, Trainer};
use isoplanat_optics::lens::catalogue::Glasses;
use state::State;

/// Times a training goes back to its last checkpoint, with half the rate each time, before it stops.
const MOST_RETURNS: u32 = 6;

/// Steps whose median time is the pace at which a length in minutes becomes one in steps.
const PACE: usize = 101;

/// Steps of an entry of the log.
const SMOOTH: u64 = 10;

/// Held-out patches of the sample pictures, by their place from the axis to the farthest corner.
const SAMPLES: [f64; 4] = [0.1, 0.4, 0.7, 0.9];

/// How a training stands.
#[derive(Clone, Copy, Debug)]
pub struct Status {
    /// Steps done.
    pub step: u64,
    /// Steps in all, where that is settled.
    pub total: Option<u64>,
    /// Share done, 0 to 1.
    pub share: f64,
    /// Seconds so far, those before a resume included.
    pub seconds: f64,
    /// The last steps' averages.
    pub entry: Entry,
}

/// A training under way.
#[derive(Debug)]
pub struct Training {
    folder: PathBuf,
    task: Task,
    trainer: Trainer,
    textures: Textures,
    electronics: Electronics,
    pairs: Pairs,
    guide: Guide,
    bound: Bound,
    /// Held-out inputs and targets.
    samples: Vec<(Array4<f32>, Array4<f32>)>,
    schedule: Schedule,
    state: State,
    guard: Guard,
    log: Log,
    clock: Clock,
    /// Averages as of the last step.
    entry: Option<Entry>,
    /// Held while the training lives, so that no second one works in the folder.
    _lock: File,
}

/// When this process began with a training, and how fast it goes.
#[derive(Debug)]
struct Clock {
    begun: Instant,
    /// Seconds before.
    before: f64,
    /// Seconds of the last steps: their median is no matter of pairs that are rendered for the first time.
    pace: Vec<f64>,
    /// Steps since the last entry of the log.
    recent: Vec<Entry>,
}

/// What lens and task make of themselves before the first step.
struct Parts {
    textures: Textures,
    electronics: Electronics,
    pairs: Pairs,
    guide: Guide,
    samples: Vec<(Array4<f32>, Array4<f32>)>,
}

impl Training {
    /// A new training of the task's lens, with `glasses`, in `folder`, which must not be there, or with `replace` may be another run.
    ///
    /// # Errors
    /// A task that cannot be trained; nothing is written then.
    pub fn create(task: Task, folder: &Path, replace: bool, compute: Compute, glasses: &Glasses) -> Result<Self> {
        check(folder, replace)?;
        let (subject, network, textures) = (task.subject(glasses)?, start(&task, compute)?, task.textures()?);
        Self::begin(task, &subject, network, textures, folder, replace)
    }

    /// As [`Training::create`], for `subject`, from `network` and with `textures` in place of the task's.
    ///
    /// # Errors
    /// As [`Training::create`].
    pub fn begin(
        mut task: Task,
        subject: &Subject,
        network: Reconstructor,
        textures: Textures,
        folder: &Path,
        replace: bool,
    ) -> Result<Self> {
        check(folder, replace)?;
        let mut trainer = Trainer::new(network, &task.train.objective(), task.seed)?;
        trainer.check_device(&task.train.objective(), task.train.pairs.batch, task.train.pairs.patch_px)?;
        if let Subject::Lens(lens) = subject {
            task.pictures.diffraction = bending::settled(&task, lens, &textures, task.network_depths_mm())?;
        }
        let parts = Parts::new(&task, subject, textures, None)?;
        let state = State::default();
        let (bound, filters) = Bound::of(subject.sha256(), &parts.guide)?;
        let locked = made(folder, replace, |inside| {
            atomic::write_bytes(&inside.join(MARKER), task.to_toml()?.as_bytes())?;
            subject.save(inside)?;
            atomic::write_bytes(&inside.join(SCENES), parts.textures.sha256().as_bytes())?;
            if let Some(filters) = &filters {
                atomic::write_bytes(&inside.join(guide::FILE), filters)?;
            }
            trainer.save(&inside.join(NETWORK), &facts(&state, &bound))
        })?;
        Self::assemble(folder, locked, task, trainer, parts, (state, bound))
    }

    /// What it was asked for.
    pub fn task(&self) -> &Task {
        &self.task
    }

    /// Goes on in a folder that [`Training::create`] made.
    ///
    /// # Errors
    /// A folder that is none, or in which another process trains.
    pub fn resume(folder: &Path, compute: Compute) -> Result<Self> {
        let task = Task::load(&folder.join(MARKER))?;
        // Locked before the checkpoint is read, so that nobody writes a newer one.
        let locked = lock(folder)?;
        let subject = Subject::of_run(folder)?;
        let path = folder.join(NETWORK);
        let (mut trainer, facts) = Trainer::load(&path, &task.train.objective(), compute)?;
        trainer.check_device(&task.train.objective(), task.train.pairs.batch, task.train.pairs.patch_px)?;
        let state = State::from_facts(&facts, &path)?;
        let (kept, filters) = guide_of(folder, trainer.generator().config().inputs, &subject.frame()?)?;
        let bound = Bound::new(subject.sha256(), filters);
        bound.check(folder, &facts)?;
        let textures = task.textures()?;
        same_scenes(folder, &textures.sha256())?;
        let parts = Parts::new(&task, &subject, textures, Some(kept))?;
        Self::assemble(folder, locked, task, trainer, parts, (state, bound))
    }

    fn assemble(
        folder: &Path,
        lock: File,
        task: Task,
        trainer: Trainer,
        parts: Parts,
        (state, bound): (State, Bound),
    ) -> Result<Self> {
        let Parts { textures, electronics, mut pairs, guide, samples } = parts;
        sweep(folder)?;
        pairs.keep_in(&folder.join("cache"), &textures)?;
        let mut schedule = task.train.schedule();
        schedule.settled = state.settled;
        let log = Log::open(&folder.join("log.csv"), HEADER, state.step)?;
        Ok(Self {
            folder: folder.to_owned(),
            task,
            trainer,
            textures,
            electronics,
            pairs,
            guide,
            bound,
            samples,
            schedule,
            state,
            guard: Guard::default(),
            log,
            clock: Clock::after(0.0),
            entry: None,
            _lock: lock,
        })
    }

    /// What is minimised, and on what, for people.
    pub fn describe(&self) -> Vec<String> {
        let config = self.trainer.generator().config();
        let pairs = match self.pairs.count() {
            Some(n) => format!("{n} training pairs, {} of them kept on disk once rendered", self.pairs.kept()),
            None => "no two training pairs alike, all rendered as they are needed".into(),
        };
        let mut lines = vec![
            format!(
                "network: {} scales, {} channels at the finest{}{}",
                config.scales,
                config.base_width,
                if config.blocks.is_paper() { String::new() } else { format!(", {} blocks", config.blocks.name()) },
                self.told()
            ),
            format!("loss: {}", self.trainer.describe()),
            format!("{pairs}, from {} scenes", self.textures.len()),
            match self.schedule.total() {
                Some(steps) => format!("{steps} steps of {} patches", self.task.train.pairs.batch),
                None => format!("{} minutes", self.task.train.budget.minutes.unwrap_or_default()),
            },
        ];
        lines.extend(self.trainer.device().map(str::to_owned));
        lines
    }

    /// What the network sees beside the capture, in words.
    fn told(&self) -> String {
        let names = self.guide.inputs().names();
        let of_bank = |f: &Filters| format!("{} of {1} × {1} pixels", f.grid.len(), 2 * f.reach() + 1);
        let banks: Vec<String> = self.guide.facts().iter().flat_map(|f| f.banks().map(of_bank)).collect();
        let filters =
            if banks.is_empty() { String::new() } else { format!(" (Wiener filters a colour: {})", banks.join(", ")) };
        if names.is_empty() {
            String::new()
        } else {
            format!("; sees {} beside the capture{filters}", names.join(", "))
        }
    }

    /// What the network is told beside the capture.
    pub fn guide(&self) -> &Guide {
        &self.guide
    }

    /// The network as a result now.
    pub fn network(&self) -> Reconstructor {
        self.trainer.result()
    }

    /// Steps done so far.
    pub fn step(&self) -> u64 {
        self.state.step
    }

    /// Steps that moved nothing because a loss or gradient was not finite.
    pub fn skipped(&self) -> u64 {
        self.state.skipped
    }

    /// Kept pairs that were found damaged and were rendered again.
    pub fn damaged(&self) -> u64 {
        self.pairs.damaged()
    }

    /// Times that it lost itself and went back to its last checkpoint, with half the rate each time.
    pub fn returned(&self) -> u32 {
        self.state.returned
    }

    /// Trains to the end. A loss that jumps to many times what it was and stays there takes it back to its last checkpoint, with half the
    /// rate from then on ([`Training::returned`]). `watch` sees every step; where it returns `false` the training ends with [`Error::Interrupted`], after a
    /// checkpoint unless the loss has just jumped: then the last sound one stays.
    ///
    /// # Errors
    /// [`Error::Stopped`] where nothing finite comes any more, or where it lost itself too often; what the disk says.
    pub fn run(&mut self, watch: &mut dyn FnMut(&Status) -> bool) -> Result<()> {
        self.clock = Clock::after(self.state.seconds);
        let every = self.task.train.budget.checkpoint_seconds;
        run_to_end(self, every, &mut |training| training.status().is_none_or(|status| watch(&status)))?;
        self.pairs.discard();
        Ok(())
    }

    /// How it stands after its last step.
    fn status(&self) -> Option<Status> {
        Some(Status {
            step: self.state.step,
            total: self.schedule.total(),
            share: self.schedule.done(self.state.step, self.state.seconds),
            seconds: self.state.seconds,
            entry: self.entry?,
        })
    }

    /// Fixes a length in time as one in steps, once the pace is known.
    fn settle(&mut self) -> Result<()> {
        let (pace, seconds) = (&self.clock.pace, self.state.seconds);
        // After a resume a few steps come first; very long ones do not wait for others.
        let known = pace.len() >= 11 || pace.iter().sum::<f64>() > 0.1 * seconds;
        // What a training goes back to must be sound: every checkpoint on the way is.
        if known && self.guard.sound() && self.schedule.settle(self.state.step, seconds, median(pace)) {
            // From here on the length is fixed: a kill must not settle it anew.
            self.state.settled = self.schedule.settled;
            self.checkpoint()?;
        }
        Ok(())
    }

    /// One step, and the PSNR of what the network made of its batch before it.
    fn one_step(&mut self, rate: f64) -> Result<(TrainStep, f64)> {
        let train = &self.task.train;
        let rng = &mut fastrand::Rng::with_seed(mixed(self.task.seed ^ 0x7374_6570, self.state.step));
        let mut parts = (Vec::new(), Vec::new());
        for _ in 0..train.pairs.batch {
            let pair = self.pairs.get(&self.textures, self.pairs.draw(rng))?;
            let (input, target) =
                cut(&self.electronics, &self.guide, &pair, train.pairs.patch_px, train.augmentation(), rng);
            parts.0.push(input);
            parts.1.push(target);
        }
        let batch = |parts: &[Array4<f32>]| {
            let views: Vec<_> = parts.iter().map(|p| p.view()).collect();
            ndarray::concatenate(Axis(0), &views).expect("patches of one size")
        };
        let (input, target) = (batch(&parts.0), batch(&parts.1));
        let step = self.trainer.step(input.view(), target.view(), rate)?;
        let each = step.output.outer_iter().zip(target.outer_iter()).map(|(a, b)| bounded(psnr(a, b)));
        let psnr_db = each.sum::<f64>() / train.pairs.batch as f64;
        Ok((step, psnr_db))
    }

    /// Back to the last checkpoint, with half of `rate` from there on; the time that was lost stays spent.
    fn go_back(&mut self, rate: f64) -> Result<()> {
        let path = self.folder.join(NETWORK);
        let lost = State { returned: self.state.returned + 1, ..self.state.clone() };
        if lost.returned > MOST_RETURNS {
            return Err(Error::Stopped(format!(
                "training stopped at step {}: its loss jumped away {} times, each time at half the rate of the time before, the last time at {rate:.1e}; \
                 {} holds the network as it was before; look at the pictures",
                lost.step,
                lost.returned,
                path.display()
            )));
        }
        let compute = self.trainer.compute();
        let (mut trainer, facts) = Trainer::load(&path, &self.task.train.objective(), compute)?;
        trainer.check_device(
            &self.task.train.objective(),
            self.task.train.pairs.batch,
            self.task.train.pairs.patch_px,
        )?;
        let then = State::from_facts(&facts, &path)?;
        self.state = State { returned: lost.returned, seconds: lost.seconds, settled: lost.settled, ..then };
        self.trainer = trainer;
        self.guard = Guard::default();
        self.log = Log::open(&self.folder.join("log.csv"), HEADER, self.state.step)?;
        self.checkpoint()
    }

    /// A sheet of held-out patches (capture, reconstruction, truth) and the mean PSNR of the reconstructions.
    fn sample(&self) -> Result<f64> {
        let (n, network) = (self.samples.len(), self.trainer.result());
        let (mut rows, mut sum) = (Vec::new(), 0.0);
        for (input, target) in &self.samples {
            let output = network.forward(input.view())?;
            let first = |a: &'_ Array4<f32>| a.index_axis(Axis(0), 0).slice(s![..3, .., ..]).to_owned();
            let (input, output, target) = (first(input), first(&output), first(target));
            sum += bounded(psnr(output.view(), target.view()));
            rows.push(vec![input, output, target]);
        }
        let sheet = picture_sheet(&["capture", "network", "truth"], &rows);
        let folder = self.folder.join("samples");
        fs::create_dir_all(&folder).map_err(|e| Error::writing(&folder, e))?;
        write_png8(&folder.join(format!("step-{:07}.png", self.state.step)), &sheet)?;
        Ok(sum / n as f64)
    }
}

impl Work for Training {
    fn step(&mut self) -> Result<Option<Stepped>> {
        self.state.seconds = self.clock.seconds();
        self.settle()?;
        let Some(rate) = self.schedule.at(self.state.step) else { return Ok(None) };
        let rate = rate * 0.5f64.powi(self.state.returned.cast_signed());
        let began = Instant::now();
        let (step, psnr_db) = self.one_step(rate)?;
        self.clock.took(began.elapsed().as_secs_f64());
        self.state.step += 1;
        self.state.skipped += u64::from(!step.updated);
        self.state.seconds = self.clock.seconds();
        if self.guard.lost(step.content) {
            self.go_back(rate)?;
            (self.clock.recent, self.clock.pace) = (Vec::new(), Vec::new());
            return Ok(Some(Stepped::Returned));
        }
        self.clock.recent.push(Entry::of(&step, self.state.step, self.state.seconds, rate, psnr_db));
        let mut entry = Entry::mean(&self.clock.recent);
        if self.state.step.is_multiple_of(SMOOTH) {
            self.clock.recent.clear();
            let every = self.task.train.budget.sample_steps;
            if every > 0 && self.state.step.is_multiple_of(every.next_multiple_of(SMOOTH)) {
                entry.held_out_psnr_db = Some(self.sample()?);
            }
            self.log.push(&entry.line());
        }
        self.entry = Some(entry);
        Ok(Some(if step.updated { Stepped::Moved } else { Stepped::Skipped }))
    }

    fn steps(&self) -> u64 {
        self.state.step
    }

    fn sound(&self) -> bool {
        self.guard.sound()
    }

    /// Log, then network: the log is never behind.
    fn checkpoint(&mut self) -> Result<()> {
        self.log.save()?;
        self.trainer.save(&self.folder.join(NETWORK), &facts(&self.state, &self.bound))
    }

    fn stopped(&mut self, why: &str) -> Error {
        Error::Stopped(format!(
            "training stopped at step {}: {why}; {} holds the network as it was; lower train.budget.rate or look at the pictures",
            self.state.step,
            self.folder.join(NETWORK).display()
        ))
    }
}

impl Clock {
    /// One that begins now, `before` seconds into the training.
    fn after(before: f64) -> Self {
        Self { begun: Instant::now(), before, pace: Vec::new(), recent: Vec::new() }
    }

    /// Seconds of the training so far, those before a resume included.
    fn seconds(&self) -> f64 {
        self.before + self.begun.elapsed().as_secs_f64()
    }

    /// A step took so many seconds.
    fn took(&mut self, seconds: f64) {
        self.pace.push(seconds);
        self.pace.drain(..self.pace.len().saturating_sub(PACE));
    }
}

/// What a checkpoint says beside the network: where it stands, and what it belongs to.
fn facts(state: &State, bound: &Bound) -> BTreeMap<String, String> {
    let mut facts = state.facts();
    bound.put(&mut facts);
    facts
}

/// At most 120 dB; what is no number stays so.
fn bounded(psnr_db: f64) -> f64 {
    if psnr_db > 120.0 { 120.0 } else { psnr_db }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::INFINITY)
}

impl Parts {
    /// `guide`: that of a training that goes on.
    fn new(task: &Task, subject: &Subject, textures: Textures, guide: Option<Guide>) -> Result<Self> {
        let (sensor, frame) = (task.sensor()?, subject.frame()?);
        let (train, density) = (&task.train, SpectralDensity::new(&sensor));
        let electronics = Electronics::from_sensor(&sensor);
        let largest = frame.rows.min(frame.columns);
        if train.pairs.region_px > largest {
            let found = format!("{} on a sensor of {} x {}", train.pairs.region_px, frame.columns, frame.rows);
            let error = Error::bad("", "train.pairs.region_px", found, format!("at most {largest}"));
            return Err(task.in_its_words(error));
        }
        let vergences = match task.network_depths_mm() {
            [] => vec![subject.vergence()],
            depths => depths.iter().map(|d| 1.0 / d).collect(),
        };
        let settings = PairSettings {
            seed: task.seed,
            region_px: train.pairs.region_px,
            count: train.pairs.count,
            budget: train.pairs.cache_mib << 20,
            diffraction: task.pictures.diffraction.stated(),
            vergences,
        };
        let pairs = Pairs::new(subject, &density, settings)?;
        let guide = guide.map_or_else(|| Guide::new(train.network.inputs, pairs.renderer(), &electronics), Ok)?;
        let samples = if train.budget.sample_steps > 0 {
            samples(&pairs, train.pairs.patch_px, &electronics, &guide)?
        } else {
            vec![]
        };
        Ok(Self { textures, electronics, pairs, guide, samples })
    }
}

/// Patches of scenes that are never trained on, from the axis outwards, at the first distance.
fn samples(
    pairs: &Pairs,
    side: usize,
    electronics: &Electronics,
    guide: &Guide,
) -> Result<Vec<(Array4<f32>, Array4<f32>)>> {
    let unseen = Textures::unseen(9000, SAMPLES.len(), 2 * side + 200);
    let renderer = pairs.renderer();
    let frame = &renderer.plan.frame;
    let corners = [[0.0, 0.0], [frame.columns as f64, frame.rows as f64]];
    let far = |axis: usize| -> f64 {
        let ends = [corners[0][axis] - frame.axis_px[axis], corners[1][axis] - frame.axis_px[axis]];
        if ends[0].abs() > ends[1].abs() { ends[0] } else { ends[1] }
    };
    SAMPLES
        .into_iter()
        .enumerate()
        .map(|(i, share)| {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a place on the sensor")]
            let start = |axis: usize, n: usize| {
                let centre = frame.axis_px[axis] + share * far(axis);
                ((centre - side as f64 / 2.0).clamp(0.0, (n - side) as f64) as usize / 4 * 4).cast_signed()
            };
            let region = Region { row: start(1, frame.rows), col: start(0, frame.columns), rows: side, cols: side };
            let rng = &mut fastrand::Rng::with_seed(mixed(0x7365_656e, i as u64));
            let patch = unseen.place(rng, frame, &renderer.optics.maps[0], region);
            let pair = self::pairs::render_pair(renderer, &patch)?;
            Ok(cut(electronics, guide, &pair, side, Augmentation::NONE, rng))
        })
        .collect()
}

/// The network a task begins with.
fn start(task: &Task, compute: Compute) -> Result<Reconstructor> {
    let config = task.train.config()?;
    let Some(path) = task.train.start_file() else { return Reconstructor::on(compute, config, task.seed) };
    let first = Reconstructor::load(&path)?;
    first.deepened(&config, task.seed, compute).map_err(|e| e.in_file(&path))
}

#[cfg(test)]
mod tests;
