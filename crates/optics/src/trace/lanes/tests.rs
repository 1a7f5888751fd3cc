//! The fast trace against the plain one, forward.

use glam::DVec3;

use super::{Level, Options, Program, Rays, TILE, Tile, index_ratios, trace_batch};
use crate::lens::builtin::{self, LENSES};
use crate::lens::test_lenses::every_kind;
use crate::lens::{Pose, Prescription, unchecked};
use crate::trace::sequential::{Hit, trace};
use crate::trace::system::TraceSurface;
use crate::trace::{Cause, Failure, Ray, System};
use gradient::{gradient, numbers};
use isoplanat_base::testing::between;

mod gradient;
mod prove;

/// The plain trace with the causes in the order in which a ray meets them.
fn plain(system: &System, ray: Ray, clip: bool, hits: &mut Vec<Hit>) -> Result<Hit, Failure> {
    let result = trace(system, ray, system.image(), hits);
    let outside = |(h, s): (&Hit, &TraceSurface)| h.at.point.x.powi(2) + h.at.point.y.powi(2) > s.semi_diameter.powi(2);
    if clip && let Some(surface) = hits.iter().zip(&system.surfaces).position(outside) {
        return Err(Failure { cause: Cause::Vignetted, surface });
    }
    match result {
        // The surface where light is reflected may have an aperture too.
        Err(Failure { cause: Cause::TotalReflection, surface }) if clip => {
            let mut open = system.clone();
            open.surfaces[surface].index_after = open.surfaces[surface].index_before;
            let hit = trace(&open, ray, surface, hits).expect("met");
            let cause =
                if outside((&hit, &system.surfaces[surface])) { Cause::Vignetted } else { Cause::TotalReflection };
            Err(Failure { cause, surface })
        }
        other => other,
    }
}

/// Every shipped lens, as it is and with random conics and aspheres, there and back.
fn systems(rng: &mut fastrand::Rng) -> Vec<(String, System)> {
    varied(0..4, rng)
}

fn varied(variants: std::ops::Range<u32>, rng: &mut fastrand::Rng) -> Vec<(String, System)> {
    let mut all = Vec::new();
    for (name, _) in LENSES {
        for variant in variants.clone() {
            let lens = unchecked(&builtin::lens(name).expect(name), |lens| vary(lens, variant, rng));
            let there = System::new(&lens, between(rng, 420.0, 680.0));
            all.push((format!("{name} {variant} reversed"), there.reversed()));
            all.push((format!("{name} {variant}"), there));
        }
    }
    all
}

/// 0: as it is; 1: conics; 2: aspheres of up to ten terms; 3: some surfaces that are not for lanes; 4: as 2, all tilted and decentred.
fn vary(lens: &mut Prescription, variant: u32, rng: &mut fastrand::Rng) {
    for (i, s) in lens.surfaces.iter_mut().enumerate().filter(|_| variant > 0) {
        s.shape.conic += between(rng, -1.5, 0.5);
        if variant > 1 {
            let r = s.semi_diameter;
            let terms = 1 + (i * 3) % 10;
            let sag = |rng: &mut fastrand::Rng, power: i32| between(rng, -5e-3, 5e-3) * r.powi(1 - power);
            s.shape.asphere = (0..terms).map(|j| sag(rng, 2 * j as i32 + 2)).collect();
            if variant == 3 && i % 3 == 1 {
                s.shape.odd = vec![sag(rng, 3)];
            }
            if variant == 3 && i % 3 == 2 || variant == 4 {
                s.pose = Some(Pose { decentre: [0.01 * r, -0.005 * r], tilt: [0.01, 0.02, 0.3] });
            }
        }
    }
}

/// Rays of all sorts: through the stop and past it, steep, from far away, along the axis, with no numbers.
fn rays(system: &System, count: usize, rng: &mut fastrand::Rng) -> Rays {
    let size = 1.5 * system.surfaces.iter().map(|s| s.semi_diameter).filter(|r| r.is_finite()).fold(0.0, f64::max);
    (0..count)
        .map(|i| {
            let mut draw = |w: f64| between(rng, -w, w);
            let width = if i % 3 == 0 { size } else { 0.3 * size };
            let tilt = if i % 7 == 0 { 0.9 } else { 0.3 };
            let mut origin = DVec3::new(draw(width), draw(width), draw(1.0));
            let direction = DVec3::new(draw(tilt), draw(tilt), 1.0).normalize();
            if i % 5 == 0 {
                origin -= 1000.0 * direction;
            }
            Ray { origin, direction }
        })
        .collect()
}

