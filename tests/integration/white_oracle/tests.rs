//! The quadrature of white against closed forms and itself.

use std::f64::consts::PI;

use isoplanat::lens::paraxial::first_order;
use isoplanat::lens::{Aperture, Medium, Shape, Surface, Wavelengths, builtin, unchecked};

use super::*;
use crate::white_axis::on_axis;

fn of_surfaces(name: &str, surfaces: Vec<Surface>, stop: usize, aperture: Aperture) -> Lens {
    unchecked(&builtin::lens("cooke_triplet").expect("shipped"), |lens| {
        lens.name = name.into();
        lens.wavelengths = Wavelengths { nm: vec![587.5618], weights: vec![1.0], primary_nm: 587.5618 };
        (lens.surfaces, lens.stop, lens.aperture) = (surfaces, stop, aperture);
    })
}

fn laikin_100() -> Lens {
    crate::support::lens_file("benches/lenses/wide_100.toml")
}

/// A round hole before the sensor.
fn hole(distance: f64, radius: f64) -> Lens {
    let shape = Shape::default();
    let surface = Surface { shape, thickness: distance, medium: Medium::Air, semi_diameter: radius, pose: None };
    of_surfaces("hole", vec![surface], 0, Aperture::StopSemiDiameter(radius))
}

/// A lens, and the largest sensor radius to look at.
fn lens(name: &str) -> (Lens, f64) {
    if name == "laikin_100" {
        let wide = laikin_100();
        let focal = first_order(&wide, 587.5618).effective_focal_length.abs();
        return (wide, 0.85 * focal);
    }
    let lens = builtin::lens(name).expect("shipped");
    let radius = lens.sensor.radius_mm();
    (lens, radius)
}

#[test]
fn a_disk_off_axis_has_its_closed_form() {
    for (z, a) in [(20.0, 3.0), (5.0, 4.0), (50.0, 0.05)] {
        let lens = hole(z, a);
        for h in [0.0f64, 0.5, 2.0, 4.0, 11.0, 30.0] {
            let root = ((z * z + h * h + a * a).powi(2) - 4.0 * a * a * h * h).sqrt();
            // The form without cancellation: 1 − (Z² + h² − a²)/√ = 4a²Z² / √(√ + Z² + h² − a²).
            let exact = 0.5 * PI * 4.0 * a * a * z * z / (root * (root + z * z + h * h - a * a));
            let found = irradiance(&lens, 550.0, h, 1000);
            assert!((found / exact - 1.0).abs() < 1e-9, "{z} {a} {h}: {found} {exact}");
        }
    }
    // A small hole: cos⁴.
    let lens = hole(50.0, 0.01);
    let ratio = irradiance(&lens, 550.0, 40.0, 1000) / irradiance(&lens, 550.0, 0.0, 1000);
    assert!((ratio / (50f64 / 50f64.hypot(40.0)).powi(4) - 1.0).abs() < 1e-6, "{ratio}");
}

/// On the axis the closed form; off it, twice the lines and counting the points of a grid, which leaves no open part out.
fn judge(name: &str) {
    const CELLS: u32 = 1000;
    let (lens, largest) = lens(name);
    for nm in [450.0, 587.5618] {
        let (found, exact) = (irradiance(&lens, nm, 0.0, 1000), on_axis(&lens, nm));
        assert!((found / exact - 1.0).abs() < 1e-5, "{name} {nm}: {found} {exact}");
        eprintln!("{name} on the axis: {found} {:+.1e}", found / exact - 1.0);
    }
    for radius in [0.6 * largest, largest] {
        let [coarse, fine] = [1000, 2000].map(|side| irradiance(&lens, 587.5618, radius, side));
        assert!(fine > 0.0 && (coarse - fine).abs() < 1e-5 * fine, "{name} {radius}: {coarse} {fine}");
        let view = View::new(&lens, 587.5618, radius);
        let step = 2.0 * view.reach / f64::from(CELLS);
        let at = |i: u32| (f64::from(i) + 0.5) * step - view.reach;
        let all: Vec<DVec2> =
            (0..CELLS).flat_map(|i| (0..CELLS).map(move |j| (i, j))).map(|(i, j)| DVec2::new(at(i), at(j))).collect();
        let weight = |t: &DVec2| (view.distance / (view.distance.powi(2) + (*t - view.point).length_squared())).powi(2);
        let open = all.iter().zip(view.open(&all)).filter(|(_, open)| *open);
        let counted = view.index_square * open.map(|(t, _)| weight(t)).sum::<f64>() * step * step;
        eprintln!("{name} at {radius:.3} mm: {fine} {:+.1e} {:+.1e}", coarse / fine - 1.0, counted / fine - 1.0);
        assert!((counted / fine - 1.0).abs() < 5e-3, "{name} {radius}: {fine} {counted}");
    }
}

