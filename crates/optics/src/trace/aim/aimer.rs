//! Rays of an object at any angle, aimed at the stop.

use glam::{DVec2, DVec3};

use super::super::object::{LaunchPlane, ObjectBar, ObjectPoint};
use super::super::sequential::{Hit, HitBar, trace_vjp};
use super::super::{Failure, Ray, System, SystemGradient};
use super::backward::Front;
use super::newton::{Solved, solve, stop_jacobian};
use super::paraxial::ParaxialStop;

/// Aims rays of one system: keeps what all of them share.
pub struct Aimer<'a> {
    system: &'a System,
    pupil: ParaxialStop,
    front: Front<'a>,
}

/// A launch ray that meets the stop where it was asked to.
#[derive(Clone, Debug, PartialEq)]
pub struct Aimed {
    /// The ray, starting on its launch plane (frame of the first vertex).
    pub ray: Ray,
    /// The plane the ray starts from, and its object.
    pub plane: LaunchPlane,
    /// Its hits, the stop's last.
    pub hits: Vec<Hit>,
    /// Distance from the target in the stop, relative to the stop's semi-diameter.
    pub residual: f64,
    /// Rays traced for it, forward and backward.
    pub iterations: u32,
    /// Whether it had to be sought backwards from the stop.
    pub backward: bool,
}

impl<'a> Aimer<'a> {
    /// For `system`. Fails if its stop is no surface of it.
    pub fn new(system: &'a System) -> Result<Self, Failure> {
        let front = Front::new(system)?;
        Ok(Self { system, pupil: ParaxialStop::of(system), front })
    }

    /// The system whose rays are aimed.
    pub fn system(&self) -> &'a System {
        self.system
    }

    /// The ray of `object` that meets the stop at `target` (mm, in the stop's vertex frame).
    ///
    /// `near` is a ray of the same object aimed before, as a first guess. The ray is not clipped by apertures. Fails
    /// where no ray of the branch that is connected with the axis gets there.
    pub fn aim(&self, object: ObjectPoint, target: DVec2, near: Option<&Aimed>) -> Result<Aimed, Failure> {
        let plane = LaunchPlane::new(self.system, object);
        let mut hits = Vec::with_capacity(self.system.surfaces.len());
        let aimed = |s: Solved, hits: Vec<Hit>, before: u32, backward: bool| Aimed {
            ray: plane.ray(s.p),
            plane,
            hits,
            residual: s.residual,
            iterations: before + s.iterations,
            backward,
        };
        let guesses = near.map(|a| self.step_from(a, &plane, target)).into_iter();
        let (mut forward, mut spent) = (None, 0);
        for guess in guesses.chain([self.pupil.guess(&plane, target)]) {
            match solve(self.system, &plane, target, guess, &mut hits) {
                Ok(s) if s.upright => return Ok(aimed(s, hits, spent, false)),
                Ok(s) => {
                    spent += s.iterations;
                    forward = forward.or(Some(s));
                }
                Err(_) => spent += 1,
            }
        }
        let backward = self.front.search(object, target).and_then(|found| {
            let s = solve(self.system, &plane, target, plane.through(found.point), &mut hits)?;
            Ok((s, found.iterations))
        });
        match (backward, forward) {
            (Ok((s, traced)), _) => Ok(aimed(s, hits, spent + traced, true)),
            // A ray that reaches its point on a folded pupil is a ray still.
            (Err(_), Some(s)) => {
                let s = solve(self.system, &plane, target, s.p, &mut hits)?;
                Ok(aimed(s, hits, spent, false))
            }
            (Err(failure), None) => Err(failure),
        }
    }

    /// Light that `aimed` brings through a unit of the stop's area, from an object element that radiates by Lambert's law in a plane
    /// perpendicular to the axis (an infinitely far one: evenly over a plane perpendicular to its light). Comparable between rays
    /// of one object point only; not a number where the pupil folds.
    pub(crate) fn flux(&self, aimed: &Aimed) -> f64 {
        let (plane, ray) = (&aimed.plane, &aimed.ray);
        let area = 1.0 / stop_jacobian(self.system, plane, ray, &aimed.hits).determinant().abs();
        if plane.object.vergence == 0.0 {
            return area;
        }
        // Solid angle: the plane is perpendicular to the middle ray, (1/v − standoff)/cos away.
        let cosine = ray.direction.dot(plane.object.direction);
        area * cosine.powi(3) * ray.direction.z
    }

    /// First guess from a neighbouring ray: one step along its own Jacobian.
    fn step_from(&self, near: &Aimed, plane: &LaunchPlane, target: DVec2) -> DVec2 {
        let p = plane.through(near.ray.origin);
        let Some(hit) = near.hits.get(self.system.stop) else { return p };
        let miss = hit.at.point.truncate() - target;
        let step = stop_jacobian(self.system, &near.plane, &near.ray, &near.hits).inverse() * miss;
        if near.plane == *plane && step.is_finite() { p - step } else { p }
    }
}

/// Cotangents that leave [`aimed_vjp`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AimedBar {
    /// Of the object point.
    pub object: ObjectBar,
    /// Of the target point in the stop.
    pub target: DVec2,
}

