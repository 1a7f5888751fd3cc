//! A white frame against hard-edge quadrature from the sensor, over the whole field of six lenses.

use isoplanat::imaging::frame::Frame;
use isoplanat::imaging::render::plan::{ILLUMINATIONS, optics};
use isoplanat::lens::{Lens, builtin};
use isoplanat::psf::table::chief_slopes;
use isoplanat::psf::{Quadrature, SensorPoint};

use crate::support::lens_file;
use crate::white_oracle::{irradiance, vignetting_onsets};

const NM: f64 = 546.1;

fn lenses() -> Vec<Lens> {
    let shipped = ["cooke_triplet", "double_gauss", "al2550_a", "two_element", "phone"];
    let mut all: Vec<Lens> = shipped.iter().map(|name| builtin::lens(name).expect("shipped")).collect();
    all.push(lens_file("benches/lenses/wide_100.toml"));
    all
}

/// A frame of 300 × 200 pixels whose corner sees the end of the field.
fn whole_field(lens: &Lens) -> Frame {
    let edge = lens.max_field_deg().to_radians().tan();
    let radii: Vec<f64> = (1..=400).map(|i| lens.sensor.radius_mm() * f64::from(i) / 200.0).collect();
    let slopes = chief_slopes(lens, lens.object_vergence, &radii).expect("light");
    let last = slopes.partition_point(|s| *s < edge) - 1;
    Frame::centred(300, 200, radii[last] / 0.5 / 300f64.hypot(200.0)).expect("valid")
}

/// Relative illumination at `count` radii and at every onset of vignetting: rms 2e-4, 1e-3 at worst.
fn white_is_right(count: u32) {
    for lens in lenses() {
        let frame = whole_field(&lens);
        let corner = frame.max_radius_mm();
        let rule = Quadrature { nm: vec![NM], weight: vec![vec![1.0]] };
        let optics = optics(&lens, &frame, &[lens.object_vergence], rule, (7, ILLUMINATIONS)).expect("traces").0;
        let onsets = vignetting_onsets(&lens, NM, corner);
        let even = (1..=count).map(|k| corner * f64::from(k) / f64::from(count));
        let axis = irradiance(&lens, NM, 0.0, 1000);
        let (mut square, mut worst, mut n) = (0.0, (0.0f64, 0.0), 0.0);
        for radius in even.chain(onsets.iter().flat_map(|r| [0.998 * r, *r, 1.002 * r])).filter(|r| *r <= corner) {
            let truth = irradiance(&lens, NM, radius, 1000) / axis;
            let off = optics.relative_illumination(SensorPoint::along([0.0, 1.0], radius))[0] - truth;
            square += off * off;
            n += 1.0;
            if off.abs() > worst.0 {
                worst = (off.abs(), radius);
            }
        }
        let rms = f64::sqrt(square / n);
        eprintln!(
            "{}: rms {rms:.1e}, worst {:.1e} at {:.3} of {corner:.3} mm, onsets {onsets:.2?}",
            lens.name, worst.0, worst.1
        );
        assert!(rms <= 2e-4 && worst.0 <= 1e-3, "{}: rms {rms:e}, worst {worst:?}", lens.name);
    }
}

#[test]
fn white_agrees_with_hard_edged_quadrature() {
    white_is_right(12);
}

#[test]
#[ignore = "a minute: 200 radii a lens"]
fn white_agrees_with_hard_edged_quadrature_at_two_hundred_places() {
    white_is_right(200);
}
