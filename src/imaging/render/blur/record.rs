//! The blur and what its cotangents need.

use ndarray::{Array3, ArrayView3};
use rustfft::num_complex::Complex;

use super::cells::{Kept, blur_cells};
use super::frame::{Frame, Shape};
use super::spectra::NodeSpectra;
use super::{Kernels, Source};
use crate::imaging::plane::Region;
use crate::imaging::render::node_grid::NodeGrid;
use crate::math::real::Real;

/// Which spectra a recorded blur keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Keep {
    pub kernels: bool,
    pub source: bool,
    /// Kernels of nodes that only dark blocks use as well.
    pub dark: bool,
}

impl Keep {
    pub(super) const NOTHING: Self = Self { kernels: false, source: false, dark: false };
}

/// Which cotangents will be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// Those of the kernels: the record keeps the source's spectra.
    Kernels,
    /// Those of the source: the record keeps the kernels' spectra.
    Source,
    /// Both.
    Both,
    /// Both, of the source where it has light: blocks that see none, and the nodes that only they use, are left out, and the
    /// source's cotangent there stays zero.
    Lit,
}

/// What [`blur_recorded`] keeps for the cotangents.
///
/// Spectra of `H × N` complex numbers, where `N` is the transform's size, a little more than a block and a kernel, and
/// `H = N / 2 + 1`: one a block, source channel and phase for [`Wanted::Kernels`] (blocks that see no light have none),
/// one a node, channel and phase for [`Wanted::Source`].
pub struct BlurRecord<T: Real> {
    pub(super) frame: Frame<T>,
    pub(super) wanted: Wanted,
    pub(super) kernels: NodeSpectra<T>,
    /// `[row of blocks][column of blocks][source channel]`.
    pub(super) source: Vec<Option<Kept<T>>>,
}

impl<T: Real> BlurRecord<T> {
    /// Bytes of the spectra it keeps.
    pub fn bytes(&self) -> usize {
        let source = self.source.iter().flatten().map(|s| s.len() * size_of::<Complex<T>>()).sum::<usize>();
        source + if self.wanted == Wanted::Kernels { 0 } else { self.kernels.bytes() }
    }

    /// The source spectra of one block, `[phase][column frequency][row frequency]`; none if it sees no light.
    pub(super) fn seen(&self, row: usize, col: usize, channel: usize) -> Option<&[Complex<T>]> {
        let at = (row * self.frame.cols.len() + col) * self.frame.shape.source_channels + channel;
        self.source.get(at).and_then(|s| s.as_deref())
    }

    /// Whether blocks that see no light have a cotangent of the source.
    pub(super) fn dark(&self) -> bool {
        self.wanted != Wanted::Lit
    }

    pub(super) fn check(&self, bar: &ArrayView3<'_, T>, wanted: Wanted) {
        let Frame { shape, region, .. } = &self.frame;
        assert_eq!(bar.dim(), (shape.channels, region.rows, region.cols), "the cotangent covers the region");
        let all = matches!(self.wanted, Wanted::Both | Wanted::Lit);
        assert!(self.wanted == wanted || all, "the record was made for {:?}", self.wanted);
    }
}

/// [`super::blur`] by [`super::Method::Cells`] with blocks of at most `block` pixels, and a record for its cotangents.
///
/// The image is the same to the bit. All that the record keeps stays in memory: [`BlurRecord::bytes`].
///
/// # Panics
/// As [`super::blur`].
pub fn blur_recorded<T: Real>(
    grid: &NodeGrid,
    kernels: &dyn Kernels<T>,
    source: &dyn Source<T>,
    region: Region,
    block: usize,
    wanted: Wanted,
) -> (Array3<T>, BlurRecord<T>) {
    let frame = Frame::new(grid, Shape::of(kernels, source), region, block);
    let keep = Keep {
        kernels: wanted != Wanted::Kernels,
        source: wanted != Wanted::Source,
        dark: matches!(wanted, Wanted::Source | Wanted::Both),
    };
    let mut spectra = NodeSpectra::new();
    let (image, kept) = blur_cells(&frame, kernels, source, &mut spectra, keep, &|_| {});
    if !keep.kernels {
        spectra = NodeSpectra::new();
    }
    (image, BlurRecord { frame, wanted, kernels: spectra, source: kept })
}
