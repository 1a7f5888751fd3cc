//! Kernels from cells of the stop: each cell's light is spread over the area it lands on, with adjoint.
//!
//! The stop is a polar mesh; its vertices are the dense points of a [`PupilMap`]. A cell is cut into as many parts as it
//! needs to be finer than a pixel where it lands; a part lies where its corners' landings put it (bilinear) and carries
//! the étendue of its share of the stop. Landings between vertices so cost a splat, not an evaluation of the polynomial
//! over the stop: this pays where a kernel has many more pixels than a beam has vertices (`benches/results/psf.md`).

use glam::DVec2;

use super::pupil::{PupilMap, PupilSampling};
use super::splat::{splat, splat_vjp};

/// Parts of a cell along one side, at most.
const MOST_PARTS: f64 = 64.0;

/// A polar mesh over the stop.
#[derive(Clone, Debug)]
pub struct Cells {
    /// The sampling whose dense points are the vertices.
    pub sampling: PupilSampling,
    rings: usize,
    sectors: usize,
    /// Largest side of a part on the sensor, pixels.
    part_px: f64,
}

/// Cotangents on the landings (pixels) and weights of a map's vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct VertexBar {
    /// Of the places `(column, row)`, pixels.
    pub pixel: Vec<[f64; 2]>,
    /// Of the weights.
    pub weight: Vec<f64>,
}

/// One part of a cell: its vertices, their shares of the landing, its area in units of a vertex's.
struct Part {
    vertices: [usize; 4],
    shares: [f64; 4],
    area: f64,
}

impl Cells {
    /// `rings` by `sectors` cells on each half of the stop (at least one), a polynomial of `degree`, parts of at most
    /// `part_px` pixels.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub fn new(degree: usize, rings: usize, sectors: usize, part_px: f64) -> Self {
        let (rings, sectors) = (rings.max(1), sectors.max(1));
        let mut points = Vec::with_capacity(2 * (rings + 1) * (sectors + 1));
        for i in 0..=rings {
            for j in 0..=sectors {
                let (x, y) = (std::f64::consts::PI * j as f64 / sectors as f64).sin_cos();
                points.push(i as f64 / rings as f64 * DVec2::new(x, y));
            }
        }
        let mirrored: Vec<DVec2> = points.iter().map(|p| DVec2::new(-p.x, p.y)).collect();
        points.extend(mirrored);
        Self { sampling: PupilSampling::with_points(degree, points), rings, sectors, part_px }
    }

    /// Every part of every cell for landings at `pixel`.
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "small counts"
    )]
    fn each(&self, pixel: &[[f64; 2]], mut work: impl FnMut(&Part)) {
        let half = pixel.len() / 2;
        // A vertex's weight is that of `π/count` of the stop.
        let per_vertex = pixel.len() as f64 / std::f64::consts::PI;
        let parts = |a: usize, b: usize, c: usize, d: usize| {
            let side = |a: usize, b: usize| (pixel[a][0] - pixel[b][0]).hypot(pixel[a][1] - pixel[b][1]);
            (side(a, b).max(side(c, d)) / self.part_px).ceil().clamp(1.0, MOST_PARTS) as usize
        };
        for mirror in [0, half] {
            for i in 0..self.rings {
                for j in 0..self.sectors {
                    let a = mirror + i * (self.sectors + 1) + j;
                    let (b, c, d) = (a + 1, a + self.sectors + 1, a + self.sectors + 2);
                    let (out, along) = (parts(a, c, b, d), parts(a, b, c, d));
                    let (dr, dt) = (1.0 / (self.rings * out) as f64, 1.0 / along as f64);
                    let step = std::f64::consts::PI / (self.sectors * along) as f64;
                    for p in 0..out {
                        let s = (p as f64 + 0.5) / out as f64;
                        let area = (i as f64 + s) / self.rings as f64 * dr * step * per_vertex;
                        for q in 0..along {
                            let t = (q as f64 + 0.5) * dt;
                            let shares = [(1.0 - s) * (1.0 - t), (1.0 - s) * t, s * (1.0 - t), s * t];
                            work(&Part { vertices: [a, b, c, d], shares, area });
                        }
                    }
                }
            }
        }
    }

    /// Adds the light of a map of [`Self::sampling`] to `kernel`, its vertices landing at `pixel` (column, row from the
    /// kernel's centre); returns all of it and what fell outside.
    pub fn splat(&self, map: &PupilMap, pixel: &[[f64; 2]], kernel: &mut [f64], size: usize) -> (f64, f64) {
        let (mut total, mut outside) = (0.0, 0.0);
        self.each(pixel, |part| {
            let (u, w) = part.light(pixel, &map.weight);
            total += w;
            outside += splat(kernel, size, u, w);
        });
        (total, outside)
    }

    /// Pulls cotangents on the kernel and on all light back to places and weights. The cutting is held.
    pub fn splat_vjp(
        &self,
        map: &PupilMap,
        pixel: &[[f64; 2]],
        kernel_bar: &[f64],
        size: usize,
        total_bar: f64,
    ) -> VertexBar {
        let mut bar = VertexBar { pixel: vec![[0.0; 2]; pixel.len()], weight: vec![0.0; pixel.len()] };
        self.each(pixel, |part| {
            let (u, w) = part.light(pixel, &map.weight);
            let (u_bar, w_bar) = splat_vjp(kernel_bar, size, u, w);
            for (v, s) in part.vertices.into_iter().zip(part.shares) {
                bar.pixel[v][0] += s * u_bar[0];
                bar.pixel[v][1] += s * u_bar[1];
                bar.weight[v] += s * part.area * (w_bar + total_bar);
            }
        });
        bar
    }
}

