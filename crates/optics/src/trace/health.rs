//! Numerical health of a lens: what its rays, roots and derivatives are worth in f64.
//!
//! Rays are aimed at the real stop over field, pupil and the lens's wavelengths and traced unclipped; each figure is
//! the worst over those that no aperture stops. References come from double-double ([`super::precise`]).

mod conditioning;
mod reach;

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::aim::Aimer;
use super::first_root::crossings;
use super::object::ObjectPoint;
use super::precise::{PreciseSystem, reference};
use super::sequential::{Hit, first_vignetted, trace};
use super::{Cause, Failure, Ray, System};
use crate::lens::Lens;
use reach::clear_ray_reaches;

pub use conditioning::VariableHealth;

/// Whether a figure is as it should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Within its limit.
    Pass,
    /// Beyond its limit.
    Fail,
    /// For information; has no limit.
    Info,
}

/// Which side of its limit a figure should be on.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Limit {
    AtMost(f64),
    AtLeast(f64),
    None,
}

/// One figure of the check.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Figure {
    /// Name for machines, with its unit.
    pub key: &'static str,
    /// What it says.
    pub what: &'static str,
    /// The worst value; infinite where nothing comes near (second roots) or nothing could be measured (`fail`).
    pub value: f64,
    /// The limit, where there is one.
    pub limit: Option<f64>,
    /// Whether the limit is an upper one.
    #[serde(skip)]
    pub at_most: bool,
    /// The verdict.
    pub verdict: Verdict,
    /// Where the worst was found.
    pub place: String,
}

/// What one surface contributes, worst over all rays that meet it within its clear aperture.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct SurfaceHealth {
    /// Most evaluations of the sag for one intersection (1 where the root is exact).
    pub evaluations: u32,
    /// Mean evaluations.
    pub mean_evaluations: f64,
    /// Largest distance of a hit from its surface along the ray, mm.
    pub residual_mm: f64,
    /// Distance along the ray to the nearest other crossing within the aperture's cylinder, mm; infinite if none.
    pub second_root_mm: f64,
    /// Least `cos²` of the refracted angle: 0 is total reflection.
    pub cos2_refracted: f64,
    /// Least `1 − αρ`: 0 is the edge of the conic.
    pub conic_edge: f64,
    /// Largest angle of incidence, degrees.
    pub incidence_deg: f64,
}

/// The whole check.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Health {
    /// Verdict by verdict.
    pub figures: Vec<Figure>,
    /// Surface by surface.
    pub surfaces: Vec<SurfaceHealth>,
    /// Variable by variable.
    pub variables: Vec<VariableHealth>,
    /// Rays aimed.
    pub rays: usize,
    /// Rays that ended early, by cause.
    pub failed: BTreeMap<&'static str, usize>,
}

impl Health {
    /// Whether no figure fails.
    pub fn passes(&self) -> bool {
        self.figures.iter().all(|f| f.verdict != Verdict::Fail)
    }
}

/// One surviving ray.
struct Good {
    ray: Ray,
    hits: Vec<Hit>,
    system: usize,
    label: String,
}

/// Points of the unit stop: centre, three rings.
fn pupil_points() -> Vec<DVec2> {
    let mut points = vec![DVec2::ZERO];
    for (radius, turn) in [(0.4, 0.0), (0.75, 0.5), (1.0, 0.0)] {
        for k in 0..8 {
            points.push(radius * DVec2::from_angle(std::f64::consts::TAU * (f64::from(k) + turn) / 8.0));
        }
    }
    points
}

/// Checks `lens` at its own wavelengths that have a weight, over its own field.
pub fn check(lens: &Lens) -> Health {
    let mut wavelengths = vec![lens.wavelengths.primary_nm];
    wavelengths.extend(lens.wavelengths.shares().map(|(nm, _)| nm).filter(|nm| *nm != lens.wavelengths.primary_nm));
    let systems: Vec<System> = wavelengths.iter().map(|nm| System::new(lens, *nm)).collect();
    let bundles = bundles(lens, systems.len());
    let of = |(index, field_deg, azimuth_deg): &(usize, f64, f64)| {
        let mut run = Run::default();
        run.bundle(lens, &systems[*index], *index, *field_deg, *azimuth_deg);
        run
    };
    let runs: Vec<Run> = bundles.par_iter().map(of).collect();
    let mut run = Run::default();
    runs.into_iter().for_each(|other| run.add(other));
    run.finish(lens, &systems)
}

/// Rays that [`check`] aims through `lens`.
#[doc(hidden)]
pub fn rays(lens: &Lens) -> usize {
    let others = lens.wavelengths.shares().filter(|(nm, _)| *nm != lens.wavelengths.primary_nm).count();
    bundles(lens, 1 + others).len() * pupil_points().len()
}

