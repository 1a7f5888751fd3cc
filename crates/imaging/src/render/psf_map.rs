//! PSFs of a lens over a frame in the colours of a sensor, in the forms that other programs train and restore with.
//!
//! Three forms, each of one lens at one object distance:
//! - [`PsfPlaces::Heights`]: image heights from the axis to the frame's corner, the outward direction downwards. A network's data sets hold `psf [K, 3, H, W]`,
//!   `illumination [K]` and `distortion [K]` of each lens so.
//! - [`PsfPlaces::Grid`]: rows and columns of kernels that stand evenly over the frame, each as it is seen in the picture.
//! - [`PsfPlaces::Nodes`] and [`PsfPlaces::Filters`]: as few kernels as a bilinear interpolation needs, or so many. With [`PsfMap::multipliers`] they are a
//!   space-varying blur by themselves: `y = Σ_k w_k ⊙ (h_k * x)`, which is what [`super::Renderer`] computes at one scene sample a pixel.
//!
//! Kernels are for a plain convolution, `y(p) = Σ_m h(m) x(p − m)`, `m = 0` in the middle: code that correlates (`conv2d` of most frameworks) flips them. They are integrated
//! over the pixel and over the bilinear filter of a scene sampled at the pitch. Their middle is where distortion alone would put the light. A kernel sums to one less
//! what falls outside its window; falling light is kept beside it.

mod arrays;

use ndarray::{Array1, Array2, Array3, Array4, Axis};
use rayon::prelude::*;

use super::node_grid::NodeGrid;
use super::nodes::{Nodes, centre};
use super::plan::{ILLUMINATIONS, optics, quadrature, ray_widths};
use crate::frame::Frame;
use crate::plane::Region;
use crate::sensor::spectrum::SpectralDensity;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::memory::{BASE, Limit, product, threads};
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::bent::WaveFigures;
use isoplanat_optics::psf::{Model, Optics, SensorPoint};

#[doc(hidden)]
pub use arrays::Values;

/// Degree of the polynomials over the stop.
const DEGREE: usize = 9;
/// Share of the light that an automatic window may lose.
const LOST: f64 = 1e-3;
/// Largest automatic window, pixels.
const LARGEST: usize = 1023;
/// Dense points of the stop while nodes are placed, at most.
const PLACING: usize = 800;

/// Where kernels stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PsfPlaces {
    /// So many image heights, evenly from the axis to the frame's corner.
    Heights(usize),
    /// Rows and columns of places, evenly from the frame's first pixel to its last; one stands in the middle.
    Grid([usize; 2]),
    /// As [`Self::Grid`], for filters and multipliers.
    Filters([usize; 2]),
    /// Where interpolation needs them, for filters and multipliers: the relative L2 error of a kernel between its neighbours.
    Nodes(f64),
}

/// What to compute.
#[derive(Clone, Debug)]
pub struct PsfMapRequest {
    /// Where kernels stand.
    pub places: PsfPlaces,
    /// 1 / object distance before the first vertex, 1/mm.
    pub vergence: f64,
    /// Kernel size in pixels, odd; `None` takes what holds 99.9 % of the light, up to 1023.
    pub size: Option<usize>,
    /// Rays per kernel and wavelength.
    pub rays: usize,
    /// Wavelengths over the sensor's response.
    pub wavelengths: usize,
    /// Whether kernels are made by diffraction, in place of rays.
    pub diffraction: bool,
    /// What all of it may take.
    pub memory: Limit,
}

impl PsfMapRequest {
    /// Kernels at `places` of `lens` at its own distance, 16384 rays and 7 wavelengths each, within the memory that this process can get.
    pub fn new(lens: &Lens, places: PsfPlaces) -> Self {
        let vergence = lens.object_vergence;
        Self {
            places,
            vergence,
            size: None,
            rays: 16_384,
            wavelengths: 7,
            diffraction: false,
            memory: Limit::of_process(),
        }
    }
}

/// Kernels in the colours of a sensor, with what belongs to them.
#[derive(Clone, Debug)]
pub struct PsfMap {
    /// What was asked for.
    pub request: PsfMapRequest,
    /// The frame.
    pub frame: Frame,
    /// Where kernels stand in it, where they stand on pixels; of image heights none.
    pub grid: Option<NodeGrid>,
    /// `[place, channel, row, col]`; each channel sums to one less what fell outside.
    pub kernels: Array4<f32>,
    /// Share of each channel's light outside the window, `[place, channel]`.
    pub outside: Array2<f64>,
    /// Irradiance of white relative to that on the axis, `[place, channel]`.
    pub illumination: Array2<f64>,
    /// Distance of each place from the axis on the sensor, mm.
    pub height_mm: Array1<f64>,
    /// Image height of each place over the one without distortion, less 1.
    pub distortion: Array1<f64>,
    /// What is to be told of kernels by diffraction; nothing of rays.
    pub diffraction: Option<WaveFigures>,
    optics: Optics,
}

