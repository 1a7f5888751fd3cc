//! Where a training stands, as a checkpoint keeps it.

use std::collections::BTreeMap;
use std::path::Path;

use crate::design::pairs::Pairs;
use crate::design::task::Task;
use crate::error::{Error, Result};

/// Where a training stands, as a checkpoint keeps it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct State {
    pub(super) step: u64,
    pub(super) seconds: f64,
    /// Steps that moved nothing.
    pub(super) skipped: u64,
    pub(super) settled: Option<[u64; 2]>,
    /// By pair, the root mean square error of its last patch; infinite where there was none. Empty where any pair will do.
    errors: Vec<f32>,
}

impl State {
    /// Nothing done yet.
    pub(super) fn new(task: &Task) -> Self {
        let remembered = if task.train.draws > 1 { task.train.pairs as usize } else { 0 };
        Self { errors: vec![f32::INFINITY; remembered], ..Self::default() }
    }

    /// A pair's number: the hardest of so many draws, as far as is known.
    pub(super) fn draw(&self, pairs: &Pairs, draws: u64, rng: &mut fastrand::Rng) -> u64 {
        let error = |index: u64| self.errors.get(index as usize).copied().unwrap_or(f32::INFINITY);
        let first = pairs.draw(rng);
        (1..draws).fold(first, |best, _| {
            let other = pairs.draw(rng);
            if error(other) > error(best) { other } else { best }
        })
    }

    pub(super) fn remember(&mut self, index: u64, psnr_db: f64) {
        if let Some(error) = self.errors.get_mut(index as usize) {
            *error = 10f64.powf(-psnr_db / 20.0) as f32;
        }
    }

    pub(super) fn facts(&self) -> BTreeMap<String, String> {
        let mut facts = BTreeMap::from([
            ("train.step".to_owned(), self.step.to_string()),
            ("train.seconds".to_owned(), format!("{:.3}", self.seconds)),
            ("train.skipped".to_owned(), self.skipped.to_string()),
        ]);
        if let Some([constant, all]) = self.settled {
            facts.insert("train.constant".to_owned(), constant.to_string());
            facts.insert("train.steps".to_owned(), all.to_string());
        }
        if !self.errors.is_empty() {
            let bits = self.errors.iter().map(|v| format!("{:08x}", v.to_bits())).collect();
            facts.insert("train.errors".to_owned(), bits);
        }
        facts
    }

    pub(super) fn from_facts(facts: &BTreeMap<String, String>, path: &Path) -> Result<Self> {
        fn number<T: std::str::FromStr>(facts: &BTreeMap<String, String>, key: &str, path: &Path) -> Result<T> {
            let text = facts.get(key).map_or("missing", String::as_str);
            let allowed = "a number, as `isoplanat train` writes it";
            text.parse().map_err(|_| Error::bad(path.display().to_string(), key, text, allowed))
        }
        let settled = facts.contains_key("train.constant").then(|| -> Result<[u64; 2]> {
            Ok([number(facts, "train.constant", path)?, number(facts, "train.steps", path)?])
        });
        Ok(Self {
            step: number(facts, "train.step", path)?,
            seconds: number(facts, "train.seconds", path)?,
            skipped: number(facts, "train.skipped", path)?,
            settled: settled.transpose()?,
            errors: facts.get("train.errors").map_or(Ok(vec![]), |text| errors(text, path))?,
        })
    }
}

/// Remembered errors, as [`State::facts`] writes them.
fn errors(text: &str, path: &Path) -> Result<Vec<f32>> {
    let bad = |part: &str| {
        let allowed = "8 hexadecimal digits a pair, as `isoplanat train` writes them";
        Error::bad(path.display().to_string(), "train.errors", part, allowed)
    };
    let parts = text.as_bytes().chunks(8).map(|c| std::str::from_utf8(c).unwrap_or("?"));
    parts.map(|p| u32::from_str_radix(p, 16).map(f32::from_bits).map_err(|_| bad(p))).collect()
}
