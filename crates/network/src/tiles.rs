//! Pictures too large for one pass: overlapping tiles, and reflection to the network's multiple.

use std::ops::Range;

use ndarray::{Array4, ArrayView4, s};

use isoplanat_base::error::Result;
use isoplanat_base::math::raster::{grown, mirrored, parts};

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
    for row in parts(rows, tile) {
        for column in parts(columns, tile) {
            let (high, wide) = (grown(&row, margin, rows), grown(&column, margin, columns));
            let done = run(input.slice(s![.., .., high.clone(), wide.clone()]))?;
            if output.is_empty() {
                output = Array4::zeros((batch, done.dim().1, rows, columns));
            }
            let within = |core: &Range<usize>, all: Range<usize>| core.start - all.start..core.end - all.start;
            let core = done.slice(s![.., .., within(&row, high), within(&column, wide)]);
            output.slice_mut(s![.., .., row.clone(), column]).assign(&core);
        }
    }
    Ok(output)
}

/// Continues the picture below and to the right to the next multiple of `multiple`, mirrored at the last row and column
/// (which are not repeated); a picture of one row or column is repeated.
pub(super) fn reflect_to_multiple(input: ArrayView4<f32>, multiple: usize) -> Array4<f32> {
    let (batch, channels, rows, columns) = input.dim();
    let shape = (batch, channels, rows.next_multiple_of(multiple), columns.next_multiple_of(multiple));
    let from = |i: usize, n: usize| mirrored(i.cast_signed(), n);
    Array4::from_shape_fn(shape, |(b, c, row, column)| input[[b, c, from(row, rows), from(column, columns)]])
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
