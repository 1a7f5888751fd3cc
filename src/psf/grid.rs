//! PSFs over field and wavelength at one depth, with throughput, and the adjoint of all of it.
//!
//! A node is a place on the sensor; its object point is where the fitted distortion sends that place, and the kernel
//! lands relative to it (design §7). By rotational symmetry a node is its radius and an azimuth: each distinct radius
//! is traced once, on the meridian, and its *landings* are rotated. Channels are quadratures over wavelength (eq. 9):
//! `kernel_c = Σ_λ w_cλ K_λ / T_c`, `T_c = Σ_λ w_cλ Σ_q W_q` with the étendue weights of [`super::pupil`].
//! Kernels are not renormalised for what falls outside the window; that share is reported.

use glam::DVec2;
use ndarray::{Array2, Array4, ArrayView3, Axis};
use rayon::prelude::*;

use super::pupil::{PupilMap, PupilSampling};
use super::splat::{splat, splat_vjp};
use crate::lens::{Lens, LensGradient};
use crate::trace::aim::ParaxialPupil;
use crate::trace::{Failure, FieldPoint, System, SystemGradient};

/// Weights below this share of a channel's largest are left out (bounded in the spectrum's own error).
const NEGLIGIBLE: f64 = 1e-6;

/// How PSFs are sampled.
#[derive(Clone, Debug)]
pub struct PsfPlan {
    /// Pupil nodes and dense points.
    pub sampling: PupilSampling,
    /// Kernel size in pixels, odd.
    pub size: usize,
    /// Pixel pitch, mm.
    pub pitch_mm: f64,
    /// Wavelengths, nm.
    pub wavelength_nm: Vec<f64>,
    /// Weight of each wavelength in each channel; every channel sums to one.
    pub weight: Vec<Vec<f64>>,
}

/// One node: a distinct radius and a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PsfNode {
    /// Index into the list of radii.
    pub radius: usize,
    /// Unit vector `(column, row)` along which the sensor radius grows.
    pub outward: [f64; 2],
}

/// Kernels and throughputs of all nodes at one depth.
#[derive(Clone, Debug)]
pub struct PsfGrid {
    /// `[node, channel, row, col]`; each sums to one less what fell outside.
    pub kernels: Array4<f64>,
    /// Étendue per unit object slope squared, `[radius, channel]`, mm².
    pub throughput: Array2<f64>,
    /// Share of the energy outside the window, `[node, channel]`.
    pub outside: Array2<f64>,
    /// Smallest traced fraction of the stop's radius over all maps (1 unless rays fail).
    pub kept: f64,
    /// Largest residual of the pupil polynomials, mm.
    pub residual_mm: f64,
    /// Surfaces (from 0) whose clear aperture clips some beam; every other aperture was left out.
    pub clipping: Vec<usize>,
    maps: Vec<Vec<PupilMap>>,
}

/// Cotangents that leave [`PsfGrid::vjp`].
#[derive(Clone, Debug)]
pub struct GridBar {
    /// Of the lens.
    pub lens: LensGradient,
    /// Of each radius's object slope.
    pub slopes: Vec<f64>,
    /// Of each radius's place on the sensor, per mm.
    pub radii_mm: Vec<f64>,
}

