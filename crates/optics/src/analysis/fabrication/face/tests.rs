//! Best-fit spheres against closed forms and against all others.

use super::*;
use crate::lens::Medium;

fn face(shape: Shape, semi_diameter: f64) -> Face {
    let surface = Surface { shape, thickness: 1.0, medium: Medium::Air, semi_diameter, pose: None };
    Face::new(0, &surface, [false, true])
}

/// A sphere's best-fit sphere is itself; so is that of an asphere whose terms are the sphere's own series.
#[test]
fn the_best_fit_sphere_of_a_sphere_is_that_sphere() {
    for c in [0.0, 0.02, -0.031, 0.0999] {
        let f = face(Shape::sphere(c), 10.0);
        assert_eq!(f.best_fit.curvature_per_mm, c);
        assert_eq!((f.best_fit.departure_um, f.best_fit.slope_um_per_mm), (0.0, 0.0));
        assert!(f.sag_table(21).iter().all(|r| r.departure_mm.abs() < 1e-15), "{c}");
    }
    // A conic constant and terms that cancel: c of a paraboloid with the sphere's next orders, to h¹².
    let c: f64 = 0.02;
    let series = [1.0 / 8.0, 1.0 / 16.0, 5.0 / 128.0, 7.0 / 256.0, 21.0 / 1024.0];
    let terms = std::iter::once(0.0).chain(series.iter().zip([3, 5, 7, 9, 11]).map(|(s, p)| s * c.powi(p)));
    let f = face(Shape::even(c, -1.0, terms.collect()), 5.0);
    assert!((f.best_fit.curvature_per_mm / c - 1.0).abs() < 1e-11, "{:?}", f.best_fit);
    assert!(f.best_fit.departure_um.abs() < 1e-9, "{:?}", f.best_fit);
}

/// A gentle paraboloid `z = ch²/2`: with `δ` the excess of curvature and `e = c³/8`, least squares through the vertex leave
/// `e(¾R²h² − h⁴)`: −eR⁴/4 at the rim, steepest there, and a curvature less by 3eR²/2·… (relative error (cR)²).
#[test]
fn a_paraboloid_departs_as_in_closed_form() {
    let (c, r): (f64, f64) = (0.004, 10.0);
    let f = face(Shape::even(c, -1.0, vec![]), r);
    let e = c.powi(3) / 8.0;
    let near = |value: f64, expected: f64, what: &str| {
        assert!((value / expected - 1.0).abs() < 4e-3, "{what}: {value} {expected}");
    };
    near(f.best_fit.departure_um, -1e3 * 0.25 * e * r.powi(4), "largest departure");
    near(f.best_fit.departure_at_mm, r, "its height");
    near(f.best_fit.slope_um_per_mm, 1e3 * 2.5 * e * r.powi(3), "slope of the departure");
    near(c - f.best_fit.curvature_per_mm, 1.5 * e * r * r, "curvature");
    for row in f.sag_table(201) {
        let h = row.height_mm;
        let leading = e * (0.75 * r * r * h * h - h.powi(4));
        assert!((row.departure_mm - leading).abs() < 4e-3 * e * r.powi(4), "{h}: {} {leading}", row.departure_mm);
        // Exactly: a parabola less the sphere of the curvature that was found.
        let s = f.best_fit.curvature_per_mm;
        let exact = 0.5 * c * h * h - (1.0 - (1.0 - s * s * h * h).sqrt()) / s;
        assert!((row.departure_mm - exact).abs() < 1e-13, "{h}");
    }
}

/// No other sphere through the vertex has a smaller mean square, on aspheres of every strength, gull wings included.
#[test]
fn the_best_fit_is_the_best() {
    let mut rng = fastrand::Rng::with_seed(4);
    for seed in 0..80 {
        let mut draw = |w: f64| (2.0 * rng.f64() - 1.0) * w;
        let mut shape = Shape::even(draw(0.09), draw(3.0), vec![draw(0.02), draw(2e-3), draw(1e-4)]);
        shape.odd = vec![draw(1e-3)];
        if shape.reach() <= 5.0 {
            continue;
        }
        let f = face(shape, 5.0);
        let rings = (0..256u32).map(|k| 25.0 * (f64::from(k) + 0.5) / 256.0);
        let sags: Vec<[f64; 2]> = rings.map(|rho| [rho, f.formula_sag(rho.sqrt()).expect("inside")]).collect();
        let square = |c: f64| -> f64 { sags.iter().map(|[rho, sag]| (sag - sphere(c, *rho).sag).powi(2)).sum() };
        let best = square(f.best_fit.curvature_per_mm);
        for k in 0..=1000 {
            let c = (f64::from(k) / 500.0 - 1.0) * 0.2 * (1.0 - 1e-9);
            assert!(square(c) >= best * (1.0 - 1e-9), "seed {seed}, {c}: {} {best}", square(c));
        }
    }
}

#[test]
fn faces_are_convex_or_concave_from_outside() {
    assert_eq!([Bend::from_curvature(0.1, true), Bend::from_curvature(0.1, false)], [Bend::Convex, Bend::Concave]);
    assert_eq!([Bend::from_curvature(-0.1, true), Bend::from_curvature(-0.1, false)], [Bend::Concave, Bend::Convex]);
    assert_eq!(Bend::from_curvature(0.0, true).code(), "plane");
    // A concave front of radius 20 asks for a tool nose below 20 mm; a convex one for none.
    let [hollow, bulging] = [-0.05, 0.05].map(|c| face(Shape::sphere(c), 4.0).tightest_concave_mm);
    assert!((hollow.expect("concave") - 20.0).abs() < 1e-9 && bulging.is_none());
}
