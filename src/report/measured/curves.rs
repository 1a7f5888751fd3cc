//! MTF curves of slanted edges as plain numbers, to be kept in a file and laid beside those of other cameras.

use serde::{Deserialize, Serialize};

use super::{Measured, curve};
use isoplanat_imaging::metrics::slanted_edge::EdgeMeasurement;

/// The curves of one edge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curves {
    /// Distance of the patch's middle from the axis on the sensor, mm.
    pub height_mm: f64,
    /// Whether its normal lies along the meridian.
    pub tangential: bool,
    /// What rays predict: cycles a pixel, modulation with the pixel.
    pub design: Vec<[f64; 2]>,
    /// What the capture shows; empty where no edge was measured.
    pub capture: Vec<[f64; 2]>,
    /// What the reconstruction shows.
    pub reconstruction: Vec<[f64; 2]>,
}

impl Measured {
    /// All its curves up to half a cycle a pixel, from the axis outwards, tangential before sagittal.
    pub fn curves(&self) -> Vec<Curves> {
        let mut all = Vec::new();
        for place in &self.places {
            let measured = |found: Option<&Result<EdgeMeasurement, String>>| match found {
                Some(Ok(edge)) => {
                    let points = curve(edge, place.texels, self.pitch_mm);
                    points.iter().map(|p| [p[0] * self.pitch_mm, p[1]]).filter(|p| p[1].is_finite()).collect()
                }
                _ => Vec::new(),
            };
            for (k, edge) in place.edges.iter().enumerate() {
                all.push(Curves {
                    height_mm: place.height_mm,
                    tangential: k == 0,
                    design: edge.design.iter().map(|p| [p[0] * self.pitch_mm, p[1]]).collect(),
                    capture: measured(Some(&edge.capture)),
                    reconstruction: measured(edge.reconstruction.as_ref()),
                });
            }
        }
        all
    }
}
