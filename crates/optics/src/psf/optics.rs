//! A lens as image formation sees it: one value, traced once, that distortion, illumination and kernels are read from, and that
//! their cotangents are added up in before they go back to the lens together.
//!
//! ```
//! use isoplanat_optics::lens::builtin;
//! use isoplanat_optics::psf::{Optics, OpticsSpec, Quadrature, SensorPoint};
//!
//! let lens = builtin::lens("cooke_triplet")?;
//! let quadrature = Quadrature { nm: vec![486.1, 587.6, 656.3], weight: vec![vec![0.2, 0.5, 0.3]] };
//! let optics = Optics::compute(&lens, &OpticsSpec::even(18.0, vec![0.0], quadrature))?;
//! // Relative illumination 15 mm from the axis, and the slope of the object that is seen there.
//! let point = SensorPoint::at([15.0, 0.0]);
//! assert!((0.9..0.92).contains(&optics.relative_illumination(point)[0]));
//! assert!((0.29..0.31).contains(&optics.maps[0].slope(15.0)));
//! // A kernel of 21 × 21 pixels of 10 µm.
//! let form = optics.form(500, 21, 1, 0.010);
//! let mut kernel = vec![0.0; 21 * 21];
//! let outside = optics.kernels(&form, 0, point, &mut kernel);
//! assert!((kernel.iter().sum::<f64>() + outside[0] - 1.0).abs() < 1e-12);
//! # Ok::<(), isoplanat_base::error::Error>(())
//! ```

use std::collections::HashMap;

use rayon::prelude::*;

use super::illumination::{Illumination, IlluminationBar};
use super::kernel::{KernelBar, KernelForm, Pencil, PencilBar};
use super::measured::{Falloff, MeasuredPsf};
use super::model::Model;
use super::point::SensorPoint;
use super::rays::Rays;
use super::sensor_map::SensorMap;
use super::splat::Raster;
use super::stop::StopPoints;
use super::table::{Adapted, Table, TableBar, TableSpec, Tolerance};
use super::wave::{DEGREES, Waves};
use crate::lens::{Lens, LensGradient};
use crate::trace::SystemGradient;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::stop::look;

/// A quadrature over wavelength: nodes and, by channel, weights that sum to one.
#[derive(Clone, Debug, PartialEq)]
pub struct Quadrature {
    /// Wavelengths, nm; of measured kernels, which have colours in their place, none.
    pub nm: Vec<f64>,
    /// Weight of each wavelength, or measured colour, in each channel.
    pub weight: Vec<Vec<f64>>,
}

/// What is computed of a lens.
#[derive(Clone, Debug, PartialEq)]
pub struct OpticsSpec {
    /// Sensor radii at which rays are traced, mm, growing, the first 0.
    pub radii_mm: Vec<f64>,
    /// Object distances, as vergence, 1/mm.
    pub vergences: Vec<f64>,
    /// Wavelengths and channels.
    pub quadrature: Quadrature,
    /// Degree of the polynomials over the stop.
    pub degree: usize,
    /// As [`TableSpec::lit`].
    pub lit: bool,
    /// Radii of the illumination, less one.
    pub illuminations: u32,
    /// By what kernels are made.
    pub diffraction: Model,
}

impl OpticsSpec {
    /// Sixteen even intervals to `radius_mm`, degree 9.
    pub fn even(radius_mm: f64, vergences: Vec<f64>, quadrature: Quadrature) -> Self {
        Self::knots(16, radius_mm, vergences, quadrature)
    }

    /// `intervals` of it.
    fn knots(intervals: u32, radius_mm: f64, vergences: Vec<f64>, quadrature: Quadrature) -> Self {
        let radii_mm = (0..=intervals).map(|i| radius_mm * f64::from(i) / f64::from(intervals)).collect();
        Self { radii_mm, vergences, quadrature, degree: 9, lit: false, illuminations: 256, diffraction: Model::Rays }
    }
}

/// A lens over sensor radius, wavelength and object distance.
#[derive(Clone, Debug)]
pub struct Optics {
    /// What was asked for.
    pub spec: OpticsSpec,
    /// Sensor radius ⇄ object slope, by object distance.
    pub maps: Vec<SensorMap>,
    beams: Beams,
}

