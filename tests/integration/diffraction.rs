//! Diffraction transfer functions against Optiland's (`../shared/golden`): 0.02, its own sampling's worth.

use glam::DVec3;
use isoplanat::analysis::diffraction::{Plan, Pupil, of_pupils};
use isoplanat::analysis::wavefront::rays::chief_landing;
use isoplanat::trace::ObjectPoint;
use isoplanat::trace::aim::Aimer;

use crate::golden::{LENSES, number, numbers, read, system};

/// All lenses and fields there, d line, tangential and sagittal.
#[test]
fn transfer_functions_agree_with_optiland() {
    let (mut count, mut worst) = (0, 0.0f64);
    for name in LENSES {
        let Some(golden) = read(name) else { return };
        let of = &golden["optiland_analyses_d_line"]["mtf_diffraction_fft"];
        let largest = numbers(&golden["fields_deg"]).into_iter().fold(0.0, f64::max).to_radians();
        let s = system(&golden, 1);
        let aimer = Aimer::new(&s).expect("has a stop");
        for row in of["values"].as_array().expect("list") {
            let angle = largest * number(&row["field"][1]);
            let object = ObjectPoint::infinite(DVec3::new(0.0, angle.sin(), angle.cos()));
            let centre = chief_landing(&aimer, object).expect("lands");
            let pupil = Pupil::trace(&aimer, object, centre).expect("light");
            let plan = Plan::new(object, numbers(&of["frequencies_cy_per_mm"]));
            let mtf = of_pupils(&[(pupil, 1.0)], &plan).expect("light");
            for (curve, key) in mtf.curves.iter().zip(["tangential", "sagittal"]) {
                for (k, theirs) in numbers(&row[key]).into_iter().enumerate() {
                    let ours = curve.modulus(0, k).expect("followed");
                    let error = (ours - theirs).abs();
                    eprintln!(
                        "{name} {:.1}° {key} {} /mm: {ours:.4}, Optiland {theirs:.4}, {error:.4}",
                        angle.to_degrees(), plan.frequencies[k]
                    );
                    assert!(error.is_finite());
                    worst = worst.max(error);
                    count += 1;
                }
                eprintln!("  samplings {:e}, residual {:e} waves", curve.error, mtf.residual_waves);
            }
        }
    }
    eprintln!("{count} values of Optiland: worst {worst}");
    assert!(worst < 0.02, "{worst}");
}
