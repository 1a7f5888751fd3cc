//! `isoplanat export RUN/ -o KIT/`: ONNX model and calibration of a run.

use std::io::Write;
use std::path::PathBuf;

use isoplanat::atomic;
use isoplanat::deploy::kit::FILE;
use isoplanat::design::task::Task;
use isoplanat::imaging::plan::{Quality, frame_of, plan};
use isoplanat::imaging::spectrum::SpectralDensity;
use isoplanat::lens::prescription;
use isoplanat::network::Reconstructor;

use crate::kit;

/// ONNX model and calibration of a run, for the camera.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Run folder that `design` wrote.
    run: PathBuf,
    /// Kit folder to write.
    #[arg(short, long)]
    output: PathBuf,
    /// Overwrite the kit.
    #[arg(long)]
    force: bool,
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    atomic::check_folder(&args.output, FILE, args.force)?;
    let task = Task::load(&args.run.join("task.toml"))?;
    let lens = prescription::load(&args.run.join("lens.toml"))?;
    let network = Reconstructor::load(&args.run.join("network.safetensors"))?;
    let (sensor, frame) = (task.sensor()?, frame_of(&lens)?);
    let density = SpectralDensity::new(&sensor);
    let render = plan(&lens, lens.object_vergence, &frame, &density, Quality::TRAINING, None)?;
    let optics = kit::whole_frame(&lens, &render, 64)?;
    let name = format!("kit for {}", lens.name);
    let kit = kit::build(&name, &lens, &network, &sensor, &frame, &optics, task.textures()?.sha256(), 320)?;
    kit.save(&args.output, args.force)?;
    writeln!(out, "{}: model for lens {}", args.output.display(), &lens.sha256()[..12])?;
    Ok(())
}
