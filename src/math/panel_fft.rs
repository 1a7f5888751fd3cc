//! Complex FFTs of many columns at once, in place, for convolutions.
//!
//! A panel is [`LANES`] columns side by side; the transform runs down the rows and treats the columns as vector lanes,
//! so nothing is transposed. The forward transform (decimation in frequency) leaves the frequencies in digit-reversed
//! order and the inverse (decimation in time) takes them so: products of spectra do not care about the order. Sizes
//! have the factors 2, 3 and 5. Source: Van Loan, Computational Frameworks for the FFT, §1.8 and §2.1.

use realfft::FftNum;

/// Columns of a panel.
pub const LANES: usize = 16;

/// One row of a panel: real parts, imaginary parts.
pub type Line<T> = [[T; LANES]; 2];

/// A plan for one number of rows.
#[derive(Clone, Debug)]
pub struct PanelFft<T> {
    size: usize,
    stages: Vec<Stage<T>>,
}

#[derive(Clone, Debug)]
struct Stage<T> {
    radix: usize,
    /// Length of the transforms this stage splits.
    len: usize,
    /// `exp(−2πi j u / len)` at `[j * (radix − 1) + u − 1]`.
    twiddles: Vec<[T; 2]>,
}

impl<T: FftNum> PanelFft<T> {
    /// A plan for `size` rows; `None` unless `size` is a product of 2, 3 and 5.
    pub fn new(size: usize) -> Option<Self> {
        let (mut stages, mut len) = (Vec::new(), size);
        if size == 0 {
            return None;
        }
        while len > 1 {
            let radix = [4, 2, 3, 5].into_iter().find(|r| len.is_multiple_of(*r))?;
            let pairs = (0..len / radix).flat_map(|j| (1..radix).map(move |u| (j * u) % len));
            let twiddles = pairs
                .map(|turn| {
                    let angle = -std::f64::consts::TAU * turn as f64 / len as f64;
                    [angle.cos(), angle.sin()].map(|v| T::from_f64(v).unwrap_or_else(T::zero))
                })
                .collect();
            stages.push(Stage { radix, len, twiddles });
            len /= radix;
        }
        Some(Self { size, stages })
    }

    /// Rows.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Spectra of the columns, frequencies in the plan's own order. `panel` has [`Self::size`] lines.
    #[inline(always)]
    pub fn forward(&self, panel: &mut [Line<T>]) {
        for stage in &self.stages {
            for block in panel.chunks_exact_mut(stage.len) {
                match stage.radix {
                    2 => by2::<T, false>(stage, block),
                    3 => by3::<T, false>(stage, block),
                    4 => by4::<T, false>(stage, block),
                    _ => by5::<T, false>(stage, block),
                }
            }
        }
    }

    /// Columns of spectra in the plan's own order, times [`Self::size`].
    #[inline(always)]
    pub fn inverse(&self, panel: &mut [Line<T>]) {
        for stage in self.stages.iter().rev() {
            for block in panel.chunks_exact_mut(stage.len) {
                match stage.radix {
                    2 => by2::<T, true>(stage, block),
                    3 => by3::<T, true>(stage, block),
                    4 => by4::<T, true>(stage, block),
                    _ => by5::<T, true>(stage, block),
                }
            }
        }
    }
}

