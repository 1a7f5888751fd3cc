//! `isoplanat compare TASK | RUN | LENS LENS -o DIR/`: a lens and others in its place, each with a network of its own, judged alike.
//!
//! The folder holds `compare.json` (what was asked), and of each camera, in `01-name/`, `lens.toml` (the lens in its place), `network/` (the run of its
//! network), `sheets/` (pictures) and `evaluation.toml` (its figures, the last to be written); at the end `comparison.html`, `.csv` and `.json`. A camera
//! that has its figures is not done again, and one whose network is under way goes on.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::atomic::{self, FolderKind};
use isoplanat::design::compare::{Placed, Specification};
use isoplanat::design::evaluate::{Settings, judgeable};
use isoplanat::design::memory;
use isoplanat::design::subject::Subject;
use isoplanat::design::task::Task;
use isoplanat::design::training::Training;
use isoplanat::imaging::files::read_linear;
use isoplanat::imaging::guide::Inputs;
use isoplanat::imaging::render::frame_of;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::{Lens, prescription};
use isoplanat::network::Compute;
use isoplanat::report::comparison::{Comparison, EdgesAt, Entrant};
use isoplanat::report::drawing::lens_svg;
use isoplanat::report::evaluation::Evaluation;
use isoplanat::report::measured::{LARGEST, Settings as EdgeSettings};
use isoplanat::report::table::{numbered, significant};
use isoplanat::terminal::path_in_line;
use isoplanat::{Error, Result};

use crate::evaluate::{Judged, Protocol};
use crate::output::Common;

/// What makes a folder one of a comparison.
const MARKER: &str = "compare.json";
/// A camera's figures.
const FIGURES: &str = "evaluation.toml";
/// Its slanted edges.
const EDGES: &str = "edges.toml";
/// Who is compared where nobody says.
const STOCK: [&str; 5] = ["al2550_a", "ac254_050_a", "aca254_050_a_surrogate", "cooke_triplet", "double_gauss"];
/// Part of the steps that a rate is tried for, and the last part of those by whose loss it is judged.
const TRIED: f64 = 0.1;
const LAST: f64 = 0.25;
/// Least steps of a trial.
const FEWEST: u64 = 20;

/// One lens and others in its place: scaled to its focal length, stopped to its aperture, refocused for its distances, on its raster, each with a
/// network of its own; table, curves over field and distance, pictures.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Task, for its lens; folder of a design, for the lens that it found; or a lens, with another one behind it
    subject: PathBuf,
    /// The lens that it is compared with, by file or shipped name: those two alone
    #[arg(conflicts_with = "against")]
    other: Option<String>,
    /// Folder of the comparison
    #[arg(short, long, value_name = "OUT_DIR")]
    output: PathBuf,
    /// Lenses beside the first, comma-separated files or shipped names
    #[arg(long, value_delimiter = ',', value_name = "LENS,…", default_values_t = STOCK.map(str::to_owned))]
    against: Vec<String>,
    /// Folder of photographs to train on, in place of the task's
    #[arg(long, value_name = "DIR")]
    train_photos: Option<PathBuf>,
    /// Minutes of each network's training, in place of the task's
    #[arg(long, conflicts_with = "steps")]
    minutes: Option<f64>,
    /// Steps of each network's training, in place of the task's: the same work for each
    #[arg(long)]
    steps: Option<u64>,
    /// Networks of each lens: task (the task's), paper (three scales, sees the capture alone), guided (the task's, guided: it sees the capture through its lens's own filters, too)
    #[arg(long, value_delimiter = ',', value_name = "KIND,…", default_value = "task")]
    networks: Vec<Kind>,
    /// Focus the other lenses for all distances of the task alike, in place of the first lens's object distance
    #[arg(long)]
    focus_all: bool,
    /// Learning rates, comma-separated: each is tried for a tenth of the steps, the one with the least loss is taken, for each camera by itself;
    /// the task's where left out
    #[arg(long, value_delimiter = ',', value_name = "RATE,…")]
    rates: Vec<f64>,
    /// MTF before and after each network too, by slanted edges at so many places from the axis to the end of the field, 0 to 6, at every distance
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=6))]
    edges: u8,
    /// Rays a pixel of their captures
    #[arg(long, default_value_t = 256, value_name = "RAYS", value_parser = clap::value_parser!(u32).range(2..=65536))]
    edge_rays: u32,
    #[command(flatten)]
    protocol: Protocol,
    /// Go on with the comparison in that folder, asked for in the same words
    #[arg(long, conflicts_with = "force")]
    resume: bool,
    #[command(flatten)]
    common: Common,
}

