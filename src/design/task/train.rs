//! The `[train]` table of a task: the final network for a finished lens.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::design::schedule::{Length, Schedule};
use crate::design::training::pairs::Augmentation;
use isoplanat_base::error::Result;
use isoplanat_card::Blocks;
use isoplanat_imaging::guide::Inputs;
use isoplanat_network::critic::CriticConfig;
use isoplanat_network::unet::FULL_SCALES;
use isoplanat_network::{Base, ContentKind, Objective, Reconstructor, UnetConfig};

/// The checkpoint in a run's folder.
pub(in crate::design) const NETWORK: &str = "network.safetensors";
/// Channels of the network's finest scale where the task names none.
pub(super) const WIDTH: usize = 32;

/// `[train]`: the final training; every key has a default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainTask {
    /// Network to start from: a run's folder, or a checkpoint.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<PathBuf>,
    /// The network.
    pub network: TrainNetwork,
    /// What it learns from.
    pub pairs: TrainPairs,
    /// What is minimised.
    pub loss: TrainLoss,
    /// How long and how fast.
    pub budget: TrainBudget,
}

/// `[train.network]`: the network of the final training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainNetwork {
    /// Channels of its finest scale; left out: the starting network's, or 32.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_width: Option<usize>,
    /// Its scales.
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
}

/// `[train.pairs]`: what the final network learns from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainPairs {
    /// Different pairs; 0: no two alike.
    pub count: u64,
    /// Side of a pair, of which a step takes a patch, pixels.
    pub region_px: usize,
    /// Side of a training patch, pixels.
    pub patch_px: usize,
    /// Patches a step.
    pub batch: usize,
    /// Space for kept pairs, MiB; 0: all rendered as they are needed.
    pub cache_mib: u64,
    /// Mirror and transpose at random.
    pub flips: bool,
    /// Noise deviation over the sensor's own, from and to.
    pub noise: [f64; 2],
    /// Largest share of veiling glare.
    pub haze: f64,
    /// Object distances, mm; empty: the design's.
    pub depths_mm: Vec<f64>,
}

/// `[train.loss]`: what the final training minimises.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainLoss {
    /// Content loss: `content` (eq. 12 with `vgg`, L1 and multi-scale SSIM without) or `l1`.
    pub content: String,
    /// VGG-19 weights (safetensors).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vgg: Option<PathBuf>,
    /// Train against discriminators (eqs. 13 and 14).
    pub adversarial: bool,
    /// Channels of the discriminators' first layer.
    pub discriminator_width: usize,
}

/// `[train.budget]`: how long the final training is, and how fast.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainBudget {
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
    /// Seconds between checkpoints: what a kill may lose.
    pub checkpoint_seconds: f64,
    /// Steps between sample pictures; 0: none.
    pub sample_steps: u64,
}

fn is_new(base: &Base) -> bool {
    *base == Base::NEW
}

impl Default for TrainNetwork {
    fn default() -> Self {
        Self { base_width: None, scales: FULL_SCALES, inputs: Inputs::BARE, blocks: Blocks::Paper, base: Base::NEW }
    }
}

impl Default for TrainPairs {
    fn default() -> Self {
        Self {
            count: 400,
            region_px: 320,
            patch_px: 256,
            batch: 1,
            cache_mib: 2048,
            flips: true,
            noise: [0.5, 2.0],
            haze: 0.1,
            depths_mm: Vec::new(),
        }
    }
}

impl Default for TrainLoss {
    fn default() -> Self {
        Self { content: "content".into(), vgg: None, adversarial: false, discriminator_width: 64 }
    }
}

impl Default for TrainBudget {
    fn default() -> Self {
        Self {
            constant_epochs: 50.0,
            decay_epochs: 100.0,
            steps: None,
            minutes: None,
            rate: 1e-4,
            rise_steps: 0,
            average: 0.0,
            checkpoint_seconds: 60.0,
            sample_steps: 500,
        }
    }
}

impl TrainTask {
    /// The file of the network to start from, where one is named.
    pub(in crate::design) fn start_file(&self) -> Option<PathBuf> {
        let path = self.start.as_ref()?;
        Some(if path.is_dir() { path.join(NETWORK) } else { path.clone() })
    }

