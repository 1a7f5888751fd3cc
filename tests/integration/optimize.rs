//! Lenses made better: against another program's residuals, from hopeless starts, with every kind of end.

use isoplanat::lens::{Aperture, Kind, Lens, Medium, Parameter, Prescription, builtin, catalogue::Glasses};
use isoplanat::optimize::pool::Pool;
use isoplanat::optimize::search::{Plan, search};
use isoplanat::optimize::spec::{Range, Spec};
use isoplanat::optimize::{
    Apertures, Constraint, Limits, Merit, Outcome, Problem, Quality, Quantity, Stop, glass, light_of, merit_of,
    optimize, residuals_of,
};

fn shipped(name: &str) -> Lens {
    builtin::lens(name).expect("shipped")
}

fn automatic() -> Merit {
    Merit { apertures: Apertures::Automatic, ..Merit::default() }
}

fn run(problem: &Problem) -> Outcome {
    optimize(problem, Limits::default(), &mut |_| true).expect("an end")
}

/// NumPy's rays, written independently (`tests/peers/optimize_scipy.py`), leave the same residuals.
#[test]
fn residuals_are_those_of_the_peer() {
    let text = include_str!("../peers/optimize_scipy.json");
    let peer: serde_json::Value = serde_json::from_str(text).expect("results");
    for name in ["two_element", "three_element"] {
        let ours = residuals_of(&shipped(name), &automatic()).expect("light");
        let theirs: Vec<f64> =
            peer[name]["first_residuals"].as_array().expect("a list").iter().filter_map(|r| r.as_f64()).collect();
        assert_eq!(ours.len(), theirs.len(), "{name}");
        let worst = ours.iter().zip(&theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-9, "{name}: {worst:e}");
    }
}

/// Every shipped lens gets better, keeps its focal length and its constraints, and is a lens.
#[test]
fn shipped_lenses_get_better() {
    for (name, _) in builtin::LENSES {
        let lens = shipped(name);
        let problem = Problem::standard(&lens);
        let found = run(&problem);
        assert!(found.violation < 1e-6, "{name}: {:e}", found.violation);
        let [before, after] = found.rms_mm;
        assert!(after < before, "{name}: {before} to {after}");
        // No better for letting less light through.
        let light = [&lens, &found.lens].map(|l| light_of(l, &problem.merit).expect("light"));
        assert!(light[0].iter().zip(&light[1]).all(|(a, b)| *b > 0.95 * a), "{name}: {light:?}");
        for held in &found.held {
            let ([low, high], value) = (held.of.bounds, held.value);
            let near = 1e-5 * value.abs().max(1.0);
            assert!(value > low - near && value < high + near, "{name}: {}: {value}", held.of.quantity.name());
        }
    }
}

/// A multiplier is what giving way brings: against the merit with the bound moved.
#[test]
fn multipliers_say_what_bounds_cost() {
    let lens = shipped("cooke_triplet");
    let at = |track: f64| {
        let mut problem = Problem::standard(&lens);
        problem.merit = automatic();
        // Edges move with the beam, which multipliers do not know: elements and a gap so thick that they need none.
        let n = lens.indices(lens.wavelengths.primary_nm);
        for (p, b) in problem.variables.parameters.iter().zip(&mut problem.bounds) {
            if p.kind == Kind::Thickness && (p.of == 3 || n[p.of + 1] > 1.0) {
                b[0] = if p.of == 3 { 1.5 } else { 3.0 };
            }
        }
        problem.constraints = Problem::focal_length(&lens);
        problem.constraints.push(Constraint { quantity: Quantity::Track, bounds: [0.0, track] });
        optimize(&problem, Limits { tolerance: 1e-10, ..Limits::default() }, &mut |_| true).expect("an end")
    };
    let (a, b, c) = (at(55.0), at(55.1), at(54.9));
    let cost = a.active.iter().find(|a| a.name == "track").expect("active").cost.abs();
    let numeric = (c.rms_mm[1] - b.rms_mm[1]) / 0.2;
    assert!((cost - numeric).abs() < 0.01 * numeric, "{cost} {numeric}");
}

#[test]
fn constraints_that_contradict_end_in_the_smallest_violation() {
    let lens = shipped("cooke_triplet");
    let mut problem = Problem::standard(&lens);
    problem.merit = automatic();
    problem.constraints.push(Constraint { quantity: Quantity::Track, bounds: [0.0, 40.0] });
    problem.constraints.push(Constraint { quantity: Quantity::BackFocus, bounds: [45.0, 90.0] });
    let found = run(&problem);
    assert_eq!(found.stop, Stop::Contradiction);
    assert!(found.violation > 0.05 && found.violation < 1.0, "{}", found.violation);
    let either = |q: &Quantity| matches!(q, Quantity::Track | Quantity::BackFocus);
    assert!(found.broken().any(|b| either(&b.of.quantity)), "{:?}", found.held);
    assert_eq!(run(&Problem::standard(&lens)).broken().count(), 0);
}

