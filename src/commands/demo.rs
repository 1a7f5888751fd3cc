//! `isoplanat demo`: the whole chain on built-in scenes, from a coarse lens to pictures from RAW captures.

mod capture;
mod settings;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use isoplanat::deploy::kit::LensEntry;
use isoplanat::deploy::session::Options;
use isoplanat::design::data::Textures;
use isoplanat::design::joint::Joint;
use isoplanat::design::joint::designing::prepare;
use isoplanat::design::joint::run::{JointSettings, joint_stage, network};
use isoplanat::design::joint::scenery::Scenery;
use isoplanat::design::memory;
use isoplanat::design::subject::{Calibration, Subject};
use isoplanat::design::task::Task;
use isoplanat::design::training::Training;
use isoplanat::imaging::files::write_png8;
use isoplanat::imaging::guide::Inputs;
use isoplanat::imaging::render::gradient_error::Chosen;
use isoplanat::imaging::render::{Renderer, frame_of};
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::{Lens, prescription};
use isoplanat::math::memory::{product, threads};
use isoplanat::network::{Compute, Reconstructor};
use isoplanat::report::demo::{DemoReport, LossCurve};
use isoplanat::report::lens_view::LensView;
use isoplanat::terminal::path_in_line;
use isoplanat::{Result, atomic};

use crate::kit;
use crate::output::Common;
use crate::progress::Bar;
use settings::Settings;

/// The file that makes a folder a demo's.
const MARKER: &str = "report.html";

/// Bytes a pixel of the frame once lens and network are finished: captures, what is made of them, and the report's pictures.
const PIXEL: usize = 1000;

/// The whole chain on built-in scenes, with a report.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The same path in a minute, on a smaller frame.
    #[arg(long)]
    quick: bool,
    /// Folder for run, kit, captures, pictures and report.
    #[arg(short, long, default_value = "isoplanat-demo", value_name = "OUT_DIR")]
    output: PathBuf,
    /// Train on the photographs of this folder instead of built-in scenes.
    #[arg(long)]
    photos: Option<PathBuf>,
    /// Seed of every draw.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The ONNX Runtime library to use.
    #[arg(long)]
    onnxruntime: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let report = atomic::write_folder(&args.output, MARKER, args.common.force, |folder| chain(args, folder))?;
    if args.common.json {
        return Ok(writeln!(out, "{}", report.summary_json())?);
    }
    for s in &report.scenes {
        writeln!(
            out,
            "{:12} capture {:.2} dB, Wiener {:.2} dB, network of the capture alone {:.2} dB, guided {:.2} dB; SSIM {:.3}, \
             {:.3}, {:.3}, {:.3}; colour shift {:.2}, {:.2}, {:.2}, {:.2}",
            s.name,
            s.capture_quality.psnr_db,
            s.wiener_quality.psnr_db,
            s.bare_quality.psnr_db,
            s.reconstruction_quality.psnr_db,
            s.capture_quality.ssim,
            s.wiener_quality.ssim,
            s.bare_quality.ssim,
            s.reconstruction_quality.ssim,
            s.capture_quality.colour_shift,
            s.wiener_quality.colour_shift,
            s.bare_quality.colour_shift,
            s.reconstruction_quality.colour_shift
        )?;
    }
    if let Some(verdict) = report.verdict() {
        writeln!(out, "{verdict}")?;
    }
    writeln!(
        out,
        "fast renderer against the reference: {:.2} dB in {:.2} s against {:.1} s",
        report.psnr_fast_vs_reference_db, report.seconds_fast, report.seconds_reference
    )?;
    writeln!(out, "{} in {:.0} s", path_in_line(&args.output.join("report.html")), report.seconds_total)?;
    Ok(())
}

