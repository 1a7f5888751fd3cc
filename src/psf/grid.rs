//! PSFs over field and wavelength at one depth, with throughput, and the adjoint of all of it.
//!
//! A node is a place on the sensor; its object point is where the fitted distortion sends that place, and the kernel
//! lands relative to it (design §7). By rotational symmetry a node is its radius and an azimuth: each distinct radius
//! is traced once, on the meridian, and its *landings* are rotated. Channels are quadratures over wavelength (eq. 9):
//! `kernel_c = Σ_λ w_cλ K_λ / T_c`, `T_c = Σ_λ w_cλ Σ_q W_q` with the étendue weights of [`super::pupil`].
//! Kernels are not renormalised for what falls outside the window; that share is reported.

use std::borrow::Cow;

use glam::DVec2;
use ndarray::{Array2, Array4, ArrayView2, ArrayView3, Axis};
use rayon::prelude::*;

use super::old_fit::dot;
use super::pupil::{PupilMap, PupilSampling};
use super::old_splat::{splat, splat_vjp};
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
    /// `[node, channel, row, col]`; each sums to one less what fell outside, or is 0 where the throughput is.
    pub kernels: Array4<f64>,
    /// Étendue per unit object slope squared, `[radius, channel]`, mm².
    pub throughput: Array2<f64>,
    /// Share of the energy outside the window, `[node, channel]`; 0 where there is none.
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
                let mut row: Vec<PupilMap> = Vec::with_capacity(systems.len());
                for s in &systems {
                    row.push(PupilMap::compute_near(s, pupil, &plan.sampling, field, row.last())?);
                }
                Ok(row)
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
        let work = kernels.axis_iter_mut(Axis(0)).into_par_iter().zip(outside.axis_iter_mut(Axis(0))).zip(nodes);
        work.for_each_init(Vec::new, |mono: &mut Vec<f64>, ((mut kernel, mut lost), node)| {
            let place = Placement::new(plan, node, radii_mm[node.radius]);
            for (l, map) in maps[node.radius].iter().enumerate() {
                let fed = fed(plan, &throughput, node.radius, l);
                if let [(c, scale)] = fed[..] {
                    // One channel: straight into its kernel.
                    let mut k = kernel.index_axis_mut(Axis(0), c);
                    if let Some(k) = k.as_slice_mut() {
                        lost[c] += place.splat(map, scale, k, size);
                        continue;
                    }
                }
                if fed.is_empty() {
                    continue;
                }
                mono.clear();
                mono.resize(size * size, 0.0);
                let missed = place.splat(map, 1.0, mono, size);
                for (c, scale) in fed {
                    lost[c] += scale * missed;
                    let mut k = kernel.index_axis_mut(Axis(0), c);
                    k.iter_mut().zip(&*mono).for_each(|(a, b)| *a += scale * b);
                }
            }
        });
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
        let dots: Vec<Vec<f64>> = (0..nodes.len())
            .into_par_iter()
            .map(|n| {
                let (bars, kernels) = (kernels_bar.index_axis(Axis(0), n), self.kernels.index_axis(Axis(0), n));
                let pairs = bars.outer_iter().zip(kernels.outer_iter());
                pairs.map(|(bar, kernel)| dot(&flat(bar), &flat(kernel))).collect()
            })
            .collect();
        let mut t_bar = throughput_bar.clone();
        let mut nodes_of: Vec<Vec<usize>> = vec![Vec::new(); slopes.len()];
        for (n, node) in nodes.iter().enumerate() {
            nodes_of[node.radius].push(n);
            for c in 0..channels {
                let t = self.throughput[[node.radius, c]];
                if t > 0.0 {
                    t_bar[[node.radius, c]] -= dots[n][c] / t;
                }
            }
        }
        let systems: Vec<System> = plan.wavelength_nm.iter().map(|nm| System::new(lens, *nm)).collect();
        let parts: Vec<(LensGradient, f64, f64)> = (0..slopes.len() * systems.len())
            .into_par_iter()
            .map(|task| {
                let (i, l) = (task / systems.len(), task % systems.len());
                let field = FieldPoint { slope: DVec2::new(0.0, slopes[i]), vergence };
                let mut gradient = LensGradient::zeros(lens);
                let (map, system) = (&self.maps[i][l], &systems[l]);
                let direct: f64 = (0..channels).map(|c| plan.weight[c][l] * t_bar[[i, c]]).sum();
                let mut bar = MapBar::new(map.x.len(), direct);
                let fed = fed(plan, &self.throughput, i, l);
                for n in &nodes_of[i] {
                    let place = Placement::new(plan, &nodes[*n], radii_mm[i]);
                    let bars = kernels_bar.index_axis(Axis(0), *n);
                    match fed[..] {
                        [] => {}
                        [(c, scale)] => {
                            place.splat_vjp(map, scale, &flat(bars.index_axis(Axis(0), c)), plan.size, &mut bar);
                        }
                        _ => place.splat_vjp(map, 1.0, &mixed(bars, &fed), plan.size, &mut bar),
                    }
                }
                let mut out = SystemGradient::zeros(system);
                let slope_bar = map.vjp(system, &plan.sampling, field, &bar.x, &bar.y, &bar.weight, &mut out);
                out.add_to(lens, plan.wavelength_nm[l], &mut gradient);
                (gradient, slope_bar, bar.radius_mm)
            })
            .collect();
        // Summed in the order of radii and wavelengths, whatever the thread count.
        let none = vec![0.0; slopes.len()];
        let mut bar = GridBar { lens: LensGradient::zeros(lens), slopes: none.clone(), radii_mm: none };
        for (task, (g, s, r)) in parts.iter().enumerate() {
            bar.lens.add(g);
            bar.slopes[task / systems.len()] += s;
            bar.radii_mm[task / systems.len()] += r;
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

/// Channels that wavelength `l` feeds at a radius, each with its weight over the channel's throughput; none where all
/// weights are negligible or where no light comes.
fn fed(plan: &PsfPlan, throughput: &Array2<f64>, radius: usize, l: usize) -> Vec<(usize, f64)> {
    if plan.weight.iter().all(|w| w[l] < NEGLIGIBLE) {
        return Vec::new();
    }
    let scale = |(c, w): (usize, &Vec<f64>)| (c, w[l] / throughput[[radius, c]]);
    plan.weight.iter().enumerate().map(scale).filter(|(_, s)| *s != 0.0 && s.is_finite()).collect()
}

/// Cotangents on one map, and on the place its landings are counted from.
struct MapBar {
    x: Vec<f64>,
    y: Vec<f64>,
    weight: Vec<f64>,
    radius_mm: f64,
}

impl MapBar {
    fn new(count: usize, direct: f64) -> Self {
        Self { x: vec![0.0; count], y: vec![0.0; count], weight: vec![direct; count], radius_mm: 0.0 }
    }
}

/// From meridional landings in mm to pixels `(column, row)` from the kernel's centre at one node.
#[derive(Clone, Copy)]
struct Placement {
    /// `outward` over the pitch, 1/mm.
    column: f64,
    row: f64,
    radius_mm: f64,
}

impl Placement {
    fn new(plan: &PsfPlan, node: &PsfNode, radius_mm: f64) -> Self {
        let [c, r] = node.outward.map(|v| v / plan.pitch_mm);
        Self { column: c, row: r, radius_mm }
    }

    #[inline]
    fn pixel(&self, x: f64, y: f64) -> [f64; 2] {
        let y = y - self.radius_mm;
        [y * self.column - x * self.row, y * self.row + x * self.column]
    }

    /// Adds `scale` times every ray of `map`; returns what fell outside.
    fn splat(&self, map: &PupilMap, scale: f64, kernel: &mut [f64], size: usize) -> f64 {
        let rays = map.x.iter().zip(&map.y).zip(&map.weight);
        rays.map(|((x, y), w)| splat(kernel, size, self.pixel(*x, *y), scale * w)).sum()
    }

    /// Pulls a cotangent on the kernel back to the rays (added to `bar`).
    fn splat_vjp(&self, map: &PupilMap, scale: f64, kernel_bar: &[f64], size: usize, bar: &mut MapBar) {
        let bars = bar.x.iter_mut().zip(&mut bar.y).zip(&mut bar.weight);
        for (((x, y), w), ((x_bar, y_bar), w_bar)) in map.x.iter().zip(&map.y).zip(&map.weight).zip(bars) {
            let (u_bar, weight_bar) = splat_vjp(kernel_bar, size, self.pixel(*x, *y), scale * w);
            let dy = u_bar[0] * self.column + u_bar[1] * self.row;
            *x_bar += u_bar[1] * self.column - u_bar[0] * self.row;
            *y_bar += dy;
            bar.radius_mm -= dy;
            *w_bar += scale * weight_bar;
        }
    }
}

/// The pixels of a kernel in order.
fn flat(kernel: ArrayView2<'_, f64>) -> Cow<'_, [f64]> {
    kernel.to_slice().map_or_else(|| kernel.iter().copied().collect(), Cow::Borrowed)
}

/// `Σ_c scale_c · bar_c`.
fn mixed(bars: ArrayView3<'_, f64>, fed: &[(usize, f64)]) -> Vec<f64> {
    let mut out = vec![0.0; bars.len_of(Axis(1)) * bars.len_of(Axis(2))];
    for (c, scale) in fed {
        out.iter_mut().zip(bars.index_axis(Axis(0), *c)).for_each(|(a, b)| *a += scale * b);
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
