//! Files of which each has to be another one, such as frames of a sensor whose differences are its noise.

use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::path::Path;

use isoplanat::{Error, Result};

/// Whether `path` is none of the `earlier` files, and no copy of one; `allowed` says what is wanted in its place.
///
/// # Errors
/// A file that is given twice.
pub(crate) fn first_time<'a>(path: &Path, earlier: impl IntoIterator<Item = &'a Path>, allowed: &str) -> Result<()> {
    // What cannot be read again was read by somebody else, who has told what is wrong with it.
    let Some(other) = earlier.into_iter().find(|other| same(path, other).unwrap_or(false)) else { return Ok(()) };
    let found = if path == other {
        "given twice".to_owned()
    } else {
        format!("the same as {}, byte for byte", other.display())
    };
    Err(Error::bad(path.display().to_string(), "contents", found, allowed))
}

/// Whether two files hold the same bytes: most differ in length or at their beginning.
fn same(one: &Path, other: &Path) -> io::Result<bool> {
    let lengths = [std::fs::metadata(one)?, std::fs::metadata(other)?].map(|m| m.is_file().then_some(m.len()));
    if lengths[0] != lengths[1] || lengths[0].is_none() {
        return Ok(false);
    }
    let (mut one, mut other) = (BufReader::new(File::open(one)?), BufReader::new(File::open(other)?));
    loop {
        let (a, b) = (one.fill_buf()?, other.fill_buf()?);
        let n = a.len().min(b.len());
        if a[..n] != b[..n] {
            return Ok(false);
        }
        if n == 0 {
            return Ok(a.is_empty() && b.is_empty());
        }
        one.consume(n);
        other.consume(n);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_are_told_from_their_like() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name);
        let mut bytes = vec![7; 20_000];
        for name in ["a", "copy"] {
            std::fs::write(at(name), &bytes).expect("writes");
        }
        bytes[19_999] = 8;
        std::fs::write(at("last"), &bytes).expect("writes");
        std::fs::write(at("short"), &bytes[..19_998]).expect("writes");
        let [a, copy, last, short, gone] = ["a", "copy", "last", "short", "gone"].map(at);
        let others = [&*last, &*short, &*gone, folder.path()];
        assert!(first_time(&a, others, "another").is_ok());
        assert!(first_time(&gone, [&*gone, &*a], "another").is_ok());
        let said = first_time(&copy, others.into_iter().chain([&*a]), "another").expect_err("a copy").to_string();
        assert!(said.contains("copy: contents: the same as ") && said.ends_with("byte for byte; another"), "{said}");
        let said = first_time(&a, [&*a], "another").expect_err("itself").to_string();
        assert!(said.ends_with("a: contents: given twice; another"), "{said}");
    }
}
