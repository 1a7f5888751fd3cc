//! Freeform terms of a surface: Zernike polynomials and polynomials in x and y.
//!
//! Both are linear in their coefficients and both become one [`Polynomial`] in `u = x/R`, `v = y/R` when they are made.
//! Zernike terms are numbered after Noll (1976), orthonormal on the unit disk, the angle from +x towards +y; beyond
//! the normalisation radius the polynomials simply go on.

use std::collections::BTreeMap;

use super::sag::Local;

/// Highest Noll index: all terms up to radial order 10.
pub(crate) const MAX_NOLL: usize = 66;
/// Highest `i + j` of an xy term.
pub(crate) const MAX_XY_DEGREE: usize = 10;

/// `Σ c_{ij} u^i v^j`, mm, with `u = x/R`, `v = y/R`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Polynomial {
    radius: f64,
    degree: usize,
    terms: Vec<(usize, usize, f64)>,
}

/// Powers `0..=degree` of a number with their first and second derivatives.
fn powers(u: f64, degree: usize) -> [[f64; 3]; MAX_XY_DEGREE + 1] {
    let mut p = [[0.0; 3]; MAX_XY_DEGREE + 1];
    p[0][0] = 1.0;
    for n in 1..=degree {
        #[expect(clippy::cast_precision_loss, reason = "small degrees")]
        let order = n as f64;
        p[n] = [p[n - 1][0] * u, order * p[n - 1][0], order * p[n - 1][1]];
    }
    p
}

impl Polynomial {
    fn new(radius: f64, terms: Vec<(usize, usize, f64)>) -> Self {
        let degree = terms.iter().map(|t| t.0 + t.1).max().unwrap_or(0);
        Self { radius, degree, terms }
    }

    /// Normalisation radius, mm.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// `(i, j, coefficient in mm)` of every monomial.
    pub(crate) fn terms(&self) -> &[(usize, usize, f64)] {
        &self.terms
    }

    /// Highest total degree.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// Adds value, slope and second derivatives at `(x, y)` mm.
    pub fn add_to(&self, x: f64, y: f64, local: &mut Local) {
        let inv = 1.0 / self.radius;
        let (u, v) = (powers(x * inv, self.degree), powers(y * inv, self.degree));
        let (mut h, mut slope, mut second) = (0.0, [0.0; 2], [0.0; 3]);
        for &(i, j, c) in &self.terms {
            h += c * u[i][0] * v[j][0];
            slope[0] += c * u[i][1] * v[j][0];
            slope[1] += c * u[i][0] * v[j][1];
            second[0] += c * u[i][2] * v[j][0];
            second[1] += c * u[i][1] * v[j][1];
            second[2] += c * u[i][0] * v[j][2];
        }
        local.h += h;
        (0..2).for_each(|k| local.slope[k] += slope[k] * inv);
        (0..3).for_each(|k| local.second[k] += second[k] * inv * inv);
    }

    /// Coefficients (mm^(1−k)) of the polynomial along the line `p + s·d`, as a polynomial in `s`.
    pub fn along(&self, p: [f64; 2], d: [f64; 2]) -> [f64; MAX_XY_DEGREE + 1] {
        let inv = 1.0 / self.radius;
        // Powers of the two linear factors.
        let table = |a: f64, b: f64| {
            let mut t = [[0.0; MAX_XY_DEGREE + 1]; MAX_XY_DEGREE + 1];
            t[0][0] = 1.0;
            for n in 1..=self.degree {
                for k in 0..=n {
                    t[n][k] = t[n - 1][k] * a + if k > 0 { t[n - 1][k - 1] * b } else { 0.0 };
                }
            }
            t
        };
        let (u, v) = (table(p[0] * inv, d[0] * inv), table(p[1] * inv, d[1] * inv));
        let mut out = [0.0; MAX_XY_DEGREE + 1];
        for &(i, j, c) in &self.terms {
            for a in 0..=i {
                for b in 0..=j {
                    out[a + b] += c * u[i][a] * v[j][b];
                }
            }
        }
        out
    }

    /// An upper bound of the gradient's length for `r ≤ radius`.
    pub(crate) fn steepest(&self, radius: f64) -> f64 {
        let t = radius / self.radius;
        #[expect(
            clippy::cast_precision_loss,
            clippy::cast_possible_truncation,
            clippy::cast_possible_wrap,
            reason = "small degrees"
        )]
        let bound = |&(i, j, c): &(usize, usize, f64)| {
            c.abs() * ((i * i + j * j) as f64).sqrt() * t.powi((i + j).saturating_sub(1) as i32)
        };
        self.terms.iter().map(bound).sum::<f64>() / self.radius
    }

    /// Value and slope of the monomial `u^i v^j` at `(x, y)`.
    fn monomial(&self, x: f64, y: f64) -> impl Fn(usize, usize) -> [f64; 3] {
        let inv = 1.0 / self.radius;
        let (u, v) = (powers(x * inv, self.degree), powers(y * inv, self.degree));
        move |i, j| [u[i][0] * v[j][0], u[i][1] * v[j][0] * inv, u[i][0] * v[j][1] * inv]
    }
}