/// Whoever takes the lens hears what it pays: constraints by name, a lens that came out worse, distortion that nothing holds.
#[test]
fn what_a_better_lens_pays_is_told() {
    let place = crate::support::Workplace::new();
    let ran_to = |code: i32, arguments: &str| {
        let ran = place.run(&format!("optimize {arguments} -o found.toml --force"));
        assert_eq!(ran.code, code, "{}", ran.err);
        ran
    };
    let said_with = |code: i32, arguments: &str| {
        let ran = ran_to(code, arguments);
        ran.err.lines().filter_map(|l| l.strip_prefix("warning: ")).map(str::to_owned).collect::<Vec<_>>()
    };
    let said = |arguments: &str| said_with(0, arguments);
    assert!(said("cooke_triplet").is_empty());
    // The lens is written, and who goes on without looking is stopped.
    let broken = ran_to(1, "double_gauss --constraint back_focus=60..");
    assert!(broken.err.contains("found.toml: what was asked for is not kept: back_focus is "), "{}", broken.err);
    place.run("inspect found.toml").done();
    let broken = ran_to(1, "cooke_triplet --bound surface[*].thickness=0..0");
    assert!(broken.err.contains("is not kept: surface[0].thickness is "), "{}", broken.err);
    let told = said_with(1, "cooke_triplet --constraint track=..30");
    assert!(told.iter().any(|w| w.starts_with("the lens is worse than its start by rms, 12.19 ->")), "{told:?}");
    let (free, held) = (said("sonnar"), said("sonnar --constraint distortion=-0.02..0.02"));
    let grew = |told: &[String]| told.iter().any(|w| w.starts_with("distortion at the edge of the field went from "));
    assert!(grew(&free) && !grew(&held), "{free:?} {held:?}");
}

/// Variables without influence, and more variables than the merit can tell apart.
#[test]
fn singular_jacobians_do_no_harm() {
    let lens = shipped("cooke_triplet");
    let wanted = |p: &Parameter| matches!(p.kind, Kind::Curvature | Kind::Thickness | Kind::Conic);
    let flat = lens.changed(|l| l.surfaces[1].shape.curvature = 0.0).expect("a lens");
    let merit = Merit { fields: vec![[0.0, 1.0]], rings: 2, ..automatic() };
    let problem = Problem::new(&flat, Parameter::all(&flat).filter(wanted).collect(), Problem::room(&flat), merit);
    let found = run(&problem);
    assert!(found.rms_mm[1] < 0.2 * found.rms_mm[0] && found.violation < 1e-6, "{:?}", found.rms_mm);
}

/// Rays that fail at the start: smaller apertures first, and an end that says how far it came.
#[test]
fn failing_rays_are_walked_around() {
    let merit = automatic();
    let wide = |d: f64| {
        let wide = |l: &mut Prescription| l.aperture = Aperture::EntrancePupilDiameter(d);
        shipped("cooke_triplet").changed(wide).expect("a lens")
    };
    let fails = |lens: &Lens| merit_of(lens, &merit).is_err();
    let lens = [20.0, 24.0, 28.0, 32.0].map(wide).into_iter().find(fails).expect("rays fail at the start");
    let mut problem = Problem::standard(&lens);
    problem.merit = merit;
    let found = run(&problem);
    assert!(found.share > 0.5, "{}", found.share);
    assert!(found.rms_mm[1].is_finite() && found.violation < 1e-6);
}

#[test]
fn path_differences_get_smaller() {
    let lens = shipped("three_element");
    let mut problem = Problem::standard(&lens);
    problem.merit = Merit { quality: Quality::Wavefront, ..automatic() };
    let found = run(&problem);
    assert!(found.rms_mm[1] < 0.2 * found.rms_mm[0], "{:?}", found.rms_mm);
}

/// Three plane plates of a triplet's glasses.
fn plates() -> Problem {
    let lens = shipped("cooke_triplet")
        .changed(|l| {
            l.aperture = Aperture::EntrancePupilDiameter(12.5);
            l.surfaces.iter_mut().for_each(|s| s.shape.curvature = 0.0);
        })
        .expect("plates");
    let mut problem = Problem::standard(&lens);
    problem.merit = automatic();
    problem.constraints.push(Constraint { quantity: Quantity::FocalLength, bounds: [50.0, 50.0] });
    problem.constraints.push(Constraint { quantity: Quantity::Track, bounds: [0.0, 60.0] });
    problem
}

