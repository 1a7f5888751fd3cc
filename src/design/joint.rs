//! The joint design step: patches → render → network → L1 → network gradient at the image → imaging, PSF and trace
//! adjoints → lens (paper eq. 15); Adam on the network, `LensSteps` on the lens.
//!
//! A step whose rays fail, whose distortion folds or whose loss is not finite is taken back: the lens returns to its
//! last good numbers and its step is halved.
//!
//! To read in this order: [`lens_steps`] (how the lens moves, within `constraint`), `images` and [`sensor_loss`] (a step without a network), [`noise`] (how well gradients are known), [`distances`] (how
//! much each object distance counts), [`as_built`] (lenses within tolerances); [`run`] is the loop, on [`scenery`], looked at by [`judge`]; [`designing`] the loop with its folder, [`state`] where it
//! stands, [`story`] its page, [`sweep`] many of them by number.

#[doc(hidden)]
pub mod as_built;
pub(crate) mod constraint;
pub mod designing;
#[doc(hidden)]
pub mod distances;
#[doc(hidden)]
pub mod judge;
#[doc(hidden)]
pub mod lens_steps;
#[doc(hidden)]
pub mod noise;
#[doc(hidden)]
pub mod run;
#[doc(hidden)]
pub mod scenery;
pub mod sensor_loss;
mod settings;
#[doc(hidden)]
pub mod state;
#[doc(hidden)]
pub mod story;
#[doc(hidden)]
pub mod sweep;

use std::time::Instant;

use ndarray::{Array3, ArrayView4, Axis, Ix3, SliceInfo, SliceInfoElem, s};
use rayon::prelude::*;

use self::distances::Distances;
use self::lens_steps::{LensSteps, Stepped};
use self::noise::Noise;
use crate::design::chain::{Patch, PatchForward, forward, forward_vjp};
use isoplanat_base::error::Result;
use isoplanat_imaging::develop::simulate::Electronics;
use isoplanat_imaging::guide::{Guide, Record};
use isoplanat_imaging::metrics::decibel;
use isoplanat_imaging::render::{RenderPlan, Renderer};
use isoplanat_network::Reconstructor;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::optimize::descent::Linear;
use isoplanat_optics::psf::{OpticsBar, SensorPoint};

/// Radii at which the illumination is looked at, and how near it has to be to its bound to hold a step.
const DARK: u32 = 8;
const NEAR: f64 = 0.05;

/// Lens and network on their way.
pub struct Joint {
    /// The lens now.
    pub lens: Lens,
    /// The network now.
    pub network: Reconstructor,
    /// What it is told beside the capture: its filters are those of the lens some steps ago.
    pub guide: Guide,
    /// How often the filters were made anew, and the seconds that took.
    pub refreshed: (usize, f64),
    /// How it moves.
    pub steps: LensSteps,
    /// Steps that were taken back.
    pub rejected: usize,
    /// Gradients of its numbers, since somebody cleared them.
    pub noise: Noise,
    /// How much object distances count.
    pub distances: Distances,
    /// Least illumination of any pixel relative to the axis that a step keeps; `None`: whatever comes.
    pub least_illumination: Option<f64>,
    /// The last lens that was rendered.
    pub good: Lens,
    /// Shortens steps of the lens after one that failed.
    pub damping: f64,
}

/// What a step did.
#[derive(Clone, Debug)]
pub struct Report {
    /// Mean L1 loss of the batch after the network.
    pub loss: f64,
    /// PSNR of the network's input against the truth, linear light, dB; without a network, of sensor images, mean over the distances.
    pub input_psnr_db: f64,
    /// PSNR of its output; without a network, of the distance with the lowest.
    pub output_psnr_db: f64,
    /// What the lens did; `None` where it was held, or the loss was no number.
    pub lens: Option<Stepped>,
    /// Seconds of the network's forward pass, backward pass and update.
    pub network_seconds: f64,
}

/// Mean absolute difference, and PSNR in linear light (dB, at most 120), of two pictures of equal size.
pub(in crate::design) fn l1_and_psnr<'a>(
    a: impl ExactSizeIterator<Item = &'a f32>,
    b: impl Iterator<Item = &'a f32>,
) -> (f64, f64) {
    let n = a.len() as f64;
    let (mut l1, mut l2) = (0.0, 0.0);
    for (x, y) in a.zip(b) {
        let d = f64::from(x - y);
        l1 += d.abs();
        l2 += d * d;
    }
    (l1 / n, decibel((l2 / n).max(1e-12)))
}

