//! Zernike polynomials over the unit disk, and their least-squares fit.
//!
//! Angles run from +x to +y. [`Order::Noll`]: orthonormal, `∫ Z_i Z_j dA/π = δ_ij`, a coefficient is the root mean square of its term
//! (R. J. Noll, J. Opt. Soc. Am. 66, 207, 1976). [`Order::Fringe`]: values within ±1 and 1 at the rim, the order of J. C. Wyant and K.
//! Creath (*Applied Optics and Optical Engineering* XI, 1992), 37 terms at most. Over a part of the disk, a vignetted pupil, the fit is
//! least squares over the points that are left: the terms are not orthogonal there, and a coefficient depends on how many are fitted.

use glam::DVec2;
use nalgebra::{DMatrix, DVector};

/// Normalisation and numbering.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Orthonormal, Noll's index.
    Noll,
    /// 1 at the rim, fringe index.
    Fringe,
}

/// Most terms of the fringe set.
pub const FRINGE_TERMS: usize = 37;

/// Radial degree `n` and azimuthal frequency: `m > 0` is `cos mθ`, `m < 0` is `sin |m|θ`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Term {
    /// Radial degree.
    pub n: u32,
    /// Azimuthal frequency, `|m| ≤ n` of the same parity.
    pub m: i32,
}

impl Order {
    /// The term of an index, counted from 1. `None` for 0, and beyond the fringe set.
    pub fn term(self, index: usize) -> Option<Term> {
        let index = u32::try_from(index).ok().filter(|j| (1..=100_000).contains(j))?;
        match self {
            Self::Noll => {
                let mut n = 0;
                while (n + 1) * (n + 2) / 2 < index {
                    n += 1;
                }
                // Within its degree: |m| grows in pairs; even indices are cosines.
                let place = index - n * (n + 1) / 2 - 1;
                let m = if n.is_multiple_of(2) { place.div_ceil(2) * 2 } else { place / 2 * 2 + 1 };
                let m = i32::try_from(m).ok()?;
                Some(Term { n, m: if index.is_multiple_of(2) { m } else { -m } })
            }
            Self::Fringe => {
                if index == 37 {
                    return Some(Term { n: 12, m: 0 });
                }
                if index > 36 {
                    return None;
                }
                // Groups of constant (n + |m|)/2 = g hold (g + 1)² − g² terms, |m| falling, cosine first.
                let g = (index - 1).isqrt();
                let place = index - 1 - g * g;
                let m = g - place / 2;
                let n = 2 * g - m;
                let m = i32::try_from(m).ok()?;
                Some(Term { n, m: if place.is_multiple_of(2) { m } else { -m } })
            }
        }
    }

    /// What the values of [`Term::value`] are multiplied with.
    fn scale(self, term: Term) -> f64 {
        match self {
            Self::Fringe => 1.0,
            Self::Noll => (f64::from(term.n + 1) * if term.m == 0 { 1.0 } else { 2.0 }).sqrt(),
        }
    }

    /// The polynomial of this index at a point of the unit disk; 0 for an index without one.
    pub fn value(self, index: usize, at: DVec2) -> f64 {
        self.term(index).map_or(0.0, |t| self.scale(t) * t.value(at))
    }
}

impl Term {
    /// `R_n^m(ρ) cos mθ` or `sin`, 1 at most.
    pub fn value(self, at: DVec2) -> f64 {
        let (rho, m) = (at.length(), self.m.unsigned_abs());
        let angle = f64::from(m) * at.y.atan2(at.x);
        radial(self.n, m, rho) * if self.m < 0 { angle.sin() } else { angle.cos() }
    }

    /// Its name: "primary coma, y".
    pub fn name(self) -> String {
        let (n, m) = (self.n, self.m.unsigned_abs());
        match (n, m) {
            (0, 0) => return "piston".into(),
            (1, 1) => return format!("tilt, {}", if self.m > 0 { "x" } else { "y" }),
            (2, 0) => return "defocus".into(),
            _ => {}
        }
        let family = match m {
            0 => "spherical".to_owned(),
            1 => "coma".into(),
            2 => "astigmatism".into(),
            3 => "trefoil".into(),
            4 => "tetrafoil".into(),
            5 => "pentafoil".into(),
            6 => "hexafoil".into(),
            _ => format!("{m}-foil"),
        };
        // Which of its family: spherical and coma begin a degree later.
        let first = if m < 2 { 4 - m % 2 } else { m };
        let rank = (n - first) / 2;
        const RANKS: [&str; 5] = ["primary", "secondary", "tertiary", "quaternary", "quinary"];
        let rank = usize::try_from(rank)
            .ok()
            .and_then(|k| RANKS.get(k))
            .map_or_else(|| format!("order {}", rank + 1), |r| (*r).to_owned());
        let axis = match (m, self.m > 0) {
            (0, _) => "",
            (1, true) => ", x",
            (1, false) => ", y",
            (2, true) => ", 0°",
            (2, false) => ", 45°",
            (_, true) => ", cos",
            (_, false) => ", sin",
        };
        format!("{rank} {family}{axis}")
    }
}

