//! Scenes to photograph: built-in generators, seeded and endless, and folders of photographs.
//!
//! A scene is linear RGB in `[0, 1]`, `[3, row, col]`, its mean between 0.18 and 0.4, as a well exposed photograph's. The same kind,
//! seed and size always give the same picture. Most generators follow the statistics of photographs: occlusion, sizes
//! distributed as r⁻³, power spectra near f⁻² (A. B. Lee, D. Mumford, J. Huang, "Occlusion models for natural images",
//! Int. J. Comput. Vis. 41, 2001), colours mostly muted. [`SceneKind::Facades`] is kept out of [`TRAINING`]: it shares no
//! shapes with the others and serves as the unseen scene of every evaluation; so is [`SceneKind::ColorChart`], which judges colour. A picture of 1024 × 768 costs 0.03 to 0.3 s of
//! one core.

mod building;
mod canvas;
mod chart;
#[doc(hidden)]
pub mod detail;
mod edges;
mod facades;
mod foliage;
mod font;
mod leaves;
mod mixed;
mod noise_tile;
mod palette;
pub mod photos;
pub mod placement;
mod text;
mod texture;
mod view;

use std::fmt;

use fastrand::Rng;
use ndarray::Array3;
use serde::{Deserialize, Serialize};

pub use placement::fill_frame;

use crate::sensor::noise::mixed as mixed_seed;

/// A family of built-in scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneKind {
    /// Shaded, textured shapes of all sizes that hide one another.
    DeadLeaves,
    /// Printed matter: lines of text of many sizes, dark on light and light on dark.
    Text,
    /// Patches of gratings, weaves, checkers, zone plates, grain and coloured 1/f noise.
    FineTexture,
    /// Chart-like: slanted squares, stars, wedges, grey patches.
    SlantedEdges,
    /// Several of the above in one picture.
    Mixed,
    /// Streets in perspective: brick, windows, roofs, railings, trees. Never used for training.
    Facades,
    /// A chart of 24 published colours, at their own brightness. Never used for training.
    ColorChart,
}

/// The kinds training draws from; [`SceneKind::Facades`] and [`SceneKind::ColorChart`] are not among them.
pub const TRAINING: [SceneKind; 5] =
    [SceneKind::DeadLeaves, SceneKind::Mixed, SceneKind::Text, SceneKind::FineTexture, SceneKind::SlantedEdges];

impl SceneKind {
    /// Every kind.
    pub const ALL: [Self; 7] = [
        Self::DeadLeaves,
        Self::Text,
        Self::FineTexture,
        Self::SlantedEdges,
        Self::Mixed,
        Self::Facades,
        Self::ColorChart,
    ];

