//! From the pupil's amplitudes to a kernel, and back: power spectrum, pixel and scene sample, and the places of a raster.
//!
//! The power spectrum on a grid fine enough to be exact goes to the kernel's places by one matrix a side, which has pixel and scene sample in it.

use std::f64::consts::TAU;

use ndarray::{Array2, s};
use rustfft::num_complex::Complex;

use super::super::splat::Raster;
use super::raster::{Field, Sampling};
use isoplanat_base::math::fft::{fft_rows, good_size};

type Complexes = Array2<Complex<f64>>;

/// `sin(πx)/(πx)`.
fn sinc(x: f64) -> f64 {
    let x = std::f64::consts::PI * x;
    if x.abs() < 1e-8 { 1.0 } else { x.sin() / x }
}

/// Where a kernel's raster lies, and how it is read from the power spectrum of the amplitudes.
pub(super) struct Reading {
    side: usize,
    /// Side of the power spectrum's grid.
    n: usize,
    /// What a place has of the power on the grid's lines, `[place, line]`: frequencies that are there, times what pixel and scene sample leave of them.
    weights: Array2<f64>,
    /// Whether a place lies within a period.
    within: Vec<bool>,
    /// Factor on the sum over the grid, and on the light that is spread evenly.
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
        // Largest step of the amplitudes' autocorrelation: the power's highest frequency over that of the period.
        let far = field.across().max(1) - 1;
        let n = good_size(2 * far + 1);
        let (side, m) = (raster.side(), raster.samples as f64);
        let fine = cell_mm / m;
        // The middle of a kernel's entry, mm; light that moves by `d` comes from `−d`.
        let origin = (raster.samples * (raster.size / 2) + raster.samples - 1) as f64;
        let places: Vec<f64> = (0..side).map(|f| (f as f64 - origin - 0.5 + 0.5 * m) * fine).collect();
        let passed: Vec<f64> = (0..=far)
            .map(|k| {
                let nu = k as f64 / period;
                sinc(nu * cell_mm) * sinc(nu * fine).powi(2)
            })
            .collect();
        let unit = fine * fine / (field.light * period * period);
        // A window wider than the period would show the kernel again beside itself.
        let within = places.iter().map(|x| x.abs() <= 0.5 * period).collect();
        let weights = weights(&places, period, &passed, n);
        Self { side, n, weights, within, scale: step * step * unit, even: unit }
    }

    /// Writes the kernel.
    pub(super) fn kernel(&self, field: &Field, out: &mut [f64]) -> Spectrum {
        let n = self.n;
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
        let sum = self.weights.dot(&self.weights.dot(&power).t());
        out.fill(0.0);
        let even = self.even * field.lost;
        for (i, row) in out.chunks_exact_mut(self.side).enumerate().filter(|(i, _)| self.within[*i]) {
            for (j, o) in row.iter_mut().enumerate().filter(|(j, _)| self.within[*j]) {
                *o = sum[[i, j]] * self.scale + even;
            }
        }
        Spectrum { field: all }
    }

    /// Pulls a cotangent on a kernel back: to the amplitudes, and to light and lost light.
    pub(super) fn kernel_vjp(
        &self,
        field: &Field,
        spectrum: &Spectrum,
        kernel: &[f64],
        bar: &[f64],
    ) -> (Complexes, [f64; 2]) {
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
        let power_bar = self.weights.t().dot(&sum_bar.t().dot(&self.weights));
        let mut lines = &spectrum.field * &power_bar.mapv(|v| Complex::new(2.0 * v, 0.0));
        let (rows, cols) = field.amplitude.dim();
        fft_rows(&mut lines, true);
        let mut lines = lines.slice(s![.., ..rows]).t().as_standard_layout().into_owned();
        fft_rows(&mut lines, true);
        (lines.slice(s![.., ..cols]).to_owned(), [light, lost])
    }
}

/// From values of a function of period `period` on `n` even places to its values at `places`, its frequency `k` times `passed[k]`; higher ones it has none. `[place, even place]`.
fn weights(places: &[f64], period: f64, passed: &[f64], n: usize) -> Array2<f64> {
    // Σ p_k cos 2πk(x/P + i/n) over all frequencies: two places at a time, as real and imaginary parts.
    let mut pairs = Array2::from_elem((places.len().div_ceil(2), n), Complex::new(0.0, 0.0));
    for (mut line, pair) in pairs.rows_mut().into_iter().zip(places.chunks(2)) {
        for (place, part) in pair.iter().zip([Complex::new(1.0 / n as f64, 0.0), Complex::new(0.0, 1.0 / n as f64)]) {
            let turn = Complex::cis(TAU * place / period);
            let mut at = Complex::new(1.0, 0.0);
            for (k, p) in passed.iter().enumerate() {
                line[k] += at * part * *p;
                if k > 0 {
                    line[n - k] += at.conj() * part * *p;
                }
                at *= turn;
            }
        }
    }
    fft_rows(&mut pairs, false);
    Array2::from_shape_fn((places.len(), n), |(f, i)| {
        let v = pairs[[f / 2, i]];
        if f % 2 == 0 { v.re } else { v.im }
    })
}
