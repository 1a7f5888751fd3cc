//! Restoration filters of a lens: at nodes of the frame the Wiener filter of the PSF there, as a kernel of finite size.
//!
//! With the PSF's transform `K_d` at each object distance `d` and the noise's power over the scene's `R(f) = nsr (4f)²` (a
//! natural scene, whose power falls as f⁻²; f in cycles a pixel) the filter with the least mean square error over the
//! distances is `Σ conj(K_d) / (Σ |K_d|² + D R)` (N. Wiener 1949). It is taken back to the pixels, tapered at its rim and made to
//! sum to one, so that white stays white. Between the nodes the results are blended as blurs are
//! ([`blur`](mod@crate::render::blur)): a pixel's value depends on the capture within a filter's reach and on nothing else, tiles or not.
//!
//! Filters are held as 16-bit numbers times a factor each; whoever computes with them, in training or in the camera, uses the
//! same rounded ones.

use ndarray::{Array2, Array4, Array5, ArrayView2, ArrayView3, ArrayViewMut4, s};
use rustfft::num_complex::Complex;

use crate::develop::simulate::Electronics;
use crate::frame::Frame;
use crate::plane::{Region, mirrored};
use crate::render::Renderer;
use crate::render::blur::cost::Task;
use crate::render::blur::{KernelArray, Method, Source, blur};
use crate::render::node_grid::NodeGrid;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::fft::{RealFft2, good_size};

/// Colours of a picture.
const COLOURS: usize = 3;

/// Nodes along the frame's longer side, less one.
const SPACES: usize = 8;

/// Smallest and largest half-width of a filter, pixels.
const HALVES: [usize; 2] = [12, 96];

/// A filter's half-width over the PSF's.
const WIDER: f64 = 1.5;

/// Share of the half-width over which a filter is tapered.
const TAPER: f64 = 0.25;

/// Mean level of a scene, for the shot noise.
const LEVEL: f64 = 0.2;

/// Spectral density of a scene at a quarter of a cycle a pixel, relative to white. A tenth of photographs' own: what PSFs between
/// nodes, aliasing and demosaicking add counts as noise too. Behind the two-element lens, of six photographs in five zones, a factor of
/// 3 to either side costs 0.3 to 0.5 dB, and twice as many nodes along an axis change 0.02 dB.
const SIGNAL: f64 = 1e-3;

/// Noise over signal stays within: darkness at a node would leave no filter.
const NSR: [f64; 2] = [1e-6, 10.0];

/// Largest magnitude of a rounded value.
const STEPS: f64 = 32_767.0;

/// Most values of all filters together: 81 nodes of the widest. 36 MiB as `f32`.
const MOST: usize = 81 * COLOURS * (2 * HALVES[1] + 1).pow(2);

/// Filters of a lens on a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Filters {
    /// Where they stand, pixels of the frame.
    pub grid: NodeGrid,
    /// Rounded values, `[node, channel, row, col]`, rows and columns odd and alike.
    pub steps: Array4<i16>,
    /// What a step is worth, `[node, channel]`.
    pub scales: Array2<f32>,
    /// `[node, channel, 1, row, col]`.
    kernels: Array5<f32>,
}

impl Filters {
    /// Bytes of the largest filters, as computed with.
    pub const LARGEST: u64 = (MOST * size_of::<f32>()) as u64;

    /// Half the rows and columns of the widest filter.
    pub const WIDEST: usize = HALVES[1];

