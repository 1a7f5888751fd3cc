//! A burn module on its way: its parameters as one flat list, their gradient, Adam with clipping.
//!
//! Generator and discriminators learn alike; a checkpoint of either is the same list of names, shapes and numbers.

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Device, Gradients, Tensor, TensorData};

use super::adam::{Adam, norm};
use super::kernels;
use crate::error::{Error, Result};

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
    /// Its moments are in the order of [`Learner::parameters`].
    adam: Adam,
}

impl<M: Module> Learner<M> {
    /// `module` on `device` (with autodiff), no step taken.
    pub(super) fn new(module: M, device: Device) -> Self {
        Self { adam: Adam::new(module.num_params()), module: Some(module), device }
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
    pub(super) fn adam(&self) -> &Adam {
        &self.adam
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
        let n = self.adam.first.len();
        let adam = adam.unwrap_or_else(|| Adam::new(n));
        assert!([weights.len(), adam.first.len(), adam.second.len()] == [n; 3]);
        self.adam = adam;
        self.change(|first, now| now.copy_from_slice(&weights[first..first + now.len()]));
    }

    /// The gradient of every parameter in their order, taken out of `gradients`; zeros where none arrived.
    pub(super) fn gradient(&self, gradients: &mut Gradients) -> Vec<Vec<f32>> {
        let mut collect = CollectGradient { gradients, found: Vec::new() };
        self.module().visit(&mut collect);
        collect.found
    }

    /// Clipped Adam step; leaves everything as it was where the loss (`sound`) or the gradient is not finite. Returns the
    /// gradient's norm before clipping, and whether the weights moved.
    pub(super) fn update(&mut self, sound: bool, gradient: Vec<Vec<f32>>, learning_rate: f64) -> (f64, bool) {
        let norm = norm(&gradient);
        let finite = sound && norm.is_finite();
        if finite {
            let scale = if norm > CLIP_NORM { (CLIP_NORM / norm) as f32 } else { 1.0 };
            let (rates, mut parts) = (self.adam.begin(scale, learning_rate), gradient.iter());
            let mut adam = std::mem::replace(&mut self.adam, Adam::new(0));
            self.change(|first, now| adam.step(rates, first, now, parts.next().expect("one a parameter")));
            self.adam = adam;
        }
        gradient.into_iter().for_each(kernels::give);
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

fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_into_vec::<f32>().expect("parameters are f32 in the host's memory")
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

struct CollectGradient<'a> {
    gradients: &'a mut Gradients,
    found: Vec<Vec<f32>>,
}

impl ModuleVisitor for CollectGradient<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let tensor = param.val();
        self.found.push(match tensor.grad_remove(self.gradients) {
            Some(gradient) => values(gradient),
            None => vec![0.0; tensor.dims().iter().product()],
        });
    }
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
