//! What holds for every lens and every ray: random valid lenses made of the shipped ones, random rays through them.
//!
//! `PROPTEST_CASES=N` takes N lenses a property in place of 500.

use glam::DVec3;
use isoplanat::lens::builtin::{self, LENSES};
use isoplanat::lens::variables::Variables;
use isoplanat::lens::{Aperture, Lens, Prescription, prescription};
use isoplanat::trace::differential::{RayDot, trace_jvp};
use isoplanat::trace::sequential::{Hit, HitBar, trace, trace_vjp};
use isoplanat::trace::{Ray, System, SystemGradient};
use proptest::prelude::*;

/// A shipped lens with every free number moved by up to a fifth of its scaled unit: those that the check lets pass.
fn lens() -> impl Strategy<Value = Lens> {
    let moves = prop::collection::vec(-1.0..1.0f64, 96);
    (0..LENSES.len(), moves, 0.0..0.2f64).prop_filter_map("the check refuses it", |(which, moves, size)| {
        let lens = builtin::lens(LENSES[which].0).expect("shipped");
        let variables = Variables::all(&lens);
        let values = variables.values(&lens);
        let moved: Vec<f64> = values.iter().zip(moves.iter().cycle()).map(|(v, m)| v + size * m).collect();
        variables.lens(&lens, &moved).ok()
    })
}

/// A place on the first aperture, in its radii, and a direction within 30° of the axis.
fn launch() -> impl Strategy<Value = [f64; 4]> {
    [-0.7..0.7f64, -0.7..0.7f64, -0.4..0.4f64, -0.4..0.4f64]
}

/// Rays whose foot stands before every vertex's sag.
fn ray(lens: &Lens, [x, y, l, m]: [f64; 4]) -> Ray {
    let radius = lens.surfaces[0].semi_diameter;
    let direction = DVec3::new(l, m, 1.0).normalize();
    let foot = DVec3::new(x * radius, y * radius, 0.0);
    Ray { origin: foot - direction * (2.0 * radius / direction.z), direction }
}

/// The hits up to the image plane; none where the ray does not get there.
fn through(system: &System, ray: Ray) -> Option<Vec<Hit>> {
    let mut hits = Vec::new();
    trace(system, ray, system.image(), &mut hits).ok()?;
    Some(hits)
}

fn config() -> ProptestConfig {
    // Failures are told with their lens; no file is left beside the tests.
    ProptestConfig { failure_persistence: None, max_global_rejects: 65_536, ..ProptestConfig::with_cases(cases()) }
}

