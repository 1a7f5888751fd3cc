//! The rays of one sensor point and wavelength through the nodes of the stop, as polynomials, and back.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use glam::{DMat2, DVec2};

use super::super::fit::{Of, apply, apply_transposed};
use super::super::stop::{Part, StopNodes};
use super::{Layout, Row, STEEPEST, STEEPEST_RAY};
use crate::trace::aim::{Crossings, SceneRay, SceneRayBar, SensorView};
use crate::trace::sequential::Hit;
use crate::trace::{Cause, Failure, SystemGradient};

/// Heights of caps, steps to the stop's radius, and radii of the unit stop that are tried where rays fail.
const STEPS: u32 = 1000;
/// Ends of the beam at another wavelength are this near, mostly.
const ABOUT: u32 = 10;
const RADII: [f64; 5] = [0.93, 0.85, 0.75, 0.6, 0.4];
/// Parts of the stop's radius tried in turn for the unit stop: a stop may be larger than anything that comes through.
const PUPILS: [f64; 9] = [1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05, 0.02];
/// How far beyond the outermost lit node the part of the stop goes that is kept to light, of the unit stop: about what lies between nodes; nearer to the rim than [`CUT`] nothing
/// is cut.
const BESIDE: f64 = 0.15;
const CUT: f64 = 0.95;
/// Apertures that a ray passes nearer to its edge than this part of its radius may clip some other ray.
const NEAR: f64 = 0.85;

/// Nodes and matrices by the part of the unit stop that they cover; those of smaller parts when they are asked for.
#[derive(Clone, Debug)]
pub(in crate::psf) struct Bases {
    whole: Arc<StopNodes>,
    parts: Arc<Mutex<HashMap<[u64; 3], Arc<StopNodes>>>>,
    /// Whether beams keep to the part of the stop through which light gets, and a little more.
    lit: bool,
}

impl Bases {
    pub(in crate::psf) fn new(degree: usize, lit: bool) -> Self {
        Self { whole: Arc::new(StopNodes::new(degree, Part::WHOLE)), parts: Arc::default(), lit }
    }

    pub(in crate::psf) fn of(&self, part: Part) -> Arc<StopNodes> {
        if part.is_whole() {
            return Arc::clone(&self.whole);
        }
        let mut parts = self.parts.lock().unwrap_or_else(PoisonError::into_inner);
        let key = [part.radius, part.heights[0], part.heights[1]].map(f64::to_bits);
        Arc::clone(parts.entry(key).or_insert_with(|| Arc::new(StopNodes::new(self.whole.degree, part))))
    }
}

/// The rays of one sensor point and wavelength.
#[derive(Clone, Debug)]
pub(in crate::psf) struct Beam {
    radius_mm: f64,
    pub(in crate::psf) part: Part,
    /// Radius of the unit stop, mm, over the stop's.
    pupil: f64,
    pub(in crate::psf) nodes: Vec<Crossings>,
}

/// Cotangents on what the rays of a beam's nodes have, node by node.
pub(in crate::psf) struct NodeBars {
    /// Of the cosines at the sensor, across the meridian and along it.
    pub(in crate::psf) cosines: [Vec<f64>; 2],
    /// Of the crossings of the first vertex plane.
    pub(in crate::psf) entrance: [Vec<f64>; 2],
    /// Of the slopes there.
    pub(in crate::psf) slope: [Vec<f64>; 2],
    /// By surface of the reversed system: of `1 − r²/a²` at its clear aperture.
    pub(in crate::psf) clips: Vec<(usize, Vec<f64>)>,
    /// Of the optical paths; of none where there are none.
    pub(in crate::psf) paths: Vec<f64>,
}

