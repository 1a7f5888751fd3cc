//! What commands read: texts from a file or from stdin, and the lens behind `LENS`; stderr is told what is doubtful about it.

use std::path::Path;

#[cfg(feature = "train")]
use isoplanat::calibrate::lens::MeasuredLens;
#[cfg(feature = "train")]
use isoplanat::design::opened::Run;
#[cfg(feature = "train")]
use isoplanat::design::subject::Subject;
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::illuminant::Illuminant;
use isoplanat::imaging::sensor::spectrum::{SEEN, SpectralDensity};
use isoplanat::interchange::{self, Imported, Reading};
use isoplanat::lens::Lens;
use isoplanat::lens::f_number::stopped_to;
use isoplanat::lens::paraxial::stop_semi_diameter;
use isoplanat::report::table::significant;
use isoplanat::trace::rims::overlapping_rims;
use isoplanat::{Result, atomic};

use crate::glasses;
use crate::named::Named;

/// The one lens named on the command line: a file of any form that is read, or a shipped lens by its bare name.
///
/// # Errors
/// As [`one_of_lenses`]; a glass of `--glass-for` that it does not name.
pub(crate) fn lens(name_or_path: &(impl AsRef<Path> + ?Sized)) -> Result<Lens> {
    let lens = one_of_lenses(name_or_path)?;
    glasses::all_taken()?;
    Ok(lens)
}

/// [`lens`], as the start of an optimisation to this focal length: what an f-number of a lens without power is taken with.
///
/// # Errors
/// As [`lens`].
pub(crate) fn start(name_or_path: &(impl AsRef<Path> + ?Sized), focal_length_mm: Option<f64>) -> Result<Lens> {
    let lens = read_in(name_or_path, Reading { focal_length_mm, ..glasses::reading() })?;
    glasses::all_taken()?;
    Ok(lens)
}

/// [`lens`], where others may name the glasses of `--glass-for`: whoever read all of them asks [`glasses::all_taken`].
///
/// # Errors
/// A file that cannot be read or is no lens, surfaces that overlap where light goes; where neither a file nor a shipped lens has that name, both are said.
pub(crate) fn one_of_lenses(name_or_path: &(impl AsRef<Path> + ?Sized)) -> Result<Lens> {
    read_in(name_or_path, glasses::reading())
}

fn read_in(name_or_path: &(impl AsRef<Path> + ?Sized), reading: Reading) -> Result<Lens> {
    let path = name_or_path.as_ref();
    let Imported { lens, notes } = interchange::lens_or_file(path, glasses::all(), reading)?;
    let toml = path.extension().is_none_or(|e| e == "toml");
    for note in notes {
        // What another program's file leaves open is no fault of it.
        if toml {
            crate::tell!("warning: {}: {note}", path.display());
        } else {
            crate::aside!("note: {}: {note}", path.display());
        }
    }
    doubts(&lens, &path.display().to_string());
    Ok(lens)
}

/// The light that a scene stands in.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(crate) struct Light {
    /// Light on the scene: E (equal energy), A, D50, D55, D65, D75, daylight:KELVIN, black-body:KELVIN. White stays white: it moves the mean
    /// wavelength of each channel.
    #[arg(long, value_name = "LIGHT", default_value = "E", hide_default_value = true)]
    pub(crate) illuminant: Illuminant,
}

/// A sensor between the light and the picture.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct NoiseArgs {
    /// Mosaic, response and noise of a sensor: its sensor.toml, or `generic`; without it pictures have none.
    #[arg(long, value_name = "SENSOR")]
    noise: Option<Named>,
    /// Divide the lens's falling light out, as a camera does with its flat field.
    #[arg(long)]
    pub(crate) flat_field: bool,
}

impl NoiseArgs {
    /// Whether mosaic and noise are asked for.
    pub(crate) fn is_asked(&self) -> bool {
        self.noise.is_some()
    }

    /// The sensor, the generic one where none is named, and whether its mosaic and noise are asked for.
    ///
    /// # Errors
    /// A file that cannot be read, or is no sensor's.
    pub(crate) fn sensor(&self) -> Result<(Sensor, bool)> {
        match &self.noise {
            Some(name) if &**name == "generic" => Ok((Sensor::generic(), true)),
            Some(file) => Ok((Sensor::load(file.as_ref())?, true)),
            None => Ok((Sensor::generic(), false)),
        }
    }
}