/// One stage on one block: small transforms of lines `len / radix` apart, then twiddles (before them in the inverse).
///
/// A macro and plain loops instead of closures: only code that is inlined is compiled for the caller's vectors.
macro_rules! stage {
    ($name:ident, $radix:literal, $dft:ident) => {
        #[inline(always)]
        fn $name<T: FftNum, const INVERSE: bool>(stage: &Stage<T>, block: &mut [Line<T>]) {
            let step = block.len() / $radix;
            for j in 0..step {
                let mut x = [[[T::zero(); LANES]; 2]; $radix];
                for t in 0..$radix {
                    x[t] = block[t * step + j];
                }
                if step > 1 {
                    let twiddles = &stage.twiddles[j * ($radix - 1)..(j + 1) * ($radix - 1)];
                    if INVERSE {
                        for u in 1..$radix {
                            x[u] = turn(&x[u], [twiddles[u - 1][0], -twiddles[u - 1][1]]);
                        }
                    }
                    x = $dft::<T, INVERSE>(&x);
                    if !INVERSE {
                        for u in 1..$radix {
                            x[u] = turn(&x[u], twiddles[u - 1]);
                        }
                    }
                } else {
                    x = $dft::<T, INVERSE>(&x);
                }
                for t in 0..$radix {
                    block[t * step + j] = x[t];
                }
            }
        }
    };
}

stage!(by2, 2, dft2);
stage!(by3, 3, dft3);
stage!(by4, 4, dft4);
stage!(by5, 5, dft5);

#[inline(always)]
fn add<T: FftNum>(a: &Line<T>, b: &Line<T>) -> Line<T> {
    let mut y = *a;
    for l in 0..LANES {
        y[0][l] = a[0][l] + b[0][l];
        y[1][l] = a[1][l] + b[1][l];
    }
    y
}

#[inline(always)]
fn sub<T: FftNum>(a: &Line<T>, b: &Line<T>) -> Line<T> {
    let mut y = *a;
    for l in 0..LANES {
        y[0][l] = a[0][l] - b[0][l];
        y[1][l] = a[1][l] - b[1][l];
    }
    y
}

#[inline(always)]
fn scale<T: FftNum>(a: &Line<T>, s: T) -> Line<T> {
    let mut y = *a;
    for l in 0..LANES {
        y[0][l] = a[0][l] * s;
        y[1][l] = a[1][l] * s;
    }
    y
}

/// `z · w`.
#[inline(always)]
fn turn<T: FftNum>(z: &Line<T>, w: [T; 2]) -> Line<T> {
    let mut y = *z;
    for l in 0..LANES {
        y[0][l] = z[0][l] * w[0] - z[1][l] * w[1];
        y[1][l] = z[0][l] * w[1] + z[1][l] * w[0];
    }
    y
}

/// `−i z`, or `i z` in the inverse.
#[inline(always)]
fn quarter<T: FftNum, const INVERSE: bool>(z: &Line<T>) -> Line<T> {
    let mut y = [z[1], z[0]];
    let negated = if INVERSE { 0 } else { 1 };
    for v in &mut y[negated] {
        *v = -*v;
    }
    y
}

#[inline(always)]
fn dft2<T: FftNum, const INVERSE: bool>(x: &[Line<T>; 2]) -> [Line<T>; 2] {
    [add(&x[0], &x[1]), sub(&x[0], &x[1])]
}

#[inline(always)]
fn dft3<T: FftNum, const INVERSE: bool>(x: &[Line<T>; 3]) -> [Line<T>; 3] {
    let sin = T::from_f64(0.75f64.sqrt()).unwrap_or_else(T::zero);
    let half = T::from_f64(0.5).unwrap_or_else(T::zero);
    let sum = add(&x[1], &x[2]);
    let middle = sub(&x[0], &scale(&sum, half));
    let side = quarter::<T, INVERSE>(&scale(&sub(&x[1], &x[2]), sin));
    [add(&x[0], &sum), add(&middle, &side), sub(&middle, &side)]
}

#[inline(always)]
fn dft4<T: FftNum, const INVERSE: bool>(x: &[Line<T>; 4]) -> [Line<T>; 4] {
    let (s0, d0) = (add(&x[0], &x[2]), sub(&x[0], &x[2]));
    let (s1, d1) = (add(&x[1], &x[3]), quarter::<T, INVERSE>(&sub(&x[1], &x[3])));
    [add(&s0, &s1), add(&d0, &d1), sub(&s0, &s1), sub(&d0, &d1)]
}

