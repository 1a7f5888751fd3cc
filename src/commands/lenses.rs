//! `isoplanat lenses`: the shipped lenses with first-order data; their files and drawings in a folder.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::lens::{Lens, builtin, prescription};
use isoplanat::report::drawing::lens_svg;
use isoplanat::report::library::Library;
use isoplanat::{Error, Result, atomic};

use crate::named::Named;
use crate::output::Common;

/// Lenses by the names that they are listed under.
type Listed = Vec<(String, Lens)>;

/// The file that tells a folder of this command.
const MARKER: &str = "lenses.csv";

/// Arguments of `lenses`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens files (.toml, .zmx, .seq, .json, .txt) or names of shipped lenses [default: all shipped lenses]
    lens: Vec<Named>,
    /// Folder for the lens files, a drawing (SVG) of each, the table as lenses.csv, and index.html that shows all of it
    #[arg(short, long, value_name = "OUT_DIR")]
    output: Option<PathBuf>,
    /// The table as comma-separated values, with all digits and whole sources
    #[arg(long, value_name = "OUT.csv")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// Runs the command; the result goes to `out`.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    if let Some(path) = &args.csv {
        crate::output::check_writable(path, args.common.force)?;
    }
    if let Some(folder) = &args.output {
        atomic::check_folder(folder, MARKER, args.common.force)?;
    }
    let (lenses, left_out) = if args.lens.is_empty() { (shipped()?, Vec::new()) } else { given(&args.lens)? };
    crate::glasses::all_taken()?;
    let library = Library::new(lenses.iter().cloned());
    if let Some(folder) = &args.output {
        atomic::write_folder(folder, MARKER, args.common.force, |folder| fill(folder, &library, &lenses))?;
    }
    if let Some(path) = &args.csv {
        crate::output::put(&library.csv(), Some(path), args.common.force, out)?;
    }
    if args.common.json {
        let mut said = library.json();
        said["left_out"] = left_out.iter().map(Error::to_string).collect();
        writeln!(out, "{said:#}")?;
    } else {
        write!(out, "{library}")?;
    }
    if left_out.is_empty() {
        return Ok(());
    }
    left_out.iter().for_each(|e| crate::tell!("left out: {e}"));
    let found = format!("{} of {} left out", left_out.len(), args.lens.len());
    Err(Error::bad("lenses", "", found, "the others are listed").into())
}

fn shipped() -> Result<Listed> {
    builtin::LENSES.iter().map(|(name, _)| Ok(((*name).to_owned(), crate::input::one_of_lenses(name)?))).collect()
}

/// The named lenses, each called as its file, files of one name told apart by numbers; and why others cannot be read.
///
/// # Errors
/// That of the first, where none can be read.
fn given(names: &[Named]) -> Result<(Listed, Vec<Error>)> {
    let mut all = Listed::new();
    let mut left_out = Vec::new();
    for name in names {
        let lens = match crate::input::one_of_lenses(name) {
            Ok(lens) => lens,
            Err(Error::Interrupted) => return Err(Error::Interrupted),
            Err(e) => {
                left_out.push(e);
                continue;
            }
        };
        let path: &Path = name.as_ref();
        let stem = path.file_stem().map_or_else(|| name.to_string(), |s| s.to_string_lossy().into_owned());
        let taken = |n: &str| all.iter().any(|(other, _)| other.eq_ignore_ascii_case(n));
        let free = (1..).map(|k| if k == 1 { stem.clone() } else { format!("{stem}-{k}") }).find(|n| !taken(n));
        all.push((free.unwrap_or(stem), lens));
    }
    if all.is_empty() && !left_out.is_empty() { Err(left_out.swap_remove(0)) } else { Ok((all, left_out)) }
}

/// Writes everything of the lenses into `folder`.
fn fill(folder: &Path, library: &Library, lenses: &[(String, Lens)]) -> Result<()> {
    let put = |name: &str, text: &str| atomic::write_bytes(&folder.join(name), text.as_bytes());
    for (name, lens) in lenses {
        // A shipped file has comments beside its numbers.
        let own = builtin::LENSES.iter().find(|(n, _)| n == name && builtin::lens(n).is_ok_and(|l| l == *lens));
        put(&format!("{name}.toml"), &own.map_or_else(|| prescription::to_toml(lens), |(_, text)| (*text).to_owned()))?;
        put(&format!("{name}.svg"), &lens_svg(lens))?;
    }
    put("index.html", &library.page())?;
    put(MARKER, &library.csv())
}
