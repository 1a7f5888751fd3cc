//! Against `trace::wavefront`, closed forms, and the third-order sums.

use super::*;
use crate::lens::{Aperture, Field, Medium, Shape, Surface, builtin, paraxial, seidel, unchecked};
use crate::psf::Model;
use crate::psf::{Optics, OpticsSpec, Quadrature, SensorPoint};
use crate::trace::system::TraceSurface;
use isoplanat_base::testing::{assert_abs, assert_rel};

const AXIS: ObjectPoint = ObjectPoint { direction: DVec3::Z, vergence: 0.0 };

#[test]
fn maps_are_the_path_differences_of_the_trace() {
    for (name, degrees, nm) in
        [("double_gauss", 12.0, 587.5618), ("cooke_triplet", 18.0, 450.0), ("phone", 20.0, 650.0)]
    {
        let lens = builtin::lens(name).expect("shipped");
        let object = ObjectPoint::in_field(&lens, f64::to_radians(degrees), 1.1);
        let map = Map::of_lens(&lens, object, nm, 24).expect("light");
        let system = System::new(&lens, nm);
        let aimer = Aimer::new(&system).expect("has a stop");
        let points: Vec<DVec2> = map.points.iter().flatten().map(|p| p.stop).collect();
        let wave = Wavefront::compute(&aimer, object, &points, Reference::Point(map.centre), true).expect("light");
        for (a, b) in map.points.iter().flatten().zip(wave.waves()) {
            assert_abs(a.waves, b.expect("open"), 1e-8, name);
        }
        assert!(points.len() > 100 && map.best.rms <= map.figures.rms, "{name}");
        eprintln!("{name}: {:?} best {:?} shift {}", map.figures, map.best, map.shift);
        // About the best point itself: nothing is left to move.
        let again = Map::compute(&aimer, object, map.centre + map.shift, 24).expect("light");
        assert_rel(again.figures.rms, map.best.rms, 1e-6, 1e-9, "exact about the best point");
        assert!(again.shift.length() < 1e-5, "{}", again.shift);
    }
}

/// A stigmatic lens out of focus and beside the point: the shift leads back.
#[test]
fn the_best_point_is_the_focus() {
    let n = 1.5;
    let surfaces = vec![
        TraceSurface::new(Shape::default(), 0.0, [1.0, n], 40.0),
        TraceSurface::new(Shape::even(-1.0 / 30.0, -n * n, vec![]), 10.0, [n, 1.0], 40.0),
        TraceSurface::new(Shape::default(), 60.2, [1.0, 1.0], f64::INFINITY),
    ];
    let system = System { wavelength_nm: 550.0, surfaces, stop: 0, stop_semi_diameter: 8.0 };
    let aimer = Aimer::new(&system).expect("has a stop");
    let map = Map::compute(&aimer, AXIS, DVec3::new(0.01, -0.02, 0.0), 32).expect("light");
    assert!((map.shift - DVec3::new(-0.01, 0.02, -0.2)).length() < 1e-7, "{}", map.shift);
    assert!(map.best.rms < 1e-6 && map.best.strehl > 1.0 - 1e-9 && map.figures.rms > 1.0);
    assert_abs(map.open, 1.0, 0.0, "open");
    // A tenth of a wave: Strehl ratio and its estimate agree.
    let near = Map::compute(&aimer, AXIS, DVec3::new(0.0, 0.0, -0.2 + 0.008), 64).expect("light");
    assert!(near.figures.rms > 0.02 && near.figures.rms < 0.1, "{}", near.figures.rms);
    assert_abs(near.figures.strehl, near.figures.marechal, 5e-3, "Strehl");
}

