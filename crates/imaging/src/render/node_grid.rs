//! Where PSFs stand: nodes on a rectangular grid of free spacing, with windows that are a partition of unity.
//!
//! Along each axis the window of a node falls linearly to nothing at its neighbours (a hat of two different sides);
//! beyond the first and the last node it stays one. A node's window is the product of both. With one node along an
//! axis the window does not vary there: the PSF is constant.

use crate::plane::Region;

/// Nodes on pixel centres; node `n` stands at row knot `n / cols`, column knot `n % cols`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeGrid {
    /// Pixel rows of the nodes, increasing.
    pub row_knots: Vec<isize>,
    /// Pixel columns of the nodes, increasing.
    pub col_knots: Vec<isize>,
}

/// The one or two nodes along an axis whose windows reach a pixel, and the weight of the second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Between {
    /// The node before (or the only one).
    pub first: usize,
    /// The node behind; equal to `first` beyond the ends.
    pub second: usize,
    /// Weight of `second`, 0 to 1; `first` has the rest.
    pub weight: f64,
}

impl Between {
    /// Weight of node `k` here; 0 if its window does not reach.
    pub(crate) fn of(self, k: usize) -> f64 {
        if self.first == k {
            1.0 - self.weight
        } else if self.second == k {
            self.weight
        } else {
            0.0
        }
    }
}

impl NodeGrid {
    /// Nodes every `spacing` pixels over `source`, the first on its first pixel.
    pub fn uniform(source: Region, spacing: usize) -> Self {
        let spacing = spacing.max(1);
        let knots = |first: isize, n: usize| {
            (0..n.saturating_sub(1).div_ceil(spacing) + 1).map(|k| first + (k * spacing).cast_signed()).collect()
        };
        Self { row_knots: knots(source.row, source.rows), col_knots: knots(source.col, source.cols) }
    }

    /// One node, at the pixel `(row, col)`.
    pub fn single(row: isize, col: isize) -> Self {
        Self { row_knots: vec![row], col_knots: vec![col] }
    }

    /// The nodes whose windows reach `region`.
    #[must_use]
    pub fn part(&self, region: Region) -> Self {
        let around = |knots: &[isize], first: isize, count: usize| {
            let last = first + count.max(1).cast_signed() - 1;
            let (a, b) = (Self::between(knots, first), Self::between(knots, last));
            knots[a.first..=b.second].to_vec()
        };
        Self {
            row_knots: around(&self.row_knots, region.row, region.rows),
            col_knots: around(&self.col_knots, region.col, region.cols),
        }
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.row_knots.len() * self.col_knots.len()
    }

    /// Whether there is no node.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Pixel `(row, column)` of node `n`.
    pub fn pixel(&self, n: usize) -> (isize, isize) {
        (self.row_knots[n / self.col_knots.len()], self.col_knots[n % self.col_knots.len()])
    }

    /// The nodes along `knots` whose windows reach `at`.
    ///
    /// # Panics
    /// If there is no knot.
    #[expect(clippy::cast_precision_loss, reason = "pixel distances")]
    pub(crate) fn between(knots: &[isize], at: isize) -> Between {
        let after = knots.partition_point(|k| *k <= at);
        if after == 0 {
            return Between { first: 0, second: 0, weight: 0.0 };
        }
        if after == knots.len() {
            return Between { first: after - 1, second: after - 1, weight: 0.0 };
        }
        let (a, b) = (knots[after - 1], knots[after]);
        Between { first: after - 1, second: after, weight: (at - a) as f64 / (b - a) as f64 }
    }

    /// Window of node `n` at the pixel `(row, col)`.
    pub(crate) fn window(&self, n: usize, row: isize, col: isize) -> f64 {
        let along = |knots: &[isize], k: usize, at: isize| Self::between(knots, at).of(k);
        along(&self.row_knots, n / self.col_knots.len(), row) * along(&self.col_knots, n % self.col_knots.len(), col)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_sum_to_one_everywhere() {
        let grids = [
            NodeGrid { row_knots: vec![-4, 0, 16, 20], col_knots: vec![3, 4, 50] },
            NodeGrid::single(7, -3),
            NodeGrid::uniform(Region { row: -3, col: 5, rows: 33, cols: 1 }, 8),
        ];
        for grid in grids {
            for (row, col) in (-10..40).flat_map(|r| (-10..60).map(move |c| (r, c))) {
                let windows: Vec<f64> = (0..grid.len()).map(|n| grid.window(n, row, col)).collect();
                assert!((windows.iter().sum::<f64>() - 1.0).abs() < 1e-15);
                assert!(windows.iter().all(|w| (0.0..=1.0).contains(w)));
            }
            for n in 0..grid.len() {
                let (row, col) = grid.pixel(n);
                assert_eq!(grid.window(n, row, col), 1.0);
            }
        }
    }

    #[test]
    fn a_uniform_grid_covers_its_source() {
        let grid = NodeGrid::uniform(Region { row: 0, col: 0, rows: 65, cols: 64 }, 16);
        assert_eq!(grid.row_knots, [0, 16, 32, 48, 64]);
        assert_eq!(grid.col_knots, [0, 16, 32, 48, 64]);
    }
}
