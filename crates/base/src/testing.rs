//! Helpers shared by tests and benches; not part of the public interface.

use std::path::PathBuf;

use ndarray::Array3;

/// Panics unless `a` and `b` agree to `tol` relative to the larger of `|b|` and `floor`.
#[track_caller]
pub fn assert_rel(a: f64, b: f64, tol: f64, floor: f64, what: &str) {
    let err = (a - b).abs() / b.abs().max(floor);
    assert!(err <= tol, "{what}: {a:e} against {b:e}: relative error {err:e} > {tol:e}");
}

/// Panics unless `|a − b| ≤ tol`.
#[track_caller]
pub fn assert_abs(a: f64, b: f64, tol: f64, what: &str) {
    assert!((a - b).abs() <= tol, "{what}: {a:e} against {b:e}: error {:e} > {tol:e}", (a - b).abs());
}

/// Fourth-order central difference of `f` at 0 with step `h`.
pub fn central_difference(mut f: impl FnMut(f64) -> f64, h: f64) -> f64 {
    (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
}

/// Derivative by central `difference`s of rising `steps`: the median of the five neighbours that agree best among themselves.
///
/// Kinks of a function err as the step grows, rounding as it shrinks, both to either side. The choice knows nothing of the value
/// that is tested.
pub fn steady_difference(difference: impl FnMut(f64) -> f64, steps: impl IntoIterator<Item = f64>) -> f64 {
    let all: Vec<f64> = steps.into_iter().map(difference).collect();
    let sorted = all.windows(all.len().min(5)).map(|window| {
        let mut window = window.to_vec();
        window.sort_by(f64::total_cmp);
        window
    });
    let spread = |w: &Vec<f64>| w[w.len() - 1] - w[0];
    sorted.min_by(|a, b| spread(a).total_cmp(&spread(b))).map_or(f64::NAN, |w| w[w.len() / 2])
}

/// A direction of unit length, half along `gradient` and half at random: a slope that single precision can resolve.
pub fn leaning(gradient: &[f64], seed: u64) -> Vec<f64> {
    let rng = &mut fastrand::Rng::with_seed(seed);
    let length = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let norm = length(gradient);
    let leant: Vec<f64> = gradient.iter().map(|v| v / norm + (rng.f64() - 0.5) * 0.8).collect();
    let long = length(&leant);
    leant.into_iter().map(|d| d / long).collect()
}

/// Uniform draw in `[a, b)`.
pub fn between(rng: &mut fastrand::Rng, a: f64, b: f64) -> f64 {
    a + (b - a) * rng.f64()
}

/// Two pictures by formula, `[3, 37, 53]` from 0 to 1, the second with a ripple on the first.
pub fn two_pictures() -> (Array3<f64>, Array3<f64>) {
    let a = Array3::from_shape_fn((3, 37, 53), |(k, r, c)| {
        let (k, r, c) = (k as f64, r as f64, c as f64);
        0.5 + 0.45 * (0.31 * c + 0.17 * r * (k + 1.0)).sin() * (0.23 * r - 0.11 * c + k).cos()
    });
    let b = Array3::from_shape_fn((3, 37, 53), |(k, r, c)| {
        let (x, y, z) = (c as f64, r as f64, k as f64);
        let ripple = 0.08 * (1.7 * x + 2.3 * y + z).sin() + 0.03 * (0.05 * x * y).cos();
        (a[[k, r, c]] + ripple).clamp(0.0, 1.0)
    });
    (a, b)
}

/// The shared reference data beside the checkout, or `None` after a visible message.
///
/// # Panics
/// Where it is absent and `ISOPLANAT_REQUIRE_SHARED` is 1: a comparison that was skipped shall not look like one that held.
pub fn shared(relative: &str) -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared").join(relative);
    if path.exists() {
        Some(path)
    } else {
        let required = std::env::var("ISOPLANAT_REQUIRE_SHARED").is_ok_and(|v| v == "1");
        assert!(!required, "ISOPLANAT_REQUIRE_SHARED: {} is not there", path.display());
        eprintln!("SKIPPED: {} is not there", path.display());
        None
    }
}
