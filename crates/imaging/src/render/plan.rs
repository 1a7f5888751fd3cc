//! How a lens is rendered: what is traced, how wide and how fine kernels are, where they stand.
//!
//! A [`RenderPlan`] belongs to a lens, a frame and object distances, and serves any number of scenes, whole pictures and
//! patches. It is held while a design moves the lens, and made anew now and then
//! ([`Renderer::replanned`](super::Renderer::replanned)).

use serde::{Deserialize, Serialize};

use super::coarse::raster;
use super::nodes::Nodes;
use crate::frame::Frame;
use crate::plane::Region;
use crate::render::node_grid::NodeGrid;
use crate::sensor::spectrum::SpectralDensity;
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::table::Tolerance;
use isoplanat_optics::psf::{Model, Optics, OpticsSpec, Quadrature, SensorPoint};

/// Largest error of rays between the table's radii, pixels.
const LANDING_ERROR_PX: f64 = 0.02;
/// Largest error of their étendue between the table's radii, relative.
const WEIGHT_ERROR: f64 = 1e-4;
/// Radii of the illumination, less one.
#[doc(hidden)]
pub const ILLUMINATIONS: u32 = 192;
/// Dense points of the first look, which measures how wide kernels are.
const LOOK: usize = 2000;
/// Coarsest cells, pixels.
const COARSEST: usize = 64;
/// How many `λ/NA` a window follows light that diffraction bends: 0.5 % of a perfect lens's lies beyond.
const FARTHEST: f64 = 20.0;
/// Half-widths in the coarsest cells, at most, over those wished for; and in pixels: a plan samples all that a kernel sees, pixel by pixel, a few times, which takes
/// seconds then.
const WIDEST: usize = 4;
const WIDEST_PX: usize = 6144;

/// How finely each approximation is made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Scene samples a pixel along each axis: 1, 2, 4 or 8; one where cells are larger than pixels.
    pub samples: usize,
    /// Wavelengths over the sensor's response.
    pub wavelengths: usize,
    /// Degree of the polynomials over the stop.
    pub degree: usize,
    /// Dense points of the stop a wavelength.
    pub dense: usize,
    /// Relative L2 error of a kernel interpolated between nodes.
    pub node_error: f64,
    /// Share of the light that may fall outside the kernel's half-width.
    pub outside: f64,
    /// Largest half-width of a kernel in cells: wider ones are computed on cells of 2, 4, … pixels.
    pub cells: usize,
    /// By what kernels are made.
    #[serde(default)]
    pub diffraction: Model,
}

impl Settings {
    /// Fine in every respect: what the others are measured against.
    pub const FINE: Self = Self {
        samples: 4,
        wavelengths: 12,
        degree: 9,
        dense: 3000,
        node_error: 0.02,
        outside: 1e-4,
        cells: 160,
        diffraction: Model::Rays,
    };
    /// For training pairs of a fixed lens.
    pub const TRAINING: Self = Self {
        samples: 1,
        wavelengths: 7,
        degree: 7,
        dense: 1200,
        node_error: 0.05,
        outside: 2e-3,
        cells: 64,
        diffraction: Model::Rays,
    };
    /// For the steps of a design.
    pub const DESIGN: Self = Self {
        samples: 1,
        wavelengths: 5,
        degree: 7,
        dense: 400,
        node_error: 0.05,
        outside: 1e-2,
        cells: 64,
        diffraction: Model::Rays,
    };

    /// Ladder of scene samples a pixel.
    #[doc(hidden)]
    pub const SAMPLES: [usize; 4] = [1, 2, 4, 8];
    /// Ladder of wavelengths.
    #[doc(hidden)]
    pub const WAVELENGTHS: [usize; 6] = [3, 4, 5, 7, 9, 12];
    /// Ladder of dense points.
    #[doc(hidden)]
    pub const DENSE: [usize; 4] = [200, 500, 1200, 3000];
    /// Ladder of node errors.
    #[doc(hidden)]
    pub const NODE_ERRORS: [f64; 5] = [0.4, 0.2, 0.1, 0.05, 0.02];
    /// Ladder of light outside.
    #[doc(hidden)]
    pub const OUTSIDE: [f64; 5] = [2e-2, 5e-3, 2e-3, 5e-4, 1e-4];
}

/// One object distance.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthPlan {
    /// 1/distance before the first vertex, 1/mm.
    pub vergence: f64,
    /// Pixels along a cell's side: 1, or more where kernels are wide.
    pub bin: usize,
    /// Scene samples a cell along each axis.
    pub samples: usize,
    /// Kernel half-width, cells.
    pub half_width: usize,
    /// The frame in cells.
    pub raster: Frame,
    /// Where kernels stand, in cells.
    pub grid: NodeGrid,
    /// Interpolation error between them that was seen, relative L2.
    pub node_error: f64,
}

