//! Many rays and their cotangents: forward and back, tile by tile, in memory that does not grow with the rays.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::adjoint::{Back, SurfaceSums};
use super::batch::groups;
use super::dispatch;
use super::program::{Options, Program, Step};
use super::run::{Extra, Recorded, Run};
use super::tile::{Bundle, TILE, Tile};
use crate::trace::sequential::{HitBar, trace, trace_vjp};
use crate::trace::{System, SystemGradient};
use isoplanat_base::math::simd::{Kernel, Simd};

/// Told the cotangents of a tile's launch rays: the number of its first ray, how many they are, the cotangents.
pub type LaunchBars<'a> = &'a (dyn Fn(usize, usize, &Bundle) + Sync);

/// Traces `count` rays through all of `system` and pulls cotangents of their landings back to all of its numbers.
///
/// `source` makes the rays of a tile, as in [`Program::trace_stream`]. `landing` sees the landed tile, optical paths
/// included, writes the cotangents of point, direction and path (zero before) and returns the tile's share of a loss.
/// Cotangents of failed rays are ignored. `launch` is told the cotangents of the launch rays, those of failed rays zero.
/// Returns the sum of the losses and the cotangents of the system.
///
/// Rays are summed in an order that depends on `count` alone, so the result does not depend on the number of threads. A
/// system with a surface that is not for lanes goes ray by ray through the plain trace.
pub fn trace_gradient(
    system: &System,
    count: usize,
    options: Options,
    source: impl Fn(usize, &mut Tile) + Sync,
    landing: impl Fn(usize, &Tile, &mut Bundle) -> f64 + Sync,
    launch: Option<LaunchBars<'_>>,
) -> (f64, SystemGradient) {
    let recorded = Program::new(system, options);
    let in_lanes = recorded.in_lanes() == recorded.steps.len();
    let plain = Program::new(system, Options { path: true, ..options });
    let parts: Vec<(f64, SystemGradient)> = groups(count)
        .into_par_iter()
        .map_init(
            || (Tile::new(), Record::new(if in_lanes { recorded.steps.len() } else { 0 })),
            |(tile, record), group| {
                let mut out = SystemGradient::zeros(system);
                let mut loss = 0.0;
                record.sums.fill(SurfaceSums::ZERO);
                for first in group.step_by(TILE) {
                    tile.len = TILE.min(count - first);
                    source(first, tile);
                    if in_lanes {
                        recorded.forward_recorded(tile, record);
                    } else {
                        record.rays[0].clone_from(&tile.rays);
                        plain.trace_tile(tile);
                    }
                    *record.bars = Bundle::ZERO;
                    loss += landing(first, tile, &mut record.bars);
                    if in_lanes {
                        // The adjoint wants the last bundle back.
                        std::mem::swap(&mut tile.rays, &mut record.rays[recorded.steps.len()]);
                    }
                    record.bars.silence(!tile.alive);
                    if in_lanes {
                        recorded.back(tile.len, record);
                    } else {
                        one_by_one_vjp(system, tile, &record.rays[0], &mut record.bars, &mut out);
                    }
                    if let Some(launch) = launch {
                        launch(first, tile.len, &record.bars);
                    }
                }
                for (step, sums) in recorded.steps.iter().zip(&record.sums) {
                    sums.add_to(step, &mut out);
                }
                (loss, out)
            },
        )
        .collect();
    let mut total = (0.0, SystemGradient::zeros(system));
    for (loss, part) in parts {
        total.0 += loss;
        total.1.add(&part);
    }
    total
}

/// What one tile leaves on its way forward, and the sums over tiles.
pub(super) struct Record {
    /// Rays before the first surface and behind every one.
    pub(super) rays: Vec<Box<Bundle>>,
    pub(super) extras: Vec<Extra>,
    pub(super) bars: Box<Bundle>,
    pub(super) sums: Vec<SurfaceSums>,
}

impl Record {
    pub(super) fn new(surfaces: usize) -> Self {
        Self {
            rays: vec![Box::new(Bundle::ZERO); surfaces + 1],
            extras: vec![Extra::ZERO; surfaces],
            bars: Box::new(Bundle::ZERO),
            sums: vec![SurfaceSums::ZERO; surfaces],
        }
    }
}

