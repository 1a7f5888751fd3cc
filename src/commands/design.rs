//! `isoplanat design TASK.toml -o RUN/`: lens and network together.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::analysis::fabrication::tolerances::Tolerances;
use isoplanat::design::data::Textures;
use isoplanat::design::folder;
use isoplanat::design::joint::as_built::round;
use isoplanat::design::joint::designing::{Designing, Prepared, prepare, prepare_after};
use isoplanat::design::joint::judge::validate;
use isoplanat::design::joint::run::{JointSettings, network};
use isoplanat::design::joint::scenery::{Entry, Scenery};
use isoplanat::design::memory;
use isoplanat::design::pace::pace;
use isoplanat::design::task::Task;
use isoplanat::design::task::stages;
use isoplanat::design::task::stated::Stated;
use isoplanat::imaging::render::gradient_error::Chosen;
use isoplanat::imaging::render::{Settings, frame_of};
use isoplanat::lens::{Lens, prescription};
use isoplanat::network::Compute;
use isoplanat::optimize::{Apertures, Constraint, Problem, merit_of};
use isoplanat::report::table::numbered;
use isoplanat::report::verdict::Verdict;
use isoplanat::{Error, Result};
use serde::Serialize;

use crate::output::Common;
use crate::progress::Bar;

/// Joint design of lens and network.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Task file (form in models/README.md), or a shipped task: lfov-paper, lfov-30, lfov-30-free, edof, edof-free, edof-joint; with --resume the run's own
    #[arg(required_unless_present = "resume", conflicts_with = "resume")]
    task: Option<PathBuf>,
    /// Folder of the run: lens, network, log, history
    #[arg(short, long, value_name = "OUT_DIR", required_unless_present = "check")]
    output: Option<PathBuf>,
    /// Go on with the run in that folder
    #[arg(long, conflicts_with_all = ["force", "check", "minutes", "steps", "photos", "seed", "tolerance_aware", "worst_of"])]
    resume: bool,
    /// Length in minutes, in place of the task's; of each of its stages
    #[arg(long, conflicts_with = "steps")]
    minutes: Option<f64>,
    /// Length in steps, in place of the task's; of each of its stages
    #[arg(long)]
    steps: Option<usize>,
    /// Folder of photographs to train on, in place of the task's
    #[arg(long)]
    photos: Option<PathBuf>,
    /// Seed of every draw, in place of the task's
    #[arg(long)]
    seed: Option<u64>,
    /// Where the network computes: cpu, or cuda or wgpu in a build with that feature; checked against the CPU first. The optics stay on the CPU
    #[arg(long, default_value = "cpu")]
    device: Compute,
    /// Take pictures through lenses that are off by draws of this file of tolerances (as for `isoplanat tolerance`), in place of the task's
    #[arg(long, value_name = "FILE")]
    tolerance_aware: Option<PathBuf>,
    /// Of so many of those draws take the one with the largest spots, in place of the task's
    #[arg(long, value_name = "N")]
    worst_of: Option<usize>,
    /// Say what would be done, and how long a step takes here; nothing is written
    #[arg(long)]
    check: bool,
    /// Judge the result on patches of these photographs too
    #[arg(long)]
    validate: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    args.device.require()?;
    if args.check {
        return check(args, out);
    }
    let Some(folder) = &args.output else { return Err(Error::bad("--output", "value", "missing", "a folder").into()) };
    let Common { json, force } = args.common;
    let options = RunOptions { folder, force, device: args.device, validate: args.validate.as_deref(), json };
    let Some(path) = &args.task else { return go_on(None, options, out) };
    folder::check(folder, force)?;
    let (task, file) = (ready(args, path)?, path.display().to_string());
    let lens = task.first(&file)?.lens(crate::glasses::all())?;
    crate::glasses::all_taken()?;
    drawable(args, &lens)?;
    start(task, &lens, &file, options, out)
}

