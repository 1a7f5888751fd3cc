//! The kernels at every level this processor has, against plain loops in f64.

use super::columns::Taps;
use super::*;

/// Leaves values that would be noticed in the scratch buffers of all threads.
pub(super) fn soil_scratch() {
    rayon::broadcast(|_| {
        strip::with_scratch(|buffers| buffers.iter_mut().for_each(|buffer| buffer.get(1 << 18).fill(1e9)));
    });
}

pub(super) fn draw(n: usize, rng: &mut fastrand::Rng) -> Vec<f32> {
    (0..n).map(|_| rng.f32() - 0.5).collect()
}

/// Largest difference relative to the largest reference value, or to 0.1 where all are smaller (inputs are of order 1).
fn error(found: &[f32], reference: &[f64]) -> f64 {
    assert_eq!(found.len(), reference.len());
    let scale = reference.iter().fold(0.1f64, |m, v| m.max(v.abs()));
    found.iter().zip(reference).fold(0.0, |m, (f, r)| m.max((f64::from(*f) - r).abs() / scale))
}

#[track_caller]
pub(super) fn assert_close(found: &[f32], reference: &[f64], what: &str) {
    let error = error(found, reference);
    assert!(error < 3e-6, "{what}: {error:e}");
}

/// A picture, activated, in f64, and the derivative of the activation.
pub(super) struct Plain {
    pub(super) values: Vec<f64>,
    slopes: Vec<f64>,
    /// Values below zero, zero elsewhere: the derivative by the slope.
    below: Vec<f64>,
}

impl Plain {
    pub(super) fn new(source: &Source, extent: Extent) -> Self {
        let slope = |i: usize| {
            let channel = i / extent.plane() % source.channels;
            source.slope.map_or(1.0, |s| f64::from(s[channel]))
        };
        let all = || source.values.iter().enumerate().map(|(i, &v)| (f64::from(v), slope(i)));
        Self {
            values: all().map(|(v, s)| if v >= 0.0 { v } else { s * v }).collect(),
            slopes: all().map(|(v, s)| if v >= 0.0 { 1.0 } else { s }).collect(),
            below: all().map(|(v, _)| v.min(0.0)).collect(),
        }
    }

    /// Cotangents of values and slopes from that of the activated values.
    pub(super) fn pull(&self, bar: &[f64], channels: usize, extent: Extent) -> (Vec<f64>, Vec<f64>) {
        let mut slope = vec![0.0; channels];
        for (i, bar) in bar.iter().enumerate() {
            slope[i / extent.plane() % channels] += bar * self.below[i];
        }
        (bar.iter().zip(&self.slopes).map(|(b, s)| b * s).collect(), slope)
    }
}

/// Calls `visit(output index, input index, weight index, source)` for every product of a convolution with `side × side` taps.
fn products(
    channels: &[usize],
    outputs: usize,
    extent: Extent,
    side: usize,
    mut visit: impl FnMut(usize, usize, usize, usize),
) {
    let Extent { batch, rows, columns } = extent;
    let inputs: usize = channels.iter().sum();
    for (n, o, y, x) in (0..batch).flat_map(|n| {
        (0..outputs).flat_map(move |o| (0..rows).flat_map(move |y| (0..columns).map(move |x| (n, o, y, x))))
    }) {
        let mut first = 0;
        for (s, &count) in channels.iter().enumerate() {
            for c in 0..count {
                for tap in 0..side * side {
                    let (v, u) = ((y + tap / side).wrapping_sub(side / 2), (x + tap % side).wrapping_sub(side / 2));
                    if v < rows && u < columns {
                        let to = ((n * outputs + o) * rows + y) * columns + x;
                        let from = ((n * count + c) * rows + v) * columns + u;
                        visit(to, from, (o * inputs + first + c) * side * side + tap, s);
                    }
                }
            }
            first += count;
        }
    }
}

