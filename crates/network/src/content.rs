//! Content losses: how far the reconstruction is from the truth, both sRGB-encoded.
//!
//! Eq. 12: `0.5 · mean (φ(x) − φ(y))² + 0.006 · mean |x − y|`, φ VGG-19's features. Without weights for VGG-19:
//! `0.84 · (1 − MS-SSIM) + 0.16 · mean |x − y|` (H. Zhao, O. Gallo, I. Frosio, J. Kautz, "Loss functions for image
//! restoration with neural networks", IEEE Trans. Comput. Imaging 3(1), 2017). Or the mean absolute difference alone.

use burn::tensor::{Tensor, TensorData};
use ndarray::{Array3, Array4, Axis};

use super::perceptual::Vgg;
use super::reconstructor::array;
use crate::ms_ssim::ms_ssim_and_gradient;
use isoplanat_base::error::Result;

/// Weights of eq. 12.
const FEATURES: f64 = 0.5;
const L1_BESIDE_FEATURES: f64 = 0.006;

/// Weights of Zhao et al.
const STRUCTURE: f64 = 0.84;
const L1_BESIDE_STRUCTURE: f64 = 0.16;

/// A content loss.
#[derive(Debug)]
pub(super) enum Content {
    /// Mean absolute difference.
    L1,
    /// Mean absolute difference and multi-scale SSIM.
    Structure,
    /// Features and mean absolute difference.
    Features(Box<Vgg>),
}

/// A content loss to be minimised, and its parts as numbers.
pub(super) struct ContentLoss {
    /// Its gradient is that of the loss; its value is not (the structure's part enters by its gradient).
    pub(super) surrogate: Tensor<1>,
    /// The loss.
    pub(super) value: f64,
    /// Mean absolute difference of the encoded pictures.
    pub(super) l1: f64,
}

impl Content {
    /// What it is, for people.
    pub(super) fn describe(&self) -> String {
        match self {
            Self::L1 => "mean absolute difference (sRGB-encoded)".into(),
            Self::Structure => "0.84 (1 - MS-SSIM) + 0.16 L1 (sRGB-encoded): no VGG-19 weights were given".into(),
            Self::Features(vgg) => format!("0.5 VGG-19 {} + 0.006 L1 (sRGB-encoded)", vgg.deepest()),
        }
    }

    /// The loss of `made` against `truth`, both encoded.
    ///
    /// # Shapes
    /// `[batch, 3, row, col]`, equal.
    pub(super) fn loss(&self, made: &Tensor<4>, truth: &Tensor<4>) -> Result<ContentLoss> {
        let l1 = (made.clone() - truth.clone()).abs().mean();
        let number = |t: &Tensor<1>| t.clone().into_data().try_into_vec::<f32>().map_or(f64::NAN, |v| f64::from(v[0]));
        let l1_value = number(&l1);
        Ok(match self {
            Self::L1 => ContentLoss { surrogate: l1, value: l1_value, l1: l1_value },
            Self::Structure => {
                let (structure, gradient) = structure(&array(made.clone().inner())?, &array(truth.clone().inner())?)?;
                let shape = made.dims();
                let values = gradient.into_raw_vec_and_offset().0;
                let gradient = Tensor::<4>::from_data(TensorData::new(values, shape), &made.device());
                ContentLoss {
                    surrogate: l1 * L1_BESIDE_STRUCTURE - (made.clone() * gradient).sum() * STRUCTURE,
                    value: L1_BESIDE_STRUCTURE * l1_value + STRUCTURE * (1.0 - structure),
                    l1: l1_value,
                }
            }
            Self::Features(vgg) => {
                let difference = vgg.forward(made.clone()) - vgg.forward(truth.clone());
                let loss = difference.square().mean() * FEATURES + l1 * L1_BESIDE_FEATURES;
                ContentLoss { value: number(&loss), surrogate: loss, l1: l1_value }
            }
        })
    }
}

/// Mean MS-SSIM over a batch and its gradient in `a`.
fn structure(a: &Array4<f32>, b: &Array4<f32>) -> Result<(f64, Array4<f32>)> {
    let batch = a.dim().0;
    let (mut sum, mut gradient) = (0.0, Array4::zeros(a.dim()));
    for (i, mut to) in gradient.axis_iter_mut(Axis(0)).enumerate() {
        let wide = |x: &Array4<f32>| -> Array3<f64> { x.index_axis(Axis(0), i).mapv(f64::from) };
        let (value, slope) = ms_ssim_and_gradient(wide(a).view(), wide(b).view())?;
        sum += value;
        to.assign(&slope.mapv(|v| (v / batch as f64) as f32));
    }
    Ok((sum / batch as f64, gradient))
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::super::kernels::Level;
    use super::*;
    use isoplanat_base::testing::{assert_rel, shared};

    fn contents() -> Vec<Content> {
        let mut all = vec![Content::L1, Content::Structure];
        if let Some(path) = shared("data/vgg19/vgg19_normalised_to_relu3_1.safetensors") {
            let device = Device::flex().autodiff();
            all.push(Content::Features(Box::new(Vgg::load(&path, Level::detect(), &device).expect("loads"))));
        }
        all
    }

    #[test]
    fn values_and_gradients_agree_along_a_line() {
        let device = Device::flex().autodiff();
        let rng = &mut fastrand::Rng::with_seed(8);
        let shape = [2, 3, 24, 32];
        let mut smooth = |phase: f32| -> Vec<f32> {
            let n: usize = shape.iter().product();
            (0..n).map(|i| 0.5 + 0.3 * ((i % 32) as f32 * 0.4 + phase).sin() + 0.05 * rng.f32()).collect()
        };
        let (truth, made, noise) = (smooth(0.0), smooth(0.7), smooth(2.0));
        let tensor = |v: &[f32]| Tensor::<4>::from_data(TensorData::new(v.to_vec(), shape), &device);
        for content in contents() {
            let x = tensor(&made).require_grad();
            let loss = content.loss(&x, &tensor(&truth)).expect("a loss");
            let bar = x.grad(&loss.surrogate.backward()).expect("tracked");
            let bar = bar.into_data().try_into_vec::<f32>().expect("f32");
            // Along the gradient's signs, so that kinks and rounding count little.
            let step: Vec<f32> = bar.iter().zip(&noise).map(|(b, d)| b.signum() * (0.5 + d)).collect();
            let pulled: f64 = bar.iter().zip(&step).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
            let at = |h: f32| {
                let moved: Vec<f32> = made.iter().zip(&step).map(|(m, d)| m + h * d).collect();
                content.loss(&tensor(&moved), &tensor(&truth)).expect("a loss").value
            };
            let h = 1e-4;
            let what = content.describe();
            assert_rel(pulled, (at(h) - at(-h)) / f64::from(2.0 * h), 1e-2, 1e-3, &what);
            let none = content.loss(&tensor(&truth), &tensor(&truth)).expect("a loss");
            assert!(none.value.abs() < 1e-6 && none.l1 == 0.0, "{what}: {}", none.value);
        }
    }
}
