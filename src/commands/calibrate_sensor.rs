//! `isoplanat calibrate-sensor`: levels and noise of a sensor, and a lens's falling light, from dark and flat frames.

use std::fmt;
use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::calibrate::shading::{self, MeasuredShading, Rings};
use isoplanat::calibrate::transfer::{Frames, Transfer, transfer};
use isoplanat::deploy::child::Helper;
use isoplanat::deploy::raw::{RawCapture, RawPixels};
use isoplanat::deploy::raw_process;
use isoplanat::imaging::develop::{IDENTITY, srgb_from_camera};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::cfa::Cfa;
use isoplanat::math::memory::product;
use isoplanat::report::plot::{Mark, Plot, Series};
use isoplanat::report::table::{Table, numbered, significant};
use isoplanat::terminal::in_line;
use isoplanat::{Error, Result};
use serde::Serialize;

use crate::output::Common;
use crate::progress::Bar;
use crate::twice;

/// Bytes of a pixel of a frame while frames are measured: as it is kept, and its share of one that is read.
const BYTES: usize = 16;
/// Points of a channel in the drawing at most.
const DRAWN: usize = 400;

/// Arguments of `calibrate-sensor`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// RAW files without light (lens cap on), two and more
    #[arg(long, required = true, num_args = 1.., value_name = "DARK")]
    darks: Vec<PathBuf>,
    /// RAW files of an even light (a white screen, out of focus), two and more of each exposure, none of them cut off; all frames at one ISO
    #[arg(long, required = true, num_args = 1.., value_name = "FLAT")]
    flats: Vec<PathBuf>,
    /// The sensor, as every command's `--calibration` reads it
    #[arg(short, long, value_name = "OUT.toml")]
    out: Option<PathBuf>,
    /// The lens's relative illumination, as `isoplanat-camera --shading` reads it
    #[arg(long, value_name = "OUT.toml")]
    shading: Option<PathBuf>,
    /// Centre of the illumination, column and row in pixels [default: the middle]
    #[arg(long, value_name = "COLUMN,ROW", value_parser = place, requires = "shading")]
    centre: Option<[f64; 2]>,
    /// Lens that the file names [default: as the frames say]
    #[arg(long)]
    lens: Option<String>,
    /// Variance over mean of every tile, drawn
    #[arg(long, value_name = "OUT.svg")]
    svg: Option<PathBuf>,
    /// The same as comma-separated values
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

fn place(text: &str) -> std::result::Result<[f64; 2], String> {
    let number = |t: &str| t.trim().parse().ok().filter(|v: &f64| v.is_finite());
    let both = text.split_once(',').and_then(|(x, y)| Some([number(x)?, number(y)?]));
    both.ok_or_else(|| "COLUMN,ROW in pixels".to_owned())
}

/// What all frames have in common.
struct Camera {
    name: String,
    lens: String,
    cfa: Cfa,
    size: (usize, usize),
    white: f64,
    iso: Option<f64>,
    neutral: Option<[f64; 3]>,
    srgb_from_camera: Option<[[f64; 3]; 3]>,
}

/// Runs the command; the result goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let outputs = [&args.out, &args.shading, &args.svg, &args.csv].map(Option::as_deref);
    crate::output::check_all(&outputs, args.common.force)?;
    let (frames, camera) = read(args)?;
    let measured = transfer(&frames).map_err(|e| e.in_file(Path::new("calibrate-sensor")))?;
    let sensor = sensor(args, &camera, &measured)?;
    let shading = if args.shading.is_some() { Some(illumination(args, &frames, &camera, &measured)?) } else { None };
    if let Some(path) = &args.out {
        let text = toml::to_string(&sensor).map_err(|e| Error::Internal(format!("sensor to TOML: {e}")))?;
        crate::output::put(&text, Some(path), args.common.force, out)?;
    }
    if let (Some(path), Some(shading)) = (&args.shading, &shading) {
        crate::output::put(&shading.text()?, Some(path), args.common.force, out)?;
    }
    let listing = Listing { measured: &measured, camera: &camera, sensor: &sensor, shading: shading.as_ref() };
    if let Some(path) = &args.svg {
        crate::output::put(&listing.svg(), Some(path), args.common.force, out)?;
    }
    if let Some(path) = &args.csv {
        crate::output::put(&listing.csv(), Some(path), args.common.force, out)?;
    }
    if args.common.json {
        writeln!(out, "{:#}", listing.json())?;
    } else {
        write!(out, "{listing}")?;
    }
    measured.warnings().iter().for_each(|w| crate::tell!("warning: {w}"));
    Ok(())
}