/// Designs `lens` by `task` (of `file`).
pub(crate) fn designed(
    task: Task,
    lens: &Lens,
    file: &str,
    options: RunOptions<'_>,
    out: &mut dyn Write,
) -> anyhow::Result<()> {
    folder::check(options.folder, options.force)?;
    start(task, lens, file, options, out)
}

/// Goes on in a folder.
pub(crate) fn resumed(options: RunOptions<'_>, out: &mut dyn Write) -> anyhow::Result<()> {
    go_on(None, options, out)
}

/// How a design is run.
#[derive(Clone, Copy)]
pub(crate) struct RunOptions<'a> {
    pub(crate) folder: &'a Path,
    /// Whether another run in that folder is replaced.
    pub(crate) force: bool,
    /// Where its network computes.
    pub(crate) device: Compute,
    /// Photographs that the result is judged on too.
    pub(crate) validate: Option<&'a Path>,
    /// Whether the result is told as JSON.
    pub(crate) json: bool,
}

impl<'a> RunOptions<'a> {
    /// A run in `folder` on the CPU, in nobody's place.
    pub(crate) fn of_folder(folder: &'a Path, json: bool) -> Self {
        Self { folder, force: false, device: Compute::Cpu, validate: None, json }
    }
}

/// A design from its beginning.
fn start(task: Task, lens: &Lens, file: &str, options: RunOptions<'_>, out: &mut dyn Write) -> anyhow::Result<()> {
    let RunOptions { force, device, .. } = options;
    let parts = task.parts(file)?;
    allowed(&parts[0], file)?;
    let first = prepared(&parts[0], lens, file)?;
    if parts.len() == 1 {
        let network = network(task.network.base_width, task.network.inputs, task.seed, device)?;
        let textures = task.textures()?;
        return run_to_end(Designing::create(task, &first, network, textures, options.folder, force)?, options, out);
    }
    // What a later stage would be refused for is said before the first begins, and before anything is written.
    for part in &parts[1..] {
        possible(part, file)?;
        prepare_after(part, &first.start, &first.problem.lens, file)?;
        network(part.network.base_width, part.network.inputs, part.seed, Compute::Cpu)?;
    }
    judged_on(&task, options.validate)?;
    drop((task.textures()?, task.held_out()?));
    network(parts[0].network.base_width, parts[0].network.inputs, parts[0].seed, device)?;
    stages::make(&task, lens, options.folder, force)?;
    go_on(Some(first), options, out)
}

/// A design from where its folder stands; where its first stage has not begun, from what that was made ready as.
fn go_on(mut ready: Option<Prepared>, options: RunOptions<'_>, out: &mut dyn Write) -> anyhow::Result<()> {
    let RunOptions { folder, device, .. } = options;
    let marker = folder.join(folder::MARKER);
    let file = marker.display().to_string();
    let reached = stages::reached(folder);
    let task = Task::load(&marker).ok();
    // Before a device is tried on the task's own shapes; a folder that is no run says so itself.
    if let Some(task) = &task {
        crate::memory::limit().allow("the design", memory::of_design(task)?, INSTEAD)?;
    }
    let Some(task) = task.filter(|task| !task.stages.is_empty() && !reached.own) else {
        return run_to_end(Designing::resume(folder, device)?, options, out);
    };
    let parts = task.parts(&file)?;
    let (lens, held) = stages::held(folder)?;
    // The lens that the first stage counts from, and the one that the last of them found.
    let before = |k: usize| -> Result<[Lens; 2]> {
        let of = |k, name: &str| prescription::load(&stages::folder_of(folder, k).join(name));
        Ok([of(0, folder::START)?, of(k - 1, "lens.toml")?])
    };
    let fresh = |part: &Task, prepared: Option<Prepared>, k: usize| -> Result<Prepared> {
        if k == 0 {
            return prepared.map_or_else(|| self::prepared(part, &lens, &file), Ok);
        }
        let [first, found] = before(k)?;
        prepare_after(part, &first, &found, &file)
    };
    let own = parts.len() - 1;
    for (k, part) in parts[..own].iter().enumerate().filter(|(k, _)| k + 1 >= reached.begun) {
        crate::aside!("stage {} of {}", k + 1, parts.len());
        let inside = stages::folder_of(folder, k);
        let designing = if k < reached.begun {
            Designing::resume(&inside, device)?
        } else {
            let prepared = fresh(part, ready.take(), k)?;
            let network = network(part.network.base_width, part.network.inputs, part.seed, device)?;
            Designing::create(part.clone(), &prepared, network, part.textures()?, &inside, false)?
        };
        // JSON is of the result alone.
        let quiet: &mut dyn Write = if options.json { &mut std::io::sink() } else { &mut *out };
        run_to_end(designing, RunOptions { validate: None, ..options }, quiet)?;
    }
    crate::aside!("stage {} of {}", parts.len(), parts.len());
    let prepared = fresh(&parts[own], None, own)?;
    let network = network(task.network.base_width, task.network.inputs, task.seed, device)?;
    let textures = task.textures()?;
    run_to_end(Designing::create_within(task, &prepared, network, textures, folder, held)?, options, out)
}