impl Program {
    /// Traces a tile and keeps every surface's record; the last bundle stands in the tile.
    pub(super) fn forward_recorded(&self, tile: &mut Tile, record: &mut Record) {
        tile.start();
        std::mem::swap(&mut tile.rays, &mut record.rays[0]);
        self.level.run(There(self, tile, record));
        std::mem::swap(&mut tile.rays, &mut record.rays[self.steps.len()]);
        tile.settle();
    }

    /// Pulls `record.bars` from behind the last surface back to the launch rays, adding to the sums.
    fn back(&self, len: usize, record: &mut Record) {
        self.level.run(Home(self, len, record));
    }
}

/// A tile through all surfaces, with their records.
struct There<'a>(&'a Program, &'a mut Tile, &'a mut Record);

impl Kernel for There<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self(program, tile, record) = self;
        for (i, (step, extra)) in program.steps.iter().zip(&mut record.extras).enumerate() {
            let (before, after) = record.rays.split_at_mut(i + 1);
            let mut run = Run {
                from: &mut before[i],
                to: &mut after[0],
                extra: Some(extra),
                colour: &tile.colour,
                alive: &mut tile.alive,
                status: &mut tile.status,
                len: tile.len,
            };
            dispatch::forward::<S, Recorded>(simd, step, &mut run);
        }
    }
}

/// A tile's cotangents back through all surfaces.
struct Home<'a>(&'a Program, usize, &'a mut Record);

impl Kernel for Home<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self(program, len, record) = self;
        for (i, step) in program.steps.iter().enumerate().rev() {
            let mut back = Back {
                before: &record.rays[i],
                after: &record.rays[i + 1],
                extra: &record.extras[i],
                bars: &mut record.bars,
                sums: &mut record.sums[i],
                each: None,
                len,
            };
            dispatch::back(simd, step, &mut back);
        }
    }
}

impl Bundle {
    /// Zero in every lane of `lanes`.
    fn silence(&mut self, lanes: u64) {
        if lanes == 0 {
            return;
        }
        let arrays = [&mut self.x, &mut self.y, &mut self.z, &mut self.l, &mut self.m, &mut self.n, &mut self.path];
        for array in arrays {
            for (lane, value) in array.iter_mut().enumerate() {
                if (lanes >> lane) & 1 == 1 {
                    *value = 0.0;
                }
            }
        }
    }
}

impl SurfaceSums {
    /// Adds the sums of one surface to the system's cotangents.
    fn add_to(&self, step: &Step, out: &mut SystemGradient) {
        let surface = &step.surface;
        let sum = |lanes: &[f64]| lanes.iter().sum::<f64>();
        let (i, bent) = (step.index, sum(&self.bent));
        let shape = &mut out.shapes[i];
        shape.curvature += sum(&self.flat) + (1.0 + surface.shape.conic) * bent;
        shape.conic += step.c * bent;
        for (a, terms) in shape.asphere.iter_mut().zip(&self.terms) {
            *a += sum(terms);
        }
        out.distances[i] += sum(&self.distance);
        out.indices[i] += sum(&self.index);
        let mu_bar = sum(&self.mu);
        out.indices[i] += mu_bar / surface.index_after;
        out.indices[i + 1] -= mu_bar * step.mu / surface.index_after;
    }
}

/// The rays of a tile through the plain trace and back; `bars` turns from landings into launch rays.
fn one_by_one_vjp(system: &System, tile: &Tile, launched: &Bundle, bars: &mut Bundle, out: &mut SystemGradient) {
    let last = system.image();
    let mut hits = Vec::new();
    let mut hit_bars = vec![HitBar::default(); last + 1];
    for lane in 0..tile.len {
        let alive = (tile.alive >> lane) & 1 == 1;
        let Some(hit) = alive.then(|| trace(system, launched.ray(lane), last, &mut hits).ok()).flatten() else {
            bars.silence(1 << lane);
            continue;
        };
        let ray = bars.ray(lane);
        let (mut point, mut direction) = (ray.origin, ray.direction);
        if let Some(m) = &system.surfaces[last].motion {
            // Landings stand in the nominal frame, hits in the surface's own.
            let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
            out.motions[last].shift += point;
            out.motions[last].rotation += outer(point, hit.at.point) + outer(direction, hit.direction);
            let back = m.rotation.transpose();
            (point, direction) = (back * point, back * direction);
        }
        hit_bars[last] = HitBar { point, direction, optical_path: bars.path[lane] };
        let (origin, direction) = trace_vjp(system, &hits, &hit_bars, out);
        bars.set(lane, crate::trace::Ray { origin, direction });
    }
}
