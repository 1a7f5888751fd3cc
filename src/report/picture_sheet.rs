//! A sheet of pictures in rows, with the name of each column above it.

use font8x8::UnicodeFonts;
use ndarray::{Array3, s};

/// Between pictures, and around letters, pixels.
const GAP: usize = 6;

/// Side of a letter, pixels; twice that above wide pictures.
const LETTER: usize = 8;

/// Columns from which letters are twice as large, pixels.
const WIDE: usize = 160;

/// Level of letters on white.
const INK: f32 = 0.05;

/// Rows of pictures of one size, linear RGB `[3, row, col]`, on white, below the names of their columns. Letters that a column has no room for are left out.
///
/// # Panics
/// Without pictures, or with pictures of several sizes.
pub(crate) fn picture_sheet(columns: &[&str], rows: &[Vec<Array3<f32>>]) -> Array3<f32> {
    let (channels, height, width) = rows[0][0].dim();
    let scale = if width >= WIDE { 2 } else { 1 };
    let top = scale * LETTER + 2 * GAP;
    let mut sheet =
        Array3::ones((channels, top + rows.len() * (height + GAP) - GAP, columns.len() * (width + GAP) - GAP));
    for (k, name) in columns.iter().enumerate() {
        let fitting = name.chars().take(width / (scale * LETTER));
        for (n, letter) in fitting.enumerate() {
            write(&mut sheet, letter, [GAP, k * (width + GAP) + n * scale * LETTER], scale);
        }
    }
    for (i, row) in rows.iter().enumerate() {
        for (k, picture) in row.iter().enumerate() {
            let (r, c) = (top + i * (height + GAP), k * (width + GAP));
            sheet.slice_mut(s![.., r..r + height, c..c + width]).assign(picture);
        }
    }
    sheet
}

/// A letter whose upper left corner is at `[row, col]`.
fn write(sheet: &mut Array3<f32>, letter: char, [row, col]: [usize; 2], scale: usize) {
    let Some(lines) = font8x8::BASIC_FONTS.get(letter) else { return };
    for (i, line) in lines.into_iter().enumerate() {
        for j in (0..LETTER).filter(|j| line >> j & 1 == 1) {
            let (r, c) = (row + scale * i, col + scale * j);
            sheet.slice_mut(s![.., r..r + scale, c..c + scale]).fill(INK);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each picture lies whole below its name, and a name that is longer than its column stays in it.
    #[test]
    fn pictures_stand_below_their_names() {
        for width in [16, 40, 200] {
            let row = |k: usize| {
                vec![Array3::from_elem((3, 12, width), 0.2 * k as f32), Array3::from_elem((3, 12, width), 0.5)]
            };
            let sheet = picture_sheet(&["a long name indeed, longer than any column is wide", "l"], &[row(1), row(2)]);
            let (_, rows, cols) = sheet.dim();
            let top = rows - 2 * 12 - GAP;
            assert_eq!(cols, 2 * width + GAP);
            for (i, level) in [(0, 0.2), (1, 0.4)] {
                let at = top + i * (12 + GAP);
                assert!(sheet.slice(s![.., at..at + 12, ..width]).iter().all(|v| (*v - level).abs() < 1e-6));
                assert!(sheet.slice(s![.., at..at + 12, width + GAP..]).iter().all(|v| *v == 0.5));
            }
            let inked =
                |from: usize, to: usize| sheet.slice(s![0, ..top, from..to]).iter().filter(|v| **v == INK).count();
            assert!(inked(0, width) > 10 && inked(width, width + GAP) == 0 && inked(width + GAP, cols) > 5, "{width}");
        }
    }
}
