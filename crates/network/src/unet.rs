//! The trimmed U-Net (paper §3.2, fig. 3): a block at every scale (two 3×3 convolutions with PReLU, or others), max-pooling
//! down, transposed convolutions up, skips by concatenation, and a global skip, so that it learns the residual.
//!
//! Parameters are named by scale (`encoder.0.conv1.weight`, `up.1.bias`, `decoder.0.slope2`, …; scale 0 is the finest,
//! `encoder.{last}` the flat bottom), so that a deeper network can start from a shallower one.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor, TensorData};
use serde::{Deserialize, Serialize};

use super::block::{Block, Convolution};
use super::layers::{Features, Way, convolve, pool, unpool};
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::memory::product;
use isoplanat_card::{Blocks, Inputs, receptive_radius_px};

/// Colour channels out.
pub(super) const CHANNELS: usize = 3;

/// Scale of the last convolution's weights against the others': training starts near the identity.
const OUTPUT_GAIN: f64 = 0.01;

/// By how much what filters change is enlarged: it is small beside the capture, and weights learn at one pace.
pub(super) const CHANGE_GAIN: f32 = 4.0;

/// From this scale on the number of channels stays: `16 ×` the finest scale's.
const WIDEST: usize = 4;

/// Scales of the full generator (paper §4.1): six down- and upsamplings.
pub const FULL_SCALES: usize = 7;

/// What a network that sees filtered captures adds its output to. One that sees none adds it to the capture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Base {
    /// The first of the filtered captures, as all did once: such a network begins with that filter's noise.
    #[default]
    Filtered,
    /// The capture, and of what each filter changes in it a share, a pixel and a colour, that the network gives: none at first. The network sees
    /// these changes in place of the filtered captures.
    Blend,
}

impl Base {
    /// That of new networks.
    pub const NEW: Self = Self::Blend;

    /// All of them.
    pub const ALL: [Self; 2] = [Self::Filtered, Self::Blend];

    /// This one for a network that sees `inputs`; where none of them is a filtered capture there is nothing to choose, and files say nothing.
    #[must_use]
    pub fn for_inputs(self, inputs: Inputs) -> Self {
        if inputs.banks() == 0 { Self::default() } else { self }
    }

    fn is_filtered(&self) -> bool {
        *self == Self::Filtered
    }
}

/// Size of the network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnetConfig {
    /// Channels of the finest scale; each coarser scale has twice as many, up to 16 times as many
    /// (32: 32, 64, 128, 256, 512, 512, 512).
    pub base_width: usize,
    /// Number of scales: 3 for design (fig. 3), 7 for the full generator; height and width are multiples of
    /// `2^(scales − 1)`.
    pub scales: usize,
    /// What it sees beside the capture.
    #[serde(default, skip_serializing_if = "Inputs::is_bare")]
    pub inputs: Inputs,
    /// What it is made of.
    #[serde(default, skip_serializing_if = "Blocks::is_paper")]
    pub blocks: Blocks,
    /// What its output is added to; checkpoints that do not say it are older than the choice.
    #[serde(default, skip_serializing_if = "Base::is_filtered")]
    pub base: Base,
}

impl Default for UnetConfig {
    fn default() -> Self {
        Self::bare(16, 3)
    }
}

impl UnetConfig {
    /// A network of the paper's blocks that sees the capture alone.
    pub fn bare(base_width: usize, scales: usize) -> Self {
        Self { base_width, scales, inputs: Inputs::BARE, blocks: Blocks::Paper, base: Base::default() }
    }

    /// The same network, fresh, that sees `inputs`.
    #[must_use]
    pub fn seeing(self, inputs: Inputs) -> Self {
        Self { inputs, base: Base::NEW.for_inputs(inputs), ..self }
    }

