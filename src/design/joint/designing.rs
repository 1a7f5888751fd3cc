//! `isoplanat design`: a joint stage in a folder that can be killed and resumed at any point.
//!
//! The folder holds the task (paths in full), the stages that came before it, the lens as the task names it (`lens-start.toml`) and as the design begins with it, by spots or from the last of those stages
//! (`lens-first.toml`), `network.safetensors` (the last checkpoint: network, its optimiser, and the [`State`] of the stage with the lens; also
//! readable as a plain network), `lens.toml` (the lens of that checkpoint), `best.safetensors` (the same of the best judgement so far),
//! `log.csv`, the history: a line of `history.jsonl` and a lens in `lenses/` for each judgement, and `report.html`, written anew at each.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

use super::as_built::{self, BestBuilt};
use super::judge::corner_seen;
use super::lens_steps::{LensSteps, Steps};
use super::run::{JointSettings, SMOOTH, Stage};
use super::scenery::{Entry, LOG_HEADER, Scenery};
use super::state::State;
use super::story::{Judgement, StoryFacts, WORSE_DB, page};
use crate::design::bending;
use crate::design::bound::Bound;
use crate::design::data::Textures;
use crate::design::evaluate::verdict::verdicts;
use crate::design::folder::{MARKER, SCENES, START, check, lock, made, same_scenes, sweep};
use crate::design::going::{Stepped, Work, run_to_end};
use crate::design::log::Log;
use crate::design::subject::Subject;
use crate::design::task::Task;
use crate::design::task::train::NETWORK;
use crate::report::verdict::Verdict;
use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::guide;
use isoplanat_imaging::render::frame_of;
use isoplanat_imaging::sensor::Sensor;
use isoplanat_network::{Compute, Reconstructor};
use isoplanat_optics::lens::{Field, Lens, prescription};
use isoplanat_optics::optimize::search::{Plan, Progress, search};
use isoplanat_optics::optimize::{Limits, Outcome, Problem, optimize, refocused};
use isoplanat_optics::psf::corner::MARGIN;

/// The fact of a checkpoint that holds the stage's state.
const STATE: &str = "design.state";
/// The checkpoint of the best judgement.
const BEST: &str = "best.safetensors";
/// The lens as the stage begins with it.
const FIRST: &str = "lens-first.toml";

/// How a design stands.
#[derive(Clone, Debug)]
pub struct Status<'a> {
    /// Steps done.
    pub step: usize,
    /// Steps in all, where that is settled.
    pub total: Option<u64>,
    /// Share done, 0 to 1.
    pub share: f64,
    /// The last steps' means.
    pub entry: Entry,
    /// The last judgement of pictures that it does not train on.
    pub judged: Option<&'a Entry>,
    /// What holds the lens back.
    pub active: Vec<String>,
}

/// What a task asks for, made ready: the first lens, and what moves and is held.
#[doc(hidden)]
#[derive(Clone, Debug)]
pub struct Prepared {
    /// The lens as the task names it, its sensor moved where the task asks for that.
    pub start: Lens,
    /// What the joint stage works on; its lens is the one it begins with.
    pub problem: Problem,
    /// What made that lens better by spots, where the task asks for it …
    pub warm: Option<Outcome>,
    /// … and whether that lens is the one: not where no light reaches the frame's corner through it.
    pub taken: bool,
    /// Which lens of a search that was, where the task states tolerances: the first one otherwise.
    pub best_built: Option<BestBuilt>,
    /// Half field angle for which the problem was made, degrees, and the distortion that the task's lens has there.
    pub seen: [f64; 2],
}

