//! The command line, and the loop over captures.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use isoplanat::calibrate::file::MeasuredDistortion;
use isoplanat::deploy::kit::Kit;
use isoplanat::deploy::raw_process::{self, Limits};
use isoplanat::deploy::reconstruct::{Camera, Steps, Veil};
use isoplanat::deploy::session::{Options, Runtime};
use isoplanat::imaging::develop::glare::{LARGEST, check};
use isoplanat::report::table::significant;
use isoplanat::{Error, Result};
use serde_json::json;

use crate::bench::Figures;
use crate::output;

/// Develop RAW captures, through the reconstruction network of a kit where one is given.
///
/// Exit codes: 0 done, 1 internal error, 2 bad input.
#[derive(Debug, Parser)]
#[command(version, name = "isoplanat-camera")]
pub(crate) struct Arguments {
    /// RAW files (DNG or a camera's own).
    #[arg(value_name = "CAPTURE", required_unless_present = "show_kit")]
    captures: Vec<PathBuf>,
    /// Kit folder, as `isoplanat export` writes it; without it no network is applied.
    #[arg(long, value_name = "KIT")]
    kit: Option<PathBuf>,
    /// Picture to write: .png (8 bits), .tif (16 bits) or .jpg; a folder for several captures [default: CAPTURE.png here].
    #[arg(short, long, value_name = "OUT")]
    out: Option<PathBuf>,
    /// Write linear light instead of sRGB (16 bits; .png or .tif).
    #[arg(long)]
    linear: bool,
    /// Leave the kit's network out.
    #[arg(long, requires = "kit")]
    no_network: bool,
    /// Leave the lens's distortion in.
    #[arg(long, requires = "kit")]
    no_undistort: bool,
    /// Distortion to take out, as `isoplanat calibrate` measured it; a kit has its own.
    #[arg(long, value_name = "DISTORTION.toml", conflicts_with = "kit")]
    distortion: Option<PathBuf>,
    /// Veiling glare to take off: a share of the light, `guess` from the picture's darkest parts, or `none` [default: the kit's]
    #[arg(long, value_name = "SHARE", value_parser = veil)]
    glare: Option<Veil>,
    /// ONNX Runtime's shared library [default: found by itself, else a slower runtime inside this program].
    #[arg(long, value_name = "PATH")]
    onnxruntime: Option<PathBuf>,
    /// Threads [default: one for each core].
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    threads: usize,
    /// Print where the time goes.
    #[arg(long)]
    bench: bool,
    /// Print what the kit holds and leave.
    #[arg(long, requires = "kit")]
    show_kit: bool,
    /// Print results as JSON.
    #[arg(long)]
    json: bool,
    /// Overwrite existing pictures.
    #[arg(long)]
    force: bool,
}

fn veil(text: &str) -> std::result::Result<Veil, String> {
    let allowed = format!("a share of the light from 0 to {LARGEST}, guess or none");
    match text {
        "guess" => Ok(Veil::Guess),
        "none" => Ok(Veil::Keep),
        _ => text.parse().ok().filter(|v| check(*v).is_ok()).map(Veil::Share).ok_or(allowed),
    }
}

/// Runs the program; the result is its exit code.
pub(crate) fn run(arguments: &Arguments) -> u8 {
    match work(arguments) {
        Ok(code) => code,
        Err(error) => complain(&error),
    }
}

/// Says an error and returns its exit code.
fn complain(error: &Error) -> u8 {
    eprintln!("isoplanat-camera: {error}");
    error.exit_code()
}

