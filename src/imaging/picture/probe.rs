//! What every setting costs in error, measured on the scene itself at a few places.
//!
//! A probe is a small block of pixels, computed as inner products of the scene with the exact kernel of its place, finely
//! in every respect; then again with one approximation at a time. To first order the errors of several approximations add,
//! pixel by pixel, so one table of differences predicts every combination ([`super::choose`]).

use ndarray::{Array4, Axis};
use rayon::prelude::*;

use super::bank::{Bank, Place, Rule, Scratch};
use super::nodes::Nodes;
use super::source::WarpedScene;
use crate::imaging::frame::Frame;
use crate::imaging::node_grid::NodeGrid;
use crate::imaging::warp::Region;
use crate::math::wide::{Work, wide};

/// Pixels along the side of a probe.
pub const SIDE: usize = 3;

/// Values of a probe's pixels, `[channel][pixel]`, flattened.
pub type Values = Vec<f32>;

/// A block of pixels and its exact kernel.
pub struct Probe {
    /// Its pixels.
    pub region: Region,
    /// Exact values.
    pub exact: Values,
    /// The scene around it, at the coarsest sampling.
    patch: Patch,
    /// Flipped exact kernels by channel and their values, at the coarsest sampling.
    kernels: Vec<Vec<f32>>,
    coarse: Values,
    /// By wavelength of the fine rule: light of the pixels in the units of [`Bank::mono`], at the coarsest sampling.
    mono: Vec<Values>,
}

/// Everything a probe is computed from.
pub struct Probing<'a> {
    /// Fine bank.
    pub bank: &'a Bank,
    /// Frame.
    pub frame: &'a Frame,
    /// The scene at each number of samples a pixel (1, 2, 4), all of the same channels.
    pub scenes: &'a [WarpedScene<'a>],
    /// Kernel size in pixels, odd.
    pub size: usize,
}

/// The scene around a region: `[channel]` planes on the fine raster, `m (rows + size − 1)` to a side.
pub struct Patch {
    planes: Vec<Vec<f32>>,
    width: usize,
    m: usize,
}

impl Patch {
    /// Samples `scene` around `region` as far as a kernel of `size` pixels reaches.
    pub fn sample(scene: &WarpedScene<'_>, region: Region, size: usize) -> Self {
        let m = scene.samples();
        let grown = region.grown(size / 2);
        let mut phases = Array4::<f32>::zeros((scene.channels(), m * m, grown.rows, grown.cols));
        scene.fill(grown, phases.view_mut());
        let width = m * grown.cols;
        let planes = phases
            .axis_iter(Axis(0))
            .map(|phases| {
                let mut plane = vec![0.0; m * grown.rows * width];
                for ((phase, i, j), v) in phases.indexed_iter() {
                    plane[(m * i + phase / m) * width + m * j + phase % m] = *v;
                }
                plane
            })
            .collect();
        Self { planes, width, m }
    }

    /// Light of pixel `(i, j)` of the region through a flipped fine kernel of `size` pixels centred in a window of
    /// `full` pixels.
    fn response(&self, channel: usize, i: usize, j: usize, flipped: &[f32], size: usize, full: usize) -> f32 {
        let inset = self.m * (full - size) / 2;
        let plane = &self.planes[channel.min(self.planes.len() - 1)];
        let (top, left) = (self.m * i + inset, self.m * j + inset);
        wide(Inner {
            kernel: flipped,
            side: self.m * size,
            plane: &plane[top * self.width + left..],
            width: self.width,
        })
    }
}

/// The inner product of a kernel, row by row, with a part of a plane.
struct Inner<'a> {
    kernel: &'a [f32],
    side: usize,
    plane: &'a [f32],
    width: usize,
}

impl Work for Inner<'_> {
    type Output = f32;
    #[inline(always)]
    fn run(self) -> f32 {
        let mut sums = [0.0f32; 16];
        let mut rest = 0.0;
        for (a, row) in self.kernel.chunks_exact(self.side).enumerate() {
            let line = &self.plane[a * self.width..][..self.side];
            let (k16, p16) = (row.chunks_exact(16), line.chunks_exact(16));
            rest += k16.remainder().iter().zip(p16.remainder()).map(|(a, b)| a * b).sum::<f32>();
            for (k, p) in k16.zip(p16) {
                for lane in 0..16 {
                    sums[lane] += k[lane] * p[lane];
                }
            }
        }
        sums.iter().sum::<f32>() + rest
    }
}