/// Point and direction in the nominal frame of the last surface.
fn nominal(system: &System, hit: &Hit) -> (DVec3, DVec3) {
    let m = system.surfaces[system.image()].motion;
    m.map_or((hit.at.point, hit.direction), |m| (m.rotation * hit.at.point + m.shift, m.rotation * hit.direction))
}

/// `ray` moved by a few units in the last place, in one of eight ways.
fn nudged(ray: Ray, k: u32) -> Ray {
    let sign = |bit: u32| if (k >> bit) & 1 == 1 { 1.0 } else { -1.0 };
    let by = 4.0 * f64::EPSILON * DVec3::new(sign(0), sign(1), sign(2));
    Ray { origin: ray.origin * (1.0 + by), direction: (ray.direction + by).normalize() }
}

/// How far point, direction and path of the plain trace move when the ray moves by a few units in the last place.
fn sensitivity(system: &System, ray: Ray, hits: &mut Vec<Hit>) -> [f64; 3] {
    let Ok(hit) = trace(system, ray, system.image(), hits) else { return [0.0; 3] };
    let (p, d) = nominal(system, &hit);
    let mut moved = [0.0f64; 3];
    for k in 0..8 {
        if let Ok(other) = trace(system, nudged(ray, k), system.image(), hits) {
            let (q, e) = nominal(system, &other);
            moved[0] = moved[0].max((q - p).length());
            moved[1] = moved[1].max((e - d).length());
            moved[2] = moved[2].max((other.optical_path - hit.optical_path).abs());
        }
    }
    moved
}

/// Agreement of one list of rays; how many passed and failed.
fn compare(name: &str, system: &System, given: &Rays, options: Options, strict: bool) -> [usize; 2] {
    let mut traced = given.clone();
    let mut paths = vec![0.0; given.len()];
    let program = Program::new(system, options);
    let status = program.trace_batch(&mut traced, options.path.then_some(&mut paths));
    let (mut count, mut hits) = ([0, 0], Vec::new());
    let mut worst = [0.0f64; 3];
    for (i, status) in status.iter().enumerate() {
        let expected = plain(system, given.ray(i), options.clip, &mut hits);
        let name = format!("{name} {options:?} ray {i} {:?}", given.ray(i));
        let (a, b) = match (status, expected) {
            (None, Ok(hit)) => (traced.ray(i), hit),
            (found, expected) => {
                assert_eq!(*found, expected.err(), "{name}");
                let ray = traced.ray(i);
                assert!(ray.origin.is_finite() && ray.direction.is_finite(), "{name}: {ray:?}");
                count[1] += 1;
                continue;
            }
        };
        count[0] += 1;
        let (p, d) = nominal(system, &b);
        let (away, turned) = ((a.origin - p).length(), (a.direction - d).length());
        let (mut path_away, mut limits) = (0.0, [1e-12, 1e-13, 1e-12 * (1.0 + b.optical_path.abs() / 30.0)]);
        if options.path {
            path_away = (paths[i] - b.optical_path).abs();
        }
        if !strict {
            // Grazing rays: what the plain trace itself makes of the last digits of its input.
            let moved = sensitivity(system, given.ray(i), &mut hits);
            limits.iter_mut().zip(moved).for_each(|(limit, moved)| *limit += 8.0 * moved);
        }
        let found = [away, turned, path_away];
        worst.iter_mut().zip(found).for_each(|(w, f)| *w = w.max(f));
        assert!(found.iter().zip(limits).all(|(f, l)| *f <= l), "{name}: {found:?} {limits:?}");
    }
    eprintln!("{name} {:?}: {count:?} {worst:?}", options.level);
    count
}

