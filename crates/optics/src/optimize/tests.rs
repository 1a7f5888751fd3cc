use super::rays::Rays;
use super::residuals::{jacobian, residuals};
use super::*;
use crate::lens::test_lenses::every_kind;
use crate::lens::variables::Variables;
use crate::lens::{Field, ImageSurface, Kind, Parameter, builtin};

/// Residuals of a lens whose numbers are `values`, rays followed from the lens at `at`.
fn moved(merit: &Merit, lens: &Lens, variables: &Variables, step: &[f64]) -> Vec<f64> {
    let clip = merit.apertures == Apertures::Stated;
    let (mut rays, mut traced) = Rays::new(merit, lens, variables, 1.0, clip).expect("light");
    let slopes = rays.slopes(lens, &mut traced).expect("derivatives");
    let x = variables.values(lens);
    let there: Vec<f64> = x.iter().zip(step).map(|(x, d)| x + d).collect();
    let mut numbers = (**lens).clone();
    variables.put(&mut numbers, &there);
    numbers.surfaces.iter_mut().for_each(|s| s.shape.refresh());
    let traced = rays.trace(&numbers, &traced, &slopes, step).expect("light");
    residuals(&rays, &traced)
}

/// Every column of the Jacobian against fourth-order differences of re-aimed rays: through lanes and ray by ray, near and far, spots
/// about both references and path differences.
#[test]
fn jacobians_agree_with_differences() {
    let cooke = builtin::lens("cooke_triplet").expect("shipped");
    let two = builtin::lens("two_element").expect("shipped");
    let three = builtin::lens("three_element").expect("shipped");
    let free = |lens: &Lens| -> Vec<Parameter> {
        let wanted = |p: &Parameter| p.kind.is_free() || p.kind == Kind::EntrancePupilDiameter;
        Parameter::all(lens).filter(wanted).collect()
    };
    let spot = Merit { rings: 2, arms: 2, fields: vec![[0.0, 1.0], [0.7, 2.0]], ..Merit::default() };
    let chief = Merit { reference: Reference::Chief, ..spot.clone() };
    let waves = Merit { quality: Quality::Wavefront, ..spot.clone() };
    let depths = Merit { depths: vec![[0.0, 1.0], [1e-3, 1.0]], ..spot.clone() };
    let mut cases =
        vec![(cooke.clone(), spot.clone()), (cooke.clone(), chief), (cooke.clone(), waves.clone()), (two, depths)];
    let curved = cooke.changed(|l| l.image = ImageSurface { curvature: -1.0 / 60.0, conic: 0.3 }).expect("a lens");
    cases.extend([
        (three.clone(), spot.clone()),
        (three, waves.clone()),
        (curved.clone(), spot.clone()),
        (curved, waves),
    ]);
    let general = |lens: Lens| lens.changed(|l| l.field = Field::Angle(4.0)).expect("a lens");
    cases.extend(every_kind().all().into_iter().map(|lens| (general(lens), spot.clone())));
    for (lens, merit) in cases {
        let variables = Variables::new(&lens, free(&lens));
        let n = variables.parameters.len();
        let clip = merit.apertures == Apertures::Stated;
        let (mut rays, mut traced) = Rays::new(&merit, &lens, &variables, 1.0, clip).expect("light");
        let slopes = rays.slopes(&lens, &mut traced).expect("derivatives");
        let j = jacobian(&rays, &traced, &slopes, n);
        let size = j.norm();
        for k in 0..n {
            let at = |h: f64| {
                let mut step = vec![0.0; n];
                step[k] = h;
                moved(&merit, &lens, &variables, &step)
            };
            let h = 1e-3;
            let [a, b, c, d] = [h, -h, 2.0 * h, -2.0 * h].map(at);
            let column = j.column(k);
            let mut worst = 0.0f64;
            for row in 0..j.nrows() {
                let numeric = (8.0 * (a[row] - b[row]) - (c[row] - d[row])) / (12.0 * h);
                worst = worst.max((numeric - column[row]).abs());
            }
            let name = variables.parameters[k].name(&lens);
            assert!(
                worst < 1e-7 * (column.norm() + 1e-3 * size),
                "{}: {name}: {worst:e} of {:e}",
                lens.name,
                column.norm()
            );
        }
    }
}

