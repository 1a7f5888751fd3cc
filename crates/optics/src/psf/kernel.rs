//! The kernels of one sensor point, and their pull-back.
//!
//! A kernel belongs to the place on the sensor where light arrives. The ray from there through the stop point `s` meets the
//! object at the slope `u(s)`; the raster that the scene is warped to shows that at `D(u)` ([`SensorMap`]), so the ray moves
//! light by `x − D(u)`. Its share is `W · Π share_a`, the étendue times a C² ramp at every clipping aperture, over
//! their sum; a wavelength's share of a channel is its irradiance there, whose edges are hard ([`super::illumination`]).
//! So a channel's kernel sums to one, less what falls outside the window, and what varies over the field in brightness is
//! kept beside it.

use super::convolved::Convolution;
use super::illumination::Illumination;
use super::meridian::{Dense, Meridian, MeridianBar};
use super::model::Model;
use super::point::SensorPoint;
use super::rays::{Rays, RaysBar};
use super::sensor_map::SensorMap;
use super::splat::Raster;
use super::stop::StopPoints;
use super::table::Table;
use super::wave::{Pupil, PupilBars, WaveFigures, Waves};
use crate::trace::SystemGradient;

/// Wavelengths with a smaller share of every channel are left out.
const NEGLIGIBLE: f64 = 1e-6;

/// How kernels are made.
#[derive(Clone, Debug)]
pub struct KernelForm {
    /// Dense points of the stop.
    pub points: StopPoints,
    /// Weight of every wavelength of the table in every channel, `[channel][wavelength]`; each channel sums to one.
    pub weight: Vec<Vec<f64>>,
    /// Size and samples a cell.
    pub raster: Raster,
    /// Side of a cell, mm: the pixel pitch, or a multiple of it for a coarser image.
    pub cell_mm: f64,
    /// Whether light that diffraction bends out of the window is put back evenly over it: a picture keeps its brightness.
    pub keeps_light: bool,
}

/// The light that arrives at one radius, which all kernels of that radius are made of.
#[derive(Clone, Debug)]
pub struct Pencil {
    /// What the rays are made of; nothing where light was measured.
    origin: Option<Meridian>,
    /// Share of each wavelength in each channel's light, `[channel][wavelength]`.
    shares: Vec<Vec<f64>>,
    /// Irradiance of each channel.
    levels: Vec<f64>,
    /// By wavelength; none that no channel sees.
    colours: Vec<Option<Colour>>,
    /// What kernels of rays are convolved with.
    opening: Option<Opening>,
    /// Wavelengths whose pupil polynomials do not follow, and which go by rays.
    unfollowed: usize,
}

/// The open pupil that kernels of rays are convolved with the diffraction of.
#[derive(Clone, Debug)]
struct Opening {
    /// Number of its wavelength.
    l: usize,
    pupil: Box<Pupil>,
    /// Mean wavelength of each channel, mm.
    mean_mm: Vec<f64>,
}

/// One wavelength of a pencil.
#[derive(Clone, Debug)]
struct Colour {
    /// Channels that it feeds, with its share of each.
    fed: Vec<(usize, f64)>,
    light: Light,
}

/// How light goes from the lens to the sensor.
#[derive(Clone, Debug)]
enum Light {
    Rays(Rays),
    Waves(Box<Pupil>),
}

impl Light {
    fn rays(&self) -> Option<&Rays> {
        match self {
            Self::Rays(rays) => Some(rays),
            Self::Waves(_) => None,
        }
    }
}

/// Cotangents of a pencil, added up over its kernels.
#[derive(Clone, Debug)]
pub(crate) struct PencilBar {
    /// By wavelength; empty where the pencil has none.
    rays: Vec<RaysBar>,
    /// By wavelength, of those that go by diffraction.
    pupils: Vec<Option<PupilBars>>,
    /// Of the pupil that kernels of rays are convolved with.
    opening: Option<PupilBars>,
    /// `[channel][wavelength]`.
    shares: Vec<Vec<f64>>,
}

impl PencilBar {
    /// All zero, in the form of `pencil`.
    pub(crate) fn zeros(pencil: &Pencil) -> Self {
        let none =
            |c: &Option<Colour>| RaysBar::zeros(c.as_ref().and_then(|c| c.light.rays()).map_or(0, |rays| rays.x.len()));
        let pupil = |c: &Option<Colour>| match &c.as_ref()?.light {
            Light::Waves(pupil) => Some(PupilBars::zeros(pupil)),
            Light::Rays(_) => None,
        };
        Self {
            rays: pencil.colours.iter().map(none).collect(),
            pupils: pencil.colours.iter().map(pupil).collect(),
            opening: pencil.opening.as_ref().map(|o| PupilBars::zeros(&o.pupil)),
            shares: pencil.shares.iter().map(|s| vec![0.0; s.len()]).collect(),
        }
    }
}

