use super::*;
use crate::lens::{builtin, variables::Variables};
use crate::trace::ObjectPoint;
use crate::trace::aim::Aimer;
use crate::trace::{System, sequential::trace};
use glam::DVec2;
use isoplanat_base::testing::{assert_abs, assert_rel, between, central_difference, steady_difference};

fn rgb() -> Quadrature {
    Quadrature {
        nm: vec![470.0, 540.0, 610.0],
        weight: vec![vec![0.1, 0.3, 0.6], vec![0.2, 0.7, 0.1], vec![0.8, 0.2, 0.0]],
    }
}

fn spec(radius_mm: f64, vergences: Vec<f64>) -> OpticsSpec {
    let radii_mm = (0..=10).map(|i| radius_mm * f64::from(i) / 10.0).collect();
    OpticsSpec {
        radii_mm,
        vergences,
        quadrature: rgb(),
        degree: 7,
        lit: false,
        illuminations: 24,
        diffraction: Model::Rays,
    }
}

fn written(to: &mut [f64], bar: &[f64]) -> bool {
    to.copy_from_slice(bar);
    true
}

/// Places that share a distance from the axis have the kernels, to the bit, and the pull-back that they have alone; one without
/// a cotangent adds nothing.
#[test]
fn places_that_share_a_radius_are_the_places_alone() {
    let lens = builtin::lens("cooke_triplet").expect("shipped");
    let o = Optics::compute(&lens, &spec(18.0, vec![lens.object_vergence])).expect("traces");
    let form = o.form(120, 15, 2, 0.02);
    let at = |x: f64, y: f64| SensorPoint::at([x, y]);
    let places = [at(9.0, 12.0), at(-2.0, 5.0), at(12.0, -9.0), at(5.0, 2.0), at(0.0, 15.0), at(0.0, 0.0)];
    assert_eq!(by_radius(&places), [vec![0, 2, 4], vec![1, 3], vec![5]]);
    let len = 3 * form.raster.len();
    let rng = &mut fastrand::Rng::with_seed(3);
    let bars: Vec<Vec<f64>> = places.iter().map(|_| (0..len).map(|_| rng.f64() - 0.5).collect()).collect();
    let together = o.kernels_each(&form, 0, &places, |i, k, outside| (i, k.to_vec(), outside.to_vec()));
    let mut alone = OpticsBar::zeros(&o);
    for (i, place) in places.iter().enumerate() {
        let mut kernel = vec![0.0; len];
        let outside = o.kernels(&form, 0, *place, &mut kernel);
        assert_eq!(together[i], (i, kernel, outside), "place {i}");
        // The last has no cotangent.
        let bar = |_: usize, to: &mut [f64]| i + 1 < places.len() && written(to, &bars[i]);
        o.kernels_vjp(&form, 0, &[*place], bar).iter().for_each(|b| alone.add_kernel(&o, 0, b));
    }
    let mut shared = OpticsBar::zeros(&o);
    let bar = |i: usize, to: &mut [f64]| i + 1 < places.len() && written(to, &bars[i]);
    let back = o.kernels_vjp(&form, 0, &places, bar);
    assert_eq!(back.len(), 2, "one a radius with a cotangent");
    back.iter().for_each(|b| shared.add_kernel(&o, 0, b));
    let variables = Variables::all(&lens);
    let [a, b] = [&shared, &alone].map(|bar| variables.gradient(&o.vjp(&lens, bar)));
    let scale = b.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
    a.iter().zip(&b).for_each(|(a, b)| assert_abs(*a, *b, 1e-12 * scale, "gradient"));
}

/// A triplet whose sensor has this radius, mm.
fn curved(radius: f64) -> Lens {
    let curve = |l: &mut crate::lens::Prescription| (l.name, l.image.curvature) = ("curved".into(), 1.0 / radius);
    builtin::lens("cooke_triplet").and_then(|lens| lens.changed(curve)).expect("a lens")
}