/// Which of so many wavelengths, field and azimuth (degrees) of every bundle of rays.
fn bundles(lens: &Lens, wavelengths: usize) -> Vec<(usize, f64, f64)> {
    // Without rotational symmetry the field is looked at on four sides.
    let azimuths: &[f64] = if lens.is_symmetric() { &[90.0] } else { &[0.0, 90.0, 180.0, 270.0] };
    let mut all = Vec::new();
    for index in 0..wavelengths {
        for fraction in [0.0, 0.35, 0.7, 1.0] {
            let sides = &azimuths[..if fraction == 0.0 { 1 } else { azimuths.len() }];
            all.extend(sides.iter().map(|azimuth| (index, fraction * lens.max_field_deg(), *azimuth)));
        }
    }
    all
}

#[derive(Default)]
struct Run {
    good: Vec<Good>,
    rays: usize,
    failed: BTreeMap<&'static str, usize>,
    /// Points of the stop that no clear ray of their field reaches, off the axis.
    out_of_reach: usize,
    /// The same on the axis, where the stop is what limits the light.
    axis_out_of_reach: Vec<String>,
    chiefs_lost: Vec<String>,
    reflected: Option<String>,
    not_converged: Option<String>,
    aiming: (f64, String),
    iterations: u32,
}

impl Run {
    fn count(&mut self, failure: Failure, label: &str) {
        *self.failed.entry(failure.cause.name()).or_default() += 1;
        let place = format!("surface[{}], {label}", failure.surface);
        match failure.cause {
            Cause::TotalReflection => self.reflected = self.reflected.take().or(Some(place)),
            Cause::NotConverged => self.not_converged = self.not_converged.take().or(Some(place)),
            _ => {}
        }
    }

    /// Adds what a later bundle found.
    fn add(&mut self, other: Self) {
        let Self { good, rays, failed, out_of_reach, axis_out_of_reach, chiefs_lost, .. } = other;
        self.good.extend(good);
        self.rays += rays;
        failed.into_iter().for_each(|(cause, count)| *self.failed.entry(cause).or_default() += count);
        self.out_of_reach += out_of_reach;
        self.axis_out_of_reach.extend(axis_out_of_reach);
        self.chiefs_lost.extend(chiefs_lost);
        self.reflected = self.reflected.take().or(other.reflected);
        self.not_converged = self.not_converged.take().or(other.not_converged);
        if other.aiming.0 >= self.aiming.0 && !other.aiming.1.is_empty() {
            self.aiming = other.aiming;
        }
        self.iterations = self.iterations.max(other.iterations);
    }

    fn bundle(&mut self, lens: &Lens, system: &System, index: usize, field_deg: f64, azimuth_deg: f64) {
        let object = ObjectPoint::in_field(lens, field_deg.to_radians(), azimuth_deg.to_radians());
        let aimer = Aimer::new(system);
        for point in pupil_points() {
            self.rays += 1;
            let label =
                format!("{field_deg:.1}°, stop ({:.2}, {:.2}), {:.1} nm", point.x, point.y, system.wavelength_nm);
            let aimed = match &aimer {
                Ok(a) => a.aim(object, point * system.stop_semi_diameter, None),
                Err(f) => Err(*f),
            };
            let chief = point == DVec2::ZERO;
            let aimed = match aimed {
                Ok(a) => a,
                // No ray was found; it is a failure only where there is one.
                Err(f) if aimer.is_err() || clear_ray_reaches(system, object, point * system.stop_semi_diameter) => {
                    self.count(f, &label);
                    if chief {
                        self.chiefs_lost.push(label);
                    }
                    continue;
                }
                Err(_) => {
                    if field_deg == 0.0 {
                        self.axis_out_of_reach.push(label);
                    } else {
                        self.out_of_reach += 1;
                    }
                    continue;
                }
            };
            if aimed.residual >= self.aiming.0 {
                self.aiming = (aimed.residual, label.clone());
            }
            self.iterations = self.iterations.max(aimed.iterations);
            let mut hits = Vec::new();
            let traced = trace(system, aimed.ray, system.image(), &mut hits);
            match (first_vignetted(system, &hits), traced) {
                (Some(f), _) => self.count(f, &label),
                (None, Err(f)) => {
                    self.count(f, &label);
                    if chief {
                        self.chiefs_lost.push(label);
                    }
                }
                (None, Ok(_)) => self.good.push(Good { ray: aimed.ray, hits, system: index, label }),
            }
        }
    }

