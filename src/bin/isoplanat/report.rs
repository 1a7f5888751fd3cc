//! `isoplanat report`: everything about a lens, or about two side by side, on one page.

use std::io::Write;
use std::path::PathBuf;

use isoplanat::Error;
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::lens::Lens;
use isoplanat::report::lens::{LensReport, Options, html};

use crate::analyses::View;

/// Arguments of `report`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), or the name of a shipped lens; several are shown side by side
    #[arg(required = true, num_args = 1..=4, value_name = "LENS")]
    lenses: Vec<String>,
    /// Where to put the page
    #[arg(short, long, value_name = "OUT.html")]
    output: Option<PathBuf>,
    /// Every curve as comma-separated values; of one lens
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    /// Everything as JSON, to stdout
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    view: View,
    /// Overwrite outputs
    #[arg(long)]
    force: bool,
}

/// Runs the command; figures go to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    if args.output.is_none() && args.csv.is_none() && !args.json {
        return Err(Error::bad("report", "output", "none", "-o OUT.html, --csv OUT.csv or --json").into());
    }
    if args.csv.is_some() && args.lenses.len() > 1 {
        return Err(Error::bad("--csv", "lenses", args.lenses.len().to_string(), "one lens").into());
    }
    crate::output::check_all(&[args.output.as_deref(), args.csv.as_deref()], args.force)?;
    let options = args.view.options()?;
    let mut reports = Vec::new();
    for name in &args.lenses {
        let lens = args.view.lens(name)?;
        let colour = in_colour(&lens);
        reports.push(LensReport::new(lens, &Options { colour, ..options.clone() }));
    }
    if let Some(path) = &args.output {
        crate::output::put(&html(&reports)?, Some(path), out)?;
    }
    if let (Some(path), [report]) = (&args.csv, &reports[..]) {
        crate::output::put(&report.csv(), Some(path), out)?;
    }
    if args.json {
        match &reports[..] {
            [one] => writeln!(out, "{}", one.json())?,
            several => {
                let all: Vec<_> = several.iter().map(LensReport::json).collect();
                writeln!(out, "{}", serde_json::json!({ "schema": 1, "lenses": all }))?;
            }
        }
        return Ok(());
    }
    for report in &reports {
        for missing in &report.missing {
            eprintln!("note: {}: {missing}", report.lens.name);
        }
        let seconds: f64 = report.seconds.iter().map(|(_, s)| s).sum();
        writeln!(out, "{}: {seconds:.2} s", report.lens.name)?;
    }
    if let Some(path) = &args.output {
        writeln!(out, "open {}", path.display())?;
    }
    Ok(())
}

/// Whether the generic sensor sees the lens's light, so that kernels can be drawn in its colours.
pub(crate) fn in_colour(lens: &Lens) -> bool {
    SpectralDensity::new(&Sensor::generic()).require(lens).is_ok()
}
