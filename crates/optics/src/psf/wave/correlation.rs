//! Correlation of a pupil's amplitudes with themselves, by FFT.

use ndarray::{Array2, s};
use rustfft::num_complex::Complex;

use isoplanat_base::math::fft::fft_rows;

/// Spectrum of amplitudes `[row, column]` in the first corner of an `n × n` raster: `[column, row]`.
pub(super) fn spectrum(amplitude: &Array2<Complex<f64>>, n: usize) -> Array2<Complex<f64>> {
    let (rows, cols) = amplitude.dim();
    let none = Complex::new(0.0, 0.0);
    let mut lines = Array2::from_elem((rows, n), none);
    lines.slice_mut(s![.., ..cols]).assign(amplitude);
    fft_rows(&mut lines, true);
    let mut spectrum = Array2::from_elem((n, n), none);
    spectrum.slice_mut(s![.., ..rows]).assign(&lines.t());
    drop(lines);
    fft_rows(&mut spectrum, true);
    spectrum
}

/// Autocorrelation `Σ A_{m+q} A*_m`, times the number of samples, of a [`spectrum`], at the first `rows` displacements along rows: `[row, column]`, negative displacements at the end.
pub(super) fn autocorrelation(spectrum: Array2<Complex<f64>>, rows: usize) -> Array2<Complex<f64>> {
    let mut power = spectrum.mapv_into(|v| Complex::new(v.norm_sqr(), 0.0));
    fft_rows(&mut power, false);
    let mut lines = power.slice(s![.., ..rows]).t().as_standard_layout().into_owned();
    drop(power);
    fft_rows(&mut lines, false);
    lines
}
