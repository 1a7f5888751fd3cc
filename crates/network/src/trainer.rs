//! One training step of the reconstruction network: content loss, discriminators, clipped Adam (paper eqs. 12 to 14).
//!
//! In a step the discriminators learn first, from the picture the generator has just made; then the generator, against
//! them as they are now. A step whose loss or gradient is not finite leaves what it would have moved as it was.

mod device_check;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use burn::tensor::Tensor;
use ndarray::{Array4, ArrayView4};

use super::average::{self, Average};
use super::checkpoint::{Checkpoint, Section};
use super::compute::Compute;
use super::content::Content;
use super::critic::{CriticConfig, Discriminator, Sight, critic_loss, generator_loss};
use super::display::encode;
use super::layers::Way;
use super::learner::{Gradient, Learner};
use super::perceptual::Vgg;
use super::reconstructor::{Reconstructor, array, tensor};
use isoplanat_base::error::{Error, Result};

/// Weight of each discriminator in the generator's loss (eq. 14).
const SIGMA: f64 = 0.01;

/// What training minimises.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Objective {
    /// Content loss.
    pub content: ContentKind,
    /// Discriminators beside it.
    pub critics: Option<CriticConfig>,
    /// Share of the weights' running mean that a step keeps; `None`: the last step's weights are the result.
    pub average: Option<f64>,
}

/// Which content loss; all on sRGB-encoded pictures.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum ContentKind {
    /// Mean absolute difference.
    L1,
    /// `0.84 (1 − MS-SSIM) + 0.16 L1`.
    #[default]
    Structure,
    /// Eq. 12 with VGG-19 weights from this file.
    Vgg(PathBuf),
}

/// A generator, what it is trained for, and its discriminators.
#[derive(Debug)]
pub struct Trainer {
    generator: Reconstructor,
    content: Content,
    critics: Vec<(&'static str, Learner<Discriminator>)>,
    average: Option<Average>,
    /// How the device was found to compute, in words.
    checked: Option<String>,
}

/// A batch on its way through the generator, sRGB-encoded.
struct Pass {
    made: Tensor<4>,
    shown: Tensor<4>,
    truth: Tensor<4>,
}

/// The generator's loss.
struct GeneratorLoss {
    content: f64,
    l1: f64,
    adversarial: f64,
    /// Has the loss's gradient.
    surrogate: Tensor<1>,
}

/// What a training step gives.
#[derive(Clone, Debug)]
pub struct TrainStep {
    /// The content loss.
    pub content: f64,
    /// Mean absolute difference of the encoded pictures.
    pub l1: f64,
    /// The generator's adversarial loss, weighted (eq. 14); 0 without discriminators.
    pub adversarial: f64,
    /// The discriminators' own loss, mean of the two; 0 without.
    pub critic: f64,
    /// The network's output, linear, `[batch, 3, row, col]`.
    pub output: Array4<f32>,
    /// Norm of the generator's gradient before clipping.
    pub gradient_norm: f64,
    /// Whether the generator moved: loss and gradient were finite.
    pub updated: bool,
}

impl Trainer {
    /// Trains `generator` for `objective`; fresh discriminators from `seed`.
    ///
    /// # Errors
    /// VGG-19 weights that cannot be read, sizes that are no discriminators.
    pub fn new(generator: Reconstructor, objective: &Objective, seed: u64) -> Result<Self> {
        let device = generator.device().clone();
        let content = match &objective.content {
            ContentKind::L1 => Content::L1,
            ContentKind::Structure => Content::Structure,
            ContentKind::Vgg(path) => Content::Features(Box::new(Vgg::load(path, generator.way(), &device)?)),
        };
        let mut critics = Vec::new();
        if let Some(config) = &objective.critics {
            config.validate().map_err(|e| e.within("discriminators"))?;
            for (i, (prefix, sight)) in [("global.", Sight::Global), ("local.", Sight::Local)].into_iter().enumerate() {
                let module = Discriminator::new(config, sight, seed.wrapping_add(1 + i as u64), &device);
                critics.push((prefix, Learner::new(module, device.clone(), generator.compute())));
            }
        }
        let average = objective.average.map(|decay| Average::new(decay, &generator.parameters()));
        Ok(Self { generator, content, critics, average, checked: None })
    }

