//! `isoplanat sweep TASK --index I --of N -o RUNS/`: one of many designs by its number; `isoplanat sweep report RUNS/`: the best of them.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::atomic::Target;
use isoplanat::design::joint::sweep::{Ranked, ranked, varied};
use isoplanat::design::task::Task;
use isoplanat::report::drawing::lens_svg;
use isoplanat::report::html::Page;
use isoplanat::report::table::{Table, numbered};
use isoplanat::{Error, Result, atomic};
use serde::Serialize;

use crate::design;

/// Many designs of one task, by number: for a job array, or `xargs -P`; nothing is shared but the folder.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Task file, or a shipped task; `report` for the table of a folder of runs
    task: PathBuf,
    /// With `report`: the folder of runs
    runs: Option<PathBuf>,
    /// Number of this design, from 0; 0 is the task as it stands
    #[arg(long, required_unless_present = "runs")]
    index: Option<u64>,
    /// How many there are
    #[arg(long, required_unless_present = "runs")]
    of: Option<u64>,
    /// Folder of all runs; with `report`: the page
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
    /// Go on where this number's run was left; a finished one is left alone
    #[arg(long)]
    resume: bool,
    /// Results as JSON
    #[arg(long)]
    json: bool,
    /// Overwrite this number's run
    #[arg(long, conflicts_with = "resume")]
    force: bool,
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    if args.task.as_os_str() == "report" && args.index.is_none() {
        return report(args, out);
    }
    let (Some(index), Some(of)) = (args.index, args.of) else {
        return Err(Error::bad("--index, --of", "value", "missing", "a number and how many there are").into());
    };
    if of == 0 {
        return Err(Error::bad("--of", "value", "0", "1 or more: how many designs there are").into());
    }
    if index >= of {
        return Err(Error::bad("--index", "value", index.to_string(), format!("0 to {}", of.saturating_sub(1))).into());
    }
    let Some(folder) = &args.output else { return Err(Error::bad("--output", "value", "missing", "a folder").into()) };
    let run = folder.join(format!("{index:05}"));
    if args.resume && run.join("task.toml").is_file() {
        return design::resumed(design::RunOptions::of_folder(&run, args.json), out);
    }
    let task = Task::load(&args.task)?;
    let file = args.task.display().to_string();
    let (task, lens) = varied(&task, index, crate::glasses::all(), &file)?;
    crate::glasses::all_taken()?;
    std::fs::create_dir_all(folder).map_err(|e| Error::writing(folder, e))?;
    let options = design::RunOptions { force: args.force, ..design::RunOptions::of_folder(&run, args.json) };
    design::designed(task, &lens, &file, options, out)
}

/// Ranks the runs of a folder: on the screen, and on a page.
fn report(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let Some(folder) = &args.runs else {
        return Err(Error::bad("sweep report", "folder", "missing", "the folder of the runs").into());
    };
    if let Some(path) = &args.output {
        crate::output::check_writable(path, args.force)?;
    }
    let found = ranked(folder)?;
    let table = ranking(&found);
    if let Some(path) = &args.output {
        let html = page(folder, &found, &table)?;
        atomic::write_bytes(Target::new(path, args.force), html.as_bytes())?;
    }
    if args.json {
        let runs = found.iter().map(RunFigures::from).collect();
        writeln!(out, "{}", numbered(&Figures { runs }))?;
        return Ok(());
    }
    writeln!(out, "{table}")?;
    Ok(())
}

/// Everything, for machines.
#[derive(Serialize)]
struct Figures<'a> {
    runs: Vec<RunFigures<'a>>,
}

#[derive(Serialize)]
struct RunFigures<'a> {
    run: &'a str,
    score_db: f64,
    held_out_psnr_db: f64,
    step: usize,
    seconds: f64,
    steps: usize,
}

impl<'a> From<&'a Ranked> for RunFigures<'a> {
    fn from(r: &'a Ranked) -> Self {
        let (best, last) = (&r.best, &r.last);
        let [_, held_out_psnr_db] = best.held_out_db;
        Self {
            run: &r.name,
            score_db: best.score(),
            held_out_psnr_db,
            step: best.step,
            seconds: last.seconds,
            steps: last.step,
        }
    }
}

/// The best designs first.
fn ranking(found: &[Ranked]) -> Table {
    let mut table =
        Table::new(["rank", "run", "ranked by, dB", "held out dB", "capture dB", "at step", "of", "minutes"]);
    for (k, r) in found.iter().enumerate() {
        table.row([
            (k + 1).to_string(),
            r.name.clone(),
            format!("{:.2}", r.best.score()),
            format!("{:.2}", r.best.held_out_db[1]),
            format!("{:.2}", r.best.held_out_db[0]),
            r.best.step.to_string(),
            r.last.step.to_string(),
            format!("{:.1}", r.last.seconds / 60.0),
        ]);
    }
    table
}

fn page(folder: &Path, found: &[isoplanat::design::joint::sweep::Ranked], table: &Table) -> Result<String> {
    let mut page = Page::new("Designs of a sweep", &format!("{} runs, the best first", found.len()));
    page.section("Table").table(table);
    page.section("The best twelve");
    let mut drawings = Vec::new();
    for (k, r) in found.iter().take(12).enumerate() {
        let notes = vec![format!("{:.2} dB at step {}", r.best.score(), r.best.step)];
        let lens = r.best.lens(&folder.join(&r.name))?;
        drawings.push((lens_svg(&lens), format!("{}. run {}", k + 1, r.name), notes));
    }
    page.noted_drawings(&drawings, 420);
    Ok(page.finish())
}
