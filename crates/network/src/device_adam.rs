//! [`Adam`] where the weights are: its moments are tensors on the device, and the optimiser brings one number back a step, the gradient's norm.
//!
//! The same recursion as on the CPU; the norm is summed in f32, so that a gradient whose square overflows f32 counts as not finite.

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Device, Gradients, Tensor, TensorData};

use super::adam::{Adam, BETA1, BETA2, EPSILON, Rates};

/// Moments of every parameter, flat, in the module's order.
#[derive(Debug)]
pub(super) struct DeviceAdam {
    first: Vec<Tensor<1>>,
    second: Vec<Tensor<1>>,
    pub(super) steps: u64,
}

impl DeviceAdam {
    /// No steps taken, for the parameters of `module` on `device` (without autodiff).
    pub(super) fn new<M: Module>(module: &M, device: &Device) -> Self {
        let zeros = || lengths(module).into_iter().map(|n| Tensor::zeros([n], device)).collect();
        Self { first: zeros(), second: zeros(), steps: 0 }
    }

    /// What `adam` holds, on `device`.
    ///
    /// # Panics
    /// Where it holds fewer numbers than `module` has.
    pub(super) fn with<M: Module>(adam: &Adam, module: &M, device: &Device) -> Self {
        Self { first: cut(&adam.first, module, device), second: cut(&adam.second, module, device), steps: adam.steps }
    }

    /// The same in the host's memory.
    pub(super) fn to_host(&self) -> Adam {
        let all = |tensors: &[Tensor<1>]| tensors.iter().flat_map(|t| values(t.clone())).collect();
        Adam { first: all(&self.first), second: all(&self.second), steps: self.steps }
    }

    /// Moves every parameter of `module` against its gradient, with step size `learning_rate` and the gradient scaled by `scale`.
    ///
    /// # Panics
    /// A gradient of another module.
    pub(super) fn step<M: Module>(&mut self, module: M, gradient: Vec<Tensor<1>>, scale: f32, learning_rate: f64) -> M {
        let rates = Rates::of(&mut self.steps, scale, learning_rate);
        assert_eq!(gradient.len(), self.first.len());
        module.map(&mut Move { adam: self, rates, gradient: gradient.into_iter().enumerate() })
    }
}

/// `all` in flat pieces as long as the parameters of `module`, on `device`.
///
/// # Panics
/// Fewer numbers than `module` has.
pub(super) fn cut<M: Module>(mut all: &[f32], module: &M, device: &Device) -> Vec<Tensor<1>> {
    let next = |n: usize| {
        let (some, rest) = all.split_at(n);
        all = rest;
        Tensor::from_data(TensorData::new(some.to_vec(), [n]), device)
    };
    lengths(module).into_iter().map(next).collect()
}

/// Numbers of every parameter, in the module's order.
fn lengths<M: Module>(module: &M) -> Vec<usize> {
    struct Lengths(Vec<usize>);
    impl ModuleVisitor for Lengths {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            self.0.push(param.val().dims().iter().product());
        }
    }
    let mut lengths = Lengths(Vec::new());
    module.visit(&mut lengths);
    lengths.0
}

/// The gradient of every parameter on its device, flat, in the module's order, taken out of `gradients`; zeros where none arrived.
pub(super) fn gradient_of<M: Module>(module: &M, gradients: &mut Gradients) -> Vec<Tensor<1>> {
    let mut collect = Collect { gradients, found: Vec::new() };
    module.visit(&mut collect);
    collect.found
}

/// Euclidean length of all of it; one number comes back from the device.
pub(super) fn norm(gradient: &[Tensor<1>]) -> f64 {
    let squares: Vec<Tensor<1>> = gradient.iter().map(|g| (g.clone() * g.clone()).sum()).collect();
    if squares.is_empty() {
        return 0.0;
    }
    values(Tensor::cat(squares, 0).sum()).iter().map(|v| f64::from(*v)).sum::<f64>().sqrt()
}

/// The numbers of a tensor, in the host's memory.
pub(super) fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_into_vec::<f32>().expect("numbers are f32")
}

struct Collect<'a> {
    gradients: &'a mut Gradients,
    found: Vec<Tensor<1>>,
}

impl ModuleVisitor for Collect<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let tensor = param.val();
        let n: usize = tensor.dims().iter().product();
        let gradient = tensor.grad_remove(self.gradients).unwrap_or_else(|| tensor.inner().zeros_like());
        self.found.push(gradient.reshape([n]));
    }
}

struct Move<'a, G> {
    adam: &'a mut DeviceAdam,
    rates: Rates,
    gradient: G,
}

impl<G: Iterator<Item = (usize, Tensor<1>)>> ModuleMapper for Move<'_, G> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let (k, gradient) = self.gradient.next().expect("one a parameter");
        let Rates { scale, rate, unbias } = self.rates;
        let gradient = gradient.mul_scalar(scale);
        let [first, second] = [&self.adam.first[k], &self.adam.second[k]].map(Clone::clone);
        let first = first.mul_scalar(BETA1 as f32) + gradient.clone().mul_scalar(1.0 - BETA1 as f32);
        let second = second.mul_scalar(BETA2 as f32) + (gradient.clone() * gradient).mul_scalar(1.0 - BETA2 as f32);
        let along = first.clone().mul_scalar(rate) / (second.clone().mul_scalar(unbias).sqrt().add_scalar(EPSILON));
        (self.adam.first[k], self.adam.second[k]) = (first, second);
        param.map(|tensor| {
            let shape = tensor.dims();
            Tensor::from_inner(tensor.inner() - along.reshape(shape)).require_grad()
        })
    }
}