#[test]
fn cooke_triplet_is_integrated_to_its_accuracy() {
    judge("cooke_triplet");
}

#[test]
fn double_gauss_is_integrated_to_its_accuracy() {
    judge("double_gauss");
}

#[test]
fn al2550_a_is_integrated_to_its_accuracy() {
    judge("al2550_a");
}

#[test]
fn two_element_is_integrated_to_its_accuracy() {
    judge("two_element");
}

#[test]
fn phone_is_integrated_to_its_accuracy() {
    judge("phone");
}

#[test]
fn laikin_100_is_integrated_to_its_accuracy() {
    judge("laikin_100");
}

/// A stop between two holes: similar triangles say where the holes begin to clip.
#[test]
fn onsets_behind_two_holes_are_those_of_similar_triangles() {
    let surface = |thickness: f64, semi_diameter: f64| Surface {
        shape: Shape::default(),
        thickness,
        medium: Medium::Air,
        semi_diameter,
        pose: None,
    };
    // From the sensor: a hole of 5 at 10 mm, the stop of 2 at 16 mm, a hole of 3.5 at 20 mm.
    let rows = vec![surface(4.0, 3.5), surface(6.0, 2.0), surface(10.0, 5.0)];
    let lens = of_surfaces("three holes", rows, 1, Aperture::StopSemiDiameter(2.0));
    // The ray through the stop's near edge reaches the front hole's far one, and the other way round: from `h`
    // through `y` at 16 it is at `y + (y − h)/4` at 20; at 10 at `h + (y − h) 10/16`.
    let front = (3.5 - 2.0 * 1.25) / 0.25;
    let rear = (5.0 - 2.0 * 10.0 / 16.0) / (6.0 / 16.0);
    let found = vignetting_onsets(&lens, 550.0, 12.0);
    assert!(found.len() == 2, "{found:?} {front} {rear}");
    assert!((found[0] - front).abs() < 1e-8 && (found[1] - rear).abs() < 1e-8, "{found:?} {front} {rear}");
}

/// Before the first onset nothing but the stop matters, behind it something does.
#[test]
fn up_to_the_first_onset_the_stop_alone_bounds_the_light() {
    for name in ["cooke_triplet", "double_gauss", "al2550_a", "phone", "laikin_100"] {
        let (lens, largest) = lens(name);
        let onsets = vignetting_onsets(&lens, 587.5618, largest);
        eprintln!("{}: onsets {onsets:?} of {largest:.3} mm", lens.name);
        assert!(onsets.windows(2).all(|pair| pair[0] <= pair[1]), "{onsets:?}");
        let Some(first) = onsets.first().copied().filter(|first| 1.02 * first < largest) else { continue };
        let stop = lens.stop;
        let wide = unchecked(&lens, |l| {
            l.aperture = Aperture::StopSemiDiameter(System::new(&lens, 587.5618).stop_semi_diameter);
            l.surfaces.iter_mut().enumerate().filter(|(i, _)| *i != stop).for_each(|(_, s)| s.semi_diameter *= 1.01);
        });
        let lost =
            |radius: f64| 1.0 - irradiance(&lens, 587.5618, radius, 1000) / irradiance(&wide, 587.5618, radius, 1000);
        let [before, behind] = [0.99 * first, 1.02 * first].map(lost);
        assert!(before.abs() < 1e-10 && behind > 1e-6, "{}: {before:e} {behind:e}", lens.name);
    }
}