type Convolve = fn(Level, &[Source], Extent, &[f32], &[f32]) -> Vec<f32>;
type ConvolveVjp = fn(Level, &[Source], Extent, &[f32], &[f32], Wanted) -> (Vec<SourceBar>, Vec<f32>, Vec<f32>);
type Unpool = fn(Level, Source, Extent, &[f32], &[f32]) -> Vec<f32>;
type UnpoolVjp = fn(Level, Source, Extent, &[f32], &[f32], Wanted) -> (SourceBar, Vec<f32>, Vec<f32>);

#[test]
fn convolution_and_cotangents_match_plain_loops() {
    let cases = [
        (vec![3], 16, 1, 5, 7),
        (vec![16], 3, 2, 9, 33),
        (vec![5, 2], 7, 1, 40, 17),
        (vec![8, 8], 12, 1, 3, 48),
        (vec![1], 1, 3, 1, 1),
        (vec![4, 4], 9, 1, 2, 130),
        (vec![2], 11, 1, 70, 16),
        (vec![3], 35, 2, 6, 31),
        (vec![40, 3], 3, 1, 15, 15),
        (vec![9], 50, 3, 1, 1),
        (vec![512], 24, 1, 4, 4),
        (vec![24], 512, 2, 4, 4),
        (vec![512, 512], 9, 1, 8, 8),
        (vec![9], 512, 1, 8, 7),
        (vec![512], 16, 1, 16, 16),
    ];
    for (level, side) in Level::available().flat_map(|level| [(level, 3), (level, 1)]) {
        let rng = &mut fastrand::Rng::with_seed(1);
        for (channels, outputs, batch, rows, columns) in &cases {
            let extent = Extent { batch: *batch, rows: *rows, columns: *columns };
            let (n, inputs) = (batch * extent.plane(), channels.iter().sum::<usize>());
            let pictures: Vec<_> = channels.iter().map(|c| draw(c * n, rng)).collect();
            let slope = draw(channels[0], rng);
            let sources: Vec<Source> = (0..channels.len())
                .map(|s| Source { values: &pictures[s], channels: channels[s], slope: (s == 0).then_some(&slope[..]) })
                .collect();
            let (weight, bias) = (draw(outputs * inputs * side * side, rng), draw(*outputs, rng));
            let bar = draw(outputs * n, rng);

            let plain: Vec<_> = sources.iter().map(|s| Plain::new(s, extent)).collect();
            let mut output: Vec<f64> =
                (0..outputs * n).map(|i| f64::from(bias[i / extent.plane() % outputs])).collect();
            let mut weight_bar = vec![0.0; weight.len()];
            let mut activated_bars: Vec<_> = plain.iter().map(|p| vec![0.0; p.values.len()]).collect();
            products(channels, *outputs, extent, side, |to, from, w, s| {
                output[to] += f64::from(weight[w]) * plain[s].values[from];
                weight_bar[w] += f64::from(bar[to]) * plain[s].values[from];
                activated_bars[s][from] += f64::from(bar[to]) * f64::from(weight[w]);
            });
            let mut bias_bar = vec![0.0; *outputs];
            bar.iter().enumerate().for_each(|(i, b)| bias_bar[i / extent.plane() % outputs] += f64::from(*b));

            let ways: [(Convolve, ConvolveVjp, &str); 2] = match side {
                3 => [
                    (convolution::convolve::<3>, convolution::convolve_vjp::<3>, "strips"),
                    (small::convolve::<3>, small::convolve_vjp::<3>, "lines"),
                ],
                _ => [
                    (convolution::convolve::<1>, convolution::convolve_vjp::<1>, "strips"),
                    (small::convolve::<1>, small::convolve_vjp::<1>, "lines"),
                ],
            };
            for (convolve, convolve_vjp, name) in ways {
                let what = format!("{side} × {side} by {name} {level:?} {channels:?} to {outputs}, {extent:?}");
                soil_scratch();
                assert_close(&convolve(level, &sources, extent, &weight, &bias), &output, &what);
                let wanted = |inputs, weights| Wanted { inputs, weights };
                soil_scratch();
                let vjp = |wanted| convolve_vjp(level, &sources, extent, &weight, &bar, wanted);
                let (bars, w, b) = vjp(wanted(true, true));
                assert_close(&w, &weight_bar, &format!("{what}: weight"));
                assert_close(&b, &bias_bar, &format!("{what}: bias"));
                for (s, found) in bars.iter().enumerate() {
                    let (values, slopes) = plain[s].pull(&activated_bars[s], channels[s], extent);
                    assert_close(&found.values, &values, &format!("{what}: source {s}"));
                    let expected = if s == 0 { slopes } else { vec![] };
                    assert_close(&found.slope, &expected, &format!("{what}: slopes of {s}"));
                }
                let half = vjp(wanted(false, true));
                assert_eq!((half.1, half.0[0].values.len()), (w, 0));
                let half = vjp(wanted(true, false));
                assert_eq!((&half.0[0].values, half.1.len(), half.2.len()), (&bars[0].values, 0, 0));
            }
        }
    }
}

