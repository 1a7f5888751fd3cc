//! Sums of correlations in the frequency domain, until the last block of a node is done.

use std::collections::BTreeMap;
use std::ops::Range;

use ndarray::Array5;
use rayon::prelude::*;

use super::correlate::{CellSums, NodeSum};
use super::frame::{Frame, Shape};
use super::plane::zero;
use isoplanat_base::math::real::Real;
use isoplanat_base::stop::look;

/// By node and channel: `[phase][column frequency][row frequency]`.
pub(super) struct NodeSums<T> {
    of: BTreeMap<(usize, usize), NodeSum<T>>,
    free: Vec<NodeSum<T>>,
}

impl<T> Default for NodeSums<T> {
    fn default() -> Self {
        Self { of: BTreeMap::new(), free: Vec::new() }
    }
}

impl<T: Real> NodeSums<T> {
    /// Hands out the sums of `nodes`, zero where there are none yet.
    pub(super) fn take(&mut self, frame: &Frame<T>, nodes: Vec<usize>, channels: Range<usize>) -> CellSums<T> {
        let len = frame.shape.phases * frame.plane.spectrum_len();
        let keys = channels.clone().flat_map(|c| nodes.iter().map(move |n| (*n, c)));
        let values = keys
            .map(|key| {
                self.of.remove(&key).unwrap_or_else(|| {
                    let values = self.free.pop().map_or_else(Vec::new, |s| s.values);
                    let mut sum = NodeSum { values, added: false };
                    sum.values.resize(len, zero());
                    sum
                })
            })
            .collect();
        CellSums { nodes, channels, values }
    }

    /// Takes them back.
    pub(super) fn give(&mut self, sums: CellSums<T>) {
        let CellSums { nodes, channels, values } = sums;
        let keys = channels.flat_map(|c| nodes.iter().map(move |n| (*n, c)));
        self.of.extend(keys.zip(values));
    }

    /// Sets apart the sums of all nodes but `nodes`.
    pub(super) fn done(&mut self, nodes: &[usize]) -> Done<T> {
        let gone: Vec<_> = self.of.keys().copied().filter(|(n, _)| !nodes.contains(n)).collect();
        Done(gone.into_iter().filter_map(|key| self.of.remove(&key).map(|s| (key, s))).collect())
    }

    /// Takes their memory back.
    pub(super) fn reuse(&mut self, done: Done<T>) {
        self.free.extend(done.0.into_iter().map(|(_, sum)| sum));
    }
}

/// Sums that nothing will be added to.
pub(super) struct Done<T>(Vec<((usize, usize), NodeSum<T>)>);

impl<T: Real> Done<T> {
    /// Adds the kernels to `out`, `[node, channel, phase, row, col]`.
    pub(super) fn finish(&mut self, frame: &Frame<T>, out: &mut Array5<T>) {
        let Shape { size, channels, phases, .. } = frame.shape;
        let (plane, len) = (&frame.plane, frame.plane.spectrum_len());
        let out = out.as_slice_mut().expect("standard layout");
        let mut places = out.chunks_exact_mut(phases * size * size).enumerate();
        let work: Vec<_> = self
            .0
            .iter_mut()
            .filter(|(_, sum)| sum.added)
            .filter_map(|((node, channel), sum)| {
                let at = *node * channels + *channel;
                places.find(|(i, _)| *i == at).map(|(_, out)| (sum, out))
            })
            .collect();
        work.into_par_iter().for_each(|(sum, out)| {
            look();
            frame.pool.with(plane, |scratch| {
                let mut kernel = vec![T::zero(); size * size];
                for (sum, out) in sum.values.chunks_exact_mut(len).zip(out.chunks_exact_mut(size * size)) {
                    plane.image(&mut scratch.buffers, &mut scratch.lines, sum, (size, size), &mut kernel);
                    out.iter_mut().zip(&kernel).for_each(|(o, v)| *o += *v);
                }
            });
        });
    }
}
