//! Rays from a point of the sensor, aimed at the real stop and followed out into the scene.
//!
//! Light runs backwards here: the system is [`System::reversed`], its first surface the sensor's. The unknowns are the
//! direction cosines `(L, M)` of the ray at the sensor (of a curved one, those along it), found by Newton on the point where it meets the stop. Seen from
//! the sensor the pupil hardly moves or shrinks even in lenses of a wide field, so the paraxial exit pupil is a good first
//! guess; where it fails the ray is walked out from the axis.
//!
//! Outside the lens the ray is a line: it crosses the first vertex plane at `e` and runs there with the slopes `g` (of the
//! light, which moves towards the sensor). An object point of slope `s` and vergence `v` lies on it where `s = g − v e`
//! ([`crate::trace::ObjectPoint::from_slope`]), so one traced ray serves every object distance.
//!
//! [`SensorView::bundle`] aims many rays of one point at once, by tiles of vector lanes; Broyden's updates stand in for ray
//! differentials there. Those that do not arrive the caller aims one by one.

use glam::{DMat2, DVec2, DVec3};

use super::super::differential::RayDot;
use super::super::lanes::{Options, Program, TILE, Tile};
use super::super::sequential::{Hit, HitBar, trace, trace_vjp};
use super::super::system::axial_cosine;
use super::super::{Cause, Failure, Ray, System, SystemGradient};
use super::newton::{Launching, Solved, solve, stop_jacobian};

/// Aimed to this distance in the stop, relative to its semi-diameter.
const TOLERANCE: f64 = 1e-12;
/// Traces of a bundle at most, until it meets the stop where it should.
const TRACES: u32 = 12;
/// Steps of the walk out from the axis, of the way: the longest and the shortest.
const STEPS: [f64; 2] = [0.25, 1.0 / 64.0];

/// All rays of one point of the sensor; the coordinates are direction cosines `(L, M)`, of a sensor that is curved `(L, M) + N ∇z`: what the path changes by where the
/// point moves along the surface, per mm of its `x` and `y`.
#[derive(Clone, Copy, Debug)]
struct SensorPoint {
    origin: DVec3,
    /// `∇z` of the sensor.
    slope: DVec2,
}

impl Launching for SensorPoint {
    #[inline]
    fn ray(&self, p: DVec2) -> Ray {
        // Cosines beyond one have no ray: the root is NaN, which no surface is met by.
        let n = axial_cosine(p, self.slope, 1.0);
        Ray { origin: self.origin, direction: (p - n * self.slope).extend(n) }
    }

    #[inline]
    fn columns(&self, ray: &Ray) -> [RayDot; 2] {
        let d = ray.direction;
        let s = self.slope;
        // dN = −(L, M)/(N − (L, M)·∇z) dp.
        let along = d.z - d.truncate().dot(s);
        [(DVec2::X, d.x), (DVec2::Y, d.y)].map(|(axis, cosine)| {
            let n = -cosine / along;
            RayDot { point: DVec3::ZERO, direction: (axis - n * s).extend(n) }
        })
    }
}

/// A lens at one wavelength as its sensor sees it.
#[derive(Clone, Debug)]
pub struct SensorView {
    /// The system met from the sensor.
    pub system: System,
    /// Height in the stop of the paraxial ray from height 1 on the sensor parallel to the axis, and of the ray from the
    /// axis with slope 1.
    paraxial: [f64; 2],
    /// Every surface behind the sensor by itself, for tiles of rays.
    surfaces: Vec<Program>,
}

/// A traced ray and where it crosses the surfaces of the reversed system, the sensor first.
#[derive(Clone, Debug)]
pub struct Crossings {
    /// The ray.
    pub ray: SceneRay,
    /// Its heights, mm.
    pub heights: Vec<DVec2>,
    /// Optical path from the sensor point to the crossing of the first vertex plane, mm.
    pub path: f64,
}

/// A ray from the sensor behind the lens, and where it came from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneRay {
    /// Direction cosines at the sensor, of the ray that leaves it.
    pub cosines: DVec2,
    /// Where it crosses the first vertex plane, mm.
    pub entrance: DVec2,
    /// Slopes of the light there.
    pub slope: DVec2,
}

