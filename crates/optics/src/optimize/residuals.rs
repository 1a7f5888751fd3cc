//! Rays to residuals: transverse distances from the reference, or path differences, each times the root of its weight.

use glam::DVec2;
use nalgebra::DMatrix;

use super::merit::{Quality, Reference, Role};
use super::rays::{Rays, Slopes, Traced};

/// Residuals, mm; the merit is the sum of their squares: the mean over the object points of the mean square.
pub(super) fn residuals(rays: &Rays, traced: &Traced) -> Vec<f64> {
    let references = references(rays, traced);
    let pistons = pistons(rays, traced, &references);
    let mut out = Vec::new();
    for (c, i, s) in rays.samples().filter(|(_, _, s)| s.role == Role::Image) {
        let (root, reference) = (s.weight.sqrt(), references[s.point]);
        if rays.quality == Quality::Wavefront {
            out.push(root * (traced.path_to(c, i, reference) - pistons[c][s.point]));
        } else {
            let off = root * (traced.landing(c, i) - reference);
            out.extend([off.x, off.y]);
        }
    }
    out
}

fn references(rays: &Rays, traced: &Traced) -> Vec<DVec2> {
    let mut references = rays.centroids(traced);
    if rays.reference == Reference::Chief && rays.quality == Quality::Spot {
        for (reference, chief) in references.iter_mut().zip(rays.chiefs()) {
            if let Some((c, i)) = chief {
                *reference = traced.landing(c, i);
            }
        }
    }
    references
}

/// Mean path of every colour and object point.
fn pistons(rays: &Rays, traced: &Traced, references: &[DVec2]) -> Vec<Vec<f64>> {
    let mut sums = vec![vec![[0.0; 2]; references.len()]; rays.colours()];
    if rays.quality == Quality::Wavefront {
        for (c, i, s) in rays.samples().filter(|(_, _, s)| s.role == Role::Image) {
            let sum = &mut sums[c][s.point];
            sum[0] += s.weight * traced.path_to(c, i, references[s.point]);
            sum[1] += s.weight;
        }
    }
    sums.iter().map(|of| of.iter().map(|[p, w]| if *w > 0.0 { p / w } else { 0.0 }).collect()).collect()
}

/// The Jacobian of [`residuals`] by the `n` variables.
pub(super) fn jacobian(rays: &Rays, traced: &Traced, slopes: &Slopes, n: usize) -> DMatrix<f64> {
    let wavefront = rays.quality == Quality::Wavefront;
    let points = rays.points.len();
    // Slopes of the references: x and y by every variable.
    let mut references = vec![0.0; 2 * n * points];
    let mut weights = vec![0.0; points];
    for (c, i, s) in rays.samples().filter(|(_, _, s)| s.role == Role::Image) {
        let [x, y, _] = slopes.of(c, i, n);
        let reference = &mut references[2 * n * s.point..2 * n * (s.point + 1)];
        weights[s.point] += s.weight;
        // Half a pupil has no mean x.
        let x_share = if rays.symmetric { 0.0 } else { s.weight };
        for j in 0..n {
            reference[j] += x_share * x[j];
            reference[n + j] += s.weight * y[j];
        }
    }
    let chiefs = rays.chiefs();
    for (p, reference) in references.chunks_exact_mut(2 * n.max(1)).enumerate() {
        let factor = if weights[p] > 0.0 && !rays.points[p].axial { weights[p].recip() } else { 0.0 };
        reference.iter_mut().for_each(|r| *r *= factor);
        if let (Reference::Chief, false, Some((c, i))) = (rays.reference, wavefront, chiefs[p]) {
            let [x, y, _] = slopes.of(c, i, n);
            reference[..n].copy_from_slice(x);
            reference[n..].copy_from_slice(y);
        }
    }
    let images = rays.samples().filter(|(_, _, s)| s.role == Role::Image).count();
    let mut out = DMatrix::zeros(if wavefront { images } else { 2 * images }, n);
    let mut pistons = vec![vec![0.0; n * points]; if wavefront { rays.colours() } else { 0 }];
    let mut light = vec![vec![0.0; points]; rays.colours()];
    let about = if wavefront { self::references(rays, traced) } else { Vec::new() };
    let path_by = |c: usize, i: usize, p: usize, j: usize| {
        let to = traced.path_by(c, i, about[p]);
        slopes.of(c, i, n)[2][j] + to.x * references[2 * n * p + j] + to.y * references[2 * n * p + n + j]
    };
    if wavefront {
        for (c, i, s) in rays.samples().filter(|(_, _, s)| s.role == Role::Image) {
            light[c][s.point] += s.weight;
            for j in 0..n {
                pistons[c][n * s.point + j] += s.weight * path_by(c, i, s.point, j);
            }
        }
    }
    for (row, (c, i, s)) in rays.samples().filter(|(_, _, s)| s.role == Role::Image).enumerate() {
        let root = s.weight.sqrt();
        if wavefront {
            for j in 0..n {
                let piston = pistons[c][n * s.point + j] / light[c][s.point];
                out[(row, j)] = root * (path_by(c, i, s.point, j) - piston);
            }
        } else {
            let [x, y, _] = slopes.of(c, i, n);
            let reference = &references[2 * n * s.point..2 * n * (s.point + 1)];
            for j in 0..n {
                out[(2 * row, j)] = root * (x[j] - reference[j]);
                out[(2 * row + 1, j)] = root * (y[j] - reference[n + j]);
            }
        }
    }
    out
}
