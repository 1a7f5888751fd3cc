//! Files of a data set: pictures in two folders, or shards of arrays.

use std::path::Path;

use isoplanat_base::atomic::{Target, write_atomic};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::npz;
use isoplanat_imaging::files::{Annotation, Depth, Encoding, write_annotated};
use ndarray::{Array1, Array3, Array4, ArrayBase, Data, Dimension, s};
use ndarray_npy::{WritableElement, WriteNpyError, WriteNpyExt};

use super::pair::Pair;

/// How pairs are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// PNG of 16 bits with the sRGB curve, cut off below black and above white.
    Png,
    /// TIFF of 32-bit floating point in linear light.
    Tiff,
    /// NumPy arrays of many pairs, `[pair, row, col, channel]` float32 in linear light, one file of captures and one of truths.
    Npy,
    /// The same in one archive, with what the table says in numbers.
    Npz,
}

/// Bytes of a shard's captures at most, unless its pairs are counted.
const SHARD: usize = 256 << 20;
/// Pairs of a shard at most, unless they are counted.
const PAIRS: usize = 1024;

impl Form {
    /// The forms there are.
    pub const ALL: [Self; 4] = [Self::Png, Self::Tiff, Self::Npy, Self::Npz];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Tiff => "tiff",
            Self::Npy => "npy",
            Self::Npz => "npz",
        }
    }

    /// Whether one file holds many pairs.
    pub(super) fn has_shards(self) -> bool {
        matches!(self, Self::Npy | Self::Npz)
    }

    /// Photographs whose pairs stand in one file: `crops` of each, so many pixels large; `asked` pairs at most.
    pub(super) fn together(self, asked: Option<usize>, crops: usize, pixels: usize) -> usize {
        let fitting = (SHARD / (pixels.max(1) * 3 * size_of::<f32>())).clamp(1, PAIRS);
        if self.has_shards() { (asked.unwrap_or(fitting) / crops).max(1) } else { 1 }
    }

    /// Names of the files that hold capture and truth of a pair in a unit, from the data set's folder.
    pub(super) fn files(self, pair: usize, unit: usize) -> [String; 2] {
        match self {
            Self::Png => [format!("capture/{pair:06}.png"), format!("truth/{pair:06}.png")],
            Self::Tiff => [format!("capture/{pair:06}.tif"), format!("truth/{pair:06}.tif")],
            Self::Npy => [format!("capture/{unit:05}.npy"), format!("truth/{unit:05}.npy")],
            Self::Npz => [format!("pairs/{unit:05}.npz"), format!("pairs/{unit:05}.npz")],
        }
    }

    /// Folders that the files stand in.
    pub(super) fn folders(self) -> &'static [&'static str] {
        if self == Self::Npz { &["pairs"] } else { &["capture", "truth"] }
    }

    /// Writes the pairs of a unit into the data set's `folder`; the files' names, each once.
    ///
    /// # Errors
    /// What the disk says.
    pub(super) fn write(self, folder: &Path, unit: usize, pairs: &[Pair]) -> Result<Vec<String>> {
        let mut names = Vec::new();
        match self {
            Self::Png | Self::Tiff => {
                for pair in pairs {
                    let files = self.files(pair.row.pair, unit);
                    for (name, image) in files.iter().zip([&pair.capture, &pair.truth]) {
                        let depth = if self == Self::Tiff { Depth::Float } else { Depth::Sixteen };
                        let annotation = Annotation::default();
                        write_annotated(&folder.join(name), image, Encoding::Srgb, depth, &annotation)?;
                    }
                    names.extend(files);
                }
            }
            Self::Npy => {
                let files = self.files(0, unit);
                for (k, name) in files.iter().enumerate() {
                    write_npy(&folder.join(name), &stacked(pairs, k))?;
                }
                names.extend(files);
            }
            Self::Npz => {
                let [name, _] = self.files(0, unit);
                archive(&folder.join(&name), pairs)?;
                names.push(name);
            }
        }
        Ok(names)
    }
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
