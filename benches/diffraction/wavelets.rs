//! The slow oracle of kernels by diffraction: wavelets of rays that are traced one by one from a sensor point through the stop, summed at each object point. No polynomials, no
//! raster of the pupil, no transform; lens, trace and the sensor map are what it shares with the library.

use std::f64::consts::{PI, TAU};

use glam::{DMat2, DVec2};
use isoplanat::lens::Lens;
use isoplanat::lens::paraxial::first_order;
use isoplanat::psf::{SensorMap, SensorPoint};
use isoplanat::trace::System;
use isoplanat::trace::aim::SensorView;
use rayon::prelude::*;
use rustfft::num_complex::Complex;

/// A wavelet that leaves the plane of the paraxial entrance pupil: where, with what path behind it, and its amplitude times its share of the pupil.
struct Wavelet {
    entrance: DVec2,
    path: f64,
    amplitude: f64,
}

/// Wavelets of one sensor radius and wavelength.
pub(crate) struct Wavelets {
    all: Vec<Wavelet>,
    radius_mm: f64,
    wavelength_mm: f64,
    /// How far behind the first vertex they start, mm.
    behind: f64,
    /// Their light.
    pub(crate) light: f64,
}

/// The object's slope that the sensor coordinates `y` show.
fn slope(map: &SensorMap, y: DVec2) -> DVec2 {
    DVec2::from_array(map.slopes(y.to_array(), 1.0))
}

/// Path from a crossing of the plane `behind` the first vertex to the object of slope `u`, less what all have.
fn to_object(map: &SensorMap, behind: f64, e: DVec2, u: DVec2) -> f64 {
    if map.vergence == 0.0 {
        return e.dot(u) / (1.0 + u.length_squared()).sqrt();
    }
    let object = (-u / map.vergence).extend(-1.0 / map.vergence);
    (e.extend(behind) - object).length() - (DVec2::ZERO.extend(behind) - object).length()
}

impl Wavelets {
    /// Of `count²` rays through equal areas of the stop; those that an aperture stops have none.
    pub(crate) fn trace(lens: &Lens, map: &SensorMap, radius_mm: f64, nm: f64, count: u32) -> Self {
        let view = SensorView::new(&System::new(lens, nm));
        let (at, stop) = (DVec2::new(0.0, radius_mm), view.system.stop_semi_diameter);
        let behind = first_order(lens, lens.wavelengths.primary_nm).entrance_pupil_position;
        // Where a ray through `s` crosses, with what path and cosines, and whether it is clear.
        let ray =
            |s: DVec2| {
                let mut hits = Vec::new();
                let cosines = view.aim(at, s * stop, None, &mut hits).ok()?;
                let ray = view.follow(at, cosines, &mut hits).ok()?;
                let clear =
                    hits.iter().zip(&view.system.surfaces).enumerate().skip(1).all(|(k, (h, of))| {
                        k == view.system.stop || h.at.point.truncate().length() <= of.semi_diameter
                    });
                let last = hits.last()?;
                let drawn = behind * (1.0 + ray.slope.length_squared()).sqrt();
                let path = last.optical_path - last.at.point.z / last.direction.z - drawn;
                Some((ray.entrance + behind * ray.slope, path, cosines, clear))
            };
        let tau = |e: DVec2| {
            let step = 1e-4;
            let to = |d: DVec2| to_object(map, behind, e, slope(map, at + step * d));
            let by = |d: DVec2| (to(d) - to(-d)) / (2.0 * step);
            DVec2::new(by(DVec2::X), by(DVec2::Y))
        };
        let area = PI / f64::from(count * count);
        let one = |q: u32| {
            // Rings of equal area, as many points in each.
            let (i, j) = (q / count, q % count);
            let rho = ((f64::from(i) + 0.5) / f64::from(count)).sqrt();
            let s = rho * DVec2::from_angle(TAU * (f64::from(j) + 0.5 * f64::from(i % 2)) / f64::from(count));
            let (entrance, path, _, true) = ray(s)? else { return None };
            let step = 1e-4;
            let [a, b, c, d] = [DVec2::X, -DVec2::X, DVec2::Y, -DVec2::Y].map(|d| ray(s + step * d));
            let (a, b, c, d) = (a?, b?, c?, d?);
            let spread =
                |by_x: DVec2, by_y: DVec2| DMat2::from_cols(by_x, by_y).determinant().abs() / (4.0 * step * step);
            let light = spread(a.2 - b.2, c.2 - d.2);
            let of_tau = spread(tau(a.0) - tau(b.0), tau(c.0) - tau(d.0));
            Some((Wavelet { entrance, path, amplitude: (light * of_tau).sqrt() * area }, light * area))
        };
        let traced: Vec<(Wavelet, f64)> = (0..count * count).into_par_iter().filter_map(one).collect();
        let light = traced.iter().map(|t| t.1).sum();
        Self { all: traced.into_iter().map(|t| t.0).collect(), radius_mm, wavelength_mm: nm * 1e-6, behind, light }
    }