    /// The size of the network to train; its width is that of the one to start from where the task names none.
    ///
    /// # Errors
    /// A network to start from that cannot be read.
    pub fn config(&self) -> Result<UnetConfig> {
        let base_width = match (self.network.base_width, self.start_file()) {
            (Some(width), _) => width,
            (None, Some(path)) => Reconstructor::config_of(&path)?.base_width,
            (None, None) => WIDTH,
        };
        Ok(self.sized(base_width))
    }

    /// Its size with so many channels at the finest scale.
    pub(super) fn sized(&self, base_width: usize) -> UnetConfig {
        UnetConfig {
            base_width,
            scales: self.network.scales,
            inputs: self.network.inputs,
            blocks: self.network.blocks,
            base: self.network.base.for_inputs(self.network.inputs),
        }
    }

    /// Paths relative to `folder` become paths below it.
    pub(super) fn resolve(&mut self, folder: &Path) {
        for p in [&mut self.start, &mut self.loss.vgg].into_iter().flatten() {
            *p = folder.join(&*p);
        }
    }

    pub(super) fn critics(&self) -> Option<CriticConfig> {
        self.loss
            .adversarial
            .then_some(CriticConfig { width: self.loss.discriminator_width, patch_px: self.pairs.patch_px })
    }

    /// What is minimised.
    pub(crate) fn objective(&self) -> Objective {
        let content = match (&self.loss.vgg, self.loss.content.as_str()) {
            (_, "l1") => ContentKind::L1,
            (Some(path), _) => ContentKind::Vgg(path.clone()),
            (None, _) => ContentKind::Structure,
        };
        let average = (self.budget.average > 0.0).then_some(self.budget.average);
        Objective { content, critics: self.critics(), average }
    }

    /// How a step varies a pair.
    pub(crate) fn augmentation(&self) -> Augmentation {
        Augmentation { flips: self.pairs.flips, noise: self.pairs.noise, haze: self.pairs.haze }
    }

    /// Learning rate over the steps.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to be below 1e13")]
    pub fn schedule(&self) -> Schedule {
        let share = self.budget.constant_epochs / (self.budget.constant_epochs + self.budget.decay_epochs);
        let length = match (self.budget.steps, self.budget.minutes) {
            (Some(n), _) => Length::Steps(n),
            (None, Some(m)) => Length::Seconds(60.0 * m),
            (None, None) => {
                let pairs = if self.pairs.count == 0 { 400 } else { self.pairs.count };
                let epoch = (pairs as f64 / self.pairs.batch as f64).max(1.0);
                Length::Steps(((self.budget.constant_epochs + self.budget.decay_epochs) * epoch).round().max(1.0) as u64)
            }
        };
        Schedule { rate: self.budget.rate, rise: self.budget.rise_steps, share, length, settled: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_those_of_the_paper() {
        let task = TrainTask::default();
        let schedule = task.schedule();
        assert_eq!(schedule.length, Length::Steps(150 * 400));
        assert_eq!((schedule.at(0), schedule.at(19_999)), (Some(1e-4), Some(1e-4)));
        assert!((schedule.at(40_000).expect("not done") - 0.5e-4).abs() < 1e-12);
        assert_eq!(schedule.at(60_000), None);
        assert_eq!(task.objective().content, ContentKind::Structure);
    }

    #[test]
    fn blocks_are_named_and_those_of_the_paper_are_not_written() {
        let text = |blocks| toml::to_string(&TrainNetwork { blocks, ..TrainNetwork::default() }).expect("text");
        assert!(!text(Blocks::Paper).contains("blocks"));
        for blocks in Blocks::ALL {
            let network: TrainNetwork = toml::from_str(&text(blocks)).expect("own text");
            let task = TrainTask { network, ..TrainTask::default() };
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
            let network = TrainNetwork { inputs, ..TrainNetwork::default() };
            let config = TrainTask { network, ..TrainTask::default() }.config().expect("no start");
            let text = serde_json::to_string(&config).expect("text");
            assert_eq!((config.base == Base::Blend, text.contains("\"base\"")), (chosen, chosen), "{text}");
        }
    }
}