#[test]
fn unpooling_and_cotangents_match_plain_loops() {
    for level in Level::available() {
        let rng = &mut fastrand::Rng::with_seed(2);
        for (inputs, outputs, batch, rows, columns) in [
            (8, 4, 1, 4, 16),
            (5, 3, 2, 7, 9),
            (1, 1, 1, 1, 1),
            (7, 6, 1, 35, 50),
            (3, 13, 2, 3, 31),
            (512, 10, 1, 4, 4),
            (11, 512, 2, 1, 1),
            (100, 40, 1, 8, 8),
            (50, 9, 1, 16, 17),
        ] {
            let extent = Extent { batch, rows, columns };
            let values = draw(batch * inputs * extent.plane(), rng);
            let slope = draw(inputs, rng);
            let source = Source { values: &values, channels: inputs, slope: Some(&slope) };
            let (weight, bias) = (draw(inputs * outputs * 4, rng), draw(outputs, rng));
            let bar = draw(4 * batch * outputs * extent.plane(), rng);
            let plain = Plain::new(&source, extent);
            let mut output = vec![0.0; bar.len()];
            let mut weight_bar = vec![0.0; weight.len()];
            let mut bias_bar = vec![0.0; outputs];
            let mut activated_bar = vec![0.0; values.len()];
            for (to, (out, &bar)) in output.iter_mut().zip(&bar).enumerate() {
                let (x, y) = (to % (2 * columns), to / (2 * columns) % (2 * rows));
                let (o, n) = (to / (4 * extent.plane()) % outputs, to / (4 * extent.plane() * outputs));
                *out = f64::from(bias[o]);
                bias_bar[o] += f64::from(bar);
                for c in 0..inputs {
                    let from = ((n * inputs + c) * rows + y / 2) * columns + x / 2;
                    let w = (c * outputs + o) * 4 + 2 * (y % 2) + x % 2;
                    *out += f64::from(weight[w]) * plain.values[from];
                    weight_bar[w] += f64::from(bar) * plain.values[from];
                    activated_bar[from] += f64::from(bar) * f64::from(weight[w]);
                }
            }
            let (values, slopes) = plain.pull(&activated_bar, inputs, extent);
            let wide = (unpooling::unpool as Unpool, unpooling::unpool_vjp as UnpoolVjp, "strips");
            for (unpool, unpool_vjp, name) in [wide, (small::unpool, small::unpool_vjp, "lines")] {
                let what = format!("{name} {level:?} {inputs} to {outputs}, {extent:?}");
                soil_scratch();
                assert_close(&unpool(level, source, extent, &weight, &bias), &output, &what);
                soil_scratch();
                let vjp =
                    |inputs, weights| unpool_vjp(level, source, extent, &weight, &bar, Wanted { inputs, weights });
                let (found, w, b) = vjp(true, true);
                assert_close(&w, &weight_bar, &format!("{what}: weight"));
                assert_close(&b, &bias_bar, &format!("{what}: bias"));
                assert_close(&found.values, &values, &format!("{what}: source"));
                assert_close(&found.slope, &slopes, &format!("{what}: slopes"));
                let half = vjp(false, true);
                assert_eq!((half.1, half.0.values.len()), (w, 0));
                let half = vjp(true, false);
                assert_eq!((&half.0.values, half.1.len(), half.2.len()), (&found.values, 0, 0));
            }
        }
    }
}

