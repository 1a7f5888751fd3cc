//! `isoplanat convert`: a lens file in another form.

use std::io::Write;
use std::path::PathBuf;

use isoplanat::interchange::{Form, text_of};
use isoplanat::report::table::numbered;
use isoplanat::terminal::in_line;
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
    #[command(flatten)]
    common: Common,
}

/// For machines.
#[derive(Serialize)]
struct Figures<'a> {
    input: &'a str,
    output: String,
    surfaces: usize,
    notes: Vec<String>,
}

/// Runs the command; a line on what was written goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    let form = Form::from_path(&args.output)?;
    crate::output::check_writable(&args.output, args.common.force)?;
    let lens = crate::input::lens(&args.input)?;
    let (text, notes) = text_of(&lens, form, crate::glasses::all())?;
    crate::output::put(&text, Some(&args.output), args.common.force, out)?;
    let output = args.output.display();
    if args.common.json {
        let (output, surfaces) = (output.to_string(), lens.surfaces.len());
        writeln!(out, "{:#}", numbered(&Figures { input: &args.input, output, surfaces, notes }))?;
        return Ok(());
    }
    for note in notes {
        crate::aside!("note: {output}: {note}");
    }
    writeln!(out, "{}: {} surfaces", in_line(&output.to_string()), lens.surfaces.len())?;
    Ok(())
}