/// Zernike terms in Noll's order, orthonormal on the disk of `radius`.
#[derive(Clone, Debug, PartialEq)]
pub struct Zernike {
    radius: f64,
    terms: Vec<f64>,
    /// `u^i v^j` of every term.
    basis: Vec<Vec<(usize, usize, f64)>>,
    sum: Polynomial,
}

impl Zernike {
    /// `terms[j − 1]` is the coefficient (mm) of the term with Noll index `j`; `radius` in mm.
    ///
    /// # Panics
    /// If there are more than `MAX_NOLL` terms.
    pub fn new(radius: f64, terms: Vec<f64>) -> Self {
        assert!(terms.len() <= MAX_NOLL, "at most {MAX_NOLL} Zernike terms");
        let basis = (1..=terms.len()).map(noll).collect();
        let mut made = Self { radius, terms, basis, sum: Polynomial::default() };
        made.refresh();
        made
    }

    /// Normalisation radius, mm.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Coefficients, mm; entry 0 has Noll index 1.
    pub fn terms(&self) -> &[f64] {
        &self.terms
    }

    /// Coefficients to change; call [`Self::refresh`] before the surface is used again.
    pub(crate) fn terms_mut(&mut self) -> &mut [f64] {
        &mut self.terms
    }

    /// Recomputes the polynomial from the coefficients.
    pub(crate) fn refresh(&mut self) {
        let mut sum = BTreeMap::<(usize, usize), f64>::new();
        for (t, basis) in self.terms.iter().zip(&self.basis) {
            for (i, j, c) in basis {
                *sum.entry((*i, *j)).or_default() += t * c;
            }
        }
        self.sum = Polynomial::new(self.radius, sum.into_iter().map(|((i, j), c)| (i, j, c)).collect());
    }

    /// The sum of all terms.
    pub fn polynomial(&self) -> &Polynomial {
        &self.sum
    }

    /// Monomials `(i, j, factor)` of entry `term`.
    pub(crate) fn monomials(&self, term: usize) -> &[(usize, usize, f64)] {
        &self.basis[term]
    }

    /// Adds the pull-back of cotangents on value and slope at `(x, y)` to the terms of `bar`.
    pub(crate) fn terms_vjp(&self, x: f64, y: f64, h_bar: f64, slope_bar: [f64; 2], bar: &mut Self) {
        let monomial = self.sum.monomial(x, y);
        for (b, basis) in bar.terms.iter_mut().zip(&self.basis) {
            for &(i, j, c) in basis {
                let [h, hx, hy] = monomial(i, j);
                *b += c * (h_bar * h + slope_bar[0] * hx + slope_bar[1] * hy);
            }
        }
    }
}

/// `Σ c_{ij} (x/R)^i (y/R)^j`, `1 ≤ i + j ≤ 10`.
#[derive(Clone, Debug, PartialEq)]
pub struct Xy {
    radius: f64,
    orders: Vec<(usize, usize)>,
    terms: Vec<f64>,
    sum: Polynomial,
}

impl Xy {
    /// Terms `(i, j, coefficient in mm)`; `radius` in mm.
    ///
    /// # Panics
    /// If a term's degree is above `MAX_XY_DEGREE`.
    pub fn new(radius: f64, terms: &[(usize, usize, f64)]) -> Self {
        assert!(terms.iter().all(|t| t.0 + t.1 <= MAX_XY_DEGREE), "xy terms up to degree {MAX_XY_DEGREE}");
        let mut made = Self {
            radius,
            orders: terms.iter().map(|t| (t.0, t.1)).collect(),
            terms: terms.iter().map(|t| t.2).collect(),
            sum: Polynomial::default(),
        };
        made.refresh();
        made
    }

    /// Normalisation radius, mm.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Powers of x and y, term by term.
    pub fn orders(&self) -> &[(usize, usize)] {
        &self.orders
    }

    /// Coefficients, mm.
    pub fn terms(&self) -> &[f64] {
        &self.terms
    }

    /// Coefficients to change; call [`Self::refresh`] before the surface is used again.
    pub(crate) fn terms_mut(&mut self) -> &mut [f64] {
        &mut self.terms
    }

