//! `isoplanat lenses`: the shipped lenses with first-order data; their files and drawings in a folder.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::atomic;
use isoplanat::lens::{Lens, builtin};
use isoplanat::report::drawing::lens_svg;
use isoplanat::report::library::Library;

/// The file that tells a folder of this command.
const MARKER: &str = "lenses.csv";

/// Arguments of `lenses`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder for the lens files, a drawing (SVG) of each, the table as lenses.csv, and index.html that shows all of it
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// The table as comma-separated values, with all digits and whole sources
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    /// Machine-readable output
    #[arg(long)]
    json: bool,
    /// Overwrite the file, replace the folder
    #[arg(long)]
    force: bool,
}

/// Runs the command; the result goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    if let Some(path) = &args.csv {
        crate::output::check_writable(path, args.force)?;
    }
    if let Some(folder) = &args.output {
        atomic::check_folder(folder, MARKER, args.force)?;
    }
    let lenses = builtin::LENSES.iter().map(|(name, _)| Ok(((*name).to_owned(), builtin::lens(name)?)));
    let lenses = lenses.collect::<isoplanat::Result<Vec<(String, Lens)>>>()?;
    let library = Library::new(lenses.iter().cloned());
    if let Some(folder) = &args.output {
        atomic::write_folder(folder, MARKER, args.force, |folder| fill(folder, &library, &lenses))?;
    }
    if let Some(path) = &args.csv {
        crate::output::put(&library.csv(), Some(path), out)?;
    }
    if args.json {
        writeln!(out, "{:#}", library.json())?;
    } else {
        write!(out, "{library}")?;
    }
    Ok(())
}

/// Writes everything of the lenses into `folder`.
fn fill(folder: &Path, library: &Library, lenses: &[(String, Lens)]) -> isoplanat::Result<()> {
    let put = |name: &str, text: &str| atomic::write_bytes(&folder.join(name), text.as_bytes());
    for ((name, lens), (_, text)) in lenses.iter().zip(builtin::LENSES) {
        put(&format!("{name}.toml"), text)?;
        put(&format!("{name}.svg"), &lens_svg(lens))?;
    }
    put("index.html", &library.page())?;
    put(MARKER, &library.csv())
}
