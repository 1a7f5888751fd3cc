//! The pupil as a sensor point sees it: what its rays have at their coordinates `τ`, in which a kernel is a Fourier transform.

use std::sync::Arc;

use glam::DVec2;

use super::super::sensor_map::SensorMap;
use super::super::splat::Raster;
use super::super::stop::Part;
use super::super::table::beam::{self, Bases, Beam, NodeBars};
use super::cell::TOLD;
use super::fitted::{Bars, Fitted};
use super::functions::{CLIPS, PATH, PupilFunctions};
use super::outside::Plane;
use super::raster::{Field, Sampling};
use super::transform::{Reading, Spectrum};
use crate::lens::Lens;
use crate::lens::paraxial::first_order;
use crate::trace::SystemGradient;
use crate::trace::aim::SensorView;
use isoplanat_base::error::Result;
use isoplanat_base::math::fft::good_size;
use isoplanat_base::math::memory::product;

/// Root mean square residual of a path that is enough, wavelengths: 1e-3 made errors of 8e-3 of a phone lens's peak, which is a tenth of a perfect lens's.
pub(super) const PATH_WAVES: f64 = 1e-4;
/// Samples across the pupil, at least and at most.
const ACROSS: [f64; 2] = [64.0, 1024.0];
/// What a pupil may miss where kernels and point spreads are made of it: root mean square residual of its path, wavelengths; light, of that of rays.
pub(super) const MISSED: [f64; 2] = [0.1, 0.1];
/// Samples across the pupil where its light is counted.
const COUNTED: f64 = 64.0;
/// Periods to an octave.
const STEPS: f64 = 8.0;
/// Cells in a period, at least.
const CELLS: f64 = 8.0;
/// Margin of the period around the window and around the blur, in λ/NA, each side.
const MARGIN: f64 = 8.0;

/// What all pupils of a lens share.
#[derive(Clone, Debug)]
pub(super) struct Shared {
    pub(super) bases: Bases,
    /// Part of the stop's radius that the unit disk stands for.
    pub(super) pupil: f64,
    /// How far behind the first vertex the paraxial entrance pupil lies, mm.
    entrance: f64,
}

impl Shared {
    pub(super) fn new(lens: &Lens, views: &[SensorView], degree: usize) -> Result<Self> {
        let bases = Bases::new(degree, true);
        let pupil = beam::pupil(views, &bases).map_err(|f| super::super::table::failed(lens, 0.0, f))?;
        let entrance = first_order(lens, lens.wavelengths.primary_nm).entrance_pupil_position;
        Ok(Self { bases, pupil, entrance })
    }
}

/// The pupil of one sensor point, wavelength and object distance.
#[derive(Clone, Debug)]
pub struct Pupil {
    /// Wavelength, mm.
    pub wavelength_mm: f64,
    /// Root mean square residual of the path's polynomial, wavelengths.
    pub residual_waves: f64,
    pub(super) functions: PupilFunctions,
    /// Half the sides of the box around those that no aperture stops, and their mirror images.
    open: DVec2,
    /// The largest displacement of a ray, mm.
    reach_mm: f64,
    /// Largest `τ`: nearly the largest sine of an angle at the image.
    pub(in crate::psf) steepest: f64,
    origin: Option<Origin>,
}

/// What the values of a pupil's functions came from.
#[derive(Clone, Debug)]
pub(super) struct Origin {
    beam: Arc<Beam>,
    radius_mm: f64,
    /// Surfaces (from the sensor) whose apertures come near.
    clips: Vec<usize>,
}

/// What a kernel was made of, for its pull-back.
pub(super) struct Made {
    sampling: Sampling,
    field: Field,
    reading: Reading,
    spectrum: Spectrum,
}

