//! The merit's rays through a moving lens: aimed at the real stop, with the rows of the Jacobian.
//!
//! Every ray keeps its place on its launch plane and the inverse of `∂(stop)/∂(launch)`: when the lens moves, the place follows by
//! its own derivative, one or two chord steps bring it to 1e-10 of the stop's semi-diameter, and
//! `δp = −S_p⁻¹ (S_θ − target_θ) δθ` is part of every row. Two sweeps back from the image and two from the stop give all rows of a
//! tile, whatever the number of variables.

use glam::{DMat2, DVec2, DVec3};

use super::engine::{Bar, Columns, Engine, Workspace};
use super::first_order::FirstOrder;
use super::merit::{Colour, Merit, Point, Quality, Reference, Role, Sample, balance, opened, rays};
use crate::lens::variables::Variables;
use crate::lens::{Lens, Prescription};
use crate::trace::aim::{Aimed, Aimer};
use crate::trace::lanes::TILE;
use crate::trace::sequential::{first_vignetted, trace};
use crate::trace::system::TraceSurface;
use crate::trace::{Cause, Failure, Ray, System};

/// Rays are aimed to this part of the stop's semi-diameter.
const AIMED: f64 = 1e-10;
/// Chord and Newton steps before a ray counts as lost.
const STEPS: usize = 12;

/// Where one ray stands on its launch plane.
#[derive(Clone, Copy, Debug)]
struct LaunchPoint {
    p: DVec2,
    /// `(∂S/∂p)⁻¹`.
    inverse: DMat2,
}

/// The rays of a merit on one lens.
pub(super) struct Rays {
    pub(super) points: Vec<Point>,
    /// Of every object point: how much of its light is traced; the rest ends at stated apertures.
    pub(super) light: Vec<f64>,
    colours: Vec<Colour>,
    pub(super) quality: Quality,
    pub(super) reference: Reference,
    pub(super) symmetric: bool,
    variables: Variables,
    work: Workspace,
    columns: [Columns; 5],
}

/// A traced lens: everything but derivatives.
#[derive(Clone, Debug)]
pub(super) struct Traced {
    places: Vec<Vec<LaunchPoint>>,
    /// Landing, and the path to the image plane.
    landed: Vec<Vec<Landing>>,
    /// How far from the axis light goes on every surface, mm.
    pub(super) heights: Vec<f64>,
    /// What rays land on.
    image: TraceSurface,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Landing {
    at: DVec3,
    direction: DVec3,
    path: f64,
}

/// Derivatives of landings, and of places on launch planes.
pub(super) struct Slopes {
    /// Of colour and sample: `x`, `y` and path by every variable, `3 × variables` numbers.
    landed: Vec<Vec<f64>>,
    /// `p` by every variable, `2 × variables` numbers.
    places: Vec<Vec<f64>>,
}

impl Rays {
    /// The rays of `merit` on `lens` at `share` of aperture and field, traced. Rays that stated apertures stop are left out.
    pub(super) fn new(
        merit: &Merit,
        lens: &Lens,
        variables: &Variables,
        share: f64,
        clip: bool,
    ) -> Result<(Self, Traced), Failure> {
        let (points, mut colours) = rays(merit, lens, share);
        let mut places = Vec::new();
        for colour in &mut colours {
            let (kept, at) = aimed(lens, &points, colour, clip)?;
            colour.samples = kept;
            places.push(at);
        }
        let mut light = vec![0.0; points.len()];
        for s in colours.iter().flat_map(|c| &c.samples) {
            light[s.point] += s.weight / points[s.point].weight.max(f64::MIN_POSITIVE);
        }
        balance(&points, &mut colours);
        let surfaces = lens.surfaces.len() + 1;
        let count = variables.parameters.len();
        let columns = std::array::from_fn(|_| Columns::new(count));
        let mut rays = Self {
            points,
            light,
            colours,
            quality: merit.quality,
            reference: merit.reference,
            symmetric: lens.is_symmetric() && !merit.whole,
            variables: variables.clone(),
            work: Workspace::new(surfaces),
            columns,
        };
        let traced = rays.settle(lens, &vec![0.0; lens.surfaces.len()], places)?;
        Ok((rays, traced))
    }

    /// The same rays through `lens`, aimed anew: what comes out depends on the lens alone.
    pub(super) fn afresh(&mut self, lens: &Lens) -> Result<Traced, Failure> {
        let mut places = Vec::with_capacity(self.colours.len());
        for colour in &self.colours {
            places.push(aimed(lens, &self.points, colour, false)?.1);
        }
        self.settle(lens, &vec![0.0; lens.surfaces.len()], places)
    }

