//! Many kernels at once: computed over depth, field and wavelength, and shown as one picture.
//!
//! The field of a kernel set runs upwards from the axis: a kernel stands as it is seen in the upright picture, its
//! outward direction towards row 0.

use ndarray::{Array2, Array3, Array4, Array5, ArrayView3, Axis, s};

use super::field::{FieldLine, untraceable};
use crate::error::{Error, Result};
use crate::imaging::sensor::Sensor;
use crate::imaging::spectrum::Spectrum;
use crate::lens::Lens;
use crate::psf::grid::PsfNode;
use crate::psf::pupil::PupilSampling;
use crate::psf::{PsfGrid, PsfPlan};

/// Degree of the pupil polynomials.
const DEGREE: usize = 9;
/// Wavelengths of a picture in colour.
const COLOUR_NODES: usize = 7;
/// Share of the light that an automatic window may lose.
const LOST: f64 = 1e-3;
/// Largest automatic window, pixels.
const LARGEST: usize = 1023;

/// What to compute.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelRequest {
    /// Object distances before the first vertex, mm; infinity is allowed.
    pub depth_mm: Vec<f64>,
    /// Wavelengths, nm.
    pub wavelength_nm: Vec<f64>,
    /// Field points from the axis to the border.
    pub fields: usize,
    /// Kernel size in pixels, odd; `None` takes what holds 99.9 % of the light, up to 1023.
    pub size: Option<usize>,
    /// Pixel pitch, mm.
    pub pitch_mm: f64,
    /// Rays per kernel and wavelength.
    pub rays: usize,
}

/// Kernels of one wavelength each, with what belongs to them.
#[derive(Clone, Debug)]
pub struct KernelSet {
    /// What was asked for.
    pub request: KernelRequest,
    /// `[depth, field, wavelength, row, col]`; each sums to one less what fell outside.
    pub kernels: Array5<f32>,
    /// Étendue per unit object slope squared, `[depth, field, wavelength]`, mm².
    pub throughput: Array3<f64>,
    /// Share of the light outside the window, `[depth, field, wavelength]`.
    pub outside: Array3<f64>,
    /// Kernel centres: distance from the axis on the sensor, `[depth, field]`, mm.
    pub radius_mm: Array2<f64>,
    /// Object slope of each field point, `[depth, field]`.
    pub slope: Array2<f64>,
    /// Field angle at the paraxial entrance pupil, `[depth, field]`, degrees.
    pub angle_deg: Array2<f64>,
}

impl KernelSet {
    /// Traces everything `request` asks for.
    ///
    /// # Errors
    /// A lens that loses rays the fields need, or a distortion that folds (file left empty); a window that would be
    /// larger than 1023 pixels.
    pub fn compute(lens: &Lens, request: &KernelRequest) -> Result<Self> {
        lens.require_symmetry("the PSF grid")?;
        let channels = request.wavelength_nm.len();
        // One channel a wavelength.
        let weight = (0..channels).map(|c| (0..channels).map(|l| f64::from(u8::from(c == l))).collect()).collect();
        let grids = grids(lens, request, &request.wavelength_nm, weight)?;
        let size = grids[0].1.kernels.len_of(Axis(2));
        let (depths, fields) = (request.depth_mm.len(), request.fields);
        let mut set = Self {
            request: request.clone(),
            kernels: Array5::zeros((depths, fields, channels, size, size)),
            throughput: Array3::zeros((depths, fields, channels)),
            outside: Array3::zeros((depths, fields, channels)),
            radius_mm: Array2::zeros((depths, fields)),
            slope: Array2::zeros((depths, fields)),
            angle_deg: Array2::zeros((depths, fields)),
        };
        for (d, (line, grid)) in grids.iter().enumerate() {
            #[expect(clippy::cast_possible_truncation, reason = "kernels leave as f32")]
            set.kernels.index_axis_mut(Axis(0), d).assign(&grid.kernels.mapv(|v| v as f32));
            set.throughput.index_axis_mut(Axis(0), d).assign(&grid.throughput);
            set.outside.index_axis_mut(Axis(0), d).assign(&grid.outside);
            for f in 0..fields {
                set.radius_mm[[d, f]] = line.radius_mm[f];
                set.slope[[d, f]] = line.slope[f];
                set.angle_deg[[d, f]] = line.angle_deg[f];
            }
        }
        Ok(set)
    }
}