/// Cotangents that leave `KernelForm::pencil_vjp`.
#[derive(Clone, Debug)]
pub struct KernelBar {
    /// Of what the rays are made of.
    pub(super) origin: MeridianBar,
    /// By wavelength: of the irradiance.
    pub(super) irradiance: Vec<f64>,
    /// Of the sensor map's coefficients.
    pub(super) map: Vec<f64>,
    /// By wavelength that goes by diffraction: of the lens met from the sensor.
    pub(super) systems: Vec<(usize, SystemGradient)>,
}

impl KernelForm {
    /// Channels.
    pub fn channels(&self) -> usize {
        self.weight.len()
    }

    /// The dense rays of wavelength `l` at a point.
    pub fn rays(&self, table: &Table, map: &SensorMap, l: usize, point: SensorPoint) -> Rays {
        let radius_mm = table.held(point.radius_mm());
        let row = table.row(l, &table.taps(radius_mm));
        Dense { points: &self.points, table, map, radius_mm }.rays(&row)
    }

    /// Each channel's shares of the wavelengths at a point, and the channel's irradiance.
    pub(super) fn shares(&self, illumination: &Illumination, point: SensorPoint) -> (Vec<Vec<f64>>, Vec<f64>) {
        let light = illumination.at(point);
        let mut levels = Vec::with_capacity(self.channels());
        let shares = self
            .weight
            .iter()
            .map(|w| {
                let parts: Vec<f64> = w.iter().zip(&light).map(|(w, e)| w * e).collect();
                let level: f64 = parts.iter().sum();
                levels.push(level);
                parts.iter().map(|p| if level > 0.0 { p / level } else { 0.0 }).collect()
            })
            .collect();
        (shares, levels)
    }

    /// Channels that wavelength `l` feeds, with its share of each.
    pub(super) fn fed(shares: &[Vec<f64>], l: usize) -> Vec<(usize, f64)> {
        if shares.iter().all(|s| s[l].abs() < NEGLIGIBLE) {
            return Vec::new();
        }
        shares.iter().enumerate().map(|(c, s)| (c, s[l])).filter(|(_, s)| *s != 0.0).collect()
    }

    /// The light that arrives at a point. Beyond the last radius with light that of the last goes on, so that
    /// what is interpolated towards a place in the dark is right up to the edge.
    pub(crate) fn pencil(
        &self,
        table: &Table,
        illumination: &Illumination,
        map: &SensorMap,
        point: SensorPoint,
        waves: Option<&Waves>,
    ) -> Pencil {
        let point = illumination.held(point);
        let (shares, levels) = self.shares(illumination, point);
        let fed: Vec<_> = (0..table.spec.wavelength_nm.len()).map(|l| Self::fed(&shares, l)).collect();
        let light = illumination.at(point);
        let mut unfollowed = 0;
        let by_waves = |l: usize| {
            let waves = waves.filter(|w| w.model == Model::Waves && !fed[l].is_empty())?;
            let pupil = waves.pupil_of(table, map, l, point);
            // Of hundreds of waves rays tell as much.
            if pupil.as_ref().is_some_and(|pupil| !pupil.is_told(self.cell_mm)) {
                return None;
            }
            let pupil = pupil.filter(|pupil| pupil.follows(light[l]));
            unfollowed += usize::from(pupil.is_none());
            pupil
        };
        let mut pupils: Vec<Option<Pupil>> = (0..fed.len()).map(by_waves).collect();
        let origin = Meridian::at(table, point, |l| !fed[l].is_empty() && pupils[l].is_none());
        let rays = origin.rays(&self.points, table, map).into_iter();
        let all = rays.zip(&mut pupils).zip(fed);
        let colours = all
            .map(|((rays, pupil), fed)| {
                let light = pupil.take().map(|p| Light::Waves(Box::new(p))).or(rays.map(Light::Rays))?;
                Some(Colour { fed, light })
            })
            .collect();
        let opening = waves.filter(|w| w.model == Model::Approximate).and_then(|w| {
            let (l, pupil) = w.opening(table, map, point, &light)?;
            let nm = &table.spec.wavelength_nm;
            let mean = |weight: &Vec<f64>| {
                let (sum, all) = weight.iter().zip(nm).fold((0.0, 0.0), |(s, a), (w, nm)| (s + w * nm, a + w));
                if all > 0.0 { sum / all * 1e-6 } else { pupil.wavelength_mm }
            };
            let mean_mm = self.weight.iter().map(mean).collect();
            Some(Opening { l, pupil: Box::new(pupil), mean_mm })
        });
        Pencil { origin: Some(origin), shares, levels, colours, opening, unfollowed }
    }