/// Pulls cotangents on the aimed launch ray back to the system (added to `out`), the object and the target.
///
/// The launch plane's distance is held: origins move in it, as they do in the plane's own `path`. `hits` are the ray's
/// own, up to the stop at least (those of a trace to the image will do).
pub fn aimed_vjp(
    system: &System,
    aimed: &Aimed,
    hits: &[Hit],
    origin_bar: DVec3,
    direction_bar: DVec3,
    out: &mut SystemGradient,
) -> AimedBar {
    let (p_bar, mut object) = aimed.plane.ray_vjp(&aimed.ray, origin_bar, direction_bar);
    let target = stop_jacobian(system, &aimed.plane, &aimed.ray, hits).transpose().inverse() * p_bar;
    let mut bars = vec![HitBar::default(); system.stop + 1];
    bars[system.stop].point = DVec3::new(-target.x, -target.y, 0.0);
    let (o, d) = trace_vjp(system, hits, &bars, out);
    object.add(&aimed.plane.ray_vjp(&aimed.ray, o, d).1);
    AimedBar { object, target }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{Lens, LensGradient, builtin, unchecked, variables::Variables};
    use crate::trace::sequential::trace;
    use crate::trace::test_lenses::{laikin_100, meniscus_200, nikkor_180, tilt};
    use isoplanat_base::testing::{assert_rel, between, central_difference};

    /// Landing and direction in the image of aimed rays, against re-aimed rays of changed lenses, objects and targets.
    #[test]
    fn aimed_vjp_agrees_with_differences() {
        let rng = &mut fastrand::Rng::with_seed(8);
        let cases = [
            (builtin::lens("two_element").expect("shipped"), 0.35),
            (builtin::lens("phone").expect("shipped"), 0.5),
            (laikin_100(), 0.85),
            (nikkor_180(), 1.57),
            (meniscus_200(), 1.7),
        ];
        for (lens, angle) in cases {
            for (tilted, vergence) in [(false, 0.0), (true, 0.0), (true, 2e-3)] {
                // A stop of fixed size: the target is stated in mm.
                let lens = if tilted { tilt(&lens, rng, 0.5) } else { lens.clone() };
                let nm = 587.5618;
                let base = System::new(&lens, nm);
                let target = DVec2::new(0.5, -0.6) * base.stop_semi_diameter;
                let mut vector = |w: f64| DVec3::new(between(rng, -w, w), between(rng, -w, w), between(rng, -w, w));
                let (p_bar, d_bar) = (vector(1.0).truncate().extend(0.0), vector(1.0));
                let landed = |lens: &Lens, object: ObjectPoint, target: DVec2| {
                    let system = System::new(lens, nm);
                    let a = Aimer::new(&system).and_then(|x| x.aim(object, target, None)).expect("aims");
                    let mut hits = Vec::new();
                    let hit = trace(&system, a.ray, system.image(), &mut hits).expect("lands");
                    (hit.at.point.dot(p_bar) + hit.direction.dot(d_bar), a, hits)
                };
                let object = |angle: f64, azimuth: f64, v: f64| ObjectPoint::from_angle(angle, azimuth, v);
                let (_, aimed, hits) = landed(&lens, object(angle, 1.1, vergence), target);
                let mut out = SystemGradient::zeros(&base);
                let mut bars = vec![HitBar::default(); base.image() + 1];
                bars[base.image()] = HitBar { point: p_bar, direction: d_bar, optical_path: 0.0 };
                let (o, d) = trace_vjp(&base, &hits, &bars, &mut out);
                let back = aimed_vjp(&base, &aimed, &hits, o, d, &mut out);
                let direct = aimed.plane.ray_vjp(&aimed.ray, o, d).1;
                assert!(back.object != direct || angle == 0.0, "the aiming has its own part");
                let what = format!("{} tilted {tilted} vergence {vergence}", lens.name);
                // The object.
                let (angle_bar, azimuth_bar) = ObjectPoint::from_angle_vjp(angle, 1.1, &back.object);
                let unit = lens.length();
                for (k, pulled) in [(0, angle_bar), (1, azimuth_bar), (2, back.object.vergence / unit)] {
                    let f = |h: f64| {
                        let moved = match k {
                            0 => object(angle + h, 1.1, vergence),
                            1 => object(angle, 1.1 + h, vergence),
                            _ => object(angle, 1.1, vergence + h / unit),
                        };
                        landed(&lens, moved, target).0
                    };
                    assert_rel(pulled, central_difference(f, 1e-4), 1e-7, 0.1, &format!("{what} object {k}"));
                }
                // The target.
                let dot = DVec2::new(0.3, 0.8);
                let f = |h: f64| landed(&lens, object(angle, 1.1, vergence), target + h * dot).0;
                assert_rel(back.target.dot(dot), central_difference(f, 1e-3), 1e-7, 0.1, &format!("{what} target"));
                // Every number of the lens.
                let mut gradient = LensGradient::zeros(&lens);
                out.add_to(&lens, nm, &mut gradient);
                let variables = Variables::all(&lens);
                let x = variables.values(&lens);
                let pulled = variables.gradient(&gradient);
                let size = pulled.iter().map(|g| g * g).sum::<f64>().sqrt();
                for _ in 0..3 {
                    let dx: Vec<f64> = x.iter().map(|_| between(rng, -0.5, 0.5)).collect();
                    let f = |h: f64| {
                        let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                        landed(&unchecked(&lens, |l| variables.put(l, &moved)), object(angle, 1.1, vergence), target).0
                    };
                    let pulled: f64 = pulled.iter().zip(&dx).map(|(a, b)| a * b).sum();
                    assert_rel(pulled, central_difference(f, 2e-5), 1e-7, 0.1 * size, &format!("{what} lens"));
                }
            }
        }
    }
}
