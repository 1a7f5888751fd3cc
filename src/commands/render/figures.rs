//! What a picture took, in numbers and in words.

use isoplanat::imaging::render::blur::Method;
use isoplanat::imaging::render::{ScenePlan, Seen};
use isoplanat::math::memory::words;
use isoplanat::psf::Model;
use isoplanat::report::table::significant;
use serde::Serialize;

/// Numbers of one picture.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub(super) enum Figures {
    /// By kernels and convolution.
    Grid(Box<GridFigures>),
    /// By rays from the sensor.
    Rays {
        /// Rays traced.
        rays: u64,
        /// Noise that they leave, root mean square relative to white.
        noise_rms: f64,
    },
}

/// Numbers of a picture by kernels.
#[derive(Clone, Debug, Serialize)]
pub(super) struct GridFigures {
    predicted_psnr_db: Option<f64>,
    holds: bool,
    scene_samples_per_px: usize,
    pixels_per_cell: usize,
    wavelengths: usize,
    pupil_degree: usize,
    pupil_points: usize,
    diffraction: Model,
    kernel_cells: usize,
    psf_nodes: usize,
    node_error: f64,
    radii_traced: usize,
    rays_traced: usize,
    method: &'static str,
    block_px: Option<usize>,
    pupil_residual: f64,
    traced_pupil_fraction: f64,
    chief_ray_residual_px: f64,
    memory_bytes: u64,
    planning_seconds: f64,
    kernels: usize,
    largest_energy_outside: f64,
}

impl GridFigures {
    /// Of a picture by `plan`, which took so many seconds to make.
    pub(super) fn new(plan: &ScenePlan, seen: Seen, memory_bytes: u64, planning_seconds: f64) -> Self {
        let (render, optics) = (&plan.renderer.plan, &plan.renderer.optics);
        let depth = &render.depths[0];
        let (method, block_px) = match plan.method {
            Method::Cells { block } => ("cells", Some(block)),
            Method::Direct => ("direct", None),
        };
        Self {
            predicted_psnr_db: plan.predicted_db,
            holds: plan.holds,
            scene_samples_per_px: depth.samples,
            pixels_per_cell: depth.bin,
            wavelengths: render.settings.wavelengths,
            pupil_degree: optics.spec.degree,
            pupil_points: render.settings.dense,
            diffraction: optics.spec.diffraction,
            kernel_cells: depth.size(),
            psf_nodes: depth.grid.len(),
            node_error: depth.node_error,
            radii_traced: optics.table().spec.radii_mm.len(),
            rays_traced: optics.table().rays,
            method,
            block_px,
            pupil_residual: optics.table().residual,
            traced_pupil_fraction: optics.table().kept(),
            chief_ray_residual_px: optics.maps[0].residual_mm / render.frame.pitch_mm,
            memory_bytes,
            planning_seconds,
            kernels: seen.kernels,
            largest_energy_outside: seen.outside,
        }
    }

    fn rows(&self) -> Vec<(&'static str, String)> {
        let percent = |share: f64| format!("{} %", significant(100.0 * share, 2));
        let cell = match self.pixels_per_cell {
            1 => "pixels".to_owned(),
            n => format!("cells of {n} × {n} pixels"),
        };
        let model = match self.diffraction {
            Model::Rays => "of rays",
            Model::Approximate => "of rays, with the open pupil's diffraction",
            Model::Waves => "by diffraction",
        };
        let nodes = match self.psf_nodes {
            1 => "one for the frame".to_owned(),
            n => format!("at {n} nodes (between them within {})", percent(self.node_error)),
        };
        let mut rows = Vec::new();
        if let Some(db) = self.predicted_psnr_db.filter(|db| db.is_finite()) {
            let held = if self.holds { "" } else { ", less than was asked for" };
            rows.push(("predicted", format!("{db:.1} dB{held}")));
        }
        let size = self.kernel_cells;
        rows.push(("kernels", format!("{size} × {size} {cell}, {nodes}, {model}")));
        rows.push(("light outside", format!("{} of a kernel's at most", percent(self.largest_energy_outside))));
        let samples = self.scene_samples_per_px;
        rows.push(("sampling", format!("{samples} × {samples} a pixel, {} wavelengths", self.wavelengths)));
        let rays = format!(
            "{} at {} sensor radii, {} points of the stop told by polynomials of degree {}",
            self.rays_traced, self.radii_traced, self.pupil_points, self.pupil_degree
        );
        rows.push(("rays", rays));
        let convolution = match self.block_px {
            Some(block) => format!("by FFT, blocks of {block} pixels"),
            None => "direct".to_owned(),
        };
        rows.push(("convolution", convolution));
        rows.push(("planning", format!("{:.2} s", self.planning_seconds)));
        rows.push(("memory", format!("{} at most", words(self.memory_bytes))));
        rows
    }
}

impl Figures {
    /// Names and texts, in the order in which they are read.
    pub(super) fn rows(&self) -> Vec<(&'static str, String)> {
        match self {
            Self::Grid(figures) => figures.rows(),
            Self::Rays { rays, noise_rms } => {
                vec![("rays", rays.to_string()), ("noise", format!("{} rms of white", significant(*noise_rms, 3)))]
            }
        }
    }
}
