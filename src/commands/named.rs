//! What the command line names: a file, a folder or something shipped, in any encoding.

use std::ffi::OsString;
use std::fmt;
use std::ops::Deref;
use std::path::Path;

use clap::builder::{OsStringValueParser, TypedValueParser, ValueParserFactory};

/// A name or a path; as text it is shown, with a mark for each byte that is none.
#[derive(Clone, Debug)]
pub(crate) struct Named {
    given: OsString,
    shown: String,
}

impl<T: Into<OsString>> From<T> for Named {
    fn from(given: T) -> Self {
        let given = given.into();
        Self { shown: given.to_string_lossy().into_owned(), given }
    }
}

impl Named {
    /// What a file made of it is called, without an ending: the name of a file or folder, or what was named with dashes for colons.
    pub(crate) fn stem(&self) -> String {
        let path: &Path = self.as_ref();
        match path.file_stem() {
            Some(stem) if path.exists() => stem.to_string_lossy().into_owned(),
            _ => self.shown.replace(':', "-"),
        }
    }
}

impl AsRef<Path> for Named {
    fn as_ref(&self) -> &Path {
        self.given.as_ref()
    }
}

impl Deref for Named {
    type Target = str;

    fn deref(&self) -> &str {
        &self.shown
    }
}

impl fmt::Display for Named {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.shown)
    }
}

impl ValueParserFactory for Named {
    type Parser = clap::builder::MapValueParser<OsStringValueParser, fn(OsString) -> Self>;

    fn value_parser() -> Self::Parser {
        OsStringValueParser::new().map(<Self as From<OsString>>::from)
    }
}