/// A network of a comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Kind {
    /// The task's.
    Task,
    /// Three scales that see the capture alone.
    Paper,
    /// The task's, guided.
    #[value(alias = "told")]
    Guided,
}

impl Kind {
    /// `task` with this network.
    fn of(self, task: &Task) -> Task {
        let mut task = task.clone();
        match self {
            Self::Task => {}
            Self::Paper => (task.train.network.scales, task.train.network.inputs) = (3, Inputs::BARE),
            Self::Guided => task.train.network.inputs = Inputs::GUIDED,
        }
        task
    }
}

/// The file of slanted edges.
#[derive(serde::Serialize, serde::Deserialize)]
struct Edges {
    distance: Vec<EdgesAt>,
}

/// A lens that takes part.
struct Camera {
    /// Its folder's name.
    folder: String,
    task: Task,
    lens: std::result::Result<Placed, Error>,
    /// As the command line names it.
    named: String,
    network: String,
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let task = task(args)?;
    let first = task.lens(crate::glasses::all())?;
    crate::input::of_task(&task)?;
    let cameras = cameras(args, &task, &first)?;
    let pictures = args.protocol.pictures()?;
    // What no camera could be judged by is told before any is trained.
    let (subject, sensor) = (Subject::from(first.clone()), task.sensor()?);
    let settings_of_first = args.protocol.settings(&task, &subject);
    judgeable(&subject, &sensor, &settings_of_first).map_err(|e| e.in_file(&args.subject))?;
    let frame = subject.frame()?;
    let size = Some([frame.columns, frame.rows]);
    for camera in &cameras {
        let bytes = memory::of_evaluation(&camera.task.train.config()?, &pictures, &settings_of_first, size, true)?;
        crate::memory::limit().allow("the judgement", bytes, "a smaller --patch or smaller photographs")?;
        if args.edges > 0 {
            // Patches of edges are of the size that their blur asks for.
            let edges = Settings { patch: LARGEST, ..settings_of_first.clone() };
            let bytes = memory::of_evaluation(&camera.task.train.config()?, &pictures, &edges, size, false)?;
            crate::memory::limit().allow("the slanted edges", bytes, "no --edges, or a smaller network")?;
        }
        let instead = "a smaller train.pairs.patch_px, batch or base_width";
        crate::memory::limit().allow("the training", memory::of_training(&camera.task)?, instead)?;
    }
    let asked_for = asked_for(args, &task, &cameras)?;
    begin(args, &asked_for)?;
    // Ctrl-C asks for an end; the step at hand is finished and kept.
    let asked = isoplanat_program::signals::asked();
    let mut outcomes = Vec::new();
    for (k, camera) in cameras.iter().enumerate() {
        crate::aside!("{} of {}: {}", k + 1, cameras.len(), camera.label());
        let outcome =
            camera.compared(args, &pictures, &asked).and_then(|found| Ok((found, camera.edges(args, &asked)?)));
        if let Err(Error::Interrupted) = outcome {
            crate::tell!("stopped; the same command with --resume goes on");
            return Err(Error::Interrupted.into());
        }
        outcomes.push(outcome);
    }
    let nobody = outcomes.iter().all(Result::is_err);
    let mut entrants = Vec::new();
    for (camera, outcome) in cameras.iter().zip(outcomes) {
        entrants.push(camera.entrant(&args.output.join(&camera.folder), outcome)?);
    }
    apart(&mut entrants, &cameras);
    if let Some(why) = entrants.first().and_then(|e| e.outcome.as_ref().err()) {
        crate::tell!("warning: the first camera was not judged: {why}");
    }
    let comparison = Comparison {
        title: format!("{} and others in its place", first.name),
        entrants,
        settings: settings(args, &task, &first),
    };
    let json = comparison.json();
    let put = |name: &str, text: &str| atomic::write_bytes(&args.output.join(name), text.as_bytes());
    put("comparison.html", &comparison.to_html()?)?;
    put("comparison.csv", &comparison.csv())?;
    put("comparison.json", &format!("{json}\n"))?;
    if args.common.json {
        writeln!(out, "{json}")?;
    } else {
        writeln!(out, "{}", comparison.table())?;
        if let Some(edges) = comparison.edges() {
            writeln!(out, "{edges}")?;
        }
        comparison.refused().iter().try_for_each(|line| writeln!(out, "{line}"))?;
        writeln!(out, "{}", path_in_line(&args.output.join("comparison.html")))?;
    }
    if nobody {
        out.flush()?;
        return Err(Error::Stopped("no camera was judged".into()).into());
    }
    Ok(())
}

