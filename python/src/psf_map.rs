//! `Lens.psf_map`: kernels in the colours of a sensor, in the forms that other programs train and restore with.

use std::path::PathBuf;

use isoplanat::imaging::render::psf_map::{PsfMap, PsfMapRequest, PsfPlaces, Values};
use isoplanat::{Lens, Sensor, SpectralDensity};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};

use crate::arrays::given;
use crate::errors::{refused, vergence};
use crate::frame::Frame;
use crate::render::{light, standing};
use crate::work::work;

/// What was asked for; what is left out is the command's own.
pub(crate) struct Asked<'a> {
    pub(crate) form: &'a str,
    pub(crate) frame: Option<Frame>,
    pub(crate) distance_mm: Option<f64>,
    pub(crate) heights: Option<usize>,
    pub(crate) grid: Option<[usize; 2]>,
    pub(crate) node_error: Option<f64>,
    pub(crate) size: Option<usize>,
    pub(crate) rays: Option<usize>,
    pub(crate) sensor: Option<PathBuf>,
    pub(crate) illuminant: Option<&'a str>,
    pub(crate) diffraction: bool,
}

impl Asked<'_> {
    fn places(&self) -> PyResult<PsfPlaces> {
        let options = [
            ("heights", self.heights.is_some(), &["heights"][..]),
            ("grid", self.grid.is_some(), &["grid", "filters"]),
            ("node_error", self.node_error.is_some(), &["filters"]),
        ];
        if !["heights", "grid", "filters"].contains(&self.form) {
            return Err(refused("form", format!("`{}`", self.form), "heights, grid or filters"));
        }
        if let Some((name, _, forms)) = options.iter().find(|(_, given, forms)| *given && !forms.contains(&self.form)) {
            return Err(refused(
                name,
                format!("given with form {}", self.form),
                format!("form {}", forms.join(" or ")),
            ));
        }
        Ok(match (self.form, self.grid, self.node_error) {
            ("heights", ..) => PsfPlaces::Heights(self.heights.unwrap_or(64)),
            ("grid", grid, _) => PsfPlaces::Grid(grid.unwrap_or([9, 9])),
            (_, Some(_), Some(_)) => return Err(refused("node_error", "given beside grid", "one of the two")),
            (_, Some(grid), None) => PsfPlaces::Filters(grid),
            (_, None, error) => PsfPlaces::Nodes(error.unwrap_or(0.05)),
        })
    }
}

pub(crate) fn compute(py: Python<'_>, lens: &Lens, asked: Asked<'_>) -> PyResult<Py<PyDict>> {
    let own = PsfMapRequest::new(lens, asked.places()?);
    let request = PsfMapRequest {
        vergence: asked.distance_mm.map_or(Ok(lens.object_vergence), |mm| vergence("distance_mm", mm))?,
        size: asked.size,
        rays: asked.rays.unwrap_or(own.rays),
        diffraction: asked.diffraction,
        ..own
    };
    let light = light(asked.illuminant)?;
    let (frame, sensor) = (asked.frame, asked.sensor);
    let arrays = work(py, || {
        let frame = frame.map_or_else(|| Frame::of(lens), Ok)?;
        let sensor = sensor.as_deref().map_or_else(|| Ok(Sensor::generic()), Sensor::load)?;
        let lens = standing(lens, &frame, request.vergence)?;
        let density = SpectralDensity::under(&sensor, light)?;
        Ok(PsfMap::compute(&lens, &frame.inner, &density, &request)?.arrays())
    })?;
    let all = PyDict::new(py);
    for (name, values) in arrays {
        let value = match values {
            Values::Single(a) => given(py, a),
            Values::Double(a) => given(py, a),
            Values::Whole(a) => given(py, a),
            Values::Text(text) => PyString::new(py, &text).into_any().unbind(),
        };
        all.set_item(name, value)?;
    }
    Ok(all.unbind())
}
