//! Overlap-add: blocks are blurred into tiles in parallel, tiles are added in a fixed order.

use std::ops::Range;

use ndarray::{Array3, Axis, s};
use rayon::prelude::*;

use super::super::cfa::Real;
use super::Source;
use super::frame::{Block, Frame};
use super::plane::Scratch;
use super::segments::Segment;

/// A block of a row of blocks: its rows, its columns, its source.
#[derive(Clone, Copy)]
pub(super) struct Place<'a, T> {
    pub row: &'a Segment<T>,
    pub col: &'a Segment<T>,
    pub block: &'a Block<T>,
}

/// What blurs a block.
pub(super) trait Convolver<T: Real>: Sync {
    /// Makes ready for the blocks of `row` × `cols`.
    fn prepare(&mut self, frame: &Frame<'_, T>, row: &Segment<T>, cols: &[Segment<T>]);

    /// Leaves the row spectra of the blurred block in `scratch.back`, `[channel][panel][row of the region]`, for the
    /// image `channels` that share the source's `channel`.
    fn convolve(
        &self,
        frame: &Frame<'_, T>,
        place: Place<'_, T>,
        source_channel: usize,
        channels: Range<usize>,
        scratch: &mut Scratch<T>,
    );
}

/// The image of all blocks of the frame.
pub(super) fn overlap_add<T: Real>(
    frame: &Frame<'_, T>,
    source: &dyn Source<T>,
    convolver: &mut dyn Convolver<T>,
    progress: &(dyn Fn(f64) + Sync),
) -> Array3<T> {
    let shape = frame.shape;
    let groups = shape.groups();
    let mut out = Array3::from_elem((shape.channels, frame.region.rows, frame.region.cols), T::zero());
    let strips = frame.strips_in_memory();
    let steps = strips.len() * frame.rows.len();
    let tile = frame.tile_len();
    let (mut blocks, mut tiles) = (Vec::new(), Vec::new());
    let mut done = 0;
    for strip in strips {
        let cols = &frame.cols[strip];
        for row in &frame.rows {
            frame.fill(source, row, cols, &mut blocks);
            if blocks.iter().take(cols.len()).any(|b| b.full) {
                convolver.prepare(frame, row, cols);
                let len = cols.len() * shape.channels * tile;
                if tiles.len() < len {
                    tiles.resize(len, T::zero());
                }
                let tasks: Vec<_> =
                    (0..cols.len()).flat_map(|b| groups.iter().enumerate().map(move |(g, c)| (b, g, c))).collect();
                let convolver = &*convolver;
                let per_task = (groups[0].len() * tile).max(1);
                tiles[..len].par_chunks_mut(per_task).zip(tasks).for_each(|(tiles, (b, group, channels))| {
                    let place = Place { row, col: &cols[b], block: &blocks[b] };
                    if !place.block.full {
                        return;
                    }
                    frame.pool.with(&frame.plane, |scratch| {
                        convolver.convolve(frame, place, group, channels.clone(), scratch);
                        let (_, _, count) = frame.reach(row);
                        for (i, tile) in tiles.chunks_exact_mut(tile).enumerate() {
                            frame.plane.rows_inverse(scratch, i, count, |row, line| {
                                tile[row * frame.plane.cols..][..frame.plane.cols].copy_from_slice(line);
                            });
                        }
                    });
                });
                add_tiles(frame, row, cols, &blocks, &tiles, &mut out);
            }
            done += 1;
            progress(done as f64 / steps as f64);
        }
    }
    out
}

/// Adds the tiles of a row of blocks, from left to right.
fn add_tiles<T: Real>(
    frame: &Frame<'_, T>,
    row: &Segment<T>,
    cols: &[Segment<T>],
    blocks: &[Block<T>],
    tiles: &[T],
    out: &mut Array3<T>,
) {
    let (start, _, count) = frame.reach(row);
    let len = frame.tile_len();
    for (channel, mut plane) in out.outer_iter_mut().enumerate() {
        let mut band = plane.slice_mut(s![start..start + count, ..]);
        band.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(i, mut line)| {
            let line = line.as_slice_mut().expect("standard layout");
            for (b, col) in cols.iter().enumerate().filter(|(b, _)| blocks[*b].full) {
                let (to, from, n) = frame.reach_cols(col);
                let tile = &tiles[(b * frame.shape.channels + channel) * len..][i * frame.plane.cols..];
                line[to..to + n].iter_mut().zip(&tile[from..from + n]).for_each(|(o, t)| *o += *t);
            }
        });
    }
}
