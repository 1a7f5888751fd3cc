//! Strehl ratio and encircled energy against closed forms.

use super::*;
use crate::psf::wave::{PointSpread, Untold};

const LIGHT: f64 = 5e-4;

fn alone(pupil: Pupil) -> PointSpread {
    PointSpread::new(&[(pupil, 1.0)]).expect("light")
}

/// A perfect lens: a Strehl ratio of 1; 83.8 % of the light within the first dark ring, 91.0 % within the second; radii that hold shares of it are those of `1 − J₀² − J₁²`.
#[test]
fn a_perfect_lens_has_airys_energy() {
    for na in [0.02, 0.1, 0.4] {
        let found = alone(Pupil::perfect(LIGHT, na, 0.0));
        assert_abs(found.strehl(), 1.0, 1e-9, "Strehl");
        let unit = LIGHT / na;
        let rings = [0.609_834_9, 1.116_576].map(|r| found.encircled(r * unit));
        eprintln!("{na}: {rings:?} {:?}", [0.5, 0.8, 0.95].map(|p| found.radius_of(p).expect("told") / unit));
        assert_abs(rings[0], 0.837_785, 1e-3, "first ring");
        assert_abs(rings[1], 0.909_930, 1e-3, "second ring");
        // The middle: the peak's density over a small circle.
        let small = 0.01 * unit;
        assert_rel(found.encircled(small), (PI * na / LIGHT * small).powi(2), 1e-3, 0.0, "the middle");
        for (part, radius) in [(0.5, 0.267_62), (0.8, 0.449_0)] {
            let radius_mm = found.radius_of(part).expect("told");
            let v = TAU * radius_mm / unit;
            let exact = 1.0 - bessel(0, v).powi(2) - bessel(1, v).powi(2);
            assert_abs(exact, part, 1e-3, "share");
            assert_rel(radius_mm / unit, radius, 2e-2, 0.0, "radius");
        }
        assert!(found.encircled(found.farthest()) < 1.0 + 1e-9 && found.radius_of(1.1).is_none());
        assert_eq!([found.encircled(0.0), found.encircled(f64::NAN), found.encircled(-1.0)], [0.0; 3]);
    }
}

/// `J_n(x)` by Bessel's integral.
fn bessel(n: u32, x: f64) -> f64 {
    let count = 400;
    let at = |k: i32| {
        let t = PI * (f64::from(k) + 0.5) / f64::from(count);
        (f64::from(n) * t - x * t.sin()).cos()
    };
    (0..count).map(at).sum::<f64>() / f64::from(count)
}

/// Out of focus by `W` waves at the rim: `sinc²(W)`.
#[test]
fn defocus_costs_what_the_closed_form_says() {
    for waves in [0.05, 0.1, 0.25, 0.4, 0.49, -0.3] {
        let found = alone(Pupil::perfect(LIGHT, 0.1, waves));
        let exact = ((PI * waves).sin() / (PI * waves)).powi(2);
        eprintln!("{waves} waves: {} for {exact}", found.strehl());
        assert_abs(found.strehl(), exact, 1e-3, "Strehl");
        assert!(found.peak().length() < 1e-3 * LIGHT / 0.1, "{}", found.peak());
    }
    // From 0.77 waves on a ring is brighter than the axis: a whole wave is dark there, not everywhere (0.0490 at 0.6 λ/NA, by Lommel's integral).
    let whole = alone(Pupil::perfect(LIGHT, 0.1, 1.0));
    assert!(whole.strehl() > 0.02 && whole.peak().length() > 0.2 * LIGHT / 0.1, "{} {}", whole.strehl(), whole.peak());
    let many = PointSpread::new(&[(Pupil::perfect(LIGHT, 0.1, 200.0), 1.0)]);
    assert_eq!(many.expect_err("as rays are"), Untold::Blurred);
    assert_eq!(PointSpread::new(&[]).expect_err("nothing"), Untold::Dark);
    assert_eq!(PointSpread::new(&[(Pupil::perfect(LIGHT, 0.1, 0.0), 0.0)]).expect_err("no weight"), Untold::Dark);
}

/// Ten waves out of focus: Lommel's integral over circles, which is that of rays, a disk of `2 W λ/NA`, but for what bends at its edge.
#[test]
fn of_many_waves_energy_is_lommels() {
    let (na, waves) = (0.1, 10.0);
    let found = alone(Pupil::perfect(LIGHT, na, waves));
    for (radius, exact) in [(8.9, 0.203_50), (14.1, 0.501_43), (17.9, 0.852_07), (26.0, 0.990_58)] {
        let held = found.encircled(radius * LIGHT / na);
        eprintln!("{radius} λ/NA: {held} for {exact}, of rays {}", (radius / (2.0 * waves)).powi(2).min(1.0));
        assert_abs(held, exact, 3e-3, "share");
    }
}

/// Two wavelengths by their light: of perfect ones the sum is perfect, energy is the mean; weights count beside the light.
#[test]
fn wavelengths_add_by_light() {
    let pupil = |nm: f64, na: f64, waves: f64| Pupil::perfect(nm * 1e-6, na, waves);
    let pair = [(pupil(450.0, 0.1, 0.0), 1.0), (pupil(650.0, 0.1, 0.0), 3.0)];
    let both = PointSpread::new(&pair).expect("light");
    assert_abs(both.strehl(), 1.0, 1e-9, "Strehl");
    let [blue, red] = pair.map(|(p, _)| alone(p));
    for radius in [1e-3, 3e-3, 6e-3, 12e-3] {
        let mean = 0.25 * blue.encircled(radius) + 0.75 * red.encircled(radius);
        assert_abs(both.encircled(radius), mean, 2e-4, "mean");
    }
    // The light of a cone goes with the square of its aperture; the peak of each with that over the square of its wavelength.
    let defocused = [(pupil(450.0, 0.1, 0.4), 1.0), (pupil(650.0, 0.2, 0.0), 2.0)];
    let peaks = [(0.1f64 / 450.0).powi(2) * 0.01, (0.2f64 / 650.0).powi(2) * 0.04 * 2.0];
    let [a, b] = defocused.clone().map(|(p, _)| alone(p).strehl());
    let found = PointSpread::new(&defocused).expect("light").strehl();
    assert_abs(found, (peaks[0] * a + peaks[1] * b) / (peaks[0] + peaks[1]), 1e-3, "Strehl");
}
