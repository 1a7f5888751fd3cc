//! Eigen-PSFs: the kernels of all nodes as combinations of a few.
//!
//! `k_n ≈ Σ_j c_j(n) E_j` by the eigenvectors of the Gram matrix of the node kernels, channel by channel, the phases of
//! a channel together. Source: Lauer, "Deconvolution with a spatially-variant PSF", Proc. SPIE 4847 (2002).

use nalgebra::{DMatrix, SymmetricEigen};
use ndarray::{Array2, Array4, Axis};
use rayon::prelude::*;

use super::super::cfa::Real;
use super::super::node_grid::NodeGrid;
use super::Kernels;

/// Kernels of a grid of nodes, decomposed.
#[derive(Clone, Debug)]
pub struct EigenKernels<T> {
    /// By channel: the components `[component, phase, row, col]`, orthonormal.
    pub components: Vec<Array4<T>>,
    /// By channel: coefficients `[component, node]`.
    pub coefficients: Vec<Array2<T>>,
    /// Largest part of its L2 norm that the kernels of any node and channel miss, measured.
    pub error: f64,
}

impl<T: Real> EigenKernels<T> {
    /// Decomposes the kernels of all nodes into at most `rank` components a channel, fewer if `tolerance` is reached.
    ///
    /// All kernels of a channel are held in f64 meanwhile.
    pub fn new(grid: &NodeGrid, kernels: &dyn Kernels<T>, rank: usize, tolerance: f64) -> Self {
        let (channels, phases, size) = (kernels.channels(), kernels.phases(), kernels.size());
        let (mut components, mut coefficients, mut worst) = (Vec::new(), Vec::new(), 0.0f64);
        for channel in 0..channels {
            let mut rows: Vec<Vec<f64>> = (0..grid.len())
                .into_par_iter()
                .map(|n| {
                    let mut k = Array4::from_elem((channels, phases, size, size), T::zero());
                    kernels.fill(n, k.view_mut());
                    k.index_axis(Axis(0), channel).iter().map(|v| v.to_double()).collect()
                })
                .collect();
            let found = decompose(&mut rows, rank, tolerance);
            worst = worst.max(found.error);
            let count = found.components.len();
            let flat: Vec<T> = found.components.iter().flatten().map(|v| T::real(*v)).collect();
            components.push(Array4::from_shape_vec((count, phases, size, size), flat).expect("kernels of one size"));
            let flat: Vec<T> = found.coefficients.iter().flatten().map(|v| T::real(*v)).collect();
            coefficients.push(Array2::from_shape_vec((count, grid.len()), flat).expect("a coefficient a node"));
        }
        Self { components, coefficients, error: worst }
    }

    /// Components, by channel.
    pub fn ranks(&self) -> Vec<usize> {
        self.components.iter().map(|c| c.len_of(Axis(0))).collect()
    }
}

struct Decomposition {
    components: Vec<Vec<f64>>,
    coefficients: Vec<Vec<f64>>,
    error: f64,
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Takes components out of `rows` until the residual left there is small, largest first.
fn decompose(rows: &mut [Vec<f64>], rank: usize, tolerance: f64) -> Decomposition {
    let norms: Vec<f64> = rows.iter().map(|r| dot(r, r)).collect();
    // Nodes are weighted alike whatever their energy: the error is relative to each.
    let scales: Vec<f64> = norms.iter().map(|n| if *n > 0.0 { n.sqrt().recip() } else { 0.0 }).collect();
    let upper: Vec<Vec<f64>> =
        (0..rows.len()).into_par_iter().map(|i| (i..rows.len()).map(|j| dot(&rows[i], &rows[j])).collect()).collect();
    let gram = DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
        let (low, high) = (i.min(j), i.max(j));
        upper[low][high - low] * scales[i] * scales[j]
    });
    let eigen = SymmetricEigen::new(gram);
    let mut order: Vec<usize> = (0..rows.len()).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let error = |rows: &[Vec<f64>]| rows.iter().zip(&scales).map(|(r, s)| dot(r, r).sqrt() * s).fold(0.0f64, f64::max);
    let mut out = Decomposition { components: Vec::new(), coefficients: Vec::new(), error: error(rows) };
    for &j in order.iter().take(rank) {
        if out.error <= tolerance {
            break;
        }
        // Summed from the residual, which is orthogonal to the components before but for rounding.
        let mut component = vec![0.0; rows.first().map_or(0, Vec::len)];
        for ((row, s), v) in rows.iter().zip(&scales).zip(eigen.eigenvectors.column(j).iter()) {
            component.iter_mut().zip(row).for_each(|(c, r)| *c += s * v * r);
        }
        let norm = dot(&component, &component).sqrt();
        if norm == 0.0 {
            break;
        }
        component.iter_mut().for_each(|c| *c /= norm);
        let coefficients: Vec<f64> = rows
            .par_iter_mut()
            .map(|row| {
                let c = dot(row, &component);
                row.iter_mut().zip(&component).for_each(|(r, e)| *r -= c * e);
                c
            })
            .collect();
        out.components.push(component);
        out.coefficients.push(coefficients);
        out.error = error(rows);
    }
    out
}
