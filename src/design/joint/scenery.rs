//! What a joint stage is trained on, and an entry of its history.

use crate::design::data::Textures;
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
pub(in crate::design) const LOG_HEADER: &str =
    "step,seconds,loss,input_psnr_db,output_psnr_db,moved_um,signal,penalty,step_seconds,network_seconds\n";

impl Entry {
    /// That of a line of the log.
    pub(in crate::design) fn read(line: &str) -> Option<Self> {
        let mut values = line.split(',').map(|text| text.parse::<f64>().ok());
        let mut next = || values.next().flatten();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of steps")]
        let entry = Self {
            step: next()? as usize,
            seconds: next()?,
            loss: next()?,
            input_psnr_db: next()?,
            output_psnr_db: next()?,
            moved_um: next()?,
            signal: next()?,
            penalty: next()?,
            step_seconds: next()?,
            network_seconds: next()?,
        };
        values.next().is_none().then_some(entry)
    }

    /// Its line of the log.
    pub(in crate::design) fn line(&self) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_log_is_read_again() {
        let line = "120,33.125,1.250000e-2,28.5000,31.2500,1.5000e-1,0.3000,0.0000e0,0.2500,0.1250\n";
        let entry = Entry::read(line.trim_end()).expect("an entry");
        assert_eq!((entry.step, entry.seconds, entry.network_seconds), (120, 33.125, 0.125));
        assert_eq!(entry.line(), line);
        assert_eq!(line.split(',').count(), LOG_HEADER.split(',').count());
        for bad in ["120,33.125", "120,33.125,x,28.5,31.2,0.1,0.3,0,0.2,0.1", &format!("{},7", line.trim_end())] {
            assert!(Entry::read(bad).is_none(), "{bad}");
        }
    }
}