/// Whether a task's pictures are judged without a network, and the photographs that its result is judged on too.
///
/// # Errors
/// Photographs for a network that the task has none of; a folder without any.
fn judged_on(task: &Task, validate_on: Option<&Path>) -> Result<(bool, Option<Textures>)> {
    let by_images = task.loss.sensor.is_some();
    if let Some(folder) = validate_on.filter(|_| by_images) {
        let allowed =
            "no --validate for a task with loss.sensor, which has no network; `isoplanat train`, then `evaluate`";
        return Err(Error::bad("--validate", "value", folder.display().to_string(), allowed));
    }
    Ok((by_images, validate_on.map(Textures::photos).transpose()?))
}

/// Runs a design to its end, and says how it went.
fn run_to_end(mut designing: Designing, options: RunOptions<'_>, out: &mut dyn Write) -> anyhow::Result<()> {
    let RunOptions { folder, validate: validate_on, json, .. } = options;
    let (by_images, held_out) = judged_on(designing.task(), validate_on)?;
    let bytes = memory::of_design(designing.task())?;
    crate::memory::limit().allow("the design", bytes, INSTEAD)?;
    crate::memory::tell(bytes);
    if designing.stage().steps() > 0 {
        crate::aside!("resumed at step {}", designing.stage().steps());
    }
    designing.device().iter().for_each(|line| crate::aside!("{line}"));
    // Ctrl-C asks for an end; the step at hand is finished and kept.
    let asked = isoplanat_program::signals::asked();
    let bar = Bar::new(match (designing.task().lens.freeze, by_images) {
        (true, _) => "network alone",
        (_, true) => "lens by its images",
        _ => "lens and network",
    });
    let mut last: Option<Entry> = None;
    let designed = designing.run(&mut |status| {
        let e = &status.entry;
        let of = status.total.map_or(String::new(), |n| format!(" of {n}"));
        let held_out = status.judged.map_or(String::new(), |j| format!("  held out {:.2} dB", j.output_psnr_db));
        let active = status.active.first().map_or(String::new(), |a| format!("  held by {a}"));
        bar.set(status.share, format!("step {}{of}  {}{held_out}{active}", status.step, entry(e, by_images, 4)));
        last = Some(e.clone());
        !asked()
    });
    bar.done(format!("{} steps", designing.stage().steps()));
    if matches!(designed, Err(Error::Interrupted)) {
        let run = folder.display();
        crate::tell!("stopped at step {}; go on with: isoplanat design --resume -o {run}", designing.stage().steps());
    }
    designed?;
    let joint = &designing.stage().joint;
    let validated = match &held_out {
        Some(textures) => {
            let sensor = designing.task().sensor()?;
            let frame = frame_of(&joint.lens)?;
            let scenery = Scenery { textures, sensor: &sensor, frame, seed: 77 };
            let guided = (&joint.network, &joint.guide);
            let pictures = designing.task_now().pictures;
            let fineness = Settings { diffraction: pictures.diffraction.stated(), ..Settings::TRAINING };
            Some(validate(&scenery, &joint.lens, guided, pictures.patch_px, 48, fineness)?)
        }
        None => None,
    };
    if json {
        let figures = Figures::new(&designing, last.as_ref(), validated.as_ref());
        return Ok(writeln!(out, "{}", numbered(&figures))?);
    }
    for line in designing.verdicts().into_iter().flat_map(Verdict::told) {
        writeln!(out, "{line}")?;
    }
    let mut tell = |name: &str, e: Option<&Entry>| -> std::io::Result<()> {
        let Some(e) = e else { return Ok(()) };
        writeln!(out, "{name:11} {}", entry(e, by_images, 5))
    };
    tell("training", last.as_ref())?;
    tell("held out", designing.judged())?;
    tell("validation", validated.as_ref())?;
    writeln!(out, "steps of the lens taken back: {}", joint.rejected)?;
    if designing.task().lens.tolerances.is_some() {
        writeln!(
            out,
            "pictures through lenses as built; of those that were drawn {} showed nothing",
            designing.stage().lost()
        )?;
    }
    if let (count @ 1.., seconds) = joint.refreshed {
        writeln!(out, "filters of the guided network made anew {count} times as it moved, in {seconds:.1} s in all")?;
    }
    for (step, chosen) in &designing.stage().fineness {
        writeln!(out, "rendered from step {step} on: {}", chosen.describe())?;
    }
    Ok(())
}

