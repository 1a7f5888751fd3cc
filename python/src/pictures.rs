//! Pictures in and out of files, and generated scenes.

use std::path::PathBuf;

use isoplanat::atomic::Target;
use isoplanat::imaging::files::{Annotation, Depth, PICTURES, extension, write_annotated};
use isoplanat::{Encoding, SceneKind, generate, read_linear};
use ndarray::Ix3;
use pyo3::prelude::*;

use crate::arrays::{Floats, Whole, given, wrong_shape};
use crate::errors::refused;
use crate::work::work;

/// The picture in a file as linear light: float32 array [3, row, col], 1 is white.
///
/// .png, .tif, .jpg and .npy; 8, 16 and 32 bits, profiles and orientation are taken into account, grey becomes three equal channels.
///
/// Raises FileNotFoundError; ValueError for what is no picture.
#[pyfunction]
#[pyo3(signature = (file))]
pub(crate) fn read_picture(py: Python<'_>, file: PathBuf) -> PyResult<Py<PyAny>> {
    Ok(given(py, work(py, || read_linear(&file))?))
}

/// Writes a picture of linear light, [3, row, col] or [row, col]: sRGB of 16 bits in .png and .tif, of 8 in .jpg, linear floating point in .npy, and in .tif
/// with `float`.
///
/// Raises FileExistsError unless `force`. Nothing is half-written.
#[pyfunction]
#[pyo3(signature = (file, picture, *, float = false, force = false))]
pub(crate) fn write_picture(
    py: Python<'_>,
    file: PathBuf,
    picture: &Bound<'_, PyAny>,
    float: bool,
    force: bool,
) -> PyResult<()> {
    let ending = extension(&file);
    if !PICTURES.contains(&ending.as_str()) {
        let allowed = format!("a name that ends in .{}", PICTURES.join(", ."));
        return Err(refused("file", format!("the ending `.{ending}`"), allowed));
    }
    if float && !["tif", "tiff", "npy"].contains(&ending.as_str()) {
        return Err(refused("float", format!("`.{ending}` has no floating point"), ".tif, .tiff or .npy"));
    }
    let image = texture(picture, "picture")?;
    if !float && let Some((place, v)) = image.indexed_iter().find(|(_, v)| !v.is_finite()) {
        return Err(refused("picture", format!("{v} at {place:?}"), "finite light"));
    }
    let depth = if float { Depth::Float } else { Depth::Sixteen };
    work(py, || write_annotated(Target::new(&file, force), &image, Encoding::Srgb, depth, &Annotation::default()))
}

/// A built-in scene as linear light, float32 array [3, row, col]: "dead_leaves", "text", "fine_texture", "slanted_edges", "mixed", "facades",
/// "color_chart". The same bits for the same seed.
#[pyfunction]
#[pyo3(signature = (kind, rows, columns, *, seed = 1))]
pub(crate) fn scene(py: Python<'_>, kind: &str, rows: usize, columns: usize, seed: u64) -> PyResult<Py<PyAny>> {
    let Some(kind) = SceneKind::from_name(kind) else {
        let known: Vec<&str> = SceneKind::ALL.iter().map(|k| k.name()).collect();
        return Err(refused("kind", format!("`{kind}`"), known.join(", ")));
    };
    for (name, size) in [("rows", rows), ("columns", columns)] {
        if !(1..=16_384).contains(&size) {
            return Err(refused(name, size, "1 to 16384"));
        }
    }
    Ok(given(py, work(py, || Ok(generate(kind, seed, rows, columns)))?))
}

/// A picture from Python: [3, row, col], or [row, col] and [1, row, col] for one of grey. It is copied: what is rendered keeps it as it was.
pub(crate) fn texture(value: &Bound<'_, PyAny>, argument: &str) -> PyResult<ndarray::Array3<f32>> {
    let floats = Floats::of(value, argument, Whole::Refused)?;
    owned(&floats, argument)
}

/// [`texture`] of an array that was looked at.
pub(crate) fn owned(floats: &Floats<'_>, argument: &str) -> PyResult<ndarray::Array3<f32>> {
    let shape = floats.shape().to_vec();
    let allowed = match shape[..] {
        [1 | 3, rows, columns] if rows > 0 && columns > 0 => None,
        [rows, columns] if rows > 0 && columns > 0 => None,
        [_, _, 3 | 4] => Some("[3, row, col]: np.moveaxis(photo[..., :3], -1, 0) puts the channels first"),
        _ => Some("[3, row, col], or [row, col] for grey; at least one pixel"),
    };
    if let Some(allowed) = allowed {
        return Err(wrong_shape(argument, &shape, allowed));
    }
    let mut all = floats.owned::<f32>();
    if shape.len() == 2 {
        all.insert_axis_inplace(ndarray::Axis(0));
    }
    // Three dimensions by now.
    all.into_dimensionality::<Ix3>().map_err(|e| refused(argument, e, "[3, row, col]"))
}
