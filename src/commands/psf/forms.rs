//! `isoplanat psf --form heights|grid|filters`: kernels in the colours of a sensor, in the forms that other programs train and restore with.

use std::io::Write;
use std::path::PathBuf;

use isoplanat::atomic::Target;
use isoplanat::imaging::files::write_png8;
use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::render::frame_of;
use isoplanat::imaging::render::psf_map::{PsfMap, PsfMapRequest, PsfPlaces};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::Lens;
use isoplanat::math::memory::words;
use isoplanat::report::atlas;
use isoplanat::report::columns::{self, Column};
use isoplanat::report::table::{numbered, significant};
use isoplanat::{Error, Result};
use serde::Serialize;
use serde_json::Value;

/// What the file is to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Form {
    /// Kernels of single wavelengths over depth and field: for whoever has spectra of his own
    Wavelengths,
    /// RGB kernels at image heights from the axis to the frame's corner, with illumination and distortion: one lens of a training set
    Heights,
    /// RGB kernels on a grid over the frame
    Grid,
    /// Filters and multipliers of a space-varying blur over the frame
    Filters,
}

/// Options of the forms over a frame.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct FrameArgs {
    /// Pixels in a row (heights, grid, filters) [default: the lens's sensor]
    #[arg(long)]
    columns: Option<usize>,
    /// Rows (heights, grid, filters) [default: the lens's sensor]
    #[arg(long)]
    rows: Option<usize>,
    /// Rows and columns of kernels (grid; filters, where they otherwise stand as interpolation needs them) [default of grid: 9,9]
    #[arg(long, value_name = "ROWS,COLUMNS", value_parser = two)]
    grid: Option<[usize; 2]>,
    /// Relative error of a kernel between its neighbours (filters) [default: 0.05]
    #[arg(long, value_name = "ERROR", conflicts_with = "grid")]
    node_error: Option<f64>,
    /// Sensor calibration whose colours these are (heights, grid, filters) [default: the generic sensor]
    #[arg(long, value_name = "SENSOR.toml")]
    calibration: Option<PathBuf>,
    #[command(flatten)]
    light: crate::input::Light,
}

/// Two whole numbers between commas.
fn two(text: &str) -> std::result::Result<[usize; 2], String> {
    let numbers: Option<Vec<usize>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    numbers.and_then(|n| n.try_into().ok()).ok_or_else(|| "two whole numbers: ROWS,COLUMNS".into())
}

/// One kernel's line.
struct Row {
    place: [Option<isize>; 2],
    height_mm: f64,
    distortion: f64,
    illumination: f64,
    outside: f64,
}

fn pixel(at: Option<isize>) -> String {
    at.map_or_else(String::new, |v| v.to_string())
}

/// Columns of the summary; the outside is the most of any channel.
const COLUMNS: &[Column<Row>] = &[
    Column::text("row", "row_px", |r| pixel(r.place[0])),
    Column::text("column", "col_px", |r| pixel(r.place[1])),
    Column::figure("height/mm", "height_mm", 6, |r| r.height_mm),
    Column::both(
        "distortion/%",
        "distortion",
        |r| format!("{:.3}", 100.0 * r.distortion),
        |r| r.distortion.to_string(),
    ),
    Column::both(
        "relative illumination",
        "relative_illumination",
        |r| format!("{:.4}", r.illumination),
        |r| r.illumination.to_string(),
    ),
    Column::both("outside/%", "outside", |r| format!("{:.3}", 100.0 * r.outside), |r| r.outside.to_string()),
];
/// Rows that are printed, at most; all are in the file of `--csv`.
const PRINTED: usize = 64;

/// Refuses options that belong to other forms.
pub(super) fn check(args: &super::Args) -> Result<()> {
    let refuse = |option: &str, forms: &str| {
        let found = format!("given with --form {}", name(args.form));
        Err(Error::bad(option, "form", found, format!("with --form {forms}")))
    };
    let o = &args.over;
    if args.form == Form::Wavelengths {
        let given = [
            ("--columns", o.columns.is_some()),
            ("--rows", o.rows.is_some()),
            ("--calibration", o.calibration.is_some()),
            ("--illuminant", o.light.illuminant != isoplanat::imaging::sensor::illuminant::Illuminant::default()),
        ];
        if let Some((option, _)) = given.iter().find(|(_, given)| *given) {
            return refuse(option, "heights, grid or filters");
        }
    } else if !args.wavelength_nm.is_empty() {
        return refuse("--wavelength-nm", "wavelengths: others are in the colours of the sensor");
    } else if args.depth_mm.len() > 1 {
        let found = format!("{} distances", args.depth_mm.len());
        return Err(Error::bad("--depth-mm", "value", found, format!("one with --form {}", name(args.form))));
    }
    match args.form {
        Form::Wavelengths | Form::Heights if o.grid.is_some() => refuse("--grid", "grid or filters"),
        Form::Wavelengths | Form::Heights | Form::Grid if o.node_error.is_some() => refuse("--node-error", "filters"),
        Form::Grid | Form::Filters if args.fields.is_some() => refuse("--fields", "wavelengths or heights"),
        _ => Ok(()),
    }
}

fn name(form: Form) -> String {
    use clap::ValueEnum;
    form.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned())
}

