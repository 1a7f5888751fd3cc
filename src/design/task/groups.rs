//! The tables of a task file, in the order of the light; every key has a default.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::stated::Stated;
use crate::design::joint::lens_steps::Steps;
use crate::design::joint::sensor_loss::SensorLoss;
use crate::design::places::Spread;
use isoplanat_imaging::guide::Inputs;
use isoplanat_imaging::render::Diffraction;

/// `[lens]`: which lens, what is done to it before the joint stage, and how it moves there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LensTask {
    /// Lens file, or the name of a shipped lens; for `isoplanat train` also the folder of a measured one.
    pub file: String,
    /// Even powers up to which refracting surfaces have terms that may move, stated as 0 where the lens has none; 0: as the lens states
    /// them.
    pub asphere_power: usize,
    /// Whether the sensor first moves to the least spots over the field and all distances.
    #[serde(skip_serializing_if = "is_false")]
    pub focus_all: bool,
    /// Starts of a global search by spots, where the lens is first improved by those; 0: from the lens alone.
    pub search: usize,
    /// Whether the lens is first improved by its spots alone.
    pub warm_start: bool,
    /// Whether it stays as it is, and the network alone is trained.
    pub freeze: bool,
    /// What its steps are measured by.
    pub steps_by: Steps,
    /// Its largest step where steps are measured by rays: their rms movement, µm.
    pub rate_um: f64,
    /// Its largest step where they are not.
    pub rate: f64,
    /// Part of the joint stage in which it moves, from and to, of 1.
    pub share: [f64; 2],
    /// Least illumination relative to the axis that its steps keep.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub least_illumination: Option<f64>,
    /// What lenses may be off by through which the design's pictures are taken: a file as for `isoplanat tolerance`, or its keys.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerances: Option<Stated>,
    /// Of how many of those draws the one with the largest spots is taken.
    #[serde(skip_serializing_if = "is_once")]
    pub worst_of: usize,
}

/// `[frame]`: the sensor.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrameTask {
    /// Raster in place of the lens file's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub raster: Option<TaskSensor>,
    /// Sensor calibration file; the generic sensor where left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
}

/// A raster in a task.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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

/// `[pictures]`: what the joint stage takes pictures of, and where they stand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PictureTask {
    /// Folder of photographs; built-in scenes where left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub photos: Option<PathBuf>,
    /// Photographs at the beginning of the folder that are kept from training, and judge the design on its way.
    pub keep_first: usize,
    /// Built-in scenes to generate.
    pub scenes: usize,
    /// Object distances, mm, taken in turn; empty: the lens's own.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub depths_mm: Vec<f64>,
    /// Patch side, pixels.
    pub patch_px: usize,
    /// Patches a step.
    pub batch: usize,
    /// How patches are spread over the field.
    pub spread: Spread,
    /// Whether all pictures of the design and of its final network, and the filters of guided networks, are by diffraction (`true`), of rays (`false`), of rays convolved with
    /// the open pupil's diffraction (`"approximate"`), or as a few of its patches through the lens it starts from ask for (`"auto"`).
    pub diffraction: Diffraction,
}

/// `[network]`: the network of the joint stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NetworkTask {
    /// Channels of its finest scale.
    pub base_width: usize,
    /// What it sees beside the capture; names as in `train.network.inputs`.
    #[serde(skip_serializing_if = "Inputs::is_bare")]
    pub inputs: Inputs,
    /// Its largest step.
    pub rate: f64,
}

/// `[loss]`: what the joint stage makes small.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossTask {
    /// Power of the mean over the distances' losses behind the network: 1 is their mean, more looks at the worst of them.
    pub depth_power: f64,
    /// A loss on the lens's own images at those distances in place of one behind the network.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor: Option<SensorLoss>,
}

/// `[budget]`: how long the joint stage is, and what is kept and told on its way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Budget {
    /// Steps (repeatable), or …
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<usize>,
    /// … minutes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub minutes: Option<f64>,
    /// Equal parts, each with 0.8 of the rates of the one before; 0: a rise and half a cosine.
    pub epochs: usize,
    /// How often the design is judged on pictures that it does not train on.
    pub checks: usize,
    /// Seconds between checkpoints: what a kill may lose.
    pub checkpoint_seconds: f64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn is_false(value: &bool) -> bool {
    !value
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn is_once(value: &usize) -> bool {
    *value == 1
}

impl Default for LensTask {
    fn default() -> Self {
        Self {
            file: String::new(),
            asphere_power: 0,
            focus_all: false,
            search: 0,
            warm_start: true,
            freeze: false,
            steps_by: Steps::default(),
            rate_um: 2.0,
            rate: 0.01,
            share: [0.1, 0.85],
            least_illumination: None,
            tolerances: None,
            worst_of: 1,
        }
    }
}

impl Default for PictureTask {
    fn default() -> Self {
        Self {
            photos: None,
            keep_first: 0,
            scenes: 40,
            depths_mm: Vec::new(),
            patch_px: 128,
            batch: 2,
            spread: Spread::default(),
            diffraction: Diffraction::Auto,
        }
    }
}

impl Default for NetworkTask {
    fn default() -> Self {
        Self { base_width: 16, inputs: Inputs::BARE, rate: 2e-3 }
    }
}

impl Default for LossTask {
    fn default() -> Self {
        Self { depth_power: 1.0, sensor: None }
    }
}

impl Default for Budget {
    fn default() -> Self {
        Self { steps: None, minutes: None, epochs: 0, checks: 10, checkpoint_seconds: 60.0 }
    }
}
