//! Black and white levels, and what a file's black has beyond four places of a cell: larger tables, and steps a row or a column.
//!
//! DNG specification 1.6, chapter 5: black at a pixel is the table `BlackLevel`, repeated from the active area's first pixel, and its row's
//! `BlackLevelDeltaV` and column's `BlackLevelDeltaH`; values run to 1 over white less the *largest* black of the sample plane.

use isoplanat_base::error::Result;
use ndarray::ArrayViewMut2;
use rawler::rawimage::{RawImage, RawImageData};
use std::path::Path;

use super::{ALLOWED, bad};

/// Black, white and steps are within: their sums and differences stay numbers, and a sample has no more bits.
const LEVELS: std::ops::RangeInclusive<f32> = -4_294_967_296.0..=4_294_967_296.0;

/// Levels of a file.
pub(super) struct Levels {
    /// As [`super::RawCapture::black`]; the mean of what is to be flattened.
    pub(super) black: [f32; 4],
    /// As [`super::RawCapture::white`].
    pub(super) white: [f32; 4],
    /// The black that `black` does not hold.
    black_of_pixels: Option<BlackOfPixels>,
}

/// Black of every pixel of the active area.
struct BlackOfPixels {
    table: Table,
    /// Added in each row; empty for none.
    of_rows: Vec<f32>,
    /// Added in each column.
    of_columns: Vec<f32>,
}

/// A table that repeats.
struct Table {
    rows: usize,
    columns: usize,
    planes: usize,
    levels: Vec<f32>,
    /// Where the active area starts in it.
    first: (usize, usize),
}

impl Table {
    fn at(&self, row: usize, column: usize, plane: usize) -> f32 {
        let (r, c) = ((self.first.0 + row) % self.rows, (self.first.1 + column) % self.columns);
        self.levels[(r * self.columns + c) * self.planes + plane.min(self.planes - 1)]
    }

    /// Whether the four places of a cell hold all of it, or of a colour picture one place.
    fn is_simple(&self, cell: usize) -> bool {
        cell.is_multiple_of(self.rows) && cell.is_multiple_of(self.columns)
    }
}

/// What a DNG adds to its table of black levels, by row and column of the active area.
#[derive(Default)]
pub(super) struct Deltas {
    pub(super) of_rows: Vec<f32>,
    pub(super) of_columns: Vec<f32>,
}

impl Levels {
    /// The levels of an image whose active area, of `size`, starts at `first` of the table of black levels. `deltas` are a DNG's.
    ///
    /// # Errors
    /// Levels that contradict each other.
    pub(super) fn of(
        path: &Path,
        image: &RawImage,
        first: (usize, usize),
        size: (usize, usize),
        deltas: Option<Deltas>,
    ) -> Result<Self> {
        let dng = deltas.is_some();
        let Deltas { of_rows, of_columns } = deltas.unwrap_or_default();
        let found = &image.blacklevel;
        let table =
            Table { rows: found.height, columns: found.width, planes: found.cpp, levels: found.as_vec(), first };
        let entries = table.rows.checked_mul(table.columns).and_then(|n| n.checked_mul(table.planes));
        if table.levels.is_empty() || entries != Some(table.levels.len()) {
            return Err(bad(path, "a table of black levels of the wrong size", ALLOWED));
        }
        let white_levels = image.whitelevel.as_vec();
        let Some(&first_white) = white_levels.first() else {
            return Err(bad(path, "no white level", ALLOWED));
        };
        let all = table.levels.iter().chain(&of_rows).chain(&of_columns).chain(&white_levels);
        if let Some(level) = all.copied().find(|level| !LEVELS.contains(level)) {
            return Err(bad(path, format!("a level of {level}"), "levels within those of 32 bits"));
        }
        // Samples of 16 bits would never reach it: the picture would be black.
        let whole = matches!(image.data, RawImageData::Integer(_));
        if let Some(white) = white_levels.iter().find(|white| whole && **white > f32::from(u16::MAX)) {
            return Err(bad(
                path,
                format!("white level {white}"),
                "levels in digital numbers, as the sensor gave them",
            ));
        }
        let colours = image.cpp == 3;
        let cell = if colours { 1 } else { 2 };
        let pixels = BlackOfPixels { table, of_rows, of_columns };
        let (mut black, mut white) = ([0.0; 4], [0.0; 4]);
        for i in 0..4 {
            let (place, plane) = if colours { ((0, 0), i.min(2)) } else { ((i / 2, i % 2), 0) };
            black[i] = pixels.mean(place, cell, size, plane);
            white[i] = if colours {
                white_levels.get(plane).copied().unwrap_or(first_white)
            } else if white_levels.len() == 4 {
                white_levels[((first.0 + place.0) % 2) * 2 + (first.1 + place.1) % 2]
            } else {
                first_white
            };
            let top = if dng { pixels.largest(size, plane) } else { black[i] };
            if !(black[i].is_finite() && white[i].is_finite() && white[i] > top) {
                let found = format!("black level {top} and white level {}", white[i]);
                return Err(bad(path, found, "black below white"));
            }
            white[i] -= top - black[i];
            // Rounded: of levels that large a step of one is none.
            if white[i] <= black[i] {
                return Err(bad(
                    path,
                    format!("black level {top} next to white level {}", white[i]),
                    "black below white",
                ));
            }
        }
        let flat = pixels.of_rows.iter().chain(&pixels.of_columns).all(|v| *v == 0.0);
        let black_of_pixels = (!(flat && pixels.table.is_simple(cell))).then_some(pixels);
        Ok(Self { black, white, black_of_pixels })
    }