    /// The light of colours that were measured: this form's weights say which channel sees which. It has no pull-back.
    pub(crate) fn pencil_of(&self, colours: Vec<Rays>) -> Pencil {
        let shares = self.weight.clone();
        let of = |(l, rays): (usize, Rays)| {
            let fed = Self::fed(&shares, l);
            (!fed.is_empty()).then_some(Colour { fed, light: Light::Rays(rays) })
        };
        let colours = colours.into_iter().enumerate().map(of).collect();
        Pencil { origin: None, levels: vec![1.0; shares.len()], shares, colours, opening: None, unfollowed: 0 }
    }

    /// Writes the fine kernels of all channels at the point of `pencil`'s radius along `outward`, `[channel][row][col]` on the
    /// raster; returns the share of each channel's light that falls outside the window.
    pub fn kernels(&self, pencil: &Pencil, outward: [f64; 2], out: &mut [f64]) -> Vec<f64> {
        self.kernels_told(pencil, outward, out).0
    }

    /// As [`Self::kernels`], with what is to be told of those by diffraction.
    pub(super) fn kernels_told(&self, pencil: &Pencil, outward: [f64; 2], out: &mut [f64]) -> (Vec<f64>, WaveFigures) {
        out.fill(0.0);
        let mut outside = vec![0.0; self.channels()];
        let mut figures = WaveFigures::default();
        for Colour { fed, light } in pencil.colours.iter().flatten() {
            let missed = match light {
                Light::Rays(rays) => {
                    figures.geometric += 1;
                    self.raster.splat(out, fed, rays.moves(outward, self.cell_mm))
                }
                Light::Waves(pupil) => {
                    let (missed, spread) = self.bent(pupil, outward, fed, out);
                    figures = figures.or(pupil.figures(spread));
                    missed
                }
            };
            fed.iter().for_each(|(c, s)| outside[*c] += s * missed);
        }
        figures.unfollowed = pencil.unfollowed.min(figures.geometric);
        figures.geometric -= figures.unfollowed;
        if let Some((opening, convolution)) = self.convolution(pencil, outward) {
            let planes = out.chunks_exact_mut(self.raster.len()).zip(&opening.mean_mm);
            for ((plane, mean_mm), outside) in planes.zip(&mut outside) {
                let all = plane.iter().sum::<f64>() + *outside;
                convolution.convolve(plane, *mean_mm);
                *outside = all - plane.iter().sum::<f64>();
                let even = self.put_back(*outside);
                plane.iter_mut().for_each(|v| *v += even);
            }
        }
        (outside, figures)
    }

