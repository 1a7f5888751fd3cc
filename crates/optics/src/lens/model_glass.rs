//! Model glasses: an index and an Abbe number in a catalogue's place.

use super::Medium;
use isoplanat_base::error::{Error, Result};

/// Lines d, F, C of catalogues, nm.
pub(crate) const LINES_NM: [f64; 3] = [587.561_8, 486.132_7, 656.272_5];

/// Index and Abbe number of a fictitious glass: `517642`, `516800.641673`, `1.5168:64.17` or `1.5168,64.17`.
pub(crate) fn fictitious(name: &str) -> Option<(f64, f64)> {
    if let Some((n, v)) = name.split_once([':', ',']) {
        return Some((n.trim().parse().ok()?, v.trim().parse().ok()?));
    }
    let digits = |s: &str| !s.is_empty() && s.len() <= 12 && s.bytes().all(|b| b.is_ascii_digit());
    let (n, v) = match name.split_once('.') {
        Some((n, v)) if digits(n) && digits(v) && n.len() >= 3 => (n, v),
        None if digits(name) && name.len() == 6 => name.split_at(3),
        _ => return None,
    };
    let v = if v.len() <= 2 { v.to_owned() } else { format!("{}.{}", &v[..2], &v[2..]) };
    Some((format!("1.{n}").parse().ok()?, v.parse().ok()?))
}

/// A constant index is a table over all wavelengths that a lens may have.
pub(crate) fn constant(n: f64) -> Result<Medium> {
    if n == 1.0 {
        return Ok(Medium::Air);
    }
    if !(1.0..=5.0).contains(&n) {
        return Err(Error::bad("", "medium", format!("an index of {n}"), "1 to 5"));
    }
    Ok(Medium::Table { wavelength_nm: vec![200.0, 20_000.0], index: vec![n, n] })
}

/// The two-term Cauchy curve that has the index `n_d` at the d line and the Abbe number `v_d` of d, F, C, as the pair of eq. 8: the
/// same curve by its values at that equation's own lines.
pub(crate) fn cauchy_of_lines(n_d: f64, v_d: f64) -> Result<Medium> {
    if v_d == 0.0 {
        // Programs write 0 for "no dispersion stated".
        return constant(n_d);
    }
    let bad = !(n_d.is_finite() && v_d.is_finite());
    if bad || !(1.0..=5.0).contains(&n_d) || !(1.0..=1e4).contains(&v_d) {
        let found = format!("a model glass of n_d {n_d}, V_d {v_d}");
        return Err(Error::bad("", "medium", found, "n_d from 1 to 5, V_d from 1 to 10000"));
    }
    let inverse_square = |nm: f64| (nm * 1e-3).powi(-2);
    let [d, f, c] = LINES_NM.map(inverse_square);
    let slope = (n_d - 1.0) / (v_d * (f - c));
    let index = |nm: f64| n_d + slope * (inverse_square(nm) - d);
    let [n_line, n_f, n_c] = [589.3, 486.1, 656.3].map(index);
    Ok(Medium::Cauchy { n_d: n_line, v_d: (n_line - 1.0) / (n_f - n_c) })
}

/// Index at the d line and Abbe number of d, F, C of a medium, as files state model glasses; 0 stands for no dispersion.
pub(crate) fn lines_of(medium: &Medium) -> (f64, f64) {
    let [d, f, c] = LINES_NM.map(|nm| medium.index(nm));
    (d, if f == c { 0.0 } else { (d - 1.0) / (f - c) })
}

/// [`lines_of`] a table that follows a model glass's curve, as one that was written for such a glass does; nothing where it does not.
pub(crate) fn lines_of_table(medium: &Medium) -> Option<(f64, f64)> {
    const CLOSE: f64 = 1e-9;
    let Medium::Table { wavelength_nm, index } = medium else { return None };
    let [short, long] = medium.range_nm();
    if LINES_NM.iter().any(|nm| *nm < short || *nm > long) {
        return None;
    }
    let (n, v) = lines_of(medium);
    let curve = cauchy_of_lines(n, v).ok()?;
    let close = |(nm, n): (&f64, &f64)| (curve.index(*nm) - n).abs() <= CLOSE;
    wavelength_nm.iter().zip(index).all(close).then_some((n, v))
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoplanat_base::testing::assert_abs;

    /// A model glass has its index and its Abbe number at the catalogues' lines, and says them again.
    #[test]
    fn model_glasses_hold_at_their_lines() {
        for (n, v) in [(1.58913, 61.2), (1.80518, 25.4), (1.4914, 57.4)] {
            let medium = cauchy_of_lines(n, v).expect("a glass");
            let [d, f, c] = LINES_NM.map(|nm| medium.index(nm));
            assert_abs(d, n, 1e-14, "n_d");
            assert_abs((d - 1.0) / (f - c), v, 1e-10, "V_d");
            let (again_n, again_v) = lines_of(&medium);
            assert_abs(again_n, n, 1e-14, "n_d again");
            assert_abs(again_v, v, 1e-10, "V_d again");
        }
        assert!(cauchy_of_lines(f64::NAN, 3.0).is_err() && cauchy_of_lines(1.5, -3.0).is_err());
    }

    #[test]
    fn fictitious_glasses() {
        assert_eq!(fictitious("517642"), Some((1.517, 64.2)));
        assert_eq!(fictitious("516800.641673"), Some((1.5168, 64.1673)));
        assert_eq!(fictitious("1.5168:64.17"), Some((1.5168, 64.17)));
        assert_eq!(fictitious("1.5168, 64.17"), Some((1.5168, 64.17)));
        assert_eq!(fictitious("NBK7_SCHOTT"), None);
        assert_eq!(fictitious("F2"), None);
    }
}
