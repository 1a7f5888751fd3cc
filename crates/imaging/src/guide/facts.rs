//! What a guide holds of its lens, and that as a file: NumPy's `.npz`.
//!
//! Of each bank of filters `row_knots`, `col_knots` (pixels), `steps` `[node, channel, row, col]` (16 bits) and `scales` `[node, channel]`, a filter being steps times
//! scale; those for less and for more noise have `quiet_` and `noisy_` before their names. Of point spread functions `psf_radii` (pixels) and `psf_numbers`
//! `[radius, number]` ([`Spread`]). `vergences`, 1/mm: the object distances that all of it is for (older files have none). `schema`: the form, 1; a newer one is refused by its
//! number, and older files state none.

use std::io::{Cursor, Write};
use std::path::Path;

use ndarray::{Array1, Array2, Array4, arr0};
use ndarray_npy::{NpzReader, NpzWriter};

use super::{Filters, Inputs, Spread};
use crate::develop::simulate::Electronics;
use crate::render::Renderer;
use crate::render::node_grid::NodeGrid;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::npz;

/// The name of such a file, in a run's folder and in a kit.
pub const FILE: &str = "filters.npz";
/// Bytes of that file at most.
pub const LARGEST: u64 = 1 << 30;

/// The noise that filters are for, over the sensor's: the lens's own, and the two of [`Inputs::levels`].
const NOISE: [f64; 3] = [1.0, 0.1, 10.0];

/// The newest form that is read, and the one that is written.
const SCHEMA: i64 = 1;

/// Before the names of a bank's arrays.
const BANKS: [&str; 3] = ["", "quiet_", "noisy_"];

/// What is known of a lens on a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facts {
    /// Filters for the sensor's own noise.
    pub filters: Option<Filters>,
    /// Filters for a tenth of it, and for ten times it.
    pub levels: Option<Box<[Filters; 2]>>,
    /// What point spread functions are like.
    pub spread: Option<Spread>,
    /// The object distances that it is for, as vergence, 1/mm; empty where that is not known.
    pub vergences: Vec<f64>,
}

impl Facts {
    /// What `inputs` need, of the lens that `renderer` holds over all its distances and for the noise of `electronics`.
    ///
    /// # Errors
    /// As [`Filters::compute`].
    pub(super) fn of(inputs: Inputs, renderer: &Renderer, electronics: &Electronics) -> Result<Self> {
        let wanted = [inputs.wiener, inputs.levels, inputs.levels];
        let noise: Vec<f64> = NOISE.iter().zip(wanted).filter_map(|(n, wanted)| wanted.then_some(*n)).collect();
        let mut banks = if noise.is_empty() { Vec::new() } else { Filters::compute(renderer, electronics, &noise)? };
        let levels = if inputs.levels { Some(banks.split_off(banks.len() - 2)) } else { None };
        let spread = inputs.psf.then(|| Spread::compute(renderer));
        let known = !banks.is_empty() || levels.is_some() || spread.is_some();
        let vergences = if known { renderer.plan.depths.iter().map(|d| d.vergence).collect() } else { Vec::new() };
        let levels = levels.and_then(|two| <[Filters; 2]>::try_from(two).ok()).map(Box::new);
        Ok(Self { filters: banks.pop(), levels, spread, vergences })
    }

    /// Whether nothing is known.
    pub fn is_empty(&self) -> bool {
        self.filters.is_none() && self.levels.is_none() && self.spread.is_none()
    }

    /// The banks of filters that there are, in the order of their channels.
    pub fn banks(&self) -> impl Iterator<Item = &Filters> {
        self.filters.iter().chain(self.levels.iter().flat_map(|l| l.iter()))
    }

    /// The object distances that it is for, mm, near to far.
    pub fn depths_mm(&self) -> Vec<f64> {
        let mut depths: Vec<f64> = self.vergences.iter().map(|v| 1.0 / v).collect();
        depths.sort_by(f64::total_cmp);
        depths
    }

    /// The bytes of the file.
    ///
    /// # Errors
    /// None that is the user's.
    pub fn to_npz(&self) -> Result<Vec<u8>> {
        let failed = |e: ndarray_npy::WriteNpzError| Error::Internal(format!("filters to npz: {e}"));
        let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
        let levels = |k: usize| self.levels.as_ref().map(|l| &l[k]);
        for (bank, prefix) in [self.filters.as_ref(), levels(0), levels(1)].into_iter().zip(BANKS) {
            if let Some(filters) = bank {
                write(filters, prefix, &mut npz).map_err(failed)?;
            }
        }
        if let Some(spread) = &self.spread {
            npz.add_array("psf_radii", &Array1::from(spread.radii_px.clone())).map_err(failed)?;
            npz.add_array("psf_numbers", &spread.numbers).map_err(failed)?;
        }
        npz.add_array("schema", &arr0(SCHEMA)).map_err(failed)?;
        npz.add_array("vergences", &Array1::from(self.vergences.clone())).map_err(failed)?;
        Ok(npz.finish().map_err(failed)?.into_inner())
    }

