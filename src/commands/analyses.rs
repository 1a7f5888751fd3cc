//! `isoplanat mtf`, `spot` and `distortion`: one analysis of the report by itself.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::analysis::overview::{Field, Overview};
use isoplanat::atomic::Target;
use isoplanat::lens::Lens;
use isoplanat::math::npz;
use isoplanat::report::lens::analysis::{Analysis, Asked, Refused, Shown};
use isoplanat::report::lens::{Options, plots_csv, spot_svg, spot_table};
use isoplanat::report::table::{Table, numbered, significant};
use isoplanat::{Error, Result};

use crate::named::Named;
use crate::output::Common;

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
    /// Field angles, degrees, with commas between [default: three to twelve that the file states, or five from the axis to the largest]
    #[arg(long, value_name = "DEG,DEG", value_delimiter = ',', conflicts_with = "max_angle_deg")]
    fields_deg: Vec<f64>,
    /// Highest frequency of the MTF, cycles/mm [default: the sensor's Nyquist frequency]
    #[arg(long, allow_negative_numbers = true, value_name = "CY/MM")]
    max_cycles_per_mm: Option<f64>,
    /// Frequencies of the MTF's table, cycles/mm, with commas between; curves go as far as the highest [default: even ones]
    #[arg(long, value_name = "CY/MM,…", value_delimiter = ',', allow_negative_numbers = true)]
    cycles_per_mm: Vec<f64>,
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

    /// Whether fields go as far as there are any.
    fn all_fields(&self) -> bool {
        self.max_angle_deg.is_none() && self.fields_deg.is_empty()
    }

    /// The checked options; kernels are grey.
    pub(crate) fn options(&self) -> Result<Options> {
        let Self { max_angle_deg, max_cycles_per_mm, shift_mm, .. } = *self;
        let (fields_deg, cycles_per_mm) = (self.fields_deg.clone(), self.cycles_per_mm.clone());
        let rays = self.rays as usize;
        let asked = Asked { rays, fields_deg, max_angle_deg, max_cycles_per_mm, cycles_per_mm, shift_mm };
        asked.options(crate::memory::limit()).map_err(|Refused { name, found, allowed }| {
            Error::bad(format!("--{}", name.replace('_', "-")), "value", found.to_string(), allowed)
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
struct Figures<'a> {
    name: &'a str,
    #[serde(flatten)]
    shown: Shown,
}

/// Runs the command; figures go to `out`.
pub(crate) fn run(analysis: Analysis, args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    crate::output::check_all(&[args.svg.as_deref(), args.csv.as_deref(), args.npz.as_deref()], args.common.force)?;
    let options = args.view.options()?;
    let lens = args.view.lens(&args.lens)?;
    // A spot of each of five fields and every wavelength; curves take far less.
    let rays = if analysis == Analysis::Distortion { 0 } else { 5 * lens.wavelengths.nm.len() * options.rays };
    let waiting = crate::long::waiting(analysis.name(), &lens, rays);
    let found = analysis.of(&lens, &options);
    drop(waiting);
    if let Some(path) = &args.svg {
        let drawing = if analysis == Analysis::Spot { spot_svg(&found.overview) } else { found.curves[0].1.to_svg() };
        crate::output::put(&drawing, Some(path), args.common.force, out)?;
    }
    if let Some(path) = &args.csv {
        crate::output::put(&plots_csv(&found.curves), Some(path), args.common.force, out)?;
    }
    if let Some(path) = &args.npz {
        let all = analysis.arrays(&found.overview);
        npz::write(Target::new(path, args.common.force), |npz| {
            npz.add_array("schema", &ndarray::arr0(1_i64))?;
            all.iter().try_for_each(|(name, array)| npz.add_array(*name, array))
        })?;
    }
    if args.common.json {
        writeln!(out, "{}", numbered(&Figures { name: &lens.name, shown: found.shown() }))?;
        return Ok(());
    }
    found.missing.iter().for_each(|m| crate::aside!("note: {}: {m}", lens.file()));
    let o = &found.overview;
    if analysis == Analysis::Mtf {
        writeln!(out, "MTF of rays, on the sensor; T tangential, S sagittal")?;
    }
    write!(out, "{}", table(analysis, o))?;
    match analysis {
        Analysis::Mtf if o.fields.iter().any(|f| matches!(f.diffraction, Some(Ok(_)))) => {
            write!(out, "\nMTF by diffraction\n{}", mtf_table(o, |field, k| by_waves(o, field, k)))?;
        }
        Analysis::Spot => {
            if let Some(text) = sampled(o) {
                writeln!(out, "{text}")?;
            }
        }
        _ => {}
    }
    let (shown, stated) = (o.settings.angles_deg.last().copied().unwrap_or(0.0), lens.max_field_deg());
    if args.view.all_fields() && shown < stated * (1.0 - ENDS) {
        let [shown, stated] = [shown, stated].map(|angle| significant(angle, 4));
        writeln!(out, "fields end with sensor or light, at {shown}°; --max-angle-deg {stated} takes the stated field")?;
    }
    Ok(())
}

/// Parts of the stated field that fields may end before without a word.
const ENDS: f64 = 1e-3;

/// A number, or a dash where there is none.
fn figure(value: f64, words: impl Fn(f64) -> String) -> String {
    if value.is_finite() { words(value) } else { "–".to_owned() }
}

/// Its figures.
fn table(analysis: Analysis, o: &Overview) -> Table {
    match analysis {
        Analysis::Spot => spot_table(o),
        Analysis::Distortion => {
            let mut table = Table::new(["field/deg", "image height/mm", "distortion/%", "of f tan θ/%"]);
            for r in &o.curve {
                let [axis, focal] = [r.distortion_percent, r.distortion_of_focal_length]
                    .map(|percent| figure(percent, |v| significant(v, 5)));
                table.row([significant(r.angle_deg, 5), significant(r.height, 7), axis, focal]);
            }
            table
        }
        Analysis::Mtf => mtf_table(o, |field, k| field.mtf[k]),
    }
}

/// MTF on the sensor by frequency, tangential and sagittal of each field, as `of` a field and the number of a frequency gives them.
fn mtf_table(o: &Overview, of: impl Fn(&Field, usize) -> [f64; 2]) -> Table {
    let angle = |f: &Field| significant(f.angle_deg, 4);
    let names = o.fields.iter().flat_map(|f| [format!("{}° T", angle(f)), format!("{}° S", angle(f))]);
    let mut table = Table::new(std::iter::once("cycles/mm".to_owned()).chain(names));
    let asked = &o.settings.asked_cycles_per_mm;
    for (k, f) in o.cycles_per_mm.iter().enumerate().filter(|(_, f)| asked.is_empty() || asked.contains(f)) {
        let values = o.fields.iter().flat_map(|field| of(field, k)).map(|v| figure(v, |v| format!("{v:.4}")));
        table.row(std::iter::once(significant(*f, 5)).chain(values));
    }
    table
}

/// MTF by diffraction on the sensor; not numbers where there is none.
fn by_waves(o: &Overview, field: &Field, k: usize) -> [f64; 2] {
    let Some(Ok(mtf)) = &field.diffraction else { return [f64::NAN; 2] };
    [0, 1].map(|d| mtf.curves.get(d).and_then(|c| c.modulus(o.shifts_mm.len() / 2, k)).unwrap_or(f64::NAN))
}

/// What the sampling of spots leaves open: the most that the rms of a quarter of the rays differs by, where that is a part of it worth telling.
fn sampled(o: &Overview) -> Option<String> {
    const TOLD: f64 = 0.01;
    let most = o.fields.iter().filter_map(|f| f.rms).map(|r| r.change / r.value).fold(0.0, f64::max);
    let rays = o.settings.rays;
    (most > TOLD && most.is_finite()).then(|| {
        let percent = significant(100.0 * most, 2);
        format!("rms of {rays} rays a wavelength: {percent} % from that of {} at most; --rays takes more", rays / 4)
    })
}
