//! A design task as a TOML file: which lens, on which sensor, trained on what, for how long.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::data::{TEXTURE, Textures};
use super::schedule::Budget;
use super::train_task::TrainTask;
use crate::error::{Error, Result};
use crate::imaging::guide::Inputs;
use crate::imaging::sensor::Sensor;
use crate::interchange;
use crate::lens::catalogue::Glasses;
use crate::lens::{Lens, Prescription, SensorRaster};
use crate::trace::rims::overlapping_rims;

/// The form of task files this program reads.
pub const SCHEMA: u32 = 1;

/// A task; every key but `schema` and `lens` has a default.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Form of the file: 1.
    pub schema: u32,
    /// Lens file, or the name of a shipped lens.
    pub lens: String,
    /// Raster in place of the lens file's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<TaskSensor>,
    /// Sensor calibration file; the generic sensor where left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
    /// Folder of photographs; built-in scenes where left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photos: Option<PathBuf>,
    /// Built-in scenes to generate.
    #[serde(default = "default_scenes")]
    pub scenes: usize,
    /// Seed of every draw.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Steps of the joint stage (repeatable), or …
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<usize>,
    /// … minutes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub minutes: Option<f64>,
    /// Patch side, pixels.
    #[serde(default = "default_patch")]
    pub patch_px: usize,
    /// Patches a step.
    #[serde(default = "default_batch")]
    pub batch: usize,
    /// Channels of the network's finest scale.
    #[serde(default = "default_width")]
    pub base_width: usize,
    /// What the network of the joint stage sees beside the capture; names as in `train.inputs`.
    #[serde(default, skip_serializing_if = "Inputs::is_bare")]
    pub inputs: Inputs,
    /// Largest lens step, scaled units.
    #[serde(default = "default_lens_rate")]
    pub lens_rate: f64,
    /// Largest network step.
    #[serde(default = "default_network_rate")]
    pub network_rate: f64,
    /// Train the network alone.
    #[serde(default)]
    pub freeze_lens: bool,
    /// The final network for the finished lens (`isoplanat train`).
    #[serde(default)]
    pub train: TrainTask,
}

/// A raster in a task.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskSensor {
    /// Pixels in a row.
    pub columns: usize,
    /// Rows.
    pub rows: usize,
    /// Pixel pitch, µm.
    pub pitch_um: f64,
    /// Axis `[column, row]`; the centre where left out.
    pub axis_px: Option<[f64; 2]>,
}

fn default_scenes() -> usize {
    40
}
fn default_seed() -> u64 {
    1
}
fn default_patch() -> usize {
    128
}
fn default_batch() -> usize {
    2
}
fn default_width() -> usize {
    16
}
fn default_lens_rate() -> f64 {
    0.01
}
fn default_network_rate() -> f64 {
    2e-3
}

impl Task {
    /// The demo's task: the two-element lens on a quadrant sensor of 960 × 640 pixels of 20 µm.
    pub fn demo() -> Self {
        Self {
            schema: SCHEMA,
            lens: "two_element".into(),
            sensor: Some(TaskSensor { columns: 960, rows: 640, pitch_um: 20.0, axis_px: Some([0.0, 0.0]) }),
            calibration: None,
            photos: None,
            scenes: default_scenes(),
            seed: default_seed(),
            steps: None,
            minutes: None,
            patch_px: default_patch(),
            batch: default_batch(),
            base_width: default_width(),
            inputs: Inputs::BARE,
            lens_rate: default_lens_rate(),
            network_rate: default_network_rate(),
            freeze_lens: false,
            train: TrainTask::default(),
        }
    }

