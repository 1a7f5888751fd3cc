//! What a camera makes of a slanted edge, and what is measured in it.

use glam::DVec2;
use ndarray::{Array2, Array3};

use isoplanat_base::error::Result;
use isoplanat_imaging::metrics::slanted_edge::EdgeMeasurement;
use isoplanat_imaging::plane::{Plane, Region};

/// What a camera makes of a region of the frame.
#[derive(Clone, Debug)]
pub struct Seen {
    /// Irradiance in each pixel's own colour, without noise, `[row, col]`.
    pub mosaic: Array2<f32>,
    /// The developed capture, with noise, and its reconstruction, both `[3, row, col]`; none without a network.
    pub developed: Option<[Array3<f32>; 2]>,
}

/// A camera: what it makes of a region in front of a scene.
pub type Camera<'a> = &'a dyn Fn(&Plane, Region) -> Result<Seen>;

/// One edge at one place.
#[derive(Clone, Debug)]
pub struct Edge {
    /// Cycles/mm and the modulation that rays predict along the capture's measured normal, or along the ideal one.
    pub design: Vec<[f64; 2]>,
    /// The edge in the capture's green pixels; why there is none.
    pub capture: Result<EdgeMeasurement, String>,
    /// The edge in the reconstruction's green; nothing without a network.
    pub reconstruction: Option<Result<EdgeMeasurement, String>>,
    /// Developed capture and reconstruction, `[3, row, col]`.
    pub pictures: Option<[Array3<f32>; 2]>,
}

impl Edge {
    /// What was measured, under its name.
    pub(super) fn all(&self) -> impl Iterator<Item = (&'static str, &Result<EdgeMeasurement, String>)> {
        [("capture", Some(&self.capture)), ("reconstruction", self.reconstruction.as_ref())]
            .into_iter()
            .filter_map(|(name, found)| Some((name, found?)))
    }
}

pub(super) fn sinc(x: f64) -> f64 {
    let y = std::f64::consts::PI * x;
    if y.abs() < 1e-9 { 1.0 } else { y.sin() / y }
}

/// The measured curve up to half a cycle a pixel, without the scene's texels: cycles/mm, modulation, its standard uncertainty.
pub fn curve(edge: &EdgeMeasurement, texels: usize, pitch_mm: f64) -> Vec<[f64; 3]> {
    let n = DVec2::from_angle(edge.normal_deg.to_radians());
    #[expect(clippy::cast_precision_loss, reason = "a few texels")]
    let own = |f: f64| {
        let f = f / texels as f64;
        // A texel's own area, and the even run between two of them.
        (sinc(f * n.x) * sinc(f * n.y)).powi(3)
    };
    let below = edge.mtf.iter().take_while(|p| p.frequency <= 0.5 + 1e-9);
    below.map(|p| [p.frequency / pitch_mm, p.value / own(p.frequency), p.uncertainty / own(p.frequency)]).collect()
}