/// Makes `task` ready for `lens`; `file` names the task. `tell` is told the share of a global search that is done, and its best rms, mm.
///
/// # Errors
/// Names and numbers that the lens does not allow; a lens whose rays do not pass.
pub fn prepare(task: &Task, lens: &Lens, file: &str, tell: &mut dyn FnMut(f64, f64)) -> Result<Prepared> {
    if let Some(tolerances) = task.stated_tolerances()? {
        as_built::round(&tolerances, lens).map_err(|e| e.in_file(Path::new(file)))?;
    }
    let (sensor, frame) = (task.sensor()?, frame_of(lens)?);
    let mut seen = corner_seen(lens, &frame, &sensor)?;
    // Light that reaches the corner; where none does, what the lens states.
    let stated = lens.max_field_deg();
    let within = |corner: f64| stated > 0.0 && stated < corner;
    let focused = task.lens.focus_all.then(|| match focused(task, lens, seen, file) {
        Err(_) if within(seen[0]) => focused(task, lens, [stated, seen[1]], file),
        other => other,
    });
    let focused = focused.transpose()?;
    if let Some(lens) = &focused {
        seen = corner_seen(lens, &frame, &sensor)?;
    }
    let lens = focused.as_ref().unwrap_or(lens);
    let [corner, distortion] = seen;
    match improved(task, lens, [corner, distortion], (&frame, &sensor), file, tell) {
        Err(_) if within(corner) => improved(task, lens, [stated, distortion], (&frame, &sensor), file, tell),
        other => other,
    }
}

/// Makes a stage ready that comes after others: it begins with `found`, what it may move and what is held counts from `start`, as in the first of them. `file` names the task.
///
/// # Errors
/// As [`prepare`].
#[doc(hidden)]
pub fn prepare_after(task: &Task, start: &Lens, found: &Lens, file: &str) -> Result<Prepared> {
    let (sensor, frame) = (task.sensor()?, frame_of(start)?);
    let (start, found) = (task.with_terms(start)?, task.with_terms(found)?);
    let seen = [corner_seen(&found, &frame, &sensor)?[0], corner_seen(&start, &frame, &sensor)?[1]];
    let mut problem = task.problem(&start, seen, file)?;
    problem.lens = found.changed(|l| l.field = Field::Angle(seen[0]))?;
    if task.lens.steps_by == Steps::Rays {
        LensSteps::new(task.lens.steps_by, &problem)?;
    }
    Ok(Prepared { start, problem, warm: None, taken: false, seen, best_built: None })
}

/// `lens` with its sensor at the least spots over the field and all distances.
fn focused(task: &Task, lens: &Lens, seen: [f64; 2], file: &str) -> Result<Lens> {
    let field_deg = lens.max_field_deg();
    let problem = task.problem(lens, seen, file)?;
    refocused(&problem.lens, problem.merit)?.lens.changed(|l| l.field = Field::Angle(field_deg))
}

/// [`prepare`] for a field.
fn improved(
    task: &Task,
    lens: &Lens,
    seen: [f64; 2],
    (frame, sensor): (&Frame, &Sensor),
    file: &str,
    tell: &mut dyn FnMut(f64, f64),
) -> Result<Prepared> {
    let mut problem = task.problem(lens, seen, file)?;
    let mut field_deg = seen[0];
    let mut warm = None;
    let mut taken = false;
    let mut best_built = None;
    let tolerances = task.stated_tolerances()?;
    if task.lens.warm_start && !task.lens.freeze {
        let mut from = problem.clone();
        // What the frame's corner sees moves with the distortion. A lens is a start where light reaches its own corner.
        for round in 0..4 {
            let searched = if task.lens.search > 0 && round == 0 {
                let plan = Plan { starts: task.lens.search, seed: task.seed, ..Plan::default() };
                let mut told = |p: Progress| {
                    tell(p.share, p.rms);
                    true
                };
                let found = search(&from, &plan, &mut told)?;
                best_built = tolerances.as_ref().and_then(|t| as_built::best_built(&found, t, &from.merit, task.seed));
                found.into_iter().nth(best_built.map_or(0, |b| b.rank))
            } else {
                None
            };
            let found = searched.map_or_else(|| optimize(&from, Limits::default(), &mut |_| true), Ok)?;
            if found.share < 1.0 {
                warm = warm.or(Some(found));
                break;
            }
            let [seen, _] = corner_seen(&found.lens, frame, sensor)?;
            from.lens = found.lens.clone();
            warm = Some(found);
            // The margin of what it sees is left for the steps to come.
            if seen <= MARGIN * field_deg {
                taken = true;
                problem.lens = from.lens;
                break;
            }
            field_deg = seen;
            from.lens = from.lens.changed(|l| l.field = Field::Angle(field_deg))?;
        }
    }
    if task.lens.steps_by == Steps::Rays && !task.lens.freeze {
        // Its rays pass, or the reason is told now.
        LensSteps::new(task.lens.steps_by, &problem)?;
    }
    Ok(Prepared { start: lens.clone(), problem, warm, taken, seen, best_built })
}

