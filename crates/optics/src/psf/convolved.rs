//! Kernels of rays convolved with the diffraction of the open pupil.
//!
//! A kernel's raster is transformed, multiplied by the transfer function of the pupil without its path differences at the channel's mean wavelength, and transformed back. What
//! the open pupil sends farther than the transform is wide is folded back into it.

use ndarray::{Array2, ArrayView2, Zip, s};

use super::splat::Raster;
use super::wave::{Open, OpenBar, Pupil, PupilBars};
use isoplanat_base::math::fft::{RealFft2, good_size};

/// How many `λ/NA` light goes that is not folded back, unless that is more than the window.
const FAR: f64 = 20.0;

/// The convolution of kernels of one form by the diffraction of one open pupil.
pub(super) struct Convolution {
    open: Open,
    fft: RealFft2<f64>,
    side: usize,
    n: usize,
    fine_mm: f64,
}

impl Convolution {
    /// By `pupil` along `outward`; nothing where it has no light.
    pub(super) fn new(pupil: &Pupil, outward: [f64; 2], raster: Raster, cell_mm: f64) -> Option<Self> {
        let open = pupil.open(outward)?;
        let (side, fine_mm) = (raster.side(), cell_mm / raster.samples as f64);
        let far = FAR * pupil.bend_mm() / fine_mm;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count, bounded")]
        let n = good_size(side + far.ceil().min(side as f64) as usize);
        Some(Self { open, fft: RealFft2::shared(n, n), side, n, fine_mm })
    }

    /// The transfer function at the frequencies of the half spectrum, `[column, row]`, for a channel of this mean wavelength.
    fn transfer(&self, wavelength_mm: f64) -> Array2<f64> {
        self.open.transfer(self.n, self.step(wavelength_mm))
    }

    /// What one frequency displaces the pupil.
    fn step(&self, wavelength_mm: f64) -> f64 {
        wavelength_mm / (self.n as f64 * self.fine_mm)
    }

    fn view<'a>(&self, plane: &'a [f64]) -> ArrayView2<'a, f64> {
        ArrayView2::from_shape((self.side, self.side), plane).expect("a plane of the raster")
    }

    fn write(&self, spectrum: Array2<rustfft::num_complex::Complex<f64>>, plane: &mut [f64]) {
        let made = self.fft.inverse(spectrum, 0, self.side);
        let made = made.slice(s![.., ..self.side]);
        plane.iter_mut().zip(made.iter()).for_each(|(p, v)| *p = *v);
    }

    /// Convolves a plane of kernels of rays, which are of a channel of this mean wavelength.
    pub(super) fn convolve(&self, plane: &mut [f64], wavelength_mm: f64) {
        let mut spectrum = self.fft.forward(self.view(plane));
        spectrum.zip_mut_with(&self.transfer(wavelength_mm), |s, t| *s *= *t);
        self.write(spectrum, plane);
    }

    /// Turns the cotangent `bar` of what [`Self::convolve`] made of `plane` into that of `plane`, and adds what the transfer function gets of it to `to`.
    pub(super) fn convolve_vjp(&self, plane: &[f64], wavelength_mm: f64, bar: &mut [f64], to: &mut OpenBar) {
        let rays = self.fft.forward(self.view(plane));
        let mut spectrum = self.fft.forward(self.view(bar));
        let mut transfer = self.transfer(wavelength_mm);
        let scale = ((self.n * self.n) as f64).recip();
        for (j, mut column) in transfer.outer_iter_mut().enumerate() {
            // How often the whole spectrum has it.
            let often = if j == 0 || 2 * j == self.n { scale } else { 2.0 * scale };
            Zip::from(&mut column).and(&mut spectrum.row_mut(j)).and(&rays.row(j)).for_each(|t, bar, rays| {
                let of = (bar.conj() * rays).re * often;
                // The open pupil's diffraction is even: the convolution is its own transpose.
                *bar *= *t;
                *t = of;
            });
        }
        self.open.transfer_vjp(self.n, self.step(wavelength_mm), &transfer, to);
        self.write(spectrum, bar);
    }

    /// Zero cotangents of the transfer function.
    pub(super) fn no_bar(&self) -> OpenBar {
        self.open.no_bar()
    }

    /// Adds the pull-back of cotangents on the transfer function to that of the pupil it is of.
    pub(super) fn open_vjp(&self, pupil: &Pupil, bar: &OpenBar, to: &mut PupilBars) {
        pupil.open_vjp(&self.open, bar, to);
    }
}
