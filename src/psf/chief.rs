//! Chief rays: the landing of the ray through the stop's centre, with adjoint.

use glam::{DVec2, DVec3};

use crate::lens::{Lens, LensGradient};
use crate::trace::aim::{ParaxialPupil, aim, aim_vjp};
use crate::trace::launch::{FieldPoint, launch, launch_vjp};
use crate::trace::sequential::{HitBar, trace, trace_vjp};
use crate::trace::{Failure, System, SystemGradient};

/// Image height in mm (along +y) of each object slope, chief ray of the primary wavelength.
pub fn chief_heights(lens: &Lens, vergence: f64, slopes: &[f64]) -> Result<Vec<f64>, Failure> {
    let system = System::new(lens, lens.wavelengths.primary_nm);
    let pupil = ParaxialPupil::new(lens);
    let mut hits = Vec::new();
    slopes
        .iter()
        .map(|s| {
            let field = FieldPoint { slope: DVec2::new(0.0, *s), vergence };
            let e = aim(&system, pupil, field, DVec2::ZERO, None, &mut hits)?;
            Ok(trace(&system, launch(field, e), system.image(), &mut hits)?.at.point.y)
        })
        .collect()
}

/// Pulls cotangents on [`chief_heights`] back to the lens (added to `gradient`).
pub fn chief_heights_vjp(
    lens: &Lens,
    vergence: f64,
    slopes: &[f64],
    heights_bar: &[f64],
    gradient: &mut LensGradient,
) -> Result<(), Failure> {
    let system = System::new(lens, lens.wavelengths.primary_nm);
    let pupil = ParaxialPupil::new(lens);
    let mut out = SystemGradient::zeros(&system);
    let mut hits = Vec::new();
    for (s, bar) in slopes.iter().zip(heights_bar) {
        let field = FieldPoint { slope: DVec2::new(0.0, *s), vergence };
        let e = aim(&system, pupil, field, DVec2::ZERO, None, &mut hits)?;
        let ray = launch(field, e);
        trace(&system, ray, system.image(), &mut hits)?;
        let mut bars = vec![HitBar::default(); system.image() + 1];
        bars[system.image()].point = DVec3::new(0.0, *bar, 0.0);
        let (o, d) = trace_vjp(&system, &hits, &bars, &mut out);
        let (e_bar, _) = launch_vjp(field, ray, o, d);
        aim_vjp(&system, field, e, &hits, e_bar, &mut out);
    }
    out.add_to(lens, system.wavelength_nm, gradient);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::builtin;
    use crate::lens::variables::Variables;
    use crate::testing::{assert_rel, central_difference};
    use crate::trace::test_lenses::laikin_100;

    /// A 100° lens, whose chief rays the paraxial pupil does not guess.
    #[test]
    fn chief_rays_of_a_wide_lens_rise_with_the_field() {
        let lens = laikin_100();
        let slopes: Vec<f64> = (0..=50).map(|deg| f64::from(deg).to_radians().tan()).collect();
        let heights = chief_heights(&lens, 0.0, &slopes).expect("aims");
        assert!(heights.windows(2).all(|w| w[1] > w[0]), "{heights:?}");
        // Barrel distortion: less than f tan θ, more than f sin θ.
        let f = crate::lens::paraxial::first_order(&lens, 587.5618).effective_focal_length;
        let edge = heights[50] / f;
        assert!((0.7..1.2).contains(&edge), "{edge}");
    }

    #[test]
    fn chief_heights_vjp_agrees_with_differences() {
        for name in ["two_element", "cooke_triplet", "phone"] {
            let lens = builtin::lens(name).expect("shipped");
            let slopes = [0.0, 0.1, 0.25, 0.3];
            let bar = [0.3, -1.0, 0.5, 2.0];
            let v = lens.object_vergence;
            let mut g = LensGradient::zeros(&lens);
            chief_heights_vjp(&lens, v, &slopes, &bar, &mut g).expect("traces");
            let vars = Variables::all(&lens);
            let x = vars.values(&lens);
            for seed in 0..5 {
                let rng = &mut fastrand::Rng::with_seed(seed);
                let dx: Vec<f64> = x.iter().map(|_| rng.f64() - 0.5).collect();
                let pulled: f64 = vars.gradient(&g).iter().zip(&dx).map(|(a, b)| a * b).sum();
                let f = |h: f64| {
                    let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                    let y = chief_heights(&vars.lens(&lens, &moved), v, &slopes).expect("traces");
                    y.iter().zip(&bar).map(|(a, b)| a * b).sum::<f64>()
                };
                assert_rel(pulled, central_difference(f, 1e-5), 1e-7, 1e-3, &format!("{name} seed {seed}"));
            }
        }
    }
}
