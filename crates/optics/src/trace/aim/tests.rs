//! Aiming on shipped lenses, wide-angle lenses, tilted lenses, lenses without sense.

use glam::{DVec2, DVec3};

use super::backward::Front;
use super::newton::solve;
use super::*;
use crate::lens::{Pose, Shape, builtin};
use crate::trace::sequential::trace;
use crate::trace::system::TraceSurface;
use crate::trace::test_lenses::{laikin_100, meniscus_200, muller_156, nikkor_180, scaled, tilt};
use crate::trace::{Cause, ObjectPoint, System};
use isoplanat_base::testing::between;

/// What aiming over a lens's field and stop came to.
#[derive(Debug, Default, PartialEq)]
struct Tally {
    rays: u32,
    failed: u32,
    backward: u32,
    iterations: u32,
    worst_iterations: u32,
    residual: f64,
}

/// Aims over field angles 0 to `half_field` (radians) and the whole stop, every ray by itself.
fn sweep(system: &System, vergence: f64, half_field: f64, alone: bool) -> Tally {
    let aimer = Aimer::new(system).expect("has a stop");
    let mut tally = Tally::default();
    for k in 0..=20 {
        let object = ObjectPoint::from_angle(half_field * f64::from(k) / 20.0, 1.2, vergence);
        let chief = aimer.aim(object, DVec2::ZERO, None).ok();
        for i in 0..41 {
            let r = (f64::from(i) / 40.0).sqrt() * system.stop_semi_diameter;
            let target = r * DVec2::from_angle(2.399_963 * f64::from(i));
            tally.rays += 1;
            match aimer.aim(object, target, chief.as_ref().filter(|_| !alone)) {
                Ok(a) => {
                    // The forward trace says so, not the search.
                    let mut hits = Vec::new();
                    let hit = trace(system, a.ray, system.stop, &mut hits).expect("traced before");
                    let residual = (hit.at.point.truncate() - target).length() / system.stop_semi_diameter;
                    assert_eq!(residual, a.residual);
                    assert_eq!(hits, a.hits);
                    // The ray comes from its object.
                    let (n, _) = object.direction_at(a.ray.origin);
                    assert!((n - a.ray.direction).length() < 1e-15);
                    tally.residual = tally.residual.max(residual);
                    tally.iterations += a.iterations;
                    tally.worst_iterations = tally.worst_iterations.max(a.iterations);
                    tally.backward += u32::from(a.backward);
                }
                Err(_) => tally.failed += 1,
            }
        }
    }
    tally
}

#[test]
fn every_ray_of_every_shipped_lens_is_aimed() {
    for (name, _) in builtin::LENSES {
        let lens = builtin::lens(name).expect("shipped");
        let system = System::new(&lens, lens.wavelengths.primary_nm);
        for alone in [true, false] {
            let t = sweep(&system, lens.object_vergence, lens.max_field_deg().to_radians(), alone);
            eprintln!("{name}, alone {alone}: {t:?}");
            assert!(t.failed == 0 && t.residual <= 1e-12, "{name}: {t:?}");
        }
    }
}

#[test]
fn every_ray_of_wide_lenses_is_aimed() {
    for lens in [laikin_100(), muller_156(), nikkor_180(), meniscus_200()] {
        let system = System::new(&lens, 587.5618);
        for alone in [true, false] {
            let t = sweep(&system, 0.0, lens.max_field_deg().to_radians(), alone);
            eprintln!("{}, alone {alone}: {t:?}", lens.name);
            assert!(t.failed == 0 && t.residual <= 1e-12, "{}: {t:?}", lens.name);
        }
        // A near object as well.
        let t = sweep(&system, 1.0 / 300.0, lens.max_field_deg().to_radians(), false);
        assert!(t.failed == 0 && t.residual <= 1e-12, "{} near: {t:?}", lens.name);
    }
}

/// A thousand times smaller or larger: the same rays at the same cost.
#[test]
fn aiming_has_no_scale() {
    for lens in [laikin_100(), nikkor_180(), builtin::lens("phone").expect("shipped")] {
        let half_field = lens.max_field_deg().to_radians();
        let here = sweep(&System::new(&lens, 587.5618), lens.object_vergence, half_field, true);
        for scale in [1e-3, 1e3] {
            let large = scaled(&lens, scale);
            let there = sweep(&System::new(&large, 587.5618), large.object_vergence, half_field, true);
            assert_eq!((there.rays, there.failed, there.backward), (here.rays, here.failed, here.backward));
            assert!(there.residual <= 1e-12, "{scale}: {there:?}");
            let more = f64::from(there.iterations) / f64::from(here.iterations);
            assert!((0.97..1.03).contains(&more), "{scale}: {there:?} against {here:?}");
        }
    }
}

