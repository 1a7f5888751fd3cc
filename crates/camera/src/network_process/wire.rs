//! What parent and child say to each other: lines of JSON, then tiles and answers. Numbers are in this machine's byte order.

use std::io::{BufRead, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use ndarray::{Array4, ArrayView4};
use serde::{Deserialize, Serialize};

use crate::any_path;
use crate::child::{self, Confinement};
use crate::onnxruntime::Candidate;
use crate::session::{Choice, Runtime};
use isoplanat_base::error::{BadInput, Error};

/// Samples of a tile that the child takes at most: 256 channels of the largest.
pub(super) const MOST_SAMPLES: u64 = 256 << 26;
/// Bytes of what is said in words at most.
const MOST_WORDS: u64 = 1 << 20;

/// What a child is told first; the model's bytes follow once it is ready for them.
#[derive(Serialize, Deserialize)]
pub(super) struct Asked {
    #[serde(with = "any_path")]
    pub(super) file: PathBuf,
    pub(super) model_bytes: u64,
    /// The one that the user named.
    pub(super) onnxruntime: Option<Candidate>,
    /// Where the runtime may lie, where nobody named it.
    pub(super) candidates: Vec<Candidate>,
    pub(super) threads: usize,
    pub(super) choice: Choice,
}

/// What a child says, a line each, before it answers tiles.
#[derive(Serialize, Deserialize)]
pub(super) enum Said {
    /// None of the candidates is a runtime: are there more? A line of them is the answer.
    Look,
    /// The runtime is loaded, the sandbox entered, and this is in force: the model may come.
    Ready(Confinement),
    /// It could not be held to its limits, or not enter its sandbox.
    Unheld(String),
    /// What became of the model.
    Opened(std::result::Result<Opened, BadInput>),
}

/// A model that runs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Opened {
    pub(super) runtime: Runtime,
    pub(super) workers: usize,
}

/// An error of the model in `file` as it goes to the parent: of the input, whatever became of the model.
pub(super) fn of_input(error: Error, file: &Path) -> BadInput {
    error.into_bad_input("inference", "a model that takes and returns an image").in_file(file)
}

/// A tile's result, and the time within the runtime.
pub(super) type Answer = std::result::Result<(Array4<f32>, Duration), BadInput>;

/// One line of JSON.
pub(super) fn words(out: &mut (impl Write + ?Sized), what: &impl Serialize) -> std::io::Result<()> {
    serde_json::to_writer(&mut *out, what)?;
    out.write_all(b"\n")?;
    out.flush()
}

/// What a line of JSON says.
pub(super) fn line<T: for<'a> Deserialize<'a>>(input: &mut (impl BufRead + ?Sized)) -> std::io::Result<T> {
    let mut line = Vec::new();
    input.take(MOST_WORDS).read_until(b'\n', &mut line)?;
    Ok(serde_json::from_slice(&line)?)
}

/// A tile: its number, its shape, its samples.
pub(super) fn write_tile(out: &mut (impl Write + ?Sized), id: u64, tile: ArrayView4<'_, f32>) -> std::io::Result<()> {
    out.write_all(&id.to_ne_bytes())?;
    for n in tile.shape() {
        out.write_all(&(*n as u64).to_ne_bytes())?;
    }
    out.write_all(bytemuck::cast_slice(tile.as_standard_layout().as_slice().unwrap_or_default()))?;
    out.flush()
}

pub(super) fn number(input: &mut impl Read) -> std::io::Result<u64> {
    let mut bytes = [0; 8];
    input.read_exact(&mut bytes)?;
    Ok(u64::from_ne_bytes(bytes))
}

/// The samples after a tile's number, `most` of them.
pub(super) fn read_samples(input: &mut impl Read, most: u64) -> std::io::Result<Array4<f32>> {
    let bad = || std::io::Error::new(std::io::ErrorKind::InvalidData, "a tile that is none");
    let mut shape = [0_usize; 4];
    let mut count = 1_u64;
    for n in &mut shape {
        let side = number(input)?;
        count = count.checked_mul(side).filter(|c| *c <= most).ok_or_else(bad)?;
        *n = usize::try_from(side).map_err(|_| bad())?;
    }
    let samples = child::read_samples(input, usize::try_from(count).map_err(|_| bad())?)?;
    Array4::from_shape_vec(shape, samples).map_err(|_| bad())
}

/// The next tile; `None` when there are no more.
pub(super) fn read_tile(input: &mut impl BufRead) -> std::io::Result<Option<(u64, Array4<f32>)>> {
    if input.fill_buf()?.is_empty() {
        return Ok(None);
    }
    let id = number(input)?;
    Ok(Some((id, read_samples(input, MOST_SAMPLES)?)))
}

/// What became of a tile: a byte, nanoseconds, its number and samples, or its number and a line.
pub(super) fn write_answer(out: &mut (impl Write + ?Sized), id: u64, answer: &Answer) -> std::io::Result<()> {
    match answer {
        Ok((tile, took)) => {
            out.write_all(&[1])?;
            out.write_all(&u64::try_from(took.as_nanos()).unwrap_or(u64::MAX).to_ne_bytes())?;
            write_tile(out, id, tile.view())
        }
        Err(refused) => {
            out.write_all(&[0])?;
            out.write_all(&id.to_ne_bytes())?;
            words(out, refused)
        }
    }
}

/// The next answer, of as many samples as `most` says once it is there.
pub(super) fn read_answer(input: &mut impl BufRead, most: impl Fn() -> u64) -> std::io::Result<(u64, Answer)> {
    let mut kind = [0];
    input.read_exact(&mut kind)?;
    if kind == [1] {
        let took = Duration::from_nanos(number(input)?);
        return Ok((number(input)?, Ok((read_samples(input, most())?, took))));
    }
    let id = number(input)?;
    Ok((id, Err(line(input)?)))
}

/// A line of JSON.
pub(super) fn line_of(what: &impl Serialize) -> std::io::Result<Vec<u8>> {
    let mut line = Vec::new();
    words(&mut line, what)?;
    Ok(line)
}