fn cases() -> u32 {
    std::env::var("PROPTEST_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(500)
}

/// Every length of a symmetric lens `s` times as large.
fn enlarge(l: &mut Prescription, s: f64) {
    for surface in &mut l.surfaces {
        let shape = &mut surface.shape;
        shape.curvature /= s;
        // a_p r^p is a length.
        shape.asphere.iter_mut().zip((2..).step_by(2)).for_each(|(a, p)| *a *= s.powi(1 - p));
        shape.odd.iter_mut().zip((3..).step_by(2)).for_each(|(a, p)| *a *= s.powi(1 - p));
        surface.thickness *= s;
        surface.semi_diameter *= s;
    }
    if let Aperture::EntrancePupilDiameter(d) | Aperture::StopSemiDiameter(d) = &mut l.aperture {
        *d *= s;
    }
    l.object_vergence /= s;
    l.sensor.pitch_um *= s;
}

proptest! {
    #![proptest_config(config())]

    /// What is written is read again to the last bit.
    #[test]
    fn files_keep_every_bit(lens in lens()) {
        let text = prescription::to_toml(&lens);
        prop_assert_eq!(&prescription::from_toml(&text, "lens.toml").expect("written by the program"), &lens);
    }

    /// Light that stays on the surfaces goes back the way it came, to 1e-9 of the first aperture.
    #[test]
    fn rays_go_back_the_way_they_came(lens in lens(), launch in launch()) {
        let system = System::new(&lens, lens.wavelengths.primary_nm);
        let Some(hits) = through(&system, ray(&lens, launch)) else { return Ok(()) };
        let (first, last) = (hits[0], hits[system.image()]);
        // Surfaces go on to a tenth beyond their clear apertures; further out a ray may meet another root first on its way back.
        if hits.iter().zip(&system.surfaces).any(|(h, s)| h.at.point.truncate().length() > s.domain) {
            return Ok(());
        }
        // Seen from the sensor z counts towards the object.
        let turned = |d: DVec3| DVec3::new(-d.x, -d.y, d.z);
        let back = Ray { origin: last.at.point, direction: turned(last.direction) };
        let reversed = system.reversed();
        let Some(returned) = through(&reversed, back) else {
            return Err(TestCaseError::fail("it does not come back"));
        };
        let end = returned[reversed.image()];
        let off = (end.at.point.truncate() - first.at.point.truncate()).length() / lens.surfaces[0].semi_diameter;
        // A ray that grazes a surface feels its rounding magnified; such rays refract by more than 60°.
        let grazing = hits.iter().any(|h| h.direction.dot(h.incoming) < 0.5);
        prop_assert!(off < 1e-9 || grazing && off < 1e-6, "place off by {:e}", off);
        prop_assert!((end.direction - turned(first.incoming)).length() < 1e-9 || grazing, "direction");
        let [there, again] = [last.optical_path - first.optical_path, end.optical_path];
        prop_assert!((there - again).abs() < 1e-9 * there.abs().max(1.0), "path {} and {}", there, again);
    }

    /// A lens of another size shows the same, larger.
    #[test]
    fn lengths_scale_together(lens in lens(), launch in launch(), power in -2.0..2.0f64) {
        let s = 10f64.powf(power);
        // Sizes have bounds.
        let Ok(large) = lens.changed(|l| enlarge(l, s)) else { return Ok(()) };
        let nm = lens.wavelengths.primary_nm;
        let systems = [System::new(&lens, nm), System::new(&large, nm)];
        let hits = [through(&systems[0], ray(&lens, launch)), through(&systems[1], ray(&large, launch))];
        let [Some(a), Some(b)] = hits else {
            prop_assert!(hits[0].is_none() && hits[1].is_none(), "one gets through, the other not");
            return Ok(());
        };
        let (a, b) = (a[systems[0].image()], b[systems[1].image()]);
        let size = lens.length().max(lens.surfaces[0].semi_diameter);
        prop_assert!((b.at.point / s - a.at.point).length() < 1e-9 * size, "place");
        prop_assert!((b.direction - a.direction).length() < 1e-9, "direction");
        prop_assert!((b.optical_path / s - a.optical_path).abs() < 1e-9 * size, "path");
    }

    /// A lens that is symmetric about its axis turns with the ray.
    #[test]
    fn rays_turn_with_the_azimuth(lens in lens(), launch in launch(), angle in 0.0..6.3f64) {
        prop_assume!(lens.is_symmetric());
        let system = System::new(&lens, lens.wavelengths.primary_nm);
        let turn = glam::DMat3::from_rotation_z(angle);
        let Ray { origin, direction } = ray(&lens, launch);
        let hits = [through(&system, Ray { origin, direction }),
            through(&system, Ray { origin: turn * origin, direction: turn * direction })];
        let [Some(a), Some(b)] = hits else {
            prop_assert!(hits[0].is_none() && hits[1].is_none(), "one gets through, the other not");
            return Ok(());
        };
        let (a, b) = (a[system.image()], b[system.image()]);
        let size = lens.length().max(lens.surfaces[0].semi_diameter);
        prop_assert!((turn * a.at.point - b.at.point).length() < 1e-9 * size, "place");
        prop_assert!((turn * a.direction - b.direction).length() < 1e-9, "direction");
    }

    /// ⟨bar, J dot⟩ = ⟨Jᵀ bar, dot⟩ of the trace.
    #[test]
    fn the_adjoint_is_the_transpose(
        lens in lens(),
        launch in launch(),
        numbers in prop::collection::vec(-1.0..1.0f64, 12),
    ) {
        let system = System::new(&lens, lens.wavelengths.primary_nm);
        let ray = ray(&lens, launch);
        let Some(hits) = through(&system, ray) else { return Ok(()) };
        let vector = |k: usize| DVec3::from_slice(&numbers[3 * k..]);
        let turn = vector(1);
        let dot = RayDot { point: vector(0), direction: turn - ray.direction * ray.direction.dot(turn) };
        let moved = trace_jvp(&system, &hits, dot);
        let mut bars = vec![HitBar::default(); hits.len()];
        bars[system.image()] = HitBar { point: vector(2), direction: vector(3), optical_path: 0.0 };
        let (o, d) = trace_vjp(&system, &hits, &bars, &mut SystemGradient::zeros(&system));
        let pulled = o.dot(dot.point) + d.dot(dot.direction);
        let pushed = moved.point.dot(vector(2)) + moved.direction.dot(vector(3));
        // Rounding counts against the terms, which may cancel.
        let size = moved.point.length() + moved.direction.length();
        prop_assert!((pulled - pushed).abs() < 1e-10 * size.max(1.0), "{:e} and {:e}", pulled, pushed);
    }

    /// Whatever the numbers, a lens is refused or traced: a ray's outcome is a place or a cause, never NaN.
    #[test]
    fn any_numbers_are_refused_or_traced(which in 0..LENSES.len(), moves in prop::collection::vec(-1.0..1.0f64, 96),
        power in -3.0..6.0f64, launch in launch()) {
        let lens = builtin::lens(LENSES[which].0).expect("shipped");
        let variables = Variables::all(&lens);
        let moved: Vec<f64> = variables.values(&lens).iter().zip(moves.iter().cycle())
            .map(|(v, m)| v + 10f64.powf(power) * m).collect();
        let Ok(lens) = variables.lens(&lens, &moved) else { return Ok(()) };
        let system = System::new(&lens, lens.wavelengths.primary_nm);
        for hit in through(&system, ray(&lens, launch)).into_iter().flatten() {
            prop_assert!(hit.at.point.is_finite() && hit.direction.is_finite() && hit.optical_path.is_finite());
        }
    }
}
