//! Largest of each 2×2 block of an activated picture, and its cotangent, which goes to the first largest value. NaN counts
//! as the largest.

use rayon::prelude::*;

use super::inner::{load_pairs, store_pairs};
use super::strip::{activate, filled, pull};
use super::{Extent, Level, Source, SourceBar, recycle};
use isoplanat_base::math::simd::{Kernel, Simd};

/// Output `[batch, channels, rows / 2, columns / 2]`; rows and columns are even.
pub(in super::super) fn pool(level: Level, source: Source, extent: Extent) -> Vec<f32> {
    check(source, extent);
    filled(source.values.len() / 4, |output| {
        output.par_chunks_mut(extent.plane() / 4).enumerate().for_each(|(plane, to)| {
            let values = &source.values[plane * extent.plane()..][..extent.plane()];
            let slope = source.slope.map_or(1.0, |slope| slope[plane % source.channels]);
            level.run(Forward { values, slope, columns: extent.columns, to });
        });
    })
}

/// Whole planes of even sides.
fn check(source: Source, extent: Extent) {
    assert_eq!(source.values.len(), extent.batch * source.channels * extent.plane());
    assert!(extent.rows.is_multiple_of(2) && extent.columns.is_multiple_of(2), "{extent:?}");
}

struct Forward<'a> {
    values: &'a [f32],
    slope: f32,
    columns: usize,
    to: &'a mut [f32],
}

impl Kernel for Forward<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let slope = simd.splat(self.slope);
        let n = self.columns / 2;
        for (from, to) in self.values.chunks_exact(2 * self.columns).zip(self.to.chunks_exact_mut(n)) {
            let (upper, lower) = from.split_at(self.columns);
            for x in (0..n).step_by(S::LANES) {
                let (a, b) = load_pairs(simd, &upper[2 * x..]);
                let (c, d) = load_pairs(simd, &lower[2 * x..]);
                let upper = simd.max(activate(simd, a, slope), activate(simd, b, slope));
                let lower = simd.max(activate(simd, c, slope), activate(simd, d, slope));
                simd.store_first(&mut to[x..], simd.max(upper, lower));
            }
        }
    }
}

/// Cotangent of [`pool`]'s source.
pub(in super::super) fn pool_vjp(level: Level, source: Source, extent: Extent, output_bar: &[f32]) -> SourceBar {
    check(source, extent);
    let n = source.values.len();
    assert_eq!(output_bar.len(), n / 4);
    let mut values = recycle::take(n);
    let slopes: Vec<f32> = values
        .par_chunks_mut(extent.plane())
        .enumerate()
        .map(|(plane, to)| {
            level.run(Backward {
                values: &source.values[plane * extent.plane()..][..extent.plane()],
                output_bar: &output_bar[plane * extent.plane() / 4..][..extent.plane() / 4],
                slope: source.slope.map_or(1.0, |slope| slope[plane % source.channels]),
                columns: extent.columns,
                to,
            })
        })
        .collect();
    let slope = if source.slope.is_some() {
        (0..source.channels).map(|c| slopes.iter().skip(c).step_by(source.channels).sum()).collect()
    } else {
        vec![]
    };
    SourceBar { values, slope }
}

struct Backward<'a> {
    values: &'a [f32],
    output_bar: &'a [f32],
    slope: f32,
    columns: usize,
    to: &'a mut [f32],
}

impl Kernel for Backward<'_> {
    /// The slope's cotangent.
    type Output = f32;
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> f32 {
        let (zero, slope) = (simd.splat(0.0), simd.splat(self.slope));
        let n = self.columns / 2;
        let mut slope_bar = zero;
        let pairs = self.values.chunks_exact(2 * self.columns).zip(self.to.chunks_exact_mut(2 * self.columns));
        for ((from, to), bars) in pairs.zip(self.output_bar.chunks_exact(n)) {
            let (upper, lower) = from.split_at(self.columns);
            let (to_upper, to_lower) = to.split_at_mut(self.columns);
            for x in (0..n).step_by(S::LANES) {
                let (a, b) = load_pairs(simd, &upper[2 * x..]);
                let (c, d) = load_pairs(simd, &lower[2 * x..]);
                let values = [a, b, c, d];
                let mut active = values;
                for active in &mut active {
                    *active = activate(simd, *active, slope);
                }
                let largest = simd.max(simd.max(active[0], active[1]), simd.max(active[2], active[3]));
                let mut bar = simd.load_first(&bars[x..]);
                let mut out = values;
                for ((out, value), active) in out.iter_mut().zip(values).zip(active) {
                    let taken = simd.where_same(active, largest, bar, zero);
                    bar = simd.where_same(active, largest, zero, bar);
                    *out = pull(simd, taken, value, slope, &mut slope_bar);
                }
                store_pairs(simd, &mut to_upper[2 * x..], out[0], out[1]);
                store_pairs(simd, &mut to_lower[2 * x..], out[2], out[3]);
            }
        }
        simd.sum(slope_bar)
    }
}
