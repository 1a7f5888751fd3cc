//! `isoplanat train TASK.toml -o RUN/`: the final network for a finished lens.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::design::evaluate::verdict::verdicts;
use isoplanat::design::log::Entry;
use isoplanat::design::memory;
use isoplanat::design::subject::Subject;
use isoplanat::design::task::Task;
use isoplanat::design::training::{Status, Training};
use isoplanat::network::Compute;
use isoplanat::report::table::numbered;
use isoplanat::report::verdict::Verdict;
use isoplanat::terminal::path_in_line;
use isoplanat::{Error, Result};

use crate::output::Common;
use crate::progress::Bar;

/// The final network for a finished lens.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Task file (form in models/README.md), or the folder of a design: its task, for its lens; with --resume the run's own.
    #[arg(required_unless_present = "resume", conflicts_with = "resume")]
    task: Option<PathBuf>,
    /// Folder of the run: network, log, sample pictures.
    #[arg(short, long, value_name = "OUT_DIR")]
    output: PathBuf,
    /// Go on with the run in that folder.
    #[arg(long, conflicts_with_all = ["force", "minutes", "steps", "photos", "start", "vgg", "adversarial", "depths_mm"])]
    resume: bool,
    /// Length in minutes, in place of the task's.
    #[arg(long, conflicts_with = "steps")]
    minutes: Option<f64>,
    /// Length in steps, in place of the task's.
    #[arg(long)]
    steps: Option<u64>,
    /// Folder of photographs to train on, in place of the task's.
    #[arg(long)]
    photos: Option<PathBuf>,
    /// Network to start from: a run's folder or a checkpoint; fewer scales are fine.
    #[arg(long)]
    start: Option<PathBuf>,
    /// VGG-19 weights (safetensors) for the content loss.
    #[arg(long)]
    vgg: Option<PathBuf>,
    /// Distances to train for, comma-separated (`inf` allowed), in place of the task's.
    #[arg(long, value_delimiter = ',', value_name = "MM,…")]
    depths_mm: Vec<f64>,
    /// Train against discriminators.
    #[arg(long)]
    adversarial: bool,
    /// Where to compute: cpu, cuda or wgpu.
    #[arg(long, default_value = "cpu")]
    device: Compute,
    #[command(flatten)]
    common: Common,
}

/// How it went, for machines.
#[derive(serde::Serialize)]
struct Figures<'a> {
    steps: u64,
    skipped: u64,
    damaged_pairs: u64,
    returned: u32,
    last: Option<Entry>,
    verdicts: Option<&'a [Verdict]>,
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let mut training = match &args.task {
        Some(path) => {
            let task = task(args, path)?;
            crate::input::of_task(&task)?;
            let instead = "a smaller patch_px, batch, base_width, region_px or folder";
            crate::memory::limit().allow("the training", memory::of_training(&task)?, instead)?;
            if crate::glasses::are_replaced() {
                task.lens(crate::glasses::all())?;
                crate::glasses::all_taken()?;
            }
            Training::create(task, &args.output, args.common.force, args.device, crate::glasses::all())?
        }
        None => {
            let training = Training::resume(&args.output, args.device)?;
            let bytes = memory::of_training(training.task())?;
            crate::memory::limit().allow("the training", bytes, "a task of its own")?;
            training
        }
    };
    crate::memory::tell(memory::of_training(training.task())?);
    training.describe().iter().for_each(|line| crate::aside!("{line}"));
    if args.resume {
        crate::aside!("resumed at step {}", training.step());
    }
    // Ctrl-C asks for an end; the step at hand is finished and kept.
    let asked = isoplanat_program::signals::asked();
    let mut last = None;
    let trained = to_the_end(&mut training, "training", &asked, &mut |status| last = Some(*status));
    if matches!(trained, Err(Error::Interrupted)) {
        let run = args.output.display();
        crate::tell!("stopped at step {}; go on with: isoplanat train --resume -o {run}", training.step());
    }
    trained?;
    let judged = judged(&training, &args.output);
    let (steps, skipped, returned) = (training.step(), training.skipped(), training.returned());
    if training.damaged() > 0 {
        crate::tell!("{} kept pairs were damaged and were rendered again", training.damaged());
    }
    if returned > 0 {
        crate::tell!(
            "the loss jumped away {returned} times; each time the training went back to its last checkpoint, with half the rate from then on: a lower train.budget.rate would have cost less"
        );
    }
    if args.common.json {
        let (damaged_pairs, last) = (training.damaged(), last.map(|s| s.entry));
        let verdicts = judged.as_deref().ok();
        writeln!(out, "{}", numbered(&Figures { steps, skipped, damaged_pairs, returned, last, verdicts }))?;
    } else {
        if let Some(s) = last {
            writeln!(out, "loss {:.5}  PSNR of training patches {:.2} dB", s.entry.content, s.entry.psnr_db)?;
        }
        for line in Verdict::told(&judged) {
            writeln!(out, "{line}")?;
        }
        let without =
            if skipped > 0 { format!(", {skipped} of them without a finite gradient") } else { String::new() };
        writeln!(out, "{}: network of {steps} steps{without}", path_in_line(&args.output))?;
    }
    Ok(())
}

/// What the trained network is worth on pictures that it was not trained on.
fn judged(training: &Training, folder: &Path) -> Result<Vec<Verdict>> {
    let bar = Bar::new("held-out pictures");
    let (subject, network) = (Subject::of_run(folder)?, training.network());
    let judged =
        verdicts(training.task(), &subject, (&network, training.guide()), &mut |share| bar.set(share, String::new()));
    bar.done(String::new());
    judged
}

/// Trains to the end with a bar called `label`, or until somebody `asked` for one; `see` sees every step.
pub(crate) fn to_the_end(
    training: &mut Training,
    label: &'static str,
    asked: &dyn Fn() -> bool,
    see: &mut dyn FnMut(&Status),
) -> Result<()> {
    let bar = Bar::new(label);
    let trained = training.run(&mut |status| {
        let e = &status.entry;
        let of = status.total.map_or(String::new(), |n| format!(" of {n}"));
        bar.set(status.share, format!("step {}{of}  loss {:.4}  {:.2} dB", status.step, e.content, e.psnr_db));
        see(status);
        !asked()
    });
    bar.done(format!("{} steps", training.step()));
    trained
}

/// The task with the command line's changes.
fn task(args: &Args, path: &Path) -> Result<Task> {
    let mut task = if path.is_dir() { Task::of_run(path) } else { Task::load(path) }?;
    if args.minutes.is_some() || args.steps.is_some() {
        (task.train.budget.minutes, task.train.budget.steps) = (args.minutes, args.steps);
    }
    if let Some(photos) = &args.photos {
        task.pictures.photos = Some(photos.clone());
    }
    if let Some(start) = &args.start {
        task.train.start = Some(start.clone());
    }
    if let Some(vgg) = &args.vgg {
        task.train.loss.vgg = Some(vgg.clone());
    }
    if !args.depths_mm.is_empty() {
        task.train.pairs.depths_mm.clone_from(&args.depths_mm);
    }
    task.train.loss.adversarial |= args.adversarial;
    task.check(&path.display().to_string())?;
    Ok(task)
}
