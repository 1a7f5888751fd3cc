//! `dataset`: pairs of capture and truth as files. What reads them is Python: `package/isoplanat/_dataset.py`.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use isoplanat::dataset::{Crops, Form, Judging, Part, Settings, make};
use isoplanat::lens::{Prescription, SensorRaster};
use isoplanat::{Error, Sensor};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::json;

use crate::arrays::Several;
use crate::bending::Bending;
use crate::errors::{raised, refused};
use crate::frame::Frame;
use crate::lens::Lens;
use crate::render::{light, standing};
use crate::work::{here, work};

/// What all lenses are looked at with.
#[derive(FromPyObject)]
pub(crate) enum Raster<'py> {
    /// One frame for all.
    One(Bound<'py, Frame>),
    /// Columns and rows over each lens's own sensor.
    Over([usize; 2]),
}

impl Raster<'_> {
    fn of(&self, lens: &isoplanat::Lens) -> isoplanat::Result<isoplanat::Lens> {
        match self {
            Self::One(frame) => standing(lens, frame.get(), lens.object_vergence),
            Self::Over([columns, rows]) => {
                let sensor: SensorRaster = lens.sensor.spanned(*columns, *rows);
                isoplanat::Lens::new(Prescription { sensor, ..(**lens).clone() }, lens.file())
            }
        }
    }
}

/// One lens, a list of them, or lenses by name; each with a name that files can have.
fn named(lenses: &Bound<'_, PyAny>) -> PyResult<Vec<(String, isoplanat::Lens)>> {
    let wrong = |_| PyTypeError::new_err("lenses: a Lens, a list of them, or a dict of them by name");
    let own = |lens: Bound<'_, Lens>| (*lens.get().inner).clone();
    if let Ok(one) = lenses.cast::<Lens>() {
        return Ok(vec![(stem(one.get()), own(one.clone()))]);
    }
    if let Ok(by_name) = lenses.cast::<PyDict>() {
        let one = |(name, lens): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
            Ok((name.extract::<String>().map_err(wrong)?, own(lens.cast_into::<Lens>().map_err(|e| wrong(e.into()))?)))
        };
        return by_name.iter().map(one).collect();
    }
    let listed: Vec<Bound<'_, Lens>> = lenses.extract().map_err(wrong)?;
    let mut all: Vec<(String, isoplanat::Lens)> = Vec::new();
    for lens in listed {
        let stem = stem(lens.get());
        let taken = |name: &String| all.iter().any(|(other, _)| other == name);
        let name = std::iter::once(stem.clone())
            .chain((2..).map(|k| format!("{stem}-{k}")))
            .find(|name| !taken(name))
            .unwrap_or(stem);
        all.push((name, own(lens)));
    }
    Ok(all)
}

/// The name of the file that a lens was read from, without its ending; its own name where it was read from none.
fn stem(lens: &Lens) -> String {
    let file = Path::new(lens.inner.file()).file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    let plain = |c: char| if c.is_alphanumeric() || "._-".contains(c) { c } else { '_' };
    let name: String = if file.is_empty() { &lens.inner.name } else { &file }.chars().map(plain).collect();
    let name = name.trim_start_matches('.');
    if name.is_empty() { "lens".to_owned() } else { name.to_owned() }
}

/// The form of a name.
fn form(name: &str) -> PyResult<Form> {
    let known = || Form::ALL.map(Form::name).join(", ");
    Form::ALL.into_iter().find(|f| f.name() == name).ok_or_else(|| refused("form", format!("`{name}`"), known()))
}

/// Makes a data set; `isoplanat.dataset` has its words. Returns what was done.
#[expect(clippy::too_many_arguments, reason = "the keywords of a call")]
#[pyfunction]
#[pyo3(signature = (lenses, photos, folder, frame, distances_mm, crop, crops, texels_per_pixel, noise, noise_level, flat_field, illuminant,
    min_psnr_db, diffraction, judge, judge_samples, form, shard, index, of, seed, force, progress))]
pub(crate) fn make_dataset(
    py: Python<'_>,
    lenses: &Bound<'_, PyAny>,
    photos: PathBuf,
    folder: PathBuf,
    frame: Option<Raster<'_>>,
    distances_mm: Several<f64>,
    crop: Option<[usize; 2]>,
    crops: usize,
    texels_per_pixel: Option<f64>,
    noise: Option<PathBuf>,
    noise_level: [f64; 2],
    flat_field: bool,
    illuminant: Option<&str>,
    min_psnr_db: f64,
    diffraction: Option<Bending>,
    judge: f64,
    judge_samples: usize,
    form: &str,
    shard: Option<usize>,
    index: usize,
    of: usize,
    seed: u64,
    force: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<Py<PyAny>> {
    let mut lenses = named(lenses)?;
    if let Some(raster) = frame {
        for (_, lens) in &mut lenses {
            *lens = here(|| raster.of(lens))?;
        }
    }
    let sensor = match &noise {
        Some(file) if file.as_os_str() != "generic" => Sensor::load(file).map_err(raised)?,
        _ => Sensor::generic(),
    };
    let settings = Settings {
        distances_mm: distances_mm.0,
        crops: crop.map(|size| Crops { size, count: crops }),
        texels_per_pixel,
        sensor,
        noise: noise.is_some(),
        noise_level,
        flat_field,
        illuminant: light(illuminant)?,
        min_psnr_db,
        diffraction: Bending::of_pictures(diffraction.or_else(|| (judge > 0.0).then(Bending::off)).as_ref())?,
        judging: Judging { share: judge, samples: judge_samples },
        seed,
        form: self::form(form)?,
        shard,
        part: Part { index, of },
        replace: force,
        ..Settings::new(lenses, photos)
    };
    let failed = OnceLock::new();
    let heard = |share: f64, what: &str| {
        isoplanat::stop::look();
        let Some(progress) = progress.as_ref().filter(|_| !what.is_empty()) else { return true };
        Python::attach(|py| progress.call1(py, (share, what)).map(drop)).map_err(|e| failed.set(e)).is_ok()
    };
    let made = work(py, || {
        let made = make(&settings, &folder, &heard)?;
        let verdict = made.verdict(settings.min_psnr_db);
        let plans = serde_json::to_value(&made.planned).map_err(|e| Error::Internal(e.to_string()))?;
        let [judged, held] = verdict.map_or([0, 0], |v| v.0);
        Ok(
            json!({ "pairs": made.pairs, "made": made.made, "kept": made.kept, "damaged": made.damaged, "complete": made.complete,
            "seconds": made.seconds, "plans": plans, "judged": judged, "held": held,
            "judged_psnr_db": verdict.map(|(_, mean)| mean.psnr_db()) }),
        )
    });
    // What the function raised ended the work.
    if let Some(error) = failed.into_inner() {
        return Err(error);
    }
    crate::analyses::python(py, &made?)
}