    /// The filters of the lens that `renderer` holds, over all its distances: a bank for each of `noise`, times the power of the noise of `electronics`.
    ///
    /// # Errors
    /// A lens whose filters would not fit into memory.
    pub fn compute(renderer: &Renderer, electronics: &Electronics, noise: &[f64]) -> Result<Vec<Self>> {
        let frame = &renderer.plan.frame;
        let whole = Region::whole(frame);
        let grid = NodeGrid::uniform(whole, frame.rows.max(frame.columns).div_ceil(SPACES));
        let depths: Vec<Array4<f32>> =
            (0..renderer.plan.depths.len()).map(|d| renderer.pixel_kernels(d, &grid)).collect();
        let reach = depths.iter().map(|k| k.dim().2 / 2).max().unwrap_or(0);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a kernel's size")]
        let half = ((WIDER * reach as f64).ceil() as usize).clamp(HALVES[0], HALVES[1]);
        let size = 2 * half + 1;
        if grid.len().saturating_mul(COLOURS * size * size) > MOST {
            let found = format!("{} of {size} × {size} pixels", grid.len());
            return Err(Error::bad("", "Wiener filters", found, format!("at most {MOST} values")));
        }
        let n = good_size(size + 2 * reach + 1);
        let fft = RealFft2::<f64>::new(n, n);
        let bank = || (Array4::zeros((grid.len(), COLOURS, size, size)), Array2::zeros((grid.len(), COLOURS)));
        let mut banks: Vec<(Array4<i16>, Array2<f32>)> = noise.iter().map(|_| bank()).collect();
        for node in 0..grid.len() {
            let (row, col) = grid.pixel(node);
            let spot = Region { row: row.min(last(frame.rows)), col: col.min(last(frame.columns)), rows: 1, cols: 1 };
            let light = renderer.light.over::<f64>(frame, spot, &[0, 1, 2]);
            for channel in 0..COLOURS {
                let kernels: Vec<Array2<f64>> = depths
                    .iter()
                    .map(|k| k.slice(s![node, channel.min(k.dim().1 - 1), .., ..]).mapv(f64::from))
                    .collect();
                let spectra = Spectra::of(&fft, n, &kernels);
                for ((steps, scales), noise) in banks.iter_mut().zip(noise) {
                    let nsr = nsr(electronics, channel, light[[channel, 0, 0]], *noise);
                    let filter = spectra.wiener(&fft, nsr, half);
                    let (rounded, scale) = rounded(filter.view());
                    steps.slice_mut(s![node, channel, .., ..]).assign(&rounded);
                    scales[[node, channel]] = scale;
                }
            }
        }
        banks.into_iter().map(|(steps, scales)| Self::from_parts(grid.clone(), steps, scales)).collect()
    }

    /// From what a file holds.
    ///
    /// # Errors
    /// Shapes that do not belong together, a factor that is no number, filters that do not keep white.
    pub fn from_parts(grid: NodeGrid, steps: Array4<i16>, scales: Array2<f32>) -> Result<Self> {
        let refuse = |what: String, allowed: &str| Err(Error::bad("", "Wiener filters", what, allowed));
        let (nodes, channels, rows, cols) = steps.dim();
        let grows = |knots: &[isize]| !knots.is_empty() && knots.windows(2).all(|w| w[0] < w[1]);
        if !grows(&grid.row_knots) || !grows(&grid.col_knots) {
            return refuse(format!("nodes at {:?}, {:?}", grid.row_knots, grid.col_knots), "nodes that grow");
        }
        let shaped = nodes == grid.len() && channels == COLOURS && rows == cols && rows % 2 == 1;
        if !shaped || scales.dim() != (nodes, channels) || steps.len() > MOST || rows > 2 * HALVES[1] + 1 {
            let allowed = "[nodes, 3, k, k] with k odd, and a factor each";
            return refuse(format!("shapes {:?}, {:?} at {} nodes", steps.dim(), scales.dim(), grid.len()), allowed);
        }
        let mut kernels = Array5::zeros((nodes, channels, 1, rows, cols));
        for ((node, channel), scale) in scales.indexed_iter() {
            let from = steps.slice(s![node, channel, .., ..]);
            let mut to = kernels.slice_mut(s![node, channel, 0, .., ..]);
            ndarray::Zip::from(&mut to).and(&from).for_each(|t, f| *t = f32::from(*f) * scale);
            let sum: f64 = to.iter().map(|v| f64::from(*v)).sum();
            if !scale.is_finite() || (sum - 1.0).abs() > 1e-2 {
                return refuse(format!("a sum of {sum} at node {node}"), "filters that sum to 1");
            }
        }
        Ok(Self { grid, steps, scales, kernels })
    }

    /// How far beyond the capture's darkest and lightest value the filtered one can lie at most, over the range between: a filter whose
    /// magnitudes sum to `G` passes `(G − 1) / 2`. So much ringing, and no more, can stand beside a saturated place.
    pub fn overshoot(&self) -> f64 {
        let gain = |filter: ArrayView2<'_, f32>| filter.iter().map(|v| f64::from(v.abs())).sum::<f64>();
        let all = self
            .kernels
            .outer_iter()
            .flat_map(|node| node.outer_iter().map(|c| gain(c.index_axis(ndarray::Axis(0), 0))).collect::<Vec<f64>>());
        0.5 * (all.fold(1.0, f64::max) - 1.0)
    }

    /// How far from a pixel the capture counts, pixels.
    pub fn reach(&self) -> usize {
        self.steps.dim().2 / 2
    }

