//! The networks' operations: 3×3 and 1×1 convolution, depthwise 3×3 convolution, gate, 2×2 max-pooling, 2×2 transposed
//! convolution; convolutions of other sizes for discriminators.
//!
//! Activations are stored *before* their PReLU, together with its slopes ([`Features`]), and every operation applies the
//! PReLU to what it reads: the activated picture is never written. Convolution takes a list of inputs in place
//! of their concatenation.
//!
//! [`Way`] says by which code: on Flex with AVX2 or AVX-512 the crate's own kernels (`extension`), elsewhere burn's operations, whole or
//! in blocks ([`in_blocks`]).

use burn::backend::Dispatch;
use burn::tensor::Tensor;

use super::extension::FastOps;
use super::in_blocks::in_blocks;
use super::kernels::Level;
use super::kernels::columns::Taps;
use burn::tensor::activation::prelu;
use burn::tensor::module::{conv_transpose2d, conv2d, max_pool2d};
use burn::tensor::ops::{ConvOptions, ConvTransposeOptions, MaxPoolOptions};

/// Which code runs the operations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    /// The crate's kernels, on the CPU.
    Kernels(Level),
    /// burn's operations.
    Burn,
    /// burn's operations, convolutions block by block.
    Blocks,
    /// As [`Way::Burn`], or with `blocks` as [`Way::Blocks`], but gradients of weights are wrong on planes of more than so many pixels.
    #[cfg(test)]
    Faulty { blocks: bool, right_to: usize },
}

impl From<Level> for Way {
    fn from(level: Level) -> Self {
        if level == Level::Plain { Self::Burn } else { Self::Kernels(level) }
    }
}

impl Way {
    /// The same with convolutions in blocks, where burn runs them.
    pub(super) fn blockwise(self) -> Self {
        match self {
            Self::Kernels(_) => self,
            Self::Burn | Self::Blocks => Self::Blocks,
            #[cfg(test)]
            Self::Faulty { right_to, .. } => Self::Faulty { blocks: true, right_to },
        }
    }

    fn in_blocks(self) -> bool {
        match self {
            Self::Kernels(_) | Self::Burn => false,
            Self::Blocks => true,
            #[cfg(test)]
            Self::Faulty { blocks, .. } => blocks,
        }
    }

    /// burn's convolution of `x`, whose sides are multiples of the stride.
    fn convolve_by_burn(self, x: Tensor<4>, weight: Tensor<4>, bias: Tensor<1>, plan: Plan) -> Tensor<4> {
        let Plan { stride, padding, groups } = plan;
        let run = |x: Tensor<4>, padding: usize| {
            #[cfg(test)]
            let weight = self.faulty(&x, &weight);
            let options = ConvOptions::new([stride; 2], [padding; 2], [1, 1], groups);
            conv2d(x, weight.clone(), Some(bias.clone()), options)
        };
        // What a block answers for is its own size over the stride: kernels of one and three with stride 1, of four with 2.
        let [_, _, side, _] = weight.dims();
        if self.in_blocks() && side == stride + 2 * padding {
            return in_blocks(x, padding, |x| run(x, 0));
        }
        run(x, padding)
    }

    /// The weight, less of which has a gradient than should.
    #[cfg(test)]
    fn faulty(self, x: &Tensor<4>, weight: &Tensor<4>) -> Tensor<4> {
        let [batch, _, rows, columns] = x.dims();
        match self {
            Self::Faulty { right_to, .. } if batch * rows * columns > right_to => {
                weight.clone() * 0.25 + weight.clone().detach() * 0.75
            }
            _ => weight.clone(),
        }
    }
}

