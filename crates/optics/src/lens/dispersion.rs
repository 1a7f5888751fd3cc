//! Dispersion formulas of glass catalogues, λ in µm.
//!
//! | name | formula | in files |
//! |---|---|---|
//! | `schott` | `n² = a₀ + a₁λ² + a₂λ⁻² + a₃λ⁻⁴ + a₄λ⁻⁶ + a₅λ⁻⁸` | AGF 1 |
//! | `sellmeier` | `n² = 1 + Σ K λ²/(λ² − L)` | AGF 2 (three terms), 6 (four), 11 (five) |
//! | `herzberger` | `n = A + BL + CL² + Dλ² + Eλ⁴ + Fλ⁶`, `L = 1/(λ² − 0.028)` | AGF 3, page 7 |
//! | `sellmeier_2` | `n² = 1 + A + B₁λ²/(λ² − λ₁²) + B₂/(λ² − λ₂²)`; coefficients `A, B₁, λ₁, B₂, λ₂` | AGF 4 |
//! | `conrady` | `n = n₀ + A/λ + B/λ^3.5` | AGF 5 |
//! | `handbook_1` | `n² = A + B/(λ² − C) − Dλ²` | AGF 7 |
//! | `handbook_2` | `n² = A + Bλ²/(λ² − C) − Dλ²` | AGF 8 |
//! | `sellmeier_4` | `n² = A + Bλ²/(λ² − C) + Dλ²/(λ² − E)` | AGF 9 |
//! | `extended` | `schott` with `a₆λ⁻¹⁰ + a₇λ⁻¹²` | AGF 10 |
//! | `extended_2` | `schott` with `a₆λ⁴ + a₇λ⁶` | AGF 12 |
//! | `extended_3` | `n² = a₀ + a₁λ² + a₂λ⁴ + a₃λ⁻² + a₄λ⁻⁴ + … + a₈λ⁻¹²` | AGF 13 |
//! | `sellmeier_offset` | `n² = 1 + C + Σ K λ²/(λ² − L)` | page 2 |
//! | `sellmeier_squares` | `n² = 1 + C + Σ K λ²/(λ² − L²)` | page 1 |
//! | `powers_of_square` | `n² = C + Σ c λ^p`; coefficients `C, c, p, …` | page 3 |
//! | `rational` | `n² = C + c₁λ^p₁/(λ² − a₁^q₁) + c₂λ^p₂/(λ² − a₂^q₂) + Σ c λ^p` | page 4 |
//! | `powers` | `n = C + Σ c λ^p` | page 5 |
//! | `gas` | `n = 1 + C + Σ B/(c − λ⁻²)` | page 6 |
//! | `retro` | `(n² − 1)/(n² + 2) = A + Bλ²/(λ² − C) + Dλ²` | page 8 |
//! | `exotic` | `n² = A + B/(λ² − C) + D(λ − E)/((λ − E)² + F)` | page 9 |
//!
//! AGF: the catalogue format of Zemax (formulas by its number there). Page: a page of refractiveindex.info (formulas by its number).

use std::ops::{Add, Div, Mul, Sub};

use serde::{Deserialize, Serialize};

/// Most coefficients of a formula.
pub const MOST: usize = 24;

/// A formula of the table above.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[expect(missing_docs, reason = "the table above says what each is")]
pub enum Formula {
    Schott,
    Sellmeier,
    Herzberger,
    #[serde(rename = "sellmeier_2")]
    Sellmeier2,
    Conrady,
    #[serde(rename = "handbook_1")]
    Handbook1,
    #[serde(rename = "handbook_2")]
    Handbook2,
    #[serde(rename = "sellmeier_4")]
    Sellmeier4,
    Extended,
    #[serde(rename = "extended_2")]
    Extended2,
    #[serde(rename = "extended_3")]
    Extended3,
    SellmeierOffset,
    SellmeierSquares,
    PowersOfSquare,
    Rational,
    Powers,
    Gas,
    Retro,
    Exotic,
}

/// What a formula gives.
enum Gives<T> {
    Index(T),
    Square(T),
    /// `(n² − 1)/(n² + 2)`.
    Retro(T),
}

/// A formula with its coefficients.
#[derive(Clone, Debug, PartialEq)]
pub struct Dispersion {
    formula: Formula,
    coefficients: Vec<f64>,
}

/// A number or a number with a derivative: formulas are written once for both.
trait Number: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> {
    fn of(x: f64) -> Self;
    fn sqrt(self) -> Self;
    /// `base^self`.
    fn exponent_of(self, base: Self) -> Self;
}

