//! The log of a training: averages over a few steps, as CSV, written whole at every checkpoint.

use std::path::{Path, PathBuf};

use serde::Serialize;

use isoplanat_base::atomic;
use isoplanat_base::error::Result;
use isoplanat_network::TrainStep;

/// Averages over a few steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Entry {
    /// Steps done at its end.
    pub step: u64,
    /// Seconds since the beginning, pauses left out.
    pub seconds: f64,
    /// Learning rate of the last step.
    pub rate: f64,
    /// Content loss.
    pub content: f64,
    /// Mean absolute difference, sRGB-encoded.
    pub l1: f64,
    /// The generator's adversarial loss, weighted.
    pub adversarial: f64,
    /// The discriminators' loss.
    pub critic: f64,
    /// PSNR of the reconstructed patches, sRGB-encoded, dB.
    pub psnr_db: f64,
    /// Norm of the generator's gradient before clipping; the largest of the steps.
    pub gradient_norm: f64,
    /// PSNR of the held-out patches, where they were looked at, dB.
    pub held_out_psnr_db: Option<f64>,
}

pub(super) const HEADER: &str =
    "step,seconds,rate,content,l1,adversarial,critic,psnr_db,gradient_norm,held_out_psnr_db\n";

impl Entry {
    /// One step's.
    pub(super) fn of(done: &TrainStep, step: u64, seconds: f64, rate: f64, psnr_db: f64) -> Self {
        Self {
            step,
            seconds,
            rate,
            content: done.content,
            l1: done.l1,
            adversarial: done.adversarial,
            critic: done.critic,
            psnr_db,
            gradient_norm: done.gradient_norm,
            held_out_psnr_db: None,
        }
    }

    /// The mean of some, at the last one's step; after a resume an entry's first steps may be missing from it.
    ///
    /// # Panics
    /// Without entries.
    pub(super) fn mean(entries: &[Self]) -> Self {
        let last = *entries.last().expect("one entry at least");
        let mean = |part: fn(&Self) -> f64| entries.iter().map(part).sum::<f64>() / entries.len() as f64;
        Self {
            content: mean(|e| e.content),
            l1: mean(|e| e.l1),
            adversarial: mean(|e| e.adversarial),
            critic: mean(|e| e.critic),
            psnr_db: mean(|e| e.psnr_db),
            // Not `f64::max`, which passes NaN over.
            gradient_norm: entries.iter().fold(0.0, |m, e| if e.gradient_norm <= m { m } else { e.gradient_norm }),
            ..last
        }
    }

    /// Its line of a log.
    pub(super) fn line(&self) -> String {
        let held_out = self.held_out_psnr_db.map(|v| format!("{v:.4}")).unwrap_or_default();
        format!(
            "{},{:.2},{:.4e},{:.6e},{:.6e},{:.4e},{:.4e},{:.4},{:.4e},{held_out}\n",
            self.step,
            self.seconds,
            self.rate,
            self.content,
            self.l1,
            self.adversarial,
            self.critic,
            self.psnr_db,
            self.gradient_norm
        )
    }
}

/// A log and its file.
#[derive(Debug)]
pub(super) struct Log {
    path: PathBuf,
    text: String,
}

/// Bytes of a log at most: some ten million lines.
pub(super) const LARGEST: u64 = 1 << 30;

impl Log {
    /// A new log, or the file's lines up to `step`, which each begins with: what a kill has lost is trained again and logged again.
    pub(super) fn open(path: &Path, header: &str, step: u64) -> Result<Self> {
        Self::open_with(path, header, step, |line| line.split(',').next().and_then(|s| s.parse().ok()))
    }

    /// [`Self::open`] of lines whose step `of` finds.
    pub(super) fn open_with(path: &Path, header: &str, step: u64, of: fn(&str) -> Option<u64>) -> Result<Self> {
        let mut text = header.to_owned();
        if path.exists() {
            let old = atomic::read_text(path, LARGEST)?;
            for line in old.lines().skip(header.lines().count()).filter(|l| of(l).is_some_and(|s| s <= step)) {
                text += line;
                text.push('\n');
            }
        }
        Ok(Self { path: path.to_owned(), text })
    }

    /// Adds a line, with its end.
    pub(super) fn push(&mut self, line: &str) {
        self.text += line;
    }

    /// All of it.
    pub(super) fn text(&self) -> &str {
        &self.text
    }

    /// Writes the file, whole or not at all.
    pub(super) fn save(&self) -> Result<()> {
        atomic::write_bytes(&self.path, self.text.as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(step: u64) -> Entry {
        Entry {
            step,
            seconds: step as f64,
            rate: 1e-4,
            content: 0.1 * step as f64,
            l1: 0.01,
            adversarial: 0.0,
            critic: 0.0,
            psnr_db: 20.0,
            gradient_norm: step as f64,
            held_out_psnr_db: (step == 20).then_some(21.5),
        }
    }

    #[test]
    fn a_log_goes_on_from_the_checkpoint_it_belongs_to() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("log.csv");
        let mut log = Log::open(&path, HEADER, 0).expect("new");
        (1..=4).for_each(|i| log.push(&entry(10 * i).line()));
        log.save().expect("written");
        let mut again = Log::open(&path, HEADER, 25).expect("read");
        assert_eq!(again.text.lines().count(), 3);
        (3..=4).for_each(|i| again.push(&entry(10 * i).line()));
        assert_eq!(again.text, log.text);
        assert!(log.text.lines().nth(2).expect("step 20").ends_with(",21.5000"));
        let columns = |line: &str| line.split(',').count();
        assert!(log.text.lines().all(|l| columns(l) == columns(HEADER.trim_end())));
        let mean = Entry::mean(&[entry(10), entry(20)]);
        assert_eq!((mean.step, mean.gradient_norm), (20, 20.0));
        assert!((mean.content - 1.5).abs() < 1e-12);
    }
}
