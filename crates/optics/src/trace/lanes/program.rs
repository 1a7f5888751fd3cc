//! A list of surfaces made ready for lanes: the constants of every surface, and the code that runs it.

use super::bends::Bends;
use crate::lens::Shape;
use crate::trace::System;
use crate::trace::system::TraceSurface;
use isoplanat_base::error::{Error, Result};
use isoplanat_base::math::simd::Level;

/// Most even terms of a surface that goes through lanes: `a₂` to `a₂₀`.
pub(super) const TERMS: usize = 10;

/// How to trace.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// Stop rays at clear apertures, hard. A surface's aperture comes before its refraction.
    pub clip: bool,
    /// Keep the optical path; not available with several wavelengths.
    pub path: bool,
    /// Which instruction set at most; `None`: the best this processor has.
    pub level: Option<Level>,
}

/// `n/n'` of every surface of `surfaces`, exactly 1 where the media are equal; see [`Program::spectral`].
pub fn index_ratios(surfaces: &[TraceSurface]) -> Vec<f64> {
    surfaces.iter().map(|s| s.index_before / s.index_after).collect()
}

/// What a surface is to the lanes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Plane,
    Sphere,
    Conic,
    /// A conic with even terms.
    Even,
    /// Everything else: ray by ray, or [in its own frame](Step::own).
    General,
}

impl Kind {
    fn of(surface: &TraceSurface) -> Self {
        let shape = &surface.shape;
        match (shape.is_even(TERMS) && surface.motion.is_none(), surface.aspheric) {
            (false, _) => Self::General,
            (true, true) => Self::Even,
            (true, false) if shape.curvature == 0.0 => Self::Plane,
            (true, false) if shape.conic == 0.0 => Self::Sphere,
            (true, false) => Self::Conic,
        }
    }
}

/// One surface with its constants, in the form the kernels use.
#[derive(Clone, Debug)]
pub(super) struct Step {
    pub(super) surface: TraceSurface,
    /// Its number in a failure.
    pub(super) index: usize,
    pub(super) kind: Kind,
    /// A surface that is tilted or decentred and would go through lanes if it were not: the same in its own frame.
    pub(super) own: Option<Box<Step>>,
    /// `c`, `c/2`.
    pub(super) c: f64,
    pub(super) half_c: f64,
    /// `v = (1+κ) c`, `v/2`, `v − c`.
    pub(super) v: f64,
    pub(super) half_v: f64,
    pub(super) excess: f64,
    /// `n/n'`, exactly 1 where the media are equal; `μ²`, `1 − μ²`, `μ² − 1`.
    pub(super) mu: f64,
    pub(super) mu_sq: f64,
    pub(super) under: f64,
    pub(super) over: f64,
    /// Whether any wavelength is refracted.
    pub(super) refracts: bool,
    /// Of every wavelength of a spectral program: `n/n'`.
    pub(super) ratios: Vec<f64>,
    /// Clear semi-diameter squared, mm²; infinite where rays are not clipped.
    pub(super) clip_sq: f64,
    /// Number of even terms.
    pub(super) count: usize,
    /// Even terms, padded with zeros: `a_i`, `2(i+1) a_i`, `2(i+1) i a_i`: of `P`, of `2P′`, of `2P″`.
    pub(super) terms: [f64; TERMS],
    pub(super) terms1: [f64; TERMS],
    pub(super) terms2: [f64; TERMS],
    /// `u`, `s`, `s − u` of the conic `z = uρ/2 + sz²/2` that the search starts from.
    pub(super) start: [f64; 3],
    /// Where the first root is certain: `r²` and `|d_xy|²/d_z²` up to these.
    pub(super) domain_sq: f64,
    pub(super) steepest_sq: f64,
    /// The clear semi-diameter squared again, but a number.
    pub(super) limit_sq: f64,
    /// Whether the ray's origin must lie within that radius as well.
    pub(super) from_within: bool,
    /// A Newton step of this length, mm, leaves only rounding after it.
    pub(super) small: f64,
    /// Of surfaces with terms: what proves roots that slopes do not.
    pub(super) bends: Option<Box<Bends>>,
}

/// A list of surfaces, ready to be traced by lanes.
#[derive(Clone, Debug)]
pub struct Program {
    pub(super) steps: Vec<Step>,
    pub(super) level: Level,
    /// Number of wavelengths; 0 for the one of the surfaces.
    pub(super) colours: u32,
    /// Whether optical paths are kept.
    pub(super) path: bool,
}

impl Program {
    /// All surfaces of `system`, image plane included.
    pub fn new(system: &System, options: Options) -> Self {
        Self::of(&system.surfaces, options)
    }

    /// A list of surfaces; the first one's `distance` counts from the frame of the launched rays.
    pub fn of(surfaces: &[TraceSurface], options: Options) -> Self {
        Self::build(surfaces, options, |_| Vec::new())
    }

    /// The same for rays of several wavelengths: `ratios` holds `n/n'` of every surface, wavelength after wavelength.
    ///
    /// # Errors
    /// `ratios` is empty or not whole wavelengths; optical paths asked for.
    pub fn spectral(surfaces: &[TraceSurface], ratios: &[f64], options: Options) -> Result<Self> {
        let count = surfaces.len();
        let colours = ratios.len() / count.max(1);
        if colours == 0 || colours * count != ratios.len() || i32::try_from(colours).is_err() || options.path {
            let found = format!("{} ratios for {count} surfaces, paths {}", ratios.len(), options.path);
            return Err(Error::bad("", "spectral trace", found, "whole wavelengths, at least one, and no paths"));
        }
        let of_surface = |i: usize| ratios.iter().skip(i).step_by(count).copied().collect();
        Ok(Self { colours: colours as u32, ..Self::build(surfaces, options, of_surface) })
    }

