//! How far lens gradients are off, and what they cost: patches of a scene at a ladder of settings.
//!
//! The loss is the squared difference of picture and ideal picture, summed over the patches, its gradient every scaled number
//! that a designer frees first ([`Variables::refracting`]). A setting's error is the L2 distance of its gradient from that of
//! [`CONVERGED`], relative to it. Patches are a sample of the frame: the gradient of a step scatters by what they are, and
//! an error well below that scatter moves no design.

use std::time::Instant;

use ndarray::Array3;
use rayon::prelude::*;

use super::plan::Settings;
use super::renderer::{Rendered, Renderer};
use crate::error::Result;
use crate::imaging::frame::Frame;
use crate::imaging::plane::{Plane, Region};
use crate::imaging::sensor::spectrum::SpectralDensity;
use crate::lens::Lens;
use crate::lens::variables::Variables;
use crate::psf::OpticsBar;

/// What gradients are compared with.
pub const CONVERGED: Settings =
    Settings { samples: 2, wavelengths: 9, degree: 9, dense: 3000, node_error: 0.03, outside: 2e-4, cells: 96 };

/// One setting's gradient.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Gradient of the loss, scaled.
    pub gradient: Vec<f64>,
    /// Seconds of tracing, rendering and pulling back all patches; planning is not counted.
    pub seconds: f64,
    /// Seconds of planning.
    pub planning: f64,
}

/// Patches of one scene.
#[derive(Clone, Debug)]
pub struct Patches<'a> {
    /// The lens.
    pub lens: &'a Lens,
    /// The frame.
    pub frame: &'a Frame,
    /// The sensor's response.
    pub density: &'a SpectralDensity,
    /// The scene.
    pub scene: &'a Plane,
    /// Parts of the frame.
    pub regions: Vec<Region>,
}

impl<'a> Patches<'a> {
    /// About `count` patches of `side` pixels, evenly over the frame.
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "raster sizes"
    )]
    pub fn even(
        lens: &'a Lens,
        frame: &'a Frame,
        density: &'a SpectralDensity,
        scene: &'a Plane,
        (side, count): (usize, usize),
    ) -> Self {
        let side = side.min(frame.rows).min(frame.columns);
        let aspect = frame.columns as f64 / frame.rows as f64;
        let across = ((count as f64 * aspect).sqrt().round() as usize).clamp(1, count);
        let down = count.div_ceil(across);
        let start =
            |k: usize, n: usize, length: usize| ((length - side) as f64 * (k as f64 + 0.5) / n as f64).round() as isize;
        let region = |i: usize, j: usize| Region {
            row: start(i, down, frame.rows),
            col: start(j, across, frame.columns),
            rows: side,
            cols: side,
        };
        let regions = (0..down).flat_map(|i| (0..across).map(move |j| (i, j))).map(|(i, j)| region(i, j)).collect();
        Self { lens, frame, density, scene, regions }
    }

    fn planned(&self, settings: Settings) -> Result<Renderer> {
        Renderer::planned(self.lens, self.frame, self.density, &[self.scene.vergence], settings)
    }

    fn bar(&self, renderer: &Renderer, region: Region) -> OpticsBar {
        let rendered: Rendered<f32> = renderer.record(self.scene, 0, region);
        let off: Array3<f32> = (&rendered.image - &rendered.truth) * 2.0;
        let none = Array3::zeros(off.dim());
        renderer.vjp(self.scene, &rendered, off.view(), (-&off).view(), none.view())
    }

    fn gradient(&self, renderer: &Renderer, bar: &OpticsBar) -> Vec<f64> {
        Variables::refracting(self.lens).gradient(&renderer.lens_gradient(self.lens, bar))
    }

    /// The gradient with `settings`.
    ///
    /// # Errors
    /// A lens that cannot be rendered on the frame.
    pub fn measure(&self, settings: Settings) -> Result<Measured> {
        let clock = Instant::now();
        let plan = self.planned(settings)?.plan;
        let planning = clock.elapsed().as_secs_f64();
        // A design step traces the lens anew.
        let clock = Instant::now();
        let renderer = Renderer::new(self.lens, &plan)?;
        let bars: Vec<OpticsBar> = self.regions.par_iter().map(|r| self.bar(&renderer, *r)).collect();
        let mut sum = OpticsBar::zeros(&renderer.optics);
        bars.iter().for_each(|b| sum.add(b));
        let gradient = self.gradient(&renderer, &sum);
        Ok(Measured { gradient, seconds: clock.elapsed().as_secs_f64(), planning })
    }

    /// Scatter of the sum over the patches, relative to it: root of the patches' variance times their number over the norm.
    ///
    /// # Errors
    /// As [`Self::measure`].
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub fn scatter(&self, settings: Settings) -> Result<f64> {
        let renderer = self.planned(settings)?;
        let each: Vec<Vec<f64>> =
            self.regions.iter().map(|r| self.gradient(&renderer, &self.bar(&renderer, *r))).collect();
        let n = each.len() as f64;
        let count = each.first().map_or(0, Vec::len);
        let (mut variance, mut square) = (0.0, 0.0);
        for k in 0..count {
            let mean = each.iter().map(|g| g[k]).sum::<f64>() / n;
            variance += each.iter().map(|g| (g[k] - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
            square += (n * mean).powi(2);
        }
        Ok((variance * n / square).sqrt())
    }
}

/// L2 distance of `a` from `b`, relative to `b`.
pub fn distance(a: &[f64], b: &[f64]) -> f64 {
    let off: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    (off / b.iter().map(|b| b * b).sum::<f64>()).sqrt()
}
