//! Where a training stands, as a checkpoint keeps it.

use std::collections::BTreeMap;
use std::path::Path;

use isoplanat_base::error::{Error, Result};

/// Where a training stands, as a checkpoint keeps it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in crate::design) struct State {
    pub(in crate::design) step: u64,
    pub(in crate::design) seconds: f64,
    /// Steps that moved nothing.
    pub(in crate::design) skipped: u64,
    pub(in crate::design) settled: Option<[u64; 2]>,
    /// Times it went back, with half the rate each time.
    pub(in crate::design) returned: u32,
}

impl State {
    pub(in crate::design) fn facts(&self) -> BTreeMap<String, String> {
        let mut facts = BTreeMap::from([
            ("train.step".to_owned(), self.step.to_string()),
            ("train.seconds".to_owned(), format!("{:.3}", self.seconds)),
            ("train.skipped".to_owned(), self.skipped.to_string()),
        ]);
        if self.returned > 0 {
            facts.insert("train.returned".to_owned(), self.returned.to_string());
        }
        if let Some([constant, all]) = self.settled {
            facts.insert("train.constant".to_owned(), constant.to_string());
            facts.insert("train.steps".to_owned(), all.to_string());
        }
        facts
    }

    pub(in crate::design) fn from_facts(facts: &BTreeMap<String, String>, path: &Path) -> Result<Self> {
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
            returned: if facts.contains_key("train.returned") { number(facts, "train.returned", path)? } else { 0 },
        })
    }
}
