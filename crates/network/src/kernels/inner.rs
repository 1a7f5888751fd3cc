//! Register-blocked inner loops over the vector operations: a block of output channels × vectors stays in registers over
//! all input channels and taps.

use super::Level;
use super::panel::Panel;
use isoplanat_base::math::simd::{F32, Kernel, Simd};

/// Most sums of a picture at once in [`correlate`].
pub(super) const PICTURES: usize = 3;

/// The pairs of `from` as even and odd lanes, at most one vector of each; zeros beyond.
#[inline(always)]
pub(super) fn load_pairs<S: F32>(simd: S, from: &[f32]) -> (S::V, S::V) {
    let (whole, rest) = simd.cut(from);
    match whole {
        [first, second, ..] => simd.unzip(simd.load(first), simd.load(second)),
        [first] => simd.unzip(simd.load(first), simd.load_first(rest)),
        [] => simd.unzip(simd.load_first(rest), simd.splat(0.0)),
    }
}

/// Stores pairs of even and odd lanes, at most one vector of each and as many as `to` takes.
#[inline(always)]
pub(super) fn store_pairs<S: F32>(simd: S, to: &mut [f32], even: S::V, odd: S::V) {
    let (first, second) = simd.zip(even, odd);
    let (whole, rest) = simd.cut_mut(to);
    match whole {
        [a, b, ..] => {
            simd.store(a, first);
            simd.store(b, second);
        }
        [a] => {
            simd.store(a, first);
            simd.store_first(rest, second);
        }
        [] => simd.store_first(rest, first),
    }
}

/// Where a convolution row reads: planes of scratch rows.
#[derive(Clone, Copy)]
pub(super) struct Rows<'a> {
    /// From the first tap of the first output of the row, in the first channel, on.
    pub(super) from: &'a [f32],
    /// Distance of channels.
    pub(super) channel_stride: usize,
    /// Distance of rows.
    pub(super) row_stride: usize,
    /// Number of channels.
    pub(super) channels: usize,
}

/// Where a convolution row writes: from `row` on a row of `panel` for each output, `n` values from column `at` on.
pub(super) struct PanelRow<'t, 'a> {
    pub(super) panel: &'t mut Panel<'a>,
    pub(super) row: usize,
    pub(super) at: usize,
    pub(super) n: usize,
}

/// One output row for a block of `size` output channels: `K × K` taps over all input channels.
///
/// `weights` is `[channel][tap][size]`, `bias` has `size` values. Without a bias the products are added to what the
/// outputs hold. Scratch rows reach to the end of the vector in which the row ends, and `K` values more.
#[inline(always)]
pub(super) fn convolve_row<S: Simd, const K: usize>(
    simd: S,
    size: usize,
    rows: Rows,
    weights: &[f32],
    bias: Option<&[f32]>,
    to: PanelRow,
) {
    match size {
        8 => block_row::<S, K, 8>(simd, rows, weights, bias, to),
        4 => block_row::<S, K, 4>(simd, rows, weights, bias, to),
        3 => block_row::<S, K, 3>(simd, rows, weights, bias, to),
        2 => block_row::<S, K, 2>(simd, rows, weights, bias, to),
        _ => block_row::<S, K, 1>(simd, rows, weights, bias, to),
    }
}

#[inline(always)]
fn block_row<S: Simd, const K: usize, const O: usize>(
    simd: S,
    rows: Rows,
    weights: &[f32],
    bias: Option<&[f32]>,
    to: PanelRow,
) {
    let PanelRow { panel, row, at, n } = to;
    let vectors = n.div_ceil(S::LANES);
    let mut v = 0;
    while v < vectors {
        let x = v * S::LANES;
        let rows = Rows { from: &rows.from[x..], ..rows };
        let to = PanelRow { panel: &mut *panel, row, at: at + x, n: n - x };
        let step = match vectors - v {
            1 => 1,
            2 | 4 => 2,
            6.. if 2 * O <= S::BLOCK => 6,
            _ => 3,
        };
        match step {
            1 => simd.run(Tile::<K, O, 1> { rows, weights, bias, to }),
            2 => simd.run(Tile::<K, O, 2> { rows, weights, bias, to }),
            3 => simd.run(Tile::<K, O, 3> { rows, weights, bias, to }),
            _ => {
                if 2 * O <= S::BLOCK {
                    simd.run(Tile::<K, O, 6> { rows, weights, bias, to });
                }
            }
        }
        v += step;
    }
}

/// `O` output channels × `N` vectors of one row, in registers over all channels and taps.
struct Tile<'a, 't, 'p, const K: usize, const O: usize, const N: usize> {
    rows: Rows<'a>,
    weights: &'a [f32],
    bias: Option<&'a [f32]>,
    to: PanelRow<'t, 'p>,
}

impl<const K: usize, const O: usize, const N: usize> Kernel for Tile<'_, '_, '_, K, O, N> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { rows, weights, bias, to: PanelRow { panel, row, at, n } } = self;
        let mut first = [[simd.splat(0.0); N]; O];
        for (o, first) in first.iter_mut().enumerate() {
            for (v, first) in first.iter_mut().enumerate() {
                *first = match bias {
                    Some(bias) => simd.splat(bias[o]),
                    None => simd.load_first(&panel.row(row + o)[at..][..n][v * S::LANES..]),
                };
            }
        }
        let sums = sum_taps::<S, K, O, N>(simd, rows, weights, first);
        for (o, sums) in sums.iter().enumerate() {
            let to = &mut panel.row(row + o)[at..][..n];
            for (v, &sum) in sums.iter().enumerate() {
                if (v + 1) * S::LANES <= n {
                    simd.store_at(to, v * S::LANES, sum);
                } else {
                    simd.store_first(&mut to[v * S::LANES..], sum);
                }
            }
        }
    }
}