#[test]
fn convolutions_by_columns_and_cotangents_match_plain_loops() {
    for level in Level::available() {
        let rng = &mut fastrand::Rng::with_seed(5);
        for (side, stride, padding, inputs, outputs, batch, rows, columns) in [
            (4, 2, 1, 3, 5, 2, 8, 12),
            (4, 1, 1, 7, 9, 1, 9, 6),
            (4, 1, 0, 20, 1, 2, 4, 4),
            (4, 2, 1, 40, 33, 1, 4, 6),
            (5, 3, 2, 2, 3, 1, 7, 11),
            (3, 1, 1, 1, 2, 1, 1, 1),
            (4, 2, 1, 2, 8, 1, 60, 70),
            (1, 2, 0, 3, 2, 1, 5, 4),
        ] {
            let (taps, extent) = (Taps { side, stride, padding }, Extent { batch, rows, columns });
            let out = taps.output(extent);
            let values = draw(batch * inputs * extent.plane(), rng);
            let source = Source { values: &values, channels: inputs, slope: None };
            let (weight, bias) = (draw(outputs * inputs * side * side, rng), draw(outputs, rng));
            let bar = draw(batch * outputs * out.plane(), rng);
            let mut output = vec![0.0; bar.len()];
            let (mut weight_bar, mut bias_bar) = (vec![0.0; weight.len()], vec![0.0; outputs]);
            let mut values_bar = vec![0.0; values.len()];
            for (to, (found, &bar)) in output.iter_mut().zip(&bar).enumerate() {
                let (x, y) = (to % out.columns, to / out.columns % out.rows);
                let (o, n) = (to / out.plane() % outputs, to / (out.plane() * outputs));
                *found = f64::from(bias[o]);
                bias_bar[o] += f64::from(bar);
                for k in 0..inputs * side * side {
                    let (c, i, j) = (k / (side * side), k / side % side, k % side);
                    let (Some(row), Some(column)) =
                        ((y * stride + i).checked_sub(padding), (x * stride + j).checked_sub(padding))
                    else {
                        continue;
                    };
                    if row < rows && column < columns {
                        let (from, w) =
                            (((n * inputs + c) * rows + row) * columns + column, o * inputs * side * side + k);
                        *found += f64::from(weight[w]) * f64::from(values[from]);
                        weight_bar[w] += f64::from(bar) * f64::from(values[from]);
                        values_bar[from] += f64::from(bar) * f64::from(weight[w]);
                    }
                }
            }
            let what = format!("{level:?} {taps:?} {inputs} to {outputs}, {extent:?}");
            soil_scratch();
            assert_close(&columns::convolve(level, taps, source, extent, &weight, &bias), &output, &what);
            soil_scratch();
            let vjp = |inputs, weights| {
                columns::convolve_vjp(level, taps, source, extent, &weight, &bar, Wanted { inputs, weights })
            };
            let (x, w, b) = vjp(true, true);
            assert_close(&x, &values_bar, &format!("{what}: source"));
            assert_close(&w, &weight_bar, &format!("{what}: weight"));
            assert_close(&b, &bias_bar, &format!("{what}: bias"));
            assert_eq!((vjp(false, true).0.len(), vjp(true, false).1.len()), (0, 0));
        }
    }
}

/// Wherever it stands in its block, and in the last, shorter vector of a row as well.
#[test]
fn pooling_keeps_what_is_not_a_number() {
    for level in Level::available() {
        let extent = Extent { batch: 1, rows: 4, columns: 38 };
        for at in 0..extent.plane() {
            let mut values: Vec<f32> = (0..extent.plane()).map(|i| (i * 7 % 31) as f32 - 15.0).collect();
            values[at] = f32::NAN;
            let source = Source { values: &values, channels: 1, slope: Some(&[0.25]) };
            let block = at / 76 * 19 + at % 38 / 2;
            let output = pool(level, source, extent);
            let kept: Vec<usize> = (0..output.len()).filter(|i| output[*i].is_nan()).collect();
            assert_eq!(kept, [block], "{level:?} {at}");
            // The cotangent goes to it, and to the slope.
            let bars = pool_vjp(level, source, extent, &[1.0; 38]);
            let corner = at / 76 * 76 + at % 38 / 2 * 2;
            let shares = [0, 1, 38, 39].map(|i| (corner + i, bars.values[corner + i]));
            assert!(shares.into_iter().all(|(i, bar)| (bar != 0.0) == (i == at)), "{level:?} {at}: {shares:?}");
            assert!(bars.slope[0].is_nan());
        }
    }
}