/// Largest part of the stop's radius whose rim the axis sees at every wavelength.
pub(in crate::psf) fn pupil(views: &[SensorView], bases: &Bases) -> Result<f64, Failure> {
    let mut failure = None;
    for part in PUPILS {
        let tried = views.iter().try_for_each(|view| {
            Aimed::at(view, 0.0, part)?.through(&bases.whole.nodes, None).map(|_| ()).map_err(|f| f.1)
        });
        match tried {
            Ok(()) => return Ok(part),
            Err(f) => failure = failure.or(Some(f)),
        }
    }
    // A part of the smallest may do.
    let smallest = PUPILS[PUPILS.len() - 1];
    match views.iter().try_for_each(|v| Beam::trace(v, bases, 0.0, smallest, None).map(|_| ())) {
        Ok(()) => Ok(smallest),
        Err(f) => Err(failure.unwrap_or(f)),
    }
}

/// A sensor point whose ray through the centre of the stop is known; all others begin there.
struct Aimed<'a> {
    view: &'a SensorView,
    at: DVec2,
    /// Radius of the unit stop, mm.
    scale: f64,
    chief: DVec2,
    chief_hits: Vec<Hit>,
    /// Where the ray meets the stop, mm, and what a step there costs in cosines.
    met: DVec2,
    per_mm: DMat2,
}

impl<'a> Aimed<'a> {
    fn at(view: &'a SensorView, radius_mm: f64, pupil: f64) -> Result<Self, Failure> {
        let (at, scale) = (DVec2::new(0.0, radius_mm), pupil * view.system.stop_semi_diameter);
        let mut chief_hits = Vec::new();
        let chief = view.aim(at, DVec2::ZERO, None, &mut chief_hits)?;
        let (met, per_mm) = view.around(at, chief, &chief_hits);
        Ok(Self { view, at, scale, chief, chief_hits, met, per_mm })
    }

    /// Rays through `places` of the unit stop. `starts` are cosines that are tried first, those of like rays; the chief ray's where there are none.
    ///
    /// # Errors
    /// The first that does not get through, and why.
    fn through(&self, places: &[DVec2], starts: Option<Vec<DVec2>>) -> Result<Vec<Crossings>, (usize, Failure)> {
        let Self { view, at, chief, .. } = *self;
        let targets: Vec<DVec2> = places.iter().map(|s| *s * self.scale).collect();
        let starts = starts.unwrap_or_else(|| targets.iter().map(|t| chief + self.per_mm * (t - self.met)).collect());
        // What does not arrive with the others is aimed one by one, with all that aiming can do.
        let mut hits = Vec::with_capacity(view.system.surfaces.len());
        let together = view.bundle(at, &targets, &starts, (chief, &self.chief_hits));
        let partly = together.iter().any(Option::is_none);
        let all = together.into_iter().enumerate().map(|(k, found)| {
            // Where some get lost others may arrive by the wrong way: through a pupil seen upside down, or too flat.
            let wrong = |n: &Crossings, hits: &mut _| is_steep(&n.ray) || partly && self.is_turned(n, hits);
            if let Some(node) = found.filter(|n| !wrong(n, &mut hits)) {
                return Ok(node);
            }
            let aimed = view.aim(at, targets[k], Some(starts[k]), &mut hits);
            let ray = aimed.and_then(|c| self.follow(c, &mut hits)).map_err(|f| (k, f))?;
            let heights = hits.iter().map(|h| h.at.point.truncate()).collect();
            Ok(Crossings { ray, heights, path: self.view.path(&hits) })
        });
        all.collect()
    }

    /// Whether the stop is not seen around a ray as it is around the chief ray.
    fn is_turned(&self, node: &Crossings, hits: &mut Vec<Hit>) -> bool {
        let around = self.view.follow(self.at, node.ray.cosines, hits);
        around.is_err()
            || self.view.around(self.at, node.ray.cosines, hits).1.determinant() * self.per_mm.determinant() <= 0.0
    }

    fn follow(&self, cosines: DVec2, hits: &mut Vec<Hit>) -> Result<SceneRay, Failure> {
        let ray = self.view.follow(self.at, cosines, hits)?;
        let across = Failure { cause: Cause::Missed, surface: self.view.system.image() };
        if is_steep(&ray) { Err(across) } else { Ok(ray) }
    }