/// A triplet comes out of plane plates, the same one with one thread and with two.
#[test]
fn plane_plates_become_a_triplet_whatever_the_threads() {
    let plan = Plan { starts: 32, hops: 1, ..Plan::default() };
    let found = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| search(&plates(), &plan, &mut |_| true)).expect("a search")
    });
    let best = found[0].first().expect("a lens");
    assert!(best.rms_mm[1] < 0.02, "{}", best.rms_mm[1]);
    let [one, two] = found.each_ref().map(|f| f.iter().map(|o| o.lens.clone()).collect::<Vec<_>>());
    assert_eq!(one, two);
}

#[test]
fn glasses_end_as_real_ones() {
    let lens = shipped("cooke_triplet");
    let mut problem = Problem::standard(&lens);
    problem.merit = automatic();
    let pool = Pool::new(Glasses::shipped(), &[], "test").expect("glasses").known_over([400.0, 700.0]);
    let found = glass::choose(&problem, &[0, 2, 4], &pool, Limits::default(), &mut |_| true).expect("glasses");
    let kept = run(&problem);
    for i in [0, 2, 4] {
        assert!(matches!(found.lens.surfaces[i].medium, Medium::Glass { .. }), "{}", found.lens.surfaces[i].medium);
        // Every scene's light passes it.
        found
            .lens
            .require_indices(400.0, "found")
            .and(found.lens.require_indices(700.0, "found"))
            .expect("seen through");
    }
    assert!(found.rms_mm[1] < kept.rms_mm[1], "{:?} {:?}", found.rms_mm, kept.rms_mm);
}

/// What a file may say wrongly is one error that names place and value.
#[test]
fn files_are_read_or_refused() {
    let lens = shipped("three_element");
    let refused = |text: &str| {
        Spec::from_toml(text, "m.toml").and_then(|s| s.problem(&lens, "m.toml")).expect_err(text).to_string()
    };
    for (text, said) in [
        ("vary = ['surface[*].radius']", "surface[*].radius"),
        ("quality = 'blur'", "blur; spot or wavefront"),
        ("fields = [0.0, 2.0]", "fields: 2"),
        ("rings = 0", "rings: 0"),
        ("constraints = { weight = 3.0 }", "weight"),
        ("constraints = { track = [5.0, 1.0] }", "track: 5 to 1"),
        ("bounds = { 'surface[0].thickness' = [3.0, 2.0] }", "surface[0].thickness: 3 to 2"),
        ("depths_mm = [-1.0]", "depths"),
        ("targets = { weight = { value = 1.0, weight = 1.0 } }", "target: weight"),
        ("targets = { track = 60.0 }", "line 1"),
        ("targets = { focal_length = { value = 0.0, weight = 1.0 } }", "focal_length: 0"),
        ("targets = { track = { value = 60.0, weight = -1.0 } }", "track: -1"),
        ("ring = 3", "line 1"),
        ("fix = ['surface[*].curvature', 'surface[*].thickness']", "fix"),
    ] {
        let error = refused(text);
        assert!(error.starts_with("m.toml: ") && error.contains(said), "{text}: {error}");
    }
    let text = "vary = ['surface[*].curvature', 'surface[1].a4', 'surface[0].n_d']\nconstraints = { focal_length = 50.0, \
                distortion = [-0.02, 0.02] }\nbounds = { 'surface[0].n_d' = [1.48, 1.6] }\ndepths_mm = [1000.0, inf]";
    let problem = Spec::from_toml(text, "m.toml").and_then(|s| s.problem(&lens, "m.toml")).expect("a problem");
    // Six surfaces refract; the stop in air is not among them.
    assert_eq!(problem.variables.parameters.len(), 8);
    assert!(problem.merit.depths.len() == 2 && problem.bounds.contains(&[1.48, 1.6]));
    let text = "targets = { focal_length = { value = 52.0, weight = 0.01 } }\nconstraints = { track = [0.0, 90.0] }";
    let problem = Spec::from_toml(text, "m.toml").and_then(|s| s.problem(&lens, "m.toml")).expect("a problem");
    assert!(problem.targets.len() == 1 && problem.constraints.iter().all(|c| c.quantity != Quantity::FocalLength));
    assert_eq!(Range::parse("..3", "f").expect("a range"), Range::Two([f64::NEG_INFINITY, 3.0]));
    assert!(Range::parse("a..b", "f").is_err());
}
