//! The lens met from the sensor: rear aperture, colours, and the irradiance of white on the axis.
//!
//! One list of surfaces serves all wavelengths; each has its own index ratios. On the axis of a rotationally symmetric
//! lens `∫ n'² cos⁴θ / Z² dA = π n'² Σ (sin²θ_out − sin²θ_in)` over the intervals of angle that pass, whose ends are
//! bisected.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::imaging::spectrum::SpectralDensity;
use crate::lens::Lens;
use crate::trace::forward::{index_ratios, trace_forward};
use crate::trace::system::TraceSurface;
use crate::trace::{Ray, System};

/// Wavelengths that stand for a channel's density, each the middle of an equal share of its light.
pub const COLOURS: usize = 128;

/// One wavelength as a ray meets it.
#[derive(Clone, Copy, Debug)]
pub struct Colour<'a> {
    /// `n/n'` of every surface, from the sensor.
    pub ratios: &'a [f64],
    /// `n'²` of the space before the sensor: radiance grows by it.
    pub index_square: f64,
}

/// A lens seen from its sensor.
#[derive(Clone, Debug)]
pub struct RearView {
    /// The system of the primary wavelength from the sensor; its first surface is the image plane.
    pub system: System,
    /// Distance from the sensor to the rear vertex, mm.
    pub distance: f64,
    /// Radius of a disk in the rear vertex plane that every ray crosses that meets the rear surface within its aperture.
    pub disk_radius: f64,
    /// Largest sensor radius this view serves, mm.
    pub radius_mm: f64,
    /// Irradiance of a scene of radiance 1 on the axis, a channel.
    pub axis_irradiance: [f64; 3],
    ratios: Vec<f64>,
    index_square: Vec<f64>,
}

impl RearView {
    /// The view of `lens` from sensor points up to `radius_mm` from the axis.
    ///
    /// # Errors
    /// No room between the rear surface and the sensor, no finite rear aperture, no light on the axis.
    pub fn new(lens: &Lens, density: &SpectralDensity, radius_mm: f64) -> Result<Self> {
        let system = System::new(lens, lens.wavelengths.primary_nm).reversed();
        let distance = system.surfaces[1].distance;
        let disk_radius = disk_radius(&system.surfaces[1], distance, radius_mm)
            .ok_or_else(|| Error::bad("", "lens", "its rear aperture reaches the sensor or has no end", "room before the sensor, a finite clear semi-diameter"))?;
        let (mut ratios, mut index_square) = (Vec::new(), Vec::new());
        for channel in 0..3 {
            for k in 0..COLOURS {
                let nm = density.sample(channel, (k as f64 + 0.5) / COLOURS as f64);
                let colour = System::new(lens, nm).reversed();
                ratios.extend(index_ratios(&colour.surfaces[1..]));
                index_square.push(colour.surfaces[0].index_after.powi(2));
            }
        }
        let mut view = Self { system, distance, disk_radius, radius_mm, axis_irradiance: [0.0; 3], ratios, index_square };
        let each: Vec<f64> = (0..3 * COLOURS).into_par_iter().map(|i| view.on_axis(view.at(i))).collect();
        view.axis_irradiance = std::array::from_fn(|c| each[c * COLOURS..][..COLOURS].iter().sum::<f64>() / COLOURS as f64);
        if view.axis_irradiance.iter().all(|e| *e > 0.0 && e.is_finite()) {
            return Ok(view);
        }
        let found = "no rays reach the sensor: no ray from its axial point passes the lens";
        Err(Error::bad("", "lens", found, "a stop and clear apertures that let light through"))
    }

    /// Area of the disk, mm².
    pub fn disk_area(&self) -> f64 {
        std::f64::consts::PI * self.disk_radius * self.disk_radius
    }

    /// The wavelength of `channel` that holds the share `u` (`0 ≤ u < 1`) of its light.
    #[inline]
    pub fn colour(&self, channel: usize, u: f64) -> Colour<'_> {
        self.at(channel * COLOURS + ((u * COLOURS as f64) as usize).min(COLOURS - 1))
    }

    #[inline]
    fn at(&self, i: usize) -> Colour<'_> {
        let count = self.system.surfaces.len() - 1;
        Colour { ratios: &self.ratios[i * count..][..count], index_square: self.index_square[i] }
    }

    /// `n'² cos⁴θ′ / Z²` and the ray towards the object (in the first vertex's frame, `z` towards the object), from the
    /// sensor point `p` through `target` of the rear vertex plane; `None` for a ray that fails or is clipped.
    #[inline]
    pub fn trace(&self, p: DVec2, target: DVec2, colour: Colour<'_>) -> Option<(f64, Ray)> {
        let z = self.distance;
        let offset = target - p;
        let square = z * z + offset.length_squared();
        let length = square.sqrt();
        let direction = DVec3::new(offset.x, offset.y, z) / length;
        let ray = Ray { origin: DVec3::new(target.x, target.y, z), direction };
        let leaving = trace_forward(&self.system.surfaces[1..], colour.ratios, ray)?;
        // A ray that turned back never meets the object.
        (leaving.direction.z > 0.0).then(|| (colour.index_square * z * z / (square * square), leaving))
    }

    /// `∫ n'² cos⁴θ / Z² dA` from the axial point at one wavelength.
    fn on_axis(&self, colour: Colour<'_>) -> f64 {
        let passes = |r: f64| self.trace(DVec2::ZERO, DVec2::new(0.0, r), colour).is_some();
        let sin_square = |r: f64| r * r / (r * r + self.distance * self.distance);
        // Radii to look at: even steps, and finer ones near the axis for stops that are tiny.
        let mut radii: Vec<f64> = (0..120).map(|k| 10f64.powf(-8.0 + 6.0 * f64::from(k) / 120.0)).collect();
        radii.extend((0..=400).map(|k| 0.01 + 0.99 * f64::from(k) / 400.0));
        let (mut sum, mut last, mut open) = (0.0, 0.0, passes(0.0));
        for r in radii.into_iter().map(|r| r * self.disk_radius) {
            let now = passes(r);
            if now != open {
                let (mut inside, mut outside) = (last, r);
                for _ in 0..50 {
                    let middle = 0.5 * (inside + outside);
                    if passes(middle) == open { inside = middle } else { outside = middle }
                }
                sum += if open { sin_square(inside) } else { -sin_square(outside) };
            }
            (last, open) = (r, now);
        }
        if open {
            sum += sin_square(last);
        }
        std::f64::consts::PI * colour.index_square * sum
    }
}

/// Radius in the vertex plane that holds every line from a sensor point within `radius_mm` to a point of the clear
/// surface: the point `(ρ, h)` is seen through `ρ f + p (1 − f)`, `f = Z / (Z + h)`.
fn disk_radius(rear: &TraceSurface, z: f64, radius_mm: f64) -> Option<f64> {
    let sags = (0..=256).map(|k| {
        let r = rear.semi_diameter * f64::from(k) / 256.0;
        rear.shape.sag(r * r).map_or(f64::NAN, |s| s.h)
    });
    let (low, high) = sags.filter(|h| h.is_finite()).fold((0.0, 0.0), |(a, b): (f64, f64), h| (a.min(h), b.max(h)));
    // The sag between two of its samples, generously.
    let pad = 0.01 * (high - low);
    let at = |h: f64| {
        let f = z / (z + h);
        rear.semi_diameter * f + radius_mm * (1.0 - f).abs()
    };
    let radius = at(low - pad).max(at(high + pad));
    (z > 0.0 && z + low - pad > 0.0 && radius.is_finite() && radius > 0.0).then_some(radius)
}
