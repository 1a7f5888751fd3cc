//! The reference's gradient: the clean picture first, then the derivative of its rays, averaged over passes (the paper's
//! §3.2.2 in reverse mode).
//!
//! Given the cotangent of the rendered picture, each pass draws rays of the renderer's kind with a seed of its own and
//! pulls the cotangent through the texel, the object slope, the traced ray (the adjoint of the lens met from its sensor),
//! its direction and its weight. The passes are independent of one another, so their spread is the error of their mean;
//! if the caller's picture was rendered with another seed, the mean is unbiased for the derivative it stands for.
//!
//! It is the *interior* term, as in the paper: which rays pass is held. Rays start at the sensor, so what stands before
//! the stop (on the object's side) does not move the edge that the stop makes: there the gradient is whole, wherever no
//! aperture of those surfaces cuts the beam. What stands between stop and sensor moves the stop's image, and the light
//! that enters or leaves at that edge is *not* in this gradient. Held besides: where rays are aimed at on the rear
//! aperture's plane, mm, the sensor points, the white level on the axis (as `RenderPlan::white` is), every aperture, and
//! the scene with its distance. The plane of the rear rim moves with its surface: with the last distance and the sag.

use glam::{DMat3, DVec2, DVec3};
use ndarray::ArrayView3;
use rayon::prelude::*;

use super::rear::RearView;
use super::stream::{Pixel, Sink, Stream, View, Waiting};
use super::{Channels, GROUPS, Settings, Tracer, check, reach_mm};
use crate::frame::Frame;
use crate::plane::{Plane, Region};
use crate::sensor::noise::mixed;
use crate::sensor::spectrum::SpectralDensity;
use isoplanat_base::error::{Error, Result};
use isoplanat_optics::lens::pose::Motion;
use isoplanat_optics::lens::variables::Variables;
use isoplanat_optics::lens::{Lens, LensGradient};
use isoplanat_optics::trace::sequential::{Hit, HitBar, trace, trace_vjp};
use isoplanat_optics::trace::{System, SystemGradient};

/// Tasks that a pass is cut into, by the rows of its region alone.
const TASKS: usize = 32;

/// An averaged gradient.
#[derive(Clone, Debug)]
pub struct Gradient {
    /// The mean over the passes.
    pub mean: LensGradient,
    /// Every pass's part of the mean: they sum to it.
    pub parts: Vec<LensGradient>,
    /// Rays started, of all passes.
    pub rays: u64,
}

/// One number of a gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Component {
    /// The mean over the passes.
    pub mean: f64,
    /// Its standard error, from the spread of the passes; infinite for a single one.
    pub standard_error: f64,
}

impl Gradient {
    /// The gradient with respect to the scaled `variables`, each with its error.
    pub fn components(&self, variables: &Variables) -> Vec<Component> {
        let passes = self.parts.len() as f64;
        let parts: Vec<Vec<f64>> = self.parts.iter().map(|g| variables.gradient(g)).collect();
        let component = |(i, mean): (usize, f64)| {
            let squares: f64 = parts.iter().map(|p| (p[i] - mean / passes).powi(2)).sum();
            // A part is a pass over the number of passes.
            let standard_error = if passes > 1.0 { (squares * passes / (passes - 1.0)).sqrt() } else { f64::INFINITY };
            Component { mean, standard_error }
        };
        variables.gradient(&self.mean).into_iter().enumerate().map(component).collect()
    }
}

/// Pulls the cotangent `image_bar` (`[3, row, col]`) of `region`, as [`super::render`] renders it for all channels, back
/// to `lens`, in `passes` passes of `settings.samples` rays a pixel and channel each.
///
/// The result does not depend on the number of threads. Lenses may have any rotationally symmetric surfaces.
///
/// # Errors
/// As [`super::render`]; a lens without symmetry; a mosaic; a cotangent of another shape or with a value that is not finite; no passes.
#[expect(clippy::too_many_arguments, reason = "the forward call's own arguments, a cotangent and a number of passes")]
pub fn render_vjp(
    lens: &Lens,
    scene: &Plane,
    density: &SpectralDensity,
    frame: &Frame,
    region: Region,
    settings: Settings,
    passes: usize,
    image_bar: ArrayView3<'_, f64>,
) -> Result<Gradient> {
    if settings.channels != Channels::All {
        return Err(Error::bad("", "channels", "a mosaic", "all channels, for a gradient"));
    }
    if image_bar.dim() != (3, region.rows, region.cols) || !image_bar.iter().all(|b| b.is_finite()) {
        let found = format!("{:?}", image_bar.dim());
        let allowed = format!("finite numbers of the shape (3, {}, {})", region.rows, region.cols);
        return Err(Error::bad("", "cotangent of the picture", found, allowed));
    }
    if passes == 0 {
        return Err(Error::bad("", "passes", "0", "1 or more; 2 or more for an error"));
    }
    lens.require_symmetry("a gradient by rays from the sensor")?;
    check(scene, region)?;
    let tracer = Tracer::new(lens, density, reach_mm(frame, region), settings)?;
    let prepared = tracer.prepared(region.radii_mm(frame, 0.0));
    let systems = Systems::new(lens, &tracer.rear);
    let mut gradient = Gradient { mean: LensGradient::zeros(lens), parts: Vec::new(), rays: 0 };
    for pass in 0..passes {
        let view = prepared.view(frame, mixed(settings.seed, pass as u64));
        let (part, rays) = one_pass(lens, scene, &systems, view, region, image_bar, passes);
        gradient.mean.add(&part);
        gradient.parts.push(part);
        gradient.rays += rays;
    }
    Ok(gradient)
}