    /// The network that learns.
    pub fn generator(&self) -> &Reconstructor {
        &self.generator
    }

    /// Where it computes.
    pub fn compute(&self) -> Compute {
        self.generator.compute()
    }

    /// The network as a result: of averaged weights where they are averaged.
    pub fn result(&self) -> Reconstructor {
        let last = || self.generator.parameters().into_iter().flat_map(|p| p.values).collect();
        self.generator.with_weights(self.average.as_ref().map_or_else(last, |a| a.weights.clone()))
    }

    /// Puts a weight into the generator that it should not have; for tests.
    #[doc(hidden)]
    pub fn poison(&mut self, weight: f32) {
        self.generator.set_parameter("output.bias", &[0.0, weight, 0.0]).expect("three channels");
    }

    /// The loss, for people.
    pub fn describe(&self) -> String {
        let adversarial = if self.critics.is_empty() { "" } else { " + 0.01 global + 0.01 local RaGAN-LS" };
        format!("{}{adversarial}", self.content.describe())
    }

    /// One step on a batch, linear pictures `[batch, 3, row, col]`.
    ///
    /// # Errors
    /// Shapes that do not fit the network.
    pub fn step(&mut self, input: ArrayView4<f32>, target: ArrayView4<f32>, learning_rate: f64) -> Result<TrainStep> {
        let way = self.generator.way();
        let pass = self.pass(&input, &target)?;
        let mut critic = 0.0;
        for (_, learner) in &mut self.critics {
            let (value, gradient) = pass.judged(way, learner)?;
            critic += value / 2.0;
            learner.update(value.is_finite(), gradient, learning_rate);
        }
        let GeneratorLoss { content, l1, adversarial, surrogate } = self.generator_loss(&pass)?;
        let made = pass.made;
        drop((pass.shown, pass.truth));
        let mut gradients = surrogate.backward();
        let output = array(made.inner())?;
        let sound = (content + adversarial).is_finite();
        let (gradient_norm, updated) = self.generator.learn(sound, &mut gradients, learning_rate);
        if let Some(average) = self.average.as_mut().filter(|_| updated) {
            average.update(&self.generator.parameters());
        }
        Ok(TrainStep { content, l1, adversarial, critic, output, gradient_norm, updated })
    }

    fn pass(&self, input: &ArrayView4<f32>, target: &ArrayView4<f32>) -> Result<Pass> {
        self.generator.check_pair(input, target)?;
        let device = self.generator.device();
        let made = self.generator.forward_tracked(tensor(input, device));
        Ok(Pass { shown: encode(made.clone()), made, truth: encode(tensor(target, device)) })
    }

    /// Content loss, and what the discriminators as they are now make of the picture.
    fn generator_loss(&self, Pass { shown, truth, .. }: &Pass) -> Result<GeneratorLoss> {
        let (way, content) = (self.generator.way(), self.content.loss(shown, truth)?);
        let mut surrogate = content.surrogate;
        let mut adversarial = 0.0;
        for (_, learner) in &self.critics {
            let frozen = learner.frozen();
            let loss = generator_loss(frozen.forward(way, truth.clone()), frozen.forward(way, shown.clone())) * SIGMA;
            adversarial += value(&loss)?;
            surrogate = surrogate + loss;
        }
        Ok(GeneratorLoss { content: content.value, l1: content.l1, adversarial, surrogate })
    }

    /// Writes generator, discriminators, optimisers and `facts` to `path`, whole or not at all; refuses numbers that are not
    /// finite. [`Reconstructor::load`] reads the generator of the file.
    pub fn save(&self, path: &Path, facts: &BTreeMap<String, String>) -> Result<()> {
        let known: Vec<_> = self.critics.iter().map(|(prefix, l)| (*prefix, l.parameters(), l.adam())).collect();
        let critics = known.iter();
        let mut sections: Vec<Section<'_>> = critics
            .map(|(prefix, parameters, adam)| Section { prefix, parameters, steps: adam.steps, adam: Some(adam) })
            .collect();
        let averaged = self.average.as_ref().map(|a| (a.steps, a.parameters(&self.generator.parameters())));
        sections.extend(averaged.iter().map(|(steps, parameters)| Section {
            prefix: average::PREFIX,
            parameters,
            steps: *steps,
            adam: None,
        }));
        self.generator.save_with(path, &sections, facts)
    }