    /// Recomputes the polynomial from the coefficients.
    pub(crate) fn refresh(&mut self) {
        let terms = self.orders.iter().zip(&self.terms).map(|((i, j), c)| (*i, *j, *c)).collect();
        self.sum = Polynomial::new(self.radius, terms);
    }

    /// The sum of all terms.
    pub fn polynomial(&self) -> &Polynomial {
        &self.sum
    }

    /// Adds the pull-back of cotangents on value and slope at `(x, y)` to the terms of `bar`.
    pub(crate) fn terms_vjp(&self, x: f64, y: f64, h_bar: f64, slope_bar: [f64; 2], bar: &mut Self) {
        let monomial = self.sum.monomial(x, y);
        for (b, &(i, j)) in bar.terms.iter_mut().zip(&self.orders) {
            let [h, hx, hy] = monomial(i, j);
            *b += h_bar * h + slope_bar[0] * hx + slope_bar[1] * hy;
        }
    }
}

/// Radial order and signed azimuthal order (negative: sine) of a Noll index.
fn noll_orders(j: usize) -> (usize, i64) {
    let mut n = 0;
    while (n + 1) * (n + 2) / 2 < j {
        n += 1;
    }
    // Position in the row of n; rows run over |m| = n mod 2, …, n, each twice except 0; even j is the cosine.
    let k = j - n * (n + 1) / 2;
    let m = if n % 2 == 0 { k / 2 * 2 } else { (k - 1) / 2 * 2 + 1 };
    let signed = i64::try_from(m).expect("small");
    (n, if j.is_multiple_of(2) { signed } else { -signed })
}