fn chain(args: &Args, folder: &Path) -> Result<DemoReport> {
    let started = Instant::now();
    let settings = Settings::new(args.quick, args.seed, args.photos.clone());
    let task = &settings.task;
    crate::aside!("about {} on two cores", if args.quick { "40 seconds" } else { "5 minutes" });
    let start = task.lens(crate::glasses::all())?;
    crate::glasses::all_taken()?;
    let (sensor, frame) = (task.sensor()?, frame_of(&start)?);
    let stages = memory::of_design(task)?.max(memory::of_training(task)?);
    let tiles = task.train.config()?.forward_bytes(settings.tile).saturating_mul(threads() as u64);
    let bytes = stages.saturating_add(tiles).saturating_add(product(&[frame.rows, frame.columns, PIXEL]));
    crate::memory::limit().allow("the demo", bytes, "--quick, or a smaller folder")?;
    crate::memory::tell(bytes);
    let density = SpectralDensity::new(&sensor);
    let mut report = DemoReport { title: "Isoplanat: a lens and its network".into(), ..DemoReport::default() };

    let textures = timed(&mut report, "Training scenes", |_| {
        let bar = Bar::new("training scenes");
        let textures = task.textures()?;
        bar.done(format!("{} scenes", textures.len()));
        Ok(textures)
    })?;
    let scenery = Scenery { textures: &textures, sensor: &sensor, frame: frame.clone(), seed: task.seed };
    let designed =
        timed(&mut report, "Joint design of lens and network", |report| designed(task, &start, &scenery, report))?;
    let lens = designed.joint.lens.changed(|l| l.name = format!("{}, designed", start.name))?;
    let networks = finished(task, [&start, &lens], designed.joint.network, &textures, folder, &mut report)?;
    let (renderer, kit) = timed(&mut report, "Kit: ONNX model and calibration", |_| {
        let renderer = Renderer::planned(&lens, &frame, &density, &[lens.object_vergence], settings.fine)?;
        let kit = kit::build(
            "isoplanat demo",
            &LensEntry { name: lens.name.clone(), sha256: lens.sha256() },
            &networks.guided.network(),
            &sensor,
            &frame,
            &Calibration::of_optics(&renderer.optics, &frame)?,
            networks.guided.guide(),
            textures.sha256(),
            settings.tile,
        )?;
        kit.save(&folder.join("kit"), false)?;
        Ok((renderer, kit))
    })?;
    // Captures of unseen scenes by the reference renderer, and what the camera makes of them.
    timed(&mut report, "Captures, Wiener filter, camera", |report| {
        let options = Options { onnxruntime: args.onnxruntime.clone(), ..Options::default() };
        for unseen in settings.unseen() {
            let runtime = &mut report.runtime;
            let bare = networks.bare.network();
            let result =
                capture::photograph(folder, &settings, &lens, &kit, &bare, &renderer, &options, unseen, runtime)?;
            write_png8(&folder.join(format!("{}-reconstruction.png", result.name)), &result.reconstruction)?;
            report.scenes.push(result);
        }
        Ok(())
    })?;
    timed(&mut report, "Fast renderer against the reference", |report| {
        capture::compare(&settings, &lens, &renderer, &density, report)
    })?;

    let depth = 1.0 / lens.object_vergence;
    report.before = Some(LensView::new(&start, depth, settings.atlas, true)?);
    report.after = Some(LensView::new(&lens, depth, settings.atlas, true)?);
    report.settings = settings.describe(&sensor, &renderer.plan);
    let finer = designed.fineness.iter().map(|(step, c)| (format!("Design from step {step} on"), c.describe()));
    report.settings.extend(finer);
    report.left_out.extend(left_out(&lens, &renderer));
    report.summary = SUMMARY.into();
    report.seconds_total = started.elapsed().as_secs_f64();
    atomic::write_bytes(&folder.join(MARKER), report.to_html()?.as_bytes())?;
    let summary = format!("{:#}\n", report.summary_json());
    atomic::write_bytes(&folder.join("summary.json"), summary.as_bytes())?;
    Ok(report)
}

const SUMMARY: &str = "A coarse two-element lens and a small network are designed together; the network, and a guided one, which sees the capture through its lens's own filters, too, are then \
                      trained for the finished lens; the second is exported to ONNX and used on RAW captures of scenes that neither has seen, \
                      rendered by an independent ray tracer from the sensor.";

/// Does a part of the run, and notes in the report how long it took.
fn timed<T>(report: &mut DemoReport, what: &str, work: impl FnOnce(&mut DemoReport) -> Result<T>) -> Result<T> {
    let clock = Instant::now();
    let done = work(report)?;
    report.stages.push((what.to_owned(), clock.elapsed().as_secs_f64()));
    Ok(done)
}

/// Lens and network together, and the settings that the design chose, from which step on.
struct Designed {
    joint: Joint,
    fineness: Vec<(usize, Chosen)>,
}