/// Cameras of one name are told apart by what named them.
fn apart(entrants: &mut [Entrant], cameras: &[Camera]) {
    let labels: Vec<String> = entrants.iter().map(Entrant::label).collect();
    for (k, camera) in cameras.iter().enumerate() {
        if labels.iter().filter(|l| **l == labels[k]).count() > 1 {
            entrants[k].name = format!("{} ({})", entrants[k].name, camera.folder);
        }
    }
}

/// The task, with the command line's changes.
fn task(args: &Args) -> Result<Task> {
    let mut task = match &args.other {
        Some(_) => Task::new(args.subject.display().to_string()),
        None if args.subject.is_dir() => Task::of_run(&args.subject)?,
        None => Task::load(&args.subject)?,
    };
    if args.other.is_some() {
        // No task says how: as the shipped ones train.
        let train = &mut task.train;
        (train.network.scales, train.network.base_width) = (4, Some(16));
        (train.loss.content, train.budget.rate) = ("l1".into(), 1e-3);
        (train.pairs.patch_px, train.pairs.region_px, train.pairs.count, train.budget.rise_steps) = (192, 256, 240, 50);
        (train.budget.constant_epochs, train.budget.decay_epochs, train.budget.minutes) = (1.0, 2.0, Some(15.0));
        (train.pairs.noise, train.pairs.haze) = ([1.0, 1.0], 0.0);
    }
    if args.minutes.is_some() || args.steps.is_some() {
        (task.train.budget.minutes, task.train.budget.steps) = (args.minutes, args.steps);
    }
    if let Some(photos) = &args.train_photos {
        task.pictures.photos = Some(photos.clone());
    }
    if let Some(rate) = args.rates.first() {
        task.train.budget.rate = *rate;
    }
    if let Some(rate) = args.rates.iter().find(|r| !(**r > 0.0 && **r < 1.0)) {
        return Err(Error::bad("--rates", "value", rate.to_string(), "above 0, below 1"));
    }
    // It is not looked at on its way.
    task.train.budget.sample_steps = 0;
    task.check(&args.subject.display().to_string())?;
    Ok(task)
}