/// Cotangents on a [`SceneRay`] and on its heights at surfaces.
#[derive(Clone, Debug, Default)]
pub struct SceneRayBar {
    /// Of the cosines.
    pub cosines: DVec2,
    /// Of the crossing of the first vertex plane.
    pub entrance: DVec2,
    /// Of the slopes.
    pub slope: DVec2,
    /// Of points at surfaces (of the reversed system).
    pub heights: Vec<(usize, DVec2)>,
    /// Of the optical path from the sensor point to the crossing of the first vertex plane.
    pub path: f64,
}

impl SensorView {
    /// The view of `system` (met from the scene).
    pub fn new(system: &System) -> Self {
        let reversed = system.reversed();
        let height = |y: f64, slope: f64| {
            let (mut y, mut w) = (y, slope * reversed.surfaces[0].index_after);
            for (i, s) in reversed.surfaces[..=reversed.stop].iter().enumerate().skip(1) {
                y += s.distance / s.index_before * w;
                if i < reversed.stop {
                    w -= s.shape.deflection(y, s.index_before, s.index_after);
                }
            }
            y
        };
        let options = Options { path: true, ..Options::default() };
        let surfaces = (1..reversed.surfaces.len()).map(|k| Program::of(&reversed.surfaces[k..=k], options)).collect();
        Self { paraxial: [height(1.0, 0.0), height(0.0, 1.0)], surfaces, system: reversed }
    }

    /// Index of the medium before the sensor.
    pub fn image_index(&self) -> f64 {
        self.system.surfaces[0].index_after
    }

    fn point(&self, at: DVec2) -> SensorPoint {
        // Beyond the reach of the sensor's surface they are no numbers, and no ray begins.
        let sensor = &self.system.surfaces[0];
        SensorPoint { origin: sensor.point(at), slope: sensor.slope(at) }
    }

    fn guess(&self, at: DVec2, target: DVec2) -> DVec2 {
        let slope = (target - self.paraxial[0] * at) / self.paraxial[1];
        (slope + self.point(at).slope) / (1.0 + slope.length_squared()).sqrt()
    }

    /// Direction cosines of the ray from `at` (mm on the sensor) that meets the stop at `target` (mm).
    ///
    /// `start` is a first guess, a neighbouring ray's.
    ///
    /// # Errors
    /// Why the last ray that was tried failed.
    pub fn aim(&self, at: DVec2, target: DVec2, start: Option<DVec2>, hits: &mut Vec<Hit>) -> Result<DVec2, Failure> {
        let mut failure = Failure { cause: Cause::NotConverged, surface: self.system.stop };
        for guess in start.into_iter().chain([self.guess(at, target)]) {
            match self.aim_from(at, target, guess, hits) {
                Ok(p) => return Ok(p),
                Err(f) => failure = f,
            }
        }
        // Out from the axis, every ray the next one's guess, in steps as long as they arrive.
        let (mut done, mut step) = (0.0, STEPS[0]);
        let mut p = self.aim_from(DVec2::ZERO, DVec2::ZERO, DVec2::ZERO, hits)?;
        while step >= STEPS[1] {
            let share = f64::min(done + step, 1.0);
            match self.aim_from(at * share, target * share, p, hits) {
                Ok(found) if share == 1.0 => return Ok(found),
                Ok(found) => (p, done) = (found, share),
                Err(f) => (failure, step) = (f, 0.5 * step),
            }
        }
        Err(failure)
    }

    /// As [`Self::aim`], from `start` and nowhere else.
    ///
    /// # Errors
    /// Where no step from there comes nearer.
    pub(crate) fn aim_from(
        &self,
        at: DVec2,
        target: DVec2,
        start: DVec2,
        hits: &mut Vec<Hit>,
    ) -> Result<DVec2, Failure> {
        let Solved { p, .. } = solve(&self.system, &self.point(at), target, start, hits)?;
        Ok(p)
    }