/// How the device of a network was found to compute the steps of `task`; of a network that takes none there is nothing to find.
fn checked(network: &mut Reconstructor, task: &Task) -> Result<Option<String>> {
    if task.loss.sensor.is_some() {
        Ok(None)
    } else {
        network.check_device(task.pictures.batch, task.pictures.patch_px)
    }
}

/// A design under way.
pub struct Designing {
    folder: PathBuf,
    task: Task,
    textures: Textures,
    held_out: Textures,
    sensor: Sensor,
    stage: Stage,
    /// How the network's device was found to compute, in words; nothing of the CPU.
    device: Option<String>,
    log: Log,
    history: Log,
    /// What the last step gave.
    entry: Option<Entry>,
    judged: Option<Entry>,
    /// What the finished network is worth, or why that could not be said.
    verdicts: Option<std::result::Result<Vec<Verdict>, String>>,
    best: Option<(f64, usize)>,
    seen: [f64; 2],
    /// The lens that the stage began with.
    first: Lens,
    /// Held while the design lives, so that no second one works in the folder.
    _lock: File,
}

impl Designing {
    /// A new design in `folder`, which must not be there, or with `replace` may be another run.
    ///
    /// # Errors
    /// A task that cannot be designed, a device that computes something else than the CPU; nothing is written then.
    pub fn create(
        task: Task,
        prepared: &Prepared,
        network: Reconstructor,
        textures: Textures,
        folder: &Path,
        replace: bool,
    ) -> Result<Self> {
        check(folder, replace)?;
        Self::begun(task, prepared, network, textures, folder, |task, fill| {
            made(folder, replace, |inside| {
                atomic::write_bytes(&inside.join(MARKER), task.to_toml()?.as_bytes())?;
                fill(inside)
            })
        })
    }

    /// A task's own design in the folder that holds the task and the stages before it ([`super::stages::make`]), whose lock is `held`. Its checkpoint comes last: without one it has not begun.
    ///
    /// # Errors
    /// As [`Designing::create`].
    #[doc(hidden)]
    pub fn create_within(
        task: Task,
        prepared: &Prepared,
        network: Reconstructor,
        textures: Textures,
        folder: &Path,
        held: File,
    ) -> Result<Self> {
        Self::begun(task, prepared, network, textures, folder, |task, fill| {
            // What it was asked may have been settled since the folder was made.
            atomic::write_bytes(&folder.join(MARKER), task.to_toml()?.as_bytes())?;
            fill(folder).map(|()| held)
        })
    }

    /// A design in a folder that `make` puts what is told it into.
    fn begun(
        mut task: Task,
        prepared: &Prepared,
        mut network: Reconstructor,
        textures: Textures,
        folder: &Path,
        make: impl FnOnce(&Task, &dyn Fn(&Path) -> Result<()>) -> Result<File>,
    ) -> Result<Self> {
        let device = checked(&mut network, &task)?;
        let held_out = task.held_out()?;
        let problem = prepared.problem.clone();
        let sensor = task.sensor()?;
        let scenery =
            Scenery { textures: &textures, sensor: &sensor, frame: frame_of(&problem.lens)?, seed: task.seed };
        let depths_mm = &task.pictures.depths_mm;
        if task.lens.freeze {
            task.pictures.diffraction = bending::settled(&task, &problem.lens, &textures, depths_mm)?;
        }
        let stage = Stage::new(&scenery, &problem, network, JointSettings::from_task(&task)?)?;
        let fill = |inside: &Path| {
            prescription::save(&prepared.start, &inside.join(START))?;
            prescription::save(&problem.lens, &inside.join(FIRST))?;
            atomic::write_bytes(&inside.join(SCENES), textures.sha256().as_bytes())?;
            let path = inside.join("lenses");
            fs::create_dir_all(&path).map_err(|e| Error::writing(&path, e))?;
            save(&stage, (None, prepared.seen), inside)
        };
        let locked = make(&task, &fill)?;
        let stage = (stage, device);
        Self::assemble(folder, locked, task, (textures, held_out, sensor), stage, (None, prepared.seen))
    }

