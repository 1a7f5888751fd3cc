//! How many knots a table needs: even intervals are halved until what lies between them is told by the others.

use rayon::prelude::*;

use super::super::fit::Of;
use super::{Table, TableSpec};
use crate::error::Result;
use crate::lens::Lens;

/// Intervals at first, and at most.
const INTERVALS: [u32; 2] = [6, 96];
/// Halving the intervals makes the error of six-point interpolation so many times smaller, at least.
const GAIN: f64 = 16.0;

/// What the error of a table may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Root mean square error of rays at the sensor's scale, mm.
    pub landing_mm: f64,
    /// Error of the étendue: mean of the differences over the mean.
    pub weight: f64,
}

/// Even knots from the axis to `radius_mm` that hold `tolerance` for objects at `vergence`, and their errors (in the
/// tolerance's own terms): what every second knot misses at the others, over what halving wins.
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
    let even = |n: u32| (0..=n).map(|i| radius_mm * f64::from(i) / f64::from(n)).collect::<Vec<f64>>();
    let holds = |t: Tolerance| t.landing_mm <= tolerance.landing_mm && t.weight <= tolerance.weight;
    let mut n = INTERVALS[0];
    loop {
        let spec = TableSpec { radii_mm: even(2 * n), wavelength_nm: ends.clone(), degree };
        let fine = Table::compute(lens, &spec)?;
        let coarse = difference(&fine.halved(), &fine, vergence);
        if holds(coarse) {
            return Ok((even(n), coarse));
        }
        let finer = Tolerance { landing_mm: coarse.landing_mm / GAIN, weight: coarse.weight / GAIN };
        if holds(finer) || 4 * n > INTERVALS[1] {
            return Ok((even(2 * n), finer));
        }
        n *= 2;
    }
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
