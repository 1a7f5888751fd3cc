//! The network as the rest of the crate sees it: forward pass, training step, checkpoint, parameters; `ndarray` only.
//!
//! One step is: output = network(input), loss = mean |output − target|, backward through burn's graph, Adam. The
//! cotangents of input and target leave here as arrays; optics takes over there.

use std::collections::BTreeMap;
use std::path::Path;

use burn::module::Module;
use burn::tensor::{Device, Gradients, Tensor, TensorData};
use ndarray::{Array4, ArrayView4, s};

use super::average;
use super::checkpoint::{self, Checkpoint, Section};
use super::compute::Compute;
use super::layers::Way;
use super::learner::{Gradient, Learner, Parameter};
use super::tiles;
use super::unet::{Unet, UnetConfig};
use isoplanat_base::error::{Error, Result};

/// Values of features above which the forward pass works in tiles: 1 GiB.
const TILE_ABOVE: usize = 1 << 28;

/// Side of such a tile without its margin, pixels.
const TILE: usize = 1024;

/// A network with its optimiser.
#[derive(Debug)]
pub struct Reconstructor {
    config: UnetConfig,
    learner: Learner<Unet>,
    compute: Compute,
    way: Way,
}

/// What a training step gives.
#[derive(Clone, Debug)]
pub struct Step {
    /// Mean absolute difference of output and target.
    pub loss: f32,
    /// The network's output, `[batch, 3, row, col]`.
    pub output: Array4<f32>,
    /// Cotangent of the input: ∂loss/∂input through network and global skip.
    pub input_bar: Array4<f32>,
    /// Cotangent of the target: ∂loss/∂target = −sign(output − target) / N.
    pub target_bar: Array4<f32>,
    /// Global norm of the weights' gradient before clipping; 0 where no update was asked for.
    pub gradient_norm: f64,
    /// Whether the weights moved: asked for, and loss and gradient were finite.
    pub updated: bool,
}

/// What a step of the network alone gives.
#[derive(Clone, Debug)]
pub struct NetworkStep {
    /// Mean absolute difference of output and target, before the update.
    pub loss: f32,
    /// The network's output, `[batch, 3, row, col]`.
    pub output: Array4<f32>,
    /// Global norm of the weights' gradient before clipping.
    pub gradient_norm: f64,
    /// Whether the weights moved: loss and gradient were finite.
    pub updated: bool,
}

impl Reconstructor {
    /// A fresh network with weights drawn from `seed`; the same seed gives the same bits.
    pub fn new(config: UnetConfig, seed: u64) -> Result<Self> {
        Self::on(Compute::Cpu, config, seed)
    }

    /// [`Reconstructor::new`] on another device.
    ///
    /// # Errors
    /// A size that is no network, or a device this build or machine has not.
    pub fn on(compute: Compute, config: UnetConfig, seed: u64) -> Result<Self> {
        config.validate().map_err(|e| e.within("network"))?;
        let device = compute.device()?.autodiff();
        let learner = Learner::new(Unet::new(&config, seed, &device), device, compute);
        Ok(Self { config, learner, compute, way: compute.way() })
    }

    /// The network's size.
    pub fn config(&self) -> &UnetConfig {
        &self.config
    }

    /// Training steps taken.
    pub fn steps(&self) -> u64 {
        self.learner.steps()
    }

    /// All parameters by name, in a fixed order.
    pub fn parameters(&self) -> Vec<Parameter> {
        self.learner.parameters()
    }

    /// Replaces the values of the parameter `name`; the optimiser's moments stay.
    pub fn set_parameter(&mut self, name: &str, values: &[f32]) -> Result<()> {
        self.learner.set_parameter(name, values)
    }

