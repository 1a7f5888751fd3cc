//! White on the axis: the level that pictures are relative to.
//!
//! On the axis of a rotationally symmetric lens a scene of radiance 1 gives the irradiance
//! `∫ n'² cos⁴θ / Z² dA = π n'² Σ (sin²θ_out − sin²θ_in)` over the intervals of angle that pass. The PSF grid's own level
//! there, throughput × Jacobian of one object point, differs from it where the blur is not the same all around a sensor
//! point: by 1e-4 to 9e-3 on the shipped lenses, per channel.

use glam::DVec3;

use crate::lens::Lens;
use crate::psf::grid::PsfPlan;
use crate::trace::exact::first_vignetted;
use crate::trace::sequential::trace;
use crate::trace::{Ray, System};

/// Irradiance on the axis of a white scene of radiance 1 at `nm`, sr; 0 if no light passes.
pub fn on_axis(lens: &Lens, nm: f64) -> f64 {
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

/// The same for every channel of a plan: the sum over its wavelengths with their weights.
pub fn on_axis_of(lens: &Lens, plan: &PsfPlan) -> Vec<f64> {
    let each: Vec<f64> = plan.wavelength_nm.iter().map(|nm| on_axis(lens, *nm)).collect();
    plan.weight.iter().map(|w| w.iter().zip(&each).map(|(w, e)| w * e).sum()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::{Aperture, Medium, Shape, Surface, builtin};

    /// A hole of radius 3 at 20 mm: `π sin²θ`; the closed form to rounding of the bisection.
    #[test]
    fn a_hole_lets_through_what_it_subtends() {
        let mut lens = builtin::lens("cooke_triplet").expect("shipped");
        lens.surfaces = vec![Surface {
            shape: Shape::default(),
            thickness: 20.0,
            medium: Medium::Air,
            semi_diameter: 3.0,
            pose: None,
        }];
        lens.stop = 0;
        lens.aperture = Aperture::StopSemiDiameter(3.0);
        let exact = std::f64::consts::PI * 9.0 / 409.0;
        assert!((on_axis(&lens, 550.0) - exact).abs() < 1e-12 * exact);
    }

    /// What the PSF grid's own level lacks is small, and not nothing.
    #[test]
    fn the_grids_own_level_is_near() {
        use crate::imaging::plan::{Quality, frame_of, plan};
        use crate::imaging::sensor::Sensor;
        use crate::imaging::spectrum::SpectralDensity;
        for name in ["two_element", "cooke_triplet", "phone"] {
            let lens = builtin::lens(name).expect("shipped");
            let frame = frame_of(&lens).expect("valid");
            let density = SpectralDensity::new(&Sensor::generic());
            let plan = plan(&lens, lens.object_vergence, &frame, &density, Quality::TRAINING, None).expect("plans");
            eprintln!("{name}: white on the axis / the grid's level there {:?}", plan.white);
            assert!(plan.white.iter().all(|w| (w - 1.0).abs() < 0.015), "{name}: {:?}", plan.white);
            assert!(plan.white.iter().any(|w| (w - 1.0).abs() > 1e-4), "{name}: {:?}", plan.white);
        }
    }
}
