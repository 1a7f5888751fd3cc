//! A burn module on its way: its parameters as one flat list, their gradient, Adam with clipping.
//!
//! On the CPU the optimiser works on plain vectors; on another device it stays there ([`DeviceAdam`]). Generator and discriminators learn alike; a checkpoint of either is the same list of names, shapes and numbers.

use std::borrow::Cow;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Device, Gradients, Tensor, TensorData};

use super::adam::{Adam, norm};
use super::compute::Compute;
use super::device_adam::{self, DeviceAdam, values};
use super::kernels;
use isoplanat_base::error::{Error, Result};

/// Gradients longer than this (global Euclidean norm) are scaled down to it.
const CLIP_NORM: f64 = 1.0;

/// One named parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Stable name, as `encoder.0.conv1.weight`.
    pub name: String,
    /// Shape: weights `[out, in, 3, 3]`, `[out, in, 1, 1]`, (`depth`) `[channels, 1, 3, 3]` or (`up`) `[in, out, 2, 2]`; biases,
    /// slopes and scales `[channels]`.
    pub shape: Vec<usize>,
    /// Values in row-major order.
    pub values: Vec<f32>,
}

/// A module and its optimiser.
#[derive(Debug)]
pub(super) struct Learner<M> {
    /// Taken out only while its parameters change.
    module: Option<M>,
    device: Device,
    optimiser: Optimiser,
}

/// Its moments are in the order of [`Learner::parameters`].
#[derive(Debug)]
enum Optimiser {
    Host(Adam),
    Device(DeviceAdam),
}

/// The gradient of every parameter, in their order, where the optimiser wants it.
#[derive(Debug)]
pub(super) enum Gradient {
    Host(Vec<Vec<f32>>),
    Device(Vec<Tensor<1>>),
}

impl Gradient {
    /// In the host's memory.
    pub(super) fn to_host(&self) -> Cow<'_, [Vec<f32>]> {
        match self {
            Self::Host(all) => Cow::Borrowed(all),
            Self::Device(all) => all.iter().map(|g| values(g.clone())).collect(),
        }
    }

    /// Its Euclidean length, by the optimiser's own sum.
    pub(super) fn norm(&self) -> f64 {
        match self {
            Self::Host(all) => norm(all),
            Self::Device(all) => device_adam::norm(all),
        }
    }
}

impl<M: Module> Learner<M> {
    /// `module` on `device` (with autodiff) of the kind `compute`, no step taken.
    pub(super) fn new(module: M, device: Device, compute: Compute) -> Self {
        let optimiser = match compute {
            Compute::Cpu => Optimiser::Host(Adam::new(module.num_params())),
            Compute::Cuda | Compute::Wgpu => Optimiser::Device(DeviceAdam::new(&module, &device.clone().inner())),
        };
        Self { optimiser, module: Some(module), device }
    }

    /// The module, its parameters tracked.
    pub(super) fn module(&self) -> &M {
        self.module.as_ref().expect("put back after every change")
    }

    /// The module with parameters that want no gradient; what flows through it still has its own.
    pub(super) fn frozen(&self) -> M {
        self.module().clone().no_grad()
    }

    /// Where it computes, with autodiff.
    pub(super) fn device(&self) -> &Device {
        &self.device
    }