    /// The network's output. Height and width must be multiples of [`UnetConfig::multiple`]; a large picture is done in
    /// overlapping tiles, with the same result.
    ///
    /// ```
    /// use isoplanat_network::{Reconstructor, UnetConfig};
    /// use ndarray::Array4;
    ///
    /// let network = Reconstructor::new(UnetConfig::bare(4, 2), 1)?;
    /// let output = network.forward(Array4::from_elem((1, 3, 8, 12), 0.4).view())?;
    /// assert_eq!(output.dim(), (1, 3, 8, 12));
    /// # Ok::<(), isoplanat_base::error::Error>(())
    /// ```
    ///
    /// # Shapes
    /// `[batch, channel, row, col]`, the channels of [`UnetConfig::inputs`] → `[batch, 3, row, col]`.
    pub fn forward(&self, input: ArrayView4<f32>) -> Result<Array4<f32>> {
        self.check(&input)?;
        let (network, way) = (self.learner.module().valid(), self.way);
        let device = self.learner.device().clone().inner();
        let run = |window: ArrayView4<f32>| array(network.forward(way, &self.config, tensor(&window, &device)));
        let (_, _, rows, columns) = input.dim();
        if rows * columns * self.config.base_width * self.config.planes_forward() <= TILE_ABOVE {
            return run(input);
        }
        let margin = self.config.receptive_radius_px().next_multiple_of(self.config.multiple());
        tiles::forward_tiled(input, TILE, margin, run)
    }

    /// [`Reconstructor::forward`] for any height and width: continued by reflection below and to the right to the next
    /// multiple, then cropped.
    pub fn forward_padded(&self, input: ArrayView4<f32>) -> Result<Array4<f32>> {
        let (_, _, rows, columns) = input.dim();
        let multiple = self.config.multiple();
        if rows.is_multiple_of(multiple) && columns.is_multiple_of(multiple) {
            return self.forward(input);
        }
        let padded = tiles::reflect_to_multiple(input, multiple);
        let output = self.forward(padded.view())?;
        Ok(output.slice(ndarray::s![.., .., ..rows, ..columns]).to_owned())
    }

    /// Loss, output and cotangents for one batch; with `update`, one Adam step of size `learning_rate` after it. With `weights` gradients and cotangents are
    /// those of a loss in which each picture of the batch counts so many times; the loss that is told is the plain one.
    ///
    /// # Shapes
    /// `input`: `[batch, channel, row, col]`, `target`: `[batch, 3, row, col]`, rows and columns multiples of [`UnetConfig::multiple`].
    pub fn step(
        &mut self,
        input: ArrayView4<f32>,
        target: ArrayView4<f32>,
        weights: Option<&[f32]>,
        learning_rate: f64,
        update: bool,
    ) -> Result<Step> {
        let Backward { loss, output, input_bar, gradient } = self.backward(&input, &target, weights, [true, update])?;
        let input_bar = input_bar.ok_or_else(|| Error::Internal("no gradient reached the network's input".into()))?;
        let mut target_bar = Array4::zeros(output.raw_dim());
        for (i, mut bar) in target_bar.outer_iter_mut().enumerate() {
            let scale = -weights.map_or(1.0, |w| w[i]) / output.len() as f32;
            let [output, target] = [output.view(), target].map(|all| all.slice_move(s![i, .., .., ..]));
            ndarray::Zip::from(&mut bar).and(&output).and(&target).for_each(|bar, &output, &target| {
                let difference = output - target;
                *bar = if difference == 0.0 { 0.0 } else { scale * difference.signum() };
            });
        }
        let (gradient_norm, updated) = match gradient {
            Some(gradient) => self.learner.update(loss.is_finite(), gradient, learning_rate),
            None => (0.0, false),
        };
        Ok(Step { loss, output, input_bar, target_bar, gradient_norm, updated })
    }

    /// One Adam step on the network alone: [`Reconstructor::step`] without the cotangents and their cost.
    pub fn step_network_only(
        &mut self,
        input: ArrayView4<f32>,
        target: ArrayView4<f32>,
        weights: Option<&[f32]>,
        learning_rate: f64,
    ) -> Result<NetworkStep> {
        let Backward { loss, output, gradient, .. } = self.backward(&input, &target, weights, [false, true])?;
        let (gradient_norm, updated) = match gradient {
            Some(gradient) => self.learner.update(loss.is_finite(), gradient, learning_rate),
            None => (0.0, false),
        };
        Ok(NetworkStep { loss, output, gradient_norm, updated })
    }

    /// Writes weights, optimiser and size to `path` (safetensors), whole or not at all. Refuses weights that are not finite.
    pub fn save(&self, path: &Path) -> Result<()> {
        self.save_with(path, &[], &BTreeMap::new())
    }

    /// [`Reconstructor::save`] with `facts` beside it.
    ///
    /// # Errors
    /// As [`Self::save`].
    pub fn save_with_facts(&self, path: &Path, facts: &BTreeMap<String, String>) -> Result<()> {
        self.save_with(path, &[], facts)
    }

