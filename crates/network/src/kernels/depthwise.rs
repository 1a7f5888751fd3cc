//! Depthwise 3×3 convolution with zero padding, every channel with taps of its own, and its cotangents.
//!
//! A plane is a task. Strips of its rows go through a scratch buffer as in a convolution; four rows of results are made at a
//! time, so that a row that is read serves three of them.

use rayon::prelude::*;

use super::convolution::bias_strip;
use super::inner::Rows;
use super::strip::{Layout, Scratch, activate_vjp, filled, load_activated, rows_of_strip, with_scratch};
use super::{Extent, Level, Source, SourceBar, Wanted, recycle};
use isoplanat_base::math::raster::parts;
use isoplanat_base::math::simd::{F32, Kernel, Simd};

const SIDE: usize = 3;
const TAPS: usize = SIDE * SIDE;

/// Output `[batch, channels, rows, columns]`; `weight` is `[channels, 1, 3, 3]`.
pub(in super::super) fn depthwise(
    level: Level,
    source: Source,
    extent: Extent,
    weight: &[f32],
    bias: &[f32],
) -> Vec<f32> {
    check(source, extent, weight);
    assert_eq!(bias.len(), source.channels);
    filled(source.values.len(), |output| {
        output.par_chunks_mut(extent.plane()).enumerate().for_each(|(plane, to)| {
            let channel = plane % source.channels;
            let (taps, bias) = (taps_of(weight, channel), bias[channel]);
            let (source, extent) = plane_of(source, extent, plane);
            with_scratch(|[scratch, ..]| level.run(Forward { source, extent, taps, bias, to, scratch }));
        });
    })
}

fn check(source: Source, extent: Extent, weight: &[f32]) {
    assert_eq!(source.values.len(), extent.batch * source.channels * extent.plane());
    assert_eq!(weight.len(), source.channels * TAPS);
}

fn taps_of(weight: &[f32], channel: usize) -> [f32; TAPS] {
    weight.as_chunks().0[channel]
}

/// One plane of a batch as a picture of its own.
fn plane_of(source: Source, extent: Extent, plane: usize) -> (Source, Extent) {
    let channel = plane % source.channels;
    let values = &source.values[plane * extent.plane()..][..extent.plane()];
    let slope = source.slope.map(|slope| &slope[channel..=channel]);
    (Source { values, channels: 1, slope }, Extent { batch: 1, ..extent })
}

struct Forward<'a> {
    source: Source<'a>,
    extent: Extent,
    taps: [f32; TAPS],
    bias: f32,
    to: &'a mut [f32],
    scratch: &'a mut Scratch,
}

impl Kernel for Forward<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { source, extent, taps, bias, to, scratch } = self;
        let (step, columns) = (rows_of_strip(extent, 1), extent.columns);
        for (first, rows) in parts(extent.rows, step).map(|part| (part.start, part.len())) {
            let layout = Layout::new(1, rows + SIDE - 1, columns);
            let buffer = scratch.get(layout.len());
            load_activated(simd, &[source], extent, 0, first as isize - 1, &layout, buffer);
            let to = &mut to[first * columns..][..rows * columns];
            convolve_rows(simd, layout.rows_from(buffer, 0, 0, 1), taps, bias, columns, to);
        }
    }
}

/// Rows of `columns` results from the rows around them.
#[inline(always)]
fn convolve_rows<S: Simd>(simd: S, from: Rows, taps: [f32; TAPS], bias: f32, columns: usize, to: &mut [f32]) {
    let rows = to.len() / columns;
    let mut row = 0;
    while row < rows {
        let from = Rows { from: &from.from[row * from.row_stride..], ..from };
        let to = &mut to[row * columns..];
        row += match rows - row {
            4.. => {
                simd.run(Several::<4> { from, taps, bias, columns, to });
                4
            }
            2 | 3 => {
                simd.run(Several::<2> { from, taps, bias, columns, to });
                2
            }
            _ => {
                simd.run(Several::<1> { from, taps, bias, columns, to });
                1
            }
        };
    }
}

