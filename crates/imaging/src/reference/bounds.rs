//! Which part of the plane of the rear rim the passing rays of a sensor point cross: an ellipse by sensor radius.
//!
//! At a ladder of radii, rays are sent from the sensor through a grid of the rear aperture, at the ends and the middle of
//! the spectrum; the grid closes in on those that pass. A bin between two radii gets an ellipse around the rays of
//! both, one grid cell wider. The ellipse lies in the meridional frame: `y` along the sensor point's radius, `x` across, so
//! it is symmetric in `x`. A pupil smaller than a grid cell is found from its aimed chief ray.

use glam::DVec2;
use rayon::prelude::*;

use super::rear::RearView;
use isoplanat_optics::trace::aim::{Aimed, Aimer};
use isoplanat_optics::trace::lanes::{TILE, Tile};
use isoplanat_optics::trace::{ObjectPoint, System};

/// An ellipse on the plane of the rear rim, in the meridional frame of a sensor point; mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ellipse {
    /// Centre along the radius.
    pub centre: f64,
    /// Semi-axis across the radius; 0 where nothing passes.
    pub across: f64,
    /// Semi-axis along the radius.
    pub along: f64,
}

impl Ellipse {
    /// Area, mm².
    #[inline]
    pub(crate) fn area(&self) -> f64 {
        std::f64::consts::PI * self.across * self.along
    }

    /// Whether `point` (across, along) lies inside.
    #[inline]
    pub fn contains(&self, point: DVec2) -> bool {
        let (x, y) = (point.x * self.along, (point.y - self.centre) * self.across);
        x * x + y * y < (self.across * self.along).powi(2)
    }
}

/// Ellipses over bins of sensor radius.
#[derive(Clone, Debug)]
pub struct Footprints {
    per_mm: f64,
    first: usize,
    bins: Vec<Ellipse>,
}

/// Cells across the grids that close in, and across the last.
const COARSE: usize = 40;
const FINE: usize = 96;
/// Rays of a row that are tried together: half a tile.
const CHUNK: usize = TILE / 2;

impl Footprints {
    /// Probes `rear` for sensor radii from `radii[0]` to `radii[1]`, mm.
    ///
    /// Bins start on the axis and their width does not depend on the radii asked for: a part of a picture is drawn from
    /// the same ellipses as the whole.
    pub fn probe(rear: &RearView, radii: [f64; 2]) -> Self {
        // Within a bin the footprint moves by at most about a percent of the aperture.
        let width = (0.01 * rear.system.surfaces[1].semi_diameter).max(rear.radius_mm / 256.0);
        let [first, last] = radii.map(|r| (r / width).max(0.0) as usize);
        let edges: Vec<Passing> =
            (first..=last + 1).into_par_iter().map(|k| Passing::find(rear, k as f64 * width)).collect();
        let bins = edges.windows(2).map(|pair| bounding(&pair[0], &pair[1])).collect();
        Self { per_mm: width.recip(), first, bins }
    }

    /// The same ellipses, so many times as large.
    #[must_use]
    pub(crate) fn grown(mut self, by: f64) -> Self {
        self.bins.iter_mut().for_each(|e| (e.across, e.along) = (by * e.across, by * e.along));
        self
    }

    /// The ellipse of a sensor point `radius` mm from the axis.
    #[inline]
    pub fn at(&self, radius: f64) -> Ellipse {
        self.bins[self.bin(radius)]
    }

    #[inline]
    fn bin(&self, radius: f64) -> usize {
        ((radius * self.per_mm) as usize).saturating_sub(self.first).min(self.bins.len() - 1)
    }

    /// Whether nothing passes from sensor points between two radii, mm.
    pub(crate) fn is_empty_between(&self, radii: [f64; 2]) -> bool {
        // Rounding may put a pixel's corner into a neighbour.
        let [first, last] = radii.map(|r| self.bin(r));
        let bins = first.saturating_sub(1)..=(last + 1).min(self.bins.len() - 1);
        self.bins[bins].iter().all(|e| e.area() == 0.0)
    }
}

/// Rays that pass from one sensor radius: for every grid row the outermost (`x ≥ 0`), and the cell's size.
#[derive(Default)]
struct Passing {
    points: Vec<DVec2>,
    cell: DVec2,
}