impl PsfMap {
    /// Traces `lens` over `frame` and makes the kernels.
    ///
    /// ```
    /// use isoplanat_imaging::frame::Frame;
    /// use isoplanat_imaging::render::psf_map::{PsfMap, PsfMapRequest, PsfPlaces};
    /// use isoplanat_imaging::sensor::{Sensor, spectrum::SpectralDensity};
    /// use isoplanat_optics::lens::builtin;
    ///
    /// let lens = builtin::lens("cooke_triplet")?;
    /// let frame = Frame::centred(96, 64, 0.3)?;
    /// let request = PsfMapRequest { rays: 1000, ..PsfMapRequest::new(&lens, PsfPlaces::Heights(4)) };
    /// let map = PsfMap::compute(&lens, &frame, &SpectralDensity::new(&Sensor::generic()), &request)?;
    /// assert_eq!(map.kernels.shape()[..2], [4, 3]);
    /// assert!((map.height_mm[3] - frame.max_radius_mm()).abs() < 1e-12 && map.illumination[[0, 1]] == 1.0);
    /// # Ok::<(), isoplanat_base::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// A lens without symmetry, or without light on the axis; one made for other light; places, sizes and rays that are none; a window larger than 1023 pixels; more
    /// than memory holds.
    pub fn compute(lens: &Lens, frame: &Frame, density: &SpectralDensity, request: &PsfMapRequest) -> Result<Self> {
        request.check()?;
        density.require(lens)?;
        let rule = quadrature(density, request.wavelengths, &[0, 1, 2]);
        let (optics, _) = optics(lens, frame, &[request.vergence], rule, (DEGREE, ILLUMINATIONS))?;
        let whole = Region::whole(frame);
        let optics = if request.diffraction { optics.diffracting(lens, Model::Waves)? } else { optics };
        let size = match request.size {
            Some(size) => size,
            None => {
                let half = ray_widths(&optics, frame, 0, whole, &[LOST])[0];
                2 * half.saturating_add(bent_px(&optics, 0, frame)).min(usize::MAX / 4) + 1
            }
        };
        if size > LARGEST && request.size.is_none() {
            let share = if request.diffraction { "99 %" } else { "99.9 %" };
            let found = format!("{size} pixels to hold {share} of the light");
            return Err(Error::bad(
                lens.file(),
                "kernel size",
                found,
                format!("a stated size (--size); automatic up to {LARGEST}"),
            ));
        }
        // As pictures place them: by rays, whose kernels differ more from place to place.
        let grid = request.places.grid(&optics.clone().of_rays(), frame, size, request.rays);
        let points: Vec<SensorPoint> = match (&grid, request.places) {
            (None, PsfPlaces::Heights(count)) => heights(frame, count),
            (grid, _) => {
                grid.iter().flat_map(|g| (0..g.len()).map(|n| g.pixel(n))).map(|(r, c)| centre(frame, r, c)).collect()
            }
        };
        let count = points.len();
        let multipliers = if request.places.are_filters() { [frame.rows, frame.columns] } else { [0, 0] };
        let (what, instead) =
            (format!("{count} kernels of {size} × {size}"), "fewer places, a smaller size, or a smaller frame");
        let making = optics.bending_bytes_at(0, &points, (size, frame.pitch_mm));
        request.memory.allow(&what, bytes(count, size, multipliers).saturating_add(making), instead)?;
        let form = optics.form(request.rays, size, 1, frame.pitch_mm);
        #[expect(clippy::cast_possible_truncation, reason = "kernels leave as f32")]
        let single = |_: usize, kernel: &[f64], outside: &[f64]| {
            (kernel.iter().map(|v| *v as f32).collect::<Vec<f32>>(), outside.to_vec())
        };
        let (made, diffraction) = optics.kernels_told_each(&form, 0, &points, single);
        let (kernels, outside): (Vec<Vec<f32>>, Vec<Vec<f64>>) = made.into_iter().unzip();
        let shaped = |e: ndarray::ShapeError| Error::Internal(e.to_string());
        let kernels = Array4::from_shape_vec((count, 3, size, size), kernels.concat()).map_err(shaped)?;
        let outside = Array2::from_shape_vec((count, 3), outside.concat()).map_err(shaped)?;
        let light: Vec<Vec<f64>> = points.par_iter().map(|p| optics.relative_illumination(*p)).collect();
        let illumination = Array2::from_shape_vec((count, 3), light.concat()).map_err(shaped)?;
        let map = &optics.maps[0];
        // The image height without distortion is the slope over its ratio on the axis.
        let distortion = points.iter().map(|p| map.ratio(0.0) / map.ratio(p.radius_mm()) - 1.0).collect();
        let height_mm = points.iter().map(|p| p.radius_mm()).collect();
        let (request, frame) = (request.clone(), frame.clone());
        Ok(Self { request, frame, grid, kernels, outside, illumination, height_mm, distortion, diffraction, optics })
    }

