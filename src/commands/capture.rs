//! `isoplanat capture LENS SCENE -o x.dng`: the virtual camera.

use std::io::Write;
use std::path::PathBuf;

use isoplanat::atomic::Target;
use isoplanat::imaging::capture::{Capture, CaptureSettings, capture};
use isoplanat::imaging::develop::glare;
use isoplanat::imaging::dng::{DngInfo, write_dng};
use isoplanat::imaging::render::memory as estimate;
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::report::table::numbered;
use serde::Serialize;

use crate::input;
use crate::named::Named;
use crate::output;
use crate::output::Common;
use crate::progress::Bar;
use crate::scene::{Placed, SMALLER, SceneArgs, texels};

/// A RAW capture of a scene, by rays from the sensor.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file, or the name of a shipped lens.
    lens: Named,
    /// Picture file, or a built-in scene as KIND or KIND:SEED.
    scene: Named,
    /// DNG to write.
    #[arg(short, long, value_name = "OUT.dng")]
    output: PathBuf,
    /// Rays a pixel.
    #[arg(long, default_value_t = 128)]
    samples: usize,
    /// Signal of a white object on the axis, green channel, relative to saturation.
    #[arg(long, default_value_t = 1.0)]
    exposure: f64,
    /// Share of the light that the lens spreads over the whole frame as veiling glare.
    #[arg(long, default_value_t = 0.0)]
    glare: f64,
    #[command(flatten)]
    light: crate::input::Light,
    /// Sensor calibration; the generic sensor where left out.
    #[arg(long)]
    calibration: Option<PathBuf>,
    #[command(flatten)]
    place: SceneArgs,
    /// Seed of rays and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    common: Common,
}

/// For machines.
#[derive(Serialize)]
struct Figures {
    capture: String,
    columns: usize,
    rows: usize,
    rays: u64,
    seconds: f64,
    render_noise: f64,
    sensor_noise: f64,
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    output::check_writable(&args.output, args.common.force)?;
    glare::check(args.glare).map_err(|e| e.at("value").of_file("--glare"))?;
    let Placed { lens, frame, plane } = args.place.place(&args.lens, &args.scene)?;
    let sensor = args.calibration.as_deref().map_or_else(|| Ok(Sensor::generic()), Sensor::load)?;
    input::in_band(&lens, &SpectralDensity::under(&sensor, args.light.illuminant)?, &args.lens)?;
    let bytes = estimate::rays(&frame).saturating_add(estimate::scene(texels(&plane.texture)));
    let what = format!("a capture of {} × {} pixels", frame.columns, frame.rows);
    crate::memory::limit().allow(&what, bytes, SMALLER)?;
    let bar = Bar::new("capture");
    let how = CaptureSettings {
        samples: args.samples,
        seed: args.seed,
        exposure: args.exposure,
        noise: true,
        glare: args.glare,
        light: args.light.illuminant,
    };
    let taken = capture(&lens, &plane, &sensor, &frame, how, Some(&|share| bar.set(share, String::new())))?;
    bar.done(String::new());
    let info = DngInfo {
        software: concat!("isoplanat ", env!("CARGO_PKG_VERSION")).into(),
        description: format!("{}, seed {}", args.scene, args.seed),
        lens: lens.name.clone(),
        model: String::new(),
    };
    write_dng(Target::new(&args.output, args.common.force), taken.dn.view(), &sensor, &info)?;
    if args.common.json {
        let Capture { rays, seconds, render_noise, sensor_noise, .. } = taken;
        let (columns, rows) = (frame.columns, frame.rows);
        let figures = Figures {
            capture: args.output.display().to_string(),
            columns,
            rows,
            rays,
            seconds,
            render_noise,
            sensor_noise,
        };
        return Ok(writeln!(out, "{}", numbered(&figures))?);
    }
    writeln!(
        out,
        "{}: {} × {} pixels, {} rays in {:.1} s; noise of the rendering {:.1e} beside the sensor's {:.1e}",
        args.output.display(),
        frame.columns,
        frame.rows,
        taken.rays,
        taken.seconds,
        taken.render_noise,
        taken.sensor_noise
    )?;
    Ok(())
}
