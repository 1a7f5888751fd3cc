//! Register-blocked inner loops over one trait of vector operations, which `x86` implements.
//!
//! Everything here is inlined into a function compiled for its processor ([`dispatch`]); a block of output channels ×
//! vectors stays in registers over all input channels and taps.
#![allow(unsafe_code, reason = "raw pointers into scratch buffers; see each Safety note")]

use super::Level;

/// Vector operations of one instruction set.
///
/// # Safety
/// All methods need a processor with the instruction set, and pointers valid for the lanes they touch.
pub(super) trait Simd: Copy {
    /// One vector.
    type V: Copy;
    /// Values in a vector; divides 16.
    const LANES: usize;
    /// Most output channels in a block.
    const BLOCK: usize;
    unsafe fn zero() -> Self::V;
    unsafe fn splat(value: f32) -> Self::V;
    unsafe fn load(from: *const f32) -> Self::V;
    /// Loads the first `n` lanes, zero elsewhere; nothing beyond is touched.
    unsafe fn load_first(from: *const f32, n: usize) -> Self::V;
    unsafe fn store(to: *mut f32, v: Self::V);
    /// Stores the first `n` lanes.
    unsafe fn store_first(to: *mut f32, n: usize, v: Self::V);
    unsafe fn add(a: Self::V, b: Self::V) -> Self::V;
    unsafe fn mul(a: Self::V, b: Self::V) -> Self::V;
    /// `a b + c`.
    unsafe fn fma(a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// Largest of the lanes and 0; NaN stays.
    unsafe fn above_zero(a: Self::V) -> Self::V;
    /// Smallest of the lanes and 0; NaN stays.
    unsafe fn below_zero(a: Self::V) -> Self::V;
    /// `a` where `sign` is ≥ 0, `b` elsewhere.
    unsafe fn choose(sign: Self::V, a: Self::V, b: Self::V) -> Self::V;
    /// The larger lanes.
    unsafe fn max(a: Self::V, b: Self::V) -> Self::V;
    /// `x` where `a` equals `b`, `y` elsewhere.
    unsafe fn where_equal(a: Self::V, b: Self::V, x: Self::V, y: Self::V) -> Self::V;
    /// The even and the odd lanes of `a` followed by `b`.
    unsafe fn unzip(a: Self::V, b: Self::V) -> (Self::V, Self::V);
    /// The inverse of `unzip`.
    unsafe fn zip(even: Self::V, odd: Self::V) -> (Self::V, Self::V);
    /// Sum of the lanes, in a fixed order.
    unsafe fn sum(a: Self::V) -> f32;
    /// [`tile`] as a function of its own.
    unsafe fn tile<const K: usize, const O: usize, const N: usize>(
        rows: &Rows,
        weights: *const f32,
        bias: *const f32,
        to: *mut f32,
        plane: usize,
        left: usize,
    );
    /// [`correlate_tile`] as a function of its own.
    unsafe fn correlate<const O: usize>(
        a: &Rows,
        b: &[*const f32; 3],
        b_row_stride: usize,
        rows: usize,
        n: usize,
        to: *mut f32,
        strides: (usize, usize),
    );
}

/// The first `n` pairs of a row as even and odd lanes, at most one vector of each; zeros beyond.
///
/// # Safety
/// The processor must have the instruction set of `S`; `2 n` values must be readable.
#[inline(always)]
pub(super) unsafe fn load_pairs<S: Simd>(from: *const f32, n: usize) -> (S::V, S::V) {
    unsafe {
        if n >= S::LANES {
            S::unzip(S::load(from), S::load(from.add(S::LANES)))
        } else {
            let first = S::load_first(from, 2 * n);
            let more = (2 * n).saturating_sub(S::LANES);
            let second = if more > 0 { S::load_first(from.add(S::LANES), more) } else { S::zero() };
            S::unzip(first, second)
        }
    }
}

/// Stores the first `n` pairs of even and odd lanes, at most one vector of each.
///
/// # Safety
/// The processor must have the instruction set of `S`; `2 n` values must be writable.
#[inline(always)]
pub(super) unsafe fn store_pairs<S: Simd>(to: *mut f32, n: usize, even: S::V, odd: S::V) {
    unsafe {
        let (first, second) = S::zip(even, odd);
        if n >= S::LANES {
            S::store(to, first);
            S::store(to.add(S::LANES), second);
        } else {
            S::store_first(to, 2 * n, first);
            let more = (2 * n).saturating_sub(S::LANES);
            if more > 0 {
                S::store_first(to.add(S::LANES), more, second);
            }
        }
    }
}

/// Work that runs on any instruction set.
pub(super) trait Kernel {
    /// Does the work. Implementations are `#[inline(always)]`, so that they are compiled for the instruction set.
    ///
    /// # Safety
    /// The processor must have the instruction set of `S`.
    unsafe fn run<S: Simd>(&self);
}

/// Runs `kernel` on the instruction set of `level`.
///
/// # Panics
/// For [`Level::Plain`], which has no kernels, and for a level this processor does not have.
pub(super) fn dispatch<K: Kernel>(level: Level, kernel: &K) {
    let best = Level::detect();
    #[cfg(target_arch = "x86_64")]
    match (level, best) {
        // SAFETY: the processor has been asked.
        (Level::Avx512, Level::Avx512) => return unsafe { super::x86::run_avx512(kernel) },
        // SAFETY: the processor has been asked; the level of AVX-512 includes AVX2 and FMA.
        (Level::Avx2, Level::Avx512 | Level::Avx2) => {
            return unsafe { super::x86::run_avx2(kernel) };
        }
        _ => {}
    }
    let _ = kernel;
    panic!("kernels for {level:?} on a processor with {best:?}");
}

/// Where a convolution row reads: planes of scratch rows.
#[derive(Clone, Copy)]
pub(super) struct Rows {
    /// First tap of the first output of the row, in the first channel.
    pub(super) from: *const f32,
    /// Distance of channels.
    pub(super) channel_stride: usize,
    /// Distance of rows.
    pub(super) row_stride: usize,
    /// Number of channels.
    pub(super) channels: usize,
}

/// One output row of `n` pixels for `O` output channels: `K × K` taps over all input channels.
///
/// `weights` is `[channel][tap][O]`, `bias` `[O]`, outputs lie `plane` apart. Where `bias` is null, the products are added
/// to what the outputs hold.
///
/// # Safety
/// The scratch rows must be readable up to the next multiple of 6 vectors beyond `n` plus `K`, outputs writable for `n`.
#[inline(always)]
pub(super) unsafe fn convolve_row<S: Simd, const K: usize, const O: usize>(
    rows: Rows,
    weights: *const f32,
    bias: *const f32,
    to: *mut f32,
    plane: usize,
    n: usize,
) {
    let vectors = n.div_ceil(S::LANES);
    let mut v = 0;
    unsafe {
        while v < vectors {
            let x = v * S::LANES;
            let left = n - x;
            let at = Rows { from: rows.from.add(x), ..rows };
            let step = match vectors - v {
                1 => 1,
                2 | 4 => 2,
                6.. if 2 * O <= S::BLOCK => 6,
                _ => 3,
            };
            match step {
                1 => S::tile::<K, O, 1>(&at, weights, bias, to.add(x), plane, left),
                2 => S::tile::<K, O, 2>(&at, weights, bias, to.add(x), plane, left),
                3 => S::tile::<K, O, 3>(&at, weights, bias, to.add(x), plane, left),
                _ => {
                    if 2 * O <= S::BLOCK {
                        S::tile::<K, O, 6>(&at, weights, bias, to.add(x), plane, left);
                    }
                }
            }
            v += step;
        }
    }
}

/// `O` output channels × `N` vectors of one row, in registers over all channels and taps.
#[inline(always)]
pub(super) unsafe fn tile<S: Simd, const K: usize, const O: usize, const N: usize>(
    rows: &Rows,
    mut weights: *const f32,
    bias: *const f32,
    to: *mut f32,
    plane: usize,
    left: usize,
) {
    unsafe {
        let mut sums = [[S::zero(); N]; O];
        for (o, sums) in sums.iter_mut().enumerate() {
            for (v, sum) in sums.iter_mut().enumerate() {
                *sum = if bias.is_null() {
                    S::load_first(to.add(o * plane + v * S::LANES), left.saturating_sub(v * S::LANES))
                } else {
                    S::splat(*bias.add(o))
                };
            }
        }
        let mut from = rows.from;
        for _ in 0..rows.channels {
            for ky in 0..K {
                for kx in 0..K {
                    let tap = from.add(ky * rows.row_stride + kx);
                    let mut x = [S::zero(); N];
                    for (v, x) in x.iter_mut().enumerate() {
                        *x = S::load(tap.add(v * S::LANES));
                    }
                    for (o, sums) in sums.iter_mut().enumerate() {
                        let weight = S::splat(*weights.add(o));
                        for (sum, x) in sums.iter_mut().zip(x) {
                            *sum = S::fma(weight, x, *sum);
                        }
                    }
                    weights = weights.add(O);
                }
            }
            from = from.add(rows.channel_stride);
        }
        for (o, sums) in sums.iter().enumerate() {
            for (v, &sum) in sums.iter().enumerate() {
                let at = to.add(o * plane + v * S::LANES);
                if (v + 1) * S::LANES <= left {
                    S::store(at, sum);
                } else {
                    S::store_first(at, left - v * S::LANES, sum);
                }
            }
        }
    }
}

/// Adds to `to[o·stride_o + t·stride_t]` the products summed over `rows × n` pixels of plane `o` of `a` (`O` planes) with
/// each of three pictures `b[t]`.
///
/// # Safety
/// Both must be readable to the next full vector beyond `n`, and one of the two zero there.
#[inline(always)]
pub(super) unsafe fn correlate_tile<S: Simd, const O: usize>(
    a: &Rows,
    b: &[*const f32; 3],
    b_row_stride: usize,
    rows: usize,
    n: usize,
    to: *mut f32,
    (stride_o, stride_t): (usize, usize),
) {
    unsafe {
        let mut sums = [[S::zero(); 3]; O];
        for row in 0..rows {
            let a_row = a.from.add(row * a.row_stride);
            let b_row = b.map(|b| b.add(row * b_row_stride));
            let mut x = 0;
            while x < n {
                let b0 = S::load(b_row[0].add(x));
                let b1 = S::load(b_row[1].add(x));
                let b2 = S::load(b_row[2].add(x));
                for (o, sums) in sums.iter_mut().enumerate() {
                    let a = S::load(a_row.add(o * a.channel_stride + x));
                    sums[0] = S::fma(a, b0, sums[0]);
                    sums[1] = S::fma(a, b1, sums[1]);
                    sums[2] = S::fma(a, b2, sums[2]);
                }
                x += S::LANES;
            }
        }
        for (o, sums) in sums.iter().enumerate() {
            for (t, &sum) in sums.iter().enumerate() {
                *to.add(o * stride_o + t * stride_t) += S::sum(sum);
            }
        }
    }
}

/// The transpose of a square of vectors: row `r` is read at `from(r)`, column `c` goes to `to + c·stride`.
///
/// # Safety
/// The processor must have the instruction set of `S`; a vector must be readable at each row, writable at each column.
#[inline(always)]
pub(super) unsafe fn transpose<S: Simd>(from: impl Fn(usize) -> *const f32, to: *mut f32, stride: usize) {
    unsafe {
        let mut rows = [S::zero(); 16];
        for (r, row) in rows.iter_mut().enumerate().take(S::LANES) {
            *row = S::load(from(r));
        }
        // Every round of interleaving rows half the square apart turns the pair (row, column) by one bit.
        let mut rounds = 1;
        while rounds < S::LANES {
            let before = rows;
            for r in 0..S::LANES / 2 {
                (rows[2 * r], rows[2 * r + 1]) = S::zip(before[r], before[r + S::LANES / 2]);
            }
            rounds *= 2;
        }
        for (c, row) in rows.iter().enumerate().take(S::LANES) {
            S::store(to.add(c * stride), *row);
        }
    }
}

/// Blocks of output channels that `total` is cut into: `(first, size)` with sizes 8, 4, 3, 2, 1, at most `largest`.
pub(super) fn blocks(total: usize, largest: usize) -> impl Iterator<Item = (usize, usize)> {
    let mut first = 0;
    std::iter::from_fn(move || {
        let size = [8, 4, 3, 2, 1].into_iter().find(|&size| size <= largest && first + size <= total)?;
        first += size;
        Some((first - size, size))
    })
}
