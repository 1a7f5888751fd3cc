//! Numbers as people read them.

/// A number with `digits` significant digits, without needless zeros; `inf` where it is infinite.
pub fn significant(value: f64, digits: usize) -> String {
    if !value.is_finite() || value == 0.0 {
        return if value.is_nan() { "nan".into() } else { format!("{}", value + 0.0) };
    }
    #[expect(clippy::cast_possible_truncation, reason = "an exponent of f64")]
    let exponent = value.abs().log10().floor() as i32;
    let digits = digits.max(1);
    if (-4..7).contains(&exponent) {
        let places = usize::try_from(i32::try_from(digits).unwrap_or(17) - 1 - exponent).unwrap_or(0);
        let text = format!("{value:.places$}");
        return if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text };
    }
    let text = format!("{value:.*e}", digits - 1);
    let (mantissa, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    let mantissa = if mantissa.contains('.') { mantissa.trim_end_matches('0').trim_end_matches('.') } else { mantissa };
    format!("{mantissa}e{exponent}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_their_significant_digits() {
        let cases = [
            (50.021_350_7, 6, "50.0214"),
            (0.0, 3, "0"),
            (-1.0, 4, "-1"),
            (1.29e-5, 4, "1.29e-5"),
            (123_456.0, 3, "123456"),
            (f64::INFINITY, 3, "inf"),
            (0.001_234_5, 3, "0.00123"),
            (1e9, 3, "1e9"),
            (100.0, 2, "100"),
        ];
        for (value, digits, text) in cases {
            assert_eq!(significant(value, digits), text);
        }
    }
}