/// `R_n^m(ρ)` by the recurrence in `n` of the Jacobi polynomials `P_k^{(0,m)}(2ρ² − 1)`, stable at any degree.
fn radial(n: u32, m: u32, rho: f64) -> f64 {
    let (x, b) = (2.0 * rho * rho - 1.0, f64::from(m));
    // R = ρ^m P_k^{(0,m)}(2ρ² − 1), k = (n − m)/2.
    let (mut before, mut now) = (0.0, 1.0);
    for k in 1..=(n - m) / 2 {
        let k = f64::from(k);
        let next = if k == 1.0 {
            0.5 * ((b + 2.0) * x - b)
        } else {
            let s = 2.0 * k + b;
            ((s - 1.0) * (s * (s - 2.0) * x - b * b) * now - 2.0 * (k - 1.0) * (k + b - 1.0) * s * before)
                / (2.0 * k * (k + b) * (s - 2.0))
        };
        (before, now) = (now, next);
    }
    now * rho.powi(i32::try_from(m).unwrap_or(i32::MAX))
}

/// Coefficients of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Normalisation and numbering.
    pub order: Order,
    /// Of index 1, 2, … in the unit of the values.
    pub coefficients: Vec<f64>,
    /// Root mean square of what the terms leave over the points, by their weights.
    pub residual_rms: f64,
}

/// Fits the first `terms` polynomials to `values` at `points` of the unit disk, by weighted least squares.
///
/// `None` where the points do not tell the terms apart (too few of them, a sliver), or the set has fewer terms.
pub(crate) fn fit(order: Order, terms: usize, points: &[DVec2], values: &[f64], weights: &[f64]) -> Option<Fit> {
    let total: f64 = weights.iter().sum();
    if terms == 0 || points.len() < terms || order.term(terms).is_none() || !(total > 0.0 && total.is_finite()) {
        return None;
    }
    let roots: Vec<f64> = weights.iter().map(|w| (w / total).sqrt()).collect();
    let matrix = DMatrix::from_fn(points.len(), terms, |i, j| roots[i] * order.value(j + 1, points[i]));
    let mut right = DVector::from_fn(points.len(), |i, _| roots[i] * values[i]);
    let qr = matrix.qr();
    qr.q_tr_mul(&mut right);
    let r = qr.r();
    let diagonal = r.diagonal().map(f64::abs);
    let told_apart = diagonal.min() > 1e-7 * diagonal.max();
    if !told_apart {
        return None;
    }
    let solved = r.solve_upper_triangular(&right.rows(0, terms))?;
    let residual_rms = right.rows_range(terms..).norm();
    let fit = Fit { order, coefficients: solved.iter().copied().collect(), residual_rms };
    (residual_rms.is_finite() && fit.coefficients.iter().all(|c| c.is_finite())).then_some(fit)
}

