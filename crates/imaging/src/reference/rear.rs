//! The lens met from the sensor: rear aperture, colours, and the irradiance of white on the axis.
//!
//! One list of surfaces serves all wavelengths; each has its own index ratios. A channel's light is cut into 16384 equal
//! shares and the middle of each rounded to a wavelength of a common grid (0.25 nm), a stand-in for its density that moves no
//! mean by more than 1e-5 of a blur's peak. On the axis of a rotationally symmetric
//! lens `∫ n'² cos⁴θ / Z² dA = π n'² Σ (sin²θ_out − sin²θ_in)` over the intervals of angle that pass, whose ends are
//! bisected; of a lens with tilts, decentres or freeform terms that is the mean over azimuths around the axis, at some of the wavelengths and
//! between them on straight lines (2e-5 where no rim cuts the beam, 4e-3 with an element of the two-element lens 14 mm aside: a test).

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use crate::sensor::spectrum::SpectralDensity;
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::lens::Lens;
use isoplanat_optics::trace::lanes::{Options, Program, TILE, Tile, index_ratios};
use isoplanat_optics::trace::system::TraceSurface;
use isoplanat_optics::trace::{Ray, System};

/// Equal shares of a channel's light.
const SHARES: usize = 16_384;
/// Step of the grid of wavelengths, nm, and the most wavelengths there are.
const STEP_NM: f64 = 0.25;
const MOST: f64 = 8192.0;

/// Azimuths that stand for all of them around the axis of a lens without symmetry, and steps of the grid of wavelengths between two that are looked at.
const AZIMUTHS: u32 = 48;
const STRIDE: usize = 64;

/// One wavelength as a ray meets it.
#[derive(Clone, Copy, Debug)]
pub struct Colour {
    /// Which of the program's wavelengths.
    pub number: u32,
    /// `n'²` of the space before the sensor: radiance grows by it.
    pub index_square: f64,
}

/// A lens seen from its sensor.
#[derive(Clone, Debug)]
pub struct RearView {
    /// The system of the primary wavelength from the sensor; its first surface is the image plane.
    pub system: System,
    /// The surfaces after the sensor at every wavelength, with their apertures.
    pub program: Program,
    /// Distance from the sensor to the plane of the rear aperture's rim, mm.
    pub distance: f64,
    /// Radius of a disk in that plane that every ray crosses that meets the rear surface within its aperture.
    pub disk_radius: f64,
    /// Largest sensor radius this view serves, mm.
    pub radius_mm: f64,
    /// Irradiance of a scene of radiance 1 on the axis, a channel.
    pub axis_irradiance: [f64; 3],
    /// Wavelengths of the grid, nm.
    nm: Vec<f64>,
    index_square: Vec<f64>,
    /// Of every channel: the wavelength of each share.
    shares: [Vec<u16>; 3],
}

impl RearView {
    /// The view of `lens` from sensor points up to `radius_mm` from the axis.
    ///
    /// # Errors
    /// A curved sensor; no room between the rear surface and the sensor, no finite rear aperture, no light on the axis.
    pub fn new(lens: &Lens, density: &SpectralDensity, radius_mm: f64) -> Result<Self> {
        let mut view = Self::without_white(lens, density, radius_mm)?;
        view.axis_irradiance = if lens.is_symmetric() { view.white(1, 1) } else { view.white(AZIMUTHS, STRIDE) };
        if view.axis_irradiance.iter().all(|e| *e > 0.0 && e.is_finite()) {
            return Ok(view);
        }
        let found = "no rays reach the sensor: no ray from its axial point passes the lens";
        Err(Error::bad(lens.file(), "surfaces", found, "a stop and clear apertures that let light through"))
    }

    /// [`Self::new`] without the irradiance of white, which stays 0.
    ///
    /// # Errors
    /// As [`Self::new`], but for light on the axis.
    pub(super) fn without_white(lens: &Lens, density: &SpectralDensity, radius_mm: f64) -> Result<Self> {
        density.require(lens)?;
        lens.require_plane_image()?;
        let system = System::new(lens, lens.wavelengths.primary_nm).reversed();
        let rear = &system.surfaces[1];
        let upright = rear.motion.is_none() && rear.shape.is_symmetric();
        let found = if upright { rim(rear, radius_mm) } else { rim_around(rear, radius_mm) };
        let (distance, disk_radius) = found.ok_or_else(|| {
            let found = "its rear surface reaches the sensor or its clear aperture has no end";
            Error::bad(lens.file(), "surfaces", found, "room before the sensor, a finite clear semi-diameter")
        })?;
        let grid = Grid::of(density);
        let (mut ratios, mut index_square) = (Vec::new(), Vec::new());
        for nm in &grid.nm {
            let colour = System::new(lens, *nm).reversed();
            ratios.extend(index_ratios(&colour.surfaces[1..]));
            index_square.push(colour.surfaces[0].index_after.powi(2));
        }
        let clip = Options { clip: true, ..Options::default() };
        let program = Program::spectral(&system.surfaces[1..], &ratios, clip)?;
        let axis_irradiance = [0.0; 3];
        let Grid { nm, shares } = grid;
        Ok(Self { system, program, distance, disk_radius, radius_mm, axis_irradiance, nm, index_square, shares })
    }

