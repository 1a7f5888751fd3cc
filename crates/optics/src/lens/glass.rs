//! Media: index of refraction against wavelength.
//!
//! - Two-term Cauchy from `(n_d, V_d)` (paper eqs. 7–8): `n(λ) = A + B/λ²`, λ in µm, with
//!   `V = (n_d − 1)/(n_F − n_C)`, with the paper's lines D 589.3, F 486.1, C 656.3 nm. Catalogues give `n_d` at
//!   587.56 nm: read as the paper's pair it makes the index at 587.56 nm larger by 1.0e-4 (PMMA) to 1.7e-4 (PC). A
//!   prescription that must hold to the digit names its glass or gives a table.
//!   Taken from 350 to 1100 nm. Two numbers hold the visible; against the catalogue's glasses the index is off by up to
//!   5e-3 (SF10, 400 nm), 2e-3 (crowns, 1100 nm) and 2e-2 (SF10, 350 nm).
//! - A glass of a catalogue ([`super::catalogue`]) by its dispersion formula ([`super::dispersion`]); known over the range that the
//!   catalogue states.
//! - A table of wavelengths and indices: exact at its entries, between them a Cauchy curve through the two
//!   neighbours (linear in 1/λ²); known up to 5 nm past its ends.
//!
//! [`Medium::index`] evaluates the formula anywhere; whoever takes a wavelength from a file or a command line asks
//! [`crate::lens::Prescription::require_indices`] first. Not covered: absorption, temperature, pressure.

use super::dispersion::Dispersion;
use isoplanat_base::figures::significant;
use isoplanat_base::units::um_from_nm;

/// Wavelengths of a table are within, nm.
pub(crate) const TABLE_NM: std::ops::RangeInclusive<f64> = 100.0..=1e5;

/// Lines of eq. 8, nm.
const D_NM: f64 = 589.3;
const F_NM: f64 = 486.1;
const C_NM: f64 = 656.3;
/// Where two numbers say enough of a dispersion, nm.
const CAUCHY_NM: [f64; 2] = [350.0, 1100.0];
/// How far a table is continued past its ends, nm.
const PAST_TABLE_NM: f64 = 5.0;

/// A homogeneous medium.
#[derive(Clone, Debug, PartialEq)]
pub enum Medium {
    /// Index 1 at every wavelength.
    Air,
    /// Two-term Cauchy from index at the d line and Abbe number.
    Cauchy {
        /// Index at 589.3 nm (eq. 8).
        n_d: f64,
        /// Abbe number.
        v_d: f64,
    },
    /// Glass of a catalogue.
    Glass {
        /// Name in the catalogue, such as `N-SK16`.
        name: String,
        /// Formula and coefficients.
        dispersion: Dispersion,
        /// Wavelengths that they hold for, nm.
        range_nm: [f64; 2],
        /// Where they come from.
        source: String,
    },
    /// Tabulated index.
    Table {
        /// Wavelengths, nm, ascending.
        wavelength_nm: Vec<f64>,
        /// Index at each.
        index: Vec<f64>,
    },
}

fn inverse_square(nm: f64) -> f64 {
    um_from_nm(nm).powi(-2)
}

/// `1/(λ_F^{-2} − λ_C^{-2})`, µm².
fn cauchy_span() -> f64 {
    1.0 / (inverse_square(F_NM) - inverse_square(C_NM))
}

impl Medium {
    /// Shortest and longest wavelength at which the index is known, nm.
    pub fn range_nm(&self) -> [f64; 2] {
        match self {
            Self::Air => [0.0, f64::INFINITY],
            Self::Cauchy { .. } => CAUCHY_NM,
            Self::Glass { range_nm, .. } => *range_nm,
            Self::Table { wavelength_nm: nm, .. } => match nm[..] {
                [] => [f64::INFINITY, f64::NEG_INFINITY],
                [first, ..] => [first - PAST_TABLE_NM, nm[nm.len() - 1] + PAST_TABLE_NM],
            },
        }
    }

    /// Where its index comes from, in words.
    pub fn source(&self) -> String {
        match self {
            Self::Air => "1 by definition".into(),
            Self::Cauchy { .. } => "two numbers of the lens file (n_d, v_d)".into(),
            Self::Glass { source, dispersion, .. } => format!("{source}, formula {}", dispersion.formula().name()),
            Self::Table { index, .. } => format!("a table of {} indices in the lens file", index.len()),
        }
    }

    /// Index at `nm`. Outside [`Self::range_nm`] the formula is continued and means nothing.
    ///
    /// ```
    /// use isoplanat_optics::lens::catalogue::{Glasses, Naming};
    ///
    /// let glass = Glasses::shipped().find("N-BK7", Naming::Exact)?;
    /// assert!((glass.index(587.5618) - 1.5168).abs() < 1e-5);
    /// # Ok::<(), isoplanat_base::error::Error>(())
    /// ```
    pub fn index(&self, nm: f64) -> f64 {
        match self {
            Self::Air => 1.0,
            Self::Cauchy { n_d, v_d } => {
                let b = (n_d - 1.0) / v_d * cauchy_span();
                n_d + b * (inverse_square(nm) - inverse_square(D_NM))
            }
            Self::Glass { dispersion, .. } => dispersion.index(um_from_nm(nm)),
            Self::Table { wavelength_nm, index } => {
                // Lists of two lengths are refused by the check; before it the shorter one counts.
                let count = wavelength_nm.len().min(index.len());
                let (wavelength_nm, index) = (&wavelength_nm[..count], &index[..count]);
                if let Some(i) = wavelength_nm.iter().position(|w| (w - nm).abs() < 1e-9) {
                    return index[i];
                }
                if count < 2 {
                    return index.first().copied().unwrap_or(f64::NAN);
                }
                let i = wavelength_nm.partition_point(|w| *w < nm).clamp(1, count - 1);
                let (u0, u1) = (inverse_square(wavelength_nm[i - 1]), inverse_square(wavelength_nm[i]));
                let t = (inverse_square(nm) - u0) / (u1 - u0);
                index[i - 1] + t * (index[i] - index[i - 1])
            }
        }
    }

