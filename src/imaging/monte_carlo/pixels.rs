//! One row of pixels: rays are drawn pixel by pixel and traced tile by tile.
//!
//! A pixel's stream of random numbers depends on its place alone, a ray's numbers on that ray alone, and a pixel's rays
//! are summed in the order in which they were drawn: the picture depends neither on threads nor on the region.

use glam::{DVec2, DVec3};
use ndarray::Axis;

use super::bounds::Footprints;
use super::rear::RearView;
use super::sampler::{Sampler, disk_from_square};
use super::{GROUPS, Settings};
use crate::imaging::frame::Frame;
use crate::imaging::noise::mixed;
use crate::imaging::warp::Plane;
use crate::trace::lanes::{TILE, Tile};

/// What a pixel's rays are drawn from.
#[derive(Clone, Copy)]
pub(super) struct Pixels<'a> {
    pub(super) scene: &'a Plane,
    pub(super) frame: &'a Frame,
    pub(super) rear: &'a RearView,
    pub(super) footprints: Option<&'a Footprints>,
    pub(super) settings: Settings,
}

/// What one row counted.
#[derive(Default)]
pub(super) struct Tally {
    pub(super) rays: u64,
    pub(super) passed: u64,
    pub(super) outside: u64,
}

/// One pixel and channel.
#[derive(Clone, Copy)]
pub(super) struct Pixel {
    pub(super) row: isize,
    pub(super) col: isize,
    pub(super) channel: usize,
}

/// A ray that waits for its tile: the sum it adds to, its weight, its channel.
#[derive(Clone, Copy, Default)]
struct Waiting {
    sum: usize,
    weight: f64,
    channel: usize,
}

/// Sums of a pixel: its groups, then the ray outside the ellipse.
const SUMS: usize = GROUPS + 1;

/// The pixels of a row on their way.
pub(super) struct Row<'a> {
    pixels: Pixels<'a>,
    tile: Tile,
    waiting: [Waiting; TILE],
    count: usize,
    /// [`SUMS`] of every pixel, in the order of [`Row::add`].
    sums: Vec<f64>,
    channels: Vec<usize>,
    pub(super) tally: Tally,
}

impl<'a> Row<'a> {
    pub(super) fn new(pixels: Pixels<'a>) -> Self {
        Self {
            pixels,
            tile: Tile::new(),
            waiting: [Waiting::default(); TILE],
            count: 0,
            sums: Vec::new(),
            channels: Vec::new(),
            tally: Tally::default(),
        }
    }

    /// Draws the rays of the next pixel.
    pub(super) fn add(&mut self, pixel: Pixel) {
        let Pixels { rear, footprints, settings, .. } = self.pixels;
        let Pixel { row, col, channel } = pixel;
        let first = self.sums.len();
        self.sums.resize(first + SUMS, 0.0);
        self.channels.push(channel);
        let seed = mixed(mixed(mixed(settings.seed, row as u64), col as u64), channel as u64);
        let mut rng = fastrand::Rng::with_seed(seed);
        for group in 0..GROUPS {
            let mut sampler = Sampler::new(&mut rng);
            for _ in 0..self.group_size() {
                // The pupil gets the first two dimensions: its edge makes most of the noise.
                let u = sampler.draw();
                let (p, (radial, radius)) = self.sensor_point(row, col, [u[2], u[3]]);
                // A point of the ellipse (in the sensor point's meridional frame) or of the whole aperture.
                let q = disk_from_square([u[0], u[1]]);
                let (target, area) = match footprints {
                    Some(footprints) => {
                        let e = footprints.at(radius);
                        let (x, y) = (e.across * q.x, e.centre + e.along * q.y);
                        (y * radial + x * radial.perp(), e.area())
                    }
                    None => (rear.disk_radius * q, rear.disk_area()),
                };
                if area > 0.0 {
                    self.start(p, target, Waiting { sum: first + group, weight: area, channel }, u[4]);
                }
            }
        }
        if let Some(footprints) = footprints {
            // One ray through the part of the rear aperture outside the ellipse.
            let (p, (radial, radius)) = self.sensor_point(row, col, [rng.f64(), rng.f64()]);
            let target = rear.disk_radius * disk_from_square([rng.f64(), rng.f64()]);
            let u = rng.f64();
            if !footprints.at(radius).contains(DVec2::new(target.dot(radial.perp()), target.dot(radial))) {
                self.start(p, target, Waiting { sum: first + GROUPS, weight: rear.disk_area(), channel }, u);
            }
        }
    }