    /// Goes on in a folder that [`Designing::create`] made.
    ///
    /// # Errors
    /// A folder that is none, or in which another process works; a device that computes something else than the CPU.
    pub fn resume(folder: &Path, compute: Compute) -> Result<Self> {
        let task = Task::load(&folder.join(MARKER))?;
        let locked = lock(folder)?;
        let path = folder.join(NETWORK);
        let (mut network, facts) = Reconstructor::load_with_facts(&path, compute)?;
        let device = checked(&mut network, &task)?;
        let file = path.display().to_string();
        let Some(text) = facts.get(STATE) else {
            return Err(Error::bad(file, STATE, "missing", "a checkpoint of `isoplanat design`"));
        };
        let state = State::from_text(text, &file)?;
        let start = prescription::load(&folder.join(START))?;
        let (sensor, textures, held_out) = (task.sensor()?, task.textures()?, task.held_out()?);
        same_scenes(folder, &textures.sha256())?;
        let frame = frame_of(&start)?;
        let first = prescription::load(&folder.join(FIRST))?;
        let mut problem = task.problem(&start, state.seen, MARKER)?;
        problem.lens = first;
        let scenery = Scenery { textures: &textures, sensor: &sensor, frame, seed: task.seed };
        let mut stage = Stage::new(&scenery, &problem, network, JointSettings::from_task(&task)?)?;
        stage.restore(&scenery, &state)?;
        // A kill between two renames leaves the lens of the checkpoint before, or its filters.
        if Bound::there(folder).ok() != Some(bound(&stage)?.0) {
            save(&stage, (state.best, state.seen), folder)?;
        }
        let stage = (stage, device);
        Self::assemble(folder, locked, task, (textures, held_out, sensor), stage, (state.best, state.seen))
    }

    fn assemble(
        folder: &Path,
        lock: File,
        task: Task,
        (textures, held_out, sensor): (Textures, Textures, Sensor),
        (stage, device): (Stage, Option<String>),
        (best, seen): (Option<(f64, usize)>, [f64; 2]),
    ) -> Result<Self> {
        sweep(folder)?;
        let log = Log::open(&folder.join("log.csv"), LOG_HEADER, stage.steps() as u64)?;
        let history = Log::open_with(&folder.join("history.jsonl"), "", stage.steps() as u64, step_of)?;
        let folder = folder.to_owned();
        let first = prescription::load(&folder.join(FIRST))?;
        let (judged, verdicts) = (None, None);
        Ok(Self {
            folder,
            task,
            textures,
            held_out,
            sensor,
            stage,
            device,
            log,
            history,
            entry: None,
            judged,
            verdicts,
            best,
            seen,
            first,
            _lock: lock,
        })
    }

    /// What it was asked for.
    pub fn task(&self) -> &Task {
        &self.task
    }

    /// How the network's device was found to compute, in words; nothing of the CPU.
    #[doc(hidden)]
    pub fn device(&self) -> Option<&str> {
        self.device.as_deref()
    }

    /// [`Self::task`], with the diffraction that pictures of the lens now ask for.
    #[doc(hidden)]
    pub fn task_now(&self) -> Task {
        let mut task = self.task.clone();
        task.pictures.diffraction = self.stage.renderer().plan.settings.diffraction.into();
        task
    }

    /// Lens and network as they are.
    #[doc(hidden)]
    pub fn stage(&self) -> &Stage {
        &self.stage
    }

    /// The last judgement.
    #[doc(hidden)]
    pub fn judged(&self) -> Option<&Entry> {
        self.judged.as_ref()
    }

    /// What the finished network is worth on pictures that it does not train on, or why that could not be said; nothing before the end, or of a design without one.
    #[doc(hidden)]
    pub fn verdicts(&self) -> Option<&std::result::Result<Vec<Verdict>, String>> {
        self.verdicts.as_ref()
    }

