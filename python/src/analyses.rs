//! `Lens.inspect`, `spot`, `mtf`, `distortion`, `report`: what the commands of these names tell, as numbers and arrays.

use std::path::Path;

use isoplanat::atomic::{Target, check_target, write_bytes};
use isoplanat::imaging::sensor::Sensor;
use isoplanat::imaging::sensor::spectrum::SpectralDensity;
use isoplanat::math::memory::Limit;
use isoplanat::report::drawing::lens_svg;
use isoplanat::report::lens::analysis::{Analysis, Asked, Refused};
use isoplanat::report::lens::{LensReport, Options, html as page};
use isoplanat::report::listing::Listing;
use isoplanat::report::table::value;
use isoplanat::{Lens, Result};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::Value;

use crate::arrays::given;
use crate::errors::{raised, refused};
use crate::work::{here, work};

/// How it is looked at; what is left out is the commands' own.
pub(crate) struct Look {
    pub(crate) distance_mm: Option<f64>,
    pub(crate) rays: usize,
    pub(crate) fields_deg: Vec<f64>,
    pub(crate) max_angle_deg: Option<f64>,
    pub(crate) max_cycles_per_mm: Option<f64>,
    pub(crate) cycles_per_mm: Vec<f64>,
    pub(crate) shift_mm: Option<f64>,
}

impl Default for Look {
    fn default() -> Self {
        Self {
            distance_mm: None,
            rays: 1600,
            fields_deg: Vec::new(),
            max_angle_deg: None,
            max_cycles_per_mm: None,
            cycles_per_mm: Vec::new(),
            shift_mm: None,
        }
    }
}

impl Look {
    fn options(&self) -> PyResult<Options> {
        let Self { rays, max_angle_deg, max_cycles_per_mm, shift_mm, .. } = *self;
        let (fields_deg, cycles_per_mm) = (self.fields_deg.clone(), self.cycles_per_mm.clone());
        let asked = Asked { rays, fields_deg, max_angle_deg, max_cycles_per_mm, cycles_per_mm, shift_mm };
        let told = |Refused { name, found, allowed }: Refused| refused(name, found, allowed);
        asked.options(Limit::of_process()).map_err(told)
    }
}

/// The values of JSON as those of Python.
pub(crate) fn python(py: Python<'_>, value: &Value) -> PyResult<Py<PyAny>> {
    Ok(py.import("json")?.call_method1("loads", (value.to_string(),))?.unbind())
}

pub(crate) fn inspect(py: Python<'_>, lens: &Lens, wavelength_nm: Option<f64>) -> PyResult<Py<PyAny>> {
    let nm = wavelength_nm.unwrap_or(lens.wavelengths.primary_nm);
    if !(200.0..=20_000.0).contains(&nm) {
        return Err(refused("wavelength_nm", nm, "200 to 20000 nm"));
    }
    lens.require_indices(nm, lens.file()).map_err(raised)?;
    python(py, &here(|| Ok(Listing::new(lens, nm).json()))?)
}

pub(crate) fn analysis(py: Python<'_>, lens: &Lens, analysis: Analysis, asked: Look) -> PyResult<Py<PyAny>> {
    let options = asked.options()?;
    let lens = crate::lens::at(lens, asked.distance_mm)?;
    let (told, arrays) = work(py, || {
        let found = analysis.of(&lens, &options);
        Ok((value(&found.shown())?, analysis.arrays(&found.overview)))
    })?;
    let told = python(py, &told)?;
    let all = told.bind(py).cast::<PyDict>()?;
    for (name, array) in arrays {
        all.set_item(name, given(py, array))?;
    }
    Ok(told)
}

pub(crate) fn report(
    py: Python<'_>,
    lens: &Lens,
    file: Option<&Path>,
    force: bool,
    asked: Look,
) -> PyResult<Py<PyAny>> {
    let options = asked.options()?;
    let lens = crate::lens::at(lens, asked.distance_mm)?;
    let told = work(py, || -> Result<Value> {
        if let Some(file) = file {
            check_target(file, force.into())?;
        }
        let colour = SpectralDensity::new(&Sensor::generic()).require(&lens).is_ok();
        let report = LensReport::new(lens, &Options { colour, ..options });
        let told = report.json();
        if let Some(file) = file {
            write_bytes(Target::new(file, force), page(&[report])?.as_bytes())?;
        }
        Ok(told)
    })?;
    python(py, &told)
}

/// First-order numbers that a notebook shows: key in the listing, words, unit.
const SHOWN: [(&str, &str, &str); 7] = [
    ("effective_focal_length_mm", "effective focal length", "mm"),
    ("f_number", "f-number", ""),
    ("back_focal_length_mm", "back focal length", "mm"),
    ("length_mm", "length, first vertex to sensor", "mm"),
    ("entrance_pupil_diameter_mm", "entrance pupil diameter", "mm"),
    ("max_field_deg", "largest half field angle", "°"),
    ("object_distance_mm", "object distance", "mm"),
];

/// A lens as a notebook shows it.
pub(crate) fn html(lens: &Lens, listing: &Listing<'_>, notes: &[String]) -> String {
    let all = listing.json();
    let row = |(key, words, unit): &(&str, &str, &str)| {
        // A distance that is no number in JSON is infinite.
        let value = all[*key].as_f64().map_or_else(|| "∞".to_owned(), |v| format!("{v:.6}"));
        format!(
            "<tr><th style=\"text-align:left\">{words}</th><td style=\"text-align:right\">{value}</td><td>{unit}</td></tr>"
        )
    };
    let rows: String = SHOWN.iter().map(row).collect();
    let notes: String = notes.iter().map(|note| format!("<p>{}</p>", escaped(note))).collect();
    format!("<div><b>{}</b><br>{}<table>{rows}</table>{notes}</div>", escaped(&lens.name), lens_svg(lens))
}

/// A text that HTML shows as it is.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
