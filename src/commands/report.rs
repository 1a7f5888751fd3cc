//! `isoplanat report`: everything about a lens, or about two side by side, on one page.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::Error;
use isoplanat::imaging::render::frame_of;
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::Lens;
use isoplanat::report::lens::{LensReport, Options, html};
use isoplanat::report::measured::{Measured, Settings, by_rays, close};
use isoplanat::report::table::numbered;
use isoplanat::terminal::in_line;
use serde::Serialize;

use crate::analyses::View;
use crate::named::Named;
use crate::output::Common;
use crate::progress::Bar;

/// Arguments of `report`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), the name of a shipped lens, or the folder of a run, or of a kit with its lens; several are
    /// shown side by side
    #[arg(required = true, num_args = 1..=4, value_name = "LENS|RUN|KIT")]
    lenses: Vec<Named>,
    /// Object distances at which point spread functions are drawn, a row each [default: the lens's own]
    #[arg(long, value_delimiter = ',', value_name = "MM,…", allow_hyphen_values = true)]
    psf_depths_mm: Vec<f64>,
    /// Also what slanted edges show in the reference renderer's captures, at four places, or so many (`--measure=6`); of a run, which is always measured,
    /// in the reconstructions too
    #[arg(long, value_name = "PLACES", num_args = 0..=1, require_equals = true, default_missing_value = "4", value_parser = clap::value_parser!(u32).range(1..=6))]
    measure: Option<u32>,
    /// Also what slanted edges show in the reconstructions of this kit, which was made for the lens
    #[arg(long, value_name = "KIT")]
    kit: Option<PathBuf>,
    /// The ONNX Runtime library to use with a kit
    #[arg(long, value_name = "FILE")]
    onnxruntime: Option<PathBuf>,
    /// Rays a pixel of those captures
    #[arg(long, value_name = "RAYS", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(2..=65536))]
    measure_rays: u32,
    /// Seed of those captures' rays and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Where to put the page
    #[arg(short, long, value_name = "OUT.html")]
    output: Option<PathBuf>,
    /// Every curve as comma-separated values; of one lens
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    view: View,
    #[command(flatten)]
    common: Common,
}

/// Several lenses, for machines.
#[derive(Serialize)]
struct Figures {
    lenses: Vec<serde_json::Value>,
}

/// Runs the command; figures go to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    if args.output.is_none() && args.csv.is_none() && !args.common.json {
        return Err(Error::bad("report", "output", "none", "-o OUT.html, --csv OUT.csv or --json").into());
    }
    if args.csv.is_some() && args.lenses.len() > 1 {
        return Err(Error::bad("--csv", "lenses", args.lenses.len().to_string(), "one lens").into());
    }
    if args.kit.is_some() && args.lenses.len() > 1 {
        return Err(Error::bad("--kit", "lenses", args.lenses.len().to_string(), "the kit's own").into());
    }
    crate::output::check_all(&[args.output.as_deref(), args.csv.as_deref()], args.common.force)?;
    if let Some(bad) = args.psf_depths_mm.iter().find(|d| d.is_nan() || **d <= 0.0) {
        return Err(Error::bad("--psf-depths-mm", "value", bad.to_string(), "positive distances, or inf").into());
    }
    let options = Options { psf_depths_mm: args.psf_depths_mm.clone(), ..args.view.options()? };
    let mut reports = Vec::new();
    for name in &args.lenses {
        let path: &Path = name.as_ref();
        let run = path.is_dir();
        let file = if run { path.join("lens.toml") } else { path.to_owned() };
        let lens = args.view.lens(&file)?;
        let colour = in_colour(&lens);
        // What cannot be measured is told before the page is made.
        let settings =
            Settings { places: args.measure.unwrap_or(4) as usize, rays: args.measure_rays as usize, seed: args.seed };
        let own = Some(path).filter(|folder| folder.join("kit.toml").is_file());
        let kit = args.kit.as_deref().or(own);
        if args.onnxruntime.is_some() && kit.is_none() {
            return Err(Error::bad("--onnxruntime", "kit", "none", "--kit KIT, or the folder of a kit").into());
        }
        let measured = match (run, args.measure) {
            _ if kit.is_some() => kit.map(|kit| of_kit(kit, args.onnxruntime.as_deref(), &file, &lens, settings)),
            (true, _) => Some(of_run(path, &lens, settings)),
            (false, Some(_)) => Some(of_lens(&lens, settings)),
            (false, None) => None,
        };
        let measured = measured.map(|m| m.map_err(|e| e.in_file(path))).transpose();
        // What was not asked for by name does not keep the rest from being shown.
        let asked = args.measure.is_some() || args.kit.is_some();
        let (measured, missing) = match measured {
            Ok(measured) => (measured, None),
            Err(e) if !asked && e.bad_input().is_some_and(|bad| bad.place.key != "run") => (None, Some(e)),
            Err(e) => return Err(e.into()),
        };
        let waiting = crate::progress::Waiting::new("report");
        let mut report = LensReport::new(lens, &Options { colour, ..options.clone() });
        drop(waiting);
        report.missing.extend(missing.map(|why| format!("measured MTF: {why}")));
        reports.push(match measured {
            Some(measured) => report.with_measured(measured),
            None => report,
        });
    }
    if let Some(path) = &args.output {
        crate::output::put(&html(&reports)?, Some(path), args.common.force, out)?;
    }
    if let (Some(path), [report]) = (&args.csv, &reports[..]) {
        crate::output::put(&report.csv(), Some(path), args.common.force, out)?;
    }
    if args.common.json {
        match &reports[..] {
            [one] => writeln!(out, "{}", one.json())?,
            several => {
                let lenses = several.iter().map(LensReport::json).collect();
                writeln!(out, "{}", numbered(&Figures { lenses }))?;
            }
        }
        return Ok(());
    }
    for report in &reports {
        for missing in &report.missing {
            crate::aside!("note: {}: {missing}", report.lens.file());
        }
        let seconds: f64 = report.seconds.iter().map(|(_, s)| s).sum();
        writeln!(out, "{}: {seconds:.2} s", in_line(&report.lens.name))?;
    }
    if let Some(path) = &args.output {
        writeln!(out, "open {}", in_line(&path.display().to_string()))?;
    }
    Ok(())
}