#[inline(always)]
fn dft5<T: FftNum, const INVERSE: bool>(x: &[Line<T>; 5]) -> [Line<T>; 5] {
    let real = |v: f64| T::from_f64(v).unwrap_or_else(T::zero);
    // cos and sin of 72° and 144°.
    let (c1, s1) = (real(0.309_016_994_374_947_45), real(0.951_056_516_295_153_5));
    let (c2, s2) = (real(-0.809_016_994_374_947_5), real(0.587_785_252_292_473_1));
    let (p1, m1) = (add(&x[1], &x[4]), sub(&x[1], &x[4]));
    let (p2, m2) = (add(&x[2], &x[3]), sub(&x[2], &x[3]));
    let a1 = add(&x[0], &add(&scale(&p1, c1), &scale(&p2, c2)));
    let a2 = add(&x[0], &add(&scale(&p1, c2), &scale(&p2, c1)));
    let b1 = quarter::<T, INVERSE>(&add(&scale(&m1, s1), &scale(&m2, s2)));
    let b2 = quarter::<T, INVERSE>(&sub(&scale(&m1, s2), &scale(&m2, s1)));
    [add(&x[0], &add(&p1, &p2)), add(&a1, &b1), add(&a2, &b2), sub(&a2, &b2), sub(&a1, &b1)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::array::from_fn;

    fn panel(size: usize, rng: &mut fastrand::Rng) -> Vec<Line<f64>> {
        (0..size).map(|_| from_fn(|_| from_fn(|_| rng.f64() - 0.5))).collect()
    }

    /// Row of each frequency, found from the spectrum of a shifted delta.
    fn order(plan: &PanelFft<f64>) -> Vec<usize> {
        let n = plan.size();
        let mut x = vec![[[0.0; LANES]; 2]; n];
        x[1 % n][0] = [1.0; LANES];
        plan.forward(&mut x);
        let turn = |l: &Line<f64>| (-l[1][0]).atan2(l[0][0]) / std::f64::consts::TAU * n as f64;
        x.iter().map(|l| turn(l).round().rem_euclid(n as f64) as usize % n).collect()
    }

    /// The spectrum is the plain sum, each frequency once, and the inverse undoes it.
    #[test]
    fn spectra_are_the_plain_sum_in_some_order() {
        let rng = &mut fastrand::Rng::with_seed(1);
        for size in [1, 2, 3, 4, 5, 6, 8, 9, 12, 15, 16, 18, 20, 25, 30, 45, 96, 120, 128, 144, 150] {
            let plan = PanelFft::new(size).expect("smooth");
            let order = order(&plan);
            let mut seen = order.clone();
            seen.sort_unstable();
            assert_eq!(seen, (0..size).collect::<Vec<_>>());
            let x = panel(size, rng);
            let mut y = x.clone();
            plan.forward(&mut y);
            for (line, k) in y.iter().zip(&order) {
                for l in 0..LANES {
                    let sum = (0..size).fold([0.0, 0.0], |s, j| {
                        let (sin, cos) = (-std::f64::consts::TAU * ((j * k) % size) as f64 / size as f64).sin_cos();
                        let (re, im) = (x[j][0][l], x[j][1][l]);
                        [s[0] + re * cos - im * sin, s[1] + re * sin + im * cos]
                    });
                    assert!((line[0][l] - sum[0]).abs() < 1e-12 && (line[1][l] - sum[1]).abs() < 1e-12, "{size}");
                }
            }
            plan.inverse(&mut y);
            let worst =
                x.iter().zip(&y).flat_map(|(a, b)| (0..2).map(move |i| (a[i][3] * size as f64 - b[i][3]).abs()));
            assert!(worst.fold(0.0, f64::max) < 1e-12 * size as f64);
        }
    }

    #[test]
    fn other_factors_have_no_plan() {
        assert!([0, 7, 11, 14].iter().all(|n| PanelFft::<f32>::new(*n).is_none()));
    }
}
