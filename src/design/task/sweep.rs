//! The `[sweep]` table of a task.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use isoplanat_base::error::{Error, Result};

/// The `[sweep]` table of a task: what is drawn; number 0 is the task as it stands.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SweepTask {
    /// Largest relative change of curvatures.
    pub radii: f64,
    /// Largest relative change of thicknesses.
    pub thicknesses: f64,
    /// Glasses by pattern of surfaces (`surface[0].medium`): names of shipped glasses, one of which is drawn.
    pub glasses: BTreeMap<String, Vec<String>>,
}

impl SweepTask {
    /// Refuses what is no sweep; `file` is named in the error.
    pub(in crate::design) fn check(&self, file: &str) -> Result<()> {
        for (key, v) in [("radii", self.radii), ("thicknesses", self.thicknesses)] {
            if !(0.0..1.0).contains(&v) {
                return Err(Error::bad(file, format!("sweep.{key}"), v.to_string(), "0 or more, below 1"));
            }
        }
        match self.glasses.iter().find(|(_, names)| names.is_empty()) {
            Some((pattern, _)) => {
                Err(Error::bad(file, format!("sweep.glasses.{pattern}"), "an empty list", "names of glasses"))
            }
            None => Ok(()),
        }
    }
}