    /// Adds the pull-back of a cotangent on [`Self::index`] to the numbers of `bar`, a medium of the same form; wavelengths of
    /// tables are held.
    pub(crate) fn index_vjp(&self, nm: f64, index_bar: f64, bar: &mut Self) {
        match (self, bar) {
            (Self::Cauchy { n_d, v_d }, Self::Cauchy { n_d: n_bar, v_d: v_bar }) => {
                let span = cauchy_span() * (inverse_square(nm) - inverse_square(D_NM));
                *n_bar += index_bar * (1.0 + span / v_d);
                *v_bar += index_bar * (-(n_d - 1.0) / (v_d * v_d) * span);
            }
            (Self::Glass { dispersion, .. }, Self::Glass { dispersion: bar, .. }) => {
                dispersion.index_vjp(um_from_nm(nm), index_bar, bar);
            }
            (Self::Table { .. }, Self::Table { index: bars, .. }) => {
                // The index is linear in the entries: each by what it alone would give.
                for (k, entry_bar) in bars.iter_mut().enumerate() {
                    let mut alone = self.clone();
                    if let Self::Table { index, .. } = &mut alone {
                        index.iter_mut().enumerate().for_each(|(j, n)| *n = f64::from(u8::from(j == k)));
                    }
                    *entry_bar += index_bar * alone.index(nm);
                }
            }
            _ => {}
        }
    }

    /// `[n_d, v_d]` as the two-number medium has them, at the lines of eq. 8.
    pub(crate) fn pair(&self) -> [f64; 2] {
        let [d, f, c] = [D_NM, F_NM, C_NM].map(|nm| self.index(nm));
        [d, (d - 1.0) / (f - c)]
    }
}

/// A medium in one short text.
impl std::fmt::Display for Medium {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Air => f.write_str("air"),
            Self::Cauchy { n_d, v_d } => write!(f, "n_d {}, v_d {}", significant(*n_d, 7), significant(*v_d, 6)),
            Self::Glass { name, .. } => f.write_str(name),
            Self::Table { index, .. } => write!(f, "table of {}", index.len()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lens::catalogue::{Glasses, Naming};
    use isoplanat_base::testing::{assert_abs, assert_rel, central_difference};

    /// Cauchy reproduces n_d and V by definition.
    #[test]
    fn cauchy_keeps_its_two_numbers() {
        let pmma = Medium::Cauchy { n_d: 1.4914, v_d: 57.4 };
        assert_abs(pmma.index(D_NM), 1.4914, 1e-15, "n_d");
        let v = (pmma.index(D_NM) - 1.0) / (pmma.index(F_NM) - pmma.index(C_NM));
        assert_rel(v, 57.4, 1e-12, 0.0, "V");
        // The paper states 1.493 at 550 nm; the D line of the pair leaves 3.1e-4.
        assert_abs(pmma.index(550.0), 1.493, 3.2e-4, "PMMA at 550 nm");
    }

    /// `index_vjp` of each form against differences, number by number; lenses of every kind test it through rays too.
    #[test]
    fn index_vjp_agrees_with_differences() {
        let table = |h: f64| Medium::Table { wavelength_nm: vec![450.0, 550.0], index: vec![1.63 + h, 1.62] };
        let mut bar = table(0.0);
        if let Medium::Table { index, .. } = &mut bar {
            index.fill(0.0);
        }
        table(0.0).index_vjp(480.0, 0.7, &mut bar);
        let Medium::Table { index, .. } = bar else { unreachable!("a table stays one") };
        assert_rel(index[0], central_difference(|h| 0.7 * table(h).index(480.0), 1e-3), 1e-9, 0.0, "entry");
    }

    /// Within its range a medium's index is a number above 1 that falls with wavelength; beyond, formulas have poles.
    #[test]
    fn indices_are_normal_within_their_range() {
        let table = Medium::Table { wavelength_nm: vec![486.0, 588.0, 656.0], index: vec![1.63, 1.62, 1.615] };
        let cauchy = Medium::Cauchy { n_d: 1.5849, v_d: 29.9 };
        for medium in [Glasses::shipped().find("N-BK7", Naming::Exact).expect("shipped"), cauchy, table.clone()] {
            let [a, b] = medium.range_nm();
            let indices: Vec<f64> = (0..=500).map(|k| medium.index(a + (b - a) * f64::from(k) / 500.0)).collect();
            assert!(indices.windows(2).all(|n| n[0] > n[1] && n[1] > 1.0), "{medium}");
        }
        assert_eq!(table.range_nm(), [481.0, 661.0]);
        let bk7 = Glasses::shipped().find("N-BK7", Naming::Exact).expect("shipped");
        assert!(bk7.index(10_100.0).is_nan() && bk7.range_nm()[1] < 10_100.0);
    }
}
