//! How many knots a table needs: the fewest, evenly spaced, that hold a tolerance at radii between them.

use rayon::prelude::*;

use super::super::fit::Of;
use super::{Table, TableSpec};
use crate::error::Result;
use crate::lens::Lens;

/// Intervals tried in turn.
const INTERVALS: [u32; 7] = [6, 8, 12, 16, 24, 32, 48];
/// Radii at which a candidate is compared with traced rays.
const CHECKS: u32 = 23;

/// What the error of a table may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Root mean square error of rays at the sensor's scale, mm.
    pub landing_mm: f64,
    /// Error of the étendue: mean of the differences over the mean.
    pub weight: f64,
}

/// Even knots from the axis to `radius_mm` that hold `tolerance` for objects at `vergence`, and the errors that were seen
/// (in the tolerance's own terms).
///
/// # Errors
/// As [`Table::compute`].
pub fn knots(
    lens: &Lens,
    vergence: f64,
    wavelength_nm: &[f64],
    degree: usize,
    radius_mm: f64,
    tolerance: Tolerance,
) -> Result<(Vec<f64>, Tolerance)> {
    // The ends of the spectrum tell.
    let ends = match wavelength_nm {
        [first, .., last] => vec![*first, *last],
        few => few.to_vec(),
    };
    let spec = |radii_mm: Vec<f64>| TableSpec { radii_mm, wavelength_nm: ends.clone(), degree };
    // Off the axis by irregular steps, so that no candidate's knots are met throughout.
    let place = |i: u32| radius_mm * (f64::from(i) + 0.37 + 0.21 * f64::from(i % 3)) / (f64::from(CHECKS) + 0.2);
    let truth = Table::compute(lens, &spec(std::iter::once(0.0).chain((0..CHECKS).map(place)).collect()))?;
    let even = |n: u32| (0..=n).map(|i| radius_mm * f64::from(i) / f64::from(n)).collect::<Vec<f64>>();
    let mut found = (even(INTERVALS[0]), Tolerance { landing_mm: f64::INFINITY, weight: f64::INFINITY });
    for n in INTERVALS {
        let table = Table::compute(lens, &spec(even(n)))?;
        let seen = difference(&table, &truth, vergence);
        found = (even(n), seen);
        if seen.landing_mm <= tolerance.landing_mm && seen.weight <= tolerance.weight {
            break;
        }
    }
    Ok(found)
}

/// Largest errors of `table` at the knots of `truth` that both have light at.
fn difference(table: &Table, truth: &Table, vergence: f64) -> Tolerance {
    let slopes = truth.chief_slopes(vergence);
    let radii = &truth.spec.radii_mm;
    let errors = (1..radii.len()).into_par_iter().filter(|k| radii[*k] <= table.edge_mm).map(|k| {
        let mm_per_slope = (radii[k] - radii[k - 1]) / (slopes[k] - slopes[k - 1]);
        let mut worst = [0.0f64; 2];
        for l in 0..truth.spec.wavelength_nm.len() {
            let (here, there) = (table.row(l, &table.taps(radii[k])), &truth.rows[k][l]);
            let basis = table.bases.of(1.0);
            let values = |of: usize, c: &[f64]| basis.at_nodes[of].at(Of::Value, c);
            let (a, b) = (here.slope(table, vergence), there.slope(truth, vergence));
            let (mut square, mut count) = (0.0, 0.0);
            for (axis, of) in [(0, 1), (1, 0)] {
                for (p, q) in values(of, &a[axis]).iter().zip(values(of, &b[axis])) {
                    square += (p - q).powi(2);
                    count += 0.5;
                }
            }
            let (w, v) = (values(0, here.weight(table)), values(0, there.weight(truth)));
            let off: f64 = w.iter().zip(&v).map(|(a, b)| (a - b).abs()).sum();
            let all: f64 = v.iter().map(|b| b.abs()).sum();
            worst[0] = worst[0].max((square / count).sqrt() * mm_per_slope.abs());
            worst[1] = worst[1].max(if all > 0.0 { off / all } else { 0.0 });
        }
        worst
    });
    let [landing_mm, weight] = errors.reduce(|| [0.0; 2], |a, b| [a[0].max(b[0]), a[1].max(b[1])]);
    Tolerance { landing_mm, weight }
}
