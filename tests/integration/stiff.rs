//! The stiff suite: extreme lenses and rays against a 60-digit trace that shares no code with the crate
//! (`tests/reference`). `cargo test --release stiff -- --nocapture` prints the table.

use std::time::Instant;

use glam::{DVec2, DVec3};
use isoplanat::lens::{Aperture, Element, Lens, Medium, Pose, Shape, Surface, Xy, Zernike, builtin, unchecked};
use isoplanat::trace::aim::Aimer;
use isoplanat::trace::exact::{Answer, Request, answer_in};
use isoplanat::trace::first_root::crossings;
use isoplanat::trace::intersect::intersect;
use isoplanat::trace::lanes::{Level, Options, Program, Rays};
use isoplanat::trace::sequential::{Hit, trace};
use isoplanat::trace::system::TraceSurface;
use isoplanat::trace::{Cause, ObjectPoint, Ray, System};
use serde_json::Value;

use crate::support::root;

const NM: f64 = 550.0;

fn suite() -> Value {
    let path = root().join("tests/reference/trace_suite.json");
    serde_json::from_slice(&std::fs::read(path).expect("the reference is part of the project")).expect("JSON")
}

fn list(v: &Value) -> &[Value] {
    v.as_array().map_or(&[], Vec::as_slice)
}

fn number(v: &Value) -> f64 {
    v.as_f64().expect("a number")
}

fn vector(v: &Value) -> DVec3 {
    DVec3::new(number(&v[0]), number(&v[1]), number(&v[2]))
}

fn size(v: &Value) -> usize {
    usize::try_from(v.as_u64().expect("a count")).expect("small")
}

fn pose(v: &Value) -> Option<Pose> {
    let (tilt, decentre) = (v.get("tilt_deg"), v.get("decentre_mm"));
    (tilt.is_some() || decentre.is_some()).then(|| Pose {
        decentre: decentre.map_or([0.0; 2], |d| [number(&d[0]), number(&d[1])]),
        tilt: tilt.map_or([0.0; 3], |t| vector(t).to_array().map(f64::to_radians)),
    })
}

/// What the schema of `tests/reference/README.md` lets a surface state.
const SURFACE: [&str; 11] = [
    "curvature",
    "conic",
    "thickness",
    "index_after",
    "semi_diameter",
    "stop",
    "asphere",
    "zernike",
    "xy",
    "tilt_deg",
    "decentre_mm",
];

fn shape(s: &Value) -> Shape {
    // A form that this reader does not know is not the reference's surface.
    let unknown = s.as_object().into_iter().flatten().map(|(key, _)| key).find(|key| !SURFACE.contains(&key.as_str()));
    assert_eq!(unknown, None, "a key of a surface that this reader does not know");
    let mut shape = Shape { curvature: number(&s["curvature"]), conic: number(&s["conic"]), ..Shape::default() };
    if let Some(terms) = s.get("asphere").and_then(Value::as_object) {
        for (key, value) in terms {
            let power: usize = key[1..].parse().expect("a power");
            let terms = if power.is_multiple_of(2) { &mut shape.asphere } else { &mut shape.odd };
            terms.resize(terms.len().max(power / 2), 0.0);
            terms[power / 2 - 1] = number(value);
        }
    }
    if let Some(z) = s.get("zernike").filter(|z| !z.is_null()) {
        shape.zernike = Some(Zernike::new(number(&z["radius_mm"]), list(&z["terms"]).iter().map(number).collect()));
    }
    if let Some(p) = s.get("xy").filter(|p| !p.is_null()) {
        let terms: Vec<(usize, usize, f64)> = p["terms"]
            .as_object()
            .expect("terms")
            .iter()
            .map(|(key, c)| {
                let (i, j) = key[1..].split_once('y').expect("x<i>y<j>");
                (i.parse().expect("a power"), j.parse().expect("a power"), number(c))
            })
            .collect();
        shape.xy = Some(Xy::new(number(&p["radius_mm"]), &terms));
    }
    shape
}

