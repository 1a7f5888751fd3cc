//! Many sensor points at a time: what every pixel of a line asks a [`SensorMap`] for.

use super::SensorMap;
use isoplanat_base::math::wide::{Work, wide};

/// Radii that are worked on together; sums run by lane, then over the lanes in order, whatever the vectors' width.
const LANES: usize = 16;

/// Points of the sensor along a row of a raster, in cells from the axis.
#[derive(Clone, Debug, Default)]
pub struct SensorLine {
    /// Offsets along columns, one a point.
    pub columns: Vec<f64>,
    /// Offset along rows, the same for all.
    pub row: f64,
    /// Side of a cell, mm.
    pub cell_mm: f64,
    /// Squared sensor radii, mm², as [`SensorMap::line`] left them.
    squares: Vec<f64>,
}

/// Cotangents on the slopes of a line's points, being added up for [`SensorMap::line_vjp`].
#[derive(Clone, Debug, Default)]
pub struct LineBar {
    factor: f64,
    /// On the ratios of slope and radius.
    weights: Vec<f64>,
}

impl LineBar {
    /// Begins anew, for the points of `line` and cotangents that are to be taken `scale` times.
    pub fn begin(&mut self, line: &SensorLine, scale: f64) {
        self.factor = scale * line.cell_mm;
        self.weights.clear();
        self.weights.resize(line.columns.len(), 0.0);
    }

    /// Adds a cotangent `by` times `gradient`, along columns and rows, on the slopes of point `j`.
    #[inline]
    pub fn add(&mut self, line: &SensorLine, j: usize, by: f64, gradient: [f64; 2]) {
        let [gx, gy] = gradient;
        self.weights[j] += self.factor * by * (gx * line.columns[j] + gy * line.row);
    }
}

impl SensorMap {
    /// Writes the object slopes of a line's points, times `scale`, along columns and rows.
    #[doc(hidden)]
    pub fn line(&self, line: &mut SensorLine, scale: f64, [column, row]: [&mut Vec<f64>; 2]) {
        let (cell, y_mm) = (line.cell_mm, line.row * line.cell_mm);
        line.squares.clear();
        line.squares.extend(line.columns.iter().map(|x| (x * cell) * (x * cell) + y_mm * y_mm));
        column.clone_from(&line.squares);
        self.ratios(column);
        row.clear();
        for (to, x) in column.iter_mut().zip(&line.columns) {
            let ratio = *to * scale;
            *to = x * cell * ratio;
            row.push(y_mm * ratio);
        }
    }

    /// Adds the pull-back of cotangents on the slopes of [`Self::line`] to that of the coefficients.
    #[doc(hidden)]
    pub fn line_vjp(&self, line: &SensorLine, bar: &LineBar, coefficients_bar: &mut [f64]) {
        self.ratios_vjp(&line.squares, &bar.weights, coefficients_bar);
    }

    /// Object slopes along columns and rows, times `scale`, of the point `[column, row]` mm from the axis.
    #[doc(hidden)]
    #[inline]
    pub fn slopes(&self, [x, y]: [f64; 2], scale: f64) -> [f64; 2] {
        let ratio = self.ratio_at(x * x + y * y) * scale;
        [x * ratio, y * ratio]
    }

    /// Replaces squared sensor radii, mm², by [`Self::ratio_at`] of them: the same bits.
    fn ratios(&self, squares_mm2: &mut [f64]) {
        wide(Ratios { map: self, squares: squares_mm2 });
    }

    /// Adds `Σ weight · ∂ratio/∂c` at squared sensor radii, mm², to the coefficients' cotangent.
    fn ratios_vjp(&self, squares_mm2: &[f64], weights: &[f64], coefficients_bar: &mut [f64]) {
        assert_eq!(squares_mm2.len(), weights.len(), "a weight for every point");
        wide(CoefficientSums { map: self, squares: squares_mm2, weights, out: coefficients_bar });
    }
}

struct Ratios<'a> {
    map: &'a SensorMap,
    squares: &'a mut [f64],
}

impl Work for Ratios<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { map, squares } = self;
        let (scale, first) = (map.inverse_square, map.coefficients[0]);
        for chunk in squares.chunks_mut(LANES) {
            let mut x2 = [0.0; LANES];
            x2.iter_mut().zip(&*chunk).for_each(|(x, s)| *x = s * scale);
            let t = x2.map(|x| 2.0 * x - 1.0);
            let (mut b1, mut b2) = ([0.0; LANES], [0.0; LANES]);
            for c in map.coefficients[1..].iter().rev() {
                for k in 0..LANES {
                    (b2[k], b1[k]) = (b1[k], c + 2.0 * t[k] * b1[k] - b2[k]);
                }
            }
            for (k, value) in chunk.iter_mut().enumerate() {
                *value = if x2[k] <= 1.0 {
                    (first + t[k] * b1[k] - b2[k]) / map.below(*value)
                } else {
                    map.ratio(value.sqrt())
                };
            }
        }
    }
}