    /// A first guess of the ray through `place` of the unit stop, from the cosines of another place.
    fn beside(&self, place: DVec2, (from, cosines): (DVec2, DVec2)) -> DVec2 {
        cosines + self.per_mm * (self.scale * (place - from))
    }

    /// Whether the ray through `place` of the unit stop gets through, as one attempt from the cosines of another place finds.
    fn follows(&self, place: DVec2, known: (DVec2, DVec2), hits: &mut Vec<Hit>) -> bool {
        let start = self.beside(place, known);
        let found = self.view.aim_from(self.at, self.scale * place, start, hits);
        found.and_then(|c| self.follow(c, hits)).is_ok()
    }

    /// Most steps, of [`STEPS`], for which all rays through `places` get through; none of them leaves the centre at no step. `about` so
    /// many are tried first.
    fn reach(&self, about: Option<u32>, places: impl Fn(f64) -> Vec<DVec2>) -> u32 {
        let at = |step: u32| places(f64::from(step) / f64::from(STEPS));
        let (mut last, mut sure) = match self.through(&at(STEPS), None) {
            Ok(_) => return STEPS,
            Err((k, _)) => (k, STEPS),
        };
        let (mut passes, mut fails, mut cheaply) = (0, STEPS, true);
        // Places of the last step that passes, and their rays: those of the next step begin there.
        let mut known: Vec<(DVec2, DVec2)> = Vec::new();
        let starts = |places: &[DVec2], known: &[(DVec2, DVec2)]| {
            (known.len() == places.len()).then(|| places.iter().zip(known).map(|(p, k)| self.beside(*p, *k)).collect())
        };
        let mut guesses = about.into_iter().flat_map(|a| [a + ABOUT, a.saturating_sub(ABOUT)]);
        let mut hits = Vec::new();
        loop {
            while fails - passes > 1 {
                let guess = guesses.next().filter(|g| (passes + 1..fails).contains(g));
                let middle = guess.unwrap_or_else(|| u32::midpoint(passes, fails));
                let places = at(middle);
                // The node that failed last is asked first: one attempt costs far less than all that aiming can do.
                let from = known.get(last).copied().unwrap_or((DVec2::ZERO, self.chief));
                if cheaply && !self.follows(places[last], from, &mut hits) {
                    fails = middle;
                    continue;
                }
                match self.through(&places, starts(&places, &known)) {
                    Ok(nodes) => {
                        passes = middle;
                        known = places.into_iter().zip(nodes.iter().map(|n| n.ray.cosines)).collect();
                    }
                    Err((k, _)) => (fails, sure, last) = (middle, middle, k),
                }
            }
            let beyond = at(fails);
            if fails == sure || self.through(&beyond, starts(&beyond, &known)).is_err() {
                return passes;
            }
            // One attempt was not enough.
            (passes, fails, cheaply) = (fails, sure, false);
        }
    }
}

/// Whether no clear aperture stops a node's ray.
fn is_open(view: &SensorView, node: &Crossings) -> bool {
    view.system.surfaces.iter().zip(&node.heights).all(|(s, h)| h.length_squared() <= s.semi_diameter.powi(2))
}

/// Whether a ray runs too flat over the first vertex plane.
fn is_steep(ray: &SceneRay) -> bool {
    ray.slope.length_squared() > STEEPEST_RAY * STEEPEST_RAY
}