    /// The optimiser's state.
    pub(super) fn adam(&self) -> Cow<'_, Adam> {
        match &self.optimiser {
            Optimiser::Host(adam) => Cow::Borrowed(adam),
            Optimiser::Device(adam) => Cow::Owned(adam.to_host()),
        }
    }

    /// Steps taken.
    pub(super) fn steps(&self) -> u64 {
        match &self.optimiser {
            Optimiser::Host(adam) => adam.steps,
            Optimiser::Device(adam) => adam.steps,
        }
    }

    /// All parameters by name, in the module's order.
    pub(super) fn parameters(&self) -> Vec<Parameter> {
        collect(self.module())
    }

    /// Replaces the values of the parameter `name`; the optimiser's moments stay.
    pub(super) fn set_parameter(&mut self, name: &str, values: &[f32]) -> Result<()> {
        let mut offset = 0;
        for parameter in self.parameters() {
            let n = parameter.values.len();
            if parameter.name == name {
                if values.len() != n {
                    return Err(Error::bad("", name, format!("{} values", values.len()), format!("{n} values")));
                }
                self.change(|first, now| {
                    if first == offset {
                        now.copy_from_slice(values);
                    }
                });
                return Ok(());
            }
            offset += n;
        }
        Err(Error::bad("", name, "no such parameter", "a name from the network's list of parameters"))
    }

    /// Puts everything back as a checkpoint had it, or only the weights, with a fresh optimiser.
    ///
    /// # Panics
    /// Where the lengths are not those of the module.
    pub(super) fn restore(&mut self, weights: &[f32], adam: Option<Adam>) {
        let n = self.module().num_params();
        let lengths = |a: &Adam| [a.first.len(), a.second.len()];
        assert!(weights.len() == n && adam.as_ref().is_none_or(|a| lengths(a) == [n; 2]));
        let there = self.device.clone().inner();
        self.optimiser = match (&self.optimiser, adam) {
            (Optimiser::Host(_), adam) => Optimiser::Host(adam.unwrap_or_else(|| Adam::new(n))),
            (Optimiser::Device(_), None) => Optimiser::Device(DeviceAdam::new(self.module(), &there)),
            (Optimiser::Device(_), Some(adam)) => Optimiser::Device(DeviceAdam::with(&adam, self.module(), &there)),
        };
        self.change(|first, now| now.copy_from_slice(&weights[first..first + now.len()]));
    }

    /// The gradient of every parameter in their order, taken out of `gradients`; zeros where none arrived.
    pub(super) fn gradient(&self, gradients: &mut Gradients) -> Gradient {
        let all = device_adam::gradient_of(self.module(), gradients);
        match self.optimiser {
            Optimiser::Device(_) => Gradient::Device(all),
            Optimiser::Host(_) => Gradient::Host(all.into_iter().map(values).collect()),
        }
    }

    /// What two steps of `learning_rate` of a fresh optimiser make of the parameters, the first with a gradient of whole numbers from -3 to 3 in their order, the
    /// second with a thousandth of whole numbers from -2 to 2: what it computes, clipping included, whatever the network.
    pub(super) fn after(&self, learning_rate: f64) -> Vec<Parameter> {
        let (there, count) = (self.device.clone().inner(), self.module().num_params());
        let optimiser = match self.optimiser {
            Optimiser::Host(_) => Optimiser::Host(Adam::new(count)),
            Optimiser::Device(_) => Optimiser::Device(DeviceAdam::new(self.module(), &there)),
        };
        let mut other = Self { module: self.module.clone(), device: self.device.clone(), optimiser };
        for (period, size) in [(7, 1.0), (5, 1e-3)] {
            #[expect(clippy::cast_precision_loss, reason = "small whole numbers")]
            let known: Vec<f32> = (0..count).map(|k| size * ((k % period) as f32 - (period / 2) as f32)).collect();
            let parts = device_adam::cut(&known, other.module(), &there);
            let gradient = match other.optimiser {
                Optimiser::Host(_) => Gradient::Host(parts.into_iter().map(values).collect()),
                Optimiser::Device(_) => Gradient::Device(parts),
            };
            other.update(true, gradient, learning_rate);
        }
        other.parameters()
    }

    /// Clipped Adam step; leaves everything as it was where the loss (`sound`) or the gradient is not finite. Returns the
    /// gradient's norm before clipping, and whether the weights moved.
    ///
    /// # Panics
    /// A gradient of another learner.
    pub(super) fn update(&mut self, sound: bool, gradient: Gradient, learning_rate: f64) -> (f64, bool) {
        let norm = gradient.norm();
        let finite = sound && norm.is_finite();
        let scale = if norm > CLIP_NORM { (CLIP_NORM / norm) as f32 } else { 1.0 };
        match gradient {
            Gradient::Host(gradient) => {
                if finite {
                    let mut optimiser = std::mem::replace(&mut self.optimiser, Optimiser::Host(Adam::new(0)));
                    let Optimiser::Host(adam) = &mut optimiser else { unreachable!("the gradient is its own") };
                    let (rates, mut parts) = (adam.begin(scale, learning_rate), gradient.iter());
                    self.change(|first, now| adam.step(rates, first, now, parts.next().expect("one a parameter")));
                    self.optimiser = optimiser;
                }
                gradient.into_iter().for_each(kernels::give);
            }
            Gradient::Device(gradient) if finite => {
                let module = self.module.take().expect("put back after every change");
                let Optimiser::Device(adam) = &mut self.optimiser else { unreachable!("the gradient is its own") };
                self.module = Some(adam.step(module, gradient, scale, learning_rate));
            }
            Gradient::Device(_) => {}
        }
        (norm, finite)
    }

    /// Calls `change` with the values of every parameter and the number of the first, in the order of
    /// [`Learner::parameters`].
    fn change(&mut self, change: impl FnMut(usize, &mut [f32])) {
        // The module is taken out, so that its tensors are held once and their memory is changed in place.
        let module = self.module.take().expect("put back after every change");
        self.module = Some(module.map(&mut Change { change, first: 0, device: &self.device }));
    }
}

