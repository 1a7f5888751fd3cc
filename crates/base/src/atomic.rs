//! Files and folders that appear whole or not at all: written beside their place, then renamed there. Files that are read whole, up to a size; texts of a stated form.

use std::fs::{self, File};
use std::io::{BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use serde::Deserialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use crate::error::{Error, Result};

/// Writes bytes, whole or not at all.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_atomic(path, |out| out.write_all(bytes).map_err(|e| Error::writing(path, e)))
}

/// Refuses what is no file: opening a pipe waits for its writer, a device may have no end.
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
    regular(path)?;
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(|e| Error::reading(path, e))?;
    file.take(most.saturating_add(1)).read_to_end(&mut bytes).map_err(|e| Error::reading(path, e))?;
    if bytes.len() as u64 > most {
        let found = format!("more than {most} bytes");
        return Err(Error::bad(path.display().to_string(), "size", found, format!("at most {most} bytes")));
    }
    Ok(bytes)
}

/// SHA-256 of `bytes` as 64 lower-case hexadecimal digits.
pub fn sha256_hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The text of a file of at most `most` bytes.
///
/// # Errors
/// As [`read_bounded`]; what is not UTF-8.
pub fn read_text(path: &Path, most: u64) -> Result<String> {
    String::from_utf8(read_bounded(path, most)?).map_err(|e| {
        let found = format!("no text at byte {}", e.utf8_error().valid_up_to());
        Error::bad(path.display().to_string(), "text", found, "UTF-8")
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
    let form: Form = toml::from_str(text).map_err(syntax)?;
    if form.schema != Some(schema) {
        let found = form.schema.map_or("missing".into(), |s| s.to_string());
        return Err(Error::bad(file, "schema", found, format!("this version reads schema = {schema}")));
    }
    toml::from_str(text).map_err(syntax)
}

/// Runs `fill` on a file beside `path` and renames it to `path` when that went well; otherwise nothing is left behind.
pub fn write_atomic(path: &Path, fill: impl FnOnce(&mut BufWriter<File>) -> Result<()>) -> Result<()> {
    let partial = Partial(beside(path, "partial"));
    let failed = |e| Error::writing(path, e);
    let file = File::options().write(true).create_new(true).open(&partial.0).map_err(failed)?;
    let mut out = BufWriter::new(file);
    fill(&mut out)?;
    out.flush().map_err(failed)?;
    let file = out.into_inner().map_err(|e| failed(e.into_error()))?;
    file.sync_all().map_err(failed)?;
    fs::rename(&partial.0, path).map_err(failed)
}

/// Whether [`write_folder`] may put a folder at `folder`: nothing stands there, or `replace` and one with `marker` in it.
///
/// # Errors
/// [`Error::Exists`].
pub fn check_folder(folder: &Path, marker: &str, replace: bool) -> Result<()> {
    if folder.exists() && !(replace && folder.join(marker).is_file()) {
        return Err(Error::Exists(folder.to_owned()));
    }
    Ok(())
}

/// Runs `fill` on a folder beside `folder` and renames it there when that went well.
///
/// With `replace` an existing folder that holds the file `marker` gives way; any other never does.
///
/// # Errors
/// [`Error::Exists`], `fill`'s, or a folder that cannot be made.
pub fn write_folder<T>(folder: &Path, marker: &str, replace: bool, fill: impl FnOnce(&Path) -> Result<T>) -> Result<T> {
    check_folder(folder, marker, replace)?;
    let (partial, old) = (beside(folder, "partial"), beside(folder, "old"));
    let failed = |e| Error::writing(folder, e);
    let written = fs::create_dir_all(&partial).map_err(failed).and_then(|()| fill(&partial)).and_then(|value| {
        if folder.exists() {
            fs::rename(folder, &old).map_err(failed)?;
        }
        fs::rename(&partial, folder).map_err(|e| {
            // Put the old folder back; the first error is the one to tell.
            let _ = fs::rename(&old, folder);
            failed(e)
        })?;
        Ok(value)
    });
    let leftovers = if written.is_ok() { &old } else { &partial };
    if leftovers.exists() {
        let _ = fs::remove_dir_all(leftovers);
    }
    written
}

/// A file that is removed when its writing ends early; after the rename there is nothing left to remove.
struct Partial(PathBuf);

impl Drop for Partial {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

/// A name in the same folder that no other writer uses.
fn beside(path: &Path, what: &str) -> PathBuf {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    path.with_file_name(format!(".{name}.{}-{count}.{what}", std::process::id()))
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

    /// A folder of ours gives way to a new one; another folder, and a failed writing, leave everything as it was.
    #[test]
    fn folders_appear_whole_and_foreign_folders_are_never_replaced() {
        let place = tempfile::tempdir().expect("a temporary folder");
        let folder = place.path().join("run");
        let fill = |text: &'static str| move |at: &Path| write_bytes(&at.join("mark"), text.as_bytes());
        write_folder(&folder, "mark", false, fill("one")).expect("new");
        assert!(matches!(write_folder(&folder, "mark", false, fill("two")), Err(Error::Exists(_))));
        write_folder(&folder, "mark", true, fill("two")).expect("replaced");
        let failed = write_folder(&folder, "mark", true, |_| Err::<(), _>(Error::Internal("no".into())));
        assert!(failed.is_err());
        assert_eq!(fs::read(folder.join("mark")).expect("kept"), b"two");
        let foreign = place.path().join("photos");
        fs::create_dir(&foreign).expect("made");
        assert!(matches!(write_folder(&foreign, "mark", true, fill("x")), Err(Error::Exists(_))));
        assert_eq!(fs::read_dir(place.path()).expect("readable").count(), 2, "nothing is left beside");
    }

    #[test]
    fn sha256_of_abc_is_the_published_one() {
        // FIPS 180-2, appendix B.1.
        assert_eq!(sha256_hex(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
