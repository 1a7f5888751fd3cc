//! Two-dimensional real FFTs with cached plans (rustfft, realfft).

use std::cell::RefCell;
use std::sync::Arc;

use ndarray::{Array2, ArrayView2, Axis};
use realfft::{ComplexToReal, FftNum, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

/// Plans for one size; cheap to share between threads.
#[derive(Clone)]
pub struct RealFft2<T: FftNum> {
    rows: usize,
    cols: usize,
    forward_rows: Arc<dyn RealToComplex<T>>,
    inverse_rows: Arc<dyn ComplexToReal<T>>,
    forward_cols: Arc<dyn Fft<T>>,
    inverse_cols: Arc<dyn Fft<T>>,
}

/// Half spectrum, stored transposed: `[column frequency, row frequency]`, so that both passes run over rows.
pub(crate) type Spectrum<T> = Array2<Complex<T>>;

/// Rows that are turned to columns at a time: a cache line of each column is met once.
const TILE: usize = 8;

impl<T: FftNum> RealFft2<T> {
    /// Plans for `rows × cols`, both at least 1.
    pub fn new(rows: usize, cols: usize) -> Self {
        Self::planned((&mut RealFftPlanner::new(), &mut FftPlanner::new()), rows, cols)
    }

    fn planned((real, complex): (&mut RealFftPlanner<T>, &mut FftPlanner<T>), rows: usize, cols: usize) -> Self {
        Self {
            rows,
            cols,
            forward_rows: real.plan_fft_forward(cols),
            inverse_rows: real.plan_fft_inverse(cols),
            forward_cols: complex.plan_fft_forward(rows),
            inverse_cols: complex.plan_fft_inverse(rows),
        }
    }

    /// Spectrum of `image` in the first corner of a zero raster of the planned size.
    pub fn forward(&self, image: ArrayView2<'_, T>) -> Spectrum<T> {
        let half = self.cols / 2 + 1;
        let mut out = Array2::from_elem((half, self.rows), Complex::new(T::zero(), T::zero()));
        let mut line = self.forward_rows.make_input_vec();
        let mut lines = vec![Complex::new(T::zero(), T::zero()); TILE * half];
        let mut scratch = self.forward_rows.make_scratch_vec();
        let columns = out.as_slice_mut().expect("standard layout");
        for (tile, some) in image.axis_chunks_iter(Axis(0), TILE).enumerate() {
            for (row, freq) in some.outer_iter().zip(lines.chunks_exact_mut(half)) {
                line.fill(T::zero());
                line.iter_mut().zip(row).for_each(|(a, b)| *a = *b);
                self.forward_rows.process_with_scratch(&mut line, freq, &mut scratch).expect("planned lengths");
            }
            let (first, count) = (TILE * tile, some.nrows());
            for (j, column) in columns.chunks_exact_mut(self.rows).enumerate() {
                let to = &mut column[first..first + count];
                to.iter_mut().zip(lines.iter().skip(j).step_by(half)).for_each(|(to, from)| *to = *from);
            }
        }
        let slice = out.as_slice_mut().expect("standard layout");
        let mut scratch = vec![Complex::new(T::zero(), T::zero()); self.forward_cols.get_inplace_scratch_len()];
        self.forward_cols.process_with_scratch(slice, &mut scratch);
        out
    }

    /// Image of a spectrum (consumed), scaled so that `inverse(forward(x)) = x`; only rows `first..first + count`.
    pub fn inverse(&self, spectrum: Spectrum<T>, first: usize, count: usize) -> Array2<T> {
        let scale = T::one() / T::from_usize(self.rows * self.cols).expect("a size");
        self.unscaled(spectrum, first, count).mapv_into(|v| v * scale)
    }

    /// [`Self::inverse`] times the number of pixels of the planned size.
    pub fn unscaled(&self, mut spectrum: Spectrum<T>, first: usize, count: usize) -> Array2<T> {
        let slice = spectrum.as_slice_mut().expect("standard layout");
        let mut scratch = vec![Complex::new(T::zero(), T::zero()); self.inverse_cols.get_inplace_scratch_len()];
        self.inverse_cols.process_with_scratch(slice, &mut scratch);
        let mut out = Array2::from_elem((count, self.cols), T::zero());
        let half = self.cols / 2 + 1;
        let mut lines = vec![Complex::new(T::zero(), T::zero()); TILE * half];
        let mut line = self.inverse_rows.make_output_vec();
        let mut scratch = self.inverse_rows.make_scratch_vec();
        let columns = spectrum.as_slice().expect("standard layout");
        for (tile, mut some) in out.axis_chunks_iter_mut(Axis(0), TILE).enumerate() {
            let (first, count) = (first + TILE * tile, some.nrows());
            for (j, column) in columns.chunks_exact(self.rows).enumerate() {
                let from = &column[first..first + count];
                lines.iter_mut().skip(j).step_by(half).zip(from).for_each(|(to, from)| *to = *from);
            }
            for (mut row, freq) in some.outer_iter_mut().zip(lines.chunks_exact_mut(half)) {
                // The imaginary parts of the two real lines are rounding; realfft refuses them otherwise.
                freq[0].im = T::zero();
                if self.cols.is_multiple_of(2) {
                    freq[half - 1].im = T::zero();
                }
                self.inverse_rows.process_with_scratch(freq, &mut line, &mut scratch).expect("planned lengths");
                row.iter_mut().zip(&line).for_each(|(a, b)| *a = *b);
            }
        }
        out
    }
}

thread_local! {
    static PLANS: RefCell<FftPlanner<f64>> = RefCell::new(FftPlanner::new());
    static REAL_PLANS: RefCell<RealFftPlanner<f64>> = RefCell::new(RealFftPlanner::new());
}

impl RealFft2<f64> {
    /// As [`Self::new`], of plans that the thread keeps: for transforms of the same few sizes again and again.
    pub fn shared(rows: usize, cols: usize) -> Self {
        let with =
            |real: &mut RealFftPlanner<f64>, complex: &mut FftPlanner<f64>| Self::planned((real, complex), rows, cols);
        REAL_PLANS.with_borrow_mut(|real| PLANS.with_borrow_mut(|complex| with(real, complex)))
    }
}

/// Transforms the rows of an array in standard layout, in place; neither way is scaled.
///
/// # Panics
/// For another layout.
pub fn fft_rows(all: &mut Array2<Complex<f64>>, forward: bool) {
    let n = all.ncols();
    let plan = PLANS.with_borrow_mut(|p| if forward { p.plan_fft_forward(n) } else { p.plan_fft_inverse(n) });
    plan.process(all.as_slice_mut().expect("standard layout"));
}

/// The smallest even size ≥ `n` whose factors are 2, 3 and 5.
pub fn good_size(n: usize) -> usize {
    let smooth = |mut m: usize| {
        for p in [2, 3, 5] {
            while m.is_multiple_of(p) {
                m /= p;
            }
        }
        m == 1
    };
    (n.max(2)..).find(|m| m % 2 == 0 && smooth(*m)).expect("powers of two have no end")
}

/// The smallest size ≥ `n` that rustfft's vector code is fast at: a multiple of four whose other factors are 2, 3 and at
/// most one 5.
///
/// Measured in f32 (ns a line): 100 takes 187 and 108 takes 88, 150 takes 250 and 160 takes 118, 200 takes 215 and 216
/// takes 157, 192 takes 125 and 256 takes 144.
pub fn fast_size(n: usize) -> usize {
    let fast = |mut m: usize| {
        if !m.is_multiple_of(4) {
            return false;
        }
        if m.is_multiple_of(5) {
            m /= 5;
        }
        for p in [2, 3] {
            while m.is_multiple_of(p) {
                m /= p;
            }
        }
        m == 1
    };
    (n.max(1)..).find(|m| fast(*m)).expect("powers of two have no end")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forward_then_inverse_is_the_identity() {
        for (rows, cols) in [(12, 10), (5, 8), (1, 2), (15, 18)] {
            let plan = RealFft2::<f64>::new(rows, cols);
            let rng = &mut fastrand::Rng::with_seed(1);
            let x = Array2::from_shape_fn((rows, cols), |_| rng.f64());
            let y = plan.inverse(plan.forward(x.view()), 0, rows);
            assert!(x.iter().zip(&y).all(|(a, b)| (a - b).abs() < 1e-14));
        }
    }

    /// One bin by its definition, where the type stands; the mean at the origin.
    #[test]
    fn a_bin_is_the_sum_of_its_definition() {
        let rng = &mut fastrand::Rng::with_seed(1);
        let field = Array2::from_shape_fn((15, 18), |_| rng.f32());
        let plan = RealFft2::new(15, 18);
        let spectrum = plan.forward(field.view());
        assert!((spectrum[[0, 0]].re - field.sum()).abs() < 1e-3 && spectrum.dim() == (10, 15));
        let bin: Complex<f32> = field
            .indexed_iter()
            .map(|((r, c), v)| {
                let phase = 2.0 * r as f32 / 15.0 + 3.0 * c as f32 / 18.0;
                Complex::from_polar(*v, -std::f32::consts::TAU * phase)
            })
            .sum();
        assert!((spectrum[[3, 2]] - bin).norm() < 1e-3);
        let back = plan.inverse(spectrum, 0, 15);
        assert!(field.iter().zip(&back).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn fast_sizes_have_at_most_one_five() {
        assert_eq!([0, 1, 5, 98, 129, 150, 193, 241].map(fast_size), [4, 4, 8, 108, 144, 160, 216, 256]);
        assert_eq!([2, 7, 31, 121].map(good_size), [2, 8, 32, 128]);
    }
}
