//! The network's operations: 3×3 convolution, 2×2 max-pooling, 2×2 transposed convolution.
//!
//! Activations are stored *before* their PReLU, together with its slopes ([`Features`]), and every operation applies the
//! PReLU to what it reads: the activated picture is never written. Convolution takes a list of inputs in place
//! of their concatenation.

use burn::tensor::Tensor;
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

    fn activated(&self) -> Tensor<4> {
        match &self.slope {
            Some(slope) => prelu(self.values.clone(), slope.clone()),
            None => self.values.clone(),
        }
    }
}

/// 3×3 convolution with zero padding of one pixel over the channels of all `inputs` in turn.
///
/// # Shapes
/// `weight`: `[out, in, 3, 3]`, `bias`: `[out]`.
pub(super) fn convolve(inputs: &[&Features], weight: Tensor<4>, bias: Tensor<1>) -> Tensor<4> {
    let parts: Vec<_> = inputs.iter().map(|input| input.activated()).collect();
    let joined = if let [one] = parts.as_slice() { one.clone() } else { Tensor::cat(parts, 1) };
    conv2d(joined, weight, Some(bias), ConvOptions::new([1, 1], [1, 1], [1, 1], 1))
}

/// Largest of each 2×2 block.
pub(super) fn pool(input: &Features) -> Tensor<4> {
    max_pool2d(input.activated(), MaxPoolOptions::new([2, 2]))
}

/// Transposed 2×2 convolution with stride 2: doubles height and width.
///
/// # Shapes
/// `weight`: `[in, out, 2, 2]`, `bias`: `[out]`.
pub(super) fn unpool(input: &Features, weight: Tensor<4>, bias: Tensor<1>) -> Tensor<4> {
    let options = ConvTransposeOptions::new([2, 2], [0, 0], [0, 0], [1, 1], 1);
    conv_transpose2d(input.activated(), weight, Some(bias), options)
}
