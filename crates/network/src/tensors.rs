//! Files of named f32 tensors (safetensors), read whole and checked, written beside their place and renamed.
//!
//! Our own facts stand in one metadata entry, `isoplanat`, as JSON in a fixed order: equal contents give equal bytes. One of them is the SHA-256 of all that
//! the file holds: one flipped bit is found.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, SafeTensors, View, serialize_to_file};

use isoplanat_base::atomic::{Replace, publish_path, read_bounded, sha256_of};
use isoplanat_base::error::{Error, Result};

/// The metadata entry that holds our facts.
const KEY: &str = "isoplanat";
/// The fact that holds the SHA-256 of the rest.
const SUM: &str = "sha256";

/// A tensor to be written: name, shape, values in row-major order.
pub(super) struct Named<'a> {
    /// Its name.
    pub(super) name: String,
    /// Its shape.
    pub(super) shape: Vec<usize>,
    /// Its values.
    pub(super) values: Cow<'a, [f32]>,
}

impl Named<'_> {
    /// Its values as they stand in a file.
    fn bytes(&self) -> Cow<'_, [u8]> {
        if cfg!(target_endian = "little") {
            Cow::Borrowed(bytemuck::cast_slice(&self.values))
        } else {
            Cow::Owned(self.values.iter().flat_map(|v| v.to_le_bytes()).collect())
        }
    }
}

impl View for &Named<'_> {
    fn dtype(&self) -> Dtype {
        Dtype::F32
    }
    fn shape(&self) -> &[usize] {
        &self.shape
    }
    fn data(&self) -> Cow<'_, [u8]> {
        self.bytes()
    }
    fn data_len(&self) -> usize {
        4 * self.values.len()
    }
}

/// Bytes of a file of weights at most.
const LARGEST: u64 = 16 << 30;

/// Writes `tensors` and `facts` to `path`, whole or not at all. Refuses values that are not finite.
pub(super) fn write(path: &Path, facts: &BTreeMap<String, String>, tensors: &[Named<'_>]) -> Result<()> {
    if let Some(bad) = tensors.iter().find(|t| t.values.iter().any(|v| !v.is_finite())) {
        return Err(Error::Internal(format!("{} is not finite; nothing was saved", bad.name)));
    }
    let mut facts = facts.clone();
    let parts = tensors.iter().map(|t| (t.name.as_str(), t.shape.as_slice(), t.bytes()));
    facts.insert(SUM.to_owned(), sum(&facts, parts.collect())?);
    let facts = json(&facts)?;
    let entries = tensors.iter().map(|t| (t.name.as_str(), t));
    publish_path(path, Replace::Always, |at| {
        serialize_to_file(entries, Some(HashMap::from([(KEY.to_owned(), facts)])), at)
            .map_err(|e| Error::writing(path, std::io::Error::other(e.to_string())))
    })
}

fn json(facts: &BTreeMap<String, String>) -> Result<String> {
    serde_json::to_string(facts).map_err(|e| Error::Internal(format!("metadata: {e}")))
}

/// A tensor's name, shape and bytes.
type Part<'a> = (&'a str, &'a [usize], Cow<'a, [u8]>);

/// SHA-256 of facts and of tensors by name: names, shapes, values.
fn sum(facts: &BTreeMap<String, String>, mut tensors: Vec<Part<'_>>) -> Result<String> {
    tensors.sort_unstable_by_key(|(name, ..)| *name);
    let mut parts = vec![Cow::Owned(json(facts)?.into_bytes())];
    for (name, shape, values) in tensors {
        parts.push(Cow::Owned(format!("{name:?} {shape:?}").into_bytes()));
        parts.push(values);
    }
    Ok(sha256_of(parts))
}

/// A file in memory.
pub(super) struct TensorFile {
    pub(super) path: PathBuf,
    facts: BTreeMap<String, String>,
    bytes: Vec<u8>,
}

impl TensorFile {
    /// Reads and checks a file; `allowed` says in errors what was wanted.
    pub(super) fn read(path: &Path, allowed: &str) -> Result<Self> {
        let bytes = read_bounded(path, LARGEST)?;
        let bad = |found: String| Error::bad(path.display().to_string(), "header", found, allowed);
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| bad(e.to_string()))?;
        let mut facts: BTreeMap<String, String> = match header.metadata().as_ref().and_then(|m| m.get(KEY)) {
            Some(text) => serde_json::from_str(text).map_err(|e| bad(format!("metadata: {e}")))?,
            None => BTreeMap::new(),
        };
        // Lengths and offsets of every tensor, once; later views cannot fail.
        let tensors = SafeTensors::deserialize(&bytes).map_err(|e| bad(e.to_string()))?;
        // Files of others have no sum, nor had ours once.
        if let Some(told) = facts.remove(SUM) {
            let views = tensors.tensors();
            let parts = views.iter().map(|(name, view)| (name.as_str(), view.shape(), Cow::Borrowed(view.data())));
            let found = sum(&facts, parts.collect())?;
            if found != told {
                let found =
                    format!("contents with the SHA-256 {}…, {}… told", &found[..8], told.get(..8).unwrap_or(&told));
                return Err(Error::bad(path.display().to_string(), "sha256", found, "the file as it was written"));
            }
        }
        Ok(Self { path: path.to_owned(), facts, bytes })
    }

    /// The error of a bad entry of this file.
    pub(super) fn bad(&self, place: &str, found: impl Into<String>, allowed: &str) -> Error {
        Error::bad(self.path.display().to_string(), place, found, allowed)
    }

    /// One of our facts.
    pub(super) fn fact(&self, key: &str) -> Option<&str> {
        self.facts.get(key).map(String::as_str)
    }

    /// All our facts.
    pub(super) fn facts(&self) -> &BTreeMap<String, String> {
        &self.facts
    }

    /// Numbers that its bytes hold at most.
    pub(super) fn numbers(&self) -> u64 {
        self.bytes.len() as u64 / 4
    }

    fn tensors(&self) -> Result<SafeTensors<'_>> {
        SafeTensors::deserialize(&self.bytes).map_err(|e| self.bad("header", e.to_string(), "a safetensors file"))
    }

    /// The names of all tensors.
    pub(super) fn names(&self) -> Result<Vec<String>> {
        Ok(self.tensors()?.names().into_iter().map(str::to_owned).collect())
    }

    /// Appends the tensor `name`, which must have `shape` and finite f32 values.
    pub(super) fn append(&self, name: &str, shape: &[usize], values: &mut Vec<f32>) -> Result<()> {
        let tensors = self.tensors()?;
        let tensor = tensors.tensor(name).map_err(|_| self.bad(name, "missing", "a tensor of that name"))?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
            return Err(self.bad(
                name,
                format!("{:?} {:?}", tensor.dtype(), tensor.shape()),
                &format!("F32 {shape:?}"),
            ));
        }
        let before = values.len();
        values.extend(tensor.data().chunks_exact(4).map(|c| f32::from_le_bytes([c[0], c[1], c[2], c[3]])));
        if values[before..].iter().any(|v| !v.is_finite()) {
            return Err(self.bad(name, "a value that is not finite", "finite values"));
        }
        Ok(())
    }

    /// The tensor `name`, which must have `shape`.
    pub(super) fn tensor(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let mut values = Vec::new();
        self.append(name, shape, &mut values)?;
        Ok(values)
    }
}
