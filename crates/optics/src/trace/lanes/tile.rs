//! Rays as structure of arrays: a [`Tile`] that stays in cache through all surfaces, and [`Rays`] of any number.

use glam::DVec3;

use crate::trace::{Failure, Ray};

/// Rays in a tile.
pub const TILE: usize = 64;

/// What a ray came to: `None` where it arrived.
pub type Status = Option<Failure>;

/// Coordinates of a tile's rays, or cotangents of them.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct Bundle {
    /// Points, mm.
    pub x: [f64; TILE],
    /// See `x`.
    pub y: [f64; TILE],
    /// See `x`.
    pub z: [f64; TILE],
    /// Unit directions.
    pub l: [f64; TILE],
    /// See `l`.
    pub m: [f64; TILE],
    /// See `l`.
    pub n: [f64; TILE],
    /// Optical path from the launch point, mm; only kept if asked for.
    pub path: [f64; TILE],
    /// Distance from the surface before, mm; only kept for the adjoint.
    pub(super) t: [f64; TILE],
}

impl Bundle {
    /// All zero.
    pub(super) const ZERO: Self = Self {
        x: [0.0; TILE],
        y: [0.0; TILE],
        z: [0.0; TILE],
        l: [0.0; TILE],
        m: [0.0; TILE],
        n: [0.0; TILE],
        path: [0.0; TILE],
        t: [0.0; TILE],
    };

    /// The ray in `lane`.
    ///
    /// # Panics
    /// If `lane` is not below [`TILE`].
    #[inline]
    pub fn ray(&self, lane: usize) -> Ray {
        Ray {
            origin: DVec3::new(self.x[lane], self.y[lane], self.z[lane]),
            direction: DVec3::new(self.l[lane], self.m[lane], self.n[lane]),
        }
    }

    /// Puts `ray` into `lane`.
    ///
    /// # Panics
    /// If `lane` is not below [`TILE`].
    #[inline]
    pub fn set(&mut self, lane: usize, ray: Ray) {
        [self.x[lane], self.y[lane], self.z[lane]] = ray.origin.to_array();
        [self.l[lane], self.m[lane], self.n[lane]] = ray.direction.to_array();
    }

    /// Whether every coordinate of `lane` is a number.
    pub(super) fn is_finite(&self, lane: usize) -> bool {
        let ray = self.ray(lane);
        ray.origin.is_finite() && ray.direction.is_finite()
    }
}

/// The ray of lanes without one: along the axis, where every surface is met.
pub(super) const AXIAL: Ray = Ray { origin: DVec3::ZERO, direction: DVec3::Z };

/// A handful of rays on their way through a lens together.
#[derive(Clone, Debug)]
pub struct Tile {
    /// The rays: in the frame of the first vertex before the trace, of the last surface's nominal vertex after it.
    ///
    /// In the place of a ray that failed stands one along the axis.
    pub rays: Box<Bundle>,
    /// Which wavelength of a [`super::Program::spectral`] each ray has; not read otherwise.
    pub colour: [u32; TILE],
    /// What each ray came to.
    pub status: [Status; TILE],
    /// Where the next surface puts its rays.
    pub(super) spare: Box<Bundle>,
    /// One bit per lane that holds a ray that has not failed.
    pub(super) alive: u64,
    pub(super) len: usize,
}

impl Default for Tile {
    fn default() -> Self {
        Self::new()
    }
}

impl Tile {
    /// An empty tile.
    pub fn new() -> Self {
        Self {
            rays: Box::new(Bundle::ZERO),
            colour: [0; TILE],
            status: [None; TILE],
            spare: Box::new(Bundle::ZERO),
            alive: 0,
            len: 0,
        }
    }

    /// Number of rays.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Sets the number of rays, at most [`TILE`].
    pub fn resize(&mut self, len: usize) {
        self.len = len.min(TILE);
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Makes the first `len` lanes alive and the others harmless.
    pub(super) fn start(&mut self) {
        for lane in self.len..TILE {
            self.rays.set(lane, AXIAL);
        }
        self.rays.path = [0.0; TILE];
        self.status = [None; TILE];
        self.alive = if self.len >= TILE { u64::MAX } else { (1 << self.len) - 1 };
    }

    /// Puts the placeholder where a ray failed, whatever the surfaces behind made of it.
    pub(super) fn settle(&mut self) {
        let used = if self.len >= TILE { u64::MAX } else { (1 << self.len) - 1 };
        let mut dead = used & !self.alive;
        while dead != 0 {
            let lane = dead.trailing_zeros() as usize;
            dead &= dead - 1;
            self.rays.set(lane, AXIAL);
            self.rays.path[lane] = 0.0;
        }
    }
}

/// Rays of any number, one array per coordinate; all arrays have the same length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rays {
    /// Points, mm.
    pub x: Vec<f64>,
    /// See `x`.
    pub y: Vec<f64>,
    /// See `x`.
    pub z: Vec<f64>,
    /// Unit directions.
    pub l: Vec<f64>,
    /// See `l`.
    pub m: Vec<f64>,
    /// See `l`.
    pub n: Vec<f64>,
}

impl Rays {
    /// Number of rays: the length of the shortest array.
    pub fn len(&self) -> usize {
        [&self.x, &self.y, &self.z, &self.l, &self.m, &self.n].into_iter().map(Vec::len).min().unwrap_or(0)
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Appends `ray`.
    pub fn push(&mut self, ray: Ray) {
        let (o, d) = (ray.origin, ray.direction);
        self.x.push(o.x);
        self.y.push(o.y);
        self.z.push(o.z);
        self.l.push(d.x);
        self.m.push(d.y);
        self.n.push(d.z);
    }

    /// Ray `i`.
    ///
    /// # Panics
    /// If there is none.
    pub fn ray(&self, i: usize) -> Ray {
        Ray {
            origin: DVec3::new(self.x[i], self.y[i], self.z[i]),
            direction: DVec3::new(self.l[i], self.m[i], self.n[i]),
        }
    }
}

impl FromIterator<Ray> for Rays {
    fn from_iter<I: IntoIterator<Item = Ray>>(rays: I) -> Self {
        let mut all = Self::default();
        rays.into_iter().for_each(|ray| all.push(ray));
        all
    }
}