fn designed(task: &Task, start: &Lens, scenery: &Scenery<'_>, report: &mut DemoReport) -> Result<Designed> {
    let bar = Bar::new("lens and network");
    let fresh = network(task.network.base_width, task.network.inputs, task.seed, Compute::Cpu)?;
    let prepared = prepare(task, start, "demo", &mut |_, _| {})?;
    let (stage, history) =
        joint_stage(scenery, &prepared.problem, fresh, JointSettings::from_task(task)?, &mut |share, e| {
            bar.set(share, format!("L1 {:.4}  {:.2} → {:.2} dB", e.loss, e.input_psnr_db, e.output_psnr_db));
        })?;
    bar.done(format!("{} steps taken back", stage.joint.rejected));
    #[expect(clippy::cast_precision_loss, reason = "step counts")]
    let points = history.iter().enumerate().map(|(i, e)| ((i + 1) as f64 * 10.0, e.loss)).collect();
    report.loss.push(LossCurve { name: "lens and network".into(), points });
    Ok(Designed { fineness: stage.fineness.clone(), joint: stage.joint })
}

/// The final networks of the finished lens, of equal steps from the same start.
struct Networks {
    bare: Training,
    guided: Training,
}

fn finished(
    task: &Task,
    [start, lens]: [&Lens; 2],
    network: Reconstructor,
    textures: &Textures,
    folder: &Path,
    report: &mut DemoReport,
) -> Result<Networks> {
    let seen = network.config().clone().seeing(task.train.network.inputs);
    let guided = network.deepened(&seen, task.seed, Compute::Cpu)?;
    let mut train = |name: &str, inputs: Inputs, network: Reconstructor| {
        timed(report, &format!("Final training: {name}"), |report| {
            let mut task = task.clone();
            task.train.network.inputs = inputs;
            let run = folder.join(if inputs.is_bare() { "run-bare" } else { "run" });
            let subject = Subject::from(lens.clone());
            let mut training = Training::begin(task, &subject, network, textures.clone(), &run, false)?;
            prescription::save(start, &run.join(isoplanat::design::folder::START))?;
            report.loss.push(followed(&mut training, name)?);
            Ok(training)
        })
    };
    let bare = train("network of the capture alone", Inputs::BARE, network)?;
    let guided = train("guided network", task.train.network.inputs, guided)?;
    Ok(Networks { bare, guided })
}

/// Runs a training under a bar of its own; its losses.
fn followed(training: &mut Training, name: &str) -> Result<LossCurve> {
    let bar = Bar::new(name);
    let (mut points, mut last) = (Vec::new(), String::new());
    training.run(&mut |status| {
        let e = &status.entry;
        if status.step.is_multiple_of(10) {
            #[expect(clippy::cast_precision_loss, reason = "step counts")]
            points.push((e.step as f64, e.content));
        }
        last = format!("step {}  L1 {:.4}  {:.2} dB", status.step, e.l1, e.psnr_db);
        bar.set(status.share, last.clone());
        true
    })?;
    bar.done(last);
    Ok(LossCurve { name: name.to_owned(), points })
}

/// What this lens and scene did not need.
fn left_out(lens: &isoplanat::lens::Lens, renderer: &Renderer) -> Vec<String> {
    let (plan, table) = (&renderer.plan, renderer.optics.table());
    let depth = &plan.depths[0];
    let apertures: Vec<String> = (0..lens.surfaces.len())
        .filter(|i| *i != lens.stop && !table.clips.contains(i))
        .map(|i| i.to_string())
        .collect();
    let (radii, nodes, size) = (table.spec.radii_mm.len(), depth.grid.len(), depth.size());
    let traced = table.rays / (radii * table.spec.wavelength_nm.len()).max(1);
    vec![
        format!(
            "Other depths: the scenes are flat, at {:.0} mm; one depth of the PSF grid serves. Exact.",
            1.0 / lens.object_vergence
        ),
        format!(
            "Half of every pupil: the lens is symmetric about its axis, so {traced} of {} node rays are traced. Exact.",
            2 * traced
        ),
        format!(
            "Fields off the meridian: {radii} sensor radii serve {nodes} PSF nodes and every pixel's illumination; rays \
             between them are within {:.1e} pixel.",
            plan.table_error.landing_mm / plan.frame.pitch_mm
        ),
        if apertures.is_empty() {
            "No clear aperture could be left out.".into()
        } else {
            format!("Clear apertures of surfaces {}: no ray of any field comes near them. Exact.", apertures.join(", "))
        },
        format!(
            "Kernels beyond {size} × {size} cells of {0} × {0} pixels: at most {1:.1e} of a PSF's energy falls outside.",
            depth.bin, plan.settings.outside
        ),
        format!(
            "Dense ray tracing: each PSF continues {} traced rays to {} by a polynomial; its residual is at most {:.1e} of the \
             beam.",
            2 * traced,
            plan.settings.dense,
            table.residual
        ),
    ]
}
