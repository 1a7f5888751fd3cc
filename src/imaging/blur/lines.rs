//! Real rows to complex lines and back: what is done to single numbers around the row transforms.

use rustfft::num_complex::Complex;

use super::super::cfa::Real;
use crate::math::wide::{Work, wide};

/// Lines that become columns together: eight complex numbers are a cache line in f32.
pub(super) const TILE: usize = 8;

/// `line = a + i b`, both zero behind their ends.
pub(super) fn twine<T: Real>(a: &[T], b: &[T], line: &mut [Complex<T>]) {
    if b.len() == a.len() {
        wide(Twine { a, b, line: &mut line[..a.len()] });
    } else {
        let second = b.iter().copied().chain(std::iter::repeat(T::zero()));
        line.iter_mut().zip(a.iter().zip(second)).for_each(|(z, (a, b))| *z = Complex::new(*a, b));
    }
    line[a.len()..].fill(Complex::new(T::zero(), T::zero()));
}

/// `line = v a + i v b`.
pub(super) fn twine_windows<T: Real>(values: &[T], windows: [&[T]; 2], line: &mut [Complex<T>]) {
    wide(TwineWindows { values, windows, line });
}

/// `out = scale Re line` ([`PART`] 0) or `scale Im line` (1).
pub(super) fn part<T: Real, const PART: usize>(line: &[Complex<T>], scale: T, out: &mut [T]) {
    for (o, z) in out.iter_mut().zip(line) {
        *o = scale * if PART == 0 { z.re } else { z.im };
    }
}

/// `out = scale (Re line · a + Im line · b)`.
pub(super) fn weigh<T: Real>(line: &[Complex<T>], windows: [&[T]; 2], scale: T, out: &mut [T]) {
    wide(Weigh { line, windows, scale, out });
}

/// Tells apart the two real rows of up to [`TILE`] transformed lines of `cols` numbers, and turns them.
///
/// Rows go to `out[k * stride + at + l]`, `k` up to `cols / 2`; `to` is `at` and the number of lines for both rows.
pub(super) fn unpack<T: Real>(
    lines: &[Complex<T>],
    cols: usize,
    out: &mut [Complex<T>],
    stride: usize,
    to: [(usize, usize); 2],
) {
    wide(Unpack { lines, cols, out, stride, to });
}

struct Twine<'a, T> {
    a: &'a [T],
    b: &'a [T],
    line: &'a mut [Complex<T>],
}

impl<T: Real> Work for Twine<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        for (z, (a, b)) in self.line.iter_mut().zip(self.a.iter().zip(self.b)) {
            *z = Complex { re: *a, im: *b };
        }
    }
}

struct TwineWindows<'a, T> {
    values: &'a [T],
    windows: [&'a [T]; 2],
    line: &'a mut [Complex<T>],
}

impl<T: Real> Work for TwineWindows<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let [a, b] = self.windows;
        for ((z, v), (a, b)) in self.line.iter_mut().zip(self.values).zip(a.iter().zip(b)) {
            *z = Complex { re: *v * *a, im: *v * *b };
        }
    }
}

struct Weigh<'a, T> {
    line: &'a [Complex<T>],
    windows: [&'a [T]; 2],
    scale: T,
    out: &'a mut [T],
}

impl<T: Real> Work for Weigh<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let [a, b] = self.windows;
        for ((o, z), (a, b)) in self.out.iter_mut().zip(self.line).zip(a.iter().zip(b)) {
            *o = (z.re * *a + z.im * *b) * self.scale;
        }
    }
}

struct Unpack<'a, T> {
    lines: &'a [Complex<T>],
    cols: usize,
    out: &'a mut [Complex<T>],
    stride: usize,
    to: [(usize, usize); 2],
}

impl<T: Real> Work for Unpack<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let (cols, half) = (self.cols, T::real(0.5));
        let lines = &self.lines[..TILE * cols];
        for k in 0..cols / 2 + 1 {
            let mirror = if k == 0 { 0 } else { cols - k };
            let (mut a, mut b) = ([[T::zero(); 2]; TILE], [[T::zero(); 2]; TILE]);
            for l in 0..TILE {
                let (z, m) = (lines[l * cols + k], lines[l * cols + mirror]);
                // The row a + i b has the spectrum Z; that of a is (Z(k) + conj Z(−k)) / 2, of b that difference / 2i.
                a[l] = [(z.re + m.re) * half, (z.im - m.im) * half];
                b[l] = [(z.im + m.im) * half, (m.re - z.re) * half];
            }
            for (values, (at, count)) in [(&a, self.to[0]), (&b, self.to[1])] {
                let out = &mut self.out[k * self.stride + at..][..count];
                if let Ok(out) = <&mut [Complex<T>; TILE]>::try_from(&mut *out) {
                    for l in 0..TILE {
                        out[l] = Complex { re: values[l][0], im: values[l][1] };
                    }
                } else {
                    for (o, v) in out.iter_mut().zip(values) {
                        *o = Complex { re: v[0], im: v[1] };
                    }
                }
            }
        }
    }
}