    /// Irradiance of white on the axis, a channel: so many azimuths (1: all are equal), every so-many-th wavelength and the last.
    fn white(&self, azimuths: u32, stride: usize) -> [f64; 3] {
        let outwards: Vec<DVec2> = match azimuths {
            1 => vec![DVec2::Y],
            _ => (0..azimuths).map(|k| DVec2::from_angle(turn(k, azimuths))).collect(),
        };
        let last = self.nm.len() - 1;
        let looked_at: Vec<usize> = (0..last).step_by(stride).chain([last]).collect();
        let known: Vec<f64> = looked_at
            .par_iter()
            .map(|i| outwards.iter().map(|o| self.on_axis(self.at(*i), *o)).sum::<f64>() / outwards.len() as f64)
            .collect();
        let each = |i: usize| match looked_at.binary_search(&i) {
            Ok(k) => known[k],
            Err(k) => {
                let [from, to] = [looked_at[k - 1], looked_at[k]];
                known[k - 1] + (i - from) as f64 / (to - from) as f64 * (known[k] - known[k - 1])
            }
        };
        self.shares.each_ref().map(|s| s.iter().map(|i| each(usize::from(*i))).sum::<f64>() / SHARES as f64)
    }

    /// The wavelength of `channel` that holds the share `u` (`0 ≤ u < 1`) of its light.
    #[inline]
    pub fn colour(&self, channel: usize, u: f64) -> Colour {
        self.at(usize::from(self.shares[channel][((u * SHARES as f64) as usize).min(SHARES - 1)]))
    }

    /// Turns random bits into wavelengths of `channel`, and writes their `n'²`: as [`Self::colour`], one for each entry.
    #[inline]
    pub(super) fn colours(&self, channel: usize, bits: &mut [u32], index_square: &mut [f64]) {
        let shares = &self.shares[channel][..SHARES];
        for (bits, index_square) in bits.iter_mut().zip(index_square) {
            let i = shares[(*bits >> (u32::BITS - SHARES.ilog2())) as usize];
            (*bits, *index_square) = (u32::from(i), self.index_square[usize::from(i)]);
        }
    }

    /// Wavelengths of [`Self::program`], nm.
    pub(crate) fn wavelengths_nm(&self) -> &[f64] {
        &self.nm
    }

    /// Both ends of the spectrum and its middle.
    pub(crate) fn probe_colours(&self) -> [Colour; 3] {
        let last = self.nm.len() - 1;
        [0, last / 2, last].map(|i| self.at(i))
    }

    #[inline]
    pub(super) fn at(&self, i: usize) -> Colour {
        Colour { number: i as u32, index_square: self.index_square[i] }
    }

    /// `n'² cos⁴θ′ / Z²` and the ray from the sensor point `p` through `target` of the rim's plane, for [`Self::program`].
    #[inline]
    pub fn ray(&self, p: DVec2, target: DVec2, colour: Colour) -> (f64, Ray) {
        let z = self.distance;
        let offset = target - p;
        let inverse = (z * z + offset.length_squared()).sqrt().recip();
        let direction = DVec3::new(offset.x, offset.y, z) * inverse;
        let ray = Ray { origin: DVec3::new(target.x, target.y, z), direction };
        // cos θ′ = z / length.
        let share = direction.z * inverse;
        (colour.index_square * share * share, ray)
    }

    /// Whether the ray that `tile` was traced with in `lane` leaves the lens towards the object.
    #[inline]
    pub(crate) fn passed(&self, tile: &Tile, lane: usize) -> bool {
        // A ray that turned back never meets the object.
        tile.status[lane].is_none() && tile.rays.n[lane] > 0.0
    }