/// Every frame, and what the first one says of its camera; the others have to agree.
fn read(args: &Args) -> Result<(Frames, Camera)> {
    let helper = Helper::current()?;
    let limit = crate::memory::limit();
    let count = args.darks.len() + args.flats.len();
    let bar = Bar::new("frames");
    let mut camera: Option<Camera> = None;
    let mut all = Vec::with_capacity(count);
    for (k, path) in args.darks.iter().chain(&args.flats).enumerate() {
        bar.set(k as f64 / count as f64, path.display().to_string());
        let (raw, _) = raw_process::decode(&helper, path, limit)?;
        // A frame beside itself has no noise.
        let earlier = args.darks.iter().chain(&args.flats).take(k).map(PathBuf::as_path);
        twice::first_time(path, earlier, "each frame once: frames that were shot one after the other")?;
        let found = Camera::of(&raw, path)?;
        match &camera {
            None => {
                let (rows, columns) = found.size;
                let what = format!("{count} frames of {columns} × {rows} pixels");
                limit.allow(&what, product(&[count, rows, columns, BYTES]), "fewer frames")?;
                let within = |[x, y]: &[f64; 2]| (0.0..=columns as f64).contains(x) && (0.0..=rows as f64).contains(y);
                if let Some(centre) = args.centre.filter(|c| !within(c)) {
                    let (found, allowed) = (format!("{centre:?}"), format!("a place within {columns} × {rows} pixels"));
                    return Err(Error::bad("--centre", "value", found, allowed));
                }
                camera = Some(found);
            }
            Some(first) => first.agrees(&found, path)?,
        }
        let RawPixels::Mosaic { samples, .. } = raw.pixels else { unreachable!("checked with the camera") };
        all.push(samples);
    }
    bar.done(format!("{} dark and {} flat frames", args.darks.len(), args.flats.len()));
    let camera = camera.ok_or_else(|| Error::Internal("no frames".into()))?;
    let flats = all.split_off(args.darks.len());
    Ok((Frames { darks: all, flats, cfa: camera.cfa, white: camera.white }, camera))
}

impl Camera {
    fn of(raw: &RawCapture, path: &Path) -> Result<Self> {
        let refuse = |place: &str, found: String, allowed: &str| {
            Err(Error::bad(path.display().to_string(), place, found, allowed))
        };
        let RawPixels::Mosaic { cfa, .. } = raw.pixels else {
            return refuse("RAW", "a picture without a Bayer mosaic".into(), "the sensor's mosaic");
        };
        if raw.corrected {
            let found = "samples that the file's own corrections changed (OpcodeList2)".into();
            return refuse("RAW", found, "levels in digital numbers, as the sensor gave them");
        }
        let white = f64::from(raw.white.iter().copied().fold(f32::INFINITY, f32::min));
        if white <= 16.0 || white > 65535.0 {
            return refuse("RAW", format!("white level {white}"), "levels in digital numbers, as the sensor gave them");
        }
        Ok(Self {
            name: format!("{} {}", raw.make, raw.model).trim().to_owned(),
            lens: raw.exif.lens().unwrap_or_default().to_owned(),
            cfa,
            size: raw.size(),
            white,
            iso: raw.exif.iso(),
            neutral: raw.neutral,
            srgb_from_camera: raw.camera_from_xyz.as_ref().and_then(srgb_from_camera),
        })
    }

    fn agrees(&self, other: &Self, path: &Path) -> Result<()> {
        let iso = |v: Option<f64>| v.map_or_else(|| "no ISO".to_owned(), |v| format!("ISO {v}"));
        let pixels = |(rows, columns): (usize, usize)| format!("{columns} × {rows} pixels");
        let pairs = [
            ("camera", self.name.clone(), other.name.clone()),
            ("size", pixels(self.size), pixels(other.size)),
            ("colour filter", self.cfa.to_string(), other.cfa.to_string()),
            ("white level", self.white.to_string(), other.white.to_string()),
            ("ISO", iso(self.iso), iso(other.iso)),
        ];
        match pairs.into_iter().find(|(_, a, b)| a != b) {
            Some((place, first, found)) => {
                Err(Error::bad(path.display().to_string(), place, found, format!("{first}, as the first frame has it")))
            }
            None => Ok(()),
        }
    }