/// How a design went, for machines.
#[derive(Serialize)]
struct Figures<'a> {
    steps: usize,
    seconds: f64,
    last: Option<&'a Entry>,
    held_out: Option<&'a Entry>,
    validation: Option<&'a Entry>,
    verdicts: Option<&'a [Verdict]>,
    rejected: usize,
    drawn_without_light: usize,
    fineness: &'a [(usize, Chosen)],
    filters_made: usize,
    filters_seconds: f64,
}

impl<'a> Figures<'a> {
    fn new(designing: &'a Designing, last: Option<&'a Entry>, validation: Option<&'a Entry>) -> Self {
        let stage = designing.stage();
        let (filters_made, filters_seconds) = stage.joint.refreshed;
        Self {
            steps: stage.steps(),
            seconds: stage.seconds(),
            last,
            held_out: designing.judged(),
            validation,
            verdicts: designing.verdicts().and_then(|v| v.as_deref().ok()),
            rejected: stage.joint.rejected,
            drawn_without_light: stage.lost(),
            fineness: &stage.fineness,
            filters_made,
            filters_seconds,
        }
    }
}

/// An entry in words.
fn entry(e: &Entry, by_images: bool, digits: usize) -> String {
    let [a, b] = [e.input_psnr_db, e.output_psnr_db];
    if by_images {
        return format!("loss {:.digits$}  {a:.2} dB, the lowest distance {b:.2} dB", e.loss);
    }
    format!("L1 {:.digits$}  {a:.2} → {b:.2} dB", e.loss)
}

const INSTEAD: &str = "a smaller patch_px, batch, base_width or folder";

/// The task with the command line's changes, read and checked.
fn ready(args: &Args, path: &Path) -> Result<Task> {
    let mut task = Task::load(path)?;
    if args.minutes.is_some() || args.steps.is_some() {
        (task.budget.minutes, task.budget.steps) = (args.minutes, args.steps);
        // Of each of its stages.
        for budget in task.stages.iter_mut().filter_map(|stage| stage.get_mut("budget")?.as_table_mut()) {
            budget.retain(|key, _| key != "minutes" && key != "steps");
        }
    }
    task.pictures.photos = args.photos.clone().or(task.pictures.photos);
    task.seed = args.seed.unwrap_or(task.seed);
    if let Some(path) = &args.tolerance_aware {
        task.lens.tolerances = Some(Stated::read(path)?);
    }
    task.lens.worst_of = args.worst_of.unwrap_or(task.lens.worst_of);
    task.check(&path.display().to_string())?;
    Ok(task)
}