impl Beam {
    /// Traces the nodes of the largest part of the stop that gets through. `near` is the beam of a neighbouring wavelength.
    pub(in crate::psf) fn trace(
        view: &SensorView,
        bases: &Bases,
        radius_mm: f64,
        pupil: f64,
        near: Option<&Self>,
    ) -> Result<Self, Failure> {
        let aimed = Aimed::at(view, radius_mm, pupil)?;
        let through = |part: Part| {
            let near = near.filter(|b| b.part == part).map(|b| b.nodes.iter().map(|n| n.ray.cosines).collect());
            let nodes = aimed.through(&bases.of(part).nodes, near).map_err(|f| f.1)?;
            Ok(Self { radius_mm, part, pupil, nodes })
        };
        let kept = |beam: Self| {
            let part = if bases.lit { beam.lit(view, bases) } else { beam.part };
            if part == beam.part { beam } else { through(part).unwrap_or(beam) }
        };
        let failure = match through(Part::WHOLE) {
            Ok(beam) => return Ok(kept(beam)),
            Err(f) => f,
        };
        // As high, and as low, as what lies beyond the centre gets through: what fails is one end of the beam, mostly. Other wavelengths get
        // about as far.
        let about = |end: usize| near.map(|b| (b.part.heights[end].abs() * f64::from(STEPS)).round() as u32);
        let degree = bases.whole.degree;
        let high = aimed.reach(about(1), |h| Part::between([0.0, h]).nodes(degree));
        let low = aimed.reach(about(0), |h| Part::between([-h, 0.0]).nodes(degree));
        // A step less: rays that hardly get through run steeply over the stop.
        let height = |step: u32| f64::from(step) / f64::from(STEPS);
        let fewer = (1..high.min(low)).step_by(20).map(|k| Part::between([-height(low - k), height(high - k)]));
        let caps = fewer.into_iter().find_map(|part| through(part).ok());
        let enough = caps.as_ref().map_or(0.0, |c| c.part.share());
        let disk = RADII.iter().filter(|r| r.powi(2) > enough).find_map(|r| through(Part::disk(*r)).ok());
        disk.or(caps).map(kept).ok_or(failure)
    }