    /// What each kernel's picture is multiplied by, `[place, channel, row, col]` over the frame: its window, which falls linearly to nothing at its neighbours, times the
    /// relative illumination. `None` of image heights.
    pub fn multipliers(&self) -> Option<Array4<f32>> {
        let grid = self.grid.as_ref()?;
        let frame = &self.frame;
        let light: Array3<f32> =
            super::light::Light::new(&self.optics, frame).over(frame, Region::whole(frame), &[0, 1, 2]);
        let mut out = Array4::zeros((grid.len(), 3, frame.rows, frame.columns));
        out.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(n, mut planes)| {
            for ((c, i, j), v) in planes.indexed_iter_mut() {
                #[expect(clippy::cast_possible_truncation, reason = "single precision")]
                let window = grid.window(n, i.cast_signed(), j.cast_signed()) as f32;
                *v = window * light[[c, i, j]];
            }
        });
        Some(out)
    }

    /// Relative illumination of each place, the mean over the channels.
    #[doc(hidden)]
    pub fn white(&self) -> Array1<f64> {
        self.illumination.sum_axis(Axis(1)) / 3.0
    }
}

impl PsfMapRequest {
    fn check(&self) -> Result<()> {
        let bad = |key: &str, found: String, allowed: &str| Err(Error::bad("", key, found, allowed));
        match self.places {
            PsfPlaces::Heights(count) if !(1..=4096).contains(&count) => {
                return bad("heights", count.to_string(), "1 to 4096");
            }
            PsfPlaces::Grid(sides) | PsfPlaces::Filters(sides) if sides.iter().any(|n| !(1..=512).contains(n)) => {
                return bad("grid", format!("{} × {}", sides[0], sides[1]), "1 to 512 rows and columns");
            }
            PsfPlaces::Nodes(error) if !(1e-4..=1.0).contains(&error) => {
                return bad("node error", error.to_string(), "0.0001 to 1");
            }
            _ => {}
        }
        if !(self.vergence >= 0.0 && self.vergence.is_finite()) {
            return bad("object distance", format!("{} mm", self.vergence.recip()), "positive distances, or inf");
        }
        if let Some(size) = self.size.filter(|s| s % 2 == 0 || *s > 2047) {
            return bad("kernel size", size.to_string(), "an odd number of pixels up to 2047");
        }
        if !(16..=1_000_000).contains(&self.rays) {
            return bad("rays", self.rays.to_string(), "16 to 1000000");
        }
        if !(1..=64).contains(&self.wavelengths) {
            return bad("wavelengths", self.wavelengths.to_string(), "1 to 64");
        }
        Ok(())
    }
}

impl PsfPlaces {
    /// Whether filters and multipliers are made.
    fn are_filters(self) -> bool {
        matches!(self, Self::Filters(_) | Self::Nodes(_))
    }

    /// Pixels of the kernels; of image heights none.
    fn grid(self, optics: &Optics, frame: &Frame, size: usize, rays: usize) -> Option<NodeGrid> {
        match self {
            Self::Heights(_) => None,
            Self::Grid([rows, cols]) | Self::Filters([rows, cols]) => {
                Some(NodeGrid { row_knots: even(frame.rows, rows), col_knots: even(frame.columns, cols) })
            }
            Self::Nodes(error) => {
                let mut nodes = Nodes::coarse(optics, 0, frame, Region::whole(frame), size, error, rays.min(PLACING));
                nodes.refine(error);
                Some(nodes.grid)
            }
        }
    }
}

/// How far light bends beyond its rays at the frame's axis and corner, pixels.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
fn bent_px(optics: &Optics, depth: usize, frame: &Frame) -> usize {
    let ends = [SensorPoint::AXIS, SensorPoint::along([0.0, 1.0], frame.max_radius_mm())];
    (optics.bending_mm_at(depth, &ends) / frame.pitch_mm).ceil() as usize
}

/// `count` pixels of `n`, evenly from the first to the last; one stands in the middle. No pixel twice.
fn even(n: usize, count: usize) -> Vec<isize> {
    let last = n.saturating_sub(1);
    if count == 1 {
        return vec![(n / 2).cast_signed()];
    }
    let mut knots: Vec<isize> =
        (0..count).map(|k| ((2 * k * last + count - 1) / (2 * (count - 1))).cast_signed()).collect();
    knots.dedup();
    knots
}

/// Image heights from the axis to the corner, downwards.
fn heights(frame: &Frame, count: usize) -> Vec<SensorPoint> {
    let corner = frame.max_radius_mm();
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let at = |k: usize| corner * k as f64 / (count.max(2) - 1) as f64;
    (0..count).map(|k| SensorPoint::along([0.0, 1.0], at(k))).collect()
}

/// Bytes, from above, of so many kernels of three channels, as they are made and once more while they are put together, and of multipliers over a frame.
fn bytes(count: usize, size: usize, [rows, columns]: [usize; 2]) -> u64 {
    let kernels = product(&[count, 3, size, size, 3 * size_of::<f32>()]);
    let making = product(&[threads(), 3, size, size, size_of::<f32>() + size_of::<f64>()]);
    // Once as they are made, once with their axes exchanged.
    let multipliers = product(&[count, 3, rows, columns, 2 * size_of::<f32>()]);
    BASE.saturating_add(kernels).saturating_add(making).saturating_add(multipliers)
}

#[cfg(test)]
mod tests;