/// The kernel's points in reverse order, in single precision.
#[expect(clippy::cast_possible_truncation, reason = "kernels in single precision")]
fn flipped(fine: &[f64]) -> Vec<f32> {
    fine.iter().rev().map(|v| *v as f32).collect()
}

/// The middle `inner` pixels of a fine raster of `size` pixels.
fn cropped(flipped: &[f32], size: usize, inner: usize, m: usize) -> Vec<f32> {
    let (side, inset) = (m * size, m * (size - inner) / 2);
    let rows = flipped.chunks_exact(side).skip(inset).take(m * inner);
    rows.flat_map(|row| row[inset..inset + m * inner].iter().copied()).collect()
}

fn pixels(region: Region) -> impl Iterator<Item = (usize, usize)> + Clone {
    (0..region.rows).flat_map(move |i| (0..region.cols).map(move |j| (i, j)))
}

fn centre(frame: &Frame, region: Region) -> Place {
    let [x, y] = region.offset(frame, 0, 0);
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let half = |n: usize| 0.5 * (n as f64 - 1.0);
    Place::offset(frame, [x + half(region.cols), y + half(region.rows)])
}

impl Probing<'_> {
    fn values(&self, patch: &Patch, region: Region, kernels: &[Vec<f32>], size: usize, full: usize) -> Values {
        let each = kernels.iter().enumerate();
        each.flat_map(|(c, k)| pixels(region).map(move |(i, j)| patch.response(c, i, j, k, size, full))).collect()
    }

    /// The exact values of the pixels of `regions`.
    pub fn exact(&self, regions: &[Region]) -> Vec<Probe> {
        let (first, last) = (&self.scenes[0], self.scenes.last().expect("at least one sampling"));
        let run = |scratch: &mut Scratch, region: &Region| {
            let (place, size) = (centre(self.frame, *region), self.size);
            let patch = Patch::sample(first, *region, size);
            // All channels of a grey scene see the same light.
            let (planes, channels) = (first.channels(), self.bank.channels());
            let count = region.rows * region.cols;
            let mut coarse = vec![0.0; channels * count];
            let mono: Vec<Values> = (0..self.bank.rule.nm.len())
                .map(|l| {
                    let kernel = flipped(self.bank.mono(l, place, size, first.samples(), scratch));
                    let mut values = Vec::with_capacity(channels * count);
                    for c in 0..planes.min(channels) {
                        values.extend(pixels(*region).map(|(i, j)| patch.response(c, i, j, &kernel, size, size)));
                    }
                    (values.len() / count..channels).for_each(|_| values.extend_from_within(..count));
                    #[expect(clippy::cast_possible_truncation, reason = "values of pixels")]
                    for (k, (sum, v)) in coarse.iter_mut().zip(&values).enumerate() {
                        *sum += self.bank.weight(k / count, l) as f32 * v;
                    }
                    values
                })
                .collect();
            let kernels = self.kernels(self.bank, *region, first.samples(), scratch);
            let exact = if self.scenes.len() == 1 {
                coarse.clone()
            } else {
                let fine = Patch::sample(last, *region, size);
                self.values(&fine, *region, &self.kernels(self.bank, *region, last.samples(), scratch), size, size)
            };
            Probe { region: *region, exact, patch, kernels, coarse, mono }
        };
        regions.par_iter().map_init(Scratch::default, run).collect()
    }

    /// Difference to the exact values with `self.scenes[which]`'s sampling.
    pub fn samples(&self, probe: &Probe, which: usize, scratch: &mut Scratch) -> Values {
        if which == 0 {
            return less(probe.coarse.clone(), &probe.exact);
        }
        let scene = &self.scenes[which];
        let patch = Patch::sample(scene, probe.region, self.size);
        let kernels = self.kernels(self.bank, probe.region, scene.samples(), scratch);
        less(self.values(&patch, probe.region, &kernels, self.size, self.size), &probe.exact)
    }

    /// Flipped fine kernels of `bank` in the middle of `region`, by channel.
    fn kernels(&self, bank: &Bank, region: Region, m: usize, scratch: &mut Scratch) -> Vec<Vec<f32>> {
        let (fine, _) = bank.fine(centre(self.frame, region), self.size, m, scratch);
        fine.iter().map(|k| flipped(k)).collect()
    }

    /// Values of a probe through another bank's kernels, at the coarsest sampling.
    pub fn through(&self, probe: &Probe, bank: &Bank, scratch: &mut Scratch) -> Values {
        let kernels = self.kernels(bank, probe.region, probe.patch.m, scratch);
        self.values(&probe.patch, probe.region, &kernels, self.size, self.size)
    }

    /// Differences that windows of `sizes` pixels make.
    pub fn windows(&self, probe: &Probe, sizes: &[usize]) -> Vec<Values> {
        let m = probe.patch.m;
        let one = |size: &usize| {
            if *size == self.size {
                return vec![0.0; probe.coarse.len()];
            }
            let inner: Vec<Vec<f32>> = probe.kernels.iter().map(|k| cropped(k, self.size, *size, m)).collect();
            less(self.values(&probe.patch, probe.region, &inner, *size, self.size), &probe.coarse)
        };
        sizes.iter().map(one).collect()
    }

    /// Difference that another quadrature over wavelength makes: light between the fine rule's wavelengths
    /// is interpolated by cubics. `white` is the irradiance of white on the axis at the fine rule's wavelengths.
    pub fn wavelengths(&self, probe: &Probe, rule: &Rule, white: &[f64]) -> Values {
        let nm = &self.bank.rule.nm;
        let count = probe.region.rows * probe.region.cols;
        let mut out = vec![0.0f64; probe.exact.len()];
        for (c, weights) in rule.weight.iter().enumerate() {
            let mut level = 0.0;
            for (at, w) in rule.nm.iter().zip(weights) {
                for (l, share) in cubic(nm, *at) {
                    level += w * share * white[l];
                    let part = c * count..(c + 1) * count;
                    let light = out[part.clone()].iter_mut().zip(&probe.mono[l][part]);
                    light.for_each(|(o, v)| *o += w * share * f64::from(*v));
                }
            }
            out[c * count..(c + 1) * count].iter_mut().for_each(|v| *v /= level);
        }
        #[expect(clippy::cast_possible_truncation, reason = "values of pixels")]
        out.iter().zip(&probe.coarse).map(|(v, e)| (v - f64::from(*e)) as f32).collect()
    }

    /// Difference that interpolation between `nodes` makes to `values`, those of their bank's kernel of the place itself.
    /// The nodes around have been prepared ([`Nodes::prepare`]).
    pub fn nodes(&self, probe: &Probe, values: &[f32], nodes: &Nodes<'_>) -> Values {
        let (region, size) = (probe.region, self.size);
        let grown = region.grown(size / 2);
        let mut sum = vec![0.0f32; values.len()];
        for n in nodes.around(grown) {
            let Some(kernel) = nodes.kernel(n) else { continue };
            let kernels: Vec<Vec<f32>> =
                kernel.chunks_exact(size * size).map(|k| k.iter().rev().copied().collect()).collect();
            let windowed = probe.patch.windowed(&nodes.grid, n, grown);
            let part = self.values(&windowed, region, &kernels, size, size);
            sum.iter_mut().zip(part).for_each(|(s, v)| *s += v);
        }
        less(sum, values)
    }
}

