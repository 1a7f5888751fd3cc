//! `capture`: the virtual camera.

use std::path::PathBuf;

use isoplanat::atomic::Target;
use isoplanat::imaging::develop::glare;
use isoplanat::imaging::render::memory as estimate;
use isoplanat::math::memory::Limit;
use isoplanat::{CaptureSettings, DngInfo, Sensor, SpectralDensity, write_dng};
use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::given;
use crate::errors::{raised, refused, vergence};
use crate::frame::Frame;
use crate::lens::Lens;
use crate::pictures::texture;
use crate::render::{light, place, standing};
use crate::work::work;

/// What the virtual camera records.
///
/// Attributes
/// ----------
/// raw : uint16 array [row, col]
///     Raw values (DN) of the mosaic.
/// clean : float32 array [row, col]
///     The signal before noise, saturation and quantisation: black 0, saturation 1.
/// cfa : str
///     The mosaic's layout, such as "RGGB".
/// black_level, white_level : float
/// render_noise, sensor_noise : float
///     Rms of the rendering's own noise that is left in `clean`, and of the sensor's on it.
/// rays : int
#[pyclass(frozen, module = "isoplanat")]
pub(crate) struct Capture {
    #[pyo3(get)]
    raw: Py<PyAny>,
    #[pyo3(get)]
    clean: Py<PyAny>,
    #[pyo3(get)]
    cfa: String,
    #[pyo3(get)]
    render_noise: f64,
    #[pyo3(get)]
    sensor_noise: f64,
    #[pyo3(get)]
    rays: u64,
    sensor: Sensor,
    lens: String,
    seed: u64,
}

/// What a sensor's file says, or "generic": cfa, full_well_electrons, read_noise_electrons, neutral_response, bits, black_level, white_level.
#[pyfunction]
pub(crate) fn sensor_facts(py: Python<'_>, sensor: PathBuf) -> PyResult<Py<PyDict>> {
    let sensor =
        if sensor.as_os_str() == "generic" { Sensor::generic() } else { Sensor::load(&sensor).map_err(raised)? };
    let facts = PyDict::new(py);
    facts.set_item("cfa", sensor.cfa.name())?;
    facts.set_item("full_well_electrons", sensor.full_well_electrons)?;
    facts.set_item("read_noise_electrons", sensor.read_noise_electrons)?;
    facts.set_item("neutral_response", sensor.neutral_response.to_vec())?;
    facts.set_item("bits", sensor.bits)?;
    facts.set_item("black_level", sensor.black_level)?;
    facts.set_item("white_level", sensor.white_level)?;
    Ok(facts.unbind())
}

#[pymethods]
impl Capture {
    /// Raw value without light, DN.
    #[getter]
    fn black_level(&self) -> f64 {
        self.sensor.black_level
    }

    /// Raw value at which a pixel saturates, DN.
    #[getter]
    fn white_level(&self) -> f64 {
        self.sensor.white_level
    }

    /// Writes it as a DNG. Raises FileExistsError unless `force`.
    #[pyo3(signature = (file, *, force = false))]
    fn save(&self, py: Python<'_>, file: PathBuf, force: bool) -> PyResult<()> {
        let info = DngInfo {
            software: concat!("isoplanat ", env!("CARGO_PKG_VERSION")).into(),
            description: format!("rays from the sensor, seed {}", self.seed),
            lens: self.lens.clone(),
            model: String::new(),
        };
        let raw: PyReadonlyArray2<'_, u16> = self.raw.bind(py).extract()?;
        let raw = raw.as_array();
        work(py, || write_dng(Target::new(&file, force), raw, &self.sensor, &info))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        Ok(format!("<Capture of shape {}, {}>", self.raw.bind(py).getattr("shape")?, self.sensor.name))
    }
}

/// A raw capture of `photo` through `lens`, by rays from the sensor, with the sensor's noise.
///
/// Parameters
/// ----------
/// lens, photo, frame, distance_mm, texels_per_pixel, illuminant
///     As of `render`. The lens may have tilts and freeform surfaces.
/// samples : int
///     Rays a pixel.
/// exposure : float
///     Signal of a white object on the axis in the green channel, relative to saturation.
/// glare : float
///     Share of the light that the lens spreads over the whole frame.
/// noise : bool
/// seed : int
///     Of rays and noise: the same bits for the same seed.
/// sensor : str or os.PathLike, optional
///     Sensor calibration (.toml); the generic sensor where left out.
#[expect(clippy::too_many_arguments, reason = "the keywords of a call")]
#[pyfunction]
#[pyo3(signature = (lens, photo, frame = None, *, distance_mm = None, texels_per_pixel = None, illuminant = None, samples = 128,
    exposure = 1.0, glare = 0.0, noise = true, seed = 1, sensor = None))]
pub(crate) fn capture(
    py: Python<'_>,
    lens: &Bound<'_, Lens>,
    photo: &Bound<'_, PyAny>,
    frame: Option<&Bound<'_, Frame>>,
    distance_mm: Option<f64>,
    texels_per_pixel: Option<f64>,
    illuminant: Option<&str>,
    samples: usize,
    exposure: f64,
    glare: f64,
    noise: bool,
    seed: u64,
    sensor: Option<PathBuf>,
) -> PyResult<Capture> {
    glare::check(glare).map_err(|e| raised(e.at("glare")))?;
    if !(2..=65_536).contains(&samples) {
        return Err(refused("samples", samples, "2 to 65536 rays a pixel"));
    }
    if let Some(texels) = texels_per_pixel.filter(|t| !(*t > 0.0 && *t <= 1000.0)) {
        return Err(refused("texels_per_pixel", texels, "a positive number, at most 1000"));
    }
    let texture = texture(photo, "photo")?;
    let light = light(illuminant)?;
    let lens = lens.get().inner.clone();
    let distance = distance_mm.map_or(Ok(lens.object_vergence), |d| vergence("distance_mm", d))?;
    let frame = frame.map(|f| f.get().clone());
    let (taken, sensor) = work(py, || {
        let frame = frame.map_or_else(|| Frame::of(&lens), Ok)?;
        let (_, rows, columns) = texture.dim();
        let bytes = estimate::rays(&frame.inner).saturating_add(estimate::scene([rows, columns]));
        let what = format!("a capture of {} × {} pixels", frame.inner.columns, frame.inner.rows);
        Limit::of_process().allow(&what, bytes, "a smaller frame or a smaller photograph")?;
        let sensor = sensor.as_deref().map_or_else(|| Ok(Sensor::generic()), Sensor::load)?;
        let lens = standing(&lens, &frame, distance)?;
        SpectralDensity::under(&sensor, light)?.require(&lens)?;
        let scene = place(&lens, &frame, texels_per_pixel, texture)?;
        let how = CaptureSettings { samples, seed, exposure, noise, glare, light };
        Ok((isoplanat::capture(&lens, &scene, &sensor, &frame.inner, how, None)?, sensor))
    })?;
    Ok(Capture {
        raw: given(py, taken.dn),
        clean: given(py, taken.clean),
        cfa: sensor.cfa.to_string(),
        render_noise: taken.render_noise,
        sensor_noise: taken.sensor_noise,
        rays: taken.rays,
        lens: lens.name.clone(),
        seed,
        sensor,
    })
}
