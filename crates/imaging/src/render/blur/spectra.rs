//! Spectra of the kernels of the nodes in use.

use std::collections::BTreeMap;

use ndarray::Array4;
use rayon::prelude::*;
use rustfft::num_complex::Complex;

use super::Kernels;
use super::frame::{Frame, Shape};
use super::plane::zero;
use isoplanat_base::math::real::Real;
use isoplanat_base::stop::look;

/// Spectra by node, `[channel][phase][column frequency][row frequency]`.
pub(super) struct NodeSpectra<T> {
    of: BTreeMap<usize, Vec<Complex<T>>>,
    free: Vec<Vec<Complex<T>>>,
}

impl<T: Real> NodeSpectra<T> {
    pub(super) fn new() -> Self {
        Self { of: BTreeMap::new(), free: Vec::new() }
    }

    /// Forgets all nodes but `nodes`; their memory is used again.
    pub(super) fn keep(&mut self, nodes: &[usize]) {
        let gone: Vec<usize> = self.of.keys().copied().filter(|n| !nodes.contains(n)).collect();
        self.free.extend(gone.iter().filter_map(|n| self.of.remove(n)));
    }

    /// Computes the spectra of those of `nodes` that are missing.
    pub(super) fn add(&mut self, frame: &Frame<T>, kernels: &dyn Kernels<T>, nodes: &[usize]) {
        let Shape { size, channels, phases, .. } = frame.shape;
        let len = frame.plane.spectrum_len();
        let missing = nodes.iter().filter(|n| !self.of.contains_key(*n));
        let mut new: Vec<_> = missing.map(|n| (*n, Vec::new())).collect();
        for (_, spectra) in &mut new {
            *spectra = self.free.pop().unwrap_or_default();
        }
        new.par_iter_mut().for_each(|(node, spectra)| {
            look();
            spectra.resize(channels * phases * len, zero());
            let mut values = Array4::from_elem((channels, phases, size, size), T::zero());
            kernels.fill(*node, values.view_mut());
            let planes = values.as_slice().expect("standard layout").chunks_exact(size * size);
            frame.pool.with(&frame.plane, |scratch| {
                for (plane, out) in planes.zip(spectra.chunks_exact_mut(len)) {
                    frame.plane.spectrum(&mut scratch.buffers, size, |i| &plane[i * size..][..size], out);
                }
            });
        });
        self.of.extend(new);
    }

    /// The spectrum of a node's kernel.
    #[inline]
    pub(super) fn plane(&self, frame: &Frame<T>, node: usize, channel: usize, phase: usize) -> &[Complex<T>] {
        let len = frame.plane.spectrum_len();
        &self.of[&node][(channel * frame.shape.phases + phase) * len..][..len]
    }

    /// Bytes of the spectra.
    pub(super) fn bytes(&self) -> usize {
        self.of.values().map(|s| s.len() * size_of::<Complex<T>>()).sum()
    }
}
