//! The blur and what its cotangents need.

use ndarray::Array3;
use rustfft::num_complex::Complex;

use super::cells::{Keep, Kept, blur_cells};
use super::frame::{Frame, Shape};
use super::spectra::NodeSpectra;
use super::{Kernels, Source};
use crate::plane::Region;
use crate::render::node_grid::NodeGrid;
use isoplanat_base::math::real::Real;

/// What [`blur_recorded`] keeps for the cotangents.
///
/// Spectra of `H × N` complex numbers, where `N` is the transform's size, a little more than a block and a kernel, and
/// `H = N / 2 + 1`: one a block, source channel and phase (blocks that see no light have none) for the kernels' cotangent,
/// one a node, channel and phase for the source's.
pub struct BlurRecord<T: Real> {
    pub(super) frame: Frame<T>,
    /// Whether blocks that see no light have a cotangent of the source.
    pub(super) dark: bool,
    pub(super) kernels: NodeSpectra<T>,
    /// `[row of blocks][column of blocks][source channel]`.
    pub(super) source: Vec<Option<Kept<T>>>,
}

impl<T: Real> BlurRecord<T> {
    /// Bytes of the spectra it keeps.
    pub fn bytes(&self) -> usize {
        let source = self.source.iter().flatten().map(|s| s.len() * size_of::<Complex<T>>());
        source.sum::<usize>() + self.kernels.bytes()
    }

    /// The source spectra of one block, `[phase][column frequency][row frequency]`; none if it sees no light.
    pub(super) fn seen(&self, row: usize, col: usize, channel: usize) -> Option<&[Complex<T>]> {
        let at = (row * self.frame.cols.len() + col) * self.frame.shape.source_channels + channel;
        self.source.get(at).and_then(|s| s.as_deref())
    }
}

/// [`super::blur`] by [`super::Method::Cells`] with blocks of at most `block` pixels, and a record for its cotangents.
///
/// The image is the same to the bit. Without `dark` the blocks that see no light, and the nodes that only they use, are left out, and
/// the source's cotangent stays zero there. All that the record keeps stays in memory: [`BlurRecord::bytes`].
///
/// # Panics
/// As [`super::blur`].
pub fn blur_recorded<T: Real>(
    grid: &NodeGrid,
    kernels: &dyn Kernels<T>,
    source: &dyn Source<T>,
    region: Region,
    block: usize,
    dark: bool,
) -> (Array3<T>, BlurRecord<T>) {
    let frame = Frame::new(grid, Shape::of(kernels, source), region, block);
    let keep = if dark { Keep::All } else { Keep::Lit };
    let mut spectra = NodeSpectra::new();
    let (image, kept) = blur_cells(&frame, kernels, source, &mut spectra, keep, &|_| {});
    (image, BlurRecord { frame, dark, kernels: spectra, source: kept })
}