    /// Designs to the end; the best of the states that were judged is the result. `watch` sees every step; where it returns `false` a
    /// checkpoint is written and the design ends with [`Error::Interrupted`].
    ///
    /// # Errors
    /// [`Error::Stopped`] where lens or network cannot go on, the folder holds their last good state; what the disk says.
    pub fn run(&mut self, watch: &mut dyn FnMut(&Status<'_>) -> bool) -> Result<()> {
        let every = self.task.budget.checkpoint_seconds;
        run_to_end(self, every, &mut |design| design.status().is_none_or(|status| watch(&status)))?;
        self.settle()
    }

    /// How it stands after its last step.
    fn status(&self) -> Option<Status<'_>> {
        Some(Status {
            step: self.stage.steps(),
            total: self.stage.total(),
            share: self.stage.used().min(1.0),
            entry: self.entry.clone()?,
            judged: self.judged.as_ref(),
            active: self.stage.active(),
        })
    }

    /// Looks at pictures that it does not train on; the state is kept if it is the best so far.
    fn judge(&mut self) -> Result<()> {
        let entry = self.stage.judged(&self.held_out, self.task.pictures.patch_px)?;
        let step = self.stage.steps();
        let score = self.stage.score(&entry);
        let better = score.is_finite() && self.best.is_none_or(|(best, _)| score > best);
        if better {
            self.best = Some((score, step));
            checkpoint_of(&self.stage, (self.best, self.seen), &bound(&self.stage)?.0, &self.folder.join(BEST))?;
        }
        let lens = &self.stage.joint.lens;
        let name = format!("lenses/step-{step:07}.toml");
        prescription::save(lens, &self.folder.join(&name))?;
        let variables = self.stage.joint.steps.variables();
        let numbers = variables.parameters.iter().filter_map(|p| Some((p.name(lens), p.value(&**lens)?)));
        let certain = self.stage.joint.noise.certainty();
        let certain = variables.parameters.iter().zip(certain).map(|(p, t)| (p.name(lens), t));
        let judgement = Judgement {
            step,
            seconds: self.stage.seconds(),
            lens: name,
            held_out_db: [entry.input_psnr_db, entry.output_psnr_db],
            held_out_l1: entry.loss,
            score_db: Some(score),
            best: better,
            active: self.stage.active(),
            variables: numbers.collect(),
            certainty: certain.collect(),
        };
        self.stage.joint.noise.clear();
        let text = serde_json::to_string(&judgement).map_err(|e| Error::Internal(format!("history: {e}")))?;
        self.history.push(&format!("{text}\n"));
        self.show()?;
        self.judged = Some(entry);
        Ok(())
    }

    /// Writes the page.
    fn show(&self) -> Result<()> {
        let history = Judgement::of(self.history.text(), "history.jsonl")?;
        let log: Vec<Entry> = self.log.text().lines().skip(1).filter_map(Entry::read).collect();
        let verdict = self.verdicts.as_ref().map_or_else(Vec::new, Verdict::told);
        let told = StoryFacts { held_out: &self.held_out, history: &history, log: &log, verdict: &verdict };
        let html = page(&self.folder, &self.task, &self.stage, &told, &self.first)?;
        atomic::write_bytes(&self.folder.join("report.html"), html.as_bytes())
    }

    /// The end: where the last state is worse than the best one, that is the result.
    fn settle(&mut self) -> Result<()> {
        let Some((best, _)) = self.best.filter(|(_, step)| *step < self.stage.steps()) else { return self.conclude() };
        let path = self.folder.join(BEST);
        let last = self.stage.judged(&self.held_out, self.task.pictures.patch_px)?;
        let last = self.stage.score(&last);
        if (last.is_nan() || last < best - WORSE_DB) && path.exists() {
            // What is left, a judgement and the page, the CPU does.
            let (network, facts) = Reconstructor::load_with_facts(&path, Compute::Cpu)?;
            let state = State::from_text(facts.get(STATE).map_or("", String::as_str), &path.display().to_string())?;
            self.stage.joint.network = network;
            let frame = self.stage.renderer().plan.frame.clone();
            let scenery = Scenery { textures: &self.textures, sensor: &self.sensor, frame, seed: self.task.seed };
            let spent = self.stage.state();
            self.stage.restore(&scenery, &state)?;
            self.stage.finish();
            self.stage.over(&spent);
            save(&self.stage, (self.best, self.seen), &self.folder)?;
            // What is told of the result is the result's.
            self.judged = Some(self.stage.judged(&self.held_out, self.task.pictures.patch_px)?);
        }
        self.conclude()
    }

