//! Sums of correlations in the frequency domain, until the last block of a node is done.

use std::collections::BTreeMap;
use std::ops::Range;

use ndarray::{Array5, s};
use rayon::prelude::*;
use rustfft::num_complex::Complex;

use super::super::cfa::Real;
use super::correlate::Sums;
use super::frame::{Frame, Shape};
use super::plane::zero;

/// By node and channel: `[phase][column frequency][row frequency]`.
pub(super) struct NodeSums<T> {
    of: BTreeMap<(usize, usize), Vec<Complex<T>>>,
    free: Vec<Vec<Complex<T>>>,
}

impl<T> Default for NodeSums<T> {
    fn default() -> Self {
        Self { of: BTreeMap::new(), free: Vec::new() }
    }
}

impl<T: Real> NodeSums<T> {
    /// Hands out the sums of `nodes`, zero where there are none yet.
    pub(super) fn take(&mut self, frame: &Frame<T>, nodes: Vec<usize>, channels: Range<usize>) -> Sums<T> {
        let len = frame.shape.phases * frame.plane.spectrum_len();
        let keys = channels.clone().flat_map(|c| nodes.iter().map(move |n| (*n, c)));
        let values = keys
            .map(|key| {
                self.of.remove(&key).unwrap_or_else(|| {
                    let mut sums = self.free.pop().unwrap_or_default();
                    sums.clear();
                    sums.resize(len, zero());
                    sums
                })
            })
            .collect();
        Sums { nodes, channels, values }
    }

    /// Takes them back.
    pub(super) fn give(&mut self, sums: Sums<T>) {
        let Sums { nodes, channels, values } = sums;
        let keys = channels.flat_map(|c| nodes.iter().map(move |n| (*n, c)));
        self.of.extend(keys.zip(values));
    }

    /// Adds the kernels of all nodes but `nodes` to `out`, and forgets them.
    pub(super) fn finish(&mut self, frame: &Frame<T>, nodes: &[usize], out: &mut Array5<T>) {
        let Shape { size, phases, .. } = frame.shape;
        let (plane, len) = (&frame.plane, frame.plane.spectrum_len());
        let gone: Vec<_> = self.of.keys().copied().filter(|(n, _)| !nodes.contains(n)).collect();
        let mut taken: Vec<_> = gone.iter().filter_map(|key| self.of.remove(key).map(|s| (*key, s))).collect();
        let kernels: Vec<Vec<T>> = taken
            .par_iter_mut()
            .map(|(_, sums)| {
                let mut kernel = vec![T::zero(); phases * size * size];
                frame.pool.with(plane, |scratch| {
                    for (sums, out) in sums.chunks_exact_mut(len).zip(kernel.chunks_exact_mut(size * size)) {
                        plane.image(&mut scratch.buffers, &mut scratch.lines, sums, (size, size), out);
                    }
                });
                kernel
            })
            .collect();
        for (((node, channel), sums), kernel) in taken.into_iter().zip(kernels) {
            let mut to = out.slice_mut(s![node, channel, .., .., ..]);
            to.iter_mut().zip(kernel).for_each(|(o, v)| *o += v);
            self.free.push(sums);
        }
    }
}
