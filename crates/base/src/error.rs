//! The library's one error type: every message names the file, the place, the value and what is allowed.
//!
//! [`BadInput`] holds these four as parts, from where the error arises. Whoever knows more puts a part in ([`Error::in_file`],
//! [`Error::within`], [`Error::at`]); nobody reads the text.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use crate::figures::readable;
use crate::terminal::cut;

pub use location::Location;
#[doc(hidden)]
pub use words::plain;

mod location;
mod words;

/// What can go wrong. Everything but [`Error::Internal`], [`Error::Stopped`] and [`Error::Interrupted`] is bad input (exit code 2).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value in a file or argument that cannot be used.
    #[error("{0}")]
    BadInput(Box<BadInput>),
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

/// A value that cannot be used: where it stands, what it is, what is allowed.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct BadInput {
    /// The file, or the argument's name; empty where whoever found the fault does not know it, until [`Error::in_file`] puts it in.
    pub file: String,
    /// Where in the file.
    pub place: Location,
    /// What was found there.
    pub found: String,
    /// What is allowed.
    pub allowed: String,
}

impl std::fmt::Display for BadInput {
    /// `file: place: found; allowed` in one line.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let place = self.place.to_string();
        let before = before(&[&one_line(&self.file), &one_line(&cut(&place, MOST))]);
        let found = readable(&self.found);
        write!(f, "{before}{}; {}", one_line(&cut(&found, MOST)), one_line(&readable(&self.allowed)))
    }
}

impl BadInput {
    /// The same with the file's name put in where it was not known.
    #[must_use]
    pub fn in_file(mut self, path: impl AsRef<Path>) -> Self {
        if self.file.is_empty() {
            self.file = path.as_ref().display().to_string();
        }
        self
    }
}

