//! Largest of each 2×2 block of an activated picture, and its cotangent, which goes to the first largest value.
#![allow(unsafe_code, reason = "vectors whose every value has been written get their length")]

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::simd::{Kernel, Simd, dispatch, load_pairs, store_pairs};
use super::strip::activate;
use super::{Extent, Level, Source, SourceBar, recycle};

/// Output `[batch, channels, rows / 2, columns / 2]`; rows and columns are even.
pub(in super::super) fn pool(level: Level, source: Source, extent: Extent) -> Vec<f32> {
    let quarter = extent.plane() / 4;
    let n = source.values.len() / 4;
    let mut output = recycle::take(n);
    output.spare_capacity_mut()[..n].par_chunks_mut(quarter).enumerate().for_each(|(plane, to)| {
        let values = &source.values[plane * extent.plane()..][..extent.plane()];
        let slope = source.slope.map_or(1.0, |slope| slope[plane % source.channels]);
        dispatch(level, &Forward { values, slope, columns: extent.columns, to: to.as_mut_ptr() });
    });
    // SAFETY: the planes have written all values.
    unsafe { output.set_len(n) };
    output
}

struct Forward<'a> {
    values: &'a [f32],
    slope: f32,
    columns: usize,
    to: *mut MaybeUninit<f32>,
}

impl Kernel for Forward<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(&self) {
        let n = self.columns / 2;
        let rows = self.values.len() / self.columns;
        // SAFETY: even rows and columns of the plane, and a quarter as many outputs, which this call alone writes.
        unsafe {
            let slope = S::splat(self.slope);
            for row in 0..rows / 2 {
                let upper = self.values.as_ptr().add(2 * row * self.columns);
                let lower = upper.add(self.columns);
                let to = self.to.cast::<f32>().add(row * n);
                let mut x = 0;
                while x < n {
                    let left = n - x;
                    let (a, b) = load_pairs::<S>(upper.add(2 * x), left);
                    let (c, d) = load_pairs::<S>(lower.add(2 * x), left);
                    let upper = S::max(activate::<S>(a, slope), activate::<S>(b, slope));
                    let lower = S::max(activate::<S>(c, slope), activate::<S>(d, slope));
                    S::store_first(to.add(x), left, S::max(upper, lower));
                    x += S::LANES;
                }
            }
        }
    }
}

/// Cotangent of [`pool`]'s source.
pub(in super::super) fn pool_vjp(
    level: Level,
    source: Source,
    extent: Extent,
    output_bar: &[f32],
) -> SourceBar {
    let n = source.values.len();
    assert_eq!(output_bar.len(), n / 4);
    let mut values = recycle::take(n);
    let slopes: Vec<f32> = values.spare_capacity_mut()[..n]
        .par_chunks_mut(extent.plane())
        .enumerate()
        .map(|(plane, to)| {
            let mut slope_bar = 0.0;
            let job = Backward {
                values: &source.values[plane * extent.plane()..][..extent.plane()],
                output_bar: &output_bar[plane * extent.plane() / 4..][..extent.plane() / 4],
                slope: source.slope.map_or(1.0, |slope| slope[plane % source.channels]),
                columns: extent.columns,
                to: to.as_mut_ptr(),
                slope_bar: &raw mut slope_bar,
            };
            dispatch(level, &job);
            slope_bar
        })
        .collect();
    // SAFETY: the planes have written all values.
    unsafe { values.set_len(n) };
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
    to: *mut MaybeUninit<f32>,
    slope_bar: *mut f32,
}

impl Kernel for Backward<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(&self) {
        let n = self.columns / 2;
        let rows = self.values.len() / self.columns;
        // SAFETY: even rows and columns of the plane; the cotangent has as many values, which this call alone writes.
        unsafe {
            let (one, slope) = (S::splat(1.0), S::splat(self.slope));
            let mut slope_bar = S::zero();
            for row in 0..rows / 2 {
                let corner = 2 * row * self.columns;
                let (from, to) =
                    (self.values.as_ptr().add(corner), self.to.cast::<f32>().add(corner));
                let bars = self.output_bar.as_ptr().add(row * n);
                let mut x = 0;
                while x < n {
                    let left = n - x;
                    let (a, b) = load_pairs::<S>(from.add(2 * x), left);
                    let (c, d) = load_pairs::<S>(from.add(self.columns + 2 * x), left);
                    let values = [a, b, c, d];
                    let mut active = values;
                    for active in &mut active {
                        *active = activate::<S>(*active, slope);
                    }
                    let largest =
                        S::max(S::max(active[0], active[1]), S::max(active[2], active[3]));
                    let mut bar = S::load_first(bars.add(x), left);
                    let mut out = values;
                    for ((out, value), active) in out.iter_mut().zip(values).zip(active) {
                        let taken = S::where_equal(active, largest, bar, S::zero());
                        bar = S::where_equal(active, largest, S::zero(), bar);
                        slope_bar = S::fma(taken, S::below_zero(value), slope_bar);
                        *out = S::mul(taken, S::choose(value, one, slope));
                    }
                    store_pairs::<S>(to.add(2 * x), left, out[0], out[1]);
                    store_pairs::<S>(to.add(self.columns + 2 * x), left, out[2], out[3]);
                    x += S::LANES;
                }
            }
            *self.slope_bar = S::sum(slope_bar);
        }
    }
}
