//! Kernels by diffraction of stated points of the sensor, with what is to be told of them.

use rayon::prelude::*;

use super::kernel::KernelForm;
use super::optics::Optics;
use super::point::SensorPoint;
use super::wave::{DEGREES, Pupil, Waves};
use crate::lens::Lens;
use isoplanat_base::error::Result;
use isoplanat_base::math::memory::threads;
use isoplanat_base::stop::look;

/// How many `λ/NA` an automatic window has around the rays.
const BENT: f64 = 10.0;

/// What is to be told of kernels by diffraction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WaveFigures {
    /// Largest root mean square residual of the polynomials of a path, wavelengths.
    pub residual_waves: f64,
    /// Largest share of light that was spread evenly over a kernel's period.
    pub spread: f64,
    /// Largest sine of an angle at the image.
    pub aperture: f64,
    /// Kernels of a wavelength that were made of rays, because their blur has hundreds of waves.
    pub geometric: usize,
}

impl WaveFigures {
    /// What is to be told of both.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        Self {
            residual_waves: self.residual_waves.max(other.residual_waves),
            spread: self.spread.max(other.spread),
            aperture: self.aperture.max(other.aperture),
            geometric: self.geometric + other.geometric,
        }
    }
}

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
        let illumination = optics.illumination();
        let point = illumination.held(point);
        let (shares, _) = form.shares(illumination, point);
        let len = form.raster.len();
        let of = |l: usize| {
            let fed = KernelForm::fed(&shares, l);
            if fed.is_empty() {
                return None;
            }
            let pupil = self.pupil(optics, l, depth, point)?;
            let mut plane = vec![0.0; len];
            let mut figures = WaveFigures { aperture: pupil.steepest, ..WaveFigures::default() };
            if pupil.is_told() {
                figures.residual_waves = pupil.residual_waves;
                figures.spread = pupil.kernel(point.outward(), form.raster, form.cell_mm, &mut plane);
            } else {
                let alone = (0..optics.spec.quadrature.nm.len()).map(|k| f64::from(u8::from(k == l))).collect();
                let form = KernelForm { weight: vec![alone], ..form.clone() };
                optics.kernels(&form, depth, point, &mut plane);
                figures.geometric = 1;
            }
            Some((fed, plane, figures))
        };
        let colours: Vec<_> = (0..optics.spec.quadrature.nm.len()).into_par_iter().map(of).collect();
        out.fill(0.0);
        let (mut figures, mut lost) = (WaveFigures::default(), vec![0.0; form.channels()]);
        for (fed, plane, of_colour) in colours.into_iter().flatten() {
            let sum: f64 = plane.iter().sum();
            for (channel, share) in fed {
                let to = out[channel * len..][..len].iter_mut();
                to.zip(&plane).for_each(|(o, v)| *o += share * v);
                lost[channel] += share * (1.0 - sum);
            }
            figures = figures.or(of_colour);
        }
        (lost, figures)
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

    /// Bytes, from above, of what is needed beside the kernels of `points`, in windows of a side of `window_mm`.
    pub fn bytes(&self, optics: &Optics, depth: usize, points: &[SensorPoint], window_mm: f64) -> u64 {
        let nm = &optics.spec.quadrature.nm;
        // The shortest wavelength's rasters are the largest.
        let shortest = (0..optics.spec.quadrature.nm.len()).min_by(|a, b| nm[*a].total_cmp(&nm[*b]));
        let of = |point: &SensorPoint| {
            let pupil = self.pupil(optics, shortest?, depth, optics.illumination().held(*point))?;
            Some(if pupil.is_told() { pupil.bytes(window_mm) } else { 0 })
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