/// `R` rows of results.
struct Several<'a, const R: usize> {
    from: Rows<'a>,
    taps: [f32; TAPS],
    bias: f32,
    columns: usize,
    to: &'a mut [f32],
}

impl<const R: usize> Kernel for Several<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { from, taps, bias, columns, to } = self;
        let mut at = 0;
        while at < columns {
            let from = Rows { from: &from.from[at..], ..from };
            if columns - at > S::LANES {
                let sums = sum_taps::<S, R, 2>(simd, from, &taps, bias);
                store::<S, R, 2>(simd, sums, columns, at, to);
                at += 2 * S::LANES;
            } else {
                let sums = sum_taps::<S, R, 1>(simd, from, &taps, bias);
                store::<S, R, 1>(simd, sums, columns, at, to);
                at += S::LANES;
            }
        }
    }
}

/// `R` rows × `N` vectors.
#[inline(always)]
fn sum_taps<S: F32, const R: usize, const N: usize>(
    simd: S,
    from: Rows,
    taps: &[f32; TAPS],
    bias: f32,
) -> [[S::V; N]; R] {
    let mut sums = [[simd.splat(bias); N]; R];
    // By hand, so that sums are named by constants and stay in registers.
    add_row::<S, R, N, 0>(simd, from, taps, &mut sums);
    add_row::<S, R, N, 1>(simd, from, taps, &mut sums);
    add_row::<S, R, N, 2>(simd, from, taps, &mut sums);
    add_row::<S, R, N, 3>(simd, from, taps, &mut sums);
    add_row::<S, R, N, 4>(simd, from, taps, &mut sums);
    add_row::<S, R, N, 5>(simd, from, taps, &mut sums);
    sums
}

/// What row `Y` gives to the results; nothing where they do not reach so far.
#[inline(always)]
fn add_row<S: F32, const R: usize, const N: usize, const Y: usize>(
    simd: S,
    from: Rows,
    taps: &[f32; TAPS],
    sums: &mut [[S::V; N]; R],
) {
    if Y >= R + SIDE - 1 {
        return;
    }
    let row = &from.from[Y * from.row_stride..][..SIDE - 1 + N * S::LANES];
    for kx in 0..SIDE {
        let mut x = [simd.splat(0.0); N];
        for (v, x) in x.iter_mut().enumerate() {
            *x = simd.load_at(row, kx + v * S::LANES);
        }
        // It is the tap `Y − r` of the result `r`.
        for (r, sums) in sums.iter_mut().enumerate() {
            if Y >= r && Y - r < SIDE {
                let tap = simd.splat(taps[(Y - r) * SIDE + kx]);
                for (sum, x) in sums.iter_mut().zip(x) {
                    *sum = simd.fma(tap, x, *sum);
                }
            }
        }
    }
}

#[inline(always)]
fn store<S: F32, const R: usize, const N: usize>(
    simd: S,
    sums: [[S::V; N]; R],
    columns: usize,
    at: usize,
    to: &mut [f32],
) {
    for (r, sums) in sums.iter().enumerate() {
        let to = &mut to[r * columns..][at..columns];
        for (v, &sum) in sums.iter().enumerate() {
            simd.store_first(&mut to[v * S::LANES..], sum);
        }
    }
}

