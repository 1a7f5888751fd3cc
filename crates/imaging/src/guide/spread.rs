//! The point spread function of every place in a few numbers: how wide it is in each colour, how much longer along the radius than across it, and how
//! bright the place is.
//!
//! Lenses are rotationally symmetric here, so all of it is a table over the distance from the axis; the direction in which the spread is long turns with the
//! place. Of several object distances it is their mean that counts.

use ndarray::{Array2, ArrayViewMut3};

use crate::frame::Frame;
use crate::plane::Region;
use crate::render::Renderer;
use isoplanat_base::error::{Error, Result};
use isoplanat_card::SPREAD;
use isoplanat_optics::psf::SensorPoint;
use isoplanat_optics::psf::measured::knot;

/// Steps of the table over the radius.
const STEPS: usize = 32;
/// Most knots of a table that is read.
const MOST: usize = 4096;
/// Numbers of a knot: widths of red, green and blue, elongation, light.
const NUMBERS: usize = 5;
/// Widths are shown by their logarithm, which is 0 and 1 at these, pixels.
const SHOWN: [f64; 2] = [0.25, 16.0];

/// What point spread functions are like, by distance from the axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Spread {
    /// Distances from the axis, pixels, growing from 0.
    pub radii_px: Vec<f64>,
    /// `[knot, number]`: rms width across one direction, pixels, of red, green and blue; elongation `(σ_r² − σ_t²) / (σ_r² + σ_t²)`; light over the axis's.
    pub numbers: Array2<f64>,
}

impl Spread {
    /// Of the lens that `renderer` holds, over all its distances.
    pub fn compute(renderer: &Renderer) -> Self {
        let (optics, plan) = (&renderer.optics, &renderer.plan);
        let frame = &plan.frame;
        let far = frame.max_radius_mm();
        let radii: Vec<f64> = (0..=STEPS).map(|k| far * k as f64 / STEPS as f64).collect();
        let points: Vec<SensorPoint> = radii.iter().map(|r| SensorPoint::along([1.0, 0.0], *r)).collect();
        let mut moments = Array2::<f64>::zeros((radii.len(), 2 * 3));
        for (depth, d) in plan.depths.iter().enumerate() {
            let size = 2 * d.half_width * d.bin + 1;
            let form = optics.form(plan.settings.dense, size, 1, frame.pitch_mm);
            let of_place = |_: usize, kernels: &[f64], _: &[f64]| {
                let all: Vec<[f64; 2]> = kernels.chunks_exact(size * size).map(|k| variances(k, size)).collect();
                [0, 1, 2].map(|c: usize| all[c.min(all.len() - 1)])
            };
            for (mut row, found) in moments.outer_iter_mut().zip(optics.kernels_each(&form, depth, &points, of_place)) {
                found.as_flattened().iter().zip(&mut row).for_each(|(v, sum)| *sum += v / plan.depths.len() as f64);
            }
        }
        let light = |point: SensorPoint| {
            let all = optics.relative_illumination(point);
            all.iter().sum::<f64>() / all.len() as f64
        };
        let numbers = Array2::from_shape_fn((radii.len(), NUMBERS), |(k, n)| {
            let [along, across] = [0, 1].map(|i| [0, 1, 2].map(|c: usize| moments[[k, 2 * c + i]]));
            match n {
                0..3 => (0.5 * (along[n] + across[n])).sqrt(),
                3 => {
                    let [a, b] = [along, across].map(|v| v.iter().sum::<f64>());
                    if a + b > 0.0 { (a - b) / (a + b) } else { 0.0 }
                }
                _ => light(points[k]).clamp(0.0, 10.0),
            }
        });
        Self { radii_px: radii.iter().map(|r| r / frame.pitch_mm).collect(), numbers }
    }

    /// From what a file holds.
    ///
    /// # Errors
    /// Knots that do not grow from 0, numbers that are not finite or no widths and shares.
    pub fn from_parts(radii_px: Vec<f64>, numbers: Array2<f64>) -> Result<Self> {
        let refuse = |found: String, allowed: &str| Err(Error::bad("", "point spread functions", found, allowed));
        let grow = radii_px.first() == Some(&0.0) && radii_px.windows(2).all(|w| w[0] < w[1]);
        if !grow || radii_px.len() > MOST || radii_px.iter().any(|r| !r.is_finite()) {
            return refuse(
                format!("{} distances from the axis", radii_px.len()),
                "up to 4096 finite ones that grow from 0",
            );
        }
        if numbers.dim() != (radii_px.len(), NUMBERS) {
            return refuse(format!("{:?} numbers at {} distances", numbers.dim(), radii_px.len()), "five at each");
        }
        for ((k, n), v) in numbers.indexed_iter() {
            let range = if n == 3 { -1.0..=1.0 } else { 0.0..=1e6 };
            if !range.contains(v) {
                return refuse(format!("{v} at distance {k}, number {n}"), "widths, an elongation within ±1, light");
            }
        }
        Ok(Self { radii_px, numbers })
    }

