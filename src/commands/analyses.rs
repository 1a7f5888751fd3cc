//! `isoplanat mtf`, `spot` and `distortion`: one analysis of the report by itself.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::analysis::overview::Overview;
use isoplanat::atomic::Target;
use isoplanat::lens::Lens;
use isoplanat::math::npz;
use isoplanat::report::lens::{
    Options, SHIFTS, SpotRow, arrays, look, plots, plots_csv, plots_json, spot_rows, spot_svg, spot_table,
};
use isoplanat::report::plot::Plot;
use isoplanat::report::table::{Table, numbered, significant};
use isoplanat::{Error, Result};
use serde_json::Value;

use crate::named::Named;
use crate::output::Common;

/// Which analysis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// MTF of rays and by diffraction against frequency, field and focus.
    Mtf,
    /// Spots by field.
    Spot,
    /// Distortion over the field.
    Distortion,
}

/// What every look at a lens's rays can be told.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct View {
    /// Object distance before the first surface, mm; `inf` is allowed [default: the lens's own]
    #[arg(long, allow_negative_numbers = true, value_name = "MM")]
    depth_mm: Option<f64>,
    #[command(flatten)]
    f_number: crate::input::FNumber,
    /// Largest field angle, degrees [default: where sensor, stated field or light end]
    #[arg(long, allow_negative_numbers = true, value_name = "DEG")]
    max_angle_deg: Option<f64>,
    /// Highest frequency of the MTF, cycles/mm [default: the sensor's Nyquist frequency]
    #[arg(long, allow_negative_numbers = true, value_name = "CY/MM")]
    max_cycles_per_mm: Option<f64>,
    /// Largest shift of the image plane, mm [default: from the foci of the fields]
    #[arg(long, allow_negative_numbers = true, value_name = "MM")]
    shift_mm: Option<f64>,
    /// Rays of a spot and wavelength
    #[arg(long, default_value_t = 1600, value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    rays: u32,
}

impl View {
    /// The lens called `named`, with its object where it was asked for.
    pub(crate) fn lens(&self, named: &(impl AsRef<Path> + ?Sized)) -> Result<Lens> {
        let name = &named.as_ref().display().to_string();
        let lens = self.f_number.applied(crate::input::lens(named)?, name)?;
        match self.depth_mm {
            None => Ok(lens),
            Some(depth) if depth > 0.0 => lens.changed(|l| l.object_vergence = 1.0 / depth),
            Some(depth) => Err(Error::bad("--depth-mm", "value", depth.to_string(), "a positive distance, or inf")),
        }
    }

    /// The checked options; kernels are grey.
    pub(crate) fn options(&self) -> Result<Options> {
        let within = |flag: &str, value: Option<f64>, allowed: std::ops::RangeInclusive<f64>, words: &str| match value {
            Some(v) if !allowed.contains(&v) => Err(Error::bad(flag, "value", v.to_string(), words)),
            _ => Ok(value),
        };
        Ok(Options {
            rays: self.rays as usize,
            max_angle_deg: within("--max-angle-deg", self.max_angle_deg, 0.0..=120.0, "0 to 120 degrees")?,
            cycles_per_mm: within("--max-cycles-per-mm", self.max_cycles_per_mm, 1e-3..=1e5, "0.001 to 100000")?,
            shift_mm: within("--shift-mm", self.shift_mm, 1e-6..=1e3, "1e-6 to 1000 mm")?,
            shifts: SHIFTS,
            whole: true,
            energy: true,
            colour: false,
            psf_depths_mm: Vec::new(),
            memory: crate::memory::limit(),
        })
    }
}

/// Arguments of the single analyses.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), or the name of a shipped lens
    lens: Named,
    /// The same as a drawing
    #[arg(long, value_name = "OUT.svg")]
    svg: Option<PathBuf>,
    /// The curves as comma-separated values
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    /// The numbers as NumPy arrays
    #[arg(long, value_name = "OUT.npz")]
    npz: Option<PathBuf>,
    #[command(flatten)]
    view: View,
    #[command(flatten)]
    common: Common,
}

/// The result as JSON has it.
#[derive(serde::Serialize)]
struct Shown<'a> {
    name: &'a str,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    fields: Vec<SpotRow>,
    plots: Value,
    missing: Vec<String>,
}