/// Constraints' gradients against differences.
#[test]
fn gradients_of_constraints_agree_with_differences() {
    use super::constraint::Held;
    use super::first_order::FirstOrder;
    for name in ["three_element", "cooke_triplet", "phone"] {
        let lens = builtin::lens(name).expect("shipped");
        let variables = Variables::all(&lens);
        let n = variables.parameters.len();
        let merit = Merit { rings: 1, arms: 1, fields: vec![[0.0, 1.0], [0.6, 1.0]], ..Merit::default() };
        let (mut rays, mut traced) = Rays::new(&merit, &lens, &variables, 1.0, false).expect("light");
        let slopes = rays.slopes(&lens, &mut traced).expect("derivatives");
        let rims: Vec<f64> = lens.surfaces.iter().map(|s| 0.9 * s.semi_diameter).collect();
        let mut all = vec![
            Quantity::FocalLength,
            Quantity::FNumber,
            Quantity::WorkingFNumber(lens.object_vergence),
            Quantity::WorkingFNumber(1.0 / 300.0),
            Quantity::Track,
            Quantity::BackFocus,
            Quantity::Distortion(1),
        ];
        for i in 0..lens.surfaces.len() {
            all.extend([Quantity::Centre(i), Quantity::Slope(i), Quantity::Reach(i)]);
            if i + 1 < lens.surfaces.len() {
                all.push(Quantity::Edge(i));
            }
        }
        let x = variables.values(&lens);
        let mut rng = fastrand::Rng::with_seed(3);
        let direction: Vec<f64> = (0..n).map(|_| 0.1 * (rng.f64() - 0.5)).collect();
        let mut value = |h: f64, quantity: Quantity, near: bool| {
            let step: Vec<f64> = direction.iter().map(|d| h * d).collect();
            let there: Vec<f64> = x.iter().zip(&step).map(|(x, d)| x + d).collect();
            let mut numbers = (*lens).clone();
            variables.put(&mut numbers, &there);
            let traced = rays.trace(&numbers, &traced, &slopes, &step).expect("light");
            let first = FirstOrder::new(&numbers, &variables);
            let held = Held {
                numbers: &numbers,
                variables: &variables,
                first,
                rims: &rims,
                rays: Some((&rays, &traced, None)),
            };
            if near { held.near(quantity, 47.0) } else { held.value(quantity) }.value
        };
        let mut numeric = Vec::new();
        for quantity in &all {
            for near in [false, true] {
                numeric.push(isoplanat_base::testing::central_difference(|h| value(h, *quantity, near), 1e-3));
            }
        }
        let first = FirstOrder::new(&lens, &variables);
        let held = Held {
            numbers: &lens,
            variables: &variables,
            first,
            rims: &rims,
            rays: Some((&rays, &traced, Some(&slopes))),
        };
        let mut numeric = numeric.into_iter();
        for quantity in &all {
            for near in [false, true] {
                let by = if near { held.near(*quantity, 47.0) } else { held.value(*quantity) }.by;
                let found: f64 = by.iter().zip(&direction).map(|(a, b)| a * b).sum();
                let numeric = numeric.next().expect("as many");
                isoplanat_base::testing::assert_rel(
                    found,
                    numeric,
                    1e-6,
                    1e-3,
                    &format!("{name}: {}", quantity.name()),
                );
            }
        }
    }
}