    /// The filtered capture over `wanted`: `image` `[3, row, col]` lies at `at` of the frame, `wanted` within it. Beyond the
    /// image it is mirrored; its edges should be the frame's, or [`Self::reach`] away.
    pub fn over(&self, image: ArrayView3<'_, f32>, at: Region, wanted: Region) -> ndarray::Array3<f32> {
        let (grid, kernels) = self.part(wanted);
        let method = Self::method(&grid, kernels.dim().3, wanted);
        blur(&grid, &KernelArray(kernels.view()), &Mirrored { image, at }, wanted, method, &|_| {})
    }

    /// The nodes whose windows reach `wanted`, and their kernels.
    pub(super) fn part(&self, wanted: Region) -> (NodeGrid, Array5<f32>) {
        let grid = self.grid.part(wanted);
        let kernels = self.kernels.select(ndarray::Axis(0), &part(&self.grid, &grid));
        (grid, kernels)
    }

    pub(super) fn method(grid: &NodeGrid, size: usize, region: Region) -> Method {
        Task { grid, region, size, channels: COLOURS, source_channels: COLOURS, phases: 1 }.cheapest()
    }
}

/// Numbers in `whole` of the nodes of its part `part`.
fn part(whole: &NodeGrid, part: &NodeGrid) -> Vec<usize> {
    let first = |all: &[isize], some: &[isize]| all.iter().position(|k| *k == some[0]).unwrap_or(0);
    let (row, col) = (first(&whole.row_knots, &part.row_knots), first(&whole.col_knots, &part.col_knots));
    let across = whole.col_knots.len();
    let rows = row..row + part.row_knots.len();
    rows.flat_map(|r| (col..col + part.col_knots.len()).map(move |c| r * across + c)).collect()
}

/// Index of the last of `n` pixels.
fn last(n: usize) -> isize {
    n.saturating_sub(1).cast_signed()
}

/// Variance of the developed picture's noise, `times` as much, over the scene's density at a quarter of a cycle a pixel.
pub(super) fn nsr(electronics: &Electronics, channel: usize, light: f64, times: f64) -> f64 {
    let gain = (light * electronics.neutral[channel]).max(1e-6);
    let noise = &electronics.noise;
    let variance = (noise.shot * LEVEL * gain + noise.read * noise.read) / (gain * gain);
    (times * variance / SIGNAL).clamp(NSR[0], NSR[1])
}

/// Of the PSFs of one place: sums over the object distances of their transforms' conjugates and of their powers.
pub(super) struct Spectra {
    n: usize,
    count: usize,
    top: Array2<Complex<f64>>,
    power: Array2<f64>,
}

impl Spectra {
    /// Of kernels no wider than `n`, for transforms of `n × n`.
    pub(super) fn of(fft: &RealFft2<f64>, n: usize, kernels: &[Array2<f64>]) -> Self {
        let mut top = Array2::from_elem((n / 2 + 1, n), Complex::new(0.0, 0.0));
        let mut power = Array2::<f64>::zeros((n / 2 + 1, n));
        for kernel in kernels {
            // The middle of the kernel onto the origin.
            let reach = kernel.nrows() / 2;
            let mut plane = Array2::zeros((n, n));
            for ((i, j), v) in kernel.indexed_iter() {
                plane[[(i + n - reach) % n, (j + n - reach) % n]] = *v;
            }
            let spectrum = fft.forward(plane.view());
            ndarray::Zip::from(&mut top).and(&mut power).and(&spectrum).for_each(|t, p, k| {
                *t += k.conj();
                *p += k.norm_sqr();
            });
        }
        Self { n, count: kernels.len(), top, power }
    }

    /// The filter for one share of noise, `[row, col]` of `2 half + 1`, sum 1.
    #[expect(clippy::cast_precision_loss, reason = "raster sizes")]
    pub(super) fn wiener(&self, fft: &RealFft2<f64>, nsr: f64, half: usize) -> Array2<f64> {
        let (n, count, mut top) = (self.n, self.count as f64, self.top.clone());
        for ((across, down), t) in top.indexed_iter_mut() {
            let [x, y] = [across as f64 / n as f64, down.min(n - down) as f64 / n as f64];
            let bottom = self.power[[across, down]] + count * nsr * 16.0 * (x * x + y * y);
            *t = if bottom > 1e-12 { *t / bottom } else { Complex::new(0.0, 0.0) };
        }
        let plane = fft.inverse(top, 0, n);
        let taper = |i: usize| {
            let out = i.abs_diff(half) as f64 / (half + 1) as f64;
            let t = ((out - (1.0 - TAPER)) / TAPER).clamp(0.0, 1.0);
            0.5 + 0.5 * (std::f64::consts::PI * t).cos()
        };
        let size = 2 * half + 1;
        let mut filter = Array2::from_shape_fn((size, size), |(i, j)| {
            plane[[(i + n - half) % n, (j + n - half) % n]] * taper(i) * taper(j)
        });
        let sum = filter.sum();
        if sum.is_finite() && sum.abs() > 1e-3 {
            filter /= sum;
        } else {
            // No light, nothing to undo.
            filter.fill(0.0);
            filter[[half, half]] = 1.0;
        }
        filter
    }
}

