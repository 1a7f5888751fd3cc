//! Rows and columns of a raster: mirrored beyond its border, cut into parts.

use std::ops::Range;

/// Index `i` mirrored into `0..n` about the first and last sample, which are not repeated.
#[inline]
pub fn mirrored(i: isize, n: usize) -> usize {
    let last = n.cast_signed() - 1;
    if last <= 0 {
        return 0;
    }
    let folded = i.rem_euclid(2 * last);
    folded.min(2 * last - folded).unsigned_abs()
}

/// `0..n` in parts of `most` each, the last one shorter where they do not divide.
///
/// # Panics
/// If `most` is 0.
#[inline]
pub fn parts(n: usize, most: usize) -> impl Iterator<Item = Range<usize>> {
    (0..n).step_by(most).map(move |first| first..n.min(first + most))
}

/// `part` with `margin` more on both sides, as far as `0..n` reaches.
pub fn grown(part: &Range<usize>, margin: usize, n: usize) -> Range<usize> {
    part.start.saturating_sub(margin)..n.min(part.end + margin)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Forwards, backwards, forwards: the ends stand once at each turn.
    #[test]
    fn mirroring_does_not_repeat_the_border() {
        let row: Vec<usize> = (-4..9).map(|i| mirrored(i, 4)).collect();
        assert_eq!(row, [2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1, 2]);
        assert!((-9..9).all(|i| mirrored(i, 1) == 0 && mirrored(i, 2) == i.rem_euclid(2).unsigned_abs()));
    }

    /// Everything once, in order.
    #[test]
    fn parts_cover_everything_once() {
        assert_eq!(parts(10, 4).collect::<Vec<_>>(), [0..4, 4..8, 8..10]);
        assert_eq!([parts(8, 4).count(), parts(0, 4).count(), parts(3, 9).count()], [2, 0, 1]);
        assert_eq!([grown(&(4..8), 3, 10), grown(&(0..4), 3, 10), grown(&(8..10), 0, 10)], [1..10, 0..7, 8..10]);
    }
}