/// One pass over the region, divided by the number of passes; and its rays.
fn one_pass(
    lens: &Lens,
    scene: &Plane,
    systems: &Systems,
    view: View<'_>,
    region: Region,
    image_bar: ArrayView3<'_, f64>,
    passes: usize,
) -> (LensGradient, u64) {
    let tasks = TASKS.min(region.rows);
    let each: Vec<(LensCotangents<'_>, u64)> = (0..tasks)
        .into_par_iter()
        .map(|task| {
            let (mut sums, mut stream) = (LensCotangents::new(scene, systems, view), Stream::new(view));
            for i in task * region.rows / tasks..(task + 1) * region.rows / tasks {
                for (j, channel) in (0..region.cols).flat_map(|j| (0..3).map(move |channel| (j, channel))) {
                    let white = view.rear.axis_irradiance[channel];
                    sums.bars.push(image_bar[[channel, i, j]] / (white * passes as f64));
                    let (row, col) = (region.row + i.cast_signed(), region.col + j.cast_signed());
                    stream.add(Pixel { row, col, channel }, &mut sums);
                }
            }
            stream.finish(&mut sums);
            (sums, stream.rays)
        })
        .collect();
    let mut total = LensCotangents::new(scene, systems, view);
    let mut rays = 0;
    for (sums, started) in &each {
        total.add(sums);
        rays += started;
    }
    (total.into_lens(lens), rays)
}

/// The lens from its sensor at every wavelength of the view, without the sensor's own surface.
struct Systems {
    each: Vec<System>,
    /// Wavelength, nm.
    nm: Vec<f64>,
}

impl Systems {
    fn new(lens: &Lens, rear: &RearView) -> Self {
        let nm = rear.wavelengths_nm().to_vec();
        let each = nm
            .par_iter()
            .map(|nm| {
                let mut system = System::new(lens, *nm).reversed();
                system.surfaces.remove(0);
                system.stop = system.stop.saturating_sub(1);
                system
            })
            .collect();
        Self { each, nm }
    }
}

/// Cotangents of the lens from its sensor.
struct LensCotangents<'a> {
    scene: &'a Plane,
    systems: &'a Systems,
    view: View<'a>,
    /// Of every pixel and channel, over the white level and the number of passes.
    bars: Vec<f64>,
    /// All but the indices.
    system: SystemGradient,
    /// Indices: wavelength after wavelength, a space after the other.
    indices: Vec<f64>,
    hits: Vec<Hit>,
    hit_bars: Vec<HitBar>,
}

impl<'a> LensCotangents<'a> {
    fn new(scene: &'a Plane, systems: &'a Systems, view: View<'a>) -> Self {
        let system = SystemGradient::zeros(&systems.each[0]);
        let indices = vec![0.0; systems.each.len() * system.indices.len()];
        let hit_bars = vec![HitBar::default(); systems.each[0].surfaces.len()];
        Self { scene, systems, view, bars: Vec::new(), system, indices, hits: Vec::new(), hit_bars }
    }

    fn add(&mut self, other: &Self) {
        self.system.add(&other.system);
        self.indices.iter_mut().zip(&other.indices).for_each(|(a, b)| *a += b);
    }

