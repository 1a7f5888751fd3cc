//! The joint design step: patches → render → network → L1 → network gradient at the image → imaging, PSF and trace
//! adjoints → lens (paper eq. 15), with Adam on both sides.
//!
//! A step whose rays fail, whose distortion folds or whose loss is not finite is taken back: the lens returns to its
//! last good numbers and its step is halved.

use ndarray::{Array4, Axis};

use super::chain::{Patch, forward, forward_vjp};
use super::constraint::Constraints;
use crate::error::Result;
use crate::imaging::render::RenderPlan;
use crate::imaging::simulate::Electronics;
use crate::lens::variables::Variables;
use crate::lens::{Lens, LensGradient, prescription};
use crate::network::Reconstructor;

/// Adam on the lens's scaled variables (f64).
#[derive(Clone, Debug)]
struct Adam {
    first: Vec<f64>,
    second: Vec<f64>,
    steps: i32,
}

impl Adam {
    fn new(count: usize) -> Self {
        Self { first: vec![0.0; count], second: vec![0.0; count], steps: 0 }
    }

    fn step(&mut self, x: &mut [f64], g: &[f64], rate: f64) {
        const B1: f64 = 0.9;
        const B2: f64 = 0.99;
        self.steps += 1;
        let (c1, c2) = (1.0 - B1.powi(self.steps), 1.0 - B2.powi(self.steps));
        for i in 0..x.len() {
            self.first[i] = B1 * self.first[i] + (1.0 - B1) * g[i];
            self.second[i] = B2 * self.second[i] + (1.0 - B2) * g[i] * g[i];
            x[i] -= rate * (self.first[i] / c1) / ((self.second[i] / c2).sqrt() + 1e-12);
        }
    }
}

/// Lens and network on their way.
pub struct Joint {
    /// The lens now.
    pub lens: Lens,
    /// The network now.
    pub network: Reconstructor,
    /// Which numbers are free.
    pub variables: Variables,
    /// What the lens must keep.
    pub constraints: Constraints,
    /// Steps that were taken back.
    pub rejected: usize,
    values: Vec<f64>,
    good: Vec<f64>,
    adam: Adam,
    damping: f64,
}

/// What a step did.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// Mean L1 loss of the batch after the network.
    pub loss: f64,
    /// Constraint penalty.
    pub penalty: f64,
    /// PSNR of the network's input against the truth, linear light, dB.
    pub input_psnr_db: f64,
    /// PSNR of its output.
    pub output_psnr_db: f64,
    /// Whether the lens moved.
    pub moved: bool,
}

impl Joint {
    /// Starts from `lens` and `network`.
    pub fn new(lens: Lens, network: Reconstructor, variables: Variables, constraints: Constraints) -> Self {
        let values = variables.values(&lens);
        let adam = Adam::new(values.len());
        Self { lens, network, variables, constraints, rejected: 0, good: values.clone(), values, adam, damping: 1.0 }
    }

    /// One step on `patches` (equal sizes). `lens_rate` 0 holds the lens.
    pub fn step(
        &mut self,
        plan: &RenderPlan,
        electronics: &Electronics,
        patches: &[Patch],
        lens_rate: f64,
        network_rate: f64,
    ) -> Result<Report> {
        // Forward, patch by patch; a lens that fails is taken back and tried no further in this step.
        let mut done = Vec::with_capacity(patches.len());
        for patch in patches {
            match forward::<f32>(&self.lens, plan, electronics, patch) {
                Ok(f) => done.push(f),
                Err(e) if self.values == self.good => return Err(e),
                Err(_) => {
                    self.take_back();
                    return self.step(plan, electronics, patches, 0.0, network_rate);
                }
            }
        }
        let batch = |pick: fn(&super::chain::PatchForward<f32>) -> &ndarray::Array3<f32>| -> Array4<f32> {
            let views: Vec<_> = done.iter().map(|f| pick(f).view()).collect();
            ndarray::stack(Axis(0), &views).expect("equal sizes")
        };
        let (input, target) = (batch(|f| &f.developed), batch(|f| &f.truth));
        let psnr = |a: &Array4<f32>| {
            let mse = a.iter().zip(&target).map(|(x, y)| f64::from(x - y).powi(2)).sum::<f64>() / a.len() as f64;
            -10.0 * mse.max(1e-12).log10()
        };
        if lens_rate == 0.0 {
            let s = self.network.step_network_only(input.view(), target.view(), network_rate)?;
            return Ok(Report {
                loss: f64::from(s.loss),
                penalty: 0.0,
                input_psnr_db: psnr(&input),
                output_psnr_db: psnr(&s.output),
                moved: false,
            });
        }
        let s = self.network.step(input.view(), target.view(), network_rate, true)?;
        // Back through optics, patch by patch.
        let mut gradient = LensGradient::zeros(&self.lens);
        for (i, (patch, f)) in patches.iter().zip(&done).enumerate() {
            let (x_bar, t_bar) = (s.input_bar.index_axis(Axis(0), i), s.target_bar.index_axis(Axis(0), i));
            gradient.add(&forward_vjp(&self.lens, plan, electronics, patch, f, x_bar, t_bar)?);
        }
        let penalty = self.constraints.penalty(&self.lens, &mut gradient);
        let g = self.variables.gradient(&gradient);
        let finite = s.loss.is_finite() && g.iter().all(|v| v.is_finite());
        if finite {
            self.good.clone_from(&self.values);
            self.adam.step(&mut self.values, &g, lens_rate * self.damping);
            self.damping = (self.damping * 1.02).min(1.0);
            let moved = self.variables.lens(&self.lens, &self.values);
            // Only a lens that a file may hold is accepted.
            match prescription::from_toml(&prescription::to_toml(&moved), &moved.name) {
                Ok(_) => self.lens = moved,
                Err(_) => self.take_back(),
            }
        }
        Ok(Report {
            loss: f64::from(s.loss),
            penalty,
            input_psnr_db: psnr(&input),
            output_psnr_db: psnr(&s.output),
            moved: finite,
        })
    }


    fn take_back(&mut self) {
        self.rejected += 1;
        self.damping *= 0.5;
        self.values.clone_from(&self.good);
        self.lens = self.variables.lens(&self.lens, &self.values);
        self.adam.first.fill(0.0);
    }
}
