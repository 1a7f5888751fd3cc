//! `isoplanat design TASK.toml -o RUN/`: lens and network together.

use std::io::Write;
use std::path::PathBuf;

use isoplanat::design::data::Textures;
use isoplanat::design::memory;
use isoplanat::design::run::{JointSettings, Scenery, joint_stage, network, validate};
use isoplanat::design::task::Task;
use isoplanat::imaging::guide;
use isoplanat::imaging::render::{Settings, frame_of};
use isoplanat::lens::prescription;
use isoplanat::{Result, atomic};

use crate::progress::Bar;

/// The file that makes a folder a run.
const MARKER: &str = "task.toml";

/// Joint design of lens and network.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Task file (form in models/README.md).
    task: PathBuf,
    /// Folder of the run: lens, network, log.
    #[arg(short, long)]
    output: PathBuf,
    /// Judge the result on patches of these photographs too.
    #[arg(long)]
    validate: Option<PathBuf>,
    /// Results as JSON.
    #[arg(long)]
    json: bool,
    /// Overwrite the run folder.
    #[arg(long)]
    force: bool,
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    atomic::check_folder(&args.output, MARKER, args.force)?;
    let task = Task::load(&args.task)?;
    crate::input::of_task(&task)?;
    let settings = JointSettings::of(&task).map_err(|e| e.in_file(&args.task))?;
    let bytes = memory::of_design(&task)?;
    let instead = "a smaller patch_px, batch, base_width or folder";
    crate::memory::limit().allow("the design", bytes, instead)?;
    let (lens, sensor) = (task.lens(crate::glasses::all())?, task.sensor()?);
    let held_out = args.validate.as_deref().map(Textures::photos).transpose()?;
    let frame = frame_of(&lens)?;
    let textures = task.textures()?;
    let scenery = Scenery { textures: &textures, sensor: &sensor, frame: frame.clone(), seed: task.seed };
    crate::memory::tell(bytes);
    let bar = Bar::new(if task.freeze_lens { "network alone" } else { "lens and network" });
    let start = network(task.base_width, task.inputs, task.seed)?;
    let (joint, history) = joint_stage(&scenery, &lens, start, settings, &mut |share, e| {
        bar.set(share, format!("L1 {:.4}  {:.2} → {:.2} dB", e.loss, e.input_psnr_db, e.output_psnr_db));
    })?;
    bar.done(String::new());
    save(args, &task, &lens, &joint, &history)?;
    let judged = match &held_out {
        Some(textures) => {
            let scenery = Scenery { textures, sensor: &sensor, frame, seed: 77 };
            Some(validate(
                &scenery,
                &joint.lens,
                (&joint.network, &joint.guide),
                task.patch_px,
                48,
                Settings::TRAINING,
            )?)
        }
        None => None,
    };
    let last = history.last().copied();
    if args.json {
        let value = serde_json::json!({ "schema": 1, "last": last, "validation": judged, "rejected": joint.rejected,
            "fineness": joint.fineness, "filters_made": joint.refreshed.0, "filters_seconds": joint.refreshed.1 });
        writeln!(out, "{value}")?;
    } else {
        if let Some(e) = last {
            writeln!(out, "training    L1 {:.5}  {:.2} → {:.2} dB", e.loss, e.input_psnr_db, e.output_psnr_db)?;
        }
        if let Some(e) = judged {
            writeln!(out, "validation  L1 {:.5}  {:.2} → {:.2} dB", e.loss, e.input_psnr_db, e.output_psnr_db)?;
        }
        writeln!(out, "steps taken back: {}", joint.rejected)?;
        if let (count @ 1.., seconds) = joint.refreshed {
            writeln!(out, "Wiener filters made anew {count} times as the lens moved, in {seconds:.1} s in all")?;
        }
        for (step, chosen) in &joint.fineness {
            writeln!(out, "rendered from step {step} on: {}", chosen.describe())?;
        }
    }
    Ok(())
}

/// Writes the run folder.
fn save(
    args: &Args,
    task: &Task,
    start: &isoplanat::lens::Lens,
    joint: &isoplanat::design::joint::Joint,
    history: &[isoplanat::design::run::Entry],
) -> Result<()> {
    atomic::write_folder(&args.output, MARKER, args.force, |folder| {
        atomic::write_bytes(&folder.join(MARKER), task.to_toml()?.as_bytes())?;
        prescription::save(start, &folder.join("lens-start.toml"))?;
        prescription::save(&joint.lens, &folder.join("lens.toml"))?;
        joint.network.save(&folder.join("network.safetensors"))?;
        if let Some(filters) = joint.guide.filters() {
            atomic::write_bytes(&folder.join(guide::FILE), &filters.to_npz()?)?;
        }
        let mut log = String::from("seconds,loss,input_psnr_db,output_psnr_db\n");
        for e in history {
            log += &format!("{:.3},{:.6},{:.3},{:.3}\n", e.seconds, e.loss, e.input_psnr_db, e.output_psnr_db);
        }
        atomic::write_bytes(&folder.join("log.csv"), log.as_bytes())
    })
}