impl Number for f64 {
    fn of(x: f64) -> Self {
        x
    }
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    fn exponent_of(self, base: Self) -> Self {
        base.powf(self)
    }
}

/// A value and its derivative.
#[derive(Clone, Copy)]
struct Dual(f64, f64);

impl Add for Dual {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self(self.0 + o.0, self.1 + o.1)
    }
}
impl Sub for Dual {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        Self(self.0 - o.0, self.1 - o.1)
    }
}
impl Mul for Dual {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Self(self.0 * o.0, self.1 * o.0 + self.0 * o.1)
    }
}
impl Div for Dual {
    type Output = Self;
    fn div(self, o: Self) -> Self {
        let quotient = self.0 / o.0;
        Self(quotient, (self.1 - quotient * o.1) / o.0)
    }
}
impl Number for Dual {
    fn of(x: f64) -> Self {
        Self(x, 0.0)
    }
    fn sqrt(self) -> Self {
        let root = self.0.sqrt();
        Self(root, 0.5 * self.1 / root)
    }
    fn exponent_of(self, base: Self) -> Self {
        let power = base.0.powf(self.0);
        // A base that is nought has no logarithm, and its power no derivative over the exponent.
        let by_exponent = if self.1 == 0.0 { 0.0 } else { power * base.0.ln() * self.1 };
        let by_base = if base.1 == 0.0 { 0.0 } else { self.0 * base.0.powf(self.0 - 1.0) * base.1 };
        Self(power, by_exponent + by_base)
    }
}

/// `Σ c_k λ^{p_k}`.
fn powers<T: Number>(c: &[T], um: f64, exponents: &[i32]) -> T {
    c.iter().zip(exponents).fold(T::of(0.0), |sum, (c, p)| sum + *c * T::of(um.powi(*p)))
}

/// `Σ c λ^p` of `c, p, c, p, …`.
fn series<T: Number>(pairs: &[T], um: f64) -> T {
    let term = |pair: &[T]| pair[0] * pair[1].exponent_of(T::of(um));
    pairs.chunks_exact(2).fold(T::of(0.0), |sum, pair| sum + term(pair))
}

/// `start + Σ K λ²/(λ² − pole(L))` of `K, L, K, L, …`.
fn poles<T: Number>(start: T, pairs: &[T], w: T, pole: impl Fn(T) -> T) -> T {
    pairs.chunks_exact(2).fold(start, |sum, pair| sum + pair[0] * w / (w - pole(pair[1])))
}

impl Formula {
    /// Its name in files.
    pub fn name(self) -> String {
        let text = serde_json::to_string(&self).unwrap_or_default();
        text.trim_matches('"').to_owned()
    }

    /// Numbers of coefficients that it may have.
    fn counts(self, count: usize) -> bool {
        match self {
            Self::Schott | Self::Herzberger => count == 6,
            Self::Sellmeier => count >= 2 && count.is_multiple_of(2),
            Self::Sellmeier2 | Self::Sellmeier4 => count == 5,
            Self::Conrady => count == 3,
            Self::Handbook1 | Self::Handbook2 | Self::Retro => count == 4,
            Self::Extended | Self::Extended2 => count == 8,
            Self::Extended3 => count == 9,
            Self::SellmeierOffset | Self::SellmeierSquares | Self::PowersOfSquare | Self::Powers | Self::Gas => {
                count % 2 == 1
            }
            Self::Rational => count >= 9 && count % 2 == 1,
            Self::Exotic => count == 6,
        }
    }

