//! Numbers as people read them.

use std::borrow::Cow;

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

/// Digits of a number from which it is shown as a power of ten.
const MOST_DIGITS: usize = 20;

/// The text with numbers of very many digits as people read them: `1000…0` of 300 digits as `1e300`, `0.000…01` as `1e-12`; digits within names stay.
pub(crate) fn readable(text: &str) -> Cow<'_, str> {
    let of_number = |c: char| c.is_ascii_digit() || c == '.';
    if !text.split(|c: char| !of_number(c)).any(|run| run.len() > MOST_DIGITS) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(start) = rest.find(of_number) {
        let (before, from) = rest.split_at(start);
        let length = from.find(|c| !of_number(c)).unwrap_or(from.len());
        let (run, after) = from.split_at(length);
        // A full stop behind a number is none of it.
        let number = run.trim_end_matches('.');
        let alone = |c: Option<char>| !c.is_some_and(|c| c.is_alphanumeric() || c == '_');
        let apart = alone(before.chars().next_back()) && alone(after.chars().next());
        out += before;
        match number.parse::<f64>() {
            Ok(value) if apart && number.len() > MOST_DIGITS && value.is_finite() => {
                out += &format!("{value:e}");
                out += &run[number.len()..];
            }
            _ => out += run,
        }
        rest = after;
    }
    out += rest;
    Cow::Owned(out)
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

    #[test]
    fn very_long_numbers_are_powers_of_ten() {
        for value in [1e300, -1e300, 1.5e-12, 1e22, f64::MAX, f64::MIN_POSITIVE] {
            let told = readable(&format!("a: {value}; above 0")).into_owned();
            let found = told.trim_start_matches("a: ").trim_end_matches("; above 0");
            assert!(found.len() < 26 && found.parse::<f64>() == Ok(value), "{told}");
        }
        assert_eq!(readable(&format!("{}.", 1e300)), "1e300.");
        assert_eq!(readable(&format!("{}..{}", 1e300, 2)), format!("{}..2", 1e300), "no number");
        let hash = format!("b{}a of 18446744073709551615 and {}", "7".repeat(62), "3".repeat(64));
        assert!(readable(&hash).starts_with(&hash[..89]) && readable(&hash).ends_with("3.333333333333333e63"));
        for text in ["1.5 mm", "", "1000000000000000000", "a.b.c", "0.1234567890123456"] {
            assert!(matches!(readable(text), Cow::Borrowed(_)), "{text}");
        }
    }
}
