//! Rows and chief rays against differences of the lens.

use super::*;
use crate::lens::{builtin, variables::Variables};
use glam::DVec2;

use super::super::fit::{Of, Parity};
use super::super::stop::StopPoints;
use crate::trace::System;
use isoplanat_base::testing::{assert_rel, between, central_difference};

#[test]
fn rows_and_chief_rays_pull_back_to_the_lens() {
    for (name, radius) in [("two_element", 20.0), ("cooke_triplet", 17.0), ("phone", 3.2)] {
        let lens = builtin::lens(name).expect("shipped");
        let radii_mm = (0..=8).map(|i| radius * f64::from(i) / 8.0).collect();
        let spec = TableSpec { radii_mm, wavelength_nm: vec![480.0, 600.0], degree: 5, lit: false };
        let table = Table::compute(&lens, &spec).expect("traces");
        let rng = &mut fastrand::Rng::with_seed(6);
        // With knots mirrored at the axis and without.
        let places = [(0, 0.05 * radius), (1, 0.83 * radius)];
        let mut random = |n: usize| -> Vec<f64> { (0..n).map(|_| between(rng, -1.0, 1.0)).collect() };
        let rows_bar = [random(table.layout.len()), random(table.layout.len())];
        let slopes_bar = random(9);
        let vergence = 1e-3;
        let value = |lens: &Lens| -> f64 {
            let t = Table::compute(lens, &spec).expect("traces");
            let rows = places.iter().zip(&rows_bar).map(|((l, r), bar)| {
                t.row(*l, &t.taps(*r)).coefficients.iter().zip(bar).map(|(a, b)| a * b).sum::<f64>()
            });
            rows.sum::<f64>() + t.chief_slopes(vergence).iter().zip(&slopes_bar).map(|(a, b)| a * b).sum::<f64>()
        };
        let mut bar = TableBar::zeros(&table);
        for ((l, r), row_bar) in places.iter().zip(&rows_bar) {
            table.row_vjp(*l, &table.taps(*r), row_bar, &mut bar);
        }
        table.chief_slopes_vjp(vergence, &slopes_bar, &mut bar);
        let variables = Variables::all(&lens);
        let (x, pulled) = (variables.values(&lens), variables.gradient(&table.vjp(&lens, &bar)));
        let norm = pulled.iter().map(|g| g * g).sum::<f64>().sqrt();
        for seed in 0..4 {
            let rng = &mut fastrand::Rng::with_seed(seed);
            let dx: Vec<f64> = x.iter().map(|_| between(rng, -0.5, 0.5)).collect();
            let found: f64 = pulled.iter().zip(&dx).map(|(a, b)| a * b).sum();
            let f = |h: f64| {
                let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                value(&variables.lens(&lens, &moved).expect("a lens"))
            };
            assert_rel(found, central_difference(f, 1e-5), 1e-6, 1e-3 * norm, &format!("{name}, direction {seed}"));
        }
    }
}

/// Any number of knots, read from anywhere, no farther out than allowed: weights of polynomials, even where knots are mirrored.
#[test]
fn taps_are_knots_that_are_there() {
    for n in 1..9usize {
        let radii: Vec<f64> = (0..n).map(|i| 0.5 * i as f64).collect();
        for place in 0..40 {
            let radius = 0.1 * f64::from(place);
            let after = radii.partition_point(|r| *r <= radius);
            for beyond in [1, 3, 4] {
                let all = taps(&radii, radius, TAPS, beyond);
                assert!(
                    all.len() <= TAPS
                        && all.iter().all(|t| t.knot < if t.mirrored { n } else { (after + beyond).min(n) }),
                    "{n} {radius} {beyond}"
                );
                let sum = |f: &dyn Fn(f64) -> f64| -> f64 {
                    all.iter().map(|t| t.weight * f(if t.mirrored { -radii[t.knot] } else { radii[t.knot] })).sum()
                };
                assert_rel(sum(&|_| 1.0), 1.0, 1e-12, 0.0, "weights");
                let held = radius.min(radii[n - 1]);
                if n > 1 {
                    assert_rel(sum(&|r| r * r), held * held, 1e-11, 1.0, "squares");
                }
            }
        }
    }
}