    /// What kernels of rays are convolved with.
    fn convolution<'a>(&self, pencil: &'a Pencil, outward: [f64; 2]) -> Option<(&'a Opening, Convolution)> {
        let opening = pencil.opening.as_ref()?;
        Some((opening, Convolution::new(&opening.pupil, outward, self.raster, self.cell_mm)?))
    }

    /// Pulls the cotangents `bar` of convolved kernels back to those of the rays' own, and adds what the open pupil gets of them.
    fn convolved_vjp(
        &self,
        pencil: &Pencil,
        (opening, convolution): (&Opening, &Convolution),
        outward: [f64; 2],
        bar: &[f64],
        to: &mut PencilBar,
    ) -> Vec<f64> {
        let len = self.raster.len();
        let mut rays = vec![0.0; self.channels() * len];
        for Colour { fed, light } in pencil.colours.iter().flatten() {
            let moves = light.rays().map(|rays| rays.moves(outward, self.cell_mm));
            moves.into_iter().for_each(|moves| {
                self.raster.splat(&mut rays, fed, moves);
            });
        }
        let (mut pulled, mut open) = (bar.to_vec(), convolution.no_bar());
        let planes = pulled.chunks_exact_mut(len).zip(rays.chunks_exact(len)).zip(&opening.mean_mm);
        for ((bar, rays), mean_mm) in planes {
            // What is put back: of all light, less what the window has.
            let mean = self.put_back(bar.iter().sum());
            bar.iter_mut().for_each(|b| *b -= mean);
            convolution.convolve_vjp(rays, *mean_mm, bar, &mut open);
        }
        if let Some(bars) = &mut to.opening {
            convolution.open_vjp(&opening.pupil, &open, bars);
        }
        pulled
    }

    /// Adds a wavelength's kernel by diffraction to the planes that it feeds; returns the shares of light outside the window and spread evenly.
    fn bent(&self, pupil: &Pupil, outward: [f64; 2], fed: &[(usize, f64)], out: &mut [f64]) -> (f64, f64) {
        let len = self.raster.len();
        let mut plane = vec![0.0; len];
        let spread = pupil.kernel(outward, self.raster, self.cell_mm, &mut plane);
        let missed = 1.0 - plane.iter().sum::<f64>();
        let even = self.put_back(missed);
        for (channel, share) in fed {
            let to = out[channel * len..][..len].iter_mut();
            to.zip(&plane).for_each(|(o, v)| *o += share * (v + even));
        }
        (missed, spread)
    }

    /// What every place of a window gets of light outside it.
    fn put_back(&self, missed: f64) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let len = self.raster.len() as f64;
        if self.keeps_light { missed / len } else { 0.0 }
    }

    /// Adds the pull-back of [`Self::bent`].
    fn bent_vjp(
        &self,
        pupil: &Pupil,
        outward: [f64; 2],
        (l, fed): (usize, &[(usize, f64)]),
        bar: &[f64],
        to: &mut PencilBar,
    ) {
        let len = self.raster.len();
        let Some(bars) = &mut to.pupils[l] else { return };
        let (mut kernel, shares) = (vec![0.0; len], &mut to.shares);
        let of_plane = |kernel: &[f64]| {
            let even = self.put_back(1.0 - kernel.iter().sum::<f64>());
            let mut plane = vec![0.0; len];
            for (channel, share) in fed {
                let bar = &bar[channel * len..][..len];
                plane.iter_mut().zip(bar).for_each(|(p, b)| *p += share * b);
                shares[*channel][l] += kernel.iter().zip(bar).map(|(k, b)| (k + even) * b).sum::<f64>();
            }
            let mean = self.put_back(plane.iter().sum());
            plane.iter_mut().for_each(|p| *p -= mean);
            plane
        };
        pupil.pull_kernel(outward, (self.raster, self.cell_mm), &mut kernel, of_plane, bars);
    }

    /// Adds the pull-back of cotangents on [`Self::kernels`] to that of the pencil.
    pub(crate) fn kernels_vjp(&self, pencil: &Pencil, outward: [f64; 2], bar: &[f64], to: &mut PencilBar) {
        let convolution = self.convolution(pencil, outward);
        let of_rays = convolution.map(|(o, c)| self.convolved_vjp(pencil, (o, &c), outward, bar, to));
        let bar = of_rays.as_deref().unwrap_or(bar);
        for (l, colour) in pencil.colours.iter().enumerate() {
            let Some(Colour { fed, light }) = colour else { continue };
            let rays = match light {
                Light::Rays(rays) => rays,
                Light::Waves(pupil) => {
                    self.bent_vjp(pupil, outward, (l, fed), bar, to);
                    continue;
                }
            };
            let lit: Vec<usize> = rays.lit().collect();
            let form = (outward, self.cell_mm);
            let (out, shares) = (&mut to.rays[l], &mut to.shares);
            self.raster.splat_vjp(bar, fed, rays.moves(outward, self.cell_mm), |k, u_bar, values| {
                let q = rays.moves_vjp(&lit, k, form, u_bar, out);
                for ((channel, scale), value) in fed.iter().zip(values) {
                    out.share[q] += scale * value;
                    shares[*channel][l] += rays.share[q] * value;
                }
            });
        }
    }

    /// Pulls cotangents on [`Self::pencil`] back.
    ///
    /// # Panics
    /// For a pencil of [`Self::pencil_of`].
    pub(crate) fn pencil_vjp(
        &self,
        table: &Table,
        map: &SensorMap,
        (pencil, waves): (&Pencil, Option<&Waves>),
        bar: &PencilBar,
    ) -> KernelBar {
        let mut map_bar = vec![0.0; map.coefficients.len()];
        let of = |l: usize| Some((pencil.colours[l].as_ref()?.light.rays()?, &bar.rays[l]));
        let origin = pencil.origin.as_ref().expect("a traced pencil");
        let origin = origin.rays_vjp(&self.points, table, map, of, &mut map_bar);
        let mut systems = Vec::new();
        for (l, (colour, bars)) in pencil.colours.iter().zip(&bar.pupils).enumerate() {
            let (Some(Colour { light: Light::Waves(pupil), .. }), Some(bars), Some(waves)) = (colour, bars, waves)
            else {
                continue;
            };
            systems.push((l, waves.vjp(map, l, (pupil, bars), &mut map_bar)));
        }
        if let (Some(Opening { l, pupil, .. }), Some(bars), Some(waves)) = (&pencil.opening, &bar.opening, waves) {
            systems.push((*l, waves.vjp(map, *l, (pupil, bars), &mut map_bar)));
        }
        let mut back = KernelBar { origin, irradiance: vec![0.0; pencil.colours.len()], map: map_bar, systems };
        // share = w E / Σ w E.
        for (c, w) in self.weight.iter().enumerate().filter(|(c, _)| pencil.levels[*c] > 0.0) {
            let mean: f64 = pencil.shares[c].iter().zip(&bar.shares[c]).map(|(s, b)| s * b).sum();
            for (to, (w, b)) in back.irradiance.iter_mut().zip(w.iter().zip(&bar.shares[c])) {
                *to += w / pencil.levels[c] * (b - mean);
            }
        }
        back
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::psf::{Optics, OpticsSpec, Quadrature};
    use isoplanat_base::testing::{assert_rel, central_difference};

    /// Of kernels at one radius and three azimuths, against differences in what a pencil is read from beside the table: every
    /// coefficient of the sensor map, every wavelength's irradiance.
    #[test]
    fn pencil_vjp_agrees_with_differences() {
        let lens = builtin::lens("two_element").expect("shipped");
        let weight = vec![vec![0.1, 0.3, 0.6], vec![0.2, 0.7, 0.1], vec![0.8, 0.2, 0.0]];
        let quadrature = Quadrature { nm: vec![470.0, 540.0, 610.0], weight };
        let o = Optics::compute(&lens, &OpticsSpec::even(20.0, vec![1e-3], quadrature)).expect("traces");
        let form = o.form(120, 31, 1, 0.02);
        let point = SensorPoint::along([1.0, 0.0], 13.0);
        let azimuths = [[1.0, 0.0], [0.6, -0.8], [0.0, 1.0]];
        let rng = &mut fastrand::Rng::with_seed(8);
        let bars: Vec<Vec<f64>> =
            azimuths.iter().map(|_| (0..3 * 31 * 31).map(|_| rng.f64() - 0.5).collect()).collect();
        let value = |illumination: &Illumination, map: &SensorMap| {
            let pencil = form.pencil(o.table(), illumination, map, point, None);
            let mut kernel = vec![0.0; 3 * 31 * 31];
            let one = |(outward, bar): (&[f64; 2], &Vec<f64>)| {
                form.kernels(&pencil, *outward, &mut kernel);
                kernel.iter().zip(bar).map(|(a, b)| a * b).sum::<f64>()
            };
            azimuths.iter().zip(&bars).map(one).sum::<f64>()
        };
        let pencil = form.pencil(o.table(), o.illumination(), &o.maps[0], point, None);
        let mut bar = PencilBar::zeros(&pencil);
        azimuths.iter().zip(&bars).for_each(|(outward, b)| form.kernels_vjp(&pencil, *outward, b, &mut bar));
        let back = form.pencil_vjp(o.table(), &o.maps[0], (&pencil, None), &bar);
        let largest = back.map.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        for (i, pulled) in back.map.iter().enumerate() {
            let moved = |h: f64| {
                let mut map = o.maps[0].clone();
                map.coefficients[i] += h;
                value(o.illumination(), &map)
            };
            // Rays that pass from one cell to the next make kinks of the second order: they err as the step.
            assert_rel(*pulled, central_difference(moved, 1e-10), 1e-6, 1e-2 * largest, &format!("coefficient {i}"));
        }
        for (l, pulled) in back.irradiance.iter().enumerate() {
            let moved = |h: f64| {
                let mut light = o.illumination().clone();
                light.irradiance[l].iter_mut().for_each(|e| *e += h);
                value(&light, &o.maps[0])
            };
            assert_rel(*pulled, central_difference(moved, 1e-5), 1e-7, 0.1, &format!("irradiance {l}"));
        }
    }
}
