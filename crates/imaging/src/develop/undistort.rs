//! Resampling between the picture the sensor saw and the rectilinear one, by the fitted radial [`Distortion`].
//!
//! The rectilinear picture keeps the scale the capture has on the axis: an object slope `r` appears at `f·r`, with
//! `f = ∂r_d/∂r` at 0. Both pictures share one [`Frame`]. The kernel is Lanczos-3, widened where the map shrinks the
//! picture, so that it also filters, and corrected to reproduce ramps exactly. One map serves all channels;
//! lateral colour is the network's business.

use std::collections::VecDeque;

use ndarray::{Array3, ArrayView1, s};
use rayon::prelude::*;

use crate::develop::distortion::Distortion;
use crate::frame::Frame;

/// Resamples a capture to the rectilinear frame, in place. `image` is `[channel, row, col]` of the frame's size; returns the fraction of the pixels
/// that have no source within the capture and are black.
///
/// Beside the picture stand the rows that are done and still read: as many as the distortion moves any of them, and a block.
///
/// # Panics
/// If the image's size is not the frame's.
pub(crate) fn undistort(image: &mut Array3<f32>, frame: &Frame, distortion: &Distortion) -> f64 {
    Map::new(frame, |rho| captured_radius(distortion, rho)).resample(image)
}

/// Radius on the sensor, mm, of what the rectilinear picture shows at `rho_mm`.
///
/// Beyond the fitted slopes the model is continued linearly, as [`Distortion::slope_from_sensor`] does.
pub fn captured_radius(distortion: &Distortion, rho_mm: f64) -> f64 {
    let slope = rho_mm / distortion.sensor_from_slope_derivative(0.0);
    let end = distortion.max_slope;
    if slope <= end {
        distortion.sensor_from_slope(slope)
    } else {
        distortion.sensor_from_slope(end) + (slope - end) * distortion.sensor_from_slope_derivative(end)
    }
}

/// Where each pixel of a picture comes from.
struct Map<'a> {
    frame: &'a Frame,
    table: RadialTable,
}

impl<'a> Map<'a> {
    /// By `source_radius(output radius)`, both mm from the axis.
    fn new(frame: &'a Frame, source_radius: impl Fn(f64) -> f64 + Sync) -> Self {
        let mut table = RadialTable::new(&source_radius, frame.max_radius_mm() / frame.pitch_mm, frame.pitch_mm);
        // A kernel wider than the picture reads the same samples as one as wide.
        let most = frame.columns.max(frame.rows) as f64;
        table.nodes.iter_mut().for_each(|(_, stretch)| *stretch = stretch.min(most));
        Self { frame, table }
    }

    /// Column and row, pixels, that the pixel `(i, j)` comes from, and how far apart its neighbours' are; `None` outside the picture.
    fn source(&self, i: usize, j: usize) -> Option<([f64; 2], f64)> {
        let frame = self.frame;
        let (x, y) = (j as f64 + 0.5 - frame.axis_px[0], i as f64 + 0.5 - frame.axis_px[1]);
        let (ratio, stretch) = self.table.at(x.hypot(y));
        let (column, row) = (frame.axis_px[0] + ratio * x, frame.axis_px[1] + ratio * y);
        let within = |v: f64, n: usize| v >= 0.0 && v <= n as f64;
        (within(column, frame.columns) && within(row, frame.rows)).then_some(([column, row], stretch))
    }

    /// No row before this one is read for row `i`.
    fn first_read(&self, i: usize) -> usize {
        let frame = self.frame;
        let y = i as f64 + 0.5 - frame.axis_px[1];
        let farthest = frame.axis_px[0].abs().max((frame.columns as f64 - frame.axis_px[0]).abs());
        let ([low, high], stretch) = self.table.range([y.abs(), y.hypot(farthest)]);
        let row = frame.axis_px[1] + (low * y).min(high * y);
        // The cubic between nodes, and what the quick path reads with no weight.
        let first = row - 0.5 - 3.0 * stretch - 1.0;
        (first.max(0.0) as usize).min(frame.rows.saturating_sub(FEW))
    }