    /// Refuses a table that ends within `frame`.
    pub(super) fn check(&self, frame: &Frame) -> Result<()> {
        let (last, far) = (self.radii_px.last().copied().unwrap_or(0.0), frame.max_radius_mm() / frame.pitch_mm);
        if last < far * (1.0 - 1e-6) {
            let allowed = format!("as far as the frame's corner, {far:.1}");
            return Err(Error::bad(
                "",
                "point spread functions",
                format!("known to {last:.1} pixels from the axis"),
                allowed,
            ));
        }
        Ok(())
    }

    /// Writes the channels over `wanted` of `frame`, `[6, row, col]`: the logarithm of the width of red, green and blue, 0 at a quarter of a pixel and 1 at 16;
    /// elongation times cosine and sine of twice the azimuth; light. All but the elongation less their [means](Self::means), so that a network sees what differs.
    pub(super) fn write(&self, frame: &Frame, wanted: Region, mut out: ArrayViewMut3<'_, f32>) {
        let means = self.means();
        for i in 0..wanted.rows {
            for j in 0..wanted.cols {
                let [x, y] = wanted.offset(frame, i, j);
                let values = self.at(x, y);
                for (k, (v, mean)) in values.into_iter().zip(means).enumerate() {
                    out[[k, i, j]] = v - mean;
                }
            }
        }
    }

    /// Means of the channels over the disk of the table; 0 of the elongation, which has a direction.
    pub(super) fn means(&self) -> [f32; SPREAD] {
        let mut sums = [0.0; SPREAD];
        let mut area = 0.0;
        for ends in self.radii_px.windows(2) {
            let (radius, weight) = (0.5 * (ends[0] + ends[1]), ends[1].powi(2) - ends[0].powi(2));
            area += weight;
            let channels = self.at(radius, 0.0);
            sums.iter_mut().zip(channels).for_each(|(sum, v)| *sum += weight * f64::from(v));
        }
        #[expect(clippy::cast_possible_truncation, reason = "numbers of the order of one")]
        let mut means = sums.map(|sum| if area > 0.0 { (sum / area) as f32 } else { 0.0 });
        (means[3], means[4]) = (0.0, 0.0);
        means
    }

    /// The channels `x`, `y` pixels from the axis, before their means are taken off.
    #[expect(clippy::cast_possible_truncation, reason = "numbers of the order of one")]
    fn at(&self, x: f64, y: f64) -> [f32; SPREAD] {
        let square = x * x + y * y;
        let (low, share) = knot(&self.radii_px, square.sqrt());
        let high = (low + 1).min(self.radii_px.len() - 1);
        let number = |n: usize| (1.0 - share) * self.numbers[[low, n]] + share * self.numbers[[high, n]];
        let width = |n: usize| (number(n).max(SHOWN[0]) / SHOWN[0]).ln() / (SHOWN[1] / SHOWN[0]).ln();
        let [cosine, sine] = if square > 0.0 { [(x * x - y * y) / square, 2.0 * x * y / square] } else { [0.0, 0.0] };
        let long = number(3);
        [width(0), width(1), width(2), long * cosine, long * sine, number(4)].map(|v| v as f32)
    }

    /// Turns channels of [`Self::write`] into those of the mirrored place, where the pictures of the channels have been turned already: rows, columns, both
    /// swapped.
    pub(super) fn turn(mut channels: ArrayViewMut3<'_, f32>, turns: [bool; 3]) {
        if turns[0] != turns[1] {
            channels.index_axis_mut(ndarray::Axis(0), 4).mapv_inplace(|v| -v);
        }
        if turns[2] {
            channels.index_axis_mut(ndarray::Axis(0), 3).mapv_inplace(|v| -v);
        }
    }
}

/// Variances of a kernel along its columns and its rows, pixels².
fn variances(kernel: &[f64], size: usize) -> [f64; 2] {
    let half = (size / 2) as f64;
    let mut sums = [0.0; 5];
    for (k, v) in kernel.iter().enumerate() {
        let (x, y) = ((k % size) as f64 - half, (k / size) as f64 - half);
        sums.iter_mut().zip([1.0, x, y, x * x, y * y]).for_each(|(sum, of)| *sum += v * of);
    }
    let [light, x, y, xx, yy] = sums;
    if light <= 0.0 {
        return [0.0; 2];
    }
    [(xx / light - (x / light).powi(2)).max(0.0), (yy / light - (y / light).powi(2)).max(0.0)]
}
