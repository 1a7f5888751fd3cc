//! Exceptions of the library's errors, with its text.

use std::io::ErrorKind;

use isoplanat::Error;
use pyo3::exceptions::{
    PyFileExistsError, PyFileNotFoundError, PyKeyboardInterrupt, PyOSError, PyPermissionError, PyRuntimeError,
    PyValueError,
};
use pyo3::prelude::*;

/// The exception for `error`: `ValueError` for what cannot be used, `OSError` and its kinds for files, `RuntimeError` for a fault of the program.
pub(crate) fn raised(error: Error) -> PyErr {
    match &error {
        Error::Exists(path) => PyFileExistsError::new_err(format!(
            "{}: exists already; name another output or pass force=True",
            path.display()
        )),
        Error::Io { reason, .. } => {
            let text = error.to_string();
            match reason.kind() {
                ErrorKind::NotFound => PyFileNotFoundError::new_err(text),
                ErrorKind::PermissionDenied => PyPermissionError::new_err(text),
                _ => PyOSError::new_err(text),
            }
        }
        Error::Interrupted => PyKeyboardInterrupt::new_err(()),
        Error::Internal(_) | Error::Stopped(_) => PyRuntimeError::new_err(error.to_string()),
        _ => PyValueError::new_err(in_python(&error.to_string())),
    }
}

/// The flag of a command line that is a dict in Python.
const GLASS_FOR: &str = "--glass-for ";

/// A message without the flags of a command line that there is not.
pub(crate) fn in_python(text: &str) -> String {
    let words = [
        (" (--memory-gib)", ""),
        ("--force", "force=True"),
        ("--depth-mm", "distances_mm"),
        ("--glass FILE", "glasses=[FILE]"),
    ];
    let text = words.iter().fold(text.to_owned(), |text, (flag, words)| text.replace(flag, words));
    // `--glass-for A=B` is an entry of a dict.
    let mut parts = text.split(GLASS_FOR);
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let end = part.find([' ', ';', ',', ')']).unwrap_or(part.len());
        match part[..end].split_once('=') {
            Some((name, glass)) => text.push_str(&format!("glass_for={{\"{name}\": \"{glass}\"}}{}", &part[end..])),
            None => text.push_str(&format!("glass_for {part}")),
        }
    }
    // Other flags have the arguments' names: `--texels-per-pixel` is texels_per_pixel.
    let mut parts = text.split("--");
    let mut plain = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let end = part.find(|c: char| !(c.is_ascii_lowercase() || c == '-')).unwrap_or(part.len());
        plain.push_str(&part[..end].trim_end_matches('-').replace('-', "_"));
        plain.push_str(&part[part[..end].trim_end_matches('-').len()..]);
    }
    plain
}

/// A `ValueError`: the argument, what was found there, what is allowed.
pub(crate) fn refused(argument: &str, found: impl std::fmt::Display, allowed: impl std::fmt::Display) -> PyErr {
    raised(Error::bad("", argument, found.to_string(), allowed.to_string()))
}

/// `value` where it is a positive, finite number.
pub(crate) fn positive(argument: &str, value: f64, unit: &str) -> PyResult<f64> {
    if value.is_finite() && value > 0.0 {
        return Ok(value);
    }
    Err(refused(argument, value, format!("a positive number of {unit}")))
}

/// The object's vergence, 1/mm, at a distance that may be infinite.
pub(crate) fn vergence(argument: &str, distance_mm: f64) -> PyResult<f64> {
    if distance_mm.is_nan() || distance_mm <= 0.0 {
        return Err(refused(argument, distance_mm, "a positive distance in mm, or inf"));
    }
    Ok(1.0 / distance_mm)
}
