//! The adjoint of the fast trace against the plain one.

use glam::DVec3;

use super::super::{Bundle, Level, Options, Rays, TILE, Tile, trace_batch, trace_gradient};
use super::{fill, nominal, nudged, plain, rays, systems, vary};
use crate::lens::test_lenses::{every_kind, numbers as of_shape};
use crate::lens::{builtin, unchecked};
use crate::trace::sequential::{HitBar, trace_vjp};
use crate::trace::{Ray, System, SystemGradient};
use isoplanat_base::testing::{assert_rel, between, central_difference};

/// Cotangents of a landing: any smooth function of all seven numbers.
fn weights(i: usize, ray: Ray, path: f64) -> (f64, HitBar) {
    let k = (i % 97) as f64 * 0.07;
    let w = [k.sin(), k.cos(), 0.3 * (2.0 * k).sin(), 5.0 * (3.0 * k).cos(), 4.0 * (5.0 * k).sin(), k.cos() + 0.2];
    let (p, d) = (ray.origin, ray.direction);
    let loss = w[0] * p.x + w[1] * p.y + w[2] * p.z + w[3] * d.x + w[4] * d.y + w[5] * d.z + 0.1 * k * path;
    let point = DVec3::new(w[0], w[1], w[2]);
    (loss, HitBar { point, direction: DVec3::new(w[3], w[4], w[5]), optical_path: 0.1 * k })
}

fn landing(first: usize, tile: &Tile, bars: &mut Bundle) -> f64 {
    let mut loss = 0.0;
    for i in 0..tile.len() {
        let (share, bar) = weights(first + i, tile.rays.ray(i), tile.rays.path[i]);
        loss += if tile.status[i].is_none() { share } else { 0.0 };
        bars.set(i, Ray { origin: bar.point, direction: bar.direction });
        bars.path[i] = bar.optical_path;
    }
    loss
}

pub(super) fn gradient(system: &System, given: &Rays, options: Options) -> (f64, SystemGradient) {
    trace_gradient(system, given.len(), options, |first, tile| fill(given, first, tile), landing, None)
}

/// All numbers of the cotangents, in one order.
pub(super) fn numbers(g: &SystemGradient) -> Vec<f64> {
    let mut all = Vec::new();
    g.shapes.iter().for_each(|s| all.extend(of_shape(s)));
    all.extend(g.distances.iter().chain(&g.indices));
    for m in &g.motions {
        all.extend(m.rotation.to_cols_array());
        all.extend(m.shift.to_array());
    }
    all
}

/// Sums over rays of the plain adjoint, and of the absolute values, which measure rounding; ray `i` of `given` has the
/// weights of ray `first + i`.
fn plain_gradient(system: &System, given: &Rays, first: usize) -> (Vec<f64>, Vec<f64>, Vec<Ray>) {
    let (mut hits, mut launch) = (Vec::new(), Vec::new());
    let (mut sum, mut size) = (vec![0.0; numbers(&SystemGradient::zeros(system)).len()], Vec::new());
    size.clone_from(&sum);
    for i in 0..given.len() {
        let mut launch_bar = Ray { origin: DVec3::ZERO, direction: DVec3::ZERO };
        if let Ok(hit) = plain(system, given.ray(i), true, &mut hits) {
            let (p, d) = nominal(system, &hit);
            let (_, bar) = weights(first + i, Ray { origin: p, direction: d }, hit.optical_path);
            let mut bars = vec![HitBar::default(); system.image() + 1];
            let mut one = SystemGradient::zeros(system);
            let last = system.image();
            bars[last] = bar;
            if let Some(m) = system.surfaces[last].motion {
                let back = m.rotation.transpose();
                bars[last].point = back * bar.point;
                bars[last].direction = back * bar.direction;
            }
            let (origin, direction) = trace_vjp(system, &hits, &bars, &mut one);
            if system.surfaces[last].motion.is_some() {
                let outer = |a: DVec3, b: DVec3| glam::DMat3::from_cols(a * b.x, a * b.y, a * b.z);
                one.motions[last].shift += bar.point;
                one.motions[last].rotation += outer(bar.point, hit.at.point) + outer(bar.direction, hit.direction);
            }
            launch_bar = Ray { origin, direction };
            for ((sum, size), v) in sum.iter_mut().zip(&mut size).zip(numbers(&one)) {
                *sum += v;
                *size += v.abs();
            }
        }
        launch.push(launch_bar);
    }
    (sum, size, launch)
}