    fn finish(self, lens: &Lens, systems: &[System]) -> Health {
        let surfaces: Vec<SurfaceHealth> =
            (0..lens.surfaces.len()).into_par_iter().map(|i| surface_health(i, &self.good, systems)).collect();
        let size = lens.length().max(lens.surfaces[lens.stop].semi_diameter);
        let (rounding, single) = self.precision(systems);
        let conditioning = conditioning::conditioning(lens, &systems[0], &self.good);
        let mut figures = self.of_rays();
        figures.extend(of_surfaces(&surfaces, size));
        figures.extend([
            figure(
                "f64_error",
                "f64 landing against double-double / size of the lens",
                (rounding.0 / size, rounding.1),
                Limit::AtMost(1e-11),
            ),
            figure(
                "f32_error_px",
                "f32 landing against f64, pixels",
                (single.0 / lens.sensor.pitch_mm(), single.1),
                Limit::AtMost(0.1),
            ),
            figure(
                "gradient_error",
                "derivatives against double-double, relative",
                conditioning.gradient,
                Limit::AtMost(1e-8),
            ),
            figure(
                "scale_ratio",
                "largest / smallest effect of a scaled variable",
                (conditioning.scale_ratio, conditioning.scale_place),
                Limit::AtMost(1e8),
            ),
            figure(
                "condition_number",
                "condition number of all variables that act, columns of equal length",
                (conditioning.condition, String::new()),
                Limit::None,
            ),
        ]);
        Health { figures, surfaces, variables: conditioning.variables, rays: self.rays, failed: self.failed }
    }

    /// Which rays arrive, and why others do not.
    fn of_rays(&self) -> Vec<Figure> {
        #[expect(clippy::cast_precision_loss, reason = "counts of rays")]
        let number = |n: usize| n as f64;
        let list = |names: &[String]| names.first().cloned().unwrap_or_default();
        let given = |place: &Option<String>| place.clone().unwrap_or_default();
        let failed = |name: &str| number(self.failed.get(name).copied().unwrap_or(0));
        vec![
            figure("rays_arrived", "rays that arrive", (number(self.good.len()), String::new()), Limit::AtLeast(1.0)),
            figure(
                "chief_rays_lost",
                "chief rays that do not arrive",
                (number(self.chiefs_lost.len()), list(&self.chiefs_lost)),
                Limit::AtMost(0.0),
            ),
            figure("vignetted", "rays beyond a clear aperture", (failed("vignetted"), String::new()), Limit::None),
            figure(
                "out_of_reach",
                "points of the stop that no clear ray of their field reaches",
                (number(self.out_of_reach), String::new()),
                Limit::None,
            ),
            figure(
                "axis_out_of_reach",
                "points of the stop that no clear ray from the axis reaches",
                (number(self.axis_out_of_reach.len()), list(&self.axis_out_of_reach)),
                Limit::AtMost(0.0),
            ),
            figure("missed", "rays that miss a surface", (failed("missed"), String::new()), Limit::None),
            figure(
                "totally_reflected",
                "rays reflected within the clear apertures",
                (failed("total_reflection"), given(&self.reflected)),
                Limit::AtMost(0.0),
            ),
            figure(
                "not_converged",
                "intersections or aiming not converged",
                (failed("not_converged"), given(&self.not_converged)),
                Limit::AtMost(0.0),
            ),
            figure("aiming_residual", "aiming residual / stop radius", self.aiming.clone(), Limit::AtMost(1e-10)),
            figure(
                "aiming_iterations",
                "most aiming iterations",
                (f64::from(self.iterations), String::new()),
                Limit::None,
            ),
        ]
    }

    /// Worst landing error of f64 against double-double, and of f32 against f64, mm.
    fn precision(&self, systems: &[System]) -> ((f64, String), (f64, String)) {
        let single: Vec<PreciseSystem<f32>> = systems.iter().map(PreciseSystem::new).collect();
        let errors = |good: &Good| {
            let landing = good.hits[good.hits.len() - 1].at.point;
            let off = |x: Option<DVec3>| x.map_or(f64::INFINITY, |p| (p - landing).truncate().length());
            let exact = off(reference(&systems[good.system], good.ray, &good.hits).map(|r| r.0));
            let rough = off(single[good.system]
                .trace(good.ray, &good.hits)
                .map(|l| DVec3::new(f64::from(l.x), f64::from(l.y), 0.0)));
            [exact, rough]
        };
        let all: Vec<[f64; 2]> = self.good.par_iter().map(errors).collect();
        let mut worst = [(0.0f64, String::new()), (0.0, String::new())];
        for (good, errors) in self.good.iter().zip(all) {
            for (w, v) in worst.iter_mut().zip(errors) {
                if v >= w.0 {
                    *w = (v, good.label.clone());
                }
            }
        }
        let [a, b] = worst;
        (a, b)
    }
}