    /// Refuses sizes that are no network or too large to train.
    pub fn validate(&self) -> Result<()> {
        if !(1..=512).contains(&self.base_width) {
            return Err(Error::bad("", "base_width", self.base_width.to_string(), "1 to 512 channels"));
        }
        if !(1..=FULL_SCALES).contains(&self.scales) {
            return Err(Error::bad("", "scales", self.scales.to_string(), "1 to 7 scales"));
        }
        if self.width(self.scales - 1) > 2048 {
            return Err(Error::bad(
                "",
                "base_width, scales",
                format!("{} channels at the coarsest scale", self.width(self.scales - 1)),
                "at most 2048: lower one of them",
            ));
        }
        Ok(())
    }

    /// Bytes that a training step on `batch` patches of `side` pixels takes, from above: features with their cotangents, as planes of
    /// each scale's width (measured: 8 of the paper's blocks, of which 11 are counted), and of every weight the gradient, Adam's
    /// moments and a checkpoint's copies.
    pub fn step_bytes(&self, side: usize, batch: usize) -> u64 {
        let of_block = match self.blocks {
            Blocks::Paper => 11,
            Blocks::Separable => 18,
            Blocks::Gated => 36,
        };
        let widths = (0..self.scales).map(|s| (s, self.width(s)));
        let planes = widths.map(|(s, w)| product(&[of_block, batch, w, (side >> s).max(1).pow(2)])).sum::<u64>();
        let planes = planes.saturating_add(product(&[4, batch, self.inputs.channels(), side.pow(2)]));
        planes.saturating_mul(4).saturating_add(self.weights().saturating_mul(24))
    }

    /// Bytes that a picture of `side × side` pixels takes on its way through, from above: skipped features of every scale, and what
    /// a scale works on; the weights, and as much again while they are turned.
    pub fn forward_bytes(&self, side: usize) -> u64 {
        let widths = (0..self.scales).map(|s| (s, self.width(s)));
        let planes =
            widths.map(|(s, w)| product(&[self.planes_forward(), w, side.div_ceil(1 << s).pow(2)])).sum::<u64>();
        let planes = planes.saturating_add(product(&[2, self.inputs.channels(), side.pow(2)]));
        planes.saturating_add(2 * self.weights()).saturating_mul(4)
    }

    /// Planes of a scale's width that a picture has at a time on its way through, from above.
    pub fn planes_forward(&self) -> usize {
        match self.blocks {
            Blocks::Paper => 4,
            Blocks::Separable => 6,
            Blocks::Gated => 8,
        }
    }

    /// Number of weights, from above.
    pub(super) fn weights(&self) -> u64 {
        let of_scale = |w: usize| match self.blocks {
            // Five 3 × 3 convolutions of a scale's width, or what amounts to fewer.
            Blocks::Paper => product(&[45, w, w]),
            // A transposed convolution of 8, and 1 × 1 convolutions of 4.5 or 14.5 times the square of the width.
            Blocks::Separable => product(&[13, w, w + 5]),
            Blocks::Gated => product(&[23, w, w + 4]),
        };
        (0..self.scales).map(|s| of_scale(self.width(s))).sum()
    }

    /// No input pixel further away than this (in rows or columns) changes an output pixel, pixels.
    pub fn receptive_radius_px(&self) -> usize {
        receptive_radius_px(self.blocks, self.scales)
    }

    /// Height and width must be multiples of this.
    pub fn multiple(&self) -> usize {
        1 << (self.scales - 1)
    }

    /// Channels of the last convolution: the colours, and the shares of what filters change.
    fn outputs(&self) -> usize {
        CHANNELS * (1 + self.blended())
    }

    /// Filtered captures that are blended in.
    pub(super) fn blended(&self) -> usize {
        if self.base == Base::Blend { self.inputs.banks() } else { 0 }
    }

    /// The first of the channels that the output is added to.
    pub(super) fn base_channel(&self) -> usize {
        if self.base == Base::Filtered { self.inputs.base() } else { 0 }
    }

    /// Channels at `scale`.
    pub(super) fn width(&self, scale: usize) -> usize {
        self.base_width << scale.min(WIDEST)
    }
}

