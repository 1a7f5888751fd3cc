//! The transfer function of an open pupil without path differences: what an aperture alone diffracts.
//!
//! It is the autocorrelation of the amplitudes over displacements `λf` of the pupil's coordinates. Between the lattice of the raster it is interpolated less that of an ellipse
//! of the same sides, which has the cone at its middle in closed form.

use std::f64::consts::FRAC_2_PI;
use std::ops::Range;
use std::sync::LazyLock;

use glam::DVec2;
use ndarray::{Array2, Zip, s};
use rustfft::num_complex::Complex;

use super::PupilBars;
use super::pupil::{Pupil, stepped};
use super::raster::{Field, Sampling};
use isoplanat_base::math::fft::{RealFft2, good_size};

/// Samples across the pupil.
const ACROSS: f64 = 48.0;

/// The transfer function of an open pupil, along the sensor's columns and rows.
pub(in crate::psf) struct Open {
    sampling: Sampling,
    field: Field,
    fft: RealFft2<f64>,
    /// Half spectrum of the amplitudes, `[column, row]`.
    spectrum: Array2<Complex<f64>>,
    /// The transfer function less the ellipse's at steps of the raster, `[column, row]`, negative ones at the end.
    rest: Array2<f64>,
    /// Sides of the ellipse, along columns and rows.
    ellipse: DVec2,
}

/// A cotangent on the values of an [`Open`] on its lattice.
pub(in crate::psf) struct OpenBar(Array2<f64>);

/// Transfer function of a round pupil, the frequency as a part of the cutoff.
fn round(part: f64) -> f64 {
    if part >= 1.0 { 0.0 } else { FRAC_2_PI * (part.acos() - part * (1.0 - part * part).sqrt()) }
}

/// Places that [`round`] is told at: between them the line is within 1e-5.
const TOLD: usize = 1024;
/// Its values there, and one beyond.
static ROUND: LazyLock<Vec<f64>> = LazyLock::new(|| (0..=TOLD + 1).map(|k| round(k as f64 / TOLD as f64)).collect());

/// [`round`] by the square of its place.
fn round_at(square: f64) -> f64 {
    let place = square.sqrt() * TOLD as f64;
    if place >= TOLD as f64 {
        return 0.0;
    }
    let low = place as usize;
    let part = place - low as f64;
    let of = &ROUND[low..];
    of[0] + part * (of[1] - of[0])
}

/// Two lattice points around a place along one axis, and how far it is from the first to the second.
#[derive(Clone, Copy)]
struct Between {
    low: usize,
    high: usize,
    part: f64,
}

impl Pupil {
    /// The transfer function of this pupil's aperture; nothing where no light is.
    pub(in crate::psf) fn open(&self, outward: [f64; 2]) -> Option<Open> {
        let period = stepped(ACROSS * self.wavelength_mm / (2.0 * self.aperture_half()));
        let sampling = Sampling::new(&self.functions, outward, period);
        let field = self.functions.open_field(&sampling);
        if field.light.is_nan() || field.light <= 0.0 {
            return None;
        }
        let (rows, cols) = field.amplitude.dim();
        let n = good_size(2 * field.across().max(1) - 1);
        let fft = RealFft2::shared(n, n);
        let spectrum = fft.forward(field.amplitude.mapv(|v| v.re).view());
        let all = fft.unscaled(spectrum.mapv(|v| Complex::new(v.norm_sqr(), 0.0)), 0, n);
        let unit = sampling.step * sampling.step / ((n * n) as f64 * field.light);
        // The box of the open part, as an ellipse's sides would be.
        let ellipse = sampling.step * DVec2::new(cols as f64 - 1.0, rows as f64 - 1.0).max(DVec2::ONE);
        let mut open = Open { sampling, field, fft, spectrum, rest: Array2::zeros((n, n)), ellipse };
        let rest = Array2::from_shape_fn((n, n), |(j, i)| {
            unit * all[[i, j]] - open.ellipse_at(open.sampling.step * DVec2::new(signed(j, n), signed(i, n)))
        });
        open.rest = rest;
        Some(open)
    }

    /// Adds the pull-back of a cotangent on the values of `open` to that of the polynomials. Lattice and ellipse are held: where they lie changes values by their own error alone.
    pub(in crate::psf) fn open_vjp(&self, open: &Open, bar: &OpenBar, to: &mut PupilBars) {
        let (field, n) = (&open.field, open.rest.nrows());
        let unit = open.sampling.step.powi(2) / ((n * n) as f64 * field.light);
        // T = unit · IFFT |FFT a|², and the light in `unit`.
        let mut values = 0.0;
        for ((j, i), b) in bar.0.indexed_iter().filter(|(_, b)| **b != 0.0) {
            let at = open.sampling.step * DVec2::new(signed(j, n), signed(i, n));
            values += b * (open.rest[[j, i]] + open.ellipse_at(at));
        }
        let mut lines = open.fft.forward(bar.0.t());
        // The cotangent of an autocorrelation, whose values are real: the real part alone.
        Zip::from(&mut lines).and(&open.spectrum).for_each(|bar, value| *bar = value * (2.0 * unit * bar.re));
        let (rows, cols) = field.amplitude.dim();
        let lines = open.fft.unscaled(lines, 0, rows);
        let amplitude = lines.slice(s![.., ..cols]).mapv(|v| Complex::new(v, 0.0));
        self.functions.field_vjp(&open.sampling, field, &amplitude, [-values / field.light, 0.0], &mut to.0);
    }
}

