//! `isoplanat trace`: exact rays through every surface.

use std::io::Write;
use std::path::PathBuf;

use isoplanat::trace::exact;

use crate::named::Named;
use crate::output::Common;

/// Arguments of `trace`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), or the name of a shipped lens
    lens: Named,
    /// Launch rays (JSON, see models/README.md); `-` reads stdin
    #[arg(long, value_name = "RAYS.json")]
    rays: PathBuf,
    /// Stop rays at the clear apertures
    #[arg(long)]
    clip: bool,
    /// Add the derivative of each landing with respect to every number of the lens
    #[arg(long)]
    gradient: bool,
    /// Write here instead of stdout
    #[arg(short, long, value_name = "OUT.json")]
    output: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// Runs the command; the result goes to `out` or to the output file.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    if let Some(path) = &args.output {
        crate::output::check_writable(path, args.common.force)?;
    }
    let lens = crate::input::lens(&args.lens)?;
    let (text, name) = crate::input::text(&args.rays)?;
    let request = exact::request_from_json(&text, &name)?;
    lens.require_indices(request.wavelength_nm, &args.lens)?;
    let answer = exact::answer(&lens, &request, args.clip, args.gradient);
    // Rays have one form: JSON, with `--json` or without.
    let _ = args.common.json;
    let mut json = serde_json::to_string_pretty(&answer)?;
    json.push('\n');
    crate::output::put(&json, args.output.as_deref(), args.common.force, out)
}
