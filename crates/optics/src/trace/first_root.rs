//! The first root of ray ∩ surface, with bounds: for surfaces that a ray may meet more than once.
//!
//! The search runs within the cylinder `r ≤ R` of the surface's [`domain`](super::system::TraceSurface::domain) (1.1
//! clear semi-diameters, or the conic's reach), from the ray's origin or, where that lies outside, from where the ray
//! enters or last left the cylinder. If the start lies before the surface the first root ahead is taken; if it lies
//! behind (surfaces that overlap, rays launched on a vertex plane) the nearest one back. A cylinder without a root is
//! doubled, up to 64 times the domain.
//!
//! On a segment of the ray the derivative of `F = h − z` is enclosed: the conic's slope is monotonic in `r`, the
//! aspheric polynomial and the freeform terms are expanded at the segment's middle. Where the enclosure has one sign, `F`
//! is monotonic and its ends decide; where `|F|` in the middle is larger than half the segment times the largest slope
//! there is no root; otherwise the segment is halved. A touching point (a root without a change of sign) is no root.

use glam::DVec3;

use super::{Cause, system::TraceSurface};
use crate::lens::shape::{HIGHEST_POWER, Local, Shape};

/// Doublings of the domain before a ray counts as missed.
const DOUBLINGS: u32 = 6;
/// The edge of the conic itself has no slope: the search ends at this share of its reach.
const EDGE: f64 = 1.0 - 1e-15;
/// Segments looked at in one cylinder before a ray counts as not converged.
const SEGMENTS: u32 = 20_000;

/// The ray `near + s·d`, its origin at `s = origin`: distance `s` of the first root, the surface there, evaluations.
pub(super) fn first_root(
    surface: &TraceSurface,
    near: DVec3,
    d: DVec3,
    origin: f64,
) -> Result<(f64, Local, u32), Cause> {
    let shape = &surface.shape;
    let reach = shape.reach() * EDGE;
    let mut spent = 0;
    for doubling in 0..=DOUBLINGS {
        let radius = (surface.domain * f64::from(1u32 << doubling)).min(reach);
        let line = Line { shape, near, d };
        if let Some((a, b)) = line.within(radius) {
            let start = origin.clamp(a, b);
            let at_start = line.value(start).ok_or(Cause::NotConverged)?;
            let (from, to) = if at_start >= 0.0 { (start, b) } else { (start, a) };
            if let Some((s, local)) = line.first(from, to, at_start, &mut spent)? {
                return Ok((s, local, spent));
            }
        }
        if radius >= reach {
            break;
        }
    }
    Err(Cause::Missed)
}

/// Every crossing of `origin + t·direction` with `surface` inside its domain, as `t`, in order; touching points are left
/// out. For reports: the trace needs the first one only.
pub fn crossings(surface: &TraceSurface, origin: DVec3, direction: DVec3) -> Result<Vec<f64>, Cause> {
    let t0 = -origin.dot(direction);
    let near = origin + t0 * direction;
    if !near.is_finite() {
        return Err(Cause::Missed);
    }
    let line = Line { shape: &surface.shape, near, d: direction };
    let radius = surface.domain.min(surface.shape.reach() * EDGE);
    let Some((mut from, to)) = line.within(radius) else { return Ok(Vec::new()) };
    let (mut found, mut spent) = (Vec::new(), 0);
    while from < to {
        let at_start = line.value(from).ok_or(Cause::NotConverged)?;
        let Some((s, _)) = line.first(from, to, at_start, &mut spent)? else { break };
        found.push(t0 + s);
        from = s + 1e-9 * (to - from).min(radius);
    }
    Ok(found)
}

struct Line<'a> {
    shape: &'a Shape,
    near: DVec3,
    d: DVec3,
}