    /// Reads what [`Self::save_with_facts`] wrote, for a device.
    ///
    /// # Errors
    /// As [`Self::load`] and [`Self::on`].
    pub fn load_with_facts(path: &Path, compute: Compute) -> Result<(Self, BTreeMap<String, String>)> {
        let file = Checkpoint::read(path)?;
        Ok((Self::from_checkpoint(&file, compute)?, file.facts().clone()))
    }

    /// [`Reconstructor::save`] with other learners and facts beside it.
    pub(super) fn save_with(&self, path: &Path, more: &[Section<'_>], facts: &BTreeMap<String, String>) -> Result<()> {
        let parameters = self.parameters();
        let adam = self.learner.adam();
        let mut sections = vec![Section { prefix: "", parameters: &parameters, steps: adam.steps, adam: Some(&adam) }];
        sections.extend(more.iter().map(|s| Section { ..*s }));
        checkpoint::save(path, &self.config, &sections, facts)
    }

    /// Reads what [`Reconstructor::save`] wrote; training goes on with the same bits. Of a training that averages its weights, the
    /// average.
    pub fn load(path: &Path) -> Result<Self> {
        Ok(Self::result_of(path)?.0)
    }

    /// [`Self::load`], and the facts beside it.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn result_of(path: &Path) -> Result<(Self, BTreeMap<String, String>)> {
        let file = Checkpoint::read(path)?;
        let mut network = Self::from_checkpoint(&file, Compute::Cpu)?;
        if file.has(average::PREFIX) {
            network.restart(file.weights(average::PREFIX, &network.parameters())?.0);
        }
        Ok((network, file.facts().clone()))
    }