    /// Takes off what the black of each pixel of a plane is above [`Self::black`], in place.
    pub(super) fn flatten(&self, mut samples: ArrayViewMut2<'_, f32>, colour: Option<usize>) {
        let Some(pixels) = &self.black_of_pixels else { return };
        for (r, mut row) in samples.outer_iter_mut().enumerate() {
            for (c, v) in row.iter_mut().enumerate() {
                let mean = self.black[colour.unwrap_or((r & 1) * 2 + (c & 1))];
                *v -= pixels.at(r, c, colour.unwrap_or(0)) - mean;
            }
        }
    }
}

impl BlackOfPixels {
    fn at(&self, row: usize, column: usize, plane: usize) -> f32 {
        let of = |list: &[f32], k: usize| list.get(k).copied().unwrap_or(0.0);
        self.table.at(row, column, plane) + of(&self.of_rows, row) + of(&self.of_columns, column)
    }

    /// Mean over the pixels at `place` of cells of `cell` × `cell` pixels.
    fn mean(&self, place: (usize, usize), cell: usize, (rows, columns): (usize, usize), plane: usize) -> f32 {
        // Table, rows and columns add, so that their means do; where an area is too small to have the place, the place as if it went on.
        let along = |first: usize, n: usize| (first..n.max(first + 1)).step_by(cell);
        let mean = |list: &[f32], first: usize, n: usize| {
            let sum: f64 = along(first, n).map(|k| f64::from(list.get(k).copied().unwrap_or(0.0))).sum();
            sum / along(first, n).count() as f64
        };
        let shares = |first: usize, n: usize, start: usize, period: usize| {
            let mut counts = vec![0usize; period];
            along(first, n).for_each(|k| counts[(start + k) % period] += 1);
            let all = along(first, n).count() as f64;
            counts.into_iter().map(move |count| count as f64 / all).collect::<Vec<_>>()
        };
        let t = &self.table;
        let of_rows = shares(place.0, rows, 0, t.rows);
        let of_columns = shares(place.1, columns, 0, t.columns);
        let mut sum = 0.0;
        for (r, a) in of_rows.iter().enumerate() {
            for (c, b) in of_columns.iter().enumerate() {
                sum += a * b * f64::from(t.at(r, c, plane));
            }
        }
        (sum + mean(&self.of_rows, place.0, rows) + mean(&self.of_columns, place.1, columns)) as f32
    }

    /// The largest black of a plane.
    fn largest(&self, (rows, columns): (usize, usize), plane: usize) -> f32 {
        let tops = |list: &[f32], n: usize, period: usize| {
            let mut tops = vec![f32::NEG_INFINITY; period];
            for k in 0..n {
                tops[k % period] = tops[k % period].max(list.get(k).copied().unwrap_or(0.0));
            }
            tops
        };
        let of_rows = tops(&self.of_rows, rows, self.table.rows);
        let of_columns = tops(&self.of_columns, columns, self.table.columns);
        let mut top = f32::NEG_INFINITY;
        for (r, a) in of_rows.iter().enumerate() {
            for (c, b) in of_columns.iter().enumerate() {
                top = top.max(self.table.at(r, c, plane) + a + b);
            }
        }
        top
    }
}
