//! Filters as a file: NumPy's `.npz` with `row_knots`, `col_knots` (pixels), `steps` `[node, channel, row, col]` (16 bits),
//! `scales` `[node, channel]` and `vergences` (1/mm; older files have none); a filter is steps times scale.

use std::io::Cursor;
use std::path::Path;

use ndarray::{Array1, Array2, Array4};
use ndarray_npy::{NpzReader, NpzWriter};

use super::Filters;
use crate::error::{Error, Result};
use crate::imaging::render::node_grid::NodeGrid;

/// The name of such a file, in a run's folder and in a kit.
pub const FILE: &str = "filters.npz";

impl Filters {
    /// The bytes of the file.
    ///
    /// # Errors
    /// None that is the user's.
    pub fn to_npz(&self) -> Result<Vec<u8>> {
        let failed = |e: ndarray_npy::WriteNpzError| Error::Internal(format!("filters to npz: {e}"));
        let knots = |k: &[isize]| k.iter().map(|v| *v as i64).collect::<Array1<i64>>();
        let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
        npz.add_array("row_knots", &knots(&self.grid.row_knots)).map_err(failed)?;
        npz.add_array("col_knots", &knots(&self.grid.col_knots)).map_err(failed)?;
        npz.add_array("steps", &self.steps).map_err(failed)?;
        npz.add_array("scales", &self.scales).map_err(failed)?;
        npz.add_array("vergences", &Array1::from(self.vergences.clone())).map_err(failed)?;
        Ok(npz.finish().map_err(failed)?.into_inner())
    }

    /// From the bytes of a file, which `path` names.
    ///
    /// # Errors
    /// No such file, or no filters.
    pub fn from_npz(bytes: &[u8], path: &Path) -> Result<Self> {
        let bad = |place: &str, e: String| {
            Error::bad(path.display().to_string(), place, e, "filters, as this program writes them")
        };
        let mut npz = NpzReader::new(Cursor::new(bytes)).map_err(|e| bad("file", e.to_string()))?;
        let mut knots = |name: &str| -> Result<Vec<isize>> {
            let all: Array1<i64> = npz.by_name(name).map_err(|e| bad(name, e.to_string()))?;
            all.iter().map(|v| isize::try_from(*v).map_err(|e| bad(name, e.to_string()))).collect()
        };
        let grid = NodeGrid { row_knots: knots("row_knots")?, col_knots: knots("col_knots")? };
        let steps: Array4<i16> = npz.by_name("steps").map_err(|e| bad("steps", e.to_string()))?;
        let scales: Array2<f32> = npz.by_name("scales").map_err(|e| bad("scales", e.to_string()))?;
        let known = npz.names().is_ok_and(|names| names.iter().any(|n| n == "vergences"));
        let vergences = if known {
            let all: Array1<f64> = npz.by_name("vergences").map_err(|e| bad("vergences", e.to_string()))?;
            all.to_vec()
        } else {
            Vec::new()
        };
        if let Some(wrong) = vergences.iter().find(|v| !v.is_finite()) {
            return Err(bad("vergences", wrong.to_string()));
        }
        let mut filters = Self::from_parts(grid, steps, scales).map_err(|e| e.in_file(path))?;
        filters.vergences = vergences;
        Ok(filters)
    }
}
