//! Relative illumination of a lens, radial and per channel, and the flat field that divides it out.

use serde::{Deserialize, Serialize};

use crate::frame::Frame;
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::psf::SensorPoint;
use isoplanat_optics::psf::measured::linear;
use ndarray::{Array3, ArrayView3};

/// Illumination below which the flat field amplifies no further: a hundredth of the axis's light. What is darker is shown darker, rather
/// than as noise that outshines the picture.
pub(crate) const DARKEST: f64 = 0.01;

/// A picture with the falling light divided out, as the camera does it; black where there is none.
///
/// # Shapes
/// `image`, `illumination` and result: `[channel, row, col]`.
#[doc(hidden)]
#[must_use]
pub fn evened(mut image: Array3<f32>, illumination: ArrayView3<'_, f32>) -> Array3<f32> {
    image.zip_mut_with(&illumination, |v, light| *v = if *light > 0.0 { *v / light.max(DARKEST as f32) } else { 0.0 });
    image
}

/// Relative illumination against the distance from the axis, per channel R, G, B; 1 on the axis.
///
/// Between the nodes it is piecewise linear, beyond the last one constant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "ShadingFile")]
pub struct Shading {
    /// Distances from the axis, mm, growing, the first one 0.
    pub radius_mm: Vec<f64>,
    /// Relative illumination at those distances, one list a channel.
    pub illumination: [Vec<f64>; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ShadingFile {
    radius_mm: Vec<f64>,
    illumination: [Vec<f64>; 3],
}

impl TryFrom<ShadingFile> for Shading {
    type Error = Error;

    fn try_from(file: ShadingFile) -> Result<Self> {
        Self::new(file.radius_mm, file.illumination)
    }
}

impl Shading {
    /// Relative illumination `illumination[channel][i]` at distance `radius_mm[i]` from the axis.
    ///
    /// # Errors
    /// Lists of different lengths, radii that do not start at 0 and grow, illumination outside `(0, 16]`, or a
    /// value on the axis that is not 1 to 1 %.
    pub fn new(radius_mm: Vec<f64>, illumination: [Vec<f64>; 3]) -> Result<Self> {
        let keys = ["radius_mm", "illumination[0]", "illumination[1]", "illumination[2]"];
        Self::stated(keys.map(|key| format!("shading.{key}")), radius_mm, illumination)
    }

    /// [`Self::new`] of the lists that stand under `keys` in a file: the radii, then each colour.
    pub(crate) fn stated(keys: [impl AsRef<str>; 4], radius_mm: Vec<f64>, illumination: [Vec<f64>; 3]) -> Result<Self> {
        let bad = |key: usize, found: String, allowed: &str| Err(Error::bad("", keys[key].as_ref(), found, allowed));
        if radius_mm.first() != Some(&0.0) {
            let found =
                radius_mm.first().map_or_else(|| "an empty list".into(), |first| format!("a list from {first}"));
            return bad(0, found, "a list that starts at 0");
        }
        if let Some(w) = radius_mm.windows(2).find(|w| !(w[1] > w[0] && w[1].is_finite())) {
            return bad(0, format!("{} after {}", w[1], w[0]), "finite radii that grow");
        }
        for (channel, values) in illumination.iter().enumerate() {
            let key = channel + 1;
            if values.len() != radius_mm.len() {
                let allowed = format!("{} values, one for each radius", radius_mm.len());
                return bad(key, format!("{} values", values.len()), &allowed);
            }
            if let Some(v) = values.iter().find(|v| !(**v > 0.0 && **v <= 16.0)) {
                return bad(key, v.to_string(), "relative illumination above 0 and up to 16");
            }
            if (values[0] - 1.0).abs() > 0.01 {
                return bad(key, format!("{} on the axis", values[0]), "1 on the axis");
            }
        }
        Ok(Self { radius_mm, illumination })
    }

    /// No shading: 1 everywhere.
    pub fn none() -> Self {
        Self { radius_mm: vec![0.0], illumination: std::array::from_fn(|_| vec![1.0]) }
    }

    /// Relative illumination of `channel` (0 = R, 1 = G, 2 = B) at a point of the sensor.
    ///
    /// # Panics
    /// For a channel above 2.
    pub fn at(&self, channel: usize, point: SensorPoint) -> f64 {
        linear(&self.radius_mm, &self.illumination[channel], point.radius_mm())
    }

    /// `1 / at(channel, point)`, at most `1 / DARKEST` ([`DARKEST`]), over `frame`, to look gains up without a search per pixel.
    pub(crate) fn gains<'a>(&self, frame: &'a Frame) -> Gains<'a> {
        const N: usize = 4096;
        let per_mm = N as f64 / frame.max_radius_mm().max(f64::MIN_POSITIVE);
        let at = |c: usize, i: usize| self.at(c, SensorPoint::along([1.0, 0.0], i as f64 / per_mm));
        let gains = std::array::from_fn(|c| (0..=N).map(|i| (1.0 / at(c, i).max(DARKEST)) as f32).collect());
        Gains { gains, per_mm, frame }
    }
}