impl DepthPlan {
    /// Kernel size, cells.
    #[doc(hidden)]
    pub fn size(&self) -> usize {
        2 * self.half_width + 1
    }

    /// Light of a pixel comes from at most so many pixels away.
    #[doc(hidden)]
    pub fn reach_px(&self) -> usize {
        self.bin * (self.half_width + if self.bin > 1 { 3 } else { 0 })
    }
}

/// How a lens is rendered on a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderPlan {
    /// The sensor's frame.
    pub frame: Frame,
    /// How finely.
    pub settings: Settings,
    /// What is traced.
    pub spec: OpticsSpec,
    /// Errors of the table between its knots, as seen.
    pub table_error: Tolerance,
    /// Object distances.
    pub depths: Vec<DepthPlan>,
}

/// The quadrature of `n` wavelengths over `channels` of the sensor.
#[doc(hidden)]
pub fn quadrature(density: &SpectralDensity, n: usize, channels: &[usize]) -> Quadrature {
    let spectrum = density.quadrature(n);
    let weight = channels.iter().map(|c| spectrum.weight[*c].clone()).collect();
    Quadrature { nm: spectrum.wavelength_nm, weight }
}

/// The frame a lens file states.
///
/// # Errors
/// A raster that is none.
pub fn frame_of(lens: &Lens) -> Result<Frame> {
    Frame::centred(lens.sensor.columns, lens.sensor.rows, lens.sensor.pitch_mm())?.with_axis(lens.sensor.axis_px)
}

/// `lens` over `frame` for objects at `vergences`, illuminated at `illuminations + 1` radii, at knots that hold the table's tolerance; and the
/// table's errors.
///
/// # Errors
/// As [`Optics::compute`]; no light on the axis.
#[doc(hidden)]
pub fn optics(
    lens: &Lens,
    frame: &Frame,
    vergences: &[f64],
    quadrature: Quadrature,
    (degree, illuminations): (usize, u32),
) -> Result<(Optics, Tolerance)> {
    let radii_mm = vec![0.0, frame.max_radius_mm()];
    lens.require_reach(frame.max_radius_mm())?;
    let tolerance = Tolerance { landing_mm: LANDING_ERROR_PX * frame.pitch_mm, weight: WEIGHT_ERROR };
    let spec = OpticsSpec {
        radii_mm,
        vergences: vergences.to_vec(),
        quadrature,
        degree,
        lit: false,
        illuminations,
        diffraction: Model::Rays,
    };
    let (optics, errors) = Optics::adapted(lens, spec, tolerance)?;
    // White is the light on the axis; of rays that all end at an aperture much smaller than the others there is none, though some may come through beside them.
    let white: f64 = optics.illumination().at(SensorPoint::AXIS).iter().sum();
    if white.is_nan() || white <= 0.0 {
        let found = "no ray that was tried comes through on the axis";
        let allowed = "clear apertures of the size of the beam; rays from the sensor try more (--method monte-carlo)";
        return Err(Error::bad(lens.file(), "semi_diameter", found, allowed));
    }
    Ok((optics, errors))
}

impl RenderPlan {
    /// Widths and nodes for `optics` over the whole of `frame`; `table_error` is what [`optics`](optics()) saw.
    ///
    /// # Errors
    /// None for a valid frame.
    pub(super) fn of(optics: &Optics, frame: &Frame, settings: Settings, table_error: Tolerance) -> Result<Self> {
        let whole = Region::whole(frame);
        let depths = (0..optics.spec.vergences.len())
            .map(|depth| depth_plan(optics, frame, depth, whole, settings, 0.0))
            .collect::<Result<_>>()?;
        Ok(Self { frame: frame.clone(), settings, spec: optics.spec.clone(), table_error, depths })
    }

    /// The plan's entry for objects at `vergence`.
    ///
    /// # Errors
    /// A distance that the plan was not made for.
    pub fn depth(&self, vergence: f64) -> Result<usize> {
        let near = |v: &f64| (v - vergence).abs() <= 1e-12 * v.abs().max(vergence.abs());
        self.spec.vergences.iter().position(near).ok_or_else(|| {
            let found = format!("{} mm", vergence.recip());
            let known: Vec<String> = self.spec.vergences.iter().map(|v| format!("{} mm", v.recip())).collect();
            isoplanat_base::error::Error::bad(
                "",
                "object distance",
                found,
                format!("one the plan was made for: {}", known.join(", ")),
            )
        })
    }
}