/// Cotangents of [`depthwise`]: of the source, the weight, the bias (empty where not wanted).
pub(in super::super) fn depthwise_vjp(
    level: Level,
    source: Source,
    extent: Extent,
    weight: &[f32],
    output_bar: &[f32],
    wanted: Wanted,
) -> (SourceBar, Vec<f32>, Vec<f32>) {
    check(source, extent, weight);
    assert_eq!(output_bar.len(), source.values.len());
    let (channels, planes) = (source.channels, extent.batch * source.channels);
    let mut values = recycle::take(if wanted.inputs { source.values.len() } else { 0 });
    let mut parts: Vec<Option<&mut [f32]>> = values.chunks_mut(extent.plane()).map(Some).collect();
    parts.resize_with(planes, || None);
    let output_bar = Source { values: output_bar, channels, slope: None };
    let sums: Vec<PlaneSums> = parts
        .into_par_iter()
        .enumerate()
        .map(|(plane, to)| {
            let turned: [f32; TAPS] = std::array::from_fn(|tap| taps_of(weight, plane % channels)[TAPS - 1 - tap]);
            let (output_bar, _) = plane_of(output_bar, extent, plane);
            let (source, extent) = plane_of(source, extent, plane);
            with_scratch(|[a, b, _]| {
                level.run(Backward { source, extent, turned, output_bar, wanted, to, scratch: (a, b) })
            })
        })
        .collect();
    // Over the pictures of the batch, in order.
    let total = |channel: usize, part: &dyn Fn(&PlaneSums) -> f32| -> f32 {
        sums[channel..].iter().step_by(channels).map(part).sum()
    };
    let slope = if source.slope.is_some() { (0..channels).map(|c| total(c, &|s| s.slope)).collect() } else { vec![] };
    let (mut weight_bar, mut bias_bar) = (vec![], vec![]);
    if wanted.weights {
        weight_bar = (0..channels * TAPS).map(|i| total(i / TAPS, &|s| s.taps[i % TAPS])).collect();
        bias_bar = (0..channels).map(|c| total(c, &|s| s.bias)).collect();
    }
    (SourceBar { values, slope }, weight_bar, bias_bar)
}

/// Sums over one plane.
#[derive(Default)]
struct PlaneSums {
    taps: [f32; TAPS],
    bias: f32,
    slope: f32,
}

struct Backward<'a> {
    source: Source<'a>,
    extent: Extent,
    turned: [f32; TAPS],
    output_bar: Source<'a>,
    wanted: Wanted,
    to: Option<&'a mut [f32]>,
    scratch: (&'a mut Scratch, &'a mut Scratch),
}

impl Kernel for Backward<'_> {
    type Output = PlaneSums;
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> PlaneSums {
        let Self { source, extent, turned, output_bar, wanted, mut to, scratch } = self;
        let (step, columns) = (rows_of_strip(extent, 2), extent.columns);
        let mut sums = PlaneSums::default();
        for (first, rows) in parts(extent.rows, step).map(|part| (part.start, part.len())) {
            let bar_layout = Layout::new(1, rows + SIDE - 1, columns);
            let bars = scratch.0.get(bar_layout.len());
            load_activated(simd, &[output_bar], extent, 0, first as isize - 1, &bar_layout, bars);
            if let Some(to) = &mut to {
                // The convolution of the output's cotangent with the taps turned by 180°.
                let to = &mut to[first * columns..][..rows * columns];
                convolve_rows(simd, bar_layout.rows_from(bars, 0, 0, 1), turned, 0.0, columns, to);
                if let Some(slope) = source.slope {
                    let values = &source.values[first * columns..][..rows * columns];
                    sums.slope += activate_vjp(simd, to, values, slope[0]);
                }
            }
            if wanted.weights {
                let layout = Layout::new(1, rows, columns);
                let values = scratch.1.get(layout.len());
                load_activated(simd, &[source], extent, 0, first as isize, &layout, values);
                let (from, bar_rows) = (layout.rows_from(values, 0, 0, 1), bar_layout.rows_from(bars, 0, 0, 0));
                simd.run(Weights { values: from, bars: bar_rows, rows, columns, to: &mut sums.taps });
                bias_strip(simd, (&bar_layout, bars), 1, rows, columns, std::slice::from_mut(&mut sums.bias));
            }
        }
        sums
    }
}

/// Adds what a strip's values, with a column of zeros before them, give to the weights' cotangents; of `bars` it reads the
/// strip's rows and those above and below.
struct Weights<'a> {
    values: Rows<'a>,
    bars: Rows<'a>,
    rows: usize,
    columns: usize,
    to: &'a mut [f32; TAPS],
}

