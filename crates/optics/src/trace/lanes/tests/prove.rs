//! Which roots lanes take for certain.

use glam::DVec3;

use super::super::program::Step;
use super::super::prove::prove;
use super::super::run::Run;
use super::super::{Level, Options, Program, Rays, TILE, Tile};
use super::compare;
use crate::lens::{Shape, builtin};
use crate::trace::first_root::crossings;
use crate::trace::intersect::intersect;
use crate::trace::system::TraceSurface;
use crate::trace::{Ray, System};
use isoplanat_base::math::simd::{Kernel, Simd};
use isoplanat_base::testing::between;

/// An even asphere that rays may meet several times, with 2 to 10 terms.
fn wild(rng: &mut fastrand::Rng) -> TraceSurface {
    let mut draw = |w: f64| between(rng, -w, w);
    let mut terms = vec![draw(0.02), draw(2e-3), draw(4e-5), draw(5e-7)];
    let shape = [draw(0.06), draw(2.0)];
    terms.resize(2 + rng.usize(..9), 0.0);
    TraceSurface::new(Shape::even(shape[0], shape[1], terms), 0.3, [1.0, 1.5], 6.0)
}

fn ray(rng: &mut fastrand::Rng) -> Ray {
    let from = DVec3::new(between(rng, -8.0, 8.0), between(rng, -8.0, 8.0), between(rng, -12.0, 1.0));
    let to = DVec3::new(between(rng, -6.5, 6.5), between(rng, -6.5, 6.5), between(rng, 0.5, 4.0));
    Ray { origin: from, direction: (to - from).normalize() }
}

struct Prove<'a> {
    step: &'a Step,
    run: Run<'a>,
    asked: u64,
}

impl Kernel for Prove<'_> {
    type Output = u64;
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> u64 {
        prove(simd, self.step, &self.run, 0, self.asked)
    }
}

/// Of crossings `t` of each ray with the first surface of `program`: which are proved.
fn proved(program: &Program, all: &[(Ray, f64)]) -> Vec<bool> {
    let step = &program.steps[0];
    let mut found = Vec::new();
    for part in all.chunks(TILE) {
        let (mut before, mut after) = (Tile::new(), Tile::new());
        for (lane, (ray, t)) in part.iter().enumerate() {
            before.rays.set(lane, *ray);
            let point = ray.origin + *t * ray.direction - step.surface.distance * DVec3::Z;
            after.rays.set(lane, Ray { origin: point, direction: ray.direction });
        }
        let asked = u64::MAX >> (TILE - part.len());
        let run = Run {
            from: &mut before.rays,
            to: &mut after.rays,
            extra: None,
            colour: &before.colour,
            alive: &mut before.alive,
            status: &mut before.status,
            len: part.len(),
        };
        let bits = program.level.run(Prove { step, run, asked });
        assert_eq!(bits & !asked, 0);
        found.extend((0..part.len()).map(|lane| (bits >> lane) & 1 == 1));
    }
    found
}

/// Every crossing of wild surfaces is offered, the first one and the others: none but the plain trace's is proved.
#[test]
fn only_the_plain_traces_root_is_proved() {
    for level in Level::available() {
        let rng = &mut fastrand::Rng::with_seed(77);
        let (mut right, mut wrong, mut certain) = (0, 0, 0);
        for _ in 0..400 {
            let surface = wild(rng);
            let program =
                Program::of(std::slice::from_ref(&surface), Options { level: Some(level), ..Options::default() });
            let mut offered = Vec::new();
            for _ in 0..40 {
                let ray = ray(rng);
                let origin = ray.origin - surface.distance * DVec3::Z;
                let plain = intersect(&surface, origin, ray.direction).map(|hit| hit.t).ok();
                for t in crossings(&surface, origin, ray.direction).unwrap_or_default() {
                    offered.push(((ray, t), plain.is_some_and(|plain| (plain - t).abs() < 1e-8)));
                }
            }
            let all: Vec<(Ray, f64)> = offered.iter().map(|(one, _)| *one).collect();
            for (((ray, t), first), proved) in offered.into_iter().zip(proved(&program, &all)) {
                assert!(first || !proved, "{level:?} {surface:?} {ray:?} {t}");
                right += usize::from(first);
                wrong += usize::from(!first);
                certain += usize::from(proved);
            }
        }
        eprintln!("{level:?}: {certain} of {right} first roots proved; {wrong} others offered");
        assert!(wrong > 500 && 10 * certain > 8 * right, "{level:?}: {certain} of {right}, {wrong}");
    }
}

/// The trace of wild surfaces, whose rays start within and beyond the domain, is the plain one.
#[test]
fn wild_surfaces_are_met_as_by_the_plain_trace() {
    for level in Level::available() {
        let rng = &mut fastrand::Rng::with_seed(78);
        let mut total = [0, 0];
        for i in 0..60 {
            let surface = wild(rng);
            let system = System { wavelength_nm: 550.0, surfaces: vec![surface], stop: 0, stop_semi_diameter: 6.0 };
            let given: Rays = (0..3 * TILE).map(|_| ray(rng)).collect();
            let options = Options { clip: i % 2 == 0, path: i % 3 == 0, level: Some(level) };
            let count = compare("wild", &system, &given, options, false);
            total = [total[0] + count[0], total[1] + count[1]];
        }
        assert!(total.iter().all(|n| *n > 1000), "{level:?}: {total:?}");
    }
}

/// Nearly all roots of the phone lens seen from its sensor are proved, also where slopes do not tell.
#[test]
fn roots_of_the_phone_lens_from_its_sensor_are_proved() {
    let system = System::new(&builtin::lens("phone").expect("shipped"), 550.0).reversed();
    let rng = &mut fastrand::Rng::with_seed(4);
    for surface in system.surfaces.iter().filter(|s| s.aspheric) {
        let program = Program::of(std::slice::from_ref(surface), Options::default());
        let rim = surface.semi_diameter;
        let mut all = Vec::new();
        for _ in 0..400 {
            // Through a point of the clear aperture, from a millimetre before it.
            let turn = std::f64::consts::TAU * rng.f64();
            let [x, y] = [turn.cos(), turn.sin()].map(|v| v * rim * rng.f64().sqrt());
            let h = surface.shape.sag(x * x + y * y).expect("within reach").h + surface.distance;
            let direction = DVec3::new(between(rng, -0.4, 0.4), between(rng, -0.4, 0.4), 1.0).normalize();
            let ray = Ray { origin: DVec3::new(x, y, h) - direction, direction };
            let plain = intersect(surface, ray.origin - surface.distance * DVec3::Z, direction).map(|hit| hit.t);
            all.extend(plain.ok().filter(|t| (t - 1.0).abs() < 1e-9).map(|t| (ray, t)));
        }
        let certain = proved(&program, &all).into_iter().filter(|p| *p).count();
        assert!(all.len() > 300 && 100 * certain > 98 * all.len(), "{certain} of {}, {surface:?}", all.len());
    }
}
