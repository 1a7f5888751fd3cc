//! From the pupil's amplitudes to a kernel, and back: power spectrum, pixel and scene sample, and the places of a raster.

use std::f64::consts::TAU;

use ndarray::{Array2, s};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

use super::super::splat::Raster;
use super::raster::{Field, Sampling};
use isoplanat_base::math::fft::{RealFft2, good_size};

type Complexes = Array2<Complex<f64>>;

/// Transforms the rows of an array whose length is a row's, in place.
fn fft_rows(all: &mut Complexes, forward: bool) {
    let n = all.ncols();
    let mut planner = FftPlanner::new();
    let plan = if forward { planner.plan_fft_forward(n) } else { planner.plan_fft_inverse(n) };
    plan.process(all.as_slice_mut().expect("standard layout"));
}

/// `sin(πx)/(πx)`.
fn sinc(x: f64) -> f64 {
    let x = std::f64::consts::PI * x;
    if x.abs() < 1e-8 { 1.0 } else { x.sin() / x }
}

/// Where a kernel's raster lies, and how it is read from the autocorrelation of the amplitudes.
pub(super) struct Reading {
    side: usize,
    /// Largest step of the autocorrelation, by rows and columns the same, and the transform's size.
    far: usize,
    n: usize,
    /// `e^{−2πi k x/P}` times what pixel and scene sample leave of frequency `k/P`: `[place, k from −far to far]`.
    basis: Complexes,
    /// Whether a place lies within a period.
    within: Vec<bool>,
    /// Factor on the sum over the autocorrelation, and on the light that is spread evenly.
    scale: f64,
    even: f64,
}

/// What a kernel's pull-back needs of its making.
pub(super) struct Spectrum {
    field: Complexes,
}

impl Reading {
    pub(super) fn new(field: &Field, sampling: &Sampling, raster: Raster, cell_mm: f64) -> Self {
        let Sampling { period, step, .. } = *sampling;
        let far = field.across().max(1) - 1;
        let n = good_size(2 * far + 1);
        let (side, m) = (raster.side(), raster.samples as f64);
        let fine = cell_mm / m;
        // The middle of a kernel's entry, mm; light that moves by `d` comes from `−d`.
        let origin = (raster.samples * (raster.size / 2) + raster.samples - 1) as f64;
        let place = |f: usize| (f as f64 - origin - 0.5 + 0.5 * m) * fine;
        let number = |k: usize| k as f64 - far as f64;
        let passed: Vec<f64> = (0..=2 * far)
            .map(|k| {
                let nu = number(k) / period;
                sinc(nu * cell_mm) * sinc(nu * fine).powi(2)
            })
            .collect();
        let basis = Array2::from_shape_fn((side, 2 * far + 1), |(f, k)| {
            Complex::from_polar(passed[k], -TAU * number(k) * place(f) / period)
        });
        let unit = fine * fine / (field.light * period * period);
        // A window wider than the period would show the kernel again beside itself.
        let within = (0..side).map(|f| place(f).abs() <= 0.5 * period).collect();
        Self { side, far, n, basis, within, scale: step * step * unit, even: unit }
    }

    /// Where step `k − far` of the autocorrelation stands in the transform.
    fn wrapped(&self, k: usize) -> usize {
        (k + self.n - self.far) % self.n
    }