/// A heavier target is met more nearly, at the price of spots; one of weight 0 changes nothing.
#[test]
fn targets_pull_by_their_weights() {
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let mut problem = Problem::standard(&lens);
    problem.constraints.retain(|c| c.quantity != Quantity::FocalLength);
    let solved = |targets: Vec<Target>| {
        let problem = Problem { targets, ..problem.clone() };
        optimize(&problem, Limits::default(), &mut |_| true).expect("a lens")
    };
    let target = |weight: f64| Target { quantity: Quantity::FocalLength, value: 52.0, weight };
    let none = solved(Vec::new());
    assert_eq!(solved(vec![target(0.0)]).rms_mm, none.rms_mm);
    assert_eq!(none.merit_mm, none.rms_mm[1]);
    let mut last = (f64::INFINITY, 0.0);
    for weight in [1e-4, 1e-3, 1e-2, 1.0] {
        let found = solved(vec![target(weight)]);
        let off = (found.wanted[0].value - 52.0).abs();
        assert!(off < last.0 && found.rms_mm[1] >= 0.999 * last.1, "{weight}: {off} mm, {:?}", found.rms_mm);
        // Residuals of power, equal to those of the focal length to first order.
        let added = found.merit_mm.powi(2) - found.rms_mm[1].powi(2);
        let bent = weight * off * 52.0 / found.wanted[0].value;
        assert!((added - bent.powi(2)).abs() <= 1e-6 * found.merit_mm.powi(2), "{weight}: {added} of {bent}");
        last = (off, found.rms_mm[1]);
    }
    assert!(last.0 < 1e-3, "{}", last.0);
}

/// Where numbers that are no lens would be better, the result is a lens with that lens's own figures, and says so.
#[test]
fn a_result_is_a_lens_with_its_own_figures() {
    let lens = builtin::lens("two_element").expect("shipped");
    let mut problem = Problem::standard(&lens);
    problem.merit.apertures = Apertures::Automatic;
    problem.constraints = Problem::focal_length(&lens);
    for (p, b) in problem.variables.parameters.iter().zip(&mut problem.bounds) {
        if p.kind == Kind::Thickness {
            b[0] = 0.1;
        }
    }
    let found = optimize(&problem, Limits::default(), &mut |_| true).expect("a lens");
    let refused = found.refused.as_ref().expect("better numbers");
    assert!(refused.merit_mm < found.merit_mm && refused.why.contains("they cross"), "{refused:?}");
    let own = merit_of(&found.lens, &problem.merit).expect("rays");
    assert!((own / found.rms_mm[1] - 1.0).abs() < 1e-6, "{own} of {:?}", found.rms_mm);
    assert!(found.rms_mm[1] <= found.rms_mm[0], "{:?}", found.rms_mm);
    let held = optimize(&Problem::standard(&lens), Limits::default(), &mut |_| true).expect("a lens");
    assert!(held.refused.is_none());
}

/// What a search finds is good over the field as the lens's own pupil sees it, not only for object points of some start's.
#[test]
fn searched_lenses_pass_light_over_their_own_field() {
    let lens = builtin::lens("two_element").expect("shipped");
    let lens = lens.changed(|l| {
        for i in [0, 1, 3, 4] {
            l.surfaces[i].shape.asphere = vec![0.0; 3];
        }
    });
    let spec = spec::Spec {
        vary: ["curvature", "conic", "thickness", "a4", "a6"].map(|k| format!("surface[*].{k}")).to_vec(),
        apertures: Some("automatic".into()),
        ..spec::Spec::default()
    };
    let problem = spec.problem(&lens.expect("a lens"), "test").expect("a problem");
    let plan = search::Plan { starts: 24, ..search::Plan::default() };
    let found = search::search(&problem, &plan, &mut |_| true).expect("searches");
    assert!(!found.is_empty());
    for o in &found {
        let own = merit_of(&o.lens, &problem.merit).expect("rays of its own field pass");
        assert!(own <= 1.5 * o.rms_mm[1] + 1e-6, "{own} mm for {}", o.rms_mm[1]);
    }
}