    /// The facts of a checkpoint.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn facts_of(path: &Path) -> Result<BTreeMap<String, String>> {
        Ok(Checkpoint::read(path)?.facts().clone())
    }

    /// A network of the same kind in the same place with other weights in the order of [`Reconstructor::parameters`].
    ///
    /// # Panics
    /// Where there are not as many as the network has.
    pub(super) fn with_weights(&self, weights: Vec<f32>) -> Self {
        let device = self.learner.device().clone();
        let learner = Learner::new(Unet::new(&self.config, 0, &device), device, self.compute);
        let mut other = Self { config: self.config.clone(), learner, compute: self.compute, way: self.way };
        other.restart(weights);
        other
    }

    /// The same network with an optimiser that has not begun.
    #[must_use]
    pub fn again(&self) -> Self {
        self.with_weights(self.parameters().into_iter().flat_map(|p| p.values).collect())
    }

    /// The size of the network in a file.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn config_of(path: &Path) -> Result<UnetConfig> {
        Checkpoint::read(path)?.config()
    }

    /// The network of a checkpoint, on a device.
    pub(super) fn from_checkpoint(file: &Checkpoint, compute: Compute) -> Result<Self> {
        let mut fresh = Self::on(compute, file.config()?, 0)?;
        let (weights, adam) = file.learner("", &fresh.parameters())?;
        fresh.learner.restore(&weights, Some(adam));
        Ok(fresh)
    }

    /// Where it computes, with autodiff.
    pub(super) fn device(&self) -> &Device {
        self.learner.device()
    }

    /// The kind of device it computes on.
    pub fn compute(&self) -> Compute {
        self.compute
    }

    /// Which code runs its operations.
    pub(super) fn way(&self) -> Way {
        self.way
    }

    /// Has other code run its operations.
    pub(super) fn set_way(&mut self, way: Way) {
        self.way = way;
    }

    /// The gradient of every parameter in the order of [`Reconstructor::parameters`], taken out of `gradients`.
    pub(super) fn gradient(&self, gradients: &mut Gradients) -> Gradient {
        self.learner.gradient(gradients)
    }

    /// As [`Learner::after`].
    pub(super) fn after(&self, learning_rate: f64) -> Vec<Parameter> {
        self.learner.after(learning_rate)
    }

    /// The forward pass with a graph behind it.
    pub(super) fn forward_tracked(&self, input: Tensor<4>) -> Tensor<4> {
        self.learner.module().forward(self.way, &self.config, input)
    }

    /// A clipped Adam step with the weights' part of `gradients`; see [`Learner::update`].
    pub(super) fn learn(&mut self, sound: bool, gradients: &mut Gradients, learning_rate: f64) -> (f64, bool) {
        let gradient = self.learner.gradient(gradients);
        self.learner.update(sound, gradient, learning_rate)
    }

    /// Puts all weights in the order of [`Reconstructor::parameters`]; the optimiser starts anew.
    ///
    /// # Panics
    /// Where there are not as many as the network has.
    pub(super) fn restart(&mut self, weights: Vec<f32>) {
        self.learner.restore(&weights, None);
    }

    /// Refuses an input that does not fit the network, and a target of another shape.
    pub(super) fn check_pair(&self, input: &ArrayView4<f32>, target: &ArrayView4<f32>) -> Result<()> {
        self.check(input)?;
        let (batch, _, rows, columns) = input.dim();
        if (batch, 3, rows, columns) != target.dim() {
            return Err(Error::bad(
                "",
                "training target",
                format!("shape {:?}", target.dim()),
                format!("three channels of the input's shape, {:?}", input.dim()),
            ));
        }
        Ok(())
    }

    /// Forward and backward; the gradients asked for only, of the mean absolute difference with `weights` of the batch's pictures.
    fn backward(
        &self,
        input: &ArrayView4<f32>,
        target: &ArrayView4<f32>,
        weights: Option<&[f32]>,
        [with_input, with_parameters]: [bool; 2],
    ) -> Result<Backward> {
        self.check_pair(input, target)?;
        if let Some(w) = weights.filter(|w| w.len() != input.dim().0) {
            let allowed = format!("{}, one a picture", input.dim().0);
            return Err(Error::bad("", "weights of pictures", w.len().to_string(), allowed));
        }
        let input = tensor(input, self.learner.device());
        let input = if with_input { input.require_grad() } else { input };
        let frozen = (!with_parameters).then(|| self.learner.frozen());
        let network = frozen.as_ref().unwrap_or_else(|| self.learner.module());

        let output = network.forward(self.way, &self.config, input.clone());
        let difference = output.clone() - tensor(target, self.learner.device());
        let difference = match weights {
            Some(weights) => {
                let weights = ArrayView4::from_shape((weights.len(), 1, 1, 1), weights);
                difference.abs()
                    * tensor(&weights.map_err(|e| Error::Internal(format!("weights: {e}")))?, self.learner.device())
            }
            None => difference.abs(),
        };
        let mut gradients = difference.mean().backward();

        let output = array(output.inner())?;
        let sum: f64 = output.iter().zip(target.iter()).map(|(a, b)| f64::from((a - b).abs())).sum();
        let input_bar = if with_input { input.grad_remove(&mut gradients).map(array).transpose()? } else { None };
        let gradient = with_parameters.then(|| self.learner.gradient(&mut gradients));
        Ok(Backward { loss: (sum / output.len() as f64) as f32, output, input_bar, gradient })
    }

    fn check(&self, input: &ArrayView4<f32>) -> Result<()> {
        let (batch, channels, rows, columns) = input.dim();
        let (multiple, wanted) = (self.config.multiple(), self.config.inputs.channels());
        let fits = |n: usize| n > 0 && n.is_multiple_of(multiple);
        if batch == 0 || channels != wanted || !fits(rows) || !fits(columns) {
            return Err(Error::bad(
                "",
                "network input",
                format!("shape [{batch}, {channels}, {rows}, {columns}]"),
                format!("[batch, {wanted}, rows, columns], rows and columns multiples of {multiple}"),
            ));
        }
        Ok(())
    }
}

/// What one pass forward and back gives.
struct Backward {
    loss: f32,
    output: Array4<f32>,
    input_bar: Option<Array4<f32>>,
    /// By parameter, in the order of [`Reconstructor::parameters`].
    gradient: Option<Gradient>,
}

pub(super) fn tensor(view: &ArrayView4<f32>, device: &Device) -> Tensor<4> {
    let (batch, channels, rows, columns) = view.dim();
    let values = view.as_standard_layout().into_owned().into_raw_vec_and_offset().0;
    Tensor::from_data(TensorData::new(values, [batch, channels, rows, columns]), device)
}