/// The lens of a case, and the index before it.
pub(crate) fn lens(case: &Value) -> (Lens, f64) {
    let surfaces: Vec<Surface> = list(&case["surfaces"])
        .iter()
        .map(|s| Surface {
            shape: shape(s),
            thickness: number(&s["thickness"]),
            medium: Medium::Table { wavelength_nm: vec![NM], index: vec![number(&s["index_after"])] },
            semi_diameter: number(&s["semi_diameter"]),
            pose: pose(s),
        })
        .collect();
    let elements = list(&case["elements"])
        .iter()
        .map(|e| Element {
            first: size(&e["first"]),
            last: size(&e["last"]),
            pose: pose(e).unwrap_or_default(),
            pivot: e.get("pivot_mm").map_or(0.0, number),
        })
        .collect();
    let stop = list(&case["surfaces"]).iter().position(|s| s["stop"] == true).unwrap_or(0);
    let lens = unchecked(&builtin::lens("cooke_triplet").expect("shipped"), |lens| {
        lens.aperture = Aperture::StopSemiDiameter(surfaces[stop].semi_diameter);
        (lens.surfaces, lens.elements, lens.stop) = (surfaces, elements, stop);
        lens.object_vergence = 0.0;
        lens.wavelengths.primary_nm = NM;
    });
    (lens, number(&case["index_before"]))
}

fn system(case: &Value) -> (Lens, System) {
    let (lens, before) = lens(case);
    let mut system = System::new(&lens, NM);
    system.surfaces[0].index_before = before;
    (lens, system)
}

#[derive(Default)]
struct Worst {
    position: f64,
    direction: f64,
    path: f64,
    gradient: f64,
    allowed: f64,
    evaluations: u32,
}

/// A surface with a key that the reader does not know is refused, not read without it.
#[test]
#[should_panic(expected = "does not know")]
fn stiff_surfaces_of_unknown_forms_are_refused() {
    shape(&serde_json::json!({ "curvature": 0.1, "conic": 0.0, "superconic": { "s4": 1.0 } }));
}

/// Outcome by outcome, number by number.
#[test]
fn stiff_cases_agree_with_sixty_digits() {
    let suite = suite();
    eprintln!(
        "{:26} {:>20} {:>9} {:>9} {:>9} {:>9} {:>6} {:>7} {:>9}",
        "case", "outcome", "mm", "allowed", "direction", "path/mm", "evals", "µs/ray", "gradient"
    );
    let mut failed = Vec::new();
    for case in list(&suite["cases"]) {
        let name = case["name"].as_str().expect("a name");
        let (lens, system) = system(case);
        let rays = list(&case["rays"]);
        let mut outcome = std::collections::BTreeMap::<&str, usize>::new();
        let mut worst = Worst::default();
        let mut hits = Vec::new();
        let length: f64 = lens.length().abs().max(1.0);
        for (number_of, r) in rays.iter().enumerate() {
            let expected = r["status"].as_str().expect("a status");
            *outcome.entry(expected).or_default() += 1;
            let ray = Ray { origin: vector(&r["origin"]), direction: vector(&r["direction"]).normalize() };
            let got = trace(&system, ray, system.image(), &mut hits);
            let status = match got {
                Ok(_) => ("ok", None),
                Err(f) => (
                    match f.cause {
                        Cause::Missed => "missed",
                        Cause::TotalReflection => "total_reflection",
                        Cause::NotConverged => "not_converged",
                        Cause::Vignetted => "vignetted",
                    },
                    Some(f.surface),
                ),
            };
            let surface = r.get("surface").filter(|s| !s.is_null()).map(size);
            if status != (expected, surface) {
                failed.push(format!("{name}, ray {number_of}: {status:?} instead of {expected} {surface:?}"));
                continue;
            }
            // What the inputs' own rounding does to the landing, from the reference.
            let rounding = r.get("rounding_mm").and_then(Value::as_f64).unwrap_or(0.0);
            let allowed = (1e-12 * length).max(1e-15 * ray.origin.length()) + 4.0 * rounding;
            worst.allowed = worst.allowed.max(allowed);
            for (i, (hit, row)) in hits.iter().zip(list(&r["rows"])).enumerate() {
                let position = (hit.at.point - vector(row)).length();
                let direction =
                    (hit.direction - DVec3::new(number(&row[3]), number(&row[4]), number(&row[5]))).length();
                let path = (hit.optical_path - number(&row[6])).abs();
                worst.position = worst.position.max(position);
                worst.direction = worst.direction.max(direction);
                worst.path = worst.path.max(path);
                worst.evaluations = worst.evaluations.max(hit.at.evaluations);
                let direction_allowed = 1e-13 + 4.0 * rounding / length.min(1.0);
                if position > allowed || direction > direction_allowed || path > 4.0 * allowed {
                    failed.push(format!("{name}, ray {number_of}, surface {i}: {position:e} {direction:e} {path:e}"));
                }
            }
            if let Some(reference) = r.get("gradient") {
                let error = gradient_error(&lens, &system, &vector(&r["origin"]), ray.direction, reference);
                worst.gradient = worst.gradient.max(error);
                // cos² of refraction and 1 − αρ are differences from 1: near total reflection and near the conic's edge
                // the inputs' rounding is this share of them, and so of every derivative.
                let nearest = closest_to_the_edge(&system, &hits);
                let allowed = 1e-9 + 64.0 * rounding / length + 64.0 * f64::EPSILON / nearest;
                if error > allowed {
                    failed.push(format!("{name}, ray {number_of}: gradient {error:e} instead of {allowed:e}"));
                }
            }
        }
        let start = Instant::now();
        let mut traced = 0u32;
        while start.elapsed().as_secs_f64() < 0.002 {
            for r in rays {
                let ray = Ray { origin: vector(&r["origin"]), direction: vector(&r["direction"]).normalize() };
                std::hint::black_box(trace(&system, ray, system.image(), &mut hits).is_ok());
                traced += 1;
            }
        }
        let micro = start.elapsed().as_secs_f64() * 1e6 / f64::from(traced);
        let outcome: Vec<String> = outcome.iter().map(|(k, v)| format!("{v} {k}")).collect();
        let w = &worst;
        eprintln!(
            "{name:26} {:>20} {:9.1e} {:9.1e} {:9.1e} {:9.1e} {:6} {micro:7.2} {:9.1e}",
            outcome.join(", "),
            w.position,
            w.allowed,
            w.direction,
            w.path,
            w.evaluations,
            w.gradient
        );
    }
    assert!(failed.is_empty(), "{} of the suite's numbers fall short:\n{}", failed.len(), failed.join("\n"));
}

