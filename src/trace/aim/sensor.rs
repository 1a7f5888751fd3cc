//! Rays from a point of the sensor, aimed at the real stop and followed out into the scene.
//!
//! Light runs backwards here: the system is [`System::reversed`], its first surface the image plane. The unknowns are the
//! direction cosines `(L, M)` of the ray at the sensor, found by Newton on the point where it meets the stop. Seen from
//! the sensor the pupil hardly moves or shrinks even in lenses of a wide field, so the paraxial exit pupil is a good first
//! guess; where it fails the ray is walked out from the axis.
//!
//! Outside the lens the ray is a line: it crosses the first vertex plane at `e` and runs there with the slopes `g` (of the
//! light, which moves towards the sensor). An object point of slope `s` and vergence `v` lies on it where `s = g − v e`
//! ([`crate::trace::launch`]), so one traced ray serves every object distance.

use glam::{DVec2, DVec3};

use super::super::differential::RayDot;
use super::super::sequential::{Hit, HitBar, trace, trace_vjp};
use super::super::{Cause, Failure, Ray, System, SystemGradient};
use super::newton::{Launching, Solved, solve, stop_jacobian};

/// Steps of the walk out from the axis, fewest and most.
const WALKS: [u32; 3] = [4, 16, 64];

/// All rays of one point of the sensor; the coordinates are direction cosines.
#[derive(Clone, Copy, Debug)]
struct SensorPoint(DVec2);

impl Launching for SensorPoint {
    #[inline]
    fn ray(&self, p: DVec2) -> Ray {
        // Cosines beyond one have no ray: the root is NaN, which no surface is met by.
        Ray { origin: self.0.extend(0.0), direction: p.extend((1.0 - p.length_squared()).sqrt()) }
    }

