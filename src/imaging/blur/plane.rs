//! FFTs of one block: real lines by realfft, columns panel by panel.
//!
//! A half spectrum lies in panels of [`LANES`] column frequencies: `[panel][line]`. While a block is convolved only one
//! panel of each spectrum is alive, so everything but the kernels stays in cache.

use std::sync::{Arc, Mutex};

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex;

use super::super::cfa::Real;
use crate::math::fft::good_size;
use crate::math::panel_fft::{LANES, Line, PanelFft};
use crate::math::wide::{Work, wide};

/// Plans for one size of block.
pub(super) struct Plane<T: Real> {
    /// Rows of the transform.
    pub rows: usize,
    /// Columns of the transform.
    pub cols: usize,
    /// Panels of a half spectrum.
    pub panels: usize,
    forward: Arc<dyn RealToComplex<T>>,
    inverse: Arc<dyn ComplexToReal<T>>,
    columns: PanelFft<T>,
}

/// Buffers of one thread.
pub(super) struct Scratch<T: Real> {
    line: Vec<T>,
    freq: Vec<Complex<T>>,
    real: Vec<Complex<T>>,
    /// Row spectra, as many planes as asked for.
    pub rows: Vec<Line<T>>,
    /// One panel of one spectrum.
    pub panel: Vec<Line<T>>,
    /// One panel of sums, one a channel.
    pub sums: Vec<Line<T>>,
    /// Row spectra on the way back.
    pub back: Vec<Line<T>>,
}

/// Scratch buffers, taken and given back, so that none is allocated twice.
pub(super) struct Pool<T: Real>(Mutex<Vec<Scratch<T>>>);

impl<T: Real> Pool<T> {
    pub(super) fn new() -> Self {
        Self(Mutex::new(Vec::new()))
    }

    /// Runs `work` with a scratch of `plane`.
    pub(super) fn with<R>(&self, plane: &Plane<T>, work: impl FnOnce(&mut Scratch<T>) -> R) -> R {
        let free = self.0.lock().ok().and_then(|mut all| all.pop());
        let mut scratch = free.unwrap_or_else(|| plane.scratch());
        let out = work(&mut scratch);
        if let Ok(mut all) = self.0.lock() {
            all.push(scratch);
        }
        out
    }
}

pub(super) fn zero_line<T: Real>() -> Line<T> {
    [[T::zero(); LANES]; 2]
}

/// Makes `buffer` at least `len` lines long.
pub(super) fn reserve<T: Real>(buffer: &mut Vec<Line<T>>, len: usize) {
    if buffer.len() < len {
        buffer.resize(len, zero_line());
    }
}

impl<T: Real> Plane<T> {
    /// The fastest size of at least `rows × cols`.
    pub(super) fn new(rows: usize, cols: usize) -> Self {
        let (rows, cols) = (good_size(rows), good_size(cols));
        let mut planner = RealFftPlanner::new();
        Self {
            rows,
            cols,
            panels: (cols / 2 + 1).div_ceil(LANES),
            forward: planner.plan_fft_forward(cols),
            inverse: planner.plan_fft_inverse(cols),
            columns: PanelFft::new(rows).expect("good sizes have the factors 2, 3 and 5"),
        }
    }

    /// Lines of a spectrum.
    pub(super) fn spectrum_len(&self) -> usize {
        self.panels * self.rows
    }

    fn scratch(&self) -> Scratch<T> {
        let zero = Complex::new(T::zero(), T::zero());
        let real = self.forward.get_scratch_len().max(self.inverse.get_scratch_len());
        Scratch {
            line: self.forward.make_input_vec(),
            freq: self.forward.make_output_vec(),
            real: vec![zero; real],
            rows: Vec::new(),
            panel: vec![zero_line(); self.rows],
            sums: Vec::new(),
            back: Vec::new(),
        }
    }

    /// Row spectra of `count` rows into plane `at` of `scratch.rows`.
    ///
    /// `fill` writes the head of a zero line, and says whether it is not zero all over.
    pub(super) fn rows_forward(
        &self,
        scratch: &mut Scratch<T>,
        at: usize,
        count: usize,
        mut fill: impl FnMut(usize, &mut [T]) -> bool,
    ) {
        let Scratch { line, freq, real, rows, .. } = scratch;
        reserve(rows, (at + 1) * self.panels * count);
        let plane = &mut rows[at * self.panels * count..][..self.panels * count];
        for i in 0..count {
            line.fill(T::zero());
            if fill(i, line) {
                self.forward.process_with_scratch(line, freq, real).expect("planned lengths");
            } else {
                freq.fill(Complex::new(T::zero(), T::zero()));
            }
            wide(Split { freq, lines: plane, stride: count, at: i });
        }
    }

    /// Rows from plane `at` of the row spectra in `scratch.back`, `[plane][panel][count]`; `take` gets each scaled row.
    pub(super) fn rows_inverse(
        &self,
        scratch: &mut Scratch<T>,
        at: usize,
        count: usize,
        mut take: impl FnMut(usize, &[T]),
    ) {
        let Scratch { line, freq, real, back, .. } = scratch;
        let back = &back[at * self.panels * count..][..self.panels * count];
        let scale = T::real(1.0 / (self.rows * self.cols) as f64);
        for i in 0..count {
            wide(Join { freq, lines: back, stride: count, at: i, scale });
            // The imaginary parts of the two real lines are rounding; realfft refuses them otherwise.
            freq[0].im = T::zero();
            if self.cols.is_multiple_of(2) {
                let last = freq.len() - 1;
                freq[last].im = T::zero();
            }
            self.inverse.process_with_scratch(freq, line, real).expect("planned lengths");
            take(i, line);
        }
    }