/// A table whose knots were chosen on the way is, to the bit, the one traced at these knots at once: a design that goes on from its file goes on the same.
#[test]
fn adapted_tables_are_those_of_their_knots() {
    // All rays arrive; rays of a part of the stop fail; light ends within the frame.
    for (name, radius) in [("cooke_triplet", 17.0), ("sonnar", 20.0), ("biotar", 21.0)] {
        let lens = builtin::lens(name).expect("shipped");
        let (wavelength_nm, vergence) = (vec![450.0, 540.0, 600.0, 650.0], lens.object_vergence);
        let tolerance = Tolerance { landing_mm: 2e-3, weight: 1e-3 };
        let adapted = Adapted::compute(&lens, vergence, &wavelength_nm, 7, radius, tolerance).expect("traces");
        let TableSpec { degree, lit, .. } = adapted.table.spec;
        let spec = TableSpec { radii_mm: adapted.radii_mm.clone(), wavelength_nm, degree, lit };
        let plain = Table::compute(&lens, &spec).expect("traces");
        assert_eq!((&adapted.table.spec, adapted.table.edge_mm), (&plain.spec, plain.edge_mm), "{name}");
        for (a, b) in adapted.table.rows.iter().flatten().zip(plain.rows.iter().flatten()) {
            assert!(a.part == b.part && a.coefficients == b.coefficients, "{name}");
        }
        assert_eq!(adapted.table.chief_slopes(vergence), plain.chief_slopes(vergence), "{name}");
    }
}

/// Rays with light, traced one by one at points of the stop that are no nodes, are where the polynomials say, at knots of fast lenses that vignette: rays beside the light, which
/// run wild or fail, are not what the polynomials are made for. What cannot be told is said.
#[test]
fn rays_with_light_are_told_within_the_tolerance() {
    let pitch_mm = 6e-3;
    let tolerance = Tolerance { landing_mm: 0.02 * pitch_mm, weight: 1e-3 };
    for (name, radius, told) in [
        ("tessar", 21.6, true),
        ("biotar", 21.6, true),
        ("retrofocus", 21.6, true),
        ("phone", 3.6, true),
        ("sonnar", 21.6, false),
    ] {
        let lens = builtin::lens(name).expect("shipped");
        let (nm, vergence) = (vec![540.0], lens.object_vergence);
        let adapted = Adapted::compute(&lens, vergence, &nm, 9, radius, tolerance).expect("traces");
        let table = &adapted.table;
        let view = SensorView::new(&System::new(&lens, nm[0]));
        let dense = StopPoints::new(table.spec.degree, 300);
        let slopes = table.chief_slopes(vergence);
        let mut worst = 0.0f64;
        for (k, at) in table.spec.radii_mm.iter().enumerate().skip(1).step_by(3) {
            let row = &table.rows[k][0];
            let mm_per_slope = ((at - table.spec.radii_mm[k - 1]) / (slopes[k] - slopes[k - 1])).abs();
            let below = 1.0 - at * at * table.horizon;
            let told = row.slope(table, vergence);
            let values = [(0, Parity::Odd), (1, Parity::Even)]
                .map(|(axis, of)| dense.at[of as usize].at(Of::Value, &told[axis]));
            let (mut square, mut sum, mut hits) = (0.0, 0.0, Vec::new());
            for (q, place) in dense.points.iter().enumerate() {
                let target = *place * table.pupil * view.system.stop_semi_diameter;
                let Ok(cosines) = view.aim(DVec2::new(0.0, *at), target, None, &mut hits) else { continue };
                let Ok(ray) = view.follow(DVec2::new(0.0, *at), cosines, &mut hits) else { continue };
                let clear = view
                    .system
                    .surfaces
                    .iter()
                    .zip(&hits)
                    .all(|(s, h)| h.at.point.truncate().length() <= s.semi_diameter);
                if clear && row.part.depth(*place) > 0.0 {
                    let exact = ray.slope - vergence * ray.entrance;
                    square += (DVec2::new(values[0][q], values[1][q]) / below - exact).length_squared();
                    sum += 1.0;
                }
            }
            worst = worst.max((square / f64::max(sum, 1.0)).sqrt() * mm_per_slope);
        }
        // Between nodes they may be somewhat farther off than at them.
        let most = 3.0 * adapted.errors.landing_mm.max(tolerance.landing_mm);
        assert!(worst <= most, "{name}: {worst} of {most} mm by degree {}", table.spec.degree);
        assert_eq!(adapted.errors.untold(pitch_mm).is_none(), told, "{name}: {:?}", adapted.errors);
    }
}
