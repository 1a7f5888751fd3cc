//! A burn module on its way: its parameters as one flat list, their gradient, Adam with clipping.
//!
//! Generator and discriminators learn alike; a checkpoint of either is the same list of names, shapes and numbers.

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Device, Gradients, Tensor, TensorData};

use super::adam::{Adam, norm};
use crate::error::{Error, Result};

/// Gradients longer than this (global Euclidean norm) are scaled down to it.
const CLIP_NORM: f64 = 1.0;

/// One named parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Stable name, as `encoder.0.conv1.weight`.
    pub name: String,
    /// Shape: weights `[out, in, 3, 3]` or (`up`) `[in, out, 2, 2]`, biases and slopes `[channels]`.
    pub shape: Vec<usize>,
    /// Values in row-major order.
    pub values: Vec<f32>,
}

/// A module with its flat weights and its optimiser.
#[derive(Debug)]
pub(super) struct Learner<M> {
    module: M,
    device: Device,
    /// All parameters in the order of [`Learner::parameters`]; `module` holds the same values.
    weights: Vec<f32>,
    adam: Adam,
}

impl<M: Module> Learner<M> {
    /// `module` on `device` (with autodiff), no step taken.
    pub(super) fn new(module: M, device: Device) -> Self {
        let weights: Vec<f32> = collect(&module).into_iter().flat_map(|p| p.values).collect();
        Self { adam: Adam::new(weights.len()), module, device, weights }
    }

    /// The module, its parameters tracked.
    pub(super) fn module(&self) -> &M {
        &self.module
    }

    /// The module with parameters that want no gradient; what flows through it still has its own.
    pub(super) fn frozen(&self) -> M {
        self.module.clone().no_grad()
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
        collect(&self.module)
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
                self.weights[offset..offset + n].copy_from_slice(values);
                self.write_weights();
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
    pub(super) fn restore(&mut self, weights: Vec<f32>, adam: Option<Adam>) {
        assert_eq!(weights.len(), self.weights.len());
        let adam = adam.unwrap_or_else(|| Adam::new(weights.len()));
        assert!(adam.first.len() == weights.len() && adam.second.len() == weights.len());
        (self.weights, self.adam) = (weights, adam);
        self.write_weights();
    }

    /// The weights' gradient in the order of the parameters, taken out of `gradients`; zeros where none arrived.
    pub(super) fn gradient(&self, gradients: &mut Gradients) -> Vec<f32> {
        let mut collect = CollectGradient { gradients, found: Vec::with_capacity(self.weights.len()) };
        self.module.visit(&mut collect);
        collect.found
    }

    /// Clipped Adam step; leaves everything as it was where the loss (`sound`) or the gradient is not finite. Returns the
    /// gradient's norm before clipping, and whether the weights moved.
    pub(super) fn update(&mut self, sound: bool, gradient: &[f32], learning_rate: f64) -> (f64, bool) {
        let norm = norm(gradient);
        if !sound || !norm.is_finite() {
            return (norm, false);
        }
        let scale = if norm > CLIP_NORM { (CLIP_NORM / norm) as f32 } else { 1.0 };
        self.adam.step(&mut self.weights, gradient, scale, learning_rate);
        self.write_weights();
        (norm, true)
    }

    /// Puts `self.weights` into the module.
    fn write_weights(&mut self) {
        let mut writer = Write { values: &self.weights, device: &self.device };
        self.module = self.module.clone().map(&mut writer);
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
        fn enter_module(&mut self, name: &str, _container: &str) {
            self.path.push(name.to_owned());
        }
        fn exit_module(&mut self, _name: &str, _container: &str) {
            self.path.pop();
        }
    }
    let mut collect = Collect::default();
    module.visit(&mut collect);
    collect.found
}

struct CollectGradient<'a> {
    gradients: &'a mut Gradients,
    found: Vec<f32>,
}

impl ModuleVisitor for CollectGradient<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let tensor = param.val();
        match tensor.grad_remove(self.gradients) {
            Some(gradient) => self.found.extend(values(gradient)),
            None => self.found.extend(std::iter::repeat_n(0.0, tensor.dims().iter().product())),
        }
    }
}

/// Replaces all parameters, in the order of [`collect`], by `values`.
struct Write<'a> {
    values: &'a [f32],
    device: &'a Device,
}

impl ModuleMapper for Write<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let shape = param.val().dims();
        let (head, rest) = self.values.split_at(shape.iter().product());
        self.values = rest;
        let device = self.device;
        param.map(|_| Tensor::from_data(TensorData::new(head.to_vec(), shape), device).require_grad())
    }
}