/// Where the light of every sensor radius comes from.
#[derive(Clone, Debug)]
enum Beams {
    /// From rays through a lens.
    Traced { table: Box<Table>, illumination: Illumination, waves: Option<Box<Waves>> },
    /// From measurements on a camera: kernels, and how light falls off. A pixel is `pitch_mm` wide.
    Measured { psf: MeasuredPsf, light: Falloff, pitch_mm: f64 },
}

/// Cotangents on what is read from an [`Optics`].
#[derive(Clone, Debug)]
pub struct OpticsBar {
    /// Of the table's polynomials.
    pub table: TableBar,
    /// Of the irradiance.
    pub illumination: IlluminationBar,
    /// Of the maps' coefficients, by object distance.
    pub maps: Vec<Vec<f64>>,
    /// Of the lens met from the sensor, by wavelength, through kernels by diffraction; none where all go by rays.
    systems: Vec<SystemGradient>,
}

impl OpticsBar {
    /// All zero, in the form of `optics`.
    pub fn zeros(optics: &Optics) -> Self {
        Self {
            table: TableBar::zeros(optics.table()),
            illumination: optics.illumination().no_bar(),
            maps: optics.maps.iter().map(|m| vec![0.0; m.coefficients.len()]).collect(),
            systems: optics.waves().map(Waves::no_bars).unwrap_or_default(),
        }
    }

    /// Adds what [`Optics::kernels_vjp`] gave for object distance `depth`.
    pub fn add_kernel(&mut self, optics: &Optics, depth: usize, back: &KernelBar) {
        back.origin.add_to(optics.table(), &mut self.table);
        optics.illumination().at_vjp(back.origin.point, &back.irradiance, &mut self.illumination);
        self.maps[depth].iter_mut().zip(&back.map).for_each(|(a, b)| *a += b);
        back.systems.iter().for_each(|(l, system)| self.systems[*l].add(system));
    }

    /// Adds `other`.
    pub fn add(&mut self, other: &Self) {
        self.table.add(&other.table);
        self.systems.iter_mut().zip(&other.systems).for_each(|(a, b)| a.add(b));
        let pairs = |a: &mut [Vec<f64>], b: &[Vec<f64>]| {
            a.iter_mut().flatten().zip(b.iter().flatten()).for_each(|(x, y)| *x += y);
        };
        pairs(&mut self.illumination, &other.illumination);
        pairs(&mut self.maps, &other.maps);
    }
}

fn finite(vergences: &[f64]) -> Result<()> {
    vergences
        .iter()
        .find(|v| !v.is_finite())
        .map_or(Ok(()), |v| Err(Error::bad("", "object distance", format!("vergence {v} /mm"), "a finite number")))
}

impl Optics {
    /// `lens` by [`OpticsSpec::even`], with the irradiance at `illuminations + 1` radii; in four times as many intervals where rays of a part of the
    /// stop fail, since between knots what both know of it is used.
    ///
    /// # Errors
    /// As [`Self::compute`].
    pub fn even(
        lens: &Lens,
        radius_mm: f64,
        vergences: Vec<f64>,
        quadrature: Quadrature,
        illuminations: u32,
    ) -> Result<Self> {
        let spec = OpticsSpec { illuminations, ..OpticsSpec::even(radius_mm, vergences, quadrature) };
        let optics = Self::compute(lens, &spec)?;
        if !optics.table().is_partial() {
            return Ok(optics);
        }
        Self::compute(
            lens,
            &OpticsSpec { illuminations, ..OpticsSpec::knots(64, radius_mm, spec.vergences, spec.quadrature) },
        )
    }

    /// Traces `lens`.
    ///
    /// # Errors
    /// A lens without rotational symmetry, or without light on the axis; an object distance at which the picture folds.
    pub fn compute(lens: &Lens, spec: &OpticsSpec) -> Result<Self> {
        finite(&spec.vergences)?;
        let Quadrature { nm, .. } = &spec.quadrature;
        let table_spec = TableSpec {
            radii_mm: spec.radii_mm.clone(),
            wavelength_nm: nm.clone(),
            degree: spec.degree,
            lit: spec.lit,
        };
        Self::of(lens, Table::compute(lens, &table_spec)?, spec.clone())
    }

