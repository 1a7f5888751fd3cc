//! A batch of small planes, each channel as one line, for the products of [`super::product`].
//!
//! Behind every row stands one zero and behind every picture a row of zeros, so that each tap of a 3×3 convolution is
//! the same line read from another place: lanes run on over the ends of rows, and a plane of 4 × 4 still fills vectors.
#![allow(unsafe_code, reason = "vector loads and stores within buffers whose size is checked on entry")]

use rayon::prelude::*;

use super::simd::{Kernel, Rows, Simd, dispatch};
use super::strip::{activate, filled};
use super::{Extent, Level, Source, recycle};

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
            let end = channels.len() * stride;
            // SAFETY: what lies behind the last channel.
            unsafe { to.at(end).write_bytes(0, lines.capacity() - end) };
            channels.par_iter().enumerate().for_each(|(at, &(source, channel))| {
                // SAFETY: this channel's line, which no other task writes.
                let to = unsafe { to.at(at * stride) };
                dispatch(level, &Load { source, channel, line, lead, stride, to });
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

    /// The first pixel of `channel`.
    pub(super) fn pixel(&self, channel: usize) -> *const f32 {
        let first = channel * self.stride + self.lead;
        assert!(first < self.values.len());
        // From the buffer's own pointer: whoever steps back to a tap stays within what it points to.
        self.values.as_ptr().wrapping_add(first)
    }

    /// The line of `channel`.
    pub(super) fn of(&self, channel: usize) -> &[f32] {
        &self.values[channel * self.stride + self.lead..][..self.line.len()]
    }

    /// All pixels of `channels` from `first` on, with their taps, as the inner loops read them.
    pub(super) fn rows(&self, first: usize, channels: usize) -> Rows {
        Rows {
            from: self.values[first * self.stride + self.lead - self.line.reach()..].as_ptr(),
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
    stride: usize,
    to: *mut f32,
}

impl Kernel for Load<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(&self) {
        let Extent { batch, rows, columns } = self.line.extent;
        let plane = rows * columns;
        // SAFETY: `stride` values belong to this channel; rows lie within them, and within the plane of the source.
        unsafe {
            self.to.write_bytes(0, self.stride);
            let slope = S::splat(self.source.slope.map_or(1.0, |slope| slope[self.channel]));
            for image in 0..batch {
                let plane_at = (image * self.source.channels + self.channel) * plane;
                let from = self.source.values[plane_at..][..plane].as_ptr();
                for row in 0..rows {
                    let (from, to) = (from.add(row * columns), self.to.add(self.lead + self.line.at(image, row)));
                    let mut x = 0;
                    while x < columns {
                        let n = columns - x;
                        S::store_first(to.add(x), n, activate::<S>(S::load_first(from.add(x), n), slope));
                        x += S::LANES;
                    }
                }
            }
        }
    }
}