    /// The part of the stop between caps that has all nodes through which light gets, and [`BESIDE`] as much more as neighbours and wavelengths may see.
    fn lit(&self, view: &SensorView, bases: &Bases) -> Part {
        let places = &bases.of(self.part).nodes;
        let open = self.nodes.iter().zip(places).filter(|(node, _)| is_open(view, node)).map(|(_, at)| at.y);
        let [low, high] = open.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], y| [low.min(y), high.max(y)]);
        let (low, high) = ((low - BESIDE).min(-BESIDE), (high + BESIDE).max(BESIDE));
        let end = |at: f64| if at.abs() < CUT { at } else { at.signum() };
        self.part.common(Part::between([end(low), end(high)]))
    }

    /// Values at the nodes.
    fn values(&self, f: impl Fn(&Crossings) -> f64) -> Vec<f64> {
        self.nodes.iter().map(f).collect()
    }

    /// The polynomials; `clips` are surfaces of the lens.
    pub(super) fn row(&self, view: &SensorView, bases: &Bases, layout: &Layout, clips: &[usize]) -> Row {
        let basis = &*bases.of(self.part);
        let [even, odd] = basis.coefficients();
        let mut out = Vec::with_capacity(layout.len());
        out.extend(apply(odd, &self.values(|n| n.ray.entrance.x)));
        out.extend(apply(even, &self.values(|n| n.ray.entrance.y)));
        out.extend(apply(odd, &self.values(|n| n.ray.slope.x)));
        out.extend(apply(even, &self.values(|n| n.ray.slope.y)));
        out.extend(apply(even, &self.etendue(view, basis)));
        for surface in clips {
            let k = view.system.image() - surface;
            let square = view.system.surfaces[k].semi_diameter.powi(2);
            out.extend(apply(even, &self.values(|n| 1.0 - n.heights[k].length_squared() / square)));
        }
        Row { coefficients: out, part: self.part, known: self.part }
    }

    /// Étendue over the unit stop, at the nodes.
    pub(in crate::psf) fn etendue(&self, view: &SensorView, basis: &StopNodes) -> Vec<f64> {
        let [[a, b], [c, d]] = self.cosine_slopes(basis);
        let n2 = view.image_index().powi(2);
        (0..a.len()).map(|j| n2 * (a[j] * d[j] - b[j] * c[j])).collect()
    }

    /// `∂L/∂x, ∂L/∂y` and `∂M/∂x, ∂M/∂y` over the unit stop, at the nodes.
    fn cosine_slopes(&self, basis: &StopNodes) -> [[Vec<f64>; 2]; 2] {
        let [even, odd] = basis.coefficients();
        let l = apply(odd, &self.values(|n| n.ray.cosines.x));
        let m = apply(even, &self.values(|n| n.ray.cosines.y));
        let [at_even, at_odd] = basis.at_nodes();
        [[at_odd.at(Of::X, &l), at_odd.at(Of::Y, &l)], [at_even.at(Of::X, &m), at_even.at(Of::Y, &m)]]
    }

    /// Pulls a cotangent on [`Self::row`]'s coefficients back to the reversed system.
    pub(super) fn row_vjp(
        &self,
        view: &SensorView,
        bases: &Bases,
        layout: &Layout,
        clips: &[usize],
        bar: &[f64],
        out: &mut SystemGradient,
    ) {
        if bar.iter().all(|b| *b == 0.0) {
            return;
        }
        let basis = &*bases.of(self.part);
        let [even, odd] = basis.coefficients();
        let [ex, ey] = layout.entrance();
        let [gx, gy] = layout.slope();
        let entrance = [apply_transposed(odd, &bar[ex]), apply_transposed(even, &bar[ey])];
        let slope = [apply_transposed(odd, &bar[gx]), apply_transposed(even, &bar[gy])];
        let etendue = apply_transposed(even, &bar[layout.weight()]);
        let cosines = self.etendue_vjp(view, basis, &etendue, out);
        let clips = clips
            .iter()
            .enumerate()
            .map(|(c, surface)| (view.system.image() - surface, apply_transposed(even, &bar[layout.clip(c)])))
            .collect();
        self.nodes_vjp(view, basis, &NodeBars { cosines, entrance, slope, clips, paths: Vec::new() }, out);
    }

    /// Pulls cotangents on what the nodes' rays have back to the reversed system.
    pub(in crate::psf) fn nodes_vjp(
        &self,
        view: &SensorView,
        basis: &StopNodes,
        bars: &NodeBars,
        out: &mut SystemGradient,
    ) {
        let at = DVec2::new(0.0, self.radius_mm);
        let mut hits = Vec::with_capacity(view.system.surfaces.len());
        for (j, node) in self.nodes.iter().enumerate() {
            if view.follow(at, node.ray.cosines, &mut hits).is_err() {
                continue;
            }
            let mut ray = SceneRayBar {
                cosines: DVec2::new(bars.cosines[0][j], bars.cosines[1][j]),
                entrance: DVec2::new(bars.entrance[0][j], bars.entrance[1][j]),
                slope: DVec2::new(bars.slope[0][j], bars.slope[1][j]),
                heights: Vec::with_capacity(bars.clips.len()),
                path: bars.paths.get(j).copied().unwrap_or(0.0),
            };
            for (k, bars) in &bars.clips {
                let (height, radius) = (node.heights[*k], view.system.surfaces[*k].semi_diameter);
                ray.heights.push((*k, -2.0 * bars[j] / radius.powi(2) * height));
                out.semi_diameters[*k] += 2.0 * bars[j] * height.length_squared() / radius.powi(3);
            }
            let target = view.vjp(at, node.ray.cosines, &hits, &ray, out);
            out.stop_semi_diameter += target.dot(basis.nodes[j]) * self.pupil;
        }
    }

    /// Pulls a cotangent on the étendue at the nodes back to the cosines there, and to the index before the sensor.
    fn etendue_vjp(
        &self,
        view: &SensorView,
        basis: &StopNodes,
        bar: &[f64],
        out: &mut SystemGradient,
    ) -> [Vec<f64>; 2] {
        let [[a, b], [c, d]] = self.cosine_slopes(basis);
        let index = view.image_index();
        let scaled: Vec<f64> = bar.iter().map(|v| v * index * index).collect();
        let times = |f: &[f64], sign: f64| scaled.iter().zip(f).map(|(s, v)| sign * s * v).collect::<Vec<f64>>();
        let [at_even, at_odd] = basis.at_nodes();
        let [even, odd] = basis.coefficients();
        let (mut l, mut m) = (vec![0.0; odd.nrows()], vec![0.0; even.nrows()]);
        at_odd.pull(Of::X, &times(&d, 1.0), &mut l);
        at_odd.pull(Of::Y, &times(&c, -1.0), &mut l);
        at_even.pull(Of::X, &times(&b, -1.0), &mut m);
        at_even.pull(Of::Y, &times(&a, 1.0), &mut m);
        let by_index: f64 = (0..a.len()).map(|j| 2.0 * index * bar[j] * (a[j] * d[j] - b[j] * c[j])).sum();
        out.indices[1] += by_index;
        [apply_transposed(odd, &l), apply_transposed(even, &m)]
    }
}

