//! Snell's law in vector form: `d' = μ d + (μ cosθ − cosθ') n̂`, `μ = n/n'`, `n̂` against the light.

use glam::DVec3;

/// Refracted unit direction, or `None` at total reflection. `normal` is a unit vector with `normal·d < 0`.
#[inline]
pub fn refract(direction: DVec3, normal: DVec3, mu: f64) -> Option<DVec3> {
    let ci = -direction.dot(normal);
    let under = 1.0 - mu * mu * (1.0 - ci * ci);
    (under >= 0.0).then(|| mu * direction + (mu * ci - under.sqrt()) * normal)
}

/// Pulls `out_bar` back to `(direction, normal, mu)`.
#[inline]
pub fn refract_vjp(direction: DVec3, normal: DVec3, mu: f64, out_bar: DVec3) -> (DVec3, DVec3, f64) {
    let ci = -direction.dot(normal);
    let sin_sq = 1.0 - ci * ci;
    let ct = (1.0 - mu * mu * sin_sq).sqrt();
    let gamma = mu * ci - ct;
    let gamma_bar = out_bar.dot(normal);
    let ci_bar = gamma_bar * (mu - mu * mu * ci / ct);
    let mu_bar = out_bar.dot(direction) + gamma_bar * (ci + mu * sin_sq / ct);
    (mu * out_bar - ci_bar * normal, gamma * out_bar - ci_bar * direction, mu_bar)
}