/// The part of a patch that the network sees, in what is rendered.
pub(in crate::design) fn middle(patch: &Patch) -> SliceInfo<[SliceInfoElem; 3], Ix3, Ix3> {
    let Patch { region, part, .. } = patch;
    let (row, col) = ((part.row - region.row).unsigned_abs(), (part.col - region.col).unsigned_abs());
    s![.., row..row + part.rows, col..col + part.cols]
}

impl Joint {
    /// Starts from `lens` and `network`, which `guide` tells what it asks for; the lens moves by `steps`.
    pub fn new(lens: Lens, network: Reconstructor, guide: Guide, steps: LensSteps) -> Self {
        Self {
            good: lens.clone(),
            lens,
            network,
            guide,
            refreshed: (0, 0.0),
            steps,
            rejected: 0,
            noise: Noise::default(),
            distances: Distances::default(),
            least_illumination: None,
            damping: 1.0,
        }
    }

    /// The lens now, traced for `plan`, with widths and nodes anew if `replan`; a lens that fails is taken back to its last good
    /// numbers.
    ///
    /// # Errors
    /// A lens that fails and is the last good one.
    pub fn renderer(&mut self, plan: &RenderPlan, replan: bool) -> Result<Renderer> {
        if replan && let Ok(renderer) = Renderer::replanned(&self.lens, plan) {
            return Ok(renderer);
        }
        match Renderer::new(&self.lens, plan) {
            Err(_) if self.lens != self.good => {
                self.take_back();
                Renderer::new(&self.lens, plan)
            }
            other => other,
        }
    }

    /// Makes the filters of a guided network anew for the one that `renderer` holds; a lens that has none keeps the old filters.
    pub(crate) fn refresh(&mut self, renderer: &Renderer, electronics: &Electronics) {
        if self.guide.facts().is_none() {
            return;
        }
        let started = Instant::now();
        if let Ok(guide) = Guide::new(self.guide.inputs(), renderer, electronics) {
            self.guide = guide;
            self.refreshed.0 += 1;
        }
        self.refreshed.1 += started.elapsed().as_secs_f64();
    }

    /// One step on `patches` (equal parts) through `renderer`, which holds the lens now, or through one `as_built` and its renderer: whose numbers are the lens's
    /// and something that does not depend on them. A rate of 0 of the lens holds it.
    ///
    /// # Errors
    /// A patch at a distance that the renderer was not made for; a network that fails.
    pub fn step(
        &mut self,
        renderer: &Renderer,
        as_built: Option<(&Lens, &Renderer)>,
        electronics: &Electronics,
        patches: &[Patch],
        [lens_rate, network_rate]: [f64; 2],
    ) -> Result<Report> {
        let own = renderer;
        let renderer = as_built.map_or(own, |(_, renderer)| renderer);
        let done = patches
            .par_iter()
            .map(|patch| forward::<f32>(renderer, electronics, patch))
            .collect::<Result<Vec<PatchForward<f32>>>>()?;
        // What the network sees: the middle of each patch, told.
        let told: Vec<(Array3<f32>, Record)> = patches
            .par_iter()
            .zip(&done)
            .map(|(patch, f)| self.guide.over_recorded(f.developed.view(), patch.region, patch.part))
            .collect();
        let truths: Vec<_> = patches.iter().zip(&done).map(|(patch, f)| f.truth.slice(middle(patch))).collect();
        let inputs: Vec<_> = told.iter().map(|(channels, _)| channels.view()).collect();
        let [input, target] = [&inputs, &truths].map(|all| ndarray::stack(Axis(0), all).expect("equal sizes"));
        let psnr = |a: ArrayView4<'_, f32>| l1_and_psnr(a.iter(), target.iter()).1;
        let input_psnr_db = psnr(input.slice(s![.., ..3, .., ..]));
        let depths = patches.iter().map(|p| renderer.plan.depth(p.scene.vergence)).collect::<Result<Vec<usize>>>()?;
        #[expect(clippy::cast_possible_truncation, reason = "weights of the order of one")]
        let weights: Vec<f32> = depths.iter().map(|d| self.distances.weight(*d) as f32).collect();
        let weights = weights.iter().any(|w| *w != 1.0).then_some(weights.as_slice());
        let clock = Instant::now();
        if lens_rate == 0.0 {
            let s = self.network.step_network_only(input.view(), target.view(), weights, network_rate)?;
            let loss = f64::from(s.loss);
            let network_seconds = clock.elapsed().as_secs_f64();
            self.see(&depths, s.output.view(), target.view());
            let output_psnr_db = psnr(s.output.view());
            return Ok(Report { loss, input_psnr_db, output_psnr_db, lens: None, network_seconds });
        }
        let s = self.network.step(input.view(), target.view(), weights, network_rate, true)?;
        let network_seconds = clock.elapsed().as_secs_f64();
        self.see(&depths, s.output.view(), target.view());
        // Back through imaging, patch by patch, and through the lens once.
        let bars: Vec<OpticsBar> = patches
            .par_iter()
            .zip(&done)
            .enumerate()
            .map(|(i, (patch, f))| {
                let x_bar = self.guide.over_vjp(&told[i].1, s.input_bar.index_axis(Axis(0), i));
                let mut t_bar = Array3::zeros(f.truth.raw_dim());
                t_bar.slice_mut(middle(patch)).assign(&s.target_bar.index_axis(Axis(0), i));
                forward_vjp(renderer, electronics, patch, f, x_bar.view(), t_bar.view())
            })
            .collect();
        let mut bar = OpticsBar::zeros(&renderer.optics);
        bars.iter().for_each(|b| bar.add(b));
        let lens = s.loss.is_finite().then(|| self.follow(own, as_built, &bar, lens_rate));
        let output_psnr_db = psnr(s.output.view());
        let loss = f64::from(s.loss);
        Ok(Report { loss, input_psnr_db, output_psnr_db, lens, network_seconds })
    }