    #[inline]
    fn columns(&self, ray: &Ray) -> [RayDot; 2] {
        let d = ray.direction;
        [DVec3::new(1.0, 0.0, -d.x / d.z), DVec3::new(0.0, 1.0, -d.y / d.z)]
            .map(|direction| RayDot { point: DVec3::ZERO, direction })
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
                    let curvature = s.shape.curvature + 2.0 * s.shape.asphere.first().copied().unwrap_or(0.0);
                    w -= y * (s.index_after - s.index_before) * curvature;
                }
            }
            y
        };
        Self { paraxial: [height(1.0, 0.0), height(0.0, 1.0)], system: reversed }
    }

    /// Index of the medium before the sensor.
    pub fn image_index(&self) -> f64 {
        self.system.surfaces[0].index_after
    }

    fn guess(&self, at: DVec2, target: DVec2) -> DVec2 {
        let slope = (target - self.paraxial[0] * at) / self.paraxial[1];
        slope / (1.0 + slope.length_squared()).sqrt()
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
            match self.solve(at, target, guess, hits) {
                Ok(p) => return Ok(p),
                Err(f) => failure = f,
            }
        }
        // Out from the axis, every ray the next one's guess.
        for steps in WALKS {
            let mut p = DVec2::ZERO;
            let walked = (0..=steps).try_for_each(|k| {
                let share = f64::from(k) / f64::from(steps);
                p = self.solve(at * share, target * share, p, hits)?;
                Ok(())
            });
            match walked {
                Ok(()) => return Ok(p),
                Err(f) => failure = f,
            }
        }
        Err(failure)
    }

    fn solve(&self, at: DVec2, target: DVec2, guess: DVec2, hits: &mut Vec<Hit>) -> Result<DVec2, Failure> {
        let Solved { p, .. } = solve(&self.system, &SensorPoint(at), target, guess, hits)?;
        Ok(p)
    }

    /// A first guess for `target` from the ray with cosines `near`, which meets the stop at `met`, one step along its Jacobian;
    /// `hits` are that ray's.
    pub fn step(&self, at: DVec2, near: DVec2, hits: &[Hit], target: DVec2) -> DVec2 {
        let point = SensorPoint(at);
        let met = hits[self.system.stop].at.point.truncate();
        let step = stop_jacobian(&self.system, &point, &point.ray(near), hits).inverse() * (target - met);
        if step.is_finite() { near + step } else { near }
    }

    /// Follows the ray of `cosines` from `at` into the scene; `hits` are those of all surfaces, the sensor first.
    ///
    /// # Errors
    /// Where it does not get through.
    pub fn follow(&self, at: DVec2, cosines: DVec2, hits: &mut Vec<Hit>) -> Result<SceneRay, Failure> {
        let last = trace(&self.system, SensorPoint(at).ray(cosines), self.system.image(), hits)?;
        let (p, d) = (last.at.point, last.direction);
        if d.z.is_nan() || d.z <= 0.0 {
            return Err(Failure { cause: Cause::Missed, surface: self.system.image() });
        }
        let run = d.truncate() / d.z;
        Ok(SceneRay { cosines, entrance: p.truncate() - p.z * run, slope: -run })
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
        let point = SensorPoint(at);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{Lens, LensGradient, builtin, variables::Variables};
    use crate::testing::{assert_abs, assert_rel, between, central_difference};
    use crate::trace::aim::{ParaxialPupil, aim};
    use crate::trace::launch::{FieldPoint, launch};
    use crate::trace::test_lenses::laikin_100;

    /// A ray from the scene and the ray from its landing are the same ray, for near and infinite objects.
    #[test]
    fn rays_from_the_sensor_are_those_from_the_scene() {
        let cases = [
            (builtin::lens("two_element").expect("shipped"), 0.4),
            (builtin::lens("phone").expect("shipped"), 0.6),
            (laikin_100(), 1.1),
        ];
        for (lens, slope) in cases {
            for vergence in [0.0, 2e-3] {
                let system = System::new(&lens, 520.0);
                let view = SensorView::new(&system);
                let field = FieldPoint { slope: DVec2::new(0.0, slope), vergence };
                for s in [DVec2::ZERO, DVec2::new(0.5, -0.4), DVec2::new(-0.2, 0.9)] {
                    let target = 0.9 * s * system.stop_semi_diameter;
                    let mut hits = Vec::new();
                    let e = aim(&system, ParaxialPupil::new(&lens), field, target, None, &mut hits).expect("aims");
                    let landed = trace(&system, launch(field, e), system.image(), &mut hits).expect("lands");
                    let at = landed.at.point.truncate();
                    let p = view.aim(at, target, None, &mut hits).expect("aims");
                    let ray = view.follow(at, p, &mut hits).expect("leaves the lens");
                    let what = format!("{} {vergence}", lens.name);
                    assert_abs((ray.entrance - e).length(), 0.0, 1e-9, &what);
                    assert_abs((ray.slope - vergence * ray.entrance - field.slope).length(), 0.0, 1e-10, &what);
                    assert_abs((p + landed.direction.truncate()).length(), 0.0, 1e-11, &what);
                }
            }
        }
    }

    /// Cosines, crossing, slopes and heights against differences of every number of the lens.
    #[test]
    fn the_pull_back_agrees_with_differences() {
        let rng = &mut fastrand::Rng::with_seed(3);
        for (name, radius) in [("two_element", 14.0), ("cooke_triplet", 15.0), ("phone", 2.5)] {
            let lens = builtin::lens(name).expect("shipped");
            let (at, unit) = (DVec2::new(0.0, radius), DVec2::new(0.4, -0.6));
            let mut draw = || DVec2::new(between(rng, -1.0, 1.0), between(rng, -1.0, 1.0));
            let heights: Vec<(usize, DVec2)> = (1..lens.surfaces.len()).map(|k| (k, draw())).collect();
            let bar = SceneRayBar { cosines: draw(), entrance: draw(), slope: draw(), heights };
            let run = |lens: &Lens| {
                let view = SensorView::new(&System::new(lens, 500.0));
                let mut hits = Vec::new();
                let p = view.aim(at, unit * view.system.stop_semi_diameter, None, &mut hits).expect("aims");
                let ray = view.follow(at, p, &mut hits).expect("leaves the lens");
                let value = ray.cosines.dot(bar.cosines)
                    + ray.entrance.dot(bar.entrance)
                    + ray.slope.dot(bar.slope)
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
                    run(&variables.lens(&lens, &moved)).0
                };
                let expected = central_difference(f, 1e-5);
                let found: f64 = pulled.iter().zip(&dx).map(|(a, b)| a * b).sum();
                assert_rel(found, expected, 1e-7, 1e-3, name);
            }
        }
    }
}