/// Kernels, illumination and maps at two depths at once, against differences of every number of the lens: 1e-6.
#[test]
fn the_pull_back_agrees_with_differences() {
    let shipped = [("two_element", 22.0, 19.0), ("cooke_triplet", 18.0, 16.3), ("phone", 3.3, 2.9)];
    let shipped = shipped.map(|(name, radius, place)| (builtin::lens(name).expect("shipped"), radius, place));
    for (lens, radius, place) in shipped.into_iter().chain([(curved(-45.0), 18.0, 16.3)]) {
        let name = &lens.name;
        let vergences = vec![lens.object_vergence, lens.object_vergence + 2e-4];
        let rng = &mut fastrand::Rng::with_seed(9);
        let size = 31;
        let cell = if radius < 4.0 { 0.004 } else { 0.02 };
        let bars: Vec<Vec<f64>> = (0..2).map(|_| (0..3 * size * size).map(|_| rng.f64() - 0.5).collect()).collect();
        let (light_bar, bright) = ([0.7, -0.4, 0.9], SensorPoint::along([0.0, 1.0], 0.93 * radius));
        let places = [SensorPoint::along([0.6, 0.8], place), SensorPoint::along([0.0, -1.0], 0.3 * place)];
        let value = |lens: &Lens| {
            let o = Optics::compute(lens, &spec(radius, vergences.clone())).expect("traces");
            let form = o.form(120, size, 1, cell);
            let mut sum = 0.0;
            for (depth, (place, bar)) in places.iter().zip(&bars).enumerate() {
                let mut k = vec![0.0; 3 * size * size];
                o.kernels(&form, depth, *place, &mut k);
                sum += k.iter().zip(bar).map(|(a, b)| a * b).sum::<f64>();
            }
            sum + light_bar.iter().zip(o.relative_illumination(bright)).map(|(b, v)| b * v).sum::<f64>()
                + 3.0 * o.maps[1].slope(0.8 * radius)
        };
        let o = Optics::compute(&lens, &spec(radius, vergences.clone())).expect("traces");
        let form = o.form(120, size, 1, cell);
        let mut bar = OpticsBar::zeros(&o);
        for (depth, (place, b)) in places.iter().zip(&bars).enumerate() {
            for back in o.kernels_vjp(&form, depth, &[*place], |_, to| written(to, b)) {
                bar.add_kernel(&o, depth, &back);
            }
        }
        o.relative_illumination_vjp(std::iter::once((bright, &light_bar[..])), &mut bar);
        o.maps[1].slope_vjp(0.8 * radius, 3.0, &mut bar.maps[1]);
        let gradient = o.vjp(&lens, &bar);
        let variables = Variables::all(&lens);
        let (x, pulled) = (variables.values(&lens), variables.gradient(&gradient));
        for seed in 0..4 {
            let rng = &mut fastrand::Rng::with_seed(seed);
            let dx: Vec<f64> = x.iter().map(|_| between(rng, -0.5, 0.5)).collect();
            let f = |h: f64| {
                let moved: Vec<f64> = x.iter().zip(&dx).map(|(a, b)| a + h * b).collect();
                value(&variables.lens(&lens, &moved).expect("a lens"))
            };
            let found: f64 = pulled.iter().zip(&dx).map(|(a, b)| a * b).sum();
            // Kinks of the splats' second derivatives, and the aiming's last digits.
            let steps = (0..14).map(|k| 2e-7 * 1.3f64.powi(k));
            let numeric = steady_difference(|h| central_difference(f, h), steps);
            assert_rel(found, numeric, 1e-6, 1e-2, &format!("{name} seed {seed}"));
        }
    }
}

/// Displacements against rays aimed from the scene: the ray of the object seen at `u` lands where the kernel's displacement
/// says, for another depth than the lens's own too.
#[test]
fn displacements_are_those_of_traced_rays() {
    let shipped = [("two_element", 20.0, 2e-4), ("cooke_triplet", 17.0, 1e-4), ("phone", 3.2, 1e-4)];
    let shipped = shipped.map(|(name, radius, tolerance)| (builtin::lens(name).expect("shipped"), radius, tolerance));
    for (lens, radius, tolerance) in shipped.into_iter().chain([(curved(-45.0), 17.0, 1e-4)]) {
        let name = &lens.name;
        for vergence in [lens.object_vergence, lens.object_vergence + 5e-4] {
            let mut spec = OpticsSpec::even(radius, vec![vergence], rgb());
            spec.radii_mm = (0..=24).map(|i| radius * f64::from(i) / 24.0).collect();
            let o = Optics::compute(&lens, &spec).expect("traces");
            let form = o.form(60, 3, 1, 0.01);
            let system = System::new(&lens, 540.0);
            let mut worst = 0.0f64;
            for at in [0.0, 0.31 * radius, 0.83 * radius] {
                let rays = form.rays(o.table(), &o.maps[0], 1, SensorPoint::along([0.0, 1.0], at));
                for (q, s) in form.points.points.iter().enumerate() {
                    // The raster's point that the ray shows, and that object's slope.
                    let d = [-rays.x[q], at - rays.y[q]];
                    let ratio = o.maps[0].ratio(d[0].hypot(d[1]));
                    let object = ObjectPoint::from_slope(DVec2::new(d[0], d[1]) * ratio, vergence);
                    let target = *s * o.table().pupil * system.stop_semi_diameter;
                    let mut hits = Vec::new();
                    let aimed = Aimer::new(&system).and_then(|a| a.aim(object, target, None)).expect("aims");
                    let hit = trace(&system, aimed.ray, system.image(), &mut hits).expect("lands");
                    worst = worst.max((hit.at.point.truncate() - DVec2::new(0.0, at)).length());
                }
            }
            eprintln!("{name} at {vergence}: {worst:e} mm");
            assert!(worst < tolerance * radius / 20.0 * 2.0, "{name} {vergence}: {worst:e} mm");
        }
    }
}

/// Kernels sum to one less what falls outside, and turn with the field by exact quarter turns.
#[test]
fn kernels_sum_to_one_and_turn_with_the_field() {
    let lens = builtin::lens("two_element").expect("shipped");
    let o = Optics::compute(&lens, &spec(20.0, vec![1e-3])).expect("traces");
    for (size, samples) in [(61, 1), (31, 2), (61, 4)] {
        let form = o.form(400, size, samples, 0.02);
        let side = size * samples;
        let mut kernels: Vec<Vec<f64>> = Vec::new();
        for outward in [[1.0, 0.0], [0.0, 1.0]] {
            let mut k = vec![0.0; 3 * side * side];
            let outside = o.kernels(&form, 0, SensorPoint::along(outward, 14.9), &mut k);
            for (c, plane) in k.chunks_exact(side * side).enumerate() {
                assert_abs(plane.iter().sum::<f64>() + outside[c], 1.0, 1e-12, "energy");
            }
            kernels.push(k);
        }
        for (i, j) in (0..side).flat_map(|i| (0..side).map(move |j| (i, j))) {
            // From along +column to along +row: (row, col) → (col, −row).
            assert_abs(kernels[1][j * side + side - 1 - i], kernels[0][i * side + j], 1e-12, "turned");
        }
    }
}