#[test]
fn gradients_agree_with_the_plain_adjoint() {
    for level in Level::available() {
        let rng = &mut fastrand::Rng::with_seed(21);
        let mut worst = 0.0f64;
        let mut all = systems(rng);
        for (form, lens) in every_kind().alone {
            let there = System::new(&lens, 550.0);
            all.extend([(format!("{form} reversed"), there.reversed()), (form.to_owned(), there)]);
        }
        for (name, system) in all {
            let given = rays(&system, 3 * TILE + 5, rng);
            let options = Options { clip: true, path: false, level: Some(level) };
            let launch_bars =
                std::sync::Mutex::new(vec![Ray { origin: DVec3::ZERO, direction: DVec3::ZERO }; given.len()]);
            let keep = |first: usize, len: usize, bars: &Bundle| {
                let mut all = launch_bars.lock().expect("not poisoned");
                (0..len).for_each(|i| all[first + i] = bars.ray(i));
            };
            let source = |first: usize, tile: &mut Tile| fill(&given, first, tile);
            let (_, found) = trace_gradient(&system, given.len(), options, source, landing, Some(&keep));
            let (expected, size, launch) = plain_gradient(&system, &given, 0);
            // Grazing rays in random lenses: what the plain adjoint itself makes of the last digits of its input.
            let mut moved = vec![0.0f64; size.len()];
            for k in (0..8).filter(|_| !name.contains(" 0")) {
                let near: Rays = (0..given.len()).map(|i| nudged(given.ray(i), k)).collect();
                let (other, ..) = plain_gradient(&system, &near, 0);
                moved.iter_mut().zip(other.iter().zip(&expected)).for_each(|(m, (a, b))| *m = m.max((a - b).abs()));
            }
            let largest = size.iter().copied().fold(0.0, f64::max);
            for (k, ((a, b), size)) in numbers(&found).into_iter().zip(expected).zip(size).enumerate() {
                // Numbers without influence are rounding in both.
                let limit = 1e-10 * size + f64::EPSILON * largest + 8.0 * moved[k];
                worst = worst.max((a - b).abs() / limit.max(f64::MIN_POSITIVE));
                assert!((a - b).abs() <= limit, "{name} {level:?} number {k}: {a:e} {b:e} {size:e}");
            }
            for (i, (a, b)) in launch_bars.lock().expect("not poisoned").iter().zip(&launch).enumerate() {
                let mut limits = [b.origin, b.direction].map(|v| 1e-10 * v.length() + 1e-12);
                if !name.contains(" 0") {
                    for k in 0..8 {
                        let near: Rays = std::iter::once(nudged(given.ray(i), k)).collect();
                        let other = plain_gradient(&system, &near, i).2[0];
                        limits[0] += (other.origin - b.origin).length();
                        limits[1] += (other.direction - b.direction).length();
                    }
                }
                assert!((a.origin - b.origin).length() <= limits[0], "{name} {level:?} ray {i}: {a:?} {b:?}");
                assert!((a.direction - b.direction).length() <= limits[1], "{name} {level:?} ray {i}: {a:?} {b:?}");
            }
        }
        eprintln!("{level:?}: worst {worst:.3} of the limit");
    }
}

/// The loss's own differences, for one lens: the chain as a whole, without the plain adjoint.
#[test]
fn the_gradient_is_the_loss_differentiated() {
    let rng = &mut fastrand::Rng::with_seed(4);
    let lens = unchecked(&builtin::lens("cooke_triplet").expect("shipped"), |lens| vary(lens, 2, rng));
    let system = System::new(&lens, 550.0);
    let given: Rays = (0..100)
        .map(|_| {
            let mut draw = |w: f64| between(rng, -w, w);
            let direction = DVec3::new(draw(0.1), draw(0.1), 1.0).normalize();
            Ray { origin: DVec3::new(draw(2.0), draw(2.0), 0.0), direction }
        })
        .collect();
    let options = Options::default();
    let (_, g) = gradient(&system, &given, options);
    let direction = |i: usize| ((i * 7 + 3) % 11) as f64 / 11.0 - 0.4;
    let moved = |t: f64| {
        let mut s = system.clone();
        for (i, surface) in s.surfaces.iter_mut().enumerate() {
            let by = direction(i) * t;
            surface.shape.curvature += 1e-3 * by;
            surface.shape.conic += by;
            surface.shape.asphere.iter_mut().for_each(|a| *a *= 1.0 + by);
            surface.distance += by;
        }
        gradient(&s, &given, options).0
    };
    let mut pulled = 0.0;
    for (i, shape) in g.shapes.iter().enumerate() {
        let by = direction(i);
        let terms: f64 = shape.asphere.iter().zip(&system.surfaces[i].shape.asphere).map(|(g, a)| g * a).sum();
        pulled += by * (1e-3 * shape.curvature + shape.conic + terms + g.distances[i]);
    }
    assert_rel(pulled, central_difference(moved, 1e-3), 1e-8, 1.0, "loss");
}

/// The same bits with any number of threads.
#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let rng = &mut fastrand::Rng::with_seed(6);
    for (name, system) in systems(rng).into_iter().step_by(3) {
        let given = rays(&system, 20 * TILE + 3, rng);
        let mut seen = None;
        for threads in [1, 2, 5] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let result = pool.install(|| {
                let mut traced = given.clone();
                let status = trace_batch(&system, &mut traced, Options { clip: true, ..Options::default() });
                let (loss, g) = gradient(&system, &given, Options::default());
                let bits: Vec<u64> = numbers(&g).into_iter().chain([loss]).map(f64::to_bits).collect();
                (status, traced, bits)
            });
            let first = seen.get_or_insert_with(|| result.clone());
            assert!(*first == result, "{name}: {threads} threads");
        }
    }
}
