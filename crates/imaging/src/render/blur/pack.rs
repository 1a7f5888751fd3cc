//! Columns of two real planes to complex lines, and what is done to single numbers of spectra.

use std::ops::Range;

use rustfft::num_complex::Complex;

use super::lines::TILE;
use isoplanat_base::math::real::Real;
use isoplanat_base::math::wide::{Work, wide};

/// Columns that go through a block's products together, small enough for the first cache.
pub(super) const COLUMNS: usize = 4;

/// The span of the columns after those from `from` on, in a half spectrum of `half` columns of `rows`.
pub(super) fn next_columns(rows: usize, half: usize, from: usize) -> Range<usize> {
    (from + COLUMNS).min(half) * rows..(from + 2 * COLUMNS).min(half) * rows
}

/// Some columns of half spectra whose rows are back in space.
#[derive(Clone, Copy)]
pub(super) struct Columns {
    /// Frequency of the first.
    pub from: usize,
    /// How many.
    pub count: usize,
    /// Numbers from one column to the next.
    pub stride: usize,
    /// Where the two planes begin in a column, and how many rows they have; the first has at least as many.
    pub planes: [(usize, usize); 2],
}

/// Puts row `l` of both planes, `a + i b`, and what its real lines say of the mirrored frequencies, into line `l` of
/// `lines`, `cols` numbers each. `values` begins at the first column.
pub(super) fn pack<T: Real>(values: &[Complex<T>], columns: Columns, lines: &mut [Complex<T>], cols: usize) {
    wide(Pack { values, columns, lines, cols });
}

/// `out = x · y`, or with `ADD` `out += x · y`.
#[inline]
pub(super) fn product<T: Real, const ADD: bool>(out: &mut [Complex<T>], x: &[Complex<T>], y: &[Complex<T>]) {
    wide(Product::<T, false, ADD> { out, x, y });
}

/// `out = conj(x) · y`, or with `ADD` `out += conj(x) · y`.
#[inline]
pub(super) fn correlate<T: Real, const ADD: bool>(out: &mut [Complex<T>], x: &[Complex<T>], y: &[Complex<T>]) {
    wide(Product::<T, true, ADD> { out, x, y });
}

/// `out = x · window`, or with `ADD` `out += x · window`, number by number.
#[inline]
pub(super) fn window<T: Real, const ADD: bool>(out: &mut [Complex<T>], x: &[Complex<T>], window: &[T]) {
    wide(Window::<T, ADD> { out, x, window });
}

struct Pack<'a, T> {
    values: &'a [Complex<T>],
    columns: Columns,
    lines: &'a mut [Complex<T>],
    cols: usize,
}

impl<T: Real> Work for Pack<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let Columns { from, count, stride, planes } = self.columns;
        let cols = self.cols;
        for k in from..from + count {
            let column = &self.values[(k - from) * stride..];
            let (a, b) = (&column[planes[0].0..][..planes[0].1], &column[planes[1].0..][..planes[1].1]);
            let mirror = if k == 0 { 0 } else { cols - k };
            let mut lines = self.lines.chunks_exact_mut(cols);
            let full = b.len() / TILE * TILE;
            for (a, b) in a[..full].chunks_exact(TILE).zip(b.chunks_exact(TILE)) {
                let zero = Complex { re: T::zero(), im: T::zero() };
                let (mut u, mut v) = ([zero; TILE], [zero; TILE]);
                for i in 0..TILE {
                    u[i] = Complex { re: a[i].re - b[i].im, im: a[i].im + b[i].re };
                    v[i] = Complex { re: a[i].re + b[i].im, im: b[i].re - a[i].im };
                }
                for ((u, v), line) in u.iter().zip(&v).zip(lines.by_ref()) {
                    // The mirror first: where both are one frequency, that one is meant.
                    line[mirror] = *v;
                    line[k] = *u;
                }
            }
            for (l, line) in (full..a.len()).zip(lines) {
                let (a, b) = (a[l], b.get(l).copied().unwrap_or(Complex { re: T::zero(), im: T::zero() }));
                line[mirror] = Complex { re: a.re + b.im, im: b.re - a.im };
                line[k] = Complex { re: a.re - b.im, im: a.im + b.re };
            }
        }
    }
}

struct Product<'a, T, const CONJUGATE: bool, const ADD: bool> {
    out: &'a mut [Complex<T>],
    x: &'a [Complex<T>],
    y: &'a [Complex<T>],
}

impl<T: Real, const CONJUGATE: bool, const ADD: bool> Work for Product<'_, T, CONJUGATE, ADD> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        for (o, (x, y)) in self.out.iter_mut().zip(self.x.iter().zip(self.y)) {
            let (re, im) = if CONJUGATE {
                (x.re * y.re + x.im * y.im, x.re * y.im - x.im * y.re)
            } else {
                (x.re * y.re - x.im * y.im, x.re * y.im + x.im * y.re)
            };
            *o = if ADD { Complex { re: o.re + re, im: o.im + im } } else { Complex { re, im } };
        }
    }
}

struct Window<'a, T, const ADD: bool> {
    out: &'a mut [Complex<T>],
    x: &'a [Complex<T>],
    window: &'a [T],
}

impl<T: Real, const ADD: bool> Work for Window<'_, T, ADD> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        for (o, (x, w)) in self.out.iter_mut().zip(self.x.iter().zip(self.window)) {
            let (re, im) = (x.re * *w, x.im * *w);
            *o = if ADD { Complex { re: o.re + re, im: o.im + im } } else { Complex { re, im } };
        }
    }
}