impl Patch {
    /// The patch (one sample a pixel) under the window of node `n`.
    #[expect(clippy::cast_possible_truncation, reason = "windows in single precision")]
    fn windowed(&self, grid: &NodeGrid, n: usize, grown: Region) -> Self {
        let along = |knots: &[isize], k: usize, first: isize, count: usize| -> Vec<f32> {
            let weight = |i: usize| NodeGrid::between(knots, first + i.cast_signed()).of(k);
            (0..count).map(|i| weight(i) as f32).collect()
        };
        let rows = along(&grid.row_knots, n / grid.col_knots.len(), grown.row, grown.rows);
        let cols = along(&grid.col_knots, n % grid.col_knots.len(), grown.col, grown.cols);
        let plane = |plane: &Vec<f32>| {
            let lines = plane.chunks_exact(self.width).zip(&rows);
            lines.flat_map(|(line, r)| line.iter().zip(&cols).map(move |(v, c)| v * r * c)).collect()
        };
        Self { planes: self.planes.iter().map(plane).collect(), width: self.width, m: self.m }
    }
}

/// `a − b`.
pub(super) fn less(mut a: Values, b: &[f32]) -> Values {
    a.iter_mut().zip(b).for_each(|(a, b)| *a -= b);
    a
}

/// Nodes and weights of the cubic (or lower) interpolation at `at` between increasing `nodes`; held at the ends.
fn cubic(nodes: &[f64], at: f64) -> impl Iterator<Item = (usize, f64)> + '_ {
    let taps = nodes.len().min(4);
    let after = nodes.partition_point(|s| *s <= at);
    let first = after.saturating_sub(taps / 2).min(nodes.len() - taps);
    (first..first + taps).map(move |i| {
        let others = (first..first + taps).filter(|j| *j != i);
        (i, others.map(|j| (at - nodes[j]) / (nodes[i] - nodes[j])).product())
    })
}