/// Kernels in the colours of the generic sensor, `[tile, channel, row, col]`, depth by depth and field by field; the
/// request's own wavelengths are not used.
pub fn colour_kernels(lens: &Lens, request: &KernelRequest) -> Result<Array4<f32>> {
    lens.require_symmetry("the PSF grid")?;
    let spectrum = Spectrum::quadrature(&Sensor::generic(), COLOUR_NODES);
    let grids = grids(lens, request, &spectrum.wavelength_nm, spectrum.weight.to_vec())?;
    let views: Vec<_> = grids.iter().map(|(_, g)| g.kernels.view()).collect();
    let all = ndarray::concatenate(Axis(0), &views).map_err(|e| Error::Internal(e.to_string()))?;
    #[expect(clippy::cast_possible_truncation, reason = "a picture")]
    Ok(all.mapv(|v| v as f32))
}

/// One grid a depth, all with the same window.
fn grids(
    lens: &Lens,
    request: &KernelRequest,
    wavelength_nm: &[f64],
    weight: Vec<Vec<f64>>,
) -> Result<Vec<(FieldLine, PsfGrid)>> {
    let mut plan = PsfPlan {
        sampling: PupilSampling::new(DEGREE, request.rays),
        size: request.size.unwrap_or(1),
        pitch_mm: request.pitch_mm,
        wavelength_nm: wavelength_nm.to_vec(),
        weight,
    };
    let nodes: Vec<PsfNode> = (0..request.fields).map(|radius| PsfNode { radius, outward: [0.0, -1.0] }).collect();
    let lines = request.depth_mm.iter().map(|d| FieldLine::new(lens, 1.0 / d, request.fields));
    let lines = lines.collect::<Result<Vec<_>>>()?;
    let compute = |plan: &PsfPlan, depth: f64, line: &FieldLine| {
        PsfGrid::compute(lens, 1.0 / depth, plan, &line.slope, &line.radius_mm, &nodes).map_err(untraceable)
    };
    if request.size.is_none() {
        let mut half = 1;
        for (depth, line) in request.depth_mm.iter().zip(&lines) {
            half = half.max(compute(&plan, *depth, line)?.half_width_px(&plan, &line.radius_mm, LOST));
        }
        if 2 * half + 1 > LARGEST {
            let found = format!("{} pixels to hold 99.9 % of the light", 2 * half + 1);
            return Err(Error::bad("", "kernel size", found, format!("state a size; automatic up to {LARGEST}")));
        }
        plan.size = 2 * half + 1;
    }
    let pairs = request.depth_mm.iter().zip(lines);
    pairs.map(|(depth, line)| compute(&plan, *depth, &line).map(|grid| (line, grid))).collect()
}

/// How kernels are shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Style {
    /// Exponent applied to values relative to the peak, before the sRGB curve; below 1 lifts faint halos.
    pub gamma: f32,
    /// Smallest side of a tile, pixels: smaller kernels are enlarged by a whole factor.
    pub min_tile: usize,
    /// Width of the lines between tiles, pixels.
    pub gap: usize,
}

impl Default for Style {
    fn default() -> Self {
        Self { gamma: 0.7, min_tile: 96, gap: 2 }
    }
}

/// Brightness of the lines between tiles, linear.
const LINE: f32 = 0.15;

/// Tiles `[tile, channel, row, col]` (one or three channels) side by side, `columns` to a row, each divided by its peak.
///
/// # Shapes
/// Result `[3, row, col]`, linear RGB in `[0, 1]`. The part of the window that no kernel reaches is cut off.
///
/// # Panics
/// If `columns` is 0 or the tiles have neither one nor three channels.
pub fn picture(tiles: &Array4<f32>, columns: usize, style: Style) -> Array3<f32> {
    let (count, channels, rows, _) = tiles.dim();
    assert!(columns > 0 && matches!(channels, 1 | 3), "{columns} columns, {channels} channels");
    let margin = empty_margin(tiles);
    let tiles = tiles.slice(s![.., .., margin..rows - margin, margin..rows - margin]);
    let size = rows - 2 * margin;
    let factor = style.min_tile.div_ceil(size.max(1)).max(1);
    let (side, step) = (size * factor, size * factor + style.gap);
    let columns = columns.min(count.max(1));
    let down = count.div_ceil(columns);
    let shape = (3, down * step + style.gap, columns * step + style.gap);
    let mut out = Array3::from_elem(shape, LINE);
    for (t, tile) in tiles.axis_iter(Axis(0)).enumerate() {
        let (r0, c0) = (style.gap + t / columns * step, style.gap + t % columns * step);
        let peak = tile.fold(0.0, |m: f32, v| m.max(*v));
        let inverse = if peak > 0.0 { 1.0 / peak } else { 0.0 };
        out.slice_mut(s![.., r0..r0 + side, c0..c0 + side]).indexed_iter_mut().for_each(|((k, r, c), v)| {
            *v = shown(&tile, [k.min(channels - 1), r / factor, c / factor], inverse, style)
        });
    }
    out
}