impl Pupil {
    /// Of rays that are traced for it; nothing where none comes through.
    pub(super) fn trace(
        view: &SensorView,
        shared: &Shared,
        map: &SensorMap,
        radius_mm: f64,
        wavelength_mm: f64,
    ) -> Option<Self> {
        let beam = Beam::trace(view, &shared.bases, radius_mm, shared.pupil, None).ok()?;
        let basis = shared.bases.of(beam.part);
        let (ratio, growth) = (map.ratio(radius_mm), map.derivative(radius_mm));
        let (u, v) = (DVec2::new(0.0, map.slope(radius_mm)), map.vergence);
        let plane = Plane::new(shared.entrance, v);
        let image = view.system.image();
        let index = view.system.surfaces[image].index_after;
        let count = beam.nodes.len();
        let mean = beam.nodes.iter().map(|n| n.path).sum::<f64>() / count as f64;
        let (mut tau, mut path) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for node in &beam.nodes {
            let (far, t) = plane.path(u, v, node.ray.entrance, node.ray.slope);
            tau.push(index * DVec2::new(ratio, growth) * t);
            path.push(node.path - mean + index * far);
        }
        let beam = Arc::new(beam);
        let near = beam::near_apertures(&[view], &[vec![Arc::clone(&beam)]]);
        let clips: Vec<usize> = near.into_iter().map(|surface| image - surface).collect();
        let of = |f: &dyn Fn(&crate::trace::aim::Crossings) -> f64| beam.nodes.iter().map(f).collect::<Vec<f64>>();
        let stop = |f: &dyn Fn(&DVec2) -> f64| basis.nodes.iter().map(f).collect::<Vec<f64>>();
        let mut even = vec![path, of(&|n| n.ray.cosines.y), stop(&|s| s.y)];
        even.extend(clips.iter().map(|k| {
            let square = view.system.surfaces[*k].semi_diameter.powi(2);
            of(&|n| 1.0 - n.heights[*k].length_squared() / square)
        }));
        let odd = vec![of(&|n| n.ray.cosines.x), stop(&|s| s.x)];
        let part = beam.part;
        let origin = Origin { beam, radius_mm, clips };
        Self::of(wavelength_mm, part, basis.degree, (tau, [even, odd]), Some(origin))
    }

    /// From the values of its functions at `τ`.
    pub(super) fn of(
        wavelength_mm: f64,
        part: Part,
        degree: usize,
        (tau, values): (Vec<DVec2>, Bars),
        origin: Option<Origin>,
    ) -> Option<Self> {
        let fitted = Fitted::new(&tau, degree, values)?;
        let longest = |all: &[DVec2]| all.iter().map(|v| v.length()).fold(0.0, f64::max);
        // Displacements are where the path is stationary.
        let reach_mm = longest(&fitted.slopes(PATH));
        let residual_waves = fitted.residual(PATH) / wavelength_mm;
        let steepest = longest(&tau);
        let open = opening(&tau, &fitted);
        let functions = PupilFunctions { wavelength_mm, part, fitted, tau };
        Some(Self { wavelength_mm, residual_waves, functions, open, reach_mm, steepest, origin })
    }

    /// A lens without aberrations but `waves` of defocus at the rim, numerical aperture `na`.
    ///
    /// # Panics
    /// For an aperture that is not positive.
    pub fn perfect(wavelength_mm: f64, na: f64, waves: f64) -> Self {
        let nodes = Part::WHOLE.nodes(4);
        let of = |f: &dyn Fn(&DVec2) -> f64| nodes.iter().map(f).collect::<Vec<f64>>();
        let even = vec![of(&|s| waves * wavelength_mm * s.length_squared()), of(&|s| na * s.y), of(&|s| s.y)];
        let odd = vec![of(&|s| na * s.x), of(&|s| s.x)];
        let tau = nodes.iter().map(|s| na * *s).collect();
        Self::of(wavelength_mm, Part::WHOLE, 4, (tau, [even, odd]), None).expect("a disk")
    }

    /// How far paths differ over the pupil, wavelengths.
    pub(super) fn path_waves(&self) -> f64 {
        let (low, high) = self.functions.fitted.range(PATH);
        (high - low) / self.wavelength_mm
    }

    /// Half the smaller side of what apertures leave of the pupil, as a sine: light bends by a wavelength over it.
    pub(in crate::psf) fn narrowest(&self) -> f64 {
        self.open.min_element()
    }

    /// Half the pupil's larger side, as a sine.
    pub(super) fn aperture_half(&self) -> f64 {
        self.functions.fitted.half.max_element()
    }

    /// Degree of the polynomials.
    pub fn degree(&self) -> usize {
        self.functions.fitted.degree
    }

    /// Side of the transform that a kernel of a window of this side takes, at most.
    pub fn transform_size(&self, window_mm: f64) -> usize {
        let across = 2.0 * self.aperture_half() * self.period(window_mm) / self.wavelength_mm;
        good_size(2 * across.ceil() as usize + 1)
    }

    /// Bytes, from above, that a kernel of a window of this side takes while it is made and pulled back: the functions on the raster, the field twice as wide, its power and
    /// spectrum, and their cotangents.
    pub(in crate::psf) fn bytes(&self, window_mm: f64) -> u64 {
        let across = 2.0 * self.functions.fitted.half.length() * self.period(window_mm) / self.wavelength_mm + 5.0;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count, from above")]
        let side = good_size(2 * across.ceil() as usize + 1);
        product(&[side, side, 64])
    }