    /// One ray's part: `bar · n'² L cos⁴θ′ / Z² A` by the numbers of the lens.
    fn ray_vjp(&mut self, traced: &Waiting, lane: usize, channel: usize, bar: f64) {
        let rear = self.view.rear;
        let colour = traced.tile.colour[lane] as usize;
        let system = &self.systems.each[colour];
        let last = system.surfaces.len() - 1;
        let [p, target] = traced.draw.ends(lane);
        let offset = (target - p).extend(rear.distance);
        let inverse = offset.length().recip();
        let direction = offset * inverse;
        let ray = isoplanat_optics::trace::Ray { origin: target.extend(rear.distance), direction };
        let Ok(hit) = trace(system, ray, last, &mut self.hits) else { return };
        // The texel, and back.
        let slope = object_slope(hit.at.point, hit.direction, self.scene.vergence);
        let channel = channel.min(self.scene.texture.dim().0 - 1);
        let (radiance, [by_col, by_row]) = self.scene.sample(channel, self.scene.texel_from_slope(slope.into()));
        let weight = traced.draw.weight[lane];
        let slope_bar = bar * weight * self.scene.texels_per_slope * DVec2::new(by_col, -by_row);
        let (point, direction_bar) = object_slope_vjp(hit.at.point, hit.direction, self.scene.vergence, slope_bar);
        self.hit_bars[last] = HitBar { point, direction: direction_bar, optical_path: 0.0 };
        self.system.indices.fill(0.0);
        let (origin_bar, direction_bar) = trace_vjp(system, &self.hits, &self.hit_bars, &mut self.system);
        // The weight: n'² A Z²/(Z² + o²)².
        let weight_bar = bar * radiance * weight;
        let index = system.surfaces[0].index_before;
        self.system.indices[0] += 2.0 * weight_bar / index;
        let spaces = self.system.indices.len();
        let indices = &mut self.indices[colour * spaces..(colour + 1) * spaces];
        indices.iter_mut().zip(&self.system.indices).for_each(|(a, b)| *a += b);
        // The plane of the rear rim.
        let z = rear.distance;
        let by_direction = (direction_bar - direction * direction.dot(direction_bar)).z * inverse;
        let distance_bar = origin_bar.z + by_direction + weight_bar * (2.0 / z - 4.0 * z * inverse * inverse);
        self.rim_vjp(distance_bar);
    }

    /// Pulls a cotangent on the distance of the rear rim's plane back to the rear surface.
    fn rim_vjp(&mut self, distance_bar: f64) {
        let surface = &self.systems.each[0].surfaces[0];
        self.system.distances[0] += distance_bar;
        let rho = surface.semi_diameter * surface.semi_diameter;
        if let Some(sag) = surface.shape.sag(rho) {
            surface.shape.sag_vjp(rho, &sag, distance_bar, 0.0, &mut self.system.shapes[0]);
        }
    }

    /// Turned round: the cotangents of the lens.
    fn into_lens(self, lens: &Lens) -> LensGradient {
        let mut gradient = LensGradient::zeros(lens);
        let count = lens.surfaces.len();
        let mut forward = SystemGradient::zeros(&System::new(lens, lens.wavelengths.primary_nm));
        let mirror = DMat3::from_diagonal(DVec3::new(1.0, 1.0, -1.0));
        for (j, shape) in self.system.shapes.iter().enumerate() {
            let i = count - 1 - j;
            // Seen from behind a shape is linear in itself, and its own inverse.
            forward.shapes[i] = shape.reversed();
            forward.distances[i + 1] = self.system.distances[j];
            let bar = self.system.motions[j];
            forward.motions[i] = Motion { rotation: mirror * bar.rotation * mirror, shift: mirror * bar.shift };
        }
        forward.add_to(lens, lens.wavelengths.primary_nm, &mut gradient);
        for (nm, indices) in self.systems.nm.iter().zip(self.indices.chunks_exact(count + 1)) {
            let indices: Vec<f64> = indices.iter().rev().copied().collect();
            gradient.add_indices(lens, *nm, &indices);
        }
        gradient
    }
}

impl Sink for LensCotangents<'_> {
    fn take(&mut self, traced: &Waiting) {
        // Every group is a mean over its rays, the picture the mean over the groups; the ray outside stands alone.
        let share = ((self.view.group_size() * GROUPS) as f64).recip();
        for span in &traced.spans {
            let bar = self.bars[span.number] * if span.sum < GROUPS { share } else { 1.0 };
            for lane in span.first..span.end {
                if bar != 0.0 && traced.passed(self.view.rear, lane) {
                    self.ray_vjp(traced, lane, span.channel, bar);
                }
            }
        }
    }
}

/// Where a ray that left the lens towards the object meets it: object height over object distance, `[right, up]`.
///
/// The ray stands in the first vertex's frame seen from the sensor (`z` towards the object). It crosses the vertex plane
/// at `e` with the slope `m`; at the distance `1/v` its height times `v` is `v e + m`, for every `v`.
#[inline]
pub(super) fn object_slope(point: DVec3, direction: DVec3, vergence: f64) -> DVec2 {
    let m = direction.truncate() / direction.z;
    vergence * (point.truncate() - point.z * m) + m
}

/// Pulls a cotangent on [`object_slope`] back to point and direction.
fn object_slope_vjp(point: DVec3, direction: DVec3, vergence: f64, slope_bar: DVec2) -> (DVec3, DVec3) {
    let m = direction.truncate() / direction.z;
    let e_bar = vergence * slope_bar;
    let m_bar = (1.0 - vergence * point.z) * slope_bar;
    let across = m_bar / direction.z;
    (e_bar.extend(-m.dot(e_bar)), across.extend(-m.dot(across)))
}

#[cfg(test)]
mod tests;
