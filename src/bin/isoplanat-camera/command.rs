//! The command line, and the loop over captures.

use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Parser, ValueEnum};
use isoplanat::calibrate::file::MeasuredDistortion;
use isoplanat::calibrate::shading::MeasuredShading;
use isoplanat::deploy::kit::Kit;
use isoplanat::deploy::network_process::Apart;
use isoplanat::deploy::reconstruct::{Camera, Steps, Target, Veil};
use isoplanat::deploy::session::{Options, Runtime};
use isoplanat::imaging::develop::gamut::Gamut;
use isoplanat::imaging::develop::glare::{LARGEST, check};
use isoplanat::imaging::develop::{Rendering, Tone};
use isoplanat::{Error, Result};
use serde_json::json;

use crate::batch::Batch;
use crate::{output, show, watch};

/// Limits of the network's process at most.
const MOST_MIB: u64 = 1 << 24;
const MOST_SECONDS: f64 = 86_400.0;
/// Steps brighter or darker at most.
const EXPOSURES: f64 = 10.0;

/// Develop RAW captures, through the reconstruction network of a kit where one is given.
///
/// Exit codes: 0 done, 1 internal error, 2 bad input.
#[derive(Debug, Parser)]
#[command(version, name = "isoplanat-camera")]
pub(crate) struct Arguments {
    /// RAW files (DNG or a camera's own), or folders of them.
    #[arg(value_name = "CAPTURE", required_unless_present = "show_kit")]
    pub(crate) captures: Vec<PathBuf>,
    /// Kit folder, as `isoplanat export` writes it; without it no network is applied.
    #[arg(long, value_name = "KIT")]
    kit: Option<PathBuf>,
    /// Picture to write: .png (8 bits), .tif (16 bits), .jpg, or .dng (the camera's own linear colours, for other programs to develop); a folder for
    /// several captures [default: CAPTURE.png here].
    #[arg(short, long, value_name = "OUT")]
    pub(crate) out: Option<PathBuf>,
    /// Format of pictures that are named after their captures [default: png].
    #[arg(long, value_name = "FORMAT")]
    pub(crate) format: Option<Format>,
    /// Write linear light without the sRGB curve (16 bits; .png or .tif).
    #[arg(long)]
    pub(crate) linear: bool,
    /// Colours that the picture's numbers stand for, as its embedded profile says.
    #[arg(long, value_name = "SPACE", default_value = "srgb")]
    color: Space,
    /// Make the picture so many steps brighter (−10 to 10).
    #[arg(long, value_name = "STEPS", default_value_t = 0.0, hide_default_value = true, allow_negative_numbers = true, value_parser = exposure)]
    exposure: f64,
    /// Light beyond white in a brighter picture: cut off, or drawn in softly (Reinhard's curve, saturation stays white).
    #[arg(long, value_name = "TONE", default_value = "cut")]
    tone: Shoulder,
    /// Develop captures as they arrive in the folders, until Ctrl-C; those that have a picture already are left alone.
    #[arg(long, requires = "out")]
    watch: bool,
    /// Leave the kit's network out.
    #[arg(long, requires = "kit")]
    no_network: bool,
    /// Leave the lens's distortion in.
    #[arg(long, requires = "kit")]
    no_undistort: bool,
    /// Distortion to take out, as `isoplanat calibrate` measured it; a kit has its own.
    #[arg(long, value_name = "DISTORTION.toml", conflicts_with = "kit")]
    distortion: Option<PathBuf>,
    /// The lens's falling light to divide out, as `isoplanat calibrate-sensor` measured it; a kit has its own.
    #[arg(long, value_name = "SHADING.toml", conflicts_with = "kit")]
    shading: Option<PathBuf>,
    /// Veiling glare to take off: a share of the light, `guess` from the picture's darkest parts, or `none` [default: the kit's]
    #[arg(long, value_name = "SHARE", value_parser = veil)]
    glare: Option<Veil>,
    /// ONNX Runtime's shared library [default: found by itself, else a slower runtime inside this program].
    #[arg(long, value_name = "PATH")]
    onnxruntime: Option<PathBuf>,
    /// Threads [default: one for each core].
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    threads: usize,
    /// Memory that the network's process may take, MiB of address space [default: 8192, and 1024 for each thread].
    #[arg(long, value_name = "MIB", requires = "kit", value_parser = clap::value_parser!(u64).range(16..=MOST_MIB))]
    network_memory: Option<u64>,
    /// Time that it may take for a tile, and for opening the model.
    #[arg(long, value_name = "SECONDS", requires = "kit", default_value_t = 600.0, value_parser = seconds)]
    tile_seconds: f64,
    /// Print where the time goes.
    #[arg(long)]
    pub(crate) bench: bool,
    /// Print what the kit holds and leave.
    #[arg(long, requires = "kit")]
    show_kit: bool,
    /// Print results as JSON.
    #[arg(long)]
    pub(crate) json: bool,
    /// Overwrite existing pictures.
    #[arg(long)]
    pub(crate) force: bool,
}

/// Formats of pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Format {
    Png,
    Tif,
    Jpg,
    Dng,
}

impl Format {
    pub(crate) const ALL: [Self; 4] = [Self::Png, Self::Tif, Self::Jpg, Self::Dng];