    /// Rays from `at` through all of `targets` (mm in the stop), aimed together from `starts`; `hits` are those of the ray of
    /// cosines `chief`, whose Jacobian all begin with. Nothing in the place of those that do not arrive.
    pub(crate) fn bundle(
        &self,
        at: DVec2,
        targets: &[DVec2],
        starts: &[DVec2],
        (chief, hits): (DVec2, &[Hit]),
    ) -> Vec<Option<Crossings>> {
        let point = self.point(at);
        let ray = point.ray(chief);
        let inverse = stop_jacobian(&self.system, &point, &ray, hits).inverse();
        let limit = TOLERANCE * self.system.stop_semi_diameter;
        let index = self.system.surfaces[self.system.image()].index_after;
        let mut out = Vec::with_capacity(targets.len());
        for (targets, starts) in targets.chunks(TILE).zip(starts.chunks(TILE)) {
            let mut tile = Aiming { view: self, tile: Tile::new(), lost: vec![false; targets.len()] };
            tile.tile.resize(targets.len());
            let mut aimed: Vec<Broyden> = starts.iter().map(|p| Broyden::new(*p, inverse)).collect();
            for _ in 0..TRACES {
                tile.launch(&point, &aimed, ray);
                tile.pass(1..=self.system.stop, |_, _| ());
                let mut worst = 0.0f64;
                for (lane, (b, target)) in aimed.iter_mut().zip(targets).enumerate().filter(|(k, _)| !tile.lost[*k]) {
                    let miss = tile.met(lane) - *target;
                    worst = worst.max(miss.length());
                    // The last step goes to rounding: what was missed by would be noise on every difference of lenses.
                    b.step(miss);
                }
                if worst <= limit {
                    break;
                }
            }
            tile.launch(&point, &aimed, ray);
            let (mut heights, mut paths) = (vec![vec![at]; targets.len()], [0.0; TILE]);
            tile.pass(1..=self.system.image(), |_, tile| {
                let all = heights.iter_mut().enumerate();
                all.for_each(|(lane, h)| h.push(DVec2::new(tile.rays.x[lane], tile.rays.y[lane])));
                paths.iter_mut().zip(&tile.rays.path).for_each(|(sum, path)| *sum += path);
            });
            out.extend(heights.into_iter().zip(&aimed).enumerate().map(|(lane, (heights, b))| {
                let (ray, met) = (tile.tile.rays.ray(lane), heights[self.system.stop]);
                let arrived = !tile.lost[lane] && (met - targets[lane]).length() <= limit && ray.direction.z > 0.0;
                let path = paths[lane] - index * ray.origin.z / ray.direction.z;
                arrived.then(|| Crossings { ray: SceneRay::of(b.p, ray.origin, ray.direction), heights, path })
            }));
        }
        out
    }

    /// Where the ray of `cosines` from `at` meets the stop, mm, and how cosines change with that point; zero where that is not known.
    /// `hits` are that ray's.
    pub(crate) fn around(&self, at: DVec2, cosines: DVec2, hits: &[Hit]) -> (DVec2, DMat2) {
        let point = self.point(at);
        let inverse = stop_jacobian(&self.system, &point, &point.ray(cosines), hits).inverse();
        (hits[self.system.stop].at.point.truncate(), if inverse.is_finite() { inverse } else { DMat2::ZERO })
    }

    /// Follows the ray of `cosines` from `at` into the scene; `hits` are those of all surfaces, the sensor first.
    ///
    /// # Errors
    /// Where it does not get through.
    pub fn follow(&self, at: DVec2, cosines: DVec2, hits: &mut Vec<Hit>) -> Result<SceneRay, Failure> {
        let last = trace(&self.system, self.point(at).ray(cosines), self.system.image(), hits)?;
        let (p, d) = (last.at.point, last.direction);
        if d.z.is_nan() || d.z <= 0.0 {
            return Err(Failure { cause: Cause::Missed, surface: self.system.image() });
        }
        Ok(SceneRay::of(cosines, p, d))
    }

    /// Optical path from the sensor point to the crossing of the first vertex plane, mm, of the ray with these hits.
    pub(crate) fn path(&self, hits: &[Hit]) -> f64 {
        let image = self.system.image();
        let last = &hits[image];
        last.optical_path - self.system.surfaces[image].index_after * last.at.point.z / last.direction.z
    }