    /// Share of the sensor point's light that moved by `d` (mm; `y` along the meridian) to it, 1/mm².
    pub(crate) fn density(&self, map: &SensorMap, d: DVec2) -> f64 {
        let wave = TAU / self.wavelength_mm;
        let u = slope(map, DVec2::new(0.0, self.radius_mm) - d);
        let first = self.all.first().map_or(0.0, |w| w.path);
        let sum: Complex<f64> = self
            .all
            .iter()
            .map(|w| {
                Complex::from_polar(w.amplitude, wave * (w.path - first + to_object(map, self.behind, w.entrance, u)))
            })
            .sum();
        // ∫|U|² = λ² ∫ a² dτ, which is the light.
        sum.norm_sqr() / (self.wavelength_mm.powi(2) * self.light)
    }

    /// Adds the kernel at `point` to `out`, laid as the library's kernels are: pixel box and scene tent by a sum over points.
    pub(crate) fn add_kernel(&self, map: &SensorMap, point: SensorPoint, grid: Grid, out: &mut [f64]) {
        let Grid { side, samples, fine_mm, parts } = grid;
        // Points on which densities are known: about the middle of the kernel's entries, box and tent reach beyond them.
        let reach = parts * (samples + 2);
        let n = side * parts + 2 * reach;
        let step = fine_mm / parts as f64;
        // As the library lays a raster: entry `f` stands for a move of `f − origin − ½ + ½ m` samples.
        let origin = (samples * (side / samples / 2) + samples - 1) as f64;
        let place = |f: f64| (f - origin - 0.5 + 0.5 * samples as f64) * fine_mm;
        let first = |k: usize| place(0.0) + (k as f64 - reach as f64) * step;
        let [c, r] = point.outward();
        let densities: Vec<f64> = (0..n * n)
            .into_par_iter()
            .map(|q| {
                let d = DVec2::new(first(q % n), first(q / n));
                // Along columns and rows to across and along the meridian; across it either sign is the same.
                self.density(map, DVec2::new(d.y * c - d.x * r, d.x * c + d.y * r)) * step * step
            })
            .collect();
        let weight = pixel_on_tent(samples, parts);
        let half = weight.len() / 2;
        let blurred = |line: &dyn Fn(usize) -> f64, f: usize| -> f64 {
            let at = f * parts + reach;
            weight.iter().enumerate().map(|(k, w)| w * line(at + k - half)).sum()
        };
        let across: Vec<f64> = (0..n * side).map(|q| blurred(&|k| densities[(q / side) * n + k], q % side)).collect();
        for (q, to) in out.iter_mut().enumerate() {
            *to += blurred(&|k| across[k * side + q % side], q / side);
        }
    }
}

/// A kernel's raster.
#[derive(Clone, Copy)]
pub(crate) struct Grid {
    /// Samples of the scene along a side.
    pub(crate) side: usize,
    /// Samples a pixel along each axis, and the side of one, mm.
    pub(crate) samples: usize,
    pub(crate) fine_mm: f64,
    /// Points a sample along each axis that box and tent are summed over.
    pub(crate) parts: usize,
}

/// What a pixel gets of a scene sample at steps of `1/parts` samples: the pixel's box on the sample's tent; over the samples it sums to one.
fn pixel_on_tent(samples: usize, parts: usize) -> Vec<f64> {
    let integral = |v: f64| {
        let v = v.clamp(-1.0, 1.0);
        if v < 0.0 { 0.5 * (1.0 + v).powi(2) } else { 1.0 - 0.5 * (1.0 - v).powi(2) }
    };
    let m = samples as f64;
    let half = (samples * parts).div_ceil(2) + parts;
    (0..=2 * half)
        .map(|k| {
            let x = (k as f64 - half as f64) / parts as f64;
            (integral(x + 0.5 * m) - integral(x - 0.5 * m)) / m
        })
        .collect()
}
