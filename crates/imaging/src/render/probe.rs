//! What every setting costs in error, measured on the scene itself at a few places.
//!
//! A probe is a small block of pixels, computed as inner products of the scene with the exact kernel of its place, finely
//! in every respect; then again with one approximation at a time. A kernel belongs to the place where light arrives, for
//! the renderer too, so a probe sees what a picture will show. To first order the errors of several approximations add,
//! pixel by pixel, so one table of differences predicts every combination ([`super::choose`]).

use std::collections::HashMap;

use ndarray::{Array2, ArrayView2, Axis, s};
use rayon::prelude::*;
use rustfft::num_complex::Complex;

use super::nodes::centre;
use super::shared::Shared;
use super::stands::Stand;
use crate::frame::Frame;
use crate::plane::Region;
use crate::render::node_grid::NodeGrid;
use isoplanat_base::math::fft::{RealFft2, good_size};
use isoplanat_base::math::wide::{Work, wide};
use isoplanat_base::stop::look;
use isoplanat_optics::psf::{KernelForm, Optics, Quadrature, SensorPoint};

/// Values of a probe's pixels, `[channel][pixel]`, flattened.
pub(crate) type Values = Vec<f32>;

/// Kernels by cell, at one sample a cell.
pub(crate) type Cache = HashMap<(isize, isize), Vec<Vec<f32>>>;

/// Dense points of the kernels that tell wavelengths apart.
const MONO_DENSE: usize = 300;

/// A block of pixels and its exact kernel.
pub(crate) struct Probe {
    /// Which scene.
    pub scene: usize,
    /// Its pixels.
    pub region: Region,
    /// The scene around it, at the coarsest sampling.
    patch: Patch,
    /// Flipped exact kernels by channel and their values, at the coarsest sampling.
    kernels: Vec<Vec<f32>>,
    pub(super) coarse: Values,
    /// By wavelength of the fine rule: light of the pixels, at the coarsest sampling.
    mono: Vec<Values>,
    /// By wavelength: irradiance of white here.
    irradiance: Vec<f64>,
    /// Root of what its square counts for: its differences carry it.
    scale: f32,
}

/// Everything a probe is computed from. Pixels are those of `frame`: the sensor's, or cells where kernels are wide.
pub(crate) struct Probing<'a> {
    /// The lens at few wavelengths: enough for what does not depend on colour.
    pub optics: &'a Optics,
    /// The lens at many.
    pub colours: &'a Optics,
    /// Object distance, as the optics count them.
    pub depth: usize,
    /// The raster.
    pub frame: &'a Frame,
    /// Channels of the image.
    pub lit: &'a [usize],
    /// By scene, the scene at each number of samples a pixel (1, 2, 4, …), all of the same channels.
    pub scenes: &'a [Vec<Shared<'a>>],
    /// Samples a pixel that see every texel.
    pub seen: usize,
    /// Kernel size in pixels, odd.
    pub size: usize,
    /// Dense points of the kernels.
    pub dense: usize,
}

/// The scene around a region: `[channel]` planes on the fine raster, `m (rows + size − 1)` to a side.
struct Patch {
    planes: Vec<Vec<f32>>,
    width: usize,
    m: usize,
}