impl Part {
    /// Where it lands, and its light.
    #[inline]
    fn light(&self, pixel: &[[f64; 2]], weight: &[f64]) -> ([f64; 2], f64) {
        let (mut u, mut w) = ([0.0; 2], 0.0);
        for (v, s) in self.vertices.into_iter().zip(self.shares) {
            u[0] += s * pixel[v][0];
            u[1] += s * pixel[v][1];
            w += s * weight[v];
        }
        (u, w * self.area)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::testing::{assert_rel, central_difference};
    use crate::trace::aim::ParaxialPupil;
    use crate::trace::launch::FieldPoint;
    use crate::trace::{Failure, System};

    fn map(cells: &Cells, slope: f64) -> Result<PupilMap, Failure> {
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let field = FieldPoint { slope: DVec2::new(0.0, slope), vergence: 5e-4 };
        PupilMap::compute(&System::new(&lens, 550.0), ParaxialPupil::new(&lens), &cells.sampling, field)
    }

    /// All étendue of a beam, as many rays have it, and its share of every pixel.
    #[test]
    fn cells_agree_with_many_rays() {
        let (pitch, size, slope) = (0.006, 65, 0.1);
        let cells = Cells::new(7, 16, 24, 0.5);
        let coarse = map(&cells, slope).expect("traces");
        let middle = coarse.y.iter().sum::<f64>() / coarse.y.len() as f64;
        let place = |m: &PupilMap| -> Vec<[f64; 2]> {
            m.x.iter().zip(&m.y).map(|(x, y)| [x / pitch, (y - middle) / pitch]).collect()
        };
        let mut kernel = vec![0.0; size * size];
        let (total, outside) = cells.splat(&coarse, &place(&coarse), &mut kernel, size);
        assert_rel(kernel.iter().sum::<f64>() + outside, total, 1e-12, 0.0, "energy");
        let lens = builtin::lens("cooke_triplet").expect("shipped");
        let field = FieldPoint { slope: DVec2::new(0.0, slope), vergence: 5e-4 };
        let sampling = PupilSampling::new(7, 60_000);
        let fine = PupilMap::compute(&System::new(&lens, 550.0), ParaxialPupil::new(&lens), &sampling, field);
        let fine = fine.expect("traces");
        let mut exact = vec![0.0; size * size];
        place(&fine).iter().zip(&fine.weight).for_each(|(u, w)| {
            splat(&mut exact, size, *u, *w);
        });
        let light: f64 = fine.weight.iter().sum();
        assert_rel(total, light, 2e-3, 0.0, "étendue");
        let off: f64 = kernel.iter().zip(&exact).map(|(a, b)| (a / total - b / light).powi(2)).sum();
        let error = (off / exact.iter().map(|b| (b / light).powi(2)).sum::<f64>()).sqrt();
        eprintln!("cells of a defocused triplet: {error:.1e}");
        assert!(error < 0.02, "{error:e}");
    }

    #[test]
    fn splat_vjp_agrees_with_differences() {
        let cells = Cells::new(5, 4, 6, 0.7);
        let base = map(&cells, 0.2).expect("traces");
        let middle = base.y.iter().sum::<f64>() / base.y.len() as f64;
        let pixel: Vec<[f64; 2]> = base.x.iter().zip(&base.y).map(|(x, y)| [x / 0.03, (y - middle) / 0.03]).collect();
        let rng = &mut fastrand::Rng::with_seed(7);
        let bar: Vec<f64> = (0..15 * 15).map(|_| rng.f64() - 0.5).collect();
        let dots: Vec<[f64; 3]> = pixel.iter().map(|_| [rng.f64() - 0.5, rng.f64() - 0.5, rng.f64() - 0.5]).collect();
        let back = cells.splat_vjp(&base, &pixel, &bar, 15, 0.3);
        let pulled: f64 = (0..pixel.len())
            .map(|q| back.pixel[q][0] * dots[q][0] + back.pixel[q][1] * dots[q][1] + back.weight[q] * dots[q][2])
            .sum();
        let f = |h: f64| {
            let mut moved = base.clone();
            moved.weight.iter_mut().zip(&dots).for_each(|(w, d)| *w += h * d[2]);
            let at: Vec<[f64; 2]> = pixel.iter().zip(&dots).map(|(p, d)| [p[0] + h * d[0], p[1] + h * d[1]]).collect();
            let mut kernel = vec![0.0; 15 * 15];
            let (total, _) = cells.splat(&moved, &at, &mut kernel, 15);
            kernel.iter().zip(&bar).map(|(a, b)| a * b).sum::<f64>() + 0.3 * total
        };
        assert_rel(pulled, central_difference(f, 1e-6), 1e-6, 1e-2, "cells");
    }
}