/// Prints to standard output; a reader that has gone away is no error.
fn say(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

fn work(arguments: &Arguments) -> Result<u8> {
    isoplanat::math::simd::check_environment()?;
    let kit = arguments.kit.as_deref().map(Kit::load).transpose()?;
    if let (true, Some(kit)) = (arguments.show_kit, &kit) {
        show_kit(kit, arguments.json)?;
        return Ok(0);
    }
    if arguments.threads > 0 {
        // Fails only if the pool is in use already.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(arguments.threads).build_global();
    }
    let outputs = output::plan(&arguments.captures, arguments.out.as_deref(), arguments.linear, arguments.force)?;
    let camera = camera(arguments, kit)?;
    let mut code = 0;
    let mut results = Vec::new();
    for (capture, out) in arguments.captures.iter().zip(&outputs) {
        match one(arguments, &camera, capture, out) {
            Ok(result) => results.push(result),
            Err(error) => code = code.max(complain(&error)),
        }
    }
    if arguments.json {
        let runtime = camera.session().map(|s| s.runtime().to_string());
        say(&format!("{:#}", json!({ "schema": 1, "runtime": runtime, "pictures": results })));
    }
    Ok(code)
}

fn camera(arguments: &Arguments, kit: Option<Kit>) -> Result<Camera> {
    let Some(kit) = kit else {
        eprintln!("isoplanat-camera: no --kit: the RAW is developed, no network is applied");
        let measured = arguments.distortion.as_deref().map(MeasuredDistortion::load).transpose()?;
        let camera = measured.as_ref().map_or_else(|| Ok(Camera::plain()), Camera::straightening)?;
        return camera.without(arguments.glare.unwrap_or(Veil::Keep));
    };
    let steps = Steps { network: !arguments.no_network, undistort: !arguments.no_undistort };
    let options =
        Options { onnxruntime: arguments.onnxruntime.clone(), threads: arguments.threads, ..Options::default() };
    let camera = Camera::with_kit(kit, steps, &options)?.without(arguments.glare.unwrap_or_default())?;
    match camera.session() {
        None => eprintln!("isoplanat-camera: --no-network: no network is applied"),
        Some(session) if matches!(session.runtime(), Runtime::Tract { .. }) => {
            eprintln!("isoplanat-camera: the network runs in {}", session.runtime());
        }
        Some(_) => {}
    }
    Ok(camera)
}

/// Develops one capture.
fn one(arguments: &Arguments, camera: &Camera, capture: &Path, out: &Path) -> Result<serde_json::Value> {
    let program = std::env::current_exe().map_err(|e| Error::Internal(format!("the program's own path: {e}")))?;
    let started = Instant::now();
    let raw = raw_process::decode(&program, capture, Limits::default())?;
    let decode = started.elapsed();
    let (make, model) = (raw.make.clone(), raw.model.clone());
    let bar = ProgressBar::hidden();
    let picture = camera.reconstruct(raw, capture, &|done, all| {
        if bar.length().is_none() {
            bar.set_draw_target(indicatif::ProgressDrawTarget::stderr());
            bar.set_length(all as u64);
            if let Ok(style) = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} tiles {eta}") {
                bar.set_style(style);
            }
            bar.set_message(capture.display().to_string());
        }
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    let picture = picture?;
    for note in &picture.notes {
        eprintln!("isoplanat-camera: {}: {note}", capture.display());
    }
    if picture.outside_fraction > 0.0 {
        let percent = 100.0 * picture.outside_fraction;
        eprintln!("isoplanat-camera: {}: {percent:.2} % of the picture lies outside the capture", capture.display());
    }
    let started = Instant::now();
    output::make_folder(out)?;
    output::write(out, &picture.image, arguments.linear, arguments.force)?;
    let (_, rows, columns) = picture.image.dim();
    let figures = Figures {
        decode,
        times: picture.times,
        write: started.elapsed(),
        megapixels: (rows * columns) as f64 / 1e6,
        tiles: picture.tiles,
        parallel: camera.session().map_or(1, isoplanat::deploy::session::Session::parallel_tiles),
    };
    if !arguments.json {
        say(&format!("{} -> {} ({columns} × {rows}, {make} {model})", capture.display(), out.display()));
        if arguments.bench {
            if let Some(session) = camera.session() {
                say(&format!("runtime             {}", session.runtime()));
            }
            say(&figures.text());
        }
    }
    Ok(json!({
        "capture": capture.display().to_string(),
        "picture": out.display().to_string(),
        "columns": columns,
        "rows": rows,
        "camera": format!("{make} {model}"),
        "network": picture.tiles > 0,
        "outside_fraction": picture.outside_fraction,
        "notes": picture.notes,
        "times": figures.json(),
    }))
}

/// What the network sees, and which scenes its filters are for.
fn told(kit: &Kit) -> String {
    let names = kit.card.inputs.names();
    if names.is_empty() {
        return "sees the capture alone".into();
    }
    let filters = kit.guide.filters().map_or(String::new(), |f| {
        let size = 2 * f.reach() + 1;
        let depths: Vec<String> = f.depths_mm().iter().map(|d| significant(*d, 6)).collect();
        let range = match depths.as_slice() {
            [] => "distances that the file does not state".into(),
            some => format!("objects at {} mm; others are taken to lie there", some.join(", ")),
        };
        format!(
            " ({} Wiener filters of {size} × {size} pixels a colour, for {range}; they ring by at most {:.2} of the range of a capture)",
            f.grid.len(),
            f.overshoot()
        )
    });
    format!("sees {} beside the capture{filters}", names.join(", "))
}

fn show_kit(kit: &Kit, as_json: bool) -> Result<()> {
    let tiling = kit.tiling()?;
    if as_json {
        let (card, distortion) = (&kit.card, &kit.distortion);
        let shown = json!({
            "schema": 1,
            "name": kit.name,
            "created_by": kit.created_by,
            "lens": kit.lens,
            "model": kit.model,
            "filters": kit.filters.as_ref().map(|(entry, _)| entry),
            "card": card,
            "frame": kit.frame,
            "distortion": distortion,
            "glare": kit.glare,
            "shading": kit.shading,
            "sensor": kit.sensor,
        });
        say(&format!("{shown:#}"));
        return Ok(());
    }
    let frame = &kit.frame;
    let edge = kit.distortion.sensor_from_slope(kit.distortion.max_slope);
    let ideal = kit.distortion.sensor_from_slope_derivative(0.0) * kit.distortion.max_slope;
    let corner = kit.shading.illumination.each_ref().map(|v| format!("{:.3}", v[v.len() - 1]));
    let lines = [
        format!("kit        {} (by {})", kit.name, kit.created_by),
        format!("lens       {} ({})", kit.lens.name, kit.lens.sha256),
        format!(
            "network    {}, {} scales, {} channels at the finest, {} blocks",
            kit.card.name,
            kit.card.scales,
            kit.card.base_width,
            kit.card.blocks.name()
        ),
        format!("told       {}", told(kit)),
        format!("model      {} ({} kB, {})", kit.model.file, kit.model_bytes.len() / 1000, kit.model.sha256),
        format!(
            "tiles      {} px, overlap {} px, {:.0} % of the work kept",
            tiling.tile(),
            kit.model.overlap_px,
            100.0 * tiling.efficiency()
        ),
        format!("demosaic   {}", kit.card.demosaic),
        format!(
            "frame      {} × {} px of {} µm, axis at column {}, row {}",
            frame.columns,
            frame.rows,
            frame.pitch_mm * 1e3,
            frame.axis_px[0],
            frame.axis_px[1]
        ),
        format!(
            "distortion {:+.2} % at {:.1}°, residual {:.4} mm",
            100.0 * (edge / ideal - 1.0),
            kit.distortion.max_slope.atan().to_degrees(),
            kit.distortion.residual_mm
        ),
        format!(
            "glare      {}",
            kit.glare.map_or("not measured".into(), |g| format!("{:.1} % of the light", 100.0 * g))
        ),
        format!("shading    {} at the last radius (R, G, B)", corner.join(", ")),
        format!(
            "sensor     {}, {}, {} bits, black {}, white {}",
            kit.sensor.name, kit.sensor.cfa, kit.sensor.bits, kit.sensor.black_level, kit.sensor.white_level
        ),
    ];
    say(&lines.join("\n"));
    Ok(())
}
