//! The `[train]` table of a task: the final network for a finished lens.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::pairs::Augmentation;
use super::schedule::{Length, Schedule};
use isoplanat_base::error::{Error, Result};
use isoplanat_card::Blocks;
use isoplanat_imaging::guide::Inputs;
use isoplanat_network::critic::CriticConfig;
use isoplanat_network::unet::FULL_SCALES;
use isoplanat_network::{Base, ContentKind, Objective, Reconstructor, UnetConfig};

/// Object distances at most.
pub(super) const MOST_DEPTHS: usize = 64;

/// The checkpoint in a run's folder.
pub(super) const NETWORK: &str = "network.safetensors";
/// Channels of the network's finest scale where the task names none.
const WIDTH: usize = 32;

/// Settings of the final training; every key has a default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainTask {
    /// Network to start from: a run's folder, or a checkpoint.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<PathBuf>,
    /// Channels of the network's finest scale; left out: the starting network's, or 32.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_width: Option<usize>,
    /// Scales of the network.
    pub scales: usize,
    /// What it sees beside the capture: any of `wiener` (the capture through the lens's own Wiener filters), `levels` (the same for other noise), `field` (the place
    /// in the field) and `psf` (what the point spread function there is like); none: the capture alone, as in the paper.
    #[serde(skip_serializing_if = "Inputs::is_bare")]
    pub inputs: Inputs,
    /// What its scales are made of: `paper`, `separable` or `gated`.
    #[serde(skip_serializing_if = "Blocks::is_paper")]
    pub blocks: Blocks,
    /// What a network that sees filtered captures adds its output to: `blend` (the capture, and shares of what each filter changes in it) or `filtered` (the first of them, as before).
    #[serde(skip_serializing_if = "is_new")]
    pub base: Base,
    /// Side of a training patch, pixels.
    pub patch_px: usize,
    /// Patches a step.
    pub batch: usize,
    /// Different training pairs; 0: no two alike.
    pub pairs: u64,
    /// Side of a training pair, of which a step takes a patch, pixels.
    pub region_px: usize,
    /// Space for kept pairs, MiB; 0: all rendered as they are needed.
    pub cache_mib: u64,
    /// Epochs at the full rate; an epoch is one step for every `batch` pairs (400 pairs where no two are alike).
    pub constant_epochs: f64,
    /// Epochs in which the rate falls to zero.
    pub decay_epochs: f64,
    /// Steps in place of the epochs' number, in their proportion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u64>,
    /// Minutes in place of the epochs' number, in their proportion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub minutes: Option<f64>,
    /// Adam's step at the full rate.
    pub rate: f64,
    /// Steps in which it rises to that.
    pub rise_steps: u64,
    /// Share of the weights' running mean that a step keeps; the mean is the result. 0: the last step's weights are.
    pub average: f64,
    /// Content loss: `content` (eq. 12 with `vgg`, L1 and multi-scale SSIM without) or `l1`.
    pub loss: String,
    /// VGG-19 weights (safetensors).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vgg: Option<PathBuf>,
    /// Train against discriminators (eqs. 13 and 14).
    pub adversarial: bool,
    /// Channels of the discriminators' first layer.
    pub discriminator_width: usize,
    /// Mirror and transpose at random.
    pub flips: bool,
    /// Noise deviation over the sensor's own, from and to.
    pub noise: [f64; 2],
    /// Largest share of veiling glare.
    pub haze: f64,
    /// Object distances, mm; empty: the lens's own.
    pub depths_mm: Vec<f64>,
    /// Seconds between checkpoints: what a kill may lose.
    pub checkpoint_seconds: f64,
    /// Steps between sample pictures; 0: none.
    pub sample_steps: u64,
}

fn is_new(base: &Base) -> bool {
    *base == Base::NEW
}

impl Default for TrainTask {
    fn default() -> Self {
        Self {
            start: None,
            base_width: None,
            scales: FULL_SCALES,
            inputs: Inputs::BARE,
            blocks: Blocks::Paper,
            base: Base::NEW,
            patch_px: 256,
            batch: 1,
            pairs: 400,
            region_px: 320,
            cache_mib: 2048,
            constant_epochs: 50.0,
            decay_epochs: 100.0,
            steps: None,
            minutes: None,
            rate: 1e-4,
            rise_steps: 0,
            average: 0.0,
            loss: "content".into(),
            vgg: None,
            adversarial: false,
            discriminator_width: 64,
            flips: true,
            noise: [0.5, 2.0],
            haze: 0.1,
            depths_mm: Vec::new(),
            checkpoint_seconds: 60.0,
            sample_steps: 500,
        }
    }
}

impl TrainTask {
    /// The file of the network to start from, where one is named.
    pub(super) fn start_file(&self) -> Option<PathBuf> {
        let path = self.start.as_ref()?;
        Some(if path.is_dir() { path.join(NETWORK) } else { path.clone() })
    }

