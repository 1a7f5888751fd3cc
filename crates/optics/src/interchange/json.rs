//! JSON of DeepLens and of Optiland: told apart by their keys.

mod deeplens;
mod once;
mod optiland;

pub(super) use deeplens::medium;
use serde_json::Value;

use super::draft::Draft;
use isoplanat_base::error::{Error, Location, Result};

/// Reads the text of a file; `file` names it in errors.
pub(super) fn read(text: &str, file: &str) -> Result<Draft> {
    // Programs in Python write infinities, which JSON does not have.
    let plain = words(text);
    let once::Once(value) = serde_json::from_str(&plain).map_err(|e| {
        // A text of JSON has no data that a value cannot take, but keys that stand twice.
        let (found, allowed) = if e.is_data() {
            (e.to_string(), "each key of an object once")
        } else {
            (format!("no JSON: {e}"), "a lens of DeepLens or Optiland")
        };
        Error::bad(file, Location::line(e.line()), found, allowed)
    })?;
    if value.get("surface_group").is_some() {
        optiland::read(&value, file)
    } else if value.get("surfaces").is_some_and(Value::is_array) {
        deeplens::read(&value, file)
    } else {
        let keys: Vec<&str> =
            value.as_object().map_or_else(Vec::new, |o| o.keys().take(5).map(String::as_str).collect());
        let found = format!("an object with the keys {}", super::text::shown(&keys.join(", ")));
        Err(Error::bad(file, "keys", found, "`surfaces` (DeepLens) or `surface_group` (Optiland)"))
    }
}

/// `Infinity`, `-Infinity` and `NaN` outside strings as strings.
fn words(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut inside = false;
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        if !inside && let Some(word) = ["-Infinity", "Infinity", "NaN"].iter().find(|w| rest.starts_with(**w)) {
            out.push('"');
            out.push_str(word);
            out.push('"');
            rest = &rest[word.len()..];
            continue;
        }
        out.push(c);
        rest = &rest[c.len_utf8()..];
        if inside && c == '\\' {
            if let Some(next) = rest.chars().next() {
                out.push(next);
                rest = &rest[next.len_utf8()..];
            }
        } else if c == '"' {
            inside = !inside;
        }
    }
    out
}

/// A part of a file with its path, for errors.
struct Part<'a> {
    value: &'a Value,
    file: &'a str,
    path: String,
}

impl<'a> Part<'a> {
    fn new(value: &'a Value, file: &'a str) -> Self {
        Self { value, file, path: String::new() }
    }

    /// The part under a key, where there is one that is not null.
    fn get(&self, key: &str) -> Option<Self> {
        let value = self.value.get(key).filter(|v| !v.is_null())?;
        let path = if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) };
        Some(Self { value, file: self.file, path })
    }

    fn need(&self, key: &str) -> Result<Self> {
        self.get(key).ok_or_else(|| self.refused(format!("no key `{key}`"), "a file that has it"))
    }

    fn items(&self) -> Result<Vec<Self>> {
        let list = self.value.as_array().ok_or_else(|| self.refused("no list", "a list"))?;
        let item = |(i, value)| Self { value, file: self.file, path: format!("{}[{i}]", self.path) };
        Ok(list.iter().enumerate().map(item).collect())
    }

    fn refused(&self, found: impl Into<String>, allowed: &str) -> Error {
        let place = if self.path.is_empty() { "keys" } else { self.path.as_str() };
        Error::bad(self.file, place, found, allowed)
    }

    /// A number; infinities are numbers, NaN is not.
    fn any_number(&self) -> Result<f64> {
        let number = match self.value {
            Value::String(s) if s == "Infinity" => Some(f64::INFINITY),
            Value::String(s) if s == "-Infinity" => Some(f64::NEG_INFINITY),
            other => other.as_f64(),
        };
        number.ok_or_else(|| self.refused(super::text::shown(&self.value.to_string()), "a number"))
    }

    fn number(&self) -> Result<f64> {
        let number = self.any_number()?;
        if number.is_finite() { Ok(number) } else { Err(self.refused(number.to_string(), "a finite number")) }
    }

    fn text(&self) -> Result<&'a str> {
        self.value.as_str().ok_or_else(|| self.refused(super::text::shown(&self.value.to_string()), "a text"))
    }

    fn is_true(&self, key: &str) -> bool {
        self.value.get(key) == Some(&Value::Bool(true))
    }
}

#[cfg(test)]
mod tests {
    /// A key twice in one object, at any depth, is refused by its name, with other values or the same; the same key of other objects is another.
    #[test]
    fn keys_that_stand_twice_are_refused() {
        for (text, line, key) in [
            ("{\"surfaces\": [],\n \"surfaces\": []}", 2, "surfaces"),
            ("{\"surfaces\": [{\"d\": 1},\n {\"d\": 1, \"roc\": Infinity,\n \"d\": 2}]}", 3, "d"),
            ("{\"surface_group\": {\"a\": {\"x\": null, \"\\u0078\": null}}}", 1, "x"),
        ] {
            let error = super::read(text, "a.json").map(|_| ()).expect_err(text).to_string();
            let told = format!("a.json: line {line}: the key `{key}` stands twice");
            assert!(error.starts_with(&told) && error.ends_with("; each key of an object once"), "{error}");
        }
        let error = super::read("{\"a\": 1", "a.json").map(|_| ()).expect_err("open").to_string();
        assert!(error.contains("no JSON: "), "{error}");
    }

    #[test]
    fn infinities_become_strings_outside_strings_only() {
        let text = r#"{"a": -Infinity, "b \" NaN": [Infinity, NaN], "c": "Infinity"}"#;
        let expected = r#"{"a": "-Infinity", "b \" NaN": ["Infinity", "NaN"], "c": "Infinity"}"#;
        assert_eq!(super::words(text), expected);
    }
}

#[cfg(test)]
mod forms;