fn shown(tile: &ArrayView3<'_, f32>, at: [usize; 3], inverse: f32, style: Style) -> f32 {
    (tile[at] * inverse).max(0.0).powf(style.gamma)
}

/// Pixels at each border that stay below a thousandth of every tile's peak; at least 3 × 3 pixels are left.
fn empty_margin(tiles: &Array4<f32>) -> usize {
    let size = tiles.len_of(Axis(2));
    let mut margin = size.saturating_sub(3) / 2;
    for tile in tiles.axis_iter(Axis(0)) {
        let floor = 1e-3 * tile.fold(0.0, |m: f32, v| m.max(*v));
        for ((_, r, c), v) in tile.indexed_iter() {
            if *v > floor {
                margin = margin.min(r).min(c).min(size - 1 - r).min(size - 1 - c);
            }
        }
    }
    margin
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;

    fn request(size: Option<usize>) -> KernelRequest {
        KernelRequest {
            depth_mm: vec![1000.0, f64::INFINITY],
            wavelength_nm: vec![486.1, 587.6],
            fields: 3,
            size,
            pitch_mm: 0.012,
            rays: 600,
        }
    }

    #[test]
    fn kernels_hold_the_light_and_grow_out_of_focus() {
        let lens = builtin::lens("three_element").expect("shipped");
        let set = KernelSet::compute(&lens, &request(None)).expect("traces");
        assert_eq!(set.kernels.shape()[..3], [2, 3, 2]);
        for d in 0..2 {
            for f in 0..3 {
                for l in 0..2 {
                    let sum: f64 = set.kernels.slice(s![d, f, l, .., ..]).iter().map(|v| f64::from(*v)).sum();
                    let outside = set.outside[[d, f, l]];
                    assert!((sum + outside - 1.0).abs() < 1e-5 && outside < 5e-3, "{sum} {outside}");
                }
            }
        }
        let peak = |d: usize| set.kernels.slice(s![d, 0, 1, .., ..]).fold(0.0, |m: f32, v| m.max(*v));
        assert!(peak(0) > 2.0 * peak(1), "in focus at 1 m: {} {}", peak(0), peak(1));
        assert_eq!(set.radius_mm[[0, 0]], 0.0);
        assert!(set.radius_mm[[0, 2]] > 1.0);
    }

    #[test]
    fn a_window_out_of_all_proportion_is_refused() {
        let lens = builtin::lens("three_element").expect("shipped");
        let wide = KernelRequest { pitch_mm: 1e-5, ..request(None) };
        assert!(KernelSet::compute(&lens, &wide).expect_err("too large").to_string().contains("kernel size"));
    }

    #[test]
    fn tiles_are_normalised_cut_and_enlarged() {
        let mut tiles = Array4::zeros((3, 1, 9, 9));
        for t in 0..3 {
            tiles[[t, 0, 4, 4]] = 0.5;
            tiles[[t, 0, 2, 4]] = 0.05;
        }
        let style = Style { gamma: 1.0, min_tile: 10, gap: 1 };
        let image = picture(&tiles, 2, style);
        // Two rows of two tiles of 5 × 5 kernel pixels, twice as large, with lines of one pixel.
        assert_eq!(image.dim(), (3, 23, 23));
        assert_eq!([image[[0, 5, 5]], image[[2, 6, 6]], image[[0, 1, 5]], image[[0, 0, 0]]], [1.0, 1.0, 0.1, LINE]);
        // The place of the fourth tile is empty.
        assert_eq!(image[[0, 16, 16]], LINE);
    }
}