impl PsfGrid {
    /// Traces every radius (`slopes[i]` is the object slope imaged near `radii_mm[i]`) and splats every node.
    pub fn compute(
        lens: &Lens,
        vergence: f64,
        plan: &PsfPlan,
        slopes: &[f64],
        radii_mm: &[f64],
        nodes: &[PsfNode],
    ) -> Result<Self, Failure> {
        let pupil = ParaxialPupil::new(lens);
        let systems: Vec<System> = plan.wavelength_nm.iter().map(|nm| System::new(lens, *nm)).collect();
        let maps = slopes
            .par_iter()
            .map(|slope| {
                let field = FieldPoint { slope: DVec2::new(0.0, *slope), vergence };
                systems.iter().map(|s| PupilMap::compute(s, pupil, &plan.sampling, field)).collect()
            })
            .collect::<Result<Vec<Vec<PupilMap>>, Failure>>()?;
        let channels = plan.weight.len();
        let mut throughput = Array2::zeros((slopes.len(), channels));
        for (i, row) in maps.iter().enumerate() {
            for (l, map) in row.iter().enumerate() {
                let total: f64 = map.weight.iter().sum();
                for c in 0..channels {
                    throughput[[i, c]] += plan.weight[c][l] * total;
                }
            }
        }
        let size = plan.size;
        let mut kernels = Array4::zeros((nodes.len(), channels, size, size));
        let mut outside = Array2::zeros((nodes.len(), channels));
        kernels.axis_iter_mut(Axis(0)).into_par_iter().zip(outside.axis_iter_mut(Axis(0))).zip(nodes).for_each(
            |((mut kernel, mut lost), node)| {
                for (l, map) in maps[node.radius].iter().enumerate() {
                    if plan.weight.iter().all(|w| w[l] < NEGLIGIBLE) {
                        continue;
                    }
                    let mut mono = vec![0.0; size * size];
                    let mut missed = 0.0;
                    for q in 0..map.x.len() {
                        let u = pixel(plan, node, map.x[q], map.y[q] - radii_mm[node.radius]);
                        missed += splat(&mut mono, size, u, map.weight[q]);
                    }
                    for c in 0..channels {
                        let w = plan.weight[c][l] / throughput[[node.radius, c]];
                        lost[c] += w * missed;
                        let mut k = kernel.index_axis_mut(Axis(0), c);
                        k.iter_mut().zip(&mono).for_each(|(a, b)| *a += w * b);
                    }
                }
            },
        );
        let all = || maps.iter().flatten();
        let mut clipping: Vec<usize> = all().flat_map(PupilMap::clipping).collect();
        clipping.sort_unstable();
        clipping.dedup();
        let kept = all().map(|m| m.kept).fold(1.0, f64::min);
        let residual_mm = all().map(|m| m.residual).fold(0.0, f64::max);
        Ok(Self { kernels, throughput, outside, kept, residual_mm, clipping, maps })
    }

    /// Pulls cotangents on kernels `[node, channel, row, col]` and throughputs `[radius, channel]` back.
    #[expect(clippy::too_many_arguments, reason = "the forward call's own arguments and two cotangents")]
    pub fn vjp(
        &self,
        lens: &Lens,
        vergence: f64,
        plan: &PsfPlan,
        slopes: &[f64],
        radii_mm: &[f64],
        nodes: &[PsfNode],
        kernels_bar: &Array4<f64>,
        throughput_bar: &Array2<f64>,
    ) -> GridBar {
        let channels = plan.weight.len();
        // kernel = A/T: T̄ −= Σ k̄·k / T, per radius.
        let mut t_bar = throughput_bar.clone();
        for (n, node) in nodes.iter().enumerate() {
            for c in 0..channels {
                let dot: f64 = kernels_bar
                    .index_axis(Axis(0), n)
                    .index_axis(Axis(0), c)
                    .iter()
                    .zip(self.kernels.index_axis(Axis(0), n).index_axis(Axis(0), c))
                    .map(|(a, b)| a * b)
                    .sum();
                t_bar[[node.radius, c]] -= dot / self.throughput[[node.radius, c]];
            }
        }
        let systems: Vec<System> = plan.wavelength_nm.iter().map(|nm| System::new(lens, *nm)).collect();
        let parts: Vec<(LensGradient, f64, f64)> = (0..slopes.len())
            .into_par_iter()
            .map(|i| {
                let field = FieldPoint { slope: DVec2::new(0.0, slopes[i]), vergence };
                let mut gradient = LensGradient::zeros(lens);
                let (mut slope_bar, mut radius_bar) = (0.0, 0.0);
                for (l, map) in self.maps[i].iter().enumerate() {
                    let weights: Vec<f64> = (0..channels).map(|c| plan.weight[c][l]).collect();
                    let system = &systems[l];
                    let count = map.x.len();
                    let direct: f64 = (0..channels).map(|c| weights[c] * t_bar[[i, c]]).sum();
                    let (mut x_bar, mut y_bar) = (vec![0.0; count], vec![0.0; count]);
                    let mut w_bar = vec![direct; count];
                    for (n, node) in nodes.iter().enumerate().filter(|(_, node)| node.radius == i) {
                        let scales: Vec<f64> = (0..channels).map(|c| weights[c] / self.throughput[[i, c]]).collect();
                        let mono_bar = mixed(kernels_bar.index_axis(Axis(0), n), &scales);
                        for q in 0..count {
                            let u = pixel(plan, node, map.x[q], map.y[q] - radii_mm[i]);
                            let (u_bar, weight_bar) = splat_vjp(&mono_bar, plan.size, u, map.weight[q]);
                            let (dx, dy) = pixel_vjp(plan, node, u_bar);
                            x_bar[q] += dx;
                            y_bar[q] += dy;
                            radius_bar -= dy;
                            w_bar[q] += weight_bar;
                        }
                    }
                    let mut out = SystemGradient::zeros(system);
                    slope_bar += map.vjp(system, &plan.sampling, field, &x_bar, &y_bar, &w_bar, &mut out);
                    out.add_to(lens, plan.wavelength_nm[l], &mut gradient);
                }
                (gradient, slope_bar, radius_bar)
            })
            .collect();
        // Summed in the order of the radii, whatever the thread count.
        let mut bar = GridBar {
            lens: LensGradient::zeros(lens),
            slopes: Vec::with_capacity(slopes.len()),
            radii_mm: Vec::with_capacity(slopes.len()),
        };
        for (g, s, r) in &parts {
            bar.lens.add(g);
            bar.slopes.push(*s);
            bar.radii_mm.push(*r);
        }
        bar
    }