    fn resample(&self, image: &mut Array3<f32>) -> f64 {
        let (channels, rows, columns) = image.dim();
        assert_eq!((rows, columns), (self.frame.rows, self.frame.columns), "the picture has the frame's size");
        if !image.is_standard_layout() {
            *image = image.as_standard_layout().into_owned();
        }
        let kernel = Lanczos::new();
        // From which row on anything is still read when the rows before `i` are done.
        let mut needed = vec![rows; rows + 1];
        for i in (0..rows).rev() {
            needed[i] = needed[i + 1].min(self.first_read(i));
        }
        let mut done: VecDeque<(usize, Row)> = VecDeque::new();
        let mut outside = 0;
        for from in (0..rows).step_by(BLOCK) {
            let to = (from + BLOCK).min(rows);
            let planes: Vec<&[f32]> =
                image.as_slice().map(|all| all.chunks_exact(rows * columns).collect()).unwrap_or_default();
            let block: Vec<Row> = (from..to).into_par_iter().map(|i| self.row(&planes, &kernel, i)).collect();
            outside += block.iter().map(|row| row.outside).sum::<usize>();
            done.extend((from..to).zip(block));
            while let Some((i, row)) = done.pop_front_if(|(i, _)| *i < needed[to]) {
                for (c, line) in row.samples.chunks_exact(columns.max(1)).enumerate() {
                    image.slice_mut(s![c, i, ..]).assign(&ArrayView1::from(line));
                }
            }
        }
        debug_assert!(done.is_empty() || channels == 0, "every row is in its place");
        outside as f64 / (rows * columns).max(1) as f64
    }

    /// The row `i` of the result.
    fn row(&self, planes: &[&[f32]], kernel: &Lanczos, i: usize) -> Row {
        let columns = self.frame.columns;
        let mut row = Row { samples: vec![0.0; planes.len() * columns], outside: 0 };
        let (mut across, mut down) = (Taps::default(), Taps::default());
        for j in 0..columns {
            let Some(([x, y], stretch)) = self.source(i, j) else {
                row.outside += 1;
                continue;
            };
            across.set(kernel, x - 0.5, stretch);
            down.set(kernel, y - 0.5, stretch);
            for (c, plane) in planes.iter().enumerate() {
                row.samples[c * columns + j] = weighted(plane, columns, &across, &down);
            }
        }
        row
    }
}

/// One row of a result, its channels one after the other, and how many of its pixels have no source.
struct Row {
    samples: Vec<f32>,
    outside: usize,
}

/// Sum of a plane's samples under the taps of both axes; the border is repeated.
fn weighted(plane: &[f32], columns: usize, across: &Taps, down: &Taps) -> f32 {
    let rows = plane.len() / columns;
    // Nearly all pixels: few taps, all within the picture, a fixed number of operations.
    if let (Some((q, along)), Some((r, weights))) = (across.few(columns), down.few(rows)) {
        let mut sums = [0.0_f32; FEW];
        for (k, w) in weights.iter().enumerate() {
            let start = (r + k) * columns + q;
            for (sum, v) in sums.iter_mut().zip(&plane[start..start + FEW]) {
                *sum += w * v;
            }
        }
        return sums.iter().zip(along).map(|(s, w)| s * w).sum();
    }
    let clamped = |k: i64, n: usize| k.clamp(0, n as i64 - 1) as usize;
    let mut sum = 0.0;
    for (r, w) in (down.first..).zip(&down.weight) {
        let line = &plane[clamped(r, rows) * columns..][..columns];
        sum += w * (across.first..).zip(&across.weight).map(|(q, v)| v * line[clamped(q, columns)]).sum::<f32>();
    }
    sum
}

/// The radial map in pixels, tabulated: ratio of source to output radius, and how far the source steps per pixel.
struct RadialTable {
    /// `(ratio, stretch)` at radius `i / PER_PIXEL`.
    nodes: Vec<(f64, f64)>,
}

impl RadialTable {
    const PER_PIXEL: f64 = 2.0;
    /// Nodes at most: those of the largest frame whose axis lies as far outside as a file may say. Beyond them the ratio is constant.
    const MOST: usize = 1 << 22;