    fn gives<T: Number>(self, c: &[T], um: f64) -> Gives<T> {
        use Gives::{Index, Retro, Square};
        let (one, w) = (T::of(1.0), T::of(um * um));
        match self {
            Self::Schott => Square(powers(c, um, &[0, 2, -2, -4, -6, -8])),
            Self::Sellmeier => Square(poles(one, c, w, |l| l)),
            Self::Herzberger => {
                let l = T::of(1.0 / (um * um - 0.028));
                Index(c[0] + c[1] * l + c[2] * l * l + powers(&c[3..], um, &[2, 4, 6]))
            }
            Self::Sellmeier2 => Square(one + c[0] + c[1] * w / (w - c[2] * c[2]) + c[3] / (w - c[4] * c[4])),
            Self::Conrady => Index(c[0] + c[1] / T::of(um) + c[2] / T::of(um.powf(3.5))),
            Self::Handbook1 => Square(c[0] + c[1] / (w - c[2]) - c[3] * w),
            Self::Handbook2 => Square(c[0] + c[1] * w / (w - c[2]) - c[3] * w),
            Self::Sellmeier4 => Square(c[0] + c[1] * w / (w - c[2]) + c[3] * w / (w - c[4])),
            Self::Extended => Square(powers(c, um, &[0, 2, -2, -4, -6, -8, -10, -12])),
            Self::Extended2 => Square(powers(c, um, &[0, 2, -2, -4, -6, -8, 4, 6])),
            Self::Extended3 => Square(powers(c, um, &[0, 2, 4, -2, -4, -6, -8, -10, -12])),
            Self::SellmeierOffset => Square(poles(one + c[0], &c[1..], w, |l| l)),
            Self::SellmeierSquares => Square(poles(one + c[0], &c[1..], w, |l| l * l)),
            Self::PowersOfSquare => Square(c[0] + series(&c[1..], um)),
            Self::Rational => {
                let part = |c: &[T]| c[0] * c[1].exponent_of(T::of(um)) / (w - c[3].exponent_of(c[2]));
                Square(c[0] + part(&c[1..]) + part(&c[5..]) + series(&c[9..], um))
            }
            Self::Powers => Index(c[0] + series(&c[1..], um)),
            Self::Gas => {
                let u = T::of(1.0 / (um * um));
                let parts = c[1..].chunks_exact(2).fold(T::of(0.0), |sum, p| sum + p[0] / (p[1] - u));
                Index(one + c[0] + parts)
            }
            Self::Retro => Retro(c[0] + c[1] * w / (w - c[2]) + c[3] * w),
            Self::Exotic => {
                let off = T::of(um) - c[4];
                Square(c[0] + c[1] / (w - c[2]) + c[3] * off / (off * off + c[5]))
            }
        }
    }

    fn index<T: Number>(self, c: &[T], um: f64) -> T {
        match self.gives(c, um) {
            Gives::Index(n) => n,
            Gives::Square(square) => square.sqrt(),
            Gives::Retro(r) => ((T::of(1.0) + r + r) / (T::of(1.0) - r)).sqrt(),
        }
    }
}

impl Dispersion {
    /// `formula` with `coefficients`; `None` for a number of them that it does not have, or one that is not finite.
    pub fn new(formula: Formula, coefficients: Vec<f64>) -> Option<Self> {
        let valid = formula.counts(coefficients.len()) && coefficients.len() <= MOST;
        (valid && coefficients.iter().all(|c| c.is_finite())).then_some(Self { formula, coefficients })
    }

    /// The formula.
    pub fn formula(&self) -> Formula {
        self.formula
    }

