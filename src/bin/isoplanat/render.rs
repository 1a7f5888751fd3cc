//! `isoplanat render LENS SCENE -o OUT`: the picture on the sensor, by PSF grid or by rays from the sensor.

use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use isoplanat::imaging::files::{Encoding, write_picture};
use isoplanat::imaging::monte_carlo::{Channels, Sampling, Settings, render};
use isoplanat::imaging::picture::plan::{PicturePlan, Wish, plan};
use isoplanat::imaging::picture::render::render as render_picture;
use isoplanat::imaging::picture::settings::Settings as Fineness;
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::spectrum::SpectralDensity;
use isoplanat::imaging::warp::Region;
use isoplanat::report::table::{Table, significant};
use isoplanat::{Error, Result};
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
    /// Take the cheapest settings that hold this PSNR, dB in linear light for a range of 1 (psf-grid).
    #[arg(long, value_name = "DB")]
    min_psnr_db: Option<f64>,
    /// Leave nothing out and make everything fine (psf-grid); for comparison.
    #[arg(long, conflicts_with = "min_psnr_db")]
    everything: bool,
    /// Say what this scene did not need: reason, work that remains, error bound (psf-grid).
    #[arg(long)]
    explain: bool,
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

impl Args {
    fn wish(&self) -> Result<Wish> {
        match self.min_psnr_db {
            None if self.everything => Ok(Wish::Everything),
            None => Ok(Wish::Psnr(DEFAULT_DB)),
            Some(db) if db.is_finite() && (10.0..=80.0).contains(&db) => Ok(Wish::Psnr(db)),
            Some(db) => Err(Error::bad("--min-psnr-db", "value", db.to_string(), "10 to 80 dB")),
        }
    }
}

/// PSNR that is held where none is asked for.
const DEFAULT_DB: f64 = 50.0;

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    output::check_writable(&args.output, args.force)?;
    let wish = args.wish()?;
    let Placed { lens, frame, max_slope, plane } = args.place.place(&args.lens, &args.scene)?;
    let density = SpectralDensity::new(&Sensor::generic());
    let clock = Instant::now();
    let mut listed = None;
    let (image, figures, bar): (Array3<f32>, serde_json::Value, Bar) = match args.method {
        Method::PsfGrid => {
            let plan = plan(&lens, &plane, &frame, &density, Some(max_slope), wish, args.explain)?;
            let planned = clock.elapsed().as_secs_f64();
            let bar = Bar::new("render");
            let picture = render_picture::<f32>(&plan, &|share| bar.set(share, String::new()));
            if !plan.holds {
                let predicted = plan.predicted_db.unwrap_or(f64::NAN);
                eprintln!("warning: the finest settings are predicted to reach {predicted:.1} dB, less than asked for");
            }
            let mut figures = figures(&plan);
            figures["planning_seconds"] = planned.into();
            figures["kernels"] = picture.kernels.into();
            figures["largest_energy_outside"] = picture.outside.into();
            if args.explain {
                figures["skips"] = serde_json::to_value(&plan.skips)?;
                listed = Some(table(&plan));
            }
            (picture.image, figures, bar)
        }
        Method::MonteCarlo => {
            let whole = Region { row: 0, col: 0, rows: frame.rows, cols: frame.columns };
            let how = Settings {
                samples: args.samples,
                seed: args.seed,
                channels: Channels::All,
                sampling: Sampling::Bounded,
            };
            let bar = Bar::new("render");
            let r = render(&lens, &plane, &density, &frame, whole, how, Some(&|share| bar.set(share, String::new())))?;
            let figures = serde_json::json!({ "rays": r.rays, "noise_rms": r.noise_rms() });
            (r.mean, figures, bar)
        }
    };
    bar.done(String::new());
    write_picture(&args.output, &image, Encoding::Srgb)?;
    let seconds = clock.elapsed().as_secs_f64();
    if args.json {
        writeln!(out, "{}", serde_json::json!({ "schema": 1, "seconds": seconds, "figures": figures }))?;
    } else {
        writeln!(out, "{}: {} × {} pixels in {seconds:.2} s", args.output.display(), frame.columns, frame.rows)?;
        for (key, value) in figures.as_object().into_iter().flatten().filter(|(key, _)| *key != "skips") {
            writeln!(out, "  {key}: {value}")?;
        }
        if let Some(table) = listed {
            writeln!(out, "\nleft out, or made coarser than the full computation:\n{table}")?;
        }
    }
    Ok(())
}

/// The plan in numbers.
fn figures(plan: &PicturePlan<'_>) -> serde_json::Value {
    let Fineness { samples, wavelengths, degree, dense, .. } = plan.settings;
    serde_json::json!({
        "predicted_psnr_db": plan.predicted_db,
        "holds": plan.holds,
        "scene_samples_per_px": samples,
        "wavelengths": wavelengths,
        "pupil_degree": degree,
        "pupil_points": dense,
        "kernel_px": 2 * plan.half_width + 1,
        "psf_nodes": plan.grid.len(),
        "node_error": plan.node_error,
        "fields_traced": plan.bank.table.slopes.len(),
        "rays_traced": plan.bank.table.rays,
        "method": format!("{:?}", plan.method),
        "pupil_residual_mm": plan.bank.table.residual_mm,
        "traced_pupil_fraction": plan.bank.table.kept,
        "distortion_residual_px": plan.distortion.residual_mm / plan.frame.pitch_mm,
    })
}

/// What was left out.
fn table(plan: &PicturePlan<'_>) -> Table {
    let mut table = Table::new(["what", "work left", "bound (rms)", "reason"]);
    for skip in &plan.skips {
        let bound = if skip.bound == 0.0 { "none".into() } else { significant(skip.bound, 2) };
        table.row([skip.what.to_owned(), significant(skip.remaining, 2), bound, skip.reason.clone()]);
    }
    table
}
