//! Convolution and transposed convolution of small planes with many channels, and their cotangents: lanes run along all
//! rows of all pictures as one line ([`super::flat`]), so that a plane of 4 × 4 fills vectors too.

use super::flat::{Line, Lines};
use super::inner::store_pairs;
use super::panel::Panel;
use super::product::{Block, Finish, group, outer, product};
use super::strip::{activate_vjp, filled};
use super::{Extent, Level, Source, SourceBar, Wanted, recycle};
use isoplanat_base::math::simd::F32;

/// Taps of the transposed convolution: row and column of the 2×2 block.
const CORNERS: usize = 4;

/// Widest planes that are convolved here; wider ones fill their vectors row by row.
const CONVOLVED: usize = 64;

/// Widest planes whose 1×1 and transposed convolutions, plain products of matrices, are done here.
const MULTIPLIED: usize = 32;

/// Whether planes of this size are convolved here.
pub(super) fn convolves(extent: Extent, pointwise: bool) -> bool {
    extent.columns <= if pointwise { MULTIPLIED } else { CONVOLVED }
}

/// Whether planes of this size are unpooled here.
pub(super) fn unpools(extent: Extent) -> bool {
    extent.columns <= MULTIPLIED
}

/// As [`super::convolve`], with `SIDE × SIDE` taps.
pub(super) fn convolve<const SIDE: usize>(
    level: Level,
    sources: &[Source],
    extent: Extent,
    weight: &[f32],
    bias: &[f32],
) -> Vec<f32> {
    let lines = Lines::load(level, sources, extent, SIDE);
    let (inputs, taps) = (lines.channels, SIDE * SIDE);
    let pack = |Block { first, size, channels, to }: Block| {
        let n = channels.len() * taps;
        interleave(size, |output| &weight[((first + output) * inputs + channels.start) * taps..][..n], to);
    };
    let output = filled(extent.batch * bias.len() * extent.plane(), |to| {
        let size = group(bias.len());
        let groups =
            Panel::cut(to, bias.len() * extent.plane(), size * extent.plane()).map(|panel| Store::plain(panel, extent));
        product::<SIDE>(level, &lines, bias, pack, groups.collect());
    });
    lines.release();
    output
}

/// As [`super::convolve_vjp`], with `SIDE × SIDE` taps.
pub(super) fn convolve_vjp<const SIDE: usize>(
    level: Level,
    sources: &[Source],
    extent: Extent,
    weight: &[f32],
    output_bar: &[f32],
    wanted: Wanted,
) -> (Vec<SourceBar>, Vec<f32>, Vec<f32>) {
    let inputs: usize = sources.iter().map(|s| s.channels).sum();
    let taps = SIDE * SIDE;
    let outputs = weight.len() / (inputs * taps);
    let bars = Lines::load(level, &[Source { values: output_bar, channels: outputs, slope: None }], extent, SIDE);
    let source_bars = if wanted.inputs {
        // The convolution of the output's cotangent with the weights turned by 180° and transposed.
        let pack = |Block { first, size, channels, to }: Block| {
            for (output, to) in channels.zip(to.chunks_exact_mut(taps * size)) {
                turn::<SIDE>(size, &weight[(output * inputs + first) * taps..][..size * taps], to);
            }
        };
        pulled(sources, extent, |groups| product::<SIDE>(level, &bars, &vec![0.0; inputs], pack, groups))
    } else {
        vec![SourceBar::default(); sources.len()]
    };
    let (mut weight_bar, mut bias_bar) = (vec![], vec![]);
    if wanted.weights {
        let values = Lines::load(level, sources, extent, SIDE);
        let stride = values.line.row_stride() as isize;
        let column = |k: usize| {
            let [row, column] = [k % taps / SIDE, k % SIDE].map(|tap| tap as isize - (SIDE / 2) as isize);
            // Lines have their reach and a vector's room on both sides.
            values.from(k / taps, row * stride + column)
        };
        weight_bar = outer(level, &bars, inputs * taps, column);
        bias_bar = (0..outputs).map(|o| bars.of(o).iter().sum()).collect();
        values.release();
    }
    bars.release();
    (source_bars, weight_bar, bias_bar)
}

/// As [`super::unpool`].
pub(super) fn unpool(level: Level, source: Source, extent: Extent, weight: &[f32], bias: &[f32]) -> Vec<f32> {
    let products = bias.len() * CORNERS;
    let lines = Lines::load(level, &[source], extent, 1);
    let spread: Vec<f32> = bias.iter().flat_map(|&b| [b; CORNERS]).collect();
    let pack = |Block { first, size, channels, to }: Block| {
        for (channel, to) in channels.zip(to.chunks_exact_mut(size)) {
            let from = &weight[channel * products + first..][..size];
            to.iter_mut().zip(from).for_each(|(to, &from)| *to = from);
        }
    };
    let output = filled(extent.batch * products * extent.plane(), |to| {
        let fine = CORNERS * extent.plane();
        let groups = Panel::cut(to, bias.len() * fine, group(products) / CORNERS * fine);
        product::<1>(level, &lines, &spread, pack, groups.map(|to| Interleave { to, extent }).collect());
    });
    lines.release();
    output
}