impl Passing {
    fn find(rear: &RearView, radius: f64) -> Self {
        let full = [-rear.disk_radius, rear.disk_radius];
        // The whole aperture; if nothing shows, around the chief ray; if nothing shows still, the whole again, finer.
        let mut found = Self::on_grid(rear, radius, rear.disk_radius, full, COARSE);
        if found.points.is_empty() {
            found = Self::around_chief(rear, radius);
        }
        if found.points.is_empty() {
            found = Self::on_grid(rear, radius, rear.disk_radius, full, 4 * COARSE);
        }
        for cells in [COARSE, FINE] {
            if found.points.is_empty() {
                return found;
            }
            let (half, span) = found.box_around();
            found = Self::on_grid(rear, radius, half, span, cells);
        }
        found
    }

    /// Half width across and span along of the points, two cells wider.
    fn box_around(&self) -> (f64, [f64; 2]) {
        let half = self.points.iter().map(|p| p.x).fold(0.0, f64::max) + 2.0 * self.cell.x;
        let low = self.points.iter().map(|p| p.y).fold(f64::INFINITY, f64::min) - 2.0 * self.cell.y;
        let high = self.points.iter().map(|p| p.y).fold(f64::NEG_INFINITY, f64::max) + 2.0 * self.cell.y;
        (half, [low, high])
    }

    /// Tries `cells` rows and half as many columns of `0..half` × `span`, the first column on the axis of symmetry, where
    /// even a small pupil has its full height.
    fn on_grid(rear: &RearView, radius: f64, half: f64, span: [f64; 2], cells: usize) -> Self {
        let columns = cells / 2;
        let cell = DVec2::new(half / columns as f64, (span[1] - span[0]) / cells as f64);
        let p = DVec2::new(0.0, radius);
        let colours = rear.probe_colours();
        let mut points = Vec::new();
        let (mut tile, mut row) = (Tile::new(), Vec::with_capacity(columns));
        for i in 0..cells {
            let y = span[0] + (i as f64 + 0.5) * cell.y;
            row.clear();
            row.extend((0..columns).map(|j| DVec2::new(j as f64 * cell.x, y)));
            for colour in colours {
                // From the rim inwards, until one passes.
                let outermost = (0..columns).step_by(CHUNK).rev().find_map(|first| {
                    let part = &row[first..columns.min(first + CHUNK)];
                    let passes = rear.passes(&mut tile, p, part, colour);
                    passes.iter().rposition(|passes| *passes).map(|j| first + j)
                });
                points.extend(outermost.map(|j| row[j]));
            }
        }
        Self { points, cell }
    }

    /// A grid around the ray through the stop's centre, shrunk until one of its rays passes.
    fn around_chief(rear: &RearView, radius: f64) -> Self {
        // Without its image plane the reversed system sees the sensor point as an object before its first vertex.
        let mut system = System { surfaces: rear.system.surfaces[1..].to_vec(), ..rear.system.clone() };
        system.stop -= 1;
        let vertex = std::mem::take(&mut system.surfaces[0].distance);
        let object = ObjectPoint::from_slope(DVec2::new(0.0, -radius / vertex), vertex.recip());
        let aimed = Aimer::new(&system).and_then(|aimer| aimer.aim(object, DVec2::ZERO, None));
        let Ok(Aimed { ray, .. }) = aimed else { return Self::default() };
        // Where the ray crosses the plane of the first vertex.
        let e = ray.origin - ray.direction * (ray.origin.z / ray.direction.z);
        let chief = radius + (e.y - radius) * rear.distance / vertex;
        let mut half = rear.disk_radius;
        while half > 1e-9 * rear.disk_radius {
            half /= COARSE as f64;
            let found = Self::on_grid(rear, radius, half, [chief - half, chief + half], COARSE);
            if !found.points.is_empty() {
                return found;
            }
        }
        Self::default()
    }
}

/// The ellipse around the rays of two neighbouring radii.
fn bounding(a: &Passing, b: &Passing) -> Ellipse {
    let points = || a.points.iter().chain(&b.points);
    if points().next().is_none() {
        return Ellipse::default();
    }
    let (low, high) = points().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p.y), h.max(p.y)));
    let cell = a.cell.max(b.cell);
    let centre = 0.5 * (low + high);
    let half = points().map(|p| p.x).fold(0.0, f64::max) + cell.x;
    let along = 0.5 * (high - low) + cell.y;
    // Scale the box's ellipse until it holds every point, each with the cell it stands for.
    let scale = points()
        .map(|p| ((p.x + 0.5 * cell.x) / half).hypot(((p.y - centre).abs() + 0.5 * cell.y) / along))
        .fold(0.0, f64::max);
    Ellipse { centre, across: half * scale, along: along * scale }
}
