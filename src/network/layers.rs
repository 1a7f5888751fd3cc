//! The network's operations: 3×3 and 1×1 convolution, depthwise 3×3 convolution, gate, 2×2 max-pooling, 2×2 transposed
//! convolution.
//!
//! Activations are stored *before* their PReLU, together with its slopes ([`Features`]), and every operation applies the
//! PReLU to what it reads: the activated picture is never written. Convolution takes a list of inputs in place
//! of their concatenation.
//!
//! On Flex with AVX2 or AVX-512 they run as the crate's own kernels (`extension`), elsewhere as burn's operations.

use burn::backend::Dispatch;
use burn::tensor::Tensor;

use super::extension::FastOps;
use super::kernels::Level;
use burn::tensor::activation::prelu;
use burn::tensor::module::{conv_transpose2d, conv2d, max_pool2d};
use burn::tensor::ops::{ConvOptions, ConvTransposeOptions, MaxPoolOptions};

/// A picture of features, `[batch, channel, row, col]`, whose PReLU is still to be applied.
#[derive(Clone, Debug)]
pub(super) struct Features {
    /// Values before the activation.
    pub(super) values: Tensor<4>,
    /// One slope a channel; `None` where there is no activation.
    pub(super) slope: Option<Tensor<1>>,
}

impl Features {
    /// Features without an activation.
    pub(super) fn plain(values: Tensor<4>) -> Self {
        Self { values, slope: None }
    }

    /// The slopes; ones, which change nothing, where there is no activation.
    fn slope(&self) -> Tensor<1> {
        let ones = || Tensor::ones([self.values.dims()[1]], &self.values.device());
        self.slope.clone().unwrap_or_else(ones)
    }

    fn activated(&self) -> Tensor<4> {
        match &self.slope {
            Some(slope) => prelu(self.values.clone(), slope.clone()),
            None => self.values.clone(),
        }
    }
}

/// 3×3 convolution with zero padding of one pixel, or 1×1 convolution, over the channels of all `inputs` in turn.
///
/// # Shapes
/// `weight`: `[out, in, 3, 3]` or `[out, in, 1, 1]`, `bias`: `[out]`.
pub(super) fn convolve(level: Level, inputs: &[&Features], weight: Tensor<4>, bias: Tensor<1>) -> Tensor<4> {
    let dispatch = |t: &Tensor<4>| t.clone().into_dispatch();
    if level != Level::Plain {
        let (w, b) = (weight.clone().into_dispatch(), bias.clone().into_dispatch());
        match inputs {
            [Features { values, slope: None }] => {
                return Tensor::from_dispatch(Dispatch::convolve_plain(dispatch(values), w, b, level));
            }
            [Features { values, slope: Some(slope) }] => {
                let slope = slope.clone().into_dispatch();
                return Tensor::from_dispatch(Dispatch::convolve_activated(dispatch(values), slope, w, b, level));
            }
            [first, Features { values: plain, slope: None }] => {
                let (x, slope, plain) = (dispatch(&first.values), first.slope().into_dispatch(), dispatch(plain));
                return Tensor::from_dispatch(Dispatch::convolve_joined(x, slope, plain, w, b, level));
            }
            _ => {}
        }
    }
    let parts: Vec<_> = inputs.iter().map(|input| input.activated()).collect();
    let joined = if let [one] = parts.as_slice() { one.clone() } else { Tensor::cat(parts, 1) };
    let padding = weight.dims()[2] / 2;
    conv2d(joined, weight, Some(bias), ConvOptions::new([1, 1], [padding; 2], [1, 1], 1))
}

/// Depthwise 3×3 convolution with zero padding of one pixel: every channel has taps of its own.
///
/// # Shapes
/// `weight`: `[channels, 1, 3, 3]`, `bias`: `[channels]`.
pub(super) fn depthwise(level: Level, input: &Features, weight: Tensor<4>, bias: Tensor<1>) -> Tensor<4> {
    if level != Level::Plain {
        let (x, slope) = (input.values.clone().into_dispatch(), input.slope().into_dispatch());
        let (weight, bias) = (weight.into_dispatch(), bias.into_dispatch());
        return Tensor::from_dispatch(Dispatch::depthwise_activated(x, slope, weight, bias, level));
    }
    let channels = weight.dims()[0];
    conv2d(input.activated(), weight, Some(bias), ConvOptions::new([1, 1], [1, 1], [1, 1], channels))
}

/// The product of the first and the second half of the channels.
pub(super) fn gate(level: Level, input: Tensor<4>) -> Tensor<4> {
    if level != Level::Plain {
        return Tensor::from_dispatch(Dispatch::gate_plain(input.into_dispatch(), level));
    }
    let half = input.dims()[1] / 2;
    input.clone().narrow(1, 0, half) * input.narrow(1, half, half)
}

/// Largest of each 2×2 block.
pub(super) fn pool(level: Level, input: &Features) -> Tensor<4> {
    if level != Level::Plain {
        let (x, slope) = (input.values.clone().into_dispatch(), input.slope().into_dispatch());
        return Tensor::from_dispatch(Dispatch::pool_activated(x, slope, level));
    }
    max_pool2d(input.activated(), MaxPoolOptions::new([2, 2]))
}

/// Transposed 2×2 convolution with stride 2: doubles height and width.
///
/// # Shapes
/// `weight`: `[in, out, 2, 2]`, `bias`: `[out]`.
pub(super) fn unpool(level: Level, input: &Features, weight: Tensor<4>, bias: Tensor<1>) -> Tensor<4> {
    if level != Level::Plain {
        let (x, slope) = (input.values.clone().into_dispatch(), input.slope().into_dispatch());
        let (weight, bias) = (weight.into_dispatch(), bias.into_dispatch());
        return Tensor::from_dispatch(Dispatch::unpool_activated(x, slope, weight, bias, level));
    }
    let options = ConvTransposeOptions::new([2, 2], [0, 0], [0, 0], [1, 1], 1);
    conv_transpose2d(input.activated(), weight, Some(bias), options)
}
