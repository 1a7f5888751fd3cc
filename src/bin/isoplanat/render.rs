//! `isoplanat render LENS SCENE -o OUT`: the picture on the sensor, by PSF grid or by rays from the sensor.

use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use isoplanat::imaging::files::{Encoding, write_picture};
use isoplanat::imaging::monte_carlo::{Channels, Sampling, Settings, render};
use isoplanat::imaging::plan::{Quality, plan};
use isoplanat::imaging::render::render_frame;
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::spectrum::SpectralDensity;
use isoplanat::imaging::warp::Region;
use ndarray::Array3;

use crate::output;
use crate::progress::Bar;
use crate::scene::{Placed, SceneArgs};

/// How to render.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Method {
    /// PSF grid and patched FFT convolution.
    PsfGrid,
    /// The reference: rays from the sensor.
    MonteCarlo,
}

/// The picture on the sensor.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file, or the name of a shipped lens.
    lens: String,
    /// Picture file, or a built-in scene: dead_leaves, text, fine_texture, slanted_edges, mixed, facades (with :SEED).
    scene: String,
    /// Picture to write: .png, .tif, .jpg.
    #[arg(short, long)]
    output: PathBuf,
    /// Renderer.
    #[arg(long, value_enum, default_value = "psf-grid")]
    method: Method,
    /// Rays a pixel and channel (monte-carlo).
    #[arg(long, default_value_t = 64)]
    samples: usize,
    #[command(flatten)]
    place: SceneArgs,
    /// Seed of the rays.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Figures as JSON.
    #[arg(long)]
    json: bool,
    /// Overwrite the picture.
    #[arg(long)]
    force: bool,
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    output::check_writable(&args.output, args.force)?;
    let Placed { lens, frame, max_slope, plane } = args.place.place(&args.lens, &args.scene)?;
    let density = SpectralDensity::new(&Sensor::generic());
    let clock = Instant::now();
    let bar = Bar::new("render");
    let progress = |share: f64| bar.set(share, String::new());
    let (image, figures): (Array3<f32>, serde_json::Value) = match args.method {
        Method::PsfGrid => {
            let plan = plan(&lens, lens.object_vergence, &frame, &density, Quality::FINE, Some(max_slope))?;
            let (image, optics) = render_frame(&lens, &plan, &plane, 192, &progress)?;
            let outside = optics.grid.outside.iter().copied().fold(0.0, f64::max);
            let figures = serde_json::json!({
                "kernel_px": plan.psf.size, "psf_nodes": optics.raster.len(), "largest_energy_outside": outside,
                "pupil_residual_mm": optics.grid.residual_mm, "traced_pupil_fraction": optics.grid.kept,
                "distortion_residual_px": optics.distortion.residual_mm / frame.pitch_mm,
            });
            (image, figures)
        }
        Method::MonteCarlo => {
            let whole = Region { row: 0, col: 0, rows: frame.rows, cols: frame.columns };
            let how = Settings {
                samples: args.samples,
                seed: args.seed,
                channels: Channels::All,
                sampling: Sampling::Bounded,
            };
            let r = render(&lens, &plane, &density, &frame, whole, how, Some(&progress))?;
            let figures = serde_json::json!({ "rays": r.rays, "noise_rms": r.noise_rms() });
            (r.mean, figures)
        }
    };
    bar.done(String::new());
    write_picture(&args.output, &image, Encoding::Srgb)?;
    let seconds = clock.elapsed().as_secs_f64();
    if args.json {
        writeln!(out, "{}", serde_json::json!({ "schema": 1, "seconds": seconds, "figures": figures }))?;
    } else {
        writeln!(out, "{}: {} × {} pixels in {seconds:.2} s", args.output.display(), frame.columns, frame.rows)?;
        for (key, value) in figures.as_object().into_iter().flatten() {
            writeln!(out, "  {key}: {value}")?;
        }
    }
    Ok(())
}