/// Monomials `u^i v^j` of a Noll term: radial polynomial × `p^m cos mθ` or `p^m sin mθ`.
fn noll(j: usize) -> Vec<(usize, usize, f64)> {
    let (n, signed) = noll_orders(j);
    let m = usize::try_from(signed.unsigned_abs()).expect("small");
    #[expect(clippy::cast_precision_loss, reason = "exact for the orders allowed")]
    let factorial = |k: usize| (1..=k).map(|x| x as f64).product::<f64>();
    let choose = |a: usize, b: usize| factorial(a) / (factorial(b) * factorial(a - b));
    #[expect(clippy::cast_precision_loss, reason = "small orders")]
    let norm = ((n + 1) as f64 * if m == 0 { 1.0 } else { 2.0 }).sqrt();
    let mut sum = BTreeMap::<(usize, usize), f64>::new();
    for s in 0..=(n - m) / 2 {
        let radial = (if s % 2 == 0 { 1.0 } else { -1.0 }) * factorial(n - s)
            / (factorial(s) * factorial((n + m) / 2 - s) * factorial((n - m) / 2 - s));
        // p^{n−2s} = (u² + v²)^{q} p^m.
        let q = (n - 2 * s - m) / 2;
        for b in 0..=q {
            // Re or Im of (u + iv)^m: i^k carries the sign.
            for k in (usize::from(signed < 0)..=m).step_by(2) {
                let sign = if (k / 2) % 2 == 0 { 1.0 } else { -1.0 };
                let c = norm * radial * choose(q, b) * sign * choose(m, k);
                *sum.entry((2 * (q - b) + m - k, 2 * b + k)).or_default() += c;
            }
        }
    }
    sum.into_iter().filter(|(_, c)| *c != 0.0).map(|((i, j), c)| (i, j, c)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(j: usize, u: f64, v: f64) -> f64 {
        let p = |x: f64, n: usize| x.powi(i32::try_from(n).expect("small"));
        noll(j).iter().map(|(a, b, c)| c * p(u, *a) * p(v, *b)).sum()
    }

    /// Noll's table, by its printed formulas.
    #[test]
    fn first_terms_are_nolls() {
        for (p, t) in [(0.3f64, 0.4f64), (0.9, 2.5), (1.0, -1.2)] {
            let (u, v) = (p * t.cos(), p * t.sin());
            let printed = [
                1.0,
                2.0 * p * t.cos(),
                2.0 * p * t.sin(),
                3f64.sqrt() * (2.0 * p * p - 1.0),
                6f64.sqrt() * p * p * (2.0 * t).sin(),
                6f64.sqrt() * p * p * (2.0 * t).cos(),
                8f64.sqrt() * (3.0 * p.powi(3) - 2.0 * p) * t.sin(),
                8f64.sqrt() * (3.0 * p.powi(3) - 2.0 * p) * t.cos(),
                8f64.sqrt() * p.powi(3) * (3.0 * t).sin(),
                8f64.sqrt() * p.powi(3) * (3.0 * t).cos(),
                5f64.sqrt() * (6.0 * p.powi(4) - 6.0 * p * p + 1.0),
                10f64.sqrt() * (4.0 * p.powi(4) - 3.0 * p * p) * (2.0 * t).cos(),
            ];
            for (i, z) in printed.iter().enumerate() {
                assert!((value(i + 1, u, v) - z).abs() < 1e-13, "Z{}: {} {z}", i + 1, value(i + 1, u, v));
            }
        }
    }

    /// Both `terms_vjp` against the surface itself: value and slope are linear in every term.
    #[test]
    fn terms_vjp_is_the_transpose_of_value_and_slope() {
        use crate::lens::Shape;
        use isoplanat_base::testing::assert_rel;
        let (x, y, h_bar, slope_bar) = (2.3, -1.7, 0.7, [-1.1, 0.4]);
        let dot = |shape: &Shape| {
            let l = shape.at(x, y).expect("a plane reaches everywhere");
            h_bar * l.h + slope_bar[0] * l.slope[0] + slope_bar[1] * l.slope[1]
        };
        let zernike = Zernike::new(4.0, vec![0.0; MAX_NOLL]);
        let mut bar = zernike.clone();
        zernike.terms_vjp(x, y, h_bar, slope_bar, &mut bar);
        for j in 0..MAX_NOLL {
            let mut terms = vec![0.0; MAX_NOLL];
            terms[j] = 1.0;
            let shape = Shape { zernike: Some(Zernike::new(4.0, terms)), ..Shape::default() };
            assert_rel(bar.terms()[j], dot(&shape), 1e-12, 1e-3, &format!("Z{}", j + 1));
        }
        let orders = [(1, 0), (0, 1), (2, 3), (10, 0), (4, 6)];
        let xy = Xy::new(3.0, &orders.map(|(i, j)| (i, j, 0.0)));
        let mut bar = xy.clone();
        xy.terms_vjp(x, y, h_bar, slope_bar, &mut bar);
        for (k, (i, j)) in orders.into_iter().enumerate() {
            let shape = Shape { xy: Some(Xy::new(3.0, &[(i, j, 1.0)])), ..Shape::default() };
            assert_rel(bar.terms()[k], dot(&shape), 1e-12, 1e-3, &format!("x{i}y{j}"));
        }
    }

    /// The polynomial along a line is the polynomial.
    #[test]
    fn along_a_line_is_the_surface_there() {
        use crate::lens::Shape;
        let xy = Xy::new(3.0, &[(1, 0, 0.3), (2, 3, -0.8), (4, 6, 0.2), (0, 7, 0.5)]);
        let (p, d) = ([0.4, -1.1], [0.6, 0.3]);
        let along = xy.polynomial().along(p, d);
        let shape = Shape { xy: Some(xy), ..Shape::default() };
        for s in [-2.0, 0.0, 0.7, 3.1] {
            let value = along.iter().rev().fold(0.0, |sum, c| sum * s + c);
            let h = shape.at(p[0] + s * d[0], p[1] + s * d[1]).expect("reaches").h;
            assert!((value - h).abs() < 1e-13, "{value} {h}");
        }
    }

    /// Orthonormal on the disk, by quadrature exact to degree 20.
    #[test]
    fn terms_are_orthonormal() {
        // Gauss–Legendre in p² (12 nodes by bisection-free Newton), 24 azimuths.
        let nodes: Vec<(f64, f64)> = (0..12)
            .map(|i| {
                let mut x = (std::f64::consts::PI * (f64::from(i) + 0.75) / 12.5).cos();
                let mut slope = 0.0;
                for _ in 0..50 {
                    let (mut a, mut b) = (1.0, x);
                    for n in 1..12 {
                        let n = f64::from(n);
                        (a, b) = (b, ((2.0 * n + 1.0) * x * b - n * a) / (n + 1.0));
                    }
                    slope = 12.0 * (x * b - a) / (x * x - 1.0);
                    x -= b / slope;
                }
                (0.5 * (x + 1.0), 1.0 / ((1.0 - x * x) * slope * slope))
            })
            .collect();
        for a in (1..=MAX_NOLL).step_by(3) {
            for b in 1..=MAX_NOLL {
                let mut sum = 0.0;
                for (s, w) in &nodes {
                    for k in 0..24 {
                        let t = std::f64::consts::TAU * f64::from(k) / 24.0;
                        let (u, v) = (s.sqrt() * t.cos(), s.sqrt() * t.sin());
                        sum += w / 24.0 * value(a, u, v) * value(b, u, v);
                    }
                }
                assert!((sum - f64::from(u8::from(a == b))).abs() < 1e-10, "<Z{a}, Z{b}> = {sum}");
            }
        }
    }
}
