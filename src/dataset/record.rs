//! What is whole: a record for each unit, written after its files; the table of all pairs, made of the records.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::metrics::decibel;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::report::columns::Column;

/// A line of `pairs.csv`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Row {
    /// Number of the pair.
    pub pair: usize,
    /// Name of the lens.
    pub lens: String,
    /// Its number.
    pub lens_index: usize,
    /// Name of the photograph's file.
    pub photo: String,
    /// Object distance, mm; none is infinity.
    pub distance_mm: Option<f64>,
    /// Place in the frame: the first row and column, rows and columns.
    pub row: usize,
    /// First column.
    pub column: usize,
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub columns: usize,
    /// Half field angle that the pair's middle sees, degrees.
    pub field_deg: f64,
    /// Name of the sensor; empty without noise.
    pub sensor: String,
    /// Noise deviation over the sensor's own.
    pub noise_level: f64,
    /// Variance of the noise a unit of signal.
    pub shot: f64,
    /// Deviation of the noise without signal.
    pub read: f64,
    /// Seed of the noise.
    pub seed: u64,
    /// Predicted PSNR of the picture before noise, dB; none where nothing had to be predicted.
    pub predicted_psnr_db: Option<f64>,
    /// What rays say of it.
    pub judged: Option<Judged>,
    /// File of the capture, from the data set's folder.
    pub capture: String,
    /// File of the truth.
    pub truth: String,
    /// Place in a shard; 0 in files of one pair.
    pub place: usize,
}

/// Mean square error of a picture before noise, as rays measure it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Judged {
    /// Without the rays' own noise, which may make it negative.
    pub mean_square: f64,
    /// Its standard error.
    pub standard_error: f64,
}

impl Judged {
    /// PSNR, dB; infinite where no error is seen.
    pub fn psnr_db(&self) -> f64 {
        db(self.mean_square)
    }

    /// 95 % interval of it.
    pub fn interval_db(&self) -> [f64; 2] {
        [1.96, -1.96].map(|errors| db(self.mean_square + errors * self.standard_error))
    }

    /// Whether so many dB are held, as far as the rays' noise lets it be told: the interval does not lie below them.
    pub fn holds(&self, db: f64) -> bool {
        self.interval_db()[1] >= db
    }

    /// The mean of several; `None` of none.
    pub(super) fn mean(all: &[Self]) -> Option<Self> {
        let count = all.len() as f64;
        let sum = |of: fn(&Self) -> f64| all.iter().map(of).sum::<f64>();
        (!all.is_empty()).then(|| Self {
            mean_square: sum(|j| j.mean_square) / count,
            standard_error: sum(|j| j.standard_error.powi(2)).sqrt() / count,
        })
    }
}

/// The PSNR of a mean square error.
pub(super) fn db(mean_square: f64) -> f64 {
    if mean_square > 0.0 { decibel(mean_square) } else { f64::INFINITY }
}

/// A number, or nothing.
fn or_none(value: Option<f64>) -> String {
    value.map_or(String::new(), |v| v.to_string())
}

/// The columns of `pairs.csv`.
pub const COLUMNS: [Column<Row>; 22] = [
    Column::value("pair", |r| r.pair.to_string()),
    Column::value("lens", |r| r.lens.clone()),
    Column::value("photo", |r| r.photo.clone()),
    Column::value("distance_mm", |r| r.distance_mm.unwrap_or(f64::INFINITY).to_string()),
    Column::value("row", |r| r.row.to_string()),
    Column::value("column", |r| r.column.to_string()),
    Column::value("rows", |r| r.rows.to_string()),
    Column::value("columns", |r| r.columns.to_string()),
    Column::value("field_deg", |r| r.field_deg.to_string()),
    Column::value("sensor", |r| r.sensor.clone()),
    Column::value("noise_level", |r| r.noise_level.to_string()),
    Column::value("shot_variance", |r| r.shot.to_string()),
    Column::value("read_deviation", |r| r.read.to_string()),
    Column::value("seed", |r| r.seed.to_string()),
    Column::value("predicted_psnr_db", |r| or_none(r.predicted_psnr_db)),
    Column::value("judged_psnr_db", |r| or_none(r.judged.map(|j| j.psnr_db()))),
    Column::value("judged_low_db", |r| or_none(r.judged.map(|j| j.interval_db()[0]))),
    Column::value("judged_high_db", |r| or_none(r.judged.map(|j| j.interval_db()[1]))),
    Column::value("lens_index", |r| r.lens_index.to_string()),
    Column::value("capture", |r| r.capture.clone()),
    Column::value("truth", |r| r.truth.clone()),
    Column::value("place", |r| r.place.to_string()),
];

/// What a unit has written.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Record {
    /// Its pairs.
    pub rows: Vec<Row>,
    /// Its files.
    pub files: Vec<Written>,
}

/// A file as it was written.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Written {
    /// From the data set's folder.
    pub name: String,
    /// Length.
    pub bytes: u64,
    /// SHA-256, in hexadecimal.
    pub sha256: String,
}

/// Bytes of a record at most.
const LARGEST: u64 = 1 << 30;

impl Written {
    /// The file of a name.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub(super) fn of(folder: &Path, name: &str) -> Result<Self> {
        Self::at(&folder.join(name), name)
    }

    /// The file of a path, under a name.
    ///
    /// # Errors
    /// As [`Self::of`].
    pub(super) fn at(path: &Path, name: &str) -> Result<Self> {
        let failed = |e| Error::reading(path, e);
        let mut file = File::open(path).map_err(failed)?;
        let (mut hash, mut bytes, mut room) = (Sha256::new(), 0, vec![0; 1 << 20]);
        loop {
            let count = file.read(&mut room).map_err(failed)?;
            if count == 0 {
                break;
            }
            hash.update(&room[..count]);
            bytes += count as u64;
        }
        let sha256 = hash.finalize().iter().map(|b| format!("{b:02x}")).collect();
        Ok(Self { name: name.to_owned(), bytes, sha256 })
    }
}

impl Record {
    fn path(folder: &Path, unit: usize) -> PathBuf {
        folder.join("records").join(format!("{unit:05}.json"))
    }

    /// Writes it; the files are whole.
    ///
    /// # Errors
    /// What the disk says.
    pub(super) fn write(&self, folder: &Path, unit: usize) -> Result<()> {
        let text = serde_json::to_string(self).map_err(|e| Error::Internal(format!("a record: {e}")))?;
        atomic::write_bytes(&Self::path(folder, unit), text.as_bytes())
    }

    /// The record of a unit; `None` where there is none that can be read.
    pub(super) fn read(folder: &Path, unit: usize) -> Option<Self> {
        let text = atomic::read_text(&Self::path(folder, unit), LARGEST).ok()?;
        serde_json::from_str(&text).ok()
    }

    /// Whether every file is as it was written.
    pub(super) fn holds(&self, folder: &Path) -> bool {
        let same = |w: &Written| {
            std::fs::metadata(folder.join(&w.name)).is_ok_and(|m| m.len() == w.bytes)
                && Written::of(folder, &w.name).is_ok_and(|now| now == *w)
        };
        self.files.iter().all(same)
    }

    /// Whether there is a record of a unit.
    pub(super) fn is_there(folder: &Path, unit: usize) -> bool {
        Self::path(folder, unit).is_file()
    }
}