/// All parameters by name, in the module's order.
fn collect<M: Module>(module: &M) -> Vec<Parameter> {
    #[derive(Default)]
    struct Collect {
        path: Vec<String>,
        found: Vec<Parameter>,
    }
    impl ModuleVisitor for Collect {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let tensor = param.val().inner();
            let shape = tensor.dims().to_vec();
            self.found.push(Parameter { name: self.path.join("."), shape, values: values(tensor) });
        }
        fn enter_module(&mut self, name: &str, container: &str) {
            // Which variant of an enum it is does not show.
            if !container.starts_with("Enum:") {
                self.path.push(name.to_owned());
            }
        }
        fn exit_module(&mut self, _name: &str, container: &str) {
            if !container.starts_with("Enum:") {
                self.path.pop();
            }
        }
    }
    let mut collect = Collect::default();
    module.visit(&mut collect);
    collect.found
}

/// Calls `change` for the parameters one after the other, in the order of [`collect`].
struct Change<'a, F> {
    change: F,
    /// Parameters' values before the next.
    first: usize,
    device: &'a Device,
}

impl<F: FnMut(usize, &mut [f32])> ModuleMapper for Change<'_, F> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        param.map(|tensor| {
            let shape = tensor.dims();
            let mut now = values(tensor.inner());
            (self.change)(self.first, &mut now);
            self.first += now.len();
            Tensor::from_data(TensorData::new(now, shape), self.device).require_grad()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::layers::Way;
    use super::super::reconstructor::tensor;
    use super::super::unet::{Unet, UnetConfig};
    use super::*;

    /// The optimiser that stays on its device takes the steps of the one on plain vectors, on burn's CPU device; both clip, both leave everything where it was
    /// after a loss or a gradient that is no number, and the one goes on from the other's checkpoint.
    #[test]
    fn on_a_device_the_optimiser_takes_the_same_steps() {
        let config = UnetConfig::bare(4, 3);
        let device = Compute::Cpu.device().expect("a CPU").autodiff();
        let fresh = |compute| Learner::new(Unet::new(&config, 3, &device), device.clone(), compute);
        let picture = |seed: u64| {
            let rng = &mut fastrand::Rng::with_seed(seed);
            tensor(&ndarray::Array4::from_shape_simple_fn((1, 3, 16, 16), || rng.f32()).view(), &device)
        };
        let step = |learner: &mut Learner<Unet>, k: u64, factor: f32, sound: bool| {
            let made = learner.module().forward(Way::Burn, &config, picture(k));
            let loss = (made - picture(100 + k)).abs().mean() * factor;
            let gradient = learner.gradient(&mut loss.backward());
            learner.update(sound, gradient, 3e-3)
        };
        let all =
            |learner: &Learner<Unet>| -> Vec<f32> { learner.parameters().into_iter().flat_map(|p| p.values).collect() };
        let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).fold(0f32, |m, (a, b)| m.max((a - b).abs()));
        let [mut host, mut there] = [Compute::Cpu, Compute::Wgpu].map(fresh);
        assert!(matches!((&host.optimiser, &there.optimiser), (Optimiser::Host(_), Optimiser::Device(_))));
        let start = all(&host);
        for k in 0..12 {
            // Every third gradient is clipped.
            let factor = if k % 3 == 0 { 1e3 } else { 1.0 };
            let [(a, moved), (b, also)] = [&mut host, &mut there].map(|l| step(l, k, factor, true));
            assert!((a / b - 1.0).abs() < 1e-5 && moved && also, "{a} {b}");
        }
        assert!(apart(&all(&host), &start) > 1e-2 && apart(&all(&host), &all(&there)) < 1e-5);
        assert_eq!((host.steps(), there.steps()), (12, 12));
        let before = (all(&there), there.adam().into_owned());
        for (factor, sound) in [(f32::NAN, true), (f32::INFINITY, true), (1.0, false)] {
            assert!(!step(&mut there, 20, factor, sound).1);
            assert_eq!((all(&there), there.adam().into_owned()), before);
        }
        let mut resumed = fresh(Compute::Wgpu);
        resumed.restore(&all(&there), Some(there.adam().into_owned()));
        for k in 30..33 {
            for learner in [&mut resumed, &mut there] {
                step(learner, k, 1.0, true);
            }
        }
        assert_eq!(all(&resumed), all(&there));
    }
}
