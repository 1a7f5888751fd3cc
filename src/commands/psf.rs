//! `isoplanat psf`: kernels over depth, field and wavelength as `.npz`, and as one picture; over a frame in the colours of a sensor (`forms`).

mod forms;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write;
use std::path::PathBuf;

use isoplanat::atomic::Target;
use isoplanat::imaging::files::write_png8;
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::Lens;
use isoplanat::math::memory::words;
use isoplanat::psf::bent::WaveFigures;
use isoplanat::report::atlas;
use isoplanat::report::table::{Table, numbered, significant};
use isoplanat::{Error, Result};
use serde::Serialize;

use crate::named::Named;
use crate::output::Common;

/// Arguments of `psf`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), or the name of a shipped lens
    lens: Named,
    /// Where to put the kernels (NumPy `.npz`)
    #[arg(short, long, value_name = "OUT.npz")]
    output: PathBuf,
    /// What the file is to be
    #[arg(long, value_enum, default_value_t = forms::Form::Wavelengths)]
    form: forms::Form,
    /// Also draw them, in the colours of the sensor: one row a depth, one column a field, or as they stand over the frame
    #[arg(long, value_name = "OUT.png")]
    png: Option<PathBuf>,
    /// Object distances before the first surface, mm, comma separated; `inf` is allowed [default: the lens's own]
    #[arg(long, value_delimiter = ',', allow_negative_numbers = true, value_name = "MM")]
    depth_mm: Vec<f64>,
    /// Wavelengths of equal weight, nm, comma separated [default: the lens's own, by their weights]
    #[arg(long, value_delimiter = ',', allow_negative_numbers = true, value_name = "NM")]
    wavelength_nm: Vec<f64>,
    #[command(flatten)]
    f_number: crate::input::FNumber,
    /// Field points from the axis to the border; image heights to the frame's corner [default: 5; of heights 64]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=512))]
    fields: Option<u16>,
    /// Kernel size, pixels, odd [default: what holds 99.9 % of the light of rays; by diffraction ten λ/NA more at each side]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=2047))]
    size: Option<u16>,
    /// Pixel pitch, µm [default: the lens's sensor]
    #[arg(long, allow_negative_numbers = true, value_name = "UM")]
    pitch_um: Option<f64>,
    /// Rays per kernel and wavelength
    #[arg(long, default_value_t = 16384, value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    rays: u32,
    /// Kernels by diffraction, in place of rays: scalar waves, every wavelength by itself
    #[arg(long)]
    diffraction: bool,
    /// Rows of the summary to write as comma-separated values
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    over: forms::FrameArgs,
    #[command(flatten)]
    common: Common,
}

