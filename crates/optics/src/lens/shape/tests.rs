//! What a shape says of itself, form by form: every answer against the sag, every gradient against differences.

use super::*;
use crate::lens::test_lenses::{every_kind, forms, moved, numbers, open_forms, with_number, with_radius};
use crate::lens::{Medium, Parameter, Surface, builtin, prescription};
use isoplanat_base::testing::{assert_rel, between, central_difference};

/// Clear semi-diameter, mm.
const RADIUS: f64 = 8.0;
/// Size of the terms.
const SIZE: f64 = 0.01;

/// Every form, of `seeds` draws.
fn drawn(seeds: u64) -> impl Iterator<Item = (String, Shape)> {
    (0..seeds).flat_map(|seed| {
        let all = forms(&mut fastrand::Rng::with_seed(seed), RADIUS, SIZE);
        all.into_iter().map(move |(name, shape)| (format!("{name} {seed}"), shape))
    })
}

/// Places all over the clear aperture: the axis, and rings of eleven.
fn places() -> impl Iterator<Item = [f64; 2]> {
    (0..=20).flat_map(|ring| {
        (0..11).map(move |k| {
            let (r, t) = (RADIUS * f64::from(ring) / 20.0, std::f64::consts::TAU * f64::from(k) / 11.0);
            [r * t.cos(), r * t.sin()]
        })
    })
}

/// Largest difference of sag between two shapes, mm.
fn apart(a: &Shape, b: &Shape) -> f64 {
    let sag = |s: &Shape, [x, y]: [f64; 2]| s.at(x, y).expect("inside").h;
    places().map(|p| (sag(a, p) - sag(b, p)).abs()).fold(0.0, f64::max)
}

/// Least difference that is one, mm: far above rounding, far below any term.
const APART: f64 = 1e-9;

/// The tests draw from [`forms`]: each kind of number of a shape stands alone on a conic there.
#[test]
fn every_kind_of_number_has_a_form_of_its_own() {
    let all = forms(&mut fastrand::Rng::with_seed(0), RADIUS, SIZE);
    for kind in Kind::ALL.into_iter().filter(|kind| kind.is_shape()) {
        let base = [Kind::Curvature, Kind::Conic, kind];
        let alone = |shape: &Shape| Kind::ALL.iter().all(|k| base.contains(k) || k.of_shape(shape).is_empty());
        let has = all.iter().any(|(_, shape)| !kind.of_shape(shape).is_empty() && alone(shape));
        assert!(has, "{kind:?} stands alone in no item of `test_lenses::forms`");
    }
}

/// Turned around twice a shape is itself; from the other side its sag is the negative one.
#[test]
fn forms_turn_around() {
    for (name, shape) in drawn(5) {
        let turned = shape.reversed();
        assert_eq!(turned.reversed(), shape, "{name}");
        assert_eq!(turned.ideal_power(), shape.ideal_power(), "{name}");
        for [x, y] in places() {
            let [a, b] = [&shape, &turned].map(|s| s.at(x, y).expect("inside"));
            assert_eq!((b.h, b.slope), (-a.h, a.slope.map(|s| -s)), "{name} at ({x}, {y})");
            assert_eq!(b.second, a.second.map(|s| -s), "{name} at ({x}, {y})");
        }
    }
}

/// Whether a form is symmetric, aspheric, even: as its sag says.
#[test]
fn what_forms_are_is_what_their_sag_says() {
    for (name, shape) in drawn(5) {
        let sag = |x: f64, y: f64| shape.at(x, y).expect("inside").h;
        let round = places().all(|[x, y]| (sag(x, y) - sag(x.hypot(y), 0.0)).abs() < APART);
        assert_eq!(shape.is_symmetric(), round, "{name}: symmetric");
        let part = shape.clone().symmetric_part();
        assert!(part.is_symmetric(), "{name}: the symmetric part");
        assert!(!round || part == shape, "{name}: a symmetric form is its own symmetric part");
        for [x, y] in places() {
            assert_eq!(part.at(x, y).expect("inside").h, shape.sag(x * x + y * y).expect("inside").h, "{name}");
        }
        let conic = Shape { curvature: shape.curvature, conic: shape.conic, ..Shape::default() };
        assert_eq!(shape.is_aspheric(), apart(&shape, &conic) > APART, "{name}: aspheric");
        let even = Shape { asphere: shape.asphere.clone(), ..conic };
        let refracts = shape.ideal_power().is_none();
        let count = shape.asphere.len();
        assert_eq!(shape.is_even(count), refracts && apart(&shape, &even) < APART, "{name}: even");
        assert!(count == 0 || !shape.is_even(count - 1), "{name}: fewer terms");
    }
}