impl Line<'_> {
    fn at(&self, s: f64) -> DVec3 {
        self.near + s * self.d
    }

    fn value(&self, s: f64) -> Option<f64> {
        let p = self.at(s);
        self.shape.at(p.x, p.y).map(|l| l.h - p.z)
    }

    /// The part of the ray within the cylinder of `radius`.
    fn within(&self, radius: f64) -> Option<(f64, f64)> {
        let (x, y, l, m) = (self.near.x, self.near.y, self.d.x, self.d.y);
        let (a, b) = (l * l + m * m, x * l + y * m);
        if a == 0.0 {
            // Along the axis: all of it or nothing; the surface's own height bounds it.
            if x.hypot(y) > radius {
                return None;
            }
            let h = self.shape.at(x, y)?.h;
            let s = (h - self.near.z) / self.d.z;
            let margin = 1.0 + s.abs();
            return s.is_finite().then_some((s - margin, s + margin));
        }
        let middle = -b / a;
        let rest = (x * m - y * l).powi(2) / a;
        let half = ((radius * radius - rest) / a).sqrt();
        // A hair inside, so that rounding does not leave the cylinder.
        let half = half * (1.0 - 1e-14);
        let (low, high) = (middle - half, middle + half);
        (half > 0.0 && low.is_finite() && high.is_finite()).then_some((low, high))
    }

    /// First sign change of `F` from `from` (where it is `at_start`) towards `to`.
    fn first(&self, from: f64, to: f64, at_start: f64, spent: &mut u32) -> Result<Option<(f64, Local)>, Cause> {
        let sign = if at_start >= 0.0 { 1.0 } else { -1.0 };
        let tiny = 1e-15 * (from.abs() + to.abs()) + f64::MIN_POSITIVE;
        let mut stack = vec![(from, to)];
        let mut segments = 0;
        while let Some((a, b)) = stack.pop() {
            segments += 1;
            *spent += 1;
            if segments > SEGMENTS {
                return Err(Cause::NotConverged);
            }
            let middle = 0.5 * (a + b);
            let (low, high) = self.slope_bounds(a.min(b), a.max(b));
            let at_end = self.value(b).ok_or(Cause::NotConverged)? * sign;
            let monotonic = low > 0.0 || high < 0.0;
            if monotonic || (b - a).abs() <= tiny {
                if at_end <= 0.0 {
                    return Ok(self.bracketed(a, b, sign, spent));
                }
                continue;
            }
            let half = 0.5 * (b - a).abs();
            let at_middle = self.value(middle).ok_or(Cause::NotConverged)? * sign;
            if at_middle > half * low.abs().max(high.abs()) {
                continue;
            }
            stack.push((middle, b));
            stack.push((a, middle));
        }
        Ok(None)
    }

    /// The root between `a` (before the sign change) and `b`: Newton, kept within the bracket.
    fn bracketed(&self, a: f64, b: f64, sign: f64, spent: &mut u32) -> Option<(f64, Local)> {
        let (mut a, mut b) = (a, b);
        let mut s = 0.5 * (a + b);
        for _ in 0..200 {
            *spent += 1;
            let p = self.at(s);
            let local = self.shape.at(p.x, p.y)?;
            let f = local.h - p.z;
            if f * sign > 0.0 {
                a = s;
            } else {
                b = s;
            }
            let step = f / (local.slope[0] * self.d.x + local.slope[1] * self.d.y - self.d.z);
            let rounding = 4.0 * f64::EPSILON * (local.h.abs() + p.z.abs() + s.abs());
            if step.abs() <= rounding || (b - a).abs() <= rounding {
                return Some((s, local));
            }
            let next = s - step;
            let inside = next.is_finite() && (next - a) * (next - b) < 0.0;
            s = if inside { next } else { 0.5 * (a + b) };
        }
        let p = self.at(s);
        self.shape.at(p.x, p.y).map(|local| (s, local))
    }

    /// Bounds of `dF/ds` for `s` in `a..=b`.
    fn slope_bounds(&self, a: f64, b: f64) -> (f64, f64) {
        let (pa, pb) = (self.at(a), self.at(b));
        let (l, m) = (self.d.x, self.d.y);
        let (ra, rb) = (pa.x.hypot(pa.y), pb.x.hypot(pb.y));
        let speed = l.hypot(m);
        // r is convex along the ray: largest at an end, smallest at the foot of the perpendicular if that lies inside.
        let (da, db) = (pa.x * l + pa.y * m, pb.x * l + pb.y * m);
        let nearest =
            if da < 0.0 && db > 0.0 && speed > 0.0 { (pa.x * m - pa.y * l).abs() / speed } else { ra.min(rb) };
        let (r1, r2) = (nearest, ra.max(rb));
        // dr/ds rises along the ray; on the axis it is anything up to the speed.
        let rate = |dot: f64, r: f64, axis: f64| if r > 0.0 { (dot / r).clamp(-speed, speed) } else { axis };
        let (v1, v2) = (rate(da, ra, -speed), rate(db, rb, speed));
        let (h1, h2) = self.radial_slope(r1, r2);
        let products = [h1 * v1, h1 * v2, h2 * v1, h2 * v2];
        let low = products.iter().copied().fold(f64::INFINITY, f64::min);
        let high = products.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let (f1, f2) = self.freeform_slope(a, b);
        (low + f1 - self.d.z, high + f2 - self.d.z)
    }

    /// Bounds of the rotational part's `dh/dr` for `r` in `r1..=r2`.
    fn radial_slope(&self, r1: f64, r2: f64) -> (f64, f64) {
        let shape = self.shape;
        let conic = |r: f64| {
            let cr = shape.curvature * r;
            let phi_sq = 1.0 - (1.0 + shape.conic) * cr * cr;
            if phi_sq > 0.0 { cr / phi_sq.sqrt() } else { cr.signum() * f64::INFINITY }
        };
        let (c1, c2) = (conic(r1), conic(r2));
        // dP/dr = Σ k a_k r^{k−1} as coefficients of r, expanded at the middle: |dP/dr − q₀| ≤ Σ |q_k| w^k.
        let mut q = [0.0; 2 * MAX_TERMS];
        let mut degree = 0;
        for (power, a) in shape.terms() {
            // A power beyond what there is room for has no bound here.
            let Some(slope) = q.get_mut(power - 1) else { return (f64::NEG_INFINITY, f64::INFINITY) };
            #[expect(clippy::cast_precision_loss, reason = "small powers")]
            let k = power as f64;
            *slope += k * a;
            degree = degree.max(power - 1);
        }
        let (middle, half) = (0.5 * (r1 + r2), 0.5 * (r2 - r1));
        let (centre, spread) = expanded(&mut q[..=degree], middle, half);
        (c1.min(c2) + centre - spread, c1.max(c2) + centre + spread)
    }

    /// Bounds of the freeform terms' derivative along the ray for `s` in `a..=b`.
    fn freeform_slope(&self, a: f64, b: f64) -> (f64, f64) {
        let (middle, half) = (self.at(0.5 * (a + b)), 0.5 * (b - a));
        // The rotational part has its bounds above; an ideal lens is a plane.
        let Shape { curvature: _, conic: _, asphere: _, odd: _, zernike, xy, ideal: _ } = self.shape;
        let parts = [zernike.as_ref().map(|z| z.polynomial()), xy.as_ref().map(|p| p.polynomial())];
        let (mut low, mut high) = (0.0, 0.0);
        for polynomial in parts.into_iter().flatten() {
            // The polynomial along the ray, around the segment's middle; its derivative at the middle ± the rest.
            let along = polynomial.along([middle.x, middle.y], [self.d.x, self.d.y]);
            let centre = along[1];
            let mut power = 1.0;
            let mut spread = 0.0;
            for (k, c) in along.iter().enumerate().skip(2) {
                power *= half;
                #[expect(clippy::cast_precision_loss, reason = "small degrees")]
                let order = k as f64;
                spread += order * c.abs() * power;
            }
            spread += 1e-13 * (centre.abs() + spread);
            low += centre - spread;
            high += centre + spread;
        }
        (low, high)
    }
}

