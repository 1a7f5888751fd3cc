//! Whether a device computes what the CPU computes: a training step's loss, output and gradients and a step of the optimiser on both, part by part.
//!
//! Backends of GPUs have been wrong in the gradients of weights alone (burn 0.22.1 on wgpu), which no loss shows at once: a
//! training there would learn something else, slowly. The oracle is burn's plain code on the CPU.

use ndarray::{Array4, ArrayView4};

use super::{Content, ContentKind, Objective, Trainer};
use crate::compute::Compute;
use crate::layers::Way;
use crate::learner::{Gradient, Parameter};
use crate::reconstructor::{Reconstructor, array};
use isoplanat_base::error::{Error, Result};

/// Most that a part may be off, of its own size. Rounding moves pixels over the kinks of PReLU and max-pooling: between our own
/// kernels and burn's code a gradient is off by up to 9e-3 in networks of seven scales, 2e-3 in those of three. The gradients
/// that were wrong were off by 0.7.
const LIMIT: f64 = 5e-2;

/// Gradients of parameters smaller than this share of all parameters' are rounding, and are measured by it.
const LEAST: f64 = 1e-3;

/// A step of the optimiser that weights cannot hide.
const STEP: f64 = 0.5;

impl Trainer {
    /// Checks a device that is not the CPU before anything is trained on it: a step on a batch of `batch` patches of `side` pixels
    /// there and by burn's plain code on the CPU, with the same weights. Where they differ, convolutions are done in
    /// blocks from then on, if that mends it.
    ///
    /// # Errors
    /// A device that computes something else even so: what is furthest off, and how far.
    pub fn check_device(&mut self, objective: &Objective, batch: usize, side: usize) -> Result<()> {
        let compute = self.generator.compute();
        if compute == Compute::Cpu { Ok(()) } else { self.judge_device(compute.name(), objective, batch, side) }
    }

    fn judge_device(&mut self, name: &str, objective: &Objective, batch: usize, side: usize) -> Result<()> {
        let channels = self.generator.config().inputs.channels();
        let (input, target) = (pictures((batch, channels, side, side), 1), pictures((batch, 3, side, side), 2));
        let oracle = self.twin(objective)?.probe(&input.view(), &target.view())?;
        let off = |trainer: &Self| -> Result<Deviation> {
            Ok(Deviation::worst(&oracle, &trainer.probe(&input.view(), &target.view())?))
        };
        let says = |d: &Deviation| format!("{} off by {:.1e} of its size", d.name, d.relative);
        let whole = off(self)?;
        if whole.passes() {
            self.checked = Some(format!("device: {name}, a step agrees with the CPU's ({})", says(&whole)));
            return Ok(());
        }
        self.set_way(self.generator.way().blockwise());
        let blocks = off(self)?;
        if !blocks.passes() {
            let found = format!("{name}: {}, in blocks {}", says(&whole), says(&blocks));
            return Err(refused(found, [batch, channels, side]));
        }
        self.checked = Some(format!(
            "device: {name}, convolutions in blocks, since whole ones are wrong ({}); so a step agrees with the CPU's ({})",
            says(&whole),
            says(&blocks)
        ));
        Ok(())
    }

    /// How the device was found to compute, for people; nothing of the CPU.
    pub fn device(&self) -> Option<&str> {
        self.checked.as_deref()
    }

    fn set_way(&mut self, way: Way) {
        self.generator.set_way(way);
        if let Content::Features(vgg) = &mut self.content {
            vgg.set_way(way);
        }
    }

    /// The same weights on the CPU, run by burn's plain code.
    fn twin(&self, objective: &Objective) -> Result<Self> {
        let all = |parameters: Vec<Parameter>| parameters.into_iter().flat_map(|p| p.values).collect::<Vec<f32>>();
        let mut generator = Reconstructor::on(Compute::Cpu, self.generator.config().clone(), 0)?;
        generator.restart(all(self.generator.parameters()));
        let mut twin = Self::new(generator, objective, 0)?;
        for ((_, own), (_, other)) in self.critics.iter().zip(&mut twin.critics) {
            other.restore(&all(own.parameters()), None);
        }
        twin.set_way(Way::Burn);
        Ok(twin)
    }