/// The same cases through every instruction set of the fast trace: outcome, landing, direction, optical path.
#[test]
fn stiff_cases_go_through_the_lanes_alike() {
    let suite = suite();
    let mut failed = Vec::new();
    for level in Level::available() {
        let (mut count, mut worst) = (0, 0.0f64);
        for case in list(&suite["cases"]) {
            let name = case["name"].as_str().expect("a name");
            let (lens, system) = system(case);
            let length = lens.length().abs().max(1.0);
            let expected = list(&case["rays"]);
            let ray = |r: &Value| Ray { origin: vector(&r["origin"]), direction: vector(&r["direction"]).normalize() };
            let mut rays: Rays = expected.iter().map(ray).collect();
            let mut paths = vec![0.0; rays.len()];
            let options = Options { path: true, level: Some(level), ..Options::default() };
            let statuses = Program::new(&system, options).trace_batch(&mut rays, Some(&mut paths));
            for (i, (r, status)) in expected.iter().zip(&statuses).enumerate() {
                count += 1;
                let ok = r["status"] == "ok";
                let surface = r.get("surface").filter(|s| !s.is_null()).map(size);
                if status.is_none() != ok || status.map(|f| f.surface) != surface {
                    failed.push(format!("{level:?}, {name}, ray {i}: {status:?} instead of {}", r["status"]));
                }
                if !ok || status.is_some() {
                    continue;
                }
                let rounding = r.get("rounding_mm").and_then(Value::as_f64).unwrap_or(0.0);
                let allowed = (1e-12 * length).max(1e-15 * ray(r).origin.length()) + 4.0 * rounding;
                let row = list(&r["rows"]).last().expect("the image plane");
                let landed = rays.ray(i);
                let off = (landed.origin - vector(row)).length();
                let direction = DVec3::new(number(&row[3]), number(&row[4]), number(&row[5]));
                let turned = (landed.direction - direction).length();
                let path = (paths[i] - number(&row[6])).abs();
                worst = worst.max(off / allowed);
                if off > allowed || turned > 1e-13 + 4.0 * rounding / length.min(1.0) || path > 4.0 * allowed {
                    failed
                        .push(format!("{level:?}, {name}, ray {i}: {off:e} {turned:e} {path:e}, {allowed:e} allowed"));
                }
            }
        }
        eprintln!("{level:?}: {count} stiff rays, worst landing {worst:.2} of what is allowed");
    }
    assert!(failed.is_empty(), "{} of the suite's numbers fall short:\n{}", failed.len(), failed.join("\n"));
}