    /// Reads what [`Trainer::save`] wrote, to go on with the same bits, and the facts.
    ///
    /// # Errors
    /// A file of another form, or without the discriminators that `objective` asks for.
    pub fn load(path: &Path, objective: &Objective, compute: Compute) -> Result<(Self, BTreeMap<String, String>)> {
        let file = Checkpoint::read(path)?;
        let mut trainer = Self::new(Reconstructor::from_checkpoint(&file, compute)?, objective, 0)?;
        for (prefix, learner) in &mut trainer.critics {
            if !file.has(prefix) {
                let place = format!("{prefix}steps");
                let allowed = "a checkpoint of adversarial training; start it from this network instead";
                return Err(Error::bad(path.display().to_string(), place, "missing", allowed));
            }
            let (weights, adam) = file.learner(prefix, &learner.parameters())?;
            learner.restore(&weights, Some(adam));
        }
        if let Some(average) = &mut trainer.average
            && file.has(average::PREFIX)
        {
            (average.weights, average.steps) = file.weights(average::PREFIX, &trainer.generator.parameters())?;
        }
        Ok((trainer, file.facts().clone()))
    }
}

impl Pass {
    /// A discriminator's own loss and its gradient; the generator stays out of it.
    fn judged(&self, way: Way, learner: &Learner<Discriminator>) -> Result<(f64, Gradient)> {
        let (critic, seen) = (learner.module(), self.shown.clone().detach());
        let loss = critic_loss(critic.forward(way, self.truth.clone()), critic.forward(way, seen));
        let value = value(&loss)?;
        Ok((value, learner.gradient(&mut loss.backward())))
    }
}

fn value(loss: &Tensor<1>) -> Result<f64> {
    let values = loss.clone().into_data().try_into_vec::<f32>();
    values.map(|v| f64::from(v[0])).map_err(|e| Error::Internal(format!("a loss: {e:?}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::UnetConfig;

    fn picture(shape: (usize, usize, usize, usize), seed: u64) -> Array4<f32> {
        let mut rng = fastrand::Rng::with_seed(seed);
        Array4::from_shape_fn(shape, |(_, k, r, c)| {
            0.5 + 0.3 * ((r as f32) * 0.3 + (c * (k + 1)) as f32 * 0.17 + seed as f32).sin() + 0.1 * rng.f32()
        })
    }

    fn small() -> Reconstructor {
        Reconstructor::new(UnetConfig::bare(4, 3), 7).expect("valid")
    }

    fn adversarial() -> Objective {
        Objective {
            content: ContentKind::Structure,
            critics: Some(CriticConfig { width: 4, patch_px: 32 }),
            average: Some(0.9),
        }
    }

    fn weights(trainer: &Trainer) -> Vec<f32> {
        let critics = trainer.critics.iter().flat_map(|(_, l)| l.parameters());
        trainer.generator.parameters().into_iter().chain(critics).flat_map(|p| p.values).collect()
    }

    #[test]
    fn every_objective_learns() {
        let target = picture((1, 3, 32, 32), 2);
        let input = target.mapv(|v| 0.7 * v + 0.1);
        for objective in [
            Objective { content: ContentKind::L1, critics: None, average: None },
            Objective { content: ContentKind::Structure, critics: None, average: None },
            adversarial(),
        ] {
            let mut trainer = Trainer::new(small(), &objective, 1).expect("valid");
            let first = trainer.step(input.view(), target.view(), 3e-3).expect("fits");
            assert!(first.updated && first.gradient_norm > 0.0);
            assert_eq!(first.adversarial > 0.0, objective.critics.is_some());
            let mut last = first.clone();
            for _ in 0..60 {
                last = trainer.step(input.view(), target.view(), 3e-3).expect("fits");
            }
            match objective.critics {
                None => {
                    assert!(last.content < 0.7 * first.content, "{objective:?}: {} {}", first.content, last.content)
                }
                // Discriminators want something else beside the content, and on one picture they win.
                Some(_) => assert!(last.content < 2.0 * first.content && last.critic.is_finite(), "{last:?}"),
            }
        }
    }

    #[test]
    fn a_checkpoint_continues_with_the_same_bits() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("network.safetensors");
        let run = |trainer: &mut Trainer, steps: std::ops::Range<u64>| {
            for s in steps {
                let (input, target) = (picture((1, 3, 32, 32), s), picture((1, 3, 32, 32), s + 100));
                trainer.step(input.view(), target.view(), 1e-3).expect("fits");
            }
        };
        let mut straight = Trainer::new(small(), &adversarial(), 1).expect("valid");
        run(&mut straight, 0..5);
        let mut first = Trainer::new(small(), &adversarial(), 1).expect("valid");
        run(&mut first, 0..3);
        let facts = BTreeMap::from([("step".to_owned(), "3".to_owned())]);
        first.save(&path, &facts).expect("written");
        let (mut resumed, read) = Trainer::load(&path, &adversarial(), Compute::Cpu).expect("read");
        assert_eq!(read.get("step").map(String::as_str), Some("3"));
        run(&mut resumed, 3..5);
        assert_eq!(weights(&resumed), weights(&straight));
        // Also a plain network, and no checkpoint for discriminators it does not have.
        assert!(Reconstructor::load(&path).expect("read").parameters() == first.result().parameters());
        small().save(&path).expect("written");
        let error = Trainer::load(&path, &adversarial(), Compute::Cpu).expect_err("no discriminators").to_string();
        assert!(error.contains("global.steps"), "{error}");
    }

    #[test]
    fn extreme_batches_leave_everything_finite() {
        let mut trainer = Trainer::new(small(), &adversarial(), 1).expect("valid");
        let shape = (2, 3, 32, 32);
        let cases = [
            (Array4::zeros(shape), Array4::zeros(shape)),
            (Array4::ones(shape), Array4::ones(shape)),
            (Array4::from_elem(shape, 0.18), Array4::from_elem(shape, 0.18)),
            (Array4::from_elem(shape, 60.0), Array4::ones(shape)),
            (Array4::from_elem(shape, -1.0), picture(shape, 3)),
            (picture(shape, 1) * 1e4, picture(shape, 2)),
        ];
        for (i, (input, target)) in cases.iter().enumerate() {
            for _ in 0..3 {
                let step = trainer.step(input.view(), target.view(), 1e-3).expect("fits");
                assert!(step.content.is_finite() && step.gradient_norm.is_finite(), "case {i}: {}", step.content);
            }
            assert!(weights(&trainer).iter().all(|w| w.is_finite()), "case {i}");
        }
        // One bad pixel: nothing moves, and the step says so.
        let before = weights(&trainer);
        let mut input = picture(shape, 1);
        input[[1, 2, 3, 4]] = f32::INFINITY;
        let step = trainer.step(input.view(), picture(shape, 2).view(), 1e-3).expect("fits");
        assert!(!step.updated);
        assert_eq!(weights(&trainer), before);
    }

    #[test]
    #[ignore = "a measurement, not a check: seconds of a training step"]
    fn time_of_a_step() {
        let vgg =
            isoplanat_base::testing::shared("data/vgg19/vgg19_normalised_to_relu3_1.safetensors").expect("the file");
        let critics = || Some(CriticConfig { width: 64, patch_px: 256 });
        for (name, objective) in [
            ("L1", Objective { content: ContentKind::L1, critics: None, average: None }),
            ("MS-SSIM", Objective { content: ContentKind::Structure, critics: None, average: None }),
            ("VGG-19", Objective { content: ContentKind::Vgg(vgg.clone()), critics: None, average: None }),
            ("L1, critics", Objective { content: ContentKind::L1, critics: critics(), average: None }),
            (
                "VGG-19, critics",
                Objective { content: ContentKind::Vgg(vgg.clone()), critics: critics(), average: None },
            ),
        ] {
            let network = Reconstructor::new(UnetConfig::bare(32, 7), 7).expect("valid");
            let mut trainer = Trainer::new(network, &objective, 1).expect("valid");
            let (input, target) = (picture((1, 3, 256, 256), 1), picture((1, 3, 256, 256), 2));
            let mut seconds: Vec<f64> = (0..8)
                .map(|_| {
                    let start = std::time::Instant::now();
                    trainer.step(input.view(), target.view(), 1e-4).expect("fits");
                    start.elapsed().as_secs_f64()
                })
                .collect();
            seconds.sort_by(f64::total_cmp);
            eprintln!("{name}: median {:.3} s, least {:.3} s", seconds[4], seconds[0]);
        }
    }
}