    /// Traces `lens` at knots, and by polynomials over the stop of at least the degree of `spec`, that hold `tolerance` up to its last radius, whose other radii are not looked
    /// at; and what their errors are.
    ///
    /// # Errors
    /// As [`Self::compute`].
    pub fn adapted(lens: &Lens, spec: OpticsSpec, tolerance: Tolerance) -> Result<(Self, Tolerance)> {
        finite(&spec.vergences)?;
        let radius_mm = spec.radii_mm[spec.radii_mm.len() - 1];
        let nearest = spec.vergences.iter().copied().fold(0.0, f64::max);
        let nm = &spec.quadrature.nm;
        let Adapted { table, radii_mm, errors } =
            Adapted::compute(lens, nearest, nm, spec.degree, radius_mm, tolerance)?;
        let (degree, lit) = (table.spec.degree, table.spec.lit);
        Ok((Self::of(lens, table, OpticsSpec { radii_mm, degree, lit, ..spec })?, errors))
    }

    fn of(lens: &Lens, table: Table, spec: OpticsSpec) -> Result<Self> {
        let radius_mm = spec.radii_mm[spec.radii_mm.len() - 1];
        let illumination = Illumination::compute(&table, radius_mm, spec.illuminations);
        let maps = spec.vergences.iter().map(|v| SensorMap::fit(lens, &table, *v)).collect::<Result<_>>()?;
        let diffraction = spec.diffraction;
        let optics = Self { spec, maps, beams: Beams::Traced { table: Box::new(table), illumination, waves: None } };
        optics.diffracting(lens, diffraction)
    }

    /// What was measured on a camera in place of a lens: kernels, how light falls off, and where on the sensor an object's slope is seen, in
    /// whose mm a pixel is `pitch_mm` wide. Three channels; a psf of one colour serves all of them.
    pub fn measured(psf: MeasuredPsf, light: Falloff, map: SensorMap, pitch_mm: f64) -> Self {
        let colours = psf.channels();
        let sees = |c: usize| (0..colours).map(|k| f64::from(u8::from(k == c.min(colours - 1)))).collect();
        let spec = OpticsSpec {
            radii_mm: psf.radii_px.iter().map(|r| r * pitch_mm).collect(),
            vergences: vec![map.vergence],
            quadrature: Quadrature { nm: Vec::new(), weight: (0..3).map(sees).collect() },
            // No rays, no polynomials.
            degree: 1,
            lit: false,
            illuminations: 0,
            diffraction: Model::Rays,
        };
        Self { spec, maps: vec![map], beams: Beams::Measured { psf, light, pitch_mm } }
    }

    /// The rays of a lens, and the irradiance of white behind it.
    ///
    /// # Panics
    /// Where there is no lens: what was measured has neither rays nor gradients.
    fn traced(&self) -> (&Table, &Illumination) {
        match &self.beams {
            Beams::Traced { table, illumination, .. } => (table, illumination),
            Beams::Measured { .. } => panic!("rays of a measured lens"),
        }
    }

    /// The rays of the lens.
    ///
    /// # Panics
    /// Of [`Self::measured`]: there is no lens to trace.
    pub fn table(&self) -> &Table {
        self.traced().0
    }

    /// Irradiance of white behind the lens.
    ///
    /// # Panics
    /// As [`Self::table`].
    pub fn illumination(&self) -> &Illumination {
        self.traced().1
    }

    /// The same with kernels made by `model` of `lens`, which it was traced of. What was measured stays as it is.
    ///
    /// # Errors
    /// As [`Self::compute`].
    pub fn diffracting(mut self, lens: &Lens, model: Model) -> Result<Self> {
        let degrees = match model {
            Model::Rays => return Ok(self.of_rays()),
            // Its paths are not asked for.
            Model::Approximate => &DEGREES[..1],
            Model::Waves => &DEGREES[..],
        };
        if matches!(self.beams, Beams::Traced { .. }) {
            let made = self.made_of(lens, model, degrees)?;
            if let Beams::Traced { waves, .. } = &mut self.beams {
                *waves = Some(Box::new(made));
                self.spec.diffraction = model;
            }
        }
        Ok(self)
    }

    /// How far diffraction would bend light, mm, and how far paths differ, wavelengths, before kernels are made by it: [`Self::bending_mm`] and
    /// [`Self::path_waves`], nearly.
    ///
    /// # Errors
    /// As [`Self::compute`].
    #[doc(hidden)]
    pub fn look_at_bending(&self, lens: &Lens) -> Result<[f64; 2]> {
        let looked = self.made_of(lens, Model::Waves, &DEGREES[..1])?;
        Ok([looked.bend_mm(), looked.path_waves()])
    }

