//! What a render needs, from lens, frame and sensor: fitted field, kernel size, wavelengths, pupil samples.

use super::field_map::{failed, field_at, fit_distortion, slope_at_height};
use super::frame::Frame;
use super::render::RenderPlan;
use super::spectrum::{SpectralDensity, Spectrum};
use super::white::on_axis_of;
use crate::error::Result;
use crate::lens::Lens;
use crate::psf::grid::{PsfGrid, PsfNode, PsfPlan};
use crate::psf::pupil::PupilSampling;

/// How finely to sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Degree of the pupil polynomial.
    pub degree: usize,
    /// Dense pupil points.
    pub dense: usize,
    /// Wavelengths over the sensor's response.
    pub wavelengths: usize,
    /// Distance between PSF nodes, pixels.
    pub spacing: usize,
    /// Energy that may fall outside the kernel's half-width at any node.
    pub outside: f64,
    /// Largest kernel half-width, pixels.
    pub max_half_width: usize,
}

impl Quality {
    /// For final renders: fine in every respect.
    pub const FINE: Self =
        Self { degree: 9, dense: 3000, wavelengths: 9, spacing: 32, outside: 2e-4, max_half_width: 200 };
    /// For training pairs of a fixed lens.
    pub const TRAINING: Self =
        Self { degree: 7, dense: 1200, wavelengths: 7, spacing: 64, outside: 2e-3, max_half_width: 60 };
    /// For the steps of a design.
    pub const DESIGN: Self =
        Self { degree: 7, dense: 500, wavelengths: 5, spacing: 112, outside: 5e-3, max_half_width: 48 };
}

/// The frame a lens file states.
pub fn frame_of(lens: &Lens) -> Result<Frame> {
    Frame::centred(lens.sensor.columns, lens.sensor.rows, lens.sensor.pitch_mm())?.with_axis(lens.sensor.axis_px)
}

/// Object slope up to which the distortion is fitted for `frame`: 2 % beyond its farthest corner.
pub fn field_slope(lens: &Lens, vergence: f64, frame: &Frame) -> Result<f64> {
    slope_at_height(lens, vergence, 1.02 * frame.max_radius_mm())
}

/// A plan for rendering `lens` on `frame`, objects at `vergence`; `max_slope` may be held from an earlier plan.
pub fn plan(
    lens: &Lens,
    vergence: f64,
    frame: &Frame,
    density: &SpectralDensity,
    quality: Quality,
    max_slope: Option<f64>,
) -> Result<RenderPlan> {
    let spectrum: Spectrum = density.quadrature(quality.wavelengths);
    let max_slope = match max_slope {
        Some(s) => s,
        None => field_slope(lens, vergence, frame)?,
    };
    let mut plan = RenderPlan {
        psf: PsfPlan {
            sampling: PupilSampling::new(quality.degree, quality.dense),
            size: 3,
            pitch_mm: frame.pitch_mm,
            wavelength_nm: spectrum.wavelength_nm,
            weight: spectrum.weight.to_vec(),
        },
        spacing: quality.spacing,
        max_slope,
        frame: frame.clone(),
        white: vec![1.0; 3],
    };
    // The kernel follows the widest PSF over the field.
    let distortion = fit_distortion(lens, vergence, max_slope)?;
    let radii: Vec<f64> = (0..8).map(|i| frame.max_radius_mm() * f64::from(i) / 7.0).collect();
    let slopes: Vec<f64> = radii.iter().map(|r| field_at(&distortion, *r).slope).collect();
    let nodes: Vec<PsfNode> = (0..radii.len()).map(|radius| PsfNode { radius, outward: [1.0, 0.0] }).collect();
    let probe = PsfGrid::compute(lens, vergence, &plan.psf, &slopes, &radii, &nodes)
        .map_err(|f| failed(lens, "PSF grid", f))?;
    let half = probe.half_width_px(&plan.psf, &radii, quality.outside).min(quality.max_half_width);
    plan.psf.size = 2 * half + 1;
    // What the grid's own level on the axis lacks to white there.
    let jacobian = field_at(&distortion, 0.0).jacobian;
    let ratio = |(exact, grid): (f64, &f64)| if exact > 0.0 { exact / (grid * jacobian) } else { 1.0 };
    plan.white = on_axis_of(lens, &plan.psf).into_iter().zip(&probe.throughput.row(0)).map(ratio).collect();
    Ok(plan)
}
