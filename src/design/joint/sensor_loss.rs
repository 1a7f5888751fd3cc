//! The loss on sensor images of one scene at several distances, before the electronics and without a network (paper eq. 16):
//! Σᵢ ζᵢ ‖Iᵢ − I_ref‖₁ + w Σᵢ (1 − SSIM(Iᵢ, refᵢ)), with means over pixels and channels.
//!
//! It asks for a blur that is the same at every distance, and not far from the ideal picture at any: a network behind it need not know the distance.
//! Ours: linear light, data range 1, and ideal pictures under the lens's own falling light, so that vignetting is no blur.

use ndarray::Array3;
use serde::{Deserialize, Serialize};

use isoplanat_base::error::{Error, Result};
use isoplanat_imaging::metrics::ssim_and_slopes;

/// The loss, as a task states it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorLoss {
    /// Distance whose image the others are to resemble, mm: one of the task's.
    pub reference_mm: f64,
    /// ζ of each of the task's distances.
    pub weights: Vec<f64>,
    /// Weight of 1 − SSIM against the ideal picture, the same at every distance.
    #[serde(default = "three")]
    pub ssim: f64,
    /// Width of the texture at each distance, mm, as many texels as the frame has columns, as the paper prints it: scenes are then not of one size on the
    /// sensor. Left out: a texel of the picture to a pixel at every distance.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub texture_mm: Vec<f64>,
}

fn three() -> f64 {
    3.0
}

/// A value, and its slopes in the images and in the ideal pictures.
#[derive(Clone, Debug)]
pub(crate) struct Slopes {
    /// The loss.
    pub loss: f64,
    /// By distance, in the sensor image `[3, row, col]`.
    pub images: Vec<Array3<f64>>,
    /// By distance, in the ideal picture under the image's light.
    pub ideals: Vec<Array3<f64>>,
}

impl SensorLoss {
    /// Refuses what cannot be meant for a task at `depths_mm` with patches of `patch_px`; `file` is named in the error.
    pub(in crate::design) fn check(&self, depths_mm: &[f64], file: &str) -> Result<()> {
        let bad = |key: &str, found: String, allowed: String| {
            Err(Error::bad(file, format!("loss.sensor.{key}"), found, allowed))
        };
        let count = depths_mm.len();
        if count < 2 {
            return Err(Error::bad(
                file,
                "pictures.depths_mm",
                format!("{count} distances"),
                "two or more beside loss.sensor",
            ));
        }
        if !depths_mm.contains(&self.reference_mm) {
            return bad("reference_mm", self.reference_mm.to_string(), format!("one of depths_mm: {depths_mm:?}"));
        }
        if self.weights.len() != count {
            let found = format!("{} numbers", self.weights.len());
            return bad("weights", found, format!("{count} numbers, one for each of depths_mm"));
        }
        if let Some(w) = self.weights.iter().find(|w| !(0.0..=1e6).contains(*w)) {
            return bad("weights", w.to_string(), "0 to 1e6".into());
        }
        if !(0.0..=1e6).contains(&self.ssim) {
            return bad("ssim", self.ssim.to_string(), "0 to 1e6".into());
        }
        if self.ssim == 0.0 {
            // Images that resemble each other are easily had: dark or blurred without end.
            return bad("ssim", "0".into(), "above 0: without it the best image is no image".into());
        }
        if !self.texture_mm.is_empty() && self.texture_mm.len() != count {
            let found = format!("{} numbers", self.texture_mm.len());
            return bad("texture_mm", found, format!("{count} numbers, one for each of depths_mm"));
        }
        if let Some(w) = self.texture_mm.iter().find(|w| !(**w > 0.0 && w.is_finite())) {
            return bad("texture_mm", w.to_string(), "a positive width".into());
        }
        if !self.texture_mm.is_empty() && depths_mm.iter().any(|d| d.is_infinite()) {
            return bad("texture_mm", "a width at infinity".into(), "finite depths_mm".into());
        }
        Ok(())
    }

    /// Texels to a unit of slope where the task states the texture's width at distance `k`, on a frame of so many columns.
    pub(in crate::design) fn texels_per_slope(&self, k: usize, depth_mm: f64, columns: usize) -> Option<f64> {
        #[expect(clippy::cast_precision_loss, reason = "a raster's size")]
        self.texture_mm.get(k).map(|width| columns as f64 * depth_mm / width)
    }