/// The stop before everything, in the middle, behind everything.
#[test]
fn the_stop_may_be_any_surface() {
    let lens = builtin::lens("two_element").expect("shipped");
    for stop in 0..lens.surfaces.len() {
        let mut system = System::new(&lens, 550.0);
        (system.stop, system.stop_semi_diameter) = (stop, 1.5);
        let t = sweep(&system, 0.0, 0.1, true);
        assert!(t.failed == 0 && t.residual <= 1e-12, "stop {stop}: {t:?}");
        // Backwards alone finds the same rays.
        let aimer = Aimer::new(&system).expect("has a stop");
        let front = Front::new(&system).expect("has a stop");
        for angle in [0.0, 0.05, 0.1] {
            for vergence in [0.0, 1e-3, -1e-3] {
                let object = ObjectPoint::from_angle(angle, 0.4, vergence);
                let target = DVec2::new(0.7, -1.1);
                let a = aimer.aim(object, target, None).expect("aims");
                let found = front.search(object, target).expect("searches");
                let point = a.hits[0].at.point;
                assert!((found.point - point).length() < 1e-8, "stop {stop}: {} {point}", found.point);
            }
        }
    }
}

#[test]
fn tilted_lenses_are_aimed() {
    let rng = &mut fastrand::Rng::with_seed(3);
    for lens in [builtin::lens("double_gauss").expect("shipped"), laikin_100(), nikkor_180(), meniscus_200()] {
        for _ in 0..3 {
            let lens = tilt(&lens, rng, 1.0);
            let system = System::new(&lens, 587.5618);
            let t = sweep(&system, lens.object_vergence, 0.97 * lens.max_field_deg().to_radians(), true);
            assert!(t.failed == 0 && t.residual <= 1e-12, "{}: {t:?}", lens.name);
        }
    }
}

/// Systems and objects without sense: an answer or a failure, no panic, no NaN.
#[test]
fn any_input_gives_a_ray_or_a_failure() {
    let rng = &mut fastrand::Rng::with_seed(1);
    let strange = [f64::NAN, f64::INFINITY, -f64::INFINITY, 0.0, 1e300, -1e300, 1e-300, -1.0];
    let (mut aimed, mut failed) = (0, 0);
    for round in 0..3000 {
        let count = 1 + rng.usize(0..6);
        let draw = |w: f64, rng: &mut fastrand::Rng| {
            if round % 3 == 0 && rng.usize(0..12) == 0 {
                strange[rng.usize(0..strange.len())]
            } else {
                between(rng, -w, w)
            }
        };
        let mut surfaces = Vec::new();
        for _ in 0..=count {
            let mut shape = Shape { curvature: draw(0.2, rng), conic: draw(3.0, rng), ..Shape::default() };
            if rng.bool() {
                shape.asphere = vec![draw(1e-3, rng), draw(1e-5, rng)];
            }
            let indices = [1.5 + draw(0.6, rng), 1.5 + draw(0.6, rng)];
            let mut s = TraceSurface::new(shape, draw(4.0, rng) + 3.0, indices, 5.0 + draw(5.0, rng));
            if rng.usize(0..4) == 0 {
                let pose =
                    Pose { decentre: [draw(1.0, rng), draw(1.0, rng)], tilt: [draw(0.5, rng), draw(0.5, rng), 0.0] };
                s.motion = Some(pose.motion());
            }
            surfaces.push(s);
        }
        let system = System {
            wavelength_nm: 550.0,
            surfaces,
            stop: rng.usize(0..count + 2 + usize::from(round % 100 == 0)),
            stop_semi_diameter: 2.0 + draw(2.0, rng),
        };
        let direction = DVec3::new(draw(1.0, rng), draw(1.0, rng), draw(1.0, rng));
        let object = ObjectPoint { direction: direction.normalize(), vergence: draw(0.1, rng) };
        let target = DVec2::new(draw(2.0, rng), draw(2.0, rng));
        let found = Aimer::new(&system).and_then(|a| a.aim(object, target, None));
        match found {
            Ok(a) => {
                aimed += 1;
                assert!(a.residual <= 1e-9, "{a:?}");
                assert!(a.ray.origin.is_finite() && a.ray.direction.is_finite(), "{a:?}");
                assert!((a.ray.direction.length() - 1.0).abs() < 1e-12, "{a:?}");
                assert!(a.hits.iter().all(|h| h.at.point.is_finite() && h.direction.is_finite()), "{a:?}");
            }
            Err(f) => {
                failed += 1;
                assert!(f.surface <= system.stop, "{f:?}");
            }
        }
    }
    eprintln!("{aimed} aimed, {failed} failed");
    assert!(aimed > 300 && failed > 300, "{aimed} {failed}");
}