    /// The columns of one panel: `from` (times the row's window, if any), then zeros, transformed into `panel`.
    #[inline]
    pub(super) fn columns_forward(&self, from: &[Line<T>], window: Option<&[T]>, panel: &mut [Line<T>]) {
        wide(Forward { columns: &self.columns, from, window, panel });
    }

    /// The columns of one panel, in place, unscaled.
    #[inline]
    pub(super) fn columns_inverse(&self, panel: &mut [Line<T>]) {
        wide(Inverse { columns: &self.columns, panel });
    }

    /// Spectrum of plane 0 of `scratch.rows` with `count` rows.
    pub(super) fn spectrum(&self, scratch: &Scratch<T>, count: usize, out: &mut [Line<T>]) {
        for (p, panel) in out.chunks_exact_mut(self.rows).enumerate() {
            self.columns_forward(&scratch.rows[p * count..][..count], None, panel);
        }
    }
}

/// `sums += x · k`, line by line.
#[inline]
pub(super) fn add_product<T: Real>(sums: &mut [Line<T>], x: &[Line<T>], k: &[Line<T>]) {
    wide(Product::<T, false> { sums, x, k });
}

/// `sums += conj(x) · k`.
#[inline]
pub(super) fn add_correlation<T: Real>(sums: &mut [Line<T>], x: &[Line<T>], k: &[Line<T>]) {
    wide(Product::<T, true> { sums, x, k });
}

/// `sums += weight · x`, line by line with a weight each.
#[inline]
pub(super) fn add_weighted<T: Real>(sums: &mut [Line<T>], x: &[Line<T>], weights: &[T]) {
    wide(Weighted { sums, x, weights });
}

struct Split<'a, T> {
    freq: &'a [Complex<T>],
    lines: &'a mut [Line<T>],
    stride: usize,
    at: usize,
}

impl<T: Real> Work for Split<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        for (p, part) in self.freq.chunks(LANES).enumerate() {
            let line = &mut self.lines[p * self.stride + self.at];
            if let Ok(part) = <&[Complex<T>; LANES]>::try_from(part) {
                for l in 0..LANES {
                    line[0][l] = part[l].re;
                    line[1][l] = part[l].im;
                }
            } else {
                *line = [[T::zero(); LANES]; 2];
                for (l, f) in part.iter().enumerate() {
                    line[0][l] = f.re;
                    line[1][l] = f.im;
                }
            }
        }
    }
}

struct Join<'a, T> {
    freq: &'a mut [Complex<T>],
    lines: &'a [Line<T>],
    stride: usize,
    at: usize,
    scale: T,
}

impl<T: Real> Work for Join<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        for (p, part) in self.freq.chunks_mut(LANES).enumerate() {
            let [re, im] = &self.lines[p * self.stride + self.at];
            for (f, (re, im)) in part.iter_mut().zip(re.iter().zip(im)) {
                *f = Complex::new(*re * self.scale, *im * self.scale);
            }
        }
    }
}

struct Forward<'a, T> {
    columns: &'a PanelFft<T>,
    from: &'a [Line<T>],
    window: Option<&'a [T]>,
    panel: &'a mut [Line<T>],
}

impl<T: Real> Work for Forward<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        let (head, tail) = self.panel.split_at_mut(self.from.len());
        match self.window {
            Some(window) => {
                for ((line, from), w) in head.iter_mut().zip(self.from).zip(window) {
                    for l in 0..LANES {
                        line[0][l] = from[0][l] * *w;
                        line[1][l] = from[1][l] * *w;
                    }
                }
            }
            None => head.copy_from_slice(self.from),
        }
        tail.fill([[T::zero(); LANES]; 2]);
        self.columns.forward(self.panel);
    }
}

struct Inverse<'a, T> {
    columns: &'a PanelFft<T>,
    panel: &'a mut [Line<T>],
}

impl<T: Real> Work for Inverse<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        self.columns.inverse(self.panel);
    }
}

struct Product<'a, T, const CONJUGATE: bool> {
    sums: &'a mut [Line<T>],
    x: &'a [Line<T>],
    k: &'a [Line<T>],
}

impl<T: Real, const CONJUGATE: bool> Work for Product<'_, T, CONJUGATE> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        for (s, (x, k)) in self.sums.iter_mut().zip(self.x.iter().zip(self.k)) {
            for l in 0..LANES {
                let (xr, xi, kr, ki) = (x[0][l], x[1][l], k[0][l], k[1][l]);
                if CONJUGATE {
                    s[0][l] += xr * kr + xi * ki;
                    s[1][l] += xr * ki - xi * kr;
                } else {
                    s[0][l] += xr * kr - xi * ki;
                    s[1][l] += xr * ki + xi * kr;
                }
            }
        }
    }
}

struct Weighted<'a, T> {
    sums: &'a mut [Line<T>],
    x: &'a [Line<T>],
    weights: &'a [T],
}

impl<T: Real> Work for Weighted<'_, T> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        for ((s, x), w) in self.sums.iter_mut().zip(self.x).zip(self.weights) {
            for i in 0..2 {
                for l in 0..LANES {
                    s[i][l] += x[i][l] * *w;
                }
            }
        }
    }
}