/// Even and odd terms each.
const MAX_TERMS: usize = HIGHEST_POWER / 2;

/// Value of the polynomial `Σ q_k x^k` at `x`, and a bound of how far it moves within `±half`, rounding included.
fn expanded(q: &mut [f64], x: f64, half: f64) -> (f64, f64) {
    let size = q.iter().rev().fold(0.0, |sum, a| sum * x + a.abs());
    // Taylor shift by repeated synthetic division.
    for k in 0..q.len() {
        for j in (k..q.len() - 1).rev() {
            q[j] += x * q[j + 1];
        }
    }
    let spread = q.iter().skip(1).rev().fold(0.0, |sum, a| (sum + a.abs()) * half);
    (q[0], spread + 64.0 * f64::EPSILON * size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::test_lenses::open_forms;
    use crate::trace::intersect::intersect;
    use isoplanat_base::testing::between;

    /// The rule of the head by brute force: a fine scan of the cylinder, then bisection.
    fn by_scan(surface: &TraceSurface, origin: DVec3, d: DVec3) -> Option<f64> {
        let value = |t: f64| {
            let p = origin + t * d;
            surface.shape.at(p.x, p.y).map(|l| l.h - p.z)
        };
        let mut radius = surface.domain;
        for _ in 0..=DOUBLINGS {
            let limit = radius.min(surface.shape.reach() * EDGE);
            let (a, b) = (d.truncate().length_squared(), origin.truncate().dot(d.truncate()));
            let disc = b * b - a * (origin.truncate().length_squared() - limit * limit);
            if disc > 0.0 {
                let ends = [(-b - disc.sqrt()) / a, (-b + disc.sqrt()) / a];
                let inside = |f: f64| ends[0] + (ends[1] - ends[0]) * (1e-12 + f * (1.0 - 2e-12));
                let start = 0f64.clamp(inside(0.0), inside(1.0));
                let before = value(start)? >= 0.0;
                let end = if before { inside(1.0) } else { inside(0.0) };
                let steps = 20_000;
                let at = |i: i32| start + (end - start) * f64::from(i) / f64::from(steps);
                for i in 0..steps {
                    let (mut lo, mut hi) = (at(i), at(i + 1));
                    if (value(hi)? >= 0.0) != before {
                        for _ in 0..80 {
                            let middle = 0.5 * (lo + hi);
                            if (value(middle)? >= 0.0) == before {
                                lo = middle;
                            } else {
                                hi = middle;
                            }
                        }
                        return Some(0.5 * (lo + hi));
                    }
                }
            }
            if limit < radius {
                break;
            }
            radius *= 2.0;
        }
        None
    }

    #[test]
    fn the_first_root_is_that_of_a_fine_scan() {
        let (mut met, mut several) = (0, 0);
        for seed in 0..400 {
            let rng = &mut fastrand::Rng::with_seed(seed);
            // Each form that has terms, in turn, with terms that bend it to and fro.
            let forms = open_forms(rng, 6.0, 0.5);
            let (form, shape) = forms[seed as usize % forms.len()].clone();
            let surface = TraceSurface::new(shape, 0.0, [1.0, 1.5], 6.0);
            let from = DVec3::new(between(rng, -6.0, 6.0), between(rng, -6.0, 6.0), between(rng, -12.0, 1.0));
            let to = DVec3::new(between(rng, -5.0, 5.0), between(rng, -5.0, 5.0), between(rng, 0.5, 4.0));
            let d = (to - from).normalize();
            let got = intersect(&surface, from, d);
            match by_scan(&surface, from, d) {
                Some(t) => {
                    met += 1;
                    several += usize::from(crossings(&surface, from, d).expect("settles").len() > 1);
                    let got = got.unwrap_or_else(|c| panic!("seed {seed}, {form}: {c:?}, scan finds {t}"));
                    assert!((got.t - t).abs() < 1e-9, "seed {seed}, {form}: {} against {t}", got.t);
                }
                None => assert_eq!(got.err(), Some(Cause::Missed), "seed {seed}, {form}"),
            }
        }
        eprintln!("{met} of 400 rays meet their surface, {several} of them more than once");
        assert!(met > 200 && several > 30, "{met} {several}");
    }

    #[test]
    fn every_crossing_of_a_gull_wing_is_listed() {
        // h = 0.2 r² − 0.03 r⁴ + 0.001 r⁶: up, down, up again.
        let surface = TraceSurface::new(Shape::even(0.0, 0.0, vec![0.2, -0.03, 0.001]), 0.0, [1.0, 1.5], 5.0);
        let d = DVec3::new(0.0, 1.0, 0.02).normalize();
        let origin = DVec3::new(0.0, -5.4, -0.1);
        let all = crossings(&surface, origin, d).expect("settles");
        // The same by a scan from side to side.
        let value = |i: i32| {
            let p = origin + f64::from(i) * 1e-4 * d;
            surface.shape.at(p.x, p.y).map_or(0.0, |l| l.h - p.z)
        };
        let scanned: Vec<f64> =
            (0..110_000).filter(|i| value(*i) * value(i + 1) < 0.0).map(|i| f64::from(i) * 1e-4).collect();
        assert_eq!(all.len(), scanned.len(), "{all:?} {scanned:?}");
        assert!(all.len() >= 6 && all.iter().zip(&scanned).all(|(a, b)| a - b < 1e-4 && a >= b), "{all:?} {scanned:?}");
        let first = intersect(&surface, origin, d).expect("meets");
        assert!((all[0] - first.t).abs() < 1e-12, "{all:?} {}", first.t);
    }
}