/// Least `cos²` of refraction and least `1 − αρ` over a ray's surfaces.
fn closest_to_the_edge(system: &System, hits: &[Hit]) -> f64 {
    hits.iter().zip(&system.surfaces).fold(1.0f64, |least, (hit, s)| {
        let slope = DVec3::new(hit.at.local.slope[0], hit.at.local.slope[1], -1.0);
        let cosine = slope.dot(hit.incoming) / slope.length();
        let mu = s.index_before / s.index_after;
        least.min(1.0 - mu * mu * (1.0 - cosine * cosine)).min(hit.at.local.sag.phi.powi(2))
    })
}

/// Worst error of the landing's derivatives, each relative to its own length.
fn gradient_error(lens: &Lens, system: &System, origin: &DVec3, direction: DVec3, reference: &Value) -> f64 {
    let request = Request {
        wavelength_nm: NM,
        rays: vec![isoplanat::trace::exact::RequestRay {
            origin_mm: origin.to_array(),
            direction: direction.to_array(),
        }],
    };
    let Answer { rays } = answer_in(lens, system, &request, false, true);
    let got = rays[0].gradient.as_ref().expect("the ray arrives");
    let mut worst = 0.0f64;
    for entry in list(reference) {
        let parameter = entry["parameter"].as_str().expect("a name");
        let found = got.iter().find(|g| g.parameter == parameter);
        let found = found.unwrap_or_else(|| panic!("{parameter} is not among the derivatives"));
        let (dx, dy) = (number(&entry["dx"]), number(&entry["dy"]));
        let error = (found.dx - dx).hypot(found.dy - dy);
        let length = dx.hypot(dy);
        // A derivative that is zero by symmetry is compared with one micrometre a unit.
        let relative = error / length.max(1e-3);
        if relative > 1e-6 {
            eprintln!("  {parameter}: ({:e}, {:e}) instead of ({dx:e}, {dy:e})", found.dx, found.dy);
        }
        worst = worst.max(relative);
    }
    worst
}

/// First roots and all crossings of random surfaces against all roots of the ray–surface polynomial.
#[test]
fn stiff_first_roots_are_those_of_the_polynomial() {
    let suite = suite();
    let surfaces: Vec<TraceSurface> = list(&suite["roots"]["surfaces"])
        .iter()
        .map(|s| TraceSurface::new(shape(s), 0.0, [1.0, 1.5], number(&s["semi_diameter"])))
        .collect();
    let (mut met, mut missed, mut several, mut worst) = (0, 0, 0, 0.0f64);
    for (i, r) in list(&suite["roots"]["rays"]).iter().enumerate() {
        let surface = &surfaces[size(&r["surface"])];
        let (origin, direction) = (vector(&r["origin"]), vector(&r["direction"]).normalize());
        let got = intersect(surface, origin, direction);
        match r["first"].as_f64() {
            Some(t) => {
                met += 1;
                let got = got.unwrap_or_else(|c| panic!("ray {i}: {c:?}, the polynomial has {t}"));
                let error = (got.t - t).abs() / (1.0 + t.abs());
                worst = worst.max(error);
                assert!(error < 1e-11, "ray {i}: {} against {t}", got.t);
                // Every crossing we list is a root of the polynomial.
                let roots: Vec<f64> = list(&r["down"]).iter().chain(list(&r["up"])).map(number).collect();
                let listed = crossings(surface, origin, direction).expect("settles");
                several += usize::from(listed.len() > 1);
                for t in listed {
                    let near = roots.iter().any(|x| (x - t).abs() < 1e-9 * (1.0 + t.abs()));
                    assert!(near, "ray {i}: {t} is no root, those are {roots:?}");
                }
            }
            None => {
                missed += 1;
                assert_eq!(got.err(), Some(Cause::Missed), "ray {i}");
            }
        }
    }
    eprintln!("{met} rays meet, {several} of them more than once, {missed} miss; worst first root {worst:e} relative");
    assert!(met > 50 && missed > 10 && several > 10);
}