struct CoefficientSums<'a> {
    map: &'a SensorMap,
    squares: &'a [f64],
    weights: &'a [f64],
    out: &'a mut [f64],
}

/// Coefficients that are summed by lanes.
const MOST: usize = 16;

impl Work for CoefficientSums<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { map, squares, weights, out } = self;
        let scale = map.inverse_square;
        let mut sums = [[0.0; LANES]; MOST];
        let terms = &mut sums[..out.len()];
        for (squares, weights) in squares.chunks(LANES).zip(weights.chunks(LANES)) {
            let (mut t, mut w) = ([0.0; LANES], [0.0; LANES]);
            for (k, (s, weight)) in squares.iter().zip(weights).enumerate() {
                let x2 = s * scale;
                if x2 <= 1.0 {
                    (t[k], w[k]) = (2.0 * x2 - 1.0, *weight / map.below(*s));
                } else if *weight != 0.0 {
                    let radius = s.sqrt();
                    map.slope_vjp(radius, weight / radius, out);
                }
            }
            let (mut a, mut b) = ([1.0; LANES], t);
            for sum in &mut *terms {
                for k in 0..LANES {
                    sum[k] += w[k] * a[k];
                    (a[k], b[k]) = (b[k], 2.0 * t[k] * b[k] - a[k]);
                }
            }
        }
        for (o, sum) in out.iter_mut().zip(&*terms) {
            *o += sum.iter().sum::<f64>();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::map;
    use super::{LineBar, SensorLine};
    use isoplanat_base::testing::{assert_rel, central_difference};

    /// Lines give the bits of single radii, beyond the edge too; their pull-back is the sum of the single ones.
    #[test]
    fn lines_are_their_radii_one_by_one() {
        let mut map = map("two_element", 20.0, 1e-3);
        map.horizon = (30.0f64 * 30.0).recip();
        map.find_edge();
        let rng = &mut fastrand::Rng::with_seed(3);
        for count in [1, 15, 16, 37] {
            let squares: Vec<f64> = (0..count).map(|_| (25.0 * rng.f64()).powi(2)).collect();
            let mut line = squares.clone();
            map.ratios(&mut line);
            assert!(line.iter().zip(&squares).all(|(l, s)| l.to_bits() == map.ratio_at(*s).to_bits()));
            let weights: Vec<f64> = (0..count).map(|_| rng.f64() - 0.5).collect();
            let (mut found, mut expected) = (vec![0.0; map.coefficients.len()], vec![0.0; map.coefficients.len()]);
            map.ratios_vjp(&squares, &weights, &mut found);
            for (s, w) in squares.iter().zip(&weights) {
                map.slope_vjp(s.sqrt(), w / s.sqrt(), &mut expected);
            }
            found.iter().zip(&expected).for_each(|(f, e)| assert_rel(*f, *e, 1e-12, 1e-3, "coefficient"));
        }
    }
    /// A line's slopes are those of its points, to the bit; their pull-back agrees with differences of the coefficients.
    #[test]
    fn lines_are_their_points() {
        let map = map("two_element", 20.0, 1e-3);
        let columns = (0..21).map(|i| f64::from(i) - 8.3).collect();
        let mut line = SensorLine { columns, row: 3.4, cell_mm: 1.1, ..SensorLine::default() };
        let scale = 100.0;
        let (mut across, mut down) = (Vec::new(), Vec::new());
        map.line(&mut line, scale, [&mut across, &mut down]);
        let rng = &mut fastrand::Rng::with_seed(4);
        let bars: Vec<(f64, [f64; 2])> = (0..21).map(|_| (rng.f64(), [rng.f64() - 0.5, rng.f64() - 0.5])).collect();
        let mut bar = LineBar::default();
        bar.begin(&line, scale);
        for (j, (by, gradient)) in bars.iter().enumerate() {
            let at = [line.columns[j] * line.cell_mm, line.row * line.cell_mm];
            assert_eq!(map.slopes(at, scale), [across[j], down[j]], "point {j}");
            bar.add(&line, j, *by, *gradient);
        }
        let mut found = vec![0.0; map.coefficients.len()];
        map.line_vjp(&line, &bar, &mut found);
        for (k, found) in found.into_iter().enumerate() {
            let value = |h: f64| {
                let mut line = line.clone();
                let (mut x, mut y) = (Vec::new(), Vec::new());
                map.changed(k, h).line(&mut line, scale, [&mut x, &mut y]);
                bars.iter().zip(x.iter().zip(&y)).map(|((by, g), (x, y))| by * (g[0] * x + g[1] * y)).sum::<f64>()
            };
            assert_rel(found, central_difference(value, 1e-6), 1e-7, 1.0, &format!("coefficient {k}"));
        }
    }
}