    /// Takes in how good pictures at these distances were.
    fn see(&mut self, depths: &[usize], output: ArrayView4<'_, f32>, target: ArrayView4<'_, f32>) {
        for ((depth, output), target) in depths.iter().zip(output.outer_iter()).zip(target.outer_iter()) {
            self.distances.see(*depth, l1_and_psnr(output.iter(), target.iter()).0);
        }
    }

    /// Moves the lens against the gradient that `bar` pulls back to it, or to one `as_built`; `renderer` holds the lens itself.
    fn follow(
        &mut self,
        renderer: &Renderer,
        as_built: Option<(&Lens, &Renderer)>,
        bar: &OpticsBar,
        lens_rate: f64,
    ) -> Stepped {
        let (lens, through) = as_built.unwrap_or((&self.lens, renderer));
        let gradient = through.lens_gradient(lens, bar);
        self.noise.add(&self.steps.variables().gradient(&gradient));
        let darkest = self.darkest(renderer);
        let stepped = self.steps.step(&self.lens, gradient, lens_rate * self.damping, &darkest);
        self.good = self.lens.clone();
        match &stepped.lens {
            Some(moved) => {
                self.lens = moved.clone();
                self.damping = (self.damping * 1.02).min(1.0);
            }
            None => self.take_back(),
        }
        stepped
    }

    /// Rows that keep the illumination from falling below what is asked, of places that are near it.
    fn darkest(&self, renderer: &Renderer) -> Vec<Linear> {
        let Some(least) = self.least_illumination else { return Vec::new() };
        let optics = &renderer.optics;
        let (radius, channels) = (renderer.plan.frame.max_radius_mm(), optics.channels());
        #[expect(clippy::cast_precision_loss, reason = "a handful")]
        let share = vec![1.0 / channels as f64; channels];
        let variables = self.steps.variables();
        let mut rows = Vec::new();
        for k in 1..=DARK {
            let at = SensorPoint::along([1.0, 0.0], radius * f64::from(k) / f64::from(DARK));
            let value: f64 = optics.relative_illumination(at).iter().zip(&share).map(|(v, w)| v * w).sum();
            if value < least + NEAR {
                let mut bar = OpticsBar::zeros(optics);
                optics.relative_illumination_vjp(std::iter::once((at, share.as_slice())), &mut bar);
                let a = variables.gradient(&renderer.lens_gradient(&self.lens, &bar));
                // No more than a tenth of what is missing at a time: rows are linear, illumination is not.
                let b = if value < least { 0.1 * (least - value) } else { least - value };
                if a.iter().all(|v| v.is_finite()) {
                    rows.push(Linear { a, b });
                }
            }
        }
        rows
    }

    fn take_back(&mut self) {
        self.rejected += 1;
        self.damping *= 0.5;
        self.lens = self.good.clone();
        self.steps.forget();
    }
}

pub(in crate::design) mod images;

#[cfg(test)]
mod tests;