/// Everybody who takes part, the task's lens first, each with each network.
fn cameras(args: &Args, task: &Task, first: &Lens) -> Result<Vec<Camera>> {
    let place = Specification::of_lens(first, if args.focus_all { task.network_depths_mm() } else { &[] })?;
    let density = SpectralDensity::new(&task.sensor()?);
    let own = Placed { lens: first.clone(), scale: 1.0, shift_mm: 0.0, rms_mm: [f64::NAN; 2], field_deg: f64::NAN };
    let mut lenses = vec![(args.subject.display().to_string(), Ok(own))];
    let others = args.other.as_ref().map_or(&args.against[..], std::slice::from_ref);
    for named in others {
        // A name that is none is a slip; a lens that has no place here is an outcome.
        let lens = crate::input::one_of_lenses(named)?;
        let seen = crate::input::in_band(&lens, &density, named);
        lenses.push((named.clone(), seen.and_then(|()| place.put(&lens))));
    }
    crate::glasses::all_taken()?;
    let mut cameras = Vec::new();
    for (named, lens) in lenses {
        for kind in &args.networks {
            let number = cameras.len() + 1;
            let stem = Path::new(&named).file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let kept = |c: char| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' };
            let stem: String = stem.chars().map(kept).take(40).collect();
            let network = if args.networks.len() > 1 { format!("{kind:?}").to_lowercase() } else { String::new() };
            let lens = match &lens {
                Ok(placed) => Ok(placed.clone()),
                Err(why) => Err(Error::Stopped(why.to_string())),
            };
            cameras.push(Camera {
                folder: format!("{number:02}-{stem}{}{network}", if network.is_empty() { "" } else { "-" }),
                task: kind.of(task),
                lens,
                named: named.clone(),
                network,
            });
        }
    }
    Ok(cameras)
}

/// What decides the figures.
#[derive(serde::Serialize)]
struct AskedFor<'a> {
    task: String,
    rates: &'a [f64],
    focus_all: bool,
    protocol: String,
    cameras: Vec<[String; 3]>,
    trained_on: String,
    sensor: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    edges: Option<[u32; 2]>,
}

/// The same, as JSON.
fn asked_for(args: &Args, task: &Task, cameras: &[Camera]) -> Result<String> {
    let (trained_on, sensor) = (task.textures()?.sha256(), format!("{:?}", task.sensor()?));
    // The lens is among the cameras, as its numbers are.
    let mut task = task.clone();
    task.lens.file = "first".into();
    let camera = |c: &Camera| {
        let lens = c.lens.as_ref().map_or_else(ToString::to_string, |p| p.lens.sha256());
        [c.named.clone(), c.network.clone(), lens]
    };
    let asked_for = AskedFor {
        task: task.to_toml()?,
        rates: &args.rates,
        focus_all: args.focus_all,
        protocol: format!("{:?}", args.protocol),
        cameras: cameras.iter().map(camera).collect(),
        trained_on,
        sensor,
        edges: (args.edges > 0).then_some([args.edges.into(), args.edge_rays]),
    };
    Ok(format!("{}\n", numbered(&asked_for)))
}

/// Makes the folder, or goes on in it.
fn begin(args: &Args, asked_for: &str) -> Result<()> {
    let folder = &args.output;
    let path = folder.join(MARKER);
    if args.resume && path.is_file() {
        // Of a kill as the folder was put there.
        atomic::recover(folder)?;
        let then = atomic::read_text(&path, 1 << 20)?;
        if then != asked_for {
            let read = |text: &str| serde_json::from_str::<serde_json::Value>(text).unwrap_or_default();
            let (then, now) = (read(&then), read(asked_for));
            let differs = now.as_object().into_iter().flatten().filter(|(k, v)| then.get(k) != Some(v));
            let keys: Vec<&str> = differs.map(|(k, _)| k.as_str()).collect();
            let found = format!("another {} than asked for now", keys.join(", "));
            let allowed = "the task, lenses, networks and protocol that it began with; a new folder for others";
            return Err(Error::bad(path.display().to_string(), "comparison", found, allowed));
        }
        return Ok(());
    }
    // Each camera's folder is a run, or what was made of one.
    let made = |path: &Path| ["task.toml", FIGURES, EDGES].iter().any(|file| path.join(file).is_file());
    let runs = std::fs::read_dir(folder).into_iter().flatten().flatten().filter(|entry| made(&entry.path()));
    let runs: Vec<String> = runs.map(|entry| format!("{}/**", entry.file_name().to_string_lossy())).collect();
    let entries: Vec<&str> = ["comparison.*", "rate/**"].into_iter().chain(runs.iter().map(String::as_str)).collect();
    atomic::publish_folder(folder, &FolderKind::new(MARKER, &entries), args.common.force.into(), |inside| {
        atomic::write_bytes(&inside.join(MARKER), asked_for.as_bytes())
    })
}