    /// Its coefficients, in the order of the table above.
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficients
    }

    pub(in crate::lens) fn coefficients_mut(&mut self) -> &mut [f64] {
        &mut self.coefficients
    }

    /// Index at `um` µm; not a number beyond poles.
    pub fn index(&self, um: f64) -> f64 {
        self.formula.index(&self.coefficients, um)
    }

    /// Adds the pull-back of a cotangent on [`Self::index`] to the coefficients' `bar`.
    pub(crate) fn index_vjp(&self, um: f64, index_bar: f64, bar: &mut Self) {
        let mut duals: Vec<Dual> = self.coefficients.iter().map(|c| Dual(*c, 0.0)).collect();
        for (k, to) in bar.coefficients.iter_mut().enumerate() {
            duals[k].1 = 1.0;
            *to += index_bar * self.formula.index(&duals, um).1;
            duals[k].1 = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::{assert_abs, assert_rel, steady_difference};

    /// One of each, near real glasses.
    fn each() -> Vec<Dispersion> {
        let bk7 = [1.039_612_12, 0.006_000_698_67, 0.231_792_344, 0.020_017_914_4, 1.010_469_45, 103.560_653];
        let schott = [2.271_178_96, -0.010_107_691, 0.010_592_509, 2.081_699_8e-4, -7.647_253_8e-6, 4.924_099e-7];
        let squares = [0.0, 1.039_612_12, 0.077_464_176, 0.231_792_344, 0.141_484_67, 1.010_469_45, 10.176_475];
        let with = |first: &[f64], more: &[f64]| [first, more].concat();
        let all = [
            (Formula::Schott, schott.to_vec()),
            (Formula::Sellmeier, bk7.to_vec()),
            (Formula::Herzberger, vec![1.5, 2e-3, 1e-5, -1e-3, 1e-5, 1e-7]),
            (Formula::Sellmeier2, vec![0.2, 1.05, 0.1, 5e-3, 0.12]),
            (Formula::Conrady, vec![1.49, 8e-3, 5e-4]),
            (Formula::Handbook1, vec![2.27, 0.011, 0.01, 0.01]),
            (Formula::Handbook2, vec![1.2, 1.05, 0.011, 0.01]),
            (Formula::Sellmeier4, vec![1.1, 1.15, 0.011, 0.9, 110.0]),
            (Formula::Extended, with(&schott, &[1e-9, 2e-10])),
            (Formula::Extended2, with(&schott, &[1e-4, 2e-5])),
            (Formula::Extended3, vec![2.27, -0.01, 1e-4, 0.0106, 2e-4, -7e-6, 5e-7, 1e-9, 1e-10]),
            (Formula::SellmeierOffset, with(&[0.01], &bk7)),
            (Formula::SellmeierSquares, squares.to_vec()),
            (Formula::PowersOfSquare, vec![2.27, -0.01, 2.0, 0.0106, -2.0]),
            (Formula::Rational, vec![1.3, 1.0, 2.0, 0.1, 2.0, 0.9, 2.0, 10.0, 2.0, -1e-3, 2.0]),
            (Formula::Powers, vec![1.5, 5e-3, -2.0, 1e-4, -4.0]),
            (Formula::Gas, vec![0.0, 0.057_921_05, 238.018_5, 0.001_679_17, 57.362]),
            (Formula::Retro, vec![0.28, 5e-3, 0.02, -1e-3]),
            (Formula::Exotic, vec![2.27, 0.011, 0.01, 1e-3, 0.1, 0.5]),
        ];
        all.map(|(f, c)| Dispersion::new(f, c).expect("well formed")).to_vec()
    }

    /// Every coefficient of every formula, against differences.
    #[test]
    fn index_vjp_agrees_with_differences() {
        for d in each() {
            for um in [0.43, 0.587_561_8, 0.9] {
                let n = d.index(um);
                assert!(n > 1.0 && n < 2.0, "{:?} {n}", d.formula);
                let mut bar = Dispersion { coefficients: vec![0.0; d.coefficients.len()], ..d };
                d.index_vjp(um, 0.7, &mut bar);
                let largest = bar.coefficients.iter().fold(0.0, |m: f64, b| m.max(b.abs()));
                for (k, pulled) in bar.coefficients.iter().enumerate() {
                    // Steps that move the index by 1e-6 and more where they are not long.
                    let size = (1.0 / (pulled.abs() + 1e-3)).min(10.0);
                    let at = |h: f64| {
                        let mut moved = d.clone();
                        moved.coefficients[k] += h;
                        0.7 * moved.index(um)
                    };
                    let difference = |h: f64| (at(h * size) - at(-h * size)) / (2.0 * h * size);
                    let numeric = steady_difference(difference, (0..8).map(|i| 1e-6 * 2f64.powi(i)));
                    assert_rel(*pulled, numeric, 1e-7, 1e-2 * largest, &format!("{:?} {k} at {um}", d.formula));
                }
            }
        }
    }

    /// Two ways to write one glass are one glass: a Sellmeier formula with its poles squared or not, a power series as one of Schott's.
    #[test]
    fn formulas_agree_with_each_other() {
        let all = each();
        let of = |formula: Formula| all.iter().find(|d| d.formula == formula).expect("each is there");
        let schott = of(Formula::Schott).coefficients().to_vec();
        let as_powers =
            vec![schott[0], schott[1], 2.0, schott[2], -2.0, schott[3], -4.0, schott[4], -6.0, schott[5], -8.0];
        let as_powers = Dispersion::new(Formula::PowersOfSquare, as_powers).expect("well formed");
        for um in [0.4, 0.55, 1.0] {
            assert_abs(as_powers.index(um), of(Formula::Schott).index(um), 1e-14, "powers");
            assert_abs(of(Formula::SellmeierSquares).index(um), of(Formula::Sellmeier).index(um), 1e-7, "squares");
        }
        // N-BK7 at the d line, as its data sheet prints it.
        assert_abs(of(Formula::Sellmeier).index(0.587_561_8), 1.516_80, 5e-6, "n_d");
    }

    #[test]
    fn wrong_numbers_of_coefficients_are_refused() {
        for (formula, count) in
            [(Formula::Schott, 5), (Formula::Sellmeier, 3), (Formula::Powers, 2), (Formula::Rational, 7)]
        {
            assert_eq!(Dispersion::new(formula, vec![1.0; count]), None);
        }
        assert_eq!(Dispersion::new(Formula::Sellmeier, vec![1.0; MOST + 2]), None);
        assert_eq!(Dispersion::new(Formula::Conrady, vec![1.5, f64::NAN, 0.0]), None);
    }
}