/// Adds the products to the sums, which come and go by value: what is done with them elsewhere must not keep them out of
/// the registers here.
#[inline(always)]
fn sum_taps<S: F32, const K: usize, const O: usize, const N: usize>(
    simd: S,
    rows: Rows,
    weights: &[f32],
    mut sums: [[S::V; N]; O],
) -> [[S::V; N]; O] {
    for (channel, weights) in (0..rows.channels).zip(weights.chunks_exact(K * K * O)) {
        for ky in 0..K {
            let taps = &rows.from[channel * rows.channel_stride + ky * rows.row_stride..][..K - 1 + N * S::LANES];
            for kx in 0..K {
                let mut x = [simd.splat(0.0); N];
                for (v, x) in x.iter_mut().enumerate() {
                    *x = simd.load_at(taps, kx + v * S::LANES);
                }
                for (o, sums) in sums.iter_mut().enumerate() {
                    let weight = simd.splat(weights[(ky * K + kx) * O + o]);
                    for (sum, x) in sums.iter_mut().zip(x) {
                        *sum = simd.fma(weight, x, *sum);
                    }
                }
            }
        }
    }
    sums
}

/// Products of planes of `a` with three pictures, summed over `rows × n` pixels.
pub(super) struct Correlation<'a> {
    pub(super) a: Rows<'a>,
    pub(super) b: [&'a [f32]; PICTURES],
    /// Distance of rows in `b`.
    pub(super) b_row_stride: usize,
    pub(super) rows: usize,
    pub(super) n: usize,
}

/// Adds to `to[o·stride_o + t·stride_t]` the products of plane `o` of `a`, one of `size`, with picture `t`.
///
/// Rows reach to the end of the vector in which they end; `a` or `b` is zero there.
#[inline(always)]
pub(super) fn correlate<S: Simd>(simd: S, size: usize, of: Correlation, to: &mut [f32], strides: (usize, usize)) {
    match size {
        8 => simd.run(Correlate::<8> { of, to, strides }),
        4 => simd.run(Correlate::<4> { of, to, strides }),
        3 => simd.run(Correlate::<3> { of, to, strides }),
        2 => simd.run(Correlate::<2> { of, to, strides }),
        _ => simd.run(Correlate::<1> { of, to, strides }),
    }
}

struct Correlate<'a, const O: usize> {
    of: Correlation<'a>,
    to: &'a mut [f32],
    strides: (usize, usize),
}

impl<const O: usize> Kernel for Correlate<'_, O> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { of, to, strides: (stride_o, stride_t) } = self;
        let sums = sum_rows::<S, O>(simd, of, [[simd.splat(0.0); PICTURES]; O]);
        for (o, sums) in sums.iter().enumerate() {
            for (t, &sum) in sums.iter().enumerate() {
                to[o * stride_o + t * stride_t] += simd.sum(sum);
            }
        }
    }
}

/// Adds the products to the sums, by value as in [`sum_taps`].
#[inline(always)]
fn sum_rows<S: F32, const O: usize>(
    simd: S,
    Correlation { a, b, b_row_stride, rows, n }: Correlation,
    mut sums: [[S::V; PICTURES]; O],
) -> [[S::V; PICTURES]; O] {
    let vectors = n.div_ceil(S::LANES);
    for row in 0..rows {
        let mut pictures = [&[][..]; PICTURES];
        for (picture, b) in pictures.iter_mut().zip(b) {
            *picture = &simd.cut(&b[row * b_row_stride..][..vectors * S::LANES]).0[..vectors];
        }
        let mut planes = [&[][..]; O];
        for (o, plane) in planes.iter_mut().enumerate() {
            let from = &a.from[o * a.channel_stride + row * a.row_stride..][..vectors * S::LANES];
            *plane = &simd.cut(from).0[..vectors];
        }
        for x in 0..vectors {
            let [b0, b1, b2] = pictures;
            let (b0, b1, b2) = (simd.load(&b0[x]), simd.load(&b1[x]), simd.load(&b2[x]));
            for (plane, sums) in planes.iter().zip(&mut sums) {
                let a = simd.load(&plane[x]);
                sums[0] = simd.fma(a, b0, sums[0]);
                sums[1] = simd.fma(a, b1, sums[1]);
                sums[2] = simd.fma(a, b2, sums[2]);
            }
        }
    }
    sums
}

/// The transpose of a square of vectors: row `r` is what `row(r)` starts with, column `c` goes to `to[c·stride..]`.
#[inline(always)]
pub(super) fn transpose<'a, S: F32>(simd: S, row: impl Fn(usize) -> &'a [f32], to: &mut [f32], stride: usize) {
    let mut rows = [simd.splat(0.0); 16];
    for (r, to) in rows.iter_mut().enumerate().take(S::LANES) {
        *to = simd.load_at(row(r), 0);
    }
    // Every round of interleaving rows half the square apart turns the pair (row, column) by one bit.
    let mut rounds = 1;
    while rounds < S::LANES {
        let before = rows;
        for r in 0..S::LANES / 2 {
            (rows[2 * r], rows[2 * r + 1]) = simd.zip(before[r], before[r + S::LANES / 2]);
        }
        rounds *= 2;
    }
    for (c, row) in rows.iter().enumerate().take(S::LANES) {
        simd.store_at(to, c * stride, *row);
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

/// Largest block of output channels in packed weights.
pub(super) fn largest(level: Level) -> usize {
    level.run(Largest)
}

struct Largest;

impl Kernel for Largest {
    type Output = usize;
    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> usize {
        S::BLOCK
    }
}