/// Refuses tolerances of the command line that are not the lens's, by their file's name.
fn drawable(args: &Args, lens: &Lens) -> Result<()> {
    args.tolerance_aware.as_ref().map_or(Ok(()), |path| round(&Tolerances::load(path)?, lens).map(|_| ()))
}

/// Refuses a task (of `file`) that has no joint stage, or none that this machine has the memory for.
fn allowed(task: &Task, file: &str) -> Result<()> {
    crate::input::of_task(task)?;
    possible(task, file)
}

/// The same but for its lens.
fn possible(task: &Task, file: &str) -> Result<()> {
    task.length().map_err(|e| e.in_file(Path::new(file)))?;
    crate::memory::limit().allow("the design", memory::of_design(task)?, INSTEAD)
}

fn prepared(task: &Task, lens: &Lens, file: &str) -> Result<Prepared> {
    let bar = (task.lens.search > 0).then(|| Bar::new("spots first"));
    let prepared = prepare(task, lens, file, &mut |share, rms| {
        if let Some(bar) = &bar {
            bar.set(share, format!("rms {:.3} µm", 1e3 * rms));
        }
    })?;
    if let Some(bar) = bar {
        bar.done(String::new());
    }
    if let Some(best) = &prepared.best_built {
        let [least, first] = best.spots_mm.map(|mm| 1e3 * mm);
        crate::aside!(
            "spots first: of {} lenses that the search found number {} is the best as built: nine in ten within {least:.1} µm rms, of number 1 within {first:.1} µm",
            best.of,
            best.rank + 1
        );
    }
    if prepared.warm.is_some() && !prepared.taken {
        crate::aside!(
            "spots first: through that lens no light reaches the frame's corner; the start is taken as it is"
        );
    } else if let Some(warm) = &prepared.warm {
        crate::aside!(
            "spots first: {:.1} µm rms -> {:.1} µm in {:.2} s ({})",
            1e3 * warm.rms_mm[0],
            1e3 * warm.rms_mm[1],
            warm.seconds,
            warm.stop.reason()
        );
    }
    Ok(prepared)
}

/// What would be done in several stages, for machines.
#[derive(Serialize)]
struct Stages<'a> {
    stages: &'a [serde_json::Value],
}

/// What would be done, in every stage; all of them with the lens that the first one begins with.
fn check(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let Some(path) = &args.task else { return Err(Error::bad("TASK", "value", "missing", "a task file").into()) };
    let (task, file) = (ready(args, path)?, path.display().to_string());
    let parts = task.parts(&file)?;
    allowed(&parts[0], &file)?;
    parts.iter().try_for_each(|part| possible(part, &file))?;
    judged_on(&task, args.validate.as_deref())?;
    let lens = parts[0].lens(crate::glasses::all())?;
    crate::glasses::all_taken()?;
    drawable(args, &lens)?;
    if !args.common.json {
        writeln!(out, "{file}: nothing was written")?;
    }
    let first = prepared(&parts[0], &lens, &file)?;
    let mut values = Vec::new();
    for (k, part) in parts.iter().enumerate() {
        if parts.len() > 1 && !args.common.json {
            writeln!(out, "\nstage {} of {}, with the lens that the first one begins with", k + 1, parts.len())?;
        }
        let later = if k > 0 { Some(prepare_after(part, &first.start, &first.problem.lens, &file)?) } else { None };
        values.push(looked_at(part, later.as_ref().unwrap_or(&first), args, out)?);
    }
    if args.common.json {
        let value = match values.as_slice() {
            [one] => one.clone(),
            stages => numbered(&Stages { stages }),
        };
        writeln!(out, "{value}")?;
    }
    Ok(())
}

