//! The network's operations: 3×3 convolution, 2×2 max-pooling, 2×2 transposed convolution.
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
pub(super) fn convolve(
    level: Level,
    inputs: &[&Features],
    weight: Tensor<4>,
    bias: Tensor<1>,
) -> Tensor<4> {
    let dispatch = |t: &Tensor<4>| t.clone().into_dispatch();
    if level != Level::Plain {
        let (w, b) = (weight.clone().into_dispatch(), bias.clone().into_dispatch());
        match inputs {
            [Features { values, slope: None }] => {
                return Tensor::from_dispatch(Dispatch::convolve_plain(
                    dispatch(values),
                    w,
                    b,
                    level,
                ));
            }
            [Features { values, slope: Some(slope) }] => {
                let slope = slope.clone().into_dispatch();
                return Tensor::from_dispatch(Dispatch::convolve_activated(
                    dispatch(values),
                    slope,
                    w,
                    b,
                    level,
                ));
            }
            [Features { values, slope: Some(slope) }, Features { values: plain, slope: None }] => {
                let (x, slope, plain) =
                    (dispatch(values), slope.clone().into_dispatch(), dispatch(plain));
                return Tensor::from_dispatch(Dispatch::convolve_joined(
                    x, slope, plain, w, b, level,
                ));
            }
            _ => {}
        }
    }
    let parts: Vec<_> = inputs.iter().map(|input| input.activated()).collect();
    let joined = if let [one] = parts.as_slice() { one.clone() } else { Tensor::cat(parts, 1) };
    conv2d(joined, weight, Some(bias), ConvOptions::new([1, 1], [1, 1], [1, 1], 1))
}

/// Largest of each 2×2 block.
pub(super) fn pool(level: Level, input: &Features) -> Tensor<4> {
    if let (true, Some(slope)) = (level != Level::Plain, &input.slope) {
        let (x, slope) = (input.values.clone().into_dispatch(), slope.clone().into_dispatch());
        return Tensor::from_dispatch(Dispatch::pool_activated(x, slope, level));
    }
    max_pool2d(input.activated(), MaxPoolOptions::new([2, 2]))
}

/// Transposed 2×2 convolution with stride 2: doubles height and width.
///
/// # Shapes
/// `weight`: `[in, out, 2, 2]`, `bias`: `[out]`.
pub(super) fn unpool(
    level: Level,
    input: &Features,
    weight: Tensor<4>,
    bias: Tensor<1>,
) -> Tensor<4> {
    if let (true, Some(slope)) = (level != Level::Plain, &input.slope) {
        let (x, slope) = (input.values.clone().into_dispatch(), slope.clone().into_dispatch());
        let (weight, bias) = (weight.into_dispatch(), bias.into_dispatch());
        return Tensor::from_dispatch(Dispatch::unpool_activated(x, slope, weight, bias, level));
    }
    let options = ConvTransposeOptions::new([2, 2], [0, 0], [0, 0], [1, 1], 1);
    conv_transpose2d(input.activated(), weight, Some(bias), options)
}
