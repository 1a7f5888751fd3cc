//! The command line.

use std::path::PathBuf;

use clap::{Args, Parser, ValueEnum};
use isoplanat_imaging::develop::gamut::Gamut;
use isoplanat_imaging::develop::glare::{LARGEST, check};
use isoplanat_imaging::develop::{Rendering, Tone};

use crate::program::output::{Format, Pictures};
use crate::reconstruct::Veil;

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
    /// RAW files (DNG or a camera's own), or folders of them. Pictures (.png, .tif, .jpg, .npy) that a camera or another program developed are
    /// taken too: their numbers as their profile says, or as sRGB, floating point as linear.
    #[arg(value_name = "CAPTURE", required_unless_present = "show_kit")]
    pub(crate) captures: Vec<PathBuf>,
    /// Kit folder, as `isoplanat export` writes it; without it no network is applied.
    #[arg(long, value_name = "KIT")]
    pub(crate) kit: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) naming: Naming,
    #[command(flatten)]
    pub(crate) look: Look,
    /// Develop captures as they arrive in the folders, until Ctrl-C; those that have a picture already are left alone.
    #[arg(long, requires = "out")]
    pub(crate) watch: bool,
    #[command(flatten)]
    pub(crate) corrections: Corrections,
    #[command(flatten)]
    pub(crate) running: Running,
    /// Print where the time goes.
    #[arg(long)]
    pub(crate) bench: bool,
    /// Print what the kit holds and leave.
    #[arg(long, requires = "kit")]
    pub(crate) show_kit: bool,
    /// Print results as JSON.
    #[arg(long)]
    pub(crate) json: bool,
    /// Overwrite existing pictures.
    #[arg(long)]
    pub(crate) force: bool,
}

// No doc comments on the groups: clap would print them as what the program is.

// How pictures are named.
#[derive(Debug, Args)]
pub(crate) struct Naming {
    /// Picture to write: .png (8 bits), .tif (16 bits), .jpg, .npy (linear light, floating point), or .dng (the camera's own linear colours, for other
    /// programs to develop); a folder for several captures [default: CAPTURE.png here].
    #[arg(short, long, value_name = "OUT")]
    pub(crate) out: Option<PathBuf>,
    /// Format of pictures that are named after their captures [default: png].
    #[arg(long, value_name = "FORMAT")]
    pub(crate) format: Option<Format>,
}

// How pictures look.
#[derive(Debug, Args)]
pub(crate) struct Look {
    /// Write linear light without the sRGB curve (16 bits; .png or .tif).
    #[arg(long)]
    pub(crate) linear: bool,
    /// Write linear light as 32-bit floating point (.tif or .npy).
    #[arg(long)]
    pub(crate) float: bool,
    /// Colours that the picture's numbers stand for, as its embedded profile says.
    #[arg(long, value_name = "SPACE", default_value = "srgb")]
    pub(crate) color: Space,
    /// Make the picture so many steps brighter (−10 to 10).
    #[arg(long, value_name = "STEPS", default_value_t = 0.0, hide_default_value = true, allow_negative_numbers = true, value_parser = exposure)]
    pub(crate) exposure: f64,
    /// Light beyond white in a brighter picture: cut off, or drawn in softly (Reinhard's curve, saturation stays white).
    #[arg(long, value_name = "TONE", default_value = "cut")]
    pub(crate) tone: Shoulder,
}

// What is done to a capture, and by which files.
#[derive(Debug, Args)]
pub(crate) struct Corrections {
    /// Leave the kit's network out.
    #[arg(long, requires = "kit")]
    pub(crate) no_network: bool,
    /// Leave the lens's distortion in.
    #[arg(long, requires = "kit")]
    pub(crate) no_undistort: bool,
    /// Distortion to take out, as `isoplanat calibrate` measured it; a kit has its own.
    #[arg(long, value_name = "DISTORTION.toml", conflicts_with = "kit")]
    pub(crate) distortion: Option<PathBuf>,
    /// The lens's falling light to divide out, as `isoplanat calibrate-sensor` measured it; a kit has its own.
    #[arg(long, value_name = "SHADING.toml", conflicts_with = "kit")]
    pub(crate) shading: Option<PathBuf>,
    /// Veiling glare to take off: a share of the light, `guess` from the picture's darkest parts, or `none` [default: the kit's]
    #[arg(long, value_name = "SHARE", value_parser = veil)]
    pub(crate) glare: Option<Veil>,
}

// What the network runs on, and its limits.
#[derive(Debug, Args)]
pub(crate) struct Running {
    /// ONNX Runtime's shared library [default: found by itself, else a slower runtime inside this program].
    #[arg(long, value_name = "PATH")]
    pub(crate) onnxruntime: Option<PathBuf>,
    /// Threads [default: one for each core].
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true, value_parser = threads)]
    pub(crate) threads: usize,
    /// Memory that this program may take, GiB, and its decoder's process as much; what needs more is refused [default: four fifths of what the system has left].
    #[arg(long, value_name = "GIB")]
    pub(crate) memory_gib: Option<f64>,
    /// Memory that the network's process may take, MiB of address space [default: 8192, and 1024 for each thread, or what the system has left].
    #[arg(long, value_name = "MIB", requires = "kit", value_parser = clap::value_parser!(u64).range(16..=MOST_MIB))]
    pub(crate) network_memory: Option<u64>,
    /// Time that it may take for a tile, and for opening the model.
    #[arg(long, value_name = "SECONDS", requires = "kit", default_value_t = 600.0, value_parser = seconds)]
    pub(crate) tile_seconds: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Space {
    Srgb,
    DisplayP3,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Shoulder {
    Cut,
    Soft,
}

impl Look {
    /// What a picture is rendered with.
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

impl Arguments {
    /// The pictures that are asked for.
    pub(crate) fn pictures(&self) -> Pictures {
        Pictures {
            captures: self.captures.clone(),
            read: [&self.corrections.distortion, &self.corrections.shading, &self.running.onnxruntime]
                .into_iter()
                .flatten()
                .cloned()
                .collect(),
            kit: self.kit.clone(),
            out: self.naming.out.clone(),
            format: self.naming.format,
            linear: self.look.linear,
            float: self.look.float,
            gamut: self.look.rendering().gamut,
            force: self.force,
        }
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

/// Threads at most: more than the largest machines have cores.
const MOST_THREADS: usize = 1024;

fn threads(text: &str) -> std::result::Result<usize, String> {
    text.parse().ok().filter(|n| *n <= MOST_THREADS).ok_or_else(|| format!("0 (one for each core) to {MOST_THREADS}"))
}

fn veil(text: &str) -> std::result::Result<Veil, String> {
    let allowed = format!("a share of the light from 0 to {LARGEST}, guess or none");
    match text {
        "guess" => Ok(Veil::Guess),
        "none" => Ok(Veil::Keep),
        _ => text.parse().ok().filter(|v| check(*v).is_ok()).map(Veil::Share).ok_or(allowed),
    }
}