    /// Reads and checks a task file; paths in it are relative to it.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::reading(path, e))?;
        let file = path.display().to_string();
        let mut task: Self =
            toml::from_str(&text).map_err(|e| Error::toml(&file, &text, &e, "the keys of models/README.md"))?;
        let folder = path.parent().unwrap_or(Path::new("."));
        for p in [&mut task.photos, &mut task.calibration].into_iter().flatten() {
            *p = folder.join(&*p);
        }
        task.train.resolve(folder);
        let beside = folder.join(&task.lens);
        if beside.is_file() {
            task.lens = beside.display().to_string();
        }
        task.check(&file)?;
        Ok(task)
    }

    /// Refuses a task that cannot be run; `file` is named in the error.
    pub fn check(&self, file: &str) -> Result<()> {
        let bad = |place: &str, found: String, allowed: &str| Err(Error::bad(file, place, found, allowed));
        if self.schema != SCHEMA {
            return bad("schema", self.schema.to_string(), "1");
        }
        if self.patch_px < 32 || !self.patch_px.is_multiple_of(4) || self.patch_px > 1024 {
            return bad("patch_px", self.patch_px.to_string(), "a multiple of 4 from 32 to 1024");
        }
        if !(1..=64).contains(&self.batch) {
            return bad("batch", self.batch.to_string(), "1 to 64");
        }
        if !(1..=10_000).contains(&self.scenes) {
            return bad("scenes", self.scenes.to_string(), "1 to 10000");
        }
        if self.steps.is_some() && self.minutes.is_some() {
            return bad("steps, minutes", "both".into(), "one of steps and minutes");
        }
        self.train.check(file)?;
        if let Some(m) = self.minutes
            && !(m > 0.0 && m < 1e6)
        {
            return bad("minutes", m.to_string(), "a positive number");
        }
        for (name, v) in [("lens_rate", self.lens_rate), ("network_rate", self.network_rate)] {
            if !(v > 0.0 && v < 1.0) {
                return bad(name, v.to_string(), "above 0, below 1");
            }
        }
        Ok(())
    }

    /// The joint stage's budget.
    ///
    /// # Errors
    /// A task without `steps` and `minutes`: it has no joint stage.
    pub fn budget(&self) -> Result<Budget> {
        match (self.steps, self.minutes) {
            (Some(n), _) => Ok(Budget::Steps(n)),
            (None, Some(m)) => Ok(Budget::Time(Duration::from_secs_f64(60.0 * m))),
            (None, None) => {
                Err(Error::bad("", "steps, minutes", "neither", "exactly one of steps and minutes for a joint design"))
            }
        }
    }

    /// The task as a file that means the same anywhere: paths in full.
    ///
    /// # Errors
    /// A working folder that cannot be asked for.
    pub fn to_toml(&self) -> Result<String> {
        let mut task = self.clone();
        let full = |p: &mut PathBuf| -> Result<()> {
            *p = std::path::absolute(&*p).map_err(|e| Error::reading(p, e))?;
            Ok(())
        };
        for p in [&mut task.photos, &mut task.calibration, &mut task.train.start, &mut task.train.vgg] {
            p.as_mut().map_or(Ok(()), full)?;
        }
        if Path::new(&task.lens).is_file() {
            let mut path = PathBuf::from(&task.lens);
            full(&mut path)?;
            task.lens = path.display().to_string();
        }
        toml::to_string(&task).map_err(|e| Error::Internal(format!("task: {e}")))
    }

    /// The lens, on the task's raster.
    pub fn lens(&self, glasses: &Glasses) -> Result<Lens> {
        let lens = interchange::lens_or_file(&self.lens, glasses)?.lens;
        overlapping_rims(&lens, &self.lens)?;
        let Some(TaskSensor { columns, rows, pitch_um, axis_px }) = self.sensor else { return Ok(lens) };
        #[expect(clippy::cast_precision_loss, reason = "a raster's size")]
        let centre = [columns as f64 / 2.0, rows as f64 / 2.0];
        let raster = SensorRaster { columns, rows, pitch_um, axis_px: axis_px.unwrap_or(centre) };
        Lens::new(Prescription { sensor: raster, ..(*lens).clone() }, &self.lens)
    }

    /// The sensor's calibration.
    pub fn sensor(&self) -> Result<Sensor> {
        self.calibration.as_deref().map_or_else(|| Ok(Sensor::generic()), Sensor::load)
    }

    /// The textures to train on.
    pub fn textures(&self) -> Result<Textures> {
        match &self.photos {
            Some(folder) => Textures::photos(folder),
            None => Ok(Textures::built_in(self.seed.wrapping_mul(1000), self.scenes, TEXTURE)),
        }
    }
}
