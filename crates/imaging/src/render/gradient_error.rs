//! How far lens gradients are off, and what they cost: patches of a scene at a ladder of settings.
//!
//! The loss is the squared difference of picture and ideal picture, summed over the patches, its gradient every scaled number
//! that a designer frees first ([`Variables::refracting`]). A setting's error is the L2 distance of its gradient from that of
//! [`CONVERGED`], patch by patch, root of the mean square over that of the gradients: in the sum of a batch gradients cancel, so that
//! what it is off by says more of the draw than of the setting. Patches are a sample of the frame: the gradient of a step
//! scatters by what they are, and an error well below that scatter moves no design. [`cheapest`] takes the coarsest
//! settings of a ladder that are.

use std::time::Instant;

use ndarray::Array3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::plan::Settings;
use super::renderer::{Rendered, Renderer};
use crate::frame::Frame;
use crate::plane::{Plane, Region};
use crate::sensor::spectrum::SpectralDensity;
use isoplanat_base::error::Result;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::lens::variables::Variables;
use isoplanat_optics::psf::{Model, OpticsBar};

/// What gradients are compared with.
pub const CONVERGED: Settings = Settings {
    samples: 2,
    wavelengths: 9,
    degree: 9,
    dense: 3000,
    node_error: 0.03,
    outside: 2e-4,
    cells: 192,
    diffraction: Model::Rays,
};

/// One setting's gradients.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Gradients of the loss by patch, scaled.
    pub gradients: Vec<Vec<f64>>,
    /// Seconds of tracing, rendering and pulling back all patches as one step; planning is not counted.
    pub seconds: f64,
    /// Seconds of planning.
    pub planning: f64,
}

impl Measured {
    /// L2 distance of the gradients from those of `converged`, patch by patch, relative to the latter; not a number where those are
    /// all zero.
    pub fn error(&self, converged: &Self) -> f64 {
        let pairs = self.gradients.iter().flatten().zip(converged.gradients.iter().flatten());
        let off: f64 = pairs.map(|(a, b)| (a - b).powi(2)).sum();
        (off / converged.gradients.iter().flatten().map(|b| b * b).sum::<f64>()).sqrt()
    }

    /// Part of the gradients, root mean square, that is not common to all patches: 0 for equal ones, near 1 where they cancel.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub fn noise(&self) -> f64 {
        let each = &self.gradients;
        let n = each.len() as f64;
        let mean = |k: usize| each.iter().map(|g| g[k]).sum::<f64>() / n;
        let common: f64 = (0..each.first().map_or(0, Vec::len)).map(|k| n * mean(k).powi(2)).sum();
        let all: f64 = each.iter().flatten().map(|v| v * v).sum();
        (1.0 - common / all).max(0.0).sqrt()
    }
}

/// Patches of scenes, at any object distances.
#[derive(Clone, Debug)]
pub struct Patches<'a> {
    /// The lens.
    pub lens: &'a Lens,
    /// The frame.
    pub frame: &'a Frame,
    /// The sensor's response.
    pub density: &'a SpectralDensity,
    /// Scenes, and the parts of the frame that are rendered of them.
    pub parts: Vec<(&'a Plane, Region)>,
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
        let places = (0..down).flat_map(|i| (0..across).map(move |j| (i, j)));
        let parts = places.map(|(i, j)| (scene, region(i, j))).collect();
        Self { lens, frame, density, parts }
    }

    fn bar(&self, renderer: &Renderer, (scene, region): (&Plane, Region)) -> Result<OpticsBar> {
        let depth = renderer.plan.depth(scene.vergence)?;
        let rendered: Rendered<f32> = renderer.record(scene, depth, region);
        let off: Array3<f32> = (&rendered.image - &rendered.truth) * 2.0;
        let none = Array3::zeros(off.dim());
        Ok(renderer.vjp(scene, &rendered, off.view(), (-&off).view(), none.view()))
    }

    fn planned(&self, settings: Settings) -> Result<Renderer> {
        let mut vergences: Vec<f64> = Vec::new();
        for (scene, _) in &self.parts {
            if !vergences.contains(&scene.vergence) {
                vergences.push(scene.vergence);
            }
        }
        Renderer::planned(self.lens, self.frame, self.density, &vergences, settings)
    }

    fn gradient(&self, renderer: &Renderer, bar: &OpticsBar) -> Vec<f64> {
        Variables::refracting(self.lens).gradient(&renderer.lens_gradient(self.lens, bar))
    }

    /// The gradients with `settings`.
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
        let bars: Vec<OpticsBar> = self.parts.par_iter().map(|p| self.bar(&renderer, *p)).collect::<Result<_>>()?;
        let mut sum = OpticsBar::zeros(&renderer.optics);
        bars.iter().for_each(|b| sum.add(b));
        let step = self.gradient(&renderer, &sum);
        let seconds = clock.elapsed().as_secs_f64();
        debug_assert!(step.iter().all(|v| v.is_finite()));
        let gradients = bars.par_iter().map(|b| self.gradient(&renderer, b)).collect();
        Ok(Measured { gradients, seconds, planning })
    }
}

