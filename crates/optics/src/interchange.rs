//! Lens files of other programs: Zemax OpticStudio `.zmx`, CODE V `.seq`, JSON of DeepLens and Optiland, DiffOptics `.txt`.
//!
//! A reader makes a `Draft`: what the file says, in mm, nm and degrees. Every keyword is read, or stands in the reader's list of
//! those without effect on rays, or is refused with its line; unknown keywords outside of surfaces are read over with a note, and refused
//! where [`Reading::strict`] asks for it. `finish` makes the lens of a draft: glasses are looked up in the file's own
//! catalogues first and held against the numbers of their lines (`line_glass.rs`), planes reached by negative distances are put in order, field points become angles at the entrance pupil, and
//! clear semi-diameters that the file leaves to its program follow from the beam ([`crate::trace::apertures`]). What was left out or
//! assumed is returned as notes, one line each, for the program to print.
//!
//! Not supported, and refused by name: mirrors, coordinate breaks, gratings, gradient indices, annular apertures that cut the
//! beam. Images are taken on a plane: of a curved image on the one through its vertex, with a note.

mod diffoptics;
mod draft;
mod finish;
mod json;
mod line_glass;
mod media;
mod order;
mod own;
mod same;
mod seq;
mod solve;
mod start;
mod text;
mod write_seq;
mod write_zmx;
mod zmx;

use std::path::Path;

use crate::lens::catalogue::{Glasses, decoded};
use crate::lens::{Lens, builtin, prescription};
use crate::trace::apertures::{self, Beam};
use isoplanat_base::error::{Error, Result};

pub use text::on_one_axis;

/// Largest lens file that is read.
const LARGEST: u64 = 16 << 20;

/// A lens with what was told about its file.
#[derive(Clone, Debug)]
pub struct Imported {
    /// The lens.
    pub lens: Lens,
    /// What was left out, resolved or assumed; one line each, without the file's name.
    pub notes: Vec<String>,
}

/// How a file is to be read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    /// Refuse keywords that the reader does not know, where they would be read over with a note.
    pub strict: bool,
    /// The configuration of a file that has several, from 1; the first one without.
    pub configuration: Option<usize>,
    /// The focal length that a start without power is to have, mm: what its f-number is taken with.
    pub focal_length_mm: Option<f64>,
}

impl Reading {
    /// Refuses a configuration beyond the first of a form that has one.
    fn of_one(self, file: &str) -> Result<()> {
        match self.configuration {
            Some(n) if n != 1 => Err(Error::bad(
                file,
                "configuration",
                n.to_string(),
                "1: only a Zemax file's MNUM and a CODE V file's ZOO state more",
            )),
            _ => Ok(()),
        }
    }
}

/// Forms of lens files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// This program's own.
    Toml,
    /// Zemax OpticStudio.
    Zmx,
    /// CODE V sequence.
    Seq,
    /// DeepLens or Optiland.
    Json,
    /// DiffOptics.
    Txt,
}

/// Endings, with their forms.
const FORMS: [(&str, Form); 5] =
    [("toml", Form::Toml), ("zmx", Form::Zmx), ("seq", Form::Seq), ("json", Form::Json), ("txt", Form::Txt)];

impl Form {
    /// The form that a file's ending says.
    ///
    /// # Errors
    /// Another ending.
    pub fn from_path(path: &Path) -> Result<Self> {
        let ending = path.extension().map_or_else(String::new, |e| e.to_string_lossy().to_ascii_lowercase());
        let found = FORMS.iter().find(|(e, _)| *e == ending).map(|(_, form)| *form);
        found.ok_or_else(|| {
            let file = path.display().to_string();
            Error::bad(file, "name", format!("the ending `{ending}`"), ".toml, .zmx, .seq, .json or .txt")
        })
    }
}

/// Reads a lens file of any form, by its ending.
///
/// # Errors
/// A file that cannot be read, is no lens, or says what this program does not support: with line or key.
pub fn load(path: &Path, glasses: &Glasses) -> Result<Imported> {
    load_as(path, glasses, Reading::default())
}

/// [`load`], in the way of `reading`.
///
/// # Errors
/// As [`load`]; a configuration that the file does not have.
pub fn load_as(path: &Path, glasses: &Glasses, reading: Reading) -> Result<Imported> {
    // A lens without an ending is TOML, as it always was.
    let form = if path.extension().is_none() { Form::Toml } else { Form::from_path(path)? };
    let file = path.display().to_string();
    let bytes = isoplanat_base::atomic::read_bounded(path, LARGEST)?;
    if form == Form::Toml {
        reading.of_one(&file)?;
        let text = String::from_utf8(bytes)
            .map_err(|_| Error::bad(file.as_str(), "text", "bytes that are no UTF-8", "a lens file in UTF-8"))?;
        return own::read(&text, &file, glasses, reading);
    }
    parse_as(&decoded(&bytes), form, &file, glasses, reading)
}

