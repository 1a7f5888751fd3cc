//! Real rows to complex lines and back: what is done to single numbers around the row transforms.

use rustfft::num_complex::Complex;

use isoplanat_base::math::real::Real;
use isoplanat_base::math::wide::{Work, wide};

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

/// Tells apart the two real rows of up to [`TILE`] transformed lines of `cols` numbers, and turns them; `turned` is as
/// long as `lines`.
///
/// Rows go to `out[k * stride + at + l]`, `k` up to `cols / 2`; `to` is `at` and the number of lines for both rows.
pub(super) fn unpack<T: Real>(
    lines: &[Complex<T>],
    turned: &mut [Complex<T>],
    out: &mut [Complex<T>],
    stride: usize,
    to: [(usize, usize); 2],
) {
    wide(Turn { lines, turned });
    wide(Unpack { turned, half: T::real(0.5), out, stride, to });
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

/// `turned[k][l] = lines[l][k]`.
struct Turn<'a, T> {
    lines: &'a [Complex<T>],
    turned: &'a mut [Complex<T>],
}

impl<T: Real> Work for Turn<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let cols = self.lines.len() / TILE;
        let lines: [&[Complex<T>]; TILE] = std::array::from_fn(|l| &self.lines[l * cols..(l + 1) * cols]);
        for (from, turned) in (0..cols).step_by(TILE).zip(self.turned.chunks_mut(TILE * TILE)) {
            // A square at a time through registers: the compiler would scatter single numbers.
            let mut square = [[Complex { re: T::zero(), im: T::zero() }; TILE]; TILE];
            for (line, square) in lines.iter().zip(&mut square) {
                let line = &line[from..];
                if let Some(line) = line.first_chunk::<TILE>() {
                    *square = *line;
                } else {
                    square[..line.len()].copy_from_slice(line);
                }
            }
            for (k, turned) in turned.chunks_exact_mut(TILE).enumerate() {
                for l in 0..TILE {
                    turned[l] = square[l][k];
                }
            }
        }
    }
}

struct Unpack<'a, T> {
    turned: &'a [Complex<T>],
    half: T,
    out: &'a mut [Complex<T>],
    stride: usize,
    to: [(usize, usize); 2],
}

impl<T: Real> Work for Unpack<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let (cols, half) = (self.turned.len() / TILE, self.half);
        let [(at_a, count_a), (at_b, count_b)] = self.to;
        for k in 0..cols / 2 + 1 {
            let mirror = if k == 0 { 0 } else { cols - k };
            let (z, m) = (&self.turned[k * TILE..][..TILE], &self.turned[mirror * TILE..][..TILE]);
            // The row a + i b has the spectrum Z; that of a is (Z(k) + conj Z(−k)) / 2, of b that difference / 2i.
            let a = &mut self.out[k * self.stride + at_a..][..count_a];
            for (a, (z, m)) in a.iter_mut().zip(z.iter().zip(m)) {
                *a = Complex { re: (z.re + m.re) * half, im: (z.im - m.im) * half };
            }
            let b = &mut self.out[k * self.stride + at_b..][..count_b];
            for (b, (z, m)) in b.iter_mut().zip(z.iter().zip(m)) {
                *b = Complex { re: (z.im + m.im) * half, im: (m.re - z.re) * half };
            }
        }
    }
}