    /// Pulls cotangents on a ray that [`Self::aim`] found and [`Self::follow`] followed back to the reversed system (added
    /// to `out`); returns that of the target in the stop. The point on the sensor is held.
    pub fn vjp(&self, at: DVec2, cosines: DVec2, hits: &[Hit], bar: &SceneRayBar, out: &mut SystemGradient) -> DVec2 {
        let image = self.system.image();
        let mut bars = vec![HitBar::default(); image + 1];
        for (surface, height) in &bar.heights {
            bars[*surface].point += height.extend(0.0);
        }
        // e = p − p_z r, g = −r with r = d/d_z.
        let (p, d) = (hits[image].at.point, hits[image].direction);
        let run = d.truncate() / d.z;
        let run_bar = -p.z * bar.entrance - bar.slope;
        bars[image].point += bar.entrance.extend(-bar.entrance.dot(run));
        bars[image].direction += (run_bar / d.z).extend(-run_bar.dot(run) / d.z);
        if bar.path != 0.0 {
            let index = self.system.surfaces[image].index_after;
            bars[image].optical_path += bar.path;
            bars[image].point.z -= bar.path * index / d.z;
            bars[image].direction.z += bar.path * index * p.z / (d.z * d.z);
            out.indices[image + 1] -= bar.path * p.z / d.z;
        }
        let point = self.point(at);
        let ray = point.ray(cosines);
        let (_, direction_bar) = trace_vjp(&self.system, hits, &bars, out);
        let onto = |bar: DVec3| {
            let [a, b] = point.columns(&ray);
            DVec2::new(a.direction.dot(bar), b.direction.dot(bar))
        };
        // The aiming: δp = −S_p⁻¹ S_θ δθ.
        let p_bar = bar.cosines + onto(direction_bar);
        let lambda = stop_jacobian(&self.system, &point, &ray, hits).transpose().inverse() * p_bar;
        let stop = self.system.stop;
        let mut bars = vec![HitBar::default(); stop + 1];
        bars[stop].point = DVec3::new(-lambda.x, -lambda.y, 0.0);
        trace_vjp(&self.system, &hits[..=stop], &bars, out);
        lambda
    }
}

impl SceneRay {
    /// The ray that left the sensor with `cosines` and the lens at `point` (first vertex frame, met from behind) along
    /// `direction`.
    fn of(cosines: DVec2, point: DVec3, direction: DVec3) -> Self {
        let run = direction.truncate() / direction.z;
        Self { cosines, entrance: point.truncate() - point.z * run, slope: -run }
    }
}

/// Rays that are aimed together.
struct Aiming<'a> {
    view: &'a SensorView,
    tile: Tile,
    /// Those that failed on the way.
    lost: Vec<bool>,
}

impl Aiming<'_> {
    /// Puts every ray at the sensor, `instead` in the place of those lost.
    fn launch(&mut self, point: &SensorPoint, aimed: &[Broyden], instead: Ray) {
        for (lane, (b, lost)) in aimed.iter().zip(&self.lost).enumerate() {
            self.tile.rays.set(lane, if *lost { instead } else { point.ray(b.p) });
        }
    }

    /// Where a ray is.
    fn met(&self, lane: usize) -> DVec2 {
        DVec2::new(self.tile.rays.x[lane], self.tile.rays.y[lane])
    }

    /// Traces them through surfaces, one after the other.
    fn pass(&mut self, surfaces: std::ops::RangeInclusive<usize>, mut seen: impl FnMut(usize, &Tile)) {
        for k in surfaces {
            self.view.surfaces[k - 1].trace_tile(&mut self.tile);
            for (lost, status) in self.lost.iter_mut().zip(&self.tile.status) {
                *lost |= status.is_some();
            }
            seen(k, &self.tile);
        }
        for lane in 0..self.lost.len() {
            self.lost[lane] |= !self.met(lane).is_finite();
        }
    }
}

/// A ray being aimed: its cosines, the inverse of its Jacobian so far, its last step and what it still missed by before.
struct Broyden {
    p: DVec2,
    inverse: DMat2,
    last: Option<(DVec2, DVec2)>,
}

impl Broyden {
    fn new(p: DVec2, inverse: DMat2) -> Self {
        Self { p, inverse, last: None }
    }