    fn made_of(&self, lens: &Lens, model: Model, degrees: &[usize]) -> Result<Waves> {
        Waves::of(lens, model, (self.table(), &self.maps), self.illumination().lit_mm(), degrees)
    }

    /// The same with kernels of rays.
    #[doc(hidden)]
    #[must_use]
    pub fn of_rays(mut self) -> Self {
        if let Beams::Traced { waves, .. } = &mut self.beams {
            *waves = None;
        }
        self.spec.diffraction = Model::Rays;
        self
    }

    /// `λ/NA` at the narrowest pupil and the longest wavelength, mm: how far diffraction bends light; 0 where kernels are made of rays.
    #[doc(hidden)]
    pub fn bending_mm(&self) -> f64 {
        self.waves().map_or(0.0, Waves::bend_mm)
    }

    /// Bytes, from above, that kernels by diffraction of `size` cells of `cell_mm` a side take while they are made, on all threads; 0 where kernels are made of rays.
    #[doc(hidden)]
    pub fn bending_bytes(&self, size: usize, cell_mm: f64) -> u64 {
        self.waves().map_or(0, |w| w.making_bytes(size, cell_mm))
    }

    /// Largest path difference over a pupil, wavelengths, as far as was looked; 0 where kernels are not made by waves.
    #[doc(hidden)]
    pub fn path_waves(&self) -> f64 {
        self.waves().filter(|w| w.model == Model::Waves).map_or(0.0, Waves::path_waves)
    }

    /// What makes kernels by diffraction; nothing where rays do.
    pub(crate) fn waves(&self) -> Option<&Waves> {
        match &self.beams {
            Beams::Traced { waves, .. } => waves.as_deref(),
            Beams::Measured { .. } => None,
        }
    }

    /// The same with the illumination at another number of radii, less one.
    /// What was measured stays as it is.
    #[must_use]
    pub fn illuminated(mut self, illuminations: u32) -> Self {
        if let Beams::Traced { table, illumination, .. } = &mut self.beams {
            let radius_mm = illumination.radii_mm[illumination.radii_mm.len() - 1];
            *illumination = Illumination::compute(table, radius_mm, illuminations);
            self.spec.illuminations = illuminations;
        }
        self
    }

    /// Channels.
    pub fn channels(&self) -> usize {
        self.spec.quadrature.weight.len()
    }

    /// Irradiance of white by channel, sr for a sensor in air; of what was measured, relative to the centre.
    pub fn irradiance(&self, point: SensorPoint) -> Vec<f64> {
        let light = match &self.beams {
            Beams::Traced { illumination, .. } => illumination.at(point),
            Beams::Measured { light, pitch_mm, .. } => return light.at(point.radius_mm() / pitch_mm),
        };
        let of = |w: &Vec<f64>| w.iter().zip(&light).map(|(w, e)| w * e).sum();
        self.spec.quadrature.weight.iter().map(of).collect()
    }

    /// Irradiance of white by channel, relative to that on the axis; 0 where a channel has none there.
    pub fn relative_illumination(&self, point: SensorPoint) -> Vec<f64> {
        let pairs = self.irradiance(point).into_iter().zip(self.irradiance(SensorPoint::AXIS));
        pairs.map(|(here, axis)| if axis > 0.0 { here / axis } else { 0.0 }).collect()
    }

    /// Adds the pull-back of cotangents on [`Self::relative_illumination`] at some points to `bar`.
    ///
    /// # Panics
    /// As [`Self::table`].
    pub fn relative_illumination_vjp<'a>(
        &self,
        points: impl Iterator<Item = (SensorPoint, &'a [f64])>,
        bar: &mut OpticsBar,
    ) {
        let weights = &self.spec.quadrature.weight;
        let scale: Vec<f64> =
            self.irradiance(SensorPoint::AXIS).iter().map(|e| if *e > 0.0 { e.recip() } else { 0.0 }).collect();
        let (mut bars, mut axis_bar) = (vec![0.0; self.spec.quadrature.nm.len()], vec![0.0; scale.len()]);
        let pull = |of_channels: &[f64], bars: &mut [f64]| {
            bars.fill(0.0);
            for ((weight, b), scale) in weights.iter().zip(of_channels).zip(&scale) {
                bars.iter_mut().zip(weight).for_each(|(to, w)| *to += b * scale * w);
            }
        };
        for (point, value_bar) in points {
            pull(value_bar, &mut bars);
            self.illumination().at_vjp(point, &bars, &mut bar.illumination);
            for ((to, here), (b, scale)) in
                axis_bar.iter_mut().zip(self.irradiance(point)).zip(value_bar.iter().zip(&scale))
            {
                *to -= b * here * scale;
            }
        }
        pull(&axis_bar, &mut bars);
        self.illumination().at_vjp(SensorPoint::AXIS, &bars, &mut bar.illumination);
    }

