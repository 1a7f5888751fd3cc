//! What is printed: texts of files cannot steer a terminal.

use std::borrow::Cow;
use std::io::{Result, Write};
use std::path::Path;

/// Whether a terminal would do something else than show it: control characters but ends of line and tabs, marks that turn the direction of a text, other ends
/// of line and paragraph, and what has no width, so that two texts look the same.
fn steers(c: char) -> bool {
    (c.is_control() && c != '\n' && c != '\t')
        || matches!(
            c,
            '\u{061c}'
                | '\u{200b}'
                | '\u{200e}'
                | '\u{200f}'
                | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{2064}'
                | '\u{2066}'..='\u{2069}'
                | '\u{feff}'
        )
}

/// The text with what would steer a terminal as escapes, `\u001b`: in a string of JSON they are the same characters still.
pub fn printable(text: &str) -> Cow<'_, str> {
    escaped(text, steers)
}

/// [`printable`] text within a line: ends of line and tabs are escapes, too. For names, which hold whatever a file or its system lets them.
pub fn in_line(text: &str) -> Cow<'_, str> {
    escaped(text, |c| steers(c) || c == '\n' || c == '\t')
}

/// A path [`in_line`].
#[doc(hidden)]
pub fn path_in_line(path: &Path) -> String {
    in_line(&path.display().to_string()).into_owned()
}

/// The text with characters of some kind as escapes.
fn escaped(text: &str, is: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is) {
        return Cow::Borrowed(text);
    }
    let escaped = text.chars().map(|c| if is(c) { format!("\\u{:04x}", u32::from(c)) } else { c.to_string() });
    Cow::Owned(escaped.collect())
}

/// The text, or its beginning and an ellipsis where it has more than `most` characters: facts of files have any length.
pub fn cut(text: &str, most: usize) -> Cow<'_, str> {
    match text.char_indices().nth(most) {
        None => Cow::Borrowed(text),
        Some(_) => Cow::Owned(text.chars().take(most.saturating_sub(1)).chain(['…']).collect()),
    }
}

/// A writer to a terminal, or what may be shown on one, of [`printable`] text. Characters that come in two writes are put together.
#[derive(Debug)]
pub struct Printable<W: Write> {
    inner: W,
    /// The beginning of a character.
    begun: Vec<u8>,
}

impl<W: Write> Printable<W> {
    /// Around `inner`.
    pub fn new(inner: W) -> Self {
        Self { inner, begun: Vec::new() }
    }
}

impl<W: Write> Write for Printable<W> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        self.begun.extend_from_slice(bytes);
        let whole = match std::str::from_utf8(&self.begun) {
            Ok(text) => text.len(),
            // What is no text at all goes on as it is marked by the decoder.
            Err(e) if e.error_len().is_some() => self.begun.len(),
            Err(e) => e.valid_up_to(),
        };
        let rest = self.begun.split_off(whole);
        let text = String::from_utf8_lossy(&self.begun);
        self.inner.write_all(printable(&text).as_bytes())?;
        self.begun = rest;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<()> {
        self.inner.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_texts_are_cut_between_characters() {
        assert!(matches!(cut("µµµ", 3), Cow::Borrowed("µµµ")));
        assert_eq!(cut("µµµµ", 3), "µµ…");
        assert_eq!(cut("a", 0), "…");
    }

    #[test]
    fn what_steers_is_shown() {
        assert_eq!(printable("a\tµ\n"), "a\tµ\n");
        assert!(matches!(printable("Cooke triplet, 50 mm"), Cow::Borrowed(_)));
        assert_eq!(printable("\u{1b}]0;x\u{7}\r\u{202e}b"), "\\u001b]0;x\\u0007\\u000d\\u202eb");
        assert_eq!(printable("a\u{2028}\u{200b}b\u{feff}\n"), "a\\u2028\\u200bb\\ufeff\n");
        assert_eq!(in_line("a\tb\n\u{2029}c"), "a\\u0009b\\u000a\\u2029c");
        assert!(matches!(in_line("f/2 – 50 µm"), Cow::Borrowed(_)));
        let text = "µm \u{1b}[2K – ende\u{9b}";
        for size in 1..5 {
            let mut out = Vec::new();
            let mut to = Printable::new(&mut out);
            for part in text.as_bytes().chunks(size) {
                to.write_all(part).expect("in memory");
            }
            assert_eq!(String::from_utf8(out).expect("text"), "µm \\u001b[2K – ende\\u009b", "{size}");
        }
    }
}