/// Small aperture and field: `W₀₄₀ = S_I/8`, `W₁₃₁ = S_II/2`, `W₂₂₂ = S_III/2` in Noll's terms.
#[test]
fn third_order_terms_are_those_of_seidel() {
    for name in ["cooke_triplet", "ac254_050_a", "tessar"] {
        let lens = builtin::lens(name).expect("shipped");
        let nm = lens.wavelengths.primary_nm;
        let lens = unchecked(&lens, |l| {
            l.aperture = Aperture::EntrancePupilDiameter(3.0);
            l.field = Field::Angle(1.0);
            l.object_vergence = 0.0;
        });
        let image = paraxial::first_order(&lens, nm).paraxial_image_distance;
        let lens = unchecked(&lens, |l| l.surfaces.last_mut().expect("surfaces").thickness = image);
        let sums = seidel::total(&seidel::per_surface(&lens, nm));
        let waves = |mm: f64| mm / (nm * 1e-6);
        let field = ObjectPoint::in_field(&lens, 1f64.to_radians(), std::f64::consts::FRAC_PI_2);
        let fit = |object: ObjectPoint| {
            Map::of_lens(&lens, object, nm, 41).expect("light").zernike(Order::Noll, 22).expect("whole").coefficients
        };
        let (axis, off) = (fit(AXIS), fit(field));
        let spherical = waves(sums.spherical) / 8.0 / (6.0 * 5f64.sqrt());
        let coma = waves(sums.coma) / 2.0 / (3.0 * 8f64.sqrt());
        let astigmatism = -waves(sums.astigmatism) / 2.0 / (2.0 * 6f64.sqrt());
        eprintln!("{name}: {} {spherical}, {} {coma}, {} {astigmatism}", axis[10], off[6], off[5]);
        assert_rel(axis[10], spherical, 0.05, 1e-4, name);
        assert_rel(off[6].abs(), coma.abs(), 0.05, 1e-3, name);
        assert_rel(off[5], astigmatism, 0.1, 1e-3, name);
        assert!(off[4].abs() < 1e-6 && off[7].abs() < 1e-6, "{name}: symmetric");
    }
}

#[test]
fn no_light_is_told() {
    let lens = builtin::lens("double_gauss").expect("shipped");
    let mut shut = System::new(&lens, 550.0);
    let last = shut.image() - 1;
    (shut.surfaces[0].semi_diameter, shut.surfaces[last].semi_diameter) = (1e-3, 1e-3);
    let aimer = Aimer::new(&shut).expect("has a stop");
    let object = ObjectPoint::in_field(&lens, 0.3, 0.0);
    let failure = Map::compute(&aimer, object, DVec3::ZERO, 16).expect_err("shut");
    assert_eq!(failure.cause, Cause::Vignetted);
    // A clipped map says how much is left.
    let mut half = System::new(&lens, 550.0);
    half.surfaces[0].semi_diameter = 6.0;
    let map = Map::compute(&Aimer::new(&half).expect("has a stop"), object, DVec3::ZERO, 32).expect("light");
    assert!(map.open > 0.05 && map.open < 0.9, "{}", map.open);
    assert_eq!(map.zernike(Order::Noll, 1000), None);
}

