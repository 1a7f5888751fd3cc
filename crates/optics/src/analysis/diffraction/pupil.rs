//! The pupil of one object point and wavelength: rays that cover its open part.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DVec2, DVec3};

use super::fault::Fault;
use super::fit::{Fitter, Surface, chebyshev, value};
use crate::analysis::wavefront::rays::{Source, StopRay};
use crate::psf::hull::Hull;
use crate::trace::ObjectPoint;
use crate::trace::aim::Aimer;
use crate::trace::pupil::FieldPupil;
use crate::trace::system::axial_cosine;

/// Degrees of the fits; the next one is taken where one leaves more than [`RESIDUAL`].
const DEGREES: [usize; 3] = [12, 18, 26];
/// Root mean square residual of a path that asks for a higher degree, wavelengths.
const RESIDUAL: f64 = 1e-4;
/// Rays are kept this far beyond a clear aperture, `r²/a² − 1`, so that its edge lies inside the fit.
const MARGIN: f64 = 0.06;
/// An aperture counts where a ray comes this near to it, and rays beyond it may fail.
const NEAR: f64 = 0.02;
/// Part of the outline within which every ray must arrive.
const INNER: f64 = 0.95;
/// Room around the rays, in parts of their extent: the chords between those on the rim are 0.4 % of it within.
const ROOM: f64 = 0.015;
/// Azimuths of the outline, and steps of its bisection.
const OUTLINE: (u32, u32) = (48, 9);
/// Residuals that end a fit at a lower degree: wavelengths; relative; of `1 − r²/a²`.
const ENOUGH: [f64; 3] = [1e-6, 1e-6, 1e-8];

/// Rays over the open part of the stop (and a little beyond the clear apertures).
#[derive(Clone, Debug)]
pub struct Pupil {
    /// The rays.
    pub rays: Vec<StopRay>,
    /// Wavelength, nm.
    pub wavelength_nm: f64,
    /// Refractive index of the image space.
    pub index: f64,
    /// Slopes of the image surface where paths are counted from.
    steep: DVec2,
    degree: usize,
}

/// The pupil function as series, one axis along a direction of the image.
///
/// `ξ, η` are the optical direction cosines along and across that direction, from −1 to 1 over the rays' own box.
#[derive(Clone, Debug)]
pub(super) struct Oriented {
    /// Middle of the box and half its sides.
    pub(super) middle: DVec2,
    pub(super) half: DVec2,
    /// Path in wavelengths.
    pub(super) path: Surface,
    /// Square root of the light per area of direction cosines.
    pub(super) amplitude: Surface,
    /// `1 − r²/a²` of the stop and of the apertures that clip.
    pub(super) clips: Vec<Surface>,
    /// Where rays are: beyond it series say nothing.
    pub(super) hull: Hull,
    /// Of the path, wavelengths.
    pub(super) residual: f64,
    /// Index of the image space, wavelength in mm.
    pub(super) index: f64,
    pub(super) wavelength: f64,
    /// Slopes of the image surface along and across.
    steep: DVec2,
    /// The open rays.
    pub(super) landings: Vec<Landing>,
}

/// Where a ray lands, by the shift `z` of the image surface: `at + z slope`; along and across, mm.
#[derive(Clone, Copy, Debug)]
pub(super) struct Landing {
    at: DVec2,
    slope: DVec2,
    /// Derivatives of both by the optical cosine along.
    at_by: DVec2,
    slope_by: DVec2,
}

/// Points of the unit disk for a fit of `degree`: rings that crowd towards the rim, the rim itself among them.
fn rings(degree: usize) -> Vec<(f64, f64)> {
    let degree = u32::try_from(degree).unwrap_or(u32::MAX);
    let count = degree / 2 + 3;
    let mut points = vec![(0.0, 0.0)];
    for j in 1..=count {
        let radius = (FRAC_PI_2 * f64::from(j) / f64::from(count)).sin();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some tens")]
        let around = (6.0 + 2.4 * f64::from(degree) * radius).round() as u32;
        let turn = 0.5 * f64::from(j % 2);
        points.extend((0..around).map(|k| (radius, TAU * (f64::from(k) + turn) / f64::from(around))));
    }
    points
}

/// The least of `1 − r²/a²`.
fn clearance(ray: &StopRay) -> f64 {
    ray.clear.iter().copied().fold(1.0, f64::min)
}

