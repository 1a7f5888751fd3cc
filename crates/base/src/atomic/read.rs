//! Files that are read whole, up to a size; texts of a stated form.

use std::fs::{self, File};
use std::io::Read;
use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use super::place;
use crate::error::{Error, Result};

/// Refuses what is no file: opening a pipe waits for its writer, a device may have no end.
///
/// [`read_bounded`] takes a pipe that is open already (`/dev/stdin`, a shell's `<(…)`), too.
///
/// # Errors
/// [`Error::Io`] for what is not there, [`Error::BadInput`] for a folder, a pipe, a device.
pub fn regular(path: &Path) -> Result<()> {
    let found = fs::metadata(path).map_err(|e| Error::reading(path, e))?;
    if found.is_file() {
        return Ok(());
    }
    let found = if found.is_dir() { "a folder" } else { "a pipe, a socket or a device" };
    Err(Error::bad(path.display().to_string(), "file", found, "a file"))
}

/// The bytes of a file of at most `most` bytes.
///
/// # Errors
/// As [`regular`]; a larger file; [`Error::Io`].
pub fn read_bounded(path: &Path, most: u64) -> Result<Vec<u8>> {
    if !is_open_pipe(path) {
        regular(path)?;
    }
    read_at_most(File::open(path).map_err(|e| Error::reading(path, e))?, path, most)
}

/// Whether `path` leads to a descriptor of this process behind which a pipe is.
fn is_open_pipe(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        fs::metadata(path).is_ok_and(|m| m.file_type().is_fifo()) && place::descriptor(path).is_some()
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        false
    }
}

/// The bytes of a reader that gives at most `most` bytes; `name` is what errors call it.
///
/// # Errors
/// More bytes; what the reader says.
pub fn read_at_most(from: impl Read, name: &Path, most: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    from.take(most.saturating_add(1)).read_to_end(&mut bytes).map_err(|e| Error::reading(name, e))?;
    if bytes.len() as u64 > most {
        let found = format!("more than {most} bytes");
        return Err(Error::bad(name.display().to_string(), "size", found, format!("at most {most} bytes")));
    }
    Ok(bytes)
}

/// SHA-256 of `bytes` as 64 lower-case hexadecimal digits.
pub fn sha256_hex(bytes: &[u8]) -> String {
    sha256_of([bytes])
}

/// [`sha256_hex`] of all `parts` as one.
pub fn sha256_of<T: AsRef<[u8]>>(parts: impl IntoIterator<Item = T>) -> String {
    let mut hash = Sha256::new();
    parts.into_iter().for_each(|part| hash.update(part));
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The text of a file of at most `most` bytes.
///
/// # Errors
/// As [`read_bounded`]; what is not UTF-8.
pub fn read_text(path: &Path, most: u64) -> Result<String> {
    as_text(read_bounded(path, most)?, path)
}

/// Bytes as the text that they are; `name` is what errors call it.
///
/// # Errors
/// What is not UTF-8.
pub fn as_text(bytes: Vec<u8>, name: &Path) -> Result<String> {
    String::from_utf8(bytes).map_err(|e| {
        let found = format!("no text at byte {}", e.utf8_error().valid_up_to());
        Error::bad(name.display().to_string(), "text", found, "UTF-8")
    })
}

/// A TOML text of form `schema`; `file` names it in messages, `allowed` says where its keys are listed. A newer file is refused by its
/// number, not by its first new key.
///
/// # Errors
/// Another form; what is no TOML, or not of this type.
pub fn of_schema<T: DeserializeOwned>(text: &str, file: &str, schema: u32, allowed: &str) -> Result<T> {
    #[derive(Deserialize)]
    struct Form {
        schema: Option<u32>,
    }
    let syntax = |e: toml::de::Error| Error::toml(file, text, &e, allowed);
    let form: Form = crate::exact::from_toml(text).map_err(syntax)?;
    if form.schema != Some(schema) {
        let found = form.schema.map_or("missing".into(), |s| s.to_string());
        return Err(Error::bad(file, "schema", found, format!("this version reads schema = {schema}")));
    }
    crate::exact::from_toml(text).map_err(syntax)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What has no end is not read, nor more than was asked for.
    #[test]
    fn only_files_of_a_size_are_read() {
        let place = tempfile::tempdir().expect("a temporary folder");
        let path = place.path().join("a");
        std::fs::write(&path, [1u8; 11]).expect("writes");
        assert_eq!(read_bounded(&path, 11).expect("reads").len(), 11);
        let refused = |path: &Path, said: &str| {
            let error = read_bounded(path, 10).expect_err("refused").to_string();
            assert!(error.contains(said) && error.contains(&path.display().to_string()), "{error}");
        };
        refused(&path, "10 bytes");
        refused(place.path(), "a folder");
        refused(&place.path().join("none"), "reading");
        #[cfg(unix)]
        {
            refused(Path::new("/dev/zero"), "a device");
            let pipe = place.path().join("pipe");
            let made = std::process::Command::new("mkfifo").arg(&pipe).status();
            if made.is_ok_and(|s| s.success()) {
                refused(&pipe, "a pipe");
            }
        }
    }

    #[test]
    fn sha256_of_abc_is_the_published_one() {
        // FIPS 180-2, appendix B.1.
        assert_eq!(sha256_hex(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