    /// Mean and variance of the mean of every pixel, in the order in which they were added.
    pub(super) fn finish(&mut self) -> impl Iterator<Item = (f64, f64)> {
        self.trace();
        let (size, n) = (self.group_size() as f64, GROUPS as f64);
        let axis = self.pixels.rear.axis_irradiance;
        self.sums.chunks_exact(SUMS).zip(&self.channels).map(move |(sums, channel)| {
            let groups = sums[..GROUPS].iter().map(|sum| sum / size);
            let (sum, squares) = groups.fold((0.0, 0.0), |(sum, squares), g| (sum + g, squares + g * g));
            let mean = sum / n;
            let variance = ((squares - n * mean * mean) / (n * (n - 1.0))).max(0.0);
            // A single draw: its square is no less than its variance in the mean.
            let found = sums[GROUPS];
            let scale = axis[*channel].recip();
            ((mean + found) * scale, (variance + found * found) * scale * scale)
        })
    }

    fn group_size(&self) -> usize {
        self.pixels.settings.samples.div_ceil(GROUPS)
    }

    /// The sensor point at `u` of a pixel, its radial direction (up on the axis) and its radius.
    #[inline]
    fn sensor_point(&self, row: isize, col: isize, u: [f64; 2]) -> (DVec2, (DVec2, f64)) {
        let p = DVec2::from(self.pixels.frame.sensor_mm_from_pixel([col as f64 + u[0], row as f64 + u[1]]));
        let radius = p.length();
        (p, (if radius > 0.0 { p * radius.recip() } else { DVec2::Y }, radius))
    }

    /// Puts the ray from `p` through `target` of the rim's plane into the tile; `u` picks the wavelength.
    #[inline]
    fn start(&mut self, p: DVec2, target: DVec2, waiting: Waiting, u: f64) {
        let rear = self.pixels.rear;
        let colour = rear.colour(waiting.channel, u);
        let (weight, ray) = rear.ray(p, target, colour);
        let lane = self.count;
        self.tile.rays.set(lane, ray);
        self.tile.colour[lane] = colour.number;
        self.waiting[lane] = Waiting { weight: waiting.weight * weight, ..waiting };
        self.count += 1;
        self.tally.rays += 1;
        if self.count == TILE {
            self.trace();
        }
    }

    /// Traces what waits and adds `n'² L cos⁴θ′ / Z² A` of every ray that meets the scene to its sum.
    fn trace(&mut self) {
        let Pixels { rear, scene, .. } = self.pixels;
        self.tile.resize(self.count);
        rear.program.trace_tile(&mut self.tile);
        for (lane, waiting) in self.waiting[..self.count].iter().enumerate() {
            if !rear.passed(&self.tile, lane) {
                continue;
            }
            self.tally.passed += 1;
            self.tally.outside += u64::from(waiting.sum % SUMS == GROUPS);
            let leaving = self.tile.rays.ray(lane);
            let slope = object_slope(leaving.origin, leaving.direction, scene.vergence);
            let channel = waiting.channel.min(scene.texture.len_of(Axis(0)) - 1);
            self.sums[waiting.sum] += waiting.weight * scene.sample(channel, scene.texel_from_slope(slope.into())).0;
        }
        self.count = 0;
    }
}

/// Where a ray that left the lens towards the object meets it: object height over object distance, `[right, up]`.
///
/// The ray stands in the first vertex's frame seen from the sensor (`z` towards the object). It crosses the vertex plane
/// at `e` with the slope `m`; at the distance `1/v` its height times `v` is `v e + m`, for every `v`.
#[inline]
pub(super) fn object_slope(point: DVec3, direction: DVec3, vergence: f64) -> DVec2 {
    let m = direction.truncate() / direction.z;
    vergence * (point.truncate() - point.z * m) + m
}