/// Flat-field gains over a frame; made by [`Shading::gains`].
#[derive(Clone, Debug)]
pub(crate) struct Gains<'a> {
    /// Over the radius.
    gains: [Vec<f32>; 3],
    per_mm: f64,
    frame: &'a Frame,
}

impl Gains<'_> {
    /// Gain of `channel` (0 = R, 1 = G, 2 = B) at pixel coordinates of the frame; a pixel's centre is at `(j + ½, i + ½)`.
    pub(crate) fn at(&self, channel: usize, column: f64, row: f64) -> f32 {
        let table = &self.gains[channel];
        let x = (self.frame.radius_mm(column, row) * self.per_mm).min((table.len() - 1) as f64);
        let i = (x as usize).min(table.len() - 2);
        let t = (x - i as f64) as f32;
        table[i] + t * (table[i + 1] - table[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cos4() -> Shading {
        let radius: Vec<f64> = (0..=40).map(|i| 0.5 * f64::from(i)).collect();
        let values: Vec<f64> = radius.iter().map(|r| (r / 50.0_f64).atan().cos().powi(4)).collect();
        Shading::new(radius, [values.clone(), values.clone(), values]).expect("valid")
    }

    #[test]
    fn between_nodes_it_is_linear_and_beyond_them_constant() {
        let s = Shading::new(vec![0.0, 10.0], [vec![1.0, 0.5], vec![1.0, 0.6], vec![1.0, 0.7]]).expect("valid");
        for (channel, r, value) in [(0, 0.0, 1.0), (0, 5.0, 0.75), (1, 2.5, 0.9), (2, 10.0, 0.7), (2, 99.0, 0.7)] {
            assert!((s.at(channel, SensorPoint::along([0.6, 0.8], r)) - value).abs() < 1e-15);
        }
        assert_eq!(Shading::none().at(1, SensorPoint::at([3.0, 0.0])), 1.0);
    }

    #[test]
    fn the_gain_table_is_the_reciprocal() {
        let s = cos4();
        let frame = Frame::centred(1600, 1200, 0.02).expect("valid");
        let table = s.gains(&frame);
        for i in 0..1000 {
            let (column, row) = (800.0 + 0.8 * f64::from(i), 600.0 - 0.6 * f64::from(i));
            let error = f64::from(table.at(1, column, row)) * s.at(1, frame.point(column, row)) - 1.0;
            assert!(error.abs() < 2e-5, "{i}: {error:e}");
        }
    }

    #[test]
    fn files_round_trip_and_wrong_ones_are_refused() {
        let s = cos4();
        let text = toml::to_string(&s).expect("writes");
        assert_eq!(toml::from_str::<Shading>(&text).expect("reads"), s);
        for bad in [
            "radius_mm = [0.0, 1.0]\nillumination = [[1.0, 0.5], [1.0, 0.5], [1.0]]",
            "radius_mm = [0.5, 1.0]\nillumination = [[1.0, 0.5], [1.0, 0.5], [1.0, 0.5]]",
            "radius_mm = [0.0, 0.0]\nillumination = [[1.0, 0.5], [1.0, 0.5], [1.0, 0.5]]",
            "radius_mm = [0.0, 1.0]\nillumination = [[1.0, nan], [1.0, 0.5], [1.0, 0.5]]",
            "radius_mm = [0.0]\nillumination = [[0.5], [1.0], [1.0]]",
            "radius_mm = []\nillumination = [[], [], []]",
        ] {
            assert!(toml::from_str::<Shading>(bad).is_err(), "{bad}");
        }
    }
}