/// How it was done, for the page.
fn settings(args: &Args, task: &Task, first: &Lens) -> Vec<[String; 2]> {
    let pair = |a: &str, b: String| [a.to_owned(), b];
    let train = &task.train;
    let length = match (train.budget.steps, train.budget.minutes) {
        (Some(n), _) => format!("{n} steps"),
        (None, Some(m)) => format!("{m} minutes"),
        (None, None) => format!("{} epochs", train.budget.constant_epochs + train.budget.decay_epochs),
    };
    let rates = match args.rates.as_slice() {
        [] | [_] => significant(train.budget.rate, 3),
        many => {
            let all: Vec<String> = many.iter().map(|r| significant(*r, 3)).collect();
            format!("the best of {} after a tenth of the steps, for each camera by itself", all.join(", "))
        }
    };
    let mut all = vec![
        pair(
            "raster",
            format!("{} × {} pixels of {} µm", first.sensor.columns, first.sensor.rows, first.sensor.pitch_um),
        ),
        pair("training", format!("{length} each, seed {}", task.seed)),
        pair("learning rate", rates),
    ];
    let focus = if args.focus_all { "all of the task's distances alike" } else { "the first lens's object distance" };
    all.push(pair("others focused for", focus.into()));
    if !task.network_depths_mm().is_empty() {
        let list: Vec<String> = task.network_depths_mm().iter().map(|d| significant(*d, 5)).collect();
        all.push(pair("trained for, mm", list.join(", ")));
    }
    all.extend(args.protocol.described());
    all
}

impl Camera {
    fn label(&self) -> String {
        if self.network.is_empty() { self.named.clone() } else { format!("{}, {}", self.named, self.network) }
    }

    /// Trains and judges it, or reads what was found before.
    fn compared(
        &self,
        args: &Args,
        pictures: &isoplanat::design::evaluate::Pictures,
        asked: &dyn Fn() -> bool,
    ) -> Result<Evaluation> {
        let placed = self.lens.as_ref().map_err(|e| Error::Stopped(e.to_string()))?;
        let folder = args.output.join(&self.folder);
        let figures = folder.join(FIGURES);
        if figures.is_file() {
            let text = atomic::read_text(&figures, 64 << 20)?;
            let file = figures.display().to_string();
            return toml::from_str(&text)
                .map_err(|e| Error::toml(&file, &text, &e, "figures, as `isoplanat compare` writes them"));
        }
        std::fs::create_dir_all(&folder).map_err(|e| Error::writing(&folder, e))?;
        let lens = folder.join("lens.toml");
        prescription::save(&placed.lens, &lens)?;
        let mut task = self.task.clone();
        (task.lens.file, task.lens.asphere_power, task.frame.raster) = (lens.display().to_string(), 0, None);
        let network = folder.join("network");
        if !network.join("task.toml").is_file() && args.rates.len() > 1 {
            task.train.budget.rate = best_rate(&task, &args.rates, &folder, asked)?;
        }
        let mut training = if network.join("task.toml").is_file() {
            Training::resume(&network, Compute::default())?
        } else {
            Training::create(task, &network, false, Compute::default(), crate::glasses::all())?
        };
        crate::train::to_the_end(&mut training, "training", asked, &mut |_| {})?;
        drop(training);
        let judged = Judged::new(&args.protocol, None, &network)?;
        let (result, sheets) = judged.judge(pictures, true)?;
        judged.save(&folder.join("sheets"), true, &sheets, &result, pictures)?;
        let text = toml::to_string(&result).map_err(|e| Error::Internal(format!("figures: {e}")))?;
        atomic::write_bytes(&figures, text.as_bytes())?;
        Ok(result)
    }