    /// Number of rays that are traced.
    pub(super) fn count(&self) -> usize {
        self.colours.iter().map(|c| c.samples.len()).sum()
    }

    /// Traces `numbers`, which differ from the lens of `from` by `step` in the variables.
    pub(super) fn trace(
        &mut self,
        numbers: &Prescription,
        from: &Traced,
        slopes: &Slopes,
        step: &[f64],
    ) -> Result<Traced, Failure> {
        let n = step.len();
        let mut places = from.places.clone();
        for (places, by) in places.iter_mut().zip(&slopes.places) {
            for (place, by) in places.iter_mut().zip(by.chunks_exact(2 * n.max(1))) {
                let dot = |by: &[f64]| by.iter().zip(step).map(|(b, s)| b * s).sum::<f64>();
                place.p += DVec2::new(dot(&by[..n]), dot(&by[n..]));
            }
        }
        self.settle(numbers, &from.heights, places)
    }

    /// Aims and traces from `places`.
    fn settle(
        &mut self,
        numbers: &Prescription,
        heights: &[f64],
        mut places: Vec<Vec<LaunchPoint>>,
    ) -> Result<Traced, Failure> {
        let surfaces = numbers.surfaces.len();
        let image = TraceSurface::new(numbers.image.shape(), 0.0, [1.0; 2], f64::INFINITY);
        let mut out = Traced { places: Vec::new(), landed: Vec::new(), heights: vec![0.0; surfaces], image };
        let numbers = &{
            let mut open = numbers.clone();
            opened(&mut open, heights);
            open
        };
        for (colour, places) in self.colours.iter().zip(&mut places) {
            let engine = Engine::new(numbers, colour.nm, &self.variables);
            let mut landed = vec![Landing::default(); places.len()];
            for (at, (samples, places)) in colour.samples.chunks(TILE).zip(places.chunks_mut(TILE)).enumerate() {
                let targets: Vec<DVec2> = samples.iter().map(|s| engine.system.stop_semi_diameter * s.target).collect();
                let planes = |i: usize| &self.points[samples[i].point].plane;
                let rays = aim(&engine, &mut self.work, &mut self.columns, planes, places, &targets)?;
                let image = engine.system.image();
                let index = engine.system.surfaces[image].index_before;
                let before = engine.system.surfaces[0].index_before;
                for (i, ray) in rays.iter().enumerate() {
                    let landing = engine.behind(&self.work, image, i);
                    landed[at * TILE + i] = Landing {
                        at: landing.origin,
                        direction: index * landing.direction,
                        path: engine.path(&self.work, i) + before * planes(i).path(ray),
                    };
                    if colour.primary || samples[i].weight > 0.0 {
                        for (k, height) in out.heights.iter_mut().enumerate() {
                            let r = engine.behind(&self.work, k, i).origin.truncate().length();
                            *height = height.max(r);
                        }
                    }
                }
            }
            out.landed.push(landed);
        }
        out.places = places;
        Ok(out)
    }

