//! What each variable does to the landings, and how well the adjoint says so.

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::Good;
use crate::lens::{Lens, Medium};
use crate::trace::System;
use crate::trace::landing::{self, Column};
use crate::trace::precise::{Number, derivative};

/// Rays of which one is compared with double-double.
const EVERY: usize = 7;
/// Surfaces times derivatives that are compared at most, but for those of one ray.
const COMPARED: usize = 4_000_000;

/// One variable of the lens.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct VariableHealth {
    /// Its name, as in the gradients of `trace`.
    pub name: String,
    /// Size of one scaled unit, in the variable's own unit.
    pub scale: f64,
    /// Root mean square motion of the landings for one scaled unit, mm, launch rays held.
    pub effect_mm: f64,
    /// Share of its effect that no combination of the other variables can imitate, 0 to 1.
    pub independence: f64,
    /// Worst relative error of the adjoint against double-double; `None` for numbers that it does not move.
    pub gradient_error: Option<f64>,
}

pub(super) struct Conditioning {
    pub(super) variables: Vec<VariableHealth>,
    pub(super) gradient: (f64, String),
    pub(super) scale_ratio: f64,
    pub(super) scale_place: String,
    pub(super) condition: f64,
}

pub(super) fn conditioning(lens: &Lens, system: &System, good: &[Good]) -> Conditioning {
    // The index of air is no number of a lens.
    let of_air = |c: &Column| matches!(c.number, Number::IndexBehind(i) if lens.surfaces[i].medium == Medium::Air);
    let columns: Vec<Column> = landing::columns(lens).into_iter().filter(|c| !of_air(c)).collect();
    // Rays of the first system, the primary wavelength.
    let rays: Vec<&Good> = good.iter().filter(|g| g.system == 0).collect();
    let rows: Vec<Vec<[f64; 2]>> =
        rays.par_iter().map(|g| landing::gradient(lens, system, &g.hits, &columns)).collect();
    let mut errors: Vec<Option<f64>> = vec![None; columns.len()];
    let mut worst = (if rays.is_empty() { f64::INFINITY } else { 0.0 }, String::new());
    // Effects in mm for one scaled unit, and their sizes over all rays.
    let effect: Vec<f64> = (0..columns.len())
        .map(|j| {
            let sum: f64 = rows.iter().map(|r| r[j][0].powi(2) + r[j][1].powi(2)).sum();
            #[expect(clippy::cast_precision_loss, reason = "counts of rays")]
            let count = rays.len().max(1) as f64;
            (sum / count).sqrt() * columns[j].scale
        })
        .collect();
    let strongest = effect.iter().copied().fold(0.0, f64::max);
    // Every seventh ray is compared with differences in double-double; fewer of lenses with thousands of numbers.
    let most = (COMPARED / (columns.len() * lens.surfaces.len()).max(1)).max(1);
    for (ray, row) in rays.iter().zip(&rows).step_by(EVERY.max(rays.len().div_ceil(most))) {
        let of = |c: &Column| derivative(lens, system, ray.ray, &ray.hits, c.number, 1e-10 * c.scale);
        let exact: Vec<Option<[f64; 2]>> = columns.par_iter().map(of).collect();
        for (j, (column, exact)) in columns.iter().zip(exact).enumerate() {
            let Some(exact) = exact else { continue };
            let length = exact[0].hypot(exact[1]);
            // A derivative far below the variable's own mean effect is compared with that, and one far below what the
            // strongest variable does (zero but for rounding, as at surfaces between equal media) with a millionth of it.
            let floor = (1e-3 * effect[j]).max(1e-6 * strongest) / column.scale;
            let off = (row[j][0] - exact[0]).hypot(row[j][1] - exact[1]);
            let error = if off == 0.0 { 0.0 } else { off / length.max(floor) };
            errors[j] = Some(errors[j].unwrap_or(0.0).max(error));
            if error > worst.0 || error.is_nan() {
                worst = (error, format!("{}, {}", column.name, ray.label));
            }
        }
    }
    let acting: Vec<usize> = (0..columns.len()).filter(|j| effect[*j] > 1e-12 * strongest).collect();
    let (independence, condition) = independence(&rows, &columns, &effect, &acting);
    let by_effect = |a: &&usize, b: &&usize| effect[**a].total_cmp(&effect[**b]);
    let (least, most) = (acting.iter().min_by(by_effect), acting.iter().max_by(by_effect));
    let (scale_ratio, scale_place) = match (least, most) {
        (Some(a), Some(b)) => (effect[*b] / effect[*a], format!("{} / {}", columns[*b].name, columns[*a].name)),
        _ => (f64::INFINITY, "no variable moves a landing".to_owned()),
    };
    let variables = columns
        .into_iter()
        .enumerate()
        .map(|(j, c)| VariableHealth {
            name: c.name,
            scale: c.scale,
            effect_mm: effect[j],
            independence: independence[j],
            gradient_error: errors[j],
        })
        .collect();
    Conditioning { variables, gradient: worst, scale_ratio, scale_place, condition }
}

/// Share of each column that the others cannot imitate, and the condition number, both of columns of equal length.
fn independence(rows: &[Vec<[f64; 2]>], columns: &[Column], effect: &[f64], acting: &[usize]) -> (Vec<f64>, f64) {
    let mut share = vec![0.0; columns.len()];
    let height = 2 * rows.len();
    if acting.is_empty() || height < acting.len() || effect.iter().any(|e| !e.is_finite()) {
        return (share, f64::INFINITY);
    }
    let matrix = DMatrix::from_fn(height, acting.len(), |r, j| {
        rows[r / 2][acting[j]][r % 2] * columns[acting[j]].scale / effect[acting[j]]
    });
    let norms: Vec<f64> = matrix.column_iter().map(|c| c.norm()).collect();
    let svd = matrix.svd(false, true);
    let Some(v_t) = svd.v_t else { return (share, f64::INFINITY) };
    let largest = svd.singular_values.max();
    let smallest = svd.singular_values.min();
    // (JᵀJ)⁻¹_jj = Σ v_kj² / σ_k²; singular values below rounding count as rounding.
    let floor = largest * f64::EPSILON;
    for (j, column) in acting.iter().enumerate() {
        let inverse: f64 =
            svd.singular_values.iter().enumerate().map(|(k, s)| (v_t[(k, j)] / s.max(floor)).powi(2)).sum();
        share[*column] = 1.0 / (norms[j] * inverse.sqrt());
    }
    (share, largest / smallest)
}
