//! Where PSFs stand: a raster of nodes whose hat windows are a partition of unity over the source.

use super::warp::Region;

/// Nodes on pixel centres, `spacing` pixels apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeRaster {
    /// Row of the first node's pixel.
    pub row: isize,
    /// Column of the first node's pixel.
    pub col: isize,
    /// Distance between nodes, pixels.
    pub spacing: usize,
    /// Nodes down.
    pub rows: usize,
    /// Nodes across.
    pub cols: usize,
}

impl NodeRaster {
    /// The smallest raster whose windows sum to one over `source`.
    pub fn over(source: Region, spacing: usize) -> Self {
        let spacing = spacing.max(1);
        let count = |n: usize| n.saturating_sub(1).div_ceil(spacing) + 1;
        Self { row: source.row, col: source.col, spacing, rows: count(source.rows), cols: count(source.cols) }
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.rows * self.cols
    }

    /// Whether there is no node.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Pixel `(row, column)` of node `n`.
    pub fn pixel(&self, n: usize) -> (isize, isize) {
        let step = |k: usize| (k * self.spacing).cast_signed();
        (self.row + step(n / self.cols), self.col + step(n % self.cols))
    }

    /// The pixel of node `n` as a one-pixel region.
    pub fn region(&self, n: usize) -> Region {
        let (row, col) = self.pixel(n);
        Region { row, col, rows: 1, cols: 1 }
    }

    /// Part of `source` inside the open window of node `n`: first row, rows, first column, columns, relative to it.
    pub fn support(&self, n: usize, source: Region) -> Option<(usize, usize, usize, usize)> {
        let (row, col) = self.pixel(n);
        let reach = self.spacing.cast_signed() - 1;
        let span = |centre: isize, start: isize, len: usize| {
            let first = (centre - reach - start).max(0);
            let last = (centre + reach - start).min(len.cast_signed() - 1);
            (last >= first).then(|| (first.unsigned_abs(), (last - first + 1).unsigned_abs()))
        };
        let (r, nr) = span(row, source.row, source.rows)?;
        let (c, nc) = span(col, source.col, source.cols)?;
        Some((r, nr, c, nc))
    }

    /// One axis of the window: `1 − |distance|/spacing`.
    #[inline]
    #[expect(clippy::cast_precision_loss, reason = "pixel distances")]
    pub fn hat(&self, distance: isize) -> f64 {
        (1.0 - distance.unsigned_abs() as f64 / self.spacing as f64).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_sum_to_one_over_the_source() {
        for (rows, cols, spacing) in [(37, 50, 16), (1, 1, 8), (64, 65, 64), (5, 9, 1)] {
            let source = Region { row: -3, col: 7, rows, cols };
            let raster = NodeRaster::over(source, spacing);
            for i in 0..rows {
                for j in 0..cols {
                    let mut sum = 0.0;
                    for n in 0..raster.len() {
                        let (r, c) = raster.pixel(n);
                        let at = (source.row + i.cast_signed() - r, source.col + j.cast_signed() - c);
                        let w = raster.hat(at.0) * raster.hat(at.1);
                        if w > 0.0 {
                            let (r0, nr, c0, nc) = raster.support(n, source).expect("touches");
                            assert!((r0..r0 + nr).contains(&i) && (c0..c0 + nc).contains(&j));
                        }
                        sum += w;
                    }
                    assert!((sum - 1.0).abs() < 1e-12, "{sum} at {i},{j}");
                }
            }
        }
    }
}