    /// Which of the rays from `p` through `targets` leave the lens towards the object.
    pub(crate) fn passes(&self, tile: &mut Tile, p: DVec2, targets: &[DVec2], colour: Colour) -> Vec<bool> {
        let mut passes = Vec::with_capacity(targets.len());
        for targets in targets.chunks(TILE) {
            tile.resize(targets.len());
            for (lane, target) in targets.iter().enumerate() {
                tile.rays.set(lane, self.ray(p, *target, colour).1);
                tile.colour[lane] = colour.number;
            }
            self.program.trace_tile(tile);
            passes.extend((0..targets.len()).map(|lane| self.passed(tile, lane)));
        }
        passes
    }

    /// `∫ n'² cos⁴θ / Z² dA` from the axial point at one wavelength, were all azimuths as the one that goes `outwards`.
    fn on_axis(&self, colour: Colour, outwards: DVec2) -> f64 {
        let mut tile = Tile::new();
        let mut passes = |radii: &[f64]| {
            let targets: Vec<DVec2> = radii.iter().map(|r| *r * outwards).collect();
            self.passes(&mut tile, DVec2::ZERO, &targets, colour)
        };
        let sin_square = |r: f64| r * r / (r * r + self.distance * self.distance);
        // Radii to look at: even steps, and finer ones near the axis for stops that are tiny.
        let mut radii = vec![0.0];
        radii.extend((0..120).map(|k| 10f64.powf(-8.0 + 6.0 * f64::from(k) / 120.0)));
        radii.extend((0..=400).map(|k| 0.01 + 0.99 * f64::from(k) / 400.0));
        radii.iter_mut().for_each(|r| *r *= self.disk_radius);
        let open = passes(&radii);
        let mut sum = 0.0;
        for (ends, open) in radii.windows(2).zip(open.windows(2)).filter(|(_, open)| open[0] != open[1]) {
            let (mut inside, mut outside) = (ends[0], ends[1]);
            // A tile of radii at a time, down to the last digit.
            for _ in 0..9 {
                let step = (outside - inside) / (TILE + 1) as f64;
                let between: Vec<f64> = (1..=TILE).map(|k| inside + k as f64 * step).collect();
                let changed = passes(&between).iter().position(|now| *now != open[0]);
                let k = changed.unwrap_or(TILE);
                outside = between.get(k).copied().unwrap_or(outside);
                inside = if k > 0 { between[k - 1] } else { inside };
            }
            sum += if open[0] { sin_square(inside) } else { -sin_square(outside) };
        }
        if open[open.len() - 1] {
            sum += sin_square(radii[radii.len() - 1]);
        }
        std::f64::consts::PI * colour.index_square * sum
    }
}

/// Wavelengths and which of them each share of a channel has.
struct Grid {
    nm: Vec<f64>,
    shares: [Vec<u16>; 3],
}

impl Grid {
    fn of(density: &SpectralDensity) -> Self {
        let middles = [0, 1, 2].map(|c| -> Vec<f64> {
            (0..SHARES).map(|k| density.sample(c, (k as f64 + 0.5) / SHARES as f64)).collect()
        });
        let all = || middles.iter().flatten().copied();
        let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(0.0, f64::max));
        let step = STEP_NM.max((high - low) / MOST);
        let shares = middles.each_ref().map(|m| m.iter().map(|nm| ((nm - low) / step).round() as u16).collect());
        let count = ((high - low) / step).round() as usize;
        Self { nm: (0..=count).map(|i| low + i as f64 * step).collect(), shares }
    }
}

/// Distance of the rim's plane from the sensor, and the radius in it that holds every line from a sensor point within
/// `radius_mm` to a point of the clear surface: `(ρ, h)` is seen through `ρ f + p (1 − f)`, `f = distance / (Z + h)`.
fn rim(rear: &TraceSurface, radius_mm: f64) -> Option<(f64, f64)> {
    const STEPS: u32 = 512;
    let point = |k: u32| {
        let r = rear.semi_diameter * f64::from(k) / f64::from(STEPS);
        rear.shape.sag(r * r).map(|s| (r, rear.distance + s.h)).filter(|(_, z)| *z > 0.0)
    };
    let distance = point(STEPS)?.1;
    let mut radius = 0.0f64;
    for k in 0..=STEPS {
        let (r, z) = point(k)?;
        let f = distance / z;
        radius = radius.max(r * f + radius_mm * (1.0 - f).abs());
    }
    // What may lie between two steps of a smooth surface.
    radius *= 1.002;
    (radius.is_finite() && radius > 0.0).then_some((distance, radius))
}