    /// Losses, output and every gradient of a step that is not taken.
    fn probe(&self, input: &ArrayView4<f32>, target: &ArrayView4<f32>) -> Result<Vec<Part>> {
        let pass = self.pass(input, target)?;
        let mut parts = Vec::new();
        for (prefix, learner) in &self.critics {
            let (loss, gradient) = pass.judged(self.generator.way(), learner)?;
            parts.push(Part::new(format!("{prefix}loss"), vec![loss as f32]));
            parts.extend(Part::gradients(prefix, &learner.parameters(), &gradient));
            parts.extend(Part::moved(prefix, learner.after(STEP)));
        }
        let loss = self.generator_loss(&pass)?;
        parts.push(Part::new("loss", vec![(loss.content + loss.adversarial) as f32]));
        let gradient = self.generator.gradient(&mut loss.surrogate.backward());
        parts.push(Part::new("output", array(pass.made.inner())?.into_raw_vec_and_offset().0));
        parts.extend(Part::gradients("", &self.generator.parameters(), &gradient));
        parts.extend(Part::moved("", self.generator.after(STEP)));
        Ok(parts)
    }
}

impl Reconstructor {
    /// As [`Trainer::check_device`], for joint design: a step by the mean absolute difference, and the gradient that goes back to the input. How the
    /// device was found to compute, in words; nothing of the CPU.
    ///
    /// # Errors
    /// As [`Trainer::check_device`].
    pub fn check_device(&mut self, batch: usize, side: usize) -> Result<Option<String>> {
        let compute = self.compute();
        if compute == Compute::Cpu { Ok(None) } else { self.judge_device(compute.name(), batch, side).map(Some) }
    }

    fn judge_device(&mut self, name: &str, batch: usize, side: usize) -> Result<String> {
        let objective = Objective { content: ContentKind::L1, critics: None, average: None };
        let weights: Vec<f32> = self.parameters().into_iter().flat_map(|p| p.values).collect();
        let config = self.config().clone();
        let twin = |compute: Compute, way: Way| -> Result<Self> {
            let mut twin = Self::on(compute, config.clone(), 0)?;
            twin.restart(weights.clone());
            twin.set_way(way);
            Ok(twin)
        };
        let mut trainer = Trainer::new(twin(self.compute(), self.way())?, &objective, 0)?;
        trainer.judge_device(name, &objective, batch, side)?;
        self.set_way(trainer.generator.way());
        let channels = config.inputs.channels();
        let (input, target) = (pictures((batch, channels, side, side), 1), pictures((batch, 3, side, side), 2));
        let mut oracle = twin(Compute::Cpu, Way::Burn)?;
        let back = |network: &mut Self| -> Result<Vec<Part>> {
            let step = network.step(input.view(), target.view(), None, 0.0, false)?;
            Ok(vec![Part::new("gradient of the input", step.input_bar.into_raw_vec_and_offset().0)])
        };
        let off = Deviation::worst(&back(&mut oracle)?, &back(self)?);
        if !off.passes() {
            let found = format!("{name}: {} off by {:.1e} of its size", off.name, off.relative);
            return Err(refused(found, [batch, channels, side]));
        }
        let told = trainer.device().unwrap_or_default();
        Ok(format!("{told}; {} off by {:.1e} of its size", off.name, off.relative))
    }
}

/// A device that computes something else on a batch of so many pictures of so many channels and such a side.
fn refused(found: String, [batch, channels, side]: [usize; 3]) -> Error {
    let allowed =
        format!("at most {LIMIT} on a batch of {batch} x {channels} x {side} x {side}; use cpu, or another driver");
    Error::bad("isoplanat", "device", found, allowed)
}

/// One of the things that are compared.
#[derive(Clone, Debug)]
struct Part {
    /// For people.
    name: String,
    values: Vec<f32>,
    /// What the part is measured by at least.
    least: f64,
}

impl Part {
    /// Numbers that are measured by their own size.
    fn new(name: impl Into<String>, values: Vec<f32>) -> Self {
        Self { name: name.into(), values, least: 0.0 }
    }

    /// Parameters that an optimiser has moved.
    fn moved(prefix: &str, parameters: Vec<Parameter>) -> impl Iterator<Item = Self> {
        parameters.into_iter().map(move |p| Self::new(format!("{prefix}{} after two steps of Adam", p.name), p.values))
    }

    /// The gradients of a module's parameters.
    fn gradients(prefix: &str, parameters: &[Parameter], gradient: &Gradient) -> Vec<Self> {
        let gradients = gradient.to_host().into_owned();
        // As the optimiser sums it to clip it.
        let norm = Self::new(format!("norm of {prefix}gradient"), vec![gradient.norm() as f32]);
        let all = gradients.iter().map(|g| length(g).powi(2)).sum::<f64>().sqrt();
        let part = |(p, values): (&Parameter, _)| Self {
            name: format!("gradient of {prefix}{}", p.name),
            values,
            least: LEAST * all,
        };
        parameters.iter().zip(gradients).map(part).chain([norm]).collect()
    }
}

