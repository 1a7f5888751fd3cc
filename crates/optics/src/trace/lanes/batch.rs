//! Many rays: in place, or streamed through closures so that memory does not grow with their number.

use std::marker::PhantomData;

use rayon::prelude::*;

use super::dispatch;
use super::program::{Options, Program};
use super::run::{Lean, Mode, Run, Spectral, WithPath};
use super::tile::{Rays, Status, TILE, Tile};
use crate::trace::System;
use isoplanat_base::math::simd::{Kernel, Simd};
use isoplanat_base::stop::look;

/// Groups that streamed rays are cut into; each is worked on by one thread, in order.
pub const GROUPS: usize = 128;

/// Tiles of one task of [`Program::trace_batch`].
const TILES: usize = 16;

/// Traces `rays` (frame of the first vertex) through all of `system` in place: rays at the image plane, in its frame.
///
/// One status per ray. In the place of a ray that failed stands one along the
/// axis. Every ray's numbers depend on that ray alone.
pub fn trace_batch(system: &System, rays: &mut Rays, options: Options) -> Vec<Status> {
    Program::new(system, options).trace_batch(rays, None)
}

impl Program {
    /// As [`trace_batch`]; `paths`, of the length of `rays`, receives the optical paths, mm, if the options ask for them.
    pub fn trace_batch(&self, rays: &mut Rays, paths: Option<&mut [f64]>) -> Vec<Status> {
        let count = rays.len();
        let mut status = vec![None; count];
        let size = TILES * TILE;
        // One part per task, of every array.
        let mut parts: Vec<Part<'_>> = Vec::with_capacity(count.div_ceil(size));
        let mut arrays = [&mut rays.x, &mut rays.y, &mut rays.z, &mut rays.l, &mut rays.m, &mut rays.n]
            .map(|array| array[..count].chunks_mut(size));
        let mut path_parts = paths.map(|paths| paths.chunks_mut(size));
        for status in status.chunks_mut(size) {
            let arrays = arrays.each_mut().map(|chunks| chunks.next().unwrap_or_default());
            let path = path_parts.as_mut().and_then(Iterator::next).unwrap_or_default();
            parts.push(Part { arrays, path, status });
        }
        parts.into_par_iter().for_each_init(Tile::new, |tile, part| part.trace(self, tile));
        status
    }

    /// Traces `count` rays that `source` makes, tile by tile, and hands the landed tiles to `sink`.
    ///
    /// Both get the number of the tile's first ray. `source` must fill every lane below [`Tile::len`]; other lanes hold
    /// what was there before. Rays are cut into at most [`GROUPS`] contiguous groups by their number alone; a group's
    /// tiles come one after the other, with a value of the group's own (from `start`) for sums. The values are returned
    /// in the order of the rays, so that sums over them do not depend on the number of threads.
    pub fn trace_stream<A: Send>(
        &self,
        count: usize,
        start: impl Fn() -> A + Sync,
        source: impl Fn(&mut A, usize, &mut Tile) + Sync,
        sink: impl Fn(&mut A, usize, &Tile) + Sync,
    ) -> Vec<A> {
        groups(count)
            .into_par_iter()
            .map_init(Tile::new, |tile, group| {
                let mut own = start();
                for first in group.step_by(TILE) {
                    tile.len = TILE.min(count - first);
                    source(&mut own, first, tile);
                    self.trace_tile(tile);
                    sink(&mut own, first, tile);
                }
                own
            })
            .collect()
    }

    /// Traces the rays of one tile: from `tile.rays` to `tile.rays` and `tile.status`.
    pub fn trace_tile(&self, tile: &mut Tile) {
        tile.start();
        if self.colours > 0 {
            tile.colour.iter_mut().for_each(|i| *i = (*i).min(self.colours - 1));
        }
        match (self.colours > 0, self.path) {
            (true, _) => self.level.run(Through(self, tile, PhantomData::<Spectral>)),
            (false, true) => self.level.run(Through(self, tile, PhantomData::<WithPath>)),
            (false, false) => self.level.run(Through(self, tile, PhantomData::<Lean>)),
        }
        tile.settle();
    }
}

/// A tile through all surfaces.
struct Through<'a, M>(&'a Program, &'a mut Tile, PhantomData<M>);

impl<M: Mode> Kernel for Through<'_, M> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self(program, tile, _) = self;
        for step in &program.steps {
            if tile.alive == 0 {
                break;
            }
            let mut run = Run {
                from: &mut tile.rays,
                to: &mut tile.spare,
                extra: None,
                colour: &tile.colour,
                alive: &mut tile.alive,
                status: &mut tile.status,
                len: tile.len,
            };
            dispatch::forward::<S, M>(simd, step, &mut run);
            std::mem::swap(&mut tile.rays, &mut tile.spare);
        }
    }
}

/// Ranges of rays, whole tiles each (but for the last), that depend on `count` alone.
pub(super) fn groups(count: usize) -> Vec<std::ops::Range<usize>> {
    let tiles = count.div_ceil(TILE);
    let number = GROUPS.min(tiles);
    (0..number).map(|g| g * tiles / number * TILE..((g + 1) * tiles / number * TILE).min(count)).collect()
}

/// A part of all arrays.
struct Part<'a> {
    arrays: [&'a mut [f64]; 6],
    path: &'a mut [f64],
    status: &'a mut [Status],
}

impl Part<'_> {
    fn trace(mut self, program: &Program, tile: &mut Tile) {
        look();
        let count = self.status.len();
        for first in (0..count).step_by(TILE) {
            let range = first..count.min(first + TILE);
            let len = range.len();
            tile.len = len;
            let bundle = &mut *tile.rays;
            let to = [&mut bundle.x, &mut bundle.y, &mut bundle.z, &mut bundle.l, &mut bundle.m, &mut bundle.n];
            for (to, from) in to.into_iter().zip(&self.arrays) {
                to[..len].copy_from_slice(&from[range.clone()]);
            }
            program.trace_tile(tile);
            let bundle = &*tile.rays;
            let from = [&bundle.x, &bundle.y, &bundle.z, &bundle.l, &bundle.m, &bundle.n];
            for (to, from) in self.arrays.iter_mut().zip(from) {
                to[range.clone()].copy_from_slice(&from[..len]);
            }
            if let Some(path) = self.path.get_mut(range.clone()) {
                path.copy_from_slice(&bundle.path[..len]);
            }
            self.status[range].copy_from_slice(&tile.status[..len]);
        }
    }
}