impl Patch {
    /// Samples `scene` around `region` as far as a kernel of `size` pixels reaches.
    fn sample(shared: &Shared<'_>, region: Region, size: usize) -> Self {
        let m = shared.scene.samples();
        let grown = region.grown(size / 2);
        let phases = shared.sample(grown);
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

/// The middle `inner` pixels of a fine raster of `size` pixels.
fn cropped(flipped: &[f32], size: usize, inner: usize, m: usize) -> Vec<f32> {
    let (side, inset) = (m * size, m * (size - inner) / 2);
    let rows = flipped.chunks_exact(side).skip(inset).take(m * inner);
    rows.flat_map(|row| row[inset..inset + m * inner].iter().copied()).collect()
}

/// Spreads what `whole` has more than its middle, `inner`, evenly over that: as kernels by diffraction are made for a smaller window.
#[expect(clippy::cast_precision_loss, reason = "a count")]
fn put_back(inner: &mut [f32], whole: &[f32]) {
    let missed = (whole.iter().sum::<f32>() - inner.iter().sum::<f32>()) / inner.len() as f32;
    inner.iter_mut().for_each(|v| *v += missed);
}

/// Kernels of `size` pixels through another, within the window of the first.
struct Through {
    fft: RealFft2<f32>,
    spectrum: Array2<Complex<f32>>,
    side: usize,
}

impl Through {
    fn new(other: &[f32], side: usize, size: usize) -> Self {
        let padded = good_size(size + side);
        let fft = RealFft2::new(padded, padded);
        let spectrum = fft.forward(ArrayView2::from_shape((side, side), other).expect("a square kernel"));
        Self { fft, spectrum, side }
    }

    fn kernel(&self, kernel: &[f32], size: usize) -> Vec<f32> {
        let mut spectrum = self.fft.forward(ArrayView2::from_shape((size, size), kernel).expect("a square kernel"));
        spectrum.zip_mut_with(&self.spectrum, |a, b| *a *= b);
        let half = self.side / 2;
        let rows = self.fft.inverse(spectrum, half, size);
        rows.outer_iter().flat_map(|row| row.slice(s![half..half + size]).to_vec()).collect()
    }
}

fn pixels(region: Region) -> impl Iterator<Item = (usize, usize)> + Clone {
    (0..region.rows).flat_map(move |i| (0..region.cols).map(move |j| (i, j)))
}

/// Flipped kernels of all channels of `form` at a point, in single precision.
fn flipped(optics: &Optics, depth: usize, form: &KernelForm, point: SensorPoint) -> Vec<Vec<f32>> {
    look();
    let mut out = vec![0.0; form.channels() * form.raster.len()];
    optics.kernels(form, depth, point, &mut out);
    #[expect(clippy::cast_possible_truncation, reason = "kernels in single precision")]
    let flip = |plane: &[f64]| plane.iter().rev().map(|v| *v as f32).collect();
    out.chunks_exact(form.raster.len()).map(flip).collect()
}

impl Probing<'_> {
    /// Kernels of the lit channels of `optics`; made once for many probes.
    pub(crate) fn form(&self, optics: &Optics, dense: usize, samples: usize) -> KernelForm {
        let mut form = optics.form(dense, self.size, samples, self.frame.pitch_mm);
        form.weight = self.lit.iter().map(|c| form.weight[*c].clone()).collect();
        form.keeps_light = true;
        form
    }

    /// Kernels of every wavelength by itself.
    fn mono_form(&self) -> KernelForm {
        let mut form = self.form(self.colours, MONO_DENSE, 1);
        let count = self.colours.spec.quadrature.nm.len();
        form.weight = (0..count).map(|k| (0..count).map(|l| f64::from(u8::from(k == l))).collect()).collect();
        form
    }

    /// What `f` makes of every probe.
    pub(crate) fn each(&self, probes: &[Probe], f: impl Fn(&Probe) -> Values + Sync) -> Vec<Values> {
        let one = |probe: &Probe| {
            look();
            f(probe)
        };
        probes.par_iter().map(one).collect()
    }

    fn centre(&self, region: Region) -> SensorPoint {
        let [x, y] = region.offset(self.frame, 0, 0);
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let half = |n: usize| 0.5 * (n as f64 - 1.0);
        SensorPoint::at([x + half(region.cols), y + half(region.rows)].map(|v| v * self.frame.pitch_mm))
    }

    /// Relative illumination of the lit channels at a point.
    fn light(&self, point: SensorPoint) -> Vec<f32> {
        let light = self.optics.relative_illumination(point);
        #[expect(clippy::cast_possible_truncation, reason = "values of pixels")]
        let of = |c: &usize| light[*c] as f32;
        self.lit.iter().map(of).collect()
    }

    fn values(
        &self,
        patch: &Patch,
        region: Region,
        (kernels, light): (&[Vec<f32>], &[f32]),
        (size, full): (usize, usize),
    ) -> Values {
        let each = kernels.iter().zip(light).enumerate();
        let one = |(c, (k, a)): (usize, (&Vec<f32>, &f32))| {
            pixels(region).map(|(i, j)| a * patch.response(c, i, j, k, size, full)).collect::<Vec<f32>>()
        };
        each.flat_map(one).collect()
    }

    /// Probes at `stands`, exact in all but the sampling of the scene, which is the coarsest.
    pub(crate) fn probes(&self, stands: &[Stand]) -> Vec<Probe> {
        let mono_form = self.mono_form();
        let form = self.form(self.optics, self.dense, 1);
        let of = |Stand { scene, region, weight }: &Stand| {
            look();
            let scene = *scene;
            #[expect(clippy::cast_possible_truncation, reason = "a factor on values of pixels")]
            let scale = weight.sqrt() as f32;
            let (at, size) = (self.centre(*region), self.size);
            let light = self.light(at);
            let patch = Patch::sample(&self.scenes[scene][0], *region, size);
            let ones = vec![1.0; self.lit.len()];
            let mono = flipped(self.colours, self.depth, &mono_form, at)
                .into_iter()
                .map(|kernel| {
                    let kernels = vec![kernel; self.lit.len()];
                    self.values(&patch, *region, (&kernels, &ones), (size, size))
                })
                .collect();
            let kernels = flipped(self.optics, self.depth, &form, at);
            let coarse = self.values(&patch, *region, (&kernels, &light), (size, size));
            let irradiance = self.colours.illumination().at(at);
            Probe { scene, region: *region, patch, kernels, coarse, mono, irradiance, scale }
        };
        stands.par_iter().map(of).collect()
    }

    /// Values with sampling `which` of the scenes' (0, the coarsest, a probe has), by the kernels of `form` at so many samples.
    pub(crate) fn sampled(&self, probe: &Probe, which: usize, form: &KernelForm) -> Values {
        let patch = Patch::sample(&self.scenes[probe.scene][which], probe.region, self.size);
        let at = self.centre(probe.region);
        let kernels = flipped(self.optics, self.depth, form, at);
        self.values(&patch, probe.region, (&kernels, &self.light(at)), (self.size, self.size))
    }

    /// Values of a probe through the kernels of `form` and `optics`, at the coarsest sampling.
    pub(crate) fn through(&self, probe: &Probe, optics: &Optics, form: &KernelForm) -> Values {
        let at = self.centre(probe.region);
        let kernels = flipped(optics, self.depth, form, at);
        self.values(&probe.patch, probe.region, (&kernels, &self.light(at)), (self.size, self.size))
    }

    /// Differences of values through two flipped kernels for all channels at `stands`, as much as each counts for, at the coarsest sampling.
    pub(crate) fn between(&self, stands: &[Stand], kernels: &[Vec<f32>; 2]) -> Vec<Values> {
        let of = |Stand { scene, region, weight }: &Stand| {
            look();
            let patch = Patch::sample(&self.scenes[*scene][0], *region, self.size);
            let light = self.light(self.centre(*region));
            let [a, b] = kernels.each_ref().map(|kernel| {
                let kernels = vec![kernel.clone(); self.lit.len()];
                self.values(&patch, *region, (&kernels, &light), (self.size, self.size))
            });
            #[expect(clippy::cast_possible_truncation, reason = "a factor on values of pixels")]
            let scale = weight.sqrt() as f32;
            a.into_iter().zip(b).map(|(a, b)| scale * (a - b)).collect()
        };
        stands.par_iter().map(of).collect()
    }

    /// Differences that `change`, a kernel of `side` pixels, makes behind the kernels of `form` and `optics` at `stands`, as much as each counts for, at the
    /// coarsest sampling.
    pub(crate) fn behind(
        &self,
        stands: &[Stand],
        optics: &Optics,
        form: &KernelForm,
        change: (&[f32], usize),
    ) -> Vec<Values> {
        let change = Through::new(change.0, change.1, self.size);
        let of = |Stand { scene, region, weight }: &Stand| {
            look();
            let at = self.centre(*region);
            let patch = Patch::sample(&self.scenes[*scene][0], *region, self.size);
            let kernels = flipped(optics, self.depth, form, at);
            let kernels: Vec<Vec<f32>> = kernels.iter().map(|k| change.kernel(k, self.size)).collect();
            #[expect(clippy::cast_possible_truncation, reason = "a factor on values of pixels")]
            let scale = weight.sqrt() as f32;
            let values = self.values(&patch, *region, (&kernels, &self.light(at)), (self.size, self.size));
            values.into_iter().map(|v| scale * v).collect()
        };
        stands.par_iter().map(of).collect()
    }

    /// Differences that windows of `sizes` pixels make.
    pub(crate) fn windows(&self, probe: &Probe, sizes: &[usize]) -> Vec<Values> {
        let light = self.light(self.centre(probe.region));
        let one = |size: &usize| {
            if *size == self.size {
                return vec![0.0; probe.coarse.len()];
            }
            let mut inner: Vec<Vec<f32>> = probe.kernels.iter().map(|k| cropped(k, self.size, *size, 1)).collect();
            if self.optics.spec.diffraction.diffracts() {
                inner.iter_mut().zip(&probe.kernels).for_each(|(inner, whole)| put_back(inner, whole));
            }
            probe.less(self.values(&probe.patch, probe.region, (&inner, &light), (*size, self.size)), &probe.coarse)
        };
        sizes.iter().map(one).collect()
    }

    /// Difference that another quadrature over wavelength makes: light between the many wavelengths is interpolated by
    /// cubics.
    pub(crate) fn wavelengths(&self, probe: &Probe, rule: &Quadrature) -> Values {
        let exact = self.light_of(probe, &self.colours.spec.quadrature);
        probe.less(self.light_of(probe, rule), &exact)
    }

    /// Values of a probe by a quadrature.
    fn light_of(&self, probe: &Probe, rule: &Quadrature) -> Values {
        let nm = &self.colours.spec.quadrature.nm;
        let axis = self.colours.illumination().at(SensorPoint::AXIS);
        let count = probe.region.rows * probe.region.cols;
        let mut out = vec![0.0f64; probe.coarse.len()];
        for (c, channel) in self.lit.iter().enumerate() {
            let mut level = 0.0;
            for (at, w) in rule.nm.iter().zip(&rule.weight[*channel]) {
                for (l, share) in cubic(nm, *at) {
                    level += w * share * axis[l];
                    let scale = w * share * probe.irradiance[l];
                    let part = c * count..(c + 1) * count;
                    let light = out[part.clone()].iter_mut().zip(&probe.mono[l][part]);
                    light.for_each(|(o, v)| *o += scale * f64::from(*v));
                }
            }
            out[c * count..(c + 1) * count].iter_mut().for_each(|v| *v /= level);
        }
        #[expect(clippy::cast_possible_truncation, reason = "values of pixels")]
        out.into_iter().map(|v| v as f32).collect()
    }

    /// Computes the kernels of `optics` that the probes' pixels ask `grid` for.
    pub(crate) fn prepare(&self, probes: &[Probe], optics: &Optics, dense: usize, grid: &NodeGrid, cache: &mut Cache) {
        let form = self.form(optics, dense, 1);
        let mut missing: Vec<(isize, isize)> = probes
            .iter()
            .flat_map(|p| {
                let part = grid.part(p.region);
                (0..part.len()).map(|n| part.pixel(n)).collect::<Vec<_>>()
            })
            .filter(|at| !cache.contains_key(at))
            .collect();
        missing.sort_unstable();
        missing.dedup();
        let of = |at: (isize, isize)| (at, flipped(optics, self.depth, &form, centre(self.frame, at.0, at.1)));
        cache.extend(missing.into_par_iter().map(of).collect::<Vec<_>>());
    }

    /// Difference that interpolation between the nodes of `grid` makes to `values`, those of their kernels at the place
    /// itself; [`Self::prepare`] has filled `cache`.
    pub(crate) fn nodes(&self, probe: &Probe, values: &[f32], grid: &NodeGrid, cache: &Cache) -> Values {
        let region = probe.region;
        let light = self.light(self.centre(region));
        let part = grid.part(region);
        let mut sum = vec![0.0f32; values.len()];
        for n in 0..part.len() {
            let at = part.pixel(n);
            let Some(kernels) = cache.get(&at) else { continue };
            let here = self.values(&probe.patch, region, (kernels, &light), (self.size, self.size));
            for ((sum, v), (i, j)) in sum.iter_mut().zip(here).zip(pixels(region).cycle()) {
                let window = part.window(n, region.row + i.cast_signed(), region.col + j.cast_signed());
                #[expect(clippy::cast_possible_truncation, reason = "windows in single precision")]
                let window = window as f32;
                *sum += window * v;
            }
        }
        probe.less(sum, values)
    }
}

impl Probe {
    /// `a − b`, as much as the probe counts for.
    pub(crate) fn less(&self, mut a: Values, b: &[f32]) -> Values {
        a.iter_mut().zip(b).for_each(|(a, b)| *a = self.scale * (*a - b));
        a
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A kernel through another by transforms is the plain sum over their pixels.
    #[test]
    fn a_kernel_through_another_is_their_sum() {
        let rng = &mut fastrand::Rng::with_seed(3);
        for (size, side) in [(7, 5), (5, 9), (31, 3)] {
            let [kernel, other] =
                [size, side].map(|n: usize| (0..n * n).map(|_| rng.f32() - 0.5).collect::<Vec<f32>>());
            let found = Through::new(&other, side, size).kernel(&kernel, size);
            assert_eq!(found.len(), size * size);
            for (at, v) in found.iter().enumerate() {
                let (i, j) = (at / size, at % size);
                let mut sum = 0.0f64;
                for (from, k) in kernel.iter().enumerate() {
                    let [a, b] = [i + side / 2, j + side / 2];
                    let (p, q) = (a.wrapping_sub(from / size), b.wrapping_sub(from % size));
                    if p < side && q < side {
                        sum += f64::from(*k) * f64::from(other[p * side + q]);
                    }
                }
                assert!((f64::from(*v) - sum).abs() < 1e-5, "{size} {side}: {v} for {sum}");
            }
        }
    }
}
