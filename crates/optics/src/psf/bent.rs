//! Kernels and point spreads by diffraction of stated points of the sensor: windows, memory, and what is to be told of them.

use rayon::prelude::*;

use super::kernel::KernelForm;
use super::optics::Optics;
use super::point::SensorPoint;
use super::wave::{PointSpread, Pupil, Untold};
use isoplanat_base::math::memory::threads;
use isoplanat_base::stop::look;

pub use super::wave::{WaveFigures, Waves};

/// Bytes that point spreads made at once may take.
const AT_ONCE: u64 = 1 << 30;

/// How many `λ/NA` an automatic window has around the rays.
const BENT: f64 = 10.0;

impl Optics {
    /// The pupil that `point` sees at wavelength `l`, for object distance `depth`, where kernels are made by diffraction; nothing where no light comes.
    #[doc(hidden)]
    pub fn pupil(&self, l: usize, depth: usize, point: SensorPoint) -> Option<Pupil> {
        self.waves()?.pupil_of(self.table(), &self.maps[depth], l, point)
    }

    /// Writes the kernels of all channels at `point`, as [`Self::kernels`] does, and says what is to be told of them.
    #[doc(hidden)]
    pub fn kernels_told(
        &self,
        form: &KernelForm,
        depth: usize,
        point: SensorPoint,
        out: &mut [f64],
    ) -> (Vec<f64>, WaveFigures) {
        look();
        form.kernels_told(&self.pencil(form, depth, point), point.outward(), out)
    }

    /// What `with` makes of each point's number, kernels and light outside, as [`Self::kernels_each`] does; with what is to be told of kernels by diffraction, nothing of rays.
    #[doc(hidden)]
    pub fn kernels_told_each<R: Send>(
        &self,
        form: &KernelForm,
        depth: usize,
        points: &[SensorPoint],
        with: impl Fn(usize, &[f64], &[f64]) -> R + Sync,
    ) -> (Vec<R>, Option<WaveFigures>) {
        if self.waves().is_none() {
            return (self.kernels_each(form, depth, points, with), None);
        }
        let one = |(i, point): (usize, &SensorPoint)| {
            let mut kernel = vec![0.0; form.channels() * form.raster.len()];
            let (outside, figures) = self.kernels_told(form, depth, *point, &mut kernel);
            (with(i, &kernel, &outside), figures)
        };
        let made: Vec<(R, WaveFigures)> = points.par_iter().enumerate().map(one).collect();
        let (made, figures): (Vec<R>, Vec<WaveFigures>) = made.into_iter().unzip();
        (made, Some(figures.into_iter().fold(WaveFigures::default(), WaveFigures::or)))
    }

    /// Bytes, from above, that [`Self::point_spreads`] takes, as far as was looked.
    #[doc(hidden)]
    pub fn point_spread_bytes(&self) -> u64 {
        let one = self.waves().map_or(0, Waves::point_spread_most);
        let all = one.saturating_mul(threads() as u64);
        if all <= AT_ONCE { all } else { one }
    }

    /// The point spreads of `points` for object distance `depth`, wavelengths by `weights` beside the light that comes; each [`Untold`] where there is none.
    #[doc(hidden)]
    pub fn point_spreads(
        &self,
        depth: usize,
        points: &[SensorPoint],
        weights: &[f64],
    ) -> Vec<std::result::Result<PointSpread, Untold>> {
        type Pupils = std::result::Result<Vec<(Pupil, f64)>, Untold>;
        let pupils = |point: &SensorPoint| -> Pupils {
            let light = self.illumination().at(*point);
            let of = |(l, w): (usize, &f64)| {
                let pupil = self.pupil(l, depth, *point)?;
                Some(if pupil.follows(light[l]) { Ok((pupil, *w)) } else { Err(Untold::Unfollowed) })
            };
            weights.iter().enumerate().filter(|(l, w)| **w > 0.0 && light[*l] > 0.0).filter_map(of).collect()
        };
        let bytes = |p: &Pupils| p.as_ref().map_or(0, |p| PointSpread::bytes(p.iter().map(|(pupil, _)| pupil)));
        let spread = |p: &Pupils| p.as_ref().map_err(|e| *e).and_then(|p| PointSpread::new(p));
        let some = |points: &[SensorPoint]| -> Vec<_> {
            let all: Vec<Pupils> = points.par_iter().map(pupils).collect();
            let most = all.iter().map(bytes).max().unwrap_or(0);
            if most.saturating_mul(threads() as u64) <= AT_ONCE {
                all.par_iter().map(spread).collect()
            } else {
                all.iter().map(spread).collect()
            }
        };
        points.chunks(threads().max(1)).flat_map(some).collect()
    }

    /// The number of the wavelength that `first` puts before all others.
    fn wavelength_by(&self, first: impl Fn(f64) -> f64) -> Option<usize> {
        let nm = &self.spec.quadrature.nm;
        (0..nm.len()).min_by(|a, b| first(nm[*a]).total_cmp(&first(nm[*b])))
    }

    /// Bytes, from above, of what kernels by diffraction of `points`, of `size` cells of `cell_mm` a side, need beside themselves; 0 of rays.
    #[doc(hidden)]
    pub fn bending_bytes_at(&self, depth: usize, points: &[SensorPoint], (size, cell_mm): (usize, f64)) -> u64 {
        // The shortest wavelength's rasters are the largest.
        let shortest = self.wavelength_by(|nm| nm);
        let of = |point: &SensorPoint| {
            let pupil = self.pupil(shortest?, depth, self.illumination().held(*point))?;
            Some(if pupil.is_told(cell_mm) { pupil.bytes(size as f64 * cell_mm) } else { 0 })
        };
        if self.waves().is_none() {
            return 0;
        }
        let most = points.par_iter().filter_map(of).reduce(|| 0, u64::max);
        most.saturating_mul(threads() as u64)
    }

    /// How far around its rays an automatic window reaches for light that bends at the narrowest pupil of `points`, at the longest wavelength, mm: ten `λ/NA`, beyond which
    /// is a hundredth of a perfect lens's light; 0 of rays.
    #[doc(hidden)]
    pub fn bending_mm_at(&self, depth: usize, points: &[SensorPoint]) -> f64 {
        let longest = self.wavelength_by(|nm| -nm);
        let at = |point: &SensorPoint| {
            let pupil = self.pupil(longest?, depth, self.illumination().held(*point))?;
            Some(BENT * pupil.bend_mm())
        };
        if self.waves().is_none() {
            return 0.0;
        }
        points.par_iter().filter_map(at).reduce(|| 0.0, f64::max)
    }
}