/// Values as whole steps, the middle one so that they sum to one, and a step's worth. What the middle one cannot hold goes to those that were rounded farthest the other way, one step each.
#[expect(clippy::cast_possible_truncation, reason = "at most 32767 steps; f32 as stored")]
fn rounded(filter: ArrayView2<'_, f64>) -> (Array2<i16>, f32) {
    let largest = filter.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let scale = (largest / (STEPS - 200.0)) as f32;
    let step = f64::from(scale);
    let mut steps = filter.mapv(|v| (v / step).round() as i16);
    let off = 1.0 / step - steps.iter().map(|v| f64::from(*v)).sum::<f64>();
    let half = filter.nrows() / 2;
    let middle = f64::from(steps[[half, half]]);
    steps[[half, half]] = (middle + off.round()).clamp(-STEPS, STEPS) as i16;
    let rest = middle + off.round() - f64::from(steps[[half, half]]);
    if rest != 0.0 {
        let left = |at: &(usize, usize)| rest.signum() * (filter[*at] / step - f64::from(steps[*at]));
        // (The middle one holds no more: it is no longer within the bound.)
        let mut movable: Vec<(usize, usize)> = filter.indexed_iter().map(|(at, _)| at).collect();
        movable.retain(|at| f64::from(steps[*at]).abs() < STEPS);
        movable.sort_by(|a, b| left(b).total_cmp(&left(a)));
        for at in movable.into_iter().take(rest.abs() as usize) {
            steps[at] += rest.signum() as i16;
        }
    }
    (steps, scale)
}

/// A capture that goes on mirrored beyond its edges.
pub(super) struct Mirrored<'a> {
    pub(super) image: ArrayView3<'a, f32>,
    pub(super) at: Region,
}

/// Where the `count` pixels from `first` on lie in a picture of `n` pixels that begins at `from` and goes on mirrored.
pub(super) fn places(first: isize, count: usize, from: isize, n: usize) -> Vec<usize> {
    (0..count).map(|k| mirrored(first + k.cast_signed() - from, n)).collect()
}

impl Source<f32> for Mirrored<'_> {
    fn channels(&self) -> usize {
        self.image.dim().0
    }

    fn fill(&self, region: Region, mut out: ArrayViewMut4<'_, f32>) -> bool {
        let (_, rows, cols) = self.image.dim();
        let down = places(region.row, region.rows, self.at.row, rows);
        let across = places(region.col, region.cols, self.at.col, cols);
        for (mut plane, image) in out.outer_iter_mut().zip(self.image.outer_iter()) {
            for (mut to, &row) in plane.index_axis_mut(ndarray::Axis(0), 0).outer_iter_mut().zip(&down) {
                let from = image.row(row);
                to.iter_mut().zip(&across).for_each(|(v, &col)| *v = from[col]);
            }
        }
        true
    }
}

/// Refuses filters that do not stand in `frame`.
///
/// # Errors
/// A node outside.
pub(super) fn check(filters: &Filters, frame: &Frame) -> Result<()> {
    let far = 2 * frame.rows.max(frame.columns).cast_signed();
    let knots = filters.grid.row_knots.iter().chain(&filters.grid.col_knots);
    match knots.copied().find(|k| !(0..=far).contains(k)) {
        Some(k) => Err(Error::bad("", "Wiener filters", format!("a node at {k}"), "nodes within the frame")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Filters sum to one however their values are rounded: all that small values lose to rounding is more than the middle one holds.
    #[test]
    fn large_filters_keep_white() {
        let side = 129;
        let filter = Array2::from_shape_fn((side, side), |at| if at == (64, 64) { 1.0 } else { 0.45 / 32_567.0 });
        let filter = &filter / filter.sum();
        let (steps, scale) = rounded(filter.view());
        let sum = steps.iter().map(|v| f64::from(*v)).sum::<f64>() * f64::from(scale);
        assert!((sum - 1.0).abs() < 1e-6, "{sum}");
        let most = filter.indexed_iter().map(|(at, v)| (v - f64::from(steps[at]) * f64::from(scale)).abs());
        assert!(most.fold(0.0, f64::max) < 250.0 * f64::from(scale));
    }
}