/// Runs the command; figures go to `out`.
pub(crate) fn run(kind: Kind, args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    crate::output::check_all(&[args.svg.as_deref(), args.csv.as_deref(), args.npz.as_deref()], args.common.force)?;
    // Spots need no maps and no MTF by diffraction, distortion no waves at all.
    let options = Options { whole: kind == Kind::Mtf, energy: kind == Kind::Spot, ..args.view.options()? };
    let lens = args.view.lens(&args.lens)?;
    // A spot of each of five fields and every wavelength; curves take far less.
    let rays = 5 * lens.wavelengths.nm.len() * options.rays;
    let waiting = crate::long::waiting(kind.name(), &lens, rays);
    let (overview, missing) = look(&lens, &options);
    drop(waiting);
    let curves: Vec<(&'static str, Plot)> = plots(&overview).into_iter().filter(|(n, _)| kind.shows(n)).collect();
    if let Some(path) = &args.svg {
        let drawing = if kind == Kind::Spot { spot_svg(&overview) } else { curves[0].1.to_svg() };
        crate::output::put(&drawing, Some(path), args.common.force, out)?;
    }
    if let Some(path) = &args.csv {
        crate::output::put(&plots_csv(&curves), Some(path), args.common.force, out)?;
    }
    if let Some(path) = &args.npz {
        save(kind, &overview, Target::new(path, args.common.force))?;
    }
    if args.common.json {
        let fields = if kind == Kind::Distortion { Vec::new() } else { spot_rows(&overview) };
        let shown = Shown { name: &lens.name, fields, plots: plots_json(&curves), missing };
        writeln!(out, "{}", numbered(&shown))?;
        return Ok(());
    }
    missing.iter().for_each(|m| crate::tell!("note: {}: {m}", lens.file()));
    write!(out, "{}", kind.table(&overview))?;
    Ok(())
}

/// A number, or a dash where there is none.
fn figure(value: f64, words: impl Fn(f64) -> String) -> String {
    if value.is_finite() { words(value) } else { "–".to_owned() }
}

impl Kind {
    /// What runs.
    fn name(self) -> &'static str {
        match self {
            Self::Mtf => "mtf",
            Self::Spot => "spot",
            Self::Distortion => "distortion",
        }
    }

    /// Whether the plot `name` belongs to it.
    fn shows(self, name: &str) -> bool {
        match self {
            Self::Mtf => name.starts_with("mtf"),
            Self::Spot => ["rms_focus", "encircled_energy"].contains(&name),
            Self::Distortion => name == "distortion",
        }
    }

    /// Its figures.
    fn table(self, o: &Overview) -> Table {
        match self {
            Self::Spot => spot_table(o),
            Self::Distortion => {
                let mut table = Table::new(["field/deg", "image height/mm", "distortion/%", "of f tan θ/%"]);
                for r in &o.curve {
                    let [axis, focal] = [r.distortion_percent, r.distortion_of_focal_length]
                        .map(|percent| figure(percent, |v| significant(v, 5)));
                    table.row([significant(r.angle_deg, 5), significant(r.height, 7), axis, focal]);
                }
                table
            }
            Self::Mtf => {
                let angle = |f: &isoplanat::analysis::overview::Field| significant(f.angle_deg, 4);
                let names = o.fields.iter().flat_map(|f| [format!("{}° T", angle(f)), format!("{}° S", angle(f))]);
                let mut table = Table::new(std::iter::once("cycles/mm".to_owned()).chain(names));
                for (k, f) in o.cycles_per_mm.iter().enumerate() {
                    let values =
                        o.fields.iter().flat_map(|field| field.mtf[k]).map(|v| figure(v, |v| format!("{v:.4}")));
                    table.row(std::iter::once(significant(*f, 5)).chain(values));
                }
                table
            }
        }
    }
}

/// Writes the numbers of `kind` under their names.
fn save(kind: Kind, o: &Overview, to: Target<'_>) -> Result<()> {
    let all = match kind {
        Kind::Mtf => arrays::mtf(o),
        Kind::Spot => arrays::spot(o),
        Kind::Distortion => arrays::distortion(o),
    };
    npz::write(to, |npz| {
        npz.add_array("schema", &ndarray::arr0(1_i64))?;
        all.iter().try_for_each(|(name, array)| npz.add_array(*name, array))
    })
}