    /// Derivatives of everything in `traced`, a trace of `numbers`; the inverses in it are brought up to date.
    pub(super) fn slopes(&mut self, numbers: &Prescription, traced: &mut Traced) -> Result<Slopes, Failure> {
        let n = self.variables.parameters.len();
        let first = FirstOrder::new(numbers, &self.variables);
        let numbers = &{
            let mut open = numbers.clone();
            opened(&mut open, &traced.heights);
            open
        };
        let mut slopes = Slopes { landed: Vec::new(), places: Vec::new() };
        let wavefront = self.quality == Quality::Wavefront;
        let centroids = self.centroids(traced);
        for (c, colour) in self.colours.iter().enumerate() {
            let engine = Engine::new(numbers, colour.nm, &self.variables);
            let image = engine.system.image();
            let (mut of_landed, mut of_places) =
                (vec![0.0; 3 * n * colour.samples.len()], vec![0.0; 2 * n * colour.samples.len()]);
            for (at, samples) in colour.samples.chunks(TILE).enumerate() {
                let places = &mut traced.places[c][at * TILE..at * TILE + samples.len()];
                let plane = |i: usize| &self.points[samples[i].point].plane;
                let rays: Vec<Ray> = places.iter().enumerate().map(|(i, q)| plane(i).ray(q.p)).collect();
                let alive = engine.trace(&rays, &mut self.work);
                check(&engine, alive, rays.len())?;
                let [sx, sy, x, y, w] = &mut self.columns;
                stop_sweeps(&engine, &mut self.work, sx, sy);
                // The landing's two coordinates, and the path.
                let mut bars = [Bar::default(); TILE];
                for (axis, out) in [(DVec3::X, &mut *x), (DVec3::Y, &mut *y)] {
                    bars.iter_mut().for_each(|b| b.point = axis);
                    engine.back(&mut self.work, image, &bars, out);
                }
                if wavefront {
                    let landed = &traced.landed[c][at * TILE..];
                    for ((bar, l), sample) in bars.iter_mut().zip(landed).zip(samples) {
                        let off = traced.image.point(centroids[sample.point]) - l.at;
                        let index = engine.system.surfaces[image].index_before;
                        *bar = Bar { point: -l.direction, direction: index * off, path: 1.0 };
                    }
                    engine.back(&mut self.work, image, &bars, w);
                }
                for (i, sample) in samples.iter().enumerate() {
                    let pull =
                        |columns: &Columns| plane(i).ray_vjp(&rays[i], columns.origin[i], columns.direction[i]).0;
                    let inverse = DMat2::from_cols(pull(sx), pull(sy)).transpose().inverse();
                    if !inverse.is_finite() {
                        return Err(Failure { cause: Cause::NotConverged, surface: engine.system.stop });
                    }
                    places[i].inverse = inverse;
                    let (px, py) = (pull(x), pull(y));
                    let pw = if wavefront {
                        let before = engine.system.surfaces[0].index_before;
                        let (o, _) = plane(i).path_vjp(&rays[i], before);
                        plane(i).ray_vjp(&rays[i], w.origin[i] + o, w.direction[i]).0
                    } else {
                        DVec2::ZERO
                    };
                    let ray = at * TILE + i;
                    let landed = &mut of_landed[3 * n * ray..3 * n * (ray + 1)];
                    let place = &mut of_places[2 * n * ray..2 * n * (ray + 1)];
                    for j in 0..n {
                        let lane = j * TILE + i;
                        let target = sample.target * first.stop.by[j];
                        let dp = inverse * (target - DVec2::new(sx.of[lane], sy.of[lane]));
                        (place[j], place[n + j]) = (dp.x, dp.y);
                        landed[j] = x.of[lane] + px.dot(dp);
                        landed[n + j] = y.of[lane] + py.dot(dp);
                        if wavefront {
                            landed[2 * n + j] = w.of[lane] + pw.dot(dp);
                        }
                    }
                }
            }
            slopes.landed.push(of_landed);
            slopes.places.push(of_places);
        }
        Ok(slopes)
    }

    /// The centroid of every object point's light.
    pub(super) fn centroids(&self, traced: &Traced) -> Vec<DVec2> {
        let mut sums = vec![(DVec2::ZERO, 0.0); self.points.len()];
        for (c, i, s) in self.samples().filter(|(_, _, s)| s.role == Role::Image) {
            sums[s.point].0 += s.weight * traced.landing(c, i);
            sums[s.point].1 += s.weight;
        }
        let symmetric = self.symmetric;
        let mean = |(point, (sum, weight)): (&Point, &(DVec2, f64))| match (point.axial, *weight > 0.0) {
            (false, true) if symmetric => DVec2::new(0.0, sum.y / weight),
            (false, true) => *sum / *weight,
            _ => DVec2::ZERO,
        };
        self.points.iter().zip(&sums).map(mean).collect()
    }

    /// Every sample with its colour, its place in the colour and whether it counts.
    pub(super) fn samples(&self) -> impl Iterator<Item = (usize, usize, &Sample)> {
        let each = |(c, colour): (usize, &'_ Colour)| (c, colour.samples.len());
        let places: Vec<(usize, usize)> = self.colours.iter().enumerate().map(each).collect();
        places.into_iter().flat_map(move |(c, len)| (0..len).map(move |i| (c, i, &self.colours[c].samples[i])))
    }

    /// The chief ray of every object point: colour and place.
    pub(super) fn chiefs(&self) -> Vec<Option<(usize, usize)>> {
        let mut chiefs = vec![None; self.points.len()];
        for (c, i, s) in self.samples().filter(|(_, _, s)| s.role == Role::Chief) {
            chiefs[s.point] = Some((c, i));
        }
        chiefs
    }

    pub(super) fn colours(&self) -> usize {
        self.colours.len()
    }
}

impl Traced {
    pub(super) fn landing(&self, colour: usize, sample: usize) -> DVec2 {
        self.landed[colour][sample].at.truncate()
    }

    /// Path to the foot of the perpendicular from `reference` on the image surface, up to the index of the image space.
    pub(super) fn path_to(&self, colour: usize, sample: usize, reference: DVec2) -> f64 {
        let l = &self.landed[colour][sample];
        l.path + l.direction.dot(self.image.point(reference) - l.at)
    }

