//! Samples of one colour inside a region: their places, their values, and which of them are no numbers.

use ndarray::ArrayView2;

use crate::sensor::cfa::Cfa;
use isoplanat_base::error::{Error, Result};

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Rectangle {
    /// First column.
    pub x: usize,
    /// First row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Rectangle {
    /// All of a plane of this many rows and columns.
    pub fn whole((height, width): (usize, usize)) -> Self {
        Self { x: 0, y: 0, width, height }
    }

    /// Place of the centre, `[x, y]` in pixels.
    pub fn centre(self) -> [f64; 2] {
        let middle = |from: usize, size: usize| from as f64 + 0.5 * (size as f64 - 1.0);
        [middle(self.x, self.width), middle(self.y, self.height)]
    }

    /// Refuses what does not lie inside a plane of this many rows and columns, and what is smaller than `least` a side.
    pub(super) fn check(self, (rows, columns): (usize, usize), least: usize) -> Result<()> {
        let inside = |from: usize, size: usize, all: usize| from.checked_add(size).is_some_and(|end| end <= all);
        let Self { x, y, width, height } = self;
        if !inside(x, width, columns) || !inside(y, height, rows) || width < least || height < least {
            let allowed = format!("at least {least} x {least} pixels inside the picture of {columns} x {rows}");
            return Err(Error::bad("", "region", format!("x {x}, y {y}, {width} x {height} pixels"), allowed));
        }
        Ok(())
    }
}

/// The pixels of a plane that belong to one colour, by their places in the 2 × 2 cell of the first pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sites([bool; 4]);

impl Sites {
    /// Every pixel.
    pub const ALL: Self = Self([true; 4]);

    /// Those that see `channel` (0 = R, 1 = G, 2 = B) behind `cfa`.
    pub fn from_cfa(cfa: Cfa, channel: usize) -> Self {
        Self(std::array::from_fn(|i| cfa.channel(i / 2, i % 2) == channel))
    }

    /// Whether the pixel at `row`, `column` counts.
    pub fn has(self, row: usize, column: usize) -> bool {
        self.0[(row & 1) * 2 + (column & 1)]
    }

    /// Share of all pixels that count.
    pub(super) fn share(self) -> f64 {
        self.0.iter().filter(|v| **v).count() as f64 / 4.0
    }
}

/// One pixel: its place and its value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) value: f64,
}

/// The samples of `region` that count, row by row.
///
/// # Errors
/// A value that is not finite.
pub(super) fn collect<T: Copy + Into<f64>>(
    plane: ArrayView2<'_, T>,
    sites: Sites,
    region: Rectangle,
) -> Result<Vec<Sample>> {
    let mut out = Vec::with_capacity(region.width * region.height);
    for row in region.y..region.y + region.height {
        for column in (region.x..region.x + region.width).filter(|c| sites.has(row, *c)) {
            let value: f64 = plane[[row, column]].into();
            if !value.is_finite() {
                let place = format!("pixel at column {column}, row {row}");
                return Err(Error::bad("", place, value.to_string(), "finite values"));
            }
            out.push(Sample { x: column as f64, y: row as f64, value });
        }
    }
    Ok(out)
}

/// Means over square cells of as many pixels a side as leave at most about `most` of them; the cells' side too.
pub(super) fn thinned(samples: &[Sample], region: Rectangle, most: usize) -> (Vec<Sample>, usize) {
    let side = ((samples.len() as f64 / most as f64).sqrt().ceil() as usize).max(1);
    if side == 1 {
        return (samples.to_vec(), 1);
    }
    let columns = region.width.div_ceil(side);
    let mut cells = vec![[0.0; 4]; columns * region.height.div_ceil(side)];
    for s in samples {
        let (column, row) = (s.x as usize - region.x, s.y as usize - region.y);
        let cell = &mut cells[row / side * columns + column / side];
        for (sum, v) in cell.iter_mut().zip([1.0, s.x, s.y, s.value]) {
            *sum += v;
        }
    }
    // Cells that the border cuts have other noise than the rest; they are few.
    let mean = |[n, x, y, v]: [f64; 4]| Sample { x: x / n, y: y / n, value: v / n };
    (cells.into_iter().filter(|c| c[0] > 0.0).map(mean).collect(), side)
}
