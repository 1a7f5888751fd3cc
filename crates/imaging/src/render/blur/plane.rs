//! FFTs of one block: a half spectrum from real rows and back, by rustfft along both axes.
//!
//! Two real rows are one complex line, `row a + i row b`, and the lines are cut into columns where the two are told
//! apart. A half spectrum lies column by column, `[column frequency][row frequency]`, so that the transforms down the
//! columns run over contiguous numbers.

use std::sync::{Arc, Mutex};

use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

use super::lines::{TILE, part, twine, unpack};
use super::pack::{Columns, pack};
use isoplanat_base::math::fft::fast_size;
use isoplanat_base::math::real::Real;

/// Plans for one size of block.
pub(super) struct Plane<T: Real> {
    /// Rows of the transform.
    pub rows: usize,
    /// Columns of the transform.
    pub cols: usize,
    /// Column frequencies of a half spectrum.
    pub half: usize,
    row_forward: Arc<dyn Fft<T>>,
    row_inverse: Arc<dyn Fft<T>>,
    column_forward: Arc<dyn Fft<T>>,
    column_inverse: Arc<dyn Fft<T>>,
}

/// What rustfft asks for, and a few lines before they become columns.
pub(super) struct Buffers<T> {
    work: Vec<Complex<T>>,
    /// [`TILE`] lines, and the same turned.
    lines: Vec<Complex<T>>,
    turned: Vec<Complex<T>>,
}

/// Buffers of one thread; all but the first grow with use.
pub(super) struct Scratch<T> {
    /// For the transforms.
    pub buffers: Buffers<T>,
    /// A half spectrum a phase.
    pub spectra: Vec<Complex<T>>,
    /// A few columns of the products with up to four nodes.
    pub columns: Vec<Complex<T>>,
    /// The same, weighed by the row windows; or the columns of up to two planes.
    pub mixed: Vec<Complex<T>>,
    /// Complex lines on the way back.
    pub lines: Vec<Complex<T>>,
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

pub(super) fn zero<T: Real>() -> Complex<T> {
    Complex::new(T::zero(), T::zero())
}

/// Makes `buffer` at least `len` long.
pub(super) fn reserve<T: Real>(buffer: &mut Vec<Complex<T>>, len: usize) {
    if buffer.len() < len {
        buffer.resize(len, zero());
    }
}

impl<T: Real> Plane<T> {
    /// The fastest size of at least `rows × cols`.
    pub(super) fn new(rows: usize, cols: usize) -> Self {
        let (rows, cols) = (fast_size(rows), fast_size(cols));
        let mut planner = FftPlanner::new();
        Self {
            rows,
            cols,
            half: cols / 2 + 1,
            row_forward: planner.plan_fft_forward(cols),
            row_inverse: planner.plan_fft_inverse(cols),
            column_forward: planner.plan_fft_forward(rows),
            column_inverse: planner.plan_fft_inverse(rows),
        }
    }

    /// Numbers of a half spectrum.
    pub(super) fn spectrum_len(&self) -> usize {
        self.half * self.rows
    }

    /// What undoes the growth of a transform there and back.
    pub(super) fn scale(&self) -> T {
        T::real(1.0 / (self.rows * self.cols) as f64)
    }

    fn scratch(&self) -> Scratch<T> {
        let plans = [&self.row_forward, &self.row_inverse, &self.column_forward, &self.column_inverse];
        let work = plans.iter().map(|p| p.get_inplace_scratch_len()).max().unwrap_or(0);
        let tile = || vec![zero(); TILE * self.cols];
        let buffers = Buffers { work: vec![zero(); work], lines: tile(), turned: tile() };
        Scratch { buffers, spectra: Vec::new(), columns: Vec::new(), mixed: Vec::new(), lines: Vec::new() }
    }

    /// Transforms lines of `cols` numbers, forth.
    pub(super) fn rows_forward(&self, work: &mut [Complex<T>], lines: &mut [Complex<T>]) {
        self.row_forward.process_with_scratch(lines, work);
    }

    /// Transforms columns of `rows` numbers, forth.
    pub(super) fn columns_forward(&self, buffers: &mut Buffers<T>, columns: &mut [Complex<T>]) {
        self.column_forward.process_with_scratch(columns, &mut buffers.work);
    }

    /// Transforms columns back, unscaled.
    pub(super) fn columns_inverse(&self, buffers: &mut Buffers<T>, columns: &mut [Complex<T>]) {
        self.column_inverse.process_with_scratch(columns, &mut buffers.work);
    }

    /// Transforms lines back, unscaled.
    pub(super) fn rows_inverse(&self, buffers: &mut Buffers<T>, lines: &mut [Complex<T>]) {
        self.row_inverse.process_with_scratch(lines, &mut buffers.work);
    }

