//! Relative illumination at every pixel.
//!
//! The optics' illumination over the sensor radius is looked up on a fine even table, linearly: its own error is below 1e-6
//! of the axis. It multiplies the blurred picture at full resolution; no node's kernel carries it.

use ndarray::{Array3, ArrayView3, Axis, Zip};
use rayon::prelude::*;

use crate::develop::shading::Shading;
use crate::frame::Frame;
use crate::plane::Region;
use isoplanat_base::math::real::Real;
use isoplanat_optics::psf::{Optics, OpticsBar, SensorPoint};

/// Intervals of the table.
const INTERVALS: usize = 4096;
/// Rows that are pulled back together.
const STRIP: usize = 64;

/// Relative illumination of every channel over the radius in pixels.
#[derive(Clone, Debug)]
pub struct Light {
    /// Intervals per pixel of radius.
    per_px: f64,
    /// Radius of an interval, mm.
    step_mm: f64,
    /// `[channel][knot]`.
    values: Vec<Vec<f64>>,
}

impl Light {
    /// Of `optics` over `frame`.
    #[expect(clippy::cast_precision_loss, reason = "table sizes")]
    pub fn new(optics: &Optics, frame: &Frame) -> Self {
        let step_mm = frame.max_radius_mm() / INTERVALS as f64;
        let knots = (0..INTERVALS + 2).into_par_iter().map(|k| optics.relative_illumination(at(k, step_mm)));
        let knots: Vec<Vec<f64>> = knots.collect();
        let values = (0..optics.channels()).map(|c| knots.iter().map(|k| k[c]).collect()).collect();
        Self { per_px: frame.pitch_mm / step_mm, step_mm, values }
    }

    #[inline]
    #[expect(
        clippy::cast_precision_loss,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "an index"
    )]
    fn place(&self, [x, y]: [f64; 2]) -> (usize, f64) {
        let at = (x * x + y * y).sqrt() * self.per_px;
        let k = (at as usize).min(INTERVALS);
        (k, (at - k as f64).min(1.0))
    }

    /// Writes the relative illumination of `channels` over `region`, `[channel, row, col]`.
    pub fn over<T: Real>(&self, frame: &Frame, region: Region, channels: &[usize]) -> Array3<T> {
        let mut out = Array3::from_elem((channels.len(), region.rows, region.cols), T::zero());
        out.axis_iter_mut(Axis(1)).into_par_iter().enumerate().for_each(|(i, mut row)| {
            for j in 0..region.cols {
                let (k, t) = self.place(region.offset(frame, i, j));
                for (c, channel) in channels.iter().enumerate() {
                    let v = &self.values[*channel];
                    row[[c, j]] = T::real(v[k] + t * (v[k + 1] - v[k]));
                }
            }
        });
        out
    }

    /// Multiplies `image` over `region` by the illumination of `channels`.
    pub(crate) fn multiply<T: Real>(&self, frame: &Frame, region: Region, channels: &[usize], image: &mut Array3<T>) {
        let light: Array3<T> = self.over(frame, region, channels);
        Zip::from(image).and(&light).par_for_each(|a, b| *a *= *b);
    }

    /// Pulls a cotangent on [`Self::over`] for all channels back to the optics (added to `bar`).
    pub fn over_vjp<T: Real>(
        &self,
        optics: &Optics,
        frame: &Frame,
        region: Region,
        light_bar: ArrayView3<'_, T>,
        bar: &mut OpticsBar,
    ) {
        let channels = light_bar.len_of(Axis(0));
        // Strips of rows, summed in their order whatever the thread count.
        let strips: Vec<Vec<f64>> = light_bar
            .axis_chunks_iter(Axis(1), STRIP)
            .into_par_iter()
            .enumerate()
            .map(|(strip, bars)| {
                let mut knots = vec![0.0; channels * (INTERVALS + 2)];
                for (i, row) in bars.axis_iter(Axis(1)).enumerate() {
                    for (j, pixel) in row.axis_iter(Axis(1)).enumerate() {
                        let (k, t) = self.place(region.offset(frame, strip * STRIP + i, j));
                        for (c, b) in pixel.iter().enumerate() {
                            let b = b.to_double();
                            knots[channels * k + c] += b * (1.0 - t);
                            knots[channels * (k + 1) + c] += b * t;
                        }
                    }
                }
                knots
            })
            .collect();
        let mut sums = vec![0.0; channels * (INTERVALS + 2)];
        for strip in &strips {
            sums.iter_mut().zip(strip).for_each(|(a, b)| *a += b);
        }
        let places = sums.chunks_exact(channels).enumerate().map(|(k, bars)| (at(k, self.step_mm), bars));
        optics.relative_illumination_vjp(places.filter(|(_, bars)| bars.iter().any(|b| *b != 0.0)), bar);
    }

    /// The flat field for a kit, at 257 radii.
    ///
    /// # Errors
    /// A corner without light.
    pub fn shading(&self) -> isoplanat_base::error::Result<Shading> {
        let knots = (0..=INTERVALS).step_by(INTERVALS / 256);
        #[expect(clippy::cast_precision_loss, reason = "table sizes")]
        let radius = knots.clone().map(|k| k as f64 * self.step_mm).collect();
        let of = |c: usize| knots.clone().map(|k| self.values[c.min(self.values.len() - 1)][k]).collect();
        Shading::new(radius, std::array::from_fn(of))
    }
}

/// Knot `k` of a table of steps of `step_mm`.
#[expect(clippy::cast_precision_loss, reason = "table sizes")]
fn at(k: usize, step_mm: f64) -> SensorPoint {
    SensorPoint::along([1.0, 0.0], k as f64 * step_mm)
}
