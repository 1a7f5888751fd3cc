//! sRGB's transfer function on tensors: losses and discriminators see pictures as people do.

use burn::tensor::Tensor;

/// Where sRGB's linear toe ends.
const TOE: f32 = 0.003_130_8;

/// Linear light → sRGB-encoded values (IEC 61966-2-1), continued beyond both ends so that the derivative nowhere is zero
/// or infinite: the toe's line below 0, the power above 1.
pub(super) fn encode(linear: Tensor<4>) -> Tensor<4> {
    let dark = linear.clone().lower_equal_elem(TOE);
    let bright = linear.clone().clamp_min(TOE).powf_scalar(1.0 / 2.4) * 1.055 - 0.055;
    bright.mask_where(dark, linear * 12.92)
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;
    use isoplanat_imaging::develop::color::srgb_from_linear;

    #[test]
    fn it_is_srgb_and_its_derivative_is_finite_everywhere() {
        let values: Vec<f32> = (0..=64).map(|i| (i as f32 - 8.0) / 40.0).chain([0.0, 1e-6, 0.003]).collect();
        let device = Device::flex().autodiff();
        let x = Tensor::<1>::from_floats(values.as_slice(), &device).reshape([1, 1, 1, values.len()]).require_grad();
        let y = encode(x.clone());
        let slopes = x.grad(&y.clone().sum().backward()).expect("tracked");
        let y = y.into_data().try_into_vec::<f32>().expect("f32");
        let slopes = slopes.into_data().try_into_vec::<f32>().expect("f32");
        for ((v, y), slope) in values.iter().zip(y).zip(slopes) {
            let at = |v: f64| if v < 0.0 { 12.92 * v } else { srgb_from_linear(v) };
            let v = f64::from(*v);
            assert!((f64::from(y) - at(v)).abs() < 2e-6, "{v} {y}");
            let numeric = (at(v + 1e-7) - at(v - 1e-7)) / 2e-7;
            assert!((f64::from(slope) - numeric).abs() < 1e-2 * numeric, "{v} {slope} {numeric}");
        }
    }
}