/// Runs the command; a summary goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    crate::output::check_all(&[Some(&*args.output), args.png.as_deref(), args.csv.as_deref()], args.common.force)?;
    forms::check(args)?;
    let lens = args.f_number.applied(crate::input::lens(&args.lens)?, &args.lens)?;
    let request = request(args, &lens)?;
    if args.form != forms::Form::Wavelengths {
        return forms::run(args, lens, out);
    }
    if args.png.is_some() {
        crate::input::in_band(&lens, &SpectralDensity::new(&Sensor::generic()), &args.lens)?;
    }
    let waiting = crate::long::waiting("psf", &lens, RADII * request.wavelength_nm.len() * NODES);
    let kernels = atlas::KernelSet::compute(&lens, &request)?;
    drop(waiting);
    kernels.save(Target::new(&args.output, args.common.force))?;
    if let Some(path) = &args.png {
        let columns = kernels.request.fields;
        let colours = atlas::colour_kernels(&lens, &request)?.kernels;
        write_png8(Target::new(path, args.common.force), &atlas::picture(&colours, columns, atlas::Style::default()))?;
    }
    if let Some(text) = &kernels.untold {
        crate::tell!("warning: {}: {text}", args.lens);
    }
    let rows = rows(&kernels);
    let names = if kernels.energy.is_some() { &COLUMNS[..] } else { &COLUMNS[..OF_RAYS] };
    if let Some(path) = &args.csv {
        let mut table = Table::new(names.iter().copied());
        for row in &rows {
            table.row(row.iter().map(f64::to_string));
        }
        crate::output::put(&table.csv(), Some(path), args.common.force, out)?;
    }
    let (size, nm) = (kernels.kernels.len_of(ndarray::Axis(3)), request.wavelength_nm.len());
    let count = request.depth_mm.len() * kernels.request.fields;
    let drawn = if args.png.is_some() { 4 * atlas::bytes(count, 3, size) } else { 0 };
    let bytes = atlas::bytes(count, nm, size).saturating_add(drawn).saturating_add(kernels.making);
    if args.common.json {
        let figures = Figures {
            size_px: size,
            pitch_um: request.pitch_mm * 1e3,
            wavelength_nm: &request.wavelength_nm,
            weight: &request.weights,
            memory_bytes: bytes,
            diffraction: kernels.diffraction.as_ref().map(Told::from),
            rows: rows.iter().map(|row| names.iter().copied().zip(row.iter().copied()).collect()).collect(),
        };
        writeln!(out, "{}", numbered(&figures))?;
        return Ok(());
    }
    let mut table = Table::new(SHOWN.iter().take(names.len()).copied());
    let dash = |v: f64, text: String| if v.is_finite() { text } else { "–".to_owned() };
    for row in &rows {
        let cell = |(k, v): (usize, &f64)| match k {
            0 => significant(*v, 6),
            1 => format!("{v:.3}"),
            4 => format!("{:.3}", 100.0 * v),
            5 => dash(*v, format!("{v:.4}")),
            6.. => dash(*v, significant(1e3 * v, 4)),
            _ => format!("{v:.4}"),
        };
        table.row(row.iter().enumerate().map(cell));
    }
    write!(out, "{table}")?;
    writeln!(out, "{size} × {size} pixels of {} µm, {nm} wavelengths", significant(request.pitch_mm * 1e3, 6))?;
    if let Some(figures) = &kernels.diffraction {
        writeln!(out, "{}", told(figures))?;
    }
    writeln!(out, "memory: at most {}", words(bytes))?;
    Ok(())
}

/// What is told of kernels by diffraction.
fn told(figures: &WaveFigures) -> String {
    let WaveFigures { residual_waves, spread, aperture, geometric, unfollowed } = figures;
    let of_rays = "their blur has hundreds of waves, or their pixels are hundreds of λ/NA wide";
    let not_followed = "waves do not tell their light to a tenth, or their paths to a tenth of a wave";
    if *aperture == 0.0 {
        let why = match (geometric, unfollowed) {
            (_, 0) => of_rays.to_owned(),
            (0, _) => not_followed.to_owned(),
            _ => format!("{of_rays}, or {not_followed}"),
        };
        return format!("by diffraction: all kernels are of rays, since {why}");
    }
    let mut text = format!(
        "by diffraction: paths to {residual_waves:.0e} wavelengths; {:.2} % of the light, far from the middle, is spread evenly",
        100.0 * spread
    );
    if *geometric > 0 {
        let _ = write!(text, "; {geometric} kernels of a wavelength are of rays, since {of_rays}");
    }
    if *unfollowed > 0 {
        let _ = write!(text, "; {unfollowed} kernels of a wavelength are of rays, since {not_followed}");
    }
    if *aperture > SCALAR {
        let _ = write!(text, "; the angles at the image reach a sine of {aperture:.2}, where scalar waves err");
    }
    text
}

/// Kernels, for machines.
#[derive(Serialize)]
struct Figures<'a> {
    size_px: usize,
    pitch_um: f64,
    wavelength_nm: &'a [f64],
    weight: &'a [f64],
    memory_bytes: u64,
    diffraction: Option<Told>,
    rows: Vec<BTreeMap<&'a str, f64>>,
}

/// What is told of kernels by diffraction, for machines.
#[derive(Serialize)]
struct Told {
    residual_waves: Option<f64>,
    spread: Option<f64>,
    largest_sine: Option<f64>,
    of_rays: usize,
    unfollowed: usize,
}