/// Rays aimed at the real stop: fields of 0 to 95°, stops before, between and behind, objects at 1 mm and far away.
#[test]
fn stiff_aims_agree_with_sixty_digits() {
    let suite = suite();
    eprintln!("{:18} {:>5} {:>10} {:>10} {:>10} {:>6}", "case", "rays", "ray/mm", "landing/mm", "residual", "traced");
    let mut failed = Vec::new();
    for case in list(&suite["cases"]).iter().filter(|c| !list(&c["aim"]).is_empty()) {
        let name = case["name"].as_str().expect("a name");
        let (lens, system) = system(case);
        let aimer = Aimer::new(&system).expect("the stop is a surface");
        let length = lens.length();
        let (mut worst, mut traced, mut hits) = ([0.0f64; 3], 0, Vec::new());
        for (i, a) in list(&case["aim"]).iter().enumerate() {
            let (origin, direction) = (vector(&a["origin"]), vector(&a["direction"]).normalize());
            let angle = number(&a["field_deg"]).to_radians();
            let object = match a["object_distance"].as_f64() {
                // Light comes with direction (0, sin, cos).
                None => ObjectPoint::from_angle(angle, std::f64::consts::FRAC_PI_2, 0.0),
                // The object itself is the ray's origin.
                Some(_) => ObjectPoint::finite(origin),
            };
            let target = DVec2::new(number(&a["stop_target"][0]), number(&a["stop_target"][1]));
            let aimed = match aimer.aim(object, target, None) {
                Ok(aimed) => aimed,
                Err(f) => {
                    failed.push(format!("{name}, aim {i}: {f:?}"));
                    continue;
                }
            };
            // Distance of the two lines, at the reference's origin.
            let apart = aimed.ray.origin - origin;
            let off = (apart - direction * direction.dot(apart)).length() + (aimed.ray.direction - direction).length();
            let landing = trace(&system, aimed.ray, system.image(), &mut hits).map(|h| h.at.point);
            let landing = landing.map_or(f64::INFINITY, |p| {
                (p - DVec3::new(number(&a["landing"][0]), number(&a["landing"][1]), p.z)).length()
            });
            worst = [worst[0].max(off), worst[1].max(landing), worst[2].max(aimed.residual)];
            traced = traced.max(aimed.iterations);
            if off > 1e-11 * length || landing > 1e-11 * length || aimed.residual > 1e-11 {
                failed.push(format!("{name}, aim {i}: {off:e} {landing:e} {:e}", aimed.residual));
            }
        }
        let count = list(&case["aim"]).len();
        eprintln!("{name:18} {count:5} {:10.1e} {:10.1e} {:10.1e} {traced:6}", worst[0], worst[1], worst[2]);
    }
    assert!(failed.is_empty(), "{} aims fall short:\n{}", failed.len(), failed.join("\n"));
}

/// Any bits as numbers: a ray either arrives with finite numbers or fails as data; nothing panics.
#[test]
fn stiff_nonsense_is_data() {
    let rng = &mut fastrand::Rng::with_seed(7);
    let wild = |rng: &mut fastrand::Rng| match rng.u8(..6) {
        0 => f64::from_bits(rng.u64(..)),
        1 => [0.0, -0.0, 1.0, -1.0, f64::MAX, f64::MIN_POSITIVE, f64::INFINITY, f64::NAN][rng.usize(..8)],
        2 => (rng.f64() - 0.5) * 1e-3,
        _ => (rng.f64() - 0.5) * 20.0,
    };
    let finite = |rng: &mut fastrand::Rng| loop {
        let x = wild(rng);
        if x.is_finite() {
            break x;
        }
    };
    let (mut arrived, mut failed) = (0, 0);
    let mut hits = Vec::new();
    for _ in 0..20_000 {
        let surfaces = 1 + rng.usize(..3);
        let mut system = System::new(&builtin::lens("cooke_triplet").expect("shipped"), NM);
        system.surfaces.truncate(surfaces);
        for s in &mut system.surfaces {
            let mut shape = Shape { curvature: finite(rng) * 0.01, conic: finite(rng), ..Shape::default() };
            shape.asphere = (0..rng.usize(..4)).map(|_| finite(rng) * 1e-3).collect();
            shape.odd = (0..rng.usize(..2)).map(|_| finite(rng) * 1e-3).collect();
            let indices = [1.0 + rng.f64(), 1.0 + rng.f64()];
            *s = TraceSurface::new(shape, finite(rng), indices, finite(rng).abs().max(1e-300));
        }
        let ray = Ray {
            origin: DVec3::new(wild(rng), wild(rng), wild(rng)),
            direction: DVec3::new(wild(rng), wild(rng), wild(rng)).normalize(),
        };
        match trace(&system, ray, system.image(), &mut hits) {
            Ok(hit) => {
                arrived += 1;
                assert!(hit.at.point.is_finite() && hit.direction.is_finite(), "{hit:?}");
            }
            Err(f) => {
                failed += 1;
                assert!(f.surface <= system.image() && hits.len() == f.surface);
            }
        }
    }
    eprintln!("{arrived} rays through nonsense arrive, {failed} fail");
    assert!(arrived > 500 && failed > 5000, "{arrived} {failed}");
}
