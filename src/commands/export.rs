//! `isoplanat export RUN/ -o KIT/`: ONNX model and calibration of a run.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::deploy::kit::{FILE, LensEntry, tile_px};
use isoplanat::deploy::session::{Options, Session};
use isoplanat::deploy::valid::Valid;
use isoplanat::design::opened::Run;
use isoplanat::design::subject::Subject;
use isoplanat::imaging::develop::glare;
use isoplanat::imaging::guide::Guide;
use isoplanat::imaging::metrics::decibel;
use isoplanat::imaging::plane::Region;
use isoplanat::imaging::scene::{SceneKind, generate};
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::math::memory::{BASE, product, words};
use isoplanat::network::card::Weights;
use isoplanat::network::onnx;
use isoplanat::report::table::numbered;
use isoplanat::{Result, atomic};
use ndarray::{Array4, Axis};

use crate::kit;
use crate::output::Common;

/// ONNX model and calibration of a run, for the camera.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Run folder that `design` or `train` wrote.
    run: PathBuf,
    /// Kit folder to write.
    #[arg(short, long, value_name = "OUT_DIR")]
    output: PathBuf,
    /// Store the weights with 16 bits: half the file; says what that costs.
    #[arg(long)]
    f16: bool,
    /// Largest side of the camera's tiles, pixels; chosen by the network's size where left out.
    #[arg(long, value_name = "PX")]
    tile: Option<usize>,
    /// Share of the light that the lens spreads over the frame as veiling glare (measured): the camera takes it off.
    #[arg(long, value_name = "SHARE")]
    glare: Option<f64>,
    /// Captures that the kit is for, as iso=LOW..HIGH, f_number=…, focal_length_mm=… or distance_m=…, as often as wanted: the camera compares them with a
    /// file's Exif facts and tells what does not fit.
    #[arg(long, value_name = "KEY=LOW..HIGH")]
    valid: Vec<String>,
    #[command(flatten)]
    common: Common,
}

