//! `isoplanat focus`: a lens with its sensor at best focus for an object distance.

use std::io::Write;
use std::path::PathBuf;

use isoplanat::Error;
use isoplanat::interchange::{Form, reopened, text_of};
use isoplanat::lens::paraxial::first_order;
use isoplanat::optimize::refocused;
use isoplanat::optimize::spec::Spec;
use isoplanat::report::table::{numbered, significant};
use serde::Serialize;

use crate::named::Named;
use crate::output::Common;

/// Arguments of `focus`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), or the name of a shipped lens such as `cooke_triplet`
    lens: Named,
    /// Object distance before the first surface, mm; `inf` is allowed. It becomes the lens's own [default: the lens's own]
    #[arg(long, allow_negative_numbers = true, value_name = "MM")]
    depth_mm: Option<f64>,
    /// File to write, by its ending: .toml, .zmx (Zemax OpticStudio), .seq (CODE V)
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Shares of the field that count, comma separated: `0` is the axis alone [default: five from 0 to 1]
    #[arg(long, value_delimiter = ',', value_name = "SHARES")]
    fields: Vec<f64>,
    #[command(flatten)]
    common: Common,
}

/// Images farther than this behind a lens are none, mm.
const FARTHEST_MM: f64 = 1e6;

/// For machines: before, and as it is written.
#[derive(Serialize)]
struct Figures<'a> {
    lens: &'a str,
    output: String,
    object_distance_mm: f64,
    sensor_distance_mm: [f64; 2],
    rms_um: [f64; 2],
    notes: Vec<String>,
}

/// Runs the command; what moved goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let form = Form::from_path(&args.output)?;
    if matches!(form, Form::Json | Form::Txt) {
        let file = args.output.display().to_string();
        return Err(Error::bad(file, "name", "a form that is read only", ".toml, .zmx or .seq").into());
    }
    crate::output::check_writable(&args.output, args.common.force)?;
    if let Some(depth_mm) = args.depth_mm.filter(|d| d.is_nan() || *d <= 0.0) {
        let found = depth_mm.to_string();
        return Err(Error::bad("--depth-mm", "value", found, "a positive distance, or inf").into());
    }
    let lens = crate::input::lens(&args.lens)?;
    let depth_mm = args.depth_mm.unwrap_or(lens.object_vergence.recip());
    let placed = lens.changed(|l| l.object_vergence = depth_mm.recip())?;
    let placed = reopened(&args.lens, placed, crate::glasses::all())?;
    // Light that does not come together says nothing of where to stand.
    let image = first_order(&placed, placed.wavelengths.primary_nm).paraxial_image_distance;
    if !(image > 0.0 && image < FARTHEST_MM) {
        let found = format!("{depth_mm} mm, of which {} makes no image behind its last surface", args.lens);
        return Err(Error::bad("--depth-mm", "value", found, "a distance whose image is real").into());
    }
    let fields = (!args.fields.is_empty()).then(|| args.fields.clone());
    let merit = Spec { fields, ..Spec::default() }.merit("--fields")?;
    let found = refocused(&placed, merit)?;
    let (text, notes) = text_of(&found.lens, form, crate::glasses::all())?;
    crate::output::put(&text, Some(&args.output), args.common.force, out)?;
    let output = args.output.display();
    let last = |l: &isoplanat::lens::Lens| l.surfaces[l.surfaces.len() - 1].thickness;
    let ([before, after], [rms, least]) = ([last(&lens), last(&found.lens)], found.rms_mm.map(|v| 1e3 * v));
    if args.common.json {
        let figures = Figures {
            lens: &args.lens,
            output: output.to_string(),
            object_distance_mm: depth_mm,
            sensor_distance_mm: [before, after],
            rms_um: [rms, least],
            notes,
        };
        writeln!(out, "{:#}", numbered(&figures))?;
        return Ok(());
    }
    notes.iter().for_each(|note| crate::aside!("note: {output}: {note}"));
    let [before, after, rms, least] = [(before, 8), (after, 8), (rms, 4), (least, 4)].map(|(v, n)| significant(v, n));
    writeln!(out, "sensor from last vertex  {before} mm, now {after}")?;
    writeln!(out, "spots, rms               {rms} µm at {} mm, now {least}", depth_mm)?;
    Ok(())
}
