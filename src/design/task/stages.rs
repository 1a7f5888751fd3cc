//! A design in stages: several joint stages one after the other, each with a fresh network, from the lens that the one before found.
//!
//! A task's `[[stages]]` come before the design that the task itself states; each states what is different in it.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use super::train::NETWORK;
use super::{Task, put};
use crate::design::folder::{MARKER, START, check, lock, made};
use isoplanat_base::atomic;
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::lens::{Lens, prescription};

/// Folder of the stages in that of the design.
const STAGES: &str = "stages";
/// What a stage may state, the same keys as of the task; `optics` and `loss.sensor` as a whole.
const KEYS: [&str; 19] = [
    "budget.checks",
    "budget.epochs",
    "budget.minutes",
    "budget.steps",
    "lens.asphere_power",
    "lens.least_illumination",
    "lens.rate",
    "lens.rate_um",
    "lens.share",
    "lens.steps_by",
    "loss.depth_power",
    "loss.sensor",
    "network.base_width",
    "network.inputs",
    "network.rate",
    "optics",
    "pictures.batch",
    "pictures.depths_mm",
    "pictures.patch_px",
];
/// Most stages.
const MOST: usize = 16;

impl Task {
    /// The designs that it asks for, one after the other, the last one its own; none of them has stages. From the second on the lens is taken as the one before found it, without focus, spots or search
    /// first. `file` names the task.
    ///
    /// # Errors
    /// A stage with a key that it may not state, or a value that is not allowed.
    pub fn parts(&self, file: &str) -> Result<Vec<Self>> {
        if self.stages.len() > MOST {
            return Err(Error::bad(file, STAGES, self.stages.len().to_string(), format!("at most {MOST}")));
        }
        if self.lens.freeze && !self.stages.is_empty() {
            let allowed = "false beside stages: what the next one takes on is the lens";
            return Err(Error::bad(file, "lens.freeze", "true", allowed));
        }
        let own = Self { stages: Vec::new(), ..self.clone() };
        let mut parts =
            self.stages.iter().enumerate().map(|(k, keys)| own.with(keys, file, k)).collect::<Result<Vec<_>>>()?;
        parts.push(own);
        for later in parts.iter_mut().skip(1) {
            let lens = &mut later.lens;
            (lens.focus_all, lens.warm_start, lens.search) = (false, false, 0);
        }
        Ok(parts)
    }

    /// The first of them.
    ///
    /// # Errors
    /// As [`Task::parts`].
    pub fn first(&self, file: &str) -> Result<Self> {
        Ok(self.parts(file)?.swap_remove(0))
    }

    /// It with what stage `number` states.
    fn with(&self, stated: &toml::Table, file: &str, number: usize) -> Result<Self> {
        let internal = |e: toml::ser::Error| Error::Internal(format!("task: {e}"));
        let place = |key: &str| format!("{STAGES}[{number}].{key}");
        let mut all = toml::Table::try_from(self).map_err(internal)?;
        for (group, key, value) in leaves(stated) {
            let whole = key.map_or(group.to_owned(), |key| format!("{group}.{key}"));
            if !KEYS.contains(&&*whole) {
                let allowed = format!("one of {}", KEYS.join(", "));
                return Err(Error::bad(file, format!("{STAGES}[{number}]"), whole, allowed));
            }
            // A length is one of the two.
            if let ("budget", Some(length @ ("steps" | "minutes"))) = (group, key)
                && let Some(budget) = all.get_mut("budget").and_then(toml::Value::as_table_mut)
            {
                budget.remove(if length == "steps" { "minutes" } else { "steps" });
            }
            put(&mut all, &whole, value.clone());
        }
        let states = |key: &str| stated.get("budget").is_some_and(|budget| budget.get(key).is_some());
        if states("steps") && states("minutes") {
            return Err(Error::bad(file, place("budget.steps, budget.minutes"), "both", "one of steps and minutes"));
        }
        let mut stage = Self::of_tables(all)
            .map_err(|(key, found)| Error::bad(file, place(&key), found, "the values of models/README.md"))?;
        stage.origin = self.origin.clone();
        stage.check(file).map_err(|e| e.within(format!("{STAGES}[{number}]")))?;
        Ok(stage)
    }
}

/// What a stage states: group, key in it and value; no key where what is no table stands in a group's place, or all of `optics`.
fn leaves(stated: &toml::Table) -> Vec<(&str, Option<&str>, &toml::Value)> {
    let mut all = Vec::new();
    for (group, value) in stated {
        match value {
            toml::Value::Table(inside) if group != "optics" => {
                all.extend(inside.iter().map(|(key, value)| (&**group, Some(&**key), value)));
            }
            _ => all.push((group, None, value)),
        }
    }
    all
}

/// The folder of stage `number`, from 0, of the design in `folder`.
pub fn folder_of(folder: &Path, number: usize) -> PathBuf {
    folder.join(STAGES).join((number + 1).to_string())
}

/// Where the design in `folder` stands: how many of its stages have begun, and whether its own design has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reached {
    /// Stages that have begun; all but the last of them are over.
    pub begun: usize,
    /// Its own design has begun: all of them are over.
    pub own: bool,
}

/// What is there of the design in `folder`.
pub fn reached(folder: &Path) -> Reached {
    let begun = (0..MOST).take_while(|k| folder_of(folder, *k).join(NETWORK).is_file()).count();
    Reached { begun, own: folder.join(NETWORK).is_file() }
}

/// Makes the folder of a design in stages, before the first of them: its task and its lens. Its own design comes into the same folder ([`crate::design::joint::designing::Designing::create_within`]).
///
/// # Errors
/// As [`check`]; what the disk says.
pub fn make(task: &Task, lens: &Lens, folder: &Path, replace: bool) -> Result<()> {
    check(folder, replace)?;
    made(folder, replace, |inside| {
        atomic::write_bytes(&inside.join(MARKER), task.to_toml()?.as_bytes())?;
        let path = inside.join(STAGES);
        fs::create_dir_all(&path).map_err(|e| Error::writing(&path, e))?;
        prescription::save(lens, &inside.join(START))
    })?;
    Ok(())
}

/// The lens of a folder that [`make`] made; its lock is held while what is returned lives: while stages are designed.
///
/// # Errors
/// A folder in which another process works, or that holds no lens.
pub fn held(folder: &Path) -> Result<(Lens, File)> {
    let lock = lock(folder)?;
    Ok((prescription::load(&folder.join(START))?, lock))
}
