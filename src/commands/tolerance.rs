//! `isoplanat tolerance LENS --tolerances FILE`: the lens as it will be built.

use std::io::Write;
use std::path::PathBuf;

use isoplanat::analysis::fabrication::tolerances::Tolerances;
use isoplanat::analysis::tolerancing::{AsBuilt, Settings};
use isoplanat::lens::prescription;
use isoplanat::report::as_built::AsBuiltReport;
use isoplanat::{Error, Result, atomic};

use crate::named::Named;
use crate::output;
use crate::output::Common;
use crate::progress::Bar;

/// What makes a folder one of drawn lenses.
pub(crate) const MARKER: &str = "draws.csv";
/// The lens that was drawn around there, refocused as the draws are.
pub(crate) const REFOCUSED: &str = "refocused.toml";
/// Most lenses that are drawn.
const MOST: usize = 1_000_000;

/// What each tolerance costs in rms spot, and whole lenses drawn within all of them, refocused, by rays and by the nominal lens's derivatives alone.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), or the name of a shipped lens
    lens: Named,
    /// File of tolerances, as for `isoplanat sheets` (models/README.md)
    #[arg(long, value_name = "FILE")]
    tolerances: PathBuf,
    /// Page to write
    #[arg(short, long, value_name = "OUT.html")]
    output: Option<PathBuf>,
    /// Lenses drawn
    #[arg(long, default_value_t = 200, value_name = "N")]
    draws: usize,
    /// Seed of the draws
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Rms spot that a lens may have, µm: its yield is told
    #[arg(long, value_name = "UM", allow_negative_numbers = true)]
    limit_um: Option<f64>,
    /// Folder for the drawn lenses, a file each, for `isoplanat evaluate --drawn` and others
    #[arg(long, value_name = "OUT_DIR")]
    lenses: Option<PathBuf>,
    /// Draws to write as comma-separated values
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// The file of draw `k`, counted from 1.
pub(crate) fn draw(k: usize) -> String {
    format!("draw-{k:06}.toml")
}

/// Runs the command.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    output::check_all(&[args.output.as_deref(), args.csv.as_deref()], args.common.force)?;
    if let Some(folder) = &args.lenses {
        atomic::check_folder(folder, MARKER, args.common.force)?;
    }
    if args.draws > MOST {
        return Err(Error::bad("--draws", "value", args.draws.to_string(), format!("at most {MOST}")).into());
    }
    if let Some(limit) = args.limit_um.filter(|l| !(*l > 0.0 && l.is_finite())) {
        return Err(Error::bad("--limit-um", "value", limit.to_string(), "a positive number of µm").into());
    }
    let lens = crate::input::lens(&args.lens)?;
    let tolerances = Tolerances::load(&args.tolerances)?;
    let asked = isoplanat_program::signals::asked();
    // From the first lens on: what cannot be drawn is refused in one line.
    let mut bar = None;
    let settings = Settings { draws: args.draws, seed: args.seed, lenses: args.lenses.is_some() };
    let made = AsBuilt::new(&lens, &tolerances, settings, &mut |share| {
        bar.get_or_insert_with(|| Bar::new("lenses drawn")).set(share, String::new());
        !asked()
    });
    let (figures, lenses) = made?;
    if let Some(bar) = bar {
        bar.done(format!("{} draws", args.draws));
    }
    let file = args.tolerances.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let limit_mm = args.limit_um.map(|um| 1e-3 * um);
    let report = AsBuiltReport { lens: &lens, file: &file, seed: args.seed, limit_mm, figures: &figures };
    if let Some(path) = &args.csv {
        output::put(&report.csv(), Some(path), args.common.force, out)?;
    }
    if let Some(path) = &args.output {
        output::put(&report.to_html(), Some(path), args.common.force, out)?;
    }
    if let Some(folder) = &args.lenses {
        atomic::write_folder(folder, MARKER, args.common.force, |inside| -> Result<()> {
            // The first is the lens itself, refocused.
            for (k, lens) in lenses.iter().enumerate() {
                let name = if k == 0 { REFOCUSED.to_owned() } else { draw(k) };
                if let Some(lens) = lens {
                    prescription::save(lens, &inside.join(name))?;
                }
            }
            atomic::write_bytes(&inside.join(MARKER), report.csv().as_bytes())
        })?;
    }
    if args.common.json {
        return Ok(writeln!(out, "{}", report.json())?);
    }
    writeln!(out, "{}", report.table())?;
    if args.draws > 0 {
        writeln!(out, "{}", report.quantiles())?;
    }
    report.remarks().iter().try_for_each(|line| writeln!(out, "{line}"))?;
    Ok(())
}