fn length(values: &[f32]) -> f64 {
    values.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt()
}

/// How far two probes of a step are apart, and where.
#[derive(Clone, Debug, PartialEq)]
struct Deviation {
    /// The part that is furthest off.
    name: String,
    /// Euclidean length of the difference over that of the oracle's part; infinite where a number is none.
    relative: f64,
}

impl Deviation {
    /// The worst of `found` against `oracle`.
    ///
    /// # Panics
    /// If the probes are of different steps.
    fn worst(oracle: &[Part], found: &[Part]) -> Self {
        assert_eq!(oracle.len(), found.len());
        let mut worst = Self { name: String::new(), relative: -1.0 };
        for (a, b) in oracle.iter().zip(found) {
            assert_eq!((&a.name, a.values.len()), (&b.name, b.values.len()));
            let difference: Vec<f32> = a.values.iter().zip(&b.values).map(|(a, b)| a - b).collect();
            let (off, scale) = (length(&difference), length(&a.values).max(a.least));
            let relative = match () {
                () if off == 0.0 => 0.0,
                () if (off / scale).is_finite() => off / scale,
                () => f64::INFINITY,
            };
            if relative > worst.relative {
                worst = Self { name: a.name.clone(), relative };
            }
        }
        worst
    }

    /// Whether that is no more than rounding.
    fn passes(&self) -> bool {
        self.relative <= LIMIT
    }
}

