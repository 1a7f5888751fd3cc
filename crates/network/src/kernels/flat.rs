//! A batch of small planes, each channel as one line, for the products of [`super::product`].
//!
//! Behind every row stands one zero and behind every picture a row of zeros, so that each tap of a 3×3 convolution is
//! the same line read from another place: lanes run on over the ends of rows, and a plane of 4 × 4 still fills vectors.

use rayon::prelude::*;

use super::inner::Rows;
use super::strip::{activate, filled};
use super::{Extent, Level, Source, recycle};
use isoplanat_base::math::simd::{Kernel, Simd};

/// Values between the end of one channel's line and the next, at least; a vector reads over the end.
const SLACK: usize = 16;

/// Where pixels lie in a line.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    /// Pictures, rows, columns.
    pub(super) extent: Extent,
    /// Zeros behind a row, and rows of zeros behind a picture: 1 for 3×3 taps, 0 for none.
    border: usize,
}

impl Line {
    /// For a convolution with `side × side` taps, 1 or 3.
    pub(super) fn new(extent: Extent, side: usize) -> Self {
        // Without taps around it a plane is one row.
        let extent = if side == 1 { Extent { rows: 1, columns: extent.plane(), ..extent } } else { extent };
        Self { extent, border: side / 2 }
    }

    /// Distance of rows.
    pub(super) fn row_stride(&self) -> usize {
        self.extent.columns + self.border
    }

    /// Where `row` of picture `image` starts.
    pub(super) fn at(&self, image: usize, row: usize) -> usize {
        (image * (self.extent.rows + self.border) + row) * self.row_stride()
    }

    /// Values from the first pixel to the last, zeros between them included.
    pub(super) fn len(&self) -> usize {
        self.at(self.extent.batch - 1, self.extent.rows - 1) + self.extent.columns
    }

    /// Where the tap above left lies from a pixel, backwards.
    pub(super) fn reach(&self) -> usize {
        self.border * (self.row_stride() + 1)
    }
}

/// The lines of several channels.
pub(super) struct Lines {
    values: Vec<f32>,
    /// Geometry of each.
    pub(super) line: Line,
    /// Zeros before the first pixel.
    lead: usize,
    /// Distance of channels; an odd number of cache lines.
    pub(super) stride: usize,
    /// Number of channels.
    pub(super) channels: usize,
}

impl Lines {
    /// The channels of all sources in turn, through their PReLU, for a convolution with `side × side` taps.
    pub(super) fn load(level: Level, sources: &[Source], extent: Extent, side: usize) -> Self {
        let channels: Vec<(&Source, usize)> =
            sources.iter().flat_map(|s| (0..s.channels).map(move |c| (s, c))).collect();
        let mut lines = Self::empty(Line::new(extent, side), channels.len());
        let Self { line, lead, stride, .. } = lines;
        lines.values = filled(lines.capacity(), |to| {
            let (to, behind) = to.split_at_mut(channels.len() * stride);
            behind.fill(0.0);
            to.par_chunks_mut(stride).zip(&channels).for_each(|(to, &(source, channel))| {
                level.run(Load { source, channel, line, lead, to });
            });
        });
        lines
    }

    /// Lines of `channels` that `write` fills: it gets the channel and its line, all zeros.
    pub(super) fn written(line: Line, channels: usize, write: impl Fn(usize, &mut [f32]) + Sync) -> Self {
        let mut lines = Self::empty(line, channels);
        let mut values = recycle::zeros(lines.capacity());
        values[..channels * lines.stride]
            .par_chunks_mut(lines.stride)
            .enumerate()
            .for_each(|(channel, to)| write(channel, &mut to[lines.lead..][..line.len()]));
        lines.values = values;
        lines
    }

    fn empty(line: Line, channels: usize) -> Self {
        let lead = line.reach().next_multiple_of(16);
        let cache_lines = (lead + (line.len() + SLACK).next_multiple_of(16)) / 16;
        Self { values: vec![], line, lead, stride: 16 * (cache_lines | 1), channels }
    }

    fn capacity(&self) -> usize {
        self.channels * self.stride + self.lead + SLACK
    }

    /// What lies from `offset` behind the first pixel of `channel` on, or before it, up to the line's reach.
    #[inline]
    pub(super) fn from(&self, channel: usize, offset: isize) -> &[f32] {
        &self.values[(channel * self.stride + self.lead).strict_add_signed(offset)..]
    }

    /// The line of `channel`.
    pub(super) fn of(&self, channel: usize) -> &[f32] {
        &self.values[channel * self.stride + self.lead..][..self.line.len()]
    }

    /// All pixels of `channels` from `first` on, with their taps, as the inner loops read them.
    pub(super) fn rows(&self, first: usize, channels: usize) -> Rows<'_> {
        Rows {
            from: &self.values[first * self.stride + self.lead - self.line.reach()..],
            channel_stride: self.stride,
            row_stride: self.line.row_stride(),
            channels,
        }
    }

    /// Keeps the memory for other lines.
    pub(super) fn release(self) {
        recycle::give(self.values);
    }
}

/// Writes one channel's line.
struct Load<'a> {
    source: &'a Source<'a>,
    channel: usize,
    line: Line,
    lead: usize,
    to: &'a mut [f32],
}

impl Kernel for Load<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Extent { batch, rows, columns } = self.line.extent;
        let plane = rows * columns;
        self.to.fill(0.0);
        let slope = simd.splat(self.source.slope.map_or(1.0, |slope| slope[self.channel]));
        for image in 0..batch {
            let plane_at = (image * self.source.channels + self.channel) * plane;
            for (row, from) in self.source.values[plane_at..][..plane].chunks_exact(columns).enumerate() {
                let to = &mut self.to[self.lead + self.line.at(image, row)..][..columns];
                for x in (0..columns).step_by(S::LANES) {
                    simd.store_first(&mut to[x..], activate(simd, simd.load_first(&from[x..]), slope));
                }
            }
        }
    }
}
