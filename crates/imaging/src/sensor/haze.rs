//! Veiling glare: a share of the light that lens and barrel scatter over the whole picture.
//!
//! The paper's prototypes showed haze that its simulation lacked (§5). A moulded lens scatters a few per cent of the light
//! at large angles (ISO 9358 calls the share the veiling glare index); over a patch it is a constant: `y = (1 − h) x + h m`
//! with `m` the scene's mean. A network that has seen it takes it off.

use ndarray::{Array2, Array3, Axis};

use super::cfa::Cfa;

/// Mixes a share `h` of each channel's mean into an image, in place; light is kept.
///
/// # Shapes
/// `[channel, row, col]`, linear light.
pub fn add_haze(image: &mut Array3<f32>, h: f32) {
    for mut channel in image.axis_iter_mut(Axis(0)) {
        let mean = channel.iter().map(|&v| f64::from(v)).sum::<f64>() / channel.len().max(1) as f64;
        let veil = h * mean as f32;
        channel.mapv_inplace(|v| (1.0 - h).mul_add(v, veil));
    }
}

/// [`add_haze`] on the whole frame's mosaic, `[row, col]`: each pixel gets the mean of its own colour.
pub(crate) fn add_haze_mosaic(mosaic: &mut Array2<f32>, cfa: Cfa, h: f64) {
    let means = cfa.means(mosaic.view());
    #[expect(clippy::cast_possible_truncation, reason = "light is f32")]
    mosaic.indexed_iter_mut().for_each(|((i, j), v)| {
        *v = ((1.0 - h) * f64::from(*v) + h * means[cfa.channel(i, j)]) as f32;
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn haze_keeps_the_light_and_takes_contrast() {
        let rng = &mut fastrand::Rng::with_seed(1);
        let clear = Array3::from_shape_simple_fn((3, 20, 30), || rng.f32());
        let mut hazy = clear.clone();
        add_haze(&mut hazy, 0.2);
        for (a, b) in clear.axis_iter(Axis(0)).zip(hazy.axis_iter(Axis(0))) {
            let spread = |x: ndarray::ArrayView2<'_, f32>| x.std(0.0);
            assert!((a.mean().expect("some") - b.mean().expect("some")).abs() < 1e-6);
            assert!((spread(b) / spread(a) - 0.8).abs() < 1e-5);
        }
        let before = clear.clone();
        let mut none = clear;
        add_haze(&mut none, 0.0);
        assert_eq!(none, before);
    }
}