    fn settings(&self) -> String {
        self.iso.map_or_else(String::new, |iso| format!(" at ISO {iso}"))
    }
}

/// The sensor as measured; what these frames do not tell is said in its source.
fn sensor(args: &Args, camera: &Camera, measured: &Transfer) -> Result<Sensor> {
    let generic = Sensor::generic();
    let neutral = camera.neutral.map_or("1 (the frames name none)", |_| "as the first dark frame was shot");
    let colour =
        camera.srgb_from_camera.map_or("none (the camera's is not known)", |_| "as the RAW file or its decoder has it");
    let source = format!(
        "isoplanat calibrate-sensor: photon transfer of {} dark and {} flat frames{}; neutral response {neutral}; colour matrix {colour}; spectral response is \
         NOT measured: that of generic-rggb",
        args.darks.len(),
        args.flats.len(),
        camera.settings(),
    );
    let bits = (1..=16).find(|b| f64::from((1u32 << b) - 1) >= camera.white).unwrap_or(16);
    let sensor = Sensor {
        schema: generic.schema,
        name: if camera.name.is_empty() { "unnamed camera".into() } else { camera.name.clone() },
        source,
        cfa: camera.cfa,
        bits,
        black_level: measured.black.value,
        white_level: camera.white,
        full_well_electrons: measured.full_well_electrons(),
        read_noise_electrons: measured.read_electrons(),
        neutral_response: camera.neutral.map_or([1.0; 3], |n| n.map(|v| v / n[1])),
        srgb_from_camera: camera.srgb_from_camera.unwrap_or(IDENTITY),
        spectral_response: generic.spectral_response,
    };
    sensor.check(&args.out.as_ref().map_or_else(|| "sensor".to_owned(), |o| o.display().to_string()))?;
    Ok(sensor)
}

/// The relative illumination of the flats.
fn illumination(args: &Args, frames: &Frames, camera: &Camera, measured: &Transfer) -> Result<MeasuredShading> {
    let (rows, columns) = camera.size;
    let named = |e: Error| e.in_file(Path::new("--flats"));
    let (mean, used) = shading::mean_of_flats(frames, measured).map_err(named)?;
    let centre_px = args.centre.unwrap_or([0.5 * columns as f64, 0.5 * rows as f64]);
    let (illumination, rms) = shading::measure(&mean, camera.cfa, centre_px).map_err(named)?;
    Ok(MeasuredShading {
        schema: 1,
        camera: camera.name.clone(),
        lens: args.lens.clone().unwrap_or_else(|| camera.lens.clone()),
        source: format!("isoplanat calibrate-sensor: mean of {used} flat frames{}", camera.settings()),
        columns,
        rows,
        centre_px,
        rms,
        illumination,
    })
}

/// What the command shows.
struct Listing<'a> {
    measured: &'a Transfer,
    camera: &'a Camera,
    sensor: &'a Sensor,
    shading: Option<&'a MeasuredShading>,
}

/// The same for machines.
#[derive(Serialize)]
struct Figures<'a> {
    camera: &'a str,
    iso: Option<f64>,
    black_dn: f64,
    black_error_dn: f64,
    blacks_dn: [f64; 4],
    white_dn: f64,
    read_noise_dn: f64,
    read_noise_by_flats_dn: f64,
    read_noise_electrons: f64,
    electrons_per_dn: f64,
    electrons_per_dn_error: f64,
    electrons_per_dn_rgb: [f64; 3],
    full_well_electrons: f64,
    tiles: usize,
    scatter: f64,
    shading: Option<Shading<'a>>,
    warnings: Vec<String>,
}

/// The relative illumination in them.
#[derive(Serialize)]
struct Shading<'a> {
    centre_px: [f64; 2],
    rms: f64,
    illumination: &'a Rings,
}

