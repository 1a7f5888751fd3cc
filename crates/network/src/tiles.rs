//! Pictures too large for one pass: overlapping tiles, and reflection to the network's multiple.

use ndarray::{Array4, ArrayView4, s};

use isoplanat_base::error::Result;

/// Applies `run` (which keeps rows and columns) to tiles of `tile` pixels with `margin` pixels of surroundings, clipped at the
/// picture's border, and puts the tiles' cores together.
///
/// With `tile` and `margin` multiples of the network's multiple and `margin` at least its receptive radius, the result
/// is that of the whole picture.
pub(super) fn forward_tiled(
    input: ArrayView4<f32>,
    tile: usize,
    margin: usize,
    run: impl Fn(ArrayView4<f32>) -> Result<Array4<f32>>,
) -> Result<Array4<f32>> {
    let (batch, _, rows, columns) = input.dim();
    let mut output = Array4::zeros((0, 0, 0, 0));
    for row in (0..rows).step_by(tile) {
        for column in (0..columns).step_by(tile) {
            let (row_end, column_end) = ((row + tile).min(rows), (column + tile).min(columns));
            let (top, left) = (row.saturating_sub(margin), column.saturating_sub(margin));
            let (bottom, right) = ((row_end + margin).min(rows), (column_end + margin).min(columns));
            let done = run(input.slice(s![.., .., top..bottom, left..right]))?;
            if output.is_empty() {
                output = Array4::zeros((batch, done.dim().1, rows, columns));
            }
            output.slice_mut(s![.., .., row..row_end, column..column_end]).assign(&done.slice(s![
                ..,
                ..,
                row - top..row_end - top,
                column - left..column_end - left
            ]));
        }
    }
    Ok(output)
}

/// Continues the picture below and to the right to the next multiple of `multiple`, mirrored at the last row and column
/// (which are not repeated); a picture of one row or column is repeated.
pub(super) fn reflect_to_multiple(input: ArrayView4<f32>, multiple: usize) -> Array4<f32> {
    let (batch, channels, rows, columns) = input.dim();
    let shape = (batch, channels, rows.next_multiple_of(multiple), columns.next_multiple_of(multiple));
    Array4::from_shape_fn(shape, |(b, c, row, column)| input[[b, c, mirror(row, rows), mirror(column, columns)]])
}

/// `index` folded into `0..n` by mirroring at both ends.
fn mirror(index: usize, n: usize) -> usize {
    if n <= 1 {
        return 0;
    }
    let period = 2 * (n - 1);
    let index = index % period;
    index.min(period - index)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflection_mirrors_without_repeating_the_border() {
        let input = Array4::from_shape_fn((1, 1, 3, 2), |(_, _, r, c)| (10 * r + c) as f32);
        let out = reflect_to_multiple(input.view(), 4);
        assert_eq!(out.dim(), (1, 1, 4, 4));
        assert_eq!(out.slice(s![0, 0, 3, ..]).to_vec(), [10.0, 11.0, 10.0, 11.0]);
        let one = Array4::from_elem((1, 1, 1, 1), 5.0f32);
        assert!(reflect_to_multiple(one.view(), 4).iter().all(|&v| v == 5.0));
    }

    #[test]
    fn tiles_of_a_pointwise_function_cover_everything_once() {
        let input = Array4::from_shape_fn((2, 3, 10, 13), |(b, c, r, w)| (b + 2 * c + 5 * r + 7 * w) as f32);
        let out = forward_tiled(input.view(), 4, 2, |w| Ok(w.mapv(|v| 2.0 * v))).expect("no errors");
        assert_eq!(out, input.mapv(|v| 2.0 * v));
    }
}
