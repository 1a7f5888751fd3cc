//! The library's one error type: every message names the file, the place, the value and what is allowed.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use crate::figures::readable;
use crate::terminal::cut;

/// What can go wrong. Everything but [`Error::Internal`], [`Error::Stopped`] and [`Error::Interrupted`] is bad input (exit code 2).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value in a file or argument that cannot be used.
    #[error("{}{}; {}", before(&[&one_line(file), &one_line(&cut(place, MOST))]), one_line(&cut(&readable(found), MOST)), one_line(&readable(allowed)))]
    BadInput {
        /// File (or the argument's name) the value stands in.
        file: String,
        /// Where in the file: key, surface, line.
        place: String,
        /// What was found there.
        found: String,
        /// What is allowed.
        allowed: String,
    },
    /// A file that could not be read or written.
    #[error("{}: {what}: {reason}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was being done: `reading`, `writing`.
        what: &'static str,
        /// The system's reason.
        reason: std::io::Error,
    },
    /// An output that exists already, without `--force`.
    #[error("{}: exists already; name another output or pass --force", .0.display())]
    Exists(PathBuf),
    /// A fault of the program.
    #[error("internal error: {0}")]
    Internal(String),
    /// Long work that cannot go on; what was reached is kept.
    #[error("{0}")]
    Stopped(String),
    /// The user pressed Ctrl-C.
    #[error("interrupted")]
    Interrupted,
}

/// What stands before a value: the parts that there are, with colons.
fn before(parts: &[&str]) -> String {
    parts.iter().filter(|part| !part.is_empty()).map(|part| format!("{part}: ")).collect()
}

/// The text in one line: readers of others say what is wrong in several, and values hold ends of lines.
fn one_line(text: &str) -> Cow<'_, str> {
    if !text.contains(['\n', '\r']) {
        return Cow::Borrowed(text);
    }
    let lines = text.split(['\n', '\r']).map(str::trim).filter(|line| !line.is_empty());
    Cow::Owned(lines.collect::<Vec<_>>().join(" "))
}

/// Characters of a place and of a value in a message at most.
const MOST: usize = 400;

/// The library's result.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// A bad value: `file: place: found; allowed`.
    ///
    /// ```
    /// use isoplanat_base::Error;
    ///
    /// let error = Error::bad("lens.toml", "surface[2].thickness_mm", "-1", "0 or more");
    /// assert_eq!(error.to_string(), "lens.toml: surface[2].thickness_mm: -1; 0 or more");
    /// assert_eq!(error.exit_code(), 2);
    /// ```
    pub fn bad(
        file: impl Into<String>,
        place: impl Into<String>,
        found: impl Into<String>,
        allowed: impl Into<String>,
    ) -> Self {
        Self::BadInput { file: file.into(), place: place.into(), found: found.into(), allowed: allowed.into() }
    }

    /// A file that could not be read.
    pub fn reading(path: &Path, reason: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), what: "reading", reason }
    }

    /// A program that could not be started as a process of its own: the system lets no more in, or it is not there.
    pub fn starting(program: &Path, reason: std::io::Error) -> Self {
        Self::Io { path: program.to_owned(), what: "starting it as a process of its own", reason }
    }

    /// A file that could not be written.
    pub fn writing(path: &Path, reason: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), what: "writing", reason }
    }

    /// A TOML text that does not parse: its line, and what the parser said.
    pub fn toml(file: &str, text: &str, error: &toml::de::Error, allowed: &str) -> Self {
        let line = error.span().map_or(1, |span| text[..span.start.min(text.len())].matches('\n').count() + 1);
        Self::bad(file, format!("line {line}"), error.message().trim().replace('\n', " "), allowed)
    }

    /// The same error with the file's name put in where it was not known (`file` empty).
    #[must_use]
    pub fn in_file(self, path: &Path) -> Self {
        match self {
            Self::BadInput { file, place, found, allowed } if file.is_empty() => {
                Self::BadInput { file: path.display().to_string(), place, found, allowed }
            }
            other => other,
        }
    }

    /// The error as part of a sentence: without the place of a file that nobody has named.
    pub fn words(&self) -> String {
        self.to_string()
    }

    /// The program's exit code for this error.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Internal(_) | Self::Stopped(_) => 1,
            Self::Interrupted => 130,
            _ => 2,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A message is one line, whatever the words of other readers, keys and values are (found by fuzzing: JPEG and `.npy`).
    #[test]
    fn messages_are_one_line() {
        let error = Error::bad("a\nb", "key\n", "expected 2\n  |\r\n1 | x\n", "a\npicture");
        assert_eq!(error.to_string(), "a b: key: expected 2 | 1 | x; a picture");
        assert_eq!(Error::bad("a", "", "x\t y", "z").to_string(), "a: x\t y; z");
    }
}