impl From<&WaveFigures> for Told {
    fn from(figures: &WaveFigures) -> Self {
        let WaveFigures { residual_waves, spread, aperture, geometric, unfollowed } = *figures;
        // Nothing is known of waves where all kernels are of rays.
        let known = |v: f64| (aperture > 0.0).then_some(v);
        Self {
            residual_waves: known(residual_waves),
            spread: known(spread),
            largest_sine: known(aperture),
            of_rays: geometric + unfollowed,
            unfollowed,
        }
    }
}

/// Sine of an angle at the image beyond which scalar theory is told to err.
const SCALAR: f64 = 0.5;

/// Columns of the summary, and how many there are of rays. The illumination is over all wavelengths by their weights; what falls outside is the most of any. By diffraction there are
/// the Strehl ratio and radii about the centroid that hold 50 and 80 % of the light, before pixels, all wavelengths by weight and light.
const COLUMNS: [&str; 8] = [
    "depth_mm",
    "field_angle_deg",
    "sensor_radius_mm",
    "relative_illumination",
    "outside",
    "strehl",
    "encircled_50_mm",
    "encircled_80_mm",
];
const OF_RAYS: usize = 5;
/// The same as people read them.
const SHOWN: [&str; 8] =
    ["depth/mm", "field/deg", "sensor radius/mm", "relative illumination", "outside/%", "Strehl", "50 %/µm", "80 %/µm"];

/// Rays that kernels are made of: radii, and rays of each at a wavelength.
const RADII: usize = 32;
const NODES: usize = 100;

/// Rows of the summary.
fn rows(set: &atlas::KernelSet) -> Vec<Vec<f64>> {
    let light = set.polychromatic_illumination();
    let row = |((d, f), light): ((usize, usize), &f64)| {
        let lost = set.outside.slice(ndarray::s![d, f, ..]).fold(0.0, |m: f64, x| m.max(*x));
        let mut row = vec![set.request.depth_mm[d], set.angle_deg[[d, f]], set.radius_mm[[d, f]], *light, lost];
        row.extend(set.energy.iter().flat_map(|(strehl, radii)| [strehl[[d, f]], radii[[d, f, 0]], radii[[d, f, 1]]]));
        row
    };
    light.indexed_iter().map(row).collect()
}

/// The checked request.
fn request(args: &Args, lens: &Lens) -> Result<atlas::KernelRequest> {
    let own = |given: &[f64], own: Vec<f64>| if given.is_empty() { own } else { given.to_vec() };
    let depth_mm = own(&args.depth_mm, vec![1.0 / lens.object_vergence]);
    if let Some(d) = depth_mm.iter().find(|d| d.is_nan() || **d <= 0.0) {
        return Err(Error::bad("--depth-mm", "value", d.to_string(), "positive distances, or inf"));
    }
    let (wavelength_nm, weights) = match &args.wavelength_nm[..] {
        [] => lens.wavelengths.shares().unzip(),
        given => (given.to_vec(), vec![1.0; given.len()]),
    };
    if let Some(nm) = wavelength_nm.iter().find(|nm| !(200.0..=20_000.0).contains(*nm)) {
        return Err(Error::bad("--wavelength-nm", "value", nm.to_string(), "200 to 20000 nm"));
    }
    let pitch_um = args.pitch_um.unwrap_or(lens.sensor.pitch_um);
    if !(pitch_um.is_finite() && pitch_um > 0.0) {
        return Err(Error::bad("--pitch-um", "value", pitch_um.to_string(), "a positive number of µm"));
    }
    if let Some(size) = args.size.filter(|s| s % 2 == 0) {
        return Err(Error::bad("--size", "value", size.to_string(), "an odd number of pixels"));
    }
    Ok(atlas::KernelRequest {
        depth_mm,
        wavelength_nm,
        weights,
        fields: usize::from(args.fields.unwrap_or(5)),
        size: args.size.map(usize::from),
        pitch_mm: pitch_um * 1e-3,
        rays: args.rays as usize,
        diffraction: args.diffraction,
        memory: crate::memory::limit(),
    })
}