/// The last convolution of a network that sees more than the capture: small weights on `features`, none yet on `inputs`.
fn beside(features: usize, [inputs, outputs]: [usize; 2], rng: &mut fastrand::Rng, device: &Device) -> Convolution {
    let all = features + inputs;
    let mut values = vec![0.0; outputs * all * 9];
    let bound = Convolution::bound(9 * features, OUTPUT_GAIN);
    for row in values.chunks_mut(9 * all) {
        row[..9 * features].iter_mut().for_each(|v| *v = (bound * (2.0 * rng.f64() - 1.0)) as f32);
    }
    Convolution {
        weight: Param::from_data(TensorData::new(values, [outputs, all, 3, 3]), device),
        bias: Param::from_data(TensorData::new(vec![0f32; outputs], [outputs]), device),
    }
}

/// The network; the forward pass is [`Unet::forward`].
#[derive(Module, Debug)]
pub(super) struct Unet {
    /// By scale, finest first; the last is the flat bottom.
    encoder: Vec<Block>,
    /// `up[s]` lifts scale `s + 1` to scale `s`.
    up: Vec<Convolution>,
    /// By scale, finest first.
    decoder: Vec<Block>,
    output: Convolution,
}

impl Unet {
    /// A network with weights drawn from `seed`; the same seed gives the same bits.
    pub(super) fn new(config: &UnetConfig, seed: u64, device: &Device) -> Self {
        let rng = &mut fastrand::Rng::with_seed(seed);
        let (kind, width) = (config.blocks, |scale| config.width(scale));
        let coarser = config.scales - 1;
        let seen = |scale| if scale == 0 { config.inputs.channels() } else { width(scale - 1) };
        Self {
            encoder: (0..config.scales).map(|s| Block::new(kind, [seen(s), width(s)], s == 0, rng, device)).collect(),
            up: (0..coarser).map(|s| Convolution::transposed(width(s + 1), width(s), rng, device)).collect(),
            decoder: (0..coarser).map(|s| Block::new(kind, [2 * width(s), width(s)], false, rng, device)).collect(),
            output: match config.inputs.is_bare() {
                true => Convolution::square(3, width(0), CHANNELS, OUTPUT_GAIN, rng, device),
                false => beside(width(0), [config.inputs.channels(), config.outputs()], rng, device),
            },
        }
    }

    /// # Shapes
    /// `[batch, channel, row, col]` → `[batch, 3, row, col]`; rows and columns are multiples of `2^(scales − 1)`. What the last
    /// convolution gives is added as [`Base`] says; where there is more to see than the capture it sees that too,
    /// so that every channel has a straight way to the output.
    pub(super) fn forward(&self, way: Way, config: &UnetConfig, input: Tensor<4>) -> Tensor<4> {
        let input = Self::seen(config, input);
        let mut features = Features::plain(input.clone());
        let mut skips = Vec::with_capacity(self.encoder.len());
        for (scale, block) in self.encoder.iter().enumerate() {
            if scale > 0 {
                features = Features::plain(pool(way, &features));
            }
            features = block.forward(way, &[&features]);
            skips.push(features.clone());
        }
        for (scale, block) in self.decoder.iter().enumerate().rev() {
            let up = &self.up[scale];
            let lifted = Features::plain(unpool(way, &features, up.weight.val(), up.bias.val()));
            features = block.forward(way, &[&skips[scale], &lifted]);
        }
        let (weight, bias) = (self.output.weight.val(), self.output.bias.val());
        if config.inputs.is_bare() {
            return input + convolve(way, &[&features], weight, bias);
        }
        let given = convolve(way, &[&features, &Features::plain(input.clone())], weight, bias);
        let colours = |of: &Tensor<4>, first: usize| of.clone().narrow(1, first, CHANNELS);
        let sum = colours(&input, config.base_channel()) + colours(&given, 0);
        (1..=config.blended())
            .map(|bank| CHANNELS * bank)
            .fold(sum, |sum, first| sum + colours(&given, first) * colours(&input, first))
    }

