//! Settings of the joint stage of a design.

use super::lens_steps::Steps;
use super::sensor_loss::SensorLoss;
use crate::design::places::Spread;
use crate::design::schedule::{Length, rise_and_fall};
use crate::design::task::Task;
use isoplanat_base::error::Result;
use isoplanat_imaging::render::{Diffraction, Settings};
use isoplanat_optics::analysis::fabrication::tolerances::Tolerances;

/// Settings of the joint stage.
#[derive(Clone, Debug)]
pub struct JointSettings {
    /// How long.
    pub length: Length,
    /// Patch side, pixels; a multiple of 4.
    pub patch: usize,
    /// Patches a step.
    pub batch: usize,
    /// How the lens moves.
    pub steps: Steps,
    /// Largest step of the lens: mm rms of its rays, or scaled or plain units; 0 holds the lens.
    pub lens_rate: f64,
    /// Part of the stage in which the lens moves, from and to.
    pub lens_share: [f64; 2],
    /// Largest step of the network.
    pub network_rate: f64,
    /// Equal parts of the stage, each with 0.8 of the rates of the one before, as in the paper; 0: a rise and half a cosine.
    pub epochs: usize,
    /// Object distances as vergences, 1/mm, taken in turn; empty: the lens's own.
    pub vergences: Vec<f64>,
    /// Power of the mean over the distances' losses.
    pub depth_power: f64,
    /// How patches are spread over the field.
    pub spread: Spread,
    /// By what kernels are made; where that is left to pictures, they are asked whenever settings are chosen.
    pub diffraction: Diffraction,
    /// Least relative illumination that the lens's steps keep.
    pub least_illumination: Option<f64>,
    /// A loss on the lens's own images in place of one behind the network, which then stays as it is.
    pub sensor_loss: Option<SensorLoss>,
    /// What lenses may be off by through which pictures are taken.
    pub tolerances: Option<Tolerances>,
    /// Of how many draws the one with the largest spots is taken.
    pub worst_of: usize,
    /// How finely it is rendered; `None`: as finely as the lens gradient needs.
    pub settings: Option<Settings>,
}

impl JointSettings {
    /// What `task` asks for.
    ///
    /// # Errors
    /// As [`Task::length`].
    pub fn from_task(task: &Task) -> Result<Self> {
        let rate = if task.lens.steps_by == Steps::Rays { 1e-3 * task.lens.rate_um } else { task.lens.rate };
        Ok(Self {
            length: task.length()?,
            patch: task.pictures.patch_px,
            batch: task.pictures.batch,
            steps: task.lens.steps_by,
            lens_rate: if task.lens.freeze { 0.0 } else { rate },
            // Nothing but the lens moves.
            lens_share: if task.loss.sensor.is_some() { [0.0, 1.0] } else { task.lens.share },
            network_rate: task.network.rate,
            epochs: task.budget.epochs,
            vergences: task.pictures.depths_mm.iter().map(|d| d.recip()).collect(),
            depth_power: task.loss.depth_power,
            spread: task.pictures.spread,
            least_illumination: task.lens.least_illumination,
            sensor_loss: task.loss.sensor.clone(),
            tolerances: task.stated_tolerances()?,
            worst_of: task.lens.worst_of,
            diffraction: task.pictures.diffraction,
            settings: None,
        })
    }

    /// Rates of lens and network when `used` of the stage is over, of their largest.
    pub(super) fn rates(&self, used: f64) -> [f64; 2] {
        let [from, to] = self.lens_share;
        let moves = used >= from && used < to;
        if self.epochs > 0 {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of parts")]
            let part = ((used * self.epochs as f64) as usize).min(self.epochs - 1);
            let rate = 0.8f64.powf(part as f64);
            return [if moves { rate } else { 0.0 }, rate];
        }
        let lens = if moves { rise_and_fall((used - from) / (to - from)) } else { 0.0 };
        [lens, rise_and_fall(used)]
    }
}