/// Number `i` of `n`, the second half negative.
fn signed(i: usize, n: usize) -> f64 {
    if 2 * i <= n { i as f64 } else { i as f64 - n as f64 }
}

impl Open {
    fn ellipse_at(&self, at: DVec2) -> f64 {
        round_at((at / self.ellipse).length_squared())
    }

    /// Where a displacement along one axis lies on the lattice; nothing where no light has it.
    fn between(&self, at: f64) -> Option<Between> {
        let (at, n) = (at / self.sampling.step, self.rest.nrows());
        if at.abs() >= n as f64 / 2.0 - 1.0 {
            return None;
        }
        let low = at.floor();
        let index = |v: f64| (v as isize).rem_euclid(n.cast_signed()).cast_unsigned();
        Some(Between { low: index(low), high: index(low + 1.0), part: at - low })
    }

    /// The transfer function at a displacement along columns and rows: `λ` times a frequency.
    #[cfg(test)]
    pub(in crate::psf) fn at(&self, displacement: DVec2) -> f64 {
        let Some(line) = self.line(displacement.x) else { return 0.0 };
        self.between(displacement.y).map_or(0.0, |y| y.of(&line) + self.ellipse_at(displacement))
    }

    /// The lattice's values at a displacement along columns, by rows.
    fn line(&self, x: f64) -> Option<Vec<f64>> {
        let x = self.between(x)?;
        let (low, high) = (self.rest.row(x.low), self.rest.row(x.high));
        Some(low.iter().zip(high).map(|(low, high)| (1.0 - x.part) * low + x.part * high).collect())
    }

    /// Displacements along rows of the frequencies of `n` lines: where they lie on the lattice, and the squares of their parts of the ellipse.
    fn rows(&self, n: usize, step: f64) -> Vec<(Option<Between>, f64)> {
        let of = |i: usize| {
            let y = step * signed(i, n);
            (self.between(y), (y / self.ellipse.y).powi(2))
        };
        (0..n).map(of).collect()
    }

    /// The transfer function at the frequencies of the half spectrum of `n × n` values (even), `[column, row]`, a frequency's displacement being `step`.
    pub(in crate::psf) fn transfer(&self, n: usize, step: f64) -> Array2<f64> {
        let rows = self.rows(n, step);
        let mut transfer = Array2::zeros((n / 2 + 1, n));
        for Frequencies { j, sign, rows: some } in frequencies(n) {
            let x = step * signed(j, n);
            let Some(line) = self.line(sign * x) else { continue };
            let (x, mut to) = ((x / self.ellipse.x).powi(2), transfer.row_mut(j));
            for i in some {
                if let (Some(y), square) = rows[i] {
                    to[i] += share(n, [j, i]) * (y.of(&line) + round_at(x + square));
                }
            }
        }
        transfer
    }

    /// Adds the pull-back of a cotangent on [`Self::transfer`].
    pub(in crate::psf) fn transfer_vjp(&self, n: usize, step: f64, bar: &Array2<f64>, to: &mut OpenBar) {
        let rows = self.rows(n, step);
        for Frequencies { j, sign, rows: some } in frequencies(n) {
            let Some(x) = self.between(sign * step * signed(j, n)) else { continue };
            let (bar, mut line) = (bar.row(j), vec![0.0; self.rest.nrows()]);
            for i in some {
                if let (Some(y), _) = rows[i] {
                    let bar = share(n, [j, i]) * bar[i];
                    line[y.low] += (1.0 - y.part) * bar;
                    line[y.high] += y.part * bar;
                }
            }
            for (index, part) in [(x.low, 1.0 - x.part), (x.high, x.part)] {
                to.0.row_mut(index).iter_mut().zip(&line).for_each(|(t, v)| *t += part * v);
            }
        }
    }

    /// Zero cotangents.
    pub(in crate::psf) fn no_bar(&self) -> OpenBar {
        OpenBar(Array2::zeros(self.rest.dim()))
    }

    /// Bytes, from above, that one takes with its pull-back.
    pub(in crate::psf) fn bytes() -> u64 {
        let side = good_size(2 * (1.5 * ACROSS) as usize + 24) as u64;
        side * side * 200
    }
}

impl Between {
    fn of(self, line: &[f64]) -> f64 {
        (1.0 - self.part) * line[self.low] + self.part * line[self.high]
    }
}

/// Frequencies of one column of a half spectrum, with the sign that its displacement is taken with.
struct Frequencies {
    j: usize,
    sign: f64,
    rows: Range<usize>,
}

/// All frequencies of the half spectrum of `n × n` values: the highest ones with both signs.
fn frequencies(n: usize) -> impl Iterator<Item = Frequencies> {
    let half = n / 2;
    (0..=half).flat_map(move |j| {
        let both = if j == half { 0..n } else { half..half + 1 };
        [Frequencies { j, sign: 1.0, rows: 0..n }, Frequencies { j, sign: -1.0, rows: both }]
    })
}

/// Share that a sign has of a frequency.
fn share(n: usize, [j, i]: [usize; 2]) -> f64 {
    if 2 * j == n || 2 * i == n { 0.5 } else { 1.0 }
}