#[test]
fn pooling_and_cotangents_match_plain_loops() {
    for level in Level::available() {
        let rng = &mut fastrand::Rng::with_seed(3);
        for (channels, batch, rows, columns) in [(3, 2, 8, 38), (2, 1, 2, 2), (1, 1, 6, 64)] {
            let extent = Extent { batch, rows, columns };
            // Coarse values, so that there are ties, of which the first counts.
            let values: Vec<f32> =
                draw(batch * channels * extent.plane(), rng).iter().map(|v| (8.0 * v).round() / 8.0).collect();
            let slope: Vec<f32> = draw(channels, rng).iter().map(|s| s + 0.3).collect();
            let source = Source { values: &values, channels, slope: Some(&slope) };
            let bar = draw(values.len() / 4, rng);
            let plain = Plain::new(&source, extent);
            let (mut output, mut activated_bar) = (vec![0.0; bar.len()], vec![0.0; values.len()]);
            for (to, out) in output.iter_mut().enumerate() {
                let (x, y, plane) = (to % (columns / 2), to / (columns / 2) % (rows / 2), 4 * to / extent.plane());
                let corner = plane * extent.plane() + 2 * y * columns + 2 * x;
                let block = [corner, corner + 1, corner + columns, corner + columns + 1];
                let best = block
                    .into_iter()
                    .reduce(|a, b| if plain.values[b] > plain.values[a] { b } else { a })
                    .expect("four");
                *out = plain.values[best];
                activated_bar[best] += f64::from(bar[to]);
            }
            let what = format!("{level:?} {channels}, {extent:?}");
            assert_close(&pool(level, source, extent), &output, &what);
            let found = pool_vjp(level, source, extent, &bar);
            let (values, slopes) = plain.pull(&activated_bar, channels, extent);
            assert_close(&found.values, &values, &format!("{what}: source"));
            assert_close(&found.slope, &slopes, &format!("{what}: slopes"));
        }
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let rng = &mut fastrand::Rng::with_seed(4);
    for (inputs, outputs, rows, columns) in [(8, 16, 96, 80), (100, 70, 9, 8), (40, 70, 32, 32)] {
        let extent = Extent { batch: 2, rows, columns };
        let values = draw(2 * inputs * extent.plane(), rng);
        let slope = draw(inputs, rng);
        let source = Source { values: &values, channels: inputs, slope: Some(&slope) };
        let (weight, bias) = (draw(outputs * inputs * 9, rng), draw(outputs, rng));
        let bar = draw(8 * outputs * extent.plane(), rng);
        let wanted = Wanted { inputs: true, weights: true };
        for level in Level::available() {
            let with = |threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
                pool.install(|| {
                    let ahead = convolve(level, &[source], extent, &weight, &bias);
                    let deep = depthwise(level, source, extent, &weight[..9 * inputs], &weight[..inputs]);
                    let (deep_bar, d, e) =
                        depthwise_vjp(level, source, extent, &weight[..9 * inputs], &bar[..values.len()], wanted);
                    let up = unpool(level, source, extent, &weight[..4 * inputs * outputs], &bias);
                    let (sources, w, b) =
                        convolve_vjp(level, &[source], extent, &weight, &bar[..2 * outputs * extent.plane()], wanted);
                    let (source, v, c) =
                        unpool_vjp(level, source, extent, &weight[..4 * inputs * outputs], &bar, wanted);
                    let bars = [&sources[0], &source, &deep_bar].map(|s| (s.values.clone(), s.slope.clone()));
                    ([ahead, up, deep], bars, [w, b, v, c, d, e])
                })
            };
            assert_eq!(with(1), with(3), "{level:?}");
        }
    }
}