    /// Its slanted edges where they are asked for, or why there are none.
    fn edges(&self, args: &Args, asked: &dyn Fn() -> bool) -> Result<Vec<EdgesAt>> {
        if args.edges == 0 {
            return Ok(Vec::new());
        }
        match self.edges_found(args, asked) {
            Err(why) if !matches!(why, Error::Interrupted) => {
                let distance = self.lens.as_ref().map_or(f64::INFINITY, |p| 1.0 / p.lens.object_vergence);
                Ok(vec![EdgesAt { depth_mm: distance, missing: vec![why.to_string()], curves: Vec::new() }])
            }
            other => other,
        }
    }

    /// Measures its slanted edges, or reads what was found before.
    fn edges_found(&self, args: &Args, asked: &dyn Fn() -> bool) -> Result<Vec<EdgesAt>> {
        let folder = args.output.join(&self.folder);
        let path = folder.join(EDGES);
        if path.is_file() {
            let text = atomic::read_text(&path, 64 << 20)?;
            let file = path.display().to_string();
            let read: Edges = toml::from_str(&text)
                .map_err(|e| Error::toml(&file, &text, &e, "curves, as `isoplanat compare` writes them"))?;
            return Ok(read.distance);
        }
        let judged = Judged::new(&args.protocol, None, &folder.join("network"))?;
        let settings =
            EdgeSettings { places: args.edges.into(), rays: args.edge_rays as usize, ..EdgeSettings::default() };
        let edges = Edges { distance: judged.edges(settings, asked)? };
        let text = toml::to_string(&edges).map_err(|e| Error::Internal(format!("curves: {e}")))?;
        atomic::write_bytes(&path, text.as_bytes())?;
        Ok(edges.distance)
    }

    /// For the page.
    fn entrant(&self, folder: &Path, outcome: Result<(Evaluation, Vec<EdgesAt>)>) -> Result<Entrant> {
        let mut notes = Vec::new();
        let (mut name, mut drawing) = (self.named.clone(), String::new());
        if let Ok(placed) = &self.lens {
            (name, drawing) = (placed.lens.name.clone(), lens_svg(&placed.lens));
            if placed.field_deg.is_finite() {
                notes.push(format!("scaled by {}", significant(placed.scale, 4)));
                let [before, after] = placed.rms_mm.map(|v| significant(1e3 * v, 4));
                notes.push(format!(
                    "sensor moved by {} mm from the paraxial image: spots {before} to {after} µm rms to {}° half field",
                    significant(placed.shift_mm, 3),
                    significant(placed.field_deg, 3)
                ));
                let corner = frame_of(&placed.lens)?.max_radius_mm();
                notes.push(format!("frame's corner {} mm from the axis", significant(corner, 4)));
            }
        }
        let config = self.task.train.config()?;
        let inputs = config.inputs.names();
        let told =
            if inputs.is_empty() { "the capture alone".to_owned() } else { inputs.join(", ") + " beside the capture" };
        notes.push(format!("network of {} scales, width {}, sees {told}", config.scales, config.base_width));
        let run = folder.join("network").join("task.toml");
        if run.is_file() {
            notes.push(format!("learning rate {}", significant(Task::load(&run)?.train.budget.rate, 3)));
        }
        let sheets = if outcome.is_ok() { sheets(&folder.join("sheets"))? } else { Vec::new() };
        let (outcome, edges) = match outcome {
            Ok((evaluation, edges)) => (Ok(evaluation), edges),
            Err(why) => (Err(why.to_string()), Vec::new()),
        };
        Ok(Entrant { name, network: self.network.clone(), notes, drawing, outcome, edges, sheets })
    }
}