/// As [`super::unpool_vjp`].
pub(super) fn unpool_vjp(
    level: Level,
    source: Source,
    extent: Extent,
    weight: &[f32],
    output_bar: &[f32],
    wanted: Wanted,
) -> (SourceBar, Vec<f32>, Vec<f32>) {
    let inputs = source.channels;
    let products = weight.len() / inputs;
    let outputs = products / CORNERS;
    let bars = Lines::written(Line::new(extent, 1), products, |m, line| {
        let (channel, y, x) = (m / CORNERS, m % CORNERS / 2, m % 2);
        for (row, to) in line.chunks_exact_mut(extent.columns).enumerate() {
            let (image, row) = (row / extent.rows, row % extent.rows);
            let from = ((image * outputs + channel) * 2 * extent.rows + 2 * row + y) * 2 * extent.columns;
            let from = &output_bar[from..][..2 * extent.columns];
            to.iter_mut().zip(from[x..].iter().step_by(2)).for_each(|(to, &from)| *to = from);
        }
    });
    let mut source_bar = SourceBar::default();
    if wanted.inputs {
        let pack = |Block { first, size, channels, to }: Block| {
            let n = channels.len();
            interleave(size, |input| &weight[(first + input) * products + channels.start..][..n], to);
        };
        let product = |groups: Vec<Store>| product::<1>(level, &bars, &vec![0.0; inputs], pack, groups);
        source_bar = pulled(&[source], extent, product).remove(0);
    }
    let (mut weight_bar, mut bias_bar) = (vec![], vec![]);
    if wanted.weights {
        let values = Lines::load(level, &[source], extent, 1);
        weight_bar = outer(level, &values, products, |m| bars.from(m, 0));
        let sum = |m: usize| bars.of(m).iter().sum::<f32>();
        bias_bar = (0..outputs).map(|o| (0..CORNERS).map(|c| sum(CORNERS * o + c)).sum()).collect();
        values.release();
    }
    bars.release();
    (source_bar, weight_bar, bias_bar)
}

/// Writes `size` rows as `[value][row]`.
#[inline(always)]
pub(super) fn interleave<'a>(size: usize, row: impl Fn(usize) -> &'a [f32], to: &mut [f32]) {
    if size == 8 {
        // The usual block, with its loop over rows unrolled.
        let rows: [&[f32]; 8] = std::array::from_fn(&row);
        let n = rows[0].len();
        let rows = rows.map(|row| &row[..n]);
        for (k, to) in to.as_chunks_mut::<8>().0[..n].iter_mut().enumerate() {
            for (to, row) in to.iter_mut().zip(&rows) {
                *to = row[k];
            }
        }
        return;
    }
    for at in 0..size {
        to[at..].iter_mut().step_by(size).zip(row(at)).for_each(|(to, &from)| *to = from);
    }
}

/// Writes `[channel][tap]` as `[tap, last first][channel]` for `size` channels.
#[inline(always)]
fn turn<const SIDE: usize>(size: usize, from: &[f32], to: &mut [f32]) {
    if SIDE == 1 {
        to.copy_from_slice(from);
        return;
    }
    if let (3, 8, [from], [to]) = (SIDE, size, from.as_chunks::<72>().0, to.as_chunks_mut::<72>().0) {
        for tap in 0..9 {
            for channel in 0..8 {
                to[tap * 8 + channel] = from[channel * 9 + 8 - tap];
            }
        }
        return;
    }
    for (channel, from) in from.chunks_exact(SIDE * SIDE).enumerate() {
        to[channel..].iter_mut().step_by(size).zip(from.iter().rev()).for_each(|(to, &from)| *to = from);
    }
}