    /// The size of the network to train; its width is that of the one to start from where the task names none.
    ///
    /// # Errors
    /// A network to start from that cannot be read.
    pub fn config(&self) -> Result<UnetConfig> {
        let base_width = match (self.base_width, self.start_file()) {
            (Some(width), _) => width,
            (None, Some(path)) => Reconstructor::config_of(&path)?.base_width,
            (None, None) => WIDTH,
        };
        Ok(self.sized(base_width))
    }

    fn sized(&self, base_width: usize) -> UnetConfig {
        UnetConfig {
            base_width,
            scales: self.scales,
            inputs: self.inputs,
            blocks: self.blocks,
            base: self.base.of(self.inputs),
        }
    }

    /// Paths relative to `folder` become paths below it.
    pub(super) fn resolve(&mut self, folder: &Path) {
        for p in [&mut self.start, &mut self.vgg].into_iter().flatten() {
            *p = folder.join(&*p);
        }
    }

    /// Refuses what is no training; `file` is named in the error.
    pub(super) fn check(&self, file: &str) -> Result<()> {
        let bad =
            |key: &str, found: String, allowed: &str| Err(Error::bad(file, format!("train.{key}"), found, allowed));
        let within = |key: &str, v: f64, low: f64, high: f64, allowed: &str| {
            if v >= low && v <= high { Ok(()) } else { bad(key, v.to_string(), allowed) }
        };
        let config = self.sized(self.base_width.unwrap_or(WIDTH));
        config.validate().map_err(|e| e.within("train").in_file(file))?;
        let multiple = config.multiple().max(8);
        if !self.patch_px.is_multiple_of(multiple) || !(16..=1024).contains(&self.patch_px) {
            let allowed = format!("a multiple of {multiple} (for {} scales) from 16 to 1024", self.scales);
            return bad("patch_px", self.patch_px.to_string(), &allowed);
        }
        if !self.region_px.is_multiple_of(4) || !(self.patch_px..=4096).contains(&self.region_px) {
            return bad("region_px", self.region_px.to_string(), "a multiple of 4, patch_px to 4096");
        }
        if !(1..=64).contains(&self.batch) {
            return bad("batch", self.batch.to_string(), "1 to 64");
        }
        if self.cache_mib > 1 << 30 {
            return bad("cache_mib", self.cache_mib.to_string(), "at most 1073741824 MiB");
        }
        if self.pairs > 10_000_000 {
            return bad("pairs", self.pairs.to_string(), "at most 10000000; 0 makes no two alike");
        }
        if self.steps.is_some() && self.minutes.is_some() {
            return bad("steps, minutes", "both".into(), "one of them, or neither: then epochs count");
        }
        if self.steps.is_some_and(|n| !(1..=1_000_000_000).contains(&n)) {
            return bad("steps", self.steps.unwrap_or_default().to_string(), "1 to 1000000000");
        }
        if let Some(minutes) = self.minutes {
            within("minutes", minutes, 1e-3, 1e6, "a positive number, at most a million")?;
        }
        within("constant_epochs", self.constant_epochs, 0.0, 1e6, "0 to a million")?;
        within("decay_epochs", self.decay_epochs, 1e-6, 1e6, "above 0, at most a million")?;
        within("rate", self.rate, 1e-9, 0.1, "1e-9 to 0.1")?;
        within("rise_steps", self.rise_steps as f64, 0.0, 1e9, "0 to 1000000000")?;
        if !(0.0..1.0).contains(&self.average) {
            return bad("average", self.average.to_string(), "0 (none) or more, below 1");
        }
        if !["content", "l1"].contains(&self.loss.as_str()) {
            return bad("loss", self.loss.clone(), "content or l1");
        }
        if self.loss == "l1" && self.vgg.is_some() {
            return bad("vgg", "given".into(), "no weights where loss is l1");
        }
        let [low, high] = self.noise;
        within("noise", low, 0.0, high, "[from, to], from no larger than to")?;
        within("noise", high, low, 100.0, "[from, to], at most 100 times the sensor's own")?;
        if low == 0.0 && high > 0.0 {
            return bad("noise", format!("{low}, {high}"), "from above 0, or [0, 0] for none");
        }
        within("haze", self.haze, 0.0, 0.9, "0 to 0.9")?;
        if self.depths_mm.len() > MOST_DEPTHS {
            return bad("depths_mm", format!("{} distances", self.depths_mm.len()), &format!("at most {MOST_DEPTHS}"));
        }
        for &d in &self.depths_mm {
            if d.is_nan() || d <= 0.0 {
                return bad("depths_mm", d.to_string(), "positive distances; inf is allowed");
            }
        }
        within("checkpoint_seconds", self.checkpoint_seconds, 0.0, 86_400.0, "0 to 86400")?;
        if let Some(critics) = self.critics() {
            critics.validate().map_err(|e| e.within("train").in_file(file))?;
        }
        Ok(())
    }