/// Surfaces of the lens, other than the stop, whose clear apertures some ray comes near.
pub(in crate::psf) fn near_apertures(views: &[&SensorView], beams: &[Vec<Arc<Beam>>]) -> Vec<usize> {
    let Some(view) = views.first() else { return Vec::new() };
    let image = view.system.image();
    (0..image)
        .filter(|surface| {
            let k = image - surface;
            let radius = view.system.surfaces[k].semi_diameter;
            let nearer = |n: &Crossings| n.heights[k].length() > NEAR * radius;
            k != view.system.stop
                && radius.is_finite()
                && beams.iter().flat_map(|b| b.iter()).any(|b| b.nodes.iter().any(nearer))
        })
        .collect()
}

/// Largest distance of the slopes at the nodes from their polynomial, relative to their range.
pub(super) fn residual(beam: &Beam, row: &Row, bases: &Bases, layout: &Layout) -> f64 {
    let fitted = bases.of(beam.part).at_nodes()[0].at(Of::Value, &row.coefficients[layout.slope()[1].clone()]);
    let values = beam.values(|n| n.ray.slope.y);
    let (low, high) = values.iter().fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(*v), b.max(*v)));
    let worst = fitted.iter().zip(&values).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    if high > low { worst / (high - low) } else { 0.0 }
}

/// Root mean square distance of the object slopes (at `vergence`) of a beam's rays from their polynomials, over the nodes through which light gets, by its étendue; 0 where
/// none does.
pub(super) fn untold(beam: &Beam, view: &SensorView, bases: &Bases, vergence: f64) -> f64 {
    let basis = &*bases.of(beam.part);
    let [even, odd] = basis.coefficients();
    let [at_even, at_odd] = basis.at_nodes();
    let across = beam.values(|n| n.ray.slope.x - vergence * n.ray.entrance.x);
    let along = beam.values(|n| n.ray.slope.y - vergence * n.ray.entrance.y);
    let [x, y] = [at_odd.at(Of::Value, &apply(odd, &across)), at_even.at(Of::Value, &apply(even, &along))];
    let weights = beam.etendue(view, basis);
    let (mut square, mut sum) = (0.0, 0.0);
    for (j, node) in beam.nodes.iter().enumerate() {
        if is_open(view, node) && weights[j] > 0.0 {
            square += weights[j] * ((x[j] - across[j]).powi(2) + (y[j] - along[j]).powi(2));
            sum += weights[j];
        }
    }
    if sum > 0.0 { (square / sum).sqrt() } else { 0.0 }
}

/// The chief ray of one sensor point at the reference wavelength.
#[derive(Clone, Debug)]
pub(super) struct Chief {
    radius_mm: f64,
    cosines: DVec2,
    /// Where it crosses the first vertex plane, along the meridian, mm.
    pub(super) entrance: f64,
    /// Its slope there.
    pub(super) slope: f64,
}