    /// Judges the network that is the result, where there is one, and writes the page. A judgement that fails takes nothing from the result.
    fn conclude(&mut self) -> Result<()> {
        if self.task.loss.sensor.is_none() {
            let joint = &self.stage.joint;
            let subject = Subject::from(joint.lens.clone());
            let verdicts = verdicts(&self.task_now(), &subject, (&joint.network, &joint.guide), &mut |_| {});
            self.verdicts = Some(verdicts.map_err(|e| e.to_string()));
        }
        self.show()
    }
}

impl Work for Designing {
    fn step(&mut self) -> Result<Option<Stepped>> {
        let before = self.stage.used();
        let frame = self.stage.renderer().plan.frame.clone();
        let scenery = Scenery { textures: &self.textures, sensor: &self.sensor, frame, seed: self.task.seed };
        let entry = match self.stage.step(&scenery) {
            Ok(Some(entry)) => entry,
            Ok(None) => {
                self.stage.finish();
                return Ok(None);
            }
            Err(why) => return Err(self.stopped(&why.to_string())),
        };
        if self.stage.steps().is_multiple_of(SMOOTH) {
            self.log.push(&entry.line());
        }
        let checks = self.task.budget.checks as f64;
        if (before * checks).floor() < (self.stage.used().min(1.0) * checks).floor() {
            self.judge()?;
        }
        let stepped = if entry.loss.is_finite() { Stepped::Moved } else { Stepped::Skipped };
        self.entry = Some(entry);
        Ok(Some(stepped))
    }

    fn steps(&self) -> u64 {
        self.stage.steps() as u64
    }

    /// Log and history, then network and lens: what is told is never behind.
    fn checkpoint(&mut self) -> Result<()> {
        self.log.save()?;
        self.history.save()?;
        save(&self.stage, (self.best, self.seen), &self.folder)
    }

    /// The last good state is kept; the error says where.
    fn stopped(&mut self, why: &str) -> Error {
        self.stage.joint.lens = self.stage.joint.good.clone();
        let kept = match self.checkpoint() {
            Ok(()) => format!("{} holds the last good state", self.folder.display()),
            Err(e) => format!("nor could it be kept: {e}"),
        };
        Error::Stopped(format!("the design stopped at step {}: {why}; {kept}", self.stage.steps()))
    }
}

fn step_of(line: &str) -> Option<u64> {
    serde_json::from_str::<serde_json::Value>(line).ok()?.get("step")?.as_u64()
}

/// What a checkpoint of `stage` belongs to, and its file of filters.
fn bound(stage: &Stage) -> Result<(Bound, Option<Vec<u8>>)> {
    Bound::of(stage.joint.lens.sha256(), &stage.joint.guide)
}

fn checkpoint_of(
    stage: &Stage,
    (best, seen): (Option<(f64, usize)>, [f64; 2]),
    bound: &Bound,
    path: &Path,
) -> Result<()> {
    let mut state = stage.state();
    (state.best, state.seen) = (best, seen);
    let mut facts = BTreeMap::from([(STATE.to_owned(), state.to_text()?)]);
    bending::put(stage.renderer().plan.settings.diffraction, &mut facts);
    bound.put(&mut facts);
    stage.joint.network.save_with_facts(path, &facts)
}

/// A checkpoint, with lens and filters as files that other commands read.
fn save(stage: &Stage, facts: (Option<(f64, usize)>, [f64; 2]), folder: &Path) -> Result<()> {
    let (bound, filters) = bound(stage)?;
    checkpoint_of(stage, facts, &bound, &folder.join(NETWORK))?;
    prescription::save(&stage.joint.lens, &folder.join("lens.toml"))?;
    if let Some(filters) = filters {
        atomic::write_bytes(&folder.join(guide::FILE), &filters)?;
    }
    Ok(())
}