    /// Its slope by the reference.
    pub(super) fn path_by(&self, colour: usize, sample: usize, reference: DVec2) -> DVec2 {
        let direction = self.landed[colour][sample].direction;
        direction.truncate() + direction.z * self.image.slope(reference)
    }
}

impl Slopes {
    /// `x`, `y` and path of a ray by the `n` variables.
    pub(super) fn of(&self, colour: usize, sample: usize, n: usize) -> [&[f64]; 3] {
        let all = &self.landed[colour][3 * n * sample..3 * n * (sample + 1)];
        [&all[..n], &all[n..2 * n], &all[2 * n..]]
    }
}

/// Which samples of a colour get through `lens`, and their places; with `clip`, through its apertures too.
fn aimed(
    lens: &Lens,
    points: &[Point],
    colour: &Colour,
    clip: bool,
) -> Result<(Vec<Sample>, Vec<LaunchPoint>), Failure> {
    let system = System::new(lens, colour.nm);
    let aimer = Aimer::new(&system)?;
    let (mut kept, mut places) = (Vec::new(), Vec::new());
    let mut near: Option<(usize, Aimed)> = None;
    let mut hits = Vec::new();
    for sample in &colour.samples {
        let point = &points[sample.point];
        let target = system.stop_semi_diameter * sample.target;
        let guess = near.as_ref().filter(|n| n.0 == sample.point).map(|n| &n.1);
        let found = aimer.aim(point.plane.object, target, guess);
        let landed = found.and_then(|a| trace(&system, a.ray, system.image(), &mut hits).map(|_| a));
        let aimed = match landed {
            Ok(aimed) => aimed,
            Err(_) if clip => continue,
            Err(failure) => return Err(failure),
        };
        if clip && sample.role != Role::Chief && first_vignetted(&system, &hits).is_some() {
            continue;
        }
        kept.push(*sample);
        places.push(LaunchPoint { p: point.plane.through(aimed.ray.origin), inverse: DMat2::ZERO });
        near = Some((sample.point, aimed));
    }
    Ok((kept, places))
}

/// Fails with the first ray that did not arrive.
fn check(engine: &Engine, alive: u64, rays: usize) -> Result<(), Failure> {
    let all = if rays >= 64 { u64::MAX } else { (1 << rays) - 1 };
    if alive & all == all { Ok(()) } else { Err(Failure { cause: Cause::Missed, surface: engine.system.image() }) }
}

/// Sweeps back from the stop.
fn stop_sweeps(engine: &Engine, work: &mut Workspace, sx: &mut Columns, sy: &mut Columns) {
    let mut bars = [Bar::default(); TILE];
    for (axis, out) in [(DVec3::X, sx), (DVec3::Y, sy)] {
        bars.iter_mut().for_each(|b| b.point = axis);
        engine.back(work, engine.system.stop, &bars, out);
    }
}

/// Brings a tile's rays to their targets; the traced rays stand in `work`.
fn aim<'p>(
    engine: &Engine,
    work: &mut Workspace,
    columns: &mut [Columns; 5],
    plane: impl Fn(usize) -> &'p crate::trace::object::LaunchPlane,
    places: &mut [LaunchPoint],
    targets: &[DVec2],
) -> Result<Vec<Ray>, Failure> {
    let stop = engine.system.stop;
    let lost = Failure { cause: Cause::NotConverged, surface: stop };
    let limit = AIMED * engine.system.stop_semi_diameter;
    let mut before = f64::INFINITY;
    let mut rays: Vec<Ray> = Vec::with_capacity(places.len());
    for _ in 0..STEPS {
        rays.clear();
        rays.extend(places.iter().enumerate().map(|(i, q)| plane(i).ray(q.p)));
        check(engine, engine.trace(&rays, work), rays.len())?;
        let misses: Vec<DVec2> =
            (0..rays.len()).map(|i| engine.behind(work, stop, i).origin.truncate() - targets[i]).collect();
        let worst = misses.iter().map(|m| m.length()).fold(0.0, f64::max);
        if worst <= limit {
            return Ok(rays);
        }
        if !worst.is_finite() {
            return Err(lost);
        }
        // A chord that serves no longer is drawn anew.
        if worst > 0.1 * before || places.iter().any(|q| q.inverse == DMat2::ZERO) {
            let [sx, sy, ..] = columns;
            stop_sweeps(engine, work, sx, sy);
            for (i, place) in places.iter_mut().enumerate() {
                let pull = |c: &Columns| plane(i).ray_vjp(&rays[i], c.origin[i], c.direction[i]).0;
                place.inverse = DMat2::from_cols(pull(sx), pull(sy)).transpose().inverse();
            }
        }
        for (place, miss) in places.iter_mut().zip(&misses) {
            place.p -= place.inverse * *miss;
        }
        before = worst;
    }
    Err(lost)
}