/// Smooth pictures with noise, `[batch, channel, row, col]`, in `[0, 1]`.
fn pictures(shape: (usize, usize, usize, usize), seed: u64) -> Array4<f32> {
    let mut rng = fastrand::Rng::with_seed(seed);
    Array4::from_shape_fn(shape, |(b, k, r, c)| {
        let (x, y, phase) = (c as f32, r as f32, (seed as f32) + (b * 5 + k) as f32);
        0.45 + 0.2 * (0.11 * x + 0.031 * y + phase).sin()
            + 0.15 * (0.043 * x - 0.19 * y + 2.0 * phase).cos()
            + 0.2 * rng.f32()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::critic::CriticConfig;
    use crate::{ContentKind, UnetConfig};

    /// A device whose weight gradients are wrong on large planes is worked round by blocks; one that is always wrong is refused
    /// with the figure and the parameter. A right one passes as it is.
    #[test]
    fn a_device_with_wrong_gradients_is_refused() {
        let critics = Some(CriticConfig { width: 4, patch_px: 32 });
        let objectives =
            [None, critics].map(|critics| Objective { content: ContentKind::Structure, critics, average: None });
        for (objective, side) in objectives.into_iter().zip([136, 32]) {
            let fresh = || {
                let network = Reconstructor::new(UnetConfig::bare(4, 3), 7).expect("valid");
                Trainer::new(network, &objective, 1).expect("valid")
            };
            let with = |right_to: usize| {
                let mut trainer = fresh();
                trainer.set_way(Way::Faulty { blocks: false, right_to });
                let judged = trainer.judge_device("test", &objective, 1, side);
                (trainer, judged)
            };
            let (trainer, judged) = with(usize::MAX);
            judged.expect("a right device");
            let said = trainer.device().expect("checked");
            assert!(said.contains("agrees") && !said.contains("blocks"), "{said}");
            if side > 128 {
                let (mut trainer, judged) = with(130 * 130);
                judged.expect("right in blocks");
                let said = trainer.device().expect("checked").to_owned();
                assert!(said.contains("in blocks") && said.contains("gradient of "), "{said}");
                // It goes on so, as the CPU does.
                let (input, target) = (pictures((1, 3, side, side), 1), pictures((1, 3, side, side), 2));
                let [a, b] = [&mut trainer, &mut fresh()]
                    .map(|t| t.step(input.view(), target.view(), 1e-3).expect("fits").gradient_norm);
                assert!((a / b - 1.0).abs() < 1e-3, "{a} {b}");
            }
            let (trainer, judged) = with(0);
            let error = judged.expect_err("refused");
            assert_eq!(error.exit_code(), 2);
            let text = error.to_string();
            assert!(
                text.starts_with("isoplanat: device: test: gradient of ") && text.contains("weight off by"),
                "{text}"
            );
            assert!(text.contains("7.5e-1") && text.contains(&format!("1 x 3 x {side} x {side}")), "{text}");
            assert!(trainer.device().is_none());
            // The CPU needs no check, and its own kernels pass it.
            let mut own = fresh();
            own.check_device(&objective, 1, side).expect("the CPU");
            assert!(own.device().is_none());
            own.judge_device("cpu", &objective, 1, side).expect("our kernels");
        }
    }

    /// The same for a network that joint design asks for the gradient at its input.
    #[test]
    fn a_network_whose_device_is_wrong_is_refused() {
        let fresh = || Reconstructor::new(UnetConfig::bare(4, 3), 7).expect("valid");
        let with = |right_to: usize| {
            let mut network = fresh();
            network.set_way(Way::Faulty { blocks: false, right_to });
            let judged = network.judge_device("test", 1, 136);
            (network, judged)
        };
        let said = with(usize::MAX).1.expect("a right device");
        assert!(said.contains("agrees") && said.contains("gradient of the input off by"), "{said}");
        let (mut network, judged) = with(130 * 130);
        assert!(judged.expect("right in blocks").contains("in blocks"));
        let (input, target) = (pictures((1, 3, 136, 136), 1), pictures((1, 3, 136, 136), 2));
        let [a, b] = [&mut network, &mut fresh()].map(|n| {
            let step = n.step(input.view(), target.view(), None, 1e-3, true).expect("fits");
            (step.gradient_norm, length(step.input_bar.as_slice().expect("whole")))
        });
        assert!((a.0 / b.0 - 1.0).abs() < 1e-3 && (a.1 / b.1 - 1.0).abs() < 1e-3, "{a:?} {b:?}");
        assert!(with(0).1.expect_err("refused").to_string().contains("weight off by"));
        assert!(fresh().check_device(1, 136).expect("the CPU").is_none());
    }

    #[test]
    fn the_worst_part_is_named_with_its_share() {
        let part = |name: &str, values: &[f32]| Part::new(name, values.to_vec());
        let oracle = [part("a", &[3.0, 4.0]), part("b", &[1.0]), part("c", &[0.0, 0.0])];
        let same = Deviation::worst(&oracle, &oracle);
        assert!(same.relative == 0.0 && same.passes());
        let off = Deviation::worst(&oracle, &[part("a", &[3.0, 4.5]), part("b", &[1.01]), part("c", &[0.0; 2])]);
        assert!((off.relative - 0.1).abs() < 1e-12 && off.name == "a" && !off.passes());
        for bad in [f32::NAN, f32::INFINITY, 1e-3] {
            let off = Deviation::worst(&oracle, &[part("a", &[3.0, 4.0]), part("b", &[1.0]), part("c", &[0.0, bad])]);
            assert!(off.relative == f64::INFINITY && off.name == "c" && !off.passes());
        }
    }

    #[test]
    fn gradients_that_are_only_rounding_are_measured_by_all() {
        let parameter = |name: &str| Parameter { name: name.into(), shape: vec![1], values: vec![0.0] };
        let parameters = [parameter("weight"), parameter("bias")];
        let of = |bias: f32| Part::gradients("local.", &parameters, &Gradient::Host(vec![vec![1.0], vec![bias]]));
        let off = Deviation::worst(&of(0.0), &of(1e-6));
        assert!(off.passes() && off.name == "gradient of local.bias", "{off:?}");
        assert!(!Deviation::worst(&of(0.0), &of(1e-3)).passes());
    }

    #[test]
    #[ignore = "a measurement, not a check: how far two right programs are apart"]
    fn rounding_of_a_right_device() {
        let vgg =
            isoplanat_base::testing::shared("data/vgg19/vgg19_normalised_to_relu3_1.safetensors").expect("the file");
        for (width, scales, batch, side) in [(16, 3, 2, 128), (8, 7, 1, 256), (32, 7, 1, 256)] {
            for content in [ContentKind::L1, ContentKind::Structure, ContentKind::Vgg(vgg.clone())] {
                let critics = Some(CriticConfig { width: 16, patch_px: side });
                let objective = Objective { content, critics, average: None };
                let network = Reconstructor::new(UnetConfig::bare(width, scales), 7).expect("valid");
                let mut trainer = Trainer::new(network, &objective, 1).expect("valid");
                trainer.judge_device("kernels", &objective, batch, side).expect("right");
                eprintln!("{width} {scales} {batch} {side} {}", trainer.device().expect("checked"));
            }
        }
    }
}
