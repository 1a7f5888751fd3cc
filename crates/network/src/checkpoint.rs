//! Checkpoints: weights, Adam's moments and step counter, sizes, and facts of the training; bit for bit.
//!
//! One safetensors file. The generator's parameters stand under their names, another learner's under `<prefix><name>`;
//! averaged weights under `average.<name>`, and are what a plain reader gets;
//! moments are `<prefix>adam.first.<name>`, `<prefix>adam.second.<name>`, the step counter the fact `<prefix>steps`. A file
//! with discriminators can be read as a plain network.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use super::adam::Adam;
use super::learner::Parameter;
use super::tensors::{Named, TensorFile, write};
use super::unet::UnetConfig;
use isoplanat_base::error::Result;

const SCHEMA: &str = "2";

const ALLOWED: &str = "a checkpoint written by this program (safetensors)";

/// One learner's part of a checkpoint.
pub(super) struct Section<'a> {
    /// Before every name; empty for the generator.
    pub(super) prefix: &'a str,
    /// Its parameters.
    pub(super) parameters: &'a [Parameter],
    /// Steps taken.
    pub(super) steps: u64,
    /// Its optimiser; none for weights that nothing moves.
    pub(super) adam: Option<&'a Adam>,
}

/// Writes a checkpoint beside `path`, then renames it. Refuses values that are not finite.
pub(super) fn save(
    path: &Path,
    config: &UnetConfig,
    sections: &[Section<'_>],
    facts: &BTreeMap<String, String>,
) -> Result<()> {
    let mut facts = facts.clone();
    facts.insert("schema".into(), SCHEMA.into());
    facts.insert("config".into(), serde_json::to_string(config).unwrap_or_default());
    let mut tensors = Vec::new();
    for Section { prefix, parameters, steps, adam } in sections {
        facts.insert(format!("{prefix}steps"), steps.to_string());
        let mut offset = 0;
        for Parameter { name, shape, values } in *parameters {
            let range = offset..offset + values.len();
            offset = range.end;
            let mut put = |name: String, values| {
                tensors.push(Named { name, shape: shape.clone(), values: Cow::Borrowed(values) });
            };
            put(format!("{prefix}{name}"), values.as_slice());
            if let Some(adam) = adam {
                put(format!("{prefix}adam.first.{name}"), &adam.first[range.clone()]);
                put(format!("{prefix}adam.second.{name}"), &adam.second[range]);
            }
        }
    }
    write(path, &facts, &tensors)
}

/// Weights of a network that is made whatever its file holds.
const SMALL: u64 = 1 << 20;
/// How many times the weights of a network its count from above may be.
const LOOSE: u64 = 32;

/// A checkpoint in memory.
pub(super) struct Checkpoint(TensorFile);

impl Checkpoint {
    /// Reads a file, of this schema only.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let file = TensorFile::read(path, ALLOWED)?;
        match file.fact("schema") {
            Some(SCHEMA) => Ok(Self(file)),
            Some(other) => Err(file.bad("schema", other, &format!("this version reads schema {SCHEMA}"))),
            None => Err(file.bad("schema", "missing", ALLOWED)),
        }
    }

    /// The network's size. A network is made before its weights are read, so what its file cannot hold is refused here.
    pub(super) fn config(&self) -> Result<UnetConfig> {
        let text = self.0.fact("config").unwrap_or_default();
        let bad = |found: String| self.0.bad("config", found, "a network's size");
        let config: UnetConfig = serde_json::from_str(text).map_err(|e| bad(e.to_string()))?;
        config.validate().map_err(|e| e.within("config").of_file(&self.0.path))?;
        let (weights, held) = (config.weights(), self.0.numbers());
        if weights > SMALL && weights / LOOSE > held {
            return Err(bad(format!("a network of some {weights} weights in a file of {held} numbers")));
        }
        Ok(config)
    }

    /// Facts of the training.
    pub(super) fn facts(&self) -> &BTreeMap<String, String> {
        self.0.facts()
    }

    /// Whether there is a learner with `prefix`.
    pub(super) fn has(&self, prefix: &str) -> bool {
        self.0.fact(&format!("{prefix}steps")).is_some()
    }

    /// Flat weights under `prefix`, in the order of `parameters`, and how many steps are in them.
    pub(super) fn weights(&self, prefix: &str, parameters: &[Parameter]) -> Result<(Vec<f32>, u64)> {
        let mut weights = Vec::new();
        for Parameter { name, shape, .. } in parameters {
            self.0.append(&format!("{prefix}{name}"), shape, &mut weights)?;
        }
        Ok((weights, self.steps(prefix)?))
    }

    fn steps(&self, prefix: &str) -> Result<u64> {
        let key = format!("{prefix}steps");
        let steps = self.0.fact(&key).unwrap_or("missing");
        steps.parse().map_err(|_| self.0.bad(&key, steps, "a whole number"))
    }

    /// Flat weights and optimiser of the learner with `prefix`, in the order of `parameters`, which gives the names and
    /// shapes that must be there.
    pub(super) fn learner(&self, prefix: &str, parameters: &[Parameter]) -> Result<(Vec<f32>, Adam)> {
        let (weights, steps) = self.weights(prefix, parameters)?;
        let mut adam = Adam::new(0);
        adam.steps = steps;
        for Parameter { name, shape, .. } in parameters {
            self.0.append(&format!("{prefix}adam.first.{name}"), shape, &mut adam.first)?;
            self.0.append(&format!("{prefix}adam.second.{name}"), shape, &mut adam.second)?;
        }
        Ok((weights, adam))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use isoplanat_card::Blocks;

    use super::super::Reconstructor;
    use super::*;
    use ndarray::Array4;

    fn model() -> Reconstructor {
        Reconstructor::new(UnetConfig::bare(4, 2), 5).expect("valid")
    }

    fn train(model: &mut Reconstructor, steps: usize) {
        let mut rng = fastrand::Rng::with_seed(model.steps());
        for _ in 0..steps {
            let a = Array4::from_shape_simple_fn((1, 3, 8, 12), || rng.f32());
            let b = Array4::from_shape_simple_fn((1, 3, 8, 12), || rng.f32());
            model.step_network_only(a.view(), b.view(), None, 1e-3).expect("fits");
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
        assert_eq!(fs::read_dir(folder.path()).expect("there").count(), 1, "no half-written files stay");
    }

    #[test]
    fn nan_weights_are_never_saved() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("network.safetensors");
        let mut model = model();
        model.set_parameter("output.bias", &[0.0, f32::NAN, 0.0]).expect("three");
        assert!(model.save(&path).is_err() && !path.exists());
    }

    /// A file of a few numbers asks for no network of a milliard.
    #[test]
    fn networks_that_their_files_cannot_hold_are_not_made() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("network.safetensors");
        for (config, refused) in [(UnetConfig::bare(4, 2), false), (UnetConfig::bare(128, 5), true)] {
            let config = serde_json::to_string(&config).expect("JSON");
            write(&path, &BTreeMap::from([("schema".into(), SCHEMA.into()), ("config".into(), config)]), &[])
                .expect("written");
            assert_eq!(Reconstructor::config_of(&path).is_err(), refused);
            let error = Reconstructor::load(&path).expect_err("no weights").to_string();
            assert_eq!(error.contains("weights in a file of"), refused, "{error}");
        }
        // The count from above is near enough to every network's own.
        for blocks in [Blocks::Paper, Blocks::Separable, Blocks::Gated] {
            for (width, scales) in [(32, 3), (16, 5), (64, 1)] {
                let config = UnetConfig { blocks, ..UnetConfig::bare(width, scales) };
                let own: usize = Reconstructor::new(config.clone(), 1)
                    .expect("valid")
                    .parameters()
                    .iter()
                    .map(|p| p.values.len())
                    .sum();
                assert!(config.weights() / LOOSE <= own as u64, "{config:?}: {own}");
            }
        }
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
        for damaged in [vec![], good[..7].to_vec(), good[..200].to_vec(), good[..good.len() - 4].to_vec(), huge] {
            fs::write(&path, damaged).expect("written");
            assert!(Reconstructor::load(&path).is_err());
        }
    }

    /// Any bit: of a weight, of a moment, of a fact.
    #[test]
    fn a_flipped_bit_is_found() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("network.safetensors");
        let facts = BTreeMap::from([("step".to_owned(), "1234".to_owned())]);
        model().save_with_facts(&path, &facts).expect("written");
        let good = fs::read(&path).expect("read");
        assert_eq!(Reconstructor::load_with_facts(&path, super::super::Compute::Cpu).expect("reads").1["step"], "1234");
        let step = good.windows(4).position(|w| w == b"1234").expect("the fact");
        let mut rng = fastrand::Rng::with_seed(5);
        let header = 8 + usize::try_from(u64::from_le_bytes(good[..8].try_into().expect("eight"))).expect("fits");
        for k in 0..200 {
            let mut damaged = good.clone();
            // The lowest bit of a digit makes another digit.
            let (at, bit) = if k == 0 { (step, 1) } else { (rng.usize(header..good.len()), 1 << rng.u8(0..8)) };
            damaged[at] ^= bit;
            fs::write(&path, damaged).expect("written");
            let error = Reconstructor::load(&path).expect_err("damaged").to_string();
            assert!(error.contains("network.safetensors"), "{error}");
        }
    }
}
