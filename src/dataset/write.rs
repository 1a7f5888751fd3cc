//! The files of a unit.

use std::path::Path;

use isoplanat_base::atomic::{Target, write_atomic};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::npz;
use isoplanat_imaging::files::{Annotation, Depth, Encoding, write_annotated};
use ndarray::{Array1, Array3, Array4, ArrayBase, Data, Dimension, s};
use ndarray_npy::{WritableElement, WriteNpyError, WriteNpyExt};

use super::form::Form;
use super::pair::Pair;

/// Writes the pairs of a unit into the data set's `folder`; the files' names, each once.
///
/// # Errors
/// What the disk says.
pub(super) fn write(form: Form, folder: &Path, unit: usize, pairs: &[Pair]) -> Result<Vec<String>> {
    let mut names = Vec::new();
    match form {
        Form::Png | Form::Tiff => {
            for pair in pairs {
                let files = form.files(pair.row.pair, unit);
                for (name, image) in files.iter().zip([&pair.capture, &pair.truth]) {
                    let depth = if form == Form::Tiff { Depth::Float } else { Depth::Sixteen };
                    let annotation = Annotation::default();
                    write_annotated(&folder.join(name), image, Encoding::Srgb, depth, &annotation)?;
                }
                names.extend(files);
            }
        }
        Form::Npy => {
            let files = form.files(0, unit);
            for (k, name) in files.iter().enumerate() {
                write_npy(&folder.join(name), &stacked(pairs, k))?;
            }
            names.extend(files);
        }
        Form::Npz => {
            let [name, _] = form.files(0, unit);
            archive(&folder.join(&name), pairs)?;
            names.push(name);
        }
    }
    Ok(names)
}

/// Captures (0) or truths (1) as `[pair, row, col, channel]`.
fn stacked(pairs: &[Pair], which: usize) -> Array4<f32> {
    let of = |pair: &'_ Pair| -> Array3<f32> {
        let image = if which == 0 { &pair.capture } else { &pair.truth };
        image.view().permuted_axes([1, 2, 0]).as_standard_layout().into_owned()
    };
    let (channels, rows, cols) = pairs.first().map_or((3, 0, 0), |p| p.capture.dim());
    let mut all = Array4::zeros((pairs.len(), rows, cols, channels));
    pairs.iter().enumerate().for_each(|(k, pair)| all.slice_mut(s![k, .., .., ..]).assign(&of(pair)));
    all
}

/// An array as `.npy`, whole or not at all.
fn write_npy<S, D>(path: &Path, array: &ArrayBase<S, D>) -> Result<()>
where
    S: Data,
    S::Elem: WritableElement,
    D: Dimension,
{
    write_atomic(path, |out| {
        array.write_npy(out).map_err(|e| match e {
            WriteNpyError::Io(e) => Error::writing(path, e),
            e => Error::Internal(format!("array: {e}")),
        })
    })
}

/// Pairs as one archive.
fn archive(path: &Path, pairs: &[Pair]) -> Result<()> {
    let numbers = |of: &dyn Fn(&Pair) -> f64| -> Array1<f64> { pairs.iter().map(of).collect() };
    let whole = |of: &dyn Fn(&Pair) -> u64| -> Array1<u64> { pairs.iter().map(of).collect() };
    npz::write(Target::from(path), |out| {
        out.add_array("capture", &stacked(pairs, 0))?;
        out.add_array("truth", &stacked(pairs, 1))?;
        out.add_array("pair", &whole(&|p| p.row.pair as u64))?;
        out.add_array("lens", &whole(&|p| p.row.lens_index as u64))?;
        out.add_array("row", &whole(&|p| p.row.row as u64))?;
        out.add_array("column", &whole(&|p| p.row.column as u64))?;
        out.add_array("distance_mm", &numbers(&|p| p.row.distance_mm.unwrap_or(f64::INFINITY)))?;
        out.add_array("field_deg", &numbers(&|p| p.row.field_deg))?;
        out.add_array("shot_variance", &numbers(&|p| p.row.shot))?;
        out.add_array("read_deviation", &numbers(&|p| p.row.read))?;
        out.add_array("seed", &whole(&|p| p.row.seed))
    })
}