impl From<BadInput> for Error {
    fn from(bad: BadInput) -> Self {
        Self::BadInput(Box::new(bad))
    }
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
    /// // A name in a file may be empty: a message says so.
    /// assert_eq!(Error::bad("a.onnx", "operator", "", "Add").to_string(), "a.onnx: operator: nothing; Add");
    /// ```
    pub fn bad(
        file: impl Into<String>,
        place: impl Into<Location>,
        found: impl Into<String>,
        allowed: impl Into<String>,
    ) -> Self {
        let (file, place, allowed) = (file.into(), place.into(), allowed.into());
        let found: String = found.into();
        let found = if found.is_empty() { "nothing".to_owned() } else { found };
        Self::BadInput(Box::new(BadInput { file, place, found, allowed }))
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

    /// A TOML text that does not parse: its line, its key where that line has it, and what is wrong.
    pub fn toml(file: &str, text: &str, error: &toml::de::Error, allowed: &str) -> Self {
        let before = error.span().and_then(|span| text.get(..span.start)).unwrap_or_default();
        let place = Location::line(before.matches('\n').count() + 1).key(words::key_before(before));
        Self::bad(file, place, plain(error.message()), allowed)
    }

    /// What is bad about the input, where that is the error.
    pub fn bad_input(&self) -> Option<&BadInput> {
        if let Self::BadInput(bad) = self { Some(bad) } else { None }
    }

    /// The error as one of input, as which it goes to another process: what is none becomes the value found at `place`.
    #[doc(hidden)]
    #[must_use]
    pub fn into_bad_input(self, place: impl Into<Location>, allowed: &str) -> BadInput {
        match self {
            Self::BadInput(bad) => *bad,
            other => {
                let (place, found) = (place.into(), other.to_string());
                BadInput { file: String::new(), place, found, allowed: allowed.to_owned() }
            }
        }
    }

    /// The same error with a part changed, where it is one of input.
    #[must_use]
    fn changed(mut self, change: impl FnOnce(&mut BadInput)) -> Self {
        if let Self::BadInput(bad) = &mut self {
            change(bad);
        }
        self
    }

    /// The same error with the file's name put in where it was not known.
    #[must_use]
    pub fn in_file(self, path: impl AsRef<Path>) -> Self {
        match self {
            Self::BadInput(bad) => bad.in_file(path).into(),
            other => other,
        }
    }

    /// The same error of `path`, whatever file it named: a thing that was made of that file has a name of its own.
    #[doc(hidden)]
    #[must_use]
    pub fn of_file(self, path: impl AsRef<Path>) -> Self {
        self.changed(|bad| bad.file = path.as_ref().display().to_string())
    }

    /// The same error without its file, for a sentence that has named it.
    #[doc(hidden)]
    #[must_use]
    pub fn without_file(self) -> Self {
        self.changed(|bad| bad.file.clear())
    }

    /// The same error with its files named as `named` does, which is told each.
    #[doc(hidden)]
    #[must_use]
    pub fn with_files(self, named: impl Fn(PathBuf) -> PathBuf) -> Self {
        match self {
            Self::Io { path, what, reason } => Self::Io { path: named(path), what, reason },
            Self::Exists(path) => Self::Exists(named(path)),
            other => other.changed(|bad| bad.file = named(std::mem::take(&mut bad.file).into()).display().to_string()),
        }
    }

    /// The same error at `place`, where whoever asked knows the value's place and whoever refused it does not.
    #[must_use]
    pub fn at(self, place: impl Into<Location>) -> Self {
        self.changed(|bad| bad.place = place.into())
    }

    /// The same error with its place below `outer` ([`Location::within`]).
    #[must_use]
    pub fn within(self, outer: impl Into<Location>) -> Self {
        self.with_place(|place| place.within(outer))
    }

    /// The same error at the place that `named` makes of its own.
    #[doc(hidden)]
    #[must_use]
    pub fn with_place(self, named: impl FnOnce(Location) -> Location) -> Self {
        self.changed(|bad| bad.place = named(std::mem::take(&mut bad.place)))
    }

    /// The same error with another way out before those that it names.
    #[doc(hidden)]
    #[must_use]
    pub fn or_else_allowed(self, way: &str) -> Self {
        self.changed(|bad| bad.allowed = format!("{way}; or {}", bad.allowed))
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

    /// Each part is put in where it is known, and only there; errors of other kinds stay what they are.
    #[test]
    fn parts_are_put_in_where_they_are_known() {
        let error = || Error::bad("", Location::surface(2).key("medium"), "x", "y");
        let line = Location { label: "SURF 3".into(), ..Location::line(7) };
        for (error, text) in [
            (error(), "surface[2].medium: x; y"),
            (error().in_file("a"), "a: surface[2].medium: x; y"),
            (error().in_file("a").in_file("b"), "a: surface[2].medium: x; y"),
            (error().in_file("a").of_file("b"), "b: surface[2].medium: x; y"),
            (error().in_file("a").without_file(), "surface[2].medium: x; y"),
            (error().at("key"), "key: x; y"),
            (error().at("").in_file("a"), "a: x; y"),
            (error().within(line), "line 7 (SURF 3): surface[2].medium: x; y"),
            (error().within("stages[1]"), "stages[1].surface[2].medium: x; y"),
            (error().or_else_allowed("z"), "surface[2].medium: x; z; or y"),
            (error().in_file("b").with_files(|file| Path::new("a").join(file)), "a/b: surface[2].medium: x; y"),
        ] {
            assert_eq!((error.to_string().replace('\\', "/").as_str(), error.exit_code()), (text, 2));
        }
        let other = Error::Exists("b".into()).at("key").of_file("a").within("c");
        assert!(other.bad_input().is_none() && other.to_string().starts_with("b: exists already"));
        let sent = other.into_bad_input("inference", "a model").in_file("m");
        assert!(
            sent.to_string().starts_with("m: inference: b: exists already") && sent.to_string().ends_with("; a model")
        );
        assert_eq!(error().in_file("a").into_bad_input("", ""), *error().in_file("a").bad_input().expect("of input"));
    }

    /// A message is one line, whatever the words of other readers, keys and values are (found by fuzzing: JPEG and `.npy`).
    #[test]
    fn messages_are_one_line() {
        let error = Error::bad("a\nb", "key\n", "expected 2\n  |\r\n1 | x\n", "a\npicture");
        assert_eq!(error.to_string(), "a b: key: expected 2 | 1 | x; a picture");
        assert_eq!(Error::bad("a", "", "x\t y", "z").to_string(), "a: x\t y; z");
    }
}
