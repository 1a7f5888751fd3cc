//! Where the light of pixels comes from: the mean object slope over all rays that reach each of them. What a lens shows at a place, whatever its blur, its
//! tilts and decentres do to the chief ray.

use rayon::prelude::*;

use super::gradient::object_slope;
use super::rear::RearView;
use super::stream::{Pixel, Sink, Stream, Waiting};
use super::{GROUPS, Settings, Tracer};
use crate::frame::Frame;
use crate::sensor::spectrum::SpectralDensity;
use isoplanat_base::error::Result;
use isoplanat_optics::lens::Lens;

/// The channel whose light is looked at: green.
const CHANNEL: usize = 1;

/// Slopes `[right, up]` at which pixels `[row, column]` of `frame` see objects at `vergence`, by `settings.samples` rays each in green light; `None`
/// where none arrives.
///
/// # Errors
/// Fewer than 2 samples; a lens without room before its sensor.
pub fn seen(
    lens: &Lens,
    density: &SpectralDensity,
    frame: &Frame,
    vergence: f64,
    pixels: &[[usize; 2]],
    settings: Settings,
) -> Result<Vec<Option<[f64; 2]>>> {
    let radius_mm = frame.max_radius_mm();
    let tracer = Tracer::without_white(lens, density, radius_mm, settings)?;
    let prepared = tracer.prepared([0.0, radius_mm]);
    let view = prepared.view(frame, settings.seed);
    let one = |[row, col]: &[usize; 2]| {
        let mut sums = Slopes { rear: view.rear, vergence, size: view.group_size() as f64, sums: [0.0; 3] };
        let mut stream = Stream::new(view);
        stream.add(Pixel { row: row.cast_signed(), col: col.cast_signed(), channel: CHANNEL }, &mut sums);
        stream.finish(&mut sums);
        let [light, right, up] = sums.sums;
        (light > 0.0).then(|| [right / light, up / light])
    };
    Ok(pixels.par_iter().map(one).collect())
}

/// Sums over a pixel's rays: light, and light times slope.
struct Slopes<'a> {
    rear: &'a RearView,
    vergence: f64,
    /// Rays of a group.
    size: f64,
    sums: [f64; 3],
}

impl Sink for Slopes<'_> {
    fn take(&mut self, traced: &Waiting) {
        for span in &traced.spans {
            // A group's rays stand for its mean, the groups for theirs; a ray outside the ellipse stands for itself.
            let share = if span.sum < GROUPS { 1.0 / (self.size * GROUPS as f64) } else { 1.0 };
            for lane in span.first..span.end {
                if traced.passed(self.rear, lane) {
                    let ray = traced.tile.rays.ray(lane);
                    let slope = object_slope(ray.origin, ray.direction, self.vergence);
                    let light = share * traced.draw.weight[lane];
                    [1.0, slope.x, slope.y].iter().zip(&mut self.sums).for_each(|(v, sum)| *sum += light * v);
                }
            }
        }
    }
}