impl Fit {
    /// The fitted function at a point of the unit disk.
    pub fn value(&self, at: DVec2) -> f64 {
        self.coefficients.iter().enumerate().map(|(j, c)| c * self.order.value(j + 1, at)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_abs, between};
    use std::f64::consts::{PI, TAU};

    /// Points and weights of a product rule that is exact for the polynomials used here: Gauss–Chebyshev in ρ², even azimuths.
    fn disk() -> Vec<(DVec2, f64)> {
        let (rings, around) = (400, 48);
        let ring = |i: u32| {
            // Fejér's rule would do; the substitution ρ² = sin² makes the midpoint rule converge.
            let t = 0.5 * PI * (f64::from(i) + 0.5) / f64::from(rings);
            let (s, c) = t.sin_cos();
            // u = ρ² = s²; du = 2 s c dt.
            (s, 2.0 * s * c * 0.5 * PI / f64::from(rings))
        };
        (0..rings)
            .flat_map(|i| {
                let (rho, w) = ring(i);
                (0..around).map(move |k| {
                    (rho * DVec2::from_angle(TAU * f64::from(k) / f64::from(around)), w / f64::from(around))
                })
            })
            .collect()
    }

    #[test]
    fn noll_terms_are_orthonormal_and_fringe_terms_are_one_at_the_rim() {
        let disk = disk();
        for i in 1..=28 {
            for j in 1..=i {
                let dot: f64 = disk.iter().map(|(p, w)| w * Order::Noll.value(i, *p) * Order::Noll.value(j, *p)).sum();
                assert_abs(dot, f64::from(u8::from(i == j)), 2e-4, &format!("{i} {j}"));
            }
        }
        for j in 1..=FRINGE_TERMS {
            let most = disk.iter().map(|(p, _)| Order::Fringe.value(j, *p).abs()).fold(0.0, f64::max);
            let rim = (0..48)
                .map(|k| Order::Fringe.value(j, DVec2::from_angle(TAU * f64::from(k) / 48.0)))
                .fold(0.0, f64::max);
            assert!(most <= 1.0 + 1e-12, "{j}");
            assert_abs(rim, 1.0, 0.02, "rim");
        }
    }

    /// Noll's and the fringe table, and closed forms.
    #[test]
    fn terms_are_those_of_the_tables() {
        let noll = [
            (0, 0),
            (1, 1),
            (1, -1),
            (2, 0),
            (2, -2),
            (2, 2),
            (3, -1),
            (3, 1),
            (3, -3),
            (3, 3),
            (4, 0),
            (4, 2),
            (4, -2),
            (4, 4),
            (4, -4),
            (5, 1),
        ];
        for (j, (n, m)) in noll.into_iter().enumerate() {
            assert_eq!(Order::Noll.term(j + 1), Some(Term { n, m }), "Noll {}", j + 1);
        }
        let fringe = [
            (0, 0),
            (1, 1),
            (1, -1),
            (2, 0),
            (2, 2),
            (2, -2),
            (3, 1),
            (3, -1),
            (4, 0),
            (3, 3),
            (3, -3),
            (4, 2),
            (4, -2),
            (5, 1),
            (5, -1),
            (6, 0),
        ];
        for (j, (n, m)) in fringe.into_iter().enumerate() {
            assert_eq!(Order::Fringe.term(j + 1), Some(Term { n, m }), "fringe {}", j + 1);
        }
        assert_eq!(Order::Fringe.term(36), Some(Term { n: 10, m: 0 }));
        assert_eq!(Order::Fringe.term(37), Some(Term { n: 12, m: 0 }));
        assert_eq!((Order::Fringe.term(38), Order::Noll.term(0)), (None, None));
        let p = DVec2::new(0.3, -0.62);
        let (r2, r4) = (p.length_squared(), p.length_squared().powi(2));
        assert_abs(Order::Noll.value(11, p), 5f64.sqrt() * (6.0 * r4 - 6.0 * r2 + 1.0), 1e-14, "spherical");
        assert_abs(Order::Noll.value(7, p), 8f64.sqrt() * (3.0 * r2 - 2.0) * p.y, 1e-14, "coma");
        assert_abs(Order::Noll.value(6, p), 6f64.sqrt() * (p.x * p.x - p.y * p.y), 1e-14, "astigmatism");
        let secondary = Term { n: 6, m: 0 }.value(p);
        assert_abs(secondary, 20.0 * r2.powi(3) - 30.0 * r4 + 12.0 * r2 - 1.0, 1e-14, "secondary spherical");
        let names: Vec<String> =
            [4, 5, 7, 9, 11, 16, 22].into_iter().map(|j| Order::Noll.term(j).expect("term").name()).collect();
        assert_eq!(
            names,
            [
                "defocus",
                "primary astigmatism, 45°",
                "primary coma, y",
                "primary trefoil, sin",
                "primary spherical",
                "secondary coma, x",
                "secondary spherical"
            ]
        );
    }

    #[test]
    fn known_coefficients_come_back() {
        let rng = &mut fastrand::Rng::with_seed(6);
        let points: Vec<DVec2> =
            (0..900).map(|_| between(rng, 0.0, 1.0).sqrt() * DVec2::from_angle(between(rng, 0.0, TAU))).collect();
        let weights: Vec<f64> = points.iter().map(|_| between(rng, 0.5, 2.0)).collect();
        for (order, terms) in [(Order::Noll, 36), (Order::Fringe, 37)] {
            let wanted: Vec<f64> = (0..terms).map(|_| between(rng, -1.0, 1.0)).collect();
            let exact = Fit { order, coefficients: wanted.clone(), residual_rms: 0.0 };
            let values: Vec<f64> = points.iter().map(|p| exact.value(*p)).collect();
            let found = fit(order, terms, &points, &values, &weights).expect("enough points");
            assert!(found.residual_rms < 1e-12);
            found.coefficients.iter().zip(&wanted).for_each(|(a, b)| assert_abs(*a, *b, 1e-12, "coefficient"));
            // Without the last term: what is left is the term.
            let short = fit(order, terms - 1, &points, &values, &weights).expect("enough points");
            assert!(short.residual_rms > 0.01 * wanted[terms - 1].abs());
        }
        // A half of the disk still tells few terms apart; a line and too few points do not.
        let half: Vec<usize> = (0..points.len()).filter(|i| points[*i].x > 0.0).collect();
        let pick = |v: &[f64]| -> Vec<f64> { half.iter().map(|i| v[*i]).collect() };
        let some: Vec<DVec2> = half.iter().map(|i| points[*i]).collect();
        let values: Vec<f64> = some.iter().map(|p| 0.4 * Order::Noll.value(8, *p)).collect();
        let found = fit(Order::Noll, 15, &some, &values, &pick(&weights)).expect("enough points");
        assert_abs(found.coefficients[7], 0.4, 1e-12, "half a disk");
        let line: Vec<DVec2> = (0..50).map(|i| DVec2::new(f64::from(i) / 50.0, 0.0)).collect();
        assert_eq!(fit(Order::Noll, 15, &line, &[0.0; 50], &[1.0; 50]), None);
        assert_eq!(fit(Order::Noll, 15, &line[..3], &[0.0; 3], &[1.0; 3]), None);
    }
}