#[test]
#[ignore = "a measurement, not a check: one thread's time of both ways to convolve, by width of the plane"]
fn where_lines_beat_strips() {
    let rng = &mut fastrand::Rng::with_seed(6);
    for (inputs, outputs, side) in
        [(512, 512, 4), (512, 512, 8), (512, 512, 16), (256, 256, 32), (128, 128, 64), (64, 64, 128), (32, 32, 256)]
    {
        let extent = Extent { batch: 1, rows: side, columns: side };
        let (values, bar) = (draw(inputs * side * side, rng), draw(4 * outputs * side * side, rng));
        let (weight, bias, slope) = (draw(inputs * outputs * 9, rng), draw(outputs, rng), draw(inputs, rng));
        let source = Source { values: &values, channels: inputs, slope: Some(&slope) };
        let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
        // The thread's own time, nanoseconds: others may use the machine too.
        let now = || {
            let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux");
            text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).expect("a number")
        };
        // The system counts in steps of some milliseconds, so that only many runs tell.
        let best = |run: &(dyn Fn() + Sync)| {
            let many = || {
                let start = now();
                (0..20).for_each(|_| run());
                1e-6 * (now() - start) / 20.0
            };
            alone.install(|| (0..3).map(|_| many()).fold(f64::INFINITY, f64::min))
        };
        let level = Level::detect();
        let wide = (convolution::convolve::<3> as Convolve, convolution::convolve_vjp::<3> as ConvolveVjp);
        let wide_up = (unpooling::unpool as Unpool, unpooling::unpool_vjp as UnpoolVjp);
        let lines = ((small::convolve::<3> as Convolve, small::convolve_vjp::<3> as ConvolveVjp), "lines");
        let lines_up = (small::unpool as Unpool, small::unpool_vjp as UnpoolVjp);
        let giga = (2 * 9 * inputs * outputs * side * side) as f64 * 1e-6;
        for (((convolve, vjp), name), (unpool, unpool_vjp)) in [((wide, "strips"), wide_up), (lines, lines_up)] {
            let ahead = best(&|| recycle::give(convolve(level, &[source], extent, &weight, &bias)));
            let back = |inputs, weights| {
                let bar = &bar[..outputs * side * side];
                best(&|| {
                    let (bars, w, _) = vjp(level, &[source], extent, &weight, bar, Wanted { inputs, weights });
                    bars.into_iter().for_each(|b| recycle::give(b.values));
                    recycle::give(w);
                })
            };
            let (by_input, by_weight) = (back(true, false), back(false, true));
            let weight = &weight[..inputs * outputs * 4];
            let up = best(&|| recycle::give(unpool(level, source, extent, weight, &bias)));
            let wanted = Wanted { inputs: true, weights: true };
            let up_back = best(&|| {
                let (b, w, _) = unpool_vjp(level, source, extent, weight, &bar, wanted);
                recycle::give(b.values);
                recycle::give(w);
            });
            let rate = |ms: f64| format!("{ms:.2} ms ({:.0} GFLOP/s)", giga / ms);
            let (ahead, by_input, by_weight) = (rate(ahead), rate(by_input), rate(by_weight));
            eprintln!(
                "{inputs} to {outputs} at {side}, {name}: forward {ahead}, input {by_input}, weight {by_weight}; up {up:.2} ms, back {up_back:.2} ms"
            );
        }
    }
}