pub(super) fn array(tensor: Tensor<4>) -> Result<Array4<f32>> {
    let shape = tensor.dims();
    let values =
        tensor.into_data().try_into_vec::<f32>().map_err(|e| Error::Internal(format!("tensor data: {e:?}")))?;
    Array4::from_shape_vec(shape, values).map_err(|e| Error::Internal(format!("tensor shape: {e}")))
}

#[cfg(test)]
mod tests {
    use super::super::kernels::Level;
    use super::*;
    use isoplanat_base::testing::assert_rel;
    use isoplanat_card::Blocks;

    fn small() -> UnetConfig {
        UnetConfig::bare(4, 3)
    }

    /// One of every kind of blocks.
    fn kinds() -> impl Iterator<Item = UnetConfig> {
        Blocks::ALL.into_iter().map(|blocks| UnetConfig { blocks, ..small() })
    }

    fn picture(shape: (usize, usize, usize, usize), seed: u64) -> Array4<f32> {
        let mut rng = fastrand::Rng::with_seed(seed);
        Array4::from_shape_simple_fn(shape, || rng.f32())
    }

    /// A target far off any output, mostly above it: the loss has no kink near it.
    fn far_target() -> Array4<f32> {
        picture((1, 3, 32, 24), 5).mapv(|v| if v > 0.2 { v + 50.0 } else { v - 50.0 })
    }

    /// A network whose last layer is not small, so that the gradient through the network counts, whose residuals count, and whose
    /// slopes lie around 1, so that the kinks of PReLU are too weak to spoil a difference quotient.
    fn awake(config: UnetConfig, seed: u64) -> Reconstructor {
        let mut model = Reconstructor::new(config, seed).expect("valid");
        let rng = &mut fastrand::Rng::with_seed(seed);
        for mut parameter in model.parameters() {
            if parameter.name == "output.weight" {
                parameter.values.iter_mut().for_each(|v| *v *= 15.0);
            } else if parameter.name.contains("slope") {
                parameter.values.iter_mut().for_each(|v| *v = 0.9 + 0.2 * rng.f32());
            } else if parameter.name.contains("scale") {
                parameter.values.iter_mut().for_each(|v| *v = 0.05 + 0.05 * rng.f32());
            }
            model.set_parameter(&parameter.name, &parameter.values).expect("same length");
        }
        model
    }

    #[test]
    fn training_starts_near_the_identity_and_is_deterministic() {
        for config in kinds() {
            let input = picture((2, 3, 16, 24), 1);
            let a = Reconstructor::new(config.clone(), 7).expect("valid").forward(input.view()).expect("fits");
            let b = Reconstructor::new(config.clone(), 7).expect("valid").forward(input.view()).expect("fits");
            assert_eq!(a, b);
            let difference = (&a - &input).iter().fold(0f32, |m, v| m.max(v.abs()));
            assert!(difference > 0.0 && difference < 0.05, "{config:?}: {difference}");
        }
    }

    #[test]
    fn names_are_stable() {
        let all = ["encoder.2", "up.1.weight [16, 8, 2, 2]", "output.bias [3]"];
        let paper =
            ["encoder.0.conv1.weight [4, 3, 3, 3]", "encoder.2.slope2 [16]", "decoder.0.conv1.weight [4, 8, 3, 3]"];
        let separable =
            ["encoder.0.depth1.weight [3, 1, 3, 3]", "decoder.0.point1.weight [4, 8, 1, 1]", "encoder.2.slope2 [16]"];
        let gated =
            ["encoder.0.enter.weight [4, 3, 1, 1]", "encoder.0.depth.weight [8, 1, 3, 3]", "decoder.1.scale2 [8]"];
        for (config, (own, a_block)) in kinds().zip([(paper, 6), (separable, 10), (gated, 14)]) {
            let model = Reconstructor::new(config, 1).expect("valid");
            let names: Vec<_> = model.parameters().into_iter().map(|p| format!("{} {:?}", p.name, p.shape)).collect();
            assert_eq!(names.len(), 5 * a_block + 2 * 2 + 2);
            for name in all.into_iter().chain(own) {
                assert!(names.iter().any(|n| n.starts_with(name)), "{name} not in {names:?}");
            }
        }
    }

    #[test]
    fn cotangents_match_central_differences() {
        kinds().for_each(cotangents_of);
    }

