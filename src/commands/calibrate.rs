//! `isoplanat calibrate CHART…`: the distortion of a real lens from photographs of a chessboard.

mod listing;
mod psf;

use std::io::Write;
use std::path::{Path, PathBuf};

use glam::DVec2;
use isoplanat::atomic::{Target, write_bytes};
use isoplanat::calibrate::file::MeasuredDistortion;
use isoplanat::calibrate::solve::{Fit, Settings, solve};
use isoplanat::calibrate::{View, chart, doubt};
use isoplanat::imaging::files::{Encoding, PICTURES, extension, write_picture};
use isoplanat::imaging::metrics::slanted_edge::Sites;
use isoplanat::report::table::value;
use isoplanat::{Error, Result};
use ndarray::{Array2, ArrayView2};

use crate::output::Common;
use crate::picture;
use crate::progress::Bar;
use crate::twice;
use listing::{Chart, Listing};

/// Arguments of `calibrate`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Photographs of a chessboard that lies flat (.jpg, .png, .tif; RAW files need the feature `deploy`), all of one size, zoom and focus,
    /// the board tilted to several sides and seen out to the corners; parts of the board count. An orientation in Exif is not applied: it is
    /// the sensor that is calibrated
    #[arg(required = true, value_name = "CHART")]
    charts: Vec<PathBuf>,
    /// The measured distortion, as `isoplanat-camera --distortion` reads it
    #[arg(short, long, value_name = "OUT.toml")]
    out: Option<PathBuf>,
    /// Radial terms: r (1 + k₁ r² + k₂ r⁴ + k₃ r⁶)
    #[arg(long, value_name = "1..3", default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=3))]
    terms: u8,
    /// Centre of distortion: `free`, `middle` of the picture, or column and row in pixels
    #[arg(long, value_name = "CENTRE", default_value = "free", value_parser = centre)]
    centre: Centre,
    /// Focal length in pixels, held [default: fitted]
    #[arg(long, value_name = "F")]
    focal_px: Option<f64>,
    /// Point spread functions over the field, from the board's edges (RAW files tell most; squares of 20 pixels and more)
    #[arg(long, value_name = "OUT.npz")]
    psf: Option<PathBuf>,
    /// The point spread functions as a picture: from the centre (left) outwards, which is up
    #[arg(long, value_name = "OUT", requires = "psf")]
    psf_picture: Option<PathBuf>,
    /// Largest move of light that is looked for, pixels [default: 8, or what the squares allow]
    #[arg(long, value_name = "PX", requires = "psf")]
    reach: Option<f64>,
    /// Camera that the file names
    #[arg(long, default_value = "", hide_default_value = true)]
    camera: String,
    /// Lens that the file names
    #[arg(long, default_value = "", hide_default_value = true)]
    lens: String,
    /// Where corners are seen from where the model lands them, drawn over the frame
    #[arg(long, value_name = "OUT.svg")]
    svg: Option<PathBuf>,
    /// Every corner as comma-separated values
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// Where the centre of distortion is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Centre {
    Free,
    Middle,
    At(DVec2),
}

fn centre(text: &str) -> std::result::Result<Centre, String> {
    let allowed = || "free, middle, or COLUMN,ROW in pixels".to_owned();
    match text {
        "free" => Ok(Centre::Free),
        "middle" => Ok(Centre::Middle),
        _ => {
            let (x, y) = text.split_once(',').ok_or_else(allowed)?;
            let number = |t: &str| t.trim().parse().ok().filter(|v: &f64| v.abs() < 1e6).ok_or_else(allowed);
            Ok(Centre::At(DVec2::new(number(x)?, number(y)?)))
        }
    }
}