    /// Writes the kernel.
    pub(super) fn kernel(&self, field: &Field, out: &mut [f64]) -> Spectrum {
        let (n, far) = (self.n, self.far);
        let (rows, cols) = field.amplitude.dim();
        // `e^{+ik τ·δ}`: the inverse transform's sign. Rows first, of those with light alone.
        let mut lines = Array2::from_elem((rows, n), Complex::new(0.0, 0.0));
        lines.slice_mut(s![.., ..cols]).assign(&field.amplitude);
        fft_rows(&mut lines, false);
        let mut all = Array2::from_elem((n, n), Complex::new(0.0, 0.0));
        all.slice_mut(s![.., ..rows]).assign(&lines.t());
        fft_rows(&mut all, false);
        // `[column, row]` now.
        let power = all.mapv(|v| v.norm_sqr());
        // `[row frequency, column frequency]` for half the rows' frequencies: of the transposed picture these are its columns'.
        let spectrum = RealFft2::<f64>::new(n, n).forward(power.view());
        let norm = 1.0 / (n * n) as f64;
        let half = Array2::from_shape_fn((2 * far + 1, far + 1), |(c, r)| spectrum[[r, self.wrapped(c)]] * norm);
        // Columns' frequencies first: `[place along columns, row frequency]`.
        let read = self.basis.dot(&half);
        let (re, im) = (read.mapv(|v| v.re), read.mapv(|v| v.im));
        let rows = self.rows();
        let sum = rows.mapv(|v| v.re).dot(&re.t()) - rows.mapv(|v| v.im).dot(&im.t());
        out.fill(0.0);
        let even = self.even * field.lost;
        for (i, row) in out.chunks_exact_mut(self.side).enumerate().filter(|(i, _)| self.within[*i]) {
            for (j, o) in row.iter_mut().enumerate().filter(|(j, _)| self.within[*j]) {
                *o = sum[[i, j]] * self.scale + even;
            }
        }
        Spectrum { field: all }
    }

    /// The rows' basis at frequencies from 0 on, those above 0 twice: those below are their conjugates.
    fn rows(&self) -> Complexes {
        let mut rows = self.basis.slice(s![.., self.far..]).to_owned();
        rows.slice_mut(s![.., 1..]).mapv_inplace(|v| 2.0 * v);
        rows
    }

    /// Pulls a cotangent on a kernel back: to the amplitudes, and to light and lost light.
    pub(super) fn kernel_vjp(
        &self,
        field: &Field,
        spectrum: &Spectrum,
        kernel: &[f64],
        bar: &[f64],
    ) -> (Complexes, [f64; 2]) {
        let n = self.n;
        let lit = |q: usize| self.within[q / self.side] && self.within[q % self.side];
        let (mut all, mut even) = (0.0, 0.0);
        for (_, (k, b)) in kernel.iter().zip(bar).enumerate().filter(|(q, _)| lit(*q)) {
            all += k * b;
            even += b;
        }
        let light = -all / field.light;
        let lost = even * self.even;
        let sum_bar = Array2::from_shape_fn((self.side, self.side), |(i, j)| {
            let q = i * self.side + j;
            if lit(q) { bar[q] * self.scale } else { 0.0 }
        });
        // sum = Re(rows · readᵀ): the cotangent of `read` is that of rows, conjugated.
        let rows = self.rows();
        let (re, im) = (sum_bar.t().dot(&rows.mapv(|v| v.re)), sum_bar.t().dot(&rows.mapv(|v| v.im)));
        let read_bar = Array2::from_shape_fn(re.dim(), |at| Complex::new(re[at], -im[at]));
        let half_bar = self.basis.mapv(|v| v.conj()).t().dot(&read_bar);
        // Onto the half spectrum; what [`RealFft2::inverse`] takes twice is given by halves, and of the line that it takes once it takes the real part.
        let mut full = Array2::from_elem((n / 2 + 1, n), Complex::new(0.0, 0.0));
        for ((c, r), v) in half_bar.indexed_iter() {
            full[[r, self.wrapped(c)]] = *v * if r == 0 { 1.0 } else { 0.5 };
        }
        let power_bar = RealFft2::<f64>::new(n, n).inverse(full, 0, n);
        let mut lines = Array2::from_shape_fn((n, n), |at| spectrum.field[at] * (2.0 * power_bar[at]));
        let (rows, cols) = field.amplitude.dim();
        fft_rows(&mut lines, true);
        let mut lines = lines.slice(s![.., ..rows]).t().as_standard_layout().into_owned();
        fft_rows(&mut lines, true);
        (lines.slice(s![.., ..cols]).to_owned(), [light, lost])
    }
}