    fn new(source_radius: &(impl Fn(f64) -> f64 + Sync), max_px: f64, pitch_mm: f64) -> Self {
        let count = ((max_px * Self::PER_PIXEL).ceil() as usize).min(Self::MOST) + 2;
        let radius = |i: usize| i as f64 / Self::PER_PIXEL;
        let source: Vec<f64> =
            (0..=count).into_par_iter().map(|i| source_radius(radius(i) * pitch_mm) / pitch_mm).collect();
        let nodes = (0..count)
            .map(|i| {
                let ratio = if i == 0 { source[1] / radius(1) } else { source[i] / radius(i) };
                let radial = (source[i + 1] - source[i]) * Self::PER_PIXEL;
                (ratio, ratio.max(radial).max(1.0))
            })
            .collect();
        Self { nodes }
    }

    /// Least and largest ratio at radii from one to another, pixels, and the largest stretch there; by nodes, the ones around among them.
    fn range(&self, radii_px: [f64; 2]) -> ([f64; 2], f64) {
        let last = self.nodes.len() - 1;
        let [from, to] = radii_px.map(|r| ((r * Self::PER_PIXEL) as usize).min(last));
        // (A frame whose numbers overflow has radii that are none.)
        let to = to.max(from);
        let around = &self.nodes[from.saturating_sub(1)..=(to + 2).min(last)];
        around.iter().fold(([f64::INFINITY, f64::NEG_INFINITY], 1.0), |([low, high], most), (ratio, stretch)| {
            ([low.min(*ratio), high.max(*ratio)], stretch.max(most))
        })
    }

    /// The ratio by the cubic through four neighbours, the stretch linearly.
    fn at(&self, radius_px: f64) -> (f64, f64) {
        let last = self.nodes.len() - 1;
        let x = (radius_px * Self::PER_PIXEL).min((last - 1) as f64);
        let i = x as usize;
        let t = x - i as f64;
        let (a, b) = (self.nodes[i], self.nodes[i + 1]);
        // The ratio is even in the radius; beyond the end the last piece continues.
        let before = self.nodes[i.abs_diff(1)].0;
        let after = if i + 2 <= last { self.nodes[i + 2].0 } else { 3.0 * (b.0 - a.0) + before };
        let bend = t * (t - 1.0);
        let cubic = a.0
            + t * (b.0 - a.0)
            + bend * ((2.0 - t) * (before - 2.0 * a.0 + b.0) + (1.0 + t) * (a.0 - 2.0 * b.0 + after)) / 6.0;
        (cubic, a.1 + t * (b.1 - a.1))
    }
}

/// Tabulated Lanczos-3 window, `sinc(x)·sinc(x/3)` for `|x| < 3`.
struct Lanczos(Vec<f32>);

impl Lanczos {
    const PER_UNIT: usize = 1024;

    fn new() -> Self {
        let sinc = |x: f64| {
            if x == 0.0 { 1.0 } else { (std::f64::consts::PI * x).sin() / (std::f64::consts::PI * x) }
        };
        let at = |i: usize| i as f64 / Self::PER_UNIT as f64;
        let mut table: Vec<f32> = (0..3 * Self::PER_UNIT).map(|i| (sinc(at(i)) * sinc(at(i) / 3.0)) as f32).collect();
        table.extend([0.0, 0.0]);
        Self(table)
    }

    fn at(&self, x: f64) -> f32 {
        let x = (x.abs() * Self::PER_UNIT as f64).min(3.0 * Self::PER_UNIT as f64);
        let i = x as usize;
        self.0[i] + (x - i as f64) as f32 * (self.0[i + 1] - self.0[i])
    }
}

/// Rows that are worked on at a time.
const BLOCK: usize = 64;

/// Taps that the quick path takes: as many as Lanczos-3 has unless it is stretched by more than a sixth.
const FEW: usize = 8;

/// Weights of one axis from sample `first` on; they sum to one.
#[derive(Default)]
struct Taps {
    first: i64,
    weight: Vec<f32>,
    padded: [f32; FEW],
}

impl Taps {
    /// Taps around `centre` (in units where sample `k` sits at `k`), the kernel stretched by `stretch ≥ 1`.
    fn set(&mut self, kernel: &Lanczos, centre: f64, stretch: f64) {
        let reach = 3.0 * stretch;
        let (first, last) = ((centre - reach).ceil() as i64, (centre + reach).floor() as i64);
        self.first = first;
        self.weight.clear();
        self.weight.extend((first..=last).map(|k| kernel.at((k as f64 - centre) / stretch)));
        let scale = 1.0 / self.weight.iter().sum::<f32>();
        self.weight.iter_mut().for_each(|w| *w *= scale);
        // Plain Lanczos shifts smooth pictures by up to 0.02 pixels; the two central taps take the first moment out.
        let moment: f32 = self.weight.iter().zip(first..).map(|(w, k)| w * (k as f64 - centre) as f32).sum();
        let middle = (centre.floor() as i64 - first) as usize;
        self.weight[middle] += moment;
        self.weight[middle + 1] -= moment;
        if self.weight.len() <= FEW {
            self.padded = [0.0; FEW];
            self.padded[..self.weight.len()].copy_from_slice(&self.weight);
        }
    }

