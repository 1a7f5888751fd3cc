//! Kernels by diffraction of stated points of the sensor, with what is to be told of them.

use rayon::prelude::*;

use super::kernel::KernelForm;
use super::optics::Optics;
use super::point::SensorPoint;
use super::wave::{DEGREES, Pupil};
use crate::lens::Lens;
use isoplanat_base::error::Result;
use isoplanat_base::math::memory::threads;
use isoplanat_base::stop::look;

pub use super::wave::{WaveFigures, Waves};

/// How many `λ/NA` an automatic window has around the rays.
const BENT: f64 = 10.0;

impl Waves {
    /// Of `lens`, at the wavelengths of `optics`.
    ///
    /// # Errors
    /// As [`Optics::compute`].
    pub fn new(lens: &Lens, optics: &Optics) -> Result<Self> {
        Self::of(lens, (optics.table(), &optics.maps), optics.illumination().lit_mm(), &DEGREES)
    }

    /// The pupil that `point` sees at wavelength `l`, for object distance `depth`; nothing where no light comes.
    pub fn pupil(&self, optics: &Optics, l: usize, depth: usize, point: SensorPoint) -> Option<Pupil> {
        self.pupil_of(optics.table(), &optics.maps[depth], l, point)
    }

    /// Writes the kernels of all channels at `point`, as [`Optics::kernels`] does, by diffraction; returns the share of each channel's light outside.
    pub fn kernels(
        &self,
        optics: &Optics,
        form: &KernelForm,
        depth: usize,
        point: SensorPoint,
        out: &mut [f64],
    ) -> (Vec<f64>, WaveFigures) {
        look();
        let pencil = form.pencil(optics.table(), optics.illumination(), &optics.maps[depth], point, Some(self));
        form.kernels_told(&pencil, point.outward(), out)
    }

    /// What `with` makes of each point's number, kernels and light outside, as [`Optics::kernels_each`] does, by diffraction.
    pub fn kernels_each<R: Send>(
        &self,
        optics: &Optics,
        form: &KernelForm,
        depth: usize,
        points: &[SensorPoint],
        with: impl Fn(usize, &[f64], &[f64]) -> R + Sync,
    ) -> (Vec<R>, WaveFigures) {
        let one = |(i, point): (usize, &SensorPoint)| {
            let mut kernel = vec![0.0; form.channels() * form.raster.len()];
            let (outside, figures) = self.kernels(optics, form, depth, *point, &mut kernel);
            (with(i, &kernel, &outside), figures)
        };
        let made: Vec<(R, WaveFigures)> = points.par_iter().enumerate().map(one).collect();
        let (made, figures): (Vec<R>, Vec<WaveFigures>) = made.into_iter().unzip();
        (made, figures.into_iter().fold(WaveFigures::default(), WaveFigures::or))
    }

    /// Bytes, from above, of what is needed beside the kernels of `points`, of `size` cells of `cell_mm` a side.
    pub fn bytes(&self, optics: &Optics, depth: usize, points: &[SensorPoint], (size, cell_mm): (usize, f64)) -> u64 {
        let nm = &optics.spec.quadrature.nm;
        // The shortest wavelength's rasters are the largest.
        let shortest = (0..optics.spec.quadrature.nm.len()).min_by(|a, b| nm[*a].total_cmp(&nm[*b]));
        let of = |point: &SensorPoint| {
            let pupil = self.pupil(optics, shortest?, depth, optics.illumination().held(*point))?;
            Some(if pupil.is_told(cell_mm) { pupil.bytes(size as f64 * cell_mm) } else { 0 })
        };
        let most = points.par_iter().filter_map(of).reduce(|| 0, u64::max);
        most.saturating_mul(threads() as u64)
    }

    /// How far around its rays an automatic window reaches for light that bends at the narrowest pupil of `points`, at the longest wavelength, mm: ten `λ/NA`, beyond which
    /// is a hundredth of a perfect lens's light.
    pub fn bending_mm(&self, optics: &Optics, depth: usize, points: &[SensorPoint]) -> f64 {
        let longest = (0..optics.spec.quadrature.nm.len()).max_by(|a, b| {
            let nm = &optics.spec.quadrature.nm;
            nm[*a].total_cmp(&nm[*b])
        });
        let at = |point: &SensorPoint| {
            let pupil = self.pupil(optics, longest?, depth, optics.illumination().held(*point))?;
            Some(BENT * pupil.wavelength_mm / pupil.narrowest().max(1e-6))
        };
        points.par_iter().filter_map(at).reduce(|| 0.0, f64::max)
    }
}
