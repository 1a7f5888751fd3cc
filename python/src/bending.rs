//! By what kernels are made, as Python says it.

use isoplanat::Diffraction;
use isoplanat::psf::Model;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use crate::errors::refused;

/// A name, or True and False for "on" and "off".
pub(crate) struct Bending(String);

impl<'a, 'py> FromPyObject<'a, 'py> for Bending {
    type Error = PyErr;

    fn extract(value: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        if let Ok(name) = value.extract::<String>() {
            return Ok(Self(name));
        }
        let on: bool = value
            .extract()
            .map_err(|_| PyTypeError::new_err(format!("diffraction: {}; a name, True or False", *value)))?;
        Ok(Self(if on { "on" } else { "off" }.to_owned()))
    }
}

impl Bending {
    /// Kernels of rays.
    pub(crate) fn off() -> Self {
        Self("off".to_owned())
    }

    fn refused(&self, allowed: &str) -> PyErr {
        refused("diffraction", format!("{:?}", self.0), format!("{allowed}; True is \"on\", False \"off\""))
    }

    /// Of pictures.
    ///
    /// # Errors
    /// A name that is none.
    pub(crate) fn of_pictures(asked: Option<&Self>) -> PyResult<Diffraction> {
        let Some(asked) = asked.filter(|asked| asked.0 != "auto") else { return Ok(Diffraction::Auto) };
        let wanted = "\"on\", \"off\", \"approximate\" or \"auto\"";
        Model::from_name(&asked.0).map(Diffraction::from).ok_or_else(|| asked.refused(wanted))
    }

    /// Of a layer's kernels: patches of a training do not decide it.
    ///
    /// # Errors
    /// A name that is none.
    pub(crate) fn of_layers(asked: Option<&Self>) -> PyResult<Model> {
        let Some(asked) = asked else { return Ok(Model::Rays) };
        Model::from_name(&asked.0).ok_or_else(|| asked.refused("\"off\", \"approximate\" or \"on\""))
    }

    /// Of point spread functions: whether by waves.
    ///
    /// # Errors
    /// A name that is none.
    pub(crate) fn of_kernels(asked: Option<&Self>) -> PyResult<bool> {
        let Some(asked) = asked else { return Ok(false) };
        match &*asked.0 {
            "off" => Ok(false),
            "on" => Ok(true),
            _ => Err(asked.refused("\"on\" or \"off\"")),
        }
    }
}