    /// Endings of its files.
    pub(crate) fn endings(self) -> &'static [&'static str] {
        match self {
            Self::Png => &["png"],
            Self::Tif => &["tif", "tiff"],
            Self::Jpg => &["jpg", "jpeg"],
            Self::Dng => &["dng"],
        }
    }

    /// The ending that its files get here.
    pub(crate) fn ending(self) -> &'static str {
        self.endings()[0]
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Space {
    Srgb,
    DisplayP3,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Shoulder {
    Cut,
    Soft,
}

impl Arguments {
    /// How pictures look.
    pub(crate) fn rendering(&self) -> Rendering {
        let gamut = match self.color {
            Space::Srgb => Gamut::Srgb,
            Space::DisplayP3 => Gamut::DisplayP3,
        };
        let tone = match self.tone {
            Shoulder::Cut => Tone::Cut,
            Shoulder::Soft => Tone::Soft,
        };
        Rendering { gamut, exposure_ev: self.exposure, tone }
    }
}

fn exposure(text: &str) -> std::result::Result<f64, String> {
    let number = text.parse().ok().filter(|v: &f64| v.abs() <= EXPOSURES);
    number.ok_or_else(|| format!("steps from -{EXPOSURES} to {EXPOSURES}"))
}

fn seconds(text: &str) -> std::result::Result<f64, String> {
    let number = text.parse().ok().filter(|v: &f64| *v > 0.0 && *v <= MOST_SECONDS);
    number.ok_or_else(|| format!("seconds, above 0, at most {MOST_SECONDS}"))
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
pub(crate) fn complain(error: &Error) -> u8 {
    eprintln!("isoplanat-camera: {error}");
    error.exit_code()
}

/// Prints to standard output; a reader that has gone away is no error.
pub(crate) fn say(text: &str) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

fn work(arguments: &Arguments) -> Result<u8> {
    isoplanat::math::simd::check_environment()?;
    let kit = arguments.kit.as_deref().map(Kit::load).transpose()?;
    if let (true, Some(kit)) = (arguments.show_kit, &kit) {
        show::show_kit(kit, arguments.json)?;
        return Ok(0);
    }
    if arguments.threads > 0 {
        // Fails only if the pool is in use already.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(arguments.threads).build_global();
    }
    if arguments.watch {
        let out = watch::folders(arguments)?;
        let camera =
            camera(arguments, kit)?.making(target(arguments, &[out.join(output::named("a", arguments.format))])?);
        return watch::run(arguments, out, &Batch::new(arguments, &camera));
    }
    let captures = output::captures(&arguments.captures)?;
    let outputs = output::plan(&captures, arguments)?;
    let camera = camera(arguments, kit)?.making(target(arguments, &outputs)?);
    let batch = Batch::new(arguments, &camera);
    let mut code = 0;
    let mut results = Vec::new();
    for (k, (capture, out)) in captures.iter().zip(&outputs).enumerate() {
        match batch.develop((k, captures.len()), capture, out) {
            Ok(result) => results.push(result),
            Err(error) => code = code.max(batch.complain(&error)),
        }
    }
    batch.finish();
    if arguments.json {
        let runtime = camera.network().map(|n| n.runtime().to_string());
        say(&format!("{:#}", json!({ "schema": 1, "runtime": runtime, "pictures": results })));
    }
    Ok(code)
}

/// What captures are made into: all outputs of a run have one format.
fn target(arguments: &Arguments, outputs: &[PathBuf]) -> Result<Target> {
    let Some(dng) = outputs.iter().find(|o| output::is_dng(o)) else {
        return Ok(Target::Rendered(arguments.rendering()));
    };
    let rendered = [
        ("--color", arguments.color != Space::Srgb),
        ("--exposure", arguments.exposure != 0.0),
        ("--tone", arguments.tone != Shoulder::Cut),
    ];
    match rendered.iter().find(|(_, asked)| *asked) {
        Some((name, _)) => {
            let found = "a DNG holds the camera's own light";
            Err(Error::bad(
                dng.display().to_string(),
                *name,
                found,
                "another format, or none of it: the program that develops it decides",
            ))
        }
        None => Ok(Target::Camera),
    }
}

fn camera(arguments: &Arguments, kit: Option<Kit>) -> Result<Camera> {
    let Some(kit) = kit else {
        eprintln!("isoplanat-camera: no --kit: the RAW is developed, no network is applied");
        let mut camera = Camera::plain();
        if let Some(path) = &arguments.distortion {
            camera = camera.straightening(&MeasuredDistortion::load(path)?)?;
        }
        if let Some(path) = &arguments.shading {
            camera = camera.evening(&MeasuredShading::load(path)?)?;
        }
        return camera.without(arguments.glare.unwrap_or(Veil::Keep));
    };
    let steps = Steps { network: !arguments.no_network, undistort: !arguments.no_undistort };
    let options =
        Options { onnxruntime: arguments.onnxruntime.clone(), threads: arguments.threads, ..Options::default() };
    let program = std::env::current_exe().map_err(|e| Error::Internal(format!("the program's own path: {e}")))?;
    let apart = Apart {
        memory_bytes: arguments.network_memory.map(|mib| mib << 20),
        time: Duration::from_secs_f64(arguments.tile_seconds),
        hint: "; --network-memory and --tile-seconds set them",
        ..Apart::of(program)
    };
    let camera = Camera::with_kit_apart(kit, steps, &options, &apart)?;
    let camera = camera.without(arguments.glare.unwrap_or_default())?;
    match camera.network() {
        None => eprintln!("isoplanat-camera: --no-network: no network is applied"),
        Some(network) if matches!(network.runtime(), Runtime::Tract { .. }) => {
            eprintln!("isoplanat-camera: the network runs in {}", network.runtime());
        }
        Some(_) => {}
    }
    Ok(camera)
}