    /// The kind's name in files and on the command line, for instance `dead_leaves`.
    pub fn name(self) -> &'static str {
        match self {
            Self::DeadLeaves => "dead_leaves",
            Self::Text => "text",
            Self::FineTexture => "fine_texture",
            Self::SlantedEdges => "slanted_edges",
            Self::Mixed => "mixed",
            Self::Facades => "facades",
            Self::ColorChart => "color_chart",
        }
    }

    /// The kind named `name`; `-` counts as `_`.
    pub fn from_name(name: &str) -> Option<Self> {
        let name = name.replace('-', "_");
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

impl fmt::Display for SceneKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A built-in scene: linear RGB in `[0, 1]`.
///
/// ```
/// use isoplanat_imaging::scene::{SceneKind, generate};
///
/// let street = generate(SceneKind::Facades, 3, 48, 64);
/// assert_eq!(street.dim(), (3, 48, 64));
/// assert_eq!(street, generate(SceneKind::Facades, 3, 48, 64));
/// assert!(street.iter().all(|v| (0.0..=1.0).contains(v)));
/// ```
///
/// # Shapes
/// Result `[3, rows, cols]`; a side of 0 gives an empty picture.
pub fn generate(kind: SceneKind, seed: u64, rows: usize, cols: usize) -> Array3<f32> {
    if rows == 0 || cols == 0 {
        return Array3::zeros((3, rows, cols));
    }
    let number = SceneKind::ALL.iter().position(|k| *k == kind).unwrap_or(0) as u64;
    let rng = &mut Rng::with_seed(mixed_seed(seed, number));
    let target = 0.2 + 0.15 * rng.f32();
    let canvas = match kind {
        SceneKind::DeadLeaves => leaves::paint(rng, rows, cols),
        SceneKind::Text => text::paint(rng, rows, cols),
        SceneKind::FineTexture => texture::paint(rng, rows, cols),
        SceneKind::SlantedEdges => edges::paint(rng, rows, cols),
        SceneKind::Mixed => mixed::paint(rng, rows, cols),
        SceneKind::Facades => facades::paint(rng, rows, cols),
        SceneKind::ColorChart => return chart::paint(rng, rows, cols).times(1.0),
    };
    canvas.exposed(target)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustfft::{FftPlanner, num_complex::Complex};

    /// Slope of log power over log frequency, 0.01 to 0.25 cycles a pixel, of a Hann-windowed square crop's luminance.
    fn spectral_slope(image: &Array3<f32>, n: usize) -> f64 {
        let luma = |r: usize, c: usize| {
            0.2126 * f64::from(image[[0, r, c]])
                + 0.7152 * f64::from(image[[1, r, c]])
                + 0.0722 * f64::from(image[[2, r, c]])
        };
        let mean = (0..n * n).map(|i| luma(i / n, i % n)).sum::<f64>() / (n * n) as f64;
        let hann = |i: usize| (std::f64::consts::PI * (i as f64 + 0.5) / n as f64).sin().powi(2);
        let value = |i: usize| Complex::new((luma(i / n, i % n) - mean) * hann(i / n) * hann(i % n), 0.0);
        let mut field: Vec<Complex<f64>> = (0..n * n).map(value).collect();
        let fft = FftPlanner::new().plan_fft_forward(n);
        fft.process(&mut field);
        let mut turned: Vec<_> = (0..n * n).map(|i| field[(i % n) * n + i / n]).collect();
        fft.process(&mut turned);
        // Mean power in rings of equal width in log frequency.
        let mut rings = vec![(0.0, 0.0); 16];
        for (i, v) in turned.iter().enumerate() {
            let signed = |k: usize| (if k > n / 2 { k as f64 - n as f64 } else { k as f64 }) / n as f64;
            let f = signed(i / n).hypot(signed(i % n));
            let ring = ((f / 0.01).log2() / 25f64.log2() * 16.0).floor();
            if (0.0..16.0).contains(&ring) {
                rings[ring as usize].0 += v.norm_sqr();
                rings[ring as usize].1 += 1.0;
            }
        }
        let points: Vec<(f64, f64)> = rings
            .iter()
            .enumerate()
            .map(|(i, (sum, count))| ((i as f64 + 0.5) / 16.0 * 25f64.ln(), (sum / count).ln()))
            .collect();
        let (mx, my) = points.iter().fold((0.0, 0.0), |m, p| (m.0 + p.0 / 16.0, m.1 + p.1 / 16.0));
        let sxy: f64 = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum();
        sxy / points.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>()
    }

    #[test]
    fn dead_leaves_have_the_power_spectrum_of_photographs() {
        let slopes: Vec<f64> =
            (0..6).map(|seed| spectral_slope(&generate(SceneKind::DeadLeaves, seed, 512, 512), 512)).collect();
        let mean = slopes.iter().sum::<f64>() / 6.0;
        assert!((-2.4..=-1.6).contains(&mean), "{slopes:?}");
    }

    #[test]
    fn the_seed_decides_and_nothing_else() {
        for kind in SceneKind::ALL {
            let a = generate(kind, 5, 60, 90);
            assert_eq!(a, generate(kind, 5, 60, 90), "{kind}");
            let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
            assert_eq!(a, pool.install(|| generate(kind, 5, 60, 90)), "{kind}");
            assert_ne!(a, generate(kind, 6, 60, 90), "{kind}");
        }
    }

    #[test]
    fn scenes_are_well_exposed_and_use_the_range() {
        for kind in SceneKind::ALL {
            for seed in 0..4 {
                let image = generate(kind, seed, 240, 320);
                assert!(image.iter().all(|v| (0.0..=1.0).contains(v)), "{kind} {seed}");
                let mean = image.mean().expect("not empty");
                assert!((0.15..=0.42).contains(&mean), "{kind} {seed}: mean {mean}");
                let mut values: Vec<f32> = image.iter().copied().collect();
                values.sort_by(f32::total_cmp);
                let at = |share: f64| values[(share * (values.len() - 1) as f64) as usize];
                assert!(at(0.01) < 0.1 && at(0.995) > 0.6, "{kind} {seed}: {} to {}", at(0.01), at(0.995));
            }
        }
    }

    #[test]
    fn tiny_sizes_pass_and_names_return() {
        for kind in SceneKind::ALL {
            for (rows, cols) in [(0, 5), (1, 1), (1, 40), (7, 3)] {
                assert_eq!(generate(kind, 1, rows, cols).dim(), (3, rows, cols));
            }
            assert_eq!(SceneKind::from_name(kind.name()), Some(kind));
        }
        assert_eq!(SceneKind::from_name("dead-leaves"), Some(SceneKind::DeadLeaves));
        assert_eq!(SceneKind::from_name("cats"), None);
        assert!(!TRAINING.contains(&SceneKind::Facades) && !TRAINING.contains(&SceneKind::ColorChart));
    }
}