/// An f-number for one run, in place of the lens's.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(crate) struct FNumber {
    /// f-number (focal length over entrance pupil) for this run only: the stop is closed to it [default: the lens's own]
    #[arg(long, allow_negative_numbers = true, value_name = "N")]
    f_number: Option<f64>,
}

impl FNumber {
    /// `lens` with its stop closed to the f-number; stderr is told. `argument` named the lens.
    ///
    /// # Errors
    /// An f-number that is none, a lens without power, a stop larger than its surface lets through.
    pub(crate) fn applied(self, lens: Lens, argument: &str) -> Result<Lens> {
        let Some(number) = self.f_number else { return Ok(lens) };
        let stopped = stopped_to(&lens, number).map_err(|e| e.of_file("--f-number"))?;
        let [before, radius] = [&lens, &stopped].map(|lens| stop_semi_diameter(lens));
        crate::aside!(
            "note: {argument}: f/{number} for this run: the stop's semi-diameter is {} mm in place of {}",
            significant(radius, 6),
            significant(before, 6)
        );
        Ok(stopped)
    }
}

/// Refuses a lens that is made for other light than the picture's, and says which of its wavelengths the picture lacks;
/// `argument` named the lens.
pub(crate) fn in_band(lens: &Lens, density: &SpectralDensity, argument: &str) -> Result<()> {
    density.require(lens)?;
    for [from, to] in density.left_out_nm() {
        crate::aside!(
            "note: {argument}: {from:.2} to {to:.2} nm are left out: the sensor sees less than {SEEN} of its peak there"
        );
    }
    let [short, long] = density.ends_nm();
    let unseen: Vec<String> = lens
        .wavelengths
        .shares()
        .filter(|(nm, _)| !(short..=long).contains(nm))
        .map(|(nm, _)| nm.to_string())
        .collect();
    if !unseen.is_empty() {
        crate::tell!(
            "warning: {argument}: wavelengths.nm: {} nm: the picture shows {short} to {long} nm, what the sensor responds to",
            unseen.join(", ")
        );
    }
    Ok(())
}

/// Says what is doubtful about the lens of a task, and refuses one made for other light than its sensor's.
#[cfg(feature = "train")]
pub(crate) fn of_task(task: &isoplanat::design::task::Task) -> Result<()> {
    match subject(&task.lens.file)? {
        Subject::Lens(read) => in_band(&read, &SpectralDensity::new(&task.sensor()?), &task.lens.file),
        Subject::Measured(_) => Ok(()),
    }
}

/// A lens by its name or file, or a measured one by its folder; stderr is told what is doubtful about it.
#[cfg(feature = "train")]
pub(crate) fn subject(name_or_path: &(impl AsRef<Path> + ?Sized)) -> Result<Subject> {
    let folder = name_or_path.as_ref();
    if !MeasuredLens::is_at(folder) {
        return Ok(lens(folder)?.into());
    }
    let measured = MeasuredLens::load(folder)?;
    told(&measured, &folder.display().to_string())?;
    Ok(Subject::Measured(Box::new(measured)))
}

/// The run in a folder; stderr is told what is doubtful about its lens.
#[cfg(feature = "train")]
pub(crate) fn run(folder: &Path) -> Result<Run> {
    let run = Run::open(folder)?;
    match &run.subject {
        Subject::Lens(lens) => doubts(lens, &folder.join("lens.toml").display().to_string()),
        Subject::Measured(lens) => told(lens, &folder.display().to_string())?,
    }
    Ok(run)
}

/// Tells stderr what is doubtful about a lens that stands in `file`.
fn doubts(lens: &Lens, file: &str) {
    for warning in overlapping_rims(lens, file) {
        crate::tell!("warning: {warning}");
    }
}

/// Tells stderr what is doubtful about a measured lens.
#[cfg(feature = "train")]
fn told(lens: &MeasuredLens, name: &str) -> Result<()> {
    for note in lens.notes()? {
        crate::aside!("note: {name}: {note}");
    }
    Ok(())
}

/// Bytes of such a text at most.
const LARGEST: u64 = 256 << 20;

/// The text of the file at `path`, or of stdin where that is `-`, with the name errors give it.
pub(crate) fn text(path: &Path) -> Result<(String, String)> {
    if path == Path::new("-") {
        let name = Path::new("<stdin>");
        let text = atomic::as_text(atomic::read_at_most(std::io::stdin(), name, LARGEST)?, name)?;
        return Ok((text, name.display().to_string()));
    }
    let text = atomic::read_text(path, LARGEST)?;
    Ok((text, path.display().to_string()))
}
