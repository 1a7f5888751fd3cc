//! From the pupil's amplitudes to a kernel: power spectrum, pixel and scene sample, and the places of a raster.

use ndarray::{Array2, s};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

use super::super::splat::Raster;
use isoplanat_base::math::fft::good_size;

/// Amplitudes `a · share` with their phases, `[row, column]` of a raster of `τ`.
pub(super) struct Grid {
    pub(super) amplitude: Array2<Complex<f64>>,
    /// `∫a² dτ` of the open part.
    pub(super) light: f64,
    /// What of it the squares of shares are less than the shares.
    pub(super) lost: f64,
}

/// Transforms both axes of a square array, in place.
fn fft(all: &mut Array2<Complex<f64>>, forward: bool) {
    let n = all.nrows();
    let mut planner = FftPlanner::new();
    let plan = if forward { planner.plan_fft_forward(n) } else { planner.plan_fft_inverse(n) };
    for _ in 0..2 {
        plan.process(all.as_slice_mut().expect("standard layout"));
        *all = all.t().as_standard_layout().into_owned();
    }
}

/// `sin(πx)/(πx)`.
fn sinc(x: f64) -> f64 {
    let x = std::f64::consts::PI * x;
    if x.abs() < 1e-8 { 1.0 } else { x.sin() / x }
}

/// Autocorrelation of the amplitudes by steps of the raster, `[row, column]` of displacements from `−n` to `n` each way, over the light.
fn autocorrelation(grid: &Grid) -> Array2<Complex<f64>> {
    let (rows, cols) = grid.amplitude.dim();
    let far = rows.max(cols) - 1;
    let n = good_size(2 * far + 1);
    let mut field = Array2::from_elem((n, n), Complex::new(0.0, 0.0));
    field.slice_mut(s![..rows, ..cols]).assign(&grid.amplitude);
    // `e^{+ik τ·δ}`: the inverse transform's sign.
    fft(&mut field, false);
    field.mapv_inplace(|v| Complex::new(v.norm_sqr(), 0.0));
    fft(&mut field, true);
    let scale = 1.0 / (n * n) as f64;
    let wrapped = |k: usize| (k + n - far) % n;
    Array2::from_shape_fn((2 * far + 1, 2 * far + 1), |(i, j)| field[[wrapped(i), wrapped(j)]] * scale)
}

/// Writes the kernel on `raster` in cells of `cell_mm`; it repeats with `period`. Returns the share of the light that was spread evenly.
pub(super) fn into_kernel(grid: &Grid, period: f64, raster: Raster, cell_mm: f64, out: &mut [f64]) -> f64 {
    out.fill(0.0);
    if grid.light.is_nan() || grid.light <= 0.0 {
        return 0.0;
    }
    let spectrum = autocorrelation(grid);
    let far = spectrum.nrows() / 2;
    let (side, m) = (raster.side(), raster.samples as f64);
    let fine = cell_mm / m;
    let step = 1.0 / period;
    // The middle of a kernel's entry, mm; light that moves by `d` comes from `−d`.
    let origin = (raster.samples * (raster.size / 2) + raster.samples - 1) as f64;
    let place = |f: usize| (f as f64 - origin - 0.5 + 0.5 * m) * fine;
    let number = |k: usize| k as f64 - far as f64;
    let passed: Vec<f64> = (0..=2 * far)
        .map(|k| {
            let nu = number(k) * step;
            sinc(nu * cell_mm) * sinc(nu * fine).powi(2)
        })
        .collect();
    // A window wider than the period would show the kernel again beside itself.
    let within = |f: usize| place(f).abs() <= 0.5 * period;
    let wave = |f: usize, k: usize| {
        let phase = -std::f64::consts::TAU * number(k) * step * place(f);
        Complex::from_polar(passed[k], phase)
    };
    let basis = Array2::from_shape_fn((side, 2 * far + 1), |(f, k)| wave(f, k));
    // Rows first, for columns' frequencies from 0 on: those below are their conjugates.
    let half: Vec<Vec<Complex<f64>>> = (far..=2 * far)
        .map(|k| {
            let column = spectrum.column(k);
            basis.rows().into_iter().map(|row| row.iter().zip(&column).map(|(a, b)| a * b).sum()).collect()
        })
        .collect();
    let cell_light = grid.light * period * period / (fine * fine);
    // Amplitudes are a raster of step λ over the period: Parseval makes light of their squares times that step's square.
    let (whole, lost) = (grid.light, grid.lost);
    let power: f64 = grid.amplitude.iter().map(Complex::norm_sqr).sum();
    let scale = (whole - lost) / power / cell_light;
    let even = lost / cell_light;
    for (i, row) in out.chunks_exact_mut(side).enumerate().filter(|(i, _)| within(*i)) {
        for (j, o) in row.iter_mut().enumerate().filter(|(j, _)| within(*j)) {
            let mut sum = half[0][i].re * basis[[j, far]].re;
            for k in 1..=far {
                let (a, b) = (half[k][i], basis[[j, far + k]]);
                sum += 2.0 * (a.re * b.re - a.im * b.im);
            }
            *o = sum * scale + even;
        }
    }
    lost / whole
}