/// A figure with its verdict.
fn figure(key: &'static str, what: &'static str, (value, place): (f64, String), limit: Limit) -> Figure {
    let verdict = match limit {
        Limit::AtMost(l) if value <= l => Verdict::Pass,
        Limit::AtLeast(l) if value >= l => Verdict::Pass,
        Limit::None => Verdict::Info,
        _ => Verdict::Fail,
    };
    let (limit, at_most) = match limit {
        Limit::AtMost(l) => (Some(l), true),
        Limit::AtLeast(l) => (Some(l), false),
        Limit::None => (None, true),
    };
    Figure { key, what, value, limit, at_most, verdict, place }
}

/// The worst surface by each figure, in a lens of this size.
fn of_surfaces(surfaces: &[SurfaceHealth], size: f64) -> [Figure; 6] {
    let worst = |value: &dyn Fn(&SurfaceHealth) -> f64, largest: bool| {
        let pick = |best: Option<(usize, f64)>, (i, v): (usize, f64)| match best {
            Some((_, b)) if (largest && b >= v) || (!largest && b <= v) => best,
            _ => Some((i, v)),
        };
        let found = surfaces.iter().map(value).enumerate().fold(None, pick);
        found.map_or((f64::NAN, String::new()), |(i, v)| (v, format!("surface[{i}]")))
    };
    let of_size = |(v, place): (f64, String)| (v / size, place);
    [
        figure(
            "intersection_evaluations",
            "most evaluations of an intersection",
            worst(&|s| f64::from(s.evaluations), true),
            Limit::AtMost(1000.0),
        ),
        figure(
            "intersection_residual",
            "residual of intersections / size of the lens",
            of_size(worst(&|s| s.residual_mm, true)),
            Limit::AtMost(1e-12),
        ),
        figure(
            "second_root",
            "nearest second crossing / size of the lens",
            of_size(worst(&|s| s.second_root_mm, false)),
            Limit::AtLeast(1e-6),
        ),
        figure(
            "cos2_refracted",
            "cos² of refraction: distance to total reflection",
            worst(&|s| s.cos2_refracted, false),
            Limit::AtLeast(1e-6),
        ),
        figure(
            "conic_edge",
            "1 − αρ: distance to the conic's edge",
            worst(&|s| s.conic_edge, false),
            Limit::AtLeast(1e-6),
        ),
        figure("incidence_deg", "largest angle of incidence, degrees", worst(&|s| s.incidence_deg, true), Limit::None),
    ]
}

fn surface_health(i: usize, good: &[Good], systems: &[System]) -> SurfaceHealth {
    let mut health = SurfaceHealth {
        evaluations: 0,
        mean_evaluations: 0.0,
        residual_mm: 0.0,
        second_root_mm: f64::INFINITY,
        cos2_refracted: 1.0,
        conic_edge: 1.0,
        incidence_deg: 0.0,
    };
    for g in good {
        let (surface, hit) = (&systems[g.system].surfaces[i], &g.hits[i]);
        let (point, d) = (hit.at.point, hit.incoming);
        health.evaluations = health.evaluations.max(hit.at.evaluations);
        health.mean_evaluations += f64::from(hit.at.evaluations);
        // Back along the ray and forth again: what rounding leaves of the root.
        let origin = point - hit.at.t * d;
        let again = origin + hit.at.t * d;
        let slope = DVec3::new(hit.at.local.slope[0], hit.at.local.slope[1], -1.0);
        if let Some(local) = surface.shape.at(again.x, again.y) {
            health.residual_mm = health.residual_mm.max(((local.h - again.z) / slope.dot(d)).abs());
        }
        if surface.aspheric {
            for t in crossings(surface, origin, d).unwrap_or_default() {
                let apart = (t - hit.at.t).abs();
                // The root itself is among them.
                if apart > 1e-9 * (1.0 + t.abs()) {
                    health.second_root_mm = health.second_root_mm.min(apart);
                }
            }
        }
        let cosine = -slope.dot(d) / slope.length();
        let mu = surface.index_before / surface.index_after;
        if mu != 1.0 {
            health.cos2_refracted = health.cos2_refracted.min(1.0 - mu * mu * (1.0 - cosine * cosine));
            health.incidence_deg = health.incidence_deg.max(cosine.clamp(-1.0, 1.0).acos().to_degrees());
        }
        let phi = hit.at.local.sag.phi;
        health.conic_edge = health.conic_edge.min(phi * phi);
    }
    #[expect(clippy::cast_precision_loss, reason = "counts of rays")]
    let count = good.len().max(1) as f64;
    health.mean_evaluations /= count;
    health
}