/// Reads the text of a file of another program; `file` names it in errors.
///
/// # Errors
/// As [`load`].
pub fn parse(text: &str, form: Form, file: &str, glasses: &Glasses) -> Result<Imported> {
    parse_as(text, form, file, glasses, Reading::default())
}

/// [`parse`], in the way of `reading`.
///
/// # Errors
/// As [`load_as`].
pub fn parse_as(text: &str, form: Form, file: &str, glasses: &Glasses, reading: Reading) -> Result<Imported> {
    if !matches!(form, Form::Zmx | Form::Seq) {
        reading.of_one(file)?;
    }
    let draft = match form {
        Form::Toml => return own::read(text, file, glasses, reading),
        Form::Zmx => zmx::read(text, file, reading)?,
        Form::Seq => seq::read(text, file, glasses, reading)?,
        Form::Json => json::read(text, file)?,
        Form::Txt => diffoptics::read(text, file)?,
    };
    finish::finish(draft, file, glasses, reading)
}

/// The text of `lens` in a form, with one line on each thing that the form cannot say but that does not change rays; glasses are named as
/// `glasses` names them.
///
/// ```
/// use isoplanat_optics::interchange::{Form, parse, text_of};
/// use isoplanat_optics::lens::{builtin, catalogue::Glasses};
///
/// let (lens, glasses) = (builtin::lens("cooke_triplet")?, Glasses::shipped());
/// let (text, _) = text_of(&lens, Form::Zmx, glasses)?;
/// let again = parse(&text, Form::Zmx, "triplet.zmx", glasses)?.lens;
/// assert_eq!(again.surfaces[0].shape.curvature, lens.surfaces[0].shape.curvature);
/// # Ok::<(), isoplanat_base::error::Error>(())
/// ```
///
/// # Errors
/// What the form cannot say: freeforms, tilts, a glass without a catalogue, numbers that its reader refuses or takes for others.
pub fn text_of(lens: &Lens, form: Form, glasses: &Glasses) -> Result<(String, Vec<String>)> {
    // Read again and compared: no file is written that says less, or another lens.
    let readable = |(text, notes): (String, Vec<String>)| match parse(&text, form, "", glasses) {
        Ok(read) => same::require(lens, &read.lens, form).map(|()| (text, notes)),
        Err(e) => Err(Error::bad(
            lens.file(),
            "form",
            format!("as {form:?} it could not be read again ({e})"),
            ".toml says all of a lens",
        )),
    };
    match form {
        Form::Toml => Ok((prescription::to_toml(lens), Vec::new())),
        Form::Zmx => readable(write_zmx::write(lens, glasses)?),
        Form::Seq => readable(write_seq::write(lens, glasses)?),
        Form::Json | Form::Txt => Err(Error::bad(
            lens.file(),
            "form",
            format!("{form:?}"),
            ".toml, .zmx or .seq; .json and .txt are read only",
        )),
    }
}

/// A lens from a path with `glasses`, or a shipped one where `name_or_path` is its bare name and no such file exists.
///
/// # Errors
/// As [`load_as`]; where neither a file nor a shipped lens has that name, the shipped ones are named.
pub fn lens_or_file(
    name_or_path: &(impl AsRef<Path> + ?Sized),
    glasses: &Glasses,
    reading: Reading,
) -> Result<Imported> {
    let path = name_or_path.as_ref();
    if path.as_os_str().is_empty() {
        return Err(Error::bad("", "lens", "an empty name", "a lens file, or the name of a shipped lens"));
    }
    let bare = path.extension().is_none() && path.components().count() == 1;
    match path.to_str().filter(|_| bare && !path.exists()) {
        Some(name) => {
            reading.of_one(name)?;
            own::read(builtin::text(name)?, name, glasses, reading)
        }
        None => load_as(path, glasses, reading),
    }
}

/// `lens`, made of the one of `name_or_path` by a change, with the clear semi-diameters that its file leaves out as the beams need them now: they belong to the lens as it
/// is, not to the one that was read. Of shipped lenses and files of other programs nothing is left out.
///
/// # Errors
/// As [`load_as`].
pub fn reopened(name_or_path: &(impl AsRef<Path> + ?Sized), lens: Lens, glasses: &Glasses) -> Result<Lens> {
    let path = name_or_path.as_ref();
    let own = path.extension().is_none_or(|e| e.eq_ignore_ascii_case("toml"));
    if !own || !path.exists() {
        return Ok(lens);
    }
    let text = isoplanat_base::atomic::read_text(path, LARGEST)?;
    let marked = own::left_out(&text, &path.display().to_string(), glasses)?;
    if marked.len() != lens.surfaces.len() || !marked.contains(&true) {
        return Ok(lens);
    }
    lens.changed(|l| {
        let beams = Beam::over_field(l);
        apertures::open(l, &marked, &beams);
    })
}

#[cfg(test)]
mod tests;
