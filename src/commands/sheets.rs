//! `isoplanat sheets`: a folder with what a workshop needs to make a lens.

use std::io::Write;
use std::path::{Path, PathBuf};

use isoplanat::analysis::fabrication::Fabrication;
use isoplanat::analysis::fabrication::mount::Mount;
use isoplanat::analysis::fabrication::tolerances::Tolerances;
use isoplanat::interchange::{Form, text_of};
use isoplanat::lens::Lens;
use isoplanat::report::sheets::Sheets;
use isoplanat::terminal::in_line;
use isoplanat::{Error, Result, atomic};

use crate::named::Named;
use crate::output::Common;

/// The file that tells a folder of this command.
const MARKER: &str = "sheets.html";

/// Arguments of `sheets`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Lens file (.toml, .zmx, .seq, .json, .txt), or the name of a shipped lens
    lens: Named,
    /// Folder to make: sheets.html, the lens as .toml, .zmx and .seq, surfaces.csv, sag-surface-N.csv
    #[arg(short, long, value_name = "OUT_DIR")]
    output: PathBuf,
    /// Tolerances and mechanical diameters (keys: models/README.md); what it does not state is printed as a dash
    #[arg(long, value_name = "FILE.toml")]
    tolerances: Option<PathBuf>,
    /// Camera mount whose flange the last glass is compared with: c, cs, nikon-f, canon-ef, m42, sony-e, mft, leica-m, none
    #[arg(long, value_name = "MOUNT", default_value = "none")]
    mount: String,
    #[command(flatten)]
    common: Common,
}

/// Runs the command; what was written goes to `out`, what cannot be made as it stands to stderr too.
pub(crate) fn run(args: &Args, out: &mut dyn Write) -> anyhow::Result<()> {
    atomic::check_folder(&args.output, MARKER, args.common.force)?;
    let mount = Mount::named(&args.mount)?;
    let tolerances = args.tolerances.as_deref().map(Tolerances::load).transpose()?.unwrap_or_default();
    let lens = crate::input::lens(&args.lens)?;
    let made = Fabrication::new(&lens, &tolerances, mount)?;
    let forms = prescriptions(&lens)?;
    let mut files: Vec<(String, String)> = forms.iter().map(|(name, form)| (name.clone(), form.words())).collect();
    files.push(("surfaces.csv".into(), "one row a surface, all digits".into()));
    for (_, face) in made.faces() {
        files.push((sag_file(face.surface), format!("sags of face {} at 201 heights, all digits", face.surface)));
    }
    let sheets = Sheets { lens: &lens, made: &made, tolerances: &tolerances, files: &files };
    atomic::write_folder(&args.output, MARKER, args.common.force, |folder| fill(folder, &sheets, &forms))?;
    for fault in &made.faults {
        crate::tell!("warning: {}: {fault}", args.lens);
    }
    for note in &made.notes {
        crate::aside!("note: {}: {note}", args.lens);
    }
    for (name, form) in forms.iter().filter(|(_, f)| f.text.is_none()) {
        crate::aside!("note: {}: {}", args.output.join(name).display(), form.words());
    }
    if args.common.json {
        writeln!(out, "{:#}", sheets.json())?;
    } else {
        let (elements, faces) = (made.elements.len(), made.faces().count());
        let folder = args.output.display().to_string();
        writeln!(out, "{}: {elements} elements, {faces} faces; open {MARKER}", in_line(&folder))?;
    }
    Ok(())
}

/// A lens file of the folder.
struct Prescription {
    /// None where the form cannot say this lens.
    text: Option<String>,
    notes: Vec<String>,
}

impl Prescription {
    fn words(&self) -> String {
        let what = if self.text.is_some() { "the prescription" } else { "not written" };
        std::iter::once(what).chain(self.notes.iter().map(String::as_str)).collect::<Vec<_>>().join("; ")
    }
}

/// The lens in each form, with why one is not written.
fn prescriptions(lens: &Lens) -> Result<Vec<(String, Prescription)>> {
    let of = |(name, form): (&str, Form)| {
        let written = match text_of(lens, form, crate::glasses::all()) {
            Ok((text, notes)) => Prescription { text: Some(text), notes },
            Err(e @ Error::BadInput(_)) => Prescription { text: None, notes: vec![e.to_string()] },
            Err(e) => return Err(e),
        };
        Ok((name.to_owned(), written))
    };
    [("lens.toml", Form::Toml), ("lens.zmx", Form::Zmx), ("lens.seq", Form::Seq)].into_iter().map(of).collect()
}

fn sag_file(surface: usize) -> String {
    format!("sag-surface-{surface}.csv")
}

/// Writes everything into `folder`, the marker last.
fn fill(folder: &Path, sheets: &Sheets<'_>, forms: &[(String, Prescription)]) -> Result<()> {
    let put = |name: &str, text: &str| atomic::write_bytes(&folder.join(name), text.as_bytes());
    for (name, form) in forms {
        if let Some(text) = &form.text {
            put(name, text)?;
        }
    }
    put("surfaces.csv", &sheets.surfaces_csv())?;
    for (surface, text) in sheets.sags_csv() {
        put(&sag_file(surface), &text)?;
    }
    put(MARKER, &sheets.page())
}
