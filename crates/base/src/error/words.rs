//! What readers of TOML and JSON say is wrong, in the words of whoever wrote the file: `text "forty" in place of a number`, not the names of types.

/// The same refusal with the names of types and of the reader's own notions put into words; what is not known stays as it is.
pub fn plain(message: &str) -> String {
    let message = message.trim();
    let of_type = message.strip_prefix("invalid type: ").or_else(|| message.strip_prefix("invalid value: "));
    if let Some((found, expected)) = of_type.and_then(|rest| rest.rsplit_once(", expected ")) {
        let (expected, end) = ended(expected);
        return format!("{} in place of {}{end}", value(found), kind(expected));
    }
    let of_length = message.strip_prefix("invalid length ");
    if let Some((found, expected)) = of_length.and_then(|rest| rest.rsplit_once(", expected ")) {
        let (expected, end) = ended(expected);
        return format!("a list of {found} in place of {}{end}", kind(expected));
    }
    if let Some((found, end)) = quoted(message, "missing field `") {
        return format!("`{found}` is missing{end}");
    }
    if let Some((found, end)) = quoted(message, "duplicate field `") {
        return format!("`{found}` stands twice{end}");
    }
    for (said, word) in [("unknown field `", "unknown key"), ("unknown variant `", "unknown word")] {
        if let Some((found, end)) = quoted(message, said) {
            return format!("{word} `{found}`{end}");
        }
    }
    message.to_owned()
}

/// The key whose value begins where the text ends: `radius_mm` of `radius_mm = `, with the one that its table is the value of: `sensor.rows` of
/// `sensor = { columns = 4, rows = `. Empty where a value begins otherwise.
pub(super) fn key_before(text: &str) -> String {
    let line = text.rsplit('\n').next().unwrap_or_default();
    let Some(line) = line.trim_end().strip_suffix('=') else { return String::new() };
    let bare = |c: char| c.is_alphanumeric() || matches!(c, '_' | '-' | '.');
    let last = |text: &str| text.trim_end().rsplit(|c| !bare(c)).next().unwrap_or_default().to_owned();
    let key = last(line);
    match line.split_once('{').and_then(|(outer, _)| outer.trim_end().strip_suffix('=')) {
        Some(outer) if !line.contains('}') && line.matches('{').count() == 1 => format!("{}.{key}", last(outer)),
        _ => key,
    }
}

/// What stands between `before` and the next quote, and what follows.
fn quoted<'a>(message: &'a str, before: &str) -> Option<(&'a str, &'a str)> {
    message.strip_prefix(before)?.split_once('`')
}

/// What was expected, and where in a JSON text it was.
fn ended(expected: &str) -> (&str, String) {
    match expected.rsplit_once(" at line ") {
        Some((expected, at)) => (expected, format!(" at line {at}")),
        None => (expected, String::new()),
    }
}

/// A value that was found.
fn value(found: &str) -> String {
    for said in ["integer `", "floating point `", "boolean `", "character `"] {
        if let Some(number) = found.strip_prefix(said).and_then(|rest| rest.strip_suffix('`')) {
            return number.to_owned();
        }
    }
    match found {
        "sequence" => "a list".into(),
        "map" => "a table".into(),
        "null" | "unit value" | "Option value" => "nothing".into(),
        _ => found.strip_prefix("string ").map_or_else(|| found.to_owned(), |text| format!("text {text}")),
    }
}

/// A kind of value that was expected.
fn kind(expected: &str) -> String {
    let known = match expected {
        "f32" | "f64" => "a number",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number from 0 on",
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
        "a nonzero u32" | "a nonzero u64" | "a nonzero usize" => "a whole number from 1 on",
        "a boolean" => "true or false",
        "a string" | "a borrowed string" | "string or map" | "path string" => "text",
        "a sequence" => "a list",
        "a map" => "a table",
        _ if expected.starts_with("struct ") || expected.starts_with("internally tagged enum ") => "a table",
        _ => {
            let count = expected.strip_prefix("an array of length ").or_else(|| {
                let of = expected.strip_prefix("a tuple of size ")?;
                of.chars().all(|c| c.is_ascii_digit()).then_some(of)
            });
            return count.map_or_else(|| expected.to_owned(), |n| format!("a list of {n}"));
        }
    };
    known.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    #[expect(dead_code, reason = "read by the test's refusals alone")]
    struct Keys {
        radius_mm: f64,
        steps: Option<u32>,
        on: Option<bool>,
        names: Option<Vec<String>>,
        size: Option<[f64; 2]>,
        below: Option<Below>,
        kind: Option<Kind>,
    }

    #[derive(Debug, serde::Deserialize)]
    #[expect(dead_code, reason = "read by the test's refusals alone")]
    struct Below {
        a: f64,
    }

    #[derive(Debug, serde::Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Kind {
        Flat,
    }

    #[test]
    fn a_value_has_the_key_before_it() {
        for (text, key) in [
            ("a = 1\nradius_mm = ", "radius_mm"),
            ("  a.b =", "a.b"),
            ("sensor = { columns = 4, rows = ", "sensor.rows"),
            ("nm = [486.1, ", ""),
            ("[[surface]]\n", ""),
            ("", ""),
            ("= ", ""),
            ("x = { a = { b = ", "b"),
        ] {
            assert_eq!(key_before(text), key, "{text}");
        }
    }

    /// The readers' own refusals, whatever words they have today.
    #[test]
    fn refusals_have_no_names_of_types() {
        for (text, said) in [
            ("radius_mm = \"forty\"", "text \"forty\" in place of a number"),
            ("radius_mm = true", "true in place of a number"),
            ("radius_mm = [1.0]", "a list in place of a number"),
            ("radius_mm = 1\nsteps = -3", "-3 in place of a whole number from 0 on"),
            ("radius_mm = 1\nsteps = 1.5", "1.5 in place of a whole number from 0 on"),
            ("radius_mm = 1\non = 1", "1 in place of true or false"),
            ("radius_mm = 1\nnames = \"a\"", "text \"a\" in place of a list"),
            ("radius_mm = 1\nnames = [5]", "5 in place of text"),
            ("radius_mm = 1\nbelow = 3", "3 in place of a table"),
            ("radius_mm = 1\nradus = 3", "unknown key `radus`, expected one of `radius_mm`"),
            ("radius_mm = 1\nsize = [1.0]", "a list of 1 in place of a list of 2"),
            ("radius_mm = 1\nkind = \"bent\"", "unknown word `bent`, expected `flat`"),
            ("steps = 3", "`radius_mm` is missing"),
        ] {
            let error = toml::from_str::<Keys>(text).expect_err(text);
            let found = plain(error.message());
            assert!(found.starts_with(said), "{text}: {found}, of {}", error.message());
        }
        // As `serde_json` says the same.
        for (message, said) in [
            (
                "invalid type: null, expected f64 at line 1 column 18",
                "nothing in place of a number at line 1 column 18",
            ),
            ("duplicate field `radius_mm` at line 1 column 28", "`radius_mm` stands twice at line 1 column 28"),
            ("expected value at line 2 column 1", "expected value at line 2 column 1"),
        ] {
            assert_eq!(plain(message), said);
        }
    }
}