impl Pupil {
    /// Traces `object`; paths count about `centre`, mm in the image surface's frame.
    ///
    /// # Errors
    /// No light, or light that leaves no pupil function (`Fault`).
    pub fn trace(aimer: &Aimer, object: ObjectPoint, centre: DVec3) -> Result<Self, Fault> {
        let source = Source::new(aimer, object, centre)?;
        let mut pupil = Self {
            rays: Vec::new(),
            wavelength_nm: aimer.system().wavelength_nm,
            index: source.index,
            steep: source.steep,
            degree: DEGREES[0],
        };
        let near = |ray: &StopRay| clearance(ray) > -MARGIN;
        let all: Vec<Option<StopRay>> =
            rings(DEGREES[0]).iter().map(|(r, a)| source.ray(*r * DVec2::from_angle(*a)).ok()).collect();
        let outline = if all.iter().all(|ray| ray.as_ref().is_some_and(near)) {
            None
        } else {
            let kept: Vec<StopRay> = all.iter().flatten().filter(|r| r.open()).cloned().collect();
            let middle = middle(&kept, &source)
                .or_else(|| FieldPupil::new(aimer, object, 8).centre.map(|c| c / aimer.system().stop_semi_diameter))
                .ok_or(Fault::Dark)?;
            Some((middle, outline(&source, middle)?))
        };
        let at = |(r, a): (f64, f64)| match &outline {
            None => r * DVec2::from_angle(a),
            Some((middle, rim)) => *middle + r * around(rim, a) * DVec2::from_angle(a),
        };
        for (k, degree) in DEGREES.into_iter().enumerate() {
            pupil.degree = degree;
            pupil.rays = if k == 0 && outline.is_none() {
                all.iter().flatten().cloned().collect()
            } else {
                traced(rings(degree), &at, &source)?
            };
            if !pupil.rays.iter().any(|r| r.open()) {
                return Err(Fault::Dark);
            }
            let signs = pupil.rays.iter().fold([0.0f64; 2], |[a, b], r| [a.min(r.spread), b.max(r.spread)]);
            let smallest = pupil.rays.iter().fold(f64::INFINITY, |a, r| a.min(r.spread.abs()));
            if signs[0] < 0.0 && signs[1] > 0.0 || smallest <= 1e-9 * signs[1].max(-signs[0]) {
                return Err(Fault::Folded);
            }
            if pupil.along(DVec2::Y).residual <= RESIDUAL {
                break;
            }
        }
        Ok(pupil)
    }

    /// The pupil function with its first axis along `direction` of the image plane.
    pub(super) fn along(&self, direction: DVec2) -> Oriented {
        let u = direction.normalize_or(DVec2::Y);
        let turned = |v: DVec2| DVec2::new(u.dot(v), u.perp().dot(v));
        let steep = turned(self.steep);
        let cosines: Vec<DVec2> = self.rays.iter().map(|r| turned(r.cosines)).collect();
        let least = cosines.iter().copied().fold(DVec2::INFINITY, DVec2::min);
        let most = cosines.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max);
        // A little room, so that the box holds chords whose ends are its own.
        let (middle, half) = (0.5 * (least + most), 0.51 * (most - least));
        let points: Vec<DVec2> = cosines.iter().map(|q| (*q - middle) / half).collect();
        let fitter = Fitter::new(&points, self.degree);
        let hull = Hull::around(&points, ROOM);
        let wavelength = self.wavelength_nm * 1e-6;
        let values = |f: &dyn Fn(&StopRay) -> f64| -> Vec<f64> { self.rays.iter().map(f).collect() };
        let (path, residual) = fitter.fit(&values(&|r| r.path / wavelength), ENOUGH[0]);
        let amplitude = values(&|r| (r.flux / r.spread.abs()).sqrt());
        let size = amplitude.iter().copied().fold(0.0, f64::max);
        let (amplitude, _) = fitter.fit(&amplitude, ENOUGH[1] * size);
        let mut clips = vec![fitter.fit(&values(&|r| 1.0 - r.stop.length_squared()), ENOUGH[2]).0];
        for k in 0..self.rays[0].clear.len() {
            if self.rays.iter().any(|r| r.clear[k] < NEAR) {
                clips.push(fitter.fit(&values(&|r| r.clear[k]), ENOUGH[2]).0);
            }
        }
        let landing = |r: &StopRay| {
            let d = turned(r.direction.truncate());
            let n = r.direction.z - d.dot(steep);
            let slope = d / n;
            // ∂(d/n)/∂q of a unit vector, with a steep image nearly: it says how finely to sample.
            let slope_by = (DVec2::X + slope * slope.x) / (n * self.index);
            Landing { at: turned(r.landing.truncate()), slope, at_by: turned(r.stretch * u), slope_by }
        };
        let landings = self.rays.iter().filter(|r| r.open()).map(landing).collect();
        let index = self.index;
        Oriented { middle, half, path, amplitude, clips, hull, residual, index, wavelength, steep, landings }
    }
}

