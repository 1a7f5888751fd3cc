//! Blocks along one axis: cut at every knot, and every so many pixels from it.

use crate::render::node_grid::NodeGrid;
use isoplanat_base::math::real::Real;

/// A run of pixels between two knots (or beyond the ends), and the windows over it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Segment<T> {
    /// First pixel.
    pub start: isize,
    /// Pixels.
    pub len: usize,
    /// Number of knots at or before it: segments of one cell have the same.
    pub cell: usize,
    /// Knots whose windows reach it (one or two), each with its window at every pixel.
    pub windows: Vec<(usize, Vec<T>)>,
}

/// Segments of at most `block` pixels over the pixels `from..to`, in order.
///
/// The cuts do not depend on `from` and `to`, so that two regions share their blocks.
pub(super) fn segments<T: Real>(knots: &[isize], block: usize, from: isize, to: isize) -> Vec<Segment<T>> {
    let block = block.clamp(1, isize::MAX.unsigned_abs()).cast_signed();
    let mut all = Vec::new();
    let mut at = from;
    while at < to {
        let cell = knots.partition_point(|k| *k <= at);
        // Before the first knot the cuts run backwards from it.
        let anchor = knots[cell.saturating_sub(1)];
        let mut end = anchor.saturating_add((at - anchor).div_euclid(block).saturating_add(1).saturating_mul(block));
        if let Some(next) = knots.get(cell) {
            end = end.min(*next);
        }
        let end = end.min(to);
        all.push(segment(knots, cell, at, (end - at).unsigned_abs()));
        at = end;
    }
    all
}

fn segment<T: Real>(knots: &[isize], cell: usize, start: isize, len: usize) -> Segment<T> {
    let between: Vec<_> = (0..len).map(|i| NodeGrid::between(knots, start + i.cast_signed())).collect();
    let mut windows = Vec::new();
    if let Some(b) = between.first() {
        windows.push((b.first, between.iter().map(|b| T::real(1.0 - b.weight)).collect()));
        // A window that is zero all over (one pixel, on the knot) is left out.
        if b.second != b.first && between.iter().any(|b| b.weight != 0.0) {
            windows.push((b.second, between.iter().map(|b| T::real(b.weight)).collect()));
        }
    }
    Segment { start, len, cell, windows }
}

/// The knots that the segments use, increasing.
pub(super) fn used<'a, T: 'a>(segments: impl IntoIterator<Item = &'a Segment<T>>) -> Vec<usize> {
    let mut all: Vec<usize> = segments.into_iter().flat_map(|s| s.windows.iter().map(|w| w.0)).collect();
    all.sort_unstable();
    all.dedup();
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_are_cut_at_knots_and_hold_the_windows() {
        for (knots, block) in [(vec![0, 10, 13], 4), (vec![5], 7), (vec![-3, 40], 1000), (vec![0, 1, 2], 1)] {
            let all: Vec<Segment<f64>> = segments(&knots, block, -9, 47);
            assert_eq!(all.iter().map(|s| s.len).sum::<usize>(), 56);
            let mut at = -9;
            for s in &all {
                assert!(s.start == at && s.len <= block && s.len > 0);
                at += s.len.cast_signed();
                assert!(knots.iter().all(|k| *k <= s.start || *k >= at), "no knot inside");
                for i in 0..s.len {
                    let b = NodeGrid::between(&knots, s.start + i.cast_signed());
                    let of = |n: usize| s.windows.iter().find(|w| w.0 == n).map_or(0.0, |w| w.1[i]);
                    let expected = |n: usize| {
                        f64::from(u8::from(n == b.first)) * (1.0 - b.weight)
                            + f64::from(u8::from(n == b.second)) * b.weight
                    };
                    assert!((0..knots.len()).all(|n| of(n) == expected(n)));
                }
            }
        }
    }

    #[test]
    fn cuts_do_not_depend_on_the_region() {
        let knots = [0, 10, 33];
        let ends = |from: isize, to: isize| -> Vec<isize> {
            segments::<f32>(&knots, 4, from, to).iter().map(|s| s.start).skip(1).collect()
        };
        let whole = ends(-50, 60);
        let part = ends(-17, 30);
        assert!(!part.is_empty() && part.iter().all(|c| whole.contains(c)));
        assert_eq!(part.len(), whole.iter().filter(|c| (-16..30).contains(*c)).count());
    }
}
