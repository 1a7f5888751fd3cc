//! Checkpoints in the safetensors format: weights, Adam's moments, step counter, size; bit for bit.
//!
//! A file is an 8-byte little-endian length, a JSON header `name → {dtype, shape, data_offsets}` with our entries under
//! `__metadata__`, and the raw little-endian values. Moments are stored as `adam.first.<name>`, `adam.second.<name>`.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::adam::Adam;
use super::reconstructor::Parameter;
use super::unet::UnetConfig;
use crate::error::{Error, Result};

const SCHEMA: &str = "1";

/// One tensor's entry in the header.
#[derive(Serialize, Deserialize)]
struct Entry {
    dtype: String,
    shape: Vec<usize>,
    data_offsets: [usize; 2],
}

/// Writes a checkpoint beside `path`, then renames it.
pub(super) fn save(
    path: &Path,
    config: &UnetConfig,
    parameters: &[Parameter],
    adam: &Adam,
) -> Result<()> {
    let finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
    if let Some(bad) = parameters.iter().find(|p| !finite(&p.values)) {
        return Err(Error::Internal(format!(
            "parameter {} is not finite; nothing was saved",
            bad.name
        )));
    }
    if !finite(&adam.first) || !finite(&adam.second) {
        return Err(Error::Internal(
            "the optimiser's moments are not finite; nothing was saved".into(),
        ));
    }
    let metadata = BTreeMap::from([
        ("schema", SCHEMA.to_owned()),
        ("steps", adam.steps.to_string()),
        ("config", serde_json::to_string(config).map_err(internal)?),
    ]);
    let mut header = serde_json::Map::new();
    header.insert("__metadata__".into(), serde_json::to_value(metadata).map_err(internal)?);
    let mut data = Vec::new();
    let mut offset = 0;
    for parameter in parameters {
        let n = parameter.values.len();
        let tensors = [
            (parameter.name.clone(), parameter.values.as_slice()),
            (format!("adam.first.{}", parameter.name), &adam.first[offset..offset + n]),
            (format!("adam.second.{}", parameter.name), &adam.second[offset..offset + n]),
        ];
        for (name, values) in tensors {
            let start = data.len();
            data.extend(values.iter().flat_map(|v| v.to_le_bytes()));
            let entry = Entry {
                dtype: "F32".into(),
                shape: parameter.shape.clone(),
                data_offsets: [start, data.len()],
            };
            header.insert(name, serde_json::to_value(entry).map_err(internal)?);
        }
        offset += n;
    }
    let mut text = serde_json::to_vec(&header).map_err(internal)?;
    text.resize(text.len().next_multiple_of(8), b' ');
    let mut bytes = (text.len() as u64).to_le_bytes().to_vec();
    bytes.extend(text);
    bytes.extend(data);
    write_whole(path, &bytes)
}

/// The network's size in a checkpoint.
pub(super) fn read_config(path: &Path) -> Result<UnetConfig> {
    let file = Checkpoint::read(path)?;
    let text = file.metadata("config")?;
    let config: UnetConfig = serde_json::from_str(text)
        .map_err(|e| file.bad("config", e.to_string(), "a network's size"))?;
    config.validate().map_err(|e| e.in_file(path))?;
    Ok(config)
}

/// Flat weights and optimiser, in the order of `parameters`, which gives the names and shapes that must be there.
pub(super) fn load(path: &Path, parameters: &[Parameter]) -> Result<(Vec<f32>, Adam)> {
    let file = Checkpoint::read(path)?;
    let steps = file.metadata("steps")?;
    let steps = steps.parse().map_err(|_| file.bad("steps", steps, "a whole number"))?;
    let (mut weights, mut adam) = (Vec::new(), Adam::new(0));
    adam.steps = steps;
    for parameter in parameters {
        file.append(&parameter.name, &parameter.shape, &mut weights)?;
        file.append(&format!("adam.first.{}", parameter.name), &parameter.shape, &mut adam.first)?;
        file.append(
            &format!("adam.second.{}", parameter.name),
            &parameter.shape,
            &mut adam.second,
        )?;
    }
    Ok((weights, adam))
}

/// A checkpoint in memory.
struct Checkpoint<'a> {
    path: &'a Path,
    metadata: BTreeMap<String, String>,
    entries: BTreeMap<String, Entry>,
    bytes: Vec<u8>,
    data_start: usize,
}

impl<'a> Checkpoint<'a> {
    fn read(path: &'a Path) -> Result<Self> {
        let bytes = fs::read(path).map_err(|e| Error::reading(path, e))?;
        let bad = |found: String| {
            Error::bad(
                path.display().to_string(),
                "header",
                found,
                "a checkpoint written by this program (safetensors)",
            )
        };
        let (length, rest) =
            bytes.split_first_chunk::<8>().ok_or_else(|| bad(format!("{} bytes", bytes.len())))?;
        let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
        let text = rest
            .get(..length)
            .ok_or_else(|| bad(format!("a header of {length} bytes in a shorter file")))?;
        let mut header: serde_json::Map<String, serde_json::Value> =
            serde_json::from_slice(text).map_err(|e| bad(e.to_string()))?;
        let metadata = header.remove("__metadata__").ok_or_else(|| bad("no metadata".into()))?;
        let metadata: BTreeMap<String, String> =
            serde_json::from_value(metadata).map_err(|e| bad(e.to_string()))?;
        let mut entries = BTreeMap::new();
        for (name, value) in header {
            let entry: Entry =
                serde_json::from_value(value).map_err(|e| bad(format!("{name}: {e}")))?;
            entries.insert(name, entry);
        }
        let file = Self { path, metadata, entries, data_start: 8 + length, bytes };
        let schema = file.metadata("schema")?;
        if schema != SCHEMA {
            return Err(file.bad("schema", schema, &format!("this version reads schema {SCHEMA}")));
        }
        Ok(file)
    }

