//! Discriminators and what they and the generator want of each other (paper §4.1, eqs. 13 and 14).
//!
//! Two of them, as in O. Kupyn, T. Martyniuk, J. Wu, Z. Wang, "DeblurGAN-v2: deblurring (orders-of-magnitude) faster and
//! better", ICCV 2019: one that judges patches (P. Isola, J.-Y. Zhu, T. Zhou, A. A. Efros, "Image-to-image translation with
//! conditional adversarial networks", CVPR 2017: 4 × 4 convolutions of stride 2, 70 × 70 pixels a score) and one that judges
//! the whole picture with a single score. Both see sRGB-encoded pictures. Losses are relativistic least squares
//! (A. Jolicoeur-Martineau, "The relativistic discriminator", ICLR 2019), with the sign that eq. 13 means.

use burn::module::{Module, Param};
use burn::tensor::activation::leaky_relu;
use burn::tensor::{Device, Tensor, TensorData};
use serde::{Deserialize, Serialize};

use super::layers::{Way, convolve_any};
use super::unet::CHANNELS;
use isoplanat_base::error::{Error, Result};

/// Slope of the leaky ReLUs below zero.
const LEAK: f64 = 0.2;

/// Added to the variance of instance normalisation. Larger than usual: a flat patch is not blown up to full contrast.
const EPSILON: f64 = 1e-3;

/// Most channels, times the finest layer's.
const WIDEST: usize = 8;

/// Sizes of the two discriminators.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CriticConfig {
    /// Channels of the first layer (64 in the publications; each layer doubles them up to eight times).
    pub width: usize,
    /// Side of the training patches, pixels: the global discriminator halves it down to four.
    pub patch_px: usize,
}

impl CriticConfig {
    /// Refuses sizes that are no network.
    pub fn validate(&self) -> Result<()> {
        if !(1..=256).contains(&self.width) {
            return Err(Error::bad("", "loss.discriminator_width", self.width.to_string(), "1 to 256 channels"));
        }
        if !(32..=1024).contains(&self.patch_px) || !self.patch_px.is_power_of_two() {
            let allowed = "32, 64, 128, 256, 512 or 1024 pixels where discriminators train";
            return Err(Error::bad("", "pairs.patch_px", self.patch_px.to_string(), allowed));
        }
        Ok(())
    }
}

/// What a discriminator looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sight {
    /// Patches: one score for each.
    Local,
    /// The whole picture: one score.
    Global,
}

#[derive(Module, Debug)]
struct Layer {
    weight: Param<Tensor<4>>,
    bias: Param<Tensor<1>>,
}

impl Layer {
    fn draw(inputs: usize, outputs: usize, rng: &mut fastrand::Rng, device: &Device) -> Self {
        let deviation = (2.0 / ((1.0 + LEAK * LEAK) * (16 * inputs) as f64)).sqrt();
        let bound = 3f64.sqrt() * deviation;
        let shape = [outputs, inputs, 4, 4];
        let values: Vec<f32> = (0..shape.iter().product()).map(|_| (bound * (2.0 * rng.f64() - 1.0)) as f32).collect();
        Self {
            weight: Param::from_data(TensorData::new(values, shape), device),
            bias: Param::from_data(TensorData::new(vec![0f32; outputs], [outputs]), device),
        }
    }

    fn forward(&self, way: Way, x: Tensor<4>, stride: usize, padding: usize) -> Tensor<4> {
        convolve_any(way, x, self.weight.val(), self.bias.val(), stride, padding)
    }
}

/// A discriminator.
#[derive(Module, Debug)]
pub(super) struct Discriminator {
    /// Halving layers, finest first.
    halving: Vec<Layer>,
    /// A layer of stride 1 before the scores (local only).
    flat: Vec<Layer>,
    score: Layer,
}

impl Discriminator {
    /// Fresh weights from `seed`.
    pub(super) fn new(config: &CriticConfig, sight: Sight, seed: u64, device: &Device) -> Self {
        let rng = &mut fastrand::Rng::with_seed(seed);
        let count = match sight {
            Sight::Local => 3,
            Sight::Global => (config.patch_px.ilog2() - 2) as usize,
        };
        let width = |layer: usize| config.width * WIDEST.min(1 << layer);
        let inputs = |layer: usize| if layer == 0 { CHANNELS } else { width(layer - 1) };
        let halving: Vec<Layer> = (0..count).map(|l| Layer::draw(inputs(l), width(l), rng, device)).collect();
        let flat: Vec<Layer> = match sight {
            Sight::Local => vec![Layer::draw(width(count - 1), width(count), rng, device)],
            Sight::Global => vec![],
        };
        let last = width(count - 1 + flat.len());
        Self { halving, flat, score: Layer::draw(last, 1, rng, device) }
    }

