//! `isoplanat check`: numerical health of a lens.

use std::io::Write;
use std::path::PathBuf;

use isoplanat::report::health::HealthReport;
use isoplanat::trace::health::{Verdict, rays};

use crate::named::Named;
use crate::output::Common;

/// Arguments of `check`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), or the name of a shipped lens
    lens: Named,
    /// Figures to write as comma-separated values
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    f_number: crate::input::FNumber,
    #[command(flatten)]
    common: Common,
}

/// Runs the command; the result goes to `out`. A failed check is an error (exit code 1) that names the first failure.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    if let Some(path) = &args.csv {
        crate::output::check_writable(path, args.common.force)?;
    }
    let lens = args.f_number.applied(crate::input::lens(&args.lens)?, &args.lens)?;
    // Each is traced again, in single and in double-double precision, which takes some ten times as long.
    let waiting = crate::long::waiting("check", &lens, 12 * rays(&lens));
    let report = HealthReport::new(&lens);
    drop(waiting);
    if let Some(path) = &args.csv {
        crate::output::put(&report.csv(), Some(path), args.common.force, out)?;
    }
    if args.common.json {
        writeln!(out, "{:#}", report.json())?;
    } else {
        write!(out, "{report}")?;
    }
    out.flush()?;
    let failed: Vec<&str> =
        report.health().figures.iter().filter(|f| f.verdict == Verdict::Fail).map(|f| f.what).collect();
    anyhow::ensure!(failed.is_empty(), "{}: {} of the checks failed: {}", args.lens, failed.len(), failed.join("; "));
    Ok(())
}
