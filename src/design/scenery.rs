//! What a joint stage is trained on, and an entry of its history.

use super::data::Textures;
use isoplanat_imaging::frame::Frame;
use isoplanat_imaging::sensor::Sensor;

/// What is trained on.
#[derive(Clone, Debug)]
pub struct Scenery<'a> {
    /// Textures to train on.
    pub textures: &'a Textures,
    /// The sensor.
    pub sensor: &'a Sensor,
    /// The frame it covers.
    pub frame: Frame,
    /// Seed of every draw.
    pub seed: u64,
}

/// One entry of the joint stage's history: means over a few steps.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Entry {
    /// Steps done at its end.
    pub step: usize,
    /// Seconds since the stage began, pauses left out.
    pub seconds: f64,
    /// Mean L1 loss over the last steps.
    pub loss: f64,
    /// PSNR of the network's input, dB.
    pub input_psnr_db: f64,
    /// PSNR of its output, dB.
    pub output_psnr_db: f64,
    /// How far a step moved the lens's rays, rms, µm; 0 where it was held or this is not known.
    pub moved_um: f64,
    /// Agreement of the last gradients, 0 to 1; 0 where it was held or this is not known.
    pub signal: f64,
    /// Penalty, or largest violation, of constraints.
    pub penalty: f64,
    /// Seconds of a step.
    pub step_seconds: f64,
    /// Those of them that the network took.
    pub network_seconds: f64,
}

/// The log's first line.
pub(super) const LOG_HEADER: &str =
    "step,seconds,loss,input_psnr_db,output_psnr_db,moved_um,signal,penalty,step_seconds,network_seconds\n";

impl Entry {
    /// That of a line of the log.
    pub(super) fn read(line: &str) -> Option<Self> {
        let v: Vec<f64> = line.split(',').map(|t| t.parse().ok()).collect::<Option<_>>()?;
        let [
            step,
            seconds,
            loss,
            input_psnr_db,
            output_psnr_db,
            moved_um,
            signal,
            penalty,
            step_seconds,
            network_seconds,
        ] = v.try_into().ok()?;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of steps")]
        let step = step as usize;
        Some(Self {
            step,
            seconds,
            loss,
            input_psnr_db,
            output_psnr_db,
            moved_um,
            signal,
            penalty,
            step_seconds,
            network_seconds,
        })
    }

    /// Its line of the log.
    pub(super) fn line(&self) -> String {
        format!(
            "{},{:.3},{:.6e},{:.4},{:.4},{:.4e},{:.4},{:.4e},{:.4},{:.4}\n",
            self.step,
            self.seconds,
            self.loss,
            self.input_psnr_db,
            self.output_psnr_db,
            self.moved_um,
            self.signal,
            self.penalty,
            self.step_seconds,
            self.network_seconds
        )
    }
}