/// Pixels along the side of cells in which a half-width of `half` pixels is at most `cells`.
pub(crate) fn bin_of(half: usize, cells: usize) -> usize {
    let mut bin = 1;
    while half.div_ceil(bin) > cells && bin < COARSEST {
        bin *= 2;
    }
    bin
}

/// Half-widths, pixels, of the kernels that hold all but each of `shares` of the light over the part `region` of the frame.
pub(super) fn widths(optics: &Optics, frame: &Frame, depth: usize, region: Region, shares: &[f64]) -> Vec<usize> {
    let rays = ray_widths(optics, frame, depth, region, shares);
    bent(&rays, optics.bending_mm() / frame.pitch_mm, shares)
}

/// The same of rays alone.
pub(super) fn ray_widths(optics: &Optics, frame: &Frame, depth: usize, region: Region, shares: &[f64]) -> Vec<usize> {
    let look = optics.form(LOOK, 1, 1, frame.pitch_mm);
    optics.half_widths(&look, depth, shares, region.radii_mm(frame, 0.0))
}

/// `halves` (pixels) that follow light which diffraction bends, too: by `λ/NA`, of `bend` pixels.
pub(super) fn bent(halves: &[usize], bend: f64, shares: &[f64]) -> Vec<usize> {
    let all = halves.iter().zip(shares);
    all.map(|(half, share)| half.saturating_add((bend * reach(*share)).ceil() as usize)).collect()
}

/// How many `λ/NA` from the centre of a perfect lens's kernel all but a share of its light is: `1/(π² share)`, as far as a window follows it; what lies beyond is put
/// back evenly over the window.
fn reach(share: f64) -> f64 {
    (std::f64::consts::PI.powi(2) * share).recip().clamp(2.0, FARTHEST)
}

/// Half-width in cells of `bin` pixels: there box and tent are wider, and the interpolation reads on.
pub(super) fn in_cells(half: usize, bin: usize) -> usize {
    if bin == 1 { half } else { half.div_ceil(bin) + 1 }
}

/// Cells for kernels of half-width `half` pixels; no nodes but one.
///
/// # Errors
/// A blur that even the coarsest cells leave wider than any window.
pub(super) fn unplaced(
    optics: &Optics,
    frame: &Frame,
    depth: usize,
    half: usize,
    settings: Settings,
) -> Result<DepthPlan> {
    let vergence = optics.spec.vergences[depth];
    let bin = bin_of(half, settings.cells);
    let widest = (WIDEST * settings.cells * COARSEST).min(WIDEST_PX);
    if half > widest {
        let found = format!("{} pixels wide at {} mm", 2 * half + 1, vergence.recip());
        let allowed = format!("at most {} pixels; larger pixels, a smaller f-number or another distance", 2 * widest);
        return Err(isoplanat_base::error::Error::bad("", "blur", found, allowed));
    }
    let samples = if bin == 1 { settings.samples } else { 1 };
    let (raster, grid) = (raster(frame, bin)?, NodeGrid::single(0, 0));
    Ok(DepthPlan { vergence, bin, samples, half_width: in_cells(half, bin), raster, grid, node_error: f64::INFINITY })
}

/// Width and nodes for one object distance, over the part `region` of the frame, where diffraction bends light by `bend_mm` more than by what `optics` have of it.
///
/// # Errors
/// A blur that even the coarsest cells leave wider than any window.
pub(crate) fn depth_plan(
    optics: &Optics,
    frame: &Frame,
    depth: usize,
    region: Region,
    settings: Settings,
    bend_mm: f64,
) -> Result<DepthPlan> {
    let shares = [settings.outside];
    let half = bent(&widths(optics, frame, depth, region, &shares), bend_mm / frame.pitch_mm, &shares)[0];
    let plan = unplaced(optics, frame, depth, half, settings)?;
    let around = super::coarse::cells(region, plan.bin);
    let (tolerance, dense) = (settings.node_error, settings.dense.min(800));
    // Diffraction blurs what rays tell from place to place, and costs more: nodes that serve rays serve it.
    let of_rays = optics.spec.diffraction.diffracts().then(|| optics.clone().of_rays());
    let placed = of_rays.as_ref().unwrap_or(optics);
    let mut nodes = Nodes::coarse(placed, depth, &plan.raster, around, plan.size(), tolerance, dense);
    nodes.refine(tolerance);
    let (grid, node_error) = (nodes.grid.clone(), nodes.error);
    Ok(DepthPlan { grid, node_error, ..plan })
}