    /// Half-width in pixels of the square window that holds all but `share` of every map's energy.
    pub fn half_width_px(&self, plan: &PsfPlan, radii_mm: &[f64], share: f64) -> usize {
        let mut widest = 0.0f64;
        for (i, row) in self.maps.iter().enumerate() {
            for (l, map) in row.iter().enumerate() {
                if plan.weight.iter().all(|w| w[l] < 1e-2) {
                    continue;
                }
                let mut reach: Vec<(f64, f64)> = (0..map.x.len())
                    .map(|q| ((map.x[q].hypot(map.y[q] - radii_mm[i])) / plan.pitch_mm, map.weight[q]))
                    .collect();
                reach.sort_by(|a, b| b.0.total_cmp(&a.0));
                let total: f64 = reach.iter().map(|r| r.1).sum();
                let mut sum = 0.0;
                for (r, w) in reach {
                    sum += w;
                    if sum > share * total {
                        widest = widest.max(r);
                        break;
                    }
                }
            }
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded below the frame")]
        let half = widest.min(1e6).ceil() as usize;
        half + 2
    }
}

/// Pixels `(column, row)` from the kernel's centre of a meridional offset `(x, y)` mm at `node`.
#[inline]
fn pixel(plan: &PsfPlan, node: &PsfNode, x: f64, y: f64) -> [f64; 2] {
    let [c, r] = node.outward;
    let (x, y) = (x / plan.pitch_mm, y / plan.pitch_mm);
    [y * c - x * r, y * r + x * c]
}

#[inline]
fn pixel_vjp(plan: &PsfPlan, node: &PsfNode, u_bar: [f64; 2]) -> (f64, f64) {
    let [c, r] = node.outward;
    ((u_bar[1] * c - u_bar[0] * r) / plan.pitch_mm, (u_bar[0] * c + u_bar[1] * r) / plan.pitch_mm)
}

/// `Σ_c scale_c · bar_c`.
fn mixed(bars: ArrayView3<'_, f64>, scales: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; bars.len_of(Axis(1)) * bars.len_of(Axis(2))];
    for (bar, s) in bars.axis_iter(Axis(0)).zip(scales) {
        out.iter_mut().zip(bar.iter()).for_each(|(a, b)| *a += s * b);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{builtin, variables::Variables};
    use crate::testing::{assert_abs, assert_rel, between, central_difference};

    fn plan(size: usize, dense: usize) -> PsfPlan {
        PsfPlan {
            sampling: PupilSampling::new(7, dense),
            size,
            pitch_mm: 0.02,
            wavelength_nm: vec![470.0, 540.0, 610.0],
            weight: vec![vec![0.1, 0.3, 0.6], vec![0.2, 0.7, 0.1], vec![0.8, 0.2, 0.0]],
        }
    }

    /// Energy is kept, a point on the axis is symmetric, a node's azimuth turns its kernel by exact quarter turns.
    #[test]
    fn kernels_keep_energy_and_turn_with_the_field() {
        let lens = builtin::lens("two_element").expect("shipped");
        let plan = plan(61, 400);
        let slopes = [0.0, 0.3];
        let radii = [0.0, 14.9];
        let nodes = [
            PsfNode { radius: 0, outward: [1.0, 0.0] },
            PsfNode { radius: 1, outward: [1.0, 0.0] },
            PsfNode { radius: 1, outward: [0.0, 1.0] },
        ];
        let grid = PsfGrid::compute(&lens, 1e-3, &plan, &slopes, &radii, &nodes).expect("traces");
        for n in 0..3 {
            for c in 0..3 {
                let k = grid.kernels.index_axis(Axis(0), n);
                let sum: f64 = k.index_axis(Axis(0), c).sum();
                assert_abs(sum + grid.outside[[n, c]], 1.0, 1e-12, "energy");
                assert!(grid.outside[[n, c]] < 0.02);
            }
        }
        let (a, b) = (grid.kernels.index_axis(Axis(0), 1), grid.kernels.index_axis(Axis(0), 2));
        for ((c, i, j), v) in a.indexed_iter() {
            assert_abs(*v, b[[c, j, 60 - i]], 1e-15, "a quarter turn");
            assert_abs(*v, a[[c, 60 - i, j]], 1e-12, "mirror symmetry");
        }
    }

    #[test]
    fn grid_vjp_agrees_with_differences() {
        for name in ["two_element", "cooke_triplet"] {
            let lens = builtin::lens(name).expect("shipped");
            let v = lens.object_vergence;
            let plan = plan(31, 60);
            let slopes = [0.1, 0.4];
            let radii = [5.0, 19.8];
            let nodes = [
                PsfNode { radius: 0, outward: [0.6, 0.8] },
                PsfNode { radius: 1, outward: [1.0, 0.0] },
                PsfNode { radius: 1, outward: [-0.8, 0.6] },
            ];
            let rng = &mut fastrand::Rng::with_seed(2);
            let k_bar = Array4::from_shape_fn((3, 3, 31, 31), |_| rng.f64() - 0.5);
            let t_bar = Array2::from_shape_fn((2, 3), |_| rng.f64() - 0.5);
            let value = |lens: &Lens, slopes: &[f64], radii: &[f64]| {
                let g = PsfGrid::compute(lens, v, &plan, slopes, radii, &nodes).expect("traces");
                (&g.kernels * &k_bar).sum() + (&g.throughput * &t_bar).sum()
            };
            let grid = PsfGrid::compute(&lens, v, &plan, &slopes, &radii, &nodes).expect("traces");
            let bar = grid.vjp(&lens, v, &plan, &slopes, &radii, &nodes, &k_bar, &t_bar);
            let vars = Variables::all(&lens);
            let x = vars.values(&lens);
            for seed in 0..4 {
                let rng = &mut fastrand::Rng::with_seed(seed);
                let dx: Vec<f64> = x.iter().map(|_| rng.f64() - 0.5).collect();
                let (ds, dr) = ([between(rng, -1.0, 1.0), 0.3], [0.2, between(rng, -1.0, 1.0)]);
                let pulled: f64 = vars.gradient(&bar.lens).iter().zip(&dx).map(|(a, b)| a * b).sum::<f64>()
                    + (0..2).map(|i| bar.slopes[i] * ds[i] * 0.01 + bar.radii_mm[i] * dr[i]).sum::<f64>();
                let f = |h: f64| {
                    let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                    let s = [slopes[0] + 0.01 * h * ds[0], slopes[1] + 0.01 * h * ds[1]];
                    let r = [radii[0] + h * dr[0], radii[1] + h * dr[1]];
                    value(&vars.lens(&lens, &moved), &s, &r)
                };
                assert_rel(pulled, central_difference(f, 1e-7), 1e-6, 1e-2, &format!("{name} seed {seed}"));
            }
        }
    }
}
