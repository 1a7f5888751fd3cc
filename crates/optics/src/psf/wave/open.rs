//! The transfer function of an open pupil without path differences: what an aperture alone diffracts.
//!
//! It is the autocorrelation of the amplitudes over displacements `λf` of the pupil's coordinates. Between the lattice of the raster it is interpolated less that of an ellipse
//! of the same sides, which has the cone at its middle in closed form.

use std::f64::consts::FRAC_2_PI;

use glam::DVec2;
use ndarray::{Array2, s};
use rustfft::num_complex::Complex;

use super::PupilBars;
use super::pupil::{Pupil, stepped};
use super::raster::{Field, Sampling};
use isoplanat_base::math::fft::{fft_rows, good_size};

/// Samples across the pupil.
const ACROSS: f64 = 48.0;

/// The transfer function of an open pupil, along the sensor's columns and rows.
pub(in crate::psf) struct Open {
    sampling: Sampling,
    field: Field,
    /// Transform of the amplitudes, `[column, row]`.
    spectrum: Array2<Complex<f64>>,
    /// The transfer function less the ellipse's at steps of the raster along rows and columns, negative ones at the end.
    rest: Array2<f64>,
    /// Sides of the ellipse, along columns and rows.
    ellipse: DVec2,
    /// Values of [`round`] at even places to its end.
    round: Vec<f64>,
}

/// A cotangent on the values of an [`Open`] on its lattice.
pub(in crate::psf) struct OpenBar(Array2<f64>);

/// Transfer function of a round pupil, the frequency as a part of the cutoff.
fn round(part: f64) -> f64 {
    if part >= 1.0 { 0.0 } else { FRAC_2_PI * (part.acos() - part * (1.0 - part * part).sqrt()) }
}

/// Places that [`round`] is told at: between them the line is within 1e-5.
const TOLD: usize = 1024;

/// The four lattice points around a place, each with its weight.
struct Corners([(usize, usize, f64); 4]);

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
        let mut lines = Array2::from_elem((rows, n), Complex::new(0.0, 0.0));
        lines.slice_mut(s![.., ..cols]).assign(&field.amplitude);
        fft_rows(&mut lines, true);
        let mut spectrum = Array2::from_elem((n, n), Complex::new(0.0, 0.0));
        spectrum.slice_mut(s![.., ..rows]).assign(&lines.t());
        fft_rows(&mut spectrum, true);
        let mut all = spectrum.mapv(|v| Complex::new(v.norm_sqr(), 0.0));
        fft_rows(&mut all, false);
        let mut all = all.t().as_standard_layout().into_owned();
        fft_rows(&mut all, false);
        let unit = sampling.step * sampling.step / ((n * n) as f64 * field.light);
        // The box of the open part, as an ellipse's sides would be.
        let ellipse = sampling.step * DVec2::new(cols as f64 - 1.0, rows as f64 - 1.0).max(DVec2::ONE);
        let round = (0..=TOLD + 1).map(|k| round(k as f64 / TOLD as f64)).collect();
        let mut open = Open { sampling, field, spectrum, rest: Array2::zeros((n, n)), ellipse, round };
        let rest = Array2::from_shape_fn((n, n), |(i, j)| {
            unit * all[[i, j]].re - open.ellipse_at(open.sampling.step * DVec2::new(signed(j, n), signed(i, n)))
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
        for ((i, j), b) in bar.0.indexed_iter().filter(|(_, b)| **b != 0.0) {
            let at = open.sampling.step * DVec2::new(signed(j, n), signed(i, n));
            values += b * (open.rest[[i, j]] + open.ellipse_at(at));
        }
        let mut power = bar.0.mapv(|b| Complex::new(unit * b, 0.0));
        fft_rows(&mut power, true);
        let mut power = power.t().as_standard_layout().into_owned();
        fft_rows(&mut power, true);
        // The cotangent of an autocorrelation, whose values are real: the real part alone.
        let mut lines = &open.spectrum * &power.mapv(|v| Complex::new(2.0 * v.re, 0.0));
        let (rows, cols) = field.amplitude.dim();
        fft_rows(&mut lines, false);
        let mut lines = lines.slice(s![.., ..rows]).t().as_standard_layout().into_owned();
        fft_rows(&mut lines, false);
        let amplitude = lines.slice(s![.., ..cols]).mapv(|v| Complex::new(v.re, 0.0));
        self.functions.field_vjp(&open.sampling, field, &amplitude, [-values / field.light, 0.0], &mut to.0);
    }
}

/// Number `i` of `n`, the second half negative.
fn signed(i: usize, n: usize) -> f64 {
    if 2 * i <= n { i as f64 } else { i as f64 - n as f64 }
}

impl Open {
    fn ellipse_at(&self, at: DVec2) -> f64 {
        let place = (at / self.ellipse).length() * TOLD as f64;
        if place >= TOLD as f64 {
            return 0.0;
        }
        let part = place.fract();
        let of = &self.round[place as usize..];
        of[0] + part * (of[1] - of[0])
    }

    /// Where a displacement (columns, rows) lies on the lattice; nothing where no light has it.
    fn corners(&self, at: DVec2) -> Option<Corners> {
        let (at, n) = (at / self.sampling.step, self.rest.nrows());
        let far = n as f64 / 2.0 - 1.0;
        if at.x.abs() >= far || at.y.abs() >= far {
            return None;
        }
        let low = at.floor();
        let part = at - low;
        let index = |v: f64| (v as isize).rem_euclid(n.cast_signed()).cast_unsigned();
        let [(i, y), (j, x)] = [(low.y, part.y), (low.x, part.x)];
        let (i, j) = ([index(i), index(i + 1.0)], [index(j), index(j + 1.0)]);
        let (y, x) = ([1.0 - y, y], [1.0 - x, x]);
        Some(Corners([0, 1, 2, 3].map(|k| (i[k / 2], j[k % 2], y[k / 2] * x[k % 2]))))
    }

    /// The transfer function at a displacement along columns and rows: `λ` times a frequency.
    pub(in crate::psf) fn at(&self, displacement: DVec2) -> f64 {
        let Some(Corners(corners)) = self.corners(displacement) else { return 0.0 };
        let rest: f64 = corners.iter().map(|(i, j, w)| w * self.rest[[*i, *j]]).sum();
        rest + self.ellipse_at(displacement)
    }

    /// Zero cotangents.
    pub(in crate::psf) fn no_bar(&self) -> OpenBar {
        OpenBar(Array2::zeros(self.rest.dim()))
    }

    /// [`Self::at`]; adds the pull-back of a cotangent on it.
    pub(in crate::psf) fn at_with_vjp(&self, displacement: DVec2, bar: f64, to: &mut OpenBar) -> f64 {
        let Some(Corners(corners)) = self.corners(displacement) else { return 0.0 };
        let mut rest = 0.0;
        for (i, j, w) in corners {
            to.0[[i, j]] += w * bar;
            rest += w * self.rest[[i, j]];
        }
        rest + self.ellipse_at(displacement)
    }

    /// Bytes, from above, that one takes with its pull-back.
    pub(in crate::psf) fn bytes() -> u64 {
        let side = good_size(2 * (1.5 * ACROSS) as usize + 24) as u64;
        side * side * 200
    }
}