    /// First sample and weights, padded with zeros, if they are few and lie within `samples` samples.
    fn few(&self, samples: usize) -> Option<(usize, &[f32; FEW])> {
        let first = usize::try_from(self.first).ok()?;
        (self.weight.len() <= FEW && first + FEW <= samples).then_some((first, &self.padded))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn barrel(frame: &Frame) -> Distortion {
        // About −8 % at the corner of the frame, focal length 20 mm.
        let max_slope = 1.2 * frame.max_radius_mm() / 20.0;
        Distortion {
            max_slope,
            coefficients_mm: [20.0 * max_slope, -2.6 * max_slope, 0.4 * max_slope, 0.0],
            residual_mm: 0.0,
        }
    }

    fn smooth(frame: &Frame) -> Array3<f32> {
        Array3::from_shape_fn((3, frame.rows, frame.columns), |(c, i, j)| {
            let (x, y) = (j as f32 / 17.0, i as f32 / 13.0);
            0.5 + 0.3 * (x + c as f32).sin() * (y - 0.5 * x).cos()
        })
    }

    /// Both maps' tables against the polynomial and its root, and there and back: 1e-6 pixel over every shipped lens.
    #[test]
    fn maps_and_their_inverses_hold_a_millionth_of_a_pixel() {
        use crate::render::frame_of;
        for (name, _) in isoplanat_optics::lens::builtin::LENSES {
            let lens = isoplanat_optics::lens::builtin::lens(name).expect("shipped");
            let frame = frame_of(&lens).expect("valid");
            let v = lens.object_vergence;
            let d = Distortion::of_lens(&lens, v, 1.02 * frame.max_radius_mm()).expect("fits");
            let focal = d.sensor_from_slope_derivative(0.0);
            let (most, pitch) = (frame.max_radius_mm() / frame.pitch_mm, frame.pitch_mm);
            let captured = |rho: f64| captured_radius(&d, rho);
            let ideal = |rho: f64| focal * d.slope_from_sensor(rho);
            let tables = [RadialTable::new(&captured, most, pitch), RadialTable::new(&ideal, most, pitch)];
            let mut worst = [0.0f64; 3];
            for i in 0..50_000 {
                let r = most * (f64::from(i) + 0.3) / 50_000.0;
                worst[0] = worst[0].max((tables[0].at(r).0 * r - captured(r * pitch) / pitch).abs());
                worst[1] = worst[1].max((tables[1].at(r).0 * r - ideal(r * pitch) / pitch).abs());
                worst[2] = worst[2].max((captured(ideal(r * pitch)) / pitch - r).abs());
            }
            assert!(worst.iter().all(|w| *w < 1e-6), "{name}: {worst:?} pixel");
        }
    }

    #[test]
    fn undistorting_returns_a_smooth_picture() {
        let frame = Frame::centred(240, 160, 0.05).expect("valid");
        for axis in [[120.0, 80.0], [0.0, 160.0]] {
            let frame = frame.clone().with_axis(axis).expect("finite");
            let distortion = barrel(&frame);
            let picture = smooth(&frame);
            // Undistorting enlarges the corners out of the frame, so go from the rectilinear side.
            let focal = distortion.sensor_from_slope_derivative(0.0);
            let ideal = |rho: f64| focal * distortion.slope_from_sensor(rho);
            let [there, back] = [Map::new(&frame, ideal), Map::new(&frame, |rho| captured_radius(&distortion, rho))];
            let mut image = picture.clone();
            there.resample(&mut image);
            undistort(&mut image, &frame, &distortion);
            let mut worst = 0.0_f32;
            for c in 0..3 {
                for i in 0..frame.rows {
                    for j in 0..frame.columns {
                        // Keep clear of the kernel's reach from pixels that had no source.
                        let margin = 6;
                        let clear = i >= margin
                            && j >= margin
                            && i + margin < frame.rows
                            && j + margin < frame.columns
                            && (i - margin..=i + margin)
                                .all(|i| (j - margin..=j + margin).all(|j| there.source(i, j).is_some()))
                            && back.source(i, j).is_some();
                        if clear {
                            let near = frame.radius_mm(j as f64 + 0.5, i as f64 + 0.5) < 0.8 * frame.max_radius_mm();
                            if near {
                                worst = worst.max((image[[c, i, j]] - picture[[c, i, j]]).abs());
                            }
                        }
                    }
                }
            }
            assert!(worst <= 1e-3, "axis {axis:?}: {worst}");
        }
    }

    #[test]
    fn a_point_moves_to_its_rectilinear_place() {
        let frame = Frame::centred(201, 201, 0.05).expect("valid");
        let distortion = barrel(&frame);
        let slope = 0.2;
        let (captured, ideal) =
            (distortion.sensor_from_slope(slope), slope * distortion.sensor_from_slope_derivative(0.0));
        assert!((captured_radius(&distortion, ideal) - captured).abs() < 1e-12);
        // A blob at the captured place, up and to the right, is found at the ideal place.
        let at = frame.pixel_from_mm([captured * 0.6, captured * 0.8]);
        let mut out = Array3::from_shape_fn((1, 201, 201), |(_, i, j)| {
            let d2 = (j as f64 + 0.5 - at[0]).powi(2) + (i as f64 + 0.5 - at[1]).powi(2);
            (-d2 / 8.0).exp() as f32
        });
        undistort(&mut out, &frame, &distortion);
        let mass = f64::from(out.sum());
        let mean = |f: &dyn Fn(usize, usize) -> f64| {
            out.indexed_iter().map(|((_, i, j), &v)| f64::from(v) * f(i, j)).sum::<f64>() / mass
        };
        let found = [mean(&|_, j| j as f64 + 0.5), mean(&|i, _| i as f64 + 0.5)];
        let expected = frame.pixel_from_mm([ideal * 0.6, ideal * 0.8]);
        assert!(
            (found[0] - expected[0]).abs() < 0.05 && (found[1] - expected[1]).abs() < 0.05,
            "{found:?} {expected:?}"
        );
    }

    #[test]
    fn pixels_without_a_source_are_black_and_counted() {
        let frame = Frame::centred(80, 60, 0.05).expect("valid");
        let max_slope = 1.2 * frame.max_radius_mm() / 20.0;
        let pincushion =
            Distortion { max_slope, coefficients_mm: [20.0 * max_slope, 3.0 * max_slope, 0.0, 0.0], residual_mm: 0.0 };
        let mut image = Array3::from_elem((3, 60, 80), 1.0_f32);
        let fraction = undistort(&mut image, &frame, &pincushion);
        let map = Map::new(&frame, |rho| captured_radius(&pincushion, rho));
        assert!(map.source(0, 0).is_none() && image[[0, 0, 0]] == 0.0);
        assert!(fraction > 0.0 && fraction < 0.5, "{fraction}");
        for ((_, i, j), &v) in image.indexed_iter() {
            if map.source(i, j).is_some() {
                assert!((v - 1.0).abs() < 1e-6);
            }
        }
    }

    /// In place equals row by row from an untouched copy, to the bit: barrel and pincushion, the axis in the middle, at a corner and outside, frames lower
    /// than a kernel and wider than a block.
    #[test]
    fn a_picture_in_place_is_the_one_beside_it() {
        let rng = &mut fastrand::Rng::with_seed(9);
        for (columns, rows) in [(150, 310), (64, 5), (7, 1), (1, 90), (40, 129)] {
            for axis in [[0.5, 0.5], [0.0, 0.0], [1.0, 1.0], [0.3, -0.4], [0.6, 1.5]] {
                let at = [axis[0] * columns as f64, axis[1] * rows as f64];
                let frame = Frame::centred(columns, rows, 0.05).expect("valid").with_axis(at).expect("finite");
                let max_slope = 1.2 * frame.max_radius_mm() / 20.0;
                for bend in [-0.25, -0.02, 0.0, 0.04, 0.5] {
                    let coefficients_mm = [20.0 * max_slope, 20.0 * bend * max_slope, 0.0, 0.0];
                    let distortion = Distortion { max_slope, coefficients_mm, residual_mm: 0.0 };
                    let picture = Array3::from_shape_simple_fn((2, rows, columns), || rng.f32());
                    let map = Map::new(&frame, |rho| captured_radius(&distortion, rho));
                    let (kernel, all) = (Lanczos::new(), picture.as_slice().expect("in order"));
                    let planes: Vec<&[f32]> = all.chunks_exact(rows * columns).collect();
                    let mut image = picture.clone();
                    let outside = undistort(&mut image, &frame, &distortion);
                    let mut count = 0;
                    for i in 0..rows {
                        let row = map.row(&planes, &kernel, i);
                        count += row.outside;
                        for (c, line) in row.samples.chunks_exact(columns).enumerate() {
                            assert!(
                                image.slice(s![c, i, ..]).iter().zip(line).all(|(a, b)| a.to_bits() == b.to_bits()),
                                "{columns} × {rows}, axis {axis:?}, {bend}: row {i}"
                            );
                        }
                    }
                    assert!((outside - count as f64 / (rows * columns) as f64).abs() < 1e-12);
                }
            }
        }
    }

    #[test]
    fn the_quick_path_equals_the_general_one() {
        let rng = &mut fastrand::Rng::with_seed(4);
        let (rows, columns) = (30, 40);
        let plane: Vec<f32> = (0..rows * columns).map(|_| rng.f32()).collect();
        let (kernel, mut across, mut down) = (Lanczos::new(), Taps::default(), Taps::default());
        for _ in 0..1000 {
            let centre = |rng: &mut fastrand::Rng, n: usize| rng.f64() * n as f64 - 0.5;
            let stretch = 1.0 + 0.4 * rng.f64();
            let (x, y) = (centre(rng, columns), centre(rng, rows));
            across.set(&kernel, x, stretch);
            down.set(&kernel, y, stretch);
            let mut expected = 0.0;
            for (r, w) in down.weight.iter().enumerate() {
                for (q, v) in across.weight.iter().enumerate() {
                    let r = (down.first + r as i64).clamp(0, rows as i64 - 1) as usize;
                    let q = (across.first + q as i64).clamp(0, columns as i64 - 1) as usize;
                    expected += f64::from(*w) * f64::from(*v) * f64::from(plane[r * columns + q]);
                }
            }
            assert!((f64::from(weighted(&plane, columns, &across, &down)) - expected).abs() < 2e-6);
        }
    }

    /// Whatever finite numbers a frame and a distortion have, a picture comes out, of a table that has an end.
    #[test]
    fn no_finite_numbers_are_too_large() {
        // Axis, pitch, end and first coefficient of the distortion.
        let cases = [
            [1e300, 0.05, 1.0, 1.0],
            [-1e18, 0.05, 1.0, 1e300],
            [1e8, 1e-300, 1e300, 1.0],
            [4.0, 1e300, 5e-324, 1.0],
            [4.0, 1e-300, 1e-300, -1.0],
            [4.0, 0.05, 1e300, 1e300],
            [4.0, 0.05, 5e-324, 5e-324],
            [0.0, 0.05, 1.0, 0.0],
        ];
        for [at, pitch_mm, max_slope, first] in cases {
            let frame = Frame::centred(9, 7, pitch_mm).expect("positive").with_axis([at, 2.0]).expect("finite");
            let coefficients_mm = [first, 0.5 * first, 1e8 * first.signum(), -first];
            let distortion = Distortion { max_slope, coefficients_mm, residual_mm: 0.0 };
            let mut image = Array3::from_elem((3, 7, 9), 0.5_f32);
            let outside = undistort(&mut image, &frame, &distortion);
            assert!((0.0..=1.0).contains(&outside), "{at} {pitch_mm} {max_slope} {first}");
        }
    }

    #[test]
    fn a_lens_without_distortion_returns_the_picture() {
        let frame = Frame::centred(64, 48, 0.05).expect("valid");
        let plain = Distortion { max_slope: 0.5, coefficients_mm: [10.0, 0.0, 0.0, 0.0], residual_mm: 0.0 };
        let picture = smooth(&frame);
        let mut image = picture.clone();
        let outside = undistort(&mut image, &frame, &plain);
        let worst = (&image - &picture).iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        assert!(worst < 1e-5 && outside == 0.0, "{worst}");
    }
}