/// Side of the built-in scene that f16 weights are judged on, pixels; a multiple of every network's.
const JUDGED: usize = 384;

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    atomic::check_folder(&args.output, FILE, args.common.force)?;
    args.glare.map(glare::check).transpose().map_err(|e| e.at("value").of_file("--glare"))?;
    let mut valid = Valid::default();
    args.valid.iter().try_for_each(|text| valid.put(text))?;
    let run = crate::input::run(&args.run)?;
    let trained_on = run.trained_on(&args.run)?;
    let Run { task, subject, network, guide } = run;
    if valid.distance_m.is_none() && task.network_depths_mm().len() > 1 {
        // A network of several distances says which.
        let ends = |pick: fn(f64, f64) -> f64, from| 1e-3 * task.network_depths_mm().iter().copied().fold(from, pick);
        valid.distance_m = Some([ends(f64::min, f64::INFINITY), ends(f64::max, 0.0)]);
    }
    let lens = LensEntry { name: subject.name().to_owned(), sha256: subject.sha256() };
    let (sensor, frame) = (task.sensor()?, subject.frame()?);
    let config = network.config();
    // Weights as they are read and encoded; with --f16 the features of two networks over the judged picture.
    let weights = std::fs::metadata(args.run.join("network.safetensors")).map_or(0, |m| m.len());
    let features = product(&[3 * config.planes_forward(), JUDGED, JUDGED, config.base_width, size_of::<f32>()]);
    let bytes = BASE + 8 * weights + if args.f16 { features } else { 0 };
    crate::memory::limit().allow("the kit", bytes, "a smaller network, or weights as f32")?;
    let name = format!("kit for {}", lens.name);
    let mut card = kit::card(&name, &lens, &network, &sensor, trained_on);
    let tile = args.tile.map_or_else(|| tile_px(&card, &frame), Ok)?;
    let mut model = onnx::encode(&network, &card)?;
    let cost = if args.f16 {
        let whole = model;
        card.weights = Weights::F16;
        model = onnx::encode(&network, &card).map_err(|e| e.in_file(args.run.join("network.safetensors")))?;
        Some(cost_of_halves(&whole, &model, &guide)?)
    } else {
        None
    };
    let calibration = subject.calibration(&SpectralDensity::new(&sensor))?;
    let mut kit = kit::around(model, &card, &lens, &sensor, &frame, &calibration, &guide, tile)?;
    kit.glare = args.glare;
    kit.valid = valid;
    kit.save(&args.output, args.common.force)?;
    let residual = calibration.distortion.residual_mm / frame.pitch_mm;
    let seen_mm = calibration.distortion.sensor_from_slope(calibration.distortion.max_slope);
    if args.common.json {
        let figures = Figures {
            kit: args.output.display().to_string(),
            lens_sha256: &lens.sha256,
            distortion_residual_px: residual,
            distortion_radius_mm: seen_mm,
            corner_mm: frame.max_radius_mm(),
            memory_bytes: bytes,
            f16: cost,
        };
        return Ok(writeln!(out, "{}", numbered(&figures))?);
    }
    let (of, unit) = match subject {
        Subject::Lens(_) => ("the chief rays", "mm"),
        Subject::Measured(_) => ("the board's corners, rms,", "pixels"),
    };
    writeln!(
        out,
        "{}: model for lens {}; its distortion's polynomial is within {residual:.2} pixel of {of} out to {seen_mm:.3} {unit} (the \
         frame's corner: {:.3} {unit}); memory: at most {}",
        args.output.display(),
        &lens.sha256[..12],
        frame.max_radius_mm(),
        words(bytes)
    )?;
    if let Some(cost) = cost {
        writeln!(
            out,
            "weights as {}: {:.1} KiB instead of {:.1}; on a built-in scene the output differs from f32 weights' by {:.1e} rms \
             and {:.1e} at most (white is 1): {:.1} dB",
            card.weights.name(),
            cost.kib,
            cost.f32_kib,
            cost.rms,
            cost.largest,
            cost.psnr_db
        )?;
    }
    Ok(())
}

/// The kit, for machines.
#[derive(serde::Serialize)]
struct Figures<'a> {
    kit: String,
    lens_sha256: &'a str,
    distortion_residual_px: f64,
    distortion_radius_mm: f64,
    corner_mm: f64,
    memory_bytes: u64,
    f16: Option<Halves>,
}

/// What weights with 16 bits save, and cost on a built-in scene (white is 1).
#[derive(serde::Serialize)]
struct Halves {
    kib: f64,
    f32_kib: f64,
    rms: f64,
    largest: f32,
    psnr_db: f64,
}

/// Sizes of the two files, and how far their outputs differ on a built-in scene, both as the camera would run them.
fn cost_of_halves(whole: &[u8], halves: &[u8], guide: &Guide) -> Result<Halves> {
    let place = Region { row: 0, col: 0, rows: JUDGED, cols: JUDGED };
    let scene = generate(SceneKind::Facades, 16, JUDGED, JUDGED);
    let picture = guide.over(scene.view(), place, place).insert_axis(Axis(0));
    let output = |model: &[u8]| -> Result<Array4<f32>> {
        Session::open(model, Path::new("model.onnx"), &Options::default())?.run(picture.view())
    };
    let difference = output(halves)? - output(whole)?;
    let largest = difference.iter().fold(0f32, |m, v| m.max(v.abs()));
    #[expect(clippy::cast_precision_loss, reason = "a mean")]
    let mean_square = difference.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / difference.len() as f64;
    #[expect(clippy::cast_precision_loss, reason = "bytes for a reader")]
    let kib = |bytes: &[u8]| bytes.len() as f64 / 1024.0;
    let (kib, f32_kib) = (kib(halves), kib(whole));
    Ok(Halves { kib, f32_kib, rms: mean_square.sqrt(), largest, psnr_db: decibel(mean_square) })
}