/// The azimuth number `k` of so many.
fn turn(k: u32, azimuths: u32) -> f64 {
    std::f64::consts::TAU * (f64::from(k) + 0.5) / f64::from(azimuths)
}

/// [`rim`] of a surface that is tilted, shifted or without symmetry, by points all around it.
fn rim_around(rear: &TraceSurface, radius_mm: f64) -> Option<(f64, f64)> {
    const STEPS: u32 = 64;
    let point = |k: u32, azimuth: u32| {
        let at = rear.semi_diameter * f64::from(k) / f64::from(STEPS) * DVec2::from_angle(turn(azimuth, AZIMUTHS));
        let mut p = at.extend(rear.shape.at(at.x, at.y)?.h);
        if let Some(m) = &rear.motion {
            p = m.rotation * p + m.shift;
        }
        p.z += rear.distance;
        (p.z > 0.0).then_some(p)
    };
    let ends = (0..AZIMUTHS).map(|a| Some(point(STEPS, a)?.z)).collect::<Option<Vec<f64>>>()?;
    let distance = ends.iter().sum::<f64>() / f64::from(AZIMUTHS);
    let mut radius = 0.0f64;
    for k in 0..=STEPS {
        for azimuth in 0..AZIMUTHS {
            let p = point(k, azimuth)?;
            let f = distance / p.z;
            radius = radius.max(p.truncate().length() * f + radius_mm * (1.0 - f).abs());
        }
    }
    // What may lie between two points of a smooth surface.
    radius *= 1.01;
    (radius.is_finite() && radius > 0.0).then_some((distance, radius))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::Sensor;
    use isoplanat_base::testing::assert_abs;

    /// White of a lens whose second element stands so far aside that its rims cut the axial beam: against ten times the azimuths and every wavelength.
    #[test]
    fn white_of_a_lens_without_symmetry_is_known_well() {
        use isoplanat_optics::lens::pose::{Element, Pose};
        let density = SpectralDensity::new(&Sensor::generic());
        for (name, first, last, cut, limit) in [
            ("two_element", 3, 4, 14.0, 4e-3),
            ("two_element", 0, 1, 3.0, 2e-4),
            ("cooke_triplet", 2, 3, 1.0, 2e-4),
            ("cooke_triplet", 4, 5, 0.05, 2e-5),
        ] {
            let lens = isoplanat_optics::lens::builtin::lens(name).and_then(|l| {
                let pose = Pose { decentre: [0.6 * cut, -0.8 * cut], tilt: [0.01, 0.0, 0.0] };
                l.changed(|l| l.elements.push(Element { first, last, pose, pivot: 0.0 }))
            });
            let view = RearView::new(&lens.expect("a lens"), &density, 5.0).expect("a view");
            let known = view.white(10 * AZIMUTHS, STRIDE / 8);
            for (a, b) in view.axis_irradiance.iter().zip(known) {
                eprintln!("{name}, {cut} mm aside: white off by {:e}", a / b - 1.0);
                assert_abs(a / b, 1.0, limit, &format!("{name}, {cut} mm aside"));
            }
        }
    }

    /// Means of Gaussian blurs whose width drifts with wavelength, against a fine midpoint rule on the response table.
    #[test]
    fn shares_stand_for_the_density() {
        let sensor = Sensor::generic();
        let grid = Grid::of(&SpectralDensity::new(&sensor));
        assert!(grid.nm.len() < 1210 && grid.nm.windows(2).all(|w| w[0] < w[1]));
        let table = &sensor.spectral_response;
        for (best, drift) in [(480.0, 0.005), (550.0, 0.02), (620.0, 0.01)] {
            let blur = |nm: f64| (1.0 + ((nm - best) * drift).powi(2)).recip();
            for (c, p) in table.channels().into_iter().enumerate() {
                let (mut sum, mut mass) = (0.0, 0.0);
                for i in 0..60_000 {
                    let nm = 400.0 + (f64::from(i) + 0.5) * 0.005;
                    let j = (((nm - 400.0) / 10.0) as usize).min(table.wavelength_nm.len() - 2);
                    let v = p[j] + (p[j + 1] - p[j]) * (nm - table.wavelength_nm[j]) / 10.0;
                    (sum, mass) = (sum + v * blur(nm), mass + v);
                }
                let mean = grid.shares[c].iter().map(|i| blur(grid.nm[usize::from(*i)])).sum::<f64>() / SHARES as f64;
                assert_abs(mean, sum / mass, 1e-5, "mean of a blur");
            }
        }
    }
}