    /// Writes the kernel on `raster` in cells of `cell_mm`, and returns the share of the light that was spread evenly.
    pub fn kernel(&self, outward: [f64; 2], raster: Raster, cell_mm: f64, out: &mut [f64]) -> f64 {
        self.made(outward, raster, cell_mm, out).map_or(0.0, |made| made.field.lost / made.field.light)
    }

    /// As [`Self::kernel`], of `times` its period and so as many times the samples across the pupil: for measuring what they leave open.
    #[doc(hidden)]
    pub fn kernel_of_period(
        &self,
        times: f64,
        outward: [f64; 2],
        (raster, cell_mm): (Raster, f64),
        out: &mut [f64],
    ) -> f64 {
        let period = times * self.period(raster.size as f64 * cell_mm);
        let made = self.made_at(Sampling::new(&self.functions, outward, period), raster, cell_mm, out);
        made.map_or(0.0, |made| made.field.lost / made.field.light)
    }

    /// Samples across the pupil's larger side for a kernel of a window of this side.
    #[doc(hidden)]
    pub fn samples_across(&self, window_mm: f64) -> f64 {
        2.0 * self.aperture_half() * self.period(window_mm) / self.wavelength_mm
    }

    /// As [`Self::kernel`], with what the pull-back needs; nothing, and a kernel of zeros, where no light is.
    pub(super) fn made(&self, outward: [f64; 2], raster: Raster, cell_mm: f64, out: &mut [f64]) -> Option<Made> {
        let period = self.period(raster.size as f64 * cell_mm);
        self.made_at(Sampling::new(&self.functions, outward, period), raster, cell_mm, out)
    }

    pub(super) fn made_at(&self, sampling: Sampling, raster: Raster, cell_mm: f64, out: &mut [f64]) -> Option<Made> {
        let field = self.functions.field(&sampling);
        if field.light.is_nan() || field.light <= 0.0 {
            out.fill(0.0);
            return None;
        }
        let reading = Reading::new(&field, &sampling, raster, cell_mm);
        let spectrum = reading.kernel(&field, out);
        Some(Made { sampling, field, reading, spectrum })
    }

    /// Adds the pull-back of a cotangent on a kernel to that of the polynomials. The raster is held: where it lies changes kernels by its own error alone.
    pub(super) fn kernel_vjp(&self, made: &Made, kernel: &[f64], bar: &[f64], to: &mut Bars) {
        let (amplitude, light) = made.reading.kernel_vjp(&made.field, &made.spectrum, kernel, bar);
        self.functions.field_vjp(&made.sampling, &made.field, &amplitude, light, to);
    }

    /// Pulls cotangents on the polynomials back to the lens, met from the sensor, and to the map's coefficients (both added).
    ///
    /// # Panics
    /// Of a pupil that no rays were traced for.
    pub(super) fn vjp(&self, view: &SensorView, shared: &Shared, map: &SensorMap, bars: &Bars, to: Pulled<'_>) {
        let Origin { beam, radius_mm, clips } = self.origin.as_ref().expect("a traced pupil");
        let radius_mm = *radius_mm;
        let ([even, odd], tau) = self.functions.fitted.vjp(bars);
        let (ratio, growth) = (map.ratio(radius_mm), map.derivative(radius_mm));
        let (u, v) = (DVec2::new(0.0, map.slope(radius_mm)), map.vergence);
        let image = view.system.image();
        let index = view.system.surfaces[image].index_after;
        let (mut u_bar, mut scales_bar, mut index_bar) = (DVec2::ZERO, DVec2::ZERO, 0.0);
        let plane = Plane::new(shared.entrance, v);
        let (mut entrance, mut slope): ([Vec<f64>; 2], [Vec<f64>; 2]) = Default::default();
        for (j, node) in beam.nodes.iter().enumerate() {
            let (e, m) = (node.ray.entrance, node.ray.slope);
            let (far, t) = plane.path(u, v, e, m);
            let scales = DVec2::new(ratio, growth);
            scales_bar += index * tau[j] * t;
            index_bar += far * even[PATH][j] + (tau[j] * scales).dot(t);
            let back = plane.path_vjp((u, v), e, m, index * even[PATH][j], index * scales * tau[j]);
            u_bar += back.u;
            for (to, by) in [(&mut entrance, back.entrance), (&mut slope, back.slope)] {
                to[0].push(by.x);
                to[1].push(by.y);
            }
        }
        map.local_vjp(radius_mm, [u_bar.y, scales_bar.x, scales_bar.y], to.map);
        to.system.indices[image + 1] += index_bar;
        let [mut even, mut odd] = [even.into_iter(), odd.into_iter()];
        let paths = even.next().unwrap_or_default();
        let cosines = [odd.next().unwrap_or_default(), even.next().unwrap_or_default()];
        // The stop's points are held.
        let clips = clips.iter().copied().zip(even.skip(1)).collect();
        let bars = NodeBars { cosines, entrance, slope, clips, paths };
        beam.nodes_vjp(view, &shared.bases.of(beam.part), &bars, to.system);
    }

