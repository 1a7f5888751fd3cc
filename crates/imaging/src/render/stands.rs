//! Where probes stand: where the scenes have detail, since what a picture misses is missed there.

use rayon::prelude::*;

use super::source::WarpedScene;
use crate::plane::Region;

/// Pixels along the side of a probe.
pub(crate) const SIDE: usize = 3;
/// Places that are looked at before probes are drawn, over all scenes.
const CANDIDATES: usize = 4096;
/// Share of the draw that is even.
const EVEN: f64 = 0.3;

/// Where a probe stands, and what its square counts for in a mean over the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stand {
    /// Which scene.
    pub scene: usize,
    /// Its pixels.
    pub region: Region,
    /// Density of an even draw over that of the draw that chose it.
    pub weight: f64,
}

/// Places of scenes, numbered, with the energy of their second differences.
pub struct Candidates(Vec<(usize, Region, f64)>);

impl Candidates {
    /// Of all of `scenes`, over `region`.
    pub fn new(scenes: &[&WarpedScene<'_>], region: Region) -> Self {
        let of = |k: usize| places(region, CANDIDATES.div_ceil(scenes.len())).into_iter().map(move |r| (k, r));
        let all: Vec<(usize, Region)> = (0..scenes.len()).flat_map(of).collect();
        Self(all.into_par_iter().map(|(k, r)| (k, r, detail(scenes[k], r))).collect())
    }

    /// `count` of them, drawn by energy (and evenly, for a part), and weighed by how much likelier they were drawn than evenly.
    pub fn drawn(&self, count: usize) -> Vec<Stand> {
        let (all, total) = (self.0.len() as f64, self.0.iter().map(|c| c.2).sum::<f64>());
        let density = |e: f64| if total > 0.0 { EVEN / all + (1.0 - EVEN) * e / total } else { all.recip() };
        // Systematic draws along the running sum.
        let mut out = Vec::with_capacity(count);
        let (mut sum, mut next) = (0.0, 0.5 / count as f64);
        for (scene, region, energy) in &self.0 {
            let p = density(*energy);
            sum += p;
            while sum >= next && out.len() < count {
                out.push(Stand { scene: *scene, region: *region, weight: 1.0 / (all * p) });
                next += 1.0 / count as f64;
            }
        }
        out
    }
}

/// `count` places of [`SIDE`] pixels spread over `region`, jittered; the same for the same region.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "raster sizes"
)]
fn places(region: Region, count: usize) -> Vec<Region> {
    let mut rng = fastrand::Rng::with_seed(7);
    let aspect = region.cols as f64 / region.rows as f64;
    let across = ((count as f64 * aspect).sqrt().round() as usize).clamp(1, count);
    let down = count.div_ceil(across);
    let mut out = Vec::with_capacity(down * across);
    for (i, j) in (0..down).flat_map(|i| (0..across).map(move |j| (i, j))) {
        let mut at = |k: usize, n: usize, length: usize| {
            let side = SIDE.min(length);
            let place = (k as f64 + rng.f64()) / n as f64 * (length - side + 1) as f64;
            ((place as usize).min(length - side), side)
        };
        let ((row, rows), (col, cols)) = (at(i, down, region.rows), at(j, across, region.cols));
        out.push(Region { row: region.row + row.cast_signed(), col: region.col + col.cast_signed(), rows, cols });
    }
    out
}

/// Energy of the second differences of a scene over a place and a pixel around it, a sample a pixel; of several the mean over those that
/// lie alike in their pixels.
fn detail(scene: &WarpedScene<'_>, region: Region) -> f64 {
    let around = region.grown(2);
    let phases = scene.samples() * scene.samples();
    let mut values = ndarray::Array4::<f32>::zeros((scene.channels(), phases, around.rows, around.cols));
    scene.fill(around, values.view_mut());
    let mut sum = 0.0;
    let planes = values.into_shape_with_order((scene.channels() * phases, around.rows, around.cols));
    for v in planes.expect("as it was filled").outer_iter() {
        for (i, j) in (1..around.rows - 1).flat_map(|i| (1..around.cols - 1).map(move |j| (i, j))) {
            let second = 4.0 * v[[i, j]] - v[[i - 1, j]] - v[[i + 1, j]] - v[[i, j - 1]] - v[[i, j + 1]];
            sum += f64::from(second * second);
        }
    }
    #[expect(clippy::cast_precision_loss, reason = "a small count")]
    let phases = phases as f64;
    sum / phases
}
