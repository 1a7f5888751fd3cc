//! White on the axis, in closed form: what quadratures are tested against.
//!
//! On the axis of a rotationally symmetric lens a scene of radiance 1 gives the irradiance
//! `∫ n'² cos⁴θ / Z² dA = π n'² Σ (sin²θ_out − sin²θ_in)` over the intervals of angle that pass.

use glam::DVec3;

use isoplanat::lens::{Aperture, Lens, Medium, Prescription, Shape, Surface, builtin};
use isoplanat::psf::{Optics, OpticsSpec, Quadrature};
use isoplanat::testing::assert_rel;
use isoplanat::trace::sequential::first_vignetted;
use isoplanat::trace::sequential::trace;
use isoplanat::trace::{Ray, System};

/// Irradiance on the axis of a white scene of radiance 1 at `nm`, sr; 0 if no light passes.
pub(crate) fn on_axis(lens: &Lens, nm: f64) -> f64 {
    let system = System::new(lens, nm).reversed();
    let index = system.surfaces[0].index_after;
    // The largest sine worth looking at: past the rim of the rear surface.
    let rear = &system.surfaces[1];
    let rim = rear.shape.sag(rear.semi_diameter.powi(2)).map_or(0.0, |s| s.h);
    let largest = (rear.semi_diameter / rear.semi_diameter.hypot((rear.distance + rim).max(0.0))).min(1.0);
    let mut hits = Vec::new();
    let mut passes = |sine: f64| {
        let direction = DVec3::new(0.0, sine, (1.0 - sine * sine).max(0.0).sqrt());
        let ray = Ray { origin: DVec3::ZERO, direction };
        trace(&system, ray, system.image(), &mut hits).is_ok_and(|h| h.direction.z > 0.0)
            && first_vignetted(&system, &hits).is_none()
    };
    // Even steps, and finer ones near the axis for stops that are tiny.
    let fine = (0..60).map(|k| 10f64.powf(-6.0 + 4.0 * f64::from(k) / 60.0));
    let sines = fine.chain((0..=200).map(|k| 0.01 + 0.99 * f64::from(k) / 200.0)).map(|s| s * largest);
    let (mut sum, mut last, mut open) = (0.0, 0.0, passes(0.0));
    for sine in sines {
        let now = passes(sine);
        if now != open {
            let (mut a, mut b) = (last, sine);
            for _ in 0..50 {
                let middle = 0.5 * (a + b);
                if passes(middle) == open { a = middle } else { b = middle }
            }
            sum += if open { a * a } else { -b * b };
        }
        (last, open) = (sine, now);
    }
    if open {
        sum += last * last;
    }
    std::f64::consts::PI * index * index * sum
}

/// A hole of radius 3 at 20 mm: `π sin²θ`; the closed form to rounding of the bisection.
#[test]
fn a_hole_lets_through_what_it_subtends() {
    let hole =
        Surface { shape: Shape::default(), thickness: 20.0, medium: Medium::Air, semi_diameter: 3.0, pose: None };
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let alone = |l: &mut Prescription| {
        (l.surfaces, l.stop, l.aperture) = (vec![hole], 0, Aperture::StopSemiDiameter(3.0));
    };
    let lens = lens.changed(alone).expect("a lens");
    let exact = std::f64::consts::PI * 9.0 / 409.0;
    assert!((on_axis(&lens, 550.0) - exact).abs() < 1e-12 * exact);
}

/// The étendue that the optics integrate over the stop, on the axis: the cone of light.
#[test]
fn white_on_the_axis_is_the_cone_of_light() {
    let nm = vec![470.0, 540.0, 610.0];
    for (name, radius) in [("two_element", 20.0), ("cooke_triplet", 17.0), ("double_gauss", 20.0), ("phone", 3.2)] {
        let lens = builtin::lens(name).expect("shipped");
        let quadrature = Quadrature { nm: nm.clone(), weight: vec![vec![0.2, 0.7, 0.1]] };
        let spec = OpticsSpec::even(radius, vec![lens.object_vergence], quadrature);
        let optics = Optics::compute(&lens, &spec).expect("traces");
        for (l, nm) in nm.iter().enumerate() {
            let (exact, found) = (on_axis(&lens, *nm), optics.illumination().irradiance[l][0]);
            eprintln!("{name} {nm}: {:e}", found / exact - 1.0);
            assert_rel(found, exact, 2e-5, 0.0, name);
        }
    }
}
