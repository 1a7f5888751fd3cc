//! `Frame`: size of a picture, pixel pitch, and where the optical axis meets it.

use std::hash::{DefaultHasher, Hash, Hasher};

use isoplanat::imaging::frame;
use pyo3::prelude::*;

use crate::errors::raised;

/// Size of a picture, pixel pitch, and where the optical axis meets it.
///
/// Parameters
/// ----------
/// columns, rows : int
///     Pixels, 1 to 65536 each.
/// pitch_um : float
///     Distance of neighbouring pixels, µm.
/// axis_px : (float, float), optional
///     Column and row of the optical axis, in pixels from the first corner; the centre where left out.
///
/// A picture on it has the shape [3, rows, columns] and stands upright.
#[pyclass(frozen, eq, module = "isoplanat")]
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Frame {
    pub(crate) inner: frame::Frame,
    pitch_um: f64,
}

impl Frame {
    /// The frame of the raster that a lens file states.
    pub(crate) fn of(lens: &isoplanat::Lens) -> isoplanat::Result<Self> {
        Ok(Self { inner: isoplanat::frame_of(lens)?, pitch_um: lens.sensor.pitch_um })
    }

    /// Its pixel pitch as it was stated, µm.
    pub(crate) fn pitch(&self) -> f64 {
        self.pitch_um
    }
}

#[pymethods]
impl Frame {
    #[new]
    #[pyo3(signature = (columns, rows, pitch_um, axis_px = None))]
    fn new(columns: usize, rows: usize, pitch_um: f64, axis_px: Option<[f64; 2]>) -> PyResult<Self> {
        crate::errors::positive("pitch_um", pitch_um, "µm")?;
        let centred = frame::Frame::centred(columns, rows, pitch_um * 1e-3).map_err(raised)?;
        let inner = match axis_px {
            Some(axis) => centred.with_axis(axis).map_err(raised)?,
            None => centred,
        };
        Ok(Self { inner, pitch_um })
    }

    /// Pixels in a row.
    #[getter]
    fn columns(&self) -> usize {
        self.inner.columns
    }

    /// Pixels in a column.
    #[getter]
    fn rows(&self) -> usize {
        self.inner.rows
    }

    /// Distance of neighbouring pixels, µm.
    #[getter]
    fn pitch_um(&self) -> f64 {
        self.pitch_um
    }

    /// Column and row of the optical axis, in pixels from the first corner.
    #[getter]
    fn axis_px(&self) -> (f64, f64) {
        self.inner.axis_px.into()
    }

    fn __repr__(&self) -> String {
        let frame::Frame { columns, rows, axis_px: [x, y], .. } = &self.inner;
        format!("Frame(columns={columns}, rows={rows}, pitch_um={}, axis_px=({x}, {y}))", self.pitch_um)
    }

    fn __hash__(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        (self.inner.columns, self.inner.rows).hash(&mut hasher);
        [self.pitch_um, self.inner.axis_px[0], self.inner.axis_px[1]].map(f64::to_bits).hash(&mut hasher);
        hasher.finish()
    }

    #[expect(clippy::type_complexity, reason = "what pickle asks for")]
    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> (Bound<'py, PyAny>, (usize, usize, f64, (f64, f64))) {
        let own = slf.get();
        let arguments = (own.inner.columns, own.inner.rows, own.pitch_um, own.axis_px());
        (slf.get_type().into_any(), arguments)
    }
}