/// Cotangents of the sources, whose activated ones `product` computes as outputs of one list.
fn pulled(sources: &[Source], extent: Extent, product: impl FnOnce(Vec<Store>)) -> Vec<SourceBar> {
    let channels: usize = sources.iter().map(|s| s.channels).sum();
    let (size, plane) = (group(channels), extent.plane());
    let mut bars: Vec<Vec<f32>> = sources.iter().map(|s| recycle::take(s.values.len())).collect();
    let mut slopes = vec![0.0; channels];
    let mut groups: Vec<Store> =
        slopes.chunks_mut(size).map(|slope_bars| Store { pieces: vec![], extent, slope_bars }).collect();
    let mut before = 0;
    for (bar, &source) in bars.iter_mut().zip(sources) {
        // Where the groups cut this source's channels.
        let mut cuts = Vec::new();
        let mut channel = 0;
        while channel < source.channels {
            let count = (size - (before + channel) % size).min(source.channels - channel);
            cuts.push((channel, count));
            channel += count;
        }
        let panels = Panel::cut_at(bar, source.channels * plane, cuts.iter().map(|(_, count)| count * plane));
        for (panel, &(first, _)) in panels.zip(&cuts) {
            groups[(before + first) / size].pieces.push(Piece { panel, source: Some((source, first)) });
        }
        before += source.channels;
    }
    product(groups);
    let mut slopes = slopes.into_iter();
    let pulled = bars.into_iter().zip(sources).map(|(values, source)| {
        let slope: Vec<f32> = slopes.by_ref().take(source.channels).collect();
        SourceBar { values, slope: if source.slope.is_some() { slope } else { vec![] } }
    });
    pulled.collect()
}

/// Some channels of pictures: a row a picture.
struct Piece<'a> {
    panel: Panel<'a>,
    /// The pictures whose cotangent this is, and the first of the channels in them.
    source: Option<(Source<'a>, usize)>,
}

/// Writes lines as rows of pictures; cotangents go through the PReLU of their source.
pub(super) struct Store<'a> {
    pieces: Vec<Piece<'a>>,
    extent: Extent,
    /// One value an output, or none.
    slope_bars: &'a mut [f32],
}

impl<'a> Store<'a> {
    /// For lines that are the panel's channels, planes of `extent`, as they are.
    pub(super) fn plain(panel: Panel<'a>, extent: Extent) -> Self {
        Self { pieces: vec![Piece { panel, source: None }], extent, slope_bars: &mut [] }
    }
}

impl Finish for Store<'_> {
    #[inline(always)]
    fn run<S: F32>(&mut self, simd: S, line: &Line, lines: &[f32], stride: usize) {
        // Of the line: without taps around it a plane is one row.
        let Extent { batch, rows, columns } = line.extent;
        let plane = self.extent.plane();
        let mut lines = lines.chunks_exact(stride);
        let mut slope_bars = self.slope_bars.iter_mut();
        for Piece { panel, source } in &mut self.pieces {
            let channels = panel.row(0).len() / plane;
            for (channel, lines) in (0..channels).zip(&mut lines) {
                let activation =
                    source.as_ref().and_then(|(s, first)| Some((s, first + channel, s.slope?[first + channel])));
                let mut slope_bar = 0.0;
                for (image, row) in (0..batch).flat_map(|image| (0..rows).map(move |row| (image, row))) {
                    let from = &lines[line.at(image, row)..][..columns];
                    let to = &mut panel.row(image)[channel * plane + row * columns..][..columns];
                    for x in (0..columns).step_by(S::LANES) {
                        simd.store_first(&mut to[x..], simd.load_first(&from[x..]));
                    }
                    if let Some((source, channel, slope)) = activation {
                        let at = (image * source.channels + channel) * plane + row * columns;
                        slope_bar += activate_vjp(simd, to, &source.values[at..][..columns], slope);
                    }
                }
                if let Some(slope) = slope_bars.next() {
                    *slope = slope_bar;
                }
            }
        }
    }
}

/// Writes the four products of every channel into 2×2 blocks of the finer pictures.
struct Interleave<'a> {
    /// Whole channels: a row a picture.
    to: Panel<'a>,
    /// Of the coarse pictures.
    extent: Extent,
}

impl Finish for Interleave<'_> {
    #[inline(always)]
    fn run<S: F32>(&mut self, simd: S, _: &Line, lines: &[f32], stride: usize) {
        let Extent { batch, rows, columns } = self.extent;
        for (pair, lines) in lines.chunks_exact(2 * stride).enumerate() {
            let (channel, y) = (2 * pair / CORNERS, 2 * pair % CORNERS / 2);
            let (left, right) = lines.split_at(stride);
            for (image, row) in (0..batch).flat_map(|image| (0..rows).map(move |row| (image, row))) {
                let at = (image * rows + row) * columns;
                let (left, right) = (&left[at..][..columns], &right[at..][..columns]);
                let to = &mut self.to.row(image)[(channel * 2 * rows + 2 * row + y) * 2 * columns..][..2 * columns];
                for x in (0..columns).step_by(S::LANES) {
                    let (even, odd) = (simd.load_first(&left[x..]), simd.load_first(&right[x..]));
                    store_pairs(simd, &mut to[2 * x..], even, odd);
                }
            }
        }
    }
}
