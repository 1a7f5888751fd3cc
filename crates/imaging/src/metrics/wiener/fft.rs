//! Two-dimensional real transforms of one size.

use std::sync::Arc;

use ndarray::Array2;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex;

/// A two-dimensional real transform; spectra are `[row, col]` with `cols / 2 + 1` columns, row by row.
pub(super) struct Fft2 {
    pub(super) rows: usize,
    pub(super) cols: usize,
    forward_row: Arc<dyn RealToComplex<f32>>,
    inverse_row: Arc<dyn ComplexToReal<f32>>,
    forward_col: Arc<dyn rustfft::Fft<f32>>,
    inverse_col: Arc<dyn rustfft::Fft<f32>>,
}

impl Fft2 {
    /// Plans for one size; `cols` is even.
    pub(super) fn new(rows: usize, cols: usize) -> Self {
        let (mut real, mut complex) = (RealFftPlanner::new(), rustfft::FftPlanner::new());
        Self {
            rows,
            cols,
            forward_row: real.plan_fft_forward(cols),
            inverse_row: real.plan_fft_inverse(cols),
            forward_col: complex.plan_fft_forward(rows),
            inverse_col: complex.plan_fft_inverse(rows),
        }
    }

    /// The spectrum of a field.
    pub(super) fn forward(&self, mut field: Array2<f32>) -> Vec<Complex<f32>> {
        let width = self.cols / 2 + 1;
        let mut spectrum = vec![Complex::default(); self.rows * width];
        let samples = field.as_slice_mut().expect("just allocated");
        for (from, to) in samples.chunks_mut(self.cols).zip(spectrum.chunks_mut(width)) {
            self.forward_row.process(from, to).expect("buffers have the plan's lengths");
        }
        self.columns(&mut spectrum, self.forward_col.as_ref());
        spectrum
    }

    /// The field of a spectrum, scaled so that it undoes [`Self::forward`].
    pub(super) fn inverse(&self, mut spectrum: Vec<Complex<f32>>) -> Array2<f32> {
        let width = self.cols / 2 + 1;
        self.columns(&mut spectrum, self.inverse_col.as_ref());
        let mut field = Array2::zeros((self.rows, self.cols));
        let samples = field.as_slice_mut().expect("just allocated");
        for (from, to) in spectrum.chunks_mut(width).zip(samples.chunks_mut(self.cols)) {
            // Rounding leaves a trace where a real signal has none.
            from[0].im = 0.0;
            from[width - 1].im = 0.0;
            self.inverse_row.process(from, to).expect("buffers have the plan's lengths");
        }
        field / (self.rows * self.cols) as f32
    }

    /// Transforms the columns, eight at a time so that memory is read in lines.
    fn columns(&self, spectrum: &mut [Complex<f32>], fft: &dyn rustfft::Fft<f32>) {
        let width = self.cols / 2 + 1;
        let mut block = vec![Complex::default(); 8 * self.rows];
        for first in (0..width).step_by(8) {
            let count = 8.min(width - first);
            for r in 0..self.rows {
                (0..count).for_each(|j| block[j * self.rows + r] = spectrum[r * width + first + j]);
            }
            fft.process(&mut block[..count * self.rows]);
            for r in 0..self.rows {
                (0..count).for_each(|j| spectrum[r * width + first + j] = block[j * self.rows + r]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_undoes_the_forward_transform_and_sizes_are_smooth() {
        let rng = &mut fastrand::Rng::with_seed(1);
        let field = Array2::from_shape_fn((15, 18), |_| rng.f32());
        let fft = Fft2::new(15, 18);
        let spectrum = fft.forward(field.clone());
        assert!((spectrum[0].re - field.sum()).abs() < 1e-3 && spectrum.len() == 15 * 10);
        // One bin by its definition.
        let bin: Complex<f32> = field
            .indexed_iter()
            .map(|((r, c), v)| {
                let phase = 2.0 * r as f32 / 15.0 + 3.0 * c as f32 / 18.0;
                Complex::from_polar(*v, -std::f32::consts::TAU * phase)
            })
            .sum();
        assert!((spectrum[2 * 10 + 3] - bin).norm() < 1e-3);
        let worst = (&fft.inverse(spectrum) - &field).iter().fold(0.0f32, |a, v| a.max(v.abs()));
        assert!(worst < 1e-6, "{worst}");
        assert_eq!([2, 7, 31, 121].map(isoplanat_base::math::fft::good_size), [2, 8, 32, 128]);
    }
}