    /// Half spectrum of the real rows `row(0..count)`, each at most `cols` long, zero behind and below.
    pub(super) fn spectrum<'a>(
        &self,
        buffers: &mut Buffers<T>,
        count: usize,
        row: impl Fn(usize) -> &'a [T],
        out: &mut [Complex<T>],
    ) where
        T: 'a,
    {
        for from in (0..count).step_by(2 * TILE) {
            let rows = (count - from).min(2 * TILE);
            // Row l and row l + lines of the tile share a line.
            let lines = rows.min(TILE);
            for (l, line) in buffers.lines.chunks_exact_mut(self.cols).enumerate().take(lines) {
                let second = if l + lines < rows { row(from + lines + l) } else { &[] };
                twine(row(from + l), second, line);
            }
            self.rows_forward(&mut buffers.work, &mut buffers.lines[..lines * self.cols]);
            let to = [(from, lines), (from + lines, rows - lines)];
            unpack(&buffers.lines, &mut buffers.turned, out, self.rows, to);
        }
        for column in out.chunks_exact_mut(self.rows) {
            column[count..].fill(zero());
        }
        self.columns_forward(buffers, out);
    }

    /// Planes of columns from lines that hold two real rows each, before the columns are transformed.
    ///
    /// `fill(l, line)` writes all of line `l` of `lines`; its parts go to row `l` of the two planes of `out`, which hold
    /// `stride` rows a column and begin at the two offsets, each with a count of rows.
    pub(super) fn turn(
        &self,
        buffers: &mut Buffers<T>,
        lines: usize,
        fill: impl Fn(usize, &mut [Complex<T>]),
        out: &mut [Complex<T>],
        stride: usize,
        planes: [(usize, usize); 2],
    ) {
        for from in (0..lines).step_by(TILE) {
            let n = (lines - from).min(TILE);
            for (l, line) in buffers.lines.chunks_exact_mut(self.cols).enumerate().take(n) {
                fill(from + l, line);
            }
            self.rows_forward(&mut buffers.work, &mut buffers.lines[..n * self.cols]);
            let to = planes.map(|(at, count)| (at + from, count.saturating_sub(from).min(n)));
            unpack(&buffers.lines, &mut buffers.turned, out, stride, to);
        }
    }

    /// Real rows `0..count` of a half spectrum (spoilt), their first `width` numbers, scaled, into `out` row by row.
    pub(super) fn image(
        &self,
        buffers: &mut Buffers<T>,
        lines: &mut Vec<Complex<T>>,
        spectrum: &mut [Complex<T>],
        (count, width): (usize, usize),
        out: &mut [T],
    ) {
        self.columns_inverse(buffers, spectrum);
        let n = count.div_ceil(2);
        reserve(lines, n * self.cols);
        let lines = &mut lines[..n * self.cols];
        let planes = [(0, n), (n, count - n)];
        for from in (0..self.half).step_by(TILE) {
            let columns = Columns { from, count: (self.half - from).min(TILE), stride: self.rows, planes };
            pack(&spectrum[from * self.rows..], columns, lines, self.cols);
        }
        self.rows_inverse(buffers, lines);
        let scale = self.scale();
        for (l, line) in lines.chunks_exact(self.cols).enumerate() {
            part::<T, 0>(&line[..width], scale, &mut out[l * width..][..width]);
            if n + l < count {
                part::<T, 1>(&line[..width], scale, &mut out[(n + l) * width..][..width]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Spectra are the plain sum, and the image comes back, for odd counts of rows and sizes off the tiles.
    #[test]
    fn spectra_are_the_plain_sum_and_come_back() {
        let rng = &mut fastrand::Rng::with_seed(2);
        for (rows, cols) in [(1, 1), (5, 9), (16, 12), (17, 20), (33, 7), (40, 31)] {
            let plane = Plane::<f64>::new(rows, cols);
            let mut scratch = plane.scratch();
            let x: Vec<f64> = (0..rows * cols).map(|_| rng.f64() - 0.5).collect();
            let mut spectrum = vec![zero(); plane.spectrum_len()];
            plane.spectrum(&mut scratch.buffers, rows, |i| &x[i * cols..][..cols], &mut spectrum);
            for _ in 0..20 {
                let (u, v) = (rng.usize(..plane.rows), rng.usize(..plane.half));
                let mut sum = Complex::new(0.0, 0.0);
                for (i, j) in (0..rows).flat_map(|i| (0..cols).map(move |j| (i, j))) {
                    let turn = (i * u) as f64 / plane.rows as f64 + (j * v) as f64 / plane.cols as f64;
                    sum += Complex::from_polar(x[i * cols + j], -std::f64::consts::TAU * turn);
                }
                assert!((spectrum[v * plane.rows + u] - sum).norm() < 1e-12);
            }
            let mut back = vec![0.0; x.len()];
            plane.image(&mut scratch.buffers, &mut scratch.lines, &mut spectrum, (rows, cols), &mut back);
            assert!(x.iter().zip(&back).all(|(a, b)| (a - b).abs() < 1e-14));
        }
    }
}