/// What becomes of clear semi-diameters, in words.
fn held_as(problem: &Problem) -> &'static str {
    match problem.merit.apertures {
        Apertures::Automatic => "follow the beam: all of the stop's light counts over the field",
        Apertures::Stated => "stay as stated: the rays that they let through count",
    }
}

/// What would be done in one stage, for machines.
#[derive(Serialize)]
struct Looked<'a> {
    variables: Vec<Moved>,
    constraints: &'a [Constraint],
    seconds_a_step: f64,
    seconds_of_its_network: f64,
    seconds_with_the_lens_held: f64,
    seconds_in_all: f64,
    rms_spot_mm: Option<f64>,
    field_deg: f64,
    scenes: usize,
}

/// A variable, and what it may become.
#[derive(Serialize)]
struct Moved {
    name: String,
    bounds: [f64; 2],
}

/// What would be done in one of them: in words, or as the value that is returned.
fn looked_at(task: &Task, prepared: &Prepared, args: &Args, out: &mut dyn Write) -> anyhow::Result<serde_json::Value> {
    let (problem, settings) = (&prepared.problem, JointSettings::from_task(task)?);
    let textures = task.textures()?;
    let sensor = task.sensor()?;
    let scenery = Scenery { textures: &textures, sensor: &sensor, frame: frame_of(&problem.lens)?, seed: task.seed };
    let (batch, side) = (task.pictures.batch, task.pictures.patch_px);
    let fresh = || {
        let mut network = network(task.network.base_width, task.network.inputs, task.seed, args.device)?;
        network.check_device(batch, side).map(|_| network)
    };
    let pace = pace(&scenery, problem, &fresh, &settings)?;
    let spots = merit_of(&problem.lens, &problem.merit).ok();
    if args.common.json {
        let all = problem.variables.parameters.iter().zip(&problem.bounds);
        return Ok(numbered(&Looked {
            variables: all.map(|(p, bounds)| Moved { name: p.name(&problem.lens), bounds: *bounds }).collect(),
            constraints: &problem.constraints,
            seconds_a_step: pace.moving,
            seconds_of_its_network: pace.network,
            seconds_with_the_lens_held: pace.held,
            seconds_in_all: pace.all(&settings),
            rms_spot_mm: spots,
            field_deg: problem.lens.max_field_deg(),
            scenes: textures.len(),
        }));
    }
    writeln!(out, "field to {:.2}° half; {} scenes to train on", problem.lens.max_field_deg(), textures.len())?;
    writeln!(out, "clear semi-diameters {}", held_as(problem))?;
    if let Some(rms) = spots {
        writeln!(out, "the stage begins with spots of {:.1} µm rms", 1e3 * rms)?;
    }
    writeln!(out, "\n{:32} {:>14}   allowed", "moves", "value")?;
    let (variables, values) = (&problem.variables, problem.variables.values(&problem.lens));
    for (k, (p, [low, high])) in variables.parameters.iter().zip(&problem.bounds).enumerate() {
        let value = values[k] * variables.scales[k];
        writeln!(out, "{:32} {:>14.7}   {low:.4} to {high:.4}", p.name(&problem.lens), value)?;
    }
    writeln!(out, "\n{:32} allowed", "held")?;
    for c in &problem.constraints {
        writeln!(
            out,
            "{:32} {:.4} to {:.4} {}",
            problem.words(c.quantity),
            c.bounds[0],
            c.bounds[1],
            c.quantity.unit()
        )?;
    }
    writeln!(
        out,
        "\na step takes {:.3} s here with the lens moving, {:.0} % of it optics, {:.3} s with the lens held; {:.1} minutes in all",
        pace.moving,
        100.0 * (1.0 - pace.network / pace.moving),
        pace.held,
        pace.all(&settings) / 60.0
    )?;
    Ok(serde_json::Value::Null)
}