    /// Scores: unbounded, higher for what looks real.
    ///
    /// # Shapes
    /// `[batch, 3, row, col]`, sRGB-encoded → `[batch, 1, n, m]`.
    pub(super) fn forward(&self, way: Way, picture: Tensor<4>) -> Tensor<4> {
        let mut x = picture * 2.0 - 1.0;
        let layers = self.halving.iter().map(|l| (l, 2)).chain(self.flat.iter().map(|l| (l, 1)));
        for (i, (layer, stride)) in layers.enumerate() {
            x = layer.forward(way, x, stride, 1);
            if i > 0 {
                x = normalised(x);
            }
            x = leaky_relu(x, LEAK);
        }
        // Over the global discriminator's plane of 4 × 4 the last layer gives one score.
        self.score.forward(way, x, 1, usize::from(!self.flat.is_empty()))
    }
}

/// Instance normalisation: every channel of every picture to mean 0 and (nearly) variance 1.
fn normalised(x: Tensor<4>) -> Tensor<4> {
    let mean = x.clone().mean_dim(3).mean_dim(2);
    let centred = x - mean;
    let variance = centred.clone().square().mean_dim(3).mean_dim(2);
    centred / (variance + EPSILON).sqrt()
}

/// What the discriminator minimises: real pictures score one higher than made ones do on average, and the other way
/// round (eq. 13).
pub(super) fn critic_loss(real: Tensor<4>, made: Tensor<4>) -> Tensor<1> {
    relativistic(real, made, 1.0)
}

/// What the generator minimises: the same with the signs exchanged.
pub(super) fn generator_loss(real: Tensor<4>, made: Tensor<4>) -> Tensor<1> {
    relativistic(real, made, -1.0)
}

fn relativistic(real: Tensor<4>, made: Tensor<4>, sign: f64) -> Tensor<1> {
    let mean = |scores: &Tensor<4>| scores.clone().mean().reshape([1, 1, 1, 1]);
    let (of_real, of_made) = (mean(&real), mean(&made));
    (real - of_made - sign).square().mean() + (made - of_real + sign).square().mean()
}

#[cfg(test)]
mod tests {
    use super::super::compute::Compute;
    use super::super::learner::Learner;
    use super::*;
    use isoplanat_base::testing::assert_rel;

    fn number(t: Tensor<1>) -> f64 {
        f64::from(t.into_data().try_into_vec::<f32>().expect("f32")[0])
    }

    #[test]
    fn losses_are_eq_13_with_its_sign_mended() {
        let device = Device::flex();
        let scores = |v: [f32; 4]| Tensor::<1>::from_floats(v, &device).reshape([1, 1, 2, 2]);
        let (real, made) = ([0.3f32, 1.2, -0.4, 0.9], [0.1f32, -0.6, 0.5, 0.2]);
        let mean = |v: [f32; 4]| v.iter().map(|&x| f64::from(x)).sum::<f64>() / 4.0;
        for sign in [1.0, -1.0] {
            let part = |v: [f32; 4], other: [f32; 4], sign: f64| {
                v.iter().map(|&x| (f64::from(x) - mean(other) - sign).powi(2)).sum::<f64>() / 4.0
            };
            let expected = part(real, made, sign) + part(made, real, -sign);
            let loss = if sign > 0.0 { critic_loss } else { generator_loss };
            assert_rel(number(loss(scores(real), scores(made))), expected, 1e-6, 1e-3, "RaGAN-LS");
        }
        // A discriminator that is right by one everywhere has nothing to learn.
        assert!(number(critic_loss(scores([1.0; 4]), scores([0.0; 4]))) < 1e-12);
        assert_rel(
            number(generator_loss(scores([1.0; 4]), scores([0.0; 4]))),
            8.0,
            1e-6,
            1.0,
            "and all the more to fear",
        );
    }

    #[test]
    fn one_score_a_picture_or_one_a_patch() {
        let device = Device::flex();
        for patch_px in [32, 64, 128, 256] {
            let config = CriticConfig { width: 2, patch_px };
            config.validate().expect("valid");
            let x = Tensor::<4>::ones([2, 3, patch_px, patch_px], &device) * 0.5;
            let scores = |sight| Discriminator::new(&config, sight, 1, &device).forward(Way::Burn, x.clone()).dims();
            assert_eq!(scores(Sight::Global), [2, 1, 1, 1], "{patch_px}");
            assert_eq!(scores(Sight::Local), [2, 1, patch_px / 8 - 2, patch_px / 8 - 2]);
        }
        for (width, patch_px) in [(0, 64), (257, 64), (16, 16), (16, 96), (16, 2048)] {
            assert!(CriticConfig { width, patch_px }.validate().is_err());
        }
    }

