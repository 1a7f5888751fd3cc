//! Kernels from cells of the stop: each cell's light is spread over the area it lands on.
//!
//! The stop is a polar mesh; its vertices are the dense points of a [`PupilMap`]. A cell is cut into as many parts as it
//! needs to be finer than a pixel where it lands; a part lies where its corners' landings put it (bilinear) and carries
//! the étendue of its share of the stop: landings between vertices cost a splat, not an evaluation of the polynomial.

use glam::DVec2;

use isoplanat::psf::pupil::{PupilMap, PupilSampling};
use isoplanat::psf::splat::splat;

/// Parts of a cell along one side, at most.
const MOST_PARTS: f64 = 64.0;

/// A polar mesh over the stop.
#[derive(Clone, Debug)]
pub(crate) struct Cells {
    /// The sampling whose dense points are the vertices.
    pub(crate) sampling: PupilSampling,
    rings: usize,
    sectors: usize,
    /// Largest side of a part on the sensor, pixels.
    part_px: f64,
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
    pub(crate) fn new(degree: usize, rings: usize, sectors: usize, part_px: f64) -> Self {
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
    pub(crate) fn splat(&self, map: &PupilMap, pixel: &[[f64; 2]], kernel: &mut [f64], size: usize) -> (f64, f64) {
        let (mut total, mut outside) = (0.0, 0.0);
        self.each(pixel, |part| {
            let (u, w) = part.light(pixel, &map.weight);
            total += w;
            outside += splat(kernel, size, u, w);
        });
        (total, outside)
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
