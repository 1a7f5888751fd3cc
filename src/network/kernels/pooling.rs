//! Largest of each 2×2 block of an activated picture, and its cotangent, which goes to the first largest value.
#![allow(unsafe_code, reason = "vectors whose every value has been written get their length")]

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::simd::{Kernel, Simd, dispatch};
use super::{Extent, Level, Source, SourceBar};

/// Output `[batch, channels, rows / 2, columns / 2]`; rows and columns are even.
pub(in super::super) fn pool(level: Level, source: Source, extent: Extent) -> Vec<f32> {
    let quarter = extent.plane() / 4;
    let n = source.values.len() / 4;
    let mut output = Vec::with_capacity(n);
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

#[inline(always)]
fn activated(x: f32, slope: f32) -> f32 {
    if x >= 0.0 { x } else { slope * x }
}

#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

impl Kernel for Forward<'_> {
    #[inline(always)]
    unsafe fn run<S: Simd>(&self) {
        let (columns, slope) = (self.columns, self.slope);
        // SAFETY: a quarter of the plane's values, written by this call alone.
        let to = unsafe { std::slice::from_raw_parts_mut(self.to, self.values.len() / 4) };
        for (rows, to) in
            self.values.chunks_exact(2 * columns).zip(to.chunks_exact_mut(columns / 2))
        {
            let (upper, lower) = rows.split_at(columns);
            for ((upper, lower), to) in upper.chunks_exact(2).zip(lower.chunks_exact(2)).zip(to) {
                let a = larger(activated(upper[0], slope), activated(upper[1], slope));
                let b = larger(activated(lower[0], slope), activated(lower[1], slope));
                to.write(larger(a, b));
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
    let mut values = Vec::with_capacity(n);
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
        let (columns, slope) = (self.columns, self.slope);
        // SAFETY: the plane's values, written by this call alone.
        let to = unsafe { std::slice::from_raw_parts_mut(self.to, self.values.len()) };
        let rows = self.values.chunks_exact(2 * columns).zip(to.chunks_exact_mut(2 * columns));
        let mut total = 0.0;
        for ((rows, to), bars) in rows.zip(self.output_bar.chunks_exact(columns / 2)) {
            let (upper, lower) = rows.split_at(columns);
            let (to_upper, to_lower) = to.split_at_mut(columns);
            // Sixteen sums side by side, so that the loop can be vectorised in a fixed order.
            let mut sums = [0.0f32; 16];
            for (x, &bar) in bars.iter().enumerate() {
                let v = [upper[2 * x], upper[2 * x + 1], lower[2 * x], lower[2 * x + 1]];
                let a = v.map(|v| activated(v, slope));
                let largest = larger(larger(a[0], a[1]), larger(a[2], a[3]));
                let is = a.map(|a| a == largest);
                let takes = [
                    is[0],
                    is[1] && !is[0],
                    is[2] && !(is[0] || is[1]),
                    is[3] && !(is[0] || is[1] || is[2]),
                ];
                let mut slope_bar = 0.0;
                let mut out = [0.0f32; 4];
                for k in 0..4 {
                    let bar = if takes[k] { bar } else { 0.0 };
                    out[k] = if v[k] >= 0.0 { bar } else { slope * bar };
                    slope_bar += bar * if v[k] < 0.0 { v[k] } else { 0.0 };
                }
                sums[x % 16] += slope_bar;
                to_upper[2 * x].write(out[0]);
                to_upper[2 * x + 1].write(out[1]);
                to_lower[2 * x].write(out[2]);
                to_lower[2 * x + 1].write(out[3]);
            }
            total += sums.iter().sum::<f32>();
        }
        // SAFETY: the caller's variable.
        unsafe { *self.slope_bar = total };
    }
}