    /// How kernels of `size` cells are made: about `dense` points of the stop, `samples` scene samples a cell of `cell_mm`.
    pub fn form(&self, dense: usize, size: usize, samples: usize, cell_mm: f64) -> KernelForm {
        let dense = if matches!(self.beams, Beams::Traced { .. }) { dense } else { 1 };
        KernelForm {
            points: StopPoints::new(self.spec.degree, dense),
            weight: self.spec.quadrature.weight.clone(),
            raster: Raster { size, samples },
            cell_mm,
            keeps_light: false,
        }
    }

    pub(super) fn pencil(&self, form: &KernelForm, depth: usize, point: SensorPoint) -> Pencil {
        match &self.beams {
            Beams::Traced { table, illumination, waves } => {
                form.pencil(table, illumination, &self.maps[depth], point, waves.as_deref())
            }
            Beams::Measured { psf, pitch_mm, .. } => form.pencil_of(Self::moved(psf, *pitch_mm, point)),
        }
    }

    /// The light of every measured colour at a point.
    fn moved(psf: &MeasuredPsf, pitch_mm: f64, point: SensorPoint) -> Vec<Rays> {
        (0..psf.channels())
            .map(|c| {
                let weights = psf.at(point.radius_mm() / pitch_mm, c);
                let all = psf.moves.iter().zip(&weights).filter(|(_, w)| **w > 0.0);
                Rays::of(all.map(|(([along, across], n), w)| ([across * pitch_mm, along * pitch_mm], 0.5 * n * w)))
            })
            .collect()
    }

    /// Light by whole cells of distance from a kernel's centre, for every channel, at a point.
    fn spread(&self, form: &KernelForm, depth: usize, point: SensorPoint) -> Vec<Vec<f64>> {
        let (rays, levels) = match &self.beams {
            Beams::Traced { table, illumination, .. } => {
                let of = |l: usize| form.rays(table, &self.maps[depth], l, point);
                let rays: Vec<Rays> = (0..self.spec.quadrature.nm.len()).map(of).collect();
                (rays, illumination.at(point))
            }
            Beams::Measured { psf, pitch_mm, .. } => {
                let rays = Self::moved(psf, *pitch_mm, point);
                let even = vec![1.0; rays.len()];
                (rays, even)
            }
        };
        let by_channel = |weight: &Vec<f64>| {
            let total: f64 = weight.iter().zip(&levels).map(|(w, e)| w * e).sum();
            let mut light = Vec::new();
            for (l, rays) in rays.iter().enumerate() {
                let scale = weight[l] * levels[l] / total;
                if scale.is_finite() {
                    rays.add_reach(form.cell_mm, scale, &mut light);
                }
            }
            light
        };
        self.spec.quadrature.weight.iter().map(by_channel).collect()
    }

    /// Writes the fine kernels of all channels at `point` for object distance `depth`, `[channel][row][col]` on the form's raster;
    /// returns the share of each channel's light that falls outside the window.
    pub fn kernels(&self, form: &KernelForm, depth: usize, point: SensorPoint, out: &mut [f64]) -> Vec<f64> {
        form.kernels(&self.pencil(form, depth, point), point.outward(), out)
    }

    /// What `with` makes of each point's number, kernels and light outside, as of [`Self::kernels`], in the order of `points`;
    /// points at the same distance from the axis share its rays.
    pub fn kernels_each<R: Send>(
        &self,
        form: &KernelForm,
        depth: usize,
        points: &[SensorPoint],
        with: impl Fn(usize, &[f64], &[f64]) -> R + Sync,
    ) -> Vec<R> {
        let of_radius = |group: &Vec<usize>| -> Vec<(usize, R)> {
            look();
            let pencil = self.pencil(form, depth, points[group[0]]);
            let mut kernel = vec![0.0; form.channels() * form.raster.len()];
            let one = |i: &usize| {
                look();
                let outside = form.kernels(&pencil, points[*i].outward(), &mut kernel);
                (*i, with(*i, &kernel, &outside))
            };
            group.iter().map(one).collect()
        };
        let mut made: Vec<(usize, R)> = by_radius(points).par_iter().flat_map_iter(of_radius).collect();
        made.sort_unstable_by_key(|(i, _)| *i);
        made.into_iter().map(|(_, r)| r).collect()
    }

