//! The wavefront of one object point over the real stop: a map in waves, and figures of it.
//!
//! Path differences are those of [`crate::trace::wavefront`], sign included: `W = [chief ray] − [ray]` on the sphere through the
//! exit pupil, about the chief ray's image point at the primary wavelength, so that lateral colour is in the map. Figures are taken
//! about that point and about the best one: the centre of the sphere that leaves the least variance, moved across (tilt) and along
//! the axis (focus), found by Gauss–Newton from the rays' own directions (a shift `δ` changes `W` by `−n (d − d_chief)·δ`) and then
//! computed exactly. The map covers the stop evenly; means weigh its points by the light they bring.

pub mod rays;

use std::f64::consts::TAU;

use glam::{DMat3, DVec2, DVec3};

use super::zernike::{self, Order};
use crate::lens::Lens;
use crate::trace::aim::Aimer;
use crate::trace::wavefront::{Reference, Wavefront};
use crate::trace::{Cause, Failure, ObjectPoint, System};
use rays::{Source, StopRay, chief_landing};

/// Rounds of Gauss–Newton to the best point.
const ROUNDS: u32 = 3;

/// A point of the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Where in the unit stop.
    pub stop: DVec2,
    /// Path difference, wavelengths.
    pub waves: f64,
    /// Light per area of the stop; 1 on average.
    pub flux: f64,
    /// Amplitude per area of the stop on the exit pupil in direction cosines: `√(flux |∂q/∂s|)`; 1 on average.
    pub amplitude: f64,
}

/// Figures about one reference point. The piston is taken out.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Figures {
    /// Largest less least, wavelengths.
    #[serde(rename = "peak_to_valley_waves")]
    pub peak_to_valley: f64,
    /// Root mean square about the mean, by light, wavelengths.
    #[serde(rename = "rms_waves")]
    pub rms: f64,
    /// Strehl ratio at the reference point, `|⟨A e^{2πiW}⟩|²/⟨A⟩²`.
    pub strehl: f64,
    /// Its estimate `e^{−(2π rms)²}` (V. N. Mahajan, J. Opt. Soc. Am. 73, 860, 1983), good from about 0.3 on.
    #[serde(rename = "strehl_marechal")]
    pub marechal: f64,
}

/// A wavefront over the stop.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// Points in a row.
    pub size: usize,
    /// `size × size` cells over the square about the unit stop, row by row from `+y` down, from `−x` on; `None` outside the stop,
    /// where apertures clip and where a ray fails.
    pub points: Vec<Option<Point>>,
    /// Wavelength, nm.
    pub wavelength_nm: f64,
    /// Centre of the reference sphere, mm in the image plane's frame.
    pub centre: DVec3,
    /// Its curvature, 1/mm.
    pub curvature: f64,
    /// Part of the stop's points through which light gets.
    pub open: f64,
    /// Figures about [`Self::centre`].
    pub figures: Figures,
    /// Figures about the best point.
    pub best: Figures,
    /// From the centre to the best point, mm: x, y, focus.
    pub shift: DVec3,
}

/// Curvature of the reference sphere about `centre`.
fn curvature(aimer: &Aimer, object: ObjectPoint, centre: DVec3) -> Result<f64, Failure> {
    Ok(Wavefront::compute(aimer, object, &[], Reference::Point(centre), false)?.curvature)
}

/// From the plane wave to the sphere: `κρ/(1 + √(1 − κ²ρ))`, `ρ` the squared distance of the ray from the centre.
fn beyond(landing: DVec3, direction: DVec3, centre: DVec3, curvature: f64) -> f64 {
    let q = landing - centre;
    let rho = q.length_squared() - q.dot(direction).powi(2);
    curvature * rho / (1.0 + (1.0 - curvature * curvature * rho).max(0.0).sqrt())
}

impl Map {
    /// The map of `object` in light of `wavelength_nm`, `size` points across; at least 2.
    ///
    /// # Errors
    /// The chief ray's failure, or what clips the last ray of a pupil without light.
    pub fn of_lens(lens: &Lens, object: ObjectPoint, wavelength_nm: f64, size: usize) -> Result<Self, Failure> {
        let primary = System::new(lens, lens.wavelengths.primary_nm);
        let centre = chief_landing(&Aimer::new(&primary)?, object)?;
        let system = System::new(lens, wavelength_nm);
        Self::compute(&Aimer::new(&system)?, object, centre, size)
    }