    /// The cotangent of the picture through a discriminator and the generator's loss, against differences.
    #[test]
    fn the_gradient_at_the_picture_agrees_with_differences() {
        let device = Device::flex().autodiff();
        let config = CriticConfig { width: 4, patch_px: 32 };
        let rng = &mut fastrand::Rng::with_seed(4);
        let mut draw = || -> Vec<f32> { (0..3 * 32 * 32).map(|_| rng.f32()).collect() };
        let (real, made, direction) = (draw(), draw(), draw());
        let tensor = |v: &[f32]| Tensor::<4>::from_data(TensorData::new(v.to_vec(), [1, 3, 32, 32]), &device);
        for sight in [Sight::Local, Sight::Global] {
            let critic = Discriminator::new(&config, sight, 2, &device).no_grad();
            let loss = |made: Tensor<4>| {
                generator_loss(critic.forward(Way::Burn, tensor(&real)), critic.forward(Way::Burn, made))
            };
            let x = tensor(&made).require_grad();
            let bar = x.grad(&loss(x.clone()).backward()).expect("tracked");
            let bar = bar.into_data().try_into_vec::<f32>().expect("f32");
            let step: Vec<f32> = bar.iter().zip(&direction).map(|(b, d)| b.signum() * (0.5 + d)).collect();
            let pulled: f64 = bar.iter().zip(&step).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
            let at = |h: f32| {
                let moved: Vec<f32> = made.iter().zip(&step).map(|(m, d)| m + h * d).collect();
                number(loss(tensor(&moved)))
            };
            let h = 2e-4;
            assert_rel(pulled, (at(h) - at(-h)) / f64::from(2.0 * h), 2e-2, 1e-3, &format!("{sight:?}"));
        }
    }

    /// Either discriminator learns to tell two pictures apart.
    #[test]
    fn discriminators_learn() {
        let device = Device::flex().autodiff();
        let config = CriticConfig { width: 4, patch_px: 32 };
        let rng = &mut fastrand::Rng::with_seed(9);
        let mut draw = |contrast: f32| -> Tensor<4> {
            let values: Vec<f32> = (0..3 * 32 * 32).map(|_| 0.5 + contrast * (rng.f32() - 0.5)).collect();
            Tensor::from_data(TensorData::new(values, [1, 3, 32, 32]), &device)
        };
        let (real, made) = (draw(0.8), draw(0.4));
        for sight in [Sight::Local, Sight::Global] {
            let mut learner =
                Learner::new(Discriminator::new(&config, sight, 2, &device), device.clone(), Compute::Cpu);
            let mut losses = Vec::new();
            for _ in 0..80 {
                let scores = |x: &Tensor<4>| learner.module().forward(Way::Burn, x.clone());
                let loss = critic_loss(scores(&real), scores(&made));
                losses.push(number(loss.clone().inner()));
                let gradient = learner.gradient(&mut loss.backward());
                assert!(learner.update(true, gradient, 3e-3).1);
            }
            assert!(losses[79] < 0.1 * losses[0], "{sight:?}: {} {}", losses[0], losses[79]);
        }
    }

    #[test]
    #[ignore = "a measurement, not a check: seconds of the discriminators' layers"]
    fn time_of_the_layers() {
        let device = Device::flex().autodiff();
        let rng = &mut fastrand::Rng::with_seed(9);
        let least = |name: &str, run: &mut dyn FnMut()| {
            let mut seconds: Vec<f64> = (0..5)
                .map(|_| {
                    let start = std::time::Instant::now();
                    run();
                    start.elapsed().as_secs_f64()
                })
                .collect();
            seconds.sort_by(f64::total_cmp);
            eprintln!("{name}: least {:.4} s, median {:.4} s", seconds[0], seconds[2]);
        };
        for way in [Way::Burn, super::super::kernels::Level::detect().into()] {
            for (inputs, outputs, side, stride) in [
                (3, 64, 256, 2),
                (64, 128, 128, 2),
                (128, 256, 64, 2),
                (256, 512, 32, 2),
                (512, 512, 16, 2),
                (512, 512, 8, 2),
                (256, 512, 32, 1),
                (512, 1, 31, 1),
            ] {
                let layer = Layer::draw(inputs, outputs, rng, &device);
                let x = Tensor::<4>::ones([1, inputs, side, side], &device) * 0.5;
                let name = format!("{way:?} {inputs} -> {outputs} at {side}, stride {stride}: forward");
                least(&name, &mut || drop(layer.forward(way, x.clone(), stride, 1).inner().into_data()));
                least("    and back", &mut || {
                    let x = x.clone().require_grad();
                    let y = layer.forward(way, x.clone(), stride, 1);
                    drop(x.grad(&(y.clone() * y).sum().backward()).expect("tracked").into_data());
                });
            }
            let x = Tensor::<4>::ones([1, 128, 64, 64], &device) * 0.5;
            least("normalised, leaky, 128 at 64, forward and back", &mut || {
                let x = x.clone().require_grad();
                let y = leaky_relu(normalised(x.clone()), LEAK);
                drop(x.grad(&(y.clone() * y).sum().backward()).expect("tracked").into_data());
            });
        }
    }
}