impl Oriented {
    /// `n N` at the optical cosines `q` along the image surface: what a shift of that surface by 1 adds to the path.
    pub(super) fn depth(&self, q: DVec2) -> f64 {
        // Rounding may take the pupil's edge beyond the last ray: a NaN is the smaller of two.
        axial_cosine(q, self.steep, self.index).max(0.0)
    }

    /// Whether a point of the box is open, path in wavelengths, amplitude: the slow way, for comparison.
    pub(super) fn at(&self, point: DVec2) -> Option<(f64, f64)> {
        let (mut eta, mut line) = (Vec::new(), Vec::new());
        let degree = self.clips.iter().chain([&self.path, &self.amplitude]).map(Surface::degree).max().unwrap_or(0);
        chebyshev(point.y, degree, &mut eta);
        let mut of = |surface: &Surface| {
            surface.along(&eta, &mut line);
            value(&line, point.x)
        };
        let open = self.hull.holds(point) && self.clips.iter().all(|c| of(c) > 0.0);
        open.then(|| (of(&self.path), of(&self.amplitude)))
    }

    /// Spread of the landings along and across, mm, and their steepest change by the cosine along, mm, with the image plane `focus`
    /// mm behind its place.
    pub(super) fn blur(&self, focus: f64) -> (DVec2, DVec2) {
        let (mut least, mut most, mut steepest) = (DVec2::INFINITY, DVec2::NEG_INFINITY, DVec2::ZERO);
        for l in &self.landings {
            let at = l.at + focus * l.slope;
            (least, most) = (least.min(at), most.max(at));
            steepest = steepest.max((l.at_by + focus * l.slope_by).abs());
        }
        (most - least, steepest)
    }
}

/// A point of the open part: the middle of the open rays, or else the clearest of them.
fn middle(open: &[StopRay], source: &Source) -> Option<DVec2> {
    #[expect(clippy::cast_precision_loss, reason = "hundreds")]
    let count = open.len() as f64;
    let mean = open.iter().map(|r| r.stop).sum::<DVec2>() / count;
    if mean.is_finite() && source.ray(mean).is_ok_and(|r| r.open()) {
        return Some(mean);
    }
    open.iter().max_by(|a, b| clearance(a).total_cmp(&clearance(b))).map(|r| r.stop)
}

/// The rays of `points` of the unit disk; those on its rim may end between the outline's azimuths.
///
/// # Errors
/// [`Fault::Ray`] where one within fails.
fn traced(points: Vec<(f64, f64)>, at: &dyn Fn((f64, f64)) -> DVec2, source: &Source) -> Result<Vec<StopRay>, Fault> {
    let mut rays = Vec::with_capacity(points.len());
    for point in points {
        match source.ray(at(point)) {
            Ok(ray) => rays.push(ray),
            Err(failure) if point.0 < INNER => return Err(failure.into()),
            Err(_) => {}
        }
    }
    Ok(rays)
}

/// Distances from `middle` to the edge of what is kept, over even azimuths.
///
/// # Errors
/// [`Fault::Ray`] where open rays end not at a clear aperture but by missing a surface or by total reflection: that edge of the pupil
/// is no polynomial of the clear apertures.
fn outline(source: &Source, middle: DVec2) -> Result<Vec<f64>, Fault> {
    let (azimuths, steps) = OUTLINE;
    let distance = |k: u32| {
        let u = DVec2::from_angle(TAU * f64::from(k) / f64::from(azimuths));
        let b = middle.dot(u);
        let rim = (b * b + 1.0 - middle.length_squared()).max(0.0).sqrt() - b;
        let kept = |t: f64| source.ray(middle + t * u).map(|r| clearance(&r)).map(|c| (c > -MARGIN).then_some(c));
        if kept(rim).is_ok_and(|c| c.is_some()) {
            return Ok(rim);
        }
        let (mut low, mut high) = (0.0, rim);
        // How clear the last kept ray is, and why the first one beyond it fails.
        let (mut clear, mut failure) = (1.0, kept(rim).err());
        for _ in 0..steps {
            let t = 0.5 * (low + high);
            match kept(t) {
                Ok(Some(c)) => (low, clear) = (t, c),
                Ok(None) => (high, failure) = (t, None),
                Err(f) => (high, failure) = (t, Some(f)),
            }
        }
        match failure {
            Some(failure) if clear > NEAR => Err(failure.into()),
            _ => Ok(low),
        }
    };
    (0..azimuths).map(distance).collect()
}

/// The outline between its azimuths.
fn around(rim: &[f64], azimuth: f64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "tens")]
    let count = rim.len() as f64;
    let t = (azimuth / TAU).rem_euclid(1.0) * count;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
    let k = (t.floor() as usize).min(rim.len() - 1);
    let part = t - t.floor();
    (1.0 - part) * rim[k] + part * rim[(k + 1) % rim.len()]
}