/// Runs the command for a form over a frame.
pub(super) fn run(args: &super::Args, lens: Lens, out: &mut dyn Write) -> anyhow::Result<()> {
    let o = &args.over;
    let sensor = o.calibration.as_deref().map_or_else(|| Ok(Sensor::generic()), Sensor::load)?;
    let density = SpectralDensity::under(&sensor, o.light.illuminant)?;
    crate::input::in_band(&lens, &density, &args.lens)?;
    let frame = frame(args, &lens)?;
    let heights = usize::from(args.fields.unwrap_or(64));
    let places = match (args.form, o.grid) {
        (Form::Grid, grid) => PsfPlaces::Grid(grid.unwrap_or([9, 9])),
        (Form::Filters, Some(grid)) => PsfPlaces::Filters(grid),
        (Form::Filters, None) => PsfPlaces::Nodes(o.node_error.unwrap_or(0.05)),
        _ => PsfPlaces::Heights(heights),
    };
    let own = PsfMapRequest::new(&lens, places);
    let request = PsfMapRequest {
        vergence: args.depth_mm.first().map_or(lens.object_vergence, |d| d.recip()),
        size: args.size.map(usize::from),
        rays: args.rays as usize,
        diffraction: args.diffraction,
        memory: crate::memory::limit(),
        ..own
    };
    let map = PsfMap::compute(&lens, &frame, &density, &request)?;
    map.save(Target::new(&args.output, args.common.force))?;
    if let Some(path) = &args.png {
        let across = map.grid.as_ref().map_or(8, |g| g.col_knots.len());
        let picture = atlas::picture(&map.kernels, across, atlas::Style::default());
        write_png8(Target::new(path, args.common.force), &picture)?;
    }
    let rows = rows(&map);
    if let Some(path) = &args.csv {
        crate::output::put(&columns::csv(COLUMNS, &rows), Some(path), args.common.force, out)?;
    }
    let (count, _, size, _) = map.kernels.dim();
    if args.common.json {
        let figures = Figures {
            form: name(args.form),
            kernels: count,
            size_px: size,
            pitch_um: frame.pitch_mm * 1e3,
            columns: frame.columns,
            rows: frame.rows,
            distance_mm: distance(request.vergence),
            diffraction: map.diffraction.as_ref().map(super::Told::from),
            places: rows.iter().map(PlaceFigures::from).collect(),
        };
        writeln!(out, "{}", numbered(&figures))?;
        return Ok(());
    }
    let shown = &rows[..rows.len().min(PRINTED)];
    // Image heights stand on no pixel.
    let used = if map.grid.is_some() { COLUMNS } else { &COLUMNS[2..] };
    write!(out, "{}", columns::table(used, shown))?;
    if rows.len() > shown.len() {
        writeln!(out, "… {} more; --csv has all", rows.len() - shown.len())?;
    }
    writeln!(
        out,
        "{count} kernels of {size} × {size} pixels of {} µm, three channels",
        significant(frame.pitch_mm * 1e3, 6)
    )?;
    if let Some(figures) = &map.diffraction {
        writeln!(out, "{}", super::told(figures))?;
    }
    if matches!(args.form, Form::Filters) {
        let bytes = (count * 3 * frame.rows * frame.columns * size_of::<f32>()) as u64;
        writeln!(out, "multipliers: {count} × 3 × {} × {}, {}", frame.rows, frame.columns, words(bytes))?;
    }
    Ok(())
}

/// A distance as JSON has it.
fn distance(vergence: f64) -> Value {
    if vergence == 0.0 { Value::from("inf") } else { Value::from(vergence.recip()) }
}

/// Everything, for machines.
#[derive(Serialize)]
struct Figures {
    form: String,
    kernels: usize,
    size_px: usize,
    pitch_um: f64,
    columns: usize,
    rows: usize,
    distance_mm: Value,
    diffraction: Option<super::Told>,
    places: Vec<PlaceFigures>,
}

#[derive(Serialize)]
struct PlaceFigures {
    row_px: Option<isize>,
    col_px: Option<isize>,
    height_mm: f64,
    distortion: f64,
    relative_illumination: f64,
    outside: f64,
}

impl From<&Row> for PlaceFigures {
    fn from(row: &Row) -> Self {
        let Row { place: [row_px, col_px], height_mm, distortion, illumination, outside } = *row;
        Self { row_px, col_px, height_mm, distortion, relative_illumination: illumination, outside }
    }
}

fn rows(map: &PsfMap) -> Vec<Row> {
    let white = map.white();
    let one = |k: usize| {
        let pixel = map.grid.as_ref().map(|g| g.pixel(k));
        Row {
            place: [pixel.map(|p| p.0), pixel.map(|p| p.1)],
            height_mm: map.height_mm[k],
            distortion: map.distortion[k],
            illumination: white[k],
            outside: map.outside.row(k).fold(0.0, |m: f64, x| m.max(*x)),
        }
    };
    (0..map.height_mm.len()).map(one).collect()
}

/// The frame of the command line: the lens's own, or another size about its middle.
fn frame(args: &super::Args, lens: &Lens) -> Result<Frame> {
    let (own, o) = (frame_of(lens)?, &args.over);
    let pitch_mm = args.pitch_um.map_or(own.pitch_mm, |um| um * 1e-3);
    let (columns, rows) = (o.columns.unwrap_or(own.columns), o.rows.unwrap_or(own.rows));
    if [columns, rows] == [own.columns, own.rows] {
        return Frame::centred(columns, rows, pitch_mm)?.with_axis(own.axis_px);
    }
    Frame::centred(columns, rows, pitch_mm).map_err(|e| e.in_file("--columns, --rows, --pitch-um"))
}
