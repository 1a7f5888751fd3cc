//! `isoplanat convert`: a lens file in another form.

use std::io::Write;
use std::path::PathBuf;

use isoplanat::interchange::{Form, text_of};
use isoplanat::lens::Lens;
use isoplanat::lens::paraxial::first_order;
use isoplanat::report::table::{numbered, significant};
use isoplanat::terminal::in_line;
use isoplanat::{Error, Result};
use serde::Serialize;

use crate::named::Named;
use crate::output::Common;

/// Arguments of `convert`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), or the name of a shipped lens
    input: Named,
    /// File to write, by its ending: .toml, .zmx (Zemax OpticStudio), .seq (CODE V)
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Makes all lengths so many times as large
    #[arg(long, value_name = "FACTOR", allow_negative_numbers = true)]
    scale: Option<f64>,
    /// Scales the lens to this focal length, mm
    #[arg(long, value_name = "MM", allow_negative_numbers = true, conflicts_with = "scale")]
    focal_length_mm: Option<f64>,
    #[command(flatten)]
    common: Common,
}

impl Args {
    /// The lens as it was asked for, and how many times as large it is.
    fn scaled(&self, lens: Lens) -> Result<(Lens, Option<f64>)> {
        let checked = |name: &str, value: f64| {
            let sound = value.is_finite() && value > 0.0;
            if sound { Ok(value) } else { Err(Error::bad(name, "value", value.to_string(), "a positive number")) }
        };
        let factor = match (self.scale, self.focal_length_mm) {
            (Some(factor), _) => checked("--scale", factor)?,
            (None, Some(wanted)) => {
                let own = first_order(&lens, lens.wavelengths.primary_nm).effective_focal_length;
                let wanted = checked("--focal-length-mm", wanted)?;
                if !(own.is_finite() && own != 0.0 && own.abs() < 1e9) {
                    let found = format!("given for {}, which has no power", self.input);
                    return Err(Error::bad("--focal-length-mm", "value", found, "a lens with a focal length"));
                }
                wanted / own.abs()
            }
            (None, None) => return Ok((lens, None)),
        };
        Ok((lens.changed(|l| l.enlarge(factor))?, Some(factor)))
    }
}

/// For machines.
#[derive(Serialize)]
struct Figures<'a> {
    input: &'a str,
    output: String,
    surfaces: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    scale: Option<f64>,
    notes: Vec<String>,
}

/// Runs the command; a line on what was written goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let form = Form::from_path(&args.output)?;
    crate::output::check_writable(&args.output, args.common.force)?;
    let (lens, factor) = args.scaled(crate::input::lens(&args.input)?)?;
    let (text, notes) = text_of(&lens, form, crate::glasses::all())?;
    crate::output::put(&text, Some(&args.output), args.common.force, out)?;
    let output = args.output.display();
    if args.common.json {
        let (output, surfaces) = (output.to_string(), lens.surfaces.len());
        writeln!(out, "{:#}", numbered(&Figures { input: &args.input, output, surfaces, scale: factor, notes }))?;
        return Ok(());
    }
    for note in notes {
        crate::aside!("note: {output}: {note}");
    }
    let scaled =
        factor.map_or(String::new(), |f| format!(", {} times as large; the sensor's pixels stay", significant(f, 6)));
    writeln!(out, "{}: {} surfaces{scaled}", in_line(&output.to_string()), lens.surfaces.len())?;
    Ok(())
}