/// Runs the command; the result goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let outputs = [&args.out, &args.svg, &args.csv, &args.psf, &args.psf_picture].map(Option::as_deref);
    crate::output::check_all(&outputs, args.common.force)?;
    if let Some(path) = args.psf_picture.as_ref().filter(|p| !PICTURES.contains(&extension(p).as_str())) {
        let found = path.display().to_string();
        return Err(Error::bad("--psf-picture", "ending", found, PICTURES.join(", ")).into());
    }
    if let Some(reach) = args.reach.filter(|r| !(1.0..=64.0).contains(r)) {
        return Err(Error::bad("--reach", "value", reach.to_string(), "1 to 64 pixels").into());
    }
    if let Some(focal) = args.focal_px.filter(|f| !(*f > 0.0 && *f < 1e9)) {
        return Err(Error::bad("--focal-px", "value", focal.to_string(), "pixels above 0 and below 1e9").into());
    }
    let bar = Bar::new("charts");
    let (mut found, mut skipped) = (Vec::new(), Vec::new());
    for (k, path) in args.charts.iter().enumerate() {
        bar.set(k as f64 / args.charts.len() as f64, path.display().to_string());
        match look(path) {
            Ok((view, size)) => {
                // One picture that counts as two makes errors look smaller than they are.
                let earlier = found.iter().map(|(chart, _): &(Chart, [usize; 2])| chart.path.as_path());
                twice::first_time(path, earlier, "each photograph once")?;
                found.push((Chart { path: path.clone(), view }, size));
            }
            Err(error) => skipped.push(error),
        }
    }
    bar.done(format!("{} of {} show a chessboard", found.len(), args.charts.len()));
    // One camera has one size: that of the most pictures, the first of equals.
    let votes = |size: [usize; 2]| found.iter().filter(|f| f.1 == size).count();
    let Some(size) = found.iter().map(|f| f.1).rev().max_by_key(|s| votes(*s)) else {
        skipped.iter().for_each(|e| crate::tell!("warning: left out: {e}"));
        return Err(Error::bad("CHART", "pictures", "no chessboard in any", "photographs of a chessboard").into());
    };
    let (same, others): (Vec<_>, Vec<_>) = found.into_iter().partition(|f| f.1 == size);
    let pixels = |[columns, rows]: [usize; 2]| format!("{columns} × {rows} pixels");
    skipped.extend(others.iter().map(|(chart, own)| {
        Error::bad(chart.path.display().to_string(), "size", pixels(*own), format!("{}, as the others", pixels(size)))
    }));
    skipped.iter().for_each(|e| crate::tell!("warning: left out: {e}"));
    let charts: Vec<Chart> = same.into_iter().map(|f| f.0).collect();
    let settings = Settings {
        size,
        terms: usize::from(args.terms),
        centre_px: match args.centre {
            Centre::Free => None,
            Centre::Middle => Some(0.5 * DVec2::new(size[0] as f64, size[1] as f64)),
            Centre::At(at) => Some(at),
        },
        focal_px: args.focal_px,
        oblong_pixels: false,
    };
    let views: Vec<View> = charts.iter().map(|c| c.view.clone()).collect();
    let fit = solve(&views, &settings).map_err(|e| e.in_file(Path::new("CHART")))?;
    let names: Vec<String> = charts.iter().map(|c| c.path.display().to_string()).collect();
    let doubts = doubt::judge(&views, &names, &settings, &fit).map_err(|e| e.in_file(Path::new("CHART")))?;
    let measured = measured(args, size, &charts, &fit);
    // Whatever becomes of the kernels.
    if let Some(path) = &args.out {
        crate::output::put(&measured.text()?, Some(path), args.common.force, out)?;
    }
    let spread = args.psf.as_ref().map(|_| psf::measure(&charts, &views, &fit, size, args.reach)).transpose()?;
    let listing = Listing { settings, charts, skipped, fit, doubts };
    if let Some(path) = &args.svg {
        crate::output::put(&listing.svg(), Some(path), args.common.force, out)?;
    }
    if let Some(path) = &args.csv {
        crate::output::put(&listing.csv(), Some(path), args.common.force, out)?;
    }
    if let (Some(path), Some(spread)) = (&args.psf, &spread) {
        write_bytes(Target::new(path, args.common.force), &spread.measured.psf.to_npz()?)?;
    }
    if let (Some(path), Some(spread)) = (&args.psf_picture, &spread) {
        write_picture(Target::new(path, args.common.force), &spread.picture(), Encoding::Srgb)?;
    }
    if args.common.json {
        let mut all = listing.json();
        if let Some(spread) = &spread {
            all["psf"] = value(&spread.figures())?;
        }
        writeln!(out, "{all:#}")?;
    } else {
        write!(out, "{listing}")?;
        if let Some(spread) = &spread {
            write!(out, "\n{spread}")?;
        }
    }
    spread.iter().flat_map(psf::Spread::warnings).for_each(|w| crate::tell!("warning: {w}"));
    listing.warnings().iter().for_each(|w| crate::tell!("warning: {w}"));
    Ok(())
}

/// The corners that a picture shows, and its columns and rows.
fn look(path: &Path) -> Result<(View, [usize; 2])> {
    let picture = picture::read(path, None, None, picture::Way::Sensor)?;
    let channels = &picture.channels;
    let named = |name: &str| channels.iter().find(|c| c.name == name);
    let chosen = named("luminance").or_else(|| named("G")).unwrap_or(&channels[0]);
    let (rows, columns) = chosen.plane.dim();
    let find = |plane: ArrayView2<'_, f64>| chart::find(plane).map_err(|e| e.in_file(path));
    if chosen.sites == Sites::ALL {
        return Ok((find(chosen.plane.view())?, [columns, rows]));
    }
    // Of a mosaic, cells of four pixels.
    let cell = |(r, c): (usize, usize)| (0..4).map(|i| chosen.plane[[2 * r + i / 2, 2 * c + i % 2]]).sum::<f64>() / 4.0;
    let mut view = find(Array2::from_shape_fn((rows / 2, columns / 2), cell).view())?;
    view.seen.iter_mut().for_each(|p| *p *= 2.0);
    Ok((view, [columns, rows]))
}

fn measured(args: &Args, size: [usize; 2], charts: &[Chart], fit: &Fit) -> MeasuredDistortion {
    let corners: usize = charts.iter().map(|c| c.view.seen.len()).sum();
    MeasuredDistortion {
        schema: 1,
        camera: args.camera.clone(),
        lens: args.lens.clone(),
        source: format!("isoplanat calibrate: {corners} corners of a chessboard in {} photographs", charts.len()),
        columns: size[0],
        rows: size[1],
        focal_length_px: fit.camera.focal_px.x,
        centre_px: fit.camera.centre_px.into(),
        k: fit.camera.k,
        max_slope: fit.max_slope,
        rms_px: fit.rms_px(),
    }
}