/// The rotational part is its conic with [`Shape::terms`], and its second and fourth powers of `r` are those of a polynomial fitted to it.
#[test]
fn powers_of_the_rotational_part_are_those_of_its_sag() {
    for (name, shape) in drawn(5).filter(|(_, shape)| shape.ideal.is_none()) {
        for ring in 0..=20 {
            let r = RADIUS * f64::from(ring) / 20.0;
            let sag = shape.sag(r * r).expect("inside");
            let terms: f64 = shape.terms().map(|(power, a)| a * r.powi(power as i32)).sum();
            assert!((sag.conic_h + terms - sag.h).abs() < 1e-13, "{name} at {r}: the terms");
        }
        // Nearly flat, so that a polynomial of the twelfth degree is all of it.
        let flat = Shape { curvature: 0.01, conic: 0.5, ..shape };
        let count = 13;
        let at = |k: usize| k as f64 / (count - 1) as f64;
        let powers = nalgebra::DMatrix::from_fn(count, count, |k, p| at(k).powi(p as i32));
        let sags = nalgebra::DVector::from_fn(count, |k, _| flat.sag((RADIUS * at(k)).powi(2)).expect("inside").h);
        let fitted = powers.lu().solve(&sags).expect("as many places as powers");
        for (power, found) in [(2, 0.5 * flat.vertex_curvature()), (4, flat.quartic())] {
            let off = (fitted[power] - found * RADIUS.powi(power as i32)).abs();
            assert!(off < 1e-7, "{name}, r^{power}: {} mm at the rim, off by {off:e}", fitted[power]);
        }
    }
}

/// The bound of slopes holds all over a dense raster, and is not far above the largest one.
#[test]
fn steepest_bounds_every_slope() {
    for (name, shape) in drawn(60) {
        let bound = shape.steepest(RADIUS);
        let slopes = places().map(|[x, y]| shape.at(x, y).expect("inside").slope);
        let largest = slopes.map(|s| s[0].hypot(s[1])).fold(0.0, f64::max);
        assert!(bound >= largest, "{name}: {bound} {largest}");
        // Terms of a freeform are bounded each for itself.
        let share = if shape.is_symmetric() { 1.3 } else { 20.0 };
        assert!(bound <= share * largest + 0.2, "{name}: {bound} {largest}");
    }
}

/// Of few freeform terms that are small beside the rest it is near, too.
#[test]
fn the_bound_of_small_freeforms_is_near() {
    for seed in 0..60 {
        let rng = &mut fastrand::Rng::with_seed(seed);
        let mut draw = |w: f64| between(rng, -w, w);
        let mut shape = Shape { curvature: draw(0.08), conic: draw(1.0), ..Shape::default() };
        if seed % 4 > 0 {
            shape.asphere = vec![draw(1e-3), draw(1e-4), draw(1e-6)];
        }
        if seed % 4 > 1 {
            shape.odd = vec![draw(1e-3), draw(1e-5)];
        }
        if seed % 4 > 2 {
            shape.zernike = Some(Zernike::new(RADIUS, (0..10).map(|_| draw(1e-2)).collect()));
        }
        let bound = shape.steepest(RADIUS);
        let slopes = (0..200u32).flat_map(|i| (0..8u32).map(move |k| (RADIUS * f64::from(i) / 199.0, f64::from(k))));
        let slopes = slopes.map(|(r, t)| shape.at(r * t.cos(), r * t.sin()).expect("inside").slope);
        let largest = slopes.map(|s| s[0].hypot(s[1])).fold(0.0, f64::max);
        assert!(bound >= largest, "seed {seed}: {bound} {largest}");
        assert!(bound <= 1.3 * largest + 0.2, "seed {seed}: {bound} {largest}");
    }
}

/// A number that is none has no bound, whichever it is.
#[test]
fn nothing_bounds_what_is_no_number() {
    for (name, shape) in drawn(1) {
        for entry in 0..numbers(&shape).len() {
            let (kind, bad) = with_number(&shape, entry, |_| f64::NAN);
            // An ideal lens is flat, whatever its focal length.
            let flat = kind == Kind::IdealFocalLength;
            assert_eq!(
                bad.steepest(RADIUS),
                if flat { 0.0 } else { f64::INFINITY },
                "{name}: {kind:?}, number {entry}"
            );
        }
    }
}