    fn bad(&self, place: &str, found: impl Into<String>, allowed: &str) -> Error {
        Error::bad(self.path.display().to_string(), place, found, allowed)
    }

    fn metadata(&self, key: &str) -> Result<&str> {
        self.metadata
            .get(key)
            .map(String::as_str)
            .ok_or_else(|| self.bad(key, "missing", "a checkpoint written by this program"))
    }

    /// Appends the tensor `name`, which must have `shape` and finite values.
    fn append(&self, name: &str, shape: &[usize], values: &mut Vec<f32>) -> Result<()> {
        let entry = self
            .entries
            .get(name)
            .ok_or_else(|| self.bad(name, "missing", "a tensor of that name"))?;
        if entry.dtype != "F32" || entry.shape != shape {
            return Err(self.bad(
                name,
                format!("{} {:?}", entry.dtype, entry.shape),
                &format!("F32 {shape:?}"),
            ));
        }
        let [start, end] = entry.data_offsets;
        let raw = self.bytes[self.data_start..]
            .get(start..end)
            .filter(|raw| raw.len() == 4 * shape.iter().product::<usize>())
            .ok_or_else(|| {
                self.bad(
                    name,
                    format!("bytes {start} to {end}"),
                    "a range of the tensor's size in the file",
                )
            })?;
        let before = values.len();
        values.extend(raw.chunks_exact(4).map(|c| f32::from_le_bytes([c[0], c[1], c[2], c[3]])));
        if values[before..].iter().any(|v| !v.is_finite()) {
            return Err(self.bad(name, "a value that is not finite", "finite values"));
        }
        Ok(())
    }
}

/// Writes `bytes` beside `path`, flushes them to the disk, and renames.
pub(super) fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.part", std::process::id()));
    let beside = path.with_file_name(name);
    let written = fs::File::create(&beside).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()
    });
    written.and_then(|()| fs::rename(&beside, path)).map_err(|e| {
        // The half-written file is of no use; the first error is the one to report.
        let _ = fs::remove_file(&beside);
        Error::writing(path, e)
    })
}

fn internal(e: serde_json::Error) -> Error {
    Error::Internal(format!("checkpoint header: {e}"))
}

#[cfg(test)]
mod tests {
    use super::super::Reconstructor;
    use super::*;
    use ndarray::Array4;

    fn model() -> Reconstructor {
        Reconstructor::new(UnetConfig { base_width: 4, scales: 2 }, 5).expect("valid")
    }

    fn train(model: &mut Reconstructor, steps: usize) {
        let mut rng = fastrand::Rng::with_seed(model.steps());
        for _ in 0..steps {
            let a = Array4::from_shape_simple_fn((1, 3, 8, 12), || rng.f32());
            let b = Array4::from_shape_simple_fn((1, 3, 8, 12), || rng.f32());
            model.step_network_only(a.view(), b.view(), 1e-3).expect("fits");
            rng = fastrand::Rng::with_seed(model.steps());
        }
    }

    #[test]
    fn resuming_gives_the_same_bits() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("network.safetensors");
        let mut straight = model();
        train(&mut straight, 6);
        let mut first = model();
        train(&mut first, 3);
        first.save(&path).expect("written");
        let mut resumed = Reconstructor::load(&path).expect("read");
        assert_eq!(resumed.parameters(), first.parameters());
        train(&mut resumed, 3);
        assert_eq!(resumed.parameters(), straight.parameters());
        assert_eq!(resumed.steps(), 6);
        assert_eq!(
            fs::read_dir(folder.path()).expect("there").count(),
            1,
            "no half-written files stay"
        );
    }

    #[test]
    fn nan_weights_are_never_saved() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("network.safetensors");
        let mut model = model();
        model.set_parameter("output.bias", &[0.0, f32::NAN, 0.0]).expect("three");
        assert!(model.save(&path).is_err() && !path.exists());
    }

    #[test]
    fn damaged_files_are_refused() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("network.safetensors");
        model().save(&path).expect("written");
        let good = fs::read(&path).expect("read");
        assert!(Reconstructor::load(&path).is_ok());
        let mut huge = good.clone();
        huge[..8].copy_from_slice(&u64::MAX.to_le_bytes());
        let text = String::from_utf8_lossy(&good).into_owned();
        assert!(text.contains("output.bias"));
        for damaged in [
            vec![],
            good[..7].to_vec(),
            good[..200].to_vec(),
            good[..good.len() - 4].to_vec(),
            huge,
        ] {
            fs::write(&path, damaged).expect("written");
            assert!(Reconstructor::load(&path).is_err());
        }
    }
}