/// Slanted edges in front of a lens and the generic sensor.
fn of_lens(lens: &Lens, settings: Settings) -> isoplanat::Result<Measured> {
    let (sensor, frame) = (Sensor::generic(), frame_of(lens)?);
    let camera = by_rays(lens, &sensor, &frame, settings);
    let bar = Bar::new("slanted edges");
    let measured = close(lens, &sensor, &frame, settings, &camera, &mut |share| bar.set(share, String::new()))?;
    bar.done(String::new());
    Ok(measured)
}

/// Slanted edges in front of a run's lens, sensor and network.
#[cfg(feature = "train")]
fn of_run(folder: &Path, lens: &Lens, settings: Settings) -> isoplanat::Result<Measured> {
    use isoplanat::design::evaluate::measured;
    use isoplanat::design::opened::Run;

    let Run { task, network, guide, .. } = Run::open(folder)?;
    let bar = Bar::new("slanted edges");
    let told = (&network, &guide);
    let found = measured(lens, told, &task.sensor()?, settings, &mut |share| bar.set(share, String::new()))
        .map_err(|e| e.in_file(folder))?;
    bar.done(String::new());
    Ok(found)
}

/// Slanted edges in front of a lens and the kit that was made for it; the lens in `file` may be looked at from another distance.
#[cfg(feature = "deploy")]
fn of_kit(
    folder: &Path,
    onnxruntime: Option<&Path>,
    file: &Path,
    lens: &Lens,
    settings: Settings,
) -> isoplanat::Result<Measured> {
    use isoplanat::deploy::child::Helper;
    use isoplanat::deploy::kit::Kit;
    use isoplanat::deploy::network_process::Apart;
    use isoplanat::deploy::session::Options;
    use isoplanat::report::measured::kit::measured;

    let kit = Kit::load(folder)?;
    if let Some(doubt) = kit.doubt() {
        crate::tell!("warning: {}: {doubt}", folder.display());
    }
    kit.require(&crate::input::lens(file)?, file)?;
    let options = Options { onnxruntime: onnxruntime.map(Path::to_owned), ..Options::default() };
    // A kit may be anybody's.
    let apart = Apart {
        memory_bytes: Some(crate::memory::limit().bytes),
        hint: "; --memory-gib sets that of memory",
        ..Apart::new(Helper::current()?)
    };
    let bar = Bar::new("slanted edges");
    let found = measured(lens, &kit, (&options, Some(&apart)), settings, &mut |share| bar.set(share, String::new()))?;
    bar.done(String::new());
    Ok(found)
}

/// A kit needs a runtime.
#[cfg(not(feature = "deploy"))]
fn of_kit(folder: &Path, _: Option<&Path>, _: &Path, _: &Lens, _: Settings) -> isoplanat::Result<Measured> {
    let kit = folder.display().to_string();
    let found = "this build lacks the feature `deploy`, which a kit's network needs";
    Err(Error::bad(kit, "kit", found, "a lens alone, or a build with --features deploy"))
}

/// A run's network needs the code that trained it.
#[cfg(not(feature = "train"))]
fn of_run(folder: &Path, _: &Lens, _: Settings) -> isoplanat::Result<Measured> {
    Err(Error::bad(
        folder.display().to_string(),
        "run",
        "this build lacks the feature `train`, which a run's network needs",
        "a lens, or a build with --features train",
    ))
}

/// Whether the generic sensor sees the lens's light, so that kernels can be drawn in its colours.
pub(crate) fn in_colour(lens: &Lens) -> bool {
    SpectralDensity::new(&Sensor::generic()).require(lens).is_ok()
}
