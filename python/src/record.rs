//! `Record`: what a rendered picture keeps for its gradient.

use isoplanat::imaging::render::Rendered;
use isoplanat::{Error, LensGradient, Plane, Region, Result};
use ndarray::{Array3, ArrayView3, Ix3};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Cast, Floats, Number, Whole, given, wrong_shape};
use crate::errors::refused;
use crate::render::Plan;
use crate::work::work;

/// A rendered picture with what its gradient needs.
///
/// Attributes
/// ----------
/// truth : array [3, row, col]
///     The ideal picture: the lens's distortion, no blur, no falling light.
/// illumination : array [3, row, col]
///     Irradiance of white over that on the axis.
/// plan : Plan
///     For `render.record(other, photo, plan=record.plan)`: another lens, all else as here.
#[pyclass(frozen, module = "isoplanat")]
pub(crate) struct Record {
    #[pyo3(get)]
    truth: Py<PyAny>,
    #[pyo3(get)]
    illumination: Py<PyAny>,
    #[pyo3(get)]
    plan: Plan,
    scene: Plane,
    kept: Kept,
}

enum Kept {
    Single(Box<Rendered<f32>>),
    Double(Box<Rendered<f64>>),
}

/// The part of the frame, or all of it.
fn part(frame: &isoplanat::Frame, region: Option<[usize; 4]>) -> PyResult<Region> {
    let Some([row, col, rows, cols]) = region else { return Ok(Region::whole(frame)) };
    let inside = |from: usize, n: usize, all: usize| n > 0 && from.checked_add(n).is_some_and(|end| end <= all);
    if !(inside(row, rows, frame.rows) && inside(col, cols, frame.columns)) {
        let allowed = format!("(row, col, rows, columns) within {} rows and {} columns", frame.rows, frame.columns);
        return Err(refused("region", format!("({row}, {col}, {rows}, {cols})"), allowed));
    }
    Ok(Region { row: row.cast_signed(), col: col.cast_signed(), rows, cols })
}

/// Picture, ideal and illumination of what was rendered, the first two taken out of it.
fn taken<T: Number>(py: Python<'_>, rendered: &mut Rendered<T>) -> [Py<PyAny>; 3] {
    let [picture, truth] = [&mut rendered.image, &mut rendered.truth].map(std::mem::take);
    [given(py, picture), given(py, truth), given(py, rendered.illumination.clone())]
}

impl Record {
    /// Renders `scene` by `plan`; the picture and the record.
    pub(crate) fn of(
        py: Python<'_>,
        plan: Plan,
        scene: Plane,
        region: Option<[usize; 4]>,
        double: bool,
    ) -> PyResult<(Py<PyAny>, Self)> {
        let region = part(&plan.renderer.plan.frame, region)?;
        let ([picture, truth, illumination], kept) = if double {
            let mut rendered = work(py, || Ok(plan.renderer.record::<f64>(&scene, 0, region)))?;
            (taken(py, &mut rendered), Kept::Double(Box::new(rendered)))
        } else {
            let mut rendered = work(py, || Ok(plan.renderer.record::<f32>(&scene, 0, region)))?;
            (taken(py, &mut rendered), Kept::Single(Box::new(rendered)))
        };
        Ok((picture, Self { truth, illumination, plan, scene, kept }))
    }
}

#[pymethods]
impl Record {
    /// The gradient of a loss by every number of the lens, under the names of `Lens.parameters`: lengths in mm, curvatures in 1/mm, angles in radians.
    ///
    /// Parameters
    /// ----------
    /// picture_bar : array [3, row, col]
    ///     ∂loss/∂picture, of the picture's shape.
    /// truth_bar, illumination_bar : arrays [3, row, col], optional
    ///     The same for a loss that reads `truth` or `illumination`.
    ///
    /// Held: the photograph, the plan (where kernels stand, how large and how fine they are).
    #[pyo3(signature = (picture_bar, truth_bar = None, illumination_bar = None))]
    fn vjp(
        &self,
        py: Python<'_>,
        picture_bar: &Bound<'_, PyAny>,
        truth_bar: Option<&Bound<'_, PyAny>>,
        illumination_bar: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Py<PyDict>> {
        let bars =
            [("picture_bar", Some(picture_bar)), ("truth_bar", truth_bar), ("illumination_bar", illumination_bar)];
        let bars = bars.map(|(name, bar)| bar.map(|bar| self.bar(bar, name)).transpose());
        let [picture, truth, illumination] = bars;
        let bars = [picture?, truth?, illumination?];
        let gradient = match &self.kept {
            Kept::Single(rendered) => self.pulled(py, rendered, &bars)?,
            Kept::Double(rendered) => self.pulled(py, rendered, &bars)?,
        };
        crate::lens::named(py, &self.plan.lens, &gradient)
    }

    fn __repr__(&self) -> String {
        let (_, rows, columns) = self.shape();
        format!("<Record of {columns} × {rows} pixels>")
    }
}

impl Record {
    fn shape(&self) -> (usize, usize, usize) {
        match &self.kept {
            Kept::Single(rendered) => rendered.illumination.dim(),
            Kept::Double(rendered) => rendered.illumination.dim(),
        }
    }

    fn bar<'py>(&self, bar: &Bound<'py, PyAny>, name: &str) -> PyResult<Floats<'py>> {
        let floats = Floats::of(bar, name, Whole::Taken)?;
        let (channels, rows, columns) = self.shape();
        if floats.shape() != [channels, rows, columns] {
            return Err(wrong_shape(
                name,
                floats.shape(),
                &format!("that of the picture, ({channels}, {rows}, {columns})"),
            ));
        }
        Ok(floats)
    }

    fn pulled<T: Number>(
        &self,
        py: Python<'_>,
        rendered: &Rendered<T>,
        bars: &[Option<Floats<'_>>; 3],
    ) -> PyResult<LensGradient> {
        let nothing: Array3<T> = Array3::from_elem(self.shape(), T::zero());
        let cast: [Option<Cast<'_, T>>; 3] = bars.each_ref().map(|bar| bar.as_ref().map(Floats::cast));
        let views = cast.each_ref().map(|c| c.as_ref().map_or_else(|| nothing.view().into_dyn(), Cast::view));
        work(py, || {
            let [picture, truth, illumination] = views.map(|v| finite(v.into_dimensionality::<Ix3>()));
            let renderer = &self.plan.renderer;
            let bar = renderer.vjp(&self.scene, rendered, picture?, truth?, illumination?);
            Ok(renderer.lens_gradient(&self.plan.lens, &bar))
        })
    }
}

fn finite<T: Number>(bar: std::result::Result<ArrayView3<'_, T>, ndarray::ShapeError>) -> Result<ArrayView3<'_, T>> {
    let bar = bar.map_err(|e| Error::Internal(e.to_string()))?;
    match bar.indexed_iter().find(|(_, v)| !v.is_finite()) {
        None => Ok(bar),
        Some(((c, i, j), v)) => {
            let place = format!("cotangent, channel {c}, row {i}, column {j}");
            Err(Error::bad("", place, v.to_double().to_string(), "finite numbers"))
        }
    }
}