/// How burn convolves.
#[derive(Clone, Copy)]
struct Plan {
    stride: usize,
    /// Zeros around.
    padding: usize,
    /// Parts of the channels that do not see each other.
    groups: usize,
}

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
pub(super) fn convolve(way: impl Into<Way>, inputs: &[&Features], weight: Tensor<4>, bias: Tensor<1>) -> Tensor<4> {
    let way = way.into();
    let dispatch = |t: &Tensor<4>| t.clone().into_dispatch();
    if let Way::Kernels(level) = way {
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
    way.convolve_by_burn(joined, weight, bias, Plan { stride: 1, padding, groups: 1 })
}

/// Depthwise 3×3 convolution with zero padding of one pixel: every channel has taps of its own.
///
/// # Shapes
/// `weight`: `[channels, 1, 3, 3]`, `bias`: `[channels]`.
pub(super) fn depthwise(way: Way, input: &Features, weight: Tensor<4>, bias: Tensor<1>) -> Tensor<4> {
    if let Way::Kernels(level) = way {
        let (x, slope) = (input.values.clone().into_dispatch(), input.slope().into_dispatch());
        let (weight, bias) = (weight.into_dispatch(), bias.into_dispatch());
        return Tensor::from_dispatch(Dispatch::depthwise_activated(x, slope, weight, bias, level));
    }
    let groups = weight.dims()[0];
    way.convolve_by_burn(input.activated(), weight, bias, Plan { stride: 1, padding: 1, groups })
}

/// The product of the first and the second half of the channels.
pub(super) fn gate(way: Way, input: Tensor<4>) -> Tensor<4> {
    if let Way::Kernels(level) = way {
        return Tensor::from_dispatch(Dispatch::gate_plain(input.into_dispatch(), level));
    }
    let half = input.dims()[1] / 2;
    input.clone().narrow(1, 0, half) * input.narrow(1, half, half)
}

/// Convolution of any size with `padding` zeros around.
///
/// # Shapes
/// `x`: `[batch, in, row, col]`, sides that are multiples of `stride`; `weight`: `[out, in, side, side]`, `bias`: `[out]`.
pub(super) fn convolve_any(
    way: Way,
    x: Tensor<4>,
    weight: Tensor<4>,
    bias: Tensor<1>,
    stride: usize,
    padding: usize,
) -> Tensor<4> {
    if let Way::Kernels(level) = way {
        let taps = Taps { side: weight.dims()[2], stride, padding };
        let [x, weight] = [x, weight].map(Tensor::into_dispatch);
        return Tensor::from_dispatch(Dispatch::convolve_columns(x, weight, bias.into_dispatch(), (level, taps)));
    }
    way.convolve_by_burn(x, weight, bias, Plan { stride, padding, groups: 1 })
}

/// Largest of each 2×2 block.
pub(super) fn pool(way: impl Into<Way>, input: &Features) -> Tensor<4> {
    if let Way::Kernels(level) = way.into() {
        let (x, slope) = (input.values.clone().into_dispatch(), input.slope().into_dispatch());
        return Tensor::from_dispatch(Dispatch::pool_activated(x, slope, level));
    }
    max_pool2d(input.activated(), MaxPoolOptions::new([2, 2]))
}

/// Transposed 2×2 convolution with stride 2: doubles height and width.
///
/// # Shapes
/// `weight`: `[in, out, 2, 2]`, `bias`: `[out]`.
pub(super) fn unpool(way: impl Into<Way>, input: &Features, weight: Tensor<4>, bias: Tensor<1>) -> Tensor<4> {
    let way = way.into();
    if let Way::Kernels(level) = way {
        let (x, slope) = (input.values.clone().into_dispatch(), input.slope().into_dispatch());
        let (weight, bias) = (weight.into_dispatch(), bias.into_dispatch());
        return Tensor::from_dispatch(Dispatch::unpool_activated(x, slope, weight, bias, level));
    }
    let options = ConvTransposeOptions::new([2, 2], [0, 0], [0, 0], [1, 1], 1);
    let run = |x: Tensor<4>| conv_transpose2d(x, weight.clone(), Some(bias.clone()), options.clone());
    if way.in_blocks() { in_blocks(input.activated(), 0, run) } else { run(input.activated()) }
}
