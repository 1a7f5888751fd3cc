//! Kernels by diffraction, of one sensor point and wavelength at a time.
//!
//! The light that a sensor point `x₀` receives from the object seen at the sensor coordinates `y` goes, by reciprocity, the way of light from `x₀` to that object:
//! `|∫ a e^{ikΦ} dτ|²` over the stop `s`, with `Φ(s, y)` the optical path from `x₀` through `s` to the object. `Φ` is linear in `y` about `y₀ = x₀`, and
//! `τ(s) = ∂Φ/∂y` are the pupil's coordinates (image-side direction cosines, nearly). The amplitude follows from the étendue, `a² dτ = W ds`: no other factor of
//! obliquity. Rays are where the phase is stationary, so `∇Φ(s, y₀) + δ ∇τ = 0` has the displacements of geometric kernels.
//!
//! [`Pupil`] has path, direction cosines, places in the stop and clear apertures as polynomials of `τ` (`fitted`), through rays that are traced for the point itself: what a table
//! interpolates over sensor radii would have to be known to 1e-7 of a millimetre. `raster` makes amplitudes of them along the sensor's rows and columns, `cell` the shares
//! that edges leave open, `transform` a kernel: the power spectrum, times the transforms of pixel and scene sample, at the places of the kernel's raster. The raster's step of
//! `λ` over a period makes the kernel repeat with that period; light beyond it is folded back into it. Cells of the raster that an edge cuts have the share of their area as
//! amplitude; what that takes away is light far out, and is spread evenly over the period. `point_spread` has the same before pixel and scene sample: Strehl ratio and encircled energy.
//!
//! All of it has its pull-back: from a kernel's cotangent to the polynomials, to the rays, to every number of the lens.
//!
//! Scalar theory: no polarisation, no diffraction between the surfaces.

mod cell;
mod fitted;
mod functions;
mod open;
mod outside;
mod point_spread;
mod pupil;
mod raster;
mod transform;

use rayon::prelude::*;

use super::model::Model;
use super::point::SensorPoint;
use super::sensor_map::SensorMap;
use super::splat::Raster;
use super::table::Table;
use crate::lens::Lens;
use crate::trace::aim::SensorView;
use crate::trace::{System, SystemGradient};
use isoplanat_base::error::Result;
use isoplanat_base::math::memory::{product, threads};
use pupil::{MISSED, PATH_WAVES, Pulled, Shared};

pub(super) use open::{Open, OpenBar};
pub use point_spread::{PointSpread, Untold};
pub use pupil::Pupil;

/// Degrees of the polynomials that are tried in turn, until paths are told.
pub(super) const DEGREES: [usize; 6] = [9, 12, 15, 18, 22, 26];
/// Parts of the farthest sensor radius at which the polynomials' degree is chosen.
const LOOKED_AT: [f64; 5] = [0.0, 0.4, 0.7, 0.9, 1.0];

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
    /// Kernels of a wavelength that were made of rays, because polynomials do not follow their pupil.
    pub unfollowed: usize,
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
            unfollowed: self.unfollowed + other.unfollowed,
        }
    }
}

/// A lens whose kernels are made by diffraction.
#[derive(Clone, Debug)]
pub struct Waves {
    /// By what kernels are made.
    pub(super) model: Model,
    views: Vec<SensorView>,
    shared: Shared,
    /// `λ/NA` at the narrowest pupil that was looked at, the longest wavelength, mm; the largest path difference over one, the shortest wavelength.
    bend_mm: f64,
    path_waves: f64,
    /// The pupils that were looked at, at the longest wavelength, and the square of how much more the shortest one's rasters take.
    looked_at: Vec<Pupil>,
    finer: f64,
}

/// Cotangents on the polynomials of a [`Pupil`].
#[derive(Clone, Debug)]
pub(super) struct PupilBars(fitted::Bars);

impl PupilBars {
    /// All zero, in the form of `pupil`.
    pub(super) fn zeros(pupil: &Pupil) -> Self {
        Self(pupil.functions.fitted.no_bars())
    }
}

impl Pupil {
    /// What is to be told of a kernel of which a share was `spread` evenly.
    pub(super) fn figures(&self, spread: f64) -> WaveFigures {
        WaveFigures {
            residual_waves: self.residual_waves,
            spread,
            aperture: self.steepest,
            geometric: 0,
            unfollowed: 0,
        }
    }

    /// Adds the pull-back of a cotangent on [`Self::kernel`], which it makes again (written to `kernel`): `bar` gives the cotangent of what was made.
    pub(super) fn pull_kernel(
        &self,
        outward: [f64; 2],
        (raster, cell_mm): (Raster, f64),
        kernel: &mut [f64],
        bar: impl FnOnce(&[f64]) -> Vec<f64>,
        to: &mut PupilBars,
    ) {
        let made = self.made(outward, raster, cell_mm, kernel);
        let bar = bar(kernel);
        if let Some(made) = made {
            self.kernel_vjp(&made, kernel, &bar, &mut to.0);
        }
    }
}

