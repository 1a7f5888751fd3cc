//! Many sensor radii at a time: what every pixel of a line asks a [`SensorMap`] for.

use super::SensorMap;
use isoplanat_base::math::wide::{Work, wide};

/// Radii that are worked on together; sums run by lane, then over the lanes in order, whatever the vectors' width.
const LANES: usize = 16;

impl SensorMap {
    /// Replaces squared sensor radii, mm², by [`Self::ratio_at`] of them: the same bits.
    pub fn ratios(&self, squares_mm2: &mut [f64]) {
        wide(Ratios { map: self, squares: squares_mm2 });
    }

    /// Adds `Σ weight · ∂ratio/∂c` at squared sensor radii, mm², to the coefficients' cotangent.
    ///
    /// # Panics
    /// If there are not as many weights as squares.
    pub fn ratios_vjp(&self, squares_mm2: &[f64], weights: &[f64], coefficients_bar: &mut [f64]) {
        assert_eq!(squares_mm2.len(), weights.len(), "a weight for every radius");
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
    use isoplanat_base::testing::assert_rel;

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
}