    fn critics(&self) -> Option<CriticConfig> {
        self.adversarial.then_some(CriticConfig { width: self.discriminator_width, patch_px: self.patch_px })
    }

    /// What is minimised.
    pub fn objective(&self) -> Objective {
        let content = match (&self.vgg, self.loss.as_str()) {
            (_, "l1") => ContentKind::L1,
            (Some(path), _) => ContentKind::Vgg(path.clone()),
            (None, _) => ContentKind::Structure,
        };
        let average = (self.average > 0.0).then_some(self.average);
        Objective { content, critics: self.critics(), average }
    }

    /// How a step varies a pair.
    pub fn augmentation(&self) -> Augmentation {
        Augmentation { flips: self.flips, noise: self.noise, haze: self.haze }
    }

    /// Learning rate over the steps.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be below 1e13")]
    pub fn schedule(&self) -> Schedule {
        let share = self.constant_epochs / (self.constant_epochs + self.decay_epochs);
        let length = match (self.steps, self.minutes) {
            (Some(n), _) => Length::Steps(n),
            (None, Some(m)) => Length::Seconds(60.0 * m),
            (None, None) => {
                let pairs = if self.pairs == 0 { 400 } else { self.pairs };
                let epoch = (pairs as f64 / self.batch as f64).max(1.0);
                Length::Steps(((self.constant_epochs + self.decay_epochs) * epoch).round().max(1.0) as u64)
            }
        };
        Schedule { rate: self.rate, rise: self.rise_steps, share, length, settled: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_those_of_the_paper() {
        let task = TrainTask::default();
        task.check("task").expect("valid");
        let schedule = task.schedule();
        assert_eq!(schedule.length, Length::Steps(150 * 400));
        assert_eq!((schedule.at(0), schedule.at(19_999)), (Some(1e-4), Some(1e-4)));
        assert!((schedule.at(40_000).expect("not done") - 0.5e-4).abs() < 1e-12);
        assert_eq!(schedule.at(60_000), None);
        assert_eq!(task.objective().content, ContentKind::Structure);
    }

    #[test]
    fn blocks_are_named_and_those_of_the_paper_are_not_written() {
        let text = |blocks| toml::to_string(&TrainTask { blocks, ..TrainTask::default() }).expect("text");
        assert!(!text(Blocks::Paper).contains("blocks"));
        for blocks in Blocks::ALL {
            let task: TrainTask = toml::from_str(&text(blocks)).expect("own text");
            assert_eq!(task.config().expect("no start").blocks, blocks);
        }
    }

    /// What a checkpoint of a network without filtered captures says is what versions before the choice read.
    #[test]
    fn networks_without_filters_have_no_base_to_choose() {
        for (inputs, chosen) in [
            (Inputs::BARE, false),
            (Inputs { field: true, ..Inputs::BARE }, false),
            (Inputs { wiener: true, ..Inputs::BARE }, true),
            (Inputs::GUIDED, true),
        ] {
            let config = TrainTask { inputs, ..TrainTask::default() }.config().expect("no start");
            let text = serde_json::to_string(&config).expect("text");
            assert_eq!((config.base == Base::Blend, text.contains("\"base\"")), (chosen, chosen), "{text}");
        }
    }

    #[test]
    fn what_is_no_training_is_refused_by_its_key() {
        let refused = |change: fn(&mut TrainTask), key: &str| {
            let mut task = TrainTask::default();
            change(&mut task);
            let text = task.check("task.toml").expect_err(key).to_string();
            assert!(text.contains("task.toml") && text.contains(key), "{key}: {text}");
        };
        refused(|t| t.patch_px = 96, "patch_px");
        refused(|t| t.region_px = 128, "region_px");
        refused(|t| t.batch = 0, "batch");
        refused(|t| t.scales = 8, "scales");
        refused(|t| (t.steps, t.minutes) = (Some(3), Some(1.0)), "minutes");
        refused(|t| t.minutes = Some(f64::NAN), "minutes");
        refused(|t| t.steps = Some(0), "steps");
        refused(|t| t.rate = -1.0, "rate");
        refused(|t| t.loss = "l2".into(), "loss");
        refused(|t| t.noise = [2.0, 1.0], "noise");
        refused(|t| t.haze = 1.0, "haze");
        refused(|t| t.depths_mm = vec![500.0, -1.0], "depths_mm");
        refused(|t| t.depths_mm = vec![500.0; 65], "depths_mm");
        refused(|t| (t.adversarial, t.discriminator_width) = (true, 0), "discriminator_width");
    }
}