/// Light that is totally reflected before the stop, and a stop that does not reach its own rim.
#[test]
fn a_hopeless_ray_names_its_cause() {
    let lens = builtin::lens("two_element").expect("shipped");
    let mut system = System::new(&lens, 550.0);
    let object = ObjectPoint::from_angle(1.2, 0.0, 0.0);
    // A plane plate of low index before the lens: no light of 69° enters from the dense side.
    let plate = [4.0, 1.0].map(|n| TraceSurface::new(Shape::default(), 0.0, [n, 1.0], 20.0));
    system.surfaces.splice(0..0, plate);
    system.stop += 2;
    let failure = Aimer::new(&system).and_then(|a| a.aim(object, DVec2::ZERO, None)).expect_err("cannot enter");
    // Seen from the stop the light never leaves so steeply: the walk ends at a surface of the front group.
    assert!(failure.surface <= system.stop && failure.cause != Cause::Vignetted, "{failure:?}");
    let mut system = System::new(&lens, 550.0);
    let stop = system.stop;
    system.surfaces[stop].shape.curvature = 1.0;
    let failure =
        Aimer::new(&system).and_then(|a| a.aim(object, DVec2::new(1.5, 0.0), None)).expect_err("no stop there");
    assert_eq!(failure, crate::trace::Failure { cause: Cause::Missed, surface: stop });
}

/// Random lenses of strong surfaces: what Newton finds within the apertures from any of 441 starts, the
/// aimer finds from its own.
#[test]
fn few_rays_are_missed_that_a_raster_of_starts_finds() {
    let rng = &mut fastrand::Rng::with_seed(6);
    let (mut both, mut missed, mut alone) = (0, 0, 0);
    for _ in 0..1500 {
        let count = 2 + rng.usize(0..5);
        let mut n = 1.0;
        let mut surfaces = Vec::new();
        for i in 0..=count {
            let after = if i % 2 == 0 { between(rng, 1.4, 1.9) } else { 1.0 };
            let shape =
                Shape { curvature: between(rng, -0.08, 0.08), conic: between(rng, -1.5, 0.5), ..Shape::default() };
            surfaces.push(TraceSurface::new(shape, if i == 0 { 0.0 } else { between(rng, 1.0, 8.0) }, [n, after], 9.0));
            n = after;
        }
        let stop = rng.usize(0..=count);
        surfaces[stop].shape = Shape::default();
        let system = System { wavelength_nm: 550.0, surfaces, stop, stop_semi_diameter: 2.0 };
        let object = ObjectPoint::from_angle(between(rng, 0.0, 1.3), between(rng, 0.0, 6.0), between(rng, -0.01, 0.02));
        let target = 2.0 * rng.f64().sqrt() * DVec2::from_angle(between(rng, 0.0, 6.0));
        let found = Aimer::new(&system).and_then(|a| a.aim(object, target, None)).is_ok();
        let plane = super::super::object::LaunchPlane::new(&system, object);
        let mut hits = Vec::new();
        let mut raster = || {
            for i in -10..=10 {
                for j in -10..=10 {
                    let start = 1.5 * DVec2::new(f64::from(i), f64::from(j));
                    let upright = solve(&system, &plane, target, start, &mut hits).is_ok_and(|s| s.upright);
                    if upright && hits.iter().all(|h| h.at.point.truncate().length() <= 9.0) {
                        return true;
                    }
                }
            }
            false
        };
        match (found, raster()) {
            (true, true) => both += 1,
            (false, true) => missed += 1,
            (true, false) => alone += 1,
            _ => {}
        }
    }
    eprintln!("{both} found by both, {missed} by the raster of starts alone, {alone} by the aimer alone");
    // Those that remain lie behind a caustic: on no branch that is connected with the axis.
    assert!(both > 1000 && missed * 50 < both && missed < alone, "{both} {missed} {alone}");
}