    fn step(&mut self, miss: DVec2) {
        if let Some((step, before)) = self.last {
            // Good Broyden: H += (s − H y) sᵀH / (sᵀ H y).
            let y = miss - before;
            let h = self.inverse * y;
            let down = step.dot(h);
            if down != 0.0 {
                let row = self.inverse.transpose() * step;
                let column = (step - h) / down;
                self.inverse += DMat2::from_cols(column * row.x, column * row.y);
            }
        }
        let step = -(self.inverse * miss);
        self.p += step;
        self.last = Some((step, miss));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{Lens, LensGradient, builtin, variables::Variables};
    use crate::trace::ObjectPoint;
    use crate::trace::aim::Aimer;
    use crate::trace::test_lenses::laikin_100;
    use isoplanat_base::testing::{assert_abs, assert_rel, between, central_difference};

    /// A shipped lens with a sensor of this radius, mm.
    fn curved(name: &str, radius: f64) -> Lens {
        let curve = |l: &mut crate::lens::Prescription| l.image.curvature = 1.0 / radius;
        builtin::lens(name).and_then(|lens| lens.changed(curve)).expect("a lens")
    }

    /// A ray from the scene and the ray from its landing are the same ray, for near and infinite objects, on plane and curved sensors.
    #[test]
    fn rays_from_the_sensor_are_those_from_the_scene() {
        let cases = [
            (builtin::lens("two_element").expect("shipped"), 0.4),
            (builtin::lens("phone").expect("shipped"), 0.6),
            (laikin_100(), 1.1),
            (curved("two_element", -40.0), 0.4),
            (curved("cooke_triplet", 35.0), 0.3),
        ];
        for (lens, slope) in cases {
            for vergence in [0.0, 2e-3] {
                let system = System::new(&lens, 520.0);
                let view = SensorView::new(&system);
                let object = ObjectPoint::from_slope(DVec2::new(0.0, slope), vergence);
                let aimer = Aimer::new(&system).expect("a stop");
                for s in [DVec2::ZERO, DVec2::new(0.5, -0.4), DVec2::new(-0.2, 0.9)] {
                    let target = 0.9 * s * system.stop_semi_diameter;
                    let mut hits = Vec::new();
                    let from = aimer.aim(object, target, None).expect("aims").ray;
                    let landed = trace(&system, from, system.image(), &mut hits).expect("lands");
                    let e = from.origin - from.direction * (from.origin.z / from.direction.z);
                    let at = landed.at.point.truncate();
                    let p = view.aim(at, target, None, &mut hits).expect("aims");
                    let ray = view.follow(at, p, &mut hits).expect("leaves the lens");
                    let what = format!("{} {vergence}", lens.name);
                    assert_abs((ray.entrance - e.truncate()).length(), 0.0, 1e-9, &what);
                    assert_abs(
                        (ray.slope - vergence * ray.entrance - DVec2::new(0.0, slope)).length(),
                        0.0,
                        1e-10,
                        &what,
                    );
                    let along = landed.direction.truncate() + landed.direction.z * DVec2::from(landed.at.local.slope);
                    assert_abs((p + along).length(), 0.0, 1e-11, &what);
                }
            }
        }
    }

    /// Bundles are the rays aimed one by one.
    #[test]
    fn bundles_are_rays_aimed_one_by_one() {
        let cases = [("two_element", 16.0), ("cooke_triplet", 15.0), ("double_gauss", 9.0), ("phone", 2.8)];
        let shipped = cases.map(|(name, radius)| (builtin::lens(name).expect("shipped"), radius));
        let others = [(laikin_100(), 12.0), (curved("cooke_triplet", -30.0), 15.0)];
        for (lens, radius) in shipped.into_iter().chain(others) {
            let view = SensorView::new(&System::new(&lens, 500.0));
            let at = DVec2::new(0.0, radius);
            let rng = &mut fastrand::Rng::with_seed(2);
            let targets: Vec<DVec2> = (0..70)
                .map(|_| {
                    let angle = between(rng, 0.0, 6.3);
                    rng.f64().sqrt() * view.system.stop_semi_diameter * DVec2::new(angle.cos(), angle.sin())
                })
                .collect();
            let (mut hits, mut chief_hits) = (Vec::new(), Vec::new());
            let chief = view.aim(at, DVec2::ZERO, None, &mut chief_hits).expect("aims");
            let (met, per_mm) = view.around(at, chief, &chief_hits);
            let starts: Vec<DVec2> = targets.iter().map(|t| chief + per_mm * (*t - met)).collect();
            let bundle: Option<Vec<_>> = view.bundle(at, &targets, &starts, (chief, &chief_hits)).into_iter().collect();
            let bundle = bundle.unwrap_or_else(|| panic!("{}: a ray does not arrive", lens.name));
            for (found, target) in bundle.iter().zip(&targets) {
                let p = view.aim(at, *target, None, &mut hits).expect("aims");
                let ray = view.follow(at, p, &mut hits).expect("leaves the lens");
                assert_abs((found.ray.cosines - p).length(), 0.0, 1e-11, &lens.name);
                assert_abs((found.ray.entrance - ray.entrance).length(), 0.0, 1e-9, &lens.name);
                assert_abs((found.ray.slope - ray.slope).length(), 0.0, 1e-10, &lens.name);
                for (a, b) in found.heights.iter().zip(&hits) {
                    assert_abs((*a - b.at.point.truncate()).length(), 0.0, 1e-9, &lens.name);
                }
            }
        }
    }

    /// Cosines, crossing, slopes, heights and paths against differences of every number of the lens.
    #[test]
    fn the_pull_back_agrees_with_differences() {
        let rng = &mut fastrand::Rng::with_seed(3);
        let shipped = [("two_element", 14.0), ("cooke_triplet", 15.0), ("phone", 2.5)];
        let shipped = shipped.map(|(name, radius)| (builtin::lens(name).expect("shipped"), radius));
        for (lens, radius) in shipped.into_iter().chain([(curved("cooke_triplet", -30.0), 15.0)]) {
            let name = &lens.name.clone();
            let (at, unit) = (DVec2::new(0.0, radius), DVec2::new(0.4, -0.6));
            let mut draw = || DVec2::new(between(rng, -1.0, 1.0), between(rng, -1.0, 1.0));
            let heights: Vec<(usize, DVec2)> = (1..lens.surfaces.len()).map(|k| (k, draw())).collect();
            let bar = SceneRayBar { cosines: draw(), entrance: draw(), slope: draw(), heights, path: 0.7 };
            let run = |lens: &Lens| {
                let view = SensorView::new(&System::new(lens, 500.0));
                let mut hits = Vec::new();
                let p = view.aim(at, unit * view.system.stop_semi_diameter, None, &mut hits).expect("aims");
                let ray = view.follow(at, p, &mut hits).expect("leaves the lens");
                let value = ray.cosines.dot(bar.cosines)
                    + ray.entrance.dot(bar.entrance)
                    + ray.slope.dot(bar.slope)
                    + view.path(&hits) * bar.path
                    + bar.heights.iter().map(|(k, b)| hits[*k].at.point.truncate().dot(*b)).sum::<f64>();
                (value, view, p, hits)
            };
            let (_, view, p, hits) = run(&lens);
            let mut out = SystemGradient::zeros(&view.system);
            let target = view.vjp(at, p, &hits, &bar, &mut out);
            let mut out = out.reversed();
            out.stop_semi_diameter += target.dot(unit);
            let mut gradient = LensGradient::zeros(&lens);
            out.add_to(&lens, 500.0, &mut gradient);
            let variables = Variables::all(&lens);
            let (x, pulled) = (variables.values(&lens), variables.gradient(&gradient));
            for _ in 0..4 {
                let dx: Vec<f64> = x.iter().map(|_| between(rng, -0.5, 0.5)).collect();
                let f = |h: f64| {
                    let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                    run(&variables.lens(&lens, &moved).expect("a lens")).0
                };
                let expected = central_difference(f, 1e-5);
                let found: f64 = pulled.iter().zip(&dx).map(|(a, b)| a * b).sum();
                assert_rel(found, expected, 1e-7, 1e-3, name);
            }
        }
    }
}
