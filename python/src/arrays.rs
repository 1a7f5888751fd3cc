//! Arrays of what Python gives: floating point as it lies where it lies in order, else a copy that does; one sentence for what is no such array.

use isoplanat::math::real::Real;
use ndarray::{Array, ArrayD, ArrayViewD, Dimension};
use numpy::{
    Element, PyArray, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArray,
    PyUntypedArrayMethods,
};
use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyString};

/// An array of floating point in row-major order.
pub(crate) enum Floats<'py> {
    /// Of 32 bits.
    Single(PyReadonlyArrayDyn<'py, f32>),
    /// Of 64 bits.
    Double(PyReadonlyArrayDyn<'py, f64>),
}

/// Whether whole numbers are taken, as f64.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Whole {
    Taken,
    Refused,
}

fn in_order<'py, T: Element>(value: &Bound<'py, PyAny>) -> Option<PyReadonlyArrayDyn<'py, T>> {
    let array = value.cast::<PyArrayDyn<T>>().ok()?.try_readonly().ok()?;
    // A slice is refused where the array is not contiguous in any order, or not aligned.
    (array.is_c_contiguous() && array.as_slice().is_ok()).then_some(array)
}

impl<'py> Floats<'py> {
    /// The array `value`, named `argument`; copied only where it is not in row-major order or of another type.
    ///
    /// # Errors
    /// `TypeError` for what holds no real numbers; whole numbers where they are refused.
    pub(crate) fn of(value: &Bound<'py, PyAny>, argument: &str, whole: Whole) -> PyResult<Self> {
        if let Some(array) = in_order::<f64>(value) {
            return Ok(Self::Double(array));
        }
        if let Some(array) = in_order::<f32>(value) {
            return Ok(Self::Single(array));
        }
        let py = value.py();
        let numpy = py.import("numpy")?;
        let array = numpy.call_method1("asarray", (value,)).map_err(|e| {
            PyTypeError::new_err(format!("{argument}: {}: no array ({}); real numbers", kind(value), e.value(py)))
        })?;
        let of_type = array.cast::<PyUntypedArray>()?.dtype();
        let wanted = match (of_type.kind(), of_type.itemsize()) {
            (b'f', 0..=4) => "float32",
            (b'f', _) => "float64",
            (b'i' | b'u', _) if whole == Whole::Taken => "float64",
            (b'i' | b'u', _) => {
                let advice = "linear light as float32 or float64 (isoplanat.read_picture reads files so)";
                return Err(PyTypeError::new_err(format!("{argument}: dtype {of_type}; {advice}")));
            }
            _ => return Err(PyTypeError::new_err(format!("{argument}: dtype {of_type}; float32 or float64"))),
        };
        let how = PyDict::new(py);
        how.set_item("dtype", wanted)?;
        how.set_item("requirements", "CA")?;
        let ordered = numpy.call_method("require", (array,), Some(&how))?;
        let lost = || PyValueError::new_err(format!("{argument}: an array that is being written to; one that is not"));
        if wanted == "float32" {
            in_order(&ordered).map(Self::Single).ok_or_else(lost)
        } else {
            in_order(&ordered).map(Self::Double).ok_or_else(lost)
        }
    }

    /// Its shape.
    pub(crate) fn shape(&self) -> &[usize] {
        match self {
            Self::Single(a) => a.shape(),
            Self::Double(a) => a.shape(),
        }
    }

    /// Its numbers in the precision `T`: as they lie where they have it, else copied.
    pub(crate) fn cast<T: Number>(&self) -> Cast<'_, T> {
        match (T::of(self), self) {
            (Some(view), _) => Cast::View(view),
            (None, Self::Single(a)) => Cast::Owned(a.as_array().mapv(|v| T::real(v.to_double()))),
            (None, Self::Double(a)) => Cast::Owned(a.as_array().mapv(T::real)),
        }
    }

    /// All of them copied in the precision `T`.
    pub(crate) fn owned<T: Number>(&self) -> ArrayD<T> {
        match self.cast() {
            Cast::View(view) => view.to_owned(),
            Cast::Owned(owned) => owned,
        }
    }
}

/// The precisions of arrays.
pub(crate) trait Number: Real + Element {
    /// The numbers as they lie, where they have this precision.
    fn of<'a>(floats: &'a Floats<'_>) -> Option<ArrayViewD<'a, Self>>;
}

impl Number for f32 {
    fn of<'a>(floats: &'a Floats<'_>) -> Option<ArrayViewD<'a, Self>> {
        if let Floats::Single(a) = floats { Some(a.as_array()) } else { None }
    }
}

impl Number for f64 {
    fn of<'a>(floats: &'a Floats<'_>) -> Option<ArrayViewD<'a, Self>> {
        if let Floats::Double(a) = floats { Some(a.as_array()) } else { None }
    }
}

/// One value, or several in a list, a tuple or an array.
pub(crate) struct Several<T>(pub(crate) Vec<T>);

/// What a list holds.
pub(crate) trait Item: Sized {
    /// In the words of a refusal.
    const ALLOWED: &'static str;
}

impl Item for f64 {
    const ALLOWED: &'static str = "a number, or several in a list";
}

impl Item for String {
    const ALLOWED: &'static str = "a name, or several in a list";
}

impl<'a, 'py, T: Item + FromPyObjectOwned<'py>> FromPyObject<'a, 'py> for Several<T> {
    type Error = PyErr;

    fn extract(value: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        // A text is a list, too; an array of one number is a number, too.
        if !value.is_instance_of::<PyString>()
            && let Ok(list) = value.extract()
        {
            return Ok(Self(list));
        }
        // Tensors, and arrays of other numbers than a list may hold.
        if let Ok(listed) = value.call_method0("tolist") {
            return listed.as_borrowed().extract();
        }
        let one =
            value.extract::<T>().map_err(|_| PyTypeError::new_err(format!("{}; {}", kind(&value), T::ALLOWED)))?;
        Ok(Self(vec![one]))
    }
}

/// Numbers as they lie, or copied.
pub(crate) enum Cast<'a, T> {
    View(ArrayViewD<'a, T>),
    Owned(ArrayD<T>),
}

impl<T> Cast<'_, T> {
    pub(crate) fn view(&self) -> ArrayViewD<'_, T> {
        match self {
            Self::View(view) => view.view(),
            Self::Owned(owned) => owned.view(),
        }
    }
}

/// The Python type of a value.
fn kind(value: &Bound<'_, PyAny>) -> String {
    value.get_type().name().map_or_else(|_| "an object".to_owned(), |name| name.to_string())
}

/// A shape as Python writes it.
pub(crate) fn written(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        _ => format!("({})", shape.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")),
    }
}

/// A `ValueError` for a shape.
pub(crate) fn wrong_shape(argument: &str, found: &[usize], allowed: &str) -> PyErr {
    crate::errors::refused(argument, format!("shape {}", written(found)), allowed)
}

/// The array for Python, without a copy.
pub(crate) fn given<T: Element, D: Dimension>(py: Python<'_>, array: Array<T, D>) -> Py<PyAny> {
    PyArray::from_owned_array(py, array).into_any().unbind()
}