impl Kernel for Weights<'_> {
    type Output = ();
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { values, bars, rows, columns, to } = self;
        let width = columns.next_multiple_of(S::LANES);
        let mut sums = [[simd.splat(0.0); SIDE]; SIDE];
        for row in 0..rows {
            let from = &values.from[row * values.row_stride..][..width + SIDE - 1];
            // The results that see this row by their lowest, middle and highest taps.
            let bar = |ky: usize| &bars.from[(row + SIDE - 1 - ky) * bars.row_stride..][..width];
            let bars = [bar(0), bar(1), bar(2)];
            for x in (0..width).step_by(S::LANES) {
                let mut shifted = [simd.splat(0.0); SIDE];
                for (kx, shifted) in shifted.iter_mut().enumerate() {
                    *shifted = simd.load_at(from, x + kx);
                }
                for (bar, sums) in bars.iter().zip(&mut sums) {
                    let bar = simd.load_at(bar, x);
                    for (sum, value) in sums.iter_mut().zip(shifted) {
                        *sum = simd.fma(bar, value, *sum);
                    }
                }
            }
        }
        for (to, sum) in to.iter_mut().zip(sums.as_flattened()) {
            *to += simd.sum(*sum);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Plain, assert_close, draw, soil_scratch};
    use super::*;

    #[test]
    fn depthwise_convolution_and_cotangents_match_plain_loops() {
        for level in Level::available() {
            let rng = &mut fastrand::Rng::with_seed(7);
            for (channels, batch, rows, columns) in [
                (1, 1, 1, 1),
                (3, 2, 7, 9),
                (2, 1, 70, 16),
                (5, 1, 3, 33),
                (2, 2, 2, 130),
                (4, 1, 41, 31),
                (70, 1, 4, 4),
            ] {
                let extent = Extent { batch, rows, columns };
                let values = draw(batch * channels * extent.plane(), rng);
                let slope = draw(channels, rng);
                let (weight, bias) = (draw(channels * TAPS, rng), draw(channels, rng));
                let bar = draw(values.len(), rng);
                for slope in [Some(&slope[..]), None] {
                    let source = Source { values: &values, channels, slope };
                    let plain = Plain::new(&source, extent);
                    let mut output = vec![0.0; values.len()];
                    let mut activated_bar = vec![0.0; values.len()];
                    let (mut weight_bar, mut bias_bar) = (vec![0.0; weight.len()], vec![0.0; channels]);
                    for to in 0..values.len() {
                        let (plane, y, x) = (to / extent.plane(), to / columns % rows, to % columns);
                        let channel = plane % channels;
                        output[to] += f64::from(bias[channel]);
                        bias_bar[channel] += f64::from(bar[to]);
                        for tap in 0..TAPS {
                            let (v, u) = ((y + tap / 3).wrapping_sub(1), (x + tap % 3).wrapping_sub(1));
                            if v < rows && u < columns {
                                let from = (plane * rows + v) * columns + u;
                                output[to] += f64::from(weight[channel * TAPS + tap]) * plain.values[from];
                                weight_bar[channel * TAPS + tap] += f64::from(bar[to]) * plain.values[from];
                                activated_bar[from] += f64::from(bar[to]) * f64::from(weight[channel * TAPS + tap]);
                            }
                        }
                    }
                    let what = format!("{level:?} {channels}, {extent:?}");
                    soil_scratch();
                    assert_close(&depthwise(level, source, extent, &weight, &bias), &output, &what);
                    soil_scratch();
                    let vjp = |inputs, weights| {
                        depthwise_vjp(level, source, extent, &weight, &bar, Wanted { inputs, weights })
                    };
                    let (found, w, b) = vjp(true, true);
                    assert_close(&w, &weight_bar, &format!("{what}: weight"));
                    assert_close(&b, &bias_bar, &format!("{what}: bias"));
                    let (expected, slopes) = plain.pull(&activated_bar, channels, extent);
                    assert_close(&found.values, &expected, &format!("{what}: source"));
                    let slopes = if slope.is_some() { slopes } else { vec![] };
                    assert_close(&found.slope, &slopes, &format!("{what}: slopes"));
                    let half = vjp(false, true);
                    assert_eq!((half.1, half.0.values.len()), (w, 0));
                    let half = vjp(true, false);
                    assert_eq!((&half.0.values, half.1.len(), half.2.len()), (&found.values, 0, 0));
                }
            }
        }
    }
}
