//! One output written by several threads: each has columns of its own of a matrix.
#![expect(unsafe_code, reason = "columns of one matrix as mutable slices; see each Safety note")]

use std::marker::PhantomData;

use isoplanat_base::math::raster::parts;

/// Some columns of a matrix, which nobody else has.
pub(super) struct Panel<'a> {
    first: *mut f32,
    stride: usize,
    rows: usize,
    width: usize,
    matrix: PhantomData<&'a mut [f32]>,
}

// SAFETY: a panel is the only way to its columns for as long as it lives, like a mutable slice.
unsafe impl Send for Panel<'_> {}

impl<'a> Panel<'a> {
    /// All of a matrix of rows of `columns` values.
    ///
    /// # Panics
    /// If `matrix` is no whole rows.
    pub(super) fn whole(matrix: &'a mut [f32], columns: usize) -> Self {
        assert!(columns > 0 && matrix.len().is_multiple_of(columns), "{} values, {columns} a row", matrix.len());
        let rows = matrix.len() / columns;
        Self { first: matrix.as_mut_ptr(), stride: columns, rows, width: columns, matrix: PhantomData }
    }

    /// A matrix of rows of `columns` values in panels of `width` columns, the last one narrower where they do not divide.
    pub(super) fn cut(matrix: &'a mut [f32], columns: usize, width: usize) -> impl Iterator<Item = Self> {
        let width = width.max(1);
        Self::cut_at(matrix, columns, parts(columns, width).map(|part| part.len()))
    }

    /// A matrix in panels of these widths; those beyond the last column are empty.
    pub(super) fn cut_at(
        matrix: &'a mut [f32],
        columns: usize,
        widths: impl Iterator<Item = usize>,
    ) -> impl Iterator<Item = Self> {
        let Self { first, stride, rows, .. } = Self::whole(matrix, columns);
        let mut used = 0;
        widths.map(move |width| {
            let (at, width) = (used, width.min(columns - used));
            used += width;
            Self { first: first.wrapping_add(at), stride, rows, width, matrix: PhantomData }
        })
    }

    /// The panel's part of a row.
    ///
    /// # Panics
    /// If there is no such row.
    #[inline(always)]
    pub(super) fn row(&mut self, row: usize) -> &mut [f32] {
        assert!(row < self.rows, "row {row} of {}", self.rows);
        // SAFETY: the row lies in the matrix, which is borrowed for as long as the panel lives; no other panel has these
        // columns, and `self` is borrowed with the slice.
        unsafe { std::slice::from_raw_parts_mut(self.first.add(row * self.stride), self.width) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panels_are_the_matrix_in_parts() {
        let mut matrix = [0.0; 21];
        for (i, mut panel) in Panel::cut(&mut matrix, 7, 3).enumerate() {
            (0..3).for_each(|row| panel.row(row).fill((10 * row + i) as f32));
        }
        let row = |r: f32| [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 2.0].map(|i| 10.0 * r + i);
        assert_eq!(matrix.as_chunks::<7>().0, [row(0.0), row(1.0), row(2.0)]);
        let widths: Vec<usize> =
            Panel::cut_at(&mut matrix, 7, [2, 9, 1].into_iter()).map(|mut p| p.row(2).len()).collect();
        assert_eq!(widths, [2, 5, 0]);
    }

    #[test]
    #[should_panic(expected = "row 3 of 3")]
    fn a_panel_ends_with_its_matrix() {
        Panel::whole(&mut [0.0; 21], 7).row(3);
    }
}