/// The rate with the least mean loss over the last quarter of a tenth of the steps.
fn best_rate(task: &Task, rates: &[f64], folder: &Path, asked: &dyn Fn() -> bool) -> Result<f64> {
    let mut best = None::<(f64, f64)>;
    let whole = task.train.schedule().total();
    for rate in rates {
        let mut short = task.clone();
        short.train.budget.rate = *rate;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "a number of steps"
        )]
        let tenth = |n: u64| ((n as f64 * TRIED) as u64).max(FEWEST);
        short.train.budget.steps = whole.map(tenth);
        short.train.budget.minutes = short.train.budget.minutes.filter(|_| whole.is_none()).map(|m| TRIED * m);
        // No trial is all rise.
        short.train.budget.rise_steps = short
            .train
            .budget
            .steps
            .map_or(short.train.budget.rise_steps, |n| short.train.budget.rise_steps.min(n / 4));
        let run = folder.join("rate");
        let mut training = Training::create(short, &run, run.exists(), Compute::default(), crate::glasses::all())?;
        let mut losses = Vec::new();
        let trained =
            crate::train::to_the_end(&mut training, "a rate on trial", asked, &mut |s| losses.push(s.entry.content));
        let lost = match trained {
            // Steps too large for the network are a finding, not a fault.
            Err(Error::Stopped(_)) => true,
            other => other.map(|()| training.returned() > 0)?,
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss,
            reason = "a number of steps"
        )]
        let last = ((losses.len() as f64 * LAST) as usize).max(1).min(losses.len());
        #[expect(clippy::cast_precision_loss, reason = "a number of steps")]
        let mean = losses[losses.len() - last..].iter().sum::<f64>() / last as f64;
        crate::aside!(
            "rate {}: loss {}{}",
            significant(*rate, 3),
            significant(mean, 4),
            if lost { ", lost itself" } else { "" }
        );
        if !lost && best.is_none_or(|(least, _)| mean < least) {
            best = Some((mean, *rate));
        }
    }
    let run = folder.join("rate");
    std::fs::remove_dir_all(&run).map_err(|e| Error::writing(&run, e))?;
    best.map(|(_, rate)| rate).ok_or_else(|| Error::Stopped("no rate of --rates kept the network".into()))
}

/// Up to four sheets of a camera: of every distance the zone on the axis, or of one distance zones from the axis outwards.
fn sheets(folder: &Path) -> Result<Vec<(String, ndarray::Array3<f32>)>> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .map_err(|e| Error::reading(folder, e))?
        .filter_map(|e| e.ok().map(|e| e.file_name().to_string_lossy().into_owned()))
        .filter(|n| n.ends_with(".png"))
        .collect();
    let number = |name: &str, of: &str| {
        let digits: String =
            name.split(of).nth(1).unwrap_or("").chars().take_while(|c| c.is_ascii_digit() || *c == '.').collect();
        digits.trim_end_matches('.').parse::<f64>().unwrap_or(f64::INFINITY)
    };
    names.sort_by(|a, b| {
        let key = |n: &str| [number(n, "depth-"), number(n, "field-")];
        key(a).partial_cmp(&key(b)).unwrap_or(std::cmp::Ordering::Equal)
    });
    if names.iter().any(|n| n.starts_with("depth-")) {
        names.retain(|n| n.ends_with("field-1.png"));
    }
    let step = names.len().div_ceil(4).max(1);
    let shown = names.iter().step_by(step);
    shown
        .map(|name| {
            let caption = name
                .trim_end_matches(".png")
                .replace("depth-", "from ")
                .replace("mm-field-", " mm, zone ")
                .replace("field-", "zone ");
            Ok((caption, read_linear(&folder.join(name))?))
        })
        .collect()
}