/// A normalising radius that is none, or far from the clear semi-diameter, is refused of every form that has one.
#[test]
fn normalising_radii_are_positive_lengths() {
    let lens = builtin::lens("two_element").expect("shipped");
    let radius = lens.surfaces[0].semi_diameter;
    let (_, together) = forms(&mut fastrand::Rng::with_seed(0), radius, 1e-3).pop().expect("several");
    let put = |shape: Shape| lens.changed(|l| l.surfaces[0].shape = Shape { conic: 0.3, ..shape });
    put(together.clone()).expect("a lens");
    let bad = [f64::NAN, 0.0, -0.0, -radius, f64::INFINITY, f64::NEG_INFINITY, 1e-4 * radius, 1e4 * radius];
    for value in bad {
        let shapes = with_radius(&together, value);
        assert_eq!(shapes.len(), 2);
        for shape in shapes {
            let error = put(shape).expect_err("no radius").to_string();
            assert!(error.contains(".radius_mm: ") && error.contains("1/1000 to 1000"), "{value}: {error}");
        }
    }
}

/// ⟨h̄, J dθ⟩ of every rotational form, by all of its numbers and the place, against fourth-order differences.
#[test]
fn sag_vjp_is_the_transpose_of_the_jacobian() {
    for seed in 0..40 {
        let rng = &mut fastrand::Rng::with_seed(seed);
        let (all, steps) = (forms(rng, RADIUS, SIZE), forms(rng, RADIUS, SIZE));
        for ((name, shape), (_, step)) in all.into_iter().zip(steps).filter(|((_, s), _)| s.is_symmetric()) {
            let (rho, d_rho) = (between(rng, 0.0, 60.0), between(rng, -1.0, 1.0));
            let sag = shape.sag(rho).expect("inside");
            let mut bar = shape.zeros_like();
            shape.sag_vjp(rho, &sag, 1.0, 100.0, &mut bar);
            let pulled: f64 = numbers(&bar).iter().zip(numbers(&step)).map(|(a, b)| a * b).sum();
            let pulled = pulled + d_rho * (sag.h1 + 100.0 * sag.h2);
            let at = |t: f64| {
                let v = moved(&shape, &step, t).sag(rho + t * d_rho).expect("inside");
                v.h + 100.0 * v.h1
            };
            assert_rel(pulled, central_difference(at, 1e-3), 1e-8, 1e-3, &format!("{name} {seed}"));
        }
    }
}

/// Every number of every form, and the place, against differences of value and slope.
#[test]
fn at_vjp_is_the_transpose_of_the_jacobian() {
    for seed in 0..20 {
        let rng = &mut fastrand::Rng::with_seed(seed);
        let (all, steps) = (forms(rng, RADIUS, SIZE), forms(rng, RADIUS, SIZE));
        for ((name, shape), (_, step)) in all.into_iter().zip(steps) {
            let [x, y, dx, dy] = [5.0, 5.0, 1.0, 1.0].map(|w| between(rng, -w, w));
            let bars = [between(rng, -1.0, 1.0), between(rng, -9.0, 9.0), between(rng, -9.0, 9.0)];
            let local = shape.at(x, y).expect("inside");
            let mut bar = shape.zeros_like();
            shape.at_vjp(x, y, &local, bars[0], [bars[1], bars[2]], &mut bar);
            let pulled = numbers(&bar).iter().zip(numbers(&step)).map(|(a, b)| a * b).sum::<f64>()
                + dx * (bars[0] * local.slope[0] + bars[1] * local.second[0] + bars[2] * local.second[1])
                + dy * (bars[0] * local.slope[1] + bars[1] * local.second[1] + bars[2] * local.second[2]);
            let at = |t: f64| {
                let l = moved(&shape, &step, t).at(x + t * dx, y + t * dy).expect("inside");
                bars[0] * l.h + bars[1] * l.slope[0] + bars[2] * l.slope[1]
            };
            assert_rel(pulled, central_difference(at, 1e-3), 1e-8, 1e-3, &format!("{name} {seed}"));
        }
    }
}

/// A file keeps every form to the last bit.
#[test]
fn files_keep_every_form() {
    let lens = builtin::lens("two_element").expect("shipped");
    for (name, shape) in drawn(3) {
        // Behind the lens, in air, where an ideal one may stand too.
        let with = lens.changed(|l| {
            let last = l.surfaces.last_mut().expect("several");
            last.thickness -= 15.0;
            let surface = Surface { shape, thickness: 15.0, medium: Medium::Air, semi_diameter: RADIUS, pose: None };
            l.surfaces.push(surface);
        });
        let with = with.unwrap_or_else(|e| panic!("{name}: {e}"));
        let text = prescription::to_toml(&with);
        let read = prescription::from_toml(&text, "lens.toml").unwrap_or_else(|e| panic!("{name}: {e}\n{text}"));
        assert_eq!(read.surfaces.last(), with.surfaces.last(), "{name}");
        assert_eq!(read, with, "{name}");
    }
}