    fn build(surfaces: &[TraceSurface], options: Options, ratios: impl Fn(usize) -> Vec<f64>) -> Self {
        let steps = surfaces.iter().enumerate().map(|(i, s)| Step::new(s, i, Kind::of(s), ratios(i), options.clip));
        Self { steps: steps.collect(), level: Level::at_most(options.level), colours: 0, path: options.path }
    }

    /// The instruction set that runs.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Surfaces that every ray meets through lanes, with the record that derivatives need; the others are met ray by ray.
    pub(crate) fn in_lanes(&self) -> usize {
        self.steps.iter().filter(|s| s.kind != Kind::General).count()
    }

    /// Tilted and decentred surfaces that go through lanes in their own frame where no record is asked for.
    pub fn in_own_frames(&self) -> usize {
        self.steps.iter().filter(|s| s.own.is_some()).count()
    }
}

impl Step {
    fn new(surface: &TraceSurface, index: usize, kind: Kind, ratios: Vec<f64>, clip: bool) -> Self {
        let shape = &surface.shape;
        let equal = surface.index_before == surface.index_after;
        let mu = if equal { 1.0 } else { surface.index_before / surface.index_after };
        let refracts = if ratios.is_empty() { mu != 1.0 } else { ratios.iter().any(|mu| *mu != 1.0) };
        let (mut terms, mut terms1, mut terms2) = ([0.0; TERMS], [0.0; TERMS], [0.0; TERMS]);
        for (i, a) in shape.asphere.iter().take(TERMS).enumerate() {
            let i1 = (i + 1) as f64;
            (terms[i], terms1[i], terms2[i]) = (*a, 2.0 * i1 * a, 2.0 * i1 * i as f64 * a);
        }
        let (radius, steepest, within) = certificate(surface, kind);
        let clip_sq = if clip { surface.semi_diameter * surface.semi_diameter } else { f64::INFINITY };
        // An aperture that is no number stays none, and lets nothing through.
        let limit_sq = if clip_sq > f64::MAX { f64::MAX } else { clip_sq };
        let v = (1.0 + shape.conic) * shape.curvature;
        let [u, s] = start_conic(shape, surface.semi_diameter.min(surface.domain));
        let own = surface.motion.map(|_| TraceSurface { motion: None, distance: 0.0, ..surface.clone() });
        let own = own.filter(|own| Kind::of(own) != Kind::General);
        let own = own.map(|own| Box::new(Self::new(&own, index, Kind::of(&own), ratios.clone(), clip)));
        Self {
            surface: surface.clone(),
            index,
            kind,
            own,
            c: shape.curvature,
            half_c: 0.5 * shape.curvature,
            v,
            half_v: 0.5 * v,
            excess: v - shape.curvature,
            mu,
            mu_sq: mu * mu,
            under: 1.0 - mu * mu,
            over: mu * mu - 1.0,
            refracts,
            ratios,
            clip_sq,
            count: shape.asphere.len(),
            terms,
            terms1,
            terms2,
            start: [u, s, s - u],
            domain_sq: radius * radius,
            limit_sq,
            steepest_sq: steepest * steepest,
            from_within: within,
            small: SMALL * surface.domain,
            bends: if kind == Kind::Even { Bends::new(shape, surface.domain).map(Box::new) } else { None },
        }
    }
}

/// Radius, largest slope up to it, and whether the origin must lie within it too, so that a root is certainly the first.
///
/// A root is the only one in a cylinder in which the slope stays below the ray's own. Where the surface's whole domain is
/// too steep at its rim for that, the clear aperture serves: between an origin and a root that both lie in a cylinder the
/// ray does not leave it, so the root is the first one on its way. Lanes that this does not settle are looked at ray by
/// ray (`prove.rs`).
fn certificate(surface: &TraceSurface, kind: Kind) -> (f64, f64, bool) {
    const STEEP: f64 = 1.0;
    if kind != Kind::Even {
        return (f64::INFINITY, 0.0, false);
    }
    if surface.steepest <= STEEP || surface.semi_diameter >= surface.domain {
        return (surface.domain, surface.steepest, false);
    }
    let radius = 0.75 * surface.semi_diameter + 0.25 * surface.domain;
    (radius, surface.shape.steepest(radius), true)
}

/// Newton's error after a step `δ` is about `δ²` over the surface's own lengths; this square is below rounding.
const SMALL: f64 = 3e-8;

/// `[u, s]` of the conic `z = uρ/2 + sz²/2` that lies nearest the surface over `r ≤ radius`: least squares of the
/// equation itself, which is linear in them.
fn start_conic(shape: &Shape, radius: f64) -> [f64; 2] {
    const SAMPLES: u32 = 32;
    let vertex = shape.vertex_curvature();
    let (mut aa, mut ab, mut bb, mut az, mut bz) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for i in 0..SAMPLES {
        let rho = radius * radius * (f64::from(i) + 0.5) / f64::from(SAMPLES);
        let Some(sag) = shape.sag(rho) else { continue };
        let (a, b, z) = (0.5 * rho, 0.5 * sag.h * sag.h, sag.h);
        (aa, ab, bb, az, bz) = (aa + a * a, ab + a * b, bb + b * b, az + a * z, bz + b * z);
    }
    let det = aa * bb - ab * ab;
    let fit = [(az * bb - bz * ab) / det, (bz * aa - az * ab) / det];
    if det > 1e-12 * aa * bb && fit.iter().all(|f| f.is_finite()) { fit } else { [vertex, 0.0] }
}