#[test]
fn every_level_agrees_with_the_plain_trace() {
    for level in Level::available() {
        let rng = &mut fastrand::Rng::with_seed(5);
        let mut total = [0, 0];
        let mut all = systems(rng);
        all.extend(varied(4..5, rng));
        for (name, system) in all {
            if name.contains(" 4") {
                let own = Program::new(&system, Options::default()).in_own_frames();
                assert_eq!(own, system.surfaces.iter().filter(|s| s.motion.is_some()).count(), "{name}");
                assert!(own >= 2, "{name}");
            }
            for (clip, path) in [(true, false), (false, true)] {
                let given = rays(&system, 3 * TILE + 5, rng);
                let options = Options { clip, path, level: Some(level) };
                // Shipped lenses, rays within their apertures.
                let strict = clip && name.contains(" 0");
                let count = compare(&name, &system, &given, options, strict);
                total = [total[0] + count[0], total[1] + count[1]];
            }
        }
        assert!(total.iter().all(|n| *n > 3000), "{level:?}: {total:?}");
    }
}

/// Every form of a surface alone, there and back: its rays are those of the plain trace, whoever follows them.
#[test]
fn every_form_goes_through_the_lanes_alike() {
    for level in Level::available() {
        let rng = &mut fastrand::Rng::with_seed(6);
        for (name, lens) in every_kind().alone {
            let there = System::new(&lens, 550.0);
            let (mut arrived, surfaces) = (0, there.surfaces.len());
            for system in [there.reversed(), there] {
                for (clip, path) in [(true, false), (false, true)] {
                    let options = Options { clip, path, level: Some(level) };
                    let in_lanes = Program::new(&system, options).in_lanes();
                    assert_eq!(in_lanes, surfaces - usize::from(name != "even"), "{name}");
                    arrived += compare(name, &system, &rays(&system, 2 * TILE + 5, rng), options, false)[0];
                }
            }
            assert!(arrived > 80, "{name}: {arrived}");
        }
    }
}

/// Rays without numbers, that miss, that turn back, that are reflected: data, at every level.
#[test]
fn hopeless_rays_fail_with_their_cause_and_finite_numbers() {
    let bad = [f64::NAN, f64::INFINITY, -f64::INFINITY, 1e200, -1e200];
    for name in ["two_element", "phone"] {
        let system = System::new(&builtin::lens(name).expect(name), 550.0);
        let mut given = Rays::default();
        let axial = Ray { origin: DVec3::ZERO, direction: DVec3::Z };
        for k in 0..6 {
            for value in bad {
                let mut ray = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
                ray[k] = value;
                given.push(Ray { origin: DVec3::from_slice(&ray[..3]), direction: DVec3::from_slice(&ray[3..]) });
                given.push(axial);
            }
        }
        for direction in [DVec3::X, -DVec3::Z, DVec3::new(0.9, 0.0, 0.19f64.sqrt()), DVec3::ZERO] {
            given.push(Ray { origin: DVec3::new(0.3, 0.0, 0.0), direction });
        }
        for level in Level::available() {
            for clip in [false, true] {
                let mut traced = given.clone();
                let options = Options { clip, path: true, level: Some(level) };
                let mut paths = vec![f64::NAN; given.len()];
                let status = Program::new(&system, options).trace_batch(&mut traced, Some(&mut paths));
                for (i, status) in status.iter().enumerate() {
                    let ray = given.ray(i);
                    let expected = plain(&system, ray, clip, &mut Vec::new()).err();
                    assert_eq!(*status, expected, "{name} {level:?} {clip} {ray:?}");
                    let out = traced.ray(i);
                    assert!(out.origin.is_finite() && out.direction.is_finite() && paths[i].is_finite(), "{out:?}");
                }
                assert!(status.iter().filter(|s| s.is_none()).count() >= 30);
                // And no cotangent that is not a number comes of them; rays that have overflowed pass for none.
                let huge = |ray: &Ray| {
                    [ray.origin, ray.direction].iter().any(|v| v.is_finite() && v.abs().max_element() > 1e9)
                };
                let sane: Rays = (0..given.len()).map(|i| given.ray(i)).filter(|r| !huge(r)).collect();
                let (_, g) = gradient(&system, &sane, options);
                let numbers = numbers(&g);
                assert!(numbers.iter().all(|v| v.is_finite()), "{name} {level:?}: {numbers:?}");
            }
        }
    }
}