#[test]
#[ignore = "a measurement, not a check: GFLOP/s of every convolution's passes, GB/s of the gate"]
fn speed_of_the_kernels() {
    let rng = &mut fastrand::Rng::with_seed(5);
    // The least of several runs, seconds.
    let time = |run: &dyn Fn()| {
        let once = || {
            let start = std::time::Instant::now();
            run();
            start.elapsed().as_secs_f64()
        };
        (0..15).map(|_| once()).fold(f64::INFINITY, f64::min)
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("threads");
    for (channels, side) in [(16, 192), (32, 96), (64, 48), (32, 256), (64, 128), (128, 64), (256, 16)] {
        let extent = Extent { batch: 1, rows: side, columns: side };
        let n = channels * side * side;
        let (values, bar, bias) = (draw(2 * n, rng), draw(n, rng), draw(channels, rng));
        let (weight, slope) = (draw(channels * channels * 9, rng), draw(channels, rng));
        let source = Source { values: &values[..n], channels, slope: Some(&slope) };
        let level = Level::detect();
        let keep = |(bars, w, _): (Vec<SourceBar>, Vec<f32>, Vec<f32>)| {
            bars.into_iter().for_each(|b| give(b.values));
            give(w);
        };
        let passes = |name: &str, products: usize, ahead: &dyn Fn() -> Vec<f32>, back: &dyn Fn(Wanted)| {
            let rate = |s: f64| 2e-9 * (products * side * side) as f64 / s;
            let [forward, by_input, by_weight] = [
                time(&|| give(ahead())),
                time(&|| back(Wanted { inputs: true, weights: false })),
                time(&|| back(Wanted { inputs: false, weights: true })),
            ];
            eprintln!(
                "{level:?}, {channels} channels, {side} × {side}, {name}: forward {:.0} GFLOP/s ({:.2} ms), input {:.0}, weight {:.0}",
                rate(forward),
                1e3 * forward,
                rate(by_input),
                rate(by_weight)
            );
        };
        pool.install(|| {
            let square = |taps: usize| &weight[..channels * channels * taps];
            for (name, taps) in [("3 × 3", 9), ("1 × 1", 1)] {
                let back = |wanted| keep(convolve_vjp(level, &[source], extent, square(taps), &bar, wanted));
                let ahead = || convolve(level, &[source], extent, square(taps), &bias);
                passes(name, channels * channels * taps, &ahead, &back);
            }
            let taps = &weight[..channels * 9];
            let back = |wanted| {
                let (b, w, c) = depthwise_vjp(level, source, extent, taps, &bar, wanted);
                keep((vec![b], w, c));
            };
            passes("depthwise", channels * 9, &|| depthwise(level, source, extent, taps, &bias), &back);
            let gigabytes = |values: usize, s: f64| 4e-9 * values as f64 / s;
            let ahead = time(&|| give(gate(level, &values, extent)));
            let back = time(&|| give(gate_vjp(level, &values, extent, &bar)));
            eprintln!("gate: forward {:.1} GB/s, back {:.1}", gigabytes(3 * n, ahead), gigabytes(5 * n, back));
        });
    }
}

#[test]
#[ignore = "a measurement, not a check: GFLOP/s of the convolution's three passes"]
fn speed_of_the_convolution() {
    let rng = &mut fastrand::Rng::with_seed(5);
    for (inputs, outputs, side) in
        [(3, 16, 256), (16, 16, 256), (32, 16, 256), (32, 32, 128), (64, 64, 64), (16, 3, 256), (128, 128, 64)]
    {
        let extent = Extent { batch: 1, rows: side, columns: side };
        let (values, bar) = (draw(inputs * side * side, rng), draw(outputs * side * side, rng));
        let (weight, bias, slope) = (draw(inputs * outputs * 9, rng), draw(outputs, rng), draw(inputs, rng));
        let source = Source { values: &values, channels: inputs, slope: Some(&slope) };
        let operations = (2 * 9 * inputs * outputs * side * side) as f64;
        for level in Level::available() {
            let time = |run: &dyn Fn()| {
                let once = || {
                    let start = std::time::Instant::now();
                    run();
                    start.elapsed().as_secs_f64()
                };
                operations / 1e9 / (0..15).map(|_| once()).fold(f64::INFINITY, f64::min)
            };
            for threads in [1, 2] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
                pool.install(|| {
                    let forward = time(&|| drop(convolve(level, &[source], extent, &weight, &bias)));
                    let back = |inputs, weights| {
                        time(&|| drop(convolve_vjp(level, &[source], extent, &weight, &bar, Wanted { inputs, weights })))
                    };
                    let (by_input, by_weight) = (back(true, false), back(false, true));
                    eprintln!("{level:?} {threads} threads {inputs} to {outputs} at {side}: forward {forward:.0}, input {by_input:.0}, weight {by_weight:.0} GFLOP/s");
                });
            }
        }
    }
}