/// A lens of a near object whose spots are judged from 0.5 to 1.5 m keeps its cone of light. With the entrance pupil left alone it runs to infinity, where a pupil of
/// the same diameter lets no light through, and 127 µm become 0.1.
#[test]
fn light_is_not_given_away_for_spots() {
    let lens = builtin::lens("three_element").expect("shipped");
    let found = |range: Option<&str>| {
        let range = range.map(|r| ("working_f_number".to_owned(), spec::Range::parse(r, "test").expect("a range")));
        let spec = spec::Spec {
            depths_mm: Some(vec![500.0, 700.0, 1000.0, 1500.0]),
            constraints: range.into_iter().collect(),
            ..spec::Spec::default()
        };
        let problem = spec.problem(&lens, "test").expect("a problem");
        optimize(&problem, Limits::default(), &mut |_| true).expect("a lens")
    };
    let cone = |lens: &Lens| crate::lens::paraxial::first_order(lens, lens.wavelengths.primary_nm).working_f_number;
    // What stands out of focus at one distance while another is sharp leaves no spots of micrometres.
    for (range, most) in [(None, 1.05 * cone(&lens)), (Some("..4.3"), 4.3)] {
        let kept = found(range);
        assert!(cone(&kept.lens) <= most * 1.0001, "{} of {}", cone(&kept.lens), cone(&lens));
        assert!(kept.rms_mm[1] > 0.02 && kept.rms_mm[1] <= kept.rms_mm[0], "{:?}", kept.rms_mm);
    }
    assert!(found(Some("..4.3")).rms_mm[1] < 0.06);
    let free = found(Some(".."));
    assert!(cone(&free.lens) > 100.0 && free.rms_mm[1] < 1e-3, "{} {:?}", cone(&free.lens), free.rms_mm);
}

/// Whoever says what focal length or f-number should be is not contradicted; a lens of a far object that is judged near keeps its cone of light there.
#[test]
fn light_is_held_where_nobody_says_what_it_should_be() {
    let held = |lens: &str, spec: &spec::Spec| {
        let problem = spec.problem(&builtin::lens(lens).expect("shipped"), "test").expect("a problem");
        let of = |c: &constraint::Constraint| match c.quantity {
            Quantity::WorkingFNumber(v) => Some((v, c.bounds[1])),
            _ => None,
        };
        problem.constraints.iter().filter_map(of).collect::<Vec<_>>()
    };
    let plain = spec::Spec::default();
    assert!(
        matches!(held("two_element", &plain)[..], [(v, most)] if v == 1e-3 && (most / 4.208 / 1.05 - 1.0).abs() < 1e-3)
    );
    assert_eq!(held("cooke_triplet", &plain), []);
    let near = spec::Spec { depths_mm: Some(vec![f64::INFINITY, 400.0, 900.0]), ..plain.clone() };
    assert!(matches!(held("cooke_triplet", &near)[..], [(v, _)] if v == 1.0 / 400.0));
    for name in ["focal_length", "f_number"] {
        let spec = spec::Spec {
            constraints: [(name.to_owned(), spec::Range::parse("1..90", "test").expect("a range"))].into(),
            ..plain.clone()
        };
        assert_eq!(held("two_element", &spec), [], "{name}");
    }
    let target = spec::Wanted { value: 5.0, weight: 0.1 };
    let spec = spec::Spec { targets: [("working_f_number".to_owned(), target)].into(), ..plain.clone() };
    assert_eq!(held("two_element", &spec), []);
    let none = spec::Spec {
        constraints: [("working_f_number".to_owned(), spec::Range::parse("..-3", "test").expect("a range"))].into(),
        ..plain
    };
    let error = none.problem(&builtin::lens("two_element").expect("shipped"), "test").expect_err("dark").to_string();
    assert!(error.contains("working_f_number") && error.contains("above 0"), "{error}");
}

/// Numbers beyond all lenses are refused where they are read: what a lens misses of them has no digits.
#[test]
fn numbers_beyond_all_lenses_are_refused() {
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let names = ["focal_length", "track", "back_focus", "distortion", "edge_glass", "slope", "surface[0].centre"];
    for name in names {
        for value in ["1e308", "-1e308", "2e12", "..1e300", "-1e300..5", "nan", "inf", "-inf"] {
            let range = spec::Range::parse(value, "test").expect("a range");
            let spec = spec::Spec { constraints: [(name.to_owned(), range)].into(), ..spec::Spec::default() };
            let error = spec.problem(&lens, "test").expect_err(value);
            assert!(error.exit_code() == 2 && error.to_string().len() < 200, "{name} {value}: {error}");
        }
        for (value, weight) in [(1e308, 1.0), (1.0, 1e308), (f64::NAN, 1.0), (1.0, f64::INFINITY)] {
            let wanted = spec::Wanted { value, weight };
            let spec = spec::Spec { targets: [(name.to_owned(), wanted)].into(), ..spec::Spec::default() };
            assert!(spec.problem(&lens, "test").is_err(), "{name}={value}@{weight}");
        }
    }
    let range = spec::Range::parse("..1e12", "test").expect("a range");
    let spec = spec::Spec { constraints: [("track".to_owned(), range)].into(), ..spec::Spec::default() };
    assert!(spec.problem(&lens, "test").is_ok());
    let range = spec::Range::parse("..1e200", "test").expect("a range");
    let spec = spec::Spec { bounds: [("surface[0].thickness".to_owned(), range)].into(), ..spec::Spec::default() };
    assert!(spec.problem(&lens, "test").is_err());
}