/// The peak of light by diffraction, whose rays go from the sensor to the object, against the coherent sum over the stop of rays that go the other way: shipped lenses, on axis
/// and off, far and near: an object 1 m away, 0.65 waves out of focus, tells the plane that edges stand in, of the entrance pupil there and of the exit pupil here.
#[test]
fn strehl_ratios_are_those_of_the_wavefront() {
    for (name, f_number, radius, vergence) in [
        ("double_gauss", 8.0, 7.5, 0.0),
        ("double_gauss", 16.0, 7.5, 0.0),
        ("double_gauss", 16.0, 7.5, 1e-3),
        ("cooke_triplet", 11.0, 15.0, 0.0),
    ] {
        let lens = builtin::lens(name).expect("shipped");
        let lens = lens.changed(|l| {
            l.aperture = Aperture::FNumber(f_number);
            l.object_vergence = vergence;
        });
        let lens = lens.expect("closes");
        let nm = lens.wavelengths.primary_nm;
        let quadrature = Quadrature { nm: vec![nm], weight: vec![vec![1.0]] };
        let spec = OpticsSpec { degree: 12, ..OpticsSpec::even(radius, vec![vergence], quadrature) };
        let optics = Optics::compute(&lens, &spec).expect("traces");
        let optics = optics.diffracting(&lens, Model::Waves).expect("traces");
        let shares: [f64; 3] = [0.0, 0.6, 0.9];
        let points = shares.map(|share| SensorPoint::along([0.0, 1.0], share * radius));
        let found = optics.point_spreads(0, &points, &[1.0]);
        for (point, found) in points.into_iter().zip(found) {
            let found = found.expect("light");
            let slope = optics.maps[0].slope(point.radius_mm());
            let object = ObjectPoint::from_slope(DVec2::new(0.0, slope), vergence);
            let system = System::new(&lens, nm);
            let aimer = Aimer::new(&system).expect("has a stop");
            // Columns and rows outwards, as the image's x and y but for the sign of x.
            let at = DVec3::new(-found.peak().x, point.radius_mm() + found.peak().y, 0.0);
            let map = Map::compute(&aimer, object, at, 96).expect("light");
            let part = found.strehl() / map.figures.strehl;
            eprintln!("{name} {}: {} of {} {:?}", point.radius_mm(), found.strehl(), map.figures.strehl, found.peak());
            assert_abs(part, 1.0, 1e-2, name);
            // No other place near is brighter.
            for by in [DVec3::X, DVec3::Y, DVec3::NEG_X, DVec3::NEG_Y] {
                let beside = Map::compute(&aimer, object, at + 3e-3 * by, 48).expect("light").figures.strehl;
                assert!(beside <= 1.005 * map.figures.strehl, "{name}: {beside}");
            }
            // The centroid is that of rays.
            let rays = optics.form(8000, 3, 1, 0.01).rays(optics.table(), &optics.maps[0], 0, point);
            let light: f64 = rays.share.iter().sum();
            let mean = |of: &[f64]| of.iter().zip(&rays.share).map(|(v, s)| v * s).sum::<f64>() / light;
            let (x, y) = (mean(&rays.x), mean(&rays.y));
            assert_abs(found.centroid().y, y, 2e-4, "centroid");
            assert!(found.centroid().x.abs() < 1e-6 && x.abs() < 1.0, "{}", found.centroid());
        }
    }
}

/// An ideal lens of f/1 has no wavefront error and no spot, near and far, on the axis and 30° off it; behind a real lens it adds none of its
/// own: the double Gauss made afocal by it and focused again by another has the double Gauss's error.
#[test]
fn ideal_lenses_have_no_error() {
    let lens = builtin::lens("double_gauss").expect("shipped");
    let ideal = |f: f64, thickness: f64| Surface {
        shape: Shape { ideal: Some(f), ..Shape::default() },
        thickness,
        medium: Medium::Air,
        semi_diameter: 200.0,
        pose: None,
    };
    for (vergence, image) in [(0.0, 50.0), (1.0 / 75.0, 150.0)] {
        let alone = unchecked(&lens, |l| {
            l.surfaces = vec![ideal(50.0, image)];
            (l.stop, l.aperture, l.object_vergence) = (0, Aperture::StopSemiDiameter(25.0), vergence);
        });
        for degrees in [0.0, 30.0] {
            let object = ObjectPoint::in_field(&alone, f64::to_radians(degrees), 0.7);
            let map = Map::of_lens(&alone, object, 550.0, 24).expect("light");
            assert_abs(map.figures.peak_to_valley, 0.0, 1e-9, &format!("{degrees}° at {vergence}"));
            assert_abs(map.shift.length(), 0.0, 1e-9, "in focus");
        }
    }
    let first = paraxial::first_order(&lens, 587.5618);
    let (rear, f) = (lens.surfaces.len() - 1, first.effective_focal_length);
    let relayed = unchecked(&lens, |l| {
        // Light that is gathered towards the focus is made parallel before it, and gathered again.
        l.surfaces[rear].thickness = first.back_focal_length - 0.2 * f;
        l.surfaces.extend([ideal(-0.2 * f, 5.0), ideal(0.2 * f, 0.2 * f)]);
    });
    let focused = unchecked(&lens, |l| l.surfaces[rear].thickness = first.back_focal_length);
    let [a, b] = [&focused, &relayed].map(|l| Map::of_lens(l, AXIS, 587.5618, 32).expect("light").figures.rms);
    eprintln!("{a} {b} waves rms");
    assert_rel(b, a, 1e-2, 0.0, "the double Gauss's own error");
}