    /// The loss of images and of the ideal pictures under their light, both `[3, row, col]` by distance, the image at `reference` being the one
    /// that the others are to resemble; with its slopes. At equal values the slope of the absolute difference counts as 0.
    ///
    /// # Errors
    /// Pictures smaller than SSIM's window.
    ///
    /// # Panics
    /// Pictures of different shapes.
    pub(crate) fn slopes(&self, images: &[Array3<f64>], ideals: &[Array3<f64>], reference: usize) -> Result<Slopes> {
        let mut loss = 0.0;
        let mut of_images: Vec<Array3<f64>> = images.iter().map(|i| Array3::zeros(i.dim())).collect();
        let mut of_ideals = of_images.clone();
        for (k, (image, ideal)) in images.iter().zip(ideals).enumerate() {
            let (ssim, [a, b]) = ssim_and_slopes(image.view(), ideal.view())?;
            loss += self.ssim * (1.0 - ssim);
            of_images[k].scaled_add(-self.ssim, &a);
            of_ideals[k].scaled_add(-self.ssim, &b);
            if k == reference || self.weights[k] == 0.0 {
                continue;
            }
            #[expect(clippy::cast_precision_loss, reason = "a picture's size")]
            let weight = self.weights[k] / image.len() as f64;
            let difference = image - &images[reference];
            loss += weight * difference.iter().map(|d| d.abs()).sum::<f64>();
            let sign = difference.mapv(|d| if d == 0.0 { 0.0 } else { weight * d.signum() });
            of_images[k] += &sign;
            of_images[reference] -= &sign;
        }
        Ok(Slopes { loss, images: of_images, ideals: of_ideals })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_abs, assert_rel, central_difference};

    fn loss() -> SensorLoss {
        SensorLoss { reference_mm: 1000.0, weights: vec![3.0, 0.3, 1.0], ssim: 3.0, texture_mm: Vec::new() }
    }

    fn pictures(seed: u64) -> Vec<Array3<f64>> {
        let rng = &mut fastrand::Rng::with_seed(seed);
        (0..3).map(|_| Array3::from_shape_simple_fn((3, 17, 23), || 0.2 + 0.6 * rng.f64())).collect()
    }

    /// Equal images that are their ideal pictures cost nothing; a constant offset of one costs its weight times the offset, and what SSIM says.
    #[test]
    fn the_loss_is_that_of_its_formula() {
        let image = pictures(1).swap_remove(0);
        let same = vec![image.clone(), image.clone(), image.clone()];
        assert_abs(loss().slopes(&same, &same, 1).expect("large enough").loss, 0.0, 1e-12, "equal");
        let mut brighter = same.clone();
        brighter[0] += 0.05;
        brighter[2] -= 0.02;
        let done = loss().slopes(&brighter, &brighter, 1).expect("large enough");
        assert_abs(done.loss, 3.0 * 0.05 + 1.0 * 0.02, 1e-12, "offsets, the reference's own weight left out");
        let flat = Array3::from_elem((3, 17, 23), 0.5);
        let done = loss().slopes(&same, &vec![flat; 3], 1).expect("large enough");
        assert!(done.loss > 3.0 * 3.0 * 0.8, "no structure in the ideal picture: {}", done.loss);
    }

    /// Against central differences along random directions of every image and ideal picture.
    #[test]
    fn slopes_agree_with_differences() {
        let (images, ideals, directions) = (pictures(2), pictures(3), pictures(4));
        let done = loss().slopes(&images, &ideals, 1).expect("large enough");
        for k in 0..3 {
            let d = &directions[k] - 0.5;
            let moved = |all: &[Array3<f64>], h: f64| {
                let mut all = all.to_vec();
                all[k].scaled_add(h, &d);
                all
            };
            let of = |images: &[Array3<f64>], ideals: &[Array3<f64>]| {
                loss().slopes(images, ideals, 1).expect("large enough").loss
            };
            // No absolute difference changes its sign within the step.
            let image = central_difference(|h| of(&moved(&images, h), &ideals), 1e-7);
            assert_rel((&done.images[k] * &d).sum(), image, 1e-6, 1e-9, "image");
            let ideal = central_difference(|h| of(&images, &moved(&ideals, h)), 1e-5);
            assert_rel((&done.ideals[k] * &d).sum(), ideal, 1e-7, 1e-9, "ideal picture");
        }
    }

    #[test]
    fn what_cannot_be_meant_is_refused_by_name() {
        let depths = [500.0, 1000.0, 1500.0];
        assert!(loss().check(&depths, "t").is_ok());
        let refused = |change: fn(&mut SensorLoss), depths: &[f64], place: &str| {
            let mut l = loss();
            change(&mut l);
            let why = l.check(depths, "t").expect_err(place).to_string();
            assert!(why.contains(place), "{why}");
        };
        refused(|_| (), &[1000.0], "depths_mm");
        refused(|l| l.reference_mm = 900.0, &depths, "reference_mm");
        refused(|l| l.weights = vec![1.0], &depths, "weights");
        refused(|l| l.weights[0] = f64::NAN, &depths, "weights");
        refused(|l| l.ssim = 0.0, &depths, "ssim");
        refused(|l| l.texture_mm = vec![1.0, 2.0], &depths, "texture_mm");
        refused(|l| l.texture_mm = vec![1.0, 2.0, 0.0], &depths, "texture_mm");
        refused(|l| l.texture_mm = vec![1.0, 2.0, 3.0], &[1000.0, 500.0, f64::INFINITY], "texture_mm");
    }
}