    /// The map about a given point, mm in the image plane's frame.
    ///
    /// # Errors
    /// As [`Self::of_lens`].
    pub fn compute(aimer: &Aimer, object: ObjectPoint, centre: DVec3, size: usize) -> Result<Self, Failure> {
        let size = size.max(2);
        let source = Source::new(aimer, object, centre)?;
        let own = curvature(aimer, object, centre)?;
        let mut lost = Failure { cause: Cause::Vignetted, surface: aimer.system().stop };
        let (mut rays, mut cells, mut inside) = (Vec::new(), vec![None; size * size], 0.0);
        #[expect(clippy::cast_precision_loss, reason = "a raster's size")]
        let at = |k: usize| (2.0 * k as f64 + 1.0) / size as f64 - 1.0;
        for (k, cell) in cells.iter_mut().enumerate() {
            let stop = DVec2::new(at(k % size), -at(k / size));
            if stop.length() > 1.0 {
                continue;
            }
            inside += 1.0;
            match source.ray(stop) {
                Ok(ray) => match ray.clipped {
                    None => {
                        *cell = Some(rays.len());
                        rays.push(ray);
                    }
                    Some(failure) => lost = failure,
                },
                Err(failure) => lost = failure,
            }
        }
        if rays.is_empty() {
            return Err(lost);
        }
        let wavelength = aimer.system().wavelength_nm * 1e-6;
        let waves = |shift: DVec3, curvature: f64| -> Vec<f64> {
            let to = centre + shift;
            let (d, at) = (source.chief_direction(), source.chief_landing());
            let chief = beyond(at, d, to, curvature);
            let of = |r: &StopRay| {
                let sphere = beyond(r.landing, r.direction, to, curvature) - chief;
                -(r.path + source.index * ((r.direction - d).dot(shift) + sphere)) / wavelength
            };
            rays.iter().map(of).collect()
        };
        let scaled = |f: &dyn Fn(&StopRay) -> f64| -> Vec<f64> {
            let all: Vec<f64> = rays.iter().map(f).collect();
            let mean = all.iter().sum::<f64>() / f64::from(u32::try_from(all.len()).unwrap_or(u32::MAX));
            all.iter().map(|v| if mean > 0.0 { v / mean } else { 1.0 }).collect()
        };
        let flux = scaled(&|r| r.flux);
        let amplitude = scaled(&|r| (r.flux * r.spread.abs()).sqrt());
        let about = waves(DVec3::ZERO, own);
        // The best centre.
        let directions: Vec<DVec3> =
            rays.iter().map(|r| source.index / wavelength * (r.direction - source.chief_direction())).collect();
        let (mut shift, mut best) = (DVec3::ZERO, about.clone());
        for _ in 0..ROUNDS {
            let moved = shift + step(&directions, &best, &flux);
            let Ok(curved) = curvature(aimer, object, centre + moved) else { break };
            let values = waves(moved, curved);
            if Figures::of(&values, &flux, &amplitude).rms <= Figures::of(&best, &flux, &amplitude).rms {
                (shift, best) = (moved, values);
            } else {
                break;
            }
        }
        let point = |k: usize| Point { stop: rays[k].stop, waves: about[k], flux: flux[k], amplitude: amplitude[k] };
        Ok(Self {
            size,
            points: cells.into_iter().map(|k| k.map(point)).collect(),
            wavelength_nm: aimer.system().wavelength_nm,
            centre,
            curvature: own,
            open: f64::from(u32::try_from(rays.len()).unwrap_or(u32::MAX)) / inside,
            figures: Figures::of(&about, &flux, &amplitude),
            best: Figures::of(&best, &flux, &amplitude),
            shift,
        })
    }

    /// Zernike coefficients of the map in wavelengths, over the unit stop, by light; over what is left of a vignetted pupil
    /// ([`zernike`]). `None` where too little is left for so many terms.
    pub(crate) fn zernike(&self, order: Order, terms: usize) -> Option<zernike::Fit> {
        let of = |f: fn(&Point) -> f64| -> Vec<f64> { self.points.iter().flatten().map(f).collect() };
        let points: Vec<DVec2> = self.points.iter().flatten().map(|p| p.stop).collect();
        zernike::fit(order, terms, &points, &of(|p| p.waves), &of(|p| p.flux))
    }
}

/// The shift that takes most of the variance out of `waves`, each of whose values falls by `direction · shift`; along axes that the
/// directions do not tell apart, none.
fn step(directions: &[DVec3], waves: &[f64], weights: &[f64]) -> DVec3 {
    let total: f64 = weights.iter().sum();
    let mean = directions.iter().zip(weights).map(|(d, w)| *d * *w).sum::<DVec3>() / total;
    let middle = waves.iter().zip(weights).map(|(v, w)| v * w).sum::<f64>() / total;
    let size = (directions.iter().zip(weights).map(|(d, w)| (*d - mean) * (*d - mean) * *w).sum::<DVec3>() / total)
        .map(|v| if v > 0.0 { v.sqrt() } else { 1.0 });
    let (mut gram, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for ((d, v), w) in directions.iter().zip(waves).zip(weights) {
        let d = (*d - mean) / size;
        gram += *w / total * DMat3::from_cols(d * d.x, d * d.y, d * d.z);
        right += *w / total * (v - middle) * d;
    }
    let matrix = nalgebra::Matrix3::from_column_slice(&gram.to_cols_array());
    let solved = matrix.svd(true, true).solve(&nalgebra::Vector3::from_column_slice(&right.to_array()), 1e-10);
    let shift = solved.map_or(DVec3::ZERO, |s| DVec3::new(s.x, s.y, s.z) / size);
    if shift.is_finite() { shift } else { DVec3::ZERO }
}

impl Figures {
    fn of(waves: &[f64], flux: &[f64], amplitude: &[f64]) -> Self {
        let total: f64 = flux.iter().sum();
        let mean = waves.iter().zip(flux).map(|(v, w)| v * w).sum::<f64>() / total;
        let rms = (waves.iter().zip(flux).map(|(v, w)| w * (v - mean).powi(2)).sum::<f64>() / total).sqrt();
        let [least, most] = waves.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(*v), b.max(*v)]);
        let (mut sum, mut whole) = (DVec2::ZERO, 0.0);
        for (v, a) in waves.iter().zip(amplitude) {
            sum += *a * DVec2::from_angle(TAU * (v - mean));
            whole += a;
        }
        let strehl = sum.length_squared() / (whole * whole);
        Self { peak_to_valley: most - least, rms, strehl, marechal: (-(TAU * rms).powi(2)).exp() }
    }
}

#[cfg(test)]
mod tests;