    /// The channels as the layers see them: where filtered captures are blended in, what each filter changes in the capture, enlarged.
    fn seen(config: &UnetConfig, input: Tensor<4>) -> Tensor<4> {
        let blended = config.blended();
        if blended == 0 {
            return input;
        }
        let part = |first: usize, count: usize| input.clone().narrow(1, first, count);
        let capture = part(0, CHANNELS);
        let changes = (1..=blended).map(|bank| (part(CHANNELS * bank, CHANNELS) - capture.clone()) * CHANGE_GAIN);
        let filtered = CHANNELS * (1 + blended);
        let rest = (config.inputs.channels() > filtered).then(|| part(filtered, config.inputs.channels() - filtered));
        Tensor::cat(std::iter::once(capture.clone()).chain(changes).chain(rest).collect(), 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_that_are_no_network_are_refused() {
        for (base_width, scales) in [(0, 3), (16, 0), (16, 8), (513, 1), (512, 4)] {
            assert!(UnetConfig::bare(base_width, scales).validate().is_err(), "{base_width} {scales}");
        }
        assert!(UnetConfig::default().validate().is_ok());
        assert_eq!(UnetConfig::default().multiple(), 4);
        let full = UnetConfig::bare(32, 7);
        assert!(full.validate().is_ok());
        let widths: Vec<usize> = (0..7).map(|s| full.width(s)).collect();
        assert_eq!(widths, [32, 64, 128, 256, 512, 512, 512]);
    }

    /// Checkpoints from before the choice do not say what their output is added to: the filtered capture. New ones say so.
    #[test]
    fn what_an_output_is_added_to_is_kept() {
        let old: UnetConfig =
            serde_json::from_str(r#"{"base_width": 16, "scales": 3, "inputs": ["wiener", "field"]}"#).expect("read");
        assert_eq!((old.base, old.base_channel(), old.blended(), old.outputs()), (Base::Filtered, 3, 0, 3));
        let new = UnetConfig::bare(16, 3).seeing(Inputs::GUIDED);
        assert_eq!((new.base, new.base_channel(), new.blended(), new.outputs()), (Base::Blend, 0, 3, 12));
        let text = serde_json::to_string(&new).expect("text");
        assert_eq!((text.contains("blend"), serde_json::from_str::<UnetConfig>(&text).expect("own text")), (true, new));
        let bare = UnetConfig::bare(16, 3);
        assert!(
            bare == bare.clone().seeing(Inputs::BARE)
                && !serde_json::to_string(&bare).expect("text").contains("base\"")
        );
    }

    /// A fresh network whose filters are blended in begins near the capture, whatever the filters make of it; one on the old base near the filtered
    /// capture. Of shares of one and no residual it gives the filtered capture.
    #[test]
    fn shares_of_one_give_the_filtered_capture() {
        use crate::Reconstructor;
        use ndarray::{Array4, s};
        let rng = &mut fastrand::Rng::with_seed(4);
        let inputs = Inputs { wiener: true, field: true, ..Inputs::BARE };
        let seen = Array4::from_shape_simple_fn((1, 9, 16, 16), || rng.f32());
        for base in Base::ALL {
            let config = UnetConfig { base, ..UnetConfig::bare(4, 2).seeing(inputs) };
            let mut net = Reconstructor::new(config, 1).expect("valid");
            let at = |net: &Reconstructor, first: usize| {
                let out = net.forward(seen.view()).expect("fits");
                (&out - &seen.slice(s![.., first..first + 3, .., ..])).iter().fold(0f32, |m, v| m.max(v.abs()))
            };
            let [near, far] = if base == Base::Blend { [0, 3] } else { [3, 0] };
            assert!(4.0 * at(&net, near) < at(&net, far), "{base:?}: {} and {}", at(&net, near), at(&net, far));
            if base == Base::Blend {
                for parameter in net.parameters().iter().filter(|p| p.name.starts_with("output.")) {
                    let mut values = vec![0.0; parameter.values.len()];
                    if parameter.name == "output.bias" {
                        // Changes are enlarged.
                        values[3..].fill(1.0 / CHANGE_GAIN);
                    }
                    net.set_parameter(&parameter.name, &values).expect("as many");
                }
                assert!(at(&net, 3) < 1e-6);
            }
        }
    }
}
