//! The definition as a plain sum, slow, and random cases for the tests of this folder.

use ndarray::{Array, Array3, Array4, Array5, Dimension};

use super::{KernelArray, SourceArray};
use crate::plane::Region;
use crate::render::node_grid::NodeGrid;
use isoplanat_base::math::real::Real;

/// Kernels and a source in memory.
pub(super) struct Case<T> {
    pub name: &'static str,
    pub grid: NodeGrid,
    pub kernels: Array5<T>,
    pub planes: Array4<T>,
    pub region: Region,
    pub block: usize,
}

impl<T: Real> Case<T> {
    pub(super) fn grown(&self) -> Region {
        self.region.grown(self.kernels.dim().3 / 2)
    }
    pub(super) fn kernels(&self) -> KernelArray<'_, T> {
        KernelArray(self.kernels.view())
    }
    pub(super) fn source(&self) -> SourceArray<'_, T> {
        SourceArray { region: self.grown(), planes: self.planes.view() }
    }

    pub(super) fn cast<U: Real>(&self) -> Case<U> {
        Case {
            name: self.name,
            grid: self.grid.clone(),
            kernels: self.kernels.mapv(|v| U::real(v.to_double())),
            planes: self.planes.mapv(|v| U::real(v.to_double())),
            region: self.region,
            block: self.block,
        }
    }

    /// `y_c(p) = Σ_n w_n(p) Σ_f Σ_t k_{n,c,f}(t) s_{c,f}(p − t)`, in f64.
    pub(super) fn plain(&self) -> Array3<f64> {
        let (nodes, channels, phases, size, _) = self.kernels.dim();
        let single = self.planes.dim().0 == 1;
        Array3::from_shape_fn((channels, self.region.rows, self.region.cols), |(c, i, j)| {
            let mut sum = 0.0;
            for (a, b) in (0..size).flat_map(|a| (0..size).map(move |b| (a, b))) {
                // Entry (a, b) moves light by (a − h, b − h); the grown source starts h before the region.
                let (si, sj) = (i + size - 1 - a, j + size - 1 - b);
                for n in 0..nodes {
                    let w = self.grid.window(n, self.region.row + i.cast_signed(), self.region.col + j.cast_signed());
                    for f in 0..phases {
                        let s = self.planes[[if single { 0 } else { c }, f, si, sj]];
                        sum += self.kernels[[n, c, f, a, b]].to_double() * w * s.to_double();
                    }
                }
            }
            sum
        })
    }

    /// Cotangents of kernels and source, term by term of [`Self::plain`], in f64.
    pub(super) fn plain_vjp(&self, bar: &Array3<f64>) -> (Array5<f64>, Array4<f64>) {
        let (nodes, channels, phases, size, _) = self.kernels.dim();
        let single = self.planes.dim().0 == 1;
        let mut kernels = Array5::zeros(self.kernels.dim());
        let mut source = Array4::zeros(self.planes.dim());
        for ((c, i, j), bar) in bar.indexed_iter() {
            assert!(c < channels);
            for n in 0..nodes {
                let w = self.grid.window(n, self.region.row + i.cast_signed(), self.region.col + j.cast_signed());
                if w == 0.0 {
                    continue;
                }
                for (f, (a, b)) in (0..phases).flat_map(|f| (0..size * size).map(move |t| (f, (t / size, t % size)))) {
                    let at = [if single { 0 } else { c }, f, i + size - 1 - a, j + size - 1 - b];
                    kernels[[n, c, f, a, b]] += bar * w * self.planes[at].to_double();
                    source[at] += bar * w * self.kernels[[n, c, f, a, b]].to_double();
                }
            }
        }
        (kernels, source)
    }
}

struct Sizes {
    name: &'static str,
    knots: (Vec<isize>, Vec<isize>),
    region: Region,
    size: usize,
    channels: (usize, usize),
    phases: usize,
    block: usize,
}

/// Shapes that have gone wrong elsewhere, or might.
pub(super) fn cases() -> Vec<Case<f64>> {
    let region = |row, col, rows, cols| Region { row, col, rows, cols };
    let free = || (vec![-4, 3, 15, 22], vec![0, 9, 30]);
    let one = || (vec![4], vec![2]);
    let all = [
        ("ragged", free(), region(-3, 2, 19, 27), 7, (2, 2), 1, 8),
        ("one pixel", free(), region(5, 5, 1, 1), 5, (1, 1), 1, 8),
        ("one row", free(), region(3, -2, 1, 33), 5, (2, 1), 1, 6),
        ("one column", free(), region(-9, 9, 30, 1), 3, (1, 1), 4, 6),
        ("smaller than a block", free(), region(6, 12, 4, 5), 3, (1, 1), 1, 64),
        ("kernel larger than the region", free(), region(2, 3, 4, 3), 15, (1, 1), 1, 5),
        ("kernel larger than the block", free(), region(0, 0, 12, 13), 11, (2, 2), 1, 3),
        ("one node", one(), region(-2, -1, 10, 14), 5, (3, 1), 1, 4),
        ("four phases, grey", free(), region(0, 0, 17, 16), 5, (3, 1), 4, 8),
        ("four phases, colour", free(), region(0, 1, 9, 20), 5, (3, 3), 4, 16),
        ("sixteen phases, grey", free(), region(-2, 7, 12, 9), 3, (2, 1), 16, 6),
        ("dense knots", (vec![0, 1, 2, 3], vec![1, 2]), region(-2, -2, 8, 7), 3, (1, 1), 1, 8),
        ("kernel of one pixel", free(), region(0, 0, 8, 9), 1, (1, 1), 1, 4),
        ("nothing", free(), region(0, 0, 0, 9), 5, (2, 2), 1, 4),
    ];
    let rng = &mut fastrand::Rng::with_seed(3);
    let mut cases: Vec<Case<f64>> = Vec::new();
    for (name, knots, region, size, channels, phases, block) in all {
        let s = Sizes { name, knots, region, size, channels, phases, block };
        cases.push(random(s, rng));
    }
    // Blocks of nothing but zeros, beside others.
    let s = Sizes {
        name: "zero blocks",
        knots: free(),
        region: region(-3, 2, 30, 40),
        size: 5,
        channels: (2, 2),
        phases: 1,
        block: 6,
    };
    let mut case = random(s, rng);
    let keep = |i: usize, j: usize| i < 8 && j > 30 || i == 20;
    case.planes.indexed_iter_mut().filter(|((_, _, i, j), _)| !keep(*i, *j)).for_each(|(_, v)| *v = 0.0);
    cases.push(case);
    cases
}

fn random(s: Sizes, rng: &mut fastrand::Rng) -> Case<f64> {
    let grid = NodeGrid { row_knots: s.knots.0, col_knots: s.knots.1 };
    let grown = s.region.grown(s.size / 2);
    let kernels = Array5::from_shape_fn((grid.len(), s.channels.0, s.phases, s.size, s.size), |_| rng.f64());
    let planes = Array4::from_shape_fn((s.channels.1, s.phases, grown.rows, grown.cols), |_| rng.f64());
    Case { name: s.name, grid, kernels, planes, region: s.region, block: s.block }
}

/// Largest difference relative to the largest value.
pub(super) fn difference<T: Real, D: Dimension>(a: &Array<T, D>, b: &Array<f64, D>) -> f64 {
    assert_eq!(a.shape(), b.shape());
    let scale = b.iter().fold(0.0f64, |m, v| m.max(v.abs())).max(f64::MIN_POSITIVE);
    a.iter().zip(b).map(|(a, b)| (a.to_double() - b).abs()).fold(0.0, f64::max) / scale
}