    /// From the bytes of a file, which `path` names.
    ///
    /// # Errors
    /// No such file, or nothing of a lens in it.
    pub fn from_npz(bytes: &[u8], path: &Path) -> Result<Self> {
        let bad = |place: &str, e: String| {
            Error::bad(
                path.display().to_string(),
                place,
                e,
                "filters and point spread functions, as this program writes them",
            )
        };
        npz::check(bytes).map_err(|(place, found)| bad(&place, found))?;
        let mut npz = NpzReader::new(Cursor::new(bytes)).map_err(|e| bad("file", e.to_string()))?;
        npz::require_schema(&mut npz, SCHEMA, path)?;
        let names = npz.names().map_err(|e| bad("file", e.to_string()))?;
        let has = |name: &str| names.iter().any(|n| n == name);
        let mut banks = [None, None, None];
        for (bank, prefix) in banks.iter_mut().zip(BANKS) {
            if has(&format!("{prefix}steps")) {
                *bank = Some(read(&mut npz, prefix, &bad)?.map_err(|e| e.in_file(path))?);
            }
        }
        let [filters, quiet, noisy] = banks;
        let levels = match (quiet, noisy) {
            (Some(quiet), Some(noisy)) => Some(Box::new([quiet, noisy])),
            (None, None) => None,
            _ => return Err(bad("quiet_steps, noisy_steps", "one of the two".into())),
        };
        let spread = if has("psf_radii") {
            let radii: Array1<f64> = npz.by_name("psf_radii").map_err(|e| bad("psf_radii", e.to_string()))?;
            let numbers: Array2<f64> = npz.by_name("psf_numbers").map_err(|e| bad("psf_numbers", e.to_string()))?;
            Some(Spread::from_parts(radii.to_vec(), numbers).map_err(|e| e.in_file(path))?)
        } else {
            None
        };
        let vergences = if has("vergences") {
            let all: Array1<f64> = npz.by_name("vergences").map_err(|e| bad("vergences", e.to_string()))?;
            all.to_vec()
        } else {
            Vec::new()
        };
        if let Some(wrong) = vergences.iter().find(|v| !v.is_finite()) {
            return Err(bad("vergences", wrong.to_string()));
        }
        let facts = Self { filters, levels, spread, vergences };
        if facts.is_empty() {
            return Err(bad("file", "an archive without any".into()));
        }
        Ok(facts)
    }
}

fn write<W: Write + std::io::Seek>(
    filters: &Filters,
    prefix: &str,
    npz: &mut NpzWriter<W>,
) -> std::result::Result<(), ndarray_npy::WriteNpzError> {
    let knots = |k: &[isize]| k.iter().map(|v| *v as i64).collect::<Array1<i64>>();
    npz.add_array(format!("{prefix}row_knots"), &knots(&filters.grid.row_knots))?;
    npz.add_array(format!("{prefix}col_knots"), &knots(&filters.grid.col_knots))?;
    npz.add_array(format!("{prefix}steps"), &filters.steps)?;
    npz.add_array(format!("{prefix}scales"), &filters.scales)
}

/// A bank of filters, or why its arrays are none.
fn read(
    npz: &mut NpzReader<Cursor<&[u8]>>,
    prefix: &str,
    bad: &dyn Fn(&str, String) -> Error,
) -> Result<Result<Filters>> {
    let mut knots = |name: &str| -> Result<Vec<isize>> {
        let name = format!("{prefix}{name}");
        let all: Array1<i64> = npz.by_name(&name).map_err(|e| bad(&name, e.to_string()))?;
        all.iter().map(|v| isize::try_from(*v).map_err(|e| bad(&name, e.to_string()))).collect()
    };
    let grid = NodeGrid { row_knots: knots("row_knots")?, col_knots: knots("col_knots")? };
    let [steps, scales] = ["steps", "scales"].map(|name| format!("{prefix}{name}"));
    let values: Array4<i16> = npz.by_name(&steps).map_err(|e| bad(&steps, e.to_string()))?;
    let factors: Array2<f32> = npz.by_name(&scales).map_err(|e| bad(&scales, e.to_string()))?;
    Ok(Filters::from_parts(grid, values, factors))
}