/// A total reflection inside a lens, at every level.
#[test]
fn total_reflection_is_told_with_its_surface() {
    let mut system = System::new(&builtin::lens("two_element").expect("shipped"), 550.0);
    system.surfaces[1].shape = crate::lens::Shape::even(-0.05, 0.3, vec![0.0, 1e-6]);
    system.surfaces[1] = TraceSurface::new(
        system.surfaces[1].shape.clone(),
        system.surfaces[1].distance,
        [system.surfaces[1].index_before, 1.0],
        12.0,
    );
    let given: Rays =
        (0..200).map(|i| Ray { origin: DVec3::new(0.055 * f64::from(i), 0.0, 0.0), direction: DVec3::Z }).collect();
    for level in Level::available() {
        let options = Options { level: Some(level), ..Options::default() };
        let count = compare("reflection", &system, &given, options, false);
        let status = trace_batch(&system, &mut given.clone(), options);
        let reflected = Some(Failure { cause: Cause::TotalReflection, surface: 1 });
        assert!(count[0] > 30 && status.iter().filter(|s| **s == reflected).count() > 10, "{count:?} {status:?}");
    }
}

/// A ray's numbers depend on that ray alone, to the last bit: batches, streams, any neighbours.
#[test]
fn rays_do_not_depend_on_their_neighbours() {
    let rng = &mut fastrand::Rng::with_seed(8);
    for (name, system) in systems(rng).into_iter().step_by(5) {
        let given = rays(&system, 2 * TILE + 7, rng);
        for level in Level::available() {
            let options = Options { clip: true, path: false, level: Some(level) };
            let mut together = given.clone();
            let status = trace_batch(&system, &mut together, options);
            let program = Program::new(&system, options);
            for i in (0..given.len()).step_by(11) {
                let mut alone: Rays = std::iter::once(given.ray(i)).collect();
                assert_eq!(program.trace_batch(&mut alone, None)[0], status[i], "{name} {level:?}");
                assert_eq!(alone.ray(0), together.ray(i), "{name} {level:?}");
            }
            let landed = program.trace_stream(
                given.len(),
                Vec::new,
                |_, first, tile| fill(&given, first, tile),
                |own: &mut Vec<Ray>, _, tile| own.extend((0..tile.len()).map(|i| tile.rays.ray(i))),
            );
            let landed: Rays = landed.into_iter().flatten().collect();
            assert_eq!(landed, together, "{name} {level:?}");
        }
    }
}

fn fill(given: &Rays, first: usize, tile: &mut Tile) {
    for lane in 0..tile.len() {
        tile.rays.set(lane, given.ray(first + lane));
    }
}

/// A spectral program takes every ray as the program of its own wavelength does.
#[test]
fn wavelengths_may_differ_from_ray_to_ray() {
    let rng = &mut fastrand::Rng::with_seed(3);
    for name in ["cooke_triplet", "phone", "al2550_a"] {
        let lens = builtin::lens(name).expect(name);
        let systems = [450.0, 550.0, 650.0].map(|nm| System::new(&lens, nm));
        let ratios: Vec<f64> = systems.iter().flat_map(|s| index_ratios(&s.surfaces)).collect();
        let given = rays(&systems[0], 300, rng);
        for level in Level::available() {
            let options = Options { clip: true, path: false, level: Some(level) };
            let program = Program::spectral(&systems[1].surfaces, &ratios, options).expect("whole wavelengths");
            let landed: Vec<_> = program
                .trace_stream(
                    given.len(),
                    Vec::new,
                    |_, first, tile| {
                        fill(&given, first, tile);
                        (0..tile.len()).for_each(|lane| tile.colour[lane] = ((first + lane) % 3) as u32);
                    },
                    |own, _, tile| own.extend((0..tile.len()).map(|i| (tile.rays.ray(i), tile.status[i]))),
                )
                .into_iter()
                .flatten()
                .collect();
            for (k, system) in systems.iter().enumerate() {
                let mut alone = given.clone();
                let status = trace_batch(system, &mut alone, options);
                for i in (k..given.len()).step_by(3) {
                    assert_eq!(landed[i].1, status[i], "{name} {level:?}");
                    let away = (landed[i].0.origin - alone.ray(i).origin).length();
                    assert!(away < 1e-12, "{name} {level:?}: {away:e}");
                }
            }
        }
        assert!(Program::spectral(&systems[0].surfaces, &ratios[1..], Options::default()).is_err());
    }
}