/// What is held and has no number at the end is an error that names it, and so is never a lens without a word.
#[test]
fn what_has_no_number_at_the_end_is_named() {
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let problem = Problem::standard(&lens);
    let mut outcome = optimize(&problem, Limits { iterations: 2, ..Limits::default() }, &mut |_| true).expect("light");
    outcome.require("test").expect("numbers");
    outcome.violation = f64::INFINITY;
    let of = Constraint { quantity: Quantity::Track, bounds: [1.0, 2.0] };
    outcome.held.push(Valued { of, value: f64::NAN });
    let error = outcome.require("test").expect_err("no number").to_string();
    assert!(error.contains("test: track: no number"), "{error}");
}

/// A side that is not stated keeps the standard bound; what the stated side leaves no room for is given up.
#[test]
fn a_bound_on_one_side_keeps_the_other() {
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let bounds = |range: &str| {
        let range = spec::Range::parse(range, "test").expect("a range");
        let spec = spec::Spec { bounds: [("surface[1].thickness".to_owned(), range)].into(), ..spec::Spec::default() };
        let problem = spec.problem(&lens, "test").expect("a problem");
        let at = problem.variables.parameters.iter().position(|p| *p == Kind::Thickness.at(1)).expect("moves");
        problem.bounds[at]
    };
    let [low, high] = bounds("..");
    assert!(low > 0.0 && high.is_finite() && low < 7.0, "{low} {high}");
    assert_eq!([bounds("..7"), bounds("1..")], [[low, 7.0], [1.0, high]]);
    assert_eq!([bounds("..-5"), bounds("0.1..7")], [[f64::NEG_INFINITY, -5.0], [0.1, 7.0]]);
}

/// A lens whose aperture is a diameter gets another f-number by another focal length.
#[test]
fn an_f_number_that_is_asked_for_moves_the_focal_length() {
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let first = crate::lens::paraxial::first_order(&lens, lens.wavelengths.primary_nm);
    let sized =
        lens.changed(|l| l.aperture = crate::lens::Aperture::EntrancePupilDiameter(first.entrance_pupil_diameter));
    let sized = sized.expect("a lens");
    let held = |lens: &Lens, range: &str| {
        let range = spec::Range::parse(range, "test").expect("a range");
        let spec = spec::Spec { constraints: [("f_number".to_owned(), range)].into(), ..spec::Spec::default() };
        let problem = spec.problem(lens, "test").expect("a problem");
        let told = !spec.notes(lens, "test").expect("notes").is_empty();
        let holds = problem.constraints.iter().any(|c| c.quantity == Quantity::FocalLength);
        assert_eq!(holds, !told);
        holds
    };
    let own = first.f_number;
    assert!(!held(&sized, &format!("{}", 1.2 * own)) && !held(&sized, &format!("..{}", 0.9 * own)));
    assert!(held(&sized, &format!("{}..{}", 0.9 * own, 1.1 * own)));
    let stated = lens.changed(|l| l.aperture = crate::lens::Aperture::FNumber(own)).expect("a lens");
    assert!(held(&stated, &format!("{}", 1.2 * own)));
}

/// What is no range is said in words.
#[test]
fn ranges_that_are_none_are_told() {
    for text in ["track = \"..60\"", "track = [1.0]", "track = { min = 1 }"] {
        let error = spec::Spec::from_toml(&format!("[constraints]\n{text}\n"), "m.toml").expect_err(text).to_string();
        assert!(error.contains("line 2") && error.contains("[LOW, HIGH]"), "{error}");
    }
}