/// The reference of sixty digits has a derivative by every kind of number that a design moves in a shape.
#[test]
fn the_reference_has_every_kind_of_number_of_a_shape() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/reference/trace_suite.json");
    let text = std::fs::read(path).expect("the reference is part of the project");
    let suite: serde_json::Value = serde_json::from_slice(&text).expect("JSON");
    let list = |v: &serde_json::Value| v.as_array().cloned().unwrap_or_default();
    let rays = list(&suite["cases"]).into_iter().flat_map(|case| list(&case["rays"]));
    let gradients = rays.flat_map(|ray| list(&ray["gradient"]));
    let stated: std::collections::BTreeSet<String> = gradients
        .filter_map(|g| g["parameter"].as_str()?.split_once("].").map(|(_, number)| number.to_owned()))
        .collect();
    let lenses = every_kind().all();
    for kind in Kind::ALL.into_iter().filter(|kind| kind.is_shape() && kind.is_free()) {
        let known = |lens: &crate::lens::Lens| {
            let mut own = Parameter::all(lens).filter(|p| p.kind == kind);
            own.any(|p| p.name(lens).split_once("].").is_some_and(|(_, number)| stated.contains(number)))
        };
        assert!(lenses.iter().any(known), "{kind:?} has no derivative in tests/reference/trace_suite.json");
    }
}

/// Forms with terms are there to be drawn from, and nothing without.
#[test]
fn open_forms_are_those_with_terms() {
    let rng = &mut fastrand::Rng::with_seed(0);
    assert!(open_forms(rng, RADIUS, SIZE).iter().all(|(_, shape)| shape.is_aspheric()));
    let closed = forms(rng, RADIUS, SIZE).into_iter().filter(|(_, shape)| !shape.is_aspheric()).count();
    assert_eq!(closed, crate::lens::test_lenses::CLOSED.len());
}

/// [`Shape::vertex_curvature_vjp`] against the sag's own slope at the vertex: `h ≈ (c + 2a₂) ρ/2`.
#[test]
fn vertex_curvature_vjp_is_the_transpose_of_the_jacobian() {
    let shape = Shape::even(0.02, -0.7, vec![3e-3, 1e-5]);
    assert_rel(shape.vertex_curvature(), 2.0 * shape.sag(0.0).expect("inside").h1, 1e-15, 0.0, "the vertex");
    let mut bar = shape.zeros_like();
    Shape::vertex_curvature_vjp(1.5, &mut bar);
    for (k, found) in [(0, bar.curvature), (1, bar.conic), (2, bar.asphere[0]), (3, bar.asphere[1])] {
        let moved = |t: f64| {
            let mut moved = shape.clone();
            match k {
                0 => moved.curvature += t,
                1 => moved.conic += t,
                k => moved.asphere[k - 2] += t,
            }
            1.5 * 2.0 * moved.sag(0.0).expect("inside").h1
        };
        assert_rel(found, central_difference(moved, 1e-3), 1e-9, 1e-9, "number");
    }
    // A shape without even terms has none to write to.
    let mut bar = Shape::sphere(0.0);
    Shape::vertex_curvature_vjp(2.0, &mut bar);
    assert_eq!(bar, Shape::sphere(2.0));
}

/// [`Shape::power_vjp`] and [`Shape::ideal_power_vjp`] against differences of every number that a power has.
#[test]
fn power_vjp_is_the_transpose_of_the_jacobian() {
    let refracting = Shape { curvature: 0.02, asphere: vec![1e-3], ..Shape::default() };
    for shape in [refracting, Shape { ideal: Some(-70.0), ..Shape::default() }] {
        let (n, n1) = (1.2, 1.7);
        let mut bar = shape.zeros_like();
        let [before, behind] = shape.power_vjp(n, n1, 1.5, &mut bar);
        let mut alone = shape.zeros_like();
        shape.ideal_power_vjp(1.5, &mut alone);
        assert!(shape.ideal.is_none() || alone == bar);
        let moved = |t: f64| {
            let step = |x: f64, by: f64| x + t * by;
            let s = Shape {
                curvature: step(shape.curvature, 1e-3),
                asphere: shape.asphere.iter().map(|a| step(*a, 1e-4)).collect(),
                ideal: shape.ideal.map(|f| step(f, 1.0)),
                ..Shape::default()
            };
            1.5 * s.power(step(n, 0.1), step(n1, -0.2))
        };
        let pulled =
            1e-3 * bar.curvature + 1e-4 * bar.asphere.iter().sum::<f64>() + bar.ideal.unwrap_or(0.0) + 0.1 * before
                - 0.2 * behind;
        assert_rel(pulled, central_difference(moved, 1e-3), 1e-9, 1e-6, "power");
    }
}