impl Waves {
    /// Of `lens`, whose rays are in `table` and `maps`, as far out as light reaches (`farthest_mm`). The degree of the polynomials is the lowest of `degrees` that tells paths to
    /// 1e-4 waves at the shortest wavelength, at a few sensor radii; of one degree nothing is asked.
    ///
    /// # Errors
    /// A lens without light on the axis.
    pub(super) fn of(
        lens: &Lens,
        model: Model,
        (table, maps): (&Table, &[SensorMap]),
        farthest_mm: f64,
        degrees: &[usize],
    ) -> Result<Self> {
        let (nm, farthest) = (&table.spec.wavelength_nm, table.held(farthest_mm));
        let views: Vec<SensorView> = nm.iter().map(|nm| SensorView::new(&System::new(lens, *nm))).collect();
        let shortest = (0..nm.len()).min_by(|a, b| nm[*a].total_cmp(&nm[*b])).unwrap_or(0);
        let left = |shared: &Shared, share: f64| {
            let (map, mm) = (&maps[0], nm[shortest] * 1e-6);
            let pupil = Pupil::trace(&views[shortest], shared, map, share * farthest, mm);
            pupil.filter(|p| p.is_open() && p.residual_waves <= MISSED[0]).map(|p| p.residual_waves)
        };
        // How many places are not told, those without light among them; the largest residual of the others.
        let worst = |shared: &Shared| {
            let found: Vec<Option<f64>> = LOOKED_AT.par_iter().map(|share| left(shared, *share)).collect();
            (found.iter().filter(|f| f.is_none()).count(), found.into_iter().flatten().fold(0.0, f64::max))
        };
        let mut shared = Shared::new(lens, &views, degrees[0])?;
        let mut least = if degrees.len() > 1 { worst(&shared) } else { (0, 0.0) };
        for degree in &degrees[1..] {
            if least.1 <= PATH_WAVES {
                break;
            }
            let finer = Shared::new(lens, &views, *degree)?;
            let left = worst(&finer);
            if left < least {
                (shared, least) = (finer, left);
            }
        }
        let mut made = Self { model, views, shared, bend_mm: 0.0, path_waves: 0.0, looked_at: Vec::new(), finer: 1.0 };
        let longest = (0..nm.len()).max_by(|a, b| nm[*a].total_cmp(&nm[*b])).unwrap_or(0);
        for share in LOOKED_AT {
            for map in maps {
                let point = SensorPoint::along([1.0, 0.0], share * farthest);
                if let Some(pupil) = made.pupil_of(table, map, longest, point) {
                    made.bend_mm = made.bend_mm.max(pupil.bend_mm());
                    let waves = pupil.path_waves() * nm[longest] / nm[shortest];
                    made.path_waves = made.path_waves.max(waves);
                    made.looked_at.push(pupil);
                }
            }
        }
        made.finer = (nm[longest] / nm[shortest]).powi(2);
        Ok(made)
    }

    /// Bytes, from above, that kernels of `size` cells of `cell_mm` a side take while they are made, on all threads.
    pub(super) fn making_bytes(&self, size: usize, cell_mm: f64) -> u64 {
        if self.model == Model::Approximate {
            // A transform less than twice as wide as the window, its spectrum, its cotangent.
            let transform = product(&[2 * size, 2 * size, 64]);
            return Open::bytes().saturating_add(transform).saturating_mul(threads() as u64);
        }
        let told = self.looked_at.iter().filter(|p| p.is_told(cell_mm));
        #[expect(clippy::cast_precision_loss, reason = "from above")]
        let most = told.map(|p| p.bytes(size as f64 * cell_mm)).max().unwrap_or(0);
        self.of_shortest(most).saturating_mul(threads() as u64)
    }

    /// Bytes, from above, that one point spread takes.
    pub(super) fn point_spread_most(&self) -> u64 {
        self.of_shortest(self.looked_at.iter().map(|p| PointSpread::bytes([p].into_iter())).max().unwrap_or(0))
    }

    /// Bytes of the shortest wavelength's rasters for those of the longest's.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "from above"
    )]
    fn of_shortest(&self, bytes: u64) -> u64 {
        (bytes as f64 * self.finer).ceil() as u64
    }

    pub(super) fn bend_mm(&self) -> f64 {
        self.bend_mm
    }

    pub(super) fn path_waves(&self) -> f64 {
        self.path_waves
    }

    /// The pupil at `point` whose opening bends light of all wavelengths, and its wavelength's number: the middle one; nothing where its light is not that of rays, `light`.
    pub(super) fn opening(
        &self,
        table: &Table,
        map: &SensorMap,
        point: SensorPoint,
        light: &[f64],
    ) -> Option<(usize, Pupil)> {
        let nm = &table.spec.wavelength_nm;
        let mean = nm.iter().sum::<f64>() / nm.len() as f64;
        let off = |l: &usize| (nm[*l] - mean).abs();
        let middle = (0..nm.len()).min_by(|a, b| off(a).total_cmp(&off(b)))?;
        let pupil = self.pupil_of(table, map, middle, point).filter(|p| p.follows(light[middle]))?;
        Some((middle, pupil))
    }

    pub(super) fn pupil_of(&self, table: &Table, map: &SensorMap, l: usize, point: SensorPoint) -> Option<Pupil> {
        let radius_mm = table.held(point.radius_mm());
        Pupil::trace(&self.views[l], &self.shared, map, radius_mm, table.spec.wavelength_nm[l] * 1e-6)
    }

    /// Zero cotangents of the lens met from the sensor, by wavelength.
    pub(super) fn no_bars(&self) -> Vec<SystemGradient> {
        self.views.iter().map(|v| SystemGradient::zeros(&v.system)).collect()
    }

    /// Pulls cotangents on a pupil's polynomials back to the lens met from the sensor, and to the coefficients of the map (added).
    pub(super) fn vjp(
        &self,
        map: &SensorMap,
        l: usize,
        (pupil, bars): (&Pupil, &PupilBars),
        map_bar: &mut [f64],
    ) -> SystemGradient {
        let view = &self.views[l];
        let mut system = SystemGradient::zeros(&view.system);
        pupil.vjp(view, &self.shared, map, &bars.0, Pulled { system: &mut system, map: map_bar });
        system
    }
}

#[cfg(test)]
mod tests;
