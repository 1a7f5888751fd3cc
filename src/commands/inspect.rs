//! `isoplanat inspect`: first-order data, aberration sums and surfaces.

use std::io::Write;
use std::path::PathBuf;

use isoplanat::report::listing::Listing;

use crate::named::Named;
use crate::output::Common;

/// Arguments of `inspect`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), or the name of a shipped lens such as `cooke_triplet`
    lens: Named,
    /// Wavelength of the first-order data, nm [default: the lens's primary wavelength]
    #[arg(long, allow_negative_numbers = true, value_name = "NM")]
    wavelength_nm: Option<f64>,
    /// Surfaces to write as comma-separated values, with their aberration sums
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    f_number: crate::input::FNumber,
    #[command(flatten)]
    common: Common,
}

/// Runs the command; the result goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    if let Some(path) = &args.csv {
        crate::output::check_writable(path, args.common.force)?;
    }
    let lens = args.f_number.applied(crate::input::lens(&args.lens)?, &args.lens)?;
    let nm = args.wavelength_nm.unwrap_or(lens.wavelengths.primary_nm);
    if !(200.0..=20_000.0).contains(&nm) {
        return Err(isoplanat::Error::bad("--wavelength-nm", "value", nm.to_string(), "200 to 20000 nm").into());
    }
    lens.require_indices(nm, &args.lens)?;
    let listing = Listing::new(&lens, nm);
    if let Some(path) = &args.csv {
        crate::output::put(&listing.csv(), Some(path), args.common.force, out)?;
    }
    if args.common.json {
        writeln!(out, "{:#}", listing.json())?;
    } else {
        write!(out, "{listing}")?;
    }
    Ok(())
}