    fn cotangents_of(config: UnetConfig) {
        let mut model = awake(config, 3);
        let (input, target) = (picture((1, 3, 32, 24), 4), far_target());
        let step = model.step(input.view(), target.view(), None, 0.0, false).expect("fits");
        assert!(!step.updated);
        // Along a direction, summed in f64. PReLU and pooling have kinks, so the step is small.
        let direction = picture((1, 3, 32, 24), 6).mapv(|v| v - 0.5);
        let loss = |x: &Array4<f32>, y: &Array4<f32>| {
            let out = model.forward(x.view()).expect("fits");
            out.iter().zip(y).map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs()).sum::<f64>() / out.len() as f64
        };
        let h = 3e-4f32;
        let slope = |towards: bool| {
            let shift = |s: f32| direction.mapv(|d| s * h * d);
            if towards {
                (loss(&(&input + &shift(1.0)), &target) - loss(&(&input + &shift(-1.0)), &target)) / f64::from(2.0 * h)
            } else {
                (loss(&input, &(&target + &shift(1.0))) - loss(&input, &(&target + &shift(-1.0)))) / f64::from(2.0 * h)
            }
        };
        let dot = |bar: &Array4<f32>| bar.iter().zip(&direction).map(|(a, b)| f64::from(a * b)).sum::<f64>();
        assert_rel(dot(&step.input_bar), slope(true), 5e-3, 1e-3, "input");
        assert_rel(dot(&step.target_bar), slope(false), 5e-3, 1e-3, "target");
    }

    /// A batch in which pictures count 2 and 0.5 times: gradients and cotangents are the sums of those of the pictures alone.
    #[test]
    fn weighed_pictures_count_so_many_times() {
        let model = Reconstructor::new(UnetConfig::bare(4, 2), 3).expect("valid");
        let (input, target) = (picture((2, 3, 16, 12), 1), picture((2, 3, 16, 12), 2));
        let weights = [2.0f32, 0.5];
        let whole = model.backward(&input.view(), &target.view(), Some(&weights), [true; 2]).expect("fits");
        let gradient = whole.gradient.as_ref().expect("asked for").to_host().concat();
        let mut sum = vec![0.0f32; gradient.len()];
        for (i, weight) in weights.iter().enumerate() {
            let [x, t] = [&input, &target].map(|all| all.slice(s![i..=i, .., .., ..]));
            let one = model.backward(&x, &t, None, [true; 2]).expect("fits");
            let bar = one.input_bar.expect("asked for") * (0.5 * weight);
            let off = &bar - &whole.input_bar.as_ref().expect("asked for").slice(s![i..=i, .., .., ..]);
            assert!(off.iter().all(|v| v.abs() < 1e-7), "picture {i}");
            let parts = one.gradient.expect("asked for").to_host().concat();
            sum.iter_mut().zip(parts).for_each(|(s, g)| *s += 0.5 * weight * g);
        }
        let size = gradient.iter().fold(0f32, |m, v| m.max(v.abs()));
        assert!(sum.iter().zip(&gradient).all(|(a, b)| (a - b).abs() < 1e-5 * size));
        let plain = model.backward(&input.view(), &target.view(), None, [false, true]).expect("fits");
        assert_eq!(plain.loss, whole.loss, "the loss that is told is the plain one");
        let error = model.backward(&input.view(), &target.view(), Some(&[1.0]), [true; 2]).err().expect("too few");
        assert!(error.to_string().contains("one a picture"), "{error}");
    }

    #[test]
    fn weight_gradients_match_central_differences() {
        kinds().for_each(|config| weight_gradients_of(&config));
    }

    fn weight_gradients_of(config: &UnetConfig) {
        let model = awake(config.clone(), 3);
        let (input, target) = (picture((1, 3, 32, 24), 4), far_target());
        let gradient = model
            .backward(&input.view(), &target.view(), None, [false, true])
            .expect("fits")
            .gradient
            .expect("asked for")
            .to_host()
            .concat();
        let mut offset = 0;
        let rng = &mut fastrand::Rng::with_seed(8);
        for parameter in model.parameters() {
            let n = parameter.values.len();
            // Random lengths with the gradient's signs: the slope is large against what a kink of PReLU or pooling adds.
            let direction: Vec<f32> =
                gradient[offset..offset + n].iter().map(|g| g.signum() * (0.5 + rng.f32())).collect();
            let pulled: f64 = gradient[offset..offset + n].iter().zip(&direction).map(|(a, b)| f64::from(a * b)).sum();
            offset += n;
            let loss = |h: f32| {
                let mut moved = awake(config.clone(), 3);
                let values: Vec<f32> = parameter.values.iter().zip(&direction).map(|(v, d)| v + h * d).collect();
                moved.set_parameter(&parameter.name, &values).expect("same length");
                let out = moved.forward(input.view()).expect("fits");
                out.iter().zip(&target).map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs()).sum::<f64>()
                    / out.len() as f64
            };
            let h = 1e-3 / (n as f32).sqrt();
            let pushed = (loss(h) - loss(-h)) / f64::from(2.0 * h);
            assert_rel(pulled, pushed, 5e-3, 2e-3, &parameter.name);
        }
    }

    #[test]
    fn both_kinds_of_step_move_the_weights_alike_and_learn() {
        for config in kinds() {
            let (input, target) = (picture((1, 3, 16, 16), 4), picture((1, 3, 16, 16), 5).mapv(|v| 0.5 * v));
            let mut a = Reconstructor::new(config.clone(), 3).expect("valid");
            let mut b = Reconstructor::new(config.clone(), 3).expect("valid");
            let first = a.step(input.view(), target.view(), None, 3e-3, true).expect("fits");
            assert!(first.updated && first.gradient_norm > 0.0);
            b.step_network_only(input.view(), target.view(), None, 3e-3).expect("fits");
            assert_eq!(a.parameters(), b.parameters());
            for _ in 0..60 {
                b.step_network_only(input.view(), target.view(), None, 3e-3).expect("fits");
            }
            let last = b.step_network_only(input.view(), target.view(), None, 3e-3).expect("fits");
            eprintln!("{:?}: {} {}", config.blocks, first.loss, last.loss);
            assert!(last.loss < 0.8 * first.loss, "{:?}: {} {}", config.blocks, first.loss, last.loss);
        }
    }

    #[test]
    fn a_step_with_nan_is_skipped_and_said() {
        let mut model = Reconstructor::new(small(), 3).expect("valid");
        let before = model.parameters();
        let (mut input, target) = (picture((1, 3, 8, 8), 4), picture((1, 3, 8, 8), 5));
        input[[0, 1, 2, 3]] = f32::NAN;
        let step = model.step(input.view(), target.view(), None, 1e-3, true).expect("fits");
        assert!(!step.updated);
        assert_eq!((model.parameters(), model.steps()), (before, 0));
    }

    #[test]
    fn shapes_that_do_not_fit_are_refused() {
        let mut model = Reconstructor::new(small(), 3).expect("valid");
        for shape in [(1, 3, 10, 8), (1, 4, 8, 8), (0, 3, 8, 8), (1, 3, 0, 8)] {
            assert!(model.forward(picture(shape, 1).view()).is_err(), "{shape:?}");
        }
        let (a, b) = (picture((1, 3, 8, 8), 1), picture((1, 3, 8, 12), 1));
        assert!(model.step(a.view(), b.view(), None, 1e-3, true).is_err());
    }

    #[test]
    fn nothing_beyond_the_receptive_radius_counts() {
        for config in kinds() {
            let model = awake(config.clone(), 11);
            let input = picture((1, 3, 80, 80), 2);
            let before = model.forward(input.view()).expect("fits");
            assert_eq!(before, model.forward(input.view()).expect("fits"), "repeatable");
            let mut farthest = 0;
            for (row, col) in [(40, 40), (37, 42), (39, 35), (38, 38), (41, 41)] {
                let mut moved = input.clone();
                moved.slice_mut(ndarray::s![.., .., row, col]).mapv_inplace(|v| v + 10.0);
                let after = model.forward(moved.view()).expect("fits");
                let changed = after.indexed_iter().filter(|((_, k, r, c), v)| **v != before[[0, *k, *r, *c]]);
                let distance = |r: usize, c: usize| r.abs_diff(row).max(c.abs_diff(col));
                farthest = changed.map(|((_, _, r, c), _)| distance(r, c)).max().unwrap_or(0).max(farthest);
            }
            assert_eq!(farthest, config.receptive_radius_px(), "{config:?}");
        }
    }

    #[test]
    fn padding_and_tiles_agree_with_the_whole() {
        for config in kinds() {
            let model = awake(config.clone(), 11);
            let input = picture((1, 3, 84, 92), 2);
            let whole = model.forward(input.view()).expect("fits");
            let margin = config.receptive_radius_px().next_multiple_of(4);
            let (network, way) = (model.learner.module().valid(), model.way);
            let device = model.learner.device().clone().inner();
            let run = |w: ArrayView4<f32>| array(network.forward(way, &config, tensor(&w, &device)));
            let tiled = tiles::forward_tiled(input.view(), 32, margin, run).expect("fits");
            let largest = whole.iter().fold(1f32, |m, v| m.max(v.abs()));
            let difference = (&tiled - &whole).iter().fold(0f32, |m, v| m.max(v.abs()));
            assert!(difference < 1e-5 * largest, "{config:?}: {difference} of {largest}");
            let cropped = input.slice(ndarray::s![.., .., ..83, ..90]);
            assert_eq!(model.forward_padded(cropped).expect("any size").dim(), (1, 3, 83, 90));
        }
    }

    #[test]
    fn every_level_gives_the_same_step() {
        let levels = match Level::detect() {
            Level::Avx512 => vec![Level::Avx512, Level::Avx2],
            Level::Avx2 => vec![Level::Avx2],
            Level::Plain => vec![],
        };
        let sizes = [
            (4, 3, (1, 3, 32, 24)),
            (5, 3, (2, 3, 12, 20)),
            (16, 3, (1, 3, 16, 16)),
            (8, 3, (1, 3, 72, 100)),
            (4, 7, (2, 3, 64, 128)),
        ];
        for (blocks, (base_width, scales, shape)) in Blocks::ALL.into_iter().flat_map(|b| sizes.map(|s| (b, s))) {
            let (input, target) = (picture(shape, 4), picture(shape, 5));
            let mut model = awake(UnetConfig { blocks, ..UnetConfig::bare(base_width, scales) }, 3);
            model.way = Way::Burn;
            let expected = model.backward(&input.view(), &target.view(), None, [true; 2]).expect("fits");
            let close = |a: &[f32], b: &[f32], what: &str| {
                let scale = b.iter().fold(0f32, |m, v| m.max(v.abs()));
                let worst = a.iter().zip(b).fold(0f32, |m, (a, b)| m.max((a - b).abs()));
                assert!(worst <= 1e-5 * scale, "{blocks:?} {what} {base_width} {shape:?}: {worst} of {scale}");
            };
            for &level in &levels {
                model.way = level.into();
                let found = model.backward(&input.view(), &target.view(), None, [true; 2]).expect("fits");
                close(
                    found.output.as_slice().expect("contiguous"),
                    expected.output.as_slice().expect("contiguous"),
                    "output",
                );
                let bars = [&found, &expected]
                    .map(|b| b.input_bar.as_ref().expect("asked for").as_slice().expect("contiguous"));
                close(bars[0], bars[1], "input");
                let weights = [&found, &expected].map(|b| b.gradient.as_ref().expect("asked for").to_host().concat());
                close(&weights[0], &weights[1], "weights");
            }
        }
    }

    #[test]
    #[ignore = "a measurement, not a check: seconds per training step"]
    fn time_of_a_step() {
        for base_width in [16, 32] {
            let mut model = Reconstructor::new(UnetConfig::bare(base_width, 3), 1).expect("valid");
            let (input, target) = (picture((1, 3, 256, 256), 1), picture((1, 3, 256, 256), 2));
            let mut time = |name: &str, run: &mut dyn FnMut(&mut Reconstructor)| {
                let mut seconds: Vec<f64> = (0..12)
                    .map(|_| {
                        let start = std::time::Instant::now();
                        run(&mut model);
                        start.elapsed().as_secs_f64()
                    })
                    .collect();
                seconds.sort_by(f64::total_cmp);
                eprintln!("{base_width} {name}: median {:.4} s, least {:.4} s", seconds[6], seconds[0]);
            };
            time("forward", &mut |m| drop(m.forward(input.view()).expect("fits")));
            time("network step", &mut |m| {
                drop(m.step_network_only(input.view(), target.view(), None, 1e-4).expect("fits"))
            });
            time("joint step", &mut |m| drop(m.step(input.view(), target.view(), None, 1e-4, true).expect("fits")));
        }
    }
}