    /// Whether a raster that is not too large tells the blur in cells of `cell_mm`: else there are hundreds of waves, or cells of hundreds of `λ/NA`, and geometry tells it
    /// as well.
    pub(in crate::psf) fn is_told(&self, cell_mm: f64) -> bool {
        let most = self.most();
        self.least() <= most && cell_mm <= most / CELLS
    }

    /// Whether some ray is stopped by no aperture.
    pub(super) fn is_open(&self) -> bool {
        (0..self.functions.tau.len()).any(|j| is_clear(&self.functions.fitted, j))
    }

    /// Whether the polynomials follow the pupil: their paths, and the light within their edges, which is `light` by rays.
    pub(in crate::psf) fn follows(&self, light: f64) -> bool {
        let period = COUNTED * self.wavelength_mm / (2.0 * self.aperture_half());
        let counted = || self.functions.open_field(&Sampling::new(&self.functions, [1.0, 0.0], period)).light;
        self.residual_waves <= MISSED[0] && (counted() - light).abs() <= MISSED[1] * light
    }

    /// Smallest period that the blur asks for, mm: beside it there is room, and edges' light that lands far from them, at the blur's other side, is told.
    pub(super) fn least(&self) -> f64 {
        (2.0 * self.reach_mm + self.margin()).max(self.reach_mm / TOLD)
    }

    /// The largest displacement of a ray, mm.
    pub(super) fn reach_mm(&self) -> f64 {
        self.reach_mm
    }

    /// How far light bends, mm: `λ/NA` of the narrower side.
    pub(in crate::psf) fn bend_mm(&self) -> f64 {
        self.wavelength_mm / self.narrowest().max(1e-9)
    }

    /// What is left around a kernel, mm.
    fn margin(&self) -> f64 {
        MARGIN * self.bend_mm()
    }

    /// Largest period, mm.
    fn most(&self) -> f64 {
        ACROSS[1] * self.wavelength_mm / (2.0 * self.aperture_half())
    }

    /// The period of a kernel whose window has this side, mm. It goes by steps: lenses that differ a little have the same, and what a kernel's error of sampling is does
    /// not enter derivatives.
    pub(super) fn period(&self, window_mm: f64) -> f64 {
        let wanted = (window_mm + self.margin()).max(self.least());
        stepped(wanted.clamp(ACROSS[0] / ACROSS[1] * self.most(), self.most()))
    }
}

/// The next of the steps that periods go by, so many to an octave.
pub(super) fn stepped(wanted: f64) -> f64 {
    ((wanted.log2() * STEPS).ceil() / STEPS).exp2()
}

/// Whether no aperture stops the ray of a node.
fn is_clear(fitted: &Fitted, node: usize) -> bool {
    fitted.halves[0].values(CLIPS).iter().all(|clip| clip[node] >= 0.0)
}

/// Half the sides of the box around the rays that no aperture stops and their mirror images; a tenth of all where a box of rays is less.
fn opening(tau: &[DVec2], fitted: &Fitted) -> DVec2 {
    let (mut low, mut high, mut across) = (f64::INFINITY, f64::NEG_INFINITY, 0.0f64);
    for t in (0..tau.len()).filter(|j| is_clear(fitted, *j)).map(|j| tau[j]) {
        (low, high, across) = (low.min(t.y), high.max(t.y), across.max(t.x.abs()));
    }
    let least = 0.1 * fitted.half;
    DVec2::new(across, 0.5 * (high - low)).max(least)
}

/// Where a pupil's pull-back is added: the lens met from the sensor, and the map's coefficients.
pub(super) struct Pulled<'a> {
    pub(super) system: &'a mut SystemGradient,
    pub(super) map: &'a mut [f64],
}