impl Chief {
    pub(super) fn trace(view: &SensorView, radius_mm: f64) -> Result<Self, Failure> {
        let at = DVec2::new(0.0, radius_mm);
        let mut hits = Vec::new();
        let cosines = view.aim(at, DVec2::ZERO, None, &mut hits)?;
        let ray = view.follow(at, cosines, &mut hits)?;
        if ray.slope.length() > STEEPEST {
            return Err(Failure { cause: Cause::Missed, surface: view.system.image() });
        }
        Ok(Self { radius_mm, cosines, entrance: ray.entrance.y + 0.0, slope: ray.slope.y + 0.0 })
    }

    pub(super) fn vjp(&self, view: &SensorView, [entrance, slope]: [f64; 2], out: &mut SystemGradient) {
        let at = DVec2::new(0.0, self.radius_mm);
        let mut hits = Vec::new();
        if (entrance, slope) != (0.0, 0.0) && view.follow(at, self.cosines, &mut hits).is_ok() {
            let bar = SceneRayBar {
                entrance: DVec2::new(0.0, entrance),
                slope: DVec2::new(0.0, slope),
                ..SceneRayBar::default()
            };
            view.vjp(at, self.cosines, &hits, &bar, out);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::trace::System;

    /// Where rays fail: the ends found are those that all rays, one by one, with all that aiming can do, get through to; rays
    /// aimed together are those aimed alone.
    #[test]
    fn ends_of_beams_are_where_rays_fail() {
        let (mut ends, mut partly) = (0, 0);
        for (name, height_mm) in [("sonnar", 21.6), ("biotar", 21.6)] {
            let lens = builtin::lens(name).expect("shipped");
            let view = SensorView::new(&System::new(&lens, 486.0));
            for share in [0.7, 0.8, 0.9, 1.0] {
                let aimed = Aimed::at(&view, share * height_mm, 1.0).expect("sees the stop");
                let alone = |place: DVec2| {
                    let mut hits = Vec::new();
                    let start = aimed.chief + aimed.per_mm * (place * aimed.scale - aimed.met);
                    let cosines = view.aim(aimed.at, place * aimed.scale, Some(start), &mut hits).ok()?;
                    aimed.follow(cosines, &mut hits).ok()
                };
                for up in [false, true] {
                    let places = |h: f64| Part::between(if up { [0.0, h] } else { [-h, 0.0] }).nodes(9);
                    let found = aimed.reach(None, places);
                    let at = |step: u32| places(f64::from(step) / f64::from(STEPS));
                    let passes = |step: u32| at(step).into_iter().all(|p| alone(p).is_some());
                    assert!(found > 0 && passes(found), "{name} {share} {up}: {found}");
                    for about in [Some(found), Some(found.saturating_sub(3 * ABOUT))] {
                        assert_eq!(aimed.reach(about, places), found, "{name} {share} {up}");
                    }
                    if found < STEPS {
                        assert!(!passes(found + 1), "{name} {share} {up}: more than {found}");
                        ends += 1;
                    }
                    let rays = aimed.through(&at(found), None).expect("they get through");
                    for (ray, place) in rays.iter().zip(at(found)) {
                        let one = alone(place).expect("gets through");
                        let off = (ray.ray.cosines - one.cosines).length();
                        assert!(off < 1e-11, "{name} {share} {up} {place}: {off:.1e}");
                    }
                    let targets: Vec<DVec2> = at(found).iter().map(|p| *p * aimed.scale).collect();
                    let starts: Vec<DVec2> =
                        targets.iter().map(|t| aimed.chief + aimed.per_mm * (*t - aimed.met)).collect();
                    let lost = view.bundle(aimed.at, &targets, &starts, (aimed.chief, &aimed.chief_hits));
                    partly += usize::from(lost.iter().any(Option::is_some) && lost.iter().any(Option::is_none));
                }
            }
        }
        assert!(ends >= 2 && partly >= 1, "{ends} {partly}");
        eprintln!("{ends} ends, {partly} bundles in part");
    }
}