    /// Pulls cotangents on the kernels of `points` back, one result a distance from the axis; `bar` writes those of a point
    /// over zeros, or says that there are none. [`OpticsBar::add_kernel`] takes what comes.
    ///
    /// # Panics
    /// As [`Self::table`].
    pub fn kernels_vjp(
        &self,
        form: &KernelForm,
        depth: usize,
        points: &[SensorPoint],
        bar: impl Fn(usize, &mut [f64]) -> bool + Sync,
    ) -> Vec<KernelBar> {
        let table = self.table();
        let of_radius = |group: &Vec<usize>| {
            let mut pulled: Option<(Pencil, PencilBar)> = None;
            let mut fine = vec![0.0; form.channels() * form.raster.len()];
            for i in group {
                look();
                fine.fill(0.0);
                if !bar(*i, &mut fine) {
                    continue;
                }
                let (pencil, to) = pulled.get_or_insert_with(|| {
                    let pencil = self.pencil(form, depth, points[*i]);
                    let none = PencilBar::zeros(&pencil);
                    (pencil, none)
                });
                form.kernels_vjp(pencil, points[*i].outward(), &fine, to);
            }
            pulled.map(|(pencil, bar)| form.pencil_vjp(table, &self.maps[depth], (&pencil, self.waves()), &bar))
        };
        by_radius(points).par_iter().filter_map(of_radius).collect()
    }

    /// Half-widths in pixels of the square windows that hold all but each of `shares` of the light of every channel at
    /// every traced radius, for object distance `depth`; two pixels for box and tent added.
    pub fn half_widths(&self, form: &KernelForm, depth: usize, shares: &[f64], radii_mm: [f64; 2]) -> Vec<usize> {
        let [low, high] = radii_mm;
        // As kernels are made: those of dim places are those of the last place with light.
        let edge = match &self.beams {
            Beams::Traced { table, illumination, .. } => table.edge_mm.min(illumination.lit_mm()),
            Beams::Measured { .. } => f64::INFINITY,
        };
        let high = high.min(edge);
        let inner = self.spec.radii_mm.iter().copied().filter(|r| *r > low && *r < high);
        let radii: Vec<f64> = [low, high].into_iter().chain(inner).filter(|r| *r <= edge).collect();
        let each: Vec<Vec<usize>> = radii
            .par_iter()
            .map(|r| {
                look();
                let mut widest = vec![0; shares.len()];
                for light in self.spread(form, depth, SensorPoint::along([1.0, 0.0], *r)) {
                    for (share, widest) in shares.iter().zip(&mut widest) {
                        let mut sum = 0.0;
                        let passes = |k: &usize| {
                            sum += light[*k];
                            sum > *share
                        };
                        *widest = (*widest).max((0..light.len()).rev().find(passes).unwrap_or(0));
                    }
                }
                widest
            })
            .collect();
        (0..shares.len()).map(|k| each.iter().map(|w| w[k]).max().unwrap_or(0) + 2).collect()
    }

    /// Pulls cotangents back to the lens.
    ///
    /// # Panics
    /// As [`Self::table`].
    pub fn vjp(&self, lens: &Lens, bar: &OpticsBar) -> LensGradient {
        let (rays, illumination) = self.traced();
        let mut table = bar.table.clone();
        illumination.vjp(rays, &bar.illumination, &mut table);
        for (map, map_bar) in self.maps.iter().zip(&bar.maps) {
            map.fit_vjp(rays, map_bar, &mut table);
        }
        let mut gradient = rays.vjp(lens, &table);
        for (system, nm) in bar.systems.iter().zip(&self.spec.quadrature.nm) {
            system.reversed().add_to(lens, *nm, &mut gradient);
        }
        gradient
    }
}

/// Numbers of points at the same distance from the axis, in the order of the first of each.
fn by_radius(points: &[SensorPoint]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    let mut known: HashMap<u64, usize> = HashMap::new();
    for (i, point) in points.iter().enumerate() {
        let group = *known.entry(point.radius_mm().to_bits()).or_insert_with(|| {
            groups.push(Vec::new());
            groups.len() - 1
        });
        groups[group].push(i);
    }
    groups
}

#[cfg(test)]
mod tests;