/// Largest error of a design's gradient, relative.
pub(crate) const LARGEST_ERROR: f64 = 0.05;
/// Largest error of a design's gradient, as a part of the patches' noise.
pub(crate) const OF_NOISE: f64 = 0.1;

/// Settings of a design, from the coarsest on. The finer ones keep pixels as cells for kernels that are wider: what a cell of two pixels loses on the
/// axis for the width of the corner's kernels is more than all the other settings win.
pub(crate) const LADDER: [Settings; 6] = [
    Settings { wavelengths: 3, dense: 200, node_error: 0.2, cells: 32, ..Settings::DESIGN },
    Settings { wavelengths: 4, dense: 300, node_error: 0.1, cells: 48, ..Settings::DESIGN },
    Settings::DESIGN,
    Settings { wavelengths: 7, dense: 300, node_error: 0.1, cells: 128, ..Settings::DESIGN },
    Settings { samples: 2, wavelengths: 7, dense: 600, outside: 5e-3, cells: 128, ..Settings::DESIGN },
    Settings {
        samples: 2,
        wavelengths: 7,
        dense: 1200,
        node_error: 0.03,
        outside: 2e-3,
        cells: 192,
        ..Settings::DESIGN
    },
];

/// Settings that were chosen for a design.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Chosen {
    /// The settings.
    pub settings: Settings,
    /// Error of the patches' gradients with them, relative.
    pub error: f64,
    /// The patches' own noise.
    pub noise: f64,
    /// Whether the error is below `LARGEST_ERROR` and `OF_NOISE` of the noise; where none is, the finest are taken.
    pub holds: bool,
}

impl Chosen {
    /// In words.
    pub fn describe(&self) -> String {
        let s = &self.settings;
        format!(
            "{}{} wavelengths, {} points of the stop, field nodes within {}, kernels of half-width {} cells at most: lens gradient off by {:.1} % {} ({:.0} % of patches' gradients is their own)",
            match s.diffraction {
                Model::Rays => "",
                Model::Approximate => "with the open pupil's diffraction, ",
                Model::Waves => "by diffraction, ",
            },
            s.wavelengths,
            s.dense,
            s.node_error,
            s.cells,
            100.0 * self.error,
            if self.holds { "as wished" } else { "though less was wished, the finest there are" },
            100.0 * self.noise
        )
    }
}

/// The coarsest settings of `LADDER` whose gradient is well below the noise of the patches; the same for the same patches.
///
/// # Errors
/// As [`Patches::measure`].
pub fn cheapest(patches: &Patches<'_>) -> Result<Chosen> {
    let converged = patches.measure(CONVERGED)?;
    let noise = converged.noise();
    // Equal patches have no noise: then the error alone counts.
    let limit = if noise > 0.0 { LARGEST_ERROR.min(OF_NOISE * noise) } else { LARGEST_ERROR };
    let mut last = None;
    for settings in LADDER {
        let error = patches.measure(settings)?.error(&converged);
        let chosen = Chosen { settings, error, noise, holds: error <= limit };
        // A scene without light has no gradient: nothing is off.
        if chosen.holds || error.is_nan() {
            return Ok(Chosen { holds: true, error: if error.is_nan() { 0.0 } else { error }, ..chosen });
        }
        last = Some(chosen);
    }
    Ok(last.expect("a ladder has rungs"))
}