impl Listing<'_> {
    /// Variance over mean: tiles as dots, the line of all as dashes.
    fn svg(&self) -> String {
        let measured = self.measured;
        let points = |channel: usize| -> Vec<[f64; 2]> {
            let own: Vec<[f64; 2]> =
                measured.points.iter().filter(|p| p.channel == channel).map(|p| [p.mean, p.variance]).collect();
            let step = own.len().div_ceil(DRAWN).max(1);
            own.into_iter().step_by(step).collect()
        };
        // In the order of the plot's own hues.
        let mut series: Vec<Series> = [(2, "blue"), (1, "green"), (0, "red")]
            .map(|(k, name)| Series { name: name.into(), points: points(k), mark: Mark::Dots })
            .into();
        let most = measured.points.iter().map(|p| p.mean).fold(1.0, f64::max);
        let line = (0..=60).map(|k| most * 10f64.powf(f64::from(k) / 20.0 - 3.0));
        let variance = |m: f64| measured.read_dn.value.powi(2) + m / measured.gain[3].value;
        let name = format!("{} e⁻/DN", significant(measured.gain[3].value, 4));
        series.push(Series { name, points: line.map(|m| [m, variance(m)]).collect(), mark: Mark::Line });
        let plot = Plot {
            title: format!("Photon transfer of {}", self.sensor.name),
            x_label: "mean above black, DN".into(),
            y_label: "variance over exposures, DN²".into(),
            x_scale: isoplanat::report::plot::Scale::Log,
            y_scale: isoplanat::report::plot::Scale::Log,
            series,
            ..Plot::default()
        };
        plot.to_svg()
    }

    fn csv(&self) -> String {
        let mut table = Table::new(["channel", "mean_dn", "variance_dn2", "pixels"]);
        for p in &self.measured.points {
            let channel = ["R", "G", "B"][p.channel].to_owned();
            table.row([channel, significant(p.mean, 7), significant(p.variance, 7), p.pixels.to_string()]);
        }
        table.csv()
    }

    fn json(&self) -> serde_json::Value {
        let (m, s) = (self.measured, self.sensor);
        numbered(&Figures {
            camera: &s.name,
            iso: self.camera.iso,
            black_dn: m.black.value,
            black_error_dn: m.black.error,
            blacks_dn: m.blacks,
            white_dn: m.white,
            read_noise_dn: m.read_dn.value,
            read_noise_by_flats_dn: m.read_by_flats_dn,
            read_noise_electrons: s.read_noise_electrons,
            electrons_per_dn: m.gain[3].value,
            electrons_per_dn_error: m.gain[3].error,
            electrons_per_dn_rgb: [0, 1, 2].map(|k| m.gain[k].value),
            full_well_electrons: s.full_well_electrons,
            tiles: m.points.len(),
            scatter: m.scatter,
            shading: self.shading.map(|s| Shading {
                centre_px: s.centre_px,
                rms: s.rms,
                illumination: &s.illumination,
            }),
            warnings: m.warnings(),
        })
    }
}

impl fmt::Display for Listing<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (m, s) = (self.measured, self.sensor);
        let with_error =
            |v: f64, error: f64, unit: &str| format!("{} ± {} {unit}", significant(v, 5), significant(error, 2));
        writeln!(f, "camera       {}{}", in_line(&s.name), self.camera.settings())?;
        writeln!(f, "black        {}", with_error(m.black.value, m.black.error, "DN"))?;
        writeln!(f, "white        {} DN", m.white)?;
        writeln!(f, "gain         {}", with_error(m.gain[3].value, m.gain[3].error, "electrons a DN"))?;
        let colours = [0, 1, 2].map(|k| with_error(m.gain[k].value, m.gain[k].error, "").trim().to_owned());
        writeln!(f, "  R, G, B    {}", colours.join(", "))?;
        writeln!(
            f,
            "read noise   {} = {} electrons (the flats' line ends at {} DN)",
            with_error(m.read_dn.value, m.read_dn.error, "DN"),
            significant(s.read_noise_electrons, 4),
            significant(m.read_by_flats_dn, 3)
        )?;
        writeln!(f, "full well    {} electrons between black and white", significant(s.full_well_electrons, 5))?;
        writeln!(f, "line         {} tiles, {} times as far off as chance", m.points.len(), significant(m.scatter, 3))?;
        if let Some(shading) = self.shading {
            let last = |v: &[f64]| significant(v.last().copied().unwrap_or(1.0), 3);
            let rings = &shading.illumination;
            let corners = [&rings.red, &rings.green, &rings.blue].map(|v| last(v));
            writeln!(
                f,
                "corner light {} of the centre's (R, G, B); {} % rms of the frame is no ring about column {}, row {}",
                corners.join(", "),
                significant(100.0 * shading.rms, 2),
                significant(shading.centre_px[0], 6),
                significant(shading.centre_px[1], 6)
            )?;
        }
        Ok(())
    }
}
