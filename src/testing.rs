//! Helpers shared by tests and benches; not part of the public interface.

use std::path::PathBuf;

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

/// Uniform draw in `[a, b)`.
pub fn between(rng: &mut fastrand::Rng, a: f64, b: f64) -> f64 {
    a + (b - a) * rng.f64()
}

/// The shared reference data beside the checkout, or `None` after a visible message.
pub fn shared(relative: &str) -> Option<PathBuf> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared").join(relative);
    if path.exists() {
        Some(path)
    } else {
        eprintln!("SKIPPED: {} is not there", path.display());
        None
    }
}
